#include "track/expression_prior.hpp"

#include <algorithm>
#include <array>
#include <string_view>

namespace facet::track {
namespace {

/// Left and right differ by about this much in talking faces.
constexpr double kSymmetrySigma = 0.15;
/// mouthClose undoes jawOpen; more of it than that pushes the lips through each other.
constexpr double kMouthCloseSigma = 0.05;
constexpr double kSmallestSigma = 0.02;
/// /// What the irises show; what the lid points would say of the gaze without them is better said by the
/// blink.
constexpr std::string_view kGaze = "eyeLook";
constexpr std::string_view kLookIn = "eyeLookIn";
constexpr std::string_view kLookOut = "eyeLookOut";
/// Eyes turn by some 15 degrees before the head follows, half of an eyeLook shape's way.
constexpr double kGazeSigma = 0.5;

/// Shapes of one side that undo each other; "Left" and "Right" are appended to both.
constexpr std::array<std::pair<std::string_view, std::string_view>, 11> kOpposedSided = {{
    {"browDown", "browOuterUp"},
    {"eyeBlink", "eyeWide"},
    {"eyeLookIn", "eyeLookOut"},
    {"eyeLookUp", "eyeLookDown"},
    {"eyeSquint", "eyeWide"},
    {"mouthSmile", "mouthFrown"},
    {"mouthLowerDown", "mouthPress"},
    {"mouthUpperUp", "mouthPress"},
    {"mouthStretch", "mouthSmile"},
    {"mouthDimple", "mouthStretch"},
    {"noseSneer", "browOuterUp"},
}};

constexpr std::array<std::pair<std::string_view, std::string_view>, 19> kOpposed = {{
    {"browInnerUp", "browDownLeft"},
    {"browInnerUp", "browDownRight"},
    {"jawLeft", "jawRight"},
    {"mouthLeft", "mouthRight"},
    {"mouthShrugLower", "mouthRollLower"},
    {"mouthShrugUpper", "mouthRollUpper"},
    {"mouthPucker", "mouthSmileLeft"},
    {"mouthPucker", "mouthSmileRight"},
    {"mouthPucker", "mouthStretchLeft"},
    {"mouthPucker", "mouthStretchRight"},
    {"mouthPucker", "mouthDimpleLeft"},
    {"mouthPucker", "mouthDimpleRight"},
    {"mouthFunnel", "mouthRollUpper"},
    {"mouthFunnel", "mouthRollLower"},
    {"mouthFunnel", "mouthPressLeft"},
    {"mouthFunnel", "mouthPressRight"},
    {"jawOpen", "mouthShrugLower"},
    {"mouthRollLower", "mouthLowerDownLeft"},
    {"mouthRollLower", "mouthLowerDownRight"},
}};

}  // namespace

ExpressionPrior::ExpressionPrior(std::span<const std::string> names, std::span<const float> sigma,
                                 const ExpressionPriorStrength& strength, bool sees_gaze)
    : strength_(strength), sigma_(static_cast<Eigen::Index>(names.size())) {
  for (std::size_t k = 0; k < names.size(); ++k) {
    sigma_[static_cast<Eigen::Index>(k)] = names[k].starts_with(kGaze)
                                               ? (sees_gaze ? kGazeSigma : kSmallestSigma)
                                               : std::max(static_cast<double>(sigma[k]), kSmallestSigma);
    constexpr std::string_view kLeft = "Left";
    // jawLeft and mouthLeft move to the left: they are no halves of a symmetric shape.
    if (names[k].ends_with(kLeft) && names[k] != "jawLeft" && names[k] != "mouthLeft") {
      std::string stem = names[k].substr(0, names[k].size() - kLeft.size());
      // Both eyes look at one thing: when one turns to the nose the other turns away from it.
      if (stem == kLookIn) {
        stem = kLookOut;
      } else if (stem == kLookOut) {
        stem = kLookIn;
      }
      if (const auto right = find(names, stem + "Right")) {
        mirrored_.emplace_back(static_cast<int>(k), *right);
      }
    }
  }
  const auto oppose = [&](const std::string& first, const std::string& second) {
    const auto a = find(names, first);
    const auto b = find(names, second);
    if (a && b) {
      opposed_.emplace_back(*a, *b);
    }
  };
  for (const auto& [first, second] : kOpposedSided) {
    for (const char* side : {"Left", "Right"}) {
      oppose(std::string(first) + side, std::string(second) + side);
    }
  }
  for (const auto& [first, second] : kOpposed) {
    oppose(std::string(first), std::string(second));
  }
  const auto close = find(names, "mouthClose");
  const auto open = find(names, "jawOpen");
  if (close && open) {
    mouth_close_and_jaw_open_ = std::make_pair(*close, *open);
  }
}

std::optional<int> ExpressionPrior::find(std::span<const std::string> names, const std::string& name) const {
  const auto at = std::find(names.begin(), names.end(), name);
  return at == names.end() ? std::nullopt : std::optional<int>(static_cast<int>(at - names.begin()));
}

double ExpressionPrior::energy(const Eigen::VectorXd& expression) const {
  const auto square = [](double x) { return x * x; };
  double sum = 0;
  for (Eigen::Index k = 0; k < sigma_.size(); ++k) {
    const double scaled = expression[k] / sigma_[k];
    sum += 0.5 * strength_.size * scaled * scaled + strength_.sparsity * scaled;
  }
  for (const auto& [left, right] : mirrored_) {
    sum += 0.5 * strength_.symmetry * square((expression[left] - expression[right]) / kSymmetrySigma);
  }
  for (const auto& [a, b] : opposed_) {
    sum += 0.5 * strength_.exclusion * square(expression[a] * expression[b] / (sigma_[a] * sigma_[b]));
  }
  if (mouth_close_and_jaw_open_) {
    const auto [close, open] = *mouth_close_and_jaw_open_;
    sum += 0.5 * square(std::max(0.0, expression[close] - expression[open]) / kMouthCloseSigma);
  }
  return sum;
}

void ExpressionPrior::add(const Eigen::VectorXd& expression, int at, Eigen::MatrixXd& hessian,
                          Eigen::VectorXd& gradient) const {
  // Adds weight/2 (x_a - x_b)^2.
  const auto add_difference = [&](int a, int b, double weight) {
    const double difference = expression[a] - expression[b];
    hessian(at + a, at + a) += weight;
    hessian(at + b, at + b) += weight;
    hessian(at + a, at + b) -= weight;
    hessian(at + b, at + a) -= weight;
    gradient[at + a] += weight * difference;
    gradient[at + b] -= weight * difference;
  };
  for (int k = 0; k < static_cast<int>(sigma_.size()); ++k) {
    hessian(at + k, at + k) += strength_.size / (sigma_[k] * sigma_[k]);
    gradient[at + k] +=
        strength_.size * expression[k] / (sigma_[k] * sigma_[k]) + strength_.sparsity / sigma_[k];
  }
  for (const auto& [left, right] : mirrored_) {
    add_difference(left, right, strength_.symmetry / (kSymmetrySigma * kSymmetrySigma));
  }
  for (const auto& [a, b] : opposed_) {
    const double scale = 1.0 / (sigma_[a] * sigma_[b]);
    const double residual = scale * expression[a] * expression[b];
    const double by_a = scale * expression[b];
    const double by_b = scale * expression[a];
    hessian(at + a, at + a) += strength_.exclusion * by_a * by_a;
    hessian(at + b, at + b) += strength_.exclusion * by_b * by_b;
    hessian(at + a, at + b) += strength_.exclusion * by_a * by_b;
    hessian(at + b, at + a) += strength_.exclusion * by_a * by_b;
    gradient[at + a] += strength_.exclusion * by_a * residual;
    gradient[at + b] += strength_.exclusion * by_b * residual;
  }
  if (mouth_close_and_jaw_open_) {
    const auto [close, open] = *mouth_close_and_jaw_open_;
    if (expression[close] > expression[open]) {
      add_difference(close, open, 1.0 / (kMouthCloseSigma * kMouthCloseSigma));
    }
  }
}

}  // namespace facet::track
