#include <fmt/format.h>

#include <algorithm>
#include <string>
#include <utility>

#include "exports/export_sequence.hpp"
#include "exports/glb_file.hpp"

namespace facet::exports {
namespace {

/// A mesh in the head frame, metres, whose node the head's pose moves, with morph targets.
class GlbAnimation {
 public:
  /// mesh: head frame, without any target. step: of all positions, where the file is compressed.
  GlbAnimation(const SequenceOptions& options, const ExportMesh& mesh, GltfStep step)
      : timeline_(options.timeline),
        glb_(options.file, options.compression),
        step_(step),
        base_m_(glb_.stored(kMetresPerMillimetre * mesh.vertices_mm, step)),
        base_normals_(glb_.stored(mesh.normals, GltfStep::Normal)) {
    const auto count = static_cast<std::size_t>(base_m_.cols());
    GltfJson attributes;
    attributes["POSITION"] = glb_.add_positions(base_m_, step_);
    attributes["NORMAL"] =
        glb_.add_floats(flat(base_normals_), "VEC3", count, kGltfVertices, GltfStep::Normal);
    attributes["TEXCOORD_0"] = glb_.add_floats(flat(gltf_texture_coordinates(mesh.texture_coordinates)),
                                               "VEC2", count, kGltfVertices, GltfStep::Texture);
    if (mesh.albedo.cols() > 0) {
      const mesh::Vertices colour = mesh.albedo.cwiseMax(0.0F).cwiseMin(1.0F);
      attributes["COLOR_0"] = glb_.add_floats(flat(colour), "VEC3", count, kGltfVertices, GltfStep::Colour);
    }
    primitive_["attributes"] = std::move(attributes);
    primitive_["indices"] = glb_.add_triangles(mesh.triangles);
    primitive_["material"] = 0;
    primitive_["targets"] = GltfJson::array();
  }

  /// A morph target: what it makes of the mesh at weight 1.
  void add_target(const std::string& name, const mesh::Vertices& vertices_mm,
                  const Eigen::Matrix3Xf& normals) {
    const Eigen::Matrix3Xf normal_deltas = normals - base_normals_;
    GltfJson target;
    target["POSITION"] = glb_.add_positions(kMetresPerMillimetre * vertices_mm - base_m_, step_);
    target["NORMAL"] = glb_.add_floats(flat(normal_deltas), "VEC3", static_cast<std::size_t>(normals.cols()),
                                       kGltfVertices, GltfStep::Normal);
    primitive_["targets"].push_back(std::move(target));
    names_.push_back(name);
  }

  void add_pose(const SequenceFrame& frame) {
    const Eigen::Isometry3f pose = metres_from_head(frame);
    Eigen::Quaternionf turn(pose.linear());
    turn.normalize();
    // The same turn has two quaternions; neighbours are of the same half, or players spin.
    if (!rotations_.empty()) {
      const Eigen::Map<const Eigen::Vector4f> before(rotations_.data() + rotations_.size() - 4);
      if (before.dot(turn.coeffs()) < 0) {
        turn.coeffs() = -turn.coeffs();
      }
    }
    times_s_.push_back(static_cast<float>(time_s(timeline_, frame.sequence)));
    for (int axis = 0; axis < 3; ++axis) {
      translations_m_.push_back(pose.translation()[axis]);
    }
    for (int axis = 0; axis < 4; ++axis) {
      rotations_.push_back(turn.coeffs()[axis]);
    }
  }

  /// weights  [frames][targets]
  void commit(std::span<const float> weights) {
    const std::size_t frames = times_s_.size();
    const int input = glb_.add_floats(times_s_, "SCALAR", frames, kGltfNoTarget, GltfStep::Exact,
                                      {{"min", {times_s_.front()}}, {"max", {times_s_.back()}}});
    GltfJson samplers = GltfJson::array();
    GltfJson channels = GltfJson::array();
    const auto animate = [&](const char* path, int output) {
      samplers.push_back({{"input", input}, {"output", output}, {"interpolation", "LINEAR"}});
      channels.push_back({{"sampler", samplers.size() - 1}, {"target", {{"node", 0}, {"path", path}}}});
    };
    animate("translation", glb_.add_floats(translations_m_, "VEC3", frames, kGltfNoTarget));
    animate("rotation", glb_.add_floats(rotations_, "VEC4", frames, kGltfNoTarget));

    GltfJson mesh{{"name", "face"}};
    if (names_.empty()) {
      primitive_.erase("targets");
    } else {
      animate("weights", glb_.add_floats(weights, "SCALAR", weights.size(), kGltfNoTarget));
      mesh["weights"] = std::vector<float>(names_.size(), 0.0F);
      mesh["extras"]["targetNames"] = names_;
    }
    mesh["primitives"] = GltfJson::array({std::move(primitive_)});

    GltfJson document;
    document["scene"] = 0;
    document["scenes"] = GltfJson::array({{{"nodes", {0}}}});
    document["nodes"] = GltfJson::array({{{"name", "head"}, {"mesh", 0}}});
    document["meshes"] = GltfJson::array({std::move(mesh)});
    document["materials"] = GltfJson::array({gltf_skin()});
    document["animations"] = GltfJson::array(
        {{{"name", "take"}, {"samplers", std::move(samplers)}, {"channels", std::move(channels)}}});
    glb_.commit(std::move(document));
  }

