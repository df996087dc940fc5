#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "gpu/batch.hpp"
#include "stereo/volume.hpp"

namespace facet::stereo {

enum class SpacetimeMethod {
  Global,  ///< [SF04 eq. 5-9]: one disparity field; the windows' slopes are its differences
  Local,   ///< [SF04 eq. 4]: every pixel on its own with d, dx, dy, dt free; for comparison
};

/// How the disparities of a volume are found (docs/stereo.md has the equations).
struct SpacetimeOptions {
  SpacetimeMethod method = SpacetimeMethod::Global;
  int window_x = 9;  ///< odd; 1 in t: frame by frame
  int window_y = 5;
  int window_t = 5;
  /// The windows of as many rows are summed together as have their sums in so many bytes. 0: as the device
  /// can hold and likes. What is found does not depend on it.
  std::size_t part_bytes = 0;
  int steps = 3;  ///< Gauss-Newton
  int cg_iterations = 8;
  float damping = 1;         ///< per px^2: an update with a variance above 1 px^2 is held back
  float most_move_px = 1;    ///< per step
  float noise = 0.01F;       ///< standard deviation of a grey value (0 to 1)
  float straddle_px = 0.5F;  ///< a window whose field strays more than that from a plane does not flatten it
  float least_texture = 0.01F;  ///< a window of less contrast (standard deviation of grey) says nothing
  float break_px = 1.5F;        ///< neighbours that start further apart are on different surfaces
};

/// Told that a long call gets on.
using Alive = std::function<void()>;

enum class StereoOutcome { Done, NumericalFailure, DeviceLost };

/// Disparities of a volume.
struct DisparityField {
  StereoOutcome outcome = StereoOutcome::Done;
  std::string failure;              ///< for people, empty where all is well
  std::vector<float> disparity_px;  ///< [slots][height][width]; 0 where there was no start value
  std::vector<float> sigma_px;      ///< [slots][height][width] standard deviation; 0 where nothing is known
  std::vector<float> correlation;   ///< [slots][height][width] of the pictures over the window, 0 to 1
  std::vector<double> energies;     ///< [steps] before each step
};

/// Spacetime stereo on the GPU: from start values to sub-pixel disparities, d(x, y, t): left pixel (x, y) of
/// slot t is right pixel (x - d, y). One thread at a time. The context must outlive it.
class SpacetimeSolver {
 public:
  /// Throws Error(Usage) for options that make no sense and a volume that is too large, Error(NoDevice).
  SpacetimeSolver(gpu::Context& context, const VolumeSize& size, const SpacetimeOptions& options);
  ~SpacetimeSolver();

  const VolumeSize& size() const;

  /// Rectified pictures [slots][height][width], grey 0 to 1, below 0 where a picture says nothing. Kernels
  /// write them (rectify), or gpu::upload.
  const gpu::Buffer& left() const;
  const gpu::Buffer& right() const;

  /// Solves from start values and waits. Memory grows with the most disparities that were to be found; where
  /// the device has none left, it counts as lost.
  /// start_px  [slots][height][width]; NaN: no disparity there, nor any in the result
  /// out       its vectors are set to the volume's size; what is solved has a sigma above 0
  /// alive     called while it waits for the device, four times a second
  void solve(
      std::span<const float> start_px, DisparityField& out, const Alive& alive = [] {});

  /// Of the last solve, on the device: "start", "solve", "quality".
  std::span<const gpu::StageTime> stage_times() const;
  /// Of the last solve.
  std::size_t dispatch_count() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::stereo
