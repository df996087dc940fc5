#include "pipeline/stages.hpp"

#include <fmt/format.h>

#include <chrono>
#include <optional>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "pipeline/calibrated_camera.hpp"

namespace facet::pipeline {
namespace {

/// Frames of a recording that are looked at ahead for the subject: beyond these it is estimated on the way.
constexpr std::uint64_t kMostFramesAhead = 3000;

/// The cameras of a configuration.
struct Cameras {
  std::unique_ptr<Camera> first;
  std::vector<FurtherCamera> further;

  void start() {
    first->start();
    for (FurtherCamera& one : further) {
      one.camera->start();
    }
  }
};

using OpenCameras = std::function<Cameras()>;

/// Takes the lenses' distortion out of the pictures, and sees that the cameras go together.
Cameras in_step(std::vector<CalibratedView> views) {
  Cameras cameras;
  const capture::RigCamera& reference = views.front().camera;
  const Eigen::Isometry3d rig_from_reference = reference.lens.camera_from_rig.inverse();
  for (CalibratedView& view : views) {
    auto camera = calibrated(std::move(view.source), view.camera, view.rig_file);
    if (cameras.first == nullptr) {
      cameras.first = std::move(camera);
      continue;
    }
    const auto wanted = cameras.first->info().frame_count;
    const auto there = camera->info().frame_count;
    if (wanted && there && *wanted != *there) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("camera '{}' has {} frames, camera '{}' {}: frame n of each must be of the same "
                      "moment; cut the videos to the frames that they share",
                      view.camera.name, *there, reference.name, *wanted));
    }
    const capture::Lens& lens = view.camera.lens;
    cameras.further.push_back(
        {std::move(camera), {capture::pinhole_of(lens), lens.camera_from_rig * rig_from_reference}});
  }
  return cameras;
}

std::vector<CalibratedView> open_videos(const std::vector<ViewConfig>& configs) {
  std::vector<CalibratedView> views;
  views.reserve(configs.size());
  for (const ViewConfig& view : configs) {
    views.push_back({view.camera, view.rig_file, camera::open_camera(view.source)});
  }
  return views;
}

class TrackerStage final : public CoarseStage {
 public:
  /// open: a recorded source once more, to look ahead; empty for others.
  TrackerStage(std::shared_ptr<const face::FaceModel> model, const MonocularConfig& config, OpenCameras open)
      : model_(std::move(model)), config_(config), open_(std::move(open)), tracker_(make_tracker()) {}

  void prepare(const std::function<bool()>& go_on) override {
    if (!open_) {
      return;
    }
    Cameras cameras = open_();
    cameras.start();
    const auto ahead = make_tracker();
    Frame frame;
    std::vector<Frame> views;
    std::string error;
    for (std::uint64_t seen = 0; seen < kMostFramesAhead && !ahead->person() && go_on();) {
      const CaptureOutcome outcome = cameras.first->next(frame, std::chrono::milliseconds(100));
      if (outcome == CaptureOutcome::Timeout) {
        continue;
      }
      if (outcome != CaptureOutcome::Delivered || frame.sequence >= config_.frames.end ||
          !read_in_step(cameras.further, frame.sequence, views, go_on, error)) {
        break;
      }
      if (frame.sequence >= config_.frames.first) {
        views.insert(views.begin(), frame);
        ahead->process(views);
        ++seen;
      }
    }
    if (!go_on()) {
      return;  // the work of a second, for nobody
    }
    ahead->settle_subject();
    if (const std::optional<track::Person> subject = ahead->person()) {
      tracker_->adopt(*subject, frame.width_px, frame.height_px);
    }
  }

  const track::TrackResult& process(std::span<const Frame> views) override {
    return tracker_->process(views);
  }
  void reset_identity() override { tracker_->reset_identity(); }

 private:
  std::unique_ptr<track::Tracker> make_tracker() const {
    return std::make_unique<track::Tracker>(*model_, config_.tracker);
  }

  std::shared_ptr<const face::FaceModel> model_;
  MonocularConfig config_;
  OpenCameras open_;
  std::unique_ptr<track::Tracker> tracker_;
};

