#include "report/evaluation.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <numbers>
#include <numeric>
#include <utility>

#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "render/closest.hpp"

namespace facet::report {
namespace {

using Eigen::Vector3f;
using maths::Similarity;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kReach_mm = 50;  // a vertex farther from the truth than this counts as measured at kReach_mm
constexpr std::size_t kAlignmentPoints = 2500;
constexpr int kAlignmentSteps = 40;
constexpr float kSteepest = 0.2588F;  // cosine of 75 degrees
constexpr float kMostWalk_mm = 0.5F;  // a point that moved less finds the nearest truth by walking

/// The transform after `step`.
maths::Similarity compose(const maths::Similarity& step, const maths::Similarity& first) {
  return {step.scale * first.scale, step.rotation * first.rotation, step * first.translation_mm};
}

Vector3f normal_at(const simulation::TruthMesh& mesh, std::int32_t triangle,
                   const Eigen::Vector2f& barycentric) {
  return render::interpolate(mesh.triangles, triangle, barycentric, mesh.normals).normalized();
}

/// Points of a mesh that its alignment rests on, and the truth that they are brought to.
struct AlignedPart {
  std::vector<Vector3f> points_mm;
  std::vector<std::int32_t>
      nearest;  ///< [points_mm] triangle that was nearest last time; -1: none yet, or none
  const Truth* truth = nullptr;
  float focal_ratio = 0;  ///< the points' focal length by the true one; 0: unknown
};

std::vector<AlignedPart> parts_of(const std::vector<PosedPair>& frames) {
  std::vector<AlignedPart> parts;
  for (const PosedPair& frame : frames) {
    const std::vector<std::int32_t>& measured = frame.reconstruction->measured;
    AlignedPart part;
    part.truth = frame.truth;
    if (frame.reconstruction->focal_px > 0 && frame.truth->focal_px() > 0) {
      part.focal_ratio = frame.reconstruction->focal_px / frame.truth->focal_px();
    }
    const std::size_t stride = measured.size() * frames.size() / kAlignmentPoints + 1;
    for (std::size_t k = 0; k < measured.size(); k += stride) {
      part.points_mm.emplace_back(frame.reconstruction->vertices_mm.col(measured[k]));
    }
    part.nearest.assign(part.points_mm.size(), -1);
    parts.push_back(std::move(part));
  }
  return parts;
}

/// Pairs a vertex with the truth that the camera sees through it, which is near whatever the depth and scale
/// are. unknown_ratio   stands for a part's focal_ratio where that is unknown
maths::Similarity start_of_alignment(const std::vector<AlignedPart>& parts, bool with_scale,
                                     float unknown_ratio) {
  std::vector<Vector3f> from;
  std::vector<Vector3f> to;
  for (const AlignedPart& part : parts) {
    const float ratio = part.focal_ratio > 0 ? part.focal_ratio : unknown_ratio;
    for (const Vector3f& point : part.points_mm) {
      const Vector3f direction = Vector3f(ratio * point.x(), ratio * point.y(), point.z()).normalized();
      const auto hit = part.truth->caster().first_hit({0, 0, 0}, direction, 1, true);
      if (hit.triangle >= 0) {
        from.push_back(point);
        to.emplace_back(hit.distance_mm * direction);
      }
    }
  }
  if (from.empty()) {
    return {};
  }
  const auto count = static_cast<Eigen::Index>(from.size());
  return maths::best_similarity(Eigen::Map<const Eigen::Matrix3Xf>(from.data()->data(), 3, count),
                                Eigen::Map<const Eigen::Matrix3Xf>(to.data()->data(), 3, count), with_scale);
}

/// The nearest truth, no farther than what is found by walking from a triangle of it.
render::Raycaster::Closest closest_near(const Truth& truth, std::int32_t triangle, const Vector3f& at) {
  constexpr float kRounding_mm = 1e-3F;
  const float reach_mm = truth.closest_from(triangle, at).distance_mm + kRounding_mm;
  return truth.caster().closest_point(at, std::min(reach_mm, kReach_mm));
}

/// An alignment under way.
struct Aligned {
  maths::Similarity transform;
  float moved_mm = kReach_mm;     ///< by the last step
  float distance_mm = kReach_mm;  ///< mean to the truth before it, kReach_mm where nothing is near
};

/// One point-to-plane step [CM92]: small rotation, shift and scale about the points' centre
/// that minimise the distances to the tangent planes at the closest points. Points whose nearest triangle is
/// known find the next one by walking where `walks`. False where nothing is near.
bool point_to_plane_step(std::vector<AlignedPart>& parts, bool with_scale, bool walks, Aligned& aligned) {
  const maths::Similarity& transform = aligned.transform;
  Eigen::Matrix<double, 7, 7> normal_matrix = Eigen::Matrix<double, 7, 7>::Zero();
  Eigen::Matrix<double, 7, 1> right_side = Eigen::Matrix<double, 7, 1>::Zero();
  Vector3f centre = Vector3f::Zero();
  std::size_t count = 0;
  for (const AlignedPart& part : parts) {
    for (const Vector3f& point : part.points_mm) {
      centre += transform * point;
    }
    count += part.points_mm.size();
  }
  centre /= static_cast<float>(count);
  float radius2_mm2 = 0;
  float distance_mm = 0;
  int used = 0;
  for (AlignedPart& part : parts) {
    for (std::size_t k = 0; k < part.points_mm.size(); ++k) {
      const Vector3f at = transform * part.points_mm[k];
      std::int32_t& last = part.nearest[k];
      const auto nearest = last < 0 ? part.truth->caster().closest_point(at, kReach_mm)
                           : walks  ? part.truth->closest_from(last, at)
                                    : closest_near(*part.truth, last, at);
      last = nearest.triangle;
      if (nearest.triangle < 0) {
        distance_mm += kReach_mm;
        continue;
      }
      distance_mm += nearest.distance_mm;
      const Vector3f normal = normal_at(part.truth->mesh(), nearest.triangle, nearest.barycentric);
      const Vector3f arm = at - centre;
      Eigen::Matrix<double, 7, 1> row;
      row << arm.cross(normal).cast<double>(), normal.cast<double>(),
          with_scale ? static_cast<double>(arm.dot(normal)) : 0.0;
      normal_matrix += row * row.transpose();
      right_side += row * static_cast<double>((nearest.point_mm - at).dot(normal));
      radius2_mm2 += arm.squaredNorm();
      ++used;
    }
  }
  aligned.distance_mm = distance_mm / static_cast<float>(count);
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
  aligned.transform = compose(step, transform);
  aligned.moved_mm =
      solved.segment<3>(3).norm() + (turn.norm() + std::abs(solved[6])) * std::sqrt(radius2_mm2);
  return true;
}

Aligned align(std::vector<AlignedPart> parts, bool with_scale, const maths::Similarity& start) {
  constexpr float kStill_mm = 1e-3F;
  Aligned aligned;
  aligned.transform = start;
  bool walked = false;
  for (int step = 0; step < kAlignmentSteps; ++step) {
    // What was found by walking is searched for once more before it counts as the end.
    const bool walks = aligned.moved_mm < kMostWalk_mm && aligned.moved_mm > kStill_mm;
    if (aligned.moved_mm <= kStill_mm && !walked) {
      break;
    }
    if (!point_to_plane_step(parts, with_scale, walks, aligned)) {
      break;
    }
    walked = walks;
  }
  return aligned;
}

}  // namespace

Truth::Truth(simulation::TruthMesh mesh, float focal_px)
    : mesh_(std::move(mesh)), focal_px_(focal_px), caster_(mesh_.vertices_mm, mesh_.triangles) {
  offsets_.assign(static_cast<std::size_t>(mesh_.vertices_mm.cols()) + 1, 0);
  for (const std::int32_t corner : mesh_.triangles.reshaped()) {
    ++offsets_[static_cast<std::size_t>(corner) + 1];
  }
  std::partial_sum(offsets_.begin(), offsets_.end(), offsets_.begin());
  triangles_.resize(static_cast<std::size_t>(mesh_.triangles.size()));
  std::vector<std::int32_t> next(offsets_.begin(), offsets_.end() - 1);
  for (Eigen::Index t = 0; t < mesh_.triangles.cols(); ++t) {
    for (const std::int32_t corner : mesh_.triangles.col(t)) {
      triangles_[static_cast<std::size_t>(next[static_cast<std::size_t>(corner)]++)] =
          static_cast<std::int32_t>(t);
    }
  }
}

render::Raycaster::Closest Truth::closest_from(std::int32_t triangle, const Vector3f& query_mm) const {
  render::Raycaster::Closest best;
  best.distance_mm = std::numeric_limits<float>::max();
  const auto look_at = [&](std::int32_t t) {
    const auto corners = mesh_.triangles.col(t);
    const Vector3f a = mesh_.vertices_mm.col(corners[0]);
    const Vector3f b = mesh_.vertices_mm.col(corners[1]);
    const Vector3f c = mesh_.vertices_mm.col(corners[2]);
    const Eigen::Vector2f at = render::closest_barycentric(a, b, c, query_mm);
    const Vector3f point = a + at.x() * (b - a) + at.y() * (c - a);
    const float distance = (point - query_mm).norm();
    if (distance < best.distance_mm) {
      best = {t, at, point, distance};
      return true;
    }
    return false;
  };
  look_at(triangle);
  for (bool nearer = true; nearer;) {
    nearer = false;
    const auto corners = mesh_.triangles.col(best.triangle);
    const std::array<float, 3> weights{1 - best.barycentric.sum(), best.barycentric.x(),
                                       best.barycentric.y()};
    // Inside of a triangle the surface is nowhere nearer around; on its border the neighbours there may be.
    constexpr float kOnBorder = 1e-6F;
    if (*std::min_element(weights.begin(), weights.end()) > kOnBorder) {
      break;
    }
    const std::array<std::int32_t, 3> around{corners[0], corners[1], corners[2]};
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const auto v = static_cast<std::size_t>(around[corner]);
      for (std::int32_t k = weights[corner] > kOnBorder ? offsets_[v] : offsets_[v + 1]; k < offsets_[v + 1];
           ++k) {
        nearer = look_at(triangles_[static_cast<std::size_t>(k)]) || nearer;
      }
    }
  }
  return best;
}

