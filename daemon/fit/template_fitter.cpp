#include "fit/template_fitter.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>

#include "facet/error.hpp"
#include "fit/depth_pull.hpp"

namespace facet::fit {

namespace {

using capture::DepthMap;
using capture::Lens;
using Eigen::Matrix3f;
using Eigen::Matrix3Xf;
using Eigen::Vector2f;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr float kSettledMm = 0.005F;
constexpr double kLeastSeen = 0.05;
constexpr float kCameraFacing = 0.15F;  ///< least cosine between normal and view for a flow to count
constexpr float kVisibilityMarginMm = 4;
constexpr double kPatches = 100;
constexpr double kExpressionMisfitMm = 0.5;  ///< what expressions do not explain, typically
constexpr float kRimPx = 5;                  ///< half of a flow's patch and a little
constexpr float kRimJumpMm = 12;             ///< in depth: another part of the face
constexpr float kResidualReduction = 1e-4F;  ///< of the conjugate gradients

/// A bilinear sample of a flow; nothing where one of its pixels knows nothing.
std::optional<Vector2f> sample(const FlowView& view, float x, float y, float& confidence) {
  if (!(x >= 0) || !(y >= 0) || !(x < static_cast<float>(view.width_px - 1)) ||
      !(y < static_cast<float>(view.height_px - 1))) {
    return std::nullopt;
  }
  const int left = static_cast<int>(x);
  const int top = static_cast<int>(y);
  const std::size_t at = static_cast<std::size_t>(top) * static_cast<std::size_t>(view.width_px) +
                         static_cast<std::size_t>(left);
  const std::size_t below = at + static_cast<std::size_t>(view.width_px);
  confidence = std::min(
      {view.confidence[at], view.confidence[at + 1], view.confidence[below], view.confidence[below + 1]});
  if (!(confidence > 0)) {
    return std::nullopt;
  }
  const float u = x - static_cast<float>(left);
  const float v = y - static_cast<float>(top);
  return Vector2f((view.flow_px[at] * (1 - u) + view.flow_px[at + 1] * u) * (1 - v) +
                  (view.flow_px[below] * (1 - u) + view.flow_px[below + 1] * u) * v);
}

/// Distance along z from every pixel to the nearest triangle; infinity where there is none.
class DepthBuffer {
 public:
  void draw(const Lens& lens, const Matrix3Xf& seen, const mesh::Triangles& triangles) {
    width_ = lens.width_px;
    height_ = lens.height_px;
    depth_.assign(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_),
                  std::numeric_limits<float>::infinity());
    const auto fx = static_cast<float>(lens.fx_px);
    const auto fy = static_cast<float>(lens.fy_px);
    const auto cx = static_cast<float>(lens.cx_px);
    const auto cy = static_cast<float>(lens.cy_px);
    for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
      std::array<Vector3f, 3> corner;
      bool in_front = true;
      for (std::size_t i = 0; i < 3; ++i) {
        const Vector3f at = seen.col(triangles(static_cast<Eigen::Index>(i), t));
        in_front = in_front && at.z() > 1;
        corner[i] = {fx * at.x() / at.z() + cx, fy * at.y() / at.z() + cy, 1 / at.z()};
      }
      if (in_front) {
        fill(corner);
      }
    }
  }
  /// Without the lens's distortion, as drawn.
  float at(float x, float y) const {
    const int column = static_cast<int>(std::lround(x));
    const int row = static_cast<int>(std::lround(y));
    return column >= 0 && row >= 0 && column < width_ && row < height_
               ? depth_[static_cast<std::size_t>(row) * static_cast<std::size_t>(width_) +
                        static_cast<std::size_t>(column)]
               : 0;
  }

