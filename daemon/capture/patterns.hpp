#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace facet::capture {

/// What the projectors show in one slot.
struct Shown {
  enum class Kind : std::uint8_t {
    Dark,     ///< nothing: off
    Blank,    ///< an even grey, for texture and flow
    Stripes,  ///< pattern `number`, for depth
    Fringes,  ///< shifted by `number` quarters of a period, for depth
    Picture,  ///< a picture that is none of these
  };
  Kind kind = Kind::Dark;
  std::uint64_t number = 0;  ///< of the stripes: never the same again; of the fringes: 0 to 3

  bool operator==(const Shown&) const = default;
};

struct PatternConfig {
  std::uint64_t seed = 1;
  int width_px = 1024;  ///< of the projector, 16 to 8192
  int height_px = 768;
  /// Mean width of a stripe, at least 3. What the cameras see should be no narrower than 3 of their pixels.
  float stripe_px = 6;
  /// Period of the fringes, 8 to the picture's width; 6 pixels of the cameras at least.
  float fringe_px = 16;
  /// Of the projector: its light is (value / 255)^gamma. 1 to 4.
  float gamma = 2.2F;
};

/// What a projector is given to show: 8 bits a pixel, top row first.
struct GreyImage {
  int width_px = 0;
  int height_px = 0;
  std::vector<std::uint8_t> values;  ///< [height_px][width_px]
};

/// What a projector is given so that its light comes out as wanted.
class ProjectorEncoder {
 public:
  /// Throws Error(Usage) where the configuration is out of range.
  explicit ProjectorEncoder(const PatternConfig& config);
  /// light: 0 to 1 of white, clamped
  std::uint8_t operator()(double light) const;

 private:
  std::vector<std::uint8_t> values_;  ///< of evenly spaced light: the power is too slow for every pixel
};

/// Random stripes as in [SF04], upright but for a slant of up to 8 degrees, so that no two rows
/// are the same. Each has its own width (0.6 to 1.4 of the mean) and light (0 to 1, a quarter at least from
/// its neighbour's); edges are soft (Gaussian, sigma 0.8 px), so that nothing is finer than the projector can
/// show.
///
/// Fringes are a sine across the picture, of all the light there is, whose phase wanders by 1.5 radians over
/// a random field of 16 px: whole periods apart they are not alike, in any direction.
///
/// Blank is half of white's light. Everything follows from seed, number and projector (which counts
/// from 0: projectors that light the same skin need different stripes), and is the same on every machine.
/// Throws Error(Usage) where the configuration is out of range or a Picture is wanted.
GreyImage draw_pattern(const PatternConfig& config, const Shown& shown, std::size_t projector = 0);

}  // namespace facet::capture
