#pragma once

#include <string>
#include <vector>

#include "calibration/calibrator.hpp"
#include "render/renderer.hpp"

namespace facet::calibration {

/// Where in each camera's picture corners were seen: a tile a camera, its cells dark where there were none.
/// names and coverage [camera_count].
render::Picture coverage_picture(const std::vector<std::string>& names,
                                 const std::vector<Coverage>& coverage);

/// What remains at every corner of every view as a line from where it was seen towards where the model puts
/// it, `exaggeration` times as long: a tile a camera. Lines that turn together are a lens that the model does
/// not fit, lines in all directions are noise.
render::Picture error_picture(const Calibration& calibration, double exaggeration);
/// An exaggeration (1, 2 or 5 times a power of ten) that makes the mean error about a sixtieth of the
/// picture.
double fitting_exaggeration(const Calibration& calibration);

}  // namespace facet::calibration
