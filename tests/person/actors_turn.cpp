#include "actors_turn.hpp"

#include <cmath>
#include <tuple>
#include <utility>

#include "mesh/mesh.hpp"
#include "person/surface_anchor.hpp"

namespace facet::person {

simulation::ActorSequenceConfig actors_turn() {
  simulation::ActorSequenceConfig config;
  config.seed = 352;
  config.width_px = 480;
  config.height_px = 360;
  config.frame_count = 345;
  config.calm_turn = true;
  config.burst = simulation::Burst::Lamps;
  config.sensor_noise = false;
  return config;
}

Observed look_at(const face::FaceModel& model, const simulation::ActorSequence& actor) {
  Observed out = look_at(model, actor, {30, 45, 75, 105, 135, 150, 165});
  out.burst = look_at(model, actor, {301, 304, 307, 310, 313}).keyframes;  // the last one without a lamp
  for (std::size_t lamp = 0; lamp < out.burst.size(); ++lamp) {
    out.burst[lamp].light = static_cast<int>(lamp) + 1;
  }
  for (std::vector<Keyframe>* pictures : {&out.keyframes, &out.burst}) {
    for (Keyframe& keyframe : *pictures) {
      keyframe.expression = out.rest;
    }
  }
  return out;
}

Observed look_at(const face::FaceModel& model, const simulation::ActorSequence& actor,
                 const std::vector<int>& frames) {
  Observed out;
  out.camera = actor.camera();
  out.camera.fx *= static_cast<float>(kShort);
  out.camera.fy = out.camera.fx;
  out.identity.assign(static_cast<std::size_t>(model.identity_count()), 0);
  out.rest = Eigen::VectorXd::Zero(model.expression_count());
  out.usual_reprojection_px = 1;
  for (const int index : frames) {
    const simulation::SyntheticFrame frame = actor.render(index, nullptr);
    Keyframe keyframe;
    keyframe.sequence = static_cast<std::uint64_t>(index);
    keyframe.camera_from_head = frame.camera_from_head.cast<double>();
    keyframe.camera_from_head.translation().z() *= kShort;
    keyframe.expression =
        Eigen::Map<const Eigen::VectorXf>(frame.expression.data(), model.expression_count()).cast<double>();
    std::tie(keyframe.yaw_deg, keyframe.pitch_deg) = orientation_deg(keyframe.camera_from_head);
    keyframe.picture = {0, 0, frame.picture.width_px, frame.picture.height_px, frame.picture.rgb};
    out.keyframes.push_back(std::move(keyframe));
  }
  return out;
}

double error_mm(const face::FaceModel& model, const Eigen::Matrix3Xd& neutral_mm,
                const report::Truth& truth) {
  report::Reconstruction mesh;
  mesh::apply(surface_rows(model), neutral_mm.cast<float>().eval(), mesh.vertices_mm);
  mesh.normals = Eigen::Matrix3Xf::Zero(3, mesh.vertices_mm.cols());
  for (std::int32_t v = 0; v < model.vertex_count(); ++v) {
    if (model.control.refinable[static_cast<std::size_t>(v)] != 0) {
      mesh.measured.push_back(v);
    }
  }
  mesh.normals.row(2).setOnes();
  const report::Comparison compared = report::measure(
      mesh, truth, report::align_from({&mesh, &truth}, report::Alignment::Similarity, maths::Similarity()));
  double sum = 0;
  for (const float distance : compared.signed_distance_mm) {
    sum += std::isfinite(distance) ? static_cast<double>(std::abs(distance)) : 10;
  }
  return sum / static_cast<double>(mesh.measured.size());
}

}  // namespace facet::person
