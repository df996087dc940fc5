#include "capture/patterns.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <random>

#include "facet/error.hpp"

namespace facet::capture {
namespace {

constexpr double kLargestSlant_rad = 8 * std::numbers::pi / 180;
constexpr double kEdge_px = 0.8;            // sigma of a stripe's edge
constexpr double kLeastStep = 0.25;         // between the light of neighbours
constexpr double kWidthSpread = 0.4;        // of the mean width, to either side
constexpr double kBlankLight = 0.5;         // the mean of the stripes and of the fringes
constexpr double kWander_rad = 1.5;         // of the fringes' phase, to either side
constexpr double kWander_periods = 1;       // between the knots of that field
constexpr int kTableSteps = 16;             // per pixel, of the tabulated light across the stripes
constexpr double kReach_px = 5 * kEdge_px;  // beyond it an edge is over

void check(const PatternConfig& config) {
  constexpr int kLeastSide_px = 16;
  constexpr int kMostSide_px = 8192;
  const auto side_fits = [](int side_px) { return side_px >= kLeastSide_px && side_px <= kMostSide_px; };
  if (!side_fits(config.width_px) || !side_fits(config.height_px)) {
    throw Error(ErrorKind::Usage,
                fmt::format("patterns of {}x{} px: a projector's sides are {} to {} px", config.width_px,
                            config.height_px, kLeastSide_px, kMostSide_px));
  }
  if (!(config.stripe_px >= 3 && config.stripe_px <= static_cast<float>(config.width_px))) {
    throw Error(ErrorKind::Usage,
                fmt::format("stripes of {} px: they are 3 px to the picture's width wide", config.stripe_px));
  }
  if (!(config.fringe_px >= 8 && config.fringe_px <= static_cast<float>(config.width_px))) {
    throw Error(ErrorKind::Usage,
                fmt::format("fringes of {} px: they are 8 px to the picture's width wide", config.fringe_px));
  }
  if (!(config.gamma >= 1 && config.gamma <= 4)) {
    throw Error(ErrorKind::Usage,
                fmt::format("a projector's gamma of {}: it lies between 1 and 4", config.gamma));
  }
}

/// The engine's numbers are the same with every library, std's distributions are not.
class Random {
 public:
  Random(std::uint64_t seed, std::uint64_t number, std::uint64_t projector) {
    std::array<std::uint32_t, 6> words{};
    std::size_t at = 0;
    for (const std::uint64_t value : {seed, number, projector}) {
      words.at(at++) = static_cast<std::uint32_t>(value);
      words.at(at++) = static_cast<std::uint32_t>(value >> 32);
    }
    std::seed_seq sequence(words.begin(), words.end());
    engine_.seed(sequence);
  }
  double uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(engine_() >> 11) * 0x1p-53);
  }

 private:
  std::mt19937_64 engine_;
};

/// A light from 0 to 1 that differs from its neighbour's by kLeastStep at least, evenly spread over what is
/// left.
double next_light(double before, Random& random) {
  const double below = std::max(0.0, before - kLeastStep);
  const double above = std::max(0.0, 1 - kLeastStep - before);
  const double at = random.uniform(0, below + above);
  return at < below ? at : before + kLeastStep + (at - below);
}

/// Light along the line across the stripes, from `first_px` on, kTableSteps a pixel.
std::vector<double> light_across(double first_px, double length_px, const PatternConfig& config,
                                 Random& random) {
  struct Edge {
    double at_px;
    double step;
  };
  std::vector<Edge> edges;
  double light = random.uniform(0, 1);
  const double first_light = light;
  const auto mean_px = static_cast<double>(config.stripe_px);
  double at_px = first_px - kReach_px - random.uniform(0, mean_px);
  while (at_px < first_px + length_px + kReach_px) {
    at_px += mean_px * random.uniform(1 - kWidthSpread, 1 + kWidthSpread);
    const double next = next_light(light, random);
    edges.push_back({at_px, next - light});
    light = next;
  }
  const auto count = static_cast<std::size_t>(std::ceil(length_px * kTableSteps)) + 2;
  std::vector<double> table(count);
  std::size_t begin = 0;  // the edges before it are over
  double before = first_light;
  for (std::size_t k = 0; k < count; ++k) {
    const double here_px = first_px + static_cast<double>(k) / kTableSteps;
    while (begin < edges.size() && edges[begin].at_px < here_px - kReach_px) {
      before += edges[begin++].step;
    }
    double sum = before;
    for (std::size_t e = begin; e < edges.size() && edges[e].at_px < here_px + kReach_px; ++e) {
      sum += edges[e].step * 0.5 * std::erfc((edges[e].at_px - here_px) / (kEdge_px * std::numbers::sqrt2));
    }
    table[k] = sum;
  }
  return table;
}

