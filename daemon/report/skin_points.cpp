#include "report/skin_points.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "render/renderer.hpp"

namespace facet::report {
namespace {

using Eigen::Vector3f;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr double kBin_mm = 0.005;
constexpr std::size_t kBins = 20'000;  // to 100 mm; what is farther counts there

double mean_of(std::span<const double> values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

/// Of the regression of values on times; NaN where all times are one.
double slope_of(const std::vector<double>& times, const std::vector<double>& values) {
  const double time = mean_of(times);
  const double value = mean_of(values);
  double product = 0;
  double square = 0;
  for (std::size_t k = 0; k < times.size(); ++k) {
    product += (times[k] - time) * (values[k] - value);
    square += (times[k] - time) * (times[k] - time);
  }
  return square > 0 ? product / square : kNone;
}

}  // namespace

bool SkinPointSum::has_topology_of(const simulation::TruthMesh& truth) const {
  return truth.vertices_mm.cols() == truth_vertices_ && truth.triangles.cols() == triangles_.cols() &&
         truth.triangles == triangles_;
}

void SkinPointSum::pin(const Reconstruction& reconstruction, const Comparison& comparison) {
  pins_.assign(static_cast<std::size_t>(reconstruction.vertices_mm.cols()), {});
  for (std::size_t k = 0; k < reconstruction.measured.size(); ++k) {
    pins_[static_cast<std::size_t>(reconstruction.measured[k])] = {comparison.triangle[k],
                                                                   comparison.barycentric[k]};
  }
}

void SkinPointSum::add(std::uint64_t subject, double time_s, const Reconstruction& reconstruction,
                       const Comparison& comparison, const simulation::TruthMesh& truth,
                       const std::function<void(std::int32_t vertex, double mm)>& each) {
  if (topology_changes_) {
    return;
  }
  if (truth_vertices_ == 0) {
    triangles_ = truth.triangles;
    truth_vertices_ = truth.vertices_mm.cols();
    histogram_.assign(kBins, 0);
  } else if (!has_topology_of(truth)) {
    topology_changes_ = true;
    return;
  }
  if (subject != subject_ || pins_.empty()) {
    subject_ = subject;
    pin(reconstruction, comparison);
    return;
  }
  double sum_mm = 0;
  std::uint64_t count = 0;
  for (const std::int32_t vertex : reconstruction.measured) {
    const Pin& pin = pins_[static_cast<std::size_t>(vertex)];
    if (pin.triangle < 0) {
      continue;
    }
    const Vector3f at =
        comparison.truth_from_reconstruction * Vector3f(reconstruction.vertices_mm.col(vertex));
    const Vector3f from =
        at - render::interpolate(truth.triangles, pin.triangle, pin.barycentric, truth.vertices_mm);
    const Vector3f normal =
        render::interpolate(truth.triangles, pin.triangle, pin.barycentric, truth.normals).normalized();
    const auto distance_mm = static_cast<double>(from.norm());
    sum_mm += distance_mm;
    sum_tangential_mm_ += static_cast<double>((from - from.dot(normal) * normal).norm());
    ++count;
    ++histogram_[std::min(static_cast<std::size_t>(distance_mm / kBin_mm), kBins - 1)];
    if (each) {
      each(vertex, distance_mm);
    }
  }
  if (count > 0) {
    count_ += count;
    sum_mm_ += sum_mm;
    frame_times_s_.push_back(time_s);
    frame_means_mm_.push_back(sum_mm / static_cast<double>(count));
  }
}

std::string SkinPointSum::missing() const {
  if (topology_changes_) {
    return "the truth's triangles change from frame to frame";
  }
  return count_ == 0 ? "no vertex is measured in two frames" : "";
}

SkinPointFigures SkinPointSum::figures() const {
  if (!missing().empty()) {
    return {kNone, kNone, kNone, kNone, kNone, kNone, 0};
  }
  SkinPointFigures figures;
  const auto count = static_cast<double>(count_);
  figures.points = count_;
  figures.mean_mm = sum_mm_ / count;
  figures.tangential_mm = sum_tangential_mm_ / count;
  std::uint64_t below = 0;
  std::size_t bin = 0;
  constexpr double kPart = 0.95;
  while (bin + 1 < kBins && static_cast<double>(below + histogram_[bin]) < kPart * count) {
    below += histogram_[bin++];
  }
  figures.p95_mm = kBin_mm * (static_cast<double>(bin) + 0.5);
  const std::size_t fifth = frame_means_mm_.size() / 5;
  const std::span<const double> means(frame_means_mm_);
  figures.first_fifth_mm = fifth > 0 ? mean_of(means.first(fifth)) : kNone;
  figures.last_fifth_mm = fifth > 0 ? mean_of(means.last(fifth)) : kNone;
  constexpr double kSlopeTime_s = 10;
  figures.slope_mm_per_10_s = kSlopeTime_s * slope_of(frame_times_s_, frame_means_mm_);
  return figures;
}

}  // namespace facet::report
