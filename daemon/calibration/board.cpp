#include "calibration/board.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>
#include <opencv2/aruco.hpp>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <utility>

#include "facet/error.hpp"
#include "maths/statistics.hpp"

namespace facet::calibration {
namespace {

struct NamedDictionary {
  const char* name;
  cv::aruco::PREDEFINED_DICTIONARY_NAME value;
};

constexpr std::array kDictionaries = {
    NamedDictionary{"4X4_50", cv::aruco::DICT_4X4_50},
    NamedDictionary{"4X4_100", cv::aruco::DICT_4X4_100},
    NamedDictionary{"4X4_250", cv::aruco::DICT_4X4_250},
    NamedDictionary{"4X4_1000", cv::aruco::DICT_4X4_1000},
    NamedDictionary{"5X5_50", cv::aruco::DICT_5X5_50},
    NamedDictionary{"5X5_100", cv::aruco::DICT_5X5_100},
    NamedDictionary{"5X5_250", cv::aruco::DICT_5X5_250},
    NamedDictionary{"5X5_1000", cv::aruco::DICT_5X5_1000},
    NamedDictionary{"6X6_50", cv::aruco::DICT_6X6_50},
    NamedDictionary{"6X6_100", cv::aruco::DICT_6X6_100},
    NamedDictionary{"6X6_250", cv::aruco::DICT_6X6_250},
    NamedDictionary{"6X6_1000", cv::aruco::DICT_6X6_1000},
    NamedDictionary{"7X7_50", cv::aruco::DICT_7X7_50},
    NamedDictionary{"7X7_100", cv::aruco::DICT_7X7_100},
    NamedDictionary{"7X7_250", cv::aruco::DICT_7X7_250},
    NamedDictionary{"7X7_1000", cv::aruco::DICT_7X7_1000},
    NamedDictionary{"ARUCO_ORIGINAL", cv::aruco::DICT_ARUCO_ORIGINAL},
    NamedDictionary{"APRILTAG_36h11", cv::aruco::DICT_APRILTAG_36h11},
};

cv::Ptr<cv::aruco::Dictionary> dictionary_of(const Board& board) {
  const auto at = std::find_if(kDictionaries.begin(), kDictionaries.end(),
                               [&](const NamedDictionary& one) { return one.name == board.dictionary; });
  if (at == kDictionaries.end()) {
    throw Error(ErrorKind::Usage, fmt::format("there is no dictionary '{}'; known are: {}", board.dictionary,
                                              fmt::join(dictionary_names(), ", ")));
  }
  return cv::aruco::getPredefinedDictionary(at->value);
}

cv::Ptr<cv::aruco::CharucoBoard> charuco_of(const Board& board) {
  return cv::aruco::CharucoBoard::create(board.columns, board.rows, static_cast<float>(board.square_mm),
                                         static_cast<float>(board.marker_mm), dictionary_of(board));
}

/// A point of OpenCV's board frame in ours (calibration::Board), mm. Our y points down. OpenCV's points up
/// until version 4.6 and down in later ones; the corners of a marker tell which.
Eigen::Vector3d from_opencv(const Board& board, const cv::aruco::CharucoBoard& charuco,
                            const cv::Point3f& point) {
  const std::vector<cv::Point3f>& marker = charuco.objPoints.front();  // clockwise from its top left
  const bool up = marker[0].y > marker[3].y;
  const double y = static_cast<double>(point.y);
  return {static_cast<double>(point.x), up ? board.rows * board.square_mm - y : y, 0};
}

cv::Mat grey_of(const Frame& frame) {
  const cv::Mat rgba(frame.height_px, frame.width_px, CV_8UC4, const_cast<std::uint8_t*>(frame.pixels.get()),
                     frame.stride_bytes);  // OpenCV only reads it
  cv::Mat grey;
  cv::cvtColor(rgba, grey, cv::COLOR_RGBA2GRAY);
  return grey;
}

double sample(const cv::Mat& grey, const Eigen::Vector2d& at) {
  const int x = static_cast<int>(std::floor(at.x()));
  const int y = static_cast<int>(std::floor(at.y()));
  const double u = at.x() - x;
  const double v = at.y() - y;
  const auto value = [&](int column, int row) {
    return static_cast<double>(
        grey.at<std::uint8_t>(std::clamp(row, 0, grey.rows - 1), std::clamp(column, 0, grey.cols - 1)));
  };
  return (1 - v) * ((1 - u) * value(x, y) + u * value(x + 1, y)) +
         v * ((1 - u) * value(x, y + 1) + u * value(x + 1, y + 1));
}

/// The width of an edge between black and white in a picture, px. Grey levels are read along a line that
/// crosses the edge at its middle and reaches a quarter of a square to either side. The width is the greatest
/// level less the least one, divided by the steepest slope, levels per px. 0 where there is no contrast.
///
/// a, b  px, two neighbouring corners of the board, between which the edge runs
double edge_width_px(const cv::Mat& grey, const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  constexpr double kStep = 0.5;
  const Eigen::Vector2d along = b - a;
  const double reach = 0.25 * along.norm();
  const Eigen::Vector2d across = Eigen::Vector2d(-along.y(), along.x()).normalized();
  const Eigen::Vector2d middle = 0.5 * (a + b);
  double least = 255;
  double most = 0;
  double steepest = 0;
  for (double t = -reach; t <= reach; t += kStep) {
    const double here = sample(grey, middle + t * across);
    least = std::min(least, here);
    most = std::max(most, here);
    const double slope =
        std::abs(sample(grey, middle + (t + kStep) * across) - sample(grey, middle + (t - kStep) * across)) /
        (2 * kStep);
    steepest = std::max(steepest, slope);
  }
  constexpr double kLeastContrast = 10;
  return most - least >= kLeastContrast && steepest > 0 ? (most - least) / steepest : 0;
}

/// The median over all edges between neighbouring corners of a row.
double edge_width_px(const cv::Mat& grey, const Board& board, const BoardView& view) {
  std::vector<double> widths;
  for (std::size_t i = 0; i + 1 < view.ids.size(); ++i) {
    if (view.ids[i + 1] == view.ids[i] + 1 && view.ids[i + 1] % (board.columns - 1) != 0) {
      if (const double width = edge_width_px(grey, view.px[i], view.px[i + 1]); width > 0) {
        widths.push_back(width);
      }
    }
  }
  return widths.empty() ? 0 : maths::median_of(widths);
}

/// What is printed, as a camera sees it: drawn with about as many px a mm as the board has in the camera's
/// picture, and blurred.
struct Print {
  cv::Mat grey;  // CV_32FC3: the grey level, 0 to 255, and its slopes to the right and down, levels per px
  double px_per_mm = 1;
  double margin_mm = 0;

