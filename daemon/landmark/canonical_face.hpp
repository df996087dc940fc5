#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace facet::landmark {

constexpr int landmark_count = 468;
/// Numbers of the irises' centres beside the face mesh.
constexpr int kRightIris = landmark_count;
constexpr int kLeftIris = landmark_count + 1;

/// The neutral face that MediaPipe's landmarks index: x to the subject's left, y up, z out of the face, cm.
struct CanonicalFace {
  Eigen::Matrix3Xf vertices_cm;                        ///< [3][468]
  Eigen::Matrix3Xf normals;                            ///< [3][468] unit, outward
  std::vector<std::array<std::int32_t, 3>> triangles;  ///< [898], counter-clockwise from outside
};

/// Reads the geometry pipeline metadata (protobuf: field 1 mesh {3 vertices x, y, z, u, v; 4 indices}). Any
/// bytes give a consistent mesh or Error(UnreadableInput) that starts with `name`.
CanonicalFace parse_canonical_face(std::span<const std::uint8_t> metadata, const std::string& name);

}  // namespace facet::landmark
