#include "animate/face_ik.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>

#include "animate/polytope.hpp"
#include "facet/error.hpp"
#include "maths/solve.hpp"

namespace facet::animate {
namespace {

constexpr Eigen::Index kMostExemplars = 1024;
/// Captured faces that the folds of a region are made of.
constexpr Eigen::Index kFoldFaces = 6;
/// Motion of a control point below which it is noise of the capture: added to its variance. mm or px.
constexpr double kNoise = 0.02;
/// How far a pose may go in standard deviations of a region's control point: where the take does not move a
/// vertex, no face follows from dragging it.
constexpr double kMostSigmas = 25;
constexpr double kInverseDamping = 1e-4;
/// Of the Levenberg-Marquardt steps, relative to mm^2 per mm^2 (or px^2): at first, at least, where they end.
constexpr double kStepDamping = 1e-4;
constexpr double kLeastDamping = 1e-9;
constexpr double kMostDamping = 1;
constexpr double kEasier = 0.05;
constexpr double kHarder = 8;
/// A step that takes less away than this part of the miss is the last.
constexpr double kCreeping = 0.999;
constexpr int kMostSteps = 24;
constexpr float kGoodMiss_mm = 0.01F;
constexpr float kGoodMiss_px = 0.1F;
constexpr int kEdgeDirections = 256;

/// Unit vectors spread evenly over the sphere (a Fibonacci spiral), or over the circle.
Eigen::MatrixXd spread_directions(Eigen::Index dimension) {
  Eigen::MatrixXd out(dimension, kEdgeDirections);
  for (Eigen::Index k = 0; k < kEdgeDirections; ++k) {
    const double part = (static_cast<double>(k) + 0.5) / kEdgeDirections;
    if (dimension == 2) {
      const double angle = 2 * std::numbers::pi * part;
      out.col(k) << std::cos(angle), std::sin(angle);
    } else {
      const double angle = 2 * std::numbers::pi * (static_cast<double>(k) / std::numbers::phi);
      const double height = 1 - 2 * part;
      const double radius = std::sqrt(1 - height * height);
      out.col(k) << radius * std::cos(angle), radius * std::sin(angle), height;
    }
  }
  return out;
}

/// Directions that tell well where positions end: spread evenly where these are as wide along every axis, for
/// skin often moves along a sheet or a line. positions [2 or 3][any]; returns [2 or 3][kEdgeDirections], unit
Eigen::MatrixXd directions_around(const Eigen::MatrixXd& positions) {
  const Eigen::MatrixXd apart = positions.colwise() - Eigen::VectorXd(positions.rowwise().mean());
  const maths::SymmetricEigen axes = maths::symmetric_eigen(
      apart * apart.transpose() / static_cast<double>(std::max<Eigen::Index>(1, positions.cols())));
  const Eigen::VectorXd widths = axes.values.cwiseMax(0).cwiseSqrt().array() + kNoise;
  Eigen::MatrixXd out =
      axes.vectors * widths.cwiseInverse().asDiagonal() * spread_directions(positions.rows());
  out.colwise().normalize();
  return out;
}

Eigen::Index dimensions(ControlTarget::Space space) {
  return space == ControlTarget::Space::Screen ? 2 : 3;
}

}  // namespace

/// One control point: its vertex and the ring around it, as sums over regions of matrices times coefficients.
struct FaceIk::Site {
  ControlTarget target;
  bool closed_ring = true;
  Eigen::VectorXf base;                        ///< [3 * (1 + ring)] mean face, the vertex first
  std::vector<Eigen::MatrixXf> from_region;    ///< [region] of [3 * (1 + ring)][coarse_rank]
  Eigen::MatrixXf from_face;                   ///< their sum
  Eigen::VectorXf influence;                   ///< [region] of the vertex, as the stencils make it
  Eigen::VectorXf detail_influence;            ///< [region] of the finest level's map
  std::vector<Eigen::MatrixXf> from_solution;  ///< [group] of [3][coarse_rank]
  Eigen::MatrixXd edge_directions;             ///< [2 or 3][kEdgeDirections] unit
  Eigen::VectorXd edges;                       ///< furthest captured position along each
  Eigen::Vector3d at{0, 0, 0};                 ///< where it was measured last, head frame
  Eigen::VectorXd aim;                         ///< the target, or where it was pulled back to
};

/// Control points that are solved together, and their region's solution.
struct FaceIk::Group {
  std::vector<std::size_t> sites;
  std::optional<FaceSums> faces;  ///< s_f of [SF04 eq. 15], of its control points one below the other; on
                                  ///< screen p(s_f) [SF04 eq. 20]
  bool solved = false;
  Eigen::VectorXd solved_for;
  Eigen::VectorXd mean;       ///< m
  Eigen::MatrixXd precision;  ///< V^-1
  Eigen::VectorXd offset;     ///< p - m, then what the steps add
  Eigen::VectorXf average;    ///< [coefficient_count] sum w_f y_f
  Eigen::MatrixXf response;   ///< [coefficient_count][dimensions] sum w_f y_f (s_f - m)^T V^-1

