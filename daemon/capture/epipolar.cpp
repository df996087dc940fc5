#include "capture/epipolar.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "maths/statistics.hpp"

namespace facet::capture {
namespace {

double quantile(std::vector<double>& values, double part) {
  return values.empty() ? 0 : maths::quantile_of(values, part);
}

struct Agreement {
  std::size_t matches = 0;
  double median_px = 0;
  double p95_px = 0;
  double part_in_front = 0;
};

Agreement agreement_of(const Lens& left, const Lens& right, std::span<const PointMatch> matches,
                       bool other_way_round) {
  std::vector<double> errors;
  std::size_t in_front = 0;
  for (const PointMatch& given : matches) {
    const PointMatch match = other_way_round ? PointMatch{given.right_px, given.left_px} : given;
    if (const std::optional<double> error = epipolar_error_px(left, right, match)) {
      errors.push_back(std::abs(*error));
      in_front += triangulate_mm(left, right, match) ? 1 : 0;
    }
  }
  const double count = static_cast<double>(std::max<std::size_t>(errors.size(), 1));
  return {errors.size(), quantile(errors, 0.5), quantile(errors, 0.95),
          static_cast<double>(in_front) / count};
}

}  // namespace

std::optional<double> epipolar_error_px(const Lens& left, const Lens& right, const PointMatch& match) {
  const std::optional<Eigen::Vector3d> a = left.direction(match.left_px);
  const std::optional<Eigen::Vector3d> b = right.direction(match.right_px);
  if (!a || !b) {
    return std::nullopt;
  }
  // b^T E a = 0 with E = [t]x R [LH81].
  const Eigen::Isometry3d right_from_left = right.camera_from_rig * left.camera_from_rig.inverse();
  const Eigen::Vector3d t = right_from_left.translation();
  const Eigen::Vector3d line_in_right = t.cross(right_from_left.linear() * *a);
  const Eigen::Vector3d line_in_left = right_from_left.linear().transpose() * b->cross(t);
  const double miss = b->dot(line_in_right);
  const double slope =
      std::sqrt(line_in_right.head<2>().squaredNorm() + line_in_left.head<2>().squaredNorm());
  const double focal_px = 0.25 * (left.fx_px + left.fy_px + right.fx_px + right.fy_px);
  return slope > 0 ? miss / slope * focal_px : 0;
}

std::optional<Eigen::Vector3d> triangulate_mm(const Lens& left, const Lens& right, const PointMatch& match) {
  const std::optional<Eigen::Vector3d> a = left.direction(match.left_px);
  const std::optional<Eigen::Vector3d> b = right.direction(match.right_px);
  if (!a || !b) {
    return std::nullopt;
  }
  const Eigen::Vector3d from = left.centre_mm();
  const Eigen::Vector3d to = right.centre_mm();
  const Eigen::Vector3d u = left.camera_from_rig.linear().transpose() * *a;
  const Eigen::Vector3d v = right.camera_from_rig.linear().transpose() * *b;
  // The s and t for which from + s u and to + t v are closest.
  Eigen::Matrix2d normal;
  normal << u.dot(u), -u.dot(v), -u.dot(v), v.dot(v);
  const Eigen::Vector2d right_side(u.dot(to - from), -v.dot(to - from));
  const double determinant = normal.determinant();
  if (!(determinant > 1e-12 * u.squaredNorm() * v.squaredNorm())) {
    return std::nullopt;
  }
  const Eigen::Vector2d depth = normal.inverse() * right_side;
  if (!(depth.x() > 0 && depth.y() > 0)) {
    return std::nullopt;
  }
  return 0.5 * (from + depth.x() * u + to + depth.y() * v);
}

PairCheck check_pair(const RigCamera& left, const RigCamera& right, std::span<const PointMatch> matches,
                     const PairCheckOptions& options) {
  const Agreement as_given = agreement_of(left.lens, right.lens, matches, false);
  PairCheck check;
  check.matches = as_given.matches;
  check.median_px = as_given.median_px;
  check.p95_px = as_given.p95_px;
  check.part_in_front = as_given.part_in_front;
  if (as_given.matches < std::max<std::size_t>(options.least_matches, 1)) {
    check.message = fmt::format("cameras '{}' and '{}': only {} matched points, {} are needed to check them",
                                left.name, right.name, as_given.matches, options.least_matches);
    return check;
  }
  const auto fits = [&](const Agreement& one) {
    return one.median_px <= options.most_median_px && one.part_in_front > 0.5;
  };
  // Cameras that verge on the subject see it nearly alike the other way round, but not as well.
  const Agreement swapped = agreement_of(left.lens, right.lens, matches, true);
  const bool other_way_round =
      fits(swapped) && (!fits(as_given) || swapped.median_px < 0.5 * as_given.median_px);
  if (fits(as_given) && !other_way_round) {
    check.verdict = PairVerdict::Fine;
    check.message = fmt::format("cameras '{}' and '{}': epipolar error {:.2f} px (median of {} points)",
                                left.name, right.name, check.median_px, check.matches);
    return check;
  }
  if (other_way_round) {
    check.verdict = PairVerdict::Swapped;
    check.message = fmt::format(
        "cameras '{}' and '{}' are swapped: their pictures fit the rig file the other way round (epipolar "
        "error {:.2f} px, {:.0f} % of the points in front of the cameras; as they are {:.2f} px, {:.0f} %). "
        "Exchange the two cameras in the configuration",
        left.name, right.name, swapped.median_px, 100 * swapped.part_in_front, check.median_px,
        100 * check.part_in_front);
    return check;
  }
  check.verdict = PairVerdict::Misaligned;
  check.message = fmt::format(
      "cameras '{}' and '{}' do not fit the rig file: epipolar error {:.2f} px (median of {} points; {:.2f} "
      "px are allowed), {:.0f} % of the points in front of both. A camera was moved, or the rig file is "
      "another rig's: calibrate again",
      left.name, right.name, check.median_px, check.matches, options.most_median_px,
      100 * check.part_in_front);
  return check;
}

}  // namespace facet::capture
