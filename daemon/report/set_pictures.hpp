#pragma once

#include <cstddef>
#include <filesystem>

#include "facet/frame_set.hpp"

namespace facet::report {

/// Writes the pictures of a set as FOLDER/frame_%06d_CAMERA.png, numbered by slot; returns how many there
/// were. The folder is made with the first picture. Throws Error(Storage).
std::size_t write_set_pictures(const FrameSet& set, const std::filesystem::path& folder);

}  // namespace facet::report
