#include "scan/phase_noise.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "maths/statistics.hpp"

namespace facet::scan {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

}  // namespace

std::vector<float> grey_noise(const std::vector<Sine>& sines, int shifts,
                              const std::vector<PhaseFault>& fault, float assumed) {
  constexpr std::size_t kBins = 16;
  constexpr std::size_t kEnough = 200;
  std::vector<float> noise(kBins, assumed);
  if (shifts == 3) {
    return noise;
  }
  std::array<std::vector<float>, kBins> values;
  std::vector<float> all;
  for (std::size_t at = 0; at < sines.size(); ++at) {
    if (fault[at] == PhaseFault::None) {
      const auto bin = static_cast<std::size_t>(
          std::clamp(sines[at].mean * static_cast<float>(kBins), 0.0F, static_cast<float>(kBins - 1)));
      const float variance = sines[at].rest / static_cast<float>(shifts - 3);
      values[bin].push_back(variance);
      all.push_back(variance);
    }
  }
  const auto dof = static_cast<double>(shifts - 3);
  const double share = std::pow(1 - 2 / (9 * dof), 3);
  const auto deviation = [&](std::vector<float>& variances) {
    const auto middle = static_cast<double>(maths::median_of(variances));
    // 8 bits round by 1/12 of a level's square: no camera is better.
    constexpr double kRounding = 1.0 / 12 / 255 / 255;
    return static_cast<float>(std::sqrt(std::max(middle / share, kRounding)));
  };
  if (all.size() < kEnough) {
    return noise;
  }
  const float overall = deviation(all);
  for (std::size_t bin = 0; bin < kBins; ++bin) {
    noise[bin] = values[bin].size() < kEnough ? overall : deviation(values[bin]);
  }
  return noise;
}

void drop_lonely(PhaseField& field, std::vector<PhaseFault>& fault) {
  const int width = field.width_px;
  const int height = field.height_px;
  const std::vector<float> phase = field.phase_rad;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const std::size_t at =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
      if (std::isnan(phase[at])) {
        continue;
      }
      const auto agrees = [&](bool there, std::size_t other) {
        return there && std::abs(phase[other] - phase[at]) < kPi;  // false for NaN
      };
      const int friends = (agrees(x > 0, at - 1) ? 1 : 0) + (agrees(x + 1 < width, at + 1) ? 1 : 0) +
                          (agrees(y > 0, at - static_cast<std::size_t>(width)) ? 1 : 0) +
                          (agrees(y + 1 < height, at + static_cast<std::size_t>(width)) ? 1 : 0);
      if (friends < 2) {
        field.phase_rad[at] = kNan;
        field.sigma_rad[at] = 0;
        fault[at] = fault[at] == PhaseFault::None ? PhaseFault::Order : fault[at];
      }
    }
  }
}

void smooth(PhaseField& field, int reach) {
  const int width = field.width_px;
  const int height = field.height_px;
  if (reach == 0) {
    return;
  }
  constexpr float kBend_rad = 0.05F;
  const std::vector<float> phase = field.phase_rad;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const auto index = [&](int column, int row) {
        return static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
               static_cast<std::size_t>(column);
      };
      const std::size_t at = index(x, y);
      if (std::isnan(phase[at])) {
        continue;
      }
      const float limit = 5 * field.sigma_rad[at] + kBend_rad;
      float sum = 0;  // of what the others are away from the middle
      int count = 1;
      for (int dy = 0; dy <= reach; ++dy) {
        for (int dx = dy == 0 ? 1 : -reach; dx <= reach; ++dx) {
          if (y - dy < 0 || y + dy >= height || x - std::abs(dx) < 0 || x + std::abs(dx) >= width) {
            continue;
          }
          const float pair =
              (phase[index(x + dx, y + dy)] - phase[at]) + (phase[index(x - dx, y - dy)] - phase[at]);
          if (std::abs(pair) < 2 * limit) {  // false for NaN
            sum += pair;
            count += 2;
          }
        }
      }
      field.phase_rad[at] = phase[at] + sum / static_cast<float>(count);
      field.sigma_rad[at] /= std::sqrt(static_cast<float>(count));
    }
  }
}

}  // namespace facet::scan
