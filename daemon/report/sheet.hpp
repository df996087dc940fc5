#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "render/renderer.hpp"
#include "report/take_pictures.hpp"
#include "take/reader.hpp"

namespace facet::report {

/// One row per frame: input, coarse mesh over the image, refined normals, shaded refined mesh, albedo,
/// photometric error; what is not there is said in its place. frames: indices in the take. images may be
/// null. done(count) is called after every row. Throws Error(UnreadableInput) from the reader.
render::Picture make_sheet(take::TakeReader& take, const std::vector<std::int64_t>& frames,
                           SourceImages* images, const std::function<void(int)>& done);

}  // namespace facet::report
