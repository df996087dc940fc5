#include "report/evaluation.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "face/face_model.hpp"
#include "facet/error.hpp"

namespace facet::report {
namespace {

using Eigen::Vector3f;
using maths::Similarity;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kReach_mm = 50;  // a vertex farther from the truth than this counts as measured at kReach_mm
constexpr std::size_t kAlignmentPoints = 2500;
constexpr int kAlignmentSteps = 40;
constexpr float kSteepest = 0.2588F;  // cosine of 75 degrees

/// The transform after `step`.
maths::Similarity compose(const maths::Similarity& step, const maths::Similarity& first) {
  return {step.scale * first.scale, step.rotation * first.rotation, step * first.translation_mm};
}

Vector3f normal_at(const simulation::TruthMesh& mesh, std::int32_t triangle,
                   const Eigen::Vector2f& barycentric) {
  return render::interpolate(mesh.triangles, triangle, barycentric, mesh.normals).normalized();
}

/// Pairs a vertex with the truth that the camera sees through it, which is near whatever the depth and scale
/// are.
maths::Similarity start_of_alignment(const std::vector<Vector3f>& points, const Truth& truth,
                                     bool with_scale) {
  std::vector<Vector3f> from;
  std::vector<Vector3f> to;
  for (const Vector3f& point : points) {
    const Vector3f direction = point.normalized();
    const auto hit = truth.caster().first_hit({0, 0, 0}, direction, 1, true);
    if (hit.triangle >= 0) {
      from.push_back(point);
      to.emplace_back(hit.distance_mm * direction);
    }
  }
  Eigen::Matrix3Xf from_mm(3, static_cast<Eigen::Index>(from.size()));
  Eigen::Matrix3Xf to_mm(3, static_cast<Eigen::Index>(to.size()));
  for (std::size_t k = 0; k < from.size(); ++k) {
    from_mm.col(static_cast<Eigen::Index>(k)) = from[k];
    to_mm.col(static_cast<Eigen::Index>(k)) = to[k];
  }
  return maths::best_similarity(from_mm, to_mm, with_scale);
}

/// One point-to-plane step [CM92]: small rotation, shift and scale about the points' centre
/// that minimise the distances to the tangent planes at the closest points. False where nothing is near.
bool point_to_plane_step(const std::vector<Vector3f>& points, const Truth& truth, bool with_scale,
                         maths::Similarity& transform, float& moved_mm) {
  Eigen::Matrix<double, 7, 7> normal_matrix = Eigen::Matrix<double, 7, 7>::Zero();
  Eigen::Matrix<double, 7, 1> right_side = Eigen::Matrix<double, 7, 1>::Zero();
  Vector3f centre = Vector3f::Zero();
  for (const Vector3f& point : points) {
    centre += transform * point;
  }
  centre /= static_cast<float>(points.size());
  float radius2_mm2 = 0;
  int used = 0;
  for (const Vector3f& point : points) {
    const Vector3f at = transform * point;
    const auto closest = truth.caster().closest_point(at, kReach_mm);
    if (closest.triangle < 0) {
      continue;
    }
    const Vector3f normal = normal_at(truth.mesh(), closest.triangle, closest.barycentric);
    const Vector3f arm = at - centre;
    Eigen::Matrix<double, 7, 1> row;
    row << arm.cross(normal).cast<double>(), normal.cast<double>(),
        with_scale ? static_cast<double>(arm.dot(normal)) : 0.0;
    normal_matrix += row * row.transpose();
    right_side += row * static_cast<double>((closest.point_mm - at).dot(normal));
    radius2_mm2 += arm.squaredNorm();
    ++used;
  }
  if (used < 7) {
    return false;
  }
  radius2_mm2 /= static_cast<float>(used);
  // Damping as if every hundredth point also wanted to stay: spheres and planes leave motions open.
  const double damping = 1e-3 * used;
  normal_matrix.diagonal().head<3>().array() += damping * static_cast<double>(radius2_mm2);
  normal_matrix.diagonal().segment<3>(3).array() += damping;
  normal_matrix(6, 6) += damping * static_cast<double>(radius2_mm2);
  const Eigen::Matrix<float, 7, 1> solved = normal_matrix.ldlt().solve(right_side).cast<float>();
  const Vector3f turn = solved.head<3>();
  maths::Similarity step;
  step.scale = 1 + solved[6];
  if (turn.norm() > 0) {
    step.rotation = Eigen::AngleAxisf(turn.norm(), turn.normalized()).toRotationMatrix();
  }
  step.translation_mm = centre + solved.segment<3>(3) - step.scale * (step.rotation * centre);
  transform = compose(step, transform);
  moved_mm = solved.segment<3>(3).norm() + (turn.norm() + std::abs(solved[6])) * std::sqrt(radius2_mm2);
  return true;
}

maths::Similarity align(const Reconstruction& reconstruction, const Truth& truth, bool with_scale) {
  std::vector<Vector3f> points;
  const std::size_t stride = reconstruction.measured.size() / kAlignmentPoints + 1;
  for (std::size_t k = 0; k < reconstruction.measured.size(); k += stride) {
    points.emplace_back(reconstruction.vertices_mm.col(reconstruction.measured[k]));
  }
  maths::Similarity transform = start_of_alignment(points, truth, with_scale);
  constexpr float kStill_mm = 1e-4F;
  float moved_mm = kReach_mm;
  for (int step = 0; step < kAlignmentSteps && moved_mm > kStill_mm; ++step) {
    if (!point_to_plane_step(points, truth, with_scale, transform, moved_mm)) {
      break;
    }
  }
  return transform;
}

}  // namespace

Truth::Truth(simulation::TruthMesh mesh)
    : mesh_(std::move(mesh)), caster_(mesh_.vertices_mm, mesh_.triangles) {}

Comparison compare(const Reconstruction& reconstruction, const Truth& truth, Alignment alignment) {
  Comparison comparison;
  if (alignment != Alignment::None && !reconstruction.measured.empty()) {
    comparison.truth_from_reconstruction = align(reconstruction, truth, alignment == Alignment::Similarity);
  }
  const maths::Similarity& transform = comparison.truth_from_reconstruction;
  const std::size_t count = reconstruction.measured.size();
  comparison.signed_distance_mm.assign(count, kNaN);
  comparison.normal_error_deg.assign(count, kNaN);
  constexpr std::size_t kBlock = 256;
  render::for_each_row(static_cast<int>((count + kBlock - 1) / kBlock), [&](int block) {
    const std::size_t end = std::min(count, (static_cast<std::size_t>(block) + 1) * kBlock);
    for (std::size_t k = static_cast<std::size_t>(block) * kBlock; k < end; ++k) {
      const std::int32_t vertex = reconstruction.measured[k];
      const Vector3f at = transform * Vector3f(reconstruction.vertices_mm.col(vertex));
      const auto closest = truth.caster().closest_point(at, kReach_mm);
      if (closest.triangle < 0) {
        continue;
      }
      const Vector3f normal = normal_at(truth.mesh(), closest.triangle, closest.barycentric);
      const bool outside = (at - closest.point_mm).dot(normal) >= 0;
      comparison.signed_distance_mm[k] = outside ? closest.distance_mm : -closest.distance_mm;
      const float cosine = normal.dot(transform.rotation * reconstruction.normals.col(vertex));
      comparison.normal_error_deg[k] =
          std::acos(std::clamp(cosine, -1.0F, 1.0F)) * 180 / std::numbers::pi_v<float>;
    }
  });
  return comparison;
}

std::vector<std::int32_t> measured_vertices(const mesh::Subject& subject, const mesh::Vertices& coarse_mm,
                                            const Eigen::Matrix3Xf& coarse_normals) {
  const mesh::Hierarchy& hierarchy = *subject.hierarchy;
  if (subject.regions.size() != static_cast<std::size_t>(hierarchy.control_vertex_count)) {
    throw Error(ErrorKind::UnreadableInput,
                "the take does not say of which regions its vertices are: there is nothing to measure");
  }
  Eigen::MatrixXf skin(1, hierarchy.control_vertex_count);
  for (std::int32_t v = 0; v < hierarchy.control_vertex_count; ++v) {
    const std::uint8_t bits = subject.regions[static_cast<std::size_t>(v)];
    skin(0, v) =
        face::has_region(bits, face::Region::Refinable) && !face::has_region(bits, face::Region::Boundary)
            ? 1.0F
            : 0.0F;
  }
  Eigen::MatrixXf finer;
  for (const mesh::Level& level : hierarchy.levels) {
    mesh::apply(level.from_coarser, skin, finer);
    skin.swap(finer);
  }
  constexpr float kWholly = 0.999F;
  constexpr float kMargin_mm = 1;
  const render::Raycaster caster(coarse_mm, hierarchy.finest().triangles);
  std::vector<std::int32_t> vertices;
  for (Eigen::Index v = 0; v < coarse_mm.cols(); ++v) {
    const Vector3f at = coarse_mm.col(v);
    if (skin(0, v) > kWholly && at.z() > 0 && -at.normalized().dot(coarse_normals.col(v)) > kSteepest &&
        !caster.occluded({0, 0, 0}, at, kMargin_mm)) {
      vertices.push_back(static_cast<std::int32_t>(v));
    }
  }
  return vertices;
}

FrameMeans FigureSum::add(std::int64_t index, const std::vector<std::int32_t>& vertices,
                          const Comparison& comparison, double photometric_rms) {
  if (histogram_.empty()) {
    histogram_.assign(static_cast<std::size_t>(static_cast<double>(kReach_mm) / kBin_mm) + 2, 0);
  }
  const auto room = static_cast<std::size_t>(vertices.empty() ? 0 : vertices.back() + 1);
  if (index != last_index_ + 1) {
    last_.clear();
    last_but_one_.clear();
  }
  std::vector<float> current(std::max(room, last_.size()), kNaN);
  last_.resize(current.size(), kNaN);
  last_but_one_.resize(current.size(), kNaN);
  FrameMeans frame;
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    const float distance = comparison.signed_distance_mm[k];
    const auto size_mm = static_cast<double>(std::isnan(distance) ? kReach_mm : std::abs(distance));
    ++histogram_[std::min(static_cast<std::size_t>(size_mm / kBin_mm), histogram_.size() - 1)];
    ++count_;
    sum_mm_ += size_mm;
    sum_squares_mm2_ += size_mm * size_mm;
    constexpr double kOpposite_deg = 180;
    const double normal_deg =
        std::isnan(distance) ? kOpposite_deg : static_cast<double>(comparison.normal_error_deg[k]);
    sum_normal_deg_ += normal_deg;
    frame.mm += size_mm;
    frame.normal_deg += normal_deg;
    const auto vertex = static_cast<std::size_t>(vertices[k]);
    current[vertex] = distance;
    const float bend = last_but_one_[vertex] - 2 * last_[vertex] + distance;
    if (!std::isnan(bend)) {
      sum_flicker_mm2_ += static_cast<double>(bend * bend) / 6;
      ++flicker_count_;
    }
  }
  if (!std::isnan(photometric_rms)) {
    sum_photometric2_ += photometric_rms * photometric_rms;
    ++photometric_count_;
  }
  last_but_one_ = std::move(last_);
  last_ = std::move(current);
  last_index_ = index;
  const auto points = static_cast<double>(vertices.size());
  return {frame.mm / points, frame.normal_deg / points};
}

