#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <memory>
#include <random>
#include <string>
#include <vector>

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

/// A picture of edges and noise, whose rows are longer than they need to be. Any seed gives another one.
inline Frame noisy_picture(int width_px, int height_px, bool grey, std::uint32_t seed) {
  std::mt19937 random(seed);
  Frame frame;
  frame.width_px = width_px;
  frame.height_px = height_px;
  frame.stride_bytes = 4 * static_cast<std::size_t>(width_px) + 12;
  auto pixels = std::make_shared<std::uint8_t[]>(frame.stride_bytes * static_cast<std::size_t>(height_px));
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x) {
      std::uint8_t* pixel =
          pixels.get() + static_cast<std::size_t>(y) * frame.stride_bytes + 4 * static_cast<std::size_t>(x);
      for (std::uint32_t channel = 0; channel < 3; ++channel) {
        const std::uint32_t stripe = (static_cast<std::uint32_t>(x) / 3 + seed) % 2 * 180 + channel * 10;
        pixel[channel] = grey && channel > 0 ? pixel[0] : static_cast<std::uint8_t>(stripe + random() % 8);
      }
      pixel[3] = 255;
    }
  }
  frame.pixels = std::move(pixels);
  return frame;
}

/// A frame with the pictures of three cameras, "one" grey, "two" in colour and of another size, "three" grey;
/// camera "two" has none in every seventh slot.
inline std::shared_ptr<const mesh::MeshFrame> picture_frame(std::uint64_t slot, int width_px = 32,
                                                            int height_px = 24) {
  auto set = std::make_shared<FrameSet>();
  set->slot = slot;
  set->trigger_ns = 1'000'000'000 + static_cast<std::int64_t>(slot) * 16'666'667;
  set->camera_names =
      std::make_shared<const std::vector<std::string>>(std::vector<std::string>{"one", "two", "three"});
  set->frames.resize(3);
  for (std::size_t camera = 0; camera < set->frames.size(); ++camera) {
    if (camera == 1 && slot % 7 == 6) {
      set->missing |= std::uint64_t{1} << camera;
      continue;
    }
    Frame& frame = set->frames[camera];
    frame = noisy_picture(width_px + (camera == 1 ? 7 : 0), height_px, camera != 1,
                          static_cast<std::uint32_t>(3 * slot + camera));
    frame.sequence = slot + camera;
    frame.timestamp_ns = set->trigger_ns + static_cast<std::int64_t>(camera);
    frame.corrupt = camera == 2 && slot % 5 == 0;
  }
  auto frame = std::make_shared<mesh::MeshFrame>();
  frame->sequence = slot;
  frame->timestamp_ns = set->trigger_ns;
  frame->control_vertices_mm.resize(3, 0);
  frame->images = std::move(set);
  return frame;
}

/// Whether two pictures are the same in every pixel and in all that is known of them; the rows' padding is
/// none.
inline bool same_picture(const Frame& a, const Frame& b) {
  if (a.empty() || b.empty() || a.width_px != b.width_px || a.height_px != b.height_px ||
      a.sequence != b.sequence || a.timestamp_ns != b.timestamp_ns || a.corrupt != b.corrupt) {
    return a.empty() && b.empty();
  }
  for (int y = 0; y < a.height_px; ++y) {
    if (std::memcmp(a.row(y), b.row(y), 4 * static_cast<std::size_t>(a.width_px)) != 0) {
      return false;
    }
  }
  return true;
}

/// Whether a set is that of picture_frame for its slot.
inline bool same_pictures(const FrameSet& got, int width_px = 32, int height_px = 24) {
  const FrameSet expected = *picture_frame(got.slot, width_px, height_px)->images;
  bool same = got.frames.size() == expected.frames.size() && got.trigger_ns == expected.trigger_ns &&
              got.missing == expected.missing && *got.camera_names == *expected.camera_names;
  for (std::size_t camera = 0; same && camera < got.frames.size(); ++camera) {
    same = same_picture(got.frames[camera], expected.frames[camera]);
  }
  return same;
}

/// Settings of a recorder of picture_frame.
inline take::TakeRecorderConfig picture_config(const std::filesystem::path& file,
                                               std::uint64_t segment_bytes = 1 << 30) {
  take::TakeRecorderConfig config = recorder_config(file);
  config.source = "three cameras";
  config.with_images = true;
  config.segment_bytes = segment_bytes;
  return config;
}

/// Records picture_frame 0 to frames - 1 and closes the take.
inline take::RecorderStatus record_pictures(const take::TakeRecorderConfig& config, std::uint64_t frames) {
  take::TakeRecorder recorder(config);
  recorder.start();
  for (std::uint64_t slot = 0; slot < frames; ++slot) {
    recorder.record(picture_frame(slot));
  }
  return recorder.stop();
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