 private:
  void fill(const std::array<Vector3f, 3>& corner) {
    const auto [least_x, most_x] = std::minmax({corner[0].x(), corner[1].x(), corner[2].x()});
    const auto [least_y, most_y] = std::minmax({corner[0].y(), corner[1].y(), corner[2].y()});
    const float area = (corner[1] - corner[0]).x() * (corner[2] - corner[0]).y() -
                       (corner[1] - corner[0]).y() * (corner[2] - corner[0]).x();
    if (!(std::abs(area) > 1e-9F) || !(least_x > -1e5F) || !(most_x < 1e5F) || !(least_y > -1e5F) ||
        !(most_y < 1e5F)) {
      return;
    }
    const int x0 = std::max(0, static_cast<int>(std::ceil(least_x)));
    const int x1 = std::min(width_ - 1, static_cast<int>(std::floor(most_x)));
    const int y0 = std::max(0, static_cast<int>(std::ceil(least_y)));
    const int y1 = std::min(height_ - 1, static_cast<int>(std::floor(most_y)));
    for (int y = y0; y <= y1; ++y) {
      for (int x = x0; x <= x1; ++x) {
        const float px = static_cast<float>(x);
        const float py = static_cast<float>(y);
        const auto side = [&](const Vector3f& a, const Vector3f& b) {
          return ((b.x() - a.x()) * (py - a.y()) - (b.y() - a.y()) * (px - a.x())) / area;
        };
        const float w2 = side(corner[0], corner[1]);
        const float w0 = side(corner[1], corner[2]);
        const float w1 = 1 - w0 - w2;
        if (w0 >= 0 && w1 >= 0 && w2 >= 0) {
          float& depth = depth_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
                                static_cast<std::size_t>(x)];
          depth = std::min(depth, 1 / (w0 * corner[0].z() + w1 * corner[1].z() + w2 * corner[2].z()));
        }
      }
    }
  }

  int width_ = 0;
  int height_ = 0;
  std::vector<float> depth_;
};

/// The projection of a point and its derivative, distortion included.
struct Projection {
  Vector2f pixel{0, 0};
  Eigen::Matrix<float, 2, 3> derivative = Eigen::Matrix<float, 2, 3>::Zero();  ///< by the point, rig frame
};

std::optional<Projection> project(const Lens& lens, const Vector3f& point_mm) {
  const Vector3d point = point_mm.cast<double>();
  const auto pixel = lens.project(point);
  if (!pixel) {
    return std::nullopt;
  }
  // The distortion changes slowly: its derivative by differences over a hundredth of a millimetre.
  constexpr double kStepMm = 0.01;
  Projection result;
  result.pixel = pixel->cast<float>();
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3d step = kStepMm * Vector3d::Unit(axis);
    const auto ahead = lens.project(point + step);
    const auto behind = lens.project(point - step);
    if (!ahead || !behind) {
      return std::nullopt;
    }
    result.derivative.col(axis) = ((*ahead - *behind) / (2 * kStepMm)).cast<float>();
  }
  return result;
}

}  // namespace

void find_visible(const Lens& lens, const mesh::Vertices& vertices_mm, const Matrix3Xf& normals,
                  const mesh::Triangles& triangles, float margin_mm, float rim_px,
                  std::vector<std::uint8_t>& visible) {
  thread_local DepthBuffer buffer;
  const Pinhole camera(lens);
  const Matrix3Xf seen = (camera.rotation * vertices_mm).colwise() + camera.translation;
  buffer.draw(lens, seen, triangles);
  visible.assign(static_cast<std::size_t>(vertices_mm.cols()), 0);
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    const Vector3f at = seen.col(v);
    const float facing = -(camera.rotation * normals.col(v)).dot(at.normalized());
    if (at.z() > 1 && facing > kCameraFacing) {
      const float x = camera.fx * at.x() / at.z() + camera.cx;
      const float y = camera.fy * at.y() / at.z() + camera.cy;
      const float drawn = buffer.at(x, y);
      bool inside = drawn > 0 && at.z() < drawn + margin_mm / facing;
      for (int i = 0; i < 8 && inside && rim_px > 0; ++i) {
        const float angle = static_cast<float>(i) * std::numbers::pi_v<float> / 4;
        inside = std::abs(buffer.at(x + rim_px * std::cos(angle), y + rim_px * std::sin(angle)) - at.z()) <
                 kRimJumpMm / facing;
      }
      visible[static_cast<std::size_t>(v)] = inside ? 1 : 0;
    }
  }
}

