#include "reference.hpp"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <array>
#include <cmath>

namespace facet::stereo::reference {
namespace {

double at(const std::vector<float>& values, std::size_t voxel) {
  return static_cast<double>(values[voxel]);
}

struct Sample {
  Eigen::Vector4d offset;  // 1, u, v, s
  double left, right, slope, field;
};

/// Both pictures through the cubic B-spline, by its recursion.
double spline(double x) {
  const double a = std::abs(x);
  if (a >= 2) {
    return 0;
  }
  return a < 1 ? 2.0 / 3 - a * a + a * a * a / 2 : (2 - a) * (2 - a) * (2 - a) / 6;
}

std::vector<Sample> samples_of(const Volume& volume, const Eigen::VectorXd& field,
                               const SpacetimeOptions& options, int x0, int y0, int t0) {
  const VolumeSize& size = volume.size;
  std::vector<Sample> out;
  for (int t = std::max(0, t0 - options.window_t / 2);
       t <= std::min(size.slots - 1, t0 + options.window_t / 2); ++t) {
    for (int y = std::max(0, y0 - options.window_y / 2);
         y <= std::min(size.height_px - 1, y0 + options.window_y / 2); ++y) {
      for (int x = std::max(1, x0 - options.window_x / 2);
           x <= std::min(size.width_px - 2, x0 + options.window_x / 2); ++x) {
        const std::size_t voxel = size.voxel(x, y, t);
        if (std::isnan(volume.start_px[voxel]) || volume.left[voxel - 1] < 0 || volume.left[voxel] < 0 ||
            volume.left[voxel + 1] < 0) {
          continue;
        }
        const double d = field[static_cast<Eigen::Index>(voxel)];
        const auto right_at = [&](double where, bool& valid) {
          const int corner = static_cast<int>(std::floor(where));
          double sum = 0;
          valid = corner >= 1 && corner + 2 < size.width_px;
          for (int k = corner - 1; valid && k <= corner + 2; ++k) {
            const double value = at(volume.right, size.voxel(k, y, t));
            valid = value >= 0;
            sum += spline(where - k) * value;
          }
          return sum;
        };
        bool valid = false;
        const double right = right_at(x - d, valid);
        if (!valid) {
          continue;
        }
        // The slope by differences within the spline's piece and a little beyond: it is smooth.
        constexpr double h = 1e-4;
        bool ignored = false;
        double ahead = right_at(x - d - h, ignored);
        double behind = right_at(x - d + h, valid);
        if (!ignored || !valid) {
          continue;
        }
        Sample sample;
        sample.offset = {1, static_cast<double>(x - x0), static_cast<double>(y - y0),
                         static_cast<double>(t - t0)};
        sample.left =
            (at(volume.left, voxel - 1) + 4 * at(volume.left, voxel) + at(volume.left, voxel + 1)) / 6;
        sample.right = right;
        sample.slope = (ahead - behind) / (2 * h);
        sample.field = d;
        out.push_back(sample);
      }
    }
  }
  return out;
}

}  // namespace

Eigen::MatrixXd slope_matrix(const Volume& volume, float break_px, std::size_t voxel) {
  const VolumeSize& size = volume.size;
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(4, static_cast<Eigen::Index>(size.voxels()));
  rows(0, static_cast<Eigen::Index>(voxel)) = 1;
  const std::array<std::size_t, 3> stride{1, static_cast<std::size_t>(size.width_px), size.slot_voxels()};
  const std::array<int, 3> extent{size.width_px, size.height_px, size.slots};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto place = static_cast<int>(voxel / stride[axis]) % extent[axis];
    const auto linked = [&](bool there, std::size_t other) {
      return there && std::abs(volume.start_px[voxel] - volume.start_px[other]) <= break_px;
    };
    const bool before = linked(place > 0, voxel - stride[axis]);
    const bool after = linked(place + 1 < extent[axis], voxel + stride[axis]);
    if (before || after) {
      const std::size_t last = after ? voxel + stride[axis] : voxel;
      const std::size_t first = before ? voxel - stride[axis] : voxel;
      const double quotient = before && after ? 0.5 : 1;
      rows(static_cast<Eigen::Index>(axis) + 1, static_cast<Eigen::Index>(last)) += quotient;
      rows(static_cast<Eigen::Index>(axis) + 1, static_cast<Eigen::Index>(first)) -= quotient;
    }
  }
  return rows;
}