AccuracyFigures FigureSum::figures() const {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  if (count_ == 0) {
    return {kNone, kNone, kNone, kNone, kNone, kNone, kNone};
  }
  const auto count = static_cast<double>(count_);
  const auto percentile = [&](double part) {
    std::uint64_t below = 0;
    for (std::size_t bin = 0; bin < histogram_.size(); ++bin) {
      if (static_cast<double>(below + histogram_[bin]) >= part * count) {
        const double inside =
            (part * count - static_cast<double>(below)) / std::max(1.0, static_cast<double>(histogram_[bin]));
        return (static_cast<double>(bin) + inside) * kBin_mm;
      }
      below += histogram_[bin];
    }
    return static_cast<double>(kReach_mm);
  };
  AccuracyFigures figures;
  figures.mean_mm = sum_mm_ / count;
  figures.std_mm = std::sqrt(std::max(0.0, sum_squares_mm2_ / count - figures.mean_mm * figures.mean_mm));
  figures.median_mm = percentile(0.5);
  figures.p95_mm = percentile(0.95);
  figures.normal_error_deg = sum_normal_deg_ / count;
  figures.flicker_mm =
      flicker_count_ > 0 ? std::sqrt(sum_flicker_mm2_ / static_cast<double>(flicker_count_)) : kNone;
  figures.photometric_rms =
      photometric_count_ > 0 ? std::sqrt(sum_photometric2_ / static_cast<double>(photometric_count_)) : kNone;
  return figures;
}