  void limit() {
    const double sigmas = std::sqrt(std::max(0.0, offset.dot(precision * offset)));
    if (sigmas > kMostSigmas) {
      offset *= kMostSigmas / sigmas;
    }
  }
};

struct FaceIk::Region {
  RegionMetric metric;
  Eigen::MatrixXf exemplars;  ///< [any][exemplar count]
  float nearest_mm = 0;
  std::int32_t nearest_frame = 0;
};

std::vector<Eigen::Index> spread_frames(const Eigen::MatrixXf& coordinates, Eigen::Index most) {
  const Eigen::Index count = coordinates.cols();
  std::vector<Eigen::Index> chosen;
  if (count <= most) {
    for (Eigen::Index f = 0; f < count; ++f) {
      chosen.push_back(f);
    }
    return chosen;
  }
  Eigen::VectorXf distance = Eigen::VectorXf::Constant(count, std::numeric_limits<float>::max());
  Eigen::Index next = 0;
  coordinates.colwise().squaredNorm().minCoeff(&next);
  while (static_cast<Eigen::Index>(chosen.size()) < most) {
    chosen.push_back(next);
    distance = distance.cwiseMin(
        (coordinates.colwise() - coordinates.col(next)).colwise().squaredNorm().transpose());
    distance.maxCoeff(&next);
  }
  return chosen;
}

FaceIk::FaceIk(std::shared_ptr<const TakeBasis> basis, IkOptions options)
    : basis_(std::move(basis)), options_(options) {
  exemplars_ = spread_frames(RegionMetric(*basis_).coordinates(basis_->coefficients()), kMostExemplars);
}

FaceIk::~FaceIk() = default;

void FaceIk::set_view(const CameraIntrinsics& camera, const Eigen::Isometry3f& camera_from_head) {
  if (!(camera.fx > 0 && camera.fy > 0) || !camera_from_head.matrix().allFinite()) {
    throw Error(ErrorKind::Usage, "the view's camera needs focal lengths above 0 and a finite pose");
  }
  camera_ = camera;
  camera_from_head_ = camera_from_head;
  has_view_ = true;
  maps_.reset();  // what was captured lies elsewhere on the screen
}

void FaceIk::set_options(IkOptions options) {
  if (options.whole != options_.whole || options.every_face != options_.every_face) {
    maps_.reset();
  }
  for (Group& group : groups_) {
    group.solved = false;
  }
  options_ = options;
}

Eigen::Vector2d FaceIk::project(const Eigen::Vector3d& head_mm) const {
  const Eigen::Vector3d at = camera_from_head_.cast<double>() * head_mm;
  constexpr double kLeastDepth_mm = 1;
  const double depth = std::max(at.z(), kLeastDepth_mm);
  return {static_cast<double>(camera_.fx) * at.x() / depth + static_cast<double>(camera_.cx),
          static_cast<double>(camera_.fy) * at.y() / depth + static_cast<double>(camera_.cy)};
}

Eigen::VectorXd FaceIk::as_targeted(const Site& site, const Eigen::Vector3d& head_mm) const {
  const Eigen::Index size = dimensions(site.target.space);
  Eigen::VectorXd out(size);
  const Eigen::Vector2d seen = size == 2 ? project(head_mm) : Eigen::Vector2d(head_mm.x(), head_mm.y());
  out[0] = seen.x();
  out[1] = seen.y();
  if (size == 3) {
    out[2] = head_mm.z();
  }
  return out;
}

void FaceIk::build_site(Site& site) const {
  const mesh::OneRings& rings = basis_->hierarchy().finest().one_rings;
  const auto vertex = static_cast<std::size_t>(site.target.vertex);
  site.closed_ring = rings.on_boundary[vertex] == 0;
  std::vector<std::int32_t> vertices{site.target.vertex};
  vertices.insert(vertices.end(), rings.neighbours.begin() + rings.offsets[vertex],
                  rings.neighbours.begin() + rings.offsets[vertex + 1]);
  const Eigen::Index rank = basis_->coarse_rank();
  const auto rows = static_cast<Eigen::Index>(3 * vertices.size());
  const auto regions = static_cast<std::size_t>(maps_->region_count());
  site.base = Eigen::VectorXf::Zero(rows);
  site.from_region.assign(regions, Eigen::MatrixXf::Zero(rows, rank));
  site.influence = Eigen::VectorXf::Zero(maps_->region_count());
  const RegionWeights& weights = maps_->control();
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    const auto row = static_cast<Eigen::Index>(3 * k);
    for (const auto& [control, share] : basis_->stencil(vertices[k])) {
      const auto at = static_cast<std::size_t>(control);
      const Eigen::Index column = 3 * Eigen::Index{control};
      site.base.segment<3>(row) += share * basis_->coarse_mean().segment<3>(column);
      for (std::int32_t entry = weights.offsets[at]; entry < weights.offsets[at + 1]; ++entry) {
        const std::size_t region = weights.regions[static_cast<std::size_t>(entry)];
        const float weight = share * weights.weights[static_cast<std::size_t>(entry)];
        site.from_region[region].middleRows<3>(row) +=
            weight * basis_->coarse().middleCols<3>(column).transpose();
        if (k == 0) {
          site.influence[static_cast<Eigen::Index>(region)] += weight;
        }
      }
    }
  }
  site.from_face = Eigen::MatrixXf::Zero(rows, rank);
  for (const Eigen::MatrixXf& part : site.from_region) {
    site.from_face += part;
  }
  site.detail_influence = Eigen::VectorXf::Zero(maps_->region_count());
  const RegionWeights& finest = maps_->finest();
  for (std::int32_t entry = finest.offsets[vertex]; entry < finest.offsets[vertex + 1]; ++entry) {
    site.detail_influence[finest.regions[static_cast<std::size_t>(entry)]] +=
        finest.weights[static_cast<std::size_t>(entry)];
  }
}

