#include <fmt/format.h>

#include <iterator>
#include <string>

#include "exports/export_sequence.hpp"

namespace facet::exports {
namespace {

using Text = fmt::memory_buffer;

std::string_view view(const Text& text) {
  return {text.data(), text.size()};
}

/// "[(x, y, z), ...]", each number as the shortest text that gives the same float.
template <typename Matrix>
void append_tuples(Text& text, const Matrix& columns) {
  text.push_back('[');
  for (Eigen::Index i = 0; i < columns.cols(); ++i) {
    fmt::format_to(std::back_inserter(text), "{}({}", i == 0 ? "" : ", ", columns(0, i));
    for (Eigen::Index row = 1; row < columns.rows(); ++row) {
      fmt::format_to(std::back_inserter(text), ", {}", columns(row, i));
    }
    text.push_back(')');
  }
  text.push_back(']');
}

/// Universal Scene Description as text: one UsdGeomMesh in the head frame, metres, moved by the head's pose.
/// A time code is the frame's number in the source; at a varying rate, the first frame's number and then the
/// time in units of the average rate.
class UsdaWriter final : public SequenceWriter {
 public:
  UsdaWriter(const SequenceOptions& options, const SequenceFrame& first)
      : file_(options.file),
        timeline_(options.timeline),
        triangles_(first.mesh.triangles),
        out_(options.file),
        normals_(options.file) {
    Text head;
    const auto to = std::back_inserter(head);
    fmt::format_to(
        to,
        "#usda 1.0\n(\n    defaultPrim = \"face\"\n    doc = \"Facet\"\n    metersPerUnit = 1\n"
        "    upAxis = \"Y\"\n    startTimeCode = {}\n    endTimeCode = {}\n    timeCodesPerSecond = {}\n"
        "    framesPerSecond = {}\n)\n\ndef Mesh \"face\"\n{{\n"
        "    uniform token subdivisionScheme = \"none\"\n"
        "    uniform token orientation = \"rightHanded\"\n",
        time_code(timeline_.sequences.front()), time_code(timeline_.sequences.back()), timeline_.rate_hz,
        timeline_.rate_hz);
    fmt::format_to(to, "    int[] faceVertexCounts = [");
    for (Eigen::Index i = 0; i < triangles_.cols(); ++i) {
      fmt::format_to(to, "{}3", i == 0 ? "" : ", ");
    }
    fmt::format_to(to, "]\n    int[] faceVertexIndices = [");
    for (Eigen::Index i = 0; i < triangles_.size(); ++i) {
      fmt::format_to(to, "{}{}", i == 0 ? "" : ", ", triangles_.data()[i]);
    }
    fmt::format_to(to, "]\n    texCoord2f[] primvars:st = ");
    append_tuples(head, first.mesh.texture_coordinates);
    fmt::format_to(to, " (\n        interpolation = \"vertex\"\n    )\n");
    if (first.mesh.albedo.cols() > 0) {
      fmt::format_to(to, "    color3f[] primvars:displayColor = ");
      append_tuples(head, first.mesh.albedo);
      fmt::format_to(to, " (\n        interpolation = \"vertex\"\n    )\n");
    }
    fmt::format_to(to, "    point3f[] points.timeSamples = {{\n");
    out_.write(view(head));
    normals_.write(
        "    normal3f[] normals (\n        interpolation = \"vertex\"\n    )\n    normal3f[] "
        "normals.timeSamples = "
        "{\n");
  }

  void add(const SequenceFrame& frame) override {
    require_same_mesh(triangles_, frame, file_);
    const mesh::Vertices points = kMetresPerMillimetre * frame.mesh.vertices_mm;
    Eigen::Matrix<float, 3, 2> extent;
    extent << points.rowwise().minCoeff(), points.rowwise().maxCoeff();

    const double code = time_code(frame.sequence);

    Text text;
    fmt::format_to(std::back_inserter(text), "        {}: ", code);
    append_tuples(text, points);
    text.append(std::string_view(",\n"));
    out_.write(view(text));

    text.clear();
    fmt::format_to(std::back_inserter(text), "        {}: ", code);
    append_tuples(text, frame.mesh.normals);
    text.append(std::string_view(",\n"));
    normals_.write(view(text));

    fmt::format_to(std::back_inserter(extents_), "        {}: ", code);
    append_tuples(extents_, extent);
    extents_.append(std::string_view(",\n"));
    // USD's matrices are for row vectors: each tuple is a column of ours.
    const Eigen::Matrix4f pose = metres_from_head(frame).matrix();
    fmt::format_to(std::back_inserter(poses_), "        {}: (", code);
    for (int column = 0; column < 4; ++column) {
      fmt::format_to(std::back_inserter(poses_), "{}({}, {}, {}, {})", column == 0 ? "" : ", ",
                     pose(0, column), pose(1, column), pose(2, column), pose(3, column));
    }
    poses_.append(std::string_view("),\n"));
  }

  void commit() override {
    out_.write("    }\n");
    normals_.move_to(out_);
    out_.write("    }\n    float3[] extent.timeSamples = {\n");
    out_.write(view(extents_));
    out_.write("    }\n    matrix4d xformOp:transform.timeSamples = {\n");
    out_.write(view(poses_));
    out_.write("    }\n    uniform token[] xformOpOrder = [\"xformOp:transform\"]\n}\n");
    out_.commit();
  }

 private:
  double time_code(std::uint64_t sequence) const {
    return timeline_.times_s.empty() ? static_cast<double>(sequence)
                                     : static_cast<double>(timeline_.sequences.front()) +
                                           time_s(timeline_, sequence) * timeline_.rate_hz;
  }

  std::filesystem::path file_;
  Timeline timeline_;
  mesh::Triangles triangles_;
  files::OutputFile out_;
  files::ScratchFile normals_;
  Text extents_;  ///< of all frames: some hundred bytes each
  Text poses_;
};

}  // namespace

std::unique_ptr<SequenceWriter> open_usda(const SequenceOptions& options, const SequenceFrame& first) {
  return std::make_unique<UsdaWriter>(options, first);
}

}  // namespace facet::exports
