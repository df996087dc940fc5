#include "support/board_views.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

namespace facet::calibration {
namespace {

constexpr double kRadians = std::numbers::pi / 180;
constexpr int kSubPixels = 4;
constexpr double kDistance_mm = 800;
// Grey levels of what is black, white and behind the board.
constexpr float kBlack = 25;
constexpr float kWhite = 215;
constexpr float kBackground = 95;

double spread(simulation::Random& random, double by) {
  return static_cast<double>(random.uniform(-1, 1)) * by;
}

/// A camera at a place that looks at another one; its x axis is level (y of the rig points down).
Eigen::Isometry3d looking_at(const Eigen::Vector3d& from, const Eigen::Vector3d& at) {
  Eigen::Matrix3d rig_from_camera;
  rig_from_camera.col(2) = (at - from).normalized();
  rig_from_camera.col(0) = Eigen::Vector3d::UnitY().cross(rig_from_camera.col(2)).normalized();
  rig_from_camera.col(1) = rig_from_camera.col(2).cross(rig_from_camera.col(0));
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = rig_from_camera;
  pose.translation() = from;
  return pose.inverse();
}

/// Gaussian blur along rows or columns; the picture's edge goes on outside.
void blur(std::vector<float>& grey, int width, int height, double sigma_px, bool along_rows) {
  const int reach = static_cast<int>(std::ceil(3 * sigma_px));
  std::vector<float> weights;
  float sum = 0;
  for (int i = -reach; i <= reach; ++i) {
    weights.push_back(static_cast<float>(std::exp(-0.5 * i * i / (sigma_px * sigma_px))));
    sum += weights.back();
  }
  const std::vector<float> from = grey;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      float value = 0;
      for (int i = -reach; i <= reach; ++i) {
        const int column = along_rows ? std::clamp(x + i, 0, width - 1) : x;
        const int row = along_rows ? y : std::clamp(y + i, 0, height - 1);
        value += weights[static_cast<std::size_t>(i + reach)] *
                 from[static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
                      static_cast<std::size_t>(column)];
      }
      grey[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)] =
          value / sum;
    }
  }
}

/// Bilinear, in pixels of the sheet; white outside.
float sheet_at(const render::Picture& sheet, double x, double y) {
  const int left = static_cast<int>(std::floor(x));
  const int top = static_cast<int>(std::floor(y));
  const auto u = static_cast<float>(x - left);
  const auto v = static_cast<float>(y - top);
  const auto value = [&](int column, int row) {
    if (column < 0 || row < 0 || column >= sheet.width_px || row >= sheet.height_px) {
      return 255.0F;
    }
    return static_cast<float>(
        sheet.rgb[3 * (static_cast<std::size_t>(row) * static_cast<std::size_t>(sheet.width_px) +
                       static_cast<std::size_t>(column))]);
  };
  return (1 - v) * ((1 - u) * value(left, top) + u * value(left + 1, top)) +
         v * ((1 - u) * value(left, top + 1) + u * value(left + 1, top + 1));
}

}  // namespace

