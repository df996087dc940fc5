#include "person/keyframes.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <string_view>

#include "maths/srgb.hpp"
#include "maths/statistics.hpp"

namespace facet::person {
namespace {

constexpr double kYawBinDeg = 4;
constexpr double kPitchBinDeg = 5;
constexpr std::size_t kMostBins = 200;
constexpr std::size_t kMostBytes = std::size_t{256}
                                   << 20;  ///< of pictures; those that are kept get better, no more come
constexpr std::size_t kMostExpressions = 3000;
/// A head that turns faster is blurred by an exposure of 1/60 s.
constexpr double kFastestDegS = 90;
/// Of the face's own extent, around it.
constexpr double kMargin = 0.08;
/// What of a keyframe's cost a head's turning at the fastest is worth, in expression weights.
constexpr double kSpeedCost = 0.5;
constexpr double kReprojectionCost = 0.3;
/// Expressions further from the person's usual ones: a face that acts. Nets see up to 0.4 in a calm face that
/// is turned by 35 degrees; one that talks and smiles is at 0.6 to 1.2.
constexpr double kRestless = 0.55;

/// Fields along either side of a head's picture that tell one light from another.
constexpr Eigen::Index kFields = 8;
/// Of the farthest two lights of a burst, by which two pictures of one light may differ.
constexpr float kSameLight = 0.2F;
/// Of the brightest picture, by which the farthest two must differ: else no lamp was switched.
constexpr float kOtherLight = 0.15F;
constexpr std::size_t kMostLit = 2000;  ///< frames: a minute
constexpr double kStillDeg = 3;         ///< from where the head is most of a burst

double degrees(double radians) {
  return radians * 180 / std::numbers::pi;
}

/// [kFields * kFields] mean linear brightness of a picture's fields.
Eigen::ArrayXf fields_of(const HeadPicture& picture) {
  const std::array<float, 256>& decoded = maths::decoded_srgb8();
  Eigen::ArrayXf sums = Eigen::ArrayXf::Zero(kFields * kFields);
  Eigen::ArrayXf counts = Eigen::ArrayXf::Constant(kFields * kFields, 1e-6F);
  for (int y = 0; y < picture.height_px; ++y) {
    for (int x = 0; x < picture.width_px; ++x) {
      const Eigen::Index field = y * kFields / picture.height_px * kFields + x * kFields / picture.width_px;
      const std::size_t pixel =
          3 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(picture.width_px) +
               static_cast<std::size_t>(x));
      sums[field] += 0.5F * (decoded[picture.rgb[pixel]] + decoded[picture.rgb[pixel + 1]]);
      counts[field] += 1;
    }
  }
  return sums / counts;
}

/// What a tracked frame tells of the head; without its speed and its picture.
Keyframe keyframe_of(const track::TrackResult& tracked, const Frame& picture) {
  Keyframe now;
  now.sequence = picture.sequence;
  now.camera_from_head = tracked.camera_from_head.cast<double>();
  now.expression = Eigen::Map<const Eigen::VectorXf>(tracked.expression.data(),
                                                     static_cast<Eigen::Index>(tracked.expression.size()))
                       .cast<double>();
  now.reprojection_px = tracked.reprojection_px;
  std::tie(now.yaw_deg, now.pitch_deg) = orientation_deg(now.camera_from_head);
  return now;
}

bool is_settled(const track::TrackResult& tracked, const Frame& picture) {
  return tracked.state == mesh::TrackingState::Tracking && tracked.has_mesh && !picture.empty() &&
         !picture.corrupt;
}

}  // namespace

HeadPicture head_picture(const Frame& picture, const track::TrackResult& tracked) {
  Eigen::Vector2f least = Eigen::Vector2f::Constant(1e9F);
  Eigen::Vector2f largest = Eigen::Vector2f::Constant(-1e9F);
  for (Eigen::Index v = 0; v < tracked.vertices_mm.cols(); ++v) {
    const Eigen::Vector3f point = tracked.camera_from_head * tracked.vertices_mm.col(v);
    if (point.z() > 1) {
      const Eigen::Vector2f px(tracked.camera.fx * point.x() / point.z() + tracked.camera.cx,
                               tracked.camera.fy * point.y() / point.z() + tracked.camera.cy);
      least = least.cwiseMin(px);
      largest = largest.cwiseMax(px);
    }
  }
  const Eigen::Vector2f margin = static_cast<float>(kMargin) * (largest - least);
  const auto clamped = [](float value, int end) {
    return static_cast<int>(std::clamp(value, 0.0F, static_cast<float>(end)));
  };
  HeadPicture out;
  out.left_px = clamped(least.x() - margin.x(), picture.width_px);
  out.top_px = clamped(least.y() - margin.y(), picture.height_px);
  out.width_px = clamped(largest.x() + margin.x(), picture.width_px) - out.left_px;
  out.height_px = clamped(largest.y() + margin.y(), picture.height_px) - out.top_px;
  out.rgb.reserve(static_cast<std::size_t>(out.width_px) * static_cast<std::size_t>(out.height_px) * 3);
  for (int y = 0; y < out.height_px; ++y) {
    const std::uint8_t* pixel = picture.row(out.top_px + y) + 4 * static_cast<std::ptrdiff_t>(out.left_px);
    for (int x = 0; x < out.width_px; ++x, pixel += 4) {
      out.rgb.insert(out.rgb.end(), pixel, pixel + 3);
    }
  }
  return out;
}

