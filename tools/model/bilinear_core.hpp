#pragma once

#include <Eigen/Core>
#include <array>
#include <functional>
#include <vector>

#include "mesh/mesh.hpp"

namespace facet::model {

/// One identity's slice of the data tensor: [0] the neutral head, then the displacements of every expression;
/// each [3][vertex_count], mm.
using TensorSlice = std::vector<Eigen::Matrix3Xf>;

/// How the tensor is mirrored at the mid-plane.
struct Mirror {
  std::vector<int> vertex;      ///< [vertex_count]
  std::vector<int> expression;  ///< [expression modes], left and right swapped, [0] = 0
};

/// What a millimetre counts for in the truncation.
struct TensorWeights {
  Eigen::VectorXd vertex;               ///< [vertex_count], above 0
  std::vector<double> expression_mode;  ///< [expression modes]
};

struct CoreOptions {
  double variance = 0.99;  ///< part of the weighted variance that the kept modes explain, unless
  int max_modes = 60;      ///< this many do not reach it (the mean not counted)
};

struct BilinearCore {
  int identity_modes = 0;  ///< the mean counted
  double explained = 0;    ///< part of the weighted variance that the modes explain
  /// [identity_modes][expression modes] of [3][vertex_count]: the mean, then modes at one standard deviation.
  std::vector<TensorSlice> rows;
};

/// The higher-order SVD of the identities x expressions x coordinates tensor, truncated in its identity mode
/// alone [LMV00; VBPP05]: expressions keep their names. Every slice counts together
/// with its mirror image, so the mean is symmetric and every mode is symmetric or antisymmetric.
///
/// slices    consumed: freed as the rows are made
/// tick      called once per finished expression mode and pass, for a progress bar: 2 x expression modes
/// calls
BilinearCore truncate_identity_mode(std::vector<TensorSlice> slices, const Mirror& mirror,
                                    const TensorWeights& weights, const CoreOptions& options,
                                    const std::function<void()>& tick);

/// Root mean square distance, mm, of a slice from its best approximation by the core (weights by projection
/// of the neutral head alone): [0] for the neutral head, [1] mean over the expressions, over the chosen
/// vertices.
std::array<double, 2> approximation_error_mm(const BilinearCore& core, const TensorSlice& slice,
                                             const TensorWeights& weights, const std::vector<int>& vertices);

}  // namespace facet::model
