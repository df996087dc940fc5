#include "report/depth_pictures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "files/output_file.hpp"

namespace facet::report {
namespace {

static_assert(std::endian::native == std::endian::little, "PLY is written as it lies in memory");

std::size_t index_of(const capture::DepthMap& map, int x, int y) {
  return static_cast<std::size_t>(y) * static_cast<std::size_t>(map.width_px) + static_cast<std::size_t>(x);
}

/// In the map's frame.
Eigen::Vector3d point_mm(const capture::DepthMap& map, int x, int y) {
  const capture::Lens& lens = map.lens;
  return static_cast<double>(map.depth_mm[index_of(map, x, y)]) *
         Eigen::Vector3d((x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px, 1);
}

/// Towards the camera, unit, map's frame; 0 where no neighbours are there.
Eigen::Vector3d normal_at(const capture::DepthMap& map, int x, int y, float break_mm) {
  const float own = map.depth_mm[index_of(map, x, y)];
  // From the neighbours on both sides, or from one where the other is not of the surface.
  const auto along = [&](int dx, int dy) -> Eigen::Vector3d {
    std::array<Eigen::Vector3d, 2> ends = {point_mm(map, x, y), point_mm(map, x, y)};
    for (const std::size_t side : {std::size_t{0}, std::size_t{1}}) {
      const int there_x = x + (side == 0 ? -dx : dx);
      const int there_y = y + (side == 0 ? -dy : dy);
      if (there_x >= 0 && there_y >= 0 && there_x < map.width_px && there_y < map.height_px) {
        const float there = map.depth_mm[index_of(map, there_x, there_y)];
        if (there > 0 && std::abs(there - own) <= break_mm) {
          ends.at(side) = point_mm(map, there_x, there_y);
        }
      }
    }
    return ends[1] - ends[0];
  };
  const Eigen::Vector3d normal = along(0, 1).cross(along(1, 0));
  const double length = normal.norm();
  return length > 0 ? Eigen::Vector3d(normal / length) : Eigen::Vector3d::Zero();
}

template <typename Value>
void append(std::string& bytes, Value value) {
  std::array<char, sizeof(Value)> raw{};
  std::memcpy(raw.data(), &value, sizeof(Value));
  bytes.append(raw.data(), raw.size());
}

}  // namespace

render::Picture relief_of(const capture::DepthMap& map) {
  constexpr float kAnything_mm = 1e6F;
  render::Picture out = render::plain_picture(map.width_px, map.height_px, {30, 40, 90});
  const Eigen::Vector3d light = Eigen::Vector3d(-1, -0.8, -1).normalized();
  for (int y = 0; y < map.height_px; ++y) {
    for (int x = 0; x < map.width_px; ++x) {
      const std::size_t at = index_of(map, x, y);
      if (map.depth_mm[at] > 0) {
        const double facing = normal_at(map, x, y, kAnything_mm).dot(light);
        const double shade = 0.1 + 0.9 * std::max(facing, 0.0);
        std::fill_n(out.rgb.begin() + static_cast<std::ptrdiff_t>(3 * at), 3,
                    render::linear_to_srgb8(static_cast<float>(shade * shade)));
      }
    }
  }
  return out;
}

std::size_t write_depth_ply(const capture::DepthMap& map, const std::vector<float>& grey, float break_mm,
                            const std::filesystem::path& file) {
  const Eigen::Isometry3d rig_from_map = map.lens.camera_from_rig.inverse();
  std::vector<std::int32_t> vertex_of(map.depth_mm.size(), -1);
  std::string vertices;
  std::int32_t vertex_count = 0;
  for (int y = 0; y < map.height_px; ++y) {
    for (int x = 0; x < map.width_px; ++x) {
      const std::size_t at = index_of(map, x, y);
      if (!(map.depth_mm[at] > 0)) {
        continue;
      }
      vertex_of[at] = vertex_count++;
      const Eigen::Vector3f point = (rig_from_map * point_mm(map, x, y)).cast<float>();
      const Eigen::Vector3f normal = (rig_from_map.linear() * normal_at(map, x, y, break_mm)).cast<float>();
      for (const float value : {point.x(), point.y(), point.z(), normal.x(), normal.y(), normal.z()}) {
        append(vertices, value);
      }
      const std::uint8_t shade = grey.empty() ? 255 : render::linear_to_srgb8(grey[at]);
      append(vertices, std::array<std::uint8_t, 3>{shade, shade, shade});
      append(vertices, map.confidence[at]);
      append(vertices, map.sigma_mm[at]);
    }
  }
  std::string faces;
  std::size_t face_count = 0;
  const auto add_face = [&](std::size_t a, std::size_t b, std::size_t c) {
    const auto joined = [&](std::size_t p, std::size_t q) {
      return std::abs(map.depth_mm[p] - map.depth_mm[q]) <= break_mm;
    };
    if (vertex_of[a] >= 0 && vertex_of[b] >= 0 && vertex_of[c] >= 0 && joined(a, b) && joined(b, c) &&
        joined(c, a)) {
      append(faces, std::uint8_t{3});
      append(faces, std::array<std::int32_t, 3>{vertex_of[a], vertex_of[b], vertex_of[c]});
      ++face_count;
    }
  };
  for (int y = 0; y + 1 < map.height_px; ++y) {
    for (int x = 0; x + 1 < map.width_px; ++x) {
      const std::size_t at = index_of(map, x, y);
      const std::size_t below = at + static_cast<std::size_t>(map.width_px);
      add_face(at, below, at + 1);
      add_face(at + 1, below, below + 1);
    }
  }
  files::OutputFile output(file);
  output.write(fmt::format(
      "ply\nformat binary_little_endian 1.0\ncomment Facet: depth map, mm, rig frame\nelement vertex {}\n"
      "property float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\n"
      "property float nz\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
      "property float confidence\nproperty float sigma_mm\nelement face {}\n"
      "property list uchar int vertex_indices\nend_header\n",
      vertex_count, face_count));
  output.write(vertices);
  output.write(faces);
  output.commit();
  return static_cast<std::size_t>(vertex_count);
}

}  // namespace facet::report
