// What the C++ decoder makes of the frame that patch_server publishes, in each profile, for CheckClient.cs.
// Usage: write_expected FOLDER

#include <fmt/format.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "stream/decoder.hpp"
#include "stream/encoder.hpp"
#include "support/mesh_frames.hpp"

namespace {

using namespace facet;

template <typename T>
void write(const std::filesystem::path& file, const T* data, std::size_t count) {
  std::ofstream out(file, std::ios::binary);
  out.exceptions(std::ios::badbit | std::ios::failbit);
  out.write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(count * sizeof(T)));
}

void write_profile(const std::filesystem::path& folder, stream::Profile profile, const std::string& name) {
  stream::Encoder encoder;
  const auto sent = test::patch_subject();
  const auto albedo = test::patch_albedo(*sent);
  const mesh::MeshFrame frame = test::patch_frame(7, sent, albedo);
  const auto subject = stream::decode_subject(encoder.subject(*sent, profile));
  const auto floats = [&](const std::string& what, const float* data, std::size_t count) {
    write(folder / (what + "-" + name + ".f32"), data, count);
  };
  const auto seen = stream::decode_albedo(encoder.albedo(sent->id, *albedo));
  floats("albedo", seen.albedo->linear_rgb.data(), seen.albedo->linear_rgb.size());
  stream::DecodedFrame decoded;
  stream::decode_frame(encoder.frame(frame, profile), subject, seen.albedo, decoded);
  std::string triangles;
  std::size_t vertex_count = 0;
  if (subject->hierarchy != nullptr) {
    const auto& finest = subject->hierarchy->finest();
    vertex_count = static_cast<std::size_t>(finest.vertex_count);
    for (Eigen::Index k = 0; k < 30; ++k) {
      triangles += fmt::format("{}{}", k == 0 ? "" : ",", finest.triangles.data()[k]);
    }
    if (profile == stream::Profile::Displacements) {
      mesh::rebuild_finest(*subject->hierarchy, decoded.frame.control_vertices_mm,
                           decoded.frame.displacements_mm, decoded.vertices_mm, decoded.normals);
    }
    floats("coordinates", subject->hierarchy->texture_coordinates.data(), 2 * vertex_count);
    floats("vertices", decoded.vertices_mm.data(), 3 * vertex_count);
    floats("normals", decoded.normals.data(), 3 * vertex_count);
  }
  const mesh::MeshFrame& got = decoded.frame;
  const Eigen::Matrix<float, 3, 4, Eigen::RowMajor> pose = got.camera_from_head.matrix().topRows<3>();
  floats("pose", pose.data(), 12);
  floats("expression", got.expression.data(), got.expression.size());
  std::string names;
  for (const std::string& expression : subject->expression_names) {
    names += (names.empty() ? "" : ",") + expression;
  }
  std::ofstream(folder / ("scalars-" + name + ".txt"))
      << fmt::format("{}\n{}\n{}\n{}\n{}\n{}\n{}\n{}\n", subject->id, names, vertex_count, triangles,
                     got.sequence, got.timestamp_ns, static_cast<int>(got.state), albedo->version);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    return 2;
  }
  write_profile(argv[1], stream::Profile::Signals, "signals");
  write_profile(argv[1], stream::Profile::Displacements, "displacements");
  write_profile(argv[1], stream::Profile::Vertices, "vertices");
  return 0;
}
