#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "support/mesh_frames.hpp"
#include "take/recorder.hpp"

namespace facet::test {

/// Recorder settings of a test: waits for the disk, keeps no reserve.
inline take::TakeRecorderConfig recorder_config(const std::filesystem::path& file) {
  take::TakeRecorderConfig config;
  config.file = file;
  config.source = "synthetic patch";
  config.software = "facet tests";
  config.when_full = take::WhenFull::Wait;
  config.disk_reserve_bytes = 0;
  return config;
}

/// Frame `index` of the tests' takes: every fifth has no face, the albedo changes at 10.
inline std::shared_ptr<const mesh::MeshFrame> take_frame(
    std::uint64_t index, const std::shared_ptr<const mesh::Subject>& subject) {
  if (index % 5 == 4) {
    return std::make_shared<mesh::MeshFrame>(searching_frame(index));
  }
  return std::make_shared<mesh::MeshFrame>(
      patch_frame(index, subject, patch_albedo(*subject, index < 10 ? 1 : 2)));
}

/// Records `frames` frames of take_frame and closes the take.
inline take::RecorderStatus record_take(const std::filesystem::path& file, std::uint64_t frames,
                                        const std::shared_ptr<const mesh::Subject>& subject) {
  take::TakeRecorder recorder(recorder_config(file));
  recorder.start();
  for (std::uint64_t index = 0; index < frames; ++index) {
    recorder.record(take_frame(index, subject));
  }
  return recorder.stop();
}

}  // namespace facet::test
