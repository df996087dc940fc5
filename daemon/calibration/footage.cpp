#include "calibration/footage.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <system_error>
#include <utility>

#include "facet/error.hpp"

namespace facet::calibration {
namespace {

bool is_colour(const Frame& frame) {
  for (int y = 0; y < frame.height_px; ++y) {
    const std::uint8_t* pixel = frame.row(y);
    for (int x = 0; x < frame.width_px; ++x, pixel += 4) {
      // JPEG makes a monochrome picture's channels differ by one here and there.
      if (std::abs(pixel[0] - pixel[1]) > 4 || std::abs(pixel[2] - pixel[1]) > 4) {
        return true;
      }
    }
  }
  return false;
}

}  // namespace

void admit(CalibrationCamera& camera, const Frame& frame, const std::string& where) {
  if (camera.width_px == 0) {
    camera.width_px = frame.width_px;
    camera.height_px = frame.height_px;
  }
  if (camera.width_px != frame.width_px || camera.height_px != frame.height_px) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: has {}x{} px, earlier pictures of camera '{}' have {}x{}", where,
                            frame.width_px, frame.height_px, camera.name, camera.width_px, camera.height_px));
  }
  camera.colour = camera.colour || is_colour(frame);
}

bool has_all_pictures(const FrameSet& set) {
  return !set.frames.empty() &&
         std::none_of(set.frames.begin(), set.frames.end(), [](const Frame& frame) { return frame.empty(); });
}

ViewPicker::Verdict SetCollector::offer(const FrameSet& set) {
  begin(set);
  CalibrationView view{fmt::format("slot {}", set.slot), {}};
  for (const Frame& frame : set.frames) {
    view.seen.push_back(detector_.detect(frame));
  }
  const ViewPicker::Verdict verdict = picker_->offer(view.seen);
  if (verdict == ViewPicker::Verdict::Kept) {
    for (std::size_t camera = 0; camera < set.frames.size(); ++camera) {
      keep(set, camera, view.seen[camera]);
    }
    footage_.views.push_back(std::move(view));
  }
  return verdict;
}

void SetCollector::begin(const FrameSet& set) {
  if (footage_.cameras.empty()) {
    std::vector<int> widths;
    for (std::size_t camera = 0; camera < set.frames.size(); ++camera) {
      const Frame& frame = set.frames[camera];
      footage_.cameras.push_back({set.camera_names->at(camera), frame.width_px, frame.height_px, false});
      coverage_.emplace_back(frame.width_px, frame.height_px);
      widths.push_back(frame.width_px);
    }
    picker_ = std::make_unique<ViewPicker>(widths);
  }
  if (set.frames.size() != footage_.cameras.size()) {
    throw Error(ErrorKind::UnreadableInput, "the cameras changed while views were taken");
  }
}

void SetCollector::keep(const FrameSet& set, std::size_t camera, const BoardView& seen) {
  const Frame& frame = set.frames[camera];
  if (frame.empty()) {
    return;
  }
  admit(footage_.cameras[camera], frame, fmt::format("slot {}", set.slot));
  if (seen.usable()) {
    coverage_[camera].add(seen);
  }
  if (!save_.empty()) {
    const std::filesystem::path folder = save_ / footage_.cameras[camera].name;
    std::error_code ignored;  // write_png says what is wrong
    std::filesystem::create_directories(folder, ignored);
    render::write_png(render::to_picture(frame), folder / fmt::format("{:08}.png", set.slot));
  }
}

}  // namespace facet::calibration
