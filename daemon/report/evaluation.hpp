#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "maths/alignment.hpp"
#include "mesh/mesh_frame.hpp"
#include "render/renderer.hpp"
#include "simulation/truth_mesh.hpp"

namespace facet::report {

/// What may be taken out before a reconstruction is measured. One camera cannot know the scale, so
/// Similarity is the usual choice of the field; it is found for every frame and mesh by itself.
enum class Alignment { None, Rigid, Similarity };

/// A reconstructed mesh of one frame in the camera frame. All arrays per finest vertex.
struct Reconstruction {
  mesh::Vertices vertices_mm;          ///< [3][vertex_count]
  Eigen::Matrix3Xf normals;            ///< [3][vertex_count] unit
  std::vector<std::int32_t> measured;  ///< the vertices to be measured, ascending
  float focal_px = 0;                  ///< of the camera that it was found with; 0: unknown
};

/// How each measured vertex of one mesh compares with the truth.
struct Comparison {
  maths::Similarity truth_from_reconstruction;
  std::vector<float>
      signed_distance_mm;  ///< [measured] to the nearest truth, positive outside of it; NaN: none near
  std::vector<float> normal_error_deg;       ///< [measured] NaN where the distance is
  std::vector<std::int32_t> triangle;        ///< [measured] of the truth, where it is nearest; -1: none near
  std::vector<Eigen::Vector2f> barycentric;  ///< [measured] weights of its second and third corner
};

/// The truth of one frame, ready for queries.
class Truth {
 public:
  /// focal_px   of the true camera; 0: unknown
  explicit Truth(simulation::TruthMesh mesh, float focal_px = 0);

  const simulation::TruthMesh& mesh() const { return mesh_; }
  float focal_px() const { return focal_px_; }
  const render::Raycaster& caster() const { return caster_; }

  /// The nearest point that is reached by walking over the surface from one of its triangles, always nearer:
  /// where a point has moved little since that triangle was nearest, the nearest of all, in a quarter of the
  /// time of the caster's search.
  render::Raycaster::Closest closest_from(std::int32_t triangle, const Eigen::Vector3f& query_mm) const;

 private:
  simulation::TruthMesh mesh_;
  float focal_px_;
  render::Raycaster caster_;
  std::vector<std::int32_t> offsets_;    ///< [vertex_count + 1] into triangles_
  std::vector<std::int32_t> triangles_;  ///< of each vertex
};

/// Measures a mesh: aligns it (start: the truth point at the same pixel, where a focal length is unknown as
/// if the reconstruction's were right, 1.4 times and 0.7 times the true one, and the nearest end counts; then
/// iterated closest points with point-to-plane steps on up to 2,500 vertices [CM92]), then takes each
/// vertex's distance to the nearest point of the truth surface and the angle to its normal there.
Comparison compare(const Reconstruction& reconstruction, const Truth& truth, Alignment alignment);

/// The same under an alignment that is known.
///
/// nearby   of the same measured vertices, not far from here: spares time; null: none
Comparison measure(const Reconstruction& reconstruction, const Truth& truth,
                   const maths::Similarity& truth_from_reconstruction, const Comparison* nearby = nullptr);
/// The same under another alignment than before; vertices that it moves by less than 0.5 mm find the truth by
/// Truth::closest_from.
Comparison measure_again(const Reconstruction& reconstruction, const Truth& truth,
                         const maths::Similarity& truth_from_reconstruction, const Comparison& before);

/// A mesh and its truth, of one frame; both outlive their use.
struct PosedPair {
  const Reconstruction* reconstruction = nullptr;
  const Truth* truth = nullptr;
};
/// compare()'s alignment, one for all frames together; with Alignment::None the identity.
maths::Similarity align_together(const std::vector<PosedPair>& frames, Alignment alignment);
/// The same for one frame, from a given start instead of the truth at the same pixel. For meshes that no
/// camera sees, and for one near another whose alignment is known.
maths::Similarity align_from(const PosedPair& frame, Alignment alignment, const maths::Similarity& start);

/// Refinable face skin of the finest level, seen or not: every control vertex that the vertex depends on is
/// marked Refinable and none is on the open edge. Ascending. Throws as measured_vertices.
std::vector<std::int32_t> face_skin(const mesh::Subject& subject);

/// Vertices to measure, the same for coarse and refined meshes: refinable face skin (every control vertex
/// that a finest vertex depends on is marked Refinable, not on the open edge), turned to the camera by at
/// most 75 degrees, and not hidden behind another part of the coarse mesh.
///
/// subject        with hierarchy and regions
/// coarse_mm      [3][finest vertex_count] camera frame, without displacements
/// coarse_normals [3][finest vertex_count]
/// Throws Error(UnreadableInput) where the subject, of a take from elsewhere, has no regions.
std::vector<std::int32_t> measured_vertices(const mesh::Subject& subject, const mesh::Vertices& coarse_mm,
                                            const Eigen::Matrix3Xf& coarse_normals);

/// Of one frame's points; those that are nowhere near the truth count as in AccuracyFigures.
struct FrameMeans {
  double mm = 0;
  double normal_deg = 0;
};

/// Figures of one kind of mesh over a sequence.
struct AccuracyFigures {
  double mean_mm = 0;
  double std_mm = 0;
  double median_mm = 0;
  double p95_mm = 0;
  double normal_error_deg = 0;
  double flicker_mm = 0;
  double photometric_rms = 0;  ///< NaN where no frame had one
};

/// Gathers comparisons of consecutive frames into figures. One thread.
class FigureSum {
 public:
  /// Adds the next frame. vertices: the measured ones, as in the Reconstruction. Frames come in order of
  /// `index`; a gap starts the flicker anew. photometric_rms: NaN where unknown.
  /// Returns the frame's own; NaN where nothing was measured.
  FrameMeans add(std::int64_t index, const std::vector<std::int32_t>& vertices, const Comparison& comparison,
                 double photometric_rms);

  /// Mean, standard deviation, median and 95th percentile of unsigned distances; mean normal error; flicker:
  /// rms of (e[t-1] - 2 e[t] + e[t+1]) / sqrt(6) over all vertices measured in three frames running, e =
  /// signed distance: the mesh's trembling against the truth's motion; white noise of sigma gives sigma.
  AccuracyFigures figures() const;
  std::uint64_t point_count() const { return count_; }

 private:
  static constexpr double kBin_mm = 0.002;
  std::vector<std::uint64_t> histogram_;
  std::uint64_t count_ = 0;
  double sum_mm_ = 0;
  double sum_squares_mm2_ = 0;
  double sum_normal_deg_ = 0;
  double sum_flicker_mm2_ = 0;
  std::uint64_t flicker_count_ = 0;
  double sum_photometric2_ = 0;
  std::uint64_t photometric_count_ = 0;
  std::int64_t last_index_ = -2;
  std::vector<float> last_;  ///< [vertex] signed distance of the last frame, NaN where not measured
  std::vector<float> last_but_one_;
};

/// |I - R| of [MD19 eq. 2] at every finest vertex: rms over the channels, linear 0 to 1; NaN
/// outside the image or where the vertex faces away.
std::vector<float> vertex_errors(const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                                 const std::vector<float>& albedo, const std::array<float, 9>& lighting,
                                 const CameraIntrinsics& camera, const Frame& image);

/// rms of those errors over some vertices; NaN where none of them has one.
double photometric_rms(const std::vector<float>& vertex_errors, const std::vector<std::int32_t>& vertices);

}  // namespace facet::report