  /// The three values of `grey` at a place between its pixels, px: interpolated bilinearly. Beyond the edge
  /// of `grey` they are those at the edge.
  Eigen::Vector3d at(const Eigen::Vector2d& px) const {
    const int x = std::clamp(static_cast<int>(std::floor(px.x())), 0, grey.cols - 2);
    const int y = std::clamp(static_cast<int>(std::floor(px.y())), 0, grey.rows - 2);
    const auto u = static_cast<float>(std::clamp(px.x() - x, 0.0, 1.0));
    const auto v = static_cast<float>(std::clamp(px.y() - y, 0.0, 1.0));
    const auto* above = grey.ptr<cv::Vec3f>(y) + x;
    const auto* below = grey.ptr<cv::Vec3f>(y + 1) + x;
    const cv::Vec3f mixed =
        (1 - v) * ((1 - u) * above[0] + u * above[1]) + v * ((1 - u) * below[0] + u * below[1]);
    return {static_cast<double>(mixed[0]), static_cast<double>(mixed[1]), static_cast<double>(mixed[2])};
  }
};

Print print_of(const Board& board, double px_per_mm) {
  Print print;
  print.px_per_mm = px_per_mm;
  print.margin_mm = margin_mm(board);
  const render::Picture sheet = draw_board(board, px_per_mm);
  const cv::Mat rgb(sheet.height_px, sheet.width_px, CV_8UC3, const_cast<std::uint8_t*>(sheet.rgb.data()));
  cv::Mat planes[3];
  cv::cvtColor(rgb, planes[0], cv::COLOR_RGB2GRAY);
  planes[0].convertTo(planes[0], CV_32F);
  constexpr double kBlur_px = 0.7;
  cv::GaussianBlur(planes[0], planes[0], {0, 0}, kBlur_px);
  const cv::Matx13f difference(-0.5F, 0, 0.5F);
  cv::filter2D(planes[0], planes[1], CV_32F, difference);
  cv::filter2D(planes[0], planes[2], CV_32F, difference.t());
  cv::merge(planes, 3, print.grey);
  return print;
}

/// Where a corner is seen: the shift of the print, with a gain and an offset of its brightness, for which the
/// picture around the corner is most like it ([LK81], Gauss-Newton). board_from_px: from the
/// picture to the board's mm near the corner, apart from a shift. Nothing where it does not settle within 3
/// px.
std::optional<Eigen::Vector2d> matched_corner(const cv::Mat& grey, const Print& print, const Board& board,
                                              const Eigen::Vector3d& corner_mm, const Eigen::Vector2d& start,
                                              const Eigen::Matrix3d& board_from_px,
                                              const Eigen::Matrix2d& px_per_mm) {
  const double reach_mm = 0.7 * board.square_mm;
  constexpr double kMostReach_px = 40;
  const int reach_px = static_cast<int>(
      std::ceil(std::min(kMostReach_px, reach_mm * px_per_mm.cwiseAbs().rowwise().sum().maxCoeff())));
  const Eigen::Matrix2d mm_per_px = px_per_mm.inverse();
  // Where the homography itself puts the corner: what the shift is counted from.
  const Eigen::Vector3d seen = board_from_px.inverse() * Eigen::Vector3d(corner_mm.x(), corner_mm.y(), 1);
  const Eigen::Vector2d anchor = seen.head<2>() / seen.z();
  Eigen::Vector2d at = start;
  constexpr int kMostSteps = 20;
  for (int step = 0; step < kMostSteps; ++step) {
    Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
    Eigen::Vector4d right = Eigen::Vector4d::Zero();
    // Gain and offset of this step's position come out of the same equations: the shift's column needs the
    // last step's gain, 0.7 of the range to begin with.
    const int x0 = static_cast<int>(std::lround(at.x()));
    const int y0 = static_cast<int>(std::lround(at.y()));
    for (int y = std::max(0, y0 - reach_px); y <= std::min(grey.rows - 1, y0 + reach_px); ++y) {
      for (int x = std::max(0, x0 - reach_px); x <= std::min(grey.cols - 1, x0 + reach_px); ++x) {
        const Eigen::Vector2d moved = Eigen::Vector2d(x, y) - at + anchor;
        const Eigen::Vector3d on_board = board_from_px * Eigen::Vector3d(moved.x(), moved.y(), 1);
        const Eigen::Vector2d mm = on_board.head<2>() / on_board.z();
        if ((mm - corner_mm.head<2>()).cwiseAbs().maxCoeff() > reach_mm) {
          continue;
        }
        const Eigen::Vector2d sheet = (mm + Eigen::Vector2d::Constant(print.margin_mm)) * print.px_per_mm -
                                      Eigen::Vector2d::Constant(0.5);
        const Eigen::Vector3d print_there = print.at(sheet);
        const double value = print_there[0];
        const Eigen::Vector2d slope = print_there.tail<2>();
        // The print under a fixed pixel moves the other way.
        const Eigen::Vector2d by_shift = -print.px_per_mm * mm_per_px.transpose() * slope;
        const Eigen::Vector4d row(by_shift.x(), by_shift.y(), value, 1);
        normal += row * row.transpose();
        right += row * static_cast<double>(grey.at<std::uint8_t>(y, x));
      }
    }
    // I = gain (print + by_shift . move) + offset: linear in gain move, gain and offset.
    const Eigen::Vector4d found = normal.ldlt().solve(right);
    const Eigen::Vector2d move = found.head<2>() / found[2];
    constexpr double kMost_px = 3;
    constexpr double kLeastGain = 0.02;
    if (!(found[2] > kLeastGain) || !((at + move - start).norm() <= kMost_px)) {
      return std::nullopt;
    }
    at += move;
    if (move.norm() < 1e-3) {
      return at;
    }
  }
  return std::nullopt;
}

/// Whether all corners of a view lie in one row or column of the board, where no pose can be found from them.
bool in_one_line(const Board& board, const std::vector<int>& ids) {
  const int across = board.columns - 1;
  const auto same = [&](auto key) {
    return std::all_of(ids.begin(), ids.end(), [&](int id) { return key(id) == key(ids.front()); });
  };
  return same([&](int id) { return id / across; }) || same([&](int id) { return id % across; });
}

}  // namespace

std::vector<std::string> dictionary_names() {
  std::vector<std::string> names;
  names.reserve(kDictionaries.size());
  for (const NamedDictionary& one : kDictionaries) {
    names.emplace_back(one.name);
  }
  return names;
}

void check(const Board& board) {
  constexpr int kMostSquares = 64;
  constexpr double kMostSquare_mm = 1000;
  if (board.columns < 4 || board.rows < 4 || board.columns > kMostSquares || board.rows > kMostSquares) {
    throw Error(ErrorKind::Usage, fmt::format("a board of {}x{} squares: 4 to {} each way are possible",
                                              board.columns, board.rows, kMostSquares));
  }
  if (!(board.square_mm >= 0.1 && board.square_mm <= kMostSquare_mm)) {
    throw Error(ErrorKind::Usage,
                fmt::format("a square of {} mm: 0.1 to {} mm are possible", board.square_mm, kMostSquare_mm));
  }
  if (board.kind == BoardKind::Checkerboard) {
    if ((board.columns + board.rows) % 2 == 0) {
      throw Error(ErrorKind::Usage,
                  fmt::format("a checkerboard of {}x{} squares looks the same upside down, so two cameras "
                              "could take one corner for another: use an even number of squares one way and "
                              "an odd number the other, such as {}x{}",
                              board.columns, board.rows, board.columns, board.rows - 1));
    }
    return;
  }
  const cv::Ptr<cv::aruco::Dictionary> dictionary = dictionary_of(board);
  const int cells = dictionary->markerSize + 2;
  if (!(board.marker_mm < board.square_mm && board.marker_mm >= 0.3 * board.square_mm)) {
    throw Error(ErrorKind::Usage,
                fmt::format("a marker of {} mm in a square of {} mm: {:g} mm and more, but less than the "
                            "square, are possible; 0.7 to 0.8 of it are usual",
                            board.marker_mm, board.square_mm, 0.3 * board.square_mm));
  }
  const int markers = board.columns * board.rows / 2;
  if (markers > dictionary->bytesList.rows) {
    throw Error(ErrorKind::Usage,
                fmt::format("a ChArUco board of {}x{} squares needs {} markers of {}x{} cells, dictionary {} "
                            "has {}",
                            board.columns, board.rows, markers, cells, cells, board.dictionary,
                            dictionary->bytesList.rows));
  }
}

std::vector<Eigen::Vector3d> corners_mm(const Board& board) {
  std::vector<Eigen::Vector3d> corners;
  if (board.kind == BoardKind::Charuco) {
    const cv::Ptr<cv::aruco::CharucoBoard> charuco = charuco_of(board);
    for (const cv::Point3f& corner : charuco->chessboardCorners) {
      corners.push_back(from_opencv(board, *charuco, corner));
    }
    return corners;
  }
  for (int row = 1; row < board.rows; ++row) {
    for (int column = 1; column < board.columns; ++column) {
      corners.emplace_back(column * board.square_mm, row * board.square_mm, 0);
    }
  }
  return corners;
}

std::vector<Rectangle> black_parts(const Board& board) {
  const double square = board.square_mm;
  std::vector<Rectangle> parts;
  std::vector<bool> has_marker(static_cast<std::size_t>(board.columns * board.rows));
  const auto cell = [&](int column, int row) {
    return static_cast<std::size_t>(row * board.columns + column);
  };
  if (board.kind == BoardKind::Charuco) {
    const cv::Ptr<cv::aruco::CharucoBoard> charuco = charuco_of(board);
    const cv::Ptr<cv::aruco::Dictionary> dictionary = charuco->dictionary;
    const int cells = dictionary->markerSize + 2;
    for (std::size_t i = 0; i < charuco->objPoints.size(); ++i) {
      const Eigen::Vector3d first = from_opencv(board, *charuco, charuco->objPoints[i][0]);
      has_marker[cell(static_cast<int>(first.x() / square), static_cast<int>(first.y() / square))] = true;
      cv::Mat bits;  // one pixel a cell
      dictionary->drawMarker(charuco->ids[i], cells, bits, 1);
      const double size = board.marker_mm / cells;
      for (int y = 0; y < cells; ++y) {
        for (int x = 0; x < cells; ++x) {
          if (bits.at<std::uint8_t>(y, x) == 0) {
            parts.push_back({first.x() + x * size, first.y() + y * size, size, size});
          }
        }
      }
    }
  }
  for (int row = 0; row < board.rows; ++row) {
    for (int column = 0; column < board.columns; ++column) {
      const bool black =
          board.kind == BoardKind::Charuco ? !has_marker[cell(column, row)] : (column + row) % 2 == 0;
      if (black) {
        parts.push_back({column * square, row * square, square, square});
      }
    }
  }
  return parts;
}

double margin_mm(const Board& board) {
  return 0.5 * board.square_mm;
}

render::Picture draw_board(const Board& board, double px_per_mm) {
  check(board);
  const double margin = margin_mm(board);
  const double width = (board.columns * board.square_mm + 2 * margin) * px_per_mm;
  const double height = (board.rows * board.square_mm + 2 * margin) * px_per_mm;
  constexpr double kMost_px = 20'000;
  if (!(width >= 1 && height >= 1 && width <= kMost_px && height <= kMost_px)) {
    throw Error(ErrorKind::Usage, fmt::format("the board's picture would have {:.0f}x{:.0f} px; 1 to {} are "
                                              "possible",
                                              width, height, kMost_px));
  }
  render::Picture picture = render::plain_picture(static_cast<int>(std::lround(width)),
                                                  static_cast<int>(std::lround(height)), {255, 255, 255});
  std::vector<float> black(picture.rgb.size() / 3);
  // The part of the pixel [i, i + 1) that [from, to) covers.
  const auto part = [](double from, double to, int i) {
    return std::max(0.0, std::min(to, i + 1.0) - std::max(from, static_cast<double>(i)));
  };
  for (const Rectangle& rectangle : black_parts(board)) {
    const double left = (rectangle.x_mm + margin) * px_per_mm;
    const double right = left + rectangle.width_mm * px_per_mm;
    const double top = (rectangle.y_mm + margin) * px_per_mm;
    const double bottom = top + rectangle.height_mm * px_per_mm;
    for (int y = static_cast<int>(top); y < std::min(bottom, double(picture.height_px)); ++y) {
      for (int x = static_cast<int>(left); x < std::min(right, double(picture.width_px)); ++x) {
        black[static_cast<std::size_t>(y) * static_cast<std::size_t>(picture.width_px) +
              static_cast<std::size_t>(x)] += static_cast<float>(part(left, right, x) * part(top, bottom, y));
      }
    }
  }
  for (std::size_t i = 0; i < black.size(); ++i) {
    const auto grey = static_cast<std::uint8_t>(std::lround(255 * (1 - std::min(black[i], 1.0F))));
    std::fill_n(picture.rgb.begin() + static_cast<std::ptrdiff_t>(3 * i), 3, grey);
  }
  return picture;
}

std::string board_pdf(const Board& board) {
  check(board);
  constexpr double kPointsPerMm = 72 / 25.4;
  const double margin = margin_mm(board);
  const double height_mm = board.rows * board.square_mm + 2 * margin;
  // PDF's y points up.
  std::string drawing = fmt::format("{} 0 0 {} 0 0 cm 0 g\n", kPointsPerMm, kPointsPerMm);
  for (const Rectangle& part : black_parts(board)) {
    drawing += fmt::format("{:.4f} {:.4f} {:.4f} {:.4f} re\n", part.x_mm + margin,
                           height_mm - margin - part.y_mm - part.height_mm, part.width_mm, part.height_mm);
  }
  drawing += "f\n";
  const std::array<std::string, 4> objects = {
      "<< /Type /Catalog /Pages 2 0 R >>", "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
      fmt::format(
          "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {:.4f} {:.4f}] /Contents 4 0 R /Resources << >> "
          ">>",
          (board.columns * board.square_mm + 2 * margin) * kPointsPerMm, height_mm * kPointsPerMm),
      fmt::format("<< /Length {} >>\nstream\n{}endstream", drawing.size(), drawing)};
  std::string pdf = "%PDF-1.4\n";
  std::string table = fmt::format("xref\n0 {}\n0000000000 65535 f \n", objects.size() + 1);
  for (std::size_t i = 0; i < objects.size(); ++i) {
    table += fmt::format("{:010} 00000 n \n", pdf.size());
    pdf += fmt::format("{} 0 obj\n{}\nendobj\n", i + 1, objects[i]);
  }
  const std::size_t table_at = pdf.size();
  return pdf + table +
         fmt::format("trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{}\n%%EOF\n", objects.size() + 1,
                     table_at);
}

struct BoardDetector::Impl {
  Board board;
  DetectorOptions options;
  cv::Ptr<cv::aruco::CharucoBoard> charuco;
  cv::Ptr<cv::aruco::DetectorParameters> parameters;
  std::vector<Eigen::Vector3d> corners;

