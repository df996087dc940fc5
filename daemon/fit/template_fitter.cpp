#include "fit/template_fitter.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "facet/error.hpp"
#include "fit/conjugate_gradients.hpp"
#include "fit/depth_pull.hpp"
#include "fit/visibility.hpp"
#include "maths/solve.hpp"

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
constexpr float kVisibilityMarginMm = 4;
constexpr float kOffMm = 5;          ///< from a map's surface: not that surface
constexpr float kTurnedAway = 0.3F;  ///< cosine; a surface seen more steeply tells nothing of that
constexpr double kLostSeen = 0.25;
constexpr double kLostRejected = 0.45;
constexpr double kLostSurfaceMm = 2.5;
constexpr double kLostTrust = 0.3;
constexpr float kVelocityGain = 0.3F;     ///< how much of a vertex's last move its velocity takes over
constexpr double kModelChange = 0.3;      ///< of an expression's weight from one mesh to the next, typically
constexpr double kModelSettledMm = 0.02;  ///< the model's steps end there
constexpr float kLinkSlackMm = 2;         ///< beyond the nearest
constexpr float kLeastUpright = 0.1F;     ///< cosine between a triangle's normal and its vertices'
constexpr int kUnfoldRounds = 12;
constexpr int kUnfoldSweeps = 6;
constexpr int kMostUnfoldRings = 5;  ///< around what stays folded with the rings inside it free
constexpr double kPatches = 100;
constexpr double kLeastExpression = -0.25;
constexpr double kMostExpression = 1.25;
constexpr double kExpressionMisfitMm = 0.5;  ///< what expressions do not explain, typically
constexpr float kRimPx = 5;                  ///< half of a flow's patch and a little
constexpr float kTieAcross = 0.02F;          ///< of a tie along the surface, which weighs 1
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

struct TemplateFitter::Impl {
  Impl(std::shared_ptr<const TemplateMesh> with, const FitOptions& how)
      : surface(std::move(with)), options(how) {
    if (!(options.alpha > 0) || !(options.beta >= 0) || !(options.sigma_s_mm > 0) ||
        !(options.placing_sigma_s_mm > 0) || !(options.sigma_m_px > 0) || !(options.gamma >= 0) ||
        !(options.sigma_t_mm > 0) || options.steps < 1 || options.cg_iterations < 1) {
      throw Error(ErrorKind::Usage,
                  "the options of the template fit make no sense: alpha, sigmas and counts are above 0, beta "
                  "not below");
    }
    const auto count = static_cast<std::size_t>(surface->vertex_count());
    blocks.resize(count);
    inverse.resize(count);
    for (Matrix3Xf* field : {&gradient, &step, &normals, &offset}) {
      field->setZero(3, surface->vertex_count());
    }
    skin = static_cast<double>(std::count(surface->is_skin.begin(), surface->is_skin.end(), std::uint8_t{1}));
    depth_pull.resize(count);
    on_map.resize(count);
    off_map.resize(count);
    flow_pull.resize(count);
    hang_together();
    edge_weights.resize(neighbours.size());
  }

  TemplateFitOutcome move(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                          const mesh::Vertices* before_mm, mesh::Vertices& vertices_mm,
                          TemplateFitReport& report);
  TemplateFitReport solve(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                          const mesh::Vertices* before_mm, mesh::Vertices& vertices_mm);
  TemplateFitReport settle(std::span<const DepthMap> maps, const mesh::Vertices& expected_mm,
                           mesh::Vertices& vertices_mm);
  bool take_step(mesh::Vertices& vertices_mm, TemplateFitReport& report);
  void set_rest(RestShape shape);
  void hang_together();
  void bring_along(const mesh::Vertices& vertices_mm);
  void add_expectation(const mesh::Vertices& vertices_mm);
  void add_ties(const mesh::Vertices& vertices_mm);
  void judge(TemplateFitReport& report, bool with_flow) const;
  void look_at_mouth(const mesh::Vertices& vertices_mm, TemplateFitReport& report) const;
  void remember(const mesh::Vertices& vertices_mm);
  bool add_data(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                const mesh::Vertices* before_mm, const mesh::Vertices& vertices_mm,
                TemplateFitReport& report);
  double model_step(mesh::Vertices& vertices_mm);
  void weigh_edges();
  Eigen::Isometry3f pose_of(const mesh::Vertices& shape, const mesh::Vertices& vertices_mm) const;
  int unfold(mesh::Vertices& vertices_mm, const mesh::Vertices* shape);
  void add_smoothness(const mesh::Vertices& vertices_mm);
  void add_depth(const DepthMap& map, const mesh::Vertices& vertices_mm);
  void add_motion(const FlowView& flow, const mesh::Vertices& before_mm,
                  std::span<const std::uint8_t> visible, const mesh::Vertices& vertices_mm);
  void apply(const Matrix3Xf& in, Matrix3Xf& out) const;
  void solve_step();

