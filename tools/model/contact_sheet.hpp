#pragma once

#include <functional>

#include "face/face_model.hpp"
#include "render/renderer.hpp"

namespace facet::model {

struct SheetOptions {
  int tile_px = 200;        ///< of one picture
  int columns = 8;          ///< pictures per row, even
  bool identities = true;   ///< the identity modes at -2 and +2 standard deviations
  bool expressions = true;  ///< every expression at weight 1, from the front and from the side
};

/// A labelled picture of what a model can do. progress(done, total) is called after every tile.
render::Picture contact_sheet(const face::FaceModel& model, const SheetOptions& options,
                              const std::function<void(int done, int total)>& progress);

}  // namespace facet::model
