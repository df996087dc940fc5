#include "reference.hpp"

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>

namespace facet::refine::reference {
namespace {

struct Ring {
  const std::int32_t* vertices;
  Eigen::Index size;
  bool closed;
};

Ring ring_of(const mesh::OneRings& rings, Eigen::Index vertex) {
  const auto v = static_cast<std::size_t>(vertex);
  return {rings.neighbours.data() + rings.offsets[v], rings.offsets[v + 1] - rings.offsets[v],
          rings.on_boundary[v] == 0};
}

Eigen::Vector3d displaced(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                          Eigen::Index vertex) {
  return problem.vertices_mm.col(vertex) + displacements_mm[vertex] * problem.normals.col(vertex);
}

}  // namespace

Lighting sh_basis(const Eigen::Vector3d& n) {
  Lighting out;
  out << 1, n.x(), n.y(), n.z(), n.x() * n.y(), n.x() * n.z(), n.y() * n.z(), n.x() * n.x() - n.y() * n.y(),
      3 * n.z() * n.z() - 1;
  return out;
}

Matrix39d sh_gradient(const Eigen::Vector3d& n) {
  Matrix39d out;
  out << 0, 1, 0, 0, n.y(), n.z(), 0, 2 * n.x(), 0,  //
      0, 0, 1, 0, n.x(), 0, n.z(), -2 * n.y(), 0,    //
      0, 0, 0, 1, 0, n.x(), n.y(), 0, 6 * n.z();
  return out;
}

Eigen::Vector3d reflected(const Lighting& lighting, const Eigen::Vector3d& normal,
                          const Eigen::Vector3d& albedo) {
  return lighting.dot(sh_basis(normal)) * albedo;
}

double lit_by_lamps(const Eigen::Vector4d& irradiance, const Eigen::Vector3d& normal) {
  return irradiance[0] + irradiance.tail<3>().dot(normal);
}

Eigen::Vector3d reflected(const Problem& problem, const Eigen::Vector3d& normal, Eigen::Index vertex) {
  Eigen::Vector3d out = reflected(problem.lighting, normal, problem.albedo.col(vertex));
  if (problem.irradiance.cols() > 0) {
    out += lit_by_lamps(problem.irradiance.col(vertex), normal) * problem.albedo.col(vertex);
  }
  return out;
}

Eigen::VectorXd ring_spacing(const mesh::OneRings& rings, const Eigen::Matrix3Xd& vertices_mm) {
  Eigen::VectorXd out(vertices_mm.cols());
  for (Eigen::Index i = 0; i < out.size(); ++i) {
    const Ring ring = ring_of(rings, i);
    double sum = 0;
    for (Eigen::Index k = 0; k < ring.size; ++k) {
      sum += (vertices_mm.col(ring.vertices[k]) - vertices_mm.col(i)).norm();
    }
    out[i] = sum / static_cast<double>(ring.size);
  }
  return out;
}

Eigen::Vector3d displaced_normal(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                                 Eigen::Index vertex) {
  const Ring ring = ring_of(*problem.rings, vertex);
  const Eigen::Vector3d centre = displaced(problem, displacements_mm, vertex);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  const Eigen::Index triangles = ring.closed ? ring.size : ring.size - 1;
  for (Eigen::Index k = 0; k < triangles; ++k) {
    const Eigen::Vector3d a = displaced(problem, displacements_mm, ring.vertices[k]) - centre;
    const Eigen::Vector3d b =
        displaced(problem, displacements_mm, ring.vertices[(k + 1) % ring.size]) - centre;
    sum += a.cross(b);
  }
  return sum;
}

Eigen::Matrix3Xd displaced_normals(const Problem& problem, const Eigen::VectorXd& displacements_mm) {
  Eigen::Matrix3Xd out(3, problem.vertex_count());
  for (Eigen::Index i = 0; i < out.cols(); ++i) {
    out.col(i) = displaced_normal(problem, displacements_mm, i).normalized();
  }
  return out;
}

Eigen::Matrix3Xd coarse_normals(const mesh::OneRings& rings, const Eigen::Matrix3Xd& vertices_mm) {
  Problem flat;
  flat.rings = &rings;
  flat.vertices_mm = vertices_mm;
  flat.normals = Eigen::Matrix3Xd::Zero(3, vertices_mm.cols());
  return displaced_normals(flat, Eigen::VectorXd::Zero(vertices_mm.cols()));
}

double graph_laplacian(const mesh::OneRings& rings, const Eigen::VectorXd& values, Eigen::Index vertex) {
  const Ring ring = ring_of(rings, vertex);
  double sum = 0;
  for (Eigen::Index k = 0; k < ring.size; ++k) {
    sum += values[ring.vertices[k]];
  }
  return values[vertex] - sum / static_cast<double>(ring.size);
}

double tukey_weight(double residual, double scale) {
  if (scale <= 0) {
    return 1;
  }
  const double t = 1 - residual * residual / (scale * scale);
  return t > 0 ? t * t : 0;
}

double tukey_loss(double residual, double scale) {
  if (scale <= 0) {
    return residual * residual;
  }
  const double t = std::max(0.0, 1 - residual * residual / (scale * scale));
  return scale * scale / 3 * (1 - t * t * t);
}

double fold_weight(double bend, double slope) {
  return slope > 0 ? 1 / std::sqrt(1 + bend * bend / (slope * slope)) : 1;
}

double fold_loss(double bend, double slope) {
  return slope > 0 ? 2 * slope * slope * (std::sqrt(1 + bend * bend / (slope * slope)) - 1) : bend * bend;
}

Eigen::VectorXd step_weights(const Problem& problem, const Eigen::VectorXd& displacements_mm) {
  const Eigen::Index count = problem.vertex_count();
  Eigen::VectorXd out = Eigen::VectorXd::Zero(2 * count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const double bend = graph_laplacian(*problem.rings, displacements_mm, i) / problem.spacing_mm[i];
    out[count + i] = problem.smooth_weight * fold_weight(bend, problem.fold_slope);
    if (problem.data_weight[i] > 0) {
      const Eigen::Vector3d normal = displaced_normal(problem, displacements_mm, i).normalized();
      const double residual = (problem.colours.col(i) - reflected(problem, normal, i)).norm();
      out[i] = problem.data_weight[i] * tukey_weight(residual, problem.robust_scale);
    }
  }
  return out;
}

double energy(const Problem& problem, const Eigen::VectorXd& displacements_mm) {
  double sum = 0;
  for (Eigen::Index i = 0; i < problem.vertex_count(); ++i) {
    if (problem.data_weight[i] > 0) {
      const Eigen::Vector3d normal = displaced_normal(problem, displacements_mm, i).normalized();
      const double residual = (problem.colours.col(i) - reflected(problem, normal, i)).norm();
      sum += problem.data_weight[i] * tukey_loss(residual, problem.robust_scale);
    }
    const double bend = graph_laplacian(*problem.rings, displacements_mm, i) / problem.spacing_mm[i];
    const double detail = (problem.prolonged_mm[i] - displacements_mm[i]) / problem.spacing_mm[i];
    sum += problem.smooth_weight * fold_loss(bend, problem.fold_slope) +
           problem.hierarchy_weight * detail * detail +
           problem.coarse_weight * displacements_mm[i] * displacements_mm[i];
  }
  return sum;
}

Eigen::VectorXd residuals(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                          const Eigen::VectorXd& weights) {
  const Eigen::Index count = problem.vertex_count();
  Eigen::VectorXd out = Eigen::VectorXd::Zero(6 * count);
  for (Eigen::Index i = 0; i < count; ++i) {
    if (weights[i] > 0) {
      const Eigen::Vector3d normal = displaced_normal(problem, displacements_mm, i).normalized();
      out.segment<3>(3 * i) =
          std::sqrt(weights[i]) * (problem.colours.col(i) - reflected(problem, normal, i));
    }
    const double spacing = problem.spacing_mm[i];
    out[3 * count + i] =
        -std::sqrt(weights[count + i]) * graph_laplacian(*problem.rings, displacements_mm, i) / spacing;
    out[4 * count + i] =
        std::sqrt(problem.hierarchy_weight) * (problem.prolonged_mm[i] - displacements_mm[i]) / spacing;
    out[5 * count + i] = -std::sqrt(problem.coarse_weight) * displacements_mm[i];
  }
  return out;
}

Eigen::SparseMatrix<double> jacobian(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                                     const Eigen::VectorXd& weights) {
  const Eigen::Index count = problem.vertex_count();
  std::vector<Eigen::Triplet<double>> entries;
  const auto add = [&](Eigen::Index row, Eigen::Index vertex, double value) {
    if (problem.fixed[static_cast<std::size_t>(vertex)] == 0) {
      entries.emplace_back(static_cast<int>(row), static_cast<int>(vertex), value);
    }
  };
  for (Eigen::Index i = 0; i < count; ++i) {
    const Ring ring = ring_of(*problem.rings, i);
    const Eigen::Vector3d centre = displaced(problem, displacements_mm, i);
    if (weights[i] > 0) {
      const Eigen::Vector3d star = displaced_normal(problem, displacements_mm, i);
      const Eigen::Vector3d normal = star.normalized();
      const Eigen::Matrix3d unit_from_star =
          (Eigen::Matrix3d::Identity() - normal * normal.transpose()) / star.norm();
      Eigen::Vector3d slope = sh_gradient(normal) * problem.lighting;
      if (problem.irradiance.cols() > 0) {
        slope += problem.irradiance.col(i).tail<3>();
      }
      const Eigen::RowVector3d shade_from_star = slope.transpose() * unit_from_star;
      const auto data = [&](Eigen::Index vertex, const Eigen::Vector3d& star_change) {
        const double shade_change = shade_from_star * star_change;
        for (int channel = 0; channel < 3; ++channel) {
          add(3 * i + channel, vertex, std::sqrt(weights[i]) * problem.albedo(channel, i) * shade_change);
        }
      };
      const Eigen::Index triangles = ring.closed ? ring.size : ring.size - 1;
      for (Eigen::Index k = 0; k < triangles; ++k) {
        const Eigen::Index vj = ring.vertices[k];
        const Eigen::Index vk = ring.vertices[(k + 1) % ring.size];
        const Eigen::Vector3d a = displaced(problem, displacements_mm, vj) - centre;
        const Eigen::Vector3d b = displaced(problem, displacements_mm, vk) - centre;
        const Eigen::Vector3d ni = problem.normals.col(i);
        data(vj, Eigen::Vector3d(problem.normals.col(vj)).cross(b));
        data(vk, a.cross(Eigen::Vector3d(problem.normals.col(vk))));
        data(i, -ni.cross(b) - a.cross(ni));
      }
    }
    const double spacing = problem.spacing_mm[i];
    const double bend = std::sqrt(weights[count + i]) / spacing;
    add(3 * count + i, i, bend);
    for (Eigen::Index k = 0; k < ring.size; ++k) {
      add(3 * count + i, ring.vertices[k], -bend / static_cast<double>(ring.size));
    }
    add(4 * count + i, i, std::sqrt(problem.hierarchy_weight) / spacing);
    add(5 * count + i, i, std::sqrt(problem.coarse_weight));
  }
  Eigen::SparseMatrix<double> out(6 * count, count);
  out.setFromTriplets(entries.begin(), entries.end());
  return out;
}

DerivativeCheck check_jacobian(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                               const Eigen::SparseMatrix<double>& jacobian) {
  constexpr double kStepMm = 1e-5;
  const Eigen::VectorXd weights = step_weights(problem, displacements_mm);
  const double largest = jacobian.coeffs().abs().maxCoeff();
  DerivativeCheck out;
  for (Eigen::Index vertex = 0; vertex < problem.vertex_count(); ++vertex) {
    if (problem.fixed[static_cast<std::size_t>(vertex)] != 0) {
      continue;
    }
    Eigen::VectorXd plus = displacements_mm;
    Eigen::VectorXd minus = displacements_mm;
    plus[vertex] += kStepMm;
    minus[vertex] -= kStepMm;
    // residuals are y - f, so that df/dd is minus their derivative
    const Eigen::VectorXd numeric =
        (residuals(problem, minus, weights) - residuals(problem, plus, weights)) / (2 * kStepMm);
    const Eigen::VectorXd difference = numeric - Eigen::VectorXd(jacobian.col(vertex));
    Eigen::Index row = 0;
    const double error = difference.cwiseAbs().maxCoeff(&row) / largest;
    if (!(error <= out.worst_error)) {
      out.worst_error = error;
      out.where = "row " + std::to_string(row) + ", vertex " + std::to_string(vertex);
    }
  }
  return out;
}

Eigen::VectorXd pcg(const Eigen::SparseMatrix<double>& jacobian, const Eigen::VectorXd& residuals,
                    int iterations) {
  Eigen::VectorXd inverse_diagonal(jacobian.cols());
  for (Eigen::Index i = 0; i < jacobian.cols(); ++i) {
    const double diagonal = jacobian.col(i).squaredNorm();
    inverse_diagonal[i] = diagonal > 0 ? 1 / diagonal : 0;
  }
  Eigen::VectorXd x = Eigen::VectorXd::Zero(jacobian.cols());
  Eigen::VectorXd r = jacobian.transpose() * residuals;
  Eigen::VectorXd z = inverse_diagonal.cwiseProduct(r);
  Eigen::VectorXd p = z;
  double rz = r.dot(z);
  // Beyond double precision: further steps divide what has underflowed.
  const double least = 1e-30 * rz;
  for (int k = 0; k < iterations && rz > least; ++k) {
    const Eigen::VectorXd jp = jacobian * p;
    const double alpha = rz / jp.squaredNorm();
    x += alpha * p;
    r -= alpha * (jacobian.transpose() * jp);
    z = inverse_diagonal.cwiseProduct(r);
    const double rz_next = r.dot(z);
    p = z + rz_next / rz * p;
    rz = rz_next;
  }
  return x;
}

Eigen::VectorXd gauss_newton_step(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                                  int pcg_iterations) {
  const Eigen::VectorXd weights = step_weights(problem, displacements_mm);
  const Eigen::SparseMatrix<double> j = jacobian(problem, displacements_mm, weights);
  const Eigen::VectorXd r = residuals(problem, displacements_mm, weights);
  if (pcg_iterations > 0) {
    return displacements_mm + pcg(j, r, pcg_iterations);
  }
  Eigen::SparseMatrix<double> normal = j.transpose() * j;
  for (Eigen::Index i = 0; i < normal.cols(); ++i) {
    if (problem.fixed[static_cast<std::size_t>(i)] != 0) {
      normal.coeffRef(i, i) = 1;
    }
  }
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(normal);
  return displacements_mm + factor.solve(j.transpose() * r);
}

RoomLighting estimate_lighting(const Eigen::Matrix3Xd& normals, const Eigen::VectorXd& lamps,
                               const Eigen::Matrix3Xd& albedo, const Eigen::Matrix3Xd& colours,
                               const Eigen::VectorXd& weights, double temporal_weight,
                               const RoomLighting& previous) {
  const Eigen::Index count = normals.cols();
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(3 * count + 10, 10);
  Eigen::VectorXd b(3 * count + 10);
  for (Eigen::Index i = 0; i < count; ++i) {
    const double root = std::sqrt(weights[i]);
    a.block<3, 9>(3 * i, 0) = root * albedo.col(i) * sh_basis(normals.col(i)).transpose();
    a.block<3, 1>(3 * i, 9) = root * lamps[i] * albedo.col(i);
    b.segment<3>(3 * i) = root * colours.col(i);
  }
  RoomLighting roots = RoomLighting::Constant(std::sqrt(temporal_weight));
  // In the unit of the factor: what the frame says of it, as temporal_weight is in that of sum w |rho|^2.
  roots[9] *= a.col(9).norm() / std::sqrt(weights.dot(albedo.colwise().squaredNorm().transpose()));
  a.bottomRows<10>() = roots.asDiagonal();
  b.tail<10>() = roots.cwiseProduct(previous);
  return a.householderQr().solve(b);
}

Eigen::Matrix3Xd estimate_albedo(const mesh::OneRings& rings, const Eigen::VectorXd& shade_squared,
                                 const Eigen::Matrix3Xd& shade_colour, const Eigen::Matrix3Xd& mean_albedo,
                                 double smooth_weight) {
  const Eigen::Index count = shade_squared.size();
  std::vector<Eigen::Triplet<double>> entries;
  for (Eigen::Index i = 0; i < count; ++i) {
    const Ring ring = ring_of(rings, i);
    entries.emplace_back(static_cast<int>(i), static_cast<int>(i), 1.0);
    for (Eigen::Index k = 0; k < ring.size; ++k) {
      entries.emplace_back(static_cast<int>(i), ring.vertices[k], -1.0 / static_cast<double>(ring.size));
    }
  }
  Eigen::SparseMatrix<double> laplacian(count, count);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  const Eigen::SparseMatrix<double> smooth = smooth_weight * laplacian.transpose() * laplacian;
  Eigen::SparseMatrix<double> normal = smooth;
  for (Eigen::Index i = 0; i < count; ++i) {
    normal.coeffRef(i, i) += shade_squared[i];
  }
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(normal);
  const Eigen::MatrixXd right = shade_colour.transpose() + smooth * mean_albedo.transpose();
  return factor.solve(right).transpose();
}

}  // namespace facet::refine::reference
