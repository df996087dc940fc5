#include "model/build_model.hpp"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <random>
#include <string_view>
#include <utility>

#include "face/deformation_transfer.hpp"
#include "mesh/quads.hpp"
#include "model/appearance.hpp"
#include "model/expression_shapes.hpp"
#include "model/head_mesh.hpp"
#include "model/identity_sampler.hpp"
#include "model/makehuman_data.hpp"

namespace facet::model {
namespace {

using face::Region;

// What a square millimetre of surface counts for in the truncation: the face is what is tracked.
constexpr double kFaceWeight = 1.0;
constexpr double kElsewhereWeight = 0.06;

/// Expressions of the upper face leave the mouth alone and the other way round: each group has its own fixed
/// vertices, which keeps the transferred shapes local.
bool moves_upper_face(std::string_view name) {
  return name.starts_with("eye") || name.starts_with("brow");
}

/// Vertices that no expression of a group moves in any ethnicity, and the eyeballs.
std::vector<std::uint8_t> fixed_vertices(const HeadMesh& head, const ExpressionShapes& shapes, bool upper) {
  std::vector<std::uint8_t> fixed(static_cast<std::size_t>(head.vertex_count()), 1);
  for (std::size_t e = 0; e < expression_names().size(); ++e) {
    if (moves_upper_face(expression_names()[e].name) != upper) {
      continue;
    }
    for (std::size_t ethnicity = 0; ethnicity < kEthnicities.size(); ++ethnicity) {
      std::array<double, 3> pure{};
      pure[ethnicity] = 1;
      const Eigen::Matrix3Xd shape_mm = shapes.blend_mm(static_cast<int>(e), pure);
      for (int v = 0; v < head.vertex_count(); ++v) {
        if (!shape_mm.col(v).isZero(0)) {
          fixed[static_cast<std::size_t>(v)] = 0;
        }
      }
    }
  }
  return fixed;
}

/// Rigid motion that brings `points` closest to `onto` (weighted least squares [Hor87; Kab76]).
Eigen::Isometry3d rigid_alignment(const Eigen::Matrix3Xd& points, const Eigen::Matrix3Xd& onto,
                                  const Eigen::VectorXd& weights) {
  const Eigen::Vector3d from = points * weights / weights.sum();
  const Eigen::Vector3d to = onto * weights / weights.sum();
  const Eigen::Matrix3d covariance =
      (onto.colwise() - to) * weights.asDiagonal() * (points.colwise() - from).transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const double sign = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1;
  const Eigen::Matrix3d rotation =
      svd.matrixU() * Eigen::Vector3d(1, 1, sign).asDiagonal() * svd.matrixV().transpose();
  Eigen::Isometry3d motion = Eigen::Isometry3d::Identity();
  motion.linear() = rotation;
  motion.translation() = to - rotation * from;
  return motion;
}

/// 1 on the ears: what the targets that scale them move most.
std::vector<std::uint8_t> find_ears(const MakeHumanTargets& targets, const HeadMesh& head) {
  constexpr double kMovedDm = 0.006;
  std::vector<std::uint8_t> ear(static_cast<std::size_t>(head.vertex_count()), 0);
  for (const char* name : {"ears/l-ear-trans-vert-up", "ears/r-ear-trans-vert-up"}) {
    const Eigen::VectorXd moved_dm = targets.displacements_dm(name, head.base_vertex).colwise().norm();
    for (int v = 0; v < head.vertex_count(); ++v) {
      if (moved_dm[v] > kMovedDm) {
        ear[static_cast<std::size_t>(v)] = 1;
      }
    }
  }
  return ear;
}

Mirror make_mirror(const HeadMesh& head) {
  Mirror mirror{head.mirror, {0}};
  const auto& names = expression_names();
  for (const ExpressionName& expression : names) {
    std::string twin = expression.name;
    if (const auto at = twin.rfind("Left"); at != std::string::npos) {
      twin.replace(at, 4, "Right");
    } else if (const auto right = twin.rfind("Right"); right != std::string::npos) {
      twin.replace(right, 5, "Left");
    }
    const auto found =
        std::find_if(names.begin(), names.end(), [&](const ExpressionName& n) { return twin == n.name; });
    mirror.expression.push_back(1 + static_cast<int>(found - names.begin()));
  }
  return mirror;
}

/// Everything that stays the same for all sampled identities.
class SliceMaker {
 public:
  SliceMaker(const HeadMesh& head, const ExpressionShapes& shapes, Eigen::Matrix3Xd source_mm,
             Eigen::VectorXd weights)
      : head_(head),
        shapes_(shapes),
        source_mm_(std::move(source_mm)),
        weights_(std::move(weights)),
        triangles_(mesh::split_quads(head.quads)),
        fixed_upper_(fixed_vertices(head, shapes, true)),
        fixed_lower_(fixed_vertices(head, shapes, false)) {}

