#include <fmt/format.h>

#include <Eigen/SVD>
#include <algorithm>
#include <numeric>
#include <string>
#include <utility>

#include "exports/export_sequence.hpp"
#include "exports/glb_file.hpp"

namespace facet::exports {
namespace {

/// A mesh with morph targets, metres, on a node that moves.
class GlbPart {
 public:
  /// mesh: without any target. step: of all positions, where the file is compressed.
  GlbPart(GlbFile& glb, std::string name, const ExportMesh& mesh, GltfStep step, int material)
      : glb_(glb),
        step_(step),
        name_(std::move(name)),
        base_m_(glb.stored(kMetresPerMillimetre * mesh.vertices_mm, step)),
        base_normals_(glb.stored(mesh.normals, GltfStep::Normal)) {
    GltfJson attributes;
    attributes["POSITION"] = glb.add_positions(base_m_, step_);
    add_attributes(attributes, glb, mesh, base_normals_);
    primitive_["attributes"] = std::move(attributes);
    primitive_["indices"] = glb.add_triangles(mesh.triangles);
    primitive_["material"] = material;
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
    targets_.push_back(name);
  }

  /// Where the node is at one more frame, metres, in its parent.
  void add_pose(const Eigen::Isometry3f& pose_m) {
    Eigen::Quaternionf turn(pose_m.linear());
    turn.normalize();
    // The same turn has two quaternions; neighbours are of the same half, or players spin.
    if (!rotations_.empty()) {
      const Eigen::Map<const Eigen::Vector4f> before(rotations_.data() + rotations_.size() - 4);
      if (before.dot(turn.coeffs()) < 0) {
        turn.coeffs() = -turn.coeffs();
      }
    }
    translations_m_.insert(translations_m_.end(), pose_m.translation().begin(), pose_m.translation().end());
    rotations_.insert(rotations_.end(), turn.coeffs().begin(), turn.coeffs().end());
  }

  const std::string& name() const { return name_; }
  std::size_t target_count() const { return targets_.size(); }
  std::span<const float> translations_m() const { return translations_m_; }
  std::span<const float> rotations() const { return rotations_; }

  /// The mesh of the document; once.
  GltfJson take_mesh() {
    GltfJson mesh{{"name", name_}};
    if (targets_.empty()) {
      primitive_.erase("targets");
    } else {
      mesh["weights"] = std::vector<float>(targets_.size(), 0.0F);
      mesh["extras"]["targetNames"] = targets_;
    }
    mesh["primitives"] = GltfJson::array({std::move(primitive_)});
    return mesh;
  }

 private:
  GlbFile& glb_;
  GltfStep step_;
  std::string name_;
  mesh::Vertices base_m_;
  Eigen::Matrix3Xf base_normals_;
  GltfJson primitive_;
  std::vector<std::string> targets_;
  std::vector<float> translations_m_;  ///< [frames][3]
  std::vector<float> rotations_;       ///< [frames][4] x y z w
};

/// A head in the head frame, metres, whose node the head's pose moves, and parts that hang on it.
class GlbAnimation {
 public:
  /// look: has the picture of all parts.
  GlbAnimation(const SequenceOptions& options, const ExportMesh& look, bool has_eyes)
      : timeline_(options.timeline), glb_(options.file, options.compression) {
    add_materials(document_, glb_, look, has_eyes);
    if (const auto start = start_timecode(timeline_)) {
      document_["asset"]["extras"] = {{"timecode", take::to_text(*start)},
                                      {"timecodeRate", take::to_text(start->rate)}};
    }
    document_["scene"] = 0;
    document_["scenes"] = GltfJson::array({{{"nodes", {0}}}});
    document_["nodes"] = GltfJson::array();
  }

