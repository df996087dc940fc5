#include "pipeline/set_cameras.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <optional>
#include <utility>

#include "facet/error.hpp"
#include "take/reader.hpp"

namespace facet::pipeline {
namespace {

/// Where a camera's picture is among a set's.
std::optional<std::size_t> place_in(const FrameSet& set, const std::string& camera) {
  const std::vector<std::string>& names = *set.camera_names;
  const auto found = std::find(names.begin(), names.end(), camera);
  return found == names.end() ? std::nullopt : std::optional(static_cast<std::size_t>(found - names.begin()));
}

/// The set that all cameras look at.
struct Shared {
  std::shared_ptr<SetSource> source;
  std::shared_ptr<const FrameSet> set;
};

class SetCamera final : public Camera {
 public:
  SetCamera(std::shared_ptr<Shared> shared, CameraInfo info, bool leads)
      : shared_(std::move(shared)), info_(std::move(info)), leads_(leads) {}

  CameraInfo info() const override { return info_; }
  CameraStatus status() const override { return {}; }
  void start() override {}
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    if (leads_) {
      const CaptureOutcome outcome = shared_->source->next(shared_->set, timeout);
      if (outcome != CaptureOutcome::Delivered) {
        return outcome;
      }
    }
    out = picture();
    out.sequence = shared_->set->slot;
    out.timestamp_ns = shared_->set->trigger_ns;
    out.media_time_ns = shared_->set->media_time_ns;
    return CaptureOutcome::Delivered;
  }
  void stop() override {}
  std::string last_error() const override { return shared_->source->last_error(); }

 private:
  Frame picture() const {
    const FrameSet& set = *shared_->set;
    const std::optional<std::size_t> at =
        set.camera_names != nullptr ? place_in(set, info_.name) : std::nullopt;
    if (at && !set.frames[*at].empty()) {
      return set.frames[*at];
    }
    Frame none;
    none.width_px = info_.width_px;
    none.height_px = info_.height_px;
    return none;
  }

  std::shared_ptr<Shared> shared_;
  CameraInfo info_;
  bool leads_;
};

/// A frame of a take that holds no pictures is a set that lacks them all.
std::shared_ptr<const FrameSet> without_pictures(const mesh::MeshFrame& frame) {
  auto set = std::make_shared<FrameSet>();
  set->slot = frame.sequence;
  set->trigger_ns = frame.timestamp_ns;
  set->media_time_ns = frame.media_time_ns;
  return set;
}

/// The sets of a take, from `first` up to but not including `end`, as the take counts its frames.
class TakeSets final : public SetSource {
 public:
  TakeSets(std::unique_ptr<take::TakeReader> take, std::int64_t first, std::int64_t end)
      : take_(std::move(take)), next_(first), end_(end) {}

  CaptureOutcome next(std::shared_ptr<const FrameSet>& out, std::chrono::milliseconds /*timeout*/) override {
    if (next_ == end_) {
      return CaptureOutcome::EndOfStream;
    }
    try {
      const auto frame = take_->frame(next_);
      out = frame->images != nullptr ? frame->images : without_pictures(*frame);
    } catch (const Error& error) {
      error_ = error.what();
      return CaptureOutcome::Failed;
    }
    ++next_;
    return CaptureOutcome::Delivered;
  }
  std::string last_error() const override { return error_; }

 private:
  std::unique_ptr<take::TakeReader> take_;
  std::int64_t next_;
  std::int64_t end_;
  std::string error_;
};

/// Sizes of the cameras' pictures, from the first set that has each.
void find_sizes(take::TakeReader& take, std::int64_t first, std::int64_t end,
                std::vector<CameraInfo>& cameras) {
  std::size_t found = 0;
  for (std::int64_t i = first; i < end && found < cameras.size(); ++i) {
    const auto frame = take.frame(i, take::Pictures::Described);
    if (frame->images == nullptr) {
      continue;
    }
    for (CameraInfo& camera : cameras) {
      const std::optional<std::size_t> at = place_in(*frame->images, camera.name);
      if (!at) {
        throw Error(ErrorKind::Usage,
                    fmt::format("'{}' has no pictures of a camera '{}'; it has {}", take.info().file.string(),
                                camera.name, fmt::join(*frame->images->camera_names, ", ")));
      }
      if (camera.width_px == 0 && frame->images->frames[*at].width_px > 0) {
        camera.width_px = frame->images->frames[*at].width_px;
        camera.height_px = frame->images->frames[*at].height_px;
        ++found;
      }
    }
  }
  for (const CameraInfo& camera : cameras) {
    if (camera.width_px == 0) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("'{}' has no picture of camera '{}' in the range asked for: record in mode "
                              "\"frames\", or choose another range",
                              take.info().file.string(), camera.name));
    }
  }
}

}  // namespace

std::vector<std::unique_ptr<Camera>> set_cameras(std::shared_ptr<SetSource> source,
                                                 const std::vector<CameraInfo>& cameras) {
  const auto shared = std::make_shared<Shared>();
  shared->source = std::move(source);
  std::vector<std::unique_ptr<Camera>> all;
  all.reserve(cameras.size());
  for (const CameraInfo& camera : cameras) {
    all.push_back(std::make_unique<SetCamera>(shared, camera, all.empty()));
  }
  return all;
}

std::vector<std::unique_ptr<Camera>> take_cameras(const std::filesystem::path& file,
                                                  const std::vector<std::string>& names,
                                                  const FrameRange& slots) {
  auto take = std::make_unique<take::TakeReader>(file);
  std::int64_t first = 0;
  while (first < take->frame_count() && take->entry(first).sequence < slots.first) {
    ++first;
  }
  std::int64_t end = first;
  while (end < take->frame_count() && take->entry(end).sequence < slots.end) {
    ++end;
  }
  std::vector<CameraInfo> cameras(names.size());
  for (std::size_t i = 0; i < names.size(); ++i) {
    cameras[i].name = names[i];
    cameras[i].frame_count = static_cast<std::uint64_t>(end - first);
  }
  find_sizes(*take, first, end, cameras);
  return set_cameras(std::make_shared<TakeSets>(std::move(take), first, end), cameras);
}

}  // namespace facet::pipeline