  Eigen::Isometry3f rig_from_rest = Eigen::Isometry3f::Identity();  ///< of the rest shape placed
  std::shared_ptr<const TemplateMesh> surface;
  FitOptions options;
  double sigma_s_mm = 0;        ///< of the call
  RestShape placed;             ///< as it was set
  Eigen::MatrixXf expressions;  ///< [3 * vertex_count][expression_count] of placed; 0 off the skin
  Eigen::LLT<Eigen::MatrixXd> expression_normals;
  Eigen::VectorXd expression;            ///< [expression_count]
  Eigen::VectorXf misfit;                ///< [3 * vertex_count]
  mesh::Vertices expressed;              ///< placed, with the expression
  mesh::Vertices rest;                   ///< the template, turned with the head
  Eigen::MatrixXf model, pulled_model;   ///< [3 * pulled vertices][6 + expression_count]
  std::vector<std::int32_t> offsets;     ///< [vertex_count + 1] into neighbours
  std::vector<std::int32_t> neighbours;  ///< the one-rings' and what a loose piece hangs on
  std::vector<float> edge_weights;       ///< [neighbours] alpha / ||s_n1 - s_n2||^2
  std::vector<float> edge_sums;          ///< [vertex_count]
  std::vector<Matrix3f> blocks;          ///< [vertex_count] data terms' part of the normal equations
  std::vector<Matrix3f> inverse;         ///< of the diagonal blocks, the preconditioner
  Matrix3Xf gradient, step, normals, offset;
  GradientsMemory<Matrix3Xf> memory;
  std::vector<float> depth_pull, flow_pull;
  std::vector<std::vector<std::uint8_t>> visible;
  double skin = 0;                            ///< vertices of it
  mesh::Vertices last_mm, velocity_mm;        ///< of the slots before; no columns: nothing is expected
  std::vector<std::uint8_t> on_map, off_map;  ///< [vertex_count]
  double flow_trust = 0, flow_count = 0;
  double surface_squares = 0, surface_weight = 0, motion_squares = 0, motion_weight = 0;
};

/// The edges of E_r. Pieces of the mesh without skin (eyeballs) have no data and no edge to where there are:
/// their vertices are joined to the nearest ones of the rest, so that they go where the skin around them
/// goes.
void TemplateFitter::Impl::hang_together() {
  const mesh::OneRings& rings = surface->one_rings;
  const std::int32_t count = surface->vertex_count();
  std::vector<std::vector<std::int32_t>> joined(static_cast<std::size_t>(count));
  std::vector<std::int32_t> piece_of(static_cast<std::size_t>(count), -1);
  std::vector<std::vector<std::int32_t>> loose;
  for (std::int32_t first = 0; first < count; ++first) {
    if (piece_of[static_cast<std::size_t>(first)] >= 0) {
      continue;
    }
    std::vector<std::int32_t> piece = {first};
    piece_of[static_cast<std::size_t>(first)] = first;
    bool has_skin = false;
    for (std::size_t i = 0; i < piece.size(); ++i) {
      const auto vertex = static_cast<std::size_t>(piece[i]);
      has_skin = has_skin || surface->is_skin[vertex] != 0;
      for (auto e = rings.offsets[vertex]; e < rings.offsets[vertex + 1]; ++e) {
        const std::int32_t other = rings.neighbours[static_cast<std::size_t>(e)];
        if (piece_of[static_cast<std::size_t>(other)] < 0) {
          piece_of[static_cast<std::size_t>(other)] = first;
          piece.push_back(other);
        }
      }
    }
    if (!has_skin) {
      loose.push_back(std::move(piece));
    }
  }
  for (const std::vector<std::int32_t>& piece : loose) {
    std::vector<std::pair<float, std::int32_t>> nearest;
    for (const std::int32_t v : piece) {
      std::pair<float, std::int32_t> best{std::numeric_limits<float>::infinity(), -1};
      for (std::int32_t other = 0; other < count; ++other) {
        if (piece_of[static_cast<std::size_t>(other)] != piece_of[static_cast<std::size_t>(v)]) {
          best =
              std::min(best, {(surface->neutral_mm.col(v) - surface->neutral_mm.col(other)).norm(), other});
        }
      }
      nearest.push_back(best);
    }
    const float least = std::min_element(nearest.begin(), nearest.end())->first;
    for (std::size_t i = 0; i < piece.size(); ++i) {
      if (nearest[i].second >= 0 && nearest[i].first <= least + kLinkSlackMm) {
        joined[static_cast<std::size_t>(piece[i])].push_back(nearest[i].second);
        joined[static_cast<std::size_t>(nearest[i].second)].push_back(piece[i]);
      }
    }
  }
  offsets.assign(1, 0);
  for (std::size_t v = 0; v < joined.size(); ++v) {
    neighbours.insert(neighbours.end(), rings.neighbours.begin() + rings.offsets[v],
                      rings.neighbours.begin() + rings.offsets[v + 1]);
    neighbours.insert(neighbours.end(), joined[v].begin(), joined[v].end());
    offsets.push_back(static_cast<std::int32_t>(neighbours.size()));
  }
}