std::vector<float> true_displacements_mm(const Reconstruction& mesh, const maths::Similarity& truth_from_mesh,
                                         const Truth& truth) {
  constexpr float kDeepest_mm = 6;
  std::vector<float> out(static_cast<std::size_t>(mesh.vertices_mm.cols()), kNaN);
  for (const std::int32_t v : mesh.measured) {
    const Vector3f at = truth_from_mesh * Vector3f(mesh.vertices_mm.col(v));
    const Vector3f normal = truth_from_mesh.rotation * mesh.normals.col(v);
    const auto outwards = truth.caster().first_hit(at, normal);
    const auto inwards = truth.caster().first_hit(at, -normal);
    const bool is_inside =
        outwards.triangle >= 0 && (inwards.triangle < 0 || outwards.distance_mm < inwards.distance_mm);
    if (is_inside || inwards.triangle >= 0) {
      const float reach_mm =
          (is_inside ? outwards.distance_mm : -inwards.distance_mm) / truth_from_mesh.scale;
      if (std::abs(reach_mm) < kDeepest_mm) {
        out[static_cast<std::size_t>(v)] = reach_mm;
      }
    }
  }
  return out;
}

namespace {

/// The half-ring average of a field and of its weights, `rounds` times; vertices of weight 0 are left out.
void smooth(const mesh::OneRings& rings, const std::vector<std::int32_t>& vertices,
            const std::vector<float>& weights, int rounds, std::vector<float>& field) {
  std::vector<float> next = field;
  for (int round = 0; round < rounds; ++round) {
    for (const std::int32_t vertex : vertices) {
      const auto v = static_cast<std::size_t>(vertex);
      float sum = 0;
      float weight = 0;
      for (std::int32_t k = rings.offsets[v]; k < rings.offsets[v + 1]; ++k) {
        const auto j = static_cast<std::size_t>(rings.neighbours[static_cast<std::size_t>(k)]);
        sum += weights[j] * field[j];
        weight += weights[j];
      }
      next[v] = weight > 0 ? 0.5F * field[v] + 0.5F * sum / weight : field[v];
    }
    field.swap(next);
  }
}

}  // namespace

