#include "trigger/runner.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <map>

#include "trigger/program.hpp"

namespace facet::trigger {
namespace {

constexpr std::int64_t kLead_ns = 20'000'000;        // from the start of a run to its first slot
constexpr std::int64_t kLookAtStop_ns = 20'000'000;  // while waiting for a slot

void add(std::atomic<std::uint64_t>& counter, std::uint64_t count = 1) {
  counter.fetch_add(count, std::memory_order_relaxed);
}

/// Calls what(line) for every bit of a mask.
template <typename What>
void for_each_line(LineMask mask, What what) {
  for (; mask != 0; mask &= mask - 1) {
    what(static_cast<std::size_t>(std::countr_zero(mask)));
  }
}

}  // namespace

TriggerRunner::TriggerRunner(const TriggerProgram& program, TriggerLines& lines, TriggerClock& clock,
                             TriggerEventSink& events, RunCounters& counters)
    : program_((check(program), program)),
      lines_(lines),
      clock_(clock),
      events_(events),
      counters_(counters),
      cameras_(lines_of(program, LineRole::Camera)),
      projectors_(lines_of(program, LineRole::Projector)),
      safe_(safe_lines(program)),
      level_(safe_) {
  std::map<std::int64_t, LineMask> by_time = {{program.exposure_ns, projectors_}};
  for_each_line(cameras_, [&](std::size_t i) {
    const std::int64_t pulse_ns = program.lines[i].pulse_ns;
    by_time[pulse_ns > 0 ? pulse_ns : program.exposure_ns] |= LineMask{1} << i;
  });
  for (const auto& [after_fire_ns, which] : by_time) {
    releases_.push_back({after_fire_ns, which});
  }
}

std::int64_t TriggerRunner::start_ns(std::uint64_t slots_after_first) const {
  return origin_ns_ + std::llround(static_cast<double>(slots_after_first) * 1e9 / program_.slots_per_second);
}

bool TriggerRunner::wait_for_start(std::int64_t deadline_ns, const std::atomic<bool>& stop) {
  for (std::int64_t now_ns = clock_.now_ns(); now_ns < deadline_ns; now_ns = clock_.now_ns()) {
    if (stop.load(std::memory_order_relaxed)) {
      return false;
    }
    clock_.sleep_until(std::min(deadline_ns, now_ns + kLookAtStop_ns));
  }
  return !stop.load(std::memory_order_relaxed);
}

TriggerRunner::Change TriggerRunner::change(std::uint64_t slot, LineMask which, LineMask active,
                                            std::int64_t planned_ns) {
  which &= level_ ^ active;
  const std::int64_t before_ns = clock_.now_ns();
  if (which == 0) {
    return {true, before_ns, 0};
  }
  const bool done = lines_.set(which, active);
  const std::int64_t after_ns = clock_.now_ns();
  if (!done) {
    return {false, after_ns, after_ns - before_ns};
  }
  level_ = (level_ & ~which) | (active & which);
  const std::int64_t late_ns = after_ns - planned_ns;
  if (late_ns > counters_.worst_late_ns.load(std::memory_order_relaxed)) {
    counters_.worst_late_ns.store(late_ns, std::memory_order_relaxed);
  }
  const bool late = late_ns > program_.tolerance_ns;
  for_each_line(which, [&](std::size_t line) {
    add(counters_.edges);
    add(counters_.edges_late, late ? 1 : 0);
    const bool became_active = (active >> line & 1) != 0;
    await(slot, line, became_active, before_ns);
    events_.put({.kind = TriggerEvent::Kind::Edge,
                 .line = static_cast<std::uint8_t>(line),
                 .active = became_active,
                 .late = late,
                 .slot = slot,
                 .planned_ns = planned_ns,
                 .actual_ns = after_ns,
                 .call_ns = after_ns - before_ns});
  });
  return {true, after_ns, after_ns - before_ns};
}

void TriggerRunner::drop(std::uint64_t slot, std::uint64_t slot_count, std::int64_t planned_ns) {
  add(counters_.slots_dropped, slot_count);
  events_.put({.kind = TriggerEvent::Kind::Dropped,
               .slot = slot,
               .slot_count = slot_count,
               .planned_ns = planned_ns,
               .actual_ns = clock_.now_ns()});
}

void TriggerRunner::await(std::uint64_t slot, std::size_t line, bool active, std::int64_t from_ns) {
  if ((lines_.read_back() >> line & 1) != 0 && awaited_count_ < awaited_.size()) {
    awaited_[awaited_count_++] = {static_cast<std::uint8_t>(line), active, slot, from_ns};
  }
}

void TriggerRunner::collect_seen() {
  std::array<SeenEdge, 16> seen;
  for (std::size_t count = seen.size(); count == seen.size();) {
    count = lines_.seen(seen);
    for (const SeenEdge& edge : std::span(seen).first(count)) {
      const auto end = awaited_.begin() + static_cast<std::ptrdiff_t>(awaited_count_);
      // The newest command before the edge: an older one of the same kind was missed.
      auto proven = end;
      for (auto it = awaited_.begin(); it != end; ++it) {
        if (it->line == edge.line && it->active == edge.active && it->from_ns <= edge.time_ns) {
          proven = it;
        }
      }
      if (proven == end) {
        add(counters_.edges_stray);
        continue;
      }
      add(counters_.edges_proven);
      events_.put({.kind = TriggerEvent::Kind::Seen,
                   .line = edge.line,
                   .active = edge.active,
                   .slot = proven->slot,
                   .planned_ns = proven->from_ns,
                   .actual_ns = edge.time_ns});
      std::move(proven + 1, end, proven);
      --awaited_count_;
    }
  }
}

void TriggerRunner::report_missing(std::uint64_t before_slot) {
  const auto begin = awaited_.begin();
  const auto end = begin + static_cast<std::ptrdiff_t>(awaited_count_);
  const auto old = std::find_if(begin, end, [&](const Awaited& a) { return a.slot >= before_slot; });
  for (auto it = begin; it != old; ++it) {
    add(counters_.edges_missing);
    events_.put({.kind = TriggerEvent::Kind::Missing,
                 .line = it->line,
                 .active = it->active,
                 .slot = it->slot,
                 .planned_ns = it->from_ns});
  }
  std::move(old, end, begin);
  awaited_count_ = static_cast<std::size_t>(end - old);
}

TriggerRunner::SlotEnd TriggerRunner::run_slot(std::uint64_t slot, std::int64_t planned_ns) {
  const LineMask pattern = program_.patterns[slot % program_.patterns.size()];
  const Change shown = change(slot, projectors_, pattern, planned_ns);
  if (!shown.done) {
    return SlotEnd::LinesFailed;
  }
  const std::int64_t fire_planned_ns = planned_ns + program_.settle_ns;
  clock_.sleep_until(std::max(fire_planned_ns, shown.actual_ns + program_.settle_ns));
  if (clock_.now_ns() > fire_planned_ns + program_.tolerance_ns) {
    drop(slot, 1, planned_ns);
    collect_seen();
    report_missing(slot);
    return change(slot, projectors_, safe_, clock_.now_ns()).done ? SlotEnd::Done : SlotEnd::LinesFailed;
  }
  const Change fired = change(slot, cameras_, cameras_, fire_planned_ns);
  if (!fired.done) {
    return SlotEnd::LinesFailed;
  }
  add(counters_.slots_fired);
  events_.put({.kind = TriggerEvent::Kind::Fired,
               .slot = slot,
               .planned_ns = fire_planned_ns,
               .actual_ns = fired.actual_ns,
               .call_ns = fired.call_ns});
  // While the cameras expose there is time to look at what the slot before has done.
  collect_seen();
  report_missing(slot);
  for (const Release& release : releases_) {
    const std::int64_t release_ns = fire_planned_ns + release.after_fire_ns;
    clock_.sleep_until(std::max(release_ns, fired.actual_ns + release.after_fire_ns));
    if (!change(slot, release.which, safe_, release_ns).done) {
      return SlotEnd::LinesFailed;
    }
  }
  return SlotEnd::Done;
}

bool TriggerRunner::run(std::uint64_t first_slot, const std::atomic<bool>& stop) {
  origin_ns_ = clock_.now_ns() + kLead_ns;
  bool lines_work = true;
  std::uint64_t at = 0;
  while (lines_work && wait_for_start(start_ns(at), stop)) {
    const std::int64_t latest_start_ns = clock_.now_ns() - program_.tolerance_ns;
    if (start_ns(at) < latest_start_ns) {
      const std::uint64_t first_dropped = at;
      const auto passed = static_cast<double>(latest_start_ns - origin_ns_);
      at = std::max(at + 1, static_cast<std::uint64_t>(passed * program_.slots_per_second / 1e9));
      at += start_ns(at) < latest_start_ns ? 1 : 0;
      drop(first_slot + first_dropped, at - first_dropped, start_ns(first_dropped));
      continue;
    }
    lines_work = run_slot(first_slot + at, start_ns(at)) == SlotEnd::Done;
    ++at;
  }
  const bool safe = change(first_slot + at, ~LineMask{0}, safe_, clock_.now_ns()).done;
  // The last slot's proofs: what is not there when the next slot would have begun does not come.
  if (lines_work && awaited_count_ > 0) {
    clock_.sleep_until(start_ns(at));
    collect_seen();
  }
  report_missing(first_slot + at + 1);
  return lines_work && safe;
}

}  // namespace facet::trigger
