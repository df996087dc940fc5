#include "simulation/truth_mesh.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <fstream>
#include <iterator>
#include <span>
#include <string_view>

#include "facet/error.hpp"
#include "files/ply.hpp"
#include "render/renderer.hpp"

namespace facet::simulation {
namespace {

constexpr std::size_t kMaxElements = 50'000'000;  // more than any mesh of ours; keeps sizes far from overflow

// Plain arrays: a call of a std::array's member would take the packed array for an aligned one.
#pragma pack(push, 1)
struct PlyVertex {
  float position[3];
  float normal[3];
  float albedo[3];
  std::uint8_t srgb[3];
};
#pragma pack(pop)
static_assert(sizeof(PlyVertex) == 39);

struct Property {
  std::string name;
  std::size_t offset = 0;
  bool is_float = false;
};

std::size_t size_of_type(std::string_view type) {
  if (type == "char" || type == "uchar" || type == "int8" || type == "uint8") {
    return 1;
  }
  if (type == "short" || type == "ushort" || type == "int16" || type == "uint16") {
    return 2;
  }
  if (type == "int" || type == "uint" || type == "float" || type == "int32" || type == "uint32" ||
      type == "float32") {
    return 4;
  }
  return type == "double" || type == "float64" ? 8 : 0;
}

/// The header's words, read line by line; positions are checked against the end of the file.
struct Header {
  std::size_t vertex_count = 0;
  std::size_t face_count = 0;
  std::size_t vertex_bytes = 0;
  std::vector<Property> vertex_properties;
  std::size_t body = 0;  ///< where the vertices begin

  const Property* find(std::string_view name) const {
    const auto found = std::find_if(vertex_properties.begin(), vertex_properties.end(),
                                    [&](const Property& property) { return property.name == name; });
    return found == vertex_properties.end() ? nullptr : &*found;
  }
};

[[noreturn]] void refuse(const std::string& source, const std::string& why) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("{}: not a truth mesh: {}", source, why));
}

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  while (!line.empty()) {
    const std::size_t end = std::min(line.find(' '), line.size());
    if (end > 0) {
      words.push_back(line.substr(0, end));
    }
    line.remove_prefix(std::min(end + 1, line.size()));
  }
  return words;
}

std::size_t count_of(std::string_view word, const std::string& source) {
  std::size_t count = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), count);
  if (error != std::errc() || end != word.data() + word.size() || count > kMaxElements) {
    refuse(source, fmt::format("'{}' is not a number of elements up to {}", word, kMaxElements));
  }
  return count;
}

Header parse_header(std::string_view text, const std::string& source) {
  Header header;
  enum class Element { None, Vertex, Face } element = Element::None;
  bool has_format = false;
  bool has_faces = false;
  for (std::size_t at = 0, line_number = 1;; ++line_number) {
    const std::size_t end = text.find('\n', at);
    if (end == std::string_view::npos || end - at > 200) {
      refuse(source, "its header has no end");
    }
    std::string_view line = text.substr(at, end - at);
    if (line.ends_with('\r')) {
      line.remove_suffix(1);
    }
    at = end + 1;
    const auto words = words_of(line);
    if (line_number == 1) {
      if (line != "ply") {
        refuse(source, "it does not begin with 'ply'");
      }
    } else if (words.empty() || words[0] == "comment" || words[0] == "obj_info") {
      continue;
    } else if (words[0] == "format" && words.size() == 3) {
      if (words[1] != "binary_little_endian") {
        refuse(source, fmt::format("its format is {}, not binary_little_endian", words[1]));
      }
      has_format = true;
    } else if (words[0] == "element" && words.size() == 3) {
      if (words[1] == "vertex" && element == Element::None) {
        element = Element::Vertex;
        header.vertex_count = count_of(words[2], source);
      } else if (words[1] == "face" && element == Element::Vertex) {
        element = Element::Face;
        header.face_count = count_of(words[2], source);
      } else {
        refuse(source, fmt::format("line {}: element '{}' is not expected here", line_number, words[1]));
      }
    } else if (words[0] == "property" && words.size() == 3 && element == Element::Vertex) {
      const std::size_t bytes = size_of_type(words[1]);
      if (bytes == 0 || header.vertex_properties.size() >= 64) {
        refuse(source, fmt::format("line {}: property type '{}' is unknown", line_number, words[1]));
      }
      header.vertex_properties.push_back(
          {std::string(words[2]), header.vertex_bytes, words[1] == "float" || words[1] == "float32"});
      header.vertex_bytes += bytes;
    } else if (words[0] == "property" && words.size() == 5 && element == Element::Face && !has_faces &&
               words[1] == "list" && size_of_type(words[2]) == 1 && size_of_type(words[3]) == 4 &&
               (words[3].starts_with("int") || words[3].starts_with("uint"))) {
      has_faces = true;
    } else if (words[0] == "end_header") {
      header.body = at;
      break;
    } else {
      refuse(source, fmt::format("line {}: '{}' is not understood", line_number, line));
    }
  }
  if (!has_format || element == Element::None || (header.face_count > 0 && !has_faces)) {
    refuse(source, "its header lacks the format, the vertices or the list of corners");
  }
  return header;
}

