#include "track/identity_shading.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>

#include "maths/harmonics.hpp"
#include "maths/srgb.hpp"

namespace facet::track {
namespace {

/// Of a kept picture: some four pixels from one control vertex to the next.
constexpr int kLongestSide = 128;
/// A channel from this value on is saturated.
constexpr int kSaturated = 250;
/// Landmarks do not reach the hairline: their box grows by this much of its size, and once more upwards.
constexpr double kMargin = 0.12;
constexpr double kForehead = 0.2;
/// Cosine to the line of sight at which a vertex begins to count, and from which on it counts wholly.
constexpr double kGrazing = 0.15;
constexpr double kFacing = 0.45;
/// Tukey's bound on a residual, relative to the face's rms brightness.
constexpr double kOutlier = 0.3;
/// How slowly the albedo leaves the mean albedo over the face, against a vertex of mean weight.
constexpr double kAlbedoSmooth = 250;
/// What the residuals of a whole face (relative to its brightness, squared, three channels) weigh against its
/// landmarks: some 75 independent facts of 5 %.
constexpr double kFaceWeight = 3e4;
/// Turns of light, albedo and trust before the first step, and before each further one.
constexpr int kFirstTurns = 6;
constexpr int kTurns = 3;
/// Less of the face than this says nothing of a person, in vertices.
constexpr double kFewestVertices = 300;
constexpr double kSmallestWeight = 0.002;

Eigen::Matrix<double, 9, 1> harmonics(const Eigen::Vector3d& n) {
  return Eigen::Matrix<double, 9, 1>(maths::harmonics(n.x(), n.y(), n.z()).data());
}

/// d (l . SH(n)) / d n.
Eigen::Vector3d by_normal(const Eigen::Matrix<double, 9, 1>& l, const Eigen::Vector3d& n) {
  return {l[1] + l[4] * n.y() + l[5] * n.z() + 2 * l[7] * n.x(),
          l[2] + l[4] * n.x() + l[6] * n.z() - 2 * l[7] * n.y(),
          l[3] + l[5] * n.x() + l[6] * n.y() + 6 * l[8] * n.z()};
}

/// 1-2-1 over both directions: with the averaging before it a quarter of a vertex spacing wide.
void blur(std::vector<std::array<float, 4>>& pixels, int width, int height) {
  std::vector<std::array<float, 4>> rows(pixels.size());
  const auto at = [width](int x, int y) { return static_cast<std::size_t>(y * width + x); };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (std::size_t c = 0; c < 4; ++c) {
        rows[at(x, y)][c] = 0.25F * pixels[at(std::max(x - 1, 0), y)][c] + 0.5F * pixels[at(x, y)][c] +
                            0.25F * pixels[at(std::min(x + 1, width - 1), y)][c];
      }
    }
  }
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (std::size_t c = 0; c < 4; ++c) {
        pixels[at(x, y)][c] = 0.25F * rows[at(x, std::max(y - 1, 0))][c] + 0.5F * rows[at(x, y)][c] +
                              0.25F * rows[at(x, std::min(y + 1, height - 1))][c];
      }
    }
  }
}

}  // namespace