namespace {

/// The first of a ring's positions, moved along the area-weighted normal. positions [3 * (1 + ring)]
Eigen::Vector3f displaced(const Eigen::Ref<const Eigen::VectorXf>& positions, bool closed_ring,
                          float displacement_mm) {
  const Eigen::Vector3f at = positions.head<3>();
  const Eigen::Index ring = positions.size() / 3 - 1;
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();
  for (Eigen::Index k = 0; k + (closed_ring ? 0 : 1) < ring; ++k) {
    const Eigen::Vector3f a = positions.segment<3>(3 * (1 + k));
    const Eigen::Vector3f b = positions.segment<3>(3 * (1 + (k + 1) % ring));
    normal += (a - at).cross(b - at);
  }
  return at + displacement_mm * normal.stableNormalized();
}

}  // namespace

Eigen::MatrixXd FaceIk::captured(const Group& group) const {
  Eigen::Index rows = 0;
  for (const std::size_t s : group.sites) {
    rows += dimensions(sites_[s].target.space);
  }
  Eigen::MatrixXd out(rows, basis_->frame_count());
  const Eigen::Index rank = basis_->coarse_rank();
  const Eigen::Index detail_rank = basis_->detail_rank();
  constexpr Eigen::Index kFrames = 512;
  Eigen::Index row = 0;
  for (const std::size_t s : group.sites) {
    const Site& site = sites_[s];
    const Eigen::Index vertex = site.target.vertex;
    for (Eigen::Index first = 0; first < basis_->frame_count(); first += kFrames) {
      const Eigen::Index count = std::min(kFrames, basis_->frame_count() - first);
      const auto faces = basis_->coefficients().middleCols(first, count);
      Eigen::MatrixXf rings = site.from_face * faces.topRows(rank);
      rings.colwise() += site.base;
      for (Eigen::Index f = 0; f < count; ++f) {
        const float displacement_mm =
            detail_rank > 0 ? basis_->detail_mean()[vertex] +
                                  basis_->detail().col(vertex).dot(faces.col(f).segment(rank, detail_rank))
                            : 0.0F;
        const Eigen::Vector3d at = displaced(rings.col(f), site.closed_ring, displacement_mm).cast<double>();
        const Eigen::VectorXd seen = as_targeted(site, at);
        out.col(first + f).segment(row, seen.size()) = seen;
      }
    }
    row += dimensions(site.target.space);
  }
  return out;
}

