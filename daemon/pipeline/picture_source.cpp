#include "pipeline/picture_source.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace facet::pipeline {
namespace {

class CamerasInStep final : public PictureSource {
 public:
  explicit CamerasInStep(std::vector<std::unique_ptr<Camera>> cameras) : cameras_(std::move(cameras)) {}

  std::vector<PictureCamera> cameras() const override {
    std::vector<PictureCamera> all;
    all.reserve(cameras_.size());
    for (const auto& camera : cameras_) {
      all.push_back({camera->info(), std::nullopt});
    }
    return all;
  }
  CameraStatus status() const override { return cameras_.front()->status(); }
  void start() override {
    for (const auto& camera : cameras_) {
      camera->start();
    }
  }
  CaptureOutcome next(FrameSet& out, std::chrono::milliseconds timeout) override;
  void stop() override {
    for (const auto& camera : cameras_) {
      camera->stop();
    }
  }
  std::string last_error() const override {
    return out_of_step_.empty() ? cameras_.front()->last_error() : out_of_step_;
  }

 private:
  std::vector<std::unique_ptr<Camera>> cameras_;
  std::vector<Frame> read_;  ///< of the moment that is being read, those of the first cameras
  std::string out_of_step_;
};

CaptureOutcome CamerasInStep::next(FrameSet& out, std::chrono::milliseconds timeout) {
  while (read_.size() < cameras_.size()) {
    Camera& camera = *cameras_[read_.size()];
    Frame frame;
    const CaptureOutcome outcome = camera.next(frame, timeout);
    const bool delivered = outcome == CaptureOutcome::Delivered;
    const bool leads = read_.empty();
    if (outcome == CaptureOutcome::Timeout || (leads && !delivered)) {
      return outcome;
    }
    if (!leads && delivered && frame.sequence < read_.front().sequence) {
      continue;
    }
    if (!leads && (!delivered || frame.sequence != read_.front().sequence)) {
      const std::string why = camera.last_error();
      out_of_step_ = fmt::format(
          "'{}' has no frame {}, which the first camera has{}: every camera needs a picture of every moment",
          camera.info().name, read_.front().sequence, why.empty() ? "" : " (" + why + ")");
      return CaptureOutcome::Failed;
    }
    read_.push_back(std::move(frame));
  }
  out = {};
  out.slot = read_.front().sequence;
  out.trigger_ns = read_.front().timestamp_ns;
  out.media_time_ns = read_.front().media_time_ns;
  out.frames = std::exchange(read_, {});
  return CaptureOutcome::Delivered;
}

}  // namespace

std::unique_ptr<PictureSource> one_camera(std::unique_ptr<Camera> camera) {
  std::vector<std::unique_ptr<Camera>> cameras;
  cameras.push_back(std::move(camera));
  return cameras_in_step(std::move(cameras));
}

std::unique_ptr<PictureSource> cameras_in_step(std::vector<std::unique_ptr<Camera>> cameras) {
  return std::make_unique<CamerasInStep>(std::move(cameras));
}

std::optional<std::size_t> place_in(const FrameSet& set, const std::string& camera) {
  if (set.camera_names == nullptr) {
    return std::nullopt;
  }
  const std::vector<std::string>& names = *set.camera_names;
  const auto found = std::find(names.begin(), names.end(), camera);
  return found == names.end() ? std::nullopt : std::optional(static_cast<std::size_t>(found - names.begin()));
}

FrameSet pictures_of(const FrameSet& set, const std::vector<PictureCamera>& cameras) {
  FrameSet out;
  out.slot = set.slot;
  out.trigger_ns = set.trigger_ns;
  out.media_time_ns = set.media_time_ns;
  out.skew_ns = set.skew_ns;
  out.frames.reserve(cameras.size());
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const std::optional<std::size_t> at = place_in(set, cameras[i].info.name);
    Frame& frame = out.frames.emplace_back();
    if (at && !set.frames[*at].empty()) {
      frame = set.frames[*at];
    } else {
      frame.width_px = cameras[i].info.width_px;
      frame.height_px = cameras[i].info.height_px;
      out.missing |= std::uint64_t{1} << i;
    }
    frame.sequence = set.slot;
    frame.timestamp_ns = set.trigger_ns;
    frame.media_time_ns = set.media_time_ns;
  }
  return out;
}

}  // namespace facet::pipeline
