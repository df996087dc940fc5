#include "capture/frame_set_matcher.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "facet/assert.hpp"
#include "facet/error.hpp"

namespace facet::capture {
namespace {

constexpr int kAgreeing = 3;         // frames in a row that end a doubt
constexpr int kAgreeingAtFirst = 8;  // the same before the frames' usual way is known
constexpr double kMean = 1.0 / 32;   // weight of a new value in a running mean
/// A distance of numbers from here on is one backwards: the device began to count anew.
constexpr std::uint32_t kBackwards = 1U << 31;
/// How much a frame's way may differ from the usual one and still tell one slot from the next, in periods.
constexpr double kTransportTolerance = 0.4;

/// Frames from one number to a later one. Drivers count in 32 bits, which wrap.
std::uint32_t sequence_distance(std::uint64_t from, std::uint64_t to) {
  return static_cast<std::uint32_t>(to - from);
}

[[noreturn]] void refuse_config(const std::string& what) {
  throw Error(ErrorKind::Usage, "frame sets: " + what);
}

void check(const CaptureConfig& config) {
  if (config.cameras.empty() || config.cameras.size() > kMaxCameras) {
    refuse_config(fmt::format("1 to {} cameras are possible, not {}", kMaxCameras, config.cameras.size()));
  }
  if (config.period_ns < 1'000'000 || config.period_ns > 10'000'000'000) {
    refuse_config(fmt::format("a period of {} ns; 1 ms to 10 s are possible", config.period_ns));
  }
  if (config.deadline_ns < config.period_ns || config.deadline_ns > 32 * config.period_ns) {
    refuse_config(fmt::format("the deadline ({} us) must be 1 to 32 periods of {} us",
                              config.deadline_ns / 1000, config.period_ns / 1000));
  }
  if (config.open_sets < 2 || config.open_sets > 32) {
    refuse_config(fmt::format("{} open sets; 2 to 32 are possible", config.open_sets));
  }
}

}  // namespace

FrameSetMatcher::FrameSetMatcher(const CaptureConfig& config)
    : config_((check(config), config)),
      tolerance_ns_(triggered() ? config.period_ns / 4 : config.period_ns / 2),
      cameras_(config.cameras.size()),
      open_(config.open_sets) {
  for (OpenSet& open : open_) {
    open.set.frames.resize(cameras_.size());
  }
  statistics_.cameras.resize(cameras_.size());
  std::vector<std::string> names;
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    cameras_[i].nominal_offset_ns = triggered() ? config.cameras[i].latency_ns : 0;
    statistics_.cameras[i].name = config.cameras[i].name;
    statistics_.cameras[i].offset_ns = static_cast<double>(cameras_[i].nominal_offset_ns);
    names.push_back(config.cameras[i].name);
  }
  camera_names_ = std::make_shared<const std::vector<std::string>>(std::move(names));
}

void FrameSetMatcher::fired(std::uint64_t slot, std::int64_t fired_ns) {
  if (firings_ > 0 && (slot <= firing(firings_ - 1).slot || fired_ns <= firing(firings_ - 1).fired_ns)) {
    ++statistics_.odd_slots;
    return;
  }
  open(slot, fired_ns);
  for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
    settle(camera);
  }
}

void FrameSetMatcher::open(std::uint64_t slot, std::int64_t fired_ns) {
  if (open_count_ == open_.size()) {
    OpenSet& oldest = open_set(0);
    std::fill(oldest.set.frames.begin(), oldest.set.frames.end(), Frame{});
    ++statistics_.dropped;
    first_open_ = (first_open_ + 1) % open_.size();
    --open_count_;
  }
  FACET_ASSERT(open_count_ < open_.size(), open_count_, open_.size());
  FACET_ASSERT(open_count_ == 0 || open_set(open_count_ - 1).firing + 1 == firings_, open_count_, firings_);
  history_[firings_ % kHistory] = {slot, fired_ns};
  OpenSet& opened = open_set(open_count_++);
  opened.firing = firings_++;
  opened.set.slot = slot;
  opened.set.trigger_ns = fired_ns;
  opened.set.missing = ~std::uint64_t{0} >> (64 - cameras_.size());
  opened.set.skew_ns = 0;
  ++statistics_.slots;
}

