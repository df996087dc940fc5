#include "scan/phase_decoder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <utility>

#include "facet/error.hpp"

namespace facet::scan {
namespace {

using capture::CodeSequence;
using ::testing::HasSubstr;

constexpr double kTurn = 2 * std::numbers::pi;
constexpr int kProjectorWidth = 640;
constexpr int kProjectorHeight = 480;

/// What a camera sees of a slanted plane on which a projector shows a sequence: optics blur, room light,
/// uneven albedo, noise, 8 bits.
struct Scene {
  int width = 200;
  int height = 24;
  double noise = 0.004;
  double gain = 0.8;
  Response response = Response::Linear;
  bool mirrored = false;  ///< the projector's columns run from right to left
  std::uint32_t seed = 5;

  /// Position on the projector, 0 to 1.
  double across(int x, int y) const {
    const double at = 0.07 + 0.86 * (x + 0.3) / width + 0.01 * y / height;
    return mirrored ? 1 - at : at;
  }
  double down(int x, int y) const { return 0.1 + 0.8 * (y + 0.2) / height + 0.02 * x / width; }

  std::vector<float> picture(const CodeSequence& sequence, std::size_t number) const {
    capture::PatternConfig config;
    config.width_px = kProjectorWidth;
    config.height_px = kProjectorHeight;
    const capture::GreyImage shown = capture::draw_coded(config, sequence, number);
    // All pictures are even along the other axis, or over both.
    const bool rows = sequence.pictures[number].axis == capture::CodeAxis::Rows;
    const int length = rows ? kProjectorHeight : kProjectorWidth;
    std::vector<double> light;
    for (int k = 0; k < length; ++k) {
      const int at = rows ? k * kProjectorWidth : k;
      light.push_back(std::pow(shown.values[static_cast<std::size_t>(at)] / 255.0, 2.2));
    }
    const auto blurred = [&](double position) {
      constexpr double sigma_px = 0.8;
      double sum = 0;
      double weights = 0;
      const double centre = position * length - 0.5;
      for (int k = static_cast<int>(centre) - 4; k <= static_cast<int>(centre) + 5; ++k) {
        const double weight = std::exp(-0.5 * std::pow((k - centre) / sigma_px, 2));
        sum += weight * light[static_cast<std::size_t>(std::clamp(k, 0, length - 1))];
        weights += weight;
      }
      return sum / weights;
    };
    std::mt19937 random(seed * 977 + static_cast<std::uint32_t>(number));
    std::normal_distribution<double> normal;
    std::vector<float> out;
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double albedo = 0.75 + 0.2 * std::sin(0.31 * x) * std::cos(0.4 * y);
        double value = gain * albedo * (0.06 + 0.94 * blurred(rows ? down(x, y) : across(x, y)));
        value = std::clamp(value + noise * normal(random), 0.0, 1.0);
        if (response == Response::Srgb) {
          value = value <= 0.0031308 ? 12.92 * value : 1.055 * std::pow(value, 1 / 2.4) - 0.055;
        }
        out.push_back(static_cast<float>(std::lround(255 * value)) / 255);
      }
    }
    return out;
  }

  DecodedView decode(const std::string& text, const DecodeOptions& options = {}) const {
    const CodeSequence sequence = capture::parse_sequence(text);
    PhaseDecoder decoder(sequence, width, height, options);
    for (std::size_t k = 0; k < sequence.pictures.size(); ++k) {
      decoder.add(k, picture(sequence, k));
    }
    return decoder.decode();
  }
};

struct Figures {
  std::size_t decoded = 0;
  std::size_t wrong_periods = 0;
  double rms_rad = 0;
  double relative = 0;  ///< error / sigma, rms
  double bias_rad = 0;
};