capture::Rig booth_rig(std::uint64_t seed) {
  struct Place {
    const char* name;
    double azimuth_deg;  // positive: on the cameras' right
    double shift_mm;     // along the camera's x axis
    double height_mm;
    double fx_px;
    bool colour;
  };
  constexpr std::array kPlaces = {
      Place{"left-a", -30, -30, 0, 1000, false},  Place{"left-b", -30, 30, 0, 1000, false},
      Place{"right-a", 30, -30, 0, 1000, false},  Place{"right-b", 30, 30, 0, 1000, false},
      Place{"colour-a", -12, 0, -120, 950, true}, Place{"colour-b", 12, 0, -120, 950, true},
  };
  simulation::Random random(seed, 0x626F6F7468ULL);
  capture::Rig rig;
  for (const Place& place : kPlaces) {
    const double azimuth = place.azimuth_deg * kRadians;
    const Eigen::Vector3d out(std::sin(azimuth), 0, -std::cos(azimuth));
    const Eigen::Vector3d along(std::cos(azimuth), 0, std::sin(azimuth));
    const Eigen::Vector3d from =
        kDistance_mm * out + place.shift_mm * along +
        Eigen::Vector3d(spread(random, 4), place.height_mm + spread(random, 4), spread(random, 4));
    const Eigen::Vector3d at(spread(random, 10), spread(random, 10), spread(random, 10));
    capture::RigCamera camera;
    camera.name = place.name;
    camera.colour = place.colour;
    capture::Lens& lens = camera.lens;
    lens.width_px = 640;
    lens.height_px = 480;
    lens.fx_px = place.fx_px * (1 + spread(random, 0.02));
    lens.fy_px = lens.fx_px * (1 + spread(random, 0.002));
    lens.cx_px = 319.5 + spread(random, 8);
    lens.cy_px = 239.5 + spread(random, 8);
    lens.distortion = {-0.15 + spread(random, 0.05), 0.08 + spread(random, 0.05), spread(random, 5e-4),
                       spread(random, 5e-4), 0};
    lens.camera_from_rig =
        Eigen::AngleAxisd(spread(random, 2 * kRadians), Eigen::Vector3d::UnitZ()) * looking_at(from, at);
    rig.cameras.push_back(camera);
  }
  rig.pairs = {{0, 1}, {2, 3}};
  return rig;
}

std::vector<Eigen::Isometry3d> held_board_poses(const Board& board, int count, std::uint64_t seed,
                                                double most_tilt_deg) {
  simulation::Random random(seed, 0x68616E64ULL);
  std::vector<Eigen::Isometry3d> poses;
  const Eigen::Vector3d centre(0.5 * board.columns * board.square_mm, 0.5 * board.rows * board.square_mm, 0);
  for (int i = 0; i < count; ++i) {
    const double about = spread(random, std::numbers::pi);
    const double tilt = most_tilt_deg * kRadians * std::sqrt(static_cast<double>(random.uniform()));
    const Eigen::Vector3d place(spread(random, 130), spread(random, 90), spread(random, 120));
    poses.emplace_back(Eigen::Translation3d(place) *
                       Eigen::AngleAxisd(tilt, Eigen::Vector3d(std::cos(about), std::sin(about), 0)) *
                       Eigen::AngleAxisd(spread(random, 0.3), Eigen::Vector3d::UnitZ()) *
                       Eigen::Translation3d(-centre));
  }
  return poses;
}

BoardView seen_corners(const Board& board, const capture::Lens& lens, const Eigen::Isometry3d& rig_from_board,
                       double noise_px, simulation::Random& random) {
  BoardView view;
  view.edge_width_px = 1.5;
  const Eigen::Isometry3d camera_from_board = lens.camera_from_rig * rig_from_board;
  const bool from_front = camera_from_board.linear().col(2).dot(camera_from_board.translation()) > 0;
  const std::vector<Eigen::Vector3d> corners = corners_mm(board);
  for (std::size_t i = 0; from_front && i < corners.size(); ++i) {
    const std::optional<Eigen::Vector2d> px = lens.project(rig_from_board * corners[i]);
    const auto inside = [](double at, int size) { return at >= 2 && at <= size - 3; };
    if (px && inside(px->x(), lens.width_px) && inside(px->y(), lens.height_px)) {
      const Eigen::Vector2d noise(static_cast<double>(random.normal()), static_cast<double>(random.normal()));
      view.ids.push_back(static_cast<int>(i));
      view.px.emplace_back(*px + noise_px * noise);
    }
  }
  constexpr std::size_t kLeast = 12;
  if (view.ids.size() < kLeast) {
    view.problem = "only some corners are in the picture";
  }
  return view;
}

