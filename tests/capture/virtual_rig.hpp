#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "capture/frame_set_matcher.hpp"

namespace facet::capture {

constexpr std::int64_t kMicrosecond = 1'000;
constexpr std::int64_t kMillisecond = 1'000'000;

/// A frame with the slot it was exposed for painted into its pixels.
inline Frame painted(std::uint64_t slot, std::uint64_t sequence, std::int64_t timestamp_ns) {
  auto pixels = std::shared_ptr<std::uint8_t[]>(new std::uint8_t[8]);
  for (int i = 0; i < 8; ++i) {
    pixels[i] = static_cast<std::uint8_t>(slot >> (8 * i));
  }
  Frame frame;
  frame.sequence = sequence;
  frame.timestamp_ns = timestamp_ns;
  frame.width_px = 2;
  frame.height_px = 1;
  frame.stride_bytes = 8;
  frame.pixels = std::move(pixels);
  return frame;
}

inline std::uint64_t slot_in(const Frame& frame) {
  std::uint64_t slot = 0;
  for (int i = 0; i < 8; ++i) {
    slot |= static_cast<std::uint64_t>(frame.pixels[i]) << (8 * i);
  }
  return slot;
}

/// What goes wrong, as probabilities per frame unless said otherwise.
struct Faults {
  double dropped_slot = 0;      ///< the trigger leaves slots out
  double counted_loss = 0;      ///< the driver's number goes on
  double uncounted_loss = 0;    ///< it does not: the camera missed its firing, or the device lost the frame
  double burst = 0;             ///< 5 to 40 frames lost in a row, counted
  double spurious = 0;          ///< an exposure nobody asked for, half a period later
  double duplicate = 0;         ///< delivered twice
  double corrupt = 0;           ///< marked by the driver
  double time_outlier = 0;      ///< a time stamp wrong by one period
  double number_restart = 0;    ///< the numbers begin anew
  bool permanent_jump = false;  ///< from some frame on all of a camera's time stamps are wrong by one period
  std::int64_t trigger_jitter_ns = 300 * kMicrosecond;
  std::int64_t time_jitter_ns = kMillisecond;         ///< of the time stamps, either way
  std::int64_t arrival_jitter_ns = 5 * kMillisecond;  ///< more than the usual way
};

/// Something the matcher is told, and when.
struct Happening {
  std::int64_t at_ns = 0;
  int camera = -1;  ///< -1: a firing
  std::uint64_t slot = 0;
  std::int64_t fired_ns = 0;
  Frame frame;
};

/// All that happens in `slot_count` slots of a rig, in order of time.
inline std::vector<Happening> play(std::mt19937_64& random, std::size_t camera_count, int slot_count,
                                   std::int64_t period_ns, const Faults& faults) {
  const auto chance = [&](double p) { return std::uniform_real_distribution<double>(0, 1)(random) < p; };
  const auto between = [&](std::int64_t low, std::int64_t high) {
    return std::uniform_int_distribution<std::int64_t>(low, high)(random);
  };
  constexpr std::int64_t kBegin_ns = 5'000'000'000;
  std::vector<Happening> happenings;
  struct Firing {
    std::uint64_t slot;
    std::int64_t fired_ns;
  };
  std::vector<Firing> firings;
  std::int64_t told_ns = 0;
  const auto first_slot = static_cast<std::uint64_t>(between(0, 1'000'000));
  for (int i = 0; i < slot_count; ++i) {
    if (chance(faults.dropped_slot)) {
      i += static_cast<int>(between(0, 6));
    }
    const std::uint64_t slot = first_slot + static_cast<std::uint64_t>(i);
    firings.push_back({slot, kBegin_ns + i * period_ns + between(0, faults.trigger_jitter_ns)});
    told_ns = std::max(told_ns, firings.back().fired_ns + between(10 * kMicrosecond, 5 * kMillisecond));
    happenings.push_back({told_ns, -1, slot, firings.back().fired_ns, {}});
  }
  for (std::size_t camera = 0; camera < camera_count; ++camera) {
    std::uint64_t sequence = chance(0.5)
                                 ? (std::uint64_t{1} << 32) - static_cast<std::uint64_t>(between(1, 100))
                                 : static_cast<std::uint64_t>(between(0, 3));
    const std::int64_t offset_ns = between(-3 * kMillisecond, 3 * kMillisecond);
    const std::int64_t transport_ns = between(8 * kMillisecond, 30 * kMillisecond);
    const std::int64_t jump_at = faults.permanent_jump ? between(50, slot_count) : slot_count + 1;
    const std::int64_t jump_ns = chance(0.5) ? period_ns : -period_ns;
    std::int64_t arrival_ns = 0;
    std::int64_t burst = 0;
    const auto deliver = [&](std::uint64_t slot, std::int64_t exposed_ns, std::int64_t wrong_ns) {
      arrival_ns = std::max(arrival_ns + 1, exposed_ns + transport_ns + between(0, faults.arrival_jitter_ns));
      Frame frame =
          painted(slot, sequence & 0xffffffff,
                  exposed_ns + offset_ns + between(-faults.time_jitter_ns, faults.time_jitter_ns) + wrong_ns);
      frame.corrupt = chance(faults.corrupt);
      happenings.push_back({arrival_ns, static_cast<int>(camera), slot, 0, frame});
      if (chance(faults.duplicate)) {
        happenings.push_back({++arrival_ns, static_cast<int>(camera), slot, 0, frame});
      }
    };
    for (std::size_t i = 0; i < firings.size(); ++i) {
      const Firing& firing = firings[i];
      if (chance(faults.uncounted_loss)) {
        continue;
      }
      if (chance(faults.number_restart)) {
        sequence = 0;
      }
      burst = burst > 0 ? burst - 1 : chance(faults.burst) ? between(5, 40) : 0;
      if (burst == 0 && !chance(faults.counted_loss)) {
        const bool jumped = static_cast<std::int64_t>(i) >= jump_at;
        const std::int64_t outlier_ns = !chance(faults.time_outlier) ? 0
                                        : chance(0.5)                ? period_ns
                                                                     : -period_ns;
        deliver(firing.slot, firing.fired_ns, jumped ? jump_ns : outlier_ns);
      }
      ++sequence;
      if (chance(faults.spurious)) {
        deliver(~std::uint64_t{0}, firing.fired_ns + period_ns / 2, 0);
        ++sequence;
      }
    }
  }
  std::stable_sort(happenings.begin(), happenings.end(),
                   [](const Happening& a, const Happening& b) { return a.at_ns < b.at_ns; });
  return happenings;
}

inline CaptureConfig rig(std::size_t camera_count) {
  CaptureConfig config;
  for (std::size_t i = 0; i < camera_count; ++i) {
    config.cameras.push_back({"camera." + std::to_string(i), 0});
  }
  return config;
}

}  // namespace facet::capture
