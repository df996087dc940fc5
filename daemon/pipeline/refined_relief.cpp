#include "pipeline/refined_relief.hpp"

#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "face/face_parts.hpp"
#include "face/subject_builder.hpp"
#include "person/skin_follower.hpp"

namespace facet::pipeline {
namespace {

/// The face in one picture: the tracked mesh where its skin is.
struct Posed {
  const person::Keyframe* keyframe;
  mesh::MeshFrame mesh;
};

/// Tracks the face in every picture, with what all of them say of who it is.
std::vector<Posed> pose(const face::FaceModel& own, const person::Observed& observed,
                        track::TrackerConfig config, const std::function<bool()>& go_on) {
  config.live = false;
  track::Tracker tracker(own, config);
  std::optional<person::SkinFollower> follower;
  if (!own.skin.albedo.empty()) {
    follower.emplace(own);
  }
  std::vector<Posed> out;
  std::int64_t now_ns = 0;
  for (const bool known : {false, true}) {
    if (known) {
      tracker.settle_subject();
    }
    for (const person::Keyframe& keyframe : observed.keyframes) {
      if (!go_on()) {
        return {};
      }
      Frame picture = person::picture_of(keyframe, observed.camera);
      picture.media_time_ns = now_ns += kKeyframeStep_ns;
      const track::TrackResult& tracked = tracker.process(picture);
      if (!known || tracked.state != mesh::TrackingState::Tracking) {
        continue;
      }
      person::FollowedHead followed{tracked.camera_from_head, tracked.vertices_mm};
      if (follower) {
        follower->follow(picture, tracked, followed);
      }
      Posed now{&keyframe, {}};
      now.mesh.state = tracked.state;
      now.mesh.camera = tracked.camera;
      now.mesh.camera_from_head = followed.camera_from_head;
      now.mesh.control_vertices_mm = std::move(followed.vertices_mm);
      out.push_back(std::move(now));
    }
  }
  return out;
}

/// Adds the mean over the pictures of what each shows more. Returns why not; empty where all went well or
/// go_on said no.
std::string add_mean(face::FaceModel& own, const person::Observed& observed, const std::vector<Posed>& poses,
                     const mesh::HierarchyOptions& options, refine::RefineStage& stage,
                     const std::function<bool()>& go_on) {
  const std::vector<float> nobody(static_cast<std::size_t>(own.identity_count()));
  const auto subject = face::build_subject(own, options, poses.front().mesh, nobody, 0);
  face::KnownSkin known = face::known_skin(own, *subject->hierarchy);
  const std::vector<float> before_mm = known.relief_mm;
  if (!go_on()) {
    return {};
  }
  stage.set_subject({.hierarchy = subject->hierarchy,
                     .mean_albedo = own.mean_albedo,
                     .refinable = own.control.refinable,
                     .trust = face::shading_trust(own),
                     .known_shape = true,
                     .relief_mm = std::move(known.relief_mm),
                     .skin_albedo = std::move(known.albedo)});
  std::vector<float> more_mm(before_mm.size(), 0);
  std::size_t refined = 0;
  std::string failure;
  refine::RefineOutput output;
  for (const Posed& each : poses) {
    if (!go_on()) {
      return {};
    }
    refine::RefineInput input;
    input.image = person::picture_of(*each.keyframe, observed.camera);
    input.camera = each.mesh.camera;
    input.camera_from_head = each.mesh.camera_from_head;
    input.control_vertices_mm = &each.mesh.control_vertices_mm;
    const refine::RefineOutcome outcome = stage.refine(input, output);
    if (outcome != refine::RefineOutcome::Refined) {
      failure = output.failure;
      if (outcome == refine::RefineOutcome::DeviceLost) {
        return failure;
      }
      continue;
    }
    ++refined;
    for (std::size_t v = 0; v < more_mm.size(); ++v) {
      more_mm[v] += output.displacements_mm[v] - before_mm[v];
    }
  }
  if (2 * refined < observed.keyframes.size()) {
    return failure.empty() ? "the face is found in too few of the pictures" : failure;
  }
  for (float& more : more_mm) {
    more /= static_cast<float>(refined);
  }
  face::add_relief(subject->hierarchy->finest().triangles, subject->hierarchy->texture_coordinates, more_mm,
                   own.skin);
  return {};
}

}  // namespace

std::string refine_relief(face::FaceModel& own, const person::Observed& observed,
                          const track::TrackerConfig& tracker, const ReliefRefinement& how,
                          const std::function<bool()>& go_on) {
  if (!how.open || own.skin.empty()) {
    return {};
  }
  std::string missed;
  try {
    const std::unique_ptr<refine::RefineStage> stage = how.open();
    const std::vector<Posed> poses = pose(own, observed, tracker, go_on);
    if (!go_on()) {
      return {};
    }
    missed = poses.empty() ? "the face is found in none of the pictures"
                           : add_mean(own, observed, poses, how.hierarchy, *stage, go_on);
  } catch (const std::exception& error) {
    missed = error.what();
  }
  return missed.empty() ? missed : "the skin's relief was not refined: " + missed;
}

}  // namespace facet::pipeline
