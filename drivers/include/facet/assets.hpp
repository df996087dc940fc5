#pragma once

#include <cstdlib>
#include <filesystem>

#include "facet/assets_folder.hpp"

namespace facet {

/// The folder of what Facet needs beside its programs: $FACET_ASSETS, else the folder set when it was built
/// (FACET_ASSETS_FOLDER: assets/ of the source tree, or /usr/share/facet in packages). It need not exist.
inline std::filesystem::path assets_folder() {
  const char* set = std::getenv("FACET_ASSETS");
  return set != nullptr && *set != '\0' ? std::filesystem::path(set)
                                        : std::filesystem::path(FACET_ASSETS_FOLDER);
}

/// The default face model and the landmark nets, where a configuration names no others.
inline std::filesystem::path default_model_file() {
  return assets_folder() / "default.facemodel";
}
inline std::filesystem::path default_landmark_nets() {
  return assets_folder() / "mediapipe" / "face_mesh_solution_packed_assets.data";
}

}  // namespace facet