void FaceIk::rebuild(std::span<const ControlTarget> targets) {
  basis_->check_unchanged();
  maps_.reset();
  sites_.clear();
  groups_.clear();
  regions_.clear();
  std::vector<std::int32_t> vertices;
  for (const ControlTarget& target : targets) {
    vertices.push_back(target.vertex);
  }
  auto maps = std::make_shared<const InfluenceMaps>(*basis_, vertices, options_.whole);
  const int region_count = maps->region_count();
  for (int region = 0; region < region_count; ++region) {
    regions_.push_back({RegionMetric(*basis_, maps->control().region(region), maps->finest().region(region),
                                     maps->eyes_of(region)),
                        {}});
    Region& made = regions_.back();
    Eigen::MatrixXf faces(basis_->coefficient_count(), static_cast<Eigen::Index>(exemplars_.size()));
    for (std::size_t k = 0; k < exemplars_.size(); ++k) {
      faces.col(static_cast<Eigen::Index>(k)) = basis_->coefficients().col(exemplars_[k]);
    }
    made.exemplars = made.metric.coordinates(faces);
  }
  maps_ = std::move(maps);

  for (const ControlTarget& target : targets) {
    Site& site = sites_.emplace_back();
    site.target = target;
    build_site(site);
  }
  if (!sites_.empty()) {
    groups_.resize(static_cast<std::size_t>(region_count));
  }
  for (std::size_t s = 0; s < sites_.size(); ++s) {
    groups_[options_.whole ? 0 : s].sites.push_back(s);
  }
  for (Group& group : groups_) {
    group.faces.emplace(captured(group), basis_->coefficients(), options_.every_face);
    Eigen::Index row = 0;
    for (const std::size_t s : group.sites) {
      const Eigen::Index size = dimensions(sites_[s].target.space);
      const auto positions = group.faces->captured().middleRows(row, size);
      sites_[s].edge_directions = directions_around(positions);
      sites_[s].edges = Eigen::VectorXd::Constant(kEdgeDirections, -std::numeric_limits<double>::max());
      for (Eigen::Index f = 0; f < positions.cols(); ++f) {
        sites_[s].edges = sites_[s].edges.cwiseMax(sites_[s].edge_directions.transpose() * positions.col(f));
      }
      row += size;
    }
  }

  // chat = B^-1 c [SF04 eq. 22]: B made of what each control vertex really gets, through the stencils. Where
  // control points all but coincide B is singular; damped around the regions' mean its rows still sum to 1.
  const auto count = static_cast<Eigen::Index>(groups_.size());
  Eigen::MatrixXd influences = Eigen::MatrixXd::Ones(count, count);
  if (count > 1) {
    for (Eigen::Index s = 0; s < count; ++s) {
      influences.row(s) = sites_[static_cast<std::size_t>(s)].influence.cast<double>().transpose();
      influences.row(s) /= influences.row(s).sum();
    }
    const Eigen::MatrixXd square =
        influences.transpose() * influences + kInverseDamping * Eigen::MatrixXd::Identity(count, count);
    const Eigen::MatrixXd inverse = maths::solve_symmetric_columns(square, influences.transpose());
    const Eigen::MatrixXd average = Eigen::MatrixXd::Constant(count, count, 1.0 / static_cast<double>(count));
    const Eigen::MatrixXd centred = Eigen::MatrixXd::Identity(count, count) - average;
    region_from_group_ = average + inverse * centred;
  } else {
    region_from_group_ = influences;
  }
  for (Site& site : sites_) {
    for (std::size_t g = 0; g < groups_.size(); ++g) {
      Eigen::MatrixXf sum = Eigen::MatrixXf::Zero(3, basis_->coarse_rank());
      for (std::size_t region = 0; region < site.from_region.size(); ++region) {
        sum += static_cast<float>(
                   region_from_group_(static_cast<Eigen::Index>(region), static_cast<Eigen::Index>(g))) *
               site.from_region[region].topRows<3>();
      }
      site.from_solution.push_back(std::move(sum));
    }
  }
}

