#include "take_frames.hpp"

#include <fmt/format.h>

#include "facet/error.hpp"
#include "pipeline/frame_range.hpp"
#include "tell.hpp"

namespace facet::tools {

std::vector<std::int64_t> frames_in_range(take::TakeReader& take, const std::string& text) {
  const pipeline::FrameRange range = pipeline::parse_frame_range(text);
  std::vector<std::int64_t> indices;
  for (std::int64_t index = 0; index < take.frame_count(); ++index) {
    const std::uint64_t sequence = take.entry(index).sequence;
    if (sequence >= range.first && sequence < range.end) {
      indices.push_back(index);
    }
  }
  if (!indices.empty()) {
    return indices;
  }
  const std::string file = take.info().file.string();
  if (take.frame_count() == 0) {
    throw Error(ErrorKind::Usage, fmt::format("take '{}' has no frames: nothing was recorded into it", file));
  }
  throw Error(ErrorKind::Usage,
              fmt::format("--frames {} selects nothing: take '{}' has the source's frames {} to {}", text,
                          file, take.entry(0).sequence, take.entry(take.frame_count() - 1).sequence));
}

exports::Timeline timeline_of(take::TakeReader& take, const std::vector<std::int64_t>& indices) {
  std::vector<take::FrameEntry> entries;
  entries.reserve(indices.size());
  for (const std::int64_t index : indices) {
    entries.push_back(take.entry(index));
  }
  return exports::make_timeline(entries, take.info().file);
}

void warn_of_varying_rate(const exports::Timeline& timeline, const std::string& output) {
  if (!timeline.times_s.empty()) {
    tell(stderr,
         "facet: warning: the source's rate varies: '{}', played at its average of {:.6g} Hz, is up to "
         "{:.3f} s beside the source (--format jsonl has every frame's time)\n",
         output, timeline.rate_hz, timeline.deviation_s);
  }
}

std::vector<std::int64_t> slots_of(take::TakeReader& take, const pipeline::FrameRange& range) {
  std::vector<std::int64_t> found;
  for (std::int64_t i = 0; i < take.frame_count(); ++i) {
    const std::uint64_t slot = take.entry(i).sequence;
    if (slot >= range.first && slot < range.end) {
      found.push_back(i);
    }
  }
  if (found.empty()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("'{}' has no slot in the range asked for: choose another with --frames",
                            take.info().file.string()));
  }
  if (take.frame(found.front())->images == nullptr) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("'{}' holds no pictures: record in mode \"booth\" (record = \"pictures\") or "
                            "\"frames\"",
                            take.info().file.string()));
  }
  return found;
}

}  // namespace facet::tools
