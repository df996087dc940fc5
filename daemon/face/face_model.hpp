#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "mesh/hierarchy.hpp"
#include "mesh/mesh.hpp"

namespace facet::face {

/// Bits of the per-vertex region mask.
enum class Region : std::uint8_t {
  Refinable = 1,  ///< face skin that shading may refine
  Eye = 2,        ///< eyeballs, lids' inner side, sockets: never refined
  Lips = 4,
  MouthInterior = 8,  ///< teeth, gums, tongue, inner mouth: never refined
  Boundary = 16,      ///< on an open edge of the mesh
  Scalp = 32,         ///< crown, ears, neck: hair is likely
  Brow = 64,
};

/// A point on the mesh that a landmark corresponds to.
struct LandmarkAnchor {
  std::array<std::int32_t, 3> vertices{};  ///< of one triangle of the split quads
  std::array<float, 3> weights{};  ///< barycentric, sum 1; all 0: this landmark has no place on the model
};

/// The core contracted with one identity: expressions become linear (blend shapes).
struct ExpressionBasis {
  mesh::Vertices neutral_mm;              ///< [3][vertex_count]
  std::vector<mesh::Vertices> deltas_mm;  ///< [expression_count] of [3][vertex_count]

  /// neutral + sum of expression[e] * deltas[e]. expression [expression_count].
  void evaluate(std::span<const float> expression, mesh::Vertices& vertices_mm) const;
};

/// A bilinear face model V = C x2 w_id x3 w_exp (Ma & Deng 2019, section 3.1; Cao et al. 2014):
/// w_id = (1, identity coefficients in standard deviations), w_exp = (1, expression weights 0 to 1). Head
/// frame, mm. Immutable after loading; any thread.
class FaceModel {
 public:
  /// Reads a model file (docs/face-model-format.md). Throws Error(UnreadableInput) naming the file and what
  /// is wrong in it.
  static FaceModel load(const std::filesystem::path& file);
  void save(const std::filesystem::path& file) const;

  std::int32_t vertex_count() const { return control.vertex_count; }
  int identity_count() const { return identity_modes - 1; }
  int expression_count() const { return static_cast<int>(expression_names.size()); }

  /// V for the given weights; missing trailing weights count as 0. identity [<= identity_count], expression
  /// [<= expression_count].
  void evaluate(std::span<const float> identity, std::span<const float> expression,
                mesh::Vertices& vertices_mm) const;

  /// C x2 w_id: the blend shapes of one person.
  ExpressionBasis contract_identity(std::span<const float> identity) const;

  /// The part of the core at chosen points: for each landmark index the bilinear core rows, blended with its
  /// anchor. returns [landmarks.size()] matrices [identity_modes * 3][expression_modes], row 3 * i + axis.
  std::vector<Eigen::MatrixXf> core_at(std::span<const int> landmark_indices) const;

  std::string name;                           ///< for people: source and version
  mesh::ControlMesh control;                  ///< quads, texture coordinates, refinable
  std::vector<std::uint8_t> regions;          ///< [vertex_count] bits of Region
  std::vector<std::string> expression_names;  ///< [expression_count] ARKit names
  std::vector<float> expression_sigma;        ///< [expression_count] typical size of a weight, for priors
  std::vector<LandmarkAnchor>
      landmarks;  ///< [468] MediaPipe face mesh order; empty before `facet model build` has found them
  mesh::Vertices mean_albedo;  ///< [3][vertex_count] linear RGB
  int identity_modes = 0;      ///< identity_count + 1, mean first
  int expression_modes = 0;    ///< expression_count + 1, neutral first
  /// [identity_modes][expression_modes][vertex_count][3], mm
  std::vector<float> core_mm;
};

}  // namespace facet::face