  void find_charuco(const cv::Mat& grey, BoardView& view) const {
    std::vector<std::vector<cv::Point2f>> markers;
    std::vector<std::vector<cv::Point2f>> rejected;
    std::vector<int> marker_ids;
    cv::aruco::detectMarkers(grey, charuco->dictionary, markers, marker_ids, parameters, rejected);
    if (marker_ids.empty()) {
      view.problem = "no marker of the board is seen";
      return;
    }
    cv::aruco::refineDetectedMarkers(grey, charuco, markers, marker_ids, rejected);
    cv::Mat found;
    cv::Mat ids;
    // Corners between two known markers alone: one marker is no proof of this board.
    cv::aruco::interpolateCornersCharuco(markers, marker_ids, grey, charuco, found, ids);
    for (int i = 0; i < ids.rows; ++i) {
      const cv::Point2f at = found.at<cv::Point2f>(i);
      view.ids.push_back(ids.at<int>(i));
      // ArUco's pixel centres are at halves.
      view.px.emplace_back(static_cast<double>(at.x) - 0.5, static_cast<double>(at.y) - 0.5);
    }
    refine(grey, view);
    const auto foreign = std::count_if(marker_ids.begin(), marker_ids.end(), [&](int id) {
      return std::find(charuco->ids.begin(), charuco->ids.end(), id) == charuco->ids.end();
    });
    if (2 * foreign > static_cast<std::ptrdiff_t>(marker_ids.size())) {
      view.problem =
          fmt::format("{} of {} markers are not of this board: another board?", foreign, marker_ids.size());
    }
  }