Window window_at(const Volume& volume, const Eigen::VectorXd& field, const SpacetimeOptions& options, int x,
                 int y, int slot) {
  Window out;
  const std::size_t voxel = volume.size.voxel(x, y, slot);
  if (std::isnan(volume.start_px[voxel])) {
    return out;
  }
  const std::vector<Sample> samples = samples_of(volume, field, options, x, y, slot);
  const auto n = static_cast<Eigen::Index>(samples.size());
  if (2 * static_cast<int>(n) < options.window_x * options.window_y) {
    return out;
  }
  // l - gain w - bias = 0 by least squares, then everything projected off (1, w).
  Eigen::MatrixXd known(n, 2);
  Eigen::VectorXd left(n);
  Eigen::MatrixXd columns(n, 4);
  Eigen::VectorXd of_field(n);
  Eigen::VectorXd squares(n);
  Eigen::VectorXd fields(n);
  Eigen::MatrixXd offsets(n, 4);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Sample& sample = samples[static_cast<std::size_t>(i)];
    known.row(i) << 1, sample.right;
    left[i] = sample.left;
    columns.row(i) = sample.slope * sample.offset.transpose();
    of_field[i] = sample.slope * sample.field;
    squares[i] = sample.slope * sample.slope;
    fields[i] = sample.field;
    offsets.row(i) = sample.offset.transpose();
  }
  const auto contrast = [&](const Eigen::VectorXd& values) {
    return std::sqrt((values.array() - values.mean()).square().mean());
  };
  if (contrast(left) < static_cast<double>(options.least_texture) ||
      contrast(known.col(1)) < static_cast<double>(options.least_texture)) {
    return out;
  }
  const Eigen::HouseholderQR<Eigen::MatrixXd> factor(known);
  const Eigen::Vector2d bias_gain = factor.solve(left);
  const double gain = bias_gain[1];
  if (gain <= 0) {
    return out;
  }
  const Eigen::VectorXd residual = left - known * bias_gain;
  const Eigen::MatrixXd projected = gain * (columns - known * factor.solve(columns));
  const Eigen::VectorXd projected_field = gain * (of_field - known * factor.solve(of_field));
  const Eigen::Vector4d p = slope_matrix(volume, options.break_px, voxel) * field;
  const double noise = static_cast<double>(options.noise);
  const double weight = 1 / (residual.squaredNorm() / static_cast<double>(n) + noise * noise);
  // How far the field strays from the window's plane.
  const Eigen::VectorXd stray = offsets * p - fields;
  const double spread = (squares.array() * stray.array().square()).sum() / squares.sum();
  const double straddle = static_cast<double>(options.straddle_px);
  const double bend = 1 / (1 + spread / (straddle * straddle));
  out.speaks = true;
  out.hessian = weight * projected.transpose() * projected;
  out.gradient = -weight * projected.transpose() * (residual - bend * (projected * p - projected_field));
  out.energy = weight * residual.squaredNorm();
  return out;
}

Eigen::VectorXd step(const Volume& volume, const Eigen::VectorXd& field, const SpacetimeOptions& options) {
  const auto count = static_cast<Eigen::Index>(volume.size.voxels());
  Eigen::MatrixXd system = Eigen::MatrixXd::Zero(count, count);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(count);
  for (int t = 0; t < volume.size.slots; ++t) {
    for (int y = 0; y < volume.size.height_px; ++y) {
      for (int x = 0; x < volume.size.width_px; ++x) {
        const Window window = window_at(volume, field, options, x, y, t);
        if (window.speaks) {
          // Few columns of the slope matrix are not 0.
          const Eigen::MatrixXd rows = slope_matrix(volume, options.break_px, volume.size.voxel(x, y, t));
          std::vector<Eigen::Index> used;
          for (Eigen::Index column = 0; column < count; ++column) {
            if (rows.col(column).squaredNorm() > 0) {
              used.push_back(column);
            }
          }
          for (const Eigen::Index a : used) {
            right[a] -= rows.col(a).dot(window.gradient);
            for (const Eigen::Index b : used) {
              system(a, b) += rows.col(a).dot(window.hessian * rows.col(b));
            }
          }
        }
      }
    }
  }
  for (Eigen::Index i = 0; i < count; ++i) {
    if (std::isnan(volume.start_px[static_cast<std::size_t>(i)])) {
      system.row(i).setZero();
      system.col(i).setZero();
      right[i] = 0;
    }
    system(i, i) += static_cast<double>(options.damping);
  }
  return system.ldlt().solve(right);
}

double energy(const Volume& volume, const Eigen::VectorXd& field, const SpacetimeOptions& options) {
  double sum = 0;
  for (int t = 0; t < volume.size.slots; ++t) {
    for (int y = 0; y < volume.size.height_px; ++y) {
      for (int x = 0; x < volume.size.width_px; ++x) {
        sum += window_at(volume, field, options, x, y, t).energy;
      }
    }
  }
  return sum;
}

}  // namespace facet::stereo::reference
