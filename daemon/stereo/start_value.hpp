#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "stereo/volume.hpp"

namespace facet::stereo {

enum class StartMethod {
  ScanLines,   ///< dynamic programming along each scan line with occlusion and ordering [CHRM96]
  SemiGlobal,  ///< costs gathered along paths of several directions [Hir08]
};

/// Where start values are found. Both ways find the same up to rounding.
enum class StartPlace {
  Best,  ///< on the device where it is a GPU that can
  Host,
  Device,  ///< Error(Usage) where it cannot
};

/// Costs of a match are 0 (alike) to 255.
struct StartOptions {
  StartMethod method = StartMethod::SemiGlobal;
  StartPlace place = StartPlace::Best;
  int window_t = 5;          ///< slots that a cost looks at; 1 is the paper's 1x3 window, 3 its 1x3x3
  int path_count = 8;        ///< semi-global: 4 or 8
  int step_cost = 8;         ///< semi-global: of a change by one px along a path
  int jump_cost = 64;        ///< semi-global: of a larger one
  int occlusion_cost = 24;   ///< scan lines: of a pixel that one camera alone sees
  int most_cost = 60;        ///< of a match; beyond, nothing fits
  float uniqueness = 0.02F;  ///< semi-global: by how much any other disparity must cost more
  float least_grey = 0.15F;  ///< what no slot of the window shows brighter is not lit, and says nothing
};

/// Start values of one slot at a time, on the CPU: whole disparities (semi-global: with a parabola's
/// fraction), NaN where left and right do not agree, where the right camera does not see what the left one
/// sees, or where nothing fits. On a GPU: DeviceStart.
class StartValue {
 public:
  /// least_px, most_px  disparities that are looked at, both included
  /// Sets up all memory. Throws Error(Usage) where the range is empty or wider than the pictures, or for
  /// options that make no sense.
  StartValue(int width_px, int height_px, int least_px, int most_px, const StartOptions& options);

  /// Memory of this object, all of it set up; of costs only as much is touched as the box around what is lit
  /// needs.
  std::size_t bytes() const;

  /// left, right  pictures, [slots][height][width] grey 0 to 1, below 0 where a picture says nothing. A slot
  /// of
  ///              which nothing can be said takes its costs from those beside it within window_t.
  /// start_px     [height][width] out
  void find(const VolumeSize& size, std::span<const float> left, std::span<const float> right, int slot,
            std::span<float> start_px);

 private:
  void normalise(std::span<const float> grey, const std::vector<std::uint8_t>& lit,
                 std::vector<std::uint8_t>& out);
  void row_costs(int row, std::size_t slot_count);
  bool find_box();
  void semi_global(std::span<float> start_px);
  template <bool backward, std::size_t paths>
  void sweep();
  template <bool fresh, std::size_t paths>
  void advance(const std::uint8_t* cost, const std::array<const std::uint16_t*, paths>& previous,
               std::array<std::uint16_t, paths>& least, const std::array<std::uint16_t*, paths>& current,
               std::uint16_t* total) const;
  void choose(int row, std::span<float> line_px);
  void scan_lines(std::span<float> start_px);

  /// Where a pixel of the box has its costs.
  std::size_t place(int x, int y) const {
    return (static_cast<std::size_t>(y - box_.y) * static_cast<std::size_t>(box_.past_x - box_.x) +
            static_cast<std::size_t>(x - box_.x)) *
           count_;
  }
  std::uint8_t* costs(int x, int y) { return costs_.data() + place(x, y); }
  std::uint16_t* totals(int x, int y) { return totals_.data() + place(x, y); }

  struct Box {
    int x = 0, past_x = 0, y = 0, past_y = 0;
  };

  int width_;
  int height_;
  int least_;
  std::size_t used_;   ///< disparities
  std::size_t count_;  ///< the same, rounded up to whole vectors
  StartOptions options_;
  Box box_;                                              ///< around what is lit
  std::vector<std::vector<std::uint8_t>> left_, right_;  ///< [window_t][height][width] normalised; 0: nothing
  std::vector<std::uint8_t> left_lit_, right_lit_;       ///< [height][width] 1 where a pattern lights it
  std::vector<std::uint8_t> costs_;                      ///< [of the box: height, width][count_]
  std::vector<std::uint16_t> totals_;                    ///< the same, summed over the paths
  std::vector<std::uint16_t> row_sums_;                  ///< [width][count_] over the slots
  std::vector<std::uint8_t> reversed_;                   ///< a row of the right picture, backwards, padded
  std::vector<std::uint16_t> right_cost_, right_best_;   ///< of a row's right pixels, as reversed_
  std::vector<std::uint16_t> paths_;                     ///< [2][4][width + 2][count_ + 2 pads]
  std::vector<std::uint16_t> path_least_;                ///< [2][4][width + 2]
  std::vector<double> columns_;                          ///< [3][width]
};

}  // namespace facet::stereo