void WrinkleSum::add(const mesh::OneRings& rings, const Reconstruction& mesh, std::vector<float> true_mm,
                     std::span<const float> recovered_mm) {
  constexpr float kNarrow_mm = 0.6F;
  constexpr float kWide_mm = 4;
  constexpr float kFold_mm = 0.08F;
  std::vector<float> weights(true_mm.size(), 0.0F);
  std::vector<float> recovered(true_mm.size(), 0.0F);
  std::vector<std::int32_t> vertices;
  double spacing_mm = 0;
  std::int64_t edges = 0;
  for (const std::int32_t vertex : mesh.measured) {
    const auto v = static_cast<std::size_t>(vertex);
    if (std::isnan(true_mm[v])) {
      continue;
    }
    vertices.push_back(vertex);
    weights[v] = 1;
    recovered[v] = recovered_mm[v];
    for (std::int32_t k = rings.offsets[v]; k < rings.offsets[v + 1]; ++k) {
      const std::int32_t j = rings.neighbours[static_cast<std::size_t>(k)];
      spacing_mm += static_cast<double>((mesh.vertices_mm.col(vertex) - mesh.vertices_mm.col(j)).norm());
      ++edges;
    }
  }
  if (vertices.empty()) {
    return;
  }
  spacing_mm /= static_cast<double>(edges);
  for (float& value : true_mm) {
    value = std::isnan(value) ? 0 : value;
  }
  // One round moves half the weight by one spacing: a variance of spacing^2 / 4 along either axis.
  const auto rounds = [&](float width_mm) {
    const double ratio = static_cast<double>(width_mm) / spacing_mm;
    return static_cast<int>(std::lround(4 * ratio * ratio));
  };
  const auto band = [&](std::vector<float>& field) {
    smooth(rings, vertices, weights, rounds(kNarrow_mm), field);
    std::vector<float> wide = field;
    smooth(rings, vertices, weights, rounds(kWide_mm) - rounds(kNarrow_mm), wide);
    for (std::size_t v = 0; v < field.size(); ++v) {
      field[v] -= wide[v];
    }
  };
  band(true_mm);
  band(recovered);
  std::vector<float> power(true_mm.size());
  for (std::size_t v = 0; v < power.size(); ++v) {
    power[v] = true_mm[v] * true_mm[v];
  }
  smooth(rings, vertices, weights, rounds(kWide_mm), power);
  for (const std::int32_t vertex : vertices) {
    const auto v = static_cast<std::size_t>(vertex);
    if (power[v] > kFold_mm * kFold_mm) {
      const auto t = static_cast<double>(true_mm[v]);
      const auto r = static_cast<double>(recovered[v]);
      ++count_;
      sums_[0] += t;
      sums_[1] += r;
      sums_[2] += t * t;
      sums_[3] += r * r;
      sums_[4] += t * r;
    }
  }
}