void FaceIk::solve_group(Group& group) {
  Eigen::VectorXd target(group.faces->captured().rows());
  Eigen::Index row = 0;
  for (const std::size_t s : group.sites) {
    target.segment(row, sites_[s].aim.size()) = sites_[s].aim;
    row += sites_[s].aim.size();
  }
  if (!group.solved || group.solved_for != target) {
    const Eigen::Index size = target.size();
    FaceSums::Result sums = group.faces->at(target);
    sums.covariance.diagonal().array() += kNoise * kNoise;
    group.mean = std::move(sums.mean);
    group.precision = maths::solve_symmetric_columns(sums.covariance, Eigen::MatrixXd::Identity(size, size));
    group.average = std::move(sums.average);
    group.response = sums.moments * group.precision.cast<float>();
    group.solved = true;
    group.solved_for = target;
  }
  group.offset = target - group.mean;
  group.limit();
}

void FaceIk::blend_regions(Pose& pose) const {
  const Eigen::Index numbers = basis_->coefficient_count();
  if (groups_.empty()) {
    pose.state.topRows(numbers).setZero();
    return;
  }
  Eigen::MatrixXf solutions(numbers, static_cast<Eigen::Index>(groups_.size()));
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    solutions.col(static_cast<Eigen::Index>(g)) =
        groups_[g].average + groups_[g].response * groups_[g].offset.cast<float>();
  }
  pose.state.topRows(numbers) = solutions * region_from_group_.transpose().cast<float>();
}

