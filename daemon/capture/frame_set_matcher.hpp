#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/frame_set.hpp"

namespace facet::capture {

/// Decides which frame belongs to which slot. Three witnesses are heard: the frame's time stamp against the
/// trigger's actual time, its sequence number against the number of firings, and, where these two disagree,
/// the time of its arrival. A frame is used where time and sequence agree. After a disagreement (a firing
/// that the camera missed, a loss that the driver did not count, a time stamp that jumped) its frames are
/// refused until three in a row agree with one another and arrived as long after their time stamps as frames
/// did before. So a camera that slipped by a slot stays out, and is reported, rather than come in shifted.
///
/// Every time is an argument, CLOCK_MONOTONIC ns, and does not decrease; one thread (FrameSetAssembler makes
/// it safe for many). Allocates nothing once constructed.
class FrameSetMatcher {
 public:
  /// Throws Error(Usage) for a configuration that can't be.
  explicit FrameSetMatcher(const CaptureConfig& config);

  /// The cameras were fired for a slot; numbers grow. Not for free-running cameras.
  void fired(std::uint64_t slot, std::int64_t fired_ns);

  /// A frame arrived; those of one camera in the order of their exposure. A frame may come before its firing
  /// is told: up to 8 of each camera wait for theirs, `deadline_ns` at most.
  void push(std::size_t camera, Frame frame, std::int64_t now_ns);

  /// A camera that does not stream is not waited for. One that begins anew must agree with itself for three
  /// frames, and its frames must take as long to arrive as before. At first all stream.
  void set_streaming(std::size_t camera, bool streaming);

  /// Deals with what has waited too long. Call it before take.
  void advance(std::int64_t now_ns);

  /// The oldest set, once it is complete, can't become complete any more or has reached its deadline; sets
  /// come in the order of their slots. False where there is none. The frames `out` held are released.
  bool take(FrameSet& out, std::int64_t now_ns);

  /// When advance or take may have something to do even if nothing arrives; none where there is no such time.
  std::optional<std::int64_t> next_deadline_ns() const;

  const CaptureStatistics& statistics() const { return statistics_; }

 private:
  static constexpr std::size_t kPending = 8;   // frames of a camera that wait for their firing
  static constexpr std::size_t kHistory = 64;  // firings that are remembered

  struct Firing {
    std::uint64_t slot = 0;
    std::int64_t fired_ns = 0;
  };
  struct Pending {
    Frame frame;
    std::int64_t arrival_ns = 0;
  };
  /// A frame's number and the firing that its time fits.
  struct Step {
    std::uint64_t sequence = 0;
    std::uint64_t firing = 0;
  };
  struct CameraTrack {
    std::int64_t nominal_offset_ns = 0;
    bool streaming = true;
    std::array<Pending, kPending> pending;  ///< oldest first
    std::size_t pending_count = 0;
    std::optional<Step> trusted;  ///< the last frame on which time and sequence agreed
    std::optional<Step> doubted;  ///< the last one on which they did not
    int agreeing = 0;  ///< frames in a row, the last of them `doubted`, that agree with one another
    std::uint64_t refused_since_trusted = 0;
    std::optional<std::uint64_t> newest_firing;  ///< older ones get nothing from this camera any more
    bool transport_known = false;
    double variance_ns2 = 0;
  };
  struct OpenSet {
    FrameSet set;
    std::uint64_t firing = 0;
  };
  struct Place {
    enum class Kind { Wait, Found, NoSlot, TimeDisagrees } kind = Kind::Wait;
    std::uint64_t firing = 0;
  };

  const Firing& firing(std::uint64_t number) const { return history_[number % kHistory]; }
  bool triggered() const { return config_.synchronisation == Synchronisation::Triggered; }
  void open(std::uint64_t slot, std::int64_t fired_ns);
  void follow_reference(std::int64_t time_ns);
  Place place_of(std::size_t camera, std::int64_t time_ns) const;
  void settle(std::size_t camera);
  void judge(std::size_t camera, Pending& pending, std::uint64_t firing_number);
  std::optional<Refusal> judge_sequence(std::size_t camera, const Pending& pending,
                                        std::uint64_t firing_number);
  void learn(std::size_t camera, const Pending& pending, std::uint64_t firing_number);
  void refuse(std::size_t camera, Refusal cause);
  void misplaced(std::size_t camera, Refusal cause);
  void pop_pending(std::size_t camera);
  OpenSet& open_set(std::size_t i) { return open_[(first_open_ + i) % open_.size()]; }
  bool ready(const OpenSet& set, std::int64_t now_ns) const;
  void finish(FrameSet& set);

  CaptureConfig config_;
  std::int64_t tolerance_ns_;
  std::vector<CameraTrack> cameras_;
  std::array<Firing, kHistory> history_{};
  std::uint64_t firings_ = 0;  ///< so far; the newest is firings_ - 1
  std::vector<OpenSet> open_;  ///< a ring
  std::size_t first_open_ = 0;
  std::size_t open_count_ = 0;
  std::size_t reference_ = 0;  ///< free-running: the camera whose frames are the slots
  CaptureStatistics statistics_;
  std::shared_ptr<const std::vector<std::string>> camera_names_;
};

}  // namespace facet::capture
