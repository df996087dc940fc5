#include "pipeline/calibrated_camera.hpp"

#include <fmt/format.h>

#include <optional>
#include <utility>

#include "capture/undistortion.hpp"
#include "facet/error.hpp"

namespace facet::pipeline {
namespace {

bool is_distorted(const capture::LensDistortion& lens) {
  return lens.k1 != 0 || lens.k2 != 0 || lens.p1 != 0 || lens.p2 != 0 || lens.k3 != 0;
}

class CalibratedCamera final : public Camera {
 public:
  CalibratedCamera(std::unique_ptr<Camera> camera, const capture::Lens& lens)
      : camera_(std::move(camera)), pinhole_(capture::pinhole_of(lens)) {
    if (is_distorted(lens.distortion)) {
      undistortion_.emplace(lens);
    }
  }

  CameraInfo info() const override {
    CameraInfo info = camera_->info();
    info.intrinsics = pinhole_;
    return info;
  }
  CameraStatus status() const override { return camera_->status(); }
  void start() override { camera_->start(); }
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    const CaptureOutcome outcome = camera_->next(out, timeout);
    if (outcome == CaptureOutcome::Delivered && undistortion_ && !out.empty()) {
      const Frame straight = undistortion_->apply(out);
      if (straight.empty()) {
        out.corrupt = true;  // of another size in the middle of a recording
      } else {
        out = straight;
      }
    }
    return outcome;
  }
  void restart(const std::string& why) override { camera_->restart(why); }
  void expect_frames(bool due) override { camera_->expect_frames(due); }
  void stop() override { camera_->stop(); }
  std::string last_error() const override { return camera_->last_error(); }

 private:
  std::unique_ptr<Camera> camera_;
  CameraIntrinsics pinhole_;
  std::optional<capture::Undistortion> undistortion_;
};

}  // namespace

std::unique_ptr<Camera> calibrated(std::unique_ptr<Camera> camera, const capture::RigCamera& known,
                                   const std::filesystem::path& rig_file) {
  capture::check_size(camera->info(), known, rig_file);
  return std::make_unique<CalibratedCamera>(std::move(camera), known.lens);
}

}  // namespace facet::pipeline
