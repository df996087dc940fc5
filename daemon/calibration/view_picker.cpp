#include "calibration/view_picker.hpp"

#include <algorithm>
#include <limits>
#include <utility>

namespace facet::calibration {
namespace {

/// Mean way of the corners that both views have, px; infinite where they share none.
double way_px(const BoardView& from, const BoardView& to) {
  double sum = 0;
  int count = 0;
  for (std::size_t i = 0; i < from.ids.size(); ++i) {
    const auto at = std::lower_bound(to.ids.begin(), to.ids.end(), from.ids[i]);
    if (at != to.ids.end() && *at == from.ids[i]) {
      sum += (to.px[static_cast<std::size_t>(at - to.ids.begin())] - from.px[i]).norm();
      ++count;
    }
  }
  return count > 0 ? sum / count : std::numeric_limits<double>::infinity();
}

}  // namespace

ViewPicker::Verdict ViewPicker::offer(const std::vector<BoardView>& seen) {
  // As parts of the picture's width: moving more from one picture to the next blurs; less is not another
  // view.
  constexpr double kStill = 0.003;
  constexpr double kElsewhere = 0.06;
  const auto any = [&](const auto& says) {
    for (std::size_t camera = 0; camera < seen.size(); ++camera) {
      if (seen[camera].usable() && says(camera)) {
        return true;
      }
    }
    return false;
  };
  const std::vector<BoardView> last = std::exchange(last_, seen);
  if (!any([](std::size_t) { return true; })) {
    return Verdict::NoBoard;
  }
  // It rests where a camera that sees it saw it in the same place before, and none saw it elsewhere.
  const auto saw_before = [&](std::size_t camera) { return !last.empty() && last[camera].usable(); };
  const bool rests =
      any(saw_before) && !any([&](std::size_t camera) {
        return saw_before(camera) && way_px(last[camera], seen[camera]) > kStill * widths_px_[camera];
      });
  if (!rests) {
    return Verdict::Moving;
  }
  for (const std::vector<BoardView>& before : kept_) {
    const bool elsewhere = any([&](std::size_t camera) {
      return !before[camera].usable() ||
             way_px(before[camera], seen[camera]) > kElsewhere * widths_px_[camera];
    });
    if (!elsewhere) {
      return Verdict::SeenBefore;
    }
  }
  kept_.push_back(seen);
  return Verdict::Kept;
}

}  // namespace facet::calibration
