#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "simulation/truth_mesh.hpp"

namespace facet::report {

/// What camera.json says of one frame. What it leaves out is empty.
struct TruthNotes {
  std::optional<Eigen::Isometry3f> camera_from_head;  ///< mm
  std::map<std::string, float> expression;            ///< by the file's names
};

/// A folder of truth: `truth/frame_NNNNNN.ply` for all frames or some, perhaps `truth/neutral.ply` and
/// `camera.json` (docs/evaluation.md). Whoever made it, every length comes out in mm. Any thread.
class TruthFolder {
 public:
  /// Lists the frames and reads camera.json.
  ///
  /// mm_per_unit   of the meshes' and poses' lengths: 1, 10 or 1000
  /// Throws Error(UnreadableInput) where there are no meshes, two of one number, or where camera.json is not
  /// understood; it names the file and the key.
  TruthFolder(std::filesystem::path folder, float mm_per_unit);

  const std::filesystem::path& folder() const { return folder_; }
  /// Numbers of the frames that have a mesh, ascending; at least one.
  std::vector<std::uint64_t> frames() const;
  bool has(std::uint64_t frame) const { return files_.contains(frame); }

  /// A frame's surface in the camera frame, wound counter-clockwise as seen from outside. Throws
  /// Error(UnreadableInput): unreadable, not of a head's size (which unit would fit is said), behind the
  /// camera.
  simulation::TruthMesh mesh(std::uint64_t frame) const;
  /// The resting head in the head frame; none without `truth/neutral.ply`. Throws as mesh().
  std::optional<simulation::TruthMesh> neutral() const;

  /// camera.json's fx, px.
  std::optional<float> focal_px() const { return focal_px_; }
  /// What camera.json says of a frame; null where nothing.
  const TruthNotes* notes(std::uint64_t frame) const;

 private:
  void list_meshes();
  void read_notes(const std::filesystem::path& file);
  simulation::TruthMesh read(const std::filesystem::path& file) const;

  std::filesystem::path folder_;
  float mm_per_unit_;
  std::map<std::uint64_t, std::filesystem::path> files_;
  std::map<std::uint64_t, TruthNotes> notes_;
  std::optional<float> focal_px_;
};

/// Brings triangles and normals to one outside: triangles wound against their vertices' normals are turned;
/// where both then enclose the surface's centre from within, both are. A surface that encloses next to
/// nothing stays as it is.
void wind_outwards(simulation::TruthMesh& mesh);

}  // namespace facet::report