/// [SF04 eq. 11]: 1 / ||s_n1 - s_n2||^2 of every edge, times alpha; and the normal equations of the
/// expressions. Of E_r, by the lengths that the edges have in the placed shape.
void TemplateFitter::Impl::weigh_edges() {
  edge_sums.assign(static_cast<std::size_t>(surface->vertex_count()), 0);
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    for (auto e = offsets[static_cast<std::size_t>(v)]; e < offsets[static_cast<std::size_t>(v) + 1]; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      const float length2 =
          (placed.vertices_mm.col(v) - placed.vertices_mm.col(neighbours[edge])).squaredNorm();
      edge_weights[edge] = static_cast<float>(options.alpha) / std::max(length2, 1e-2F);
      edge_sums[static_cast<std::size_t>(v)] += edge_weights[edge];
    }
  }
}

/// Where a shape comes closest to a mesh, judged by the skin that depth maps pull.
Eigen::Isometry3f TemplateFitter::Impl::pose_of(const mesh::Vertices& shape,
                                                const mesh::Vertices& vertices_mm) const {
  Eigen::VectorXd weights(vertices_mm.cols());
  for (Eigen::Index v = 0; v < weights.size(); ++v) {
    weights[v] = depth_pull[static_cast<std::size_t>(v)] > 0 ? 1 : 1e-6;
  }
  return Eigen::Isometry3f(
      align_rigidly(shape.cast<double>(), vertices_mm.cast<double>(), weights).cast<float>());
}

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
  last_mm.resize(3, 0);
  weigh_edges();
  // Landmarks and depth may have turned lids and corners of the mouth over.
  if (options.unfolds) {
    unfold(placed.vertices_mm, &surface->neutral_mm);
    weigh_edges();
  }
  expressed = placed.vertices_mm;
  const auto known = options.knows_expressions ? static_cast<Eigen::Index>(placed.expressions_mm.size()) : 0;
  expression.setZero(known);
  expressions.resize(3 * static_cast<Eigen::Index>(count), known);
  if (known == 0) {
    return;
  }
  misfit.resize(expressions.rows());
  for (std::int32_t v = 0; v < count; ++v) {
    const bool counts = surface->is_skin[static_cast<std::size_t>(v)] != 0;
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
    rig_from_rest.setIdentity();
    return;
  }
  rig_from_rest = pose_of(expressed, vertices_mm);
  if (expression.size() > 0) {
    const Eigen::Isometry3f rest_from_rig = rig_from_rest.inverse();
    Eigen::Map<Matrix3Xf>(misfit.data(), 3, vertices_mm.cols()) =
        ((rest_from_rig.linear() * vertices_mm).colwise() + rest_from_rig.translation()) - placed.vertices_mm;
    expression = expression_normals.solve((expressions.transpose() * misfit).cast<double>())
                     .cwiseMax(kLeastExpression)
                     .cwiseMin(kMostExpression);
    expressed = placed.vertices_mm;
    for (Eigen::Index e = 0; e < expression.size(); ++e) {
      expressed += static_cast<float>(expression[e]) * placed.expressions_mm[static_cast<std::size_t>(e)];
    }
    rig_from_rest = pose_of(expressed, vertices_mm);
  }
  rest = (rig_from_rest.linear() * expressed).colwise() + rig_from_rest.translation();
}

/// Gradient of alpha E_r at the current displacements.
void TemplateFitter::Impl::add_smoothness(const mesh::Vertices& vertices_mm) {
  offset = vertices_mm - rest;
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    Vector3f sum = Vector3f::Zero();
    for (auto e = offsets[static_cast<std::size_t>(v)]; e < offsets[static_cast<std::size_t>(v) + 1]; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      sum += edge_weights[edge] * (offset.col(v) - offset.col(neighbours[edge]));
    }
    gradient.col(v) += sum;
  }
}

