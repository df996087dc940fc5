#include "landmark/appearance.hpp"

#include <algorithm>
#include <cmath>

namespace facet::landmark {

void measure_appearance(const Frame& frame, const FaceLandmarks& face, Eigen::VectorXf& brightness) {
  constexpr int samples = 5;  ///< per axis
  constexpr int middle = samples / 2;
  constexpr float patch_interocular = 0.16F;  ///< side of the patch averaged round a landmark
  const float step = patch_interocular * face.interocular_px / (samples - 1);
  const auto last_x = static_cast<float>(frame.width_px - 1);
  const auto last_y = static_cast<float>(frame.height_px - 1);
  brightness.resize(landmark_count);
  for (int i = 0; i < landmark_count; ++i) {
    float sum = 0;
    for (int row = 0; row < samples; ++row) {
      const float y = face.points_px(1, i) + static_cast<float>(row - middle) * step;
      const std::uint8_t* pixels = frame.row(static_cast<int>(std::clamp(y + 0.5F, 0.0F, last_y)));
      for (int column = 0; column < samples; ++column) {
        const float x = face.points_px(0, i) + static_cast<float>(column - middle) * step;
        const std::uint8_t* pixel = pixels + 4 * static_cast<std::size_t>(std::clamp(x + 0.5F, 0.0F, last_x));
        sum += 0.299F * pixel[0] + 0.587F * pixel[1] + 0.114F * pixel[2];
      }
    }
    brightness[i] = sum / (samples * samples);
  }
}

float likeness(const Eigen::VectorXf& a, const Eigen::VectorXf& b, const Eigen::VectorXf& weights) {
  const float total = weights.sum();
  if (!(total > 0)) {
    return 0;
  }
  const float mean_a = weights.dot(a) / total;
  const float mean_b = weights.dot(b) / total;
  const auto contrast_a = a.array() - mean_a;
  const auto contrast_b = b.array() - mean_b;
  const float together = (weights.array() * contrast_a * contrast_b).sum();
  const float power =
      (weights.array() * contrast_a.square()).sum() * (weights.array() * contrast_b.square()).sum();
  return power > 0 ? together / std::sqrt(power) : 0.0F;
}

}  // namespace facet::landmark
