#include "simulation/actor_take.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "simulation/anatomy.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

constexpr float kIdentitySigma = 0.8F;
constexpr float kMaxIdentity = 2.0F;
constexpr float kDistance_mm = 700;
constexpr std::array<float, 9> kLighting{0.75F, -0.1F, 0.25F, 0.25F, 0, 0, 0, 0, 0};

/// One value per control vertex, pushed through every level's stencils.
Eigen::MatrixXf push_to_finest(const mesh::Hierarchy& hierarchy, Eigen::MatrixXf values) {
  for (const mesh::Level& level : hierarchy.levels) {
    Eigen::MatrixXf finer;
    mesh::apply(level.from_coarser, values, finer);
    values = std::move(finer);
  }
  return values;
}

Eigen::MatrixXf region_weights(const face::FaceModel& model, face::Region region) {
  Eigen::MatrixXf weights(1, model.vertex_count());
  for (std::int32_t v = 0; v < model.vertex_count(); ++v) {
    weights(0, v) = face::has_region(model.regions[static_cast<std::size_t>(v)], region) ? 1.0F : 0.0F;
  }
  return weights;
}

Eigen::Isometry3f camera_from_head(const HeadMotion& motion) {
  using Eigen::AngleAxisf;
  using Eigen::Vector3f;
  Eigen::Isometry3f pose = Eigen::Isometry3f::Identity();
  pose.linear() =
      AngleAxisf(std::numbers::pi_v<float>, Vector3f::UnitX()).toRotationMatrix() *
      (AngleAxisf(motion.yaw_rad, Vector3f::UnitY()) * AngleAxisf(motion.pitch_rad, Vector3f::UnitX()) *
       AngleAxisf(motion.roll_rad, Vector3f::UnitZ()))
          .toRotationMatrix();
  pose.translation() = Vector3f(0, 0, kDistance_mm) + motion.shift_mm;
  return pose;
}

}  // namespace

ActorTake::ActorTake(const face::FaceModel& model, const ActorTakeConfig& config)
    : config_(config),
      performance_(
          {.seed = config.seed, .duration_s = static_cast<double>(config.frame_count) / config.rate_hz}) {
  Random random(config.seed, 91);
  std::vector<float> identity(static_cast<std::size_t>(model.identity_count()));
  for (float& coefficient : identity) {
    coefficient = std::clamp(kIdentitySigma * random.normal(), -kMaxIdentity, kMaxIdentity);
  }
  basis_ = model.contract_identity(identity);

  // Pixels so small that only the number of vertices ends the subdivision.
  constexpr float kPixelsPerUnit = 1e6F;
  mesh::HierarchyOptions options;
  options.max_vertices = config.max_vertices;
  const std::vector<std::uint8_t> facing(static_cast<std::size_t>(model.vertex_count()), 1);
  auto subject = std::make_shared<mesh::Subject>();
  subject->hierarchy = mesh::build_hierarchy(
      model.control, kPixelsPerUnit * model.control.texture_coordinates, facing, options);
  subject->expression_names = model.expression_names;
  subject->identity = identity;
  subject->regions = model.regions;
  subject->id = mesh::subject_id(*subject, 1);
  subject_ = subject;

  const mesh::Hierarchy& hierarchy = *subject->hierarchy;
  const Eigen::MatrixXf colours = push_to_finest(hierarchy, model.mean_albedo);
  auto albedo = std::make_shared<mesh::Albedo>();
  albedo->version = 1;
  albedo->linear_rgb.assign(colours.data(), colours.data() + colours.size());
  albedo_ = albedo;

  std::vector<mesh::Vertices> levels;
  mesh::push_positions(hierarchy, basis_.neutral_mm, levels);
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(levels.back(), hierarchy.finest().triangles, normals);
  const Eigen::VectorXf skin =
      push_to_finest(hierarchy, region_weights(model, face::Region::Refinable)).row(0).transpose();
  const Eigen::VectorXf lips =
      push_to_finest(hierarchy, region_weights(model, face::Region::Lips)).row(0).transpose();
  wrinkles_.emplace(find_anatomy(model, basis_.neutral_mm),
                    RestingSkin{levels.back(), normals, hierarchy.finest().triangles, skin, lips},
                    config.seed, model.expression_names);
}

mesh::MeshFrame ActorTake::shape(std::span<const float> expression) const {
  mesh::MeshFrame frame;
  frame.state = mesh::TrackingState::Tracking;
  frame.camera = {1500.0F, 1500.0F, 639.5F, 359.5F, 1280, 720};
  frame.subject = subject_;
  frame.camera_from_head = camera_from_head({});
  frame.expression.assign(expression.begin(), expression.end());
  basis_.evaluate(expression, frame.control_vertices_mm);
  Eigen::VectorXf relief_mm;
  wrinkles_->relief_mm(expression, relief_mm);
  frame.displacements_mm.assign(relief_mm.data(), relief_mm.data() + relief_mm.size());
  frame.confidence.assign(frame.displacements_mm.size(), 1.0F);
  frame.lighting = kLighting;
  frame.albedo = albedo_;
  return frame;
}

std::shared_ptr<const mesh::MeshFrame> ActorTake::frame(int index) const {
  const double time_s = static_cast<double>(index) / static_cast<double>(config_.rate_hz);
  auto frame =
      std::make_shared<mesh::MeshFrame>(shape(performance_.expression(time_s, subject_->expression_names)));
  frame->sequence = static_cast<std::uint64_t>(index);
  frame->media_time_ns = static_cast<std::int64_t>(std::llround(time_s * 1e9));
  frame->timestamp_ns = 1'000'000'000 + frame->media_time_ns;
  frame->camera_from_head = camera_from_head(performance_.head(time_s));
  return frame;
}

}  // namespace facet::simulation