Frame picture_of(const Keyframe& keyframe, const CameraIntrinsics& camera) {
  Frame out;
  out.sequence = keyframe.sequence;
  out.width_px = camera.width_px;
  out.height_px = camera.height_px;
  out.stride_bytes = 4 * static_cast<std::size_t>(camera.width_px);
  std::shared_ptr<std::uint8_t[]> pixels(
      new std::uint8_t[out.stride_bytes * static_cast<std::size_t>(camera.height_px)]());
  const HeadPicture& head = keyframe.picture;
  const std::uint8_t* rgb = head.rgb.data();
  for (int y = 0; y < head.height_px; ++y) {
    std::uint8_t* pixel = pixels.get() + static_cast<std::size_t>(head.top_px + y) * out.stride_bytes +
                          4 * static_cast<std::size_t>(head.left_px);
    for (int x = 0; x < head.width_px; ++x, pixel += 4, rgb += 3) {
      std::copy_n(rgb, 3, pixel);
      pixel[3] = 255;
    }
  }
  out.pixels = std::move(pixels);
  return out;
}

std::pair<double, double> orientation_deg(const Eigen::Isometry3d& camera_from_head) {
  const Eigen::Vector3d camera =
      -(camera_from_head.linear().transpose() * camera_from_head.translation()).normalized();
  return {degrees(std::atan2(camera.x(), camera.z())), degrees(std::asin(std::clamp(camera.y(), -1.0, 1.0)))};
}

KeyframeCollector::KeyframeCollector(const face::FaceModel& model) : model_(&model) {
  for (const std::string& name : model.expression_names) {
    moves_.push_back(name.find("Look") == std::string::npos ? 1 : 0);
  }
  clear();
}

void KeyframeCollector::clear() {
  bins_.clear();
  picture_bytes_ = 0;
  clear_lit();
  expressions_.clear();
  next_expression_ = 0;
  reprojections_px_.clear();
  mean_expression_ = Eigen::VectorXd::Zero(model_->expression_count());
  previous_.reset();
}

void KeyframeCollector::clear_lit() {
  lit_.clear();
  lit_bytes_ = 0;
  lit_step_ = 1;
}

double KeyframeCollector::restlessness(const Eigen::VectorXd& expression, const Eigen::VectorXd& rest) const {
  double sum = 0;
  for (std::size_t e = 0; e < moves_.size(); ++e) {
    const auto at = static_cast<Eigen::Index>(e);
    sum += moves_[e] != 0 ? (expression[at] - rest[at]) * (expression[at] - rest[at]) : 0;
  }
  return std::sqrt(sum);
}

double KeyframeCollector::cost(const Keyframe& keyframe, const Eigen::VectorXd& rest) const {
  return restlessness(keyframe.expression, rest) + kSpeedCost * keyframe.speed_deg_s / kFastestDegS +
         kReprojectionCost * keyframe.reprojection_px * 640 / std::max(camera_.width_px, camera_.height_px);
}

void KeyframeCollector::begin_unless_same(const track::TrackResult& tracked) {
  if (tracked.subject != subject_ || tracked.identity != identity_ || tracked.camera.fx != camera_.fx ||
      tracked.camera.width_px != camera_.width_px || tracked.camera.height_px != camera_.height_px) {
    clear();
    subject_ = tracked.subject;
    identity_ = tracked.identity;
    camera_ = tracked.camera;
  }
}

