#include <fmt/format.h>

#include <optional>
#include <utility>

#include "capture/undistortion.hpp"
#include "facet/error.hpp"
#include "pipeline/picture_source.hpp"

namespace facet::pipeline {
namespace {

bool is_distorted(const capture::LensDistortion& lens) {
  return lens.k1 != 0 || lens.k2 != 0 || lens.p1 != 0 || lens.p2 != 0 || lens.k3 != 0;
}

class CalibratedPictures final : public PictureSource {
 public:
  CalibratedPictures(std::unique_ptr<PictureSource> pictures, const std::vector<capture::RigCamera>& known)
      : pictures_(std::move(pictures)) {
    for (const capture::RigCamera& camera : known) {
      lenses_.push_back(camera.lens);
      auto& undistortion = undistortions_.emplace_back();
      if (is_distorted(camera.lens.distortion)) {
        undistortion.emplace(camera.lens);
      }
    }
  }

  std::vector<PictureCamera> cameras() const override {
    std::vector<PictureCamera> cameras = pictures_->cameras();
    const Eigen::Isometry3d rig_from_reference = lenses_.front().camera_from_rig.inverse();
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      cameras[i].info.intrinsics = capture::pinhole_of(lenses_[i]);
      cameras[i].camera_from_reference =
          i == 0 ? Eigen::Isometry3d::Identity() : lenses_[i].camera_from_rig * rig_from_reference;
    }
    return cameras;
  }
  CameraStatus status() const override { return pictures_->status(); }
  void start() override { pictures_->start(); }
  CaptureOutcome next(FrameSet& out, std::chrono::milliseconds timeout) override {
    const CaptureOutcome outcome = pictures_->next(out, timeout);
    if (outcome == CaptureOutcome::Delivered) {
      for (std::size_t i = 0; i < undistortions_.size(); ++i) {
        straighten(out.frames[i], undistortions_[i]);
      }
    }
    return outcome;
  }
  void stop() override { pictures_->stop(); }
  std::string last_error() const override { return pictures_->last_error(); }

 private:
  static void straighten(Frame& frame, std::optional<capture::Undistortion>& undistortion) {
    if (!undistortion || frame.empty()) {
      return;
    }
    const Frame straight = undistortion->apply(frame);
    if (straight.empty()) {
      frame.corrupt = true;  // of another size in the middle of a recording
    } else {
      frame = straight;
    }
  }

  std::unique_ptr<PictureSource> pictures_;
  std::vector<capture::Lens> lenses_;
  std::vector<std::optional<capture::Undistortion>> undistortions_;  ///< nothing where there is no distortion
};

}  // namespace

std::unique_ptr<PictureSource> calibrated(std::unique_ptr<PictureSource> pictures,
                                          const std::vector<capture::RigCamera>& known,
                                          const std::filesystem::path& rig_file) {
  const std::vector<PictureCamera> cameras = pictures->cameras();
  const std::optional<std::uint64_t> wanted = cameras.front().info.frame_count;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    capture::check_size(cameras[i].info, known[i], rig_file);
    const std::optional<std::uint64_t> there = cameras[i].info.frame_count;
    if (wanted && there && *wanted != *there) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("camera '{}' has {} frames, camera '{}' {}: frame n of each must be of the same "
                      "moment; cut the videos to the frames that they share",
                      known[i].name, *there, known.front().name, *wanted));
    }
  }
  return std::make_unique<CalibratedPictures>(std::move(pictures), known);
}

}  // namespace facet::pipeline
