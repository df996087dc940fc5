#pragma once

#include <cstddef>

#include "capture/depth_map.hpp"
#include "capture/rig.hpp"
#include "scan/phase_decoder.hpp"
#include "stereo/rectification.hpp"

namespace facet::scan {

struct StructuredLightOptions {
  stereo::DepthRange depths{600, 900};
  int width_px = 0;  ///< of the depth map; 0: as the left camera's pictures
  int height_px = 0;
  float most_sigma_mm = 0.5F;  ///< standard deviation of a depth
  float break_mm = 3;          ///< neighbours that differ by more are on different surfaces
  int least_island_px = 100;   ///< smaller pieces of surface are noise
  int least_width_px = 3;      ///< of a surface, across and down: thinner ones lie between two others
  /// Where both axes are coded: how far a match may lie from where the other axis says, px of the right
  /// camera's rows or of the projector.
  float most_disagreement_px = 2;
};

/// A depth map from structured light.
struct StructuredDepth {
  capture::DepthMap map;
  std::size_t ambiguous = 0;    ///< pixels with more than one match: holes
  std::size_t disagreeing = 0;  ///< whose phases along the other axis tell that the match is none: holes
  /// Median distance between where a match lies and where it should, px, along the rows of the right camera
  /// or across the projector's columns: tells a calibration that does not fit. 0 where one axis alone is
  /// coded.
  float epipolar_px = 0;
  std::size_t epipolar_count = 0;  ///< matches behind it
};

/// Depth from two cameras that saw one projector's sequence: along each rectified row, the right camera's
/// phase is interpolated to the left pixel's. The projector needs no calibration.
/// left, right  of the pair's cameras' picture sizes, with the columns coded (rows as a check), or the rows
///              alone where the projector is turned
/// Throws Error(Usage) for what Rectification refuses, views of other sizes than the lenses', or axes that
/// are not coded in both. Any thread.
StructuredDepth match_phases(const capture::Rig& rig, const capture::StereoPair& pair,
                             const DecodedView& left, const DecodedView& right,
                             const StructuredLightOptions& options);

/// Depth from one camera and the projector that it saw: where each pixel's line of sight, projected, is at
/// the column (and row, if both are coded) that lights the pixel. The map's lens is the camera's without its
/// distortion. Needs the sequence's numbers of periods. Throws as above.
StructuredDepth triangulate_phases(const capture::Rig& rig, std::size_t camera, std::size_t projector,
                                   const DecodedView& view, const StructuredLightOptions& options);

/// Depths in which the surface lies that two cameras decoded, found by matching at all depths; nothing
/// narrower than what may be expected where there are few matches. Throws as match_phases.
stereo::DepthRange find_depths(const capture::Rig& rig, const capture::StereoPair& pair,
                               const DecodedView& left, const DecodedView& right);
stereo::DepthRange find_depths(const capture::Rig& rig, std::size_t camera, std::size_t projector,
                               const DecodedView& view);

}  // namespace facet::scan