double WrinkleSum::correlation() const {
  const auto count = static_cast<double>(count_);
  const double true_variance = sums_[2] - sums_[0] * sums_[0] / count;
  const double recovered_variance = sums_[3] - sums_[1] * sums_[1] / count;
  return (sums_[4] - sums_[0] * sums_[1] / count) / std::sqrt(true_variance * recovered_variance);
}

double WrinkleSum::depth() const {
  const auto count = static_cast<double>(count_);
  return (sums_[4] - sums_[0] * sums_[1] / count) / (sums_[2] - sums_[0] * sums_[0] / count);
}

std::vector<float> vertex_errors(const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                                 const std::vector<float>& albedo, const std::array<float, 9>& lighting,
                                 const CameraIntrinsics& camera, const Frame& image) {
  std::vector<float> errors(static_cast<std::size_t>(vertices_mm.cols()), kNaN);
  for (std::size_t v = 0; v < errors.size(); ++v) {
    const Vector3f at = vertices_mm.col(static_cast<Eigen::Index>(v));
    const Vector3f normal = normals.col(static_cast<Eigen::Index>(v));
    if (at.z() <= 0 || normal.dot(at) >= 0) {
      continue;
    }
    const float x = camera.fx * at.x() / at.z() + camera.cx;
    const float y = camera.fy * at.y() / at.z() + camera.cy;
    const float left = std::floor(x);
    const float top = std::floor(y);
    if (left < 0 || top < 0 || left + 1 >= static_cast<float>(image.width_px) ||
        top + 1 >= static_cast<float>(image.height_px)) {
      continue;
    }
    const float light = render::irradiance(lighting, normal);
    const std::uint8_t* upper = image.row(static_cast<int>(top)) + 4 * static_cast<std::ptrdiff_t>(left);
    const std::uint8_t* lower = image.row(static_cast<int>(top) + 1) + 4 * static_cast<std::ptrdiff_t>(left);
    const float across = x - left;
    const float down = y - top;
    float sum = 0;
    for (std::size_t channel = 0; channel < 3; ++channel) {
      const auto value = [&](const std::uint8_t* row) {
        return (1 - across) * render::srgb8_to_linear(row[channel]) +
               across * render::srgb8_to_linear(row[4 + channel]);
      };
      const float error = (1 - down) * value(upper) + down * value(lower) - light * albedo[3 * v + channel];
      sum += error * error;
    }
    errors[v] = std::sqrt(sum / 3);
  }
  return errors;
}

double photometric_rms(const std::vector<float>& vertex_errors, const std::vector<std::int32_t>& vertices) {
  double sum = 0;
  std::uint64_t count = 0;
  for (const std::int32_t vertex : vertices) {
    const float error = vertex_errors[static_cast<std::size_t>(vertex)];
    if (!std::isnan(error)) {
      sum += static_cast<double>(error * error);
      ++count;
    }
  }
  return count > 0 ? std::sqrt(sum / static_cast<double>(count)) : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace facet::report
