#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "animate/region_metric.hpp"
#include "animate/take_basis.hpp"

namespace facet::animate {

struct GraphOptions {
  float lambda = 0.3F;  ///< of [SF04 eq. 23]: what a large step costs, whether or not the take makes it
  int neighbours = 12;  ///< jumps kept per face, the cheapest
};

/// Asked now and then by what takes long, from two threads at once; false breaks it off, with
/// Error(Unavailable).
using GoOn = std::function<bool()>;

/// The captured faces of one region as a graph [SF04 sec. 5.1]. The cost of going from face
/// i to face j is w(i, j) = dist(M_i+1, M_j) + lambda dist(M_i, M_j) [SF04 eq. 23], dist the region's metric;
/// a face that the take does not go on from counts as its own successor. A jump while lids are down costs
/// extra, where the take knows of blinks. Kept per face: the step to its successor and the cheapest jumps,
/// each the cheapest of its neighbourhood in time. Faces are numbered as TakeBasis::frames. Immutable; any
/// thread.
class FaceGraph {
 public:
  struct Edge {
    std::int32_t to = 0;
    float cost = 0;  ///< mm
  };

  /// Compares every face with every other one, in blocks, on two threads. go_on is asked here and by paced().
  FaceGraph(const TakeBasis& basis, const RegionMetric& metric, GraphOptions options = {}, GoOn go_on = {});

  int face_count() const { return static_cast<int>(coordinates_.cols()); }
  std::span<const Edge> edges(std::int32_t from) const;
  /// The next captured face; -1 where the take does not go on.
  std::int32_t successor(std::int32_t face) const;
  float distance(std::int32_t a, std::int32_t b) const {
    return (coordinates_.col(a) - coordinates_.col(b)).norm();
  }
  /// w(i, j), whether or not the edge is kept; mm.
  float cost(std::int32_t from, std::int32_t to) const;
  /// The captured face nearest to a face given by its coordinates (RegionMetric), and how far it is, mm.
  std::int32_t nearest(const Eigen::Ref<const Eigen::VectorXf>& coordinates, float& distance_mm) const;

  struct Path {
    std::vector<std::int32_t> faces;  ///< first and last are those asked for
    double cost = 0;                  ///< sum of its edges', mm
    double direct_cost = 0;           ///< w(first, last): what linear interpolation amounts to, mm
    float worst_cost = 0;             ///< of its most expensive edge
    std::int32_t worst_from = 0;      ///< where that edge begins
    int jumps = 0;
  };
  /// The cheapest path [Dij59], never dearer than the direct edge; passing a blink costs extra where
  /// neither end is one.
  Path shortest(std::int32_t from, std::int32_t to) const;
  /// The cheapest path of exactly `steps` edges, steps >= 1: one that takes a given time at the captured
  /// speed. It waits by going round among faces alike. Blinks cost extra within `calm_steps` of its ends.
  /// Memory: 4 bytes per step and face; falls back to shortest() beyond kMostStates of them.
  Path paced(std::int32_t from, std::int32_t to, int steps, int calm_steps) const;

  /// A walk of `count` faces with P_ij proportional to exp(-w(i, j) / sigma) over the kept edges, sigma such
  /// that runs between jumps last mean_run faces on average; none is shorter than least_run except where the
  /// take ends. The same for a seed on every machine.
  std::vector<std::int32_t> random_walk(std::int32_t first, std::size_t count, std::uint64_t seed,
                                        double mean_run, std::size_t least_run) const;

  static constexpr std::int64_t kMostStates = 64'000'000;

 private:
  void check_go_on() const;
  float blink_cost(std::int32_t from, std::int32_t to) const;
  void find_edges(std::int32_t begin, std::int32_t end, int window);
  Path describe(std::vector<std::int32_t> faces) const;

  GraphOptions options_;
  GoOn go_on_;
  Eigen::MatrixXf coordinates_;
  std::vector<float> blink_;
  std::vector<std::uint8_t> follows_;
  float blink_weight_mm_ = 0;
  std::vector<Edge> edges_;           ///< [face_count][neighbours + 1]
  std::vector<std::uint8_t> counts_;  ///< edges of each face
};

}  // namespace facet::animate