/// [SF04 eq. 10] of one depth map: the residual along its z axis, w = confidence x max(0, n . template n).
void TemplateFitter::Impl::add_depth(const DepthMap& map, const mesh::Vertices& vertices_mm) {
  const Pinhole camera(map.lens);
  const auto sigma = static_cast<float>(sigma_s_mm);
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    if (surface->is_skin[vertex] == 0) {
      continue;
    }
    const auto pull = pull_of(map, camera, vertices_mm.col(v), normals.col(v), sigma);
    if (pull && pull->facing > kTurnedAway && pull->alike > kTurnedAway) {
      on_map[vertex] = 1;
      off_map[vertex] |= static_cast<std::uint8_t>(std::abs(pull->difference_mm) * pull->facing > kOffMm);
    }
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

/// beta times [SF04 eq. 13] of one camera: where the vertex is seen to go against where the flow goes.
void TemplateFitter::Impl::add_motion(const FlowView& flow, const mesh::Vertices& before_mm,
                                      std::span<const std::uint8_t> seen, const mesh::Vertices& vertices_mm) {
  const auto sigma = flow.sigma_px > 0 ? flow.sigma_px : static_cast<float>(options.sigma_m_px);
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
    flow_count += 1;
    const auto moved = sample(flow, static_cast<float>(from->x()), static_cast<float>(from->y()), confidence);
    flow_trust += static_cast<double>(moved ? confidence : 0);
    const auto now = moved ? project(flow.lens, vertices_mm.col(v)) : std::nullopt;
    if (!now) {
      continue;
    }
    const Vector2f difference = now->pixel - from->cast<float>() - *moved;
    const float robust = confidence * confidence * tukey_weight(difference.norm(), sigma);
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

/// gamma sum over vertices of rho(||v - (last + velocity)||, sigma_t): quiet where data are weak or noisy.
void TemplateFitter::Impl::add_expectation(const mesh::Vertices& vertices_mm) {
  const auto gamma = static_cast<float>(options.gamma);
  const auto sigma = static_cast<float>(options.sigma_t_mm);
  for (Eigen::Index v = 0; v < last_mm.cols(); ++v) {
    const Vector3f difference = vertices_mm.col(v) - last_mm.col(v) - velocity_mm.col(v);
    const float weight = gamma * tukey_weight(difference.norm(), sigma);
    blocks[static_cast<std::size_t>(v)].diagonal().array() += weight;
    gradient.col(v) += weight * difference;
  }
}

void TemplateFitter::Impl::remember(const mesh::Vertices& vertices_mm) {
  if (vertices_mm.cols() != surface->vertex_count()) {
    throw Error(ErrorKind::Usage,
                fmt::format("a mesh of {} vertices is no result of the template fit", vertices_mm.cols()));
  }
  if (last_mm.cols() == 0) {
    velocity_mm = mesh::Vertices::Zero(3, vertices_mm.cols());
  } else {
    velocity_mm += kVelocityGain * (vertices_mm - last_mm - velocity_mm);
  }
  last_mm = vertices_mm;
}

/// Thresholds lie well off what a followed face shows: rejected below 0.32 (what others hide lies behind
/// them), seen 0.72 to 0.85, trust above 0.74. The rms tells of a template that was just placed alone: depth
/// pulls within 4 mm afterwards.
void TemplateFitter::Impl::judge(TemplateFitReport& report, bool with_flow) const {
  if (report.rejected > kLostRejected) {
    report.lost_because = fmt::format("{:.0f} % of the skin lies more than {} mm off the depth maps",
                                      100 * report.rejected, kOffMm);
  } else if (report.seen < kLostSeen) {
    report.lost_because = fmt::format("only {:.0f} % of the skin lies on a depth map", 100 * report.seen);
  } else if (report.surface_rms_mm > kLostSurfaceMm) {
    report.lost_because = fmt::format("the skin lies {:.1f} mm off the depth maps", report.surface_rms_mm);
  } else if (with_flow && report.flow_trust < kLostTrust) {
    report.lost_because = fmt::format("the flow comes back to where it began on {:.0f} % of the skin only",
                                      100 * report.flow_trust);
  }
  report.lost = !report.lost_because.empty();
}

/// out = (data blocks + alpha Laplacian) in.
void TemplateFitter::Impl::apply(const Matrix3Xf& in, Matrix3Xf& out) const {
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    Vector3f sum = edge_sums[vertex] * in.col(v);
    for (auto e = offsets[vertex]; e < offsets[vertex + 1]; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      sum -= edge_weights[edge] * in.col(neighbours[edge]);
    }
    out.col(v).noalias() = blocks[vertex] * in.col(v) + sum;
  }
}

/// step = -H^-1 gradient, with the diagonal's 3x3 blocks as preconditioner.
void TemplateFitter::Impl::solve_step() {
  const std::int32_t count = surface->vertex_count();
  for (std::int32_t v = 0; v < count; ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    inverse[vertex] = (blocks[vertex] + edge_sums[vertex] * Matrix3f::Identity()).inverse();
  }
  conjugate_gradients(
      gradient, options.cg_iterations, kResidualReduction,
      [this](const Matrix3Xf& in, Matrix3Xf& out) { apply(in, out); },
      [&](const Matrix3Xf& in, Matrix3Xf& out) {
        for (std::int32_t v = 0; v < count; ++v) {
          out.col(v).noalias() = inverse[static_cast<std::size_t>(v)] * in.col(v);
        }
      },
      memory, step);
}

/// Pose and expressions alone. Returns NoData or NumericalFailure where it can't be, NotConverged where it is
/// done: the vertices are free to go their own ways.
TemplateFitOutcome TemplateFitter::Impl::move(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                                              const mesh::Vertices* before_mm, mesh::Vertices& vertices_mm,
                                              TemplateFitReport& report) {
  if (placed.vertices_mm.cols() != vertices_mm.cols()) {
    throw Error(ErrorKind::Usage, "the template fit has no rest shape yet, or other vertices");
  }
  std::fill(depth_pull.begin(), depth_pull.end(), 1.0F);  // nothing is known yet: all of it is brought along
  if (before_mm != nullptr) {
    visible.resize(std::max(visible.size(), flows.size()));
    for (std::size_t k = 0; k < flows.size(); ++k) {
      const mesh::Vertices& from_mm = flows[k].from_mm != nullptr ? *flows[k].from_mm : *before_mm;
      if (from_mm.cols() != vertices_mm.cols()) {
        throw Error(ErrorKind::Usage, "a flow of the template fit leads away from a mesh of other vertices");
      }
      mesh::vertex_normals(from_mm, surface->triangles, normals);
      find_visible(flows[k].lens, from_mm, normals, surface->triangles, kVisibilityMarginMm, kRimPx,
                   visible[k]);
    }
  }
  bring_along(vertices_mm);
  for (int i = 0; i < (options.turns_with_the_head ? options.model_steps : 0); ++i) {
    if (!add_data(maps, flows, before_mm, vertices_mm, report)) {
      return TemplateFitOutcome::NoData;
    }
    const double moved = model_step(vertices_mm);
    if (!std::isfinite(moved)) {
      return TemplateFitOutcome::NumericalFailure;
    }
    if (moved < kModelSettledMm) {
      break;
    }
  }
  return TemplateFitOutcome::NotConverged;
}

TemplateFitReport TemplateFitter::Impl::solve(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                                              const mesh::Vertices* before_mm, mesh::Vertices& vertices_mm) {
  TemplateFitReport report;
  const mesh::Vertices given = vertices_mm;
  const auto give_up = [&](TemplateFitOutcome outcome, std::string failure) {
    vertices_mm = given;
    report.outcome = outcome;
    report.lost = true;
    report.lost_because = failure;
    report.failure = std::move(failure);
    return report;
  };
  const auto no_data = [&] {
    return give_up(
        TemplateFitOutcome::NoData,
        report.rejected > kLostRejected
            ? fmt::format("{:.0f} % of the skin lies more than {} mm off the depth maps",
                          100 * report.rejected, kOffMm)
            : fmt::format("only {:.1f} % of the template's skin lies on a depth map", 100 * report.seen));
  };
  report.outcome = move(maps, flows, before_mm, vertices_mm, report);
  if (report.outcome == TemplateFitOutcome::NoData) {
    return no_data();
  }
  if (report.outcome == TemplateFitOutcome::NumericalFailure) {
    return give_up(report.outcome, "the model's step of the template fit is not finite");
  }
  while (report.steps < options.steps && report.outcome != TemplateFitOutcome::Converged) {
    bring_along(vertices_mm);
    if (!add_data(maps, flows, before_mm, vertices_mm, report)) {
      return no_data();
    }
    add_expectation(vertices_mm);
    add_smoothness(vertices_mm);
    if (!take_step(vertices_mm, report)) {
      return give_up(TemplateFitOutcome::NumericalFailure,
                     fmt::format("step {} of the template fit is not finite", report.steps));
    }
  }
  bring_along(vertices_mm);
  double squares = 0;
  double count = 0;
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    if (depth_pull[static_cast<std::size_t>(v)] > 0) {
      squares += static_cast<double>((vertices_mm.col(v) - rest.col(v)).squaredNorm());
      ++count;
    }
  }
  report.shape_rms_mm = std::sqrt(squares / std::max(count, 1.0));
  if (options.unfolds) {
    report.unfolded = unfold(vertices_mm, &expressed);
    // The rest shape with its expression may be folded itself; the model's face is not.
    report.unfolded += unfold(vertices_mm, &surface->neutral_mm);
    report.unfolded += unfold(vertices_mm, nullptr);
  }
  look_at_mouth(vertices_mm, report);
  judge(report, before_mm != nullptr && !flows.empty());
  return report;
}

