#include "person/skin_albedo.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace facet::person {
namespace {

/// Of the lamps, relative to the mean of the diagonal.
constexpr double kRidge = 0.01;
constexpr int kSweeps = 400;
/// Of the first solve, between which the weights are renewed.
constexpr int kFirstRounds = 4;
constexpr float kLeastGain = 0.2F;
constexpr float kMostGain = 5;
/// What the model's mean albedo counts as, of one picture's worth.
constexpr float kModelCounts = 0.05F;
constexpr float kDarkest = 0.02F;  ///< of the usual shading; less tells nothing of the albedo
constexpr double kNothing = 1e-12;

}  // namespace

float brightness(const Eigen::Vector3f& rgb) {
  return 0.5F * (rgb.x() + rgb.y());
}

float SkinSamples::brightness(Eigen::Index keyframe, Eigen::Index texel) const {
  return person::brightness({rgb[0](keyframe, texel), rgb[1](keyframe, texel), rgb[2](keyframe, texel)});
}

float SkinSamples::albedo_brightness(Eigen::Index texel) const {
  return person::brightness(albedo.col(texel));
}

SkinAlbedo::SkinAlbedo(const SkinLight& light, Eigen::VectorXf gains, float usual_brightness,
                       float usual_albedo)
    : light_(light),
      lamps_(Eigen::MatrixXd::Zero(light::kLamps, light.room_count())),
      gains_(std::move(gains)),
      usual_(usual_brightness),
      usual_albedo_(usual_albedo) {}

/// Weight of a picture's texel.
float SkinAlbedo::believed(const SkinSamples& samples, Eigen::Index k, Eigen::Index i) const {
  const float weight = samples.weight(k, i);
  if (!(weight > 0)) {
    return 0;
  }
  const float predicted = gains_[k] * samples.shading(k, i) * samples.albedo_brightness(i);
  const float t = (samples.brightness(k, i) - predicted) / (usual_ * bound_);
  const float rest = 1 - t * t;
  return rest > 0 ? weight * rest * rest : 0;
}

void SkinAlbedo::solve_lamps(SkinSamples& samples, const Eigen::MatrixXf& rows) {
  for (int round = lit_ ? kFirstRounds - 1 : 0; round < kFirstRounds; ++round) {
    for (Eigen::Index room = 0; room < lamps_.cols(); ++room) {
      solve_room(samples, rows, room);
    }
    samples.shading = light_.in_head(lamps_).transpose() * rows;
    lit_ = true;
  }
}

/// The lamps that some of the keyframes were lit by.
void SkinAlbedo::solve_room(const SkinSamples& samples, const Eigen::MatrixXf& rows, Eigen::Index room) {
  constexpr Eigen::Index n = light::kRoomDirections;
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(light::kLamps, light::kLamps);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(light::kLamps);
  Eigen::MatrixXf shown(light::kLamps, rows.cols());
  Eigen::VectorXf values(rows.cols());
  for (Eigen::Index k = 0; k < gains_.size(); ++k) {
    if (light_.room(static_cast<std::size_t>(k)) != room) {
      continue;
    }
    Eigen::Index count = 0;
    for (Eigen::Index i = 0; i < rows.cols(); ++i) {
      const float weight = lit_ ? believed(samples, k, i) : samples.weight(k, i);
      if (weight > 0) {
        shown.col(count) = std::sqrt(weight) * gains_[k] * samples.albedo_brightness(i) * rows.col(i);
        values[count++] = std::sqrt(weight) * samples.brightness(k, i);
      }
    }
    Eigen::MatrixXf lower = Eigen::MatrixXf::Zero(light::kLamps, light::kLamps);
    lower.selfadjointView<Eigen::Lower>().rankUpdate(shown.leftCols(count));
    const Eigen::MatrixXd in_head = lower.selfadjointView<Eigen::Lower>().toDenseMatrix().cast<double>();
    const Eigen::VectorXd right_in_head = (shown.leftCols(count) * values.head(count)).cast<double>();
    const Eigen::MatrixXd& turn = light_.head_from_camera(static_cast<std::size_t>(k));
    for (Eigen::Index a = 0; a < 2; ++a) {
      right.segment(a * n, n) += turn.transpose() * right_in_head.segment(a * n, n);
      for (Eigen::Index b = 0; b <= a; ++b) {
        const Eigen::MatrixXd turned = in_head.block(a * n, b * n, n, n) * turn;
        matrix.block(a * n, b * n, n, n) += turn.transpose() * turned;
      }
    }
  }
  matrix.topRightCorner(n, n) = matrix.bottomLeftCorner(n, n).transpose();
  Eigen::VectorXd strengths = lamps_.col(room);
  light::descend(matrix, right, kRidge, kSweeps, strengths);
  lamps_.col(room) = strengths;
}