struct TemplateFitter::Impl {
  Impl(std::shared_ptr<const TemplateMesh> with, const FitOptions& how)
      : surface(std::move(with)), options(how) {
    if (!(options.alpha > 0) || !(options.beta >= 0) || !(options.sigma_s_mm > 0) ||
        !(options.sigma_m_px > 0) || options.steps < 1 || options.cg_iterations < 1) {
      throw Error(ErrorKind::Usage,
                  "the options of the template fit make no sense: alpha, sigmas and counts are above 0, beta "
                  "not below");
    }
    const auto count = static_cast<std::size_t>(surface->vertex_count());
    blocks.resize(count);
    inverse.resize(count);
    for (Matrix3Xf* field :
         {&gradient, &step, &residual, &direction, &product, &preconditioned, &normals, &offset}) {
      field->setZero(3, surface->vertex_count());
    }
    depth_pull.resize(count);
    flow_pull.resize(count);
    edge_weights.resize(surface->one_rings.neighbours.size());
  }

  FitReport solve(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                  const mesh::Vertices* before_mm, mesh::Vertices& vertices_mm);
  void set_rest(RestShape shape);
  void bring_along(const mesh::Vertices& vertices_mm);
  void add_smoothness(const mesh::Vertices& vertices_mm);
  void add_depth(const DepthMap& map, const mesh::Vertices& vertices_mm);
  void add_motion(const FlowView& flow, const mesh::Vertices& before_mm,
                  std::span<const std::uint8_t> visible, const mesh::Vertices& vertices_mm);
  void apply(const Matrix3Xf& in, Matrix3Xf& out) const;
  void conjugate_gradients();

  std::shared_ptr<const TemplateMesh> surface;
  FitOptions options;
  RestShape placed;             ///< as it was set
  Eigen::MatrixXf expressions;  ///< [3 * vertex_count][expression_count] of placed; 0 off the skin
  Eigen::LLT<Eigen::MatrixXd> expression_normals;
  Eigen::VectorXd expression;       ///< [expression_count]
  Eigen::VectorXf misfit;           ///< [3 * vertex_count]
  mesh::Vertices expressed;         ///< placed, with the expression
  mesh::Vertices rest;              ///< the template, turned with the head
  std::vector<float> edge_weights;  ///< [one-ring entries] alpha / ||s_n1 - s_n2||^2
  std::vector<float> edge_sums;     ///< [vertex_count]
  std::vector<Matrix3f> blocks;     ///< [vertex_count] data terms' part of the normal equations
  std::vector<Matrix3f> inverse;    ///< of the diagonal blocks, the preconditioner
  Matrix3Xf gradient, step, residual, direction, product, preconditioned, normals, offset;
  std::vector<float> depth_pull, flow_pull;
  std::vector<std::vector<std::uint8_t>> visible;
  double surface_squares = 0, surface_weight = 0, motion_squares = 0, motion_weight = 0;
};

/// Eq. 11: 1 / ||s_n1 - s_n2||^2 of every edge, times alpha; and the normal equations of the expressions.
void TemplateFitter::Impl::set_rest(RestShape shape) {
  const std::int32_t count = surface->vertex_count();
  const bool fits = shape.vertices_mm.cols() == count &&
                    std::all_of(shape.expressions_mm.begin(), shape.expressions_mm.end(),
                                [&](const mesh::Vertices& delta) { return delta.cols() == count; });
  if (!fits) {
    throw Error(ErrorKind::Usage,
                fmt::format("the template's rest shape does not have its {} vertices", count));
  }
  placed = std::move(shape);
  expressed = placed.vertices_mm;
  const mesh::OneRings& rings = surface->one_rings;
  edge_sums.assign(static_cast<std::size_t>(count), 0);
  for (std::int32_t v = 0; v < count; ++v) {
    for (auto e = rings.offsets[static_cast<std::size_t>(v)];
         e < rings.offsets[static_cast<std::size_t>(v) + 1]; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      const float length2 =
          (placed.vertices_mm.col(v) - placed.vertices_mm.col(rings.neighbours[edge])).squaredNorm();
      edge_weights[edge] = static_cast<float>(options.alpha) / std::max(length2, 1e-2F);
      edge_sums[static_cast<std::size_t>(v)] += edge_weights[edge];
    }
  }
  const auto known = options.knows_expressions ? static_cast<Eigen::Index>(placed.expressions_mm.size()) : 0;
  expression.setZero(known);
  if (known == 0) {
    return;
  }
  expressions.resize(3 * static_cast<Eigen::Index>(count), known);
  misfit.resize(expressions.rows());
  double skin = 0;
  for (std::int32_t v = 0; v < count; ++v) {
    const bool counts = surface->is_skin[static_cast<std::size_t>(v)] != 0;
    skin += counts ? 1 : 0;
    for (Eigen::Index e = 0; e < known; ++e) {
      expressions.block<3, 1>(Eigen::Index{3} * v, e) =
          counts ? Vector3f(placed.expressions_mm[static_cast<std::size_t>(e)].col(v)) : Vector3f::Zero();
    }
  }
  // A face has about a hundred patches whose misfits have nothing to do with each other.
  const double ridge = skin / kPatches * kExpressionMisfitMm * kExpressionMisfitMm /
                       (options.expression_sigma * options.expression_sigma);
  const Eigen::MatrixXd normal_matrix = (expressions.transpose() * expressions).cast<double>() +
                                        ridge * Eigen::MatrixXd::Identity(known, known);
  expression_normals.compute(normal_matrix);
}