void TemplateFitter::Impl::look_at_mouth(const mesh::Vertices& vertices_mm, TemplateFitReport& report) const {
  constexpr float kLeastEdge_mm = 0.1F;
  double squares = 0;
  double edges = 0;
  double seen = 0;
  double off = 0;
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    if (surface->is_mouth.empty() || surface->is_mouth[vertex] == 0) {
      continue;
    }
    seen += on_map[vertex];
    off += off_map[vertex];
    const mesh::OneRings& rings = surface->one_rings;
    for (auto e = rings.offsets[vertex]; e < rings.offsets[vertex + 1]; ++e) {
      const std::int32_t other = rings.neighbours[static_cast<std::size_t>(e)];
      const Vector3f expected = rest.col(v) - rest.col(other);
      const Vector3f bent = vertices_mm.col(v) - vertices_mm.col(other) - expected;
      squares += static_cast<double>(bent.squaredNorm() /
                                     std::max(expected.squaredNorm(), kLeastEdge_mm * kLeastEdge_mm));
      ++edges;
    }
  }
  report.mouth_bend = std::sqrt(squares / std::max(edges, 1.0));
  report.mouth_off = off / std::max(seen, 1.0);
}

/// The Gauss-Newton step of the normal equations as they stand; false where it is not finite.
bool TemplateFitter::Impl::take_step(mesh::Vertices& vertices_mm, TemplateFitReport& report) {
  solve_step();
  ++report.steps;
  if (!step.allFinite()) {
    return false;
  }
  vertices_mm += step;
  report.last_move_mm = static_cast<double>(step.colwise().norm().maxCoeff());
  if (report.last_move_mm < static_cast<double>(kSettledMm)) {
    report.outcome = TemplateFitOutcome::Converged;
  }
  return true;
}