  /// One identity: aligned to the source head, with every expression transferred to it.
  TensorSlice slice(const Identity& identity) const {
    const Eigen::Matrix3Xd neutral_mm =
        rigid_alignment(identity.neutral_mm, source_mm_, weights_) * identity.neutral_mm;
    const face::DeformationTransfer upper(source_mm_, neutral_mm, triangles_, fixed_upper_);
    const face::DeformationTransfer lower(source_mm_, neutral_mm, triangles_, fixed_lower_);
    TensorSlice slice = {neutral_mm.cast<float>()};
    for (std::size_t e = 0; e < expression_names().size(); ++e) {
      const Eigen::Matrix3Xd source_shape_mm = shapes_.blend_mm(static_cast<int>(e), identity.ethnicity);
      Eigen::Matrix3Xd shape_mm =
          (moves_upper_face(expression_names()[e].name) ? upper : lower).transfer(source_shape_mm);
      rotate_eyeballs(static_cast<int>(e), head_, neutral_mm, shape_mm);
      slice.push_back(shape_mm.cast<float>());
    }
    return slice;
  }

 private:
  const HeadMesh& head_;
  const ExpressionShapes& shapes_;
  Eigen::Matrix3Xd source_mm_;
  Eigen::VectorXd weights_;
  mesh::Triangles triangles_;
  std::vector<std::uint8_t> fixed_upper_;
  std::vector<std::uint8_t> fixed_lower_;
};

/// Weights per vertex: its area, and whether it belongs to the face.
Eigen::VectorXd truncation_weights(const HeadMesh& head, const Eigen::Matrix3Xd& mean_mm,
                                   const std::vector<std::uint8_t>& regions) {
  Eigen::VectorXd weights = vertex_areas(head.quads, mean_mm);
  for (Eigen::Index v = 0; v < weights.size(); ++v) {
    weights[v] *= face::has_region(regions[static_cast<std::size_t>(v)], Region::Refinable)
                      ? kFaceWeight
                      : kElsewhereWeight;
  }
  return weights / weights.mean();
}

Eigen::Vector3d eyeball_centre(const HeadMesh& head, const Eigen::Matrix3Xf& positions_mm, Part part) {
  const std::vector<int> eyeball = head.vertices_of(part);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const int v : eyeball) {
    sum += positions_mm.col(v).cast<double>();
  }
  return sum / static_cast<double>(eyeball.size());
}

void fill_model(const HeadMesh& head, BilinearCore&& core, face::FaceModel& model) {
  model.control.quads = head.quads;
  model.control.vertex_count = head.vertex_count();
  model.control.texture_coordinates = head.texture_coordinates;
  model.control.refinable.clear();
  for (const std::uint8_t bits : model.regions) {
    model.control.refinable.push_back(face::has_region(bits, Region::Refinable) ? 1 : 0);
  }
  for (const ExpressionName& expression : expression_names()) {
    model.expression_names.emplace_back(expression.name);
    model.expression_sigma.push_back(expression.sigma);
  }
  model.identity_modes = core.identity_modes;
  model.expression_modes = static_cast<int>(expression_names().size()) + 1;
  model.core_mm.resize(static_cast<std::size_t>(model.identity_modes) *
                       static_cast<std::size_t>(model.expression_modes) *
                       static_cast<std::size_t>(head.vertex_count()) * 3);
  for (int i = 0; i < model.identity_modes; ++i) {
    for (int e = 0; e < model.expression_modes; ++e) {
      model.core_row(i, e) = core.rows[static_cast<std::size_t>(i)][static_cast<std::size_t>(e)];
    }
    core.rows[static_cast<std::size_t>(i)].clear();
  }
}

}  // namespace

