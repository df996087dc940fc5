#include "booth/booth_shading.hpp"

#include <algorithm>
#include <list>
#include <utility>

#include "capture/undistortion.hpp"
#include "refine/recovering_refiner.hpp"
#include "refine/refine_stage.hpp"

namespace facet::booth {
namespace {

/// The finest level as a hierarchy whose control vertices are its own.
std::shared_ptr<const mesh::Hierarchy> single_level(const mesh::Hierarchy& of) {
  const mesh::Level& level = of.finest();
  auto hierarchy = std::make_shared<mesh::Hierarchy>();
  hierarchy->control_vertex_count = level.vertex_count;
  mesh::Level& only = hierarchy->levels.emplace_back(level);
  only.from_coarser = {};
  for (std::int32_t v = 0; v < level.vertex_count; ++v) {
    only.from_coarser.row_offsets.push_back(v);
    only.from_coarser.columns.push_back(v);
    only.from_coarser.weights.push_back(1);
  }
  only.from_coarser.row_offsets.push_back(level.vertex_count);
  hierarchy->texture_coordinates = of.texture_coordinates;
  return hierarchy;
}

/// Beside a camera's confidence: where none is sure, what its refinement makes of the vertices around counts.
constexpr float kLeastWeight = 1e-3F;

struct View {
  View(const capture::Lens& lens, std::unique_ptr<refine::RefineStage> first, const refine::OpenRefiner& open,
       Messages& messages)
      : undistortion(lens), refiner(std::move(first), open, messages, {}) {}

  capture::Undistortion undistortion;
  refine::RecoveringRefiner refiner;
  refine::RefineOutput output;
};

}  // namespace

refine::RefinerConfig booth_refinement() {
  refine::RefinerConfig config;
  config.budget = refine::Budget::Fixed;  // the booth's frames wait for depth, not for shading
  config.given_prior = true;
  config.fine_albedo = true;
  config.room_lamps = refine::RoomLamps::Never;  // its lamps and projectors blink from frame to frame
  config.weights.displacement_hierarchy = 3;
  config.weights.displacement_smooth = 3;
  config.weights.displacement_coarse = 0;
  config.weights.albedo_smooth = 300;
  config.robust_scale = 0.4F;
  config.displacement_bound_mm = 20;
  return config;
}

struct BoothShading::Impl {
  Messages messages;
  std::list<View> views;
  mesh::SparseRows fine_from_template;
  mesh::Vertices base_mm;  ///< [3][finest vertex_count] the template subdivided, rig frame
  std::vector<float> weights;
  float bound_mm = 0;             ///< of the refinement
  std::vector<float> bounded_mm;  ///< the displacements by depth, within it
};

BoothShading::BoothShading(const std::string& gpu_device, const capture::Rig& rig,
                           const refine::RefinerConfig& config)
    : BoothShading(refine::refiner_opener({.device = gpu_device}, config), rig,
                   config.displacement_bound_mm) {}

BoothShading::BoothShading(const refine::OpenRefiner& open, const capture::Rig& rig, float bound_mm)
    : impl_(std::make_unique<Impl>()) {
  impl_->bound_mm = bound_mm;
  for (const capture::RigCamera& camera : rig.cameras) {
    if (camera.colour) {
      impl_->views.emplace_back(camera.lens, open(), open, impl_->messages);
    }
  }
}

BoothShading::~BoothShading() = default;

void BoothShading::begin(const mesh::Hierarchy& hierarchy, const fit::TemplateMesh& surface,
                         const face::FaceModel& model) {
  const mesh::Level& fine = hierarchy.finest();
  impl_->fine_from_template = fine.from_coarser;
  Eigen::MatrixXf skin(1, surface.vertex_count());
  for (std::int32_t v = 0; v < surface.vertex_count(); ++v) {
    skin(0, v) = surface.is_skin[static_cast<std::size_t>(v)] != 0 ? 1.0F : 0.0F;
  }
  Eigen::MatrixXf fine_skin;
  mesh::apply(fine.from_coarser, skin, fine_skin);
  constexpr float kSkin = 0.99F;
  refine::SubjectSetup subject;
  subject.hierarchy = single_level(hierarchy);
  for (std::int32_t v = 0; v < fine.vertex_count; ++v) {
    subject.refinable.push_back(fine_skin(0, v) > kSkin ? 1 : 0);
  }
  mesh::Vertices template_albedo;
  mesh::apply(surface.from_control, model.mean_albedo, template_albedo);
  mesh::apply(fine.from_coarser, template_albedo, subject.mean_albedo);
  for (View& view : impl_->views) {
    view.refiner.set_subject(subject);
  }
}

std::string BoothShading::refine(std::span<const Frame> pictures, const mesh::Vertices& template_mm,
                                 std::span<const float> displacements_mm, std::vector<float>& added_mm) {
  mesh::apply(impl_->fine_from_template, template_mm, impl_->base_mm);
  added_mm.assign(displacements_mm.size(), 0);
  impl_->weights.assign(displacements_mm.size(), 0);
  impl_->bounded_mm.assign(displacements_mm.begin(), displacements_mm.end());
  for (float& displacement : impl_->bounded_mm) {
    displacement = std::clamp(displacement, -impl_->bound_mm, impl_->bound_mm);
  }
  std::string missing;
  bool any = false;
  std::size_t at = 0;
  for (View& view : impl_->views) {
    refine::RefineInput input;
    input.image = view.undistortion.apply(pictures[at++]);
    if (input.image.empty() || input.image.corrupt) {
      view.refiner.restart();
      continue;
    }
    const capture::Lens& lens = view.undistortion.lens();
    input.camera = {static_cast<float>(lens.fx_px),
                    static_cast<float>(lens.fy_px),
                    static_cast<float>(lens.cx_px),
                    static_cast<float>(lens.cy_px),
                    lens.width_px,
                    lens.height_px};
    input.camera_from_head = lens.camera_from_rig.cast<float>();
    input.control_vertices_mm = &impl_->base_mm;
    input.prior_displacements_mm = impl_->bounded_mm;
    const std::string& why = view.refiner.refine(input, view.output);
    if (!why.empty()) {
      missing = "no shading by one of the colour cameras: " + why;
      continue;
    }
    any = true;
    for (std::size_t v = 0; v < displacements_mm.size(); ++v) {
      const float weight = view.output.confidence[v] + kLeastWeight;
      added_mm[v] += weight * (view.output.displacements_mm[v] - impl_->bounded_mm[v]);
      impl_->weights[v] += weight;
    }
  }
  for (std::size_t v = 0; v < displacements_mm.size(); ++v) {
    added_mm[v] = impl_->weights[v] > 0 ? added_mm[v] / impl_->weights[v] : 0.0F;
  }
  return any || !missing.empty() ? missing : "no colour camera has a picture for the shading";
}

void BoothShading::restart() {
  for (View& view : impl_->views) {
    view.refiner.restart();
  }
}

std::vector<Messages::Message> BoothShading::take_messages() {
  return impl_->messages.take();
}

}  // namespace facet::booth
