#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "capture/depth_map.hpp"
#include "capture/rig.hpp"

namespace facet::report {

/// The depth maps of a take on disk: for each pair, named by its left camera, a folder with a float map of
/// depths (slot_%06d.pfm, mm along z of its lens, 0 in a hole) and one of their standard deviations
/// (slot_%06d-sigma.pfm) for every slot that gets a mesh; rig.toml holds the lenses, depth.json says of what
/// they were made. A process that was broken off goes on with what it finds there. One thread.
class DepthFolder {
 public:
  /// made_of: text that tells one computation from another (take, rig, depths, slots). Throws Error: Storage
  /// where the folder can't be made, Usage where it holds maps that were made of something else.
  DepthFolder(std::filesystem::path folder, const capture::Rig& rig, const std::string& made_of);

  /// Slots whose maps were whole when the folder was opened.
  const std::set<std::uint64_t>& kept() const { return kept_; }
  /// Maps of a kept slot, [pairs]. Throws Error(UnreadableInput).
  std::vector<capture::DepthMap> read(std::uint64_t slot) const;
  /// Does nothing for a slot that is kept. Throws Error(Storage).
  void write(std::uint64_t slot, std::span<const capture::DepthMap> maps);

 private:
  std::filesystem::path folder_;
  std::vector<std::string> names_;      ///< [pairs]
  std::optional<capture::Rig> lenses_;  ///< once they are known
  std::set<std::uint64_t> kept_;
};

/// Where the depth map of a pair in a slot is.
std::filesystem::path depth_file(const std::filesystem::path& folder, const std::string& left_camera,
                                 std::uint64_t slot);

}  // namespace facet::report
