#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
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

/// What every pixel's ray hits first.
struct HitImage {
  int width_px = 0;
  int height_px = 0;
  std::vector<std::int32_t> triangle;        ///< [height_px][width_px] index, -1 where nothing is hit
  std::vector<Eigen::Vector2f> barycentric;  ///< weights of the triangle's second and third vertex
  std::vector<float> depth_mm;               ///< z in the camera frame; 0 where nothing is hit
};

/// Ray queries against one triangle mesh (Embree). Any thread once built. A query with numbers that are not
/// finite finds nothing.
class Raycaster {
 public:
  /// Quick: built in a third of the time, for rays that are slower by an eighth; for few pictures.
  enum class Build { Thorough, Quick };
  /// vertices_mm [3][vertex_count], triangles [3][triangle_count]; both copied.
  /// Throws Error(UnreadableInput) where a triangle names a vertex that is not there or a position is not
  /// finite, Error(Internal) where Embree cannot start.
  Raycaster(const mesh::Vertices& vertices_mm, const mesh::Triangles& triangles,
            Build build = Build::Thorough);
  /// A mesh in motion: positions at evenly spaced times from 0 to 1, straight lines between. Only `first_hit`
  /// knows other times than 0.
  /// keys_mm  at least one, all [3][vertex_count]
  /// Throws as above, Error(Internal) where the keys differ in size or there is none.
  Raycaster(const std::vector<mesh::Vertices>& keys_mm, const mesh::Triangles& triangles,
            Build build = Build::Thorough);
  ~Raycaster();
  Raycaster(Raycaster&& other) noexcept;
  Raycaster& operator=(Raycaster&& other) noexcept;

  /// One ray per pixel through (x + offset, y + offset) of a pinhole at the origin, z forward; pixel centres
  /// are at integers. Vertices must be in the camera frame. Runs on up to two threads.
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
  /// First hit along a ray (unit direction); triangle -1 where there is none. cull_back: passes through
  /// triangles seen from behind. time: of a mesh in motion, clamped to 0 to 1.
  Hit first_hit(const Eigen::Vector3f& origin_mm, const Eigen::Vector3f& direction, float min_distance_mm = 0,
                bool cull_back = false, float time = 0) const;

