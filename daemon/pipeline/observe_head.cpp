#include "pipeline/observe_head.hpp"

#include <chrono>

#include "facet/error.hpp"

namespace facet::pipeline {

ObservedHead observe_head(ShadingParts& parts, const FrameRange& frames,
                          const std::optional<FrameRange>& burst,
                          const std::function<bool(std::uint64_t done)>& go_on) {
  ObservedHead out{person::KeyframeCollector(*parts.model)};
  parts.coarse->prepare([&] { return go_on(0); });
  parts.pictures->start();
  FrameSet set;
  while (go_on(out.frames)) {
    const CaptureOutcome outcome = parts.pictures->next(set, std::chrono::milliseconds(100));
    if (outcome == CaptureOutcome::Timeout ||
        (outcome == CaptureOutcome::Delivered && set.slot < frames.first)) {
      continue;
    }
    if (outcome == CaptureOutcome::Failed) {
      throw Error(ErrorKind::UnreadableInput, parts.pictures->last_error());
    }
    if (outcome == CaptureOutcome::EndOfStream || set.slot >= frames.end) {
      break;
    }
    const track::TrackResult& tracked = parts.coarse->process(set.frames);
    if (burst && set.slot >= burst->first && set.slot < burst->end) {
      out.keyframes.offer_lit(tracked, set.frames.front());
    } else {
      out.keyframes.offer(tracked, set.frames.front());
    }
    ++out.frames;
    out.mesh_frames += tracked.has_mesh ? 1 : 0;
  }
  parts.pictures->stop();
  return out;
}

}  // namespace facet::pipeline