  /// ArUco's own corners are half a pixel off (its pixel centres are at halves) and drawn towards the
  /// markers' edges on oblique boards: they are where the search begins. It is made again for those that are
  /// not found, from where the others say that they are; what is not found then is left out.
  void refine(const cv::Mat& grey, BoardView& view) const {
    const BoardView begin = view;
    std::optional<Print> print;
    std::vector<std::optional<Eigen::Vector2d>> refined(begin.ids.size());
    for (int round = 0; round < 2; ++round) {
      const std::optional<Eigen::Matrix3d> homography = homography_of(view);
      view = {};
      if (!homography) {
        return;
      }
      const Eigen::Matrix3d board_from_px = homography->inverse();
      for (std::size_t i = 0; i < begin.ids.size(); ++i) {
        const Eigen::Vector3d& corner = corners[static_cast<std::size_t>(begin.ids[i])];
        const Eigen::Vector3d seen = *homography * Eigen::Vector3d(corner.x(), corner.y(), 1);
        const Eigen::Vector2d at = seen.head<2>() / seen.z();
        const Eigen::Matrix2d px_per_mm =
            (homography->topLeftCorner<2, 2>() - at * homography->block<1, 2>(2, 0)) / seen.z();
        if (!print) {
          // No finer than 4000 px and no coarser than 8 px a square.
          const double coarsest = 8 / board.square_mm;
          const double finest = 4000 / (std::max(board.columns, board.rows) * board.square_mm);
          print = print_of(board, std::clamp(std::sqrt(std::abs(px_per_mm.determinant())), coarsest,
                                             std::max(finest, coarsest)));
        }
        if (!refined[i]) {
          refined[i] = matched_corner(grey, *print, board, corner, round == 0 ? begin.px[i] : at,
                                      board_from_px, px_per_mm);
        }
        if (refined[i]) {
          view.ids.push_back(begin.ids[i]);
          view.px.push_back(*refined[i]);
        }
      }
    }
  }