TemplateFitReport TemplateFitter::Impl::settle(std::span<const DepthMap> maps,
                                               const mesh::Vertices& expected_mm,
                                               mesh::Vertices& vertices_mm) {
  if (placed.vertices_mm.cols() != expected_mm.cols()) {
    throw Error(ErrorKind::Usage, "the template fit has no rest shape yet, or other vertices");
  }
  TemplateFitReport report;
  rest = expected_mm;
  vertices_mm = expected_mm;
  while (report.steps < options.steps && report.outcome != TemplateFitOutcome::Converged) {
    const bool seen = add_data(maps, {}, nullptr, vertices_mm, report);
    add_ties(vertices_mm);
    add_smoothness(vertices_mm);
    if (!seen || !take_step(vertices_mm, report)) {
      vertices_mm = expected_mm;
      report.outcome = seen ? TemplateFitOutcome::NumericalFailure : TemplateFitOutcome::NoData;
      report.lost = true;
      report.failure =
          seen ? fmt::format("step {} of the template fit is not finite", report.steps)
               : fmt::format("only {:.1f} % of the template's skin lies on a depth map", 100 * report.seen);
      report.lost_because = report.failure;
      return report;
    }
  }
  if (options.unfolds) {
    report.unfolded = unfold(vertices_mm, &expected_mm);
  }
  judge(report, false);
  return report;
}

/// Sum over vertices of ||v - s||^2, s the mesh that is expected: fully along its surface, hardly across.
void TemplateFitter::Impl::add_ties(const mesh::Vertices& vertices_mm) {
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    const Vector3f normal = normals.col(v);
    const Matrix3f tie = Matrix3f::Identity() - (1 - kTieAcross) * normal * normal.transpose();
    blocks[static_cast<std::size_t>(v)] += tie;
    gradient.col(v) += tie * (vertices_mm.col(v) - rest.col(v));
  }
}

/// Normal equations of the data terms at the vertices as they are; false where hardly any of them sees
/// anything.
bool TemplateFitter::Impl::add_data(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                                    const mesh::Vertices* before_mm, const mesh::Vertices& vertices_mm,
                                    TemplateFitReport& report) {
  mesh::vertex_normals(vertices_mm, surface->triangles, normals);
  std::fill(blocks.begin(), blocks.end(), Matrix3f::Zero());
  gradient.setZero();
  std::fill(depth_pull.begin(), depth_pull.end(), 0.0F);
  std::fill(flow_pull.begin(), flow_pull.end(), 0.0F);
  surface_squares = surface_weight = motion_squares = motion_weight = flow_trust = flow_count = 0;
  std::fill(on_map.begin(), on_map.end(), std::uint8_t{0});
  std::fill(off_map.begin(), off_map.end(), std::uint8_t{0});
  for (const DepthMap& map : maps) {
    add_depth(map, vertices_mm);
  }
  for (std::size_t k = 0; before_mm != nullptr && k < flows.size(); ++k) {
    add_motion(flows[k], flows[k].from_mm != nullptr ? *flows[k].from_mm : *before_mm, visible[k],
               vertices_mm);
  }
  const auto pulled = [&](const std::vector<float>& pull) {
    return static_cast<double>(std::count_if(pull.begin(), pull.end(), [](float one) { return one > 0; })) /
           std::max(skin, 1.0);
  };
  report.seen = pulled(depth_pull);
  report.followed = pulled(flow_pull);
  report.surface_rms_mm = surface_weight > 0 ? std::sqrt(surface_squares / surface_weight) : 0;
  report.motion_rms_px = motion_weight > 0 ? std::sqrt(motion_squares / motion_weight) : 0;
  report.rejected =
      static_cast<double>(std::count(off_map.begin(), off_map.end(), std::uint8_t{1})) /
      std::max(static_cast<double>(std::count(on_map.begin(), on_map.end(), std::uint8_t{1})), 1.0);
  report.flow_trust = flow_trust / std::max(flow_count, 1.0);
  return report.seen >= kLeastSeen || report.followed >= kLeastSeen;
}

