#include "refine/room_light.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "maths/harmonics.hpp"
#include "maths/solve.hpp"
#include "maths/srgb.hpp"

namespace facet::refine {
namespace {

using shaders::vec4;

// So many vertices say enough of the lamps.
constexpr std::size_t kMostRows = 1200;
// Frames from one solve of the lamps to the next, and what an older one counts for after each: it is half
// forgotten after four.
constexpr std::uint64_t kSolveEvery = 8;
constexpr double kDecay = 0.85;
// Of the first frame, between which the weights are renewed.
constexpr int kFirstRounds = 4;
constexpr int kGainRounds = 3;
// Tukey's bound on a residual relative to the face's rms brightness.
constexpr double kRobust = 0.4;
// A frame of which less than this share of what is usually believed holds is doubtful: a hand, or another
// light. After so many in a row the lamps are found anew, and taken where they explain clearly more than the
// old ones.
constexpr double kDoubtful = 0.6;
constexpr int kDoubtfulFrames = 6;
constexpr double kClearlyMore = 1.25;
// Fewer vertices, or less of their weight explained, say nothing of a room.
constexpr Eigen::Index kLeastRows = 100;
constexpr double kLeastBelieved = 0.5;
// Ridge, relative to the mean of the diagonal.
constexpr double kRidge = 0.03;
constexpr int kSweeps = 60;
constexpr int kFirstSweeps = 300;
// Cosine to the viewing ray from which on a vertex is looked at.
constexpr float kFacing = 0.35F;
constexpr float kMostReachPx = 8;
constexpr std::uint8_t kSaturated = 250;
constexpr float kLargestHeadMm = 2000;
// Share of the strongest lamp below which a lamp of a frame is left out.
constexpr double kNoLamp = 1e-3;

}  // namespace

/// What a frame shows of the vertices looked at.
struct RoomLight::Rows {
  std::vector<std::int32_t> vertices;
  Eigen::VectorXd shading;  ///< colour over albedo
  Eigen::VectorXd weights;  ///< sum to 1
  double rms = 0;           ///< weighted, of shading

