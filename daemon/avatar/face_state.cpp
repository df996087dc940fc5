#include "avatar/face_state.hpp"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <system_error>

#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"

namespace facet::avatar {
namespace {

using nlohmann::json;

constexpr float kMetresPerMillimetre = 0.001F;
/// The most that counts as a value's rest, 0 to 1. The range above rest is stretched to 0 to 1 (subtract); a
/// value that rests nearer to 1 has too little range left for that.
constexpr float kMostRest = 0.95F;

/// Throws std::exception saying what is wrong.
NeutralPose parse(std::string_view text) {
  constexpr std::size_t kMostValues = 1000;  // as JsonLimits counts; a neutral pose has 59 numbers
  const json document = files::parse_json(text, {kMostNeutralBytes, kMostValues}, "its text");
  if (document.at("facet_neutral") != 1) {
    throw std::runtime_error("it is of another version");
  }
  NeutralPose neutral;
  for (const auto& [name, value] : document.at("values").items()) {
    const int index = mesh::arkit_index(name);
    const auto number = value.get<float>();
    if (index < 0 || !(number >= 0 && number <= 1)) {
      throw std::runtime_error(fmt::format("'{}' is no value of ARKit's from 0 to 1", name));
    }
    neutral.values.at(static_cast<std::size_t>(index)) = number;
  }
  const auto rotation = document.at("rotation").get<std::array<float, 4>>();
  const auto translation = document.at("translation_m").get<std::array<float, 3>>();
  const Eigen::Quaternionf turn(Eigen::Map<const Eigen::Vector4f>(rotation.data()));
  neutral.upright_from_head.translation() = Eigen::Map<const Eigen::Vector3f>(translation.data());
  if (!(std::abs(turn.norm() - 1.0F) < 1e-3F) || !neutral.upright_from_head.translation().allFinite()) {
    throw std::runtime_error("its pose is none");
  }
  neutral.upright_from_head.linear() = turn.normalized().toRotationMatrix();
  return neutral;
}

}  // namespace

FaceState face_state(const mesh::MeshFrame& frame) {
  FaceState state;
  state.sequence = frame.sequence;
  state.timestamp_ns = frame.timestamp_ns;
  state.tracked = frame.subject != nullptr;
  if (!state.tracked) {
    return state;
  }
  state.provisional = frame.state == mesh::TrackingState::Acquiring;
  state.has_expression = !frame.expression.empty();
  state.values = mesh::arkit_values(frame.subject->expression_names, frame.expression);
  state.upright_from_head = mesh::upright_from_camera() * frame.camera_from_head;
  state.upright_from_head.translation() *= kMetresPerMillimetre;
  return state;
}

void values_to_frame(const mesh::ArkitValues& values, mesh::MeshFrame& frame) {
  const std::vector<std::string>& names = frame.subject->expression_names;
  frame.avatar_values.assign(frame.expression.begin(), frame.expression.end());
  for (std::size_t i = 0; i < std::min(names.size(), frame.avatar_values.size()); ++i) {
    if (const int index = mesh::arkit_index(names[i]); index >= 0) {
      frame.avatar_values[i] = values.at(static_cast<std::size_t>(index));
    }
  }
}

void subtract_values(const NeutralPose& neutral, FaceState& state) {
  for (std::size_t i = 0; i < state.values.size(); ++i) {
    const float rest = std::min(neutral.values.at(i), kMostRest);
    state.values.at(i) = std::clamp((state.values.at(i) - rest) / (1.0F - rest), 0.0F, 1.0F);
  }
}

void subtract_head(const NeutralPose& neutral, FaceState& state) {
  state.upright_from_head = neutral.upright_from_head.inverse() * state.upright_from_head;
}

void NeutralRecorder::add(const FaceState& state) {
  if (!state.tracked || state.provisional) {
    return;
  }
  ++frames_;
  for (std::size_t i = 0; i < sums_.size(); ++i) {
    sums_.at(i) += state.values.at(i);
  }
  translations_ += state.upright_from_head.translation();
  const Eigen::Vector4f turn = Eigen::Quaternionf(state.upright_from_head.linear()).normalized().coeffs();
  turns_ += turn * turn.transpose();
}

std::optional<NeutralPose> NeutralRecorder::mean() const {
  if (frames_ < kFewestFrames) {
    return std::nullopt;
  }
  NeutralPose neutral;
  const auto count = static_cast<float>(frames_);
  for (std::size_t i = 0; i < sums_.size(); ++i) {
    neutral.values.at(i) = sums_.at(i) / count;
  }
  // The mean turn is the eigenvector of the largest eigenvalue, which comes last.
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4f> solver(turns_);
  neutral.upright_from_head.linear() =
      Eigen::Quaternionf(Eigen::Vector4f(solver.eigenvectors().col(3))).normalized().toRotationMatrix();
  neutral.upright_from_head.translation() = translations_ / count;
  return neutral;
}

void save_neutral(const NeutralPose& neutral, const std::filesystem::path& file) {
  json values = json::object();
  for (std::size_t i = 0; i < neutral.values.size(); ++i) {
    values[mesh::arkit_name(i)] = neutral.values.at(i);
  }
  const Eigen::Quaternionf turn(neutral.upright_from_head.linear());
  const Eigen::Vector3f place = neutral.upright_from_head.translation();
  const json document = {{"facet_neutral", 1},
                         {"values", std::move(values)},
                         {"rotation", {turn.x(), turn.y(), turn.z(), turn.w()}},
                         {"translation_m", {place.x(), place.y(), place.z()}}};
  files::OutputFile output(file);
  output.write(document.dump(2) + "\n");
  output.commit();
}

NeutralPose parse_neutral(std::string_view text, const std::string& source) {
  try {
    return parse(text);
  } catch (const std::exception& error) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("neutral pose {}: {}; `facet neutral` records it anew", source, error.what()));
  }
}

std::optional<NeutralPose> load_neutral(const std::filesystem::path& file) {
  std::error_code ignored;
  if (!std::filesystem::exists(file, ignored)) {
    return std::nullopt;
  }
  return parse_neutral(files::read_text(file, kMostNeutralBytes, "neutral pose"), file.string());
}

void Smoother::apply(FaceState& state) {
  if (!state.tracked) {
    before_.reset();
    return;
  }
  if (before_ && time_constant_s_ > 0) {
    const float elapsed_s = 1e-9F * static_cast<float>(state.timestamp_ns - before_->timestamp_ns);
    const float share = 1.0F - std::exp(-std::max(0.0F, elapsed_s) / time_constant_s_);
    for (std::size_t i = 0; i < state.values.size(); ++i) {
      state.values.at(i) = before_->values.at(i) + share * (state.values.at(i) - before_->values.at(i));
    }
    const Eigen::Quaternionf from(before_->upright_from_head.linear());
    const Eigen::Quaternionf to(state.upright_from_head.linear());
    state.upright_from_head.linear() = from.slerp(share, to).normalized().toRotationMatrix();
    state.upright_from_head.translation() =
        before_->upright_from_head.translation() +
        share * (state.upright_from_head.translation() - before_->upright_from_head.translation());
  }
  before_ = state;
}

}  // namespace facet::avatar
