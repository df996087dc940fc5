#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "capture/depth_map.hpp"
#include "capture/rig.hpp"
#include "face/face_model.hpp"
#include "fit/template_mesh.hpp"
#include "landmark/landmarker.hpp"

namespace facet::booth {

/// The landmarks that one camera saw.
struct SeenLandmarks {
  const capture::Lens* lens = nullptr;
  const landmark::FaceLandmarks* face = nullptr;
  bool by_hand = false;  ///< a person pointed at them, whom steep skin does not deceive
};

/// Landmarks brought into space: each one's line of sight meets the surface of the depth maps. Where several
/// cameras see a landmark, the mean of those that agree within 8 mm counts, weighted by confidence and by how
/// squarely the skin is seen there; a landmark in a hole, on skin that is turned away by more than 60
/// degrees (where a net guesses), or that the face model has no place for, is left out. anchors  [468] of the
/// face model. Allocates; 0.2 s. Any thread.
std::vector<fit::Correspondence> landmarks_in_space(std::span<const SeenLandmarks> views,
                                                    std::span<const capture::DepthMap> maps,
                                                    std::span<const face::LandmarkAnchor> anchors);

}  // namespace facet::booth
