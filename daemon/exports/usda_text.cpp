#include "exports/usda_text.hpp"

namespace facet::exports {

void append_matrix(UsdaText& text, const Eigen::Matrix4f& matrix) {
  text.push_back('(');
  for (int column = 0; column < 4; ++column) {
    fmt::format_to(std::back_inserter(text), "{}({}, {}, {}, {})", column == 0 ? "" : ", ", matrix(0, column),
                   matrix(1, column), matrix(2, column), matrix(3, column));
  }
  text.push_back(')');
}

void append_layer_head(UsdaText& text, const Timeline& timeline, std::string_view prim) {
  const auto to = std::back_inserter(text);
  fmt::format_to(to,
                 "#usda 1.0\n(\n    defaultPrim = \"{}\"\n    doc = \"Facet\"\n    metersPerUnit = 1\n"
                 "    upAxis = \"Y\"\n    startTimeCode = {}\n    endTimeCode = {}\n"
                 "    timeCodesPerSecond = {}\n    framesPerSecond = {}\n",
                 prim, usda_time_code(timeline, timeline.sequences.front()),
                 usda_time_code(timeline, timeline.sequences.back()), timeline.rate_hz, timeline.rate_hz);
  if (const auto start = start_timecode(timeline)) {
    fmt::format_to(to,
                   "    customLayerData = {{\n        string timecode = \"{}\"\n"
                   "        string timecodeRate = \"{}\"\n    }}\n",
                   take::to_text(*start), take::to_text(start->rate));
  }
  fmt::format_to(to, ")\n\n");
}

void append_mesh_constants(UsdaText& text, const ExportMesh& mesh, std::string_view indent) {
  const auto to = std::back_inserter(text);
  fmt::format_to(to,
                 "{0}uniform token subdivisionScheme = \"none\"\n"
                 "{0}uniform token orientation = \"rightHanded\"\n{0}int[] faceVertexCounts = ",
                 indent);
  append_tuples(text, Eigen::RowVectorXi::Constant(mesh.triangles.cols(), 3));
  fmt::format_to(to, "\n{}int[] faceVertexIndices = ", indent);
  append_tuples(text,
                Eigen::Map<const Eigen::RowVectorXi>(mesh.triangles.data(), mesh.triangles.size()).eval());
  fmt::format_to(to, "\n{}texCoord2f[] primvars:st = ", indent);
  append_tuples(text, mesh.texture_coordinates);
  fmt::format_to(to, " (\n{0}    interpolation = \"vertex\"\n{0})\n", indent);
  if (mesh.albedo.cols() > 0) {
    fmt::format_to(to, "{}color3f[] primvars:displayColor = ", indent);
    append_tuples(text, mesh.albedo);
    fmt::format_to(to, " (\n{0}    interpolation = \"vertex\"\n{0})\n", indent);
  }
}

double usda_time_code(const Timeline& timeline, std::uint64_t sequence) {
  return timeline.times_s.empty() ? static_cast<double>(sequence)
                                  : static_cast<double>(timeline.sequences.front()) +
                                        time_s(timeline, sequence) * timeline.rate_hz;
}

}  // namespace facet::exports
