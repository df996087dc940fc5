#include <string>

#include "exports/export_sequence.hpp"
#include "exports/usda_text.hpp"

namespace facet::exports {
namespace {

/// Universal Scene Description as text: one UsdGeomMesh in the head frame, metres, moved by the head's pose,
/// with points and normals for every frame.
class UsdaFramesWriter final : public SequenceWriter {
 public:
  UsdaFramesWriter(const SequenceOptions& options, const SequenceFrame& first)
      : file_(options.file),
        timeline_(options.timeline),
        triangles_(first.mesh.triangles),
        out_(options.file),
        normals_(options.file) {
    UsdaText head;
    append_layer_head(head, timeline_, "face");
    const auto to = std::back_inserter(head);
    fmt::format_to(to, "def Mesh \"face\"\n{{\n");
    append_mesh_constants(head, first.mesh, "    ");
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

    const double code = usda_time_code(timeline_, frame.sequence);

    UsdaText text;
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
    fmt::format_to(std::back_inserter(poses_), "        {}: ", code);
    append_matrix(poses_, metres_from_head(frame).matrix());
    poses_.append(std::string_view(",\n"));
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
  std::filesystem::path file_;
  Timeline timeline_;
  mesh::Triangles triangles_;
  files::OutputFile out_;
  files::ScratchFile normals_;
  UsdaText extents_;  ///< of all frames: some hundred bytes each
  UsdaText poses_;
};

}  // namespace

std::unique_ptr<SequenceWriter> open_usda_frames(const SequenceOptions& options, const SequenceFrame& first) {
  return std::make_unique<UsdaFramesWriter>(options, first);
}

}  // namespace facet::exports
