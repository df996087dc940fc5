#include <algorithm>
#include <cctype>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "exports/export_sequence.hpp"
#include "exports/usda_text.hpp"

namespace facet::exports {
namespace {

/// A name that a prim may have. index: of the shape, where its own name can't be one.
std::string prim_name(const std::string& name, std::size_t index) {
  const auto fits = [](char c) { return c == '_' || std::isalnum(static_cast<unsigned char>(c)) != 0; };
  const bool whole = !name.empty() && std::isdigit(static_cast<unsigned char>(name.front())) == 0 &&
                     std::all_of(name.begin(), name.end(), fits);
  return whole ? name : fmt::format("shape_{}", index);
}

/// Numbers with so many decimals, as doubles whose shortest text has no more.
Eigen::MatrixXd rounded(const Eigen::Matrix3Xf& values, double steps) {
  return ((values.cast<double>() * steps).array().round() / steps + 0.0).matrix();  // no -0
}

/// Universal Scene Description as text, by the schemas of UsdSkel: the neutral face in the head frame,
/// metres, with a BlendShape for each expression; a SkelAnimation with their weights; the head's pose on the
/// SkelRoot. The skeleton's one joint rests: programs want one where there are shapes.
class UsdaWriter final : public SequenceWriter {
 public:
  UsdaWriter(const SequenceOptions& options, const SequenceFrame& first)
      : file_(options.file),
        timeline_(options.timeline),
        triangles_(first.mesh.triangles),
        shape_count_(options.shapes.names.size()),
        out_(options.file),
        weights_(options.file),
        low_m_(Eigen::Vector3f::Constant(std::numeric_limits<float>::max())),
        high_m_(-low_m_) {
    UsdaText text;
    append_layer_head(text, timeline_, "face");
    fmt::format_to(std::back_inserter(text),
                   "def SkelRoot \"face\" (\n    prepend apiSchemas = [\"SkelBindingAPI\"]\n)\n{{\n");
    append_mesh(text, options.shapes, neutral_mesh(options.shapes, first.mesh));
    append_skeleton(text, options.shapes);
    out_.write(view(text));
  }

  void add(const SequenceFrame& frame) override {
    require_same_mesh(triangles_, frame, file_);
    low_m_ = low_m_.cwiseMin(kMetresPerMillimetre * frame.mesh.vertices_mm.rowwise().minCoeff());
    high_m_ = high_m_.cwiseMax(kMetresPerMillimetre * frame.mesh.vertices_mm.rowwise().maxCoeff());
    const double code = usda_time_code(timeline_, frame.sequence);
    Eigen::RowVectorXf weights = Eigen::RowVectorXf::Zero(static_cast<Eigen::Index>(shape_count_));
    std::copy_n(frame.expression.begin(), std::min(shape_count_, frame.expression.size()), weights.begin());
    UsdaText text;
    fmt::format_to(std::back_inserter(text), "                {}: ", code);
    append_tuples(text, weights);
    text.append(std::string_view(",\n"));
    weights_.write(view(text));
    fmt::format_to(std::back_inserter(poses_), "        {}: ", code);
    append_matrix(poses_, metres_from_head(frame).matrix());
    poses_.append(std::string_view(",\n"));
  }

  void commit() override {
    weights_.move_to(out_);
    UsdaText text;
    const auto to = std::back_inserter(text);
    Eigen::Matrix<float, 3, 2> extent;
    extent << low_m_, high_m_;
    fmt::format_to(to, "            }}\n        }}\n    }}\n    float3[] extent = ");
    append_tuples(text, extent);
    fmt::format_to(to, "\n    matrix4d xformOp:transform.timeSamples = {{\n{}    }}\n", view(poses_));
    fmt::format_to(to, "    uniform token[] xformOpOrder = [\"xformOp:transform\"]\n}}\n");
    out_.write(view(text));
    out_.commit();
  }