std::shared_ptr<const face::FaceModel> load_model(const MonocularConfig& config) {
  auto model = std::make_shared<const face::FaceModel>(face::FaceModel::load(config.model_file));
  // A control mesh that can't be subdivided must be found now, not with the first face.
  mesh::HierarchyOptions coarse_only;
  coarse_only.max_levels = 1;
  const auto count = static_cast<std::size_t>(model->vertex_count());
  try {
    mesh::build_hierarchy(model->control, mesh::TextureCoordinates::Zero(2, model->vertex_count()),
                          std::vector<std::uint8_t>(count, 0), coarse_only);
  } catch (const Error& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: the model's mesh can't be used: {}",
                                                        config.model_file.string(), error.what()));
  }
  return model;
}

}  // namespace

track::TrackerConfig tracker_config(const MonocularConfig& config, const CameraInfo& source) {
  track::TrackerConfig tracker = config.tracker;
  if (!tracker.intrinsics) {
    tracker.intrinsics = source.intrinsics;
  }
  return tracker;
}

namespace {

Stages open_with(const MonocularConfig& given, const OpenCameras& open) {
  Stages stages;
  // Cheap and likely mistakes first.
  Cameras cameras = open();
  stages.camera = std::move(cameras.first);
  stages.further_cameras = std::move(cameras.further);
  MonocularConfig config = given;
  config.tracker = tracker_config(config, stages.camera->info());
  for (const FurtherCamera& one : stages.further_cameras) {
    config.tracker.further_views.push_back(one.view);
  }
  stages.model = load_model(config);
  const bool recorded = !stages.camera->info().live && !config.source.loop;
  stages.coarse = std::make_unique<TrackerStage>(stages.model, config, recorded ? open : OpenCameras());
  if (config.gpu_device != kNoDevice) {
    stages.open_refiner = refine::refiner_opener(config.gpu_device, config.refiner);
    stages.refiner = stages.open_refiner();
  }
  return stages;
}

}  // namespace

std::vector<CalibratedView> calibrated_views(const std::vector<capture::RigCamera>& known,
                                             const std::filesystem::path& rig_file,
                                             std::vector<std::unique_ptr<Camera>> cameras) {
  std::vector<CalibratedView> views;
  views.reserve(known.size());
  for (std::size_t i = 0; i < known.size(); ++i) {
    views.push_back({known[i], rig_file, std::move(cameras[i])});
  }
  return views;
}

bool read_in_step(std::span<FurtherCamera> cameras, std::uint64_t sequence, std::vector<Frame>& out,
                  const std::function<bool()>& go_on, std::string& error) {
  out.clear();
  for (FurtherCamera& one : cameras) {
    for (;;) {
      Frame frame;
      const CaptureOutcome outcome = one.camera->next(frame, std::chrono::milliseconds(100));
      if (outcome == CaptureOutcome::Timeout ||
          (outcome == CaptureOutcome::Delivered && frame.sequence < sequence)) {
        if (!go_on()) {
          return false;
        }
        continue;
      }
      if (outcome != CaptureOutcome::Delivered || frame.sequence != sequence) {
        const std::string why = one.camera->last_error();
        error = fmt::format(
            "'{}' has no frame {}, which the first camera has{}: every camera needs a picture of "
            "every moment",
            one.camera->info().name, sequence, why.empty() ? "" : " (" + why + ")");
        return false;
      }
      out.push_back(std::move(frame));
      break;
    }
  }
  return true;
}

Stages open_stages(const MonocularConfig& config) {
  if (!config.views.empty()) {
    return open_stages(config, [views = config.views] { return open_videos(views); });
  }
  return open_with(config, [source = config.source] { return Cameras{camera::open_camera(source), {}}; });
}

Stages open_stages(const MonocularConfig& given, const OpenViews& open) {
  MonocularConfig config = given;
  config.tracker.intrinsics.reset();  // the rig file knows
  config.source.loop = false;
  return open_with(config, [open] { return in_step(open()); });
}

}  // namespace facet::pipeline
