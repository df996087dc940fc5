#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "face/face_model.hpp"
#include "mesh/hierarchy.hpp"
#include "person/keyframes.hpp"
#include "refine/refine_stage.hpp"
#include "track/tracker.hpp"

namespace facet::pipeline {

/// Between keyframes as they are shown to a tracker: each by itself, none after a loss.
inline constexpr std::int64_t kKeyframeStep_ns = 400'000'000;

/// What a learned face's relief is refined with.
struct ReliefRefinement {
  mesh::HierarchyOptions hierarchy;
  refine::OpenRefiner open;  ///< empty: reliefs stay as they are
};

/// Refines the relief of a face in the pictures that it was learned from: in each of them the face is
/// tracked, its skin followed and its relief refined as in any frame [MD19 eq. 6]. As the head turns the
/// light leads each picture astray in another way, so that their mean is nearer than one of them
/// (docs/person.md); a vertex that a picture does not show has there what it had. Each picture goes on from
/// the displacements of the one before. Where half of the pictures can't be refined, and where the device is
/// lost, all stays as it is.
///
/// own      of one person, with a skin
/// tracker  with the camera that the pictures are of
/// go_on    asked before each picture, which takes up to a second, and before the device's work; false breaks
///          it off, with the relief as it was
/// Returns for people why it was not refined; empty where it was, where nothing is to be refined with or on,
/// and where it was broken off. Some seconds of a processor, the device as for a few frames; any thread.
std::string refine_relief(face::FaceModel& own, const person::Observed& observed,
                          const track::TrackerConfig& tracker, const ReliefRefinement& how,
                          const std::function<bool()>& go_on);

}  // namespace facet::pipeline