/// Free-running: makes the slots that a frame of the reference camera stands for, its lost ones included.
void FrameSetMatcher::follow_reference(std::int64_t time_ns) {
  if (firings_ == 0) {
    open(0, time_ns);
    return;
  }
  const Firing last = firing(firings_ - 1);
  const std::int64_t passed_ns = time_ns - last.fired_ns;
  if (passed_ns < config_.period_ns / 2) {
    return;
  }
  const auto slots = static_cast<std::uint64_t>(
      std::max(std::int64_t{1}, (passed_ns + config_.period_ns / 2) / config_.period_ns));
  FACET_ASSERT(slots >= 1 && passed_ns > 0, slots, passed_ns);
  // A longer gap leaves no frame that could still wait for its slots.
  const std::uint64_t first = slots <= open_.size() ? 1 : slots;
  for (std::uint64_t i = first; i <= slots; ++i) {
    open(last.slot + i,
         last.fired_ns + passed_ns * static_cast<std::int64_t>(i) / static_cast<std::int64_t>(slots));
  }
}

FrameSetMatcher::Place FrameSetMatcher::place_of(std::size_t camera, std::int64_t time_ns) const {
  const double offset_ns = triggered() ? statistics_.cameras[camera].offset_ns : 0;
  const std::int64_t fired_ns = time_ns - static_cast<std::int64_t>(offset_ns);
  if (firings_ == 0 || firing(firings_ - 1).fired_ns < fired_ns - tolerance_ns_) {
    return {Place::Kind::Wait, 0};
  }
  const std::uint64_t oldest = firings_ - std::min<std::uint64_t>(firings_, kHistory);
  std::uint64_t nearest = firings_ - 1;
  const auto distance_ns = [&](std::uint64_t number) { return std::abs(firing(number).fired_ns - fired_ns); };
  while (nearest > oldest && distance_ns(nearest - 1) < distance_ns(nearest)) {
    --nearest;
  }
  FACET_ASSERT(nearest < firings_ && firings_ - nearest <= kHistory, nearest, firings_);
  if (distance_ns(nearest) <= tolerance_ns_) {
    return {Place::Kind::Found, nearest};
  }
  return {distance_ns(nearest) <= config_.period_ns / 2 ? Place::Kind::TimeDisagrees : Place::Kind::NoSlot,
          0};
}

void FrameSetMatcher::refuse(std::size_t camera, Refusal cause) {
  ++statistics_.cameras[camera].refused.at(static_cast<std::size_t>(cause));
}

/// A frame at no slot's time may be one more than was fired: the next numbers prove nothing by themselves.
void FrameSetMatcher::misplaced(std::size_t camera, Refusal cause) {
  refuse(camera, cause);
  statistics_.cameras[camera].in_step = false;
}

void FrameSetMatcher::pop_pending(std::size_t camera) {
  CameraTrack& state = cameras_[camera];
  FACET_ASSERT(state.pending_count > 0 && state.pending_count <= kPending, camera, state.pending_count);
  std::move(state.pending.begin() + 1,
            state.pending.begin() + static_cast<std::ptrdiff_t>(state.pending_count), state.pending.begin());
  state.pending[--state.pending_count].frame = {};
}

