#pragma once

#include <filesystem>
#include <functional>

#include "simulation/actor_sequence.hpp"

namespace facet::simulation {

/// What is written of a sequence beside its videos.
struct SequenceFiles {
  int truth_every = 1;         ///< truth/frame_%06d.ply of every so many frames
  bool with_surfaces = false;  ///< surfaces/frame_%06d.ply of every frame: for other renderers
};

/// Renders a whole sequence into a folder (made where missing): video.mkv (lossless, unless the webcam has a
/// codec), the files chosen, truth/neutral.ply and camera.json (docs/synthetic-sequences.md); of several
/// cameras also view-2.mkv, ..., and of those or one with distortion rig.toml.
/// done(count) is called after every frame. Throws Error(Storage) where it cannot write.
void write_sequence(const ActorSequence& sequence, const std::filesystem::path& folder,
                    const SequenceFiles& wanted, const std::function<void(int)>& done);

/// Name of a frame's truth mesh in a sequence's folder.
std::filesystem::path truth_file(const std::filesystem::path& folder, std::uint64_t index);

}  // namespace facet::simulation