Figures judge(const Scene& scene, const PhaseField& field) {
  Figures out;
  double squares = 0;
  double relative = 0;
  for (int y = 0; y < scene.height; ++y) {
    for (int x = 0; x < scene.width; ++x) {
      const std::size_t at = static_cast<std::size_t>(y * scene.width + x);
      const auto phase = static_cast<double>(field.phase_rad[at]);
      if (std::isnan(phase)) {
        EXPECT_EQ(field.sigma_rad[at], 0);
        continue;
      }
      ++out.decoded;
      EXPECT_GT(field.sigma_rad[at], 0);
      const double error = phase - field.start_rad - kTurn * field.periods * scene.across(x, y);
      if (std::abs(error) > std::numbers::pi) {
        ++out.wrong_periods;
        continue;
      }
      squares += error * error;
      out.bias_rad += error;
      relative += std::pow(error / static_cast<double>(field.sigma_rad[at]), 2);
    }
  }
  const auto n = static_cast<double>(out.decoded - out.wrong_periods);
  out.rms_rad = std::sqrt(squares / n);
  out.relative = std::sqrt(relative / n);
  out.bias_rad /= n;
  return out;
}

TEST(PhaseDecoder, FindsTheProjectorsColumnsFromAnyUsualSequence) {
  const Scene scene;
  DecodeOptions options;
  options.smooth_px = 0;
  options.noise = 0.004F;
  for (const char* text : {
           "phase:3x40,gray:6",
           "phase:4x40,gray:6",
           "phase:4x40,gray:6,white,black",
           "phase:8x40,gray:6,gray-inverse:6",
           "gray-pairs:6,phase:16x40",
           "phase:5x40,gray:6:fine-first",
           "phase:4x40,gray:7",
           "phase:4x20,gray-pairs:6",
           "phase:4x1,phase:4x7,phase:4x40",
           "phase:3x40,phase:3x8,phase:3x1",
           "phase:4x40,phase:4x36.5,phase:4x34",
           "phase:4x1,phase:4x40",
       }) {
    SCOPED_TRACE(text);
    const DecodedView view = scene.decode(text, options);
    EXPECT_EQ(view.columns.why_no_phases, "");
    EXPECT_TRUE(view.rows.phase_rad.empty());
    const Figures figures = judge(scene, view.columns);
    EXPECT_EQ(figures.wrong_periods, 0U);
    // One coarse set beside a fine one leaves little room for noise.
    EXPECT_GT(figures.decoded, static_cast<std::size_t>(0.97 * scene.width * scene.height));
    EXPECT_LT(figures.rms_rad, 0.04);
    EXPECT_LT(std::abs(figures.bias_rad), 0.03);
    // Sines of 3 and 4 shifts keep the harmonics that 8 bits and gamma leave.
    EXPECT_GT(figures.relative, 0.6);
    EXPECT_LT(figures.relative, 2);
    EXPECT_NEAR(view.columns.start_rad, 0, 0.03);
    EXPECT_FALSE(view.columns.reversed);
    EXPECT_EQ(view.faults[0], figures.decoded);
  }
}

TEST(PhaseDecoder, NoiseIsToldBySigmaAndLoweredByTheMeanOverNeighbours) {
  Scene scene;
  scene.noise = 0.012;
  DecodeOptions options;
  options.smooth_px = 0;
  const Figures sharp = judge(scene, scene.decode("phase:8x40,gray:6,gray-inverse:6", options).columns);
  options.smooth_px = 1;
  const Figures smooth = judge(scene, scene.decode("phase:8x40,gray:6,gray-inverse:6", options).columns);
  EXPECT_EQ(sharp.wrong_periods + smooth.wrong_periods, 0U);
  EXPECT_NEAR(sharp.relative, 1, 0.15);
  EXPECT_NEAR(smooth.relative, 1, 0.3);
  EXPECT_LT(smooth.rms_rad, 0.55 * sharp.rms_rad);
}

