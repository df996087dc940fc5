#include "landmark/canonical_face.hpp"

#include <Eigen/Geometry>
#include <cstring>

#include "facet/error.hpp"

namespace facet::landmark {
namespace {

constexpr std::size_t floats_per_vertex = 5;  ///< x, y, z, u, v
constexpr std::size_t max_indices = std::size_t{3} * 4096;

enum class WireType : unsigned { Varint = 0, Fixed64 = 1, Bytes = 2, Fixed32 = 5 };

/// Walks over the fields of one protobuf message.
class MessageReader {
 public:
  MessageReader(std::span<const std::uint8_t> bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  [[noreturn]] void fail(const char* what) const {
    throw Error(ErrorKind::UnreadableInput, name_ + ": " + what);
  }

  /// Moves to the next field; false at the end.
  bool next() {
    if (bytes_.empty()) {
      return false;
    }
    const std::uint64_t key = varint();
    field = static_cast<std::uint32_t>(key >> 3U);
    type = static_cast<WireType>(key & 7U);
    switch (type) {
      case WireType::Varint:
        value = varint();
        break;
      case WireType::Fixed64:
        content = take(8);
        break;
      case WireType::Bytes:
        content = take(varint());
        break;
      case WireType::Fixed32:
        content = take(4);
        break;
      default:
        fail("damaged: unknown protobuf wire type");
    }
    return true;
  }

  std::uint32_t field = 0;
  WireType type = WireType::Varint;
  std::uint64_t value = 0;                ///< of a Varint field
  std::span<const std::uint8_t> content;  ///< of any other field

 private:
  std::uint64_t varint() {
    std::uint64_t result = 0;
    for (unsigned shift = 0; shift < 64; shift += 7) {
      const std::uint8_t byte = take(1)[0];
      result |= static_cast<std::uint64_t>(byte & 0x7FU) << shift;
      if ((byte & 0x80U) == 0) {
        return result;
      }
    }
    fail("damaged: a protobuf number does not end");
  }
  std::span<const std::uint8_t> take(std::uint64_t count) {
    if (count > bytes_.size()) {
      fail("damaged: a protobuf field reaches beyond its message");
    }
    const auto taken = bytes_.first(static_cast<std::size_t>(count));
    bytes_ = bytes_.subspan(static_cast<std::size_t>(count));
    return taken;
  }

  std::span<const std::uint8_t> bytes_;
  const std::string& name_;
};

Eigen::Matrix3Xf vertex_normals(const CanonicalFace& face) {
  Eigen::Matrix3Xf normals = Eigen::Matrix3Xf::Zero(3, landmark_count);
  for (const auto& [a, b, c] : face.triangles) {
    const Eigen::Vector3f ab = face.vertices_cm.col(b) - face.vertices_cm.col(a);
    const Eigen::Vector3f ac = face.vertices_cm.col(c) - face.vertices_cm.col(a);
    const Eigen::Vector3f normal = ab.cross(ac);
    for (const int corner : {a, b, c}) {
      normals.col(corner) += normal;
    }
  }
  normals.colwise().normalize();
  return normals;
}

}  // namespace

CanonicalFace parse_canonical_face(std::span<const std::uint8_t> metadata, const std::string& name) {
  constexpr std::uint32_t mesh_field = 1;
  constexpr std::uint32_t vertex_field = 3;
  constexpr std::uint32_t index_field = 4;
  std::vector<float> values;
  std::vector<std::int32_t> indices;
  MessageReader message(metadata, name);
  while (message.next()) {
    if (message.field != mesh_field || message.type != WireType::Bytes) {
      continue;
    }
    MessageReader mesh(message.content, name);
    while (mesh.next()) {
      if (mesh.field == vertex_field && mesh.type == WireType::Fixed32) {
        float value = 0;
        std::memcpy(&value, mesh.content.data(), sizeof value);
        if (!std::isfinite(value)) {
          mesh.fail("the canonical face has a vertex that is no number");
        }
        values.push_back(value);
      } else if (mesh.field == index_field && mesh.type == WireType::Varint) {
        if (mesh.value >= landmark_count || indices.size() >= max_indices) {
          mesh.fail("the canonical face has a triangle beyond its vertices");
        }
        indices.push_back(static_cast<std::int32_t>(mesh.value));
      }
    }
  }
  if (values.size() != floats_per_vertex * landmark_count || indices.empty() || indices.size() % 3 != 0) {
    message.fail("the canonical face does not have 468 vertices and whole triangles");
  }
  CanonicalFace face;
  face.vertices_cm.resize(3, landmark_count);
  for (int v = 0; v < landmark_count; ++v) {
    for (int axis = 0; axis < 3; ++axis) {
      face.vertices_cm(axis, v) =
          values[static_cast<std::size_t>(v) * floats_per_vertex + static_cast<std::size_t>(axis)];
    }
  }
  for (std::size_t i = 0; i < indices.size(); i += 3) {
    face.triangles.push_back({indices[i], indices[i + 1], indices[i + 2]});
  }
  face.normals = vertex_normals(face);
  return face;
}

}  // namespace facet::landmark