IdentityShading::IdentityShading(const face::FaceModel& model) : model_(&model) {
  const auto& quads = model.control.quads;
  const auto is_skin = [&](std::int32_t vertex) {
    return model.control.refinable[static_cast<std::size_t>(vertex)] != 0;
  };
  std::vector<std::int32_t> place(static_cast<std::size_t>(model.vertex_count()), -1);
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    if (!std::any_of(quads.col(q).begin(), quads.col(q).end(), is_skin)) {
      continue;
    }
    std::array<std::int32_t, 4> local{};
    for (std::size_t corner = 0; corner < 4; ++corner) {
      const std::int32_t vertex = quads(static_cast<Eigen::Index>(corner), q);
      std::int32_t& index = place[static_cast<std::size_t>(vertex)];
      if (index < 0) {
        index = static_cast<std::int32_t>(support_.size());
        support_.push_back(vertex);
      }
      local[corner] = index;
    }
    quads_.push_back(local);
  }
  std::vector<std::int32_t> data_place(support_.size(), -1);
  for (std::size_t s = 0; s < support_.size(); ++s) {
    if (is_skin(support_[s])) {
      data_place[s] = static_cast<std::int32_t>(data_.size());
      data_.push_back(static_cast<std::int32_t>(s));
    }
  }
  const auto count = static_cast<Eigen::Index>(data_.size());
  std::vector<Eigen::Triplet<double>> edges;
  for (std::size_t q = 0; q < quads_.size(); ++q) {
    for (std::size_t corner = 0; corner < 4; ++corner) {
      const std::int32_t own = data_place[static_cast<std::size_t>(quads_[q][corner])];
      const std::int32_t next = data_place[static_cast<std::size_t>(quads_[q][(corner + 1) % 4])];
      if (own >= 0) {
        vertex_quads_.push_back({own, static_cast<std::int32_t>(q)});
      }
      if (own >= 0 && next >= 0) {
        edges.emplace_back(own, next, 1.0);
        edges.emplace_back(next, own, 1.0);
      }
    }
  }
  std::sort(vertex_quads_.begin(), vertex_quads_.end());
  // L x = x - mean of x over the ring.
  Eigen::SparseMatrix<double> rings(count, count);
  rings.setFromTriplets(edges.begin(), edges.end(), [](double, double) { return 1.0; });
  const Eigen::VectorXd valence = (rings * Eigen::VectorXd::Ones(count)).cwiseMax(1.0);
  Eigen::SparseMatrix<double> identity(count, count);
  identity.setIdentity();
  const Eigen::SparseMatrix<double> laplacian =
      identity - Eigen::SparseMatrix<double>(valence.cwiseInverse().asDiagonal() * rings);
  smoothness_ = laplacian.transpose() * laplacian;
  mean_albedo_.resize(3, count);
  for (Eigen::Index v = 0; v < count; ++v) {
    const std::int32_t s = data_[static_cast<std::size_t>(v)];
    mean_albedo_.col(v) = model.mean_albedo.col(support_[static_cast<std::size_t>(s)]).cast<double>();
  }
  albedo_ = mean_albedo_;
}

void IdentityShading::add_frame(const Frame& image, const landmark::FaceLandmarks* face) {
  const std::array<float, 256>& linear = maths::decoded_srgb8();
  LookedAt& frame = frames_.emplace_back();
  if (face == nullptr || image.empty()) {
    return;
  }
  const Eigen::Array2d first = face->points_px.topRows<2>().rowwise().minCoeff().cast<double>().array();
  const Eigen::Array2d last = face->points_px.topRows<2>().rowwise().maxCoeff().cast<double>().array();
  const Eigen::Array2d size = last - first;
  // Upwards in the head's sense, whichever way the head is held.
  const Eigen::Array2d up =
      kForehead * size.maxCoeff() * face->camera_from_canonical.col(1).head<2>().cast<double>().array();
  const Eigen::Array2d low = (first - kMargin * size).min(first + up).max(0.0).floor();
  const Eigen::Array2d high =
      (last + kMargin * size).max(last + up).min(Eigen::Array2d(image.width_px, image.height_px)).ceil();
  if (!((high - low).minCoeff() >= 8)) {
    return;
  }
  Picture& out = frame.picture;
  out.px_per_source_px = std::min(1.0, kLongestSide / (high - low).maxCoeff());
  out.source_origin_px = low.matrix();
  out.width = static_cast<int>((high - low).x() * out.px_per_source_px);
  out.height = static_cast<int>((high - low).y() * out.px_per_source_px);
  out.pixels.resize(static_cast<std::size_t>(out.width) * static_cast<std::size_t>(out.height));
  const double step = 1 / out.px_per_source_px;
  for (int y = 0; y < out.height; ++y) {
    const int y_first = static_cast<int>(low.y() + y * step);
    const int y_end =
        std::max(std::min(static_cast<int>(low.y() + (y + 1) * step), image.height_px), y_first + 1);
    for (int x = 0; x < out.width; ++x) {
      const int x_first = static_cast<int>(low.x() + x * step);
      const int x_end =
          std::max(std::min(static_cast<int>(low.x() + (x + 1) * step), image.width_px), x_first + 1);
      std::array<float, 4> sum{};
      for (int sy = y_first; sy < y_end; ++sy) {
        const std::uint8_t* pixel = image.row(sy) + static_cast<std::ptrdiff_t>(x_first) * 4;
        for (int sx = x_first; sx < x_end; ++sx, pixel += 4) {
          for (std::size_t c = 0; c < 3; ++c) {
            sum[c] += linear[pixel[c]];
          }
          sum[3] += std::max({pixel[0], pixel[1], pixel[2]}) >= kSaturated ? 0.0F : 1.0F;
        }
      }
      const auto pixels = static_cast<float>((y_end - y_first) * (x_end - x_first));
      for (float& value : sum) {
        value /= pixels;
      }
      out.pixels[static_cast<std::size_t>(y * out.width + x)] = sum;
    }
  }
  blur(out.pixels, out.width, out.height);
}