/// The rest shape in the pose and with the expression of the mesh as it is: what bends beyond them is E_r's.
void TemplateFitter::Impl::bring_along(const mesh::Vertices& vertices_mm) {
  if (!options.turns_with_the_head) {
    rest = placed.vertices_mm;
    return;
  }
  Eigen::VectorXd weights(vertices_mm.cols());
  for (Eigen::Index v = 0; v < weights.size(); ++v) {
    weights[v] = depth_pull[static_cast<std::size_t>(v)] > 0 ? 1 : 1e-6;
  }
  const auto pose_of = [&](const mesh::Vertices& shape) {
    return Eigen::Isometry3f(
        align_rigidly(shape.cast<double>(), vertices_mm.cast<double>(), weights).cast<float>());
  };
  Eigen::Isometry3f rig_from_rest = pose_of(expressed);
  if (expression.size() > 0) {
    const Eigen::Isometry3f rest_from_rig = rig_from_rest.inverse();
    Eigen::Map<Matrix3Xf>(misfit.data(), 3, vertices_mm.cols()) =
        ((rest_from_rig.linear() * vertices_mm).colwise() + rest_from_rig.translation()) - placed.vertices_mm;
    expression = expression_normals.solve((expressions.transpose() * misfit).cast<double>())
                     .cwiseMax(-0.25)
                     .cwiseMin(1.25);
    expressed = placed.vertices_mm;
    for (Eigen::Index e = 0; e < expression.size(); ++e) {
      expressed += static_cast<float>(expression[e]) * placed.expressions_mm[static_cast<std::size_t>(e)];
    }
    rig_from_rest = pose_of(expressed);
  }
  rest = (rig_from_rest.linear() * expressed).colwise() + rig_from_rest.translation();
}

/// Gradient of alpha E_r at the current displacements.
void TemplateFitter::Impl::add_smoothness(const mesh::Vertices& vertices_mm) {
  const mesh::OneRings& rings = surface->one_rings;
  offset = vertices_mm - rest;
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    Vector3f sum = Vector3f::Zero();
    for (auto e = rings.offsets[static_cast<std::size_t>(v)];
         e < rings.offsets[static_cast<std::size_t>(v) + 1]; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      sum += edge_weights[edge] * (offset.col(v) - offset.col(rings.neighbours[edge]));
    }
    gradient.col(v) += sum;
  }
}