  /// Tukey's weight of what a prediction leaves of a row.
  double believed(Eigen::Index row, double predicted) const {
    const double residual = (shading[row] - predicted) / (kRobust * rms);
    const double t = 1 - residual * residual;
    return t > 0 ? weights[row] * t * t : 0;
  }
};

RoomLight::RoomLight(std::shared_ptr<const mesh::Hierarchy> hierarchy, std::vector<float> counts,
                     mesh::Vertices albedo)
    : hierarchy_(std::move(hierarchy)), counts_(std::move(counts)), albedo_(std::move(albedo)) {
  irradiance_.assign(counts_.size(), vec4{0, 0, 0, 0});
  const auto counted = static_cast<std::size_t>(
      std::count_if(counts_.begin(), counts_.end(), [](float count) { return count > 0; }));
  // Half of them turn away or are hidden.
  const std::size_t step = std::max<std::size_t>(1, (counted + 2 * kMostRows - 1) / (2 * kMostRows));
  std::size_t met = 0;
  for (std::size_t v = 0; v < counts_.size(); ++v) {
    if (counts_[v] > 0 && met++ % step == 0) {
      looked_at_.push_back(static_cast<std::int32_t>(v));
    }
  }
  forget();
}

void RoomLight::forget() {
  known_ = {Eigen::MatrixXd::Zero(light::kLamps, light::kLamps), Eigen::VectorXd::Zero(light::kLamps),
            Eigen::VectorXd::Zero(light::kLamps)};
  gain_ = 1;
  frames_ = 0;
  doubtful_ = 0;
}

/// Of what is looked at.
Eigen::Vector3f RoomLight::middle() const {
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  for (const std::int32_t v : looked_at_) {
    sum += vertices_mm_.col(v);
  }
  return sum / static_cast<float>(std::max<std::size_t>(1, looked_at_.size()));
}

/// M0 and its normals in this frame; the head's visibility where it is not known yet. Returns false where the
/// mesh is broken.
bool RoomLight::place(std::span<const vec4> control_mm, const Eigen::Matrix3f& shading_from_head) {
  const mesh::Level& coarsest = hierarchy_->levels.front();
  control_mm_.resize(3, static_cast<Eigen::Index>(control_mm.size()));
  for (std::size_t v = 0; v < control_mm.size(); ++v) {
    control_mm_.col(static_cast<Eigen::Index>(v)) << control_mm[v].x, control_mm[v].y, control_mm[v].z;
  }
  const Eigen::Array3f extent = control_mm_.rowwise().maxCoeff() - control_mm_.rowwise().minCoeff();
  if (!control_mm_.allFinite() || !shading_from_head.allFinite() || !(extent.maxCoeff() < kLargestHeadMm)) {
    return false;
  }
  mesh::apply(coarsest.from_coarser, control_mm_, vertices_mm_);
  mesh::vertex_normals(vertices_mm_, coarsest.triangles, normals_);
  head_normals_ = shading_from_head.transpose() * normals_;
  head_mm_ = shading_from_head.transpose() * (vertices_mm_.colwise() - middle());
  if (visibility_.empty()) {
    visibility_ = light::HeadVisibility(head_mm_, head_normals_, coarsest.triangles);
  }
  return true;
}

/// Colours over albedo of what is looked at and seen: the mean over a square half as wide as the vertices'
/// distance.
void RoomLight::sample(const Frame& image, const CameraIntrinsics& camera,
                       const Eigen::Matrix3f& shading_from_head, Rows& rows) const {
  const std::array<float, 256>& linear = maths::decoded_srgb8();
  Eigen::Index to_camera = 0;
  (light::room_directions().transpose() * (shading_from_head.transpose() * -middle())).maxCoeff(&to_camera);
  const std::uint8_t* const seen = visibility_.of_direction(static_cast<int>(to_camera));
  const mesh::OneRings& rings = hierarchy_->levels.front().one_rings;
  std::vector<double> shading;
  std::vector<double> weights;
  for (const std::int32_t v : looked_at_) {
    const Eigen::Vector3f at = vertices_mm_.col(v);
    const float depth = -at.z();
    const float facing = -normals_.col(v).dot(at.normalized());
    if (!(depth > 1) || !(facing > kFacing)) {
      continue;
    }
    const Eigen::Vector3f neighbour = vertices_mm_.col(
        rings.neighbours[static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v)])]);
    const float reach_px = 0.5F * (neighbour - at).norm() * camera.fx / depth;
    const int reach = static_cast<int>(std::clamp(reach_px / 2, 0.0F, kMostReachPx));
    const Eigen::Array2f px(camera.fx * at.x() / depth + camera.cx, camera.cy - camera.fy * at.y() / depth);
    const auto margin = static_cast<float>(reach + 1);
    const Eigen::Array2f size(static_cast<float>(image.width_px), static_cast<float>(image.height_px));
    if (!((px >= margin).all() && (px <= size - 1 - margin).all())) {
      continue;
    }
    const auto x = static_cast<int>(std::lround(px.x()));
    const auto y = static_cast<int>(std::lround(px.y()));
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    bool saturated = false;
    for (int row = y - reach; row <= y + reach; ++row) {
      const std::uint8_t* pixel = image.row(row) + static_cast<std::ptrdiff_t>(x - reach) * 4;
      for (int column = 0; column <= 2 * reach; ++column, pixel += 4) {
        sum += Eigen::Vector3f(linear[pixel[0]], linear[pixel[1]], linear[pixel[2]]);
        saturated = saturated || std::max({pixel[0], pixel[1], pixel[2]}) >= kSaturated;
      }
    }
    if (saturated) {
      continue;
    }
    const float side = static_cast<float>(2 * reach + 1);
    const Eigen::Vector3f albedo = albedo_.col(v);
    const float square = albedo.squaredNorm();
    if (!(square > 0)) {
      continue;
    }
    rows.vertices.push_back(v);
    shading.push_back(static_cast<double>(albedo.dot(sum) / (side * side * square)));
    const float facing_weight = std::min(1.0F, (facing - kFacing) / (1 - kFacing) * 3);
    weights.push_back(static_cast<double>(counts_[static_cast<std::size_t>(v)] * facing_weight * square *
                                          static_cast<float>(seen[v]) / 255));
  }
  rows.shading = Eigen::Map<const Eigen::VectorXd>(shading.data(), static_cast<Eigen::Index>(shading.size()));
  rows.weights = Eigen::Map<const Eigen::VectorXd>(weights.data(), static_cast<Eigen::Index>(weights.size()));
  const double total = rows.weights.sum();
  if (total > 0) {
    rows.weights /= total;
  }
  rows.rms = std::sqrt(rows.weights.dot(rows.shading.cwiseAbs2()));
}

