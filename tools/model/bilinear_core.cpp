#include "model/bilinear_core.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "maths/solve.hpp"

namespace facet::model {
namespace {

using Block = Eigen::MatrixXf;  // [3 x vertex_count][slices]

/// One expression mode of every slice, split into what is the same in the mirror and what changes its sign.
struct Halves {
  Block even;
  Block odd;
};

Halves split(const std::vector<TensorSlice>& slices, const Mirror& mirror, std::size_t mode) {
  const Eigen::Index vertices = slices.front().front().cols();
  const auto count = static_cast<Eigen::Index>(slices.size());
  Halves halves{Block(3 * vertices, count), Block(3 * vertices, count)};
  const auto twin_mode = static_cast<std::size_t>(mirror.expression[mode]);
  for (Eigen::Index s = 0; s < count; ++s) {
    const Eigen::Matrix3Xf& own = slices[static_cast<std::size_t>(s)][mode];
    const Eigen::Matrix3Xf& other = slices[static_cast<std::size_t>(s)][twin_mode];
    for (Eigen::Index v = 0; v < vertices; ++v) {
      const Eigen::Vector3f twin =
          other.col(mirror.vertex[static_cast<std::size_t>(v)]).cwiseProduct(Eigen::Vector3f(-1, 1, 1));
      halves.even.block<3, 1>(3 * v, s) = 0.5F * (own.col(v) + twin);
      halves.odd.block<3, 1>(3 * v, s) = 0.5F * (own.col(v) - twin);
    }
  }
  return halves;
}

Eigen::Matrix3Xf as_vertices(const Eigen::VectorXf& stacked) {
  return stacked.reshaped(3, stacked.size() / 3);
}

/// Root of the weights, once per coordinate.
Eigen::VectorXf coordinate_weights(const TensorWeights& weights, std::size_t mode) {
  Eigen::VectorXf roots(3 * weights.vertex.size());
  for (Eigen::Index v = 0; v < weights.vertex.size(); ++v) {
    roots.segment<3>(3 * v).setConstant(
        static_cast<float>(std::sqrt(weights.vertex[v] * weights.expression_mode[mode])));
  }
  return roots;
}

struct Component {
  double eigenvalue;
  bool even;
  Eigen::Index column;
};

}  // namespace

BilinearCore truncate_identity_mode(std::vector<TensorSlice> slices, const Mirror& mirror,
                                    const TensorWeights& weights, const CoreOptions& options,
                                    const std::function<void()>& tick) {
  const auto count = static_cast<Eigen::Index>(slices.size());
  const std::size_t modes = slices.front().size();

  // Gram matrices of the identity mode's unfolding, centred on the mean.
  Eigen::MatrixXd even_gram = Eigen::MatrixXd::Zero(count, count);
  Eigen::MatrixXd odd_gram = Eigen::MatrixXd::Zero(count, count);
  for (std::size_t mode = 0; mode < modes; ++mode) {
    Halves halves = split(slices, mirror, mode);
    const Eigen::VectorXf roots = coordinate_weights(weights, mode);
    const Eigen::VectorXf mean = halves.even.rowwise().mean();
    halves.even.colwise() -= mean;
    halves.even = roots.asDiagonal() * halves.even;
    halves.odd = roots.asDiagonal() * halves.odd;
    even_gram += Eigen::MatrixXf(halves.even.transpose() * halves.even).cast<double>();
    odd_gram += Eigen::MatrixXf(halves.odd.transpose() * halves.odd).cast<double>();
    tick();
  }
  const maths::SymmetricEigen even = maths::symmetric_eigen(even_gram);
  const maths::SymmetricEigen odd = maths::symmetric_eigen(odd_gram);
  std::vector<Component> components;
  for (Eigen::Index column = 0; column < count; ++column) {
    components.push_back({even.values[column], true, column});
    components.push_back({odd.values[column], false, column});
  }
  std::stable_sort(components.begin(), components.end(),
                   [](const Component& a, const Component& b) { return a.eigenvalue > b.eigenvalue; });
  const double total = even.values.sum() + odd.values.sum();
  std::size_t kept = 0;
  double explained = 0;
  while (kept < components.size() && static_cast<int>(kept) < options.max_modes &&
         explained < options.variance * total) {
    explained += components[kept++].eigenvalue;
  }

  // Mode k at one standard deviation: the samples' combination with its unit eigenvector / sqrt(samples).
  Eigen::MatrixXf even_mix = Eigen::MatrixXf::Zero(count, static_cast<Eigen::Index>(kept));
  Eigen::MatrixXf odd_mix = even_mix;
  for (std::size_t k = 0; k < kept; ++k) {
    const Component& component = components[k];
    const Eigen::VectorXd mix =
        (component.even ? even : odd).vectors.col(component.column) / std::sqrt(static_cast<double>(count));
    (component.even ? even_mix : odd_mix).col(static_cast<Eigen::Index>(k)) = mix.cast<float>();
  }
  BilinearCore core;
  core.identity_modes = static_cast<int>(kept) + 1;
  core.explained = explained / total;
  core.rows.assign(kept + 1, TensorSlice(modes));
  for (std::size_t mode = 0; mode < modes; ++mode) {
    Halves halves = split(slices, mirror, mode);
    const Eigen::VectorXf mean = halves.even.rowwise().mean();
    halves.even.colwise() -= mean;
    const Block mixed = halves.even * even_mix + halves.odd * odd_mix;
    core.rows[0][mode] = as_vertices(mean);
    for (std::size_t k = 0; k < kept; ++k) {
      core.rows[k + 1][mode] = as_vertices(mixed.col(static_cast<Eigen::Index>(k)));
    }
    tick();
  }
  return core;
}

std::array<double, 2> approximation_error_mm(const BilinearCore& core, const TensorSlice& slice,
                                             const TensorWeights& weights, const std::vector<int>& vertices) {
  const Eigen::VectorXf roots = coordinate_weights(weights, 0);
  const auto stacked = [](const Eigen::Matrix3Xf& m) { return m.reshaped(); };
  const Eigen::Index modes = core.identity_modes - 1;
  Eigen::MatrixXf basis(roots.size(), modes);
  for (Eigen::Index k = 0; k < modes; ++k) {
    basis.col(k) = roots.cwiseProduct(stacked(core.rows[static_cast<std::size_t>(k + 1)][0]));
  }
  const Eigen::VectorXf wanted = roots.cwiseProduct(stacked(slice[0] - core.rows[0][0]));
  const Eigen::MatrixXd normal = (basis.transpose() * basis).cast<double>();
  const Eigen::VectorXf identity =
      maths::solve_symmetric(normal, (basis.transpose() * wanted).cast<double>()).cast<float>();
  std::array<double, 2> error{};
  for (std::size_t mode = 0; mode < slice.size(); ++mode) {
    Eigen::Matrix3Xf rest = slice[mode] - core.rows[0][mode];
    for (Eigen::Index k = 0; k < modes; ++k) {
      rest -= identity[k] * core.rows[static_cast<std::size_t>(k + 1)][mode];
    }
    double sum = 0;
    for (const int v : vertices) {
      sum += static_cast<double>(rest.col(v).squaredNorm());
    }
    const double rms = std::sqrt(sum / static_cast<double>(vertices.size()));
    error[mode == 0 ? 0 : 1] += mode == 0 ? rms : rms / static_cast<double>(slice.size() - 1);
  }
  return error;
}

}  // namespace facet::model
