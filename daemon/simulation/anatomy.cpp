#include "simulation/anatomy.hpp"

#include <fmt/format.h>

#include "facet/error.hpp"

namespace facet::simulation {

Anatomy find_anatomy(const face::FaceModel& model, const mesh::Vertices& neutral_mm) {
  const auto at = [&](std::size_t landmark) -> Eigen::Vector3f {
    if (landmark >= model.landmarks.size() ||
        (model.landmarks[landmark].weights[0] == 0 && model.landmarks[landmark].weights[1] == 0 &&
         model.landmarks[landmark].weights[2] == 0)) {
      throw Error(
          ErrorKind::UnreadableInput,
          fmt::format("the face model '{}' lacks landmark {}, which the virtual actor needs; build it "
                      "with `facet model build`",
                      model.name, landmark));
    }
    return face::FaceModel::anchor_point(model.landmarks[landmark], neutral_mm);
  };
  // Numbers of MediaPipe's face mesh.
  return {.eye_outer = {at(33), at(263)},
          .eye_inner = {at(133), at(362)},
          .lid_upper = {at(159), at(386)},
          .lid_lower = {at(145), at(374)},
          .brow = {at(105), at(334)},
          .mouth_corner = {at(61), at(291)},
          .nasion = at(168),
          .nose_tip = at(1),
          .lip_upper = at(13),
          .lip_lower = at(14),
          .chin = at(152),
          .forehead = at(10)};
}

}  // namespace facet::simulation