  /// The first is the head, the others are its children. centre_m: where the node rests in its parent.
  GlbPart& add_part(const std::string& name, const ExportMesh& mesh, GltfStep step,
                    const Eigen::Vector3f& centre_m) {
    const std::size_t index = parts_.size();
    GltfJson node{{"name", name}, {"mesh", index}};
    if (index > 0) {
      node["translation"] = gltf_list(centre_m);
      document_["nodes"][0]["children"].push_back(index);
    }
    document_["nodes"].push_back(std::move(node));
    parts_.push_back(std::make_unique<GlbPart>(glb_, name, mesh, step, index > 0 ? 1 : 0));
    return *parts_.back();
  }
  void add_time(const SequenceFrame& frame) {
    times_s_.push_back(static_cast<float>(time_s(timeline_, frame.sequence)));
  }

  /// weights  [frames][targets] of the head
  void commit(std::span<const float> weights) {
    const std::size_t frames = times_s_.size();
    const int input = glb_.add_floats(times_s_, "SCALAR", frames, kGltfNoTarget, GltfStep::Exact,
                                      {{"min", {times_s_.front()}}, {"max", {times_s_.back()}}});
    GltfJson samplers = GltfJson::array();
    GltfJson channels = GltfJson::array();
    const auto animate = [&](std::size_t node, const char* path, int output) {
      samplers.push_back({{"input", input}, {"output", output}, {"interpolation", "LINEAR"}});
      channels.push_back({{"sampler", samplers.size() - 1}, {"target", {{"node", node}, {"path", path}}}});
    };
    document_["meshes"] = GltfJson::array();
    for (std::size_t node = 0; node < parts_.size(); ++node) {
      GlbPart& part = *parts_[node];
      animate(node, "translation", glb_.add_floats(part.translations_m(), "VEC3", frames, kGltfNoTarget));
      animate(node, "rotation", glb_.add_floats(part.rotations(), "VEC4", frames, kGltfNoTarget));
      if (node == 0 && part.target_count() > 0) {
        animate(node, "weights", glb_.add_floats(weights, "SCALAR", weights.size(), kGltfNoTarget));
      }
      document_["meshes"].push_back(part.take_mesh());
    }
    document_["animations"] = GltfJson::array(
        {{{"name", "take"}, {"samplers", std::move(samplers)}, {"channels", std::move(channels)}}});
    glb_.commit(std::move(document_));
  }

 private:
  Timeline timeline_;
  GlbFile glb_;
  GltfJson document_;
  std::vector<std::unique_ptr<GlbPart>> parts_;
  std::vector<float> times_s_;
};

/// Every frame's geometry as a morph target whose weight is 1 at its time and 0 at all others. The first
/// frame is the mesh itself.
class GlbFramesWriter final : public SequenceWriter {
 public:
  GlbFramesWriter(const SequenceOptions& options, const SequenceFrame& first)
      : file_(fitting(options, first)),
        triangles_(first.mesh.triangles),
        glb_(options, first.mesh, false),
        head_(glb_.add_part("head", first.mesh, GltfStep::Position, Eigen::Vector3f::Zero())) {}