/// What is added to the fringes' phase: a random value at each knot of a grid, smooth between them.
class Wander {
 public:
  Wander(const PatternConfig& config, std::size_t projector)
      : pitch_px_(kWander_periods * static_cast<double>(config.fringe_px)),
        columns_(static_cast<std::size_t>(config.width_px / pitch_px_) + 2) {
    constexpr std::uint64_t kOwn = ~std::uint64_t{0};  // no stripes have that number
    Random random(config.seed, kOwn, projector);
    knots_.resize(columns_ * (static_cast<std::size_t>(config.height_px / pitch_px_) + 2));
    for (double& knot : knots_) {
      knot = random.uniform(-kWander_rad, kWander_rad);
    }
  }
  double operator()(int x, int y) const {
    const auto column = static_cast<std::size_t>(x / pitch_px_);
    const auto row = static_cast<std::size_t>(y / pitch_px_);
    const double across = eased(x / pitch_px_ - static_cast<double>(column));
    const double down = eased(y / pitch_px_ - static_cast<double>(row));
    const auto along = [&](std::size_t line) {
      const double* knot = knots_.data() + line * columns_ + column;
      return (1 - across) * knot[0] + across * knot[1];
    };
    return (1 - down) * along(row) + down * along(row + 1);
  }

 private:
  static double eased(double part) { return part * part * (3 - 2 * part); }

  double pitch_px_;
  std::size_t columns_;
  std::vector<double> knots_;
};

constexpr std::size_t kEncoderSteps = 1 << 16;

}  // namespace

ProjectorEncoder::ProjectorEncoder(const PatternConfig& config) {
  check(config);
  const auto gamma = static_cast<double>(config.gamma);
  values_.reserve(kEncoderSteps + 1);
  for (std::size_t k = 0; k <= kEncoderSteps; ++k) {
    values_.push_back(static_cast<std::uint8_t>(
        std::lround(255 * std::pow(static_cast<double>(k) / kEncoderSteps, 1 / gamma))));
  }
}

std::uint8_t ProjectorEncoder::operator()(double light) const {
  return values_[static_cast<std::size_t>(std::lround(std::clamp(light, 0.0, 1.0) * kEncoderSteps))];
}

GreyImage draw_pattern(const PatternConfig& config, const Shown& shown, std::size_t projector) {
  const ProjectorEncoder encode(config);
  if (shown.kind == Shown::Kind::Picture) {
    throw Error(ErrorKind::Usage, "a picture of its own is no pattern that could be drawn");
  }
  GreyImage image{config.width_px, config.height_px, {}};
  image.values.assign(static_cast<std::size_t>(config.width_px) * static_cast<std::size_t>(config.height_px),
                      shown.kind == Shown::Kind::Blank ? encode(kBlankLight) : std::uint8_t{0});
  if (shown.kind == Shown::Kind::Fringes) {
    const Wander wander(config, projector);
    constexpr double kTurn = 2 * std::numbers::pi;
    const double shift = kTurn / 4 * static_cast<double>(shown.number % 4);
    std::uint8_t* value = image.values.data();
    for (int y = 0; y < config.height_px; ++y) {
      for (int x = 0; x < config.width_px; ++x) {
        const double phase = kTurn * x / static_cast<double>(config.fringe_px) + wander(x, y) + shift;
        *value++ = encode((1 + std::cos(phase)) / 2);
      }
    }
  }
  if (shown.kind != Shown::Kind::Stripes) {
    return image;
  }
  Random random(config.seed, shown.number, projector);
  const double slant_rad = random.uniform(-kLargestSlant_rad, kLargestSlant_rad);
  const double across_x = std::cos(slant_rad);
  const double across_y = std::sin(slant_rad);
  const double bottom_px = across_y * (config.height_px - 1);
  const double first_px = std::min(0.0, bottom_px);
  const double length_px = across_x * (config.width_px - 1) + std::abs(bottom_px);
  const std::vector<double> table = light_across(first_px, length_px, config, random);
  std::uint8_t* value = image.values.data();
  for (int y = 0; y < config.height_px; ++y) {
    for (int x = 0; x < config.width_px; ++x) {
      const double at = (across_x * x + across_y * y - first_px) * kTableSteps;
      const auto step = static_cast<std::size_t>(at);
      const double part = at - static_cast<double>(step);
      *value++ = encode((1 - part) * table[step] + part * table[step + 1]);
    }
  }
  return image;
}

}  // namespace facet::capture
