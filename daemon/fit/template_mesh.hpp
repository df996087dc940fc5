#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <vector>

#include "face/face_model.hpp"
#include "mesh/mesh.hpp"

namespace facet::fit {

/// The mesh that is fitted to depth maps and keeps its topology through a take
/// [SF04 sec. 3]: the face model's, refined. Immutable once built; any thread.
struct TemplateMesh {
  mesh::Vertices neutral_mm;  ///< [3][vertex_count] the model's mean neutral face, head frame
  mesh::Triangles triangles;
  mesh::OneRings one_rings;
  mesh::SparseRows from_control;  ///< row r: vertex r from the model's control vertices
  /// [expression_count] of [3][vertex_count]: what the model's expressions add for the mean person, head
  /// frame.
  std::vector<mesh::Vertices> expressions_mm;
  /// [vertex_count] 1 where a depth map or a flow may pull: skin. 0: eyeballs, sockets, the inner mouth,
  /// which follow the skin around them.
  std::vector<std::uint8_t> is_skin;
  std::vector<std::uint8_t>
      is_mouth;  ///< [vertex_count] 1 on the skin up to 7 mm around the lips; may be empty

  std::int32_t vertex_count() const { return static_cast<std::int32_t>(neutral_mm.cols()); }
};

/// Refines the model's mesh in whole sweeps of 4-8 subdivision to the most vertices that max_vertices allows
/// (the default gives about 16 K or less, the paper's size, with the default model). Start-up only. Throws
/// Error(UnreadableInput) where the model's mesh can't be subdivided.
TemplateMesh make_template(const face::FaceModel& model, std::int32_t max_vertices = 18'000);

/// A point of the template and where it is in the rig's frame.
struct Correspondence {
  face::LandmarkAnchor anchor;  ///< on the model's control mesh
  Eigen::Vector3d target_mm{0, 0, 0};
};

/// The template of one person in the rig's frame, with the expressions that its skin is expected to make.
struct RestShape {
  mesh::Vertices vertices_mm;                  ///< [3][vertex_count]
  std::vector<mesh::Vertices> expressions_mm;  ///< [expression_count] of [3][vertex_count]; may be empty
};

struct FirstShape;

/// How the template was brought to its correspondences.
struct Placement {
  RestShape rest;
  mesh::Vertices shown_mm;           ///< [3][vertex_count] with the expression that the correspondences show
  Eigen::VectorXd expression;        ///< [expression_count] that expression, 0 to 1
  double rms_mm = 0;                 ///< of the correspondences that agree, after the affine map
  std::vector<std::uint8_t> agrees;  ///< [correspondence_count] 0: counted as wrong and left out
};

/// Places the template by correspondences [SF04 sec. 3.1]: a similarity, then an affine map that is drawn
/// towards it, then what is left spread by normalised radial basis functions. Correspondences that lie far
/// off what most agree on (more than 4 times the median distance, and 10 mm) are left out.
///
/// shape  whose shown_mm the correspondences are of; its expression is taken away again for the rest shape
/// Throws Error(UnreadableInput) with fewer than 6 correspondences that agree, or where they lie on a line.
Placement place(const TemplateMesh& surface, const FirstShape& shape,
                std::span<const Correspondence> correspondences);

/// The rotation and translation that bring `from` to `to`, both [3][count], least squares with weights
/// [count] [Hor87]. scale: null for a rigid motion, else it is estimated, too.
Eigen::Isometry3d align_rigidly(const Eigen::Ref<const Eigen::Matrix3Xd>& from,
                                const Eigen::Ref<const Eigen::Matrix3Xd>& to,
                                const Eigen::Ref<const Eigen::VectorXd>& weights, double* scale = nullptr);

}  // namespace facet::fit