face::FaceModel build_model(const BuildOptions& options, const BuildProgress& progress, BuildReport& report) {
  const auto samples = static_cast<std::uint64_t>(options.identities);
  const std::uint64_t modes = expression_names().size() + 1;
  const auto checks = static_cast<std::uint64_t>(options.check_identities);
  const std::uint64_t total = samples + checks + 2 * modes;
  std::uint64_t done = 0;
  progress(done, total, "reading MakeHuman's data");

  const MakeHumanMesh base =
      read_makehuman_mesh(options.makehuman / "public/data/models/human_full_size.json");
  const MakeHumanTargets targets(options.makehuman);
  const HeadMesh head = cut_head(base);
  const HeadFrame frame = head_frame(base, head);
  const IdentitySampler sampler(options.makehuman, targets, base, head, frame);

  // The source head, its origin between the eyes.
  Eigen::Matrix3Xd source_mm = sampler.average().neutral_mm;
  source_mm.colwise() -= 0.5 * (eyeball_centre(head, source_mm.cast<float>(), Part::LeftEyeball) +
                                eyeball_centre(head, source_mm.cast<float>(), Part::RightEyeball));
  face::FaceModel model;
  model.name = "MakeHuman head (CC0), 51 ARKit expressions";
  model.regions = find_regions(head, source_mm, find_ears(targets, head));
  model.mean_albedo = mean_albedo(head, source_mm, read_makehuman_skins(options.makehuman));
  const ExpressionShapes shapes(targets, head, source_mm);

  TensorWeights weights{truncation_weights(head, source_mm, model.regions), {1.0}};
  for (const ExpressionName& expression : expression_names()) {
    weights.expression_mode.push_back(static_cast<double>(expression.sigma * expression.sigma));
  }
  const SliceMaker maker(head, shapes, source_mm, weights.vertex);
  std::mt19937_64 random(options.seed);
  std::vector<TensorSlice> slices;
  for (int s = 0; s < options.identities; ++s) {
    slices.push_back(maker.slice(sampler.draw(random)));
    progress(++done, total, "sampling identities");
  }
  BilinearCore core = truncate_identity_mode(std::move(slices), make_mirror(head), weights, options.core,
                                             [&] { progress(++done, total, "reducing the tensor"); });

  std::vector<int> face_vertices;
  for (int v = 0; v < head.vertex_count(); ++v) {
    if (face::has_region(model.regions[static_cast<std::size_t>(v)], Region::Refinable)) {
      face_vertices.push_back(v);
    }
  }
  report = {};
  report.explained_variance = core.explained;
  for (int s = 0; s < options.check_identities; ++s) {
    const auto error_mm =
        approximation_error_mm(core, maker.slice(sampler.draw(random)), weights, face_vertices);
    report.neutral_error_mm += error_mm[0] / options.check_identities;
    report.expression_error_mm += error_mm[1] / options.check_identities;
    progress(++done, total, "measuring what the reduction loses");
  }
  double variance_mm2 = 0;
  for (int i = 1; i < core.identity_modes; ++i) {
    for (const int v : face_vertices) {
      variance_mm2 += static_cast<double>(core.rows[static_cast<std::size_t>(i)][0].col(v).squaredNorm());
    }
  }
  report.identity_rms_mm = std::sqrt(variance_mm2 / static_cast<double>(face_vertices.size()));

  // The origin between the mean face's eyes.
  const Eigen::Vector3d left = eyeball_centre(head, core.rows[0][0], Part::LeftEyeball);
  const Eigen::Vector3d right = eyeball_centre(head, core.rows[0][0], Part::RightEyeball);
  report.eye_distance_mm = (left - right).norm();
  core.rows[0][0].colwise() -= (0.5 * (left + right)).cast<float>();
  fill_model(head, std::move(core), model);
  return model;
}

}  // namespace facet::model
