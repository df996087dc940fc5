#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "capture/rig.hpp"
#include "face/face_parts.hpp"
#include "render/renderer.hpp"
#include "take/reader.hpp"

namespace facet::report {

/// What a sheet of a booth's meshes is drawn from.
struct BoothSheetSources {
  take::TakeReader* meshes = nullptr;
  take::TakeReader* pictures = nullptr;  ///< what the meshes were made of; null: not at hand
  capture::Rig rig;
  std::filesystem::path depth_folder;  ///< as `facet process --depth` writes; empty: none
  /// As `facet synth-booth` writes; empty: no truth is known. Its pictures say which of its slots a picture
  /// shows.
  std::filesystem::path truth_folder;
  std::vector<face::FacePart> parts;  ///< [control vertex_count] of the take's meshes; empty: not known
};

/// Of each point that is compared with the truth.
struct PointErrors {
  std::vector<float> distance_mm;
  std::vector<float> normal_deg;
};

/// How far one mesh is from the truth, over the face's skin that the first colour camera sees.
struct BoothError {
  std::uint64_t slot = 0;
  double mean_mm = 0;
  double p95_mm = 0;
  double normal_deg = 0;  ///< mean
  /// Of wrinkles in the mesh with the truth's (WrinkleSum, against the mesh smoothed over 5 mm): correlation,
  /// and depth as a share. NaN where the truth has none.
  double wrinkle_correlation = 0;
  double wrinkle_depth = 0;
  std::array<PointErrors, face::kFacePartNames.size()> parts;  ///< by face::FacePart, where they are known
};

/// One row per frame: stripes, depth as a shaded relief, mesh over the picture, shaded mesh, texture, error;
/// what is not there is said in its place. frames: indices in the take of meshes. done(count) is called after
/// every row. errors: out, of the frames whose truth is known. Throws Error(UnreadableInput).
render::Picture make_booth_sheet(const BoothSheetSources& sources, const std::vector<std::int64_t>& frames,
                                 const std::function<void(int)>& done, std::vector<BoothError>& errors);

}  // namespace facet::report