void FaceIk::pick_folds(Pose& pose) {
  const Eigen::Index detail_rank = basis_->detail_rank();
  const auto faces = basis_->coefficients();
  for (std::size_t r = 0; r < regions_.size(); ++r) {
    Region& region = regions_[r];
    const auto column = static_cast<Eigen::Index>(r);
    const Eigen::VectorXf at = region.metric.coordinates(pose.state.col(column));
    const Eigen::VectorXf distance = (region.exemplars.colwise() - at).colwise().norm();
    std::vector<Eigen::Index> nearest(static_cast<std::size_t>(distance.size()));
    for (std::size_t k = 0; k < nearest.size(); ++k) {
      nearest[k] = static_cast<Eigen::Index>(k);
    }
    const Eigen::Index taken = std::min<Eigen::Index>(kFoldFaces + 1, distance.size());
    std::partial_sort(nearest.begin(), nearest.begin() + taken, nearest.end(),
                      [&](Eigen::Index a, Eigen::Index b) { return distance[a] < distance[b]; });
    region.nearest_mm = distance[nearest.front()];
    region.nearest_frame = static_cast<std::int32_t>(exemplars_[static_cast<std::size_t>(nearest.front())]);
    if (detail_rank == 0) {
      continue;
    }
    auto folds = pose.state.col(column).tail(detail_rank);
    folds = pose.state.col(column).segment(basis_->coarse_rank(), detail_rank);
    if (!options_.sharp_folds) {
      continue;
    }
    // A kernel that falls to 0 at the first face that is not taken: faces come and go without a jump.
    const float reach = std::max(distance[nearest[static_cast<std::size_t>(taken - 1)]], 1e-6F) * 1.0001F;
    Eigen::VectorXf sum = Eigen::VectorXf::Zero(detail_rank);
    float total = 0;
    for (Eigen::Index k = 0; k < taken; ++k) {
      const Eigen::Index exemplar = nearest[static_cast<std::size_t>(k)];
      const float part = distance[exemplar] / reach;
      const float weight = (1 - part * part) * (1 - part * part);
      sum += weight * faces.col(exemplars_[static_cast<std::size_t>(exemplar)])
                          .segment(basis_->coarse_rank(), detail_rank);
      total += weight;
    }
    if (total > 0) {
      folds = sum / total;
    }
  }
}

Eigen::Vector3f FaceIk::position(const Site& site, const Eigen::MatrixXf& state) const {
  const Eigen::Index rank = basis_->coarse_rank();
  const Eigen::Index detail_rank = basis_->detail_rank();
  Eigen::VectorXf ring = site.base;
  float displacement_mm = 0;
  const Eigen::Index vertex = site.target.vertex;
  if (detail_rank > 0) {
    displacement_mm = basis_->detail_mean()[vertex];
  }
  for (std::size_t r = 0; r < site.from_region.size(); ++r) {
    const auto column = static_cast<Eigen::Index>(r);
    ring.noalias() += site.from_region[r] * state.col(column).head(rank);
    if (detail_rank > 0 && site.detail_influence[column] > 0) {
      const auto broad = state.col(column).segment(rank, detail_rank);
      const auto folds = state.col(column).tail(detail_rank);
      displacement_mm += site.detail_influence[column] * (basis_->detail().col(vertex).dot(broad) +
                                                          basis_->folds().col(vertex).dot(folds - broad));
    }
  }
  return displaced(ring, site.closed_ring, displacement_mm);
}

/// How far every control point is from its aim: outcomes, and the misses group by group, control point by
/// control point.
Eigen::VectorXd FaceIk::measure(const Pose& pose, Eigen::Index size, bool& good) {
  Eigen::VectorXd misses(size);
  good = true;
  Eigen::Index row = 0;
  for (const Group& group : groups_) {
    for (const std::size_t s : group.sites) {
      Site& site = sites_[s];
      site.at = position(site, pose.state).cast<double>();
      const bool on_screen = site.target.space == ControlTarget::Space::Screen;
      const Eigen::VectorXd miss = site.aim - as_targeted(site, site.at);
      misses.segment(row, miss.size()) = miss;
      row += miss.size();
      outcomes_[s].miss = static_cast<float>(miss.norm());
      outcomes_[s].met = outcomes_[s].miss <= (on_screen ? kMetScreen_px : kMetHead_mm);
      good = good && outcomes_[s].miss <= (on_screen ? kGoodMiss_px : kGoodMiss_mm);
    }
  }
  return misses;
}

