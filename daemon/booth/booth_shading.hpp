#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "capture/rig.hpp"
#include "face/face_model.hpp"
#include "facet/messages.hpp"
#include "fit/template_mesh.hpp"
#include "mesh/hierarchy.hpp"
#include "refine/refine_stage.hpp"
#include "refine/refiner.hpp"

namespace facet::booth {

/// The refinement's settings on top of displacements that depth maps gave.
refine::RefinerConfig booth_refinement();

/// Shading on top of a booth's fine levels: what the colour pictures of a blank slot say of the skin's slopes
/// moves the displacements that depth maps gave (docs/template-fit.md, "Shading on top"). One refinement a
/// colour camera (refine::Refiner, with the fine mesh as its only level); what they add is averaged by their
/// confidence. A device that is lost is opened again; meanwhile that camera adds nothing. One thread but for
/// take_messages.
class BoothShading {
 public:
  /// rig: its colour cameras count. Seconds, for the kernels are compiled. Throws Error(NoDevice).
  BoothShading(const std::string& gpu_device, const capture::Rig& rig,
               const refine::RefinerConfig& config = booth_refinement());
  /// The same with refinements that `open` opens, one a camera, whose displacements are held within bound_mm.
  BoothShading(const refine::OpenRefiner& open, const capture::Rig& rig, float bound_mm);
  ~BoothShading();

  /// A new person. hierarchy: of fit::FineSurface over `surface`.
  void begin(const mesh::Hierarchy& hierarchy, const fit::TemplateMesh& surface,
             const face::FaceModel& model);

  /// pictures          [colour cameras] as they came; an empty one is left out
  /// template_mm       [3][template vertex_count] rig frame
  /// displacements_mm  [finest vertex_count] along the normals of the template subdivided, by depth
  /// added_mm          out: [finest vertex_count] what shading adds to them; may turn triangles over
  ///                   (FineSurface::add)
  /// Returns why a camera adds nothing, for people, or that none has a picture; empty where all is well.
  std::string refine(std::span<const Frame> pictures, const mesh::Vertices& template_mm,
                     std::span<const float> displacements_mm, std::vector<float>& added_mm);

  /// The next slot does not follow the one before.
  void restart();

  /// Of devices that went and came. Any thread.
  std::vector<Messages::Message> take_messages();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::booth