void KeyframeCollector::offer(const track::TrackResult& tracked, const Frame& picture) {
  if (!is_settled(tracked, picture)) {
    previous_.reset();
    return;
  }
  begin_unless_same(tracked);
  Keyframe now = keyframe_of(tracked, picture);
  const Eigen::Matrix3f turn = tracked.camera_from_head.linear();
  if (previous_ && picture.media_time_ns > previous_->first) {
    const double seconds = static_cast<double>(picture.media_time_ns - previous_->first) * 1e-9;
    now.speed_deg_s = degrees(Eigen::AngleAxisf(turn * previous_->second.transpose()).angle()) / seconds;
  }
  previous_.emplace(picture.media_time_ns, turn);

  if (expressions_.size() < kMostExpressions) {
    expressions_.emplace_back(now.expression.cast<float>());
    reprojections_px_.push_back(tracked.reprojection_px);
  } else {
    expressions_[next_expression_] = now.expression.cast<float>();
    reprojections_px_[next_expression_] = tracked.reprojection_px;
    next_expression_ = (next_expression_ + 1) % kMostExpressions;
  }
  mean_expression_ += (now.expression - mean_expression_) / static_cast<double>(expressions_.size());

  if (now.speed_deg_s > kFastestDegS) {
    return;
  }
  const std::pair bin(static_cast<int>(std::lround(now.yaw_deg / kYawBinDeg)),
                      static_cast<int>(std::lround(now.pitch_deg / kPitchBinDeg)));
  const auto held = bins_.find(bin);
  if (held == bins_.end() ? bins_.size() >= kMostBins || picture_bytes_ >= kMostBytes
                          : cost(held->second, mean_expression_) <= cost(now, mean_expression_)) {
    return;
  }
  now.picture = head_picture(picture, tracked);
  const std::size_t bytes =
      picture_bytes_ + now.picture.rgb.size() - (held == bins_.end() ? 0 : held->second.picture.rgb.size());
  if (now.picture.rgb.empty() || bytes > kMostBytes) {
    return;
  }
  picture_bytes_ = bytes;
  bins_.insert_or_assign(bin, std::move(now));
}

OrientationSpan KeyframeCollector::span() const {
  OrientationSpan out;
  for (const auto& [bin, keyframe] : bins_) {
    out.least_yaw = std::min(out.least_yaw, keyframe.yaw_deg);
    out.largest_yaw = std::max(out.largest_yaw, keyframe.yaw_deg);
    out.least_pitch = std::min(out.least_pitch, keyframe.pitch_deg);
    out.largest_pitch = std::max(out.largest_pitch, keyframe.pitch_deg);
  }
  return out;
}

std::vector<std::pair<double, double>> KeyframeCollector::filled() const {
  std::vector<std::pair<double, double>> out;
  for (const auto& [bin, keyframe] : bins_) {
    out.emplace_back(bin.first * kYawBinDeg, bin.second * kPitchBinDeg);
  }
  return out;
}

std::optional<Observed> KeyframeCollector::observed(int most, int most_lit) const {
  if (bins_.empty()) {
    return std::nullopt;
  }
  Observed out{camera_, identity_, Eigen::VectorXd::Zero(model_->expression_count()), 0, {}, span(), {}};
  std::vector<float> values(expressions_.size());
  for (Eigen::Index e = 0; e < out.rest.size(); ++e) {
    std::transform(expressions_.begin(), expressions_.end(), values.begin(),
                   [e](const Eigen::VectorXf& expression) { return expression[e]; });
    out.rest[e] = maths::median_of(values);
  }
  values = reprojections_px_;
  out.usual_reprojection_px = maths::median_of(values);

  std::vector<const Keyframe*> chosen;
  for (const auto& [bin, keyframe] : bins_) {
    if (keyframe.reprojection_px <= 2.4 * out.usual_reprojection_px + 0.8 &&
        restlessness(keyframe.expression, out.rest) <= kRestless) {
      chosen.push_back(&keyframe);
    }
  }
  if (chosen.empty()) {
    return std::nullopt;
  }
  // Of the two that stand nearest to each other the restless one goes, until few enough are left.
  while (chosen.size() > static_cast<std::size_t>(std::max(most, 1))) {
    double nearest = 1e18;
    std::pair<std::size_t, std::size_t> pair;
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      for (std::size_t j = i + 1; j < chosen.size(); ++j) {
        const double distance = std::hypot(chosen[i]->yaw_deg - chosen[j]->yaw_deg,
                                           0.8 * (chosen[i]->pitch_deg - chosen[j]->pitch_deg));
        if (distance < nearest) {
          nearest = distance;
          pair = {i, j};
        }
      }
    }
    const bool first_goes = cost(*chosen[pair.first], out.rest) > cost(*chosen[pair.second], out.rest);
    chosen.erase(chosen.begin() + static_cast<std::ptrdiff_t>(first_goes ? pair.first : pair.second));
  }
  std::sort(chosen.begin(), chosen.end(),
            [](const Keyframe* a, const Keyframe* b) { return a->sequence < b->sequence; });
  for (const Keyframe* keyframe : chosen) {
    out.keyframes.push_back(*keyframe);
  }
  out.burst = burst(most_lit, out.rest);
  return out;
}

