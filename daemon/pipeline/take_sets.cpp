#include <fmt/format.h>
#include <fmt/ranges.h>

#include <utility>

#include "facet/error.hpp"
#include "pipeline/picture_source.hpp"
#include "take/reader.hpp"

namespace facet::pipeline {
namespace {

/// The sets of a take, from `first` up to but not including `end`, as the take counts its frames.
class TakeSets final : public PictureSource {
 public:
  TakeSets(std::unique_ptr<take::TakeReader> take, std::vector<PictureCamera> cameras, std::int64_t first,
           std::int64_t end)
      : take_(std::move(take)), cameras_(std::move(cameras)), next_(first), end_(end) {}

  std::vector<PictureCamera> cameras() const override { return cameras_; }
  CameraStatus status() const override { return {}; }
  void start() override {}
  CaptureOutcome next(FrameSet& out, std::chrono::milliseconds /*timeout*/) override {
    if (next_ == end_) {
      return CaptureOutcome::EndOfStream;
    }
    try {
      const auto frame = take_->frame(next_);
      FrameSet none;
      none.slot = frame->sequence;
      none.trigger_ns = frame->timestamp_ns;
      none.media_time_ns = frame->media_time_ns;
      out = pictures_of(frame->images != nullptr ? *frame->images : none, cameras_);
    } catch (const Error& error) {
      error_ = error.what();
      return CaptureOutcome::Failed;
    }
    ++next_;
    return CaptureOutcome::Delivered;
  }
  void stop() override {}
  std::string last_error() const override { return error_; }

 private:
  std::unique_ptr<take::TakeReader> take_;
  std::vector<PictureCamera> cameras_;
  std::int64_t next_;
  std::int64_t end_;
  std::string error_;
};

/// Sizes of the cameras' pictures, from the first set that has each.
void find_sizes(take::TakeReader& take, std::int64_t first, std::int64_t end,
                std::vector<PictureCamera>& cameras) {
  std::size_t found = 0;
  for (std::int64_t i = first; i < end && found < cameras.size(); ++i) {
    const auto frame = take.frame(i, take::Pictures::Described);
    if (frame->images == nullptr) {
      continue;
    }
    for (PictureCamera& camera : cameras) {
      CameraInfo& info = camera.info;
      const std::optional<std::size_t> at = place_in(*frame->images, info.name);
      if (!at) {
        throw Error(ErrorKind::Usage,
                    fmt::format("'{}' has no pictures of a camera '{}'; it has {}", take.info().file.string(),
                                info.name, fmt::join(*frame->images->camera_names, ", ")));
      }
      if (info.width_px == 0 && frame->images->frames[*at].width_px > 0) {
        info.width_px = frame->images->frames[*at].width_px;
        info.height_px = frame->images->frames[*at].height_px;
        ++found;
      }
    }
  }
  for (const PictureCamera& camera : cameras) {
    if (camera.info.width_px == 0) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("'{}' has no picture of camera '{}' in the range asked for: record in mode "
                              "\"frames\", or choose another range",
                              take.info().file.string(), camera.info.name));
    }
  }
}

}  // namespace

std::unique_ptr<PictureSource> take_sets(const std::filesystem::path& file,
                                         const std::vector<std::string>& names, const FrameRange& slots) {
  auto take = std::make_unique<take::TakeReader>(file);
  std::int64_t first = 0;
  while (first < take->frame_count() && take->entry(first).sequence < slots.first) {
    ++first;
  }
  std::int64_t end = first;
  while (end < take->frame_count() && take->entry(end).sequence < slots.end) {
    ++end;
  }
  std::vector<PictureCamera> cameras(names.size());
  for (std::size_t i = 0; i < names.size(); ++i) {
    cameras[i].info.name = names[i];
    cameras[i].info.frame_count = static_cast<std::uint64_t>(end - first);
  }
  find_sizes(*take, first, end, cameras);
  return std::make_unique<TakeSets>(std::move(take), std::move(cameras), first, end);
}

}  // namespace facet::pipeline