/// One Gauss-Newton step of the data terms over the pose and the expressions' weights alone: what moves fast
/// and together (the head, the jaw) is in place before each vertex goes its own way, which it does only over
/// the few edges that a conjugate gradient step carries it. The weights' changes are small and few (a prior
/// of kModelChange, and as much again of the absolute value by its quadratic bound). Returns the largest move
/// of a vertex, mm.
double TemplateFitter::Impl::model_step(mesh::Vertices& vertices_mm) {
  const Eigen::Index known = expression.size();
  const Eigen::Index unknowns = 6 + known;
  std::vector<std::int32_t> pulled;
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    if (depth_pull[static_cast<std::size_t>(v)] > 0 || flow_pull[static_cast<std::size_t>(v)] > 0) {
      pulled.push_back(v);
    }
  }
  const auto rows = 3 * static_cast<Eigen::Index>(pulled.size());
  model.resize(rows, unknowns);
  pulled_model.resize(rows, unknowns);
  const Vector3f middle = vertices_mm.rowwise().mean();
  const Matrix3f turned = rig_from_rest.linear();
  Eigen::VectorXf slope = Eigen::VectorXf::Zero(unknowns);
  for (std::size_t i = 0; i < pulled.size(); ++i) {
    const std::int32_t v = pulled[i];
    const auto row = 3 * static_cast<Eigen::Index>(i);
    const Vector3f arm = vertices_mm.col(v) - middle;
    auto own = model.middleRows<3>(row);
    own.leftCols<3>() << 0, arm.z(), -arm.y(), -arm.z(), 0, arm.x(), arm.y(), -arm.x(), 0;
    own.middleCols<3>(3).setIdentity();
    if (known > 0) {
      own.rightCols(known).noalias() = turned * expressions.middleRows<3>(Eigen::Index{3} * v);
    }
    pulled_model.middleRows<3>(row).noalias() = blocks[static_cast<std::size_t>(v)] * own;
    slope.noalias() += own.transpose() * gradient.col(v);
  }
  Eigen::MatrixXd matrix = (model.transpose() * pulled_model).cast<double>();
  const double firmness = static_cast<double>(pulled.size()) / kPatches * kExpressionMisfitMm *
                          kExpressionMisfitMm / (kModelChange * kModelChange);
  matrix.diagonal().head(3).array() += 1e-3;
  matrix.diagonal().tail(known).array() += firmness;
  const auto solve = [&] { return Eigen::VectorXd(-maths::solve_symmetric(matrix, slope.cast<double>())); };
  Eigen::VectorXd change = solve();
  // |x| <= x^2 / (2 |x0|) + |x0| / 2: few large changes rather than many small ones.
  for (Eigen::Index e = 0; e < known; ++e) {
    matrix(6 + e, 6 + e) += firmness * kModelChange / std::max(std::abs(change[6 + e]), 0.02);
  }
  change = solve();
  for (Eigen::Index e = 0; e < known; ++e) {
    change[6 + e] =
        std::clamp(expression[e] + change[6 + e], kLeastExpression, kMostExpression) - expression[e];
  }
  const Eigen::VectorXf by = change.cast<float>();
  if (!by.allFinite()) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  offset.setZero();
  for (Eigen::Index e = 0; e < known; ++e) {
    offset += by[6 + e] * placed.expressions_mm[static_cast<std::size_t>(e)];
  }
  const float angle = by.head<3>().norm();
  const Matrix3f turn = angle > 0 ? Eigen::AngleAxisf(angle, by.head<3>() / angle).toRotationMatrix()
                                  : Matrix3f(Matrix3f::Identity());
  offset = ((turn * ((vertices_mm + turned * offset).colwise() - middle)).colwise() +
            (middle + by.segment<3>(3))) -
           vertices_mm;
  vertices_mm += offset;
  expression += change.tail(known);
  return static_cast<double>(offset.colwise().norm().maxCoeff());
}

/// Data that turn a triangle over are wrong there (the rim of a lid, what shows between the lips): E_r
/// against a shape, brought to the mesh's pose, alone decides where its vertices are, and those around them
/// where that is not enough. Without a shape: a membrane between the vertices around them. Returns how many
/// vertices.
int TemplateFitter::Impl::unfold(mesh::Vertices& vertices_mm, const mesh::Vertices* shape) {
  const mesh::Triangles& triangles = surface->triangles;
  Matrix3f turn = Matrix3f::Identity();
  if (shape != nullptr) {
    turn = pose_of(*shape, vertices_mm).linear();
  }
  std::vector<std::uint8_t> is_free(static_cast<std::size_t>(surface->vertex_count()), 0);
  std::vector<std::int32_t> freed;
  const auto set_free = [&](std::int32_t v, int rings, const auto& around) -> void {
    if (is_free[static_cast<std::size_t>(v)] == 0) {
      is_free[static_cast<std::size_t>(v)] = 1;
      freed.push_back(v);
    }
    for (auto e = offsets[static_cast<std::size_t>(v)];
         rings > 0 && e < offsets[static_cast<std::size_t>(v) + 1]; ++e) {
      around(neighbours[static_cast<std::size_t>(e)], rings - 1, around);
    }
  };
  // A membrane takes detail away: only where nothing else helps, and over as many rings as that takes.
  const float least_upright = shape != nullptr ? kLeastUpright : 0;
  std::vector<std::int32_t> corners;  // of what is folded
  int rings = 1;
  for (int round = 0; round < kUnfoldRounds; ++round) {
    mesh::vertex_normals(vertices_mm, triangles, normals);
    corners.clear();
    for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
      const auto corner = triangles.col(t);
      const Vector3f across = (vertices_mm.col(corner[1]) - vertices_mm.col(corner[0]))
                                  .cross(vertices_mm.col(corner[2]) - vertices_mm.col(corner[0]));
      const Vector3f outwards = normals.col(corner[0]) + normals.col(corner[1]) + normals.col(corner[2]);
      if (across.dot(outwards) <= least_upright * across.norm() * outwards.norm()) {
        corners.insert(corners.end(), {corner[0], corner[1], corner[2]});
      }
    }
    if (corners.empty()) {
      break;
    }
    const std::size_t free_before = freed.size();
    for (const std::int32_t v : corners) {
      set_free(v, is_free[static_cast<std::size_t>(v)] == 0 ? 0 : 1, set_free);
    }
    if (shape == nullptr && freed.size() == free_before && rings < kMostUnfoldRings) {
      ++rings;
      std::sort(corners.begin(), corners.end());
      corners.erase(std::unique(corners.begin(), corners.end()), corners.end());
      for (const std::int32_t v : corners) {
        set_free(v, rings, set_free);
      }
    }
    for (int sweep = 0; sweep < kUnfoldSweeps; ++sweep) {
      for (const std::int32_t v : freed) {
        Vector3f sum = Vector3f::Zero();
        for (auto e = offsets[static_cast<std::size_t>(v)]; e < offsets[static_cast<std::size_t>(v) + 1];
             ++e) {
          const auto edge = static_cast<std::size_t>(e);
          sum += edge_weights[edge] * vertices_mm.col(neighbours[edge]);
          if (shape != nullptr) {
            sum += edge_weights[edge] * (turn * (shape->col(v) - shape->col(neighbours[edge])));
          }
        }
        vertices_mm.col(v) = sum / edge_sums[static_cast<std::size_t>(v)];
      }
    }
  }
  return static_cast<int>(freed.size());
}