  void add(const SequenceFrame& frame) override {
    require_same_mesh(triangles_, frame, file_);
    if (frames_ > 0) {
      head_.add_target(fmt::format("frame_{:06}", frame.sequence), frame.mesh.vertices_mm,
                       frame.mesh.normals);
    }
    glb_.add_time(frame);
    head_.add_pose(metres_from_head(frame));
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
  /// The file's name, where it can hold the frames: before any is written. What is reckoned is the
  /// least; of a compressed file the weights, as no frame is known before it is compressed.
  static std::filesystem::path fitting(const SequenceOptions& options, const SequenceFrame& first) {
    const std::uint64_t frames = options.timeline.sequences.size();
    const auto vertices = static_cast<std::uint64_t>(first.mesh.vertices_mm.cols());
    const std::uint64_t weights = frames * (frames - std::min<std::uint64_t>(frames, 1)) * sizeof(float);
    // Place and normal of each vertex; a time, place and turn of the head.
    const std::uint64_t frame = (6 * vertices + 8) * sizeof(float);
    if (options.compression == GlbCompression::None) {
      require_glb_size(options.file, frames * frame + weights);
    } else {
      require_glb_size(options.file, weights, " of weights");
    }
    return options.file;
  }

  std::filesystem::path file_;
  mesh::Triangles triangles_;
  GlbAnimation glb_;
  GlbPart& head_;
  std::size_t frames_ = 0;
};

/// The centre of the sphere that fits points best: |p|^2 = 2 c . p + k, in the least-squares sense.
Eigen::Vector3f sphere_centre(const Eigen::Matrix3Xf& points) {
  Eigen::MatrixX4d rows(points.cols(), 4);
  rows << 2.0 * points.transpose().cast<double>(), Eigen::VectorXd::Ones(points.cols());
  const Eigen::VectorXd squares = points.cast<double>().colwise().squaredNorm().transpose();
  const Eigen::Vector4d solution = (rows.transpose() * rows).ldlt().solve(rows.transpose() * squares);
  return solution.head<3>().cast<float>();
}

/// The rigid movement that lays points on others best, in the least-squares sense [Kab76]: not
/// Eigen::umeyama, of which GCC 12 says that it reads beyond a vector.
Eigen::Isometry3f rigid_movement(const Eigen::Matrix3Xf& from, const Eigen::Matrix3Xf& to) {
  const Eigen::Vector3d from_mean = from.cast<double>().rowwise().mean();
  const Eigen::Vector3d to_mean = to.cast<double>().rowwise().mean();
  const Eigen::Matrix3d covariance =
      (to.cast<double>().colwise() - to_mean) * (from.cast<double>().colwise() - from_mean).transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d turn = svd.matrixU() * svd.matrixV().transpose();
  if (turn.determinant() < 0) {
    turn -= 2 * svd.matrixU().col(2) * svd.matrixV().col(2).transpose();
  }
  Eigen::Isometry3f out = Eigen::Isometry3f::Identity();
  out.linear() = turn.cast<float>();
  out.translation() = (to_mean - turn * from_mean).cast<float>();
  return out;
}

/// The vertices of a mesh and what triangles they have among each other.
ExportMesh part_of(const ExportMesh& mesh, const std::vector<std::int32_t>& vertices) {
  std::vector<std::int32_t> place(static_cast<std::size_t>(mesh.vertices_mm.cols()), -1);
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    place[static_cast<std::size_t>(vertices[i])] = static_cast<std::int32_t>(i);
  }
  ExportMesh part;
  part.vertices_mm = mesh.vertices_mm(Eigen::all, vertices);
  part.normals = mesh.normals(Eigen::all, vertices);
  part.texture_coordinates = mesh.texture_coordinates(Eigen::all, vertices);
  if (mesh.albedo.cols() > 0) {
    part.albedo = mesh.albedo(Eigen::all, vertices);
  }
  part.skin_png = mesh.skin_png;
  part.triangles.resize(3, mesh.triangles.cols());
  Eigen::Index count = 0;
  for (Eigen::Index t = 0; t < mesh.triangles.cols(); ++t) {
    const Eigen::Vector3i corners = mesh.triangles.col(t).unaryExpr(
        [&](std::int32_t vertex) { return place[static_cast<std::size_t>(vertex)]; });
    if (corners.minCoeff() >= 0) {
      part.triangles.col(count++) = corners;
    }
  }
  part.triangles.conservativeResize(3, count);
  return part;
}

/// The coarse mesh of the neutral face with the person's expressions as morph targets; the eyeballs as nodes
/// that turn about their centres.
class GlbExpressionsWriter final : public SequenceWriter {
 public:
  GlbExpressionsWriter(const SequenceOptions& options, const SequenceFrame& first)
      : file_(options.file),
        triangles_(first.mesh.triangles),
        target_count_(options.shapes.names.size()),
        glb_(options, first.mesh,
             !options.shapes.eyeballs[0].empty() || !options.shapes.eyeballs[1].empty()) {
    const ExpressionShapes& shapes = options.shapes;
    const ExportMesh neutral = neutral_mesh(shapes, first.mesh);
    std::vector<std::int32_t> rest(static_cast<std::size_t>(neutral.vertices_mm.cols()));
    std::iota(rest.begin(), rest.end(), 0);
    for (const std::vector<std::int32_t>& eye : shapes.eyeballs) {
      std::erase_if(rest, [&](std::int32_t v) { return std::binary_search(eye.begin(), eye.end(), v); });
    }
    head_ = &glb_.add_part("head", part_of(neutral, rest), GltfStep::Shape, Eigen::Vector3f::Zero());
    for (const auto& [side, name] : {std::pair{0U, "eyeLeft"}, {1U, "eyeRight"}}) {
      if (!shapes.eyeballs.at(side).empty()) {
        add_eye(name, shapes.eyeballs.at(side), neutral);
      }
    }
    for (std::size_t e = 0; e < target_count_; ++e) {
      add_shape(shapes.names[e], shapes.neutral_mm + shapes.deltas_mm[e], rest);
    }
  }

