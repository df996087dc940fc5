#include "simulation/sequence.hpp"

#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>

#include "capture/rig_file.hpp"
#include "files/output_file.hpp"
#include "render/video_writer.hpp"
#include "simulation/recorded_curves.hpp"

namespace facet::simulation {
namespace {

using nlohmann::json;

json vector_json(const Eigen::Vector3f& vector) {
  return {vector.x(), vector.y(), vector.z()};
}

json light_json(const Lighting& lighting) {
  json areas = json::array();
  for (const AreaLight& light : lighting.area_lights) {
    areas.push_back({{"centre_mm", vector_json(light.centre_mm)},
                     {"half_u_mm", vector_json(light.half_u_mm)},
                     {"half_v_mm", vector_json(light.half_v_mm)},
                     {"reference_distance_mm", light.reference_distance_mm},
                     {"irradiance", vector_json(light.irradiance)}});
  }
  return {{"kind", light_name(lighting.kind)},
          {"spherical_harmonics", lighting.spherical_harmonics},
          {"area_lights", areas}};
}

json look_json(const Look& look) {
  json made = {{"skin", skin_type_name(look.skin_type)}};
  if (!look.painted()) {
    made["effects"] = effects_of(look);
  }
  return made;
}

json webcam_json(const WebcamEffects& effects, const Webcam& webcam) {
  const capture::LensDistortion& lens = webcam.distortion;
  return {{"effects", names_of(effects)},
          {"readout_ms", 1e3 * webcam.readout_s},
          {"exposure_ms", 1e3 * webcam.exposure_s},
          {"distortion", {lens.k1, lens.k2, lens.p1, lens.p2, lens.k3}}};
}

json frame_json(int index, const SyntheticFrame& frame, const std::vector<std::string>& names) {
  json pose = json::array();
  for (Eigen::Index row = 0; row < 4; ++row) {
    json values = json::array();
    for (Eigen::Index column = 0; column < 4; ++column) {
      values.push_back(frame.camera_from_head.matrix()(row, column));
    }
    pose.push_back(values);
  }
  json expression = json::object();
  for (std::size_t k = 0; k < names.size(); ++k) {
    expression[names[k]] = frame.expression[k];
  }
  json made = {{"index", index}, {"camera_from_head", pose}, {"expression", expression}};
  if (frame.lamp >= 0) {
    made["lamp"] = frame.lamp;
  }
  return made;
}

}  // namespace

std::filesystem::path truth_file(const std::filesystem::path& folder, std::uint64_t index) {
  return folder / "truth" / fmt::format("frame_{:06}.ply", index);
}

void write_sequence(const ActorSequence& sequence, const std::filesystem::path& folder,
                    const SequenceFiles& wanted, const std::function<void(int)>& done) {
  files::make_folder(folder / "truth");
  write_truth_ply(sequence.neutral(), folder / "truth" / "neutral.ply",
                  "head frame, mm, x to the subject's left, y up, z out of the face");
  const ActorSequenceConfig& config = sequence.config();
  const CameraIntrinsics& camera = sequence.camera();
  json document = {{"fx", camera.fx},
                   {"fy", camera.fy},
                   {"cx", camera.cx},
                   {"cy", camera.cy},
                   {"width", camera.width_px},
                   {"height", camera.height_px},
                   {"fps", config.rate_hz},
                   {"seed", config.seed},
                   {"person", config.person.value_or(config.seed)},
                   {"light", light_json(sequence.lighting())},
                   {"highlights", config.highlights},
                   {"glasses", config.glasses},
                   {"look", look_json(config.look)},
                   {"model", sequence.model_name()},
                   {"curves", config.curves ? json(config.curves->source()) : json(nullptr)},
                   {"start_s", config.start_s},
                   {"calm_turn", config.calm_turn},
                   {"burst", burst_name(config.burst)},
                   {"identity", sequence.identity()},
                   {"outside_span_rms_mm", sequence.outside_span_rms_mm()},
                   {"frames", json::array()}};
  std::vector<std::unique_ptr<render::VideoWriter>> videos;
  for (const capture::RigCamera& one : sequence.rig().cameras) {
    videos.push_back(std::make_unique<render::VideoWriter>(folder / (one.name + ".mkv"), one.lens.width_px,
                                                           one.lens.height_px, config.rate_hz,
                                                           config.webcam.codec));
  }
  if (config.webcam.any()) {
    document["webcam"] = webcam_json(config.webcam, sequence.webcam());
  }
  TruthMesh truth;
  TruthMesh surfaces;
  if (wanted.with_surfaces) {
    files::make_folder(folder / "surfaces");
  }
  for (int index = 0; index < config.frame_count; ++index) {
    const bool with_truth = index % wanted.truth_every == 0;
    const SyntheticFrame frame =
        sequence.render(index, with_truth ? &truth : nullptr, wanted.with_surfaces ? &surfaces : nullptr);
    videos.front()->append(frame.picture);
    for (std::size_t k = 1; k < videos.size(); ++k) {
      videos[k]->append(frame.further_pictures[k - 1]);
    }
    if (with_truth) {
      write_truth_ply(truth, truth_file(folder, static_cast<std::uint64_t>(index)));
    }
    if (wanted.with_surfaces) {
      write_truth_ply(surfaces, folder / "surfaces" / fmt::format("frame_{:06}.ply", index));
    }
    json& described = document["frames"].emplace_back(frame_json(index, frame, sequence.expression_names()));
    if (config.webcam.exposure || config.webcam.white_balance) {
      described["gain"] = frame.settings.gain;
      described["white_balance"] = vector_json(frame.settings.white_balance);
    }
    done(index + 1);
  }
  for (const std::unique_ptr<render::VideoWriter>& video : videos) {
    video->finish();
  }
  if (videos.size() > 1 || config.webcam.distortion) {
    capture::write_rig(sequence.rig(), folder / "rig.toml");
  }
  files::OutputFile output(folder / "camera.json");
  output.write(document.dump(1) + "\n");
  output.commit();
}

}  // namespace facet::simulation
