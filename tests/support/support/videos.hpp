#pragma once

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <string_view>

#include "render/renderer.hpp"
#include "render/video_writer.hpp"

namespace facet::test {

/// Writes a Matroska file of grey pictures, 320 x 240 px, 25 Hz: nobody is seen. Link ROOMS render
/// simulation.
inline void write_grey_video(const std::filesystem::path& file, int frame_count) {
  render::VideoWriter video(file, 320, 240, 25);
  for (int f = 0; f < frame_count; ++f) {
    video.append(render::plain_picture(320, 240, {118, 118, 118}));
  }
  video.finish();
}

/// Cuts a Matroska file just after the header of its first cluster: a video stream of no frame is left.
inline void cut_before_first_frame(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  constexpr std::string_view kCluster = "\x1F\x43\xB6\x75";
  constexpr std::size_t kClusterHeaderBytes = 12;
  std::filesystem::resize_file(file, bytes.find(kCluster) + kClusterHeaderBytes);
}

}  // namespace facet::test
