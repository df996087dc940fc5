#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "calibration/board.hpp"
#include "calibration/calibrator.hpp"
#include "calibration/view_picker.hpp"
#include "facet/frame_set.hpp"

namespace facet::calibration {

/// What calibrate() works on.
struct Footage {
  std::vector<CalibrationCamera> cameras;
  std::vector<CalibrationView> views;
};

/// Takes a picture's size and colour into account; `where` names it in the error. Throws
/// Error(UnreadableInput) where earlier ones of this camera have another size.
void admit(CalibrationCamera& camera, const Frame& frame, const std::string& where);

/// Whether every camera's picture is there: the first set must tell their sizes.
bool has_all_pictures(const FrameSet& set);

/// Frame sets as they come, from a take or a daemon, of which some are kept. One thread.
class SetCollector {
 public:
  /// detector  stays while this does
  /// save      folder of a folder for each camera, where the pictures of kept sets go; empty: nowhere
  SetCollector(const BoardDetector& detector, std::filesystem::path save)
      : detector_(detector), save_(std::move(save)) {}

  /// The first one has all pictures. Throws Error(UnreadableInput) where the cameras are others than before.
  ViewPicker::Verdict offer(const FrameSet& set);

  const std::vector<Coverage>& coverage() const { return coverage_; }
  Footage& footage() { return footage_; }
  std::size_t kept() const { return footage_.views.size(); }

 private:
  void begin(const FrameSet& set);
  void keep(const FrameSet& set, std::size_t camera, const BoardView& seen);

  const BoardDetector& detector_;
  std::filesystem::path save_;
  Footage footage_;
  std::vector<Coverage> coverage_;
  std::unique_ptr<ViewPicker> picker_;
};

}  // namespace facet::calibration