/// Sequences of others: the shifts run the other way, phase 0 lies elsewhere, the code counts from the right.
TEST(PhaseDecoder, FindsHowOthersSequencesLie) {
  const Scene scene;
  const CodeSequence sequence = capture::parse_sequence("phase:4x40,gray:6");
  const auto decoded = [&](const std::vector<std::size_t>& phases, const Scene& seen) {
    PhaseDecoder decoder(sequence, scene.width, scene.height, {});
    for (std::size_t k = 0; k < sequence.pictures.size(); ++k) {
      decoder.add(k, seen.picture(sequence, k < 4 ? phases[k] : k));
    }
    return decoder.decode();
  };
  const DecodedView backwards = decoded({0, 3, 2, 1}, scene);
  EXPECT_TRUE(backwards.columns.reversed);
  EXPECT_EQ(judge(scene, backwards.columns).wrong_periods, 0U);
  EXPECT_LT(judge(scene, backwards.columns).rms_rad, 0.05);
  // From the second shift on: phase 0 is a quarter of a period away.
  const DecodedView shifted = decoded({1, 2, 3, 0}, scene);
  EXPECT_NEAR(std::abs(shifted.columns.start_rad), std::numbers::pi / 2, 0.05);
  EXPECT_EQ(judge(scene, shifted.columns).wrong_periods, 0U);
  EXPECT_LT(judge(scene, shifted.columns).rms_rad, 0.06);
  // A camera that is turned over sees the columns rise from right to left.
  Scene mirrored = scene;
  mirrored.mirrored = true;
  const DecodedView turned = decoded({0, 1, 2, 3}, mirrored);
  EXPECT_FALSE(turned.columns.reversed);
  EXPECT_EQ(judge(mirrored, turned.columns).wrong_periods, 0U);
  EXPECT_GT(judge(mirrored, turned.columns).decoded, 4600U);
}

TEST(PhaseDecoder, RowsAreDecodedBesideColumns) {
  Scene scene;
  scene.height = 120;
  const DecodedView view = scene.decode("phase:4x40,gray:6,rows,phase:4x16,gray:4");
  EXPECT_EQ(judge(scene, view.columns).wrong_periods, 0U);
  ASSERT_EQ(view.rows.phase_rad.size(), view.columns.phase_rad.size());
  std::size_t decoded = 0;
  for (int y = 0; y < scene.height; ++y) {
    for (int x = 0; x < scene.width; ++x) {
      const float phase = view.rows.phase_rad[static_cast<std::size_t>(y * scene.width + x)];
      if (!std::isnan(phase)) {
        ++decoded;
        ASSERT_NEAR(static_cast<double>(phase) - view.rows.start_rad, kTurn * 16 * scene.down(x, y), 0.2);
      }
    }
  }
  EXPECT_GT(decoded, static_cast<std::size_t>(0.95 * scene.width * scene.height));
}

TEST(PhaseDecoder, SrgbPicturesAreSinesOnceTheyAreLinear) {
  Scene scene;
  scene.response = Response::Srgb;
  DecodeOptions options;
  options.response = Response::Srgb;
  const DecodedView right = scene.decode("phase:4x40,gray:6,gray-inverse:6", options);
  options.response = Response::Linear;
  const DecodedView wrong = scene.decode("phase:4x40,gray:6,gray-inverse:6", options);
  EXPECT_LT(right.residual, 0.5 * wrong.residual);
  EXPECT_LT(judge(scene, right.columns).rms_rad, 0.03);
  // What is no sine bends the phase, but not into another period.
  EXPECT_EQ(judge(scene, wrong.columns).wrong_periods, 0U);
  EXPECT_GT(judge(scene, wrong.columns).decoded, 4500U);
}

TEST(PhaseDecoder, WhatCannotBeKnownIsAFault) {
  const Scene scene;
  const CodeSequence sequence = capture::parse_sequence("phase:8x40,gray:6,gray-inverse:6");
  PhaseDecoder decoder(sequence, scene.width, scene.height, {});
  std::mt19937 random(3);
  for (std::size_t k = 0; k < sequence.pictures.size(); ++k) {
    std::vector<float> grey = scene.picture(sequence, k);
    for (int y = 0; y < scene.height; ++y) {
      float* row = &grey[static_cast<std::size_t>(y * scene.width)];
      for (int x = 0; x < 20; ++x) {
        row[x] = 0.05F;  // in the dark
        row[x + 30] = std::min(1.0F, 1.6F * row[x + 30]);
        row[x + 60] = static_cast<float>(random() % 200) / 255;  // leaves in the wind
        if (sequence.pictures[k].kind != capture::CodedPicture::Kind::Phase) {
          row[x + 90] = 0.3F;  // the code is not seen
        }
      }
    }
    decoder.add(k, grey);
  }
  const DecodedView view = decoder.decode();
  const auto count = [&](int first, PhaseFault fault) {
    int found = 0;
    for (int y = 0; y < scene.height; ++y) {
      for (int x = first; x < first + 20; ++x) {
        found += view.fault[static_cast<std::size_t>(y * scene.width + x)] == fault ? 1 : 0;
      }
    }
    return found;
  };
  const int all = 20 * scene.height;
  EXPECT_EQ(count(0, PhaseFault::Unlit), all);
  EXPECT_GT(count(30, PhaseFault::Saturated), all / 4);
  EXPECT_EQ(count(60, PhaseFault::None), 0);
  EXPECT_GT(count(60, PhaseFault::Residual), all * 3 / 4);
  EXPECT_EQ(count(90, PhaseFault::Gray), all);
  EXPECT_GT(count(130, PhaseFault::None), all * 9 / 10);
  std::size_t sum = 0;
  for (const std::size_t faults : view.faults) {
    sum += faults;
  }
  EXPECT_EQ(sum, view.fault.size());
}