/// C x3 (1, expression) at the support.
void IdentityShading::contract(const Eigen::VectorXd& expression) {
  const auto rows = static_cast<Eigen::Index>(3 * support_.size());
  modes_.setZero(rows, model_->identity_modes);
  for (int e = 0; e < model_->expression_modes; ++e) {
    const double weight = e == 0 ? 1.0 : expression[e - 1];
    if (std::abs(weight) < kSmallestWeight) {
      continue;
    }
    for (int mode = 0; mode < model_->identity_modes; ++mode) {
      const auto row = model_->core_row(mode, e);
      for (std::size_t s = 0; s < support_.size(); ++s) {
        modes_.col(mode).segment<3>(static_cast<Eigen::Index>(3 * s)) +=
            weight * row.col(support_[s]).cast<double>();
      }
    }
  }
}

/// At places_, which belong to the shape.
void IdentityShading::observe(const LookedAt& frame, const SubjectShape& shape,
                              const Eigen::Vector2d& centre_px, const Pose& pose, Observed& out) const {
  const auto count = static_cast<Eigen::Index>(data_.size());
  out.colours.setZero(3, count);
  out.weights.setZero(count);
  out.normals.setZero(3, count);
  for (const auto& [vertex, q] : vertex_quads_) {
    const auto& quad = quads_[static_cast<std::size_t>(q)];
    out.normals.col(vertex) +=
        (places_.col(quad[2]) - places_.col(quad[0])).cross(places_.col(quad[3]) - places_.col(quad[1]));
  }
  out.lengths = out.normals.colwise().norm().cwiseMax(1e-12);
  const Picture& picture = frame.picture;
  double facing_sum = 0;
  for (Eigen::Index v = 0; v < count; ++v) {
    out.normals.col(v) = pose.rotation * out.normals.col(v).eval() / out.lengths[v];
    const Eigen::Vector3d place =
        pose.rotation * places_.col(data_[static_cast<std::size_t>(v)]) + pose.translation_mm;
    facing_sum -= out.normals.col(v).dot(place);
  }
  out.sign = facing_sum < 0 ? -1 : 1;  // most of a face that is seen faces the camera
  out.normals *= out.sign;
  for (Eigen::Index v = 0; v < count; ++v) {
    const Eigen::Vector3d place =
        pose.rotation * places_.col(data_[static_cast<std::size_t>(v)]) + pose.translation_mm;
    const double facing = -out.normals.col(v).dot(place.normalized());
    Projection point;
    if (facing <= kGrazing || !project(place, shape.focal_px, centre_px, point)) {
      continue;
    }
    const Eigen::Vector2d at =
        ((point.px.array() + 0.5).matrix() - picture.source_origin_px) * picture.px_per_source_px -
        Eigen::Vector2d(0.5, 0.5);
    if (!(at.x() >= 0 && at.y() >= 0 && at.x() < picture.width - 1 && at.y() < picture.height - 1)) {
      continue;
    }
    const auto x = static_cast<int>(at.x());
    const auto y = static_cast<int>(at.y());
    Eigen::Vector4d value = Eigen::Vector4d::Zero();
    for (int corner = 0; corner < 4; ++corner) {
      const int cx = x + corner % 2;
      const int cy = y + corner / 2;
      const double share = (1 - std::abs(at.x() - cx)) * (1 - std::abs(at.y() - cy));
      const auto& pixel = picture.pixels[static_cast<std::size_t>(cy * picture.width + cx)];
      value += share * Eigen::Map<const Eigen::Vector4f>(pixel.data()).cast<double>();
    }
    out.colours.col(v) = value.head<3>();
    const double t = std::clamp((facing - kGrazing) / (kFacing - kGrazing), 0.0, 1.0);
    const double trusted = std::clamp((value[3] - 0.6) / 0.4, 0.0, 1.0);
    out.weights[v] = t * t * (3 - 2 * t) * trusted;
  }
}

