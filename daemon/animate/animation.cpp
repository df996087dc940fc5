#include "animate/animation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "animate/places.hpp"
#include "facet/error.hpp"
#include "mesh/hierarchy.hpp"

namespace facet::animate {
namespace {

/// No blinks this close to a key.
constexpr double kCalm_s = 0.3;
/// A key's time that no path has to fill.
constexpr double kShortest_s = 1e-6;

double smooth(double part) {
  const double t = std::clamp(part, 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

/// Where every vertex of the finest level is in a pose, head frame, mm.
mesh::Vertices finest_vertices(const TakeBasis& basis, const Pose& pose) {
  mesh::MeshFrame frame;
  blend(basis, pose, frame);
  mesh::Vertices vertices;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(basis.hierarchy(), frame.control_vertices_mm, frame.displacements_mm, vertices,
                       normals);
  return vertices;
}

std::string misses(const std::vector<ControlTarget>& targets, const std::vector<ControlOutcome>& outcomes,
                   const std::string& where) {
  std::string text;
  for (std::size_t i = 0; i < outcomes.size(); ++i) {
    const char* unit = targets[i].space == ControlTarget::Space::Screen ? "px" : "mm";
    const auto add = [&](const std::string& what) {
      text += fmt::format("{}{}: vertex {} {}", text.empty() ? "" : "; ", where, targets[i].vertex, what);
    };
    if (!outcomes[i].met) {
      add(fmt::format("is {:.2f} {} from its target", outcomes[i].miss, unit));
    }
    if (outcomes[i].outside > kOutsideTolerance) {
      add(fmt::format("{} {:.1f} {} outside what was captured",
                      outcomes[i].clamped ? "was pulled back from" : "is", outcomes[i].outside, unit));
    }
    if (outcomes[i].nearest_mm > kFarFromCaptured_mm) {
      add(
          fmt::format("is in a region {:.1f} mm from the nearest captured face: it may be no face of this "
                      "person",
                      outcomes[i].nearest_mm));
    }
  }
  return text;
}

/// Solves keys one after the other into poses that share their regions.
class KeySolver {
 public:
  KeySolver(std::shared_ptr<const TakeBasis> basis, const KeyList& list)
      : basis_(std::move(basis)), list_(list) {
    options_.whole = list.whole;
    options_.beyond = list.beyond;
    const auto add = [&](const std::string& text) {
      const std::int32_t vertex = find_vertex(*basis_, text);
      if (std::find(vertices_.begin(), vertices_.end(), vertex) == vertices_.end()) {
        vertices_.push_back(vertex);
      }
    };
    for (const std::string& text : list.regions) {
      add(text);
    }
    for (const Key& key : list.keys) {
      for (const KeyControl& control : key.controls) {
        add(control.vertex);
      }
    }
    check_controls(*basis_, vertices_);
    maps_ = std::make_shared<const InfluenceMaps>(*basis_, vertices_, list.whole);
  }

  const std::shared_ptr<const InfluenceMaps>& maps() const { return maps_; }

  /// The states of a key's regions.
  Eigen::MatrixXf solve(std::size_t index, AnimationReport& report) {
    const Key& key = list_.keys[index];
    const std::string where = fmt::format("key {} ({} s)", index + 1, key.time_s);
    if (key.frame) {
      return captured_state(*basis_, captured(*key.frame, where)).replicate(1, maps_->region_count());
    }
    if (key.controls.empty()) {
      return Eigen::MatrixXf::Zero(basis_->coefficient_count() + basis_->detail_rank(),
                                   maps_->region_count());
    }
    try {
      std::vector<ControlTarget> targets;
      for (const KeyControl& control : key.controls) {
        if (rest_.cols() == 0) {
          rest_ = resting_vertices(*basis_);
        }
        targets.push_back(control_target(*basis_, control, rest_));
      }
      std::vector<std::int32_t> own;
      own.reserve(targets.size());
      for (const ControlTarget& target : targets) {
        own.push_back(target.vertex);
      }
      Pose pose;
      // The solver of the same control points is used again: their maps take long to make.
      auto& ik = solvers_[own];
      if (ik == nullptr) {
        ik = std::make_unique<FaceIk>(basis_, options_);
        ik->set_view(basis_->sample().camera, basis_->sample().camera_from_head);
      }
      const std::string warning = misses(targets, ik->solve(targets, pose), where);
      if (!warning.empty()) {
        report.warnings.push_back(warning);
      }
      if (own == vertices_ || list_.whole) {
        return pose.state;
      }
      // Control points of other keys follow this key's pose.
      const mesh::Vertices vertices = finest_vertices(*basis_, pose);
      std::vector<ControlTarget> all;
      for (const std::int32_t vertex : vertices_) {
        all.push_back({vertex, ControlTarget::Space::Head, vertices.col(vertex)});
      }
      auto& whole_set = solvers_[vertices_];
      if (whole_set == nullptr) {
        whole_set = std::make_unique<FaceIk>(
            basis_, IkOptions{.whole = options_.whole, .beyond = true, .sharp_folds = true});
        whole_set->set_view(basis_->sample().camera, basis_->sample().camera_from_head);
      }
      whole_set->solve(all, pose);
      return pose.state;
    } catch (const Error& error) {
      throw Error(error.kind(), fmt::format("{}: {}", where, error.what()));
    }
  }

 private:
  Eigen::Index captured(std::uint64_t sequence, const std::string& where) const {
    const auto frames = basis_->frames();
    for (std::size_t f = 0; f < frames.size(); ++f) {
      if (frames[f].sequence == static_cast<std::int64_t>(sequence)) {
        return static_cast<Eigen::Index>(f);
      }
    }
    throw Error(ErrorKind::Usage,
                fmt::format("{}: the take has no mesh of frame {}: it has frames {} to {}", where, sequence,
                            frames.front().sequence, frames.back().sequence));
  }

  std::shared_ptr<const TakeBasis> basis_;
  const KeyList& list_;
  IkOptions options_;
  std::vector<std::int32_t> vertices_;
  std::shared_ptr<const InfluenceMaps> maps_;
  std::map<std::vector<std::int32_t>, std::unique_ptr<FaceIk>> solvers_;
  mesh::Vertices rest_;
};

RegionMetric metric_of(const TakeBasis& basis, const InfluenceMaps& maps, int region) {
  return {basis, maps.control().region(region), maps.finest().region(region), maps.eyes_of(region)};
}

}  // namespace

mesh::Vertices resting_vertices(const TakeBasis& basis) {
  Pose mean;
  mean.maps = std::make_shared<const InfluenceMaps>(basis, std::span<const std::int32_t>());
  mean.state = Eigen::MatrixXf::Zero(basis.coefficient_count() + basis.detail_rank(), 1);
  return finest_vertices(basis, mean);
}

ControlTarget control_target(const TakeBasis& basis, const KeyControl& control,
                             const mesh::Vertices& rest_mm) {
  ControlTarget target;
  target.vertex = find_vertex(basis, control.vertex);
  const std::int32_t one[] = {target.vertex};
  check_controls(basis, one);
  target.target = control.value;
  if (control.how == KeyControl::How::Screen) {
    target.space = ControlTarget::Space::Screen;
  } else if (control.how == KeyControl::How::Move) {
    target.target += rest_mm.col(target.vertex);
  }
  return target;
}

Track::Track(const TakeBasis& basis, const std::vector<std::int32_t>& faces, double begin_s, double step_s)
    : step_s_(step_s) {
  const auto captured = basis.frames();
  const auto follows = [&](std::int32_t face) {
    return face > 0 && face < basis.frame_count() && captured[static_cast<std::size_t>(face)].follows != 0;
  };
  for (std::size_t k = 0; k < faces.size(); ++k) {
    const double at_s = begin_s + static_cast<double>(k) * step_s;
    const bool goes_on = k > 0 && faces[k] == faces[k - 1] + 1 && follows(faces[k]);
    if (goes_on) {
      runs_.back().end_s = at_s;
      continue;
    }
    Run run;
    run.first_face = faces[k];
    run.begin_s = run.end_s = at_s;
    std::int32_t lowest = faces[k];
    while (follows(lowest)) {
      --lowest;
    }
    std::int32_t highest = faces[k];
    while (follows(highest + 1)) {
      ++highest;
    }
    run.lowest = lowest;
    run.highest = highest;
    runs_.push_back(run);
  }
  const double end_s = begin_s + static_cast<double>(faces.size() - 1) * step_s;
  for (std::size_t r = 1; r < runs_.size(); ++r) {
    Run& run = runs_[r];
    run.fade_middle_s = 0.5 * (runs_[r - 1].end_s + run.begin_s);
    // The ends of the track are met exactly.
    run.fade_half_s = std::min({0.5 * kFade_s, run.fade_middle_s - begin_s, end_s - run.fade_middle_s});
  }
}

Eigen::VectorXf Track::sample(const TakeBasis& basis, const Run& run, double time_s) const {
  const double face = std::clamp(run.first_face + (step_s_ > 0 ? (time_s - run.begin_s) / step_s_ : 0.0),
                                 run.lowest, run.highest);
  const double whole = std::min(std::floor(face), run.highest);
  const auto part = static_cast<float>(face - whole);
  const auto at = [&](double offset) {
    return static_cast<Eigen::Index>(std::clamp(whole + offset, run.lowest, run.highest));
  };
  const auto faces = basis.coefficients();
  Eigen::VectorXf state(basis.coefficient_count() + basis.detail_rank());
  auto coefficients = state.head(basis.coefficient_count());
  if (part == 0) {
    coefficients = faces.col(at(0));
  } else {
    // Cubic spline through the faces [CR74].
    const float square = part * part;
    const float cube = square * part;
    coefficients = (-0.5F * cube + square - 0.5F * part) * faces.col(at(-1)) +
                   (1.5F * cube - 2.5F * square + 1) * faces.col(at(0)) +
                   (-1.5F * cube + 2 * square + 0.5F * part) * faces.col(at(1)) +
                   (0.5F * cube - 0.5F * square) * faces.col(at(2));
  }
  state.tail(basis.detail_rank()) = coefficients.segment(basis.coarse_rank(), basis.detail_rank());
  return state;
}

Eigen::VectorXf Track::state(const TakeBasis& basis, double time_s) const {
  // The first run that no longer only fades out, then the later ones over it.
  std::size_t first = 0;
  for (std::size_t r = 1; r < runs_.size() && time_s >= runs_[r].fade_middle_s + runs_[r].fade_half_s; ++r) {
    first = r;
  }
  const double last_s = runs_.back().end_s;
  const double clamped_s = std::clamp(time_s, runs_.front().begin_s, last_s);
  Eigen::VectorXf out = sample(basis, runs_[first], clamped_s);
  for (std::size_t r = first + 1; r < runs_.size(); ++r) {
    const Run& run = runs_[r];
    const double begin_s = run.fade_middle_s - run.fade_half_s;
    if (time_s <= begin_s && run.fade_half_s > 0) {
      break;
    }
    if (time_s < run.fade_middle_s && !(run.fade_half_s > 0)) {
      break;
    }
    const double part = run.fade_half_s > 0 ? smooth((time_s - begin_s) / (2 * run.fade_half_s)) : 1.0;
    out += static_cast<float>(part) * (sample(basis, run, clamped_s) - out);
  }
  return out;
}

Animation Animation::of_keys(const std::shared_ptr<const TakeBasis>& basis, const KeyList& list,
                             AnimationReport& report, const GoOn& go_on) {
  if (list.keys.empty()) {
    throw Error(ErrorKind::Usage, "an animation needs a key");
  }
  KeySolver solver(basis, list);
  std::vector<Eigen::MatrixXf> states;
  for (std::size_t k = 0; k < list.keys.size(); ++k) {
    if (go_on && !go_on()) {
      throw Error(ErrorKind::Unavailable, "broken off");
    }
    states.push_back(solver.solve(k, report));
  }
  Animation made;
  made.basis_ = basis;
  made.maps_ = solver.maps();
  made.duration_s_ = list.keys.back().time_s;
  const double period_s = basis->frame_period_s();
  for (int region = 0; region < made.maps_->region_count(); ++region) {
    const RegionMetric metric = metric_of(*basis, *made.maps_, region);
    const FaceGraph graph(*basis, metric, {}, go_on);
    std::vector<Interval>& intervals = made.regions_.emplace_back();
    std::vector<std::int32_t> nearest;
    std::vector<Eigen::VectorXf> offsets;
    std::vector<float> offsets_mm;
    for (const Eigen::MatrixXf& state : states) {
      float offset_mm = 0;
      nearest.push_back(graph.nearest(metric.coordinates(state.col(region)), offset_mm));
      offsets.emplace_back(state.col(region) - captured_state(*basis, nearest.back()));
      offsets_mm.push_back(offset_mm);
    }
    if (states.size() == 1) {
      intervals.push_back({0, 0, Track(*basis, {nearest[0]}, 0, 0), offsets[0], offsets[0]});
    }
    for (std::size_t k = 0; k + 1 < states.size(); ++k) {
      const double begin_s = list.keys[k].time_s;
      const double time_s = list.keys[k + 1].time_s - begin_s;
      const int steps = std::max(1, static_cast<int>(std::lround(time_s / period_s)));
      const FaceGraph::Path shortest = graph.shortest(nearest[k], nearest[k + 1]);
      const FaceGraph::Path path = list.pace == Pace::Captured
                                       ? graph.paced(nearest[k], nearest[k + 1], steps,
                                                     static_cast<int>(std::lround(kCalm_s / period_s)))
                                       : shortest;
      const auto edges = static_cast<double>(path.faces.size() - 1);
      const double step_s = edges > 0 && time_s > kShortest_s ? time_s / edges : period_s;
      intervals.push_back({begin_s, begin_s + time_s, Track(*basis, path.faces, begin_s, step_s), offsets[k],
                           offsets[k + 1]});
      report.transitions.push_back(
          {k, region, path.cost, shortest.cost, path.direct_cost, static_cast<int>(path.faces.size()),
           path.jumps, path.worst_cost,
           static_cast<std::uint64_t>(basis->frames()[static_cast<std::size_t>(path.worst_from)].sequence),
           offsets_mm[k + 1], period_s / step_s});
    }
  }
  return made;
}

Animation Animation::of_walk(const std::shared_ptr<const TakeBasis>& basis, const WalkOptions& options,
                             AnimationReport& report, const GoOn& go_on) {
  if (!(options.duration_s > 0 && options.duration_s <= kLongest_s) || !(options.mean_run_s > 0)) {
    throw Error(ErrorKind::Usage, fmt::format("a walk of {} s with jumps every {} s makes no sense",
                                              options.duration_s, options.mean_run_s));
  }
  Animation made;
  made.basis_ = basis;
  made.maps_ = std::make_shared<const InfluenceMaps>(*basis, options.regions);
  made.duration_s_ = options.duration_s;
  const double period_s = basis->frame_period_s();
  const auto faces = static_cast<std::size_t>(std::ceil(options.duration_s / period_s)) + 1;
  const Eigen::VectorXf unmoved = Eigen::VectorXf::Zero(basis->coefficient_count() + basis->detail_rank());
  // All regions begin with the same face, the one nearest to the mean.
  const RegionMetric whole(*basis);
  Eigen::Index first = 0;
  whole.coordinates(basis->coefficients()).colwise().squaredNorm().minCoeff(&first);
  for (int region = 0; region < made.maps_->region_count(); ++region) {
    const FaceGraph graph(*basis, metric_of(*basis, *made.maps_, region), {}, go_on);
    const std::vector<std::int32_t> walk = graph.random_walk(
        static_cast<std::int32_t>(first), faces,
        options.seed + 0x9E3779B97F4A7C15ULL * static_cast<std::uint64_t>(region),
        options.mean_run_s / period_s, static_cast<std::size_t>(std::ceil(Track::kFade_s / period_s)));
    for (std::size_t k = 0; k + 1 < walk.size(); ++k) {
      if (graph.successor(walk[k]) != walk[k + 1]) {
        ++report.jumps;
        const float cost = graph.cost(walk[k], walk[k + 1]);
        if (cost > report.worst_jump_cost) {
          report.worst_jump_cost = cost;
          report.worst_jump_frame =
              static_cast<std::uint64_t>(basis->frames()[static_cast<std::size_t>(walk[k])].sequence);
        }
      }
    }
    std::vector<Interval>& intervals = made.regions_.emplace_back();
    intervals.push_back({0, options.duration_s, Track(*basis, walk, 0, period_s), unmoved, unmoved});
  }
  return made;
}

void Animation::pose(double time_s, Pose& out) const {
  out.maps = maps_;
  out.state.resize(basis_->coefficient_count() + basis_->detail_rank(), maps_->region_count());
  for (std::size_t r = 0; r < regions_.size(); ++r) {
    const std::vector<Interval>& intervals = regions_[r];
    const auto after =
        std::upper_bound(intervals.begin(), intervals.end(), time_s,
                         [](double at_s, const Interval& interval) { return at_s < interval.begin_s; });
    const Interval& interval = after == intervals.begin() ? intervals.front() : *(after - 1);
    const double length_s = interval.end_s - interval.begin_s;
    const auto part = static_cast<float>(length_s > 0 ? smooth((time_s - interval.begin_s) / length_s) : 0.0);
    out.state.col(static_cast<Eigen::Index>(r)) = interval.track.state(*basis_, time_s) +
                                                  (1 - part) * interval.offset_before +
                                                  part * interval.offset_after;
  }
}

Eigen::Isometry3f Animation::camera_from_head(double time_s, HeadMotion motion) const {
  if (motion == HeadMotion::Still) {
    return basis_->sample().camera_from_head;
  }
  // Forwards to the take's end and back again, and so on.
  const auto last = static_cast<double>(basis_->frame_count() - 1);
  const double along = std::fmod(time_s / basis_->frame_period_s(), 2 * last);
  const double at = along <= last ? along : 2 * last - along;
  const auto before = std::min(static_cast<std::size_t>(at), static_cast<std::size_t>(last) - 1);
  const auto part = static_cast<float>(at - static_cast<double>(before));
  const auto pose_of = [&](std::size_t f) {
    Eigen::Isometry3f pose = Eigen::Isometry3f::Identity();
    pose.matrix().topRows<3>() = Eigen::Map<const Eigen::Matrix<float, 3, 4, Eigen::RowMajor>>(
        basis_->frames()[f].camera_from_head.data());
    return pose;
  };
  const Eigen::Isometry3f a = pose_of(before);
  const Eigen::Isometry3f b = pose_of(before + 1);
  Eigen::Isometry3f out = Eigen::Isometry3f::Identity();
  out.linear() =
      Eigen::Quaternionf(a.linear()).slerp(part, Eigen::Quaternionf(b.linear())).toRotationMatrix();
  out.translation() = (1 - part) * a.translation() + part * b.translation();
  return out;
}

}  // namespace facet::animate
