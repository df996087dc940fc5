#include "pipeline/calibrated_camera.hpp"

#include <fmt/format.h>

#include <optional>
#include <utility>

#include "facet/error.hpp"
#include "pipeline/undistortion.hpp"

namespace facet::pipeline {
namespace {

bool is_distorted(const capture::LensDistortion& lens) {
  return lens.k1 != 0 || lens.k2 != 0 || lens.p1 != 0 || lens.p2 != 0 || lens.k3 != 0;
}

class CalibratedCamera final : public Camera {
 public:
  CalibratedCamera(std::unique_ptr<Camera> camera, const capture::Lens& lens)
      : camera_(std::move(camera)), pinhole_(pinhole_of(lens)) {
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
  std::optional<Undistortion> undistortion_;
};

}  // namespace

CameraIntrinsics pinhole_of(const capture::Lens& lens) {
  return {static_cast<float>(lens.fx_px),
          static_cast<float>(lens.fy_px),
          static_cast<float>(lens.cx_px),
          static_cast<float>(lens.cy_px),
          lens.width_px,
          lens.height_px};
}

const capture::RigCamera& camera_named(const capture::Rig& rig, const std::filesystem::path& rig_file,
                                       const std::string& name, const std::string& advice) {
  std::string known;
  for (const capture::RigCamera& camera : rig.cameras) {
    if (camera.name == name) {
      return camera;
    }
    known += (known.empty() ? "" : ", ") + camera.name;
  }
  throw Error(ErrorKind::Usage, fmt::format("the rig file '{}' has no camera '{}'; it has {}: {}",
                                            rig_file.string(), name, known, advice));
}

void check_size(const CameraInfo& camera, const capture::RigCamera& known,
                const std::filesystem::path& rig_file) {
  const capture::Lens& lens = known.lens;
  if (camera.width_px != lens.width_px || camera.height_px != lens.height_px) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("camera '{}' gives pictures of {} x {} px, the rig file '{}' has it calibrated at {} x "
                    "{}: give pictures of that size, or calibrate again",
                    known.name, camera.width_px, camera.height_px, rig_file.string(), lens.width_px,
                    lens.height_px));
  }
}

std::unique_ptr<Camera> calibrated(std::unique_ptr<Camera> camera, const capture::RigCamera& known,
                                   const std::filesystem::path& rig_file) {
  check_size(camera->info(), known, rig_file);
  return std::make_unique<CalibratedCamera>(std::move(camera), known.lens);
}

}  // namespace facet::pipeline