void FrameSetMatcher::push(std::size_t camera, Frame frame, std::int64_t now_ns) {
  CameraTrack& state = cameras_.at(camera);
  if (frame.timestamp_ns > now_ns + tolerance_ns_) {
    misplaced(camera, Refusal::TimeDisagrees);
    return;
  }
  if (state.pending_count == kPending) {
    misplaced(camera, Refusal::Overrun);
    pop_pending(camera);
  }
  if (!triggered() && camera == reference_) {
    follow_reference(frame.timestamp_ns);
  }
  FACET_ASSERT(state.pending_count < kPending, camera, state.pending_count);
  state.pending[state.pending_count++] = {std::move(frame), now_ns};
  if (!triggered() && camera == reference_) {
    for (std::size_t other = 0; other < cameras_.size(); ++other) {
      settle(other);
    }
  } else {
    settle(camera);
  }
}

/// Judges the frames whose firing is known.
void FrameSetMatcher::settle(std::size_t camera) {
  CameraTrack& state = cameras_[camera];
  while (state.pending_count > 0) {
    const Place place = place_of(camera, state.pending[0].frame.timestamp_ns);
    switch (place.kind) {
      case Place::Kind::Wait:
        return;
      case Place::Kind::Found:
        judge(camera, state.pending[0], place.firing);
        break;
      case Place::Kind::NoSlot:
        misplaced(camera, Refusal::NoSlot);
        break;
      case Place::Kind::TimeDisagrees:
        misplaced(camera, Refusal::TimeDisagrees);
        break;
    }
    pop_pending(camera);
  }
}

std::optional<Refusal> FrameSetMatcher::judge_sequence(std::size_t camera, const Pending& pending,
                                                       std::uint64_t firing_number) {
  CameraTrack& state = cameras_[camera];
  CameraMatch& match = statistics_.cameras[camera];
  FACET_ASSERT(!match.in_step || state.trusted, camera, firing_number);
  FACET_ASSERT(firing_number < firings_, camera, firing_number, firings_);
  const Step step = {pending.frame.sequence, firing_number};
  const auto follows = [&](const std::optional<Step>& before) {
    return before && firing_number > before->firing &&
           sequence_distance(before->sequence, step.sequence) == firing_number - before->firing;
  };
  const auto same_number = [&](const std::optional<Step>& before) {
    return before && sequence_distance(before->sequence, step.sequence) == 0;
  };
  if (same_number(state.trusted) || same_number(state.doubted)) {
    // The same number at another time: the device began to count anew.
    match.in_step = match.in_step && state.trusted->firing == firing_number;
    return Refusal::Duplicate;
  }
  if (!triggered()) {
    // Cameras that run at rates of their own slip by a slot now and then; only the time counts.
    const std::uint32_t distance =
        state.trusted ? sequence_distance(state.trusted->sequence, step.sequence) : 1;
    match.lost += distance < kBackwards ? distance - 1 : 0;
    match.in_step = true;
    state.trusted = step;
    return std::nullopt;
  }
  const double transport_ns = static_cast<double>(pending.arrival_ns - pending.frame.timestamp_ns);
  const bool arrived_as_usual =
      !state.transport_known || std::abs(transport_ns - match.transport_ns) <=
                                    kTransportTolerance * static_cast<double>(config_.period_ns);
  // Numbers that fall wrap or begin anew.
  const bool sure = match.in_step && step.sequence > state.trusted->sequence;
  const bool agrees = follows(state.trusted) && (sure || arrived_as_usual);
  if (!agrees) {
    ++state.refused_since_trusted;
    state.agreeing = !arrived_as_usual ? 0 : follows(state.doubted) ? state.agreeing + 1 : 1;
    state.doubted = step;
    match.in_step = false;
    if (state.agreeing < (state.transport_known ? kAgreeing : kAgreeingAtFirst)) {
      return Refusal::SequenceDisagrees;
    }
  }
  if (agrees) {
    // Of two frames at one firing both were refused: more than there were firings between.
    const std::uint64_t between = firing_number - state.trusted->firing - 1;
    match.lost += between - std::min(between, state.refused_since_trusted);
  }
  state.refused_since_trusted = 0;
  match.in_step = true;
  state.trusted = step;
  state.doubted.reset();
  state.agreeing = 0;
  return std::nullopt;
}