/// Eq. 10 of one depth map: the residual along its z axis, w = confidence x max(0, normal . template normal).
void TemplateFitter::Impl::add_depth(const DepthMap& map, const mesh::Vertices& vertices_mm) {
  const Pinhole camera(map.lens);
  const auto sigma = static_cast<float>(options.sigma_s_mm);
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    if (surface->is_skin[vertex] == 0) {
      continue;
    }
    const auto pull = pull_of(map, camera, vertices_mm.col(v), normals.col(v), sigma);
    if (!pull || !(pull->weight > 0)) {
      continue;
    }
    const float weight = pull->weight;
    const float difference = pull->difference_mm;
    blocks[vertex].noalias() += weight * pull->jacobian * pull->jacobian.transpose();
    gradient.col(v) += weight * difference * pull->jacobian;
    depth_pull[vertex] += weight;
    surface_squares += static_cast<double>(weight * difference * difference);
    surface_weight += static_cast<double>(weight);
  }
}

/// beta times eq. 13 of one camera: where the vertex is seen to go against where the flow goes.
void TemplateFitter::Impl::add_motion(const FlowView& flow, const mesh::Vertices& before_mm,
                                      std::span<const std::uint8_t> seen, const mesh::Vertices& vertices_mm) {
  const auto sigma = static_cast<float>(options.sigma_m_px);
  const auto beta = static_cast<float>(options.beta);
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    if (surface->is_skin[vertex] == 0 || seen[vertex] == 0) {
      continue;
    }
    const auto from = flow.lens.project(before_mm.col(v).cast<double>());
    if (!from) {
      continue;
    }
    float confidence = 0;
    const auto moved = sample(flow, static_cast<float>(from->x()), static_cast<float>(from->y()), confidence);
    const auto now = moved ? project(flow.lens, vertices_mm.col(v)) : std::nullopt;
    if (!now) {
      continue;
    }
    const Vector2f difference = now->pixel - from->cast<float>() - *moved;
    const float robust = confidence * tukey_weight(difference.norm(), sigma);
    if (!(robust > 0)) {
      continue;
    }
    blocks[vertex].noalias() += beta * robust * now->derivative.transpose() * now->derivative;
    gradient.col(v) += beta * robust * now->derivative.transpose() * difference;
    flow_pull[vertex] += robust;
    motion_squares += static_cast<double>(robust * difference.squaredNorm());
    motion_weight += static_cast<double>(robust);
  }
}

/// out = (data blocks + alpha Laplacian) in.
void TemplateFitter::Impl::apply(const Matrix3Xf& in, Matrix3Xf& out) const {
  const mesh::OneRings& rings = surface->one_rings;
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    Vector3f sum = edge_sums[vertex] * in.col(v);
    for (auto e = rings.offsets[vertex]; e < rings.offsets[vertex + 1]; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      sum -= edge_weights[edge] * in.col(rings.neighbours[edge]);
    }
    out.col(v).noalias() = blocks[vertex] * in.col(v) + sum;
  }
}

/// step = -H^-1 gradient, by conjugate gradients with the diagonal's 3x3 blocks as preconditioner.
void TemplateFitter::Impl::conjugate_gradients() {
  const std::int32_t count = surface->vertex_count();
  const auto precondition = [&] {
    for (std::int32_t v = 0; v < count; ++v) {
      preconditioned.col(v).noalias() = inverse[static_cast<std::size_t>(v)] * residual.col(v);
    }
  };
  const auto dot = [](const Matrix3Xf& a, const Matrix3Xf& b) {
    return a.cwiseProduct(b).cast<double>().sum();
  };
  for (std::int32_t v = 0; v < count; ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    inverse[vertex] = (blocks[vertex] + edge_sums[vertex] * Matrix3f::Identity()).inverse();
  }
  step.setZero();
  residual = -gradient;
  precondition();
  direction = preconditioned;
  double energy = dot(residual, preconditioned);
  const double enough =
      energy * static_cast<double>(kResidualReduction) * static_cast<double>(kResidualReduction);
  for (int i = 0; i < options.cg_iterations && energy > enough; ++i) {
    apply(direction, product);
    const double curvature = dot(direction, product);
    if (!(curvature > 0)) {
      return;
    }
    const auto length = static_cast<float>(energy / curvature);
    step += length * direction;
    residual -= length * product;
    precondition();
    const double next = dot(residual, preconditioned);
    direction = preconditioned + static_cast<float>(next / energy) * direction;
    energy = next;
  }
}

