#include "animate/face_graph.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <future>
#include <limits>
#include <queue>
#include <random>

#include "facet/error.hpp"
#include "maths/statistics.hpp"

namespace facet::animate {
namespace {

/// Faces closer in time than this to where the take goes anyway are no jumps.
constexpr double kJumpWindow_s = 0.25;
/// What a jump with lids wholly down costs, in steps that are large for the take.
constexpr float kBlinkSteps = 8;
constexpr double kLargeStep = 0.75;  // quantile of the captured steps

}  // namespace

FaceGraph::FaceGraph(const TakeBasis& basis, const RegionMetric& metric, GraphOptions options, GoOn go_on)
    : options_(options), go_on_(std::move(go_on)), coordinates_(metric.coordinates(basis.coefficients())) {
  if (options_.neighbours < 1 || options_.neighbours > 64 ||
      !(options_.lambda >= 0 && options_.lambda <= 100)) {
    throw Error(ErrorKind::Usage,
                fmt::format("a face graph keeps 1 to 64 neighbours with lambda from 0 to 100, not {} with {}",
                            options_.neighbours, options_.lambda));
  }
  const int count = face_count();
  std::vector<float> steps;
  for (const CapturedFrame& frame : basis.frames()) {
    follows_.push_back(frame.follows != 0 ? 1 : 0);
    blink_.push_back(frame.blink);
    const auto face = static_cast<std::int32_t>(follows_.size()) - 1;
    if (face > 0 && follows_.back() != 0) {
      steps.push_back(distance(face - 1, face));
    }
  }
  if (!steps.empty()) {
    const auto large = static_cast<std::size_t>(kLargeStep * static_cast<double>(steps.size() - 1));
    blink_weight_mm_ = kBlinkSteps * maths::nth_of(steps, large);
  }
  edges_.resize(static_cast<std::size_t>(count) * static_cast<std::size_t>(options_.neighbours + 1));
  counts_.assign(static_cast<std::size_t>(count), 0);
  const int window = std::max(1, static_cast<int>(std::lround(kJumpWindow_s / basis.frame_period_s())));
  auto other_half = std::async(std::launch::async, [&] { find_edges(count / 2, count, window); });
  find_edges(0, count / 2, window);
  other_half.get();
}

std::span<const FaceGraph::Edge> FaceGraph::edges(std::int32_t from) const {
  const auto at = static_cast<std::size_t>(from);
  return {edges_.data() + at * static_cast<std::size_t>(options_.neighbours + 1), counts_[at]};
}

std::int32_t FaceGraph::successor(std::int32_t face) const {
  const auto next = static_cast<std::size_t>(face) + 1;
  return next < follows_.size() && follows_[next] != 0 ? face + 1 : -1;
}

void FaceGraph::check_go_on() const {
  if (go_on_ && !go_on_()) {
    throw Error(ErrorKind::Unavailable, "broken off");
  }
}

float FaceGraph::blink_cost(std::int32_t from, std::int32_t to) const {
  return blink_weight_mm_ *
         std::max(blink_[static_cast<std::size_t>(from)], blink_[static_cast<std::size_t>(to)]);
}

float FaceGraph::cost(std::int32_t from, std::int32_t to) const {
  const std::int32_t next = successor(from) >= 0 ? successor(from) : from;
  return distance(next, to) + options_.lambda * distance(from, to) +
         (next == to ? 0.0F : blink_cost(next, to));
}

void FaceGraph::find_edges(std::int32_t begin, std::int32_t end, int window) {
  constexpr std::int32_t kBlock = 64;
  const int count = face_count();
  const Eigen::VectorXf squares = coordinates_.colwise().squaredNorm();
  std::vector<float> costs(static_cast<std::size_t>(count));
  std::vector<Edge> found;
  const auto cheaper = [](const Edge& a, const Edge& b) { return a.cost < b.cost; };
  for (std::int32_t first = begin; first < end; first += kBlock) {
    check_go_on();
    const std::int32_t rows = std::min(kBlock, end - first);
    const std::int32_t with_next = std::min(rows + 1, count - first);
    const Eigen::MatrixXf products = coordinates_.transpose() * coordinates_.middleCols(first, with_next);
    for (std::int32_t face = first; face < first + rows; ++face) {
      const bool goes_on = successor(face) >= 0;
      const std::int32_t next = goes_on ? face + 1 : face;
      const auto own = products.col(face - first);
      const auto nexts = products.col(next - first);
      Eigen::Map<Eigen::VectorXf> row(costs.data(), count);
      row = (squares.array() + squares[next] - 2 * nexts.array()).max(0.0F).sqrt() +
            options_.lambda * (squares.array() + squares[face] - 2 * own.array()).max(0.0F).sqrt();
      found.clear();
      float limit = std::numeric_limits<float>::max();
      const auto most = static_cast<std::size_t>(options_.neighbours);
      for (std::int32_t to = 0; to < count; ++to) {
        const auto at = static_cast<std::size_t>(to);
        const bool cheapest_around = costs[at] < limit && (to == 0 || costs[at] <= costs[at - 1]) &&
                                     (to + 1 == count || costs[at] < costs[at + 1]);
        if (!cheapest_around || std::abs(to - next) <= window) {
          continue;
        }
        found.push_back({to, cost(face, to)});
        std::push_heap(found.begin(), found.end(), cheaper);
        if (found.size() > most) {
          std::pop_heap(found.begin(), found.end(), cheaper);
          found.pop_back();
        }
        if (found.size() == most) {
          limit = found.front().cost;
        }
      }
      std::sort(found.begin(), found.end(), cheaper);
      Edge* out = edges_.data() + static_cast<std::size_t>(face) * (most + 1);
      const auto at = static_cast<std::size_t>(face);
      if (goes_on) {
        out[counts_[at]++] = {next, cost(face, next)};
      }
      for (const Edge& edge : found) {
        out[counts_[at]++] = edge;
      }
    }
  }
}

std::int32_t FaceGraph::nearest(const Eigen::Ref<const Eigen::VectorXf>& coordinates,
                                float& distance_mm) const {
  Eigen::Index best = 0;
  const float square = (coordinates_.colwise() - coordinates).colwise().squaredNorm().minCoeff(&best);
  distance_mm = std::sqrt(square);
  return static_cast<std::int32_t>(best);
}

FaceGraph::Path FaceGraph::describe(std::vector<std::int32_t> faces) const {
  Path path;
  path.faces = std::move(faces);
  path.direct_cost = static_cast<double>(cost(path.faces.front(), path.faces.back()));
  for (std::size_t k = 0; k + 1 < path.faces.size(); ++k) {
    const float edge = cost(path.faces[k], path.faces[k + 1]);
    path.cost += static_cast<double>(edge);
    path.jumps += successor(path.faces[k]) == path.faces[k + 1] ? 0 : 1;
    if (edge > path.worst_cost) {
      path.worst_cost = edge;
      path.worst_from = path.faces[k];
    }
  }
  return path;
}

FaceGraph::Path FaceGraph::shortest(std::int32_t from, std::int32_t to) const {
  if (from == to) {
    return describe({from});
  }
  const auto count = static_cast<std::size_t>(face_count());
  const float shut = std::max(blink_[static_cast<std::size_t>(from)], blink_[static_cast<std::size_t>(to)]);
  std::vector<double> least(count, std::numeric_limits<double>::max());
  std::vector<std::int32_t> before(count, -1);
  using Entry = std::pair<double, std::int32_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> open;
  least[static_cast<std::size_t>(from)] = 0;
  open.emplace(0.0, from);
  const auto reach = [&](std::int32_t face, std::int32_t via, double total) {
    if (total < least[static_cast<std::size_t>(face)]) {
      least[static_cast<std::size_t>(face)] = total;
      before[static_cast<std::size_t>(face)] = via;
      open.emplace(total, face);
    }
  };
  reach(to, from, static_cast<double>(cost(from, to)));
  while (!open.empty()) {
    const auto [total, face] = open.top();
    open.pop();
    if (face == to) {
      break;
    }
    if (total > least[static_cast<std::size_t>(face)]) {
      continue;
    }
    for (const Edge& edge : edges(face)) {
      const float blinking = edge.to == to ? 0.0F : blink_[static_cast<std::size_t>(edge.to)] - shut;
      reach(edge.to, face,
            total + static_cast<double>(edge.cost) +
                static_cast<double>(blink_weight_mm_ * std::max(0.0F, blinking)));
    }
  }
  std::vector<std::int32_t> faces;
  for (std::int32_t face = to; face >= 0; face = before[static_cast<std::size_t>(face)]) {
    faces.push_back(face);
  }
  std::reverse(faces.begin(), faces.end());
  return describe(std::move(faces));
}

FaceGraph::Path FaceGraph::paced(std::int32_t from, std::int32_t to, int steps, int calm_steps) const {
  const auto count = static_cast<std::size_t>(face_count());
  if (static_cast<std::int64_t>(steps) * static_cast<std::int64_t>(count) > kMostStates) {
    return shortest(from, to);
  }
  constexpr float kUnreached = std::numeric_limits<float>::max();
  const float shut = std::max(blink_[static_cast<std::size_t>(from)], blink_[static_cast<std::size_t>(to)]);
  std::vector<float> least(count, kUnreached);
  std::vector<float> next(count);
  std::vector<std::int32_t> before(static_cast<std::size_t>(steps) * count, -1);
  least[static_cast<std::size_t>(from)] = 0;
  for (int step = 0; step + 1 < steps; ++step) {
    check_go_on();
    std::fill(next.begin(), next.end(), kUnreached);
    const bool calm = step < calm_steps || step + calm_steps >= steps;
    for (std::int32_t face = 0; face < face_count(); ++face) {
      const float so_far = least[static_cast<std::size_t>(face)];
      if (so_far == kUnreached) {
        continue;
      }
      for (const Edge& edge : edges(face)) {
        const auto at = static_cast<std::size_t>(edge.to);
        const float blinking = calm ? blink_weight_mm_ * std::max(0.0F, blink_[at] - shut) : 0.0F;
        const float total = so_far + edge.cost + blinking;
        if (total < next[at]) {
          next[at] = total;
          before[static_cast<std::size_t>(step) * count + at] = face;
        }
      }
    }
    least.swap(next);
  }
  // The last step may go from anywhere.
  std::int32_t last = from;
  float best = kUnreached;
  for (std::int32_t face = 0; face < face_count(); ++face) {
    if (least[static_cast<std::size_t>(face)] < kUnreached) {
      const float total = least[static_cast<std::size_t>(face)] + cost(face, to);
      if (total < best) {
        best = total;
        last = face;
      }
    }
  }
  if (best == kUnreached) {
    return shortest(from, to);
  }
  std::vector<std::int32_t> faces{to, last};
  for (int step = steps - 2; step >= 0; --step) {
    faces.push_back(before[static_cast<std::size_t>(step) * count + static_cast<std::size_t>(faces.back())]);
  }
  std::reverse(faces.begin(), faces.end());
  return describe(std::move(faces));
}

std::vector<std::int32_t> FaceGraph::random_walk(std::int32_t first, std::size_t count, std::uint64_t seed,
                                                 double mean_run, std::size_t least_run) const {
  // The mean probability of a jump rises with sigma: halved in on.
  const double wanted = 1.0 / std::max(1.0, mean_run - static_cast<double>(least_run));
  const auto jump_part = [&](std::int32_t face, double sigma) {
    double jumps = 0;
    double all = 0;
    const float least = edges(face).empty() ? 0.0F : edges(face).front().cost;
    for (const Edge& edge : edges(face)) {
      const double weight = std::exp(-static_cast<double>(edge.cost - least) / sigma);
      all += weight;
      jumps += edge.to == successor(face) ? 0.0 : weight;
    }
    return all > 0 ? jumps / all : 0.0;
  };
  double low = 1e-4;
  double high = 1e3;
  const std::int32_t stride = std::max(1, face_count() / 2000);
  for (int halving = 0; halving < 40; ++halving) {
    const double sigma = std::sqrt(low * high);
    double sum = 0;
    int faces = 0;
    for (std::int32_t face = 0; face < face_count(); face += stride) {
      if (successor(face) >= 0) {
        sum += jump_part(face, sigma);
        ++faces;
      }
    }
    (sum < wanted * faces ? low : high) = sigma;
  }
  const double sigma = std::sqrt(low * high);

  std::mt19937_64 random(seed);
  const auto uniform = [&] { return static_cast<double>(random() >> 11U) * 0x1p-53; };
  std::vector<std::int32_t> walk{first};
  std::size_t run = 1;
  while (walk.size() < count) {
    const std::int32_t face = walk.back();
    const std::int32_t next = successor(face);
    std::int32_t chosen = next;
    if (next < 0 || run >= least_run) {
      double all = 0;
      const auto weight = [&](const Edge& edge) { return std::exp(-static_cast<double>(edge.cost) / sigma); };
      const auto choices = edges(face);
      float least = std::numeric_limits<float>::max();
      for (const Edge& edge : choices) {
        least = std::min(least, edge.cost);
      }
      const auto relative = [&](const Edge& edge) { return weight({edge.to, edge.cost - least}); };
      for (const Edge& edge : choices) {
        all += relative(edge);
      }
      double left = uniform() * all;
      chosen = choices.empty() ? 0 : choices.back().to;
      for (const Edge& edge : choices) {
        left -= relative(edge);
        if (left < 0) {
          chosen = edge.to;
          break;
        }
      }
    }
    run = chosen == next ? run + 1 : 1;
    walk.push_back(chosen);
  }
  return walk;
}

}  // namespace facet::animate