TemplateFitter::TemplateFitter(std::shared_ptr<const TemplateMesh> surface, const FitOptions& options)
    : impl_(std::make_unique<Impl>(std::move(surface), options)) {}
TemplateFitter::~TemplateFitter() = default;

void TemplateFitter::set_rest(RestShape rest) {
  impl_->set_rest(std::move(rest));
}

TemplateFitReport TemplateFitter::fit(std::span<const DepthMap> maps, mesh::Vertices& vertices_mm) {
  const mesh::Vertices given = vertices_mm;
  impl_->sigma_s_mm = impl_->options.placing_sigma_s_mm;
  TemplateFitReport placed = impl_->solve(maps, {}, nullptr, vertices_mm);
  if (placed.lost) {
    return placed;
  }
  impl_->sigma_s_mm = impl_->options.sigma_s_mm;
  TemplateFitReport report = impl_->solve(maps, {}, nullptr, vertices_mm);
  if (report.outcome == TemplateFitOutcome::NoData ||
      report.outcome == TemplateFitOutcome::NumericalFailure) {
    vertices_mm = given;
  }
  report.steps += placed.steps;
  report.unfolded += placed.unfolded;
  // What tears, and whose face it is, shows while depth pulls from afar.
  report.shape_rms_mm = std::max(report.shape_rms_mm, placed.shape_rms_mm);
  report.mouth_bend = std::max(report.mouth_bend, placed.mouth_bend);
  report.mouth_off = std::max(report.mouth_off, placed.mouth_off);
  return report;
}

void TemplateFitter::move(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                          const mesh::Vertices& before_mm, mesh::Vertices& vertices_mm) {
  TemplateFitReport report;
  for (const double sigma_mm : {impl_->options.placing_sigma_s_mm, impl_->options.sigma_s_mm}) {
    const mesh::Vertices given = vertices_mm;
    impl_->sigma_s_mm = sigma_mm;
    if (impl_->move(maps, flows, &before_mm, vertices_mm, report) != TemplateFitOutcome::NotConverged) {
      vertices_mm = given;
      return;
    }
  }
}

TemplateFitReport TemplateFitter::track(std::span<const DepthMap> maps, std::span<const FlowView> flows,
                                        const mesh::Vertices& before_mm, mesh::Vertices& vertices_mm) {
  impl_->sigma_s_mm = impl_->options.sigma_s_mm;
  return impl_->solve(maps, flows, &before_mm, vertices_mm);
}

TemplateFitReport TemplateFitter::settle(std::span<const DepthMap> maps, const mesh::Vertices& expected_mm,
                                         mesh::Vertices& vertices_mm) {
  impl_->sigma_s_mm = impl_->options.sigma_s_mm;
  return impl_->settle(maps, expected_mm, vertices_mm);
}

void TemplateFitter::remember(const mesh::Vertices& vertices_mm) {
  impl_->remember(vertices_mm);
}

void TemplateFitter::forget() {
  impl_->last_mm.resize(3, 0);
}

mesh::Vertices TemplateFitter::shape_like(const mesh::Vertices& other_mm) {
  if (impl_->placed.vertices_mm.cols() != other_mm.cols()) {
    throw Error(ErrorKind::Usage, "the template fit has no rest shape yet, or other vertices");
  }
  std::fill(impl_->depth_pull.begin(), impl_->depth_pull.end(), 1.0F);
  impl_->bring_along(other_mm);
  return impl_->rest;
}

const Eigen::VectorXd& TemplateFitter::expression() const {
  return impl_->expression;
}

const std::vector<float>& TemplateFitter::depth_weight() const {
  return impl_->depth_pull;
}

}  // namespace facet::fit