maths::Similarity align_together(const std::vector<PosedPair>& frames, Alignment alignment) {
  std::vector<PosedPair> filled;
  std::copy_if(frames.begin(), frames.end(), std::back_inserter(filled),
               [](const PosedPair& frame) { return !frame.reconstruction->measured.empty(); });
  if (alignment == Alignment::None || filled.empty()) {
    return {};
  }
  const bool with_scale = alignment == Alignment::Similarity;
  const std::vector<AlignedPart> parts = parts_of(filled);
  Aligned best;
  for (const float unknown_ratio : {1.0F, 1.4F, 0.7F}) {
    Aligned aligned = align(parts, with_scale, start_of_alignment(parts, with_scale, unknown_ratio));
    // Two ways to the same end differ by less than this.
    constexpr float kNearer = 0.99F;
    if (unknown_ratio == 1 || aligned.distance_mm < kNearer * best.distance_mm) {
      best = aligned;
    }
    if (std::all_of(parts.begin(), parts.end(),
                    [](const AlignedPart& part) { return part.focal_ratio > 0; })) {
      break;
    }
  }
  return best.transform;
}

maths::Similarity align_from(const PosedPair& frame, Alignment alignment, const maths::Similarity& start) {
  if (alignment == Alignment::None || frame.reconstruction->measured.empty()) {
    return start;
  }
  return align(parts_of({frame}), alignment == Alignment::Similarity, start).transform;
}

