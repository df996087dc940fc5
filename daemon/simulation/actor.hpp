#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "mesh/mesh.hpp"
#include "simulation/look.hpp"
#include "simulation/performance.hpp"
#include "simulation/props.hpp"
#include "simulation/scattering.hpp"
#include "simulation/skin_maps.hpp"
#include "simulation/strands.hpp"

namespace facet::simulation {

/// An actor's shape at one moment. Head frame, mm.
struct ActorShape {
  mesh::Vertices head_mm;         ///< [3][head vertex_count]
  Eigen::Matrix3Xf head_normals;  ///< [3][head vertex_count]
  mesh::Vertices lower_teeth_mm;
  Gaze gaze;
  Eigen::Matrix3Xf albedo;  ///< [3][head vertex_count] linear RGB, with the blood where the face has put it
};

/// Who is made.
struct ActorTraits {
  std::uint64_t seed = 1;
  bool glasses = false;
  /// How far the identity lies outside of the model's span, rms over the face, mm; varied by 20 % between
  /// actors. 0 for models whose own faces are people's, of which the tracker knows nothing.
  double outside_span_mm = 1.2;
  Look look = {};  ///< of skin and hair
};

/// A virtual person: a face model's topology with an identity that the model cannot express, expressions
/// that differ from the model's, wrinkles that deepen with them, painted skin, eyes, teeth, hair, neck.
/// Immutable; any thread.
class VirtualActor {
 public:
  /// Throws Error(UnreadableInput) where the model has no landmark map.
  VirtualActor(const face::FaceModel& model, const ActorTraits& traits);
  ~VirtualActor();

  /// The head's surface: skin, lips, inner mouth, sockets, hair; without eyeballs, teeth and props.
  const mesh::Triangles& head_triangles() const { return head_triangles_; }
  const Eigen::Matrix3Xf& head_albedo() const { return head_albedo_; }  ///< at rest, linear RGB
  const std::vector<Material>& head_materials() const { return head_materials_; }
  const mesh::Vertices& resting_mm() const { return resting_mm_; }  ///< the head's, without relief and hair
  const Look& look() const { return look_; }
  const Eigen::Vector3f& skin() const { return skin_; }     ///< its albedo where nothing is special
  const SkinMaps& skin_maps() const { return skin_maps_; }  ///< empty where the skin is painted
  const HairStrands& hair() const { return hair_; }         ///< empty where the look has no strands
  /// Of the head's vertices; null where the look has no scattering.
  const Scattering* scattering() const { return scattering_.get(); }
  const Eigen::VectorXf& openness() const { return openness_; }    ///< [vertex_count] 0 to 1
  const Eigen::VectorXf& face_skin() const { return face_skin_; }  ///< [vertex_count] 1 on face skin
  const std::vector<std::string>& expression_names() const { return expression_names_; }
  const std::vector<float>& identity() const { return identity_; }  ///< coefficients inside the model's span
  const Anatomy& anatomy() const { return anatomy_; }
  /// rms of what the identity adds outside the model's span, over the face skin.
  float outside_span_rms_mm() const { return outside_span_rms_mm_; }

  const std::array<Eyeball, 2>& eyeballs() const { return eyeballs_; }  ///< subject's right, left
  const Surface& eyeball_surface() const { return eyeball_surface_; }   ///< looks along +z, around the origin
  const Surface& upper_teeth() const { return upper_teeth_; }
  const Surface& lower_teeth() const { return lower_teeth_; }  ///< at rest
  const Torso& torso() const { return torso_; }
  const Surface& glasses() const { return glasses_; }  ///< empty without glasses

  /// expression [expression_count] 0 to 1. shape's arrays are resized on first use.
  void shape(std::span<const float> expression, const Gaze& gaze, ActorShape& shape) const;

 private:
  void make_identity(const face::FaceModel& model, const ActorTraits& traits);
  void find_eyeballs(const face::FaceModel& model);
  void make_surface(const face::FaceModel& model);
  /// [head vertex_count] what the blood of a pose is multiplied by.
  Eigen::VectorXf blood_flow(const mesh::Vertices& control_mm) const;
  SkinZones skin_zones(const face::FaceModel& model) const;
  void grow_hair(const mesh::Vertices& resting_mm, const Eigen::VectorXf& skin, std::uint64_t seed);

  Look look_;
  SkinMaps skin_maps_;
  mesh::Vertices resting_mm_;
  HairStrands hair_;
  std::unique_ptr<const Scattering> scattering_;
  Eigen::Vector3f skin_{0, 0, 0};
  mesh::Quads quads_;  ///< of the control mesh
  std::vector<std::string> expression_names_;
  std::vector<float> identity_;
  float outside_span_rms_mm_ = 0;
  face::ExpressionBasis basis_;
  Anatomy anatomy_{};
  std::vector<std::uint8_t> is_eyeball_;  ///< [control vertex_count]
  std::array<Eyeball, 2> eyeballs_;
  std::vector<std::int32_t> jaw_;  ///< control vertices of the chin, which carry the lower teeth
  std::shared_ptr<const mesh::Hierarchy> hierarchy_;
  mesh::Triangles head_triangles_;
  Eigen::Matrix3Xf head_albedo_;
  std::vector<Material> head_materials_;
  Eigen::VectorXf openness_;
  Eigen::VectorXf face_skin_;
  Eigen::VectorXf hair_volume_mm_;
  Eigen::Vector3f head_middle_mm_{0, 0, 0};
  struct Relief;
  std::unique_ptr<const Relief> relief_;
  Surface eyeball_surface_;
  Surface upper_teeth_;
  Surface lower_teeth_;
  Torso torso_;
  Surface glasses_;
};

}  // namespace facet::simulation
