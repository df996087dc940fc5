#pragma once

#include <cstdlib>
#include <filesystem>
#include <system_error>

#include "facet/assets_folder.hpp"

namespace facet {

/// ../share/facet of the folder that the running program lies in, where there is one: an installation that
/// can be moved. Empty where there is none.
inline std::filesystem::path share_beside_program() {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path share = program.parent_path().parent_path() / "share" / "facet";
  return !error && std::filesystem::is_directory(share, error) ? share : std::filesystem::path();
}

/// The folder of what Facet needs beside its programs: $FACET_ASSETS, else share/facet beside the program's
/// folder, else the folder set when it was built (FACET_ASSETS_FOLDER: assets/ of the source tree, or
/// /usr/share/facet in packages). It need not exist.
inline std::filesystem::path assets_folder() {
  if (const char* set = std::getenv("FACET_ASSETS"); set != nullptr && *set != '\0') {
    return set;
  }
  const std::filesystem::path beside = share_beside_program();
  return beside.empty() ? std::filesystem::path(FACET_ASSETS_FOLDER) : beside;
}

/// The default face model and the landmark nets, where a configuration names no others.
inline std::filesystem::path default_model_file() {
  return assets_folder() / "default.facemodel";
}
inline std::filesystem::path default_landmark_nets() {
  return assets_folder() / "mediapipe" / "face_mesh_solution_packed_assets.data";
}

}  // namespace facet