Comparison compare(const Reconstruction& reconstruction, const Truth& truth, Alignment alignment) {
  return measure(reconstruction, truth, align_together({{&reconstruction, &truth}}, alignment));
}

namespace {

/// Fills a comparison by a search for the nearest truth: closest(k, at), at the place of measured vertex k.
template <typename Search>
Comparison measure_by(const Reconstruction& reconstruction, const Truth& truth,
                      const maths::Similarity& transform, const Search& closest) {
  Comparison comparison;
  comparison.truth_from_reconstruction = transform;
  const std::size_t count = reconstruction.measured.size();
  comparison.signed_distance_mm.assign(count, kNaN);
  comparison.normal_error_deg.assign(count, kNaN);
  comparison.triangle.assign(count, -1);
  comparison.barycentric.assign(count, Eigen::Vector2f::Zero());
  constexpr std::size_t kBlock = 256;
  render::for_each_row(static_cast<int>((count + kBlock - 1) / kBlock), [&](int block) {
    const std::size_t end = std::min(count, (static_cast<std::size_t>(block) + 1) * kBlock);
    for (std::size_t k = static_cast<std::size_t>(block) * kBlock; k < end; ++k) {
      const std::int32_t vertex = reconstruction.measured[k];
      const Vector3f at = transform * Vector3f(reconstruction.vertices_mm.col(vertex));
      const render::Raycaster::Closest nearest = closest(k, at);
      if (nearest.triangle < 0 || nearest.distance_mm > kReach_mm) {
        continue;
      }
      const Vector3f normal = normal_at(truth.mesh(), nearest.triangle, nearest.barycentric);
      const bool outside = (at - nearest.point_mm).dot(normal) >= 0;
      comparison.signed_distance_mm[k] = outside ? nearest.distance_mm : -nearest.distance_mm;
      const float cosine = normal.dot(transform.rotation * reconstruction.normals.col(vertex));
      comparison.normal_error_deg[k] =
          std::acos(std::clamp(cosine, -1.0F, 1.0F)) * 180 / std::numbers::pi_v<float>;
      comparison.triangle[k] = nearest.triangle;
      comparison.barycentric[k] = nearest.barycentric;
    }
  });
  return comparison;
}

}  // namespace