void FrameSetMatcher::judge(std::size_t camera, Pending& pending, std::uint64_t firing_number) {
  if (const auto refusal = judge_sequence(camera, pending, firing_number)) {
    refuse(camera, *refusal);
    return;
  }
  CameraTrack& state = cameras_[camera];
  const bool new_firing = !state.newest_firing || firing_number > *state.newest_firing;
  state.newest_firing = new_firing ? firing_number : *state.newest_firing;
  if (pending.frame.corrupt) {
    refuse(camera, Refusal::Corrupt);
    return;
  }
  if (open_count_ == 0 || firing_number < open_set(0).firing) {
    refuse(camera, Refusal::TooLate);
    return;
  }
  const std::uint64_t bit = std::uint64_t{1} << camera;
  const std::uint64_t place = firing_number - open_set(0).firing;
  FACET_ASSERT(place < open_count_, camera, firing_number, firings_, open_count_);
  FrameSet& set = open_set(place).set;
  FACET_ASSERT(set.slot == firing(firing_number).slot, set.slot, firing(firing_number).slot, firing_number);
  if ((set.missing & bit) == 0) {
    refuse(camera, Refusal::Duplicate);
    return;
  }
  learn(camera, pending, firing_number);
  ++statistics_.cameras[camera].in_sets;
  FACET_ASSERT(set.frames[camera].empty() && !pending.frame.empty(), camera, set.slot);
  set.missing &= ~bit;
  set.frames[camera] = std::move(pending.frame);
}

void FrameSetMatcher::learn(std::size_t camera, const Pending& pending, std::uint64_t firing_number) {
  CameraTrack& state = cameras_[camera];
  CameraMatch& match = statistics_.cameras[camera];
  const auto offset_ns = static_cast<double>(pending.frame.timestamp_ns - firing(firing_number).fired_ns);
  const double residual_ns = offset_ns - match.offset_ns;
  const auto nominal_ns = static_cast<double>(state.nominal_offset_ns);
  const double reach_ns = triggered() ? 0.25 * static_cast<double>(config_.period_ns) : 1e18;
  const double wanted_ns = match.offset_ns + kMean * residual_ns;
  match.offset_ns = std::clamp(wanted_ns, nominal_ns - reach_ns, nominal_ns + reach_ns);
  match.offset_odd = match.offset_ns != wanted_ns;
  state.variance_ns2 += kMean * (residual_ns * residual_ns - state.variance_ns2);
  FACET_ASSERT(state.variance_ns2 >= 0, camera, state.variance_ns2, residual_ns);
  match.jitter_ns = std::sqrt(state.variance_ns2);
  match.worst_ns = std::max(match.worst_ns, std::abs(residual_ns));
  const auto transport_ns = static_cast<double>(pending.arrival_ns - pending.frame.timestamp_ns);
  match.transport_ns += (state.transport_known ? kMean : 1.0) * (transport_ns - match.transport_ns);
  state.transport_known = true;
}

void FrameSetMatcher::set_streaming(std::size_t camera, bool streaming) {
  CameraTrack& state = cameras_.at(camera);
  if (streaming && !state.streaming) {
    // Another run of the device has other numbers; its frames still take their usual way.
    state.trusted.reset();
    state.doubted.reset();
    state.agreeing = 0;
    state.refused_since_trusted = 0;
    statistics_.cameras[camera].in_step = false;
  }
  state.streaming = streaming;
}

void FrameSetMatcher::advance(std::int64_t now_ns) {
  FACET_ASSERT(reference_ < cameras_.size(), reference_, cameras_.size());
  for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
    CameraTrack& state = cameras_[camera];
    // Free-running: where the reference is silent, the first camera that waits for it takes its place.
    if (!triggered() && state.pending_count > 0 && camera != reference_ &&
        now_ns - state.pending[0].arrival_ns >= config_.deadline_ns / 2) {
      reference_ = camera;
      for (std::size_t i = 0; i < state.pending_count; ++i) {
        follow_reference(state.pending[i].frame.timestamp_ns);
      }
      for (std::size_t other = 0; other < cameras_.size(); ++other) {
        settle(other);
      }
    }
    while (state.pending_count > 0 && now_ns - state.pending[0].arrival_ns >= config_.deadline_ns) {
      misplaced(camera, Refusal::NoSlot);
      pop_pending(camera);
      settle(camera);
    }
  }
}