TEST(PhaseDecoder, PicturesInAnotherOrderAreToldOf) {
  const Scene scene;
  const auto mixed = [&](const std::string& text,
                         const std::vector<std::pair<std::size_t, std::size_t>>& swaps) {
    const CodeSequence sequence = capture::parse_sequence(text);
    std::vector<std::size_t> order;
    for (std::size_t k = 0; k < sequence.pictures.size(); ++k) {
      order.push_back(k);
    }
    for (const auto& [a, b] : swaps) {
      std::swap(order[a], order[b]);
    }
    PhaseDecoder decoder(sequence, scene.width, scene.height, {});
    for (std::size_t k = 0; k < order.size(); ++k) {
      decoder.add(k, scene.picture(sequence, order[k]));
    }
    return decoder.decode();
  };
  // Bits with the finest first, read as if it were the last.
  const DecodedView bits = mixed("phase:4x40,gray:6", {{4, 9}, {5, 8}, {6, 7}});
  EXPECT_THAT(bits.columns.why_no_phases, HasSubstr("order"));
  EXPECT_EQ(bits.faults[0], 0U);
  const DecodedView sets = mixed("phase:4x1,phase:4x7,phase:4x40", {{0, 4}, {1, 5}, {2, 6}, {3, 7}});
  EXPECT_THAT(sets.columns.why_no_phases, HasSubstr("order"));
  EXPECT_EQ(sets.faults[0], 0U);
  // The shifts of a set the other way round, which for a set alone nobody could tell.
  const DecodedView one_set = mixed("phase:4x1,phase:4x7,phase:4x40", {{5, 7}});
  EXPECT_THAT(one_set.columns.why_no_phases, HasSubstr("do not fit each other"));
  const DecodedView same = mixed("phase:4x20,phase:4x40", {});
  EXPECT_THAT(same.columns.why_no_phases, HasSubstr("do not tell 40 periods apart"));
}

TEST(PhaseDecoder, RefusesWhatIsNoSequence) {
  const CodeSequence sequence = capture::parse_sequence("phase:4x40,gray:6");
  EXPECT_THROW(PhaseDecoder(sequence, 0, 4, {}), Error);
  DecodeOptions options;
  options.smooth_px = 9;
  EXPECT_THROW(PhaseDecoder(sequence, 4, 4, options), Error);
  PhaseDecoder decoder(sequence, 4, 4, {});
  const std::vector<float> grey(16, 0.5F);
  EXPECT_THROW(decoder.add(10, grey), Error);
  EXPECT_THROW(decoder.add(0, std::span(grey).first(15)), Error);
  decoder.add(0, grey);
  EXPECT_THROW(decoder.add(0, grey), Error);
  EXPECT_THROW(decoder.decode(), Error);
  for (std::size_t k = 1; k < 10; ++k) {
    decoder.add(k, grey);
  }
  const DecodedView nothing = decoder.decode();  // no pixel is lit
  EXPECT_EQ(nothing.faults[static_cast<std::size_t>(PhaseFault::Unlit)], 16U);
}

}  // namespace
}  // namespace facet::scan