/// Reads the named float properties of every vertex; false where the file lacks one.
bool read_fields(const std::byte* vertices, const Header& header, const std::array<const char*, 3>& names,
                 Eigen::Matrix3Xf& values) {
  std::array<std::size_t, 3> offsets{};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const Property* property = header.find(names[axis]);
    if (property == nullptr || !property->is_float) {
      return false;
    }
    offsets[axis] = property->offset;
  }
  values.resize(3, static_cast<Eigen::Index>(header.vertex_count));
  for (std::size_t v = 0; v < header.vertex_count; ++v) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      std::memcpy(&values(static_cast<Eigen::Index>(axis), static_cast<Eigen::Index>(v)),
                  vertices + v * header.vertex_bytes + offsets[axis], sizeof(float));
    }
  }
  return true;
}

}  // namespace

void write_truth_ply(const TruthMesh& mesh, const std::filesystem::path& file) {
  std::vector<PlyVertex> vertices(static_cast<std::size_t>(mesh.vertices_mm.cols()));
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    const auto column = static_cast<Eigen::Index>(v);
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      const auto k = static_cast<std::size_t>(axis);
      vertices[v].position[k] = mesh.vertices_mm(axis, column);
      vertices[v].normal[k] = mesh.normals(axis, column);
      vertices[v].albedo[k] = mesh.albedo(axis, column);
      vertices[v].srgb[k] = render::linear_to_srgb8(mesh.albedo(axis, column));
    }
  }
  files::write_ply(
      {.comments =
           {"Facet truth mesh: camera frame, mm, x right, y down, z forward; albedo linear, colours sRGB"},
       .fields = {"float x", "float y", "float z", "float nx", "float ny", "float nz", "float albedo_red",
                  "float albedo_green", "float albedo_blue", "uchar red", "uchar green", "uchar blue"},
       .vertices = std::as_bytes(std::span(vertices)),
       .vertex_count = vertices.size(),
       .corners = {mesh.triangles.data(), static_cast<std::size_t>(mesh.triangles.size())}},
      file);
}

TruthMesh read_truth_ply(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: no such truth mesh, or not readable", file.string()));
  }
  const std::vector<char> bytes{std::istreambuf_iterator<char>(stream), {}};
  return parse_truth_ply(std::as_bytes(std::span(bytes)), file.string());
}

TruthMesh parse_truth_ply(std::span<const std::byte> bytes, const std::string& source) {
  const Header header = parse_header({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, source);
  const std::size_t vertex_total = header.vertex_count * header.vertex_bytes;
  if (bytes.size() - header.body != vertex_total + header.face_count * sizeof(files::PlyFace)) {
    refuse(source, fmt::format("{} bytes follow the header where {} vertices and {} triangles take {}",
                               bytes.size() - header.body, header.vertex_count, header.face_count,
                               vertex_total + header.face_count * sizeof(files::PlyFace)));
  }
  const std::byte* vertices = bytes.data() + header.body;
  TruthMesh mesh;
  if (!read_fields(vertices, header, {"x", "y", "z"}, mesh.vertices_mm)) {
    refuse(source, "its vertices lack x, y and z as float");
  }
  if (!mesh.vertices_mm.allFinite()) {
    refuse(source, "a position is not finite");
  }
  mesh.triangles.resize(3, static_cast<Eigen::Index>(header.face_count));
  const std::byte* faces = vertices + vertex_total;
  for (std::size_t f = 0; f < header.face_count; ++f) {
    files::PlyFace face{};
    std::memcpy(&face, faces + f * sizeof(files::PlyFace), sizeof(files::PlyFace));
    for (std::size_t k = 0; k < 3; ++k) {
      if (face.count != 3 || face.corners[k] < 0 ||
          static_cast<std::size_t>(face.corners[k]) >= header.vertex_count) {
        refuse(source,
               fmt::format("face {} has {} corners or names a vertex that is not there", f, face.count));
      }
      mesh.triangles(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(f)) = face.corners[k];
    }
  }
  if (!read_fields(vertices, header, {"nx", "ny", "nz"}, mesh.normals)) {
    mesh::vertex_normals(mesh.vertices_mm, mesh.triangles, mesh.normals);
  }
  if (!read_fields(vertices, header, {"albedo_red", "albedo_green", "albedo_blue"}, mesh.albedo)) {
    constexpr float kGrey = 0.5F;
    mesh.albedo = Eigen::Matrix3Xf::Constant(3, mesh.vertices_mm.cols(), kGrey);
  }
  if (!mesh.normals.allFinite() || !mesh.albedo.allFinite()) {
    refuse(source, "a normal or an albedo is not finite");
  }
  return mesh;
}

}  // namespace facet::simulation
