#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace facet::landmark {

/// The parts of MediaPipe's packed face mesh assets (npm package @mediapipe/face_mesh 0.4.1657299874,
/// Apache-2.0).
class LandmarkAssets {
 public:
  /// Reads the file and checks its size and CRC-32. Throws Error(UnreadableInput) that names the file and
  /// says how to fetch it.
  static LandmarkAssets load(const std::filesystem::path& file);

  std::span<const std::uint8_t> attention_landmarks()
      const;                                        ///< TensorFlow Lite: irises, finer lips and eyes
  std::span<const std::uint8_t> landmarks() const;  ///< TensorFlow Lite: 468 points
  std::span<const std::uint8_t> geometry() const;   ///< protobuf: the canonical face
  std::span<const std::uint8_t> detector() const;   ///< TensorFlow Lite: short-range face detector

 private:
  std::vector<std::uint8_t> bytes_;
};

/// CRC-32 as in zlib and PNG (polynomial 0xEDB88320, reflected).
std::uint32_t crc32(std::span<const std::uint8_t> bytes);

}  // namespace facet::landmark