  void add(const SequenceFrame& frame) override {
    require_same_mesh(triangles_, frame, file_);
    glb_.add_time(frame);
    head_->add_pose(metres_from_head(frame));
    for (Eye& eye : eyes_) {
      // How it turned is told by where its vertices went, so it needs no angles of the model.
      const Eigen::Isometry3f moved =
          rigid_movement(eye.resting_mm, frame.mesh.vertices_mm(Eigen::all, eye.vertices));
      Eigen::Isometry3f pose_m = moved;
      pose_m.translation() = kMetresPerMillimetre * (moved * eye.centre_mm);
      eye.part->add_pose(pose_m);
    }
    const std::size_t begin = weights_.size();
    weights_.resize(begin + target_count_, 0.0F);
    std::copy_n(frame.expression.begin(), std::min(target_count_, frame.expression.size()),
                weights_.begin() + static_cast<std::ptrdiff_t>(begin));
  }
  void commit() override { glb_.commit(weights_); }

 private:
  struct Eye {
    std::vector<std::int32_t> vertices;
    Eigen::Matrix3Xf resting_mm;
    Eigen::Vector3f centre_mm;
    GlbPart* part;
  };

  void add_eye(const char* name, const std::vector<std::int32_t>& vertices, const ExportMesh& neutral) {
    ExportMesh eyeball = part_of(neutral, vertices);
    Eye eye{vertices, eyeball.vertices_mm, sphere_centre(eyeball.vertices_mm), nullptr};
    eyeball.vertices_mm.colwise() -= eye.centre_mm;
    eye.part = &glb_.add_part(name, eyeball, GltfStep::Shape, kMetresPerMillimetre * eye.centre_mm);
    eyes_.push_back(std::move(eye));
  }

  /// An eyeball has the shapes that move it, at rest in this animation: for programs that drive shapes alone.
  void add_shape(const std::string& name, const mesh::Vertices& shape_mm,
                 const std::vector<std::int32_t>& rest) {
    Eigen::Matrix3Xf normals;
    mesh::vertex_normals(shape_mm, triangles_, normals);
    mend_normals(normals);
    head_->add_target(name, shape_mm(Eigen::all, rest), normals(Eigen::all, rest));
    for (Eye& eye : eyes_) {
      constexpr float kMoves_mm = 0.01F;
      const Eigen::Matrix3Xf moved_mm = shape_mm(Eigen::all, eye.vertices);
      if ((moved_mm - eye.resting_mm).colwise().norm().maxCoeff() > kMoves_mm) {
        eye.part->add_target(name, moved_mm.colwise() - eye.centre_mm, normals(Eigen::all, eye.vertices));
      }
    }
  }

  std::filesystem::path file_;
  mesh::Triangles triangles_;
  std::size_t target_count_;
  GlbAnimation glb_;
  GlbPart* head_ = nullptr;
  std::vector<Eye> eyes_;
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
