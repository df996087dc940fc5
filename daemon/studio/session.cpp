#include "studio/session.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <system_error>

#include "animate/places.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"
#include "mesh/hierarchy.hpp"
#include "studio/keys.hpp"
#include "take/closing.hpp"
#include "take/recorder.hpp"

namespace facet::studio {
namespace {

constexpr double kDefaultRate_hz = 30;

bool all_finite(const mesh::MeshFrame& frame) {
  const Eigen::Map<const Eigen::VectorXf> displacements(
      frame.displacements_mm.data(), static_cast<Eigen::Index>(frame.displacements_mm.size()));
  const Eigen::Map<const Eigen::VectorXf> expression(frame.expression.data(),
                                                     static_cast<Eigen::Index>(frame.expression.size()));
  return frame.control_vertices_mm.allFinite() && displacements.allFinite() && expression.allFinite() &&
         frame.camera_from_head.matrix().allFinite();
}

}  // namespace

Session::Session(std::filesystem::path take_file, const std::string& name, bool posing,
                 const std::function<bool(std::int64_t done, std::int64_t total)>& progress)
    : file(std::move(take_file)) {
  const take::ClosedTake closed = take::close_take(file);
  if (!closed.info.closed) {
    throw Error(ErrorKind::Usage, fmt::format("take {}: {}", name, closed.left));
  }
  file_state = animate::state_of(file);
  reader.emplace(file);
  std::int64_t first_ns = 0;
  for (std::int64_t index = 0; index < reader->frame_count(); ++index) {
    const take::FrameEntry entry = reader->entry(index);
    if (!entry.has_mesh) {
      continue;
    }
    first_ns = meshes.empty() ? entry.media_time_ns : first_ns;
    const double time_s = static_cast<double>(entry.media_time_ns - first_ns) * 1e-9;
    const double least_s = meshes.empty() ? 0.0 : meshes.back().time_s;
    meshes.push_back({index, std::max(time_s, least_s), entry.sequence});
  }
  if (meshes.empty()) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("take {} has no mesh", name));
  }
  if (posing) {
    auto ready = std::make_shared<Faces>();
    ready->basis = animate::TakeBasis::open(file, {}, progress);
    ready->ik = std::make_shared<animate::FaceIk>(ready->basis);
    ready->ik->set_view(ready->basis->sample().camera, ready->basis->sample().camera_from_head);
    ready->rest_mm = animate::resting_vertices(*ready->basis);
    ready->places = animate::places(*ready->basis);
    blank = animate::blank_frame(*ready->basis);
    faces = ready;
    std::error_code ignored;
    if (std::filesystem::exists(keys_file(file), ignored)) {
      try {
        stored_keys = files::read_text(keys_file(file), animate::kKeysLimits.most_bytes, "keys file");
        animate::parse_keys(stored_keys, keys_file(file).string());
      } catch (const Error& error) {
        stored_keys.clear();
        keys_fault = fmt::format("the take is open without its keys: {}; {}", error.what(),
                                 files::set_aside(keys_file(file)));
      }
    }
  }
}

double Session::duration_s(Shown what) const {
  return what == Shown::Keys ? animation->duration_s() : meshes.back().time_s;
}

mesh::MeshFrame Session::animated(double time_s) const {
  animate::Pose posed;
  animation->pose(time_s, posed);
  mesh::MeshFrame frame = blank;
  animate::blend(*faces->basis, posed, frame);
  frame.media_time_ns = std::llround(time_s * 1e9);
  frame.origin = mesh::Origin::Pose;
  return frame;
}

std::size_t Session::entry_at(double time_s) const {
  const auto after = std::upper_bound(meshes.begin(), meshes.end(), time_s + 1e-6,
                                      [](double at_s, const MeshEntry& one) { return at_s < one.time_s; });
  return after == meshes.begin() ? 0 : static_cast<std::size_t>(after - meshes.begin()) - 1;
}

std::vector<std::string> Session::make_animation(std::string text, const std::function<bool()>& go_on) {
  const animate::KeyList list = animate::parse_keys(text, "keys");
  animate::AnimationReport report;
  animation = animate::Animation::of_keys(faces->basis, list, report, go_on);
  animated_keys = std::move(text);
  keys_rate_hz = list.rate_hz > 0                         ? list.rate_hz
                 : faces->basis->frame_period_s() > 0.001 ? 1.0 / faces->basis->frame_period_s()
                                                          : kDefaultRate_hz;
  return std::move(report.warnings);
}

std::int64_t Session::animation_frames() const {
  return std::max<std::int64_t>(1, std::llround(animation->duration_s() * keys_rate_hz) + 1);
}

void Session::write_animation(const std::filesystem::path& to, const std::string& software,
                              const std::function<bool(std::int64_t written)>& progress) const {
  take::TakeRecorderConfig config;
  config.file = to;
  config.source = fmt::format("keys of {}", file.string());
  config.software = software;
  config.when_full = take::WhenFull::Wait;
  take::TakeRecorder recorder(config);
  recorder.start();
  bool broken_off = false;
  const std::int64_t count = animation_frames();
  for (std::int64_t index = 0; index < count && !broken_off; ++index) {
    mesh::MeshFrame frame = animated(static_cast<double>(index) / keys_rate_hz);
    frame.sequence = static_cast<std::uint64_t>(index);
    frame.timestamp_ns = frame.media_time_ns;
    recorder.record(std::make_shared<const mesh::MeshFrame>(std::move(frame)));
    broken_off = !progress(index + 1);
  }
  const take::RecorderStatus status = recorder.stop();
  if (broken_off) {
    std::error_code ignored;
    std::filesystem::remove(to, ignored);
    throw Error(ErrorKind::Unavailable, "broken off");
  }
  if (status.state == take::RecorderState::Failed) {
    throw Error(ErrorKind::Storage, fmt::format("'{}': {}", to.string(), status.reason));
  }
}

void Session::keep(mesh::MeshFrame frame, std::optional<Clock::time_point> asked, Clock::time_point now) {
  if (!all_finite(frame)) {
    throw Error(ErrorKind::Internal, "a face is not finite: it is not shown");
  }
  frame.images = nullptr;
  frame.sequence = published++;
  frame.timestamp_ns = std::chrono::duration_cast<std::chrono::nanoseconds>(now.time_since_epoch()).count();
  frame.stage_ms = {};
  frame.stage_ms.latency_ms = asked ? std::chrono::duration<float, std::milli>(now - *asked).count() : 0.0F;
  last = std::make_shared<const mesh::MeshFrame>(std::move(frame));
}

void Session::play(Shown what, double from_s, bool begin_again, Clock::time_point now) {
  playing = what;
  loop = begin_again;
  played_from_s = from_s >= duration_s(what) ? 0.0 : from_s;
  playing_since = next_due = now;
}

double Session::advance(Clock::time_point now) {
  const double end_s = duration_s(*playing);
  double time_s = played_from_s + std::chrono::duration<double>(now - playing_since).count();
  if (time_s >= end_s && loop && end_s > 0) {
    time_s = std::fmod(time_s, end_s);
    played_from_s = time_s;
    playing_since = now;
  }
  return time_s;
}

Clock::duration Session::step_after(double time_s) const {
  double step_s = 1.0 / keys_rate_hz;
  if (*playing == Shown::Take) {
    const std::size_t next = std::min(entry_at(time_s) + 1, meshes.size() - 1);
    step_s = std::max(1e-3, meshes[next].time_s - time_s);
  }
  return std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(step_s));
}

}  // namespace facet::studio