BoardCamera::BoardCamera(const Board& board, const capture::Lens& lens)
    : lens_(lens),
      // Samples of the sheet about as dense as those of the picture at the booth's distance.
      px_per_mm_(kSubPixels * lens.fx_px / kDistance_mm),
      margin_mm_(margin_mm(board)),
      sheet_(draw_board(board, px_per_mm_)),
      directions_(static_cast<std::size_t>(lens.width_px) * static_cast<std::size_t>(lens.height_px) *
                  kSubPixels * kSubPixels) {
  constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();
  render::for_each_row(lens.height_px * kSubPixels, [&](int row) {
    for (int column = 0; column < lens.width_px * kSubPixels; ++column) {
      const Eigen::Vector2d px((column + 0.5) / kSubPixels - 0.5, (row + 0.5) / kSubPixels - 0.5);
      const std::optional<Eigen::Vector3d> direction = lens.direction(px);
      directions_[static_cast<std::size_t>(row) * static_cast<std::size_t>(lens.width_px * kSubPixels) +
                  static_cast<std::size_t>(column)] =
          direction ? Eigen::Vector2f(direction->head<2>().cast<float>())
                    : Eigen::Vector2f(kNothing, kNothing);
    }
  });
}

Frame BoardCamera::take(const Eigen::Isometry3d& rig_from_board, const BoardPictureOptions& options,
                        simulation::Random& random) const {
  const Eigen::Isometry3d board_from_camera = (lens_.camera_from_rig * rig_from_board).inverse();
  const Eigen::Vector3d eye = board_from_camera.translation();
  const Eigen::Matrix3d turn = board_from_camera.linear();
  const int width = lens_.width_px;
  const int height = lens_.height_px;
  std::vector<float> grey(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  render::for_each_row(height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      float sum = 0;
      for (int sub = 0; sub < kSubPixels * kSubPixels; ++sub) {
        const auto row = static_cast<std::size_t>(y * kSubPixels + sub / kSubPixels);
        const auto column = static_cast<std::size_t>(x * kSubPixels + sub % kSubPixels);
        const Eigen::Vector2f direction =
            directions_[row * static_cast<std::size_t>(width * kSubPixels) + column];
        const Eigen::Vector3d ray =
            turn * Eigen::Vector3d(static_cast<double>(direction.x()), static_cast<double>(direction.y()), 1);
        float value = kBackground;
        // The board's printed side is seen from z < 0 of its frame; NaN compares false.
        if (eye.z() < 0 && ray.z() > 0) {
          const Eigen::Vector3d hit = eye - eye.z() / ray.z() * ray;
          const double u = (hit.x() + margin_mm_) * px_per_mm_;
          const double v = (hit.y() + margin_mm_) * px_per_mm_;
          if (u >= 0 && v >= 0 && u <= sheet_.width_px && v <= sheet_.height_px) {
            value = kBlack + (kWhite - kBlack) / 255 * sheet_at(sheet_, u - 0.5, v - 0.5);
          }
        }
        sum += value;
      }
      // Light falls off towards one side, as it does in rooms.
      const float light = 1 - 0.25F * static_cast<float>(x) / static_cast<float>(width);
      grey[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)] =
          light * sum / static_cast<float>(kSubPixels * kSubPixels);
    }
  });
  if (options.blur_px > 0) {
    blur(grey, width, height, options.blur_px, true);
    blur(grey, width, height, options.blur_px, false);
  }
  render::Picture picture = render::plain_picture(width, height, {0, 0, 0});
  for (std::size_t i = 0; i < grey.size(); ++i) {
    const float value = grey[i] + static_cast<float>(options.noise) * random.normal();
    std::fill_n(picture.rgb.begin() + static_cast<std::ptrdiff_t>(3 * i), 3,
                static_cast<std::uint8_t>(std::clamp(std::lround(value), 0L, 255L)));
  }
  return render::to_frame(picture);
}

}  // namespace facet::calibration
