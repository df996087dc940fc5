#include "calibration/board.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <string>

#include "facet/error.hpp"
#include "support/board_views.hpp"

namespace facet::calibration {
namespace {

using simulation::Random;
using ::testing::HasSubstr;

Board checkerboard() {
  Board board;
  board.kind = BoardKind::Checkerboard;
  board.columns = 10;
  return board;
}

std::string error_of(const Board& board) {
  try {
    check(board);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "no error";
}

/// Rows of the sheet's picture, 0.
bool is_black(const render::Picture& sheet, double px_per_mm, double x_mm, double y_mm) {
  const auto x = static_cast<std::size_t>(x_mm * px_per_mm);
  const auto y = static_cast<std::size_t>(y_mm * px_per_mm);
  return sheet.rgb[3 * (y * static_cast<std::size_t>(sheet.width_px) + x)] < 128;
}

TEST(Board, WhatCannotWorkIsRefused) {
  EXPECT_EQ(error_of({}), "no error");
  EXPECT_EQ(error_of(checkerboard()), "no error");
  Board board = checkerboard();
  board.columns = 9;
  EXPECT_THAT(error_of(board), HasSubstr("upside down"));
  board = {};
  board.marker_mm = 20;
  EXPECT_THAT(error_of(board), HasSubstr("marker of 20 mm"));
  board = {};
  board.dictionary = "3X3";
  EXPECT_THAT(error_of(board), HasSubstr("known are: 4X4_50"));
  board = {.columns = 20, .rows = 20, .dictionary = "4X4_50"};
  EXPECT_THAT(error_of(board), HasSubstr("needs 200 markers"));
  board = {.columns = 2};
  EXPECT_THAT(error_of(board), HasSubstr("2x7 squares"));
  board = {.square_mm = std::nan("")};
  EXPECT_THAT(error_of(board), HasSubstr("square of nan mm"));
}

/// Around every corner black and white squares take turns in the drawing.
TEST(Board, CornersLieWhereTheDrawingHasThem) {
  constexpr double kScale = 4;
  for (const Board& board : {Board{}, checkerboard()}) {
    const render::Picture sheet = draw_board(board, kScale);
    const double margin = margin_mm(board);
    const std::vector<Eigen::Vector3d> corners = corners_mm(board);
    ASSERT_EQ(corners.size(), static_cast<std::size_t>((board.columns - 1) * (board.rows - 1)));
    for (const Eigen::Vector3d& corner : corners) {
      const auto black = [&](double x, double y) {
        return is_black(sheet, kScale, corner.x() + margin + x, corner.y() + margin + y);
      };
      EXPECT_EQ(black(0.5, 0.5), black(-0.5, -0.5));
      EXPECT_EQ(black(-0.5, 0.5), black(0.5, -0.5));
      EXPECT_NE(black(0.5, 0.5), black(0.5, -0.5));
    }
  }
}

TEST(Board, PdfHasTheBoardsTrueSize) {
  const std::string pdf = board_pdf({});
  EXPECT_TRUE(pdf.starts_with("%PDF-1.4"));
  // 9 x 7 squares of 20 mm and a margin of 10 mm: 200 x 160 mm, in points.
  EXPECT_THAT(pdf, HasSubstr("/MediaBox [0 0 566.9291 453.5433]"));
  EXPECT_TRUE(pdf.ends_with("%%EOF\n"));
}

/// Mean and largest distance of detected corners from where the lens puts them.
struct Accuracy {
  std::size_t corners = 0;
  Eigen::Vector2d bias{0, 0};
  double rms_px = 0;
  double most_px = 0;
};

Accuracy accuracy_of(const Board& board, int pictures, const BoardPictureOptions& options = {}) {
  const capture::Rig rig = booth_rig(3);
  const BoardDetector detector(board);
  const std::vector<Eigen::Vector3d> corners = corners_mm(board);
  const capture::Lens& lens = rig.cameras[0].lens;
  const BoardCamera camera(board, lens);
  Random random(11, 0);
  Accuracy accuracy;
  const auto poses = held_board_poses(board, pictures, 5);
  for (const Eigen::Isometry3d& pose : poses) {
    const BoardView view = detector.detect(camera.take(pose, options, random));
    for (std::size_t i = 0; view.usable() && i < view.ids.size(); ++i) {
      const Eigen::Vector2d error =
          view.px[i] - *lens.project(pose * corners[static_cast<std::size_t>(view.ids[i])]);
      accuracy.bias += error;
      accuracy.rms_px += error.squaredNorm();
      accuracy.most_px = std::max(accuracy.most_px, error.norm());
      ++accuracy.corners;
    }
  }
  accuracy.bias /= static_cast<double>(accuracy.corners);
  accuracy.rms_px = std::sqrt(accuracy.rms_px / static_cast<double>(accuracy.corners));
  return accuracy;
}

TEST(BoardDetector, FindsCharucoCornersToAFewHundredthsOfAPixel) {
  const Accuracy found = accuracy_of({}, 8);
  std::printf("ChArUco: %zu corners, bias %.3f %.3f px, rms %.3f px, largest %.2f px\n", found.corners,
              found.bias.x(), found.bias.y(), found.rms_px, found.most_px);
  EXPECT_GT(found.corners, 150U);
  EXPECT_LT(found.rms_px, 0.03);
  EXPECT_LT(found.bias.norm(), 0.01);
  EXPECT_LT(found.most_px, 0.3);
}

TEST(BoardDetector, FindsCheckerboardCornersToAFewHundredthsOfAPixel) {
  const Accuracy found = accuracy_of(checkerboard(), 6);
  std::printf("Checkerboard: %zu corners, bias %.3f %.3f px, rms %.3f px, largest %.2f px\n", found.corners,
              found.bias.x(), found.bias.y(), found.rms_px, found.most_px);
  EXPECT_GT(found.corners, 150U);
  EXPECT_LT(found.rms_px, 0.03);
  EXPECT_LT(found.bias.norm(), 0.01);
  EXPECT_LT(found.most_px, 0.3);
}

/// Softer and noisier than the print is taken to be.
TEST(BoardDetector, BlurAndNoiseCostLittle) {
  const Accuracy found = accuracy_of({}, 8, {.noise = 6, .blur_px = 1});
  std::printf("ChArUco, blurred: %zu corners, bias %.3f %.3f px, rms %.3f px, largest %.2f px\n",
              found.corners, found.bias.x(), found.bias.y(), found.rms_px, found.most_px);
  EXPECT_GT(found.corners, 150U);
  EXPECT_LT(found.rms_px, 0.07);
  EXPECT_LT(found.bias.norm(), 0.02);
}

class Detection : public ::testing::Test {
 protected:
  Frame picture(const Board& board, const Eigen::Isometry3d& pose,
                const BoardPictureOptions& options = {}) const {
    // One camera a board for all cases: making one takes long.
    static std::map<std::string, BoardCamera> cameras;
    const std::string name = board.kind == BoardKind::Charuco ? board.dictionary : "checkerboard";
    const BoardCamera& camera = cameras.try_emplace(name, board, rig_.cameras[0].lens).first->second;
    Random random(1, 1);
    return camera.take(pose, options, random);
  }
  Eigen::Isometry3d middle(double x_mm = 0) const {
    return Eigen::Isometry3d(Eigen::AngleAxisd(0.52, Eigen::Vector3d::UnitY()) *
                             Eigen::Translation3d(x_mm - 90, -70, 0));
  }
  const capture::Rig rig_ = booth_rig(3);
  const BoardDetector detector_{Board{}};
};

TEST_F(Detection, ABoardPartlyOutOfViewIsUsedForWhatIsSeen) {
  const BoardView whole = detector_.detect(picture({}, middle()));
  EXPECT_TRUE(whole.usable()) << whole.problem;
  EXPECT_EQ(whole.ids.size(), 48U);
  const BoardView part = detector_.detect(picture({}, middle(250)));
  EXPECT_TRUE(part.usable()) << part.problem;
  EXPECT_LT(part.ids.size(), 48U);
  const BoardView little = detector_.detect(picture({}, middle(330)));
  EXPECT_FALSE(little.usable()) << little.ids.size();
  Board checkers = checkerboard();
  EXPECT_TRUE(BoardDetector(checkers).detect(picture(checkers, middle())).usable());
  EXPECT_THAT(BoardDetector(checkers).detect(picture(checkers, middle(260))).problem,
              HasSubstr("seen whole"));
}

TEST_F(Detection, SaysWhatIsWrongWithAPicture) {
  EXPECT_THAT(detector_.detect({}).problem, HasSubstr("no picture"));
  EXPECT_THAT(detector_.detect(render::to_frame(render::plain_picture(640, 480, {90, 90, 90}))).problem,
              HasSubstr("no marker"));
  EXPECT_THAT(detector_.detect(render::to_frame(render::plain_picture(20, 20, {90, 90, 90}))).problem,
              HasSubstr("too small"));
  EXPECT_THAT(detector_.detect(picture(checkerboard(), middle())).problem, HasSubstr("no marker"));
  const Board foreign{.columns = 9, .rows = 7, .dictionary = "6X6_250"};
  EXPECT_FALSE(detector_.detect(picture(foreign, middle())).usable());
  const BoardView blurred = detector_.detect(picture({}, middle(), {.blur_px = 2.2}));
  EXPECT_FALSE(blurred.usable());
  const BoardView sharp = detector_.detect(picture({}, middle()));
  EXPECT_GT(sharp.edge_width_px, 1);
  EXPECT_LT(sharp.edge_width_px, 3);
  Frame damaged = picture({}, middle());
  damaged.corrupt = true;
  EXPECT_THAT(detector_.detect(damaged).problem, HasSubstr("damaged"));
}

/// Numbers of corners do not depend on how the board is held.
TEST_F(Detection, ACheckerboardUpsideDownHasTheSameCorners) {
  const Board board = checkerboard();
  const BoardDetector detector(board);
  const std::vector<Eigen::Vector3d> corners = corners_mm(board);
  for (const double turn : {0.0, 1.6, 3.1, -1.5}) {
    const Eigen::Isometry3d pose(Eigen::AngleAxisd(0.52, Eigen::Vector3d::UnitY()) *
                                 Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()) *
                                 Eigen::Translation3d(-100, -70, 0));
    const BoardView view = detector.detect(picture(board, pose));
    ASSERT_TRUE(view.usable()) << turn << ": " << view.problem;
    for (std::size_t i = 0; i < view.ids.size(); ++i) {
      const auto at = rig_.cameras[0].lens.project(pose * corners[static_cast<std::size_t>(view.ids[i])]);
      EXPECT_LT((*at - view.px[i]).norm(), 0.3) << turn << ", corner " << i;
    }
  }
}

}  // namespace
}  // namespace facet::calibration
