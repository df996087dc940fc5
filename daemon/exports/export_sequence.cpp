#include "exports/export_sequence.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "facet/error.hpp"
#include "mesh/arkit.hpp"

namespace facet::exports {
namespace {

/// The whole rate, or the one of television (29.97), that a measured one may be where its ends are known to a
/// millisecond, as most files tell them; else the measured one.
double usual_rate_hz(double measured_hz, double elapsed_s) {
  constexpr double kTelevision = 1.001;
  const double whole = std::round(measured_hz);
  const double television = std::round(measured_hz * kTelevision) / kTelevision;
  const double nearest =
      std::abs(whole - measured_hz) <= std::abs(television - measured_hz) ? whole : television;
  const double uncertainty = 1.5e-3 / elapsed_s;
  return nearest > 0 && std::abs(nearest / measured_hz - 1) <= uncertainty ? nearest : measured_hz;
}

}  // namespace

Timeline make_timeline(std::span<const take::FrameEntry> entries, const std::filesystem::path& take) {
  if (entries.empty()) {
    throw Error(ErrorKind::Internal, "export: a timeline of no frames");
  }
  Timeline timeline;
  timeline.first_ns = entries.front().timestamp_ns;
  timeline.sequences.push_back(entries.front().sequence);
  for (std::size_t i = 1; i < entries.size(); ++i) {
    const take::FrameEntry& before = entries[i - 1];
    const take::FrameEntry& now = entries[i];
    const std::int64_t elapsed_ns = now.media_time_ns - before.media_time_ns;
    if (now.sequence <= before.sequence || elapsed_ns <= 0) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("{}: frame {} does not come after frame {}; export them apart (--frames)",
                              take.string(), now.sequence, before.sequence));
    }
    timeline.sequences.push_back(now.sequence);
  }
  if (entries.size() > 1) {
    const double elapsed_s =
        1e-9 * static_cast<double>(entries.back().media_time_ns - entries.front().media_time_ns);
    timeline.rate_hz = usual_rate_hz(
        static_cast<double>(entries.back().sequence - entries.front().sequence) / elapsed_s, elapsed_s);
  }
  std::vector<double> times_s;
  for (const take::FrameEntry& entry : entries) {
    times_s.push_back(1e-9 * static_cast<double>(entry.media_time_ns - entries.front().media_time_ns));
    timeline.deviation_s =
        std::max(timeline.deviation_s, std::abs(times_s.back() - time_s(timeline, entry.sequence)));
  }
  if (timeline.deviation_s * timeline.rate_hz > 0.5) {
    timeline.times_s = std::move(times_s);
  }
  return timeline;
}

std::optional<take::TimecodePlace> start_timecode(const Timeline& timeline) {
  return take::timecode_at(timeline.timecode, timeline.first_ns, timeline.rate_hz);
}

void require_same_mesh(const mesh::Triangles& triangles, const SequenceFrame& frame,
                       const std::filesystem::path& file) {
  if (frame.mesh.triangles.cols() != triangles.cols() || frame.mesh.triangles != triangles) {
    throw Error(
        ErrorKind::Usage,
        fmt::format(
            "cannot write '{0}': frame {1} has another mesh than the frames before it (the person was "
            "estimated anew there): export them apart, with --frames :{1} and --frames {1}:",
            file.string(), frame.sequence));
  }
}

double time_s(const Timeline& timeline, std::uint64_t sequence) {
  const std::vector<std::uint64_t>& numbers = timeline.sequences;
  if (timeline.times_s.empty()) {
    return static_cast<double>(sequence - numbers.front()) / timeline.rate_hz;
  }
  const auto after = std::lower_bound(numbers.begin(), numbers.end(), sequence);
  const auto at = static_cast<std::size_t>(after - numbers.begin());
  if (*after == sequence) {
    return timeline.times_s[at];
  }
  const double share =
      static_cast<double>(sequence - numbers[at - 1]) / static_cast<double>(numbers[at] - numbers[at - 1]);
  return std::lerp(timeline.times_s[at - 1], timeline.times_s[at], share);
}

Eigen::Isometry3f metres_from_head(const SequenceFrame& frame) {
  Eigen::Isometry3f pose = mesh::upright_from_camera() * frame.camera_from_head;
  pose.translation() *= kMetresPerMillimetre;
  return pose;
}

VertexCache::VertexCache(const SequenceOptions& options, const SequenceFrame& first)
    : options_(options), base_(first.mesh) {
  const std::uint64_t samples = options.timeline.sequences.back() - options.timeline.sequences.front() + 1;
  if (samples > static_cast<std::uint64_t>(std::numeric_limits<std::int32_t>::max())) {
    throw Error(ErrorKind::Usage,
                fmt::format("cannot write '{}': {} frames are more than the format can hold",
                            options.file.string(), samples));
  }
  sample_count_ = static_cast<std::int32_t>(samples);
  place(first);
  base_.vertices_mm = points_;  // in metres here
  if (options.space == MeshSpace::Camera) {
    base_.normals = metres_from_head(first).linear() * base_.normals;
  }
  points_.resize(3, 0);
  next_ = first.sequence;
}

void VertexCache::place(const SequenceFrame& frame) {
  points_ = kMetresPerMillimetre * frame.mesh.vertices_mm;
  if (options_.space == MeshSpace::Camera) {
    const Eigen::Isometry3f pose = metres_from_head(frame);
    points_ = (pose.linear() * points_).colwise() + pose.translation();
  }
}

void VertexCache::commit(files::OutputFile& cache) const {
  std::filesystem::path base = options_.file;
  base.replace_extension("obj");
  write_obj_as_is(base_, base,
                  options_.space == MeshSpace::Camera
                      ? words_of(MeshAxes::Upright)
                      : "metres, x to the subject's left, y up, z out of the face");
  cache.commit();
}

}  // namespace facet::exports