void SkinAlbedo::scale_lamps(SkinSamples& samples, float factor) {
  lamps_ *= static_cast<double>(factor);
  samples.shading *= factor;
}

void SkinAlbedo::solve_gains(SkinSamples& samples) {
  Eigen::ArrayXd both = Eigen::ArrayXd::Zero(gains_.size());
  Eigen::ArrayXd squares = Eigen::ArrayXd::Zero(gains_.size());
  for (Eigen::Index i = 0; i < samples.weight.cols(); ++i) {
    for (Eigen::Index k = 0; k < gains_.size(); ++k) {
      const float weight = believed(samples, k, i);
      const float predicted = samples.shading(k, i) * samples.albedo_brightness(i);
      both[k] += static_cast<double>(weight * samples.brightness(k, i) * predicted);
      squares[k] += static_cast<double>(weight * predicted * predicted);
    }
  }
  for (Eigen::Index k = 0; k < gains_.size(); ++k) {
    if (both[k] > 0 && squares[k] > kNothing) {  // else nothing of it is believed
      gains_[k] = std::clamp(static_cast<float>(both[k] / squares[k]), kLeastGain, kMostGain);
    }
  }
  const float mean = std::exp(gains_.array().log().mean());
  gains_ /= mean;
  scale_lamps(samples, mean);
}

void SkinAlbedo::solve_albedo(SkinSamples& samples, bool first) {
  const float counts = kModelCounts * usual_shading() * usual_shading();
  samples.seen.setZero(samples.weight.cols());
  for (Eigen::Index i = 0; i < samples.weight.cols(); ++i) {
    Eigen::Vector3f sum = counts * (hue_ * samples.model.col(i).array()).matrix();
    float squares = counts;
    for (Eigen::Index k = 0; k < gains_.size(); ++k) {
      const float shading = gains_[k] * samples.shading(k, i);
      const float weight = first ? samples.weight(k, i) : believed(samples, k, i);
      if (!(weight > 0) || shading < kDarkest * usual_shading()) {
        continue;
      }
      sum += weight * shading *
             Eigen::Vector3f(samples.rgb[0](k, i), samples.rgb[1](k, i), samples.rgb[2](k, i));
      squares += weight * shading * shading;
      samples.seen[i] += weight;
    }
    samples.albedo.col(i) = sum / squares;
  }
  normalise(samples);
}

/// What no picture shows gets the hue of what they do.
void SkinAlbedo::normalise(SkinSamples& samples) {
  double model = kNothing;
  double found = kNothing;
  Eigen::Array3d model_rgb = Eigen::Array3d::Constant(kNothing);
  Eigen::Array3d found_rgb = Eigen::Array3d::Constant(kNothing);
  for (Eigen::Index i = 0; i < samples.seen.size(); ++i) {
    const Eigen::Array3f weighted = samples.seen[i] * samples.model.col(i).array();
    model += static_cast<double>(person::brightness(hue_ * weighted));
    found += static_cast<double>(samples.seen[i] * samples.albedo_brightness(i));
    model_rgb += weighted.cast<double>();
    found_rgb += (samples.seen[i] * samples.albedo.col(i).array()).cast<double>();
  }
  const double factor = model / found;
  samples.albedo *= static_cast<float>(factor);
  scale_lamps(samples, static_cast<float>(1 / factor));
  hue_ = (factor * found_rgb / model_rgb).cast<float>();
}

double SkinAlbedo::residual(const SkinSamples& samples) const {
  double sum = 0;
  double weights = kNothing;
  for (Eigen::Index i = 0; i < samples.weight.cols(); ++i) {
    for (Eigen::Index k = 0; k < gains_.size(); ++k) {
      const float weight = believed(samples, k, i);
      const float predicted = gains_[k] * samples.shading(k, i) * samples.albedo_brightness(i);
      const float off = (samples.brightness(k, i) - predicted) / usual_;
      sum += static_cast<double>(weight * off * off);
      weights += static_cast<double>(weight);
    }
  }
  return std::sqrt(sum / weights);
}

}  // namespace facet::person