 private:
  static void append_mesh(UsdaText& text, const ExpressionShapes& shapes, const ExportMesh& neutral) {
    const auto to = std::back_inserter(text);
    fmt::format_to(
        to, "    def Mesh \"head\" (\n        prepend apiSchemas = [\"SkelBindingAPI\"]\n    )\n    {{\n");
    append_mesh_constants(text, neutral, "        ");
    const mesh::Vertices points_m = kMetresPerMillimetre * neutral.vertices_mm;
    Eigen::Matrix<float, 3, 2> extent;
    extent << points_m.rowwise().minCoeff(), points_m.rowwise().maxCoeff();
    fmt::format_to(to, "        float3[] extent = ");
    append_tuples(text, extent);
    fmt::format_to(to, "\n        point3f[] points = ");
    append_tuples(text, points_m);
    fmt::format_to(to, "\n        normal3f[] normals = ");
    append_tuples(text, neutral.normals);
    fmt::format_to(to, " (\n            interpolation = \"vertex\"\n        )\n");
    fmt::format_to(to, "        rel skel:skeleton = </face/skeleton>\n");
    append_names(text, "        uniform token[] skel:blendShapes", shapes.names);
    fmt::format_to(to, "        rel skel:blendShapeTargets = [");
    for (std::size_t e = 0; e < shapes.names.size(); ++e) {
      fmt::format_to(to, "{}</face/head/{}>", e == 0 ? "" : ", ", prim_name(shapes.names[e], e));
    }
    fmt::format_to(to, "]\n");
    for (std::size_t e = 0; e < shapes.names.size(); ++e) {
      append_shape(text, prim_name(shapes.names[e], e), shapes.deltas_mm[e], neutral);
    }
    fmt::format_to(to, "    }}\n");
  }

  /// What an expression does to the vertices that it moves or turns.
  static void append_shape(UsdaText& text, const std::string& name, const mesh::Vertices& deltas_mm,
                           const ExportMesh& neutral) {
    Eigen::Matrix3Xf normals;
    mesh::vertex_normals(neutral.vertices_mm + deltas_mm, neutral.triangles, normals);
    mend_normals(normals);
    const Eigen::MatrixXd offsets_m = rounded(kMetresPerMillimetre * deltas_mm, 1e7);
    const Eigen::MatrixXd normal_offsets = rounded(normals - neutral.normals, 1e4);
    std::vector<int> moved;
    for (Eigen::Index v = 0; v < deltas_mm.cols(); ++v) {
      if (!offsets_m.col(v).isZero(0) || !normal_offsets.col(v).isZero(0)) {
        moved.push_back(static_cast<int>(v));
      }
    }
    const auto to = std::back_inserter(text);
    fmt::format_to(
        to, "        def BlendShape \"{}\"\n        {{\n            uniform vector3f[] offsets = ", name);
    append_tuples(text, offsets_m(Eigen::all, moved).eval());
    fmt::format_to(to, "\n            uniform vector3f[] normalOffsets = ");
    append_tuples(text, normal_offsets(Eigen::all, moved).eval());
    fmt::format_to(to, "\n            uniform int[] pointIndices = ");
    append_tuples(
        text,
        Eigen::Map<const Eigen::RowVectorXi>(moved.data(), static_cast<Eigen::Index>(moved.size())).eval());
    fmt::format_to(to, "\n        }}\n");
  }

  /// Up to the samples of the weights.
  static void append_skeleton(UsdaText& text, const ExpressionShapes& shapes) {
    const auto to = std::back_inserter(text);
    fmt::format_to(
        to,
        "    def Skeleton \"skeleton\" (\n        prepend apiSchemas = [\"SkelBindingAPI\"]\n    )\n    {{\n"
        "        uniform token[] joints = [\"head\"]\n");
    for (const char* transforms : {"bindTransforms", "restTransforms"}) {
      fmt::format_to(to, "        uniform matrix4d[] {} = [", transforms);
      append_matrix(text, Eigen::Matrix4f::Identity());
      fmt::format_to(to, "]\n");
    }
    fmt::format_to(to,
                   "        rel skel:animationSource = </face/skeleton/take>\n\n"
                   "        def SkelAnimation \"take\"\n        {{\n");
    append_names(text, "            uniform token[] blendShapes", shapes.names);
    fmt::format_to(to, "            float[] blendShapeWeights.timeSamples = {{\n");
  }

  static void append_names(UsdaText& text, const char* what, const std::vector<std::string>& names) {
    fmt::format_to(std::back_inserter(text), "{} = [", what);
    for (std::size_t i = 0; i < names.size(); ++i) {
      fmt::format_to(std::back_inserter(text), "{}\"{}\"", i == 0 ? "" : ", ", prim_name(names[i], i));
    }
    fmt::format_to(std::back_inserter(text), "]\n");
  }

  std::filesystem::path file_;
  Timeline timeline_;
  mesh::Triangles triangles_;
  std::size_t shape_count_;
  files::OutputFile out_;
  files::ScratchFile weights_;
  UsdaText poses_;  ///< of all frames: some hundred bytes each
  Eigen::Vector3f low_m_;
  Eigen::Vector3f high_m_;
};

}  // namespace

std::unique_ptr<SequenceWriter> open_usda(const SequenceOptions& options, const SequenceFrame& first) {
  return std::make_unique<UsdaWriter>(options, first);
}

}  // namespace facet::exports
