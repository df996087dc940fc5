#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "facet/frame.hpp"
#include "mesh/mesh.hpp"

namespace facet::render {

/// 8-bit sRGB picture, R G B interleaved, top row first.
struct Picture {
  int width_px = 0;
  int height_px = 0;
  std::vector<std::uint8_t> rgb;  ///< [height_px][width_px][3]
};

/// What every pixel's centre ray hits first.
struct HitImage {
  int width_px = 0;
  int height_px = 0;
  std::vector<std::int32_t> triangle;        ///< [height_px][width_px] index, -1 where nothing is hit
  std::vector<Eigen::Vector2f> barycentric;  ///< weights of the triangle's second and third vertex
  std::vector<float> depth_mm;               ///< z in the camera frame; 0 where nothing is hit
};

/// Ray queries against one triangle mesh (Embree). Any thread once built.
class Raycaster {
 public:
  /// vertices_mm [3][vertex_count], copied.
  Raycaster(const mesh::Vertices& vertices_mm, const mesh::Triangles& triangles);
  ~Raycaster();

  /// One ray per sample through pixel (x + offset, y + offset) of a pinhole at the origin, z forward.
  /// Vertices must be in the camera frame.
  HitImage cast(const CameraIntrinsics& camera, Eigen::Vector2f offset_px = {0, 0}) const;

  struct Closest {
    std::int32_t triangle = -1;
    Eigen::Vector2f barycentric{0, 0};
    Eigen::Vector3f point_mm{0, 0, 0};
    float distance_mm = 0;
  };
  /// The nearest point of the surface within max_distance_mm; triangle -1 where there is none.
  Closest closest_point(const Eigen::Vector3f& query_mm, float max_distance_mm) const;

  struct Hit {
    std::int32_t triangle = -1;
    Eigen::Vector2f barycentric{0, 0};
    float distance_mm = 0;
  };
  /// First hit along a ray (unit direction); triangle -1 where there is none. cull_back: ignore triangles
  /// seen from behind.
  Hit first_hit(const Eigen::Vector3f& origin_mm, const Eigen::Vector3f& direction,
                float min_distance_mm = 0) const;

  /// Whether anything lies between the two points, both ends pulled in by margin_mm.
  bool occluded(const Eigen::Vector3f& from_mm, const Eigen::Vector3f& to_mm, float margin_mm) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Values of a per-vertex field at the hits: [height_px * width_px][rows], 0 where nothing is hit.
Eigen::MatrixXf interpolate(const HitImage& hits, const mesh::Triangles& triangles,
                            const Eigen::Ref<const Eigen::MatrixXf>& field);

/// 9 SH basis values of eq. 1 (Ma & Deng 2019): (1, nx, ny, nz, nx ny, nx nz, ny nz, nx^2 - ny^2, 3 nz^2 -
/// 1).
std::array<float, 9> sh_basis(const Eigen::Vector3f& normal);

std::uint8_t linear_to_srgb8(float linear);
float srgb8_to_linear(std::uint8_t srgb);

/// Perceptual heat colours (dark blue to yellow) for value in [0, 1], clamped.
std::array<std::uint8_t, 3> heat_colour(float value);

Picture to_picture(const Frame& frame);
/// Writes PNG, through a temporary name so that no half file is left. Throws Error(Storage).
void write_png(const Picture& picture, const std::filesystem::path& file);
Picture read_image(const std::filesystem::path& file);

void draw_text(Picture& picture, int x_px, int y_px, const std::string& text, std::array<std::uint8_t, 3> rgb,
               int scale = 1);
void draw_line(Picture& picture, Eigen::Vector2f a_px, Eigen::Vector2f b_px, std::array<std::uint8_t, 3> rgb,
               float opacity = 1);
void draw_dot(Picture& picture, Eigen::Vector2f at_px, float radius_px, std::array<std::uint8_t, 3> rgb);
void paste(Picture& onto, const Picture& from, int x_px, int y_px);
Picture resize(const Picture& picture, int width_px, int height_px);

}  // namespace facet::render