 private:
  Timeline timeline_;
  GlbFile glb_;
  GltfStep step_;
  mesh::Vertices base_m_;
  Eigen::Matrix3Xf base_normals_;
  GltfJson primitive_;
  std::vector<std::string> names_;
  std::vector<float> times_s_;
  std::vector<float> translations_m_;
  std::vector<float> rotations_;
};

/// Every frame's geometry as a morph target whose weight is 1 at its time and 0 at all others. The first
/// frame is the mesh itself.
class GlbFramesWriter final : public SequenceWriter {
 public:
  GlbFramesWriter(const SequenceOptions& options, const SequenceFrame& first)
      : file_(options.file),
        triangles_(first.mesh.triangles),
        glb_(options, first.mesh, GltfStep::Position) {}

  void add(const SequenceFrame& frame) override {
    require_same_mesh(triangles_, frame, file_);
    if (frames_ > 0) {
      glb_.add_target(fmt::format("frame_{:06}", frame.sequence), frame.mesh.vertices_mm, frame.mesh.normals);
    }
    glb_.add_pose(frame);
    ++frames_;
  }

  void commit() override {
    const std::size_t targets = frames_ - 1;
    std::vector<float> weights(frames_ * targets, 0.0F);
    for (std::size_t target = 0; target < targets; ++target) {
      weights[(target + 1) * targets + target] = 1.0F;
    }
    glb_.commit(weights);
  }

 private:
  std::filesystem::path file_;
  mesh::Triangles triangles_;
  GlbAnimation glb_;
  std::size_t frames_ = 0;
};

/// The coarse mesh of the neutral face with the person's expressions as morph targets.
class GlbExpressionsWriter final : public SequenceWriter {
 public:
  GlbExpressionsWriter(const SequenceOptions& options, const SequenceFrame& first)
      : file_(options.file),
        triangles_(first.mesh.triangles),
        target_count_(options.shapes.names.size()),
        glb_(options, neutral(options.shapes, first.mesh), GltfStep::Shape) {
    Eigen::Matrix3Xf normals;
    for (std::size_t e = 0; e < target_count_; ++e) {
      const mesh::Vertices shape = options.shapes.neutral_mm + options.shapes.deltas_mm[e];
      mesh::vertex_normals(shape, triangles_, normals);
      mend_normals(normals);
      glb_.add_target(options.shapes.names[e], shape, normals);
    }
  }

  void add(const SequenceFrame& frame) override {
    require_same_mesh(triangles_, frame, file_);
    glb_.add_pose(frame);
    const std::size_t begin = weights_.size();
    weights_.resize(begin + target_count_, 0.0F);
    std::copy_n(frame.expression.begin(), std::min(target_count_, frame.expression.size()),
                weights_.begin() + static_cast<std::ptrdiff_t>(begin));
  }
  void commit() override { glb_.commit(weights_); }

 private:
  static ExportMesh neutral(const ExpressionShapes& shapes, const ExportMesh& mesh) {
    ExportMesh out = mesh;
    out.vertices_mm = shapes.neutral_mm;
    mesh::vertex_normals(out.vertices_mm, out.triangles, out.normals);
    mend_normals(out.normals);
    return out;
  }

  std::filesystem::path file_;
  mesh::Triangles triangles_;
  std::size_t target_count_;
  GlbAnimation glb_;
  std::vector<float> weights_;
};

}  // namespace

std::unique_ptr<SequenceWriter> open_glb_frames(const SequenceOptions& options, const SequenceFrame& first) {
  return std::make_unique<GlbFramesWriter>(options, first);
}

std::unique_ptr<SequenceWriter> open_glb_expressions(const SequenceOptions& options,
                                                     const SequenceFrame& first) {
  return std::make_unique<GlbExpressionsWriter>(options, first);
}

}  // namespace facet::exports
