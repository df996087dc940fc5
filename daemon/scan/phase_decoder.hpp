#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "capture/code_sequence.hpp"

namespace facet::scan {

/// How a camera's grey values follow from light.
enum class Response : std::uint8_t {
  Linear,  ///< in proportion: most industrial cameras
  Srgb,    ///< sRGB: most other pictures
};

struct DecodeOptions {
  Response response = Response::Linear;
  float least_modulation = 0.02F;  ///< of the fringes, linear grey (white is 1)
  float saturated = 250.5F / 255;  ///< grey as coded, from which on a pixel says nothing
  /// Of a Gray bit, parts of the fringes' modulation; one bit may be less clear, the one whose edge is near.
  float least_bit = 0.35F;
  /// Of what is no sine (rms), parts of the modulation; with more than 3 shifts. A projector whose gamma
  /// nobody took into account leaves 0.3.
  float most_residual = 0.4F;
  float noise = 0.01F;  ///< standard deviation of a linear grey value, for sets of 3 shifts alone
  /// Phases of several sets disagree (rms) by no more, radians.
  float most_disagreement_rad = 0.5F;
  /// Phases are averaged over (2 n + 1)^2 px of one surface, in pairs opposite of each other, so that slopes
  /// do not count. 0 to 8.
  int smooth_px = 1;
};

/// Why a pixel has no phase.
enum class PhaseFault : std::uint8_t {
  None,
  Unlit,      ///< its fringes have too little modulation
  Saturated,  ///< in one of its fringes
  Gray,       ///< more than one Gray bit is unclear, or its number is no period of the projector
  Residual,   ///< its grey values are no sine
  Order,      ///< which period it is in can't be told
};
inline constexpr std::size_t kPhaseFaults = 6;
const char* to_string(PhaseFault fault);

/// Along one axis of the projector, what a camera's pixels are lit by. Arrays are [height_px][width_px].
struct PhaseField {
  int width_px = 0;
  int height_px = 0;
  std::vector<float> phase_rad;  ///< absolute, of the finest fringes; NaN where it is not known
  std::vector<float> sigma_rad;  ///< standard deviation from the pictures' noise; 0 where not known
  double periods = 0;            ///< over the projector's picture; 0: not given
  /// Phase at the projector's edge: position 0 to 1 is (phase - start) / (2 pi periods).
  double start_rad = 0;

  /// How the fringes were found to lie to their Gray code or to each other.
  bool reversed = false;      ///< the pictures are shifted the other way round than draw_coded's
  int cells_per_period = 0;   ///< of the Gray code; 0 without one
  double agreement = 0;       ///< 1: periods and code fit; 0: they have nothing to do with each other
  std::string why_no_phases;  ///< for people, where no phase could be told at all; else empty
};

/// What a camera saw of a sequence.
struct DecodedView {
  int width_px = 0;
  int height_px = 0;
  PhaseField columns;  ///< its arrays are empty where that axis is not coded
  PhaseField rows;
  std::vector<float> light;         ///< mean linear grey over the fringes' shifts, for texture
  std::vector<float> modulation;    ///< of the finest fringes, linear grey
  std::vector<PhaseFault> fault;    ///< of the first axis that has one
  std::vector<std::size_t> faults;  ///< [kPhaseFaults] pixels with each fault
  float residual = 0;               ///< median over lit pixels of what is no sine, parts of the modulation
};

/// From the pictures of a phase-shift sequence to absolute phase (docs/structured-light.md has the
/// equations). On the CPU: a picture is read once, and few operations a pixel fall on it. Memory: 16 bytes a
/// pixel and set of fringes, 2 bytes a Gray bit. One thread at a time.
class PhaseDecoder {
 public:
  /// Throws Error(Usage) for sizes below 1 or options out of range.
  PhaseDecoder(const capture::CodeSequence& sequence, int width_px, int height_px,
               const DecodeOptions& options);
  ~PhaseDecoder();
  PhaseDecoder(PhaseDecoder&& other) noexcept;
  PhaseDecoder& operator=(PhaseDecoder&& other) noexcept;

  /// Takes a picture in, in any order, each once.
  /// picture  index into the sequence's pictures
  /// grey     [height_px][width_px] as coded, 0 to 1
  /// Throws Error(Usage) for another size, an index beyond the sequence or a picture that was given before.
  void add(std::size_t picture, std::span<const float> grey);

  /// What was seen. Throws Error(Usage) where a picture is missing.
  DecodedView decode() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::scan