bool FrameSetMatcher::ready(const OpenSet& set, std::int64_t now_ns) const {
  if (set.set.complete() || now_ns >= set.set.trigger_ns + config_.deadline_ns) {
    return true;
  }
  for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
    const CameraTrack& state = cameras_[camera];
    const bool moved_on = state.newest_firing && *state.newest_firing >= set.firing;
    if ((set.set.missing >> camera & 1) != 0 && state.streaming && !moved_on) {
      return false;
    }
  }
  return true;
}

/// Counts a set and measures its skew.
void FrameSetMatcher::finish(FrameSet& set) {
  double least_ns = 1e300;
  double most_ns = -1e300;
  double sum_ns = 0;
  int count = 0;
  const auto time_ns = [&](std::size_t camera) {
    return static_cast<double>(set.frames[camera].timestamp_ns - set.trigger_ns);
  };
  for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
    CameraMatch& match = statistics_.cameras[camera];
    if ((set.missing >> camera & 1) != 0) {
      ++match.missing;
      continue;
    }
    FACET_ASSERT(!set.frames[camera].empty(), camera, set.slot, set.missing);
    const double own_ns = time_ns(camera) - (triggered() ? match.offset_ns : 0);
    least_ns = std::min(least_ns, own_ns);
    most_ns = std::max(most_ns, own_ns);
    sum_ns += time_ns(camera);
    ++count;
  }
  ++(set.complete() ? statistics_.complete : statistics_.incomplete);
  if (count < 2) {
    return;
  }
  set.skew_ns = std::llround(most_ns - least_ns);
  statistics_.worst_skew_ns = std::max(statistics_.worst_skew_ns, set.skew_ns);
  for (std::size_t camera = 0; camera < cameras_.size() && set.complete(); ++camera) {
    double& skew_ns = statistics_.cameras[camera].skew_ns;
    skew_ns += kMean * (time_ns(camera) - sum_ns / count - skew_ns);
  }
}

bool FrameSetMatcher::take(FrameSet& out, std::int64_t now_ns) {
  out.frames.resize(cameras_.size());
  std::fill(out.frames.begin(), out.frames.end(), Frame{});
  if (open_count_ == 0 || !ready(open_set(0), now_ns)) {
    return false;
  }
  FACET_ASSERT(open_set(0).set.frames.size() == cameras_.size(), open_set(0).set.frames.size(),
               cameras_.size());
  std::swap(out, open_set(0).set);
  first_open_ = (first_open_ + 1) % open_.size();
  --open_count_;
  FACET_ASSERT(open_count_ == 0 || open_set(0).set.slot > out.slot, open_set(0).set.slot, out.slot);
  out.camera_names = camera_names_;
  finish(out);
  return true;
}

std::optional<std::int64_t> FrameSetMatcher::next_deadline_ns() const {
  std::optional<std::int64_t> next_ns;
  const auto consider = [&](std::int64_t at_ns) { next_ns = std::min(next_ns.value_or(at_ns), at_ns); };
  if (open_count_ > 0) {
    consider(open_[first_open_].set.trigger_ns + config_.deadline_ns);
  }
  for (const CameraTrack& state : cameras_) {
    if (state.pending_count > 0) {
      const bool may_lead = !triggered() && &state != &cameras_[reference_];
      consider(state.pending[0].arrival_ns + (may_lead ? config_.deadline_ns / 2 : config_.deadline_ns));
    }
  }
  return next_ns;
}

}  // namespace facet::capture