Comparison measure(const Reconstruction& reconstruction, const Truth& truth,
                   const maths::Similarity& truth_from_reconstruction, const Comparison* nearby) {
  return measure_by(reconstruction, truth, truth_from_reconstruction, [&](std::size_t k, const Vector3f& at) {
    const bool is_known = nearby != nullptr && nearby->triangle[k] >= 0;
    return is_known ? closest_near(truth, nearby->triangle[k], at)
                    : truth.caster().closest_point(at, kReach_mm);
  });
}

Comparison measure_again(const Reconstruction& reconstruction, const Truth& truth,
                         const maths::Similarity& truth_from_reconstruction, const Comparison& before) {
  return measure_by(reconstruction, truth, truth_from_reconstruction, [&](std::size_t k, const Vector3f& at) {
    const std::int32_t triangle = before.triangle[k];
    if (triangle < 0) {
      return truth.caster().closest_point(at, kReach_mm);
    }
    const Vector3f was_at = before.truth_from_reconstruction *
                            Vector3f(reconstruction.vertices_mm.col(reconstruction.measured[k]));
    return (at - was_at).norm() < kMostWalk_mm ? truth.closest_from(triangle, at)
                                               : closest_near(truth, triangle, at);
  });
}

std::vector<std::int32_t> face_skin(const mesh::Subject& subject) {
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
  std::vector<std::int32_t> vertices;
  for (Eigen::Index v = 0; v < skin.cols(); ++v) {
    if (skin(0, v) > kWholly) {
      vertices.push_back(static_cast<std::int32_t>(v));
    }
  }
  return vertices;
}

std::vector<std::int32_t> measured_vertices(const mesh::Subject& subject, const mesh::Vertices& coarse_mm,
                                            const Eigen::Matrix3Xf& coarse_normals) {
  constexpr float kMargin_mm = 1;
  std::vector<std::int32_t> vertices = face_skin(subject);
  const auto turned_away = [&](std::int32_t v) {
    const Vector3f at = coarse_mm.col(v);
    return !(at.z() > 0 && -at.normalized().dot(coarse_normals.col(v)) > kSteepest);
  };
  vertices.erase(std::remove_if(vertices.begin(), vertices.end(), turned_away), vertices.end());
  const render::Raycaster caster(coarse_mm, subject.hierarchy->finest().triangles,
                                 render::Raycaster::Build::Quick);
  const auto hidden = [&](std::int32_t v) {
    return caster.occluded({0, 0, 0}, coarse_mm.col(v), kMargin_mm);
  };
  vertices.erase(std::remove_if(vertices.begin(), vertices.end(), hidden), vertices.end());
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