FitReport TemplateFitter::Impl::solve(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                                      const mesh::Vertices* before_mm, mesh::Vertices& vertices_mm) {
  FitReport report;
  if (placed.vertices_mm.cols() != vertices_mm.cols()) {
    throw Error(ErrorKind::Usage, "the template fit has no rest shape yet, or other vertices");
  }
  std::fill(depth_pull.begin(), depth_pull.end(), 1.0F);  // nothing is known yet: all of it is brought along
  if (before_mm != nullptr) {
    mesh::vertex_normals(*before_mm, surface->triangles, normals);
    visible.resize(std::max(visible.size(), flows.size()));
    for (std::size_t k = 0; k < flows.size(); ++k) {
      find_visible(flows[k].lens, *before_mm, normals, surface->triangles, kVisibilityMarginMm, kRimPx,
                   visible[k]);
    }
  }
  double skin = 0;
  for (const std::uint8_t one : surface->is_skin) {
    skin += one;
  }
  const mesh::Vertices given = vertices_mm;
  for (report.steps = 0; report.steps < options.steps;) {
    bring_along(vertices_mm);
    mesh::vertex_normals(vertices_mm, surface->triangles, normals);
    std::fill(blocks.begin(), blocks.end(), Matrix3f::Zero());
    gradient.setZero();
    std::fill(depth_pull.begin(), depth_pull.end(), 0.0F);
    std::fill(flow_pull.begin(), flow_pull.end(), 0.0F);
    surface_squares = surface_weight = motion_squares = motion_weight = 0;
    for (const DepthMap& map : maps) {
      add_depth(map, vertices_mm);
    }
    for (std::size_t k = 0; before_mm != nullptr && k < flows.size(); ++k) {
      add_motion(flows[k], *before_mm, visible[k], vertices_mm);
    }
    const auto pulled = [&](const std::vector<float>& pull) {
      return static_cast<double>(std::count_if(pull.begin(), pull.end(), [](float one) { return one > 0; })) /
             std::max(skin, 1.0);
    };
    report.seen = pulled(depth_pull);
    report.followed = pulled(flow_pull);
    report.surface_rms_mm = surface_weight > 0 ? std::sqrt(surface_squares / surface_weight) : 0;
    report.motion_rms_px = motion_weight > 0 ? std::sqrt(motion_squares / motion_weight) : 0;
    if (report.seen < kLeastSeen && report.followed < kLeastSeen) {
      vertices_mm = given;
      report.outcome = FitOutcome::NoData;
      report.failure =
          fmt::format("only {:.1f} % of the template's skin lies on a depth map", 100 * report.seen);
      return report;
    }
    add_smoothness(vertices_mm);
    conjugate_gradients();
    ++report.steps;
    if (!step.allFinite()) {
      vertices_mm = given;
      report.outcome = FitOutcome::NumericalFailure;
      report.failure = fmt::format("step {} of the template fit is not finite", report.steps);
      return report;
    }
    vertices_mm += step;
    report.last_move_mm = static_cast<double>(step.colwise().norm().maxCoeff());
    if (report.last_move_mm < static_cast<double>(kSettledMm)) {
      report.outcome = FitOutcome::Converged;
      return report;
    }
  }
  report.outcome = FitOutcome::NotConverged;
  return report;
}

TemplateFitter::TemplateFitter(std::shared_ptr<const TemplateMesh> surface, const FitOptions& options)
    : impl_(std::make_unique<Impl>(std::move(surface), options)) {}
TemplateFitter::~TemplateFitter() = default;

void TemplateFitter::set_rest(RestShape rest) {
  impl_->set_rest(std::move(rest));
}

FitReport TemplateFitter::fit(std::span<const DepthMap> maps, mesh::Vertices& vertices_mm) {
  return impl_->solve(maps, {}, nullptr, vertices_mm);
}

FitReport TemplateFitter::track(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                                const mesh::Vertices& before_mm, mesh::Vertices& vertices_mm) {
  return impl_->solve(maps, flows, &before_mm, vertices_mm);
}

const Eigen::VectorXd& TemplateFitter::expression() const {
  return impl_->expression;
}

const std::vector<float>& TemplateFitter::depth_weight() const {
  return impl_->depth_pull;
}

}  // namespace facet::fit
