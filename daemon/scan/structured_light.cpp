#include "scan/structured_light.hpp"

#include <fmt/format.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>

#include "facet/error.hpp"
#include "maths/statistics.hpp"
#include "stereo/islands.hpp"

namespace facet::scan {
namespace {

using Eigen::Vector2d;
using Eigen::Vector2f;
using Eigen::Vector3d;

constexpr float kPi = std::numbers::pi_v<float>;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kHalfConfidence_mm = 0.1F;  // standard deviation of a depth that counts half

/// A field seen through another camera's pixels, [height][width]; NaN where it is not known.
struct Sampled {
  std::vector<float> phase;
  std::vector<float> sigma;
};

/// Bilinear; nothing where one of the four pixels has no phase or they are of two surfaces.
Sampled sample(const PhaseField& field, const std::vector<Vector2f>& sources) {
  Sampled out;
  out.phase.assign(sources.size(), kNan);
  out.sigma.assign(sources.size(), 0);
  const auto width = static_cast<std::size_t>(field.width_px);
  for (std::size_t at = 0; at < sources.size(); ++at) {
    const float x = sources[at].x();
    const float y = sources[at].y();
    if (!(x >= 0 && y >= 0 && x <= static_cast<float>(field.width_px - 1) &&
          y <= static_cast<float>(field.height_px - 1))) {
      continue;
    }
    const int left = std::clamp(static_cast<int>(x), 0, std::max(field.width_px - 2, 0));
    const int top = std::clamp(static_cast<int>(y), 0, std::max(field.height_px - 2, 0));
    const float u = x - static_cast<float>(left);
    const float v = y - static_cast<float>(top);
    const std::size_t corner = static_cast<std::size_t>(top) * width + static_cast<std::size_t>(left);
    const std::array<std::size_t, 4> at_corner{
        corner, corner + (field.width_px > 1 ? 1 : 0), corner + (field.height_px > 1 ? width : 0),
        corner + (field.width_px > 1 ? 1 : 0) + (field.height_px > 1 ? width : 0)};
    const std::array<float, 4> weight{(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v};
    float phase = 0;
    float sigma = 0;
    float least = std::numeric_limits<float>::max();
    float most = std::numeric_limits<float>::lowest();
    bool known = true;
    for (std::size_t k = 0; k < 4; ++k) {
      const float value = field.phase_rad[at_corner[k]];
      known = known && !std::isnan(value);
      phase += weight[k] * value;
      sigma += weight[k] * field.sigma_rad[at_corner[k]];
      least = std::min(least, value);
      most = std::max(most, value);
    }
    if (known && most - least < kPi) {
      out.phase[at] = phase;
      out.sigma[at] = sigma;
    }
  }
  return out;
}

bool coded(const PhaseField& field) {
  return !field.phase_rad.empty();
}

void require_size(const DecodedView& view, const capture::Lens& lens, const std::string& name) {
  if (view.width_px != lens.width_px || view.height_px != lens.height_px) {
    throw Error(ErrorKind::Usage,
                fmt::format("camera '{}': decoded pictures of {}x{} px, the rig says {}x{}", name,
                            view.width_px, view.height_px, lens.width_px, lens.height_px));
  }
}

const capture::RigCamera& camera_of(const capture::Rig& rig, std::size_t index) {
  if (index >= rig.cameras.size()) {
    throw Error(ErrorKind::Usage,
                fmt::format("there is no camera {} in a rig of {}", index, rig.cameras.size()));
  }
  return rig.cameras[index];
}

capture::DepthMap empty_map(const capture::Lens& lens) {
  capture::DepthMap map;
  map.width_px = lens.width_px;
  map.height_px = lens.height_px;
  map.lens = lens;
  const std::size_t count =
      static_cast<std::size_t>(lens.width_px) * static_cast<std::size_t>(lens.height_px);
  map.depth_mm.assign(count, 0);
  map.sigma_mm.assign(count, 0);
  map.confidence.assign(count, 0);
  return map;
}

bool in_range(double depth, const stereo::DepthRange& depths) {
  return depth >= static_cast<double>(depths.nearest_mm) && depth <= static_cast<double>(depths.farthest_mm);
}

float median_of(std::vector<float>& values) {
  return values.empty() ? 0 : maths::median_of(values);
}

/// At an edge, a pixel or two see both surfaces and lie between them: no runs of so few pixels stay.
void drop_thin(capture::DepthMap& map, const StructuredLightOptions& options) {
  const auto width = static_cast<std::size_t>(map.width_px);
  const auto height = static_cast<std::size_t>(map.height_px);
  const auto sweep = [&](std::size_t lines, std::size_t line_step, std::size_t count, std::size_t step) {
    for (std::size_t line = 0; line < lines; ++line) {
      std::size_t begin = 0;  // of a run
      for (std::size_t k = 0; k <= count; ++k) {
        const std::size_t at = line * line_step + k * step;
        const bool joined = k > begin && k < count && map.depth_mm[at] > 0 && map.depth_mm[at - step] > 0 &&
                            std::abs(map.depth_mm[at] - map.depth_mm[at - step]) <= options.break_mm;
        if (joined) {
          continue;
        }
        if (k - begin < static_cast<std::size_t>(std::max(options.least_width_px, 0))) {
          for (std::size_t dropped = begin; dropped < k; ++dropped) {
            map.depth_mm[line * line_step + dropped * step] = 0;
          }
        }
        begin = k;
      }
    }
  };
  sweep(height, width, width, 1);
  sweep(width, 1, height, width);
}

/// What is left after sigma and size of pieces; confidences.
void finish(const StructuredLightOptions& options, StructuredDepth& out, std::vector<float>& epipolar) {
  capture::DepthMap& map = out.map;
  for (std::size_t at = 0; at < map.depth_mm.size(); ++at) {
    if (!(map.sigma_mm[at] <= options.most_sigma_mm)) {
      map.depth_mm[at] = 0;
    }
  }
  drop_thin(map, options);
  stereo::Islands(map.width_px, map.height_px)
      .drop(std::vector<float>(map.depth_mm), options.break_mm, options.least_island_px, map.depth_mm);
  for (std::size_t at = 0; at < map.depth_mm.size(); ++at) {
    if (map.depth_mm[at] > 0) {
      const float relative = map.sigma_mm[at] / kHalfConfidence_mm;
      map.confidence[at] = 1 / (1 + relative * relative);
    } else {
      map.sigma_mm[at] = 0;
    }
  }
  out.epipolar_count = epipolar.size();
  out.epipolar_px = median_of(epipolar);
}

/// A place in the right picture's row with the wanted phase.
struct Crossing {
  double x = 0;      ///< px
  double sigma = 0;  ///< px, of both pictures' noise
  int count = 0;     ///< of crossings that are not one
};

/// left  phase and sigma; right: of one row, [width]; from, to: columns of the right picture
Crossing find_crossing(float left_phase, float left_sigma, const float* right_phase, const float* right_sigma,
                       int from, int to) {
  Crossing found;
  double sum = 0;
  int joined = 0;
  for (int x = from; x < to; ++x) {
    const float here = right_phase[x] - left_phase;
    const float next = right_phase[x + 1] - left_phase;
    // A crossing at `next` is found by the next step. NaN compares false.
    if (!((here <= 0 && next > 0) || (here >= 0 && next < 0)) || !(std::abs(next - here) < kPi)) {
      continue;
    }
    const auto step = static_cast<double>(next - here);
    const double part = static_cast<double>(-here) / step;
    const double at = x + part;
    const auto square = [](double value) { return value * value; };
    const double variance = square(static_cast<double>(left_sigma)) +
                            square((1 - part) * static_cast<double>(right_sigma[x])) +
                            square(part * static_cast<double>(right_sigma[x + 1]));
    // Where noise makes the phase turn back, one place is crossed three times.
    if (found.count > 0 && at - sum / joined <= 1.5) {
      sum += at;
      ++joined;
    } else {
      sum = at;
      joined = 1;
      ++found.count;
    }
    found.x = sum / joined;
    found.sigma = std::sqrt(variance) / std::abs(step);
  }
  return found;
}

/// Where two lines of sight come closest, along the first one; nothing where that is not in front.
std::optional<double> meeting_mm(const capture::Lens& one, const capture::Lens& other) {
  const auto middle = [](const capture::Lens& lens) -> std::optional<Vector3d> {
    const auto seen = lens.direction({(lens.width_px - 1) / 2.0, (lens.height_px - 1) / 2.0});
    return seen ? std::optional<Vector3d>((lens.camera_from_rig.linear().transpose() * *seen).normalized())
                : std::nullopt;
  };
  const auto a = middle(one);
  const auto b = middle(other);
  if (!a || !b) {
    return std::nullopt;
  }
  const double cosine = a->dot(*b);
  constexpr double kLeastAngle = 0.03;  // rad; what is nearer to parallel meets anywhere
  if (!(1 - cosine * cosine > kLeastAngle * kLeastAngle)) {
    return std::nullopt;
  }
  const Vector3d between = other.centre_mm() - one.centre_mm();
  const double along = (between.dot(*a) - cosine * between.dot(*b)) / (1 - cosine * cosine);
  return along > 0 ? std::optional(along) : std::nullopt;
}

stereo::DepthRange expected_depths(const capture::Lens& one, const capture::Lens& other) {
  if (const auto meeting = meeting_mm(one, other)) {
    return {static_cast<float>(0.6 * *meeting), static_cast<float>(3 * *meeting)};
  }
  const double baseline = (other.centre_mm() - one.centre_mm()).norm();
  return {static_cast<float>(3 * baseline), static_cast<float>(60 * baseline)};
}

stereo::DepthRange depths_of(const capture::DepthMap& map, const stereo::DepthRange& expected) {
  std::vector<float> depths;
  std::copy_if(map.depth_mm.begin(), map.depth_mm.end(), std::back_inserter(depths),
               [](float depth) { return depth > 0; });
  constexpr std::size_t kEnough = 200;
  if (depths.size() < kEnough) {
    return expected;
  }
  std::sort(depths.begin(), depths.end());
  const float nearest = depths[depths.size() / 200];
  const float farthest = depths[depths.size() - 1 - depths.size() / 200];
  const float margin = 0.25F * (farthest - nearest) + 0.01F * farthest;
  return {std::max(nearest - margin, 0.5F * nearest), farthest + margin};
}

StructuredLightOptions looking_everywhere(const stereo::DepthRange& depths) {
  StructuredLightOptions options;
  options.depths = depths;
  options.most_sigma_mm = std::numeric_limits<float>::max();
  options.break_mm = 0.01F * depths.nearest_mm;
  return options;
}

/// An axis that is coded.
struct ProjectorAxis {
  Eigen::Index component = 0;  ///< of the projector's pixel
  const PhaseField* field = nullptr;
  double px_per_rad = 0;  ///< of the projector
  Sampled sampled;
};

std::vector<ProjectorAxis> coded_axes(const DecodedView& view, const capture::Lens& light) {
  std::vector<ProjectorAxis> axes;
  for (const bool rows : {false, true}) {
    const PhaseField& field = rows ? view.rows : view.columns;
    if (coded(field)) {
      if (!(field.periods > 0)) {
        throw Error(
            ErrorKind::Usage,
            "depth from camera and projector needs the numbers of periods over the projector's picture: "
            "phase:NxF");
      }
      axes.push_back({rows ? 1 : 0,
                      &field,
                      (rows ? light.height_px : light.width_px) / (2 * std::numbers::pi * field.periods),
                      {}});
    }
  }
  return axes;
}

/// The lens without its distortion, with pictures of another size where one is given (not 0).
capture::Lens undistorted(const capture::Lens& seeing, int width_px, int height_px) {
  capture::Lens lens = seeing;
  lens.distortion = {};
  if (width_px > 0 && height_px > 0) {
    const double across = static_cast<double>(width_px) / lens.width_px;
    const double down = static_cast<double>(height_px) / lens.height_px;
    lens.fx_px *= across;
    lens.fy_px *= down;
    lens.cx_px = (lens.cx_px + 0.5) * across - 0.5;
    lens.cy_px = (lens.cy_px + 0.5) * down - 0.5;
    lens.width_px = width_px;
    lens.height_px = height_px;
  }
  return lens;
}

/// Where a line of sight meets what the projector's pixel lights.
struct Meeting {
  double depth_mm = 0;
  double weight = 0;  ///< 1 / mm^2
  Vector2d along;     ///< projector's pixels per mm of depth
  Vector2d off;       ///< projector's pixels that are left
};

/// Gauss-Newton along the line of sight: the sum over the axes of ((pixel - wanted) / sigma)^2. Nothing where
/// it does not settle. at: the camera's pixel; start_mm: where to begin.
std::optional<Meeting> meet(const capture::Lens& light, const std::vector<ProjectorAxis>& axes,
                            std::size_t at, const Vector3d& centre, const Vector3d& direction,
                            double start_mm) {
  constexpr int kMostSteps = 20;
  constexpr double kEnough_mm = 1e-5;
  Meeting met{start_mm, 0, {0, 0}, {0, 0}};
  for (int step = 0; step < kMostSteps; ++step) {
    const double small = 1e-5 * met.depth_mm;
    const auto pixel = light.project(centre + met.depth_mm * direction);
    const auto beside = light.project(centre + (met.depth_mm + small) * direction);
    if (!pixel || !beside) {
      return std::nullopt;
    }
    met.along = (*beside - *pixel) / small;
    met.weight = 0;
    double pull = 0;
    for (const ProjectorAxis& axis : axes) {
      const Eigen::Index k = axis.component;
      const double wanted =
          (static_cast<double>(axis.sampled.phase[at]) - axis.field->start_rad) * axis.px_per_rad - 0.5;
      const double sigma = static_cast<double>(axis.sampled.sigma[at]) * axis.px_per_rad;
      met.off[k] = wanted - (*pixel)[k];
      met.weight += met.along[k] * met.along[k] / (sigma * sigma);
      pull += met.along[k] * met.off[k] / (sigma * sigma);
    }
    if (!(met.weight > 0)) {
      return std::nullopt;
    }
    const double move = std::clamp(pull / met.weight, -0.5 * met.depth_mm, 0.5 * met.depth_mm);
    met.depth_mm += move;
    if (std::abs(move) < kEnough_mm) {
      return met;
    }
  }
  return std::nullopt;
}

}  // namespace

StructuredDepth match_phases(const capture::Rig& rig, const capture::StereoPair& pair,
                             const DecodedView& left, const DecodedView& right,
                             const StructuredLightOptions& options) {
  const capture::RigCamera& left_camera = camera_of(rig, pair.left);
  const capture::RigCamera& right_camera = camera_of(rig, pair.right);
  require_size(left, left_camera.lens, left_camera.name);
  require_size(right, right_camera.lens, right_camera.name);
  const stereo::Rectification rectification(
      rig, pair, options.depths, options.width_px > 0 ? options.width_px : left_camera.lens.width_px,
      options.height_px > 0 ? options.height_px : left_camera.lens.height_px);
  const bool has_columns = coded(left.columns) && coded(right.columns);
  const bool has_rows = coded(left.rows) && coded(right.rows);
  if (!has_columns && !has_rows) {
    throw Error(ErrorKind::Usage, fmt::format("cameras '{}' and '{}' have no coded axis in common",
                                              left_camera.name, right_camera.name));
  }
  const std::vector<Vector2f> left_sources = rectification.left_sources();
  const std::vector<Vector2f> right_sources = rectification.right_sources();
  const Sampled left_phase = sample(has_columns ? left.columns : left.rows, left_sources);
  const Sampled right_phase = sample(has_columns ? right.columns : right.rows, right_sources);
  const bool checks = has_columns && has_rows;
  const Sampled left_check = checks ? sample(left.rows, left_sources) : Sampled{};
  const Sampled right_check = checks ? sample(right.rows, right_sources) : Sampled{};

  StructuredDepth out;
  out.map = empty_map(rectification.left());
  std::vector<float> epipolar;
  const int width = out.map.width_px;
  const int height = out.map.height_px;
  for (int y = 0; y < height; ++y) {
    const std::size_t first = static_cast<std::size_t>(y) * static_cast<std::size_t>(width);
    for (int x = 0; x < width; ++x) {
      const std::size_t at = first + static_cast<std::size_t>(x);
      if (std::isnan(left_phase.phase[at])) {
        continue;
      }
      const int from = std::max(0, x - rectification.most_disparity_px());
      const int to = std::min(width - 1, x - rectification.least_disparity_px() + 1);
      const Crossing match = find_crossing(left_phase.phase[at], left_phase.sigma[at],
                                           &right_phase.phase[first], &right_phase.sigma[first], from, to);
      if (match.count != 1) {
        out.ambiguous += match.count > 1 ? 1 : 0;
        continue;
      }
      const double depth = rectification.depth_mm(x - match.x);
      if (!in_range(depth, options.depths)) {
        continue;
      }
      if (checks) {
        const std::size_t there = first + static_cast<std::size_t>(std::lround(match.x));
        const std::size_t above = y > 0 ? there - static_cast<std::size_t>(width) : there;
        const std::size_t below = y + 1 < height ? there + static_cast<std::size_t>(width) : there;
        const float off = right_check.phase[there] - left_check.phase[at];
        const float rise = (right_check.phase[below] - right_check.phase[above]) /
                           static_cast<float>((below - above) / static_cast<std::size_t>(width));
        const float off_px = std::abs(off / rise);
        if (!(off_px <= options.most_disagreement_px)) {  // true for NaN: it can't be checked
          ++out.disagreeing;
          continue;
        }
        epipolar.push_back(off_px);
      }
      out.map.depth_mm[at] = static_cast<float>(depth);
      out.map.sigma_mm[at] = static_cast<float>(match.sigma * rectification.depth_per_px_mm(depth));
    }
  }
  finish(options, out, epipolar);
  return out;
}

StructuredDepth triangulate_phases(const capture::Rig& rig, std::size_t camera, std::size_t projector,
                                   const DecodedView& view, const StructuredLightOptions& options) {
  const capture::RigCamera& seeing = camera_of(rig, camera);
  require_size(view, seeing.lens, seeing.name);
  if (projector >= rig.projectors.size()) {
    throw Error(ErrorKind::Usage,
                fmt::format("there is no projector {} in a rig of {}", projector, rig.projectors.size()));
  }
  if (!(options.depths.nearest_mm > 0 && options.depths.nearest_mm < options.depths.farthest_mm)) {
    throw Error(ErrorKind::Usage, fmt::format("depths from {} to {} mm are no range",
                                              options.depths.nearest_mm, options.depths.farthest_mm));
  }
  const capture::Lens& light = rig.projectors[projector].lens;
  std::vector<ProjectorAxis> axes = coded_axes(view, light);
  if (axes.empty()) {
    throw Error(ErrorKind::Usage, fmt::format("camera '{}' has no coded axis", seeing.name));
  }
  const capture::Lens lens = undistorted(seeing.lens, options.width_px, options.height_px);
  StructuredDepth out;
  out.map = empty_map(lens);
  const Vector3d centre = lens.centre_mm();
  const Eigen::Matrix3d rig_from_camera = lens.camera_from_rig.linear().transpose();
  const auto direction_of = [&](int x, int y) -> Vector3d {
    return rig_from_camera * Vector3d((x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px, 1);
  };
  std::vector<Vector2f> sources;
  sources.reserve(out.map.depth_mm.size());
  for (int y = 0; y < lens.height_px; ++y) {
    for (int x = 0; x < lens.width_px; ++x) {
      const auto pixel = seeing.lens.project(centre + direction_of(x, y));
      sources.emplace_back(pixel ? Vector2f(pixel->cast<float>()) : Vector2f(-1, -1));
    }
  }
  for (ProjectorAxis& axis : axes) {
    axis.sampled = sample(*axis.field, sources);
  }
  const double middle = 2 / (1 / static_cast<double>(options.depths.nearest_mm) +
                             1 / static_cast<double>(options.depths.farthest_mm));
  std::vector<float> epipolar;
  double start = middle;
  for (int y = 0; y < lens.height_px; ++y) {
    for (int x = 0; x < lens.width_px; ++x) {
      const std::size_t at =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(lens.width_px) + static_cast<std::size_t>(x);
      const bool known = std::all_of(axes.begin(), axes.end(), [&](const ProjectorAxis& axis) {
        return !std::isnan(axis.sampled.phase[at]);
      });
      if (!known) {
        continue;
      }
      const auto met = meet(light, axes, at, centre, direction_of(x, y), start);
      if (!met || !in_range(met->depth_mm, options.depths)) {
        continue;
      }
      if (axes.size() == 2) {
        const double across =
            (met->along.x() * met->off.y() - met->along.y() * met->off.x()) / met->along.norm();
        if (std::abs(across) > static_cast<double>(options.most_disagreement_px)) {
          ++out.disagreeing;
          continue;
        }
        epipolar.push_back(static_cast<float>(std::abs(across)));
      }
      start = met->depth_mm;
      out.map.depth_mm[at] = static_cast<float>(met->depth_mm);
      out.map.sigma_mm[at] = static_cast<float>(1 / std::sqrt(met->weight));
    }
  }
  finish(options, out, epipolar);
  return out;
}

stereo::DepthRange find_depths(const capture::Rig& rig, const capture::StereoPair& pair,
                               const DecodedView& left, const DecodedView& right) {
  const stereo::DepthRange expected =
      expected_depths(camera_of(rig, pair.left).lens, camera_of(rig, pair.right).lens);
  return depths_of(match_phases(rig, pair, left, right, looking_everywhere(expected)).map, expected);
}

stereo::DepthRange find_depths(const capture::Rig& rig, std::size_t camera, std::size_t projector,
                               const DecodedView& view) {
  if (projector >= rig.projectors.size()) {
    throw Error(ErrorKind::Usage,
                fmt::format("there is no projector {} in a rig of {}", projector, rig.projectors.size()));
  }
  const stereo::DepthRange expected =
      expected_depths(camera_of(rig, camera).lens, rig.projectors[projector].lens);
  return depths_of(triangulate_phases(rig, camera, projector, view, looking_everywhere(expected)).map,
                   expected);
}

}  // namespace facet::scan