  /// From the board's mm to the picture, lens distortion left aside; nothing where the corners do not tell.
  std::optional<Eigen::Matrix3d> homography_of(const BoardView& view) const {
    std::vector<cv::Point2f> on_board;
    std::vector<cv::Point2f> on_picture;
    for (std::size_t i = 0; i < view.ids.size(); ++i) {
      const Eigen::Vector3d& corner = corners[static_cast<std::size_t>(view.ids[i])];
      on_board.emplace_back(static_cast<float>(corner.x()), static_cast<float>(corner.y()));
      on_picture.emplace_back(static_cast<float>(view.px[i].x()), static_cast<float>(view.px[i].y()));
    }
    constexpr std::size_t kLeast = 5;   // four make a homography, and one to spare
    constexpr double kMostMiss_px = 5;  // lenses bend it
    if (on_board.size() < kLeast || in_one_line(board, view.ids)) {
      return std::nullopt;
    }
    const cv::Mat found = cv::findHomography(on_board, on_picture, cv::RANSAC, kMostMiss_px);
    if (found.empty()) {
      return std::nullopt;
    }
    const Eigen::Matrix3d homography =
        Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(found.ptr<double>());
    return homography.determinant() != 0 ? std::optional(homography) : std::nullopt;
  }

  void find_checkerboard(const cv::Mat& grey, BoardView& view) const {
    const int across = board.columns - 1;
    const int down = board.rows - 1;
    std::vector<cv::Point2f> found;
    if (!cv::findChessboardCornersSB(grey, {across, down}, found,
                                     cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_ACCURACY)) {
      view.problem = fmt::format("no checkerboard of {}x{} squares is seen whole", board.columns, board.rows);
      return;
    }
    std::vector<Eigen::Vector2d> px;
    px.reserve(found.size());
    for (const cv::Point2f& at : found) {
      px.emplace_back(static_cast<double>(at.x), static_cast<double>(at.y));
    }
    // Rows may have been found from right to left, and the board upside down.
    const Eigen::Vector2d along = px[1] - px[0];
    const Eigen::Vector2d beside = px[static_cast<std::size_t>(across)] - px[0];
    if (along.x() * beside.y() - along.y() * beside.x() < 0) {
      for (auto row = px.begin(); row != px.end(); row += across) {
        std::reverse(row, row + across);
      }
    }
    // The square inside the first four corners is black: (1, 1) of the board.
    const auto square = [&](std::size_t i) {
      const auto width = static_cast<std::size_t>(across);
      return sample(grey, 0.25 * (px[i] + px[i + 1] + px[i + width] + px[i + width + 1]));
    };
    if (square(0) > square(1)) {
      std::reverse(px.begin(), px.end());
    }
    view.px = std::move(px);
    view.ids.resize(view.px.size());
    std::iota(view.ids.begin(), view.ids.end(), 0);
    refine(grey, view);
  }
};

BoardDetector::BoardDetector(const Board& board, const DetectorOptions& options)
    : impl_(std::make_unique<Impl>()) {
  check(board);
  impl_->board = board;
  impl_->options = options;
  impl_->parameters = cv::aruco::DetectorParameters::create();
  impl_->corners = corners_mm(board);
  if (board.kind == BoardKind::Charuco) {
    impl_->charuco = charuco_of(board);
  }
}

BoardDetector::~BoardDetector() = default;

const Board& BoardDetector::board() const {
  return impl_->board;
}

BoardView BoardDetector::detect(const Frame& picture) const {
  BoardView view;
  constexpr int kLeast_px = 64;
  if (picture.empty() || picture.width_px < kLeast_px || picture.height_px < kLeast_px) {
    view.problem = picture.empty() ? "there is no picture" : "the picture is too small";
    return view;
  }
  if (picture.corrupt) {
    view.problem = "the camera says that the picture is damaged";
    return view;
  }
  const cv::Mat grey = grey_of(picture);
  try {
    if (impl_->board.kind == BoardKind::Charuco) {
      impl_->find_charuco(grey, view);
    } else {
      impl_->find_checkerboard(grey, view);
    }
  } catch (const cv::Exception& error) {  // odd pictures fail OpenCV's own checks
    view = {};
    view.problem = fmt::format("OpenCV can't search this picture ({})", error.err);
  }
  if (!view.usable()) {
    return view;
  }
  const auto count = static_cast<int>(view.ids.size());
  view.edge_width_px = edge_width_px(grey, impl_->board, view);
  if (count < impl_->options.least_corners) {
    view.problem =
        fmt::format("only {} of {} corners are seen, {} are needed", count,
                    (impl_->board.columns - 1) * (impl_->board.rows - 1), impl_->options.least_corners);
  } else if (in_one_line(impl_->board, view.ids)) {
    view.problem = "all corners that are seen lie in one line";
  } else if (view.edge_width_px > impl_->options.most_edge_width_px) {
    view.problem = fmt::format("blurred: edges are {:.1f} px wide, {:.1f} are allowed", view.edge_width_px,
                               impl_->options.most_edge_width_px);
  }
  return view;
}

}  // namespace facet::calibration