/// [row][lamp of the head's frame] what a lamp of strength 1 gives.
Eigen::MatrixXf RoomLight::lamps_of(const Rows& rows) const {
  Eigen::MatrixXf out(rows.shading.size(), light::kLamps);
  for (int d = 0; d < light::kRoomDirections; ++d) {
    const Eigen::Vector3f direction = light::room_directions().col(d);
    const std::uint8_t* const seen = visibility_.of_direction(d);
    for (Eigen::Index row = 0; row < out.rows(); ++row) {
      const std::int32_t v = rows.vertices[static_cast<std::size_t>(row)];
      const Eigen::Vector3f at = head_mm_.col(v);
      const float lit =
          static_cast<float>(seen[v]) / 255 * light::clamped(head_normals_.col(v).dot(direction)).value;
      out(row, d) = lit;
      out(row, light::kRoomDirections + d) = lit * light::falloff(at.dot(direction), at.squaredNorm());
    }
  }
  return out;
}

/// How the exposure has changed since the lamps were found, and how much of the frame they explain then: a
/// robust ratio of what is seen to what irradiance() says.
void RoomLight::compare(const Rows& rows) {
  Eigen::VectorXd predicted(rows.shading.size());
  for (Eigen::Index row = 0; row < predicted.size(); ++row) {
    const std::int32_t v = rows.vertices[static_cast<std::size_t>(row)];
    const vec4& e = irradiance_[static_cast<std::size_t>(v)];
    predicted[row] =
        static_cast<double>(e.x + e.y * normals_(0, v) + e.z * normals_(1, v) + e.w * normals_(2, v));
  }
  for (int round = 0; round < kGainRounds; ++round) {
    double both = 0;
    double square = 0;
    believed_ = 0;
    for (Eigen::Index row = 0; row < predicted.size(); ++row) {
      const double weight = rows.believed(row, gain_ * predicted[row]);
      both += weight * rows.shading[row] * predicted[row];
      square += weight * predicted[row] * predicted[row];
      believed_ += weight;
    }
    gain_ = both > 0 && square > 0
                ? both / square
                : rows.weights.dot(rows.shading) / std::max(rows.weights.dot(predicted), 1e-12);
  }
}

/// Adds a frame to the normal equations and follows them; where there are no lamps yet, finds them.
void RoomLight::solve(const Rows& rows, const Eigen::MatrixXd& head_from_room) {
  const bool first = known_.strengths.maxCoeff() <= 0;
  const Eigen::MatrixXf lamps = lamps_of(rows);
  Known next = known_;
  for (int round = 0; round < (first ? kFirstRounds : 1); ++round) {
    Eigen::VectorXd weights = rows.weights;
    if (!first || round > 0) {
      const Eigen::VectorXf predicted = lamps * light::turned(head_from_room, next.strengths).cast<float>();
      for (Eigen::Index row = 0; row < weights.size(); ++row) {
        weights[row] = rows.believed(row, gain_ * static_cast<double>(predicted[row]));
      }
    }
    believed_ = weights.sum();
    const Eigen::MatrixXf weighted = weights.cast<float>().asDiagonal() * lamps;
    const Eigen::MatrixXd head_matrix = (lamps.transpose() * weighted).cast<double>();
    const Eigen::VectorXd head_right =
        (weighted.transpose() * rows.shading.cast<float>()).cast<double>() / gain_;
    next.matrix = kDecay * known_.matrix;
    next.right = kDecay * known_.right;
    constexpr Eigen::Index n = light::kRoomDirections;
    for (Eigen::Index i = 0; i < 2; ++i) {
      next.right.segment(i * n, n) += head_from_room.transpose() * head_right.segment(i * n, n);
      for (Eigen::Index j = 0; j < 2; ++j) {
        next.matrix.block(i * n, j * n, n, n) +=
            head_from_room.transpose() * head_matrix.block(i * n, j * n, n, n) * head_from_room;
      }
    }
    light::descend(next.matrix, next.right, kRidge, first ? kFirstSweeps : kSweeps, next.strengths);
  }
  if (!next.strengths.allFinite() || (first && !(believed_ >= kLeastBelieved))) {
    return;
  }
  next.usually_believed = first ? believed_ : 0.9 * known_.usually_believed + 0.1 * believed_;
  known_ = std::move(next);
}

/// Another light, or something before the face: what explains clearly more is taken.
void RoomLight::find_anew(const Rows& rows, const Eigen::MatrixXd& head_from_room) {
  Known old = known_;
  const double old_gain = gain_;
  const double old_believed = believed_;
  forget();
  solve(rows, head_from_room);
  if (known_.strengths.maxCoeff() <= 0 || believed_ < kClearlyMore * old_believed) {
    known_ = std::move(old);
    gain_ = old_gain;
    believed_ = old_believed;
  }
}

