#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <cstdint>
#include <vector>

#include "face/face_model.hpp"

namespace facet::person {

/// How strongly the shape is held to the model, and what a measurement is worth (docs/person.md).
struct AnchorStrength {
  double distance = 5e-4;  ///< of |delta|^2, per mm^2 of skin and mm^2
  double curvature = 20;   ///< of |Laplacian delta|^2, per mm^2 of skin
  double first_log_focal_sigma = 0.1;
  double log_focal_sigma = 0.5;
  double expression_sigma = 0.1;  ///< of a solved expression about its prior
  double expression_facts = 400;  ///< what a whole face's measurements count as, against that prior
};

/// [vertex_count][vertex_count] rows that take control vertices to near where they lie on the surface that
/// 4-8 subdivision makes of them (mesh::build_hierarchy's vertex mask, twice; open edges stay).
mesh::SparseRows surface_rows(const face::FaceModel& model);

/// What of a head pictures tell of, and what may follow it.
struct FreeSkin {
  std::vector<std::int32_t> skin;  ///< vertices that pictures tell of, ascending
  std::vector<std::int32_t> free;  ///< those and some rings around them, ascending
  std::vector<int> ring;  ///< [vertex_count] 0 on the skin, rings away from it, -1 beyond the free ones
};
FreeSkin free_skin(const face::FaceModel& model);

/// lambda_0 M + lambda_L K M^-1 K over the free vertices: K the cotangent stiffness of a face, M its
/// vertices' areas (mm^2). Vertices beyond the free ones stay where they are; rows of K that reach free ones
/// count. control_mm  [3][vertex_count] the face returns     [free][free]
Eigen::SparseMatrix<double> anchor_matrix(const face::FaceModel& model, const Eigen::Matrix3Xd& control_mm,
                                          const std::vector<std::int32_t>& free, const std::vector<int>& ring,
                                          const AnchorStrength& strength);

}  // namespace facet::person