  /// Whether anything lies between the two points, both ends pulled in by margin_mm.
  bool occluded(const Eigen::Vector3f& from_mm, const Eigen::Vector3f& to_mm, float margin_mm) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Calls work(y) for every row 0 <= y < row_count, on up to two threads, in interleaved order; returns when
/// all are done. work must be safe to call from two threads at once and must not throw.
void for_each_row(int row_count, const std::function<void(int)>& work);

/// The part of the hemisphere over each vertex (cosine-weighted, 0 to 1) that is free within 25 mm, a
/// nostril's size; 1 at a vertex of no triangle. Returns [1][vertex_count]. Runs on up to two threads.
Eigen::MatrixXf openness(const mesh::Vertices& vertices_mm, const mesh::Triangles& triangles);

/// Values of a per-vertex field at the hits: [rows of field][height_px * width_px], 0 where nothing is hit.
/// field [any][vertex_count].
Eigen::MatrixXf interpolate(const HitImage& hits, const mesh::Triangles& triangles,
                            const Eigen::Ref<const Eigen::MatrixXf>& field);

/// A vertex field's value at one point of a triangle. field [3][vertex_count]; barycentric as in Hit.
Eigen::Vector3f interpolate(const mesh::Triangles& triangles, std::int32_t triangle,
                            const Eigen::Vector2f& barycentric, const mesh::Vertices& field);

/// Offsets spread evenly over a pixel (a low-discrepancy sequence), their mean exactly its centre so that a
/// picture averaged from them is not shifted: one `cast` each, averaged in linear light, gives an antialiased
/// picture. count >= 1.
std::vector<Eigen::Vector2f> sample_offsets_px(int count);

/// The colour of a point of the surface, linear RGB. Called from two threads.
using SurfaceColour =
    std::function<Eigen::Vector3f(std::int32_t triangle, const Eigen::Vector2f& barycentric)>;

/// Renders a surface over a background, antialiased with the given number of rays per pixel; where rays miss,
/// the background shows through. Sizes of camera and background must agree.
/// Throws Error(Internal) where they don't.
Picture render_surface(const Raycaster& surface, const CameraIntrinsics& camera, const SurfaceColour& colour,
                       const Picture& background, int rays_per_pixel = 4);

/// A picture of one colour.
Picture plain_picture(int width_px, int height_px, std::array<std::uint8_t, 3> rgb);

/// l . SH(n), the irradiance of [MD19 eq. 1]. normal_camera: unit, in the camera frame (x right, y
/// down, z forward); it is turned into the lighting's frame (y up, z towards the camera).
float irradiance(const std::array<float, 9>& lighting, const Eigen::Vector3f& normal_camera);

/// sRGB transfer function; linear is clamped to 0 to 1.
std::uint8_t linear_to_srgb8(float linear);
float srgb8_to_linear(std::uint8_t srgb);

/// Perceptual heat colours (dark blue to yellow, lightness rises evenly) for value in [0, 1], clamped; NaN is
/// mid grey.
std::array<std::uint8_t, 3> heat_colour(float value);

/// A unit normal of the camera frame as the usual normal-map colour: red right, green up, blue towards the
/// camera, each 0.5 + 0.5 n.
std::array<std::uint8_t, 3> normal_colour(const Eigen::Vector3f& normal_camera);

Picture to_picture(const Frame& frame);
/// A frame with alpha 255; sequence and times are 0.
Frame to_frame(const Picture& picture);

/// The bytes of a PNG file. Throws Error(Internal).
std::vector<std::uint8_t> encode_png(const Picture& picture);
/// Writes PNG, through a temporary name so that no half file is left. Throws Error(Storage).
void write_png(const Picture& picture, const std::filesystem::path& file);
/// Reads PNG or JPEG (files::read_image). Throws Error(UnreadableInput) naming the file.
Picture read_image(const std::filesystem::path& file);

/// A picture's brightness as coded, (R + 2 G + B) / 4, 0 to 1, top row first.
struct GreyPicture {
  int width_px = 0;
  int height_px = 0;
  std::vector<float> values;  ///< [height_px][width_px]
};
/// Reads PNG of 8 or 16 bits a channel, or JPEG. Throws Error(UnreadableInput) naming the file.
GreyPicture read_grey(const std::filesystem::path& file);

/// Antialiased text whose first line's box has its top left corner at (x, y). scale 1 is 12 px high, 2 twice
/// that. '\n' begins a new line; what lies outside the picture is cut.
void draw_text(Picture& picture, int x_px, int y_px, const std::string& text, std::array<std::uint8_t, 3> rgb,
               int scale = 1);
/// Width and height of the box that draw_text fills.
Eigen::Vector2i text_size_px(const std::string& text, int scale = 1);
/// An antialiased line of one pixel's width; opacity 0 to 1. Ends may lie outside the picture.
void draw_line(Picture& picture, Eigen::Vector2f a_px, Eigen::Vector2f b_px, std::array<std::uint8_t, 3> rgb,
               float opacity = 1);
/// An antialiased filled disc.
void draw_dot(Picture& picture, Eigen::Vector2f at_px, float radius_px, std::array<std::uint8_t, 3> rgb);
/// Copies a picture into another one; what lies outside is cut.
void paste(Picture& onto, const Picture& from, int x_px, int y_px);
/// A part of a picture; what lies outside is filled with `outside`.
Picture crop(const Picture& picture, int x_px, int y_px, int width_px, int height_px,
             std::array<std::uint8_t, 3> outside = {0, 0, 0});
/// Area average where it shrinks, cubic where it grows. Throws Error(Internal) for a size below 1.
Picture resize(const Picture& picture, int width_px, int height_px);

}  // namespace facet::render