/// Follows the lamps by what a frame shows.
void RoomLight::learn(const Rows& rows, const Eigen::MatrixXd& head_from_room) {
  const bool due = frames_++ % kSolveEvery == 0;
  if (known_.strengths.maxCoeff() <= 0) {
    if (due) {
      gain_ = 1;
      solve(rows, head_from_room);
    }
    return;
  }
  compare(rows);
  const bool doubtful = believed_ < kDoubtful * known_.usually_believed;
  doubtful_ = doubtful ? doubtful_ + 1 : 0;
  if (doubtful_ >= kDoubtfulFrames) {
    doubtful_ = 0;
    find_anew(rows, head_from_room);
  } else if (!doubtful && due) {
    solve(rows, head_from_room);
  }
}

/// a and b of every vertex of M0 from the lamps' strengths in the head's frame.
void RoomLight::spread(const Eigen::VectorXd& head_strengths, const Eigen::Matrix3f& shading_from_head) {
  const auto count = static_cast<Eigen::Index>(irradiance_.size());
  std::fill(irradiance_.begin(), irradiance_.end(), vec4{0, 0, 0, 0});
  const double least = kNoLamp * head_strengths.maxCoeff();
  for (int d = 0; d < light::kRoomDirections; ++d) {
    if (!(head_strengths[d] + head_strengths[light::kRoomDirections + d] > least)) {
      continue;
    }
    const Eigen::Vector3f direction = light::room_directions().col(d);
    const Eigen::Vector3f in_room = shading_from_head * direction;
    const auto far = static_cast<float>(head_strengths[d] / 255);
    const auto near = static_cast<float>(head_strengths[light::kRoomDirections + d] / 255);
    const std::uint8_t* const seen = visibility_.of_direction(d);
    for (Eigen::Index v = 0; v < count; ++v) {
      const float cosine = head_normals_(0, v) * direction.x() + head_normals_(1, v) * direction.y() +
                           head_normals_(2, v) * direction.z();
      const light::Clamped lit = light::clamped(cosine);
      const float strength =
          far + near * light::falloff(head_mm_.col(v).dot(direction), head_mm_.col(v).squaredNorm());
      const float light = strength * static_cast<float>(seen[v]);
      const float slope = light * lit.slope;
      vec4& out = irradiance_[static_cast<std::size_t>(v)];
      out.x += light * lit.value - slope * cosine;
      out.y += slope * in_room.x();
      out.z += slope * in_room.y();
      out.w += slope * in_room.z();
    }
  }
}

std::array<float, 9> RoomLight::harmonics() const {
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(9, 9);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(9);
  for (const std::int32_t v : looked_at_) {
    const Eigen::Vector3f n =
        normals_.cols() > v ? Eigen::Vector3f(normals_.col(v)) : Eigen::Vector3f::Zero();
    if (!(n.z() > 0)) {
      continue;
    }
    const std::array<float, 9> basis = maths::harmonics(n.x(), n.y(), n.z());
    const Eigen::VectorXd row = Eigen::Map<const Eigen::Matrix<float, 9, 1>>(basis.data()).cast<double>();
    const vec4& e = irradiance_[static_cast<std::size_t>(v)];
    matrix += row * row.transpose();
    right += static_cast<double>(e.x + e.y * n.x() + e.z * n.y() + e.w * n.z()) * row;
  }
  matrix.diagonal().array() += kRidge * std::max(matrix.trace() / 9, 1e-9);
  const Eigen::VectorXd solved = maths::solve_symmetric(matrix, right);
  std::array<float, 9> out{};
  for (std::size_t k = 0; k < out.size(); ++k) {
    out[k] = static_cast<float>(solved[static_cast<Eigen::Index>(k)]);
  }
  return out;
}

void RoomLight::look(const Frame& image, const CameraIntrinsics& camera, std::span<const vec4> control_mm,
                     const Eigen::Matrix3f& shading_from_head) {
  if (!place(control_mm, shading_from_head)) {
    std::fill(irradiance_.begin(), irradiance_.end(), vec4{0, 0, 0, 0});
    return;
  }
  const Eigen::MatrixXd head_from_room = light::turned_lamps(shading_from_head.transpose());
  spread(light::turned(head_from_room, known_.strengths), shading_from_head);
  if (!image.empty()) {
    Rows rows;
    sample(image, camera, shading_from_head, rows);
    if (rows.shading.size() >= kLeastRows && rows.rms > 0) {
      learn(rows, head_from_room);
      spread(light::turned(head_from_room, known_.strengths), shading_from_head);
    }
  }
  const auto gain = static_cast<float>(gain_);
  for (vec4& value : irradiance_) {
    value = {gain * value.x, gain * value.y, gain * value.z, gain * value.w};
  }
}

}  // namespace facet::refine