/// How the control points move with the groups' offsets, displacements left out; rows and columns as measure.
Eigen::MatrixXd FaceIk::jacobian(Eigen::Index size) const {
  Eigen::MatrixXd out(size, size);
  Eigen::Index row = 0;
  for (const Group& group : groups_) {
    for (const std::size_t s : group.sites) {
      const Site& site = sites_[s];
      Eigen::MatrixXd view = Eigen::MatrixXd::Identity(3, 3);
      if (site.target.space == ControlTarget::Space::Screen) {
        const Eigen::Vector3d seen = camera_from_head_.cast<double>() * site.at;
        Eigen::Matrix<double, 2, 3> derivative;
        derivative << camera_.fx / seen.z(), 0, -camera_.fx * seen.x() / (seen.z() * seen.z()),  //
            0, camera_.fy / seen.z(), -camera_.fy * seen.y() / (seen.z() * seen.z());
        view = derivative * camera_from_head_.linear().cast<double>();
      }
      Eigen::Index column = 0;
      for (std::size_t g = 0; g < groups_.size(); ++g) {
        const Eigen::Index columns = groups_[g].offset.size();
        const Eigen::MatrixXf moved =
            site.from_solution[g] * groups_[g].response.topRows(basis_->coarse_rank());
        out.block(row, column, site.aim.size(), columns) = view * moved.cast<double>();
        column += columns;
      }
      row += site.aim.size();
    }
  }
  return out;
}

/// Steps of Levenberg and Marquardt [Mar63] on the groups' offsets. Where control points crowd, some of their
/// directions are all but dependent: a fixed damping then creeps. It falls with every step that helps and
/// grows with every one that does not.
void FaceIk::correct(Pose& pose) {
  Eigen::Index size = 0;
  for (const Group& group : groups_) {
    size += group.offset.size();
  }
  bool good = false;
  Eigen::VectorXd misses = measure(pose, size, good);
  Eigen::MatrixXd moves = jacobian(size);
  double damping = kStepDamping;
  for (int step = 0; step < kMostSteps && !good && damping < kMostDamping; ++step) {
    Eigen::MatrixXd square = moves.transpose() * moves;
    square.diagonal().array() += damping;
    const Eigen::VectorXd change = maths::solve_symmetric(square, moves.transpose() * misses);
    std::vector<Eigen::VectorXd> before;
    Eigen::Index at = 0;
    for (Group& group : groups_) {
      before.push_back(group.offset);
      group.offset += change.segment(at, group.offset.size());
      at += group.offset.size();
      group.limit();
    }
    blend_regions(pose);
    const double norm = misses.norm();
    const Eigen::VectorXd left = measure(pose, size, good);
    if (left.norm() < norm) {
      const bool creeps = left.norm() > kCreeping * norm && damping <= kLeastDamping;
      misses = left;
      if (creeps) {
        return;
      }
      moves = jacobian(size);
      damping = std::max(kLeastDamping, kEasier * damping);
      continue;
    }
    for (std::size_t g = 0; g < groups_.size(); ++g) {
      groups_[g].offset = before[g];
    }
    blend_regions(pose);
    misses = measure(pose, size, good);
    damping *= kHarder;
  }
}

void FaceIk::report(const Pose& pose) {
  for (std::size_t s = 0; s < sites_.size(); ++s) {
    const Region& region = regions_[options_.whole ? 0 : s];
    outcomes_[s].nearest_mm = region.nearest_mm;
    outcomes_[s].nearest_frame = region.nearest_frame;
  }
  if (!pose.state.allFinite()) {
    throw Error(ErrorKind::Internal, "a pose is not finite");
  }
}

