#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "maths/alignment.hpp"
#include "mesh/mesh_frame.hpp"
#include "report/evaluation.hpp"

namespace facet::report {

/// How far along its normals each measured vertex of an aligned mesh stands from the truth: the displacement
/// that the refinement should have found there.
///
/// mesh               without displacements, as measured
/// truth_from_mesh    of its Comparison
/// returns            [vertex_count] mm at the mesh's scale; NaN where not measured or not within 6 mm
std::vector<float> true_displacements_mm(const Reconstruction& mesh, const maths::Similarity& truth_from_mesh,
                                         const Truth& truth);

/// What a recovered field has of a true one, over any points. One thread.
class FieldSum {
 public:
  void add(double truth, double recovered);
  void add(std::span<const float> truth, std::span<const float> recovered);

  std::uint64_t point_count() const { return count_; }
  /// Pearson's. NaN without points or where one of the two is the same everywhere.
  double correlation() const;
  /// The slope of the regression of recovered on truth: 1 where it comes out as deep as it is.
  double depth() const;
  /// rms of truth: the error of a mesh that recovers nothing. NaN without points.
  double true_rms() const;
  /// rms of recovered minus truth. NaN without points.
  double error_rms() const;

 private:
  std::uint64_t count_ = 0;
  std::array<double, 5> sums_{};  ///< of t, r, t t, r r, t r
};

/// True and recovered displacements of the points of one band.
struct BandField {
  std::vector<std::int32_t> vertices;  ///< of the finest level, ascending
  std::vector<float> true_mm;          ///< [vertices]
  std::vector<float> recovered_mm;     ///< [vertices]
};

/// True and recovered displacements, band by band. G_s: the half-ring average over measured vertices alone,
/// repeated until it is as wide as a Gaussian of s mm at their mean spacing.
struct BandFields {
  BandField whole;     ///< as they are, at every measured point
  BandField middle;    ///< G_4 x - G_15 x: forms of 4 to 15 mm, at one point of every cube of 3 mm; G_15 is a
                       ///< Gaussian over these points, by their straight distance
  BandField wrinkles;  ///< G_0.6 x - G_4 x, where sqrt(G_4 of the truth's square) is above 0.08 mm: folds and
                       ///< their banks
};

/// Splits the displacements of one frame.
///
/// rings          of the mesh's level
/// mesh           without displacements, as measured
/// true_mm        [vertex_count] true_displacements_mm
/// recovered_mm   [vertex_count] the refinement's
BandFields split_bands(const mesh::OneRings& rings, const Reconstruction& mesh,
                       const std::vector<float>& true_mm, std::span<const float> recovered_mm);

/// The band of wrinkles alone.
BandField split_wrinkles(const mesh::OneRings& rings, const Reconstruction& mesh,
                         const std::vector<float>& true_mm, std::span<const float> recovered_mm);

/// Applies the half-ring average P = (I + W) / 2 to fields over some vertices, W the average over a vertex's
/// neighbours among them (itself where it has none). One thread.
class RingSmoother {
 public:
  /// vertices   that count, ascending; rings   of the whole level
  RingSmoother(const mesh::OneRings& rings, const std::vector<std::int32_t>& vertices);

  /// P^rounds of each row of fields [2][vertices], to 1e-5 of its range, in about 3.4 sqrt(rounds) averages
  /// instead of `rounds`: P^n = sum over k of (2 - [k = 0]) C(2n, n + k) / 4^n T_k(W), T_k Chebyshev's
  /// polynomials, since cos(x / 2)^2n is that sum of cos(k x).
  void smooth(Eigen::Matrix2Xf& fields, int rounds) const;

 private:
  void average(const Eigen::Matrix2Xf& fields, Eigen::Matrix2Xf& out) const;

  std::vector<std::int32_t> offsets_;     ///< [vertices + 1]
  std::vector<std::int32_t> neighbours_;  ///< places in `vertices`
};

/// Compares recovered with true displacements at the width of wrinkles, where the truth has some. One thread.
class WrinkleSum {
 public:
  /// Adds a frame; arguments as in split_wrinkles.
  void add(const mesh::OneRings& rings, const Reconstruction& mesh, const std::vector<float>& true_mm,
           std::span<const float> recovered_mm);

  double correlation() const { return sum_.correlation(); }
  double depth() const { return sum_.depth(); }
  std::uint64_t point_count() const { return sum_.point_count(); }

 private:
  FieldSum sum_;
};

}  // namespace facet::report
