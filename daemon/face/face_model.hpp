#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "face/skin_chart.hpp"
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

/// Whether a vertex's region bits hold a region.
constexpr bool has_region(std::uint8_t bits, Region region) {
  return (bits & static_cast<std::uint8_t>(region)) != 0;
}

/// A point on the mesh that a landmark corresponds to.
struct LandmarkAnchor {
  std::array<std::int32_t, 3> vertices{};  ///< of one triangle of the split quads
  std::array<float, 3> weights{};  ///< barycentric, sum 1; all 0: this landmark has no place on the model
};

/// The core contracted with one identity: expressions become linear (blend shapes).
struct ExpressionBasis {
  mesh::Vertices neutral_mm;              ///< [3][vertex_count]
  std::vector<mesh::Vertices> deltas_mm;  ///< [expression_count] of [3][vertex_count]

  /// neutral + sum of expression[e] * deltas[e]; missing trailing weights count as 0. expression
  /// [<= expression_count]; vertices_mm is resized only when its size differs. Any thread.
  void evaluate(std::span<const float> expression, mesh::Vertices& vertices_mm) const;
};

/// A bilinear face model V = C x2 w_id x3 w_exp [MD19 sec. 3; CWZTZ14]:
/// w_id = (1, identity coefficients in standard deviations), w_exp = (1, expression weights 0 to 1). Head
/// frame, mm. Immutable after loading; any thread.
class FaceModel {
 public:
  /// Reads a model file (docs/face-model-format.md). Throws Error(UnreadableInput) naming the file and what
  /// is wrong in it.
  static FaceModel load(const std::filesystem::path& file);

  /// Reads a model from the bytes of a file. source names it in messages; a model whose core has more than
  /// max_core_values numbers is refused before any memory is taken for it.
  static FaceModel parse(std::span<const std::byte> bytes, const std::string& source,
                         std::uint64_t max_core_values = kMaxCoreValues);

  /// Writes the model through a temporary name in the same folder, so that no half file is ever seen. The
  /// core is rounded to 16 bits per number (step: the row's largest value / 32767, at least 1 micrometre).
  /// Throws Error(Storage) where it can't write and Error(Internal) where the model breaks a rule of check().
  void save(const std::filesystem::path& file) const;

  /// What is wrong with the model's fields (sizes that disagree, indices out of range, numbers that are not
  /// finite, names used twice); empty where nothing is.
  std::string check() const;

  std::int32_t vertex_count() const { return control.vertex_count; }
  int identity_count() const { return identity_modes - 1; }
  int expression_count() const { return static_cast<int>(expression_names.size()); }
  /// Index of an expression by its name; -1 where the model lacks it.
  int expression_index(std::string_view expression) const;

  /// Numbers of a core: 2^28, 1 GiB as float; 100 identity and 57 expression modes of 15,000 vertices fit.
  static constexpr std::uint64_t kMaxCoreValues = std::uint64_t{1} << 28;
  /// Landmarks of the MediaPipe face mesh.
  static constexpr int kLandmarkCount = 468;

  /// V for the given weights; missing trailing weights count as 0. identity [<= identity_count], expression
  /// [<= expression_count].
  void evaluate(std::span<const float> identity, std::span<const float> expression,
                mesh::Vertices& vertices_mm) const;

  /// C x2 w_id: the blend shapes of one person.
  ExpressionBasis contract_identity(std::span<const float> identity) const;

  /// The row of the core for one pair of modes. identity_mode 0 is the mean, expression_mode 0 the neutral
  /// face. [3][vertex_count], mm; valid while the model lives.
  Eigen::Map<const mesh::Vertices> core_row(int identity_mode, int expression_mode) const {
    return {core_mm.data() + row_offset(identity_mode, expression_mode), 3, control.vertex_count};
  }
  Eigen::Map<mesh::Vertices> core_row(int identity_mode, int expression_mode) {
    return {core_mm.data() + row_offset(identity_mode, expression_mode), 3, control.vertex_count};
  }

  /// Where a landmark lies on the given vertices, mm: the anchor's blend. The anchor must have a place.
  static Eigen::Vector3f anchor_point(const LandmarkAnchor& anchor, const mesh::Vertices& vertices_mm) {
    return anchor.weights[0] * vertices_mm.col(anchor.vertices[0]) +
           anchor.weights[1] * vertices_mm.col(anchor.vertices[1]) +
           anchor.weights[2] * vertices_mm.col(anchor.vertices[2]);
  }

  /// The part of the core at chosen points: for each landmark index the bilinear core rows, blended with its
  /// anchor. returns [landmark_indices.size()] matrices [identity_modes * 3][expression_modes], row
  /// 3 * identity mode + axis; all 0 for a landmark without a place on the model.
  std::vector<Eigen::MatrixXf> core_at(std::span<const int> landmark_indices) const;

  std::string name;  ///< for people: source and version
  /// [identity_count of another model] of a person's model (face::person_model): the face of the model of
  /// many that its expressions were carried over from. Not kept in files; empty otherwise.
  std::vector<float> carried_from;
  mesh::ControlMesh control;                  ///< quads, texture coordinates, refinable
  std::vector<std::uint8_t> regions;          ///< [vertex_count] bits of Region
  std::vector<std::string> expression_names;  ///< [expression_count] ARKit names
  std::vector<float> expression_sigma;        ///< [expression_count] typical size of a weight, for priors
  std::vector<LandmarkAnchor>
      landmarks;  ///< [468] MediaPipe face mesh order; empty before `facet model build` has found them
  mesh::Vertices mean_albedo;  ///< [3][vertex_count] linear RGB
  SkinChart skin;              ///< of a person's model: what is known of the skin
  int identity_modes = 0;      ///< identity_count + 1, mean first
  int expression_modes = 0;    ///< expression_count + 1, neutral first
  /// [identity_modes][expression_modes][vertex_count][3], mm
  std::vector<float> core_mm;

 private:
  std::size_t row_offset(int identity_mode, int expression_mode) const {
    return (static_cast<std::size_t>(identity_mode) * static_cast<std::size_t>(expression_modes) +
            static_cast<std::size_t>(expression_mode)) *
           3 * static_cast<std::size_t>(control.vertex_count);
  }
};

}  // namespace facet::face