/// [MD19 eq. 3] without memory: nine unknowns over hundreds of vertices.
void IdentityShading::solve_light(LookedAt& frame, const Observed& seen) const {
  Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
  Light right = Light::Zero();
  for (Eigen::Index v = 0; v < seen.weights.size(); ++v) {
    const double weight = seen.weights[v] * frame.trust[v];
    if (weight > 0) {
      const Light basis = harmonics(seen.normals.col(v));
      normal.selfadjointView<Eigen::Lower>().rankUpdate(basis, weight * albedo_.col(v).squaredNorm());
      right += weight * albedo_.col(v).dot(seen.colours.col(v)) * basis;
    }
  }
  normal.diagonal().array() += 1e-4 * normal.trace() / 9 + 1e-12;
  frame.light = normal.selfadjointView<Eigen::Lower>().llt().solve(right);
}

/// [MD19 eq. 4] over all frames, the mean albedo in the pictures' tone. False where it cannot be solved.
bool IdentityShading::solve_albedo(std::span<const Observed> seen, std::span<LookedAt* const> frames) {
  const Eigen::Index count = albedo_.cols();
  Eigen::Matrix3Xd products = Eigen::Matrix3Xd::Zero(3, count);
  Eigen::VectorXd squares = Eigen::VectorXd::Zero(count);
  for (std::size_t f = 0; f < frames.size(); ++f) {
    for (Eigen::Index v = 0; v < count; ++v) {
      const double weight = seen[f].weights[v] * frames[f]->trust[v];
      const double shade = frames[f]->light->dot(harmonics(seen[f].normals.col(v)));
      products.col(v) += weight * shade * seen[f].colours.col(v);
      squares[v] += weight * shade * shade;
    }
  }
  const double mean_square =
      squares.sum() / std::max<double>(1.0, static_cast<double>((squares.array() > 0).count()));
  if (!(mean_square > 0) || !std::isfinite(mean_square)) {
    return false;
  }
  albedo_system_ = kAlbedoSmooth * mean_square * smoothness_;
  for (Eigen::Index v = 0; v < count; ++v) {
    albedo_system_.coeffRef(v, v) += squares[v] + 1e-6 * mean_square;
  }
  if (!pattern_known_) {
    albedo_solver_.analyzePattern(albedo_system_);
    pattern_known_ = true;
  }
  albedo_solver_.factorize(albedo_system_);
  if (albedo_solver_.info() != Eigen::Success) {
    return false;
  }
  for (Eigen::Index channel = 0; channel < 3; ++channel) {
    const Eigen::VectorXd mean = mean_albedo_.row(channel);
    const Eigen::VectorXd product = products.row(channel);
    const double tone = product.dot(mean) / std::max(squares.dot(mean.cwiseAbs2()), 1e-12);
    const Eigen::VectorXd right = product - tone * squares.cwiseProduct(mean);
    albedo_.row(channel) = (tone * mean + albedo_solver_.solve(right)).transpose();
  }
  // Light times albedo is all that is seen: the albedo keeps the model's brightness.
  const double brightness = squares.dot(albedo_.colwise().sum());
  const double mean_brightness = squares.dot(mean_albedo_.colwise().sum());
  if (!(brightness > 0) || !std::isfinite(brightness)) {
    return false;
  }
  albedo_ *= mean_brightness / brightness;
  return true;
}

