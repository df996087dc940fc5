#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "booth/booth_shading.hpp"
#include "booth/face_points.hpp"
#include "booth/photometric.hpp"
#include "capture/depth_map.hpp"
#include "capture/rig.hpp"
#include "face/face_model.hpp"
#include "facet/frame_set.hpp"
#include "fit/skin_tracker.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::booth {

/// From the depth maps and the colour pictures of blank slots to one mesh in correspondence: the face is
/// looked for by its landmarks, the template is placed and fitted, then followed from slot to slot
/// (docs/template-fit.md). A face that is lost is looked for again. Slots with stripes between blank ones
/// get a mesh by their depth maps. One thread at a time, on the CPU.
class PerformanceTracker {
 public:
  /// rig: one colour camera at least. points: where the first person's face is in their slot, of cameras of
  /// the rig; no mesh before that. shading: of that rig; null: none. Throws Error: Usage where there is no
  /// such camera, UnreadableInput for the landmark nets and for a model that can't be refined, Unavailable
  /// without Embree.
  PerformanceTracker(std::shared_ptr<const face::FaceModel> model, const std::filesystem::path& landmark_nets,
                     std::shared_ptr<const capture::Rig> rig, const fit::SkinTrackerOptions& options,
                     std::optional<FacePoints> points = {}, std::unique_ptr<BoothShading> shading = nullptr);
  ~PerformanceTracker();

  /// How far a blank slot's face is from rest: the norm of its expression by landmarks (fit::FirstShape).
  /// Empty: no face is seen, or where it is was pointed at. Nothing that follows depends on it.
  std::optional<double> strain(const FrameSet& set, std::span<const capture::DepthMap> maps);

  /// The next blank slot, in order of time, or against it while nothing is handed out. set: frames in the
  /// rig's order. maps: [pairs] of that slot. out: state, subject, pose, expression and vertices, as seen by
  /// the rig's first colour camera; the times of landmarks and fit. Says in degraded_reason what was missing.
  /// lit: slots between the blank slot before and this one that known lights lit.
  void process(const FrameSet& set, std::span<const capture::DepthMap> maps, mesh::MeshFrame& out,
               std::span<const LitSlot> lit = {});

  /// A slot with stripes between the last two that `process` was given, after the later one. fraction: of the
  /// time from the one to the other; not between 0 and 1: no blank slot has come after it, and there is no
  /// mesh. maps, out: as above, without landmarks; the albedo is the latest.
  void process_between(double fraction, std::span<const capture::DepthMap> maps, mesh::MeshFrame& out);

  /// Forgets the person; the next slots are searched for a face.
  void reset();

  /// Of the shading's device. Any thread.
  std::vector<Messages::Message> take_messages();

  /// Of the mesh in the last slot that had one, rig frame; null before. For checks and pictures.
  const mesh::Vertices* vertices_mm() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::booth
