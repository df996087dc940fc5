#pragma once

#include <filesystem>
#include <functional>

#include "simulation/actor_sequence.hpp"

namespace facet::simulation {

/// Renders a whole sequence into a folder (made where missing): video.mkv (lossless, unless the webcam has a
/// codec), truth/frame_%06d.ply of every truth_every-th frame, truth/neutral.ply and camera.json
/// (docs/synthetic-sequences.md); of several cameras also view-2.mkv, ..., and of those or one with
/// distortion rig.toml.
/// done(count) is called after every frame. Throws Error(Storage) where it cannot write.
void write_sequence(const ActorSequence& sequence, const std::filesystem::path& folder, int truth_every,
                    const std::function<void(int)>& done);

/// Name of a frame's truth mesh in a sequence's folder.
std::filesystem::path truth_file(const std::filesystem::path& folder, std::uint64_t index);

}  // namespace facet::simulation
