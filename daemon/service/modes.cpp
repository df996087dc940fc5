#include "service/modes.hpp"

#include <fmt/format.h>

#include <array>
#include <utility>

#include "facet/error.hpp"
#include "pipeline/booth.hpp"
#include "pipeline/frames.hpp"
#include "pipeline/live_cameras.hpp"
#include "pipeline/shading.hpp"
#include "pipeline/shading_parts.hpp"

namespace facet::service {
namespace {

void tell(OpenedPipeline& opened, std::string line, bool warns = false) {
  opened.lines.push_back({warns, std::move(line)});
}

void tell_device(OpenedPipeline& opened, std::string line, std::string kernels_ignored) {
  tell(opened, std::move(line));
  if (!kernels_ignored.empty()) {
    tell(opened, std::move(kernels_ignored), true);
  }
}

void tell_refiner(OpenedPipeline& opened, const pipeline::ShadingParts& stages) {
  if (stages.refiner != nullptr) {
    tell_device(opened, fmt::format("refining on {}", stages.refiner->device()),
                stages.refiner->kernels_ignored());
  } else {
    tell(opened, "refinement off (gpu.device = \"none\"): meshes are coarse and marked as degraded", true);
  }
}

void tell_devices(OpenedPipeline& opened, const pipeline::Devices& devices) {
  opened.live = true;
  for (std::size_t i = 0; i < devices.cameras.size(); ++i) {
    const CameraInfo camera = devices.cameras[i]->info();
    opened.source_name += (i == 0 ? "" : ", ") + devices.config.cameras[i].name;
    tell(opened, fmt::format("camera {}: {}, {} x {} px, {:.2f} Hz", devices.config.cameras[i].name,
                             camera.name, camera.width_px, camera.height_px, camera.rate_hz));
  }
  tell(opened, devices.open_trigger
                   ? fmt::format("trigger: {} lines, {:.2f} slots a second",
                                 devices.config.program.lines.size(), devices.config.program.slots_per_second)
                   : std::string("no trigger: the cameras run freely"));
}

pipeline::ShadingPipeline::Options monocular_options(const Config& config) {
  return {config.pipeline.hierarchy, config.pipeline.frames, {}, true};
}

void check_one_source(const camera::CameraConfig& source) {
  if (!camera::names_source(source)) {
    const camera::CameraKind& kind = camera::camera_kind(source.kind);
    throw Error(ErrorKind::Usage, fmt::format("source.{} is missing: {}", kind.needs, kind.advice));
  }
}

void check_monocular(const Config& config) {
  if (!has_live_cameras(config)) {
    check_one_source(config.pipeline.source);
    return;
  }
  if (camera::names_source(config.pipeline.source)) {
    throw Error(ErrorKind::Usage,
                "mode \"monocular\" takes pictures from one [source] or from [[camera]]s: leave out "
                "source.kind and source.path, or the [[camera]]s");
  }
  pipeline::check(config.devices, config.rig_file);
}

OpenedPipeline open_one_source(const Config& config) {
  const auto stages = std::make_shared<pipeline::ShadingParts>(pipeline::open_shading(config.pipeline));
  const CameraInfo source = stages->pictures->cameras().front().info;
  const camera::CameraConfig& given = config.pipeline.source;
  OpenedPipeline opened;
  // A take tells where its video is, from whatever folder the daemon was started.
  opened.source_name =
      given.kind == "file" ? std::filesystem::absolute(given.path).lexically_normal().string() : source.name;
  opened.live = source.live;
  tell(opened, fmt::format("source {}: {} x {} px, {:.2f} Hz{}", source.name, source.width_px,
                           source.height_px, source.rate_hz, source.live ? ", live" : ""));
  tell_refiner(opened, *stages);
  opened.make = [stages, options = monocular_options(config)](const Sinks& sinks) {
    return std::make_unique<pipeline::ShadingPipeline>(
        std::move(*stages), options,
        std::vector<pipeline::MeshSink*>{&sinks.stream, &sinks.bridges, &sinks.take});
  };
  return opened;
}

OpenedPipeline open_several_cameras(const Config& config) {
  const auto views = std::make_shared<pipeline::LiveCameras>(
      pipeline::open_live_cameras(config.devices, config.rig_file, config.pipeline));
  OpenedPipeline opened;
  tell_devices(opened, views->devices);
  tell(opened,
       fmt::format("meshes are in the frame of camera {}", views->devices.config.cameras.front().name));
  tell_refiner(opened, views->stages);
  opened.make = [views, options = monocular_options(config)](const Sinks& sinks) {
    return std::make_unique<pipeline::LiveCamerasPipeline>(
        std::move(*views), options,
        std::vector<pipeline::MeshSink*>{&sinks.stream, &sinks.bridges, &sinks.take});
  };
  return opened;
}

OpenedPipeline open_monocular(const Config& config) {
  return has_live_cameras(config) ? open_several_cameras(config) : open_one_source(config);
}

OpenedPipeline open_frames(const Config& config) {
  const auto devices = std::make_shared<pipeline::Devices>(pipeline::open_devices(config.devices));
  OpenedPipeline opened;
  tell_devices(opened, *devices);
  opened.make = [devices](const Sinks& sinks) {
    return std::make_unique<pipeline::FramesPipeline>(
        std::move(*devices), std::vector<pipeline::FrameSetSink*>{&sinks.sets_shown});
  };
  return opened;
}

OpenedPipeline open_booth(const Config& config) {
  const auto booth =
      std::make_shared<pipeline::Booth>(pipeline::open_booth(config.devices, booth_config(config)));
  OpenedPipeline opened;
  tell_devices(opened, booth->devices);
  tell_device(opened, fmt::format("depth maps on {}", booth->stages.depth->device()),
              booth->stages.depth->kernels_ignored());
  opened.make = [booth, record = config.booth_record](const Sinks& sinks) {
    std::vector<pipeline::FrameSetSink*> set_sinks;
    std::vector<pipeline::MeshSink*> mesh_sinks = {&sinks.stream, &sinks.bridges};
    if (record == BoothRecord::Pictures) {
      set_sinks.push_back(&sinks.sets_recorded);
    } else {
      mesh_sinks.push_back(&sinks.take);
    }
    return std::make_unique<pipeline::BoothPipeline>(std::move(*booth), std::move(set_sinks),
                                                     std::move(mesh_sinks));
  };
  return opened;
}

constexpr std::array kRows = {
    ModeRow{check_monocular, open_monocular},
    ModeRow{[](const Config& config) { pipeline::check(config.devices); }, open_frames},
    ModeRow{[](const Config& config) { pipeline::check(config.devices, booth_config(config)); }, open_booth},
};
static_assert(kRows.size() == kModes.size());

}  // namespace

const ModeRow& mode_row(Mode mode) {
  return kRows.at(static_cast<std::size_t>(mode));
}

void require_source(const Config& config, const std::filesystem::path& file) {
  try {
    mode_row(config.mode).check(config);
  } catch (const Error& error) {
    throw Error(ErrorKind::Usage, fmt::format("{}: {}", file.string(), error.what()));
  }
}

}  // namespace facet::service
