#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "mesh/mesh.hpp"
#include "simulation/anatomy.hpp"

namespace facet::simulation {

/// The resting skin that wrinkles are laid out on. Head frame, mm; all [vertex_count] of the finest mesh.
struct RestingSkin {
  const mesh::Vertices& vertices_mm;
  const Eigen::Matrix3Xf& normals;
  const mesh::Triangles& triangles;
  const Eigen::VectorXf& skin;  ///< 1 on face skin, 0 on eyes, inner mouth and the open edge, soft between
  const Eigen::VectorXf& lips;  ///< 1 on the lips
};

/// Wrinkle-scale relief of one actor: creases that deepen with the expressions that fold them (forehead
/// lines, frown lines, crow's feet, lower lids, nasolabial and smile folds, chin, lips), and relief that is
/// always there (pores, unevenness). Creases are 2 to 6 mm wide and 0.2 to 0.8 mm deep at full strength.
/// Immutable; any thread.
class Wrinkles {
 public:
  Wrinkles(const Anatomy& anatomy, const RestingSkin& resting, std::uint64_t seed,
           const std::vector<std::string>& expression_names);

  /// Displacement along the normals, mm, for an expression [expression_count]. relief_mm is resized.
  void relief_mm(std::span<const float> expression, Eigen::VectorXf& relief_mm) const;

 private:
  struct Fold {
    Eigen::VectorXf pattern_mm;                     ///< [vertex_count] at full strength
    std::vector<std::pair<std::size_t, float>> by;  ///< expression index and how much it folds
    float resting = 0;                              ///< strength without any expression
  };
  std::vector<Fold> folds_;
  Eigen::VectorXf always_mm_;
};

}  // namespace facet::simulation
