#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "calibration/board.hpp"

namespace facet::calibration {

/// Chooses views for a calibration from a stream of them: the board held still, and elsewhere than in the
/// views that were kept before. One thread.
class ViewPicker {
 public:
  /// widths_px [camera_count] of the pictures.
  explicit ViewPicker(std::vector<int> widths_px) : widths_px_(std::move(widths_px)) {}

  enum class Verdict { Kept, NoBoard, Moving, SeenBefore };
  /// Looks at the next moment, seen [camera_count], and remembers it where it is kept.
  Verdict offer(const std::vector<BoardView>& seen);
  std::size_t kept() const { return kept_.size(); }

 private:
  std::vector<int> widths_px_;
  std::vector<BoardView> last_;
  std::vector<std::vector<BoardView>> kept_;
};

}  // namespace facet::calibration
