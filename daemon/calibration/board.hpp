#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "facet/frame.hpp"
#include "render/renderer.hpp"

namespace facet::calibration {

enum class BoardKind { Charuco, Checkerboard };

/// A flat calibration board. Board frame: origin at the outer corner of the top left square, x right, y down,
/// z into the board, mm.
struct Board {
  BoardKind kind = BoardKind::Charuco;
  int columns = 9;  ///< squares
  int rows = 7;
  double square_mm = 20;
  double marker_mm = 15;               ///< ChArUco only; less than the square
  std::string dictionary = "4X4_250";  ///< ChArUco only; OpenCV's name without "DICT_"
};

/// Names that Board::dictionary may have.
std::vector<std::string> dictionary_names();

/// Throws Error(Usage) that says what is wrong with a board: too few squares, more markers than the
/// dictionary has, a checkerboard that looks the same upside down.
void check(const Board& board);

/// The inner corners, [(columns - 1) * (rows - 1)], z = 0; their indices are the ids of detected corners.
std::vector<Eigen::Vector3d> corners_mm(const Board& board);

/// A black rectangle of the board, board frame.
struct Rectangle {
  double x_mm = 0;
  double y_mm = 0;
  double width_mm = 0;
  double height_mm = 0;
};
std::vector<Rectangle> black_parts(const Board& board);

/// Width of the white that is printed around the board: half a square.
double margin_mm(const Board& board);

/// The board with its margin, antialiased. Pixel (0, 0) is centred half a pixel inside the sheet's corner.
/// Throws Error(Usage) beyond 20,000 px.
render::Picture draw_board(const Board& board, double px_per_mm);
/// The same as a page of the board's true size, in vectors.
std::string board_pdf(const Board& board);

/// What is seen of a board in one picture.
struct BoardView {
  std::vector<int> ids;             ///< [corner_count] indices into corners_mm, ascending
  std::vector<Eigen::Vector2d> px;  ///< [corner_count]
  double edge_width_px = 0;         ///< of the board's edges, black to white; 1 to 2 where it is sharp
  std::string problem;              ///< why it can't be used; empty where it can
  bool usable() const { return problem.empty(); }
};

struct DetectorOptions {
  int least_corners = 12;         ///< views with fewer are of no use
  double most_edge_width_px = 5;  ///< views that are more blurred are of no use
};

/// Finds a board in pictures, its corners to a few hundredths of a pixel. Any thread once built.
class BoardDetector {
 public:
  /// Throws Error(Usage) as check() does.
  explicit BoardDetector(const Board& board, const DetectorOptions& options = {});
  ~BoardDetector();
  BoardDetector(const BoardDetector&) = delete;
  BoardDetector& operator=(const BoardDetector&) = delete;

  /// picture: any size from 64 px; a picture without a board is a view with a problem.
  BoardView detect(const Frame& picture) const;
  const Board& board() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::calibration