void FaceIk::check(std::span<const ControlTarget> targets) const {
  std::vector<std::int32_t> vertices;
  for (const ControlTarget& target : targets) {
    vertices.push_back(target.vertex);
  }
  check_controls(*basis_, vertices);
  for (const ControlTarget& target : targets) {
    const bool on_screen = target.space == ControlTarget::Space::Screen;
    const Eigen::Index numbers = dimensions(target.space);
    if (!target.target.head(numbers).allFinite()) {
      throw Error(ErrorKind::Usage,
                  fmt::format("vertex {}: its target is not a finite number", target.vertex));
    }
    const Eigen::Vector3d resting = basis_->rest_mm().col(target.vertex).cast<double>();
    if (on_screen && !has_view_) {
      throw Error(ErrorKind::Usage, fmt::format("vertex {}: a target on screen needs a view", target.vertex));
    }
    if (on_screen && (camera_from_head_.cast<double>() * resting).z() < 1) {
      throw Error(ErrorKind::Usage, fmt::format("vertex {} is behind the view's camera", target.vertex));
    }
    const double away = on_screen ? (target.target.head<2>().cast<double>() - project(resting)).norm()
                                  : (target.target.cast<double>() - resting).norm();
    const double farthest = static_cast<double>(on_screen ? kFarthest_px : kFarthest_mm);
    if (away > farthest) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("vertex {}: its target lies {:.3g} {} from where it rests; {:.0f} {} at most",
                      target.vertex, away, on_screen ? "px" : "mm", farthest, on_screen ? "px" : "mm"));
    }
  }
}

const std::vector<ControlOutcome>& FaceIk::solve(std::span<const ControlTarget> targets, Pose& pose) {
  check(targets);
  const bool same =
      maps_ != nullptr && targets.size() == sites_.size() &&
      std::equal(targets.begin(), targets.end(), sites_.begin(), [](const auto& target, const Site& site) {
        return target.vertex == site.target.vertex && target.space == site.target.space;
      });
  if (!same) {
    rebuild(targets);
  }
  outcomes_.assign(targets.size(), {});
  for (std::size_t s = 0; s < sites_.size(); ++s) {
    Site& site = sites_[s];
    site.target = targets[s];
    const Eigen::Index numbers = dimensions(site.target.space);
    site.aim = site.target.target.head(numbers).cast<double>();
    // Inside the captured range: no further along any direction than some captured position.
    const Eigen::VectorXd inside = nearest_inside(site.edge_directions, site.edges, site.aim);
    outcomes_[s].outside = static_cast<float>((site.aim - inside).norm());
    if (!options_.beyond && outcomes_[s].outside > 0) {
      site.aim = inside;
      outcomes_[s].clamped = true;
    }
  }
  pose.maps = maps_;
  pose.state.setZero(basis_->coefficient_count() + basis_->detail_rank(), maps_->region_count());
  for (Group& group : groups_) {
    solve_group(group);
  }
  blend_regions(pose);
  pick_folds(pose);
  if (!groups_.empty()) {
    correct(pose);
    pick_folds(pose);
    correct(pose);
  }
  report(pose);
  return outcomes_;
}

Eigen::MatrixXd FaceIk::region_weights() const {
  const auto regions = static_cast<Eigen::Index>(regions_.size());
  Eigen::MatrixXd out = Eigen::MatrixXd::Zero(basis_->frame_count(), regions);
  if (groups_.empty()) {
    out.setConstant(1.0 / static_cast<double>(basis_->frame_count()));
    return out;
  }
  Eigen::MatrixXd solved(basis_->frame_count(), static_cast<Eigen::Index>(groups_.size()));
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    const Group& group = groups_[g];
    const Eigen::VectorXd lever = group.precision * group.offset;
    const Eigen::VectorXd factor = (group.faces->captured().colwise() - group.mean).transpose() * lever;
    solved.col(static_cast<Eigen::Index>(g)) =
        group.faces->weights(group.solved_for).cwiseProduct((1.0 + factor.array()).matrix());
  }
  return solved * region_from_group_.transpose();
}

}  // namespace facet::animate