void KeyframeCollector::offer_lit(const track::TrackResult& tracked, const Frame& picture) {
  if (!is_settled(tracked, picture) || lit_.size() >= kMostLit) {
    return;
  }
  begin_unless_same(tracked);
  Lit now{keyframe_of(tracked, picture), {}};
  now.keyframe.picture = head_picture(picture, tracked);
  if (now.keyframe.picture.rgb.empty()) {
    return;
  }
  now.fields = fields_of(now.keyframe.picture);
  while (lit_bytes_ + now.keyframe.picture.rgb.size() > kMostBytes && lit_step_ < lit_.size()) {
    lit_step_ *= 2;
    lit_bytes_ = 0;
    for (std::size_t i = 0; i < lit_.size(); ++i) {
      if (i % lit_step_ != 0) {
        lit_[i].keyframe.picture = {};
      }
      lit_bytes_ += lit_[i].keyframe.picture.rgb.size();
    }
  }
  if (lit_.size() % lit_step_ == 0) {
    lit_bytes_ += now.keyframe.picture.rgb.size();
  } else {
    now.keyframe.picture = {};
  }
  lit_.push_back(std::move(now));
}

std::vector<Keyframe> KeyframeCollector::burst(int most, const Eigen::VectorXd& rest) const {
  std::vector<double> yaws;
  std::vector<double> pitches;
  float farthest = 0;
  float brightness = 0;
  const auto apart = [&](std::size_t a, std::size_t b) {
    return (lit_[a].fields - lit_[b].fields).matrix().norm();
  };
  for (std::size_t a = 0; a < lit_.size(); ++a) {
    yaws.push_back(lit_[a].keyframe.yaw_deg);
    pitches.push_back(lit_[a].keyframe.pitch_deg);
    brightness = std::max(brightness, lit_[a].fields.matrix().norm());
    for (std::size_t b = 0; b < a; ++b) {
      farthest = std::max(farthest, apart(a, b));
    }
  }
  if (lit_.empty() || farthest < kOtherLight * brightness) {
    return {};
  }
  const double yaw = maths::median_of(yaws);
  const double pitch = maths::median_of(pitches);
  const float same = kSameLight * farthest;
  std::vector<std::size_t> usable;
  for (std::size_t i = 0; i < lit_.size(); ++i) {
    const Keyframe& keyframe = lit_[i].keyframe;
    const bool steady = (i > 0 && apart(i, i - 1) < same) || (i + 1 < lit_.size() && apart(i, i + 1) < same);
    if (steady && !keyframe.picture.rgb.empty() && restlessness(keyframe.expression, rest) <= kRestless &&
        std::hypot(keyframe.yaw_deg - yaw, keyframe.pitch_deg - pitch) <= kStillDeg) {
      usable.push_back(i);
    }
  }
  std::vector<Keyframe> out;
  std::vector<std::size_t> firsts;  // of each light
  std::vector<std::size_t> taken;
  while (taken.size() < std::min(usable.size(), static_cast<std::size_t>(std::max(most, 0)))) {
    std::size_t next = 0;
    float best = -1;
    for (const std::size_t i : usable) {
      float nearest = std::numeric_limits<float>::max();
      for (const std::size_t other : taken) {
        nearest = std::min(nearest, other == i ? -1 : apart(i, other));
      }
      if (nearest > best) {
        best = nearest;
        next = i;
      }
    }
    if (best >= same) {
      firsts.push_back(next);
    }
    const auto nearest = std::min_element(firsts.begin(), firsts.end(), [&](std::size_t a, std::size_t b) {
      return apart(a, next) < apart(b, next);
    });
    taken.push_back(next);
    out.push_back(lit_[next].keyframe);
    out.back().light = static_cast<int>(nearest - firsts.begin()) + 1;
  }
  return out;
}

int Observed::light_count() const {
  int lights = 0;
  for (const Keyframe& keyframe : burst) {
    lights = std::max(lights, keyframe.light);
  }
  return lights;
}

}  // namespace facet::person