void IdentityShading::renew_trust(LookedAt& frame, const Observed& seen, double brightness) const {
  for (Eigen::Index v = 0; v < seen.weights.size(); ++v) {
    const double shade = frame.light->dot(harmonics(seen.normals.col(v)));
    const double square = (seen.colours.col(v) - shade * albedo_.col(v)).squaredNorm() /
                          (3 * kOutlier * kOutlier * brightness * brightness);
    frame.trust[v] = square < 1 ? (1 - square) * (1 - square) : 0.0;
  }
}

/// Adds the frame's part to `out`; returns the weighted sum of squared relative residuals (mean of channels).
double IdentityShading::linearise(const LookedAt& frame, const Observed& seen, const Pose& pose,
                                  double brightness, IdentityEvidence& out) {
  const Eigen::Index count = albedo_.cols();
  const Eigen::Index modes = modes_.cols() - 1;
  Eigen::MatrixXd jacobian = Eigen::MatrixXd::Zero(modes, count);
  Eigen::VectorXd residuals = Eigen::VectorXd::Zero(count);
  double sum = 0;
  auto pair = vertex_quads_.begin();
  for (Eigen::Index v = 0; v < count; ++v) {
    const auto first = pair;
    pair = std::find_if(first, vertex_quads_.end(), [v](const auto& each) { return each[0] != v; });
    const double weight = seen.weights[v] * frame.trust[v];
    if (!(weight > 0)) {
      continue;
    }
    const Eigen::Vector3d normal = seen.normals.col(v);
    Eigen::Vector3d slope = by_normal(*frame.light, normal);
    slope -= slope.dot(normal) * normal;
    slope = pose.rotation.transpose() * slope * (seen.sign / seen.lengths[v]);
    const auto mode_rows = [&](std::int32_t s) { return modes_.block(Eigen::Index{3} * s, 1, 3, modes); };
    for (auto each = first; each != pair; ++each) {
      const auto& quad = quads_[static_cast<std::size_t>((*each)[1])];
      const Eigen::Vector3d along = places_.col(quad[2]) - places_.col(quad[0]);
      const Eigen::Vector3d across = places_.col(quad[3]) - places_.col(quad[1]);
      // d (along x across) = d along x across + along x d across
      jacobian.col(v) += (mode_rows(quad[2]) - mode_rows(quad[0])).transpose() * across.cross(slope) +
                         (mode_rows(quad[3]) - mode_rows(quad[1])).transpose() * slope.cross(along);
    }
    const double shade = frame.light->dot(harmonics(normal));
    const Eigen::Vector3d rho = albedo_.col(v) / brightness;
    const Eigen::Vector3d residual = seen.colours.col(v) / brightness - shade * rho;
    sum += weight * residual.squaredNorm() / 3;
    // Three channels follow one number: their squares add up to one row.
    const double scale = std::sqrt(weight * rho.squaredNorm());
    residuals[v] = weight * rho.dot(residual) / std::max(scale, 1e-12);
    jacobian.col(v) *= scale;
  }
  out.information.selfadjointView<Eigen::Lower>().rankUpdate(jacobian);
  out.pull += jacobian * residuals;
  return sum;
}

