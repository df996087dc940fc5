#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "landmark/landmarker.hpp"

namespace facet::booth {

constexpr std::size_t kMaxFacePointsFileBytes = std::size_t{1} << 20;

/// Landmarks that a person pointed at, where the landmark net finds no face (docs/booth.md).
struct FacePoints {
  struct Camera {
    std::string name;
    /// [468] landmarks as the net would have found them; confidence 1 for those that were pointed at, 0 for
    /// the others.
    landmark::FaceLandmarks face;
  };
  std::uint64_t slot = 0;  ///< whose pictures were looked at
  std::vector<Camera> cameras;
};

/// Reads a file of face points. Throws Error: UnreadableInput where it can't be read; Usage, with the line,
/// where it makes no sense. Any thread.
FacePoints read_face_points(const std::filesystem::path& file);

/// The same of a text; `file` stands in messages.
FacePoints parse_face_points(std::string_view text, const std::filesystem::path& file);

}  // namespace facet::booth
