#pragma once

#include <Eigen/Core>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "facet/frame.hpp"
#include "stereo/rectification.hpp"

namespace facet::stereo {

/// Fringes that lit a slot.
struct Fringes {
  double shift_turns = 0;  ///< parts of a period
  bool blank = false;      ///< the even light that is their mean, in their place
};

struct FringeSlot {
  int slots_away = 0;  ///< from the slot whose phase is wanted
  Fringes fringes;
};

/// What each slot's linear grey counts for in a sum that is e^(i phase) times the fringes' amplitude in the
/// slot that is wanted: the least squares estimate where light, amplitude and phase drift evenly from slot to
/// slot, as on a moving face (docs/stereo.md, S12). Empty where the slots tell no phase: fewer than three, or
/// of shifts that are too much alike.
struct PhaseWeights {
  std::vector<std::complex<double>> of_slots;
  double error_rad = 0;  ///< of the phase, standard deviation over all drifts
};
PhaseWeights phase_weights(std::span<const FringeSlot> slots);

struct FringeOptions {
  float noise = 0.01F;     ///< standard deviation of a linear grey value (0 to 1)
  float own_drift = 0.3F;  ///< part of PhaseWeights::error_rad that the two cameras do not have in common
  /// Phases that motion may put further off do for start values alone: fewer than two slots of fringes on
  /// either side of a blank one.
  float most_error_rad = 0.08F;
  float saturated = 250.5F / 255;    ///< grey as coded, from which on a pixel says nothing
  float least_amplitude = 0.02F;     ///< of the fringes, linear grey
  float least_slope_rad = 0.15F;     ///< of the fringes, per px
  float most_move_px = 0.5F;         ///< further from where it is looked for, the same phase is another's
  int smooth_px = 1;                 ///< phases are averaged over (2 n + 1)^2 px of a picture, 0 to 4
  int most_carried_px = 3;           ///< over how many px without a phase a surface is followed
  std::size_t least_piece_px = 300;  ///< of start values that begin a surface
};

/// A slot as a pair saw it.
struct FringePictures {
  const Frame* left = nullptr;
  const Frame* right = nullptr;
  FringeSlot slot;
};

/// Disparities at which both cameras see the same phase of fringes (docs/stereo.md, "Fringes"): pixel by
/// pixel, without the flattening of stereo's windows. On the CPU. Keeps its memory from call to call. One
/// thread at a time. Arrays are [height][width] of the rectified left picture.
class FringeMatcher {
 public:
  /// left_sources, right_sources  Rectification's, which must outlive it; rows of width_px
  /// Throws Error(Usage) for options out of range.
  FringeMatcher(std::span<const Eigen::Vector2f> left_sources, std::span<const Eigen::Vector2f> right_sources,
                int width_px, const FringeOptions& options);

  /// Memory once it has seen fringes, of two cameras of that size.
  static std::size_t bytes(const capture::Lens& camera, std::size_t rectified_pixels);

  /// Finds the phases of the slot that is wanted, which the other calls are about.
  /// slots  the fringes in it and around it; pictures are there and of their cameras' sizes
  /// False where they tell none.
  bool look(std::span<const FringePictures> slots);

  /// Whether the phases are near enough for `refine`.
  bool can_refine() const { return error_rad_ <= options_.most_error_rad; }

  /// Fringes repeat, and start values may be whole periods off. The largest piece of them is taken to be
  /// right, as a face is one surface, and followed from pixel to pixel by phase; then, where it did not come,
  /// the next ones.
  /// start_px  in/out, NaN: none
  /// lit       1 where the surface may go
  void spread(std::span<float> start_px, std::span<const std::uint8_t> lit);

  /// disparity_px, sigma_px  in/out; sigma 0: no disparity, and none is looked for
  /// Returns how many were refined; the others keep what they are given with. None where motion may put the
  /// phases off by more than most_error_rad.
  std::size_t refine(std::span<float> disparity_px, std::span<float> sigma_px) const;

 private:
  /// Phases as one camera sees them; NaN where none is known.
  struct View {
    std::span<const Eigen::Vector2f> sources;
    std::vector<float> seen_rad, seen_variance;  ///< [height][width] of its picture
    std::vector<float> smooth_rad, smooth_variance;
    std::vector<float> phase_rad, variance;  ///< rectified
  };
  struct Match {
    float disparity_px = 0;
    float sigma_px = 0;
  };
  void sum_up(std::span<const Frame* const> frames, std::span<const std::complex<double>> weights,
              View& view) const;
  void smooth(int width, int height, View& view) const;
  static void rectify(int width, int height, View& view);
  bool match(std::size_t at, float start_px, Match& found) const;
  void find_pieces(std::span<const float> start_px);
  void follow(std::span<const std::size_t> piece, std::span<const float> start_px,
              std::span<const std::uint8_t> lit);
  template <typename Work>
  void for_neighbours(std::size_t at, const Work& work) const;

  std::size_t width_;
  std::size_t height_;
  FringeOptions options_;
  float error_rad_ = 0;  ///< PhaseWeights::error_rad
  View left_, right_;
  std::vector<std::size_t> members_;            ///< pixels, piece by piece
  std::vector<std::span<std::size_t>> pieces_;  ///< of members_, largest first
  std::vector<std::uint8_t> reached_;           ///< 1: in a piece
  std::vector<float> followed_px_;              ///< NaN: not reached
  std::vector<std::uint8_t> carried_;           ///< px since the last phase
  std::vector<std::size_t> wave_, next_wave_;
};

}  // namespace facet::stereo
