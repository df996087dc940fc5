#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "render/renderer.hpp"

namespace facet::simulation {

/// Writes a Matroska file that decodes to exactly the pictures put in: FFV1 with 8-bit RGB planes. One
/// thread.
class LosslessVideo {
 public:
  /// Throws Error(Storage) where the file can't be made, Error(Usage) for a size below 1 or a rate of 0.
  LosslessVideo(const std::filesystem::path& file, int width_px, int height_px, int rate_hz);
  /// Closes the file if finish() was not called; a failure then goes unreported.
  ~LosslessVideo();
  LosslessVideo(const LosslessVideo&) = delete;
  LosslessVideo& operator=(const LosslessVideo&) = delete;

  /// Appends a frame. Throws Error(Storage) where it can't be written, Error(Internal) for another size.
  void append(const render::Picture& picture);
  /// Writes what is left and closes the file. Throws Error(Storage).
  void finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::simulation