std::optional<IdentityEvidence> IdentityShading::evidence(const SubjectShape& shape,
                                                          const Eigen::Vector2d& centre_px,
                                                          std::span<const FrameState* const> states) {
  std::vector<std::size_t> chosen;
  for (std::size_t f = 0; f < frames_.size(); ++f) {
    if (frames_[f].picture.width > 0) {
      chosen.push_back(f);
    }
  }
  if (chosen.size() > kFramesUsed) {
    std::vector<std::size_t> spread;
    for (std::size_t k = 0; k < kFramesUsed; ++k) {
      spread.push_back(chosen[k * (chosen.size() - 1) / (kFramesUsed - 1)]);
    }
    chosen = std::move(spread);
  }
  const auto count = static_cast<Eigen::Index>(data_.size());
  std::vector<LookedAt*> frames;
  std::vector<Observed> seen(chosen.size());
  std::vector<Eigen::MatrixXd> modes;
  std::vector<Eigen::Matrix3Xd> places;
  Eigen::VectorXd weights(shape.identity.size() + 1);
  weights << 1.0, shape.identity;
  double colour_sum = 0;
  double weight_sum = 0;
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    LookedAt& frame = frames_[chosen[k]];
    const FrameState& state = *states[chosen[k]];
    contract(state.expression);
    const Eigen::VectorXd flat = modes_ * weights;
    places_ = Eigen::Map<const Eigen::Matrix3Xd>(flat.data(), 3, static_cast<Eigen::Index>(support_.size()));
    observe(frame, shape, centre_px, state.pose, seen[k]);
    weight_sum += seen[k].weights.sum();
    colour_sum += seen[k].colours.colwise().squaredNorm().dot(seen[k].weights);
    frames.push_back(&frame);
    modes.push_back(modes_);
    places.push_back(places_);
  }
  const double brightness = std::sqrt(colour_sum / std::max(3 * weight_sum, 1e-12));
  if (!(weight_sum >= kFewestVertices * static_cast<double>(std::max<std::size_t>(frames.size(), 1))) ||
      !(brightness > 1e-4)) {
    return std::nullopt;
  }
  const bool first_time = frames.front()->trust.size() != count;
  for (LookedAt* frame : frames) {
    if (frame->trust.size() != count) {
      frame->trust = Eigen::VectorXd::Ones(count);
    }
  }
  for (int turn = 0; turn < (first_time ? kFirstTurns : kTurns); ++turn) {
    for (std::size_t k = 0; k < frames.size(); ++k) {
      solve_light(*frames[k], seen[k]);
    }
    if (!solve_albedo(seen, frames)) {
      return std::nullopt;
    }
  }
  IdentityEvidence out;
  const Eigen::Index identities = shape.identity.size();
  out.information.setZero(identities, identities);
  out.pull.setZero(identities);
  out.at = shape.identity;
  double squares = 0;
  double trusted = 0;
  for (std::size_t k = 0; k < frames.size(); ++k) {
    renew_trust(*frames[k], seen[k], brightness);
    trusted += seen[k].weights.dot(frames[k]->trust);
    modes_ = modes[k];
    places_ = places[k];
    squares += linearise(*frames[k], seen[k], states[chosen[k]]->pose, brightness, out);
  }
  residual_ = std::sqrt(squares / std::max(trusted, 1e-12));
  // A frame's face counts the same whatever its size, and as often as the batch has frames.
  const double scale = kFaceWeight / weight_sum * static_cast<double>(frames_.size());
  out.information = scale * Eigen::MatrixXd(out.information.selfadjointView<Eigen::Lower>());
  out.pull *= scale;
  if (!out.information.allFinite() || !out.pull.allFinite()) {
    return std::nullopt;
  }
  return out;
}

}  // namespace facet::track
