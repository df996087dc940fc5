#include "track/expression_reader.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string_view>

namespace facet::track {
namespace {

/// From here on a landmark lies further off its fit than an expression brings it: the net errs.
constexpr double kFarOff_mm = 5;

struct Row {
  std::string_view name;
  float step;  ///< of its numbers, per mm
};

#include "track/expression_reading.inc"

}  // namespace

void landmark_movements(const LandmarkModel& model, const LandmarkBasis& basis,
                        const landmark::FaceLandmarks& face, const FitCamera& camera, double focal_px,
                        const FrameState& state, LandmarkMovements& out) {
  const Eigen::Matrix3d view_from_head = camera.view_from_reference.linear() * state.pose.rotation;
  const double focal = camera.focal_ratio * focal_px;
  out.mm.resize(2, model.count());
  out.seen.setZero(model.count());
  for (Eigen::Index l = 0; l < out.mm.cols(); ++l) {
    const Eigen::Vector3d by_fit = basis.deltas_mm.middleRows<3>(3 * l) * state.expression;
    const Eigen::Vector3d head_mm =
        basis.neutral_mm.segment<3>(3 * l) + basis.bias_mm.segment<3>(3 * l) + by_fit;
    const Eigen::Vector3d seen_from =
        camera.view_from_reference * (state.pose.rotation * head_mm + state.pose.translation_mm);
    const int landmark = model.landmarks()[static_cast<std::size_t>(l)];
    const double seen = landmark::confidence_of(face, landmark);
    Eigen::Vector3d off = Eigen::Vector3d::Zero();
    if (seen > 0 && seen_from.z() > kNearestDepthMm) {
      const Eigen::Vector2d measured = landmark::place_of(face, landmark).head<2>().cast<double>();
      off.head<2>() = (measured - camera.centre_px) * (seen_from.z() / focal) - seen_from.head<2>();
      const double believed = seen / (1 + off.squaredNorm() / (kFarOff_mm * kFarOff_mm));
      off *= believed;
      out.seen[l] = static_cast<float>(believed);
    }
    out.mm.col(l) = (by_fit + view_from_head.transpose() * off).head<2>().cast<float>();
  }
}

const ExpressionReading& learned_reading() {
  static const ExpressionReading reading = [] {
    const auto numbers = [](const auto& rows, const auto& table) {
      const auto count = static_cast<Eigen::Index>(rows.size());
      ExpressionReading::Numbers out(count, static_cast<Eigen::Index>(table.size()) / count);
      for (Eigen::Index r = 0; r < count; ++r) {
        for (Eigen::Index c = 0; c < out.cols(); ++c) {
          out(r, c) = rows[static_cast<std::size_t>(r)].step *
                      static_cast<float>(table[static_cast<std::size_t>(r * out.cols() + c)]);
        }
      }
      return out;
    };
    ExpressionReading made;
    made.landmarks.assign(kLandmarks.begin(), kLandmarks.end());
    for (const Row& row : kEvidenceRows) {
      made.names.emplace_back(row.name);
    }
    made.evidence = numbers(kEvidenceRows, kEvidence);
    const ExpressionReading::Numbers rounded = numbers(kCertaintyRows, kCertainty);
    made.certainty = 0.5F * (rounded + rounded.transpose());
    made.rare = kRare;
    made.told = Eigen::Map<const Eigen::VectorXf>(kTold.data(), static_cast<Eigen::Index>(kTold.size()));
    return made;
  }();
  return reading;
}

ExpressionReader::ExpressionReader(const LandmarkModel& model, std::span<const std::string> expression_names,
                                   const ExpressionReading& reading)
    : reading_(&reading),
      seen_(reading.evidence.cols()),
      pull_(reading.evidence.rows()),
      read_(reading.evidence.rows()),
      shown_(static_cast<Eigen::Index>(reading.landmarks.size())) {
  for (const std::string& name : reading.names) {
    const auto found = std::find(expression_names.begin(), expression_names.end(), name);
    if (found == expression_names.end()) {
      return;
    }
    indices_.push_back(static_cast<int>(found - expression_names.begin()));
  }
  std::vector<int> places;
  for (const int landmark : reading.landmarks) {
    places.push_back(model.position_of(landmark));
  }
  if (std::find(places.begin(), places.end(), -1) == places.end()) {
    places_ = places;
  }
  for (const char* part : {"mouth", "jaw"}) {
    const auto place_of = [&](const char* side) {
      return std::find(reading.names.begin(), reading.names.end(), std::string(part) + side) -
             reading.names.begin();
    };
    const auto count = static_cast<std::ptrdiff_t>(reading.names.size());
    if (place_of("Left") < count && place_of("Right") < count) {
      sideways_.push_back({place_of("Left"), place_of("Right")});
    }
  }
  if (reading.told.size() == reading.evidence.rows()) {
    shares_.resize(reading.evidence.rows(), shown_.size());
    for (Eigen::Index k = 0; k < shares_.cols(); ++k) {
      shares_.col(k) = reading.evidence.middleCols<2>(2 * k).rowwise().squaredNorm();
    }
    const Eigen::VectorXf whole = shares_.rowwise().sum().cwiseMax(std::numeric_limits<float>::min());
    shares_ = reading.told.cwiseQuotient(whole).asDiagonal() * shares_;
  }
}

void ExpressionReader::read(const LandmarkMovements& movements, std::vector<float>& values,
                            std::vector<float>& confidence) {
  confidence.clear();
  if (places_.empty()) {
    return;
  }
  const auto names = static_cast<Eigen::Index>(indices_.size());
  for (std::size_t k = 0; k < places_.size(); ++k) {
    seen_.segment<2>(static_cast<Eigen::Index>(2 * k)) = movements.mm.col(places_[k]);
    shown_[static_cast<Eigen::Index>(k)] = movements.seen[places_[k]];
  }
  for (Eigen::Index e = 0; e < names; ++e) {
    seen_[seen_.size() - names + e] =
        kFittedMm * values[static_cast<std::size_t>(indices_[static_cast<std::size_t>(e)])];
  }
  pull_.noalias() = reading_->evidence * seen_;
  pull_.array() -= reading_->rare;
  // One value at a time within its bounds, round and round: P is positive definite, so it settles.
  constexpr int kMostRounds = 200;
  constexpr float kSettled = 1e-4F;
  const ExpressionReading::Numbers& certainty = reading_->certainty;
  read_.setZero();
  float change = 1;
  for (int round = 0; round < kMostRounds && change > kSettled; ++round) {
    change = 0;
    for (Eigen::Index e = 0; e < names; ++e) {
      const float others = certainty.row(e).dot(read_) - certainty(e, e) * read_[e];
      const float value = std::clamp((pull_[e] - others) / certainty(e, e), 0.0F, 1.0F);
      change = std::max(change, std::abs(value - read_[e]));
      read_[e] = value;
    }
  }
  take_rest_off();
  for (Eigen::Index e = 0; e < names; ++e) {
    values[static_cast<std::size_t>(indices_[static_cast<std::size_t>(e)])] = read_[e];
  }
  if (shares_.size() > 0) {
    confidence.resize(values.size());
    pull_.noalias() = shares_ * shown_;
    for (Eigen::Index e = 0; e < names; ++e) {
      confidence[static_cast<std::size_t>(indices_[static_cast<std::size_t>(e)])] =
          std::clamp(pull_[e], 0.0F, 1.0F);
    }
  }
}

void ExpressionReader::forget() {
  read_before_ = 0;
  for (Sideways& pair : sideways_) {
    pair.rest = 0;
  }
}

void ExpressionReader::take_rest_off() {
  // Steps towards what is read, however far off it is, find the median. Large at first; later so small that
  // a mouth held to one side for 20 s keeps two thirds of that at 30 frames a second.
  constexpr float kFirstStep = 0.3F;
  constexpr float kLastStep = 5e-4F;
  const float step = std::max(kLastStep, kFirstStep / static_cast<float>(++read_before_));
  for (Sideways& pair : sideways_) {
    const float to_right = read_[pair.right] - read_[pair.left];
    pair.rest += std::clamp(to_right - pair.rest, -step, step);
    read_[pair.right] = std::clamp(to_right - pair.rest, 0.0F, 1.0F);
    read_[pair.left] = std::clamp(pair.rest - to_right, 0.0F, 1.0F);
  }
}

}  // namespace facet::track
