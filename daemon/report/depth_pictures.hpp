#pragma once

#include <filesystem>
#include <vector>

#include "capture/depth_map.hpp"
#include "render/renderer.hpp"

namespace facet::report {

/// Shaded relief of a depth map, lit from the upper left; holes are blue.
render::Picture relief_of(const capture::DepthMap& map);

/// Writes a depth map's surface as binary PLY: vertices in the rig's frame, mm, with normals, grey,
/// confidence and sigma_mm, and the triangles between neighbouring pixels whose depths differ by no more than
/// break_mm. grey  [height_px][width_px] 0 to 1, linear; empty: white Returns the number of vertices. Throws
/// Error(Storage).
std::size_t write_depth_ply(const capture::DepthMap& map, const std::vector<float>& grey, float break_mm,
                            const std::filesystem::path& file);

}  // namespace facet::report
