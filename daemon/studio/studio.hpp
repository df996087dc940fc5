#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "animate/animation.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::studio {

/// What the studio puts on the stream.
enum class Shown : std::uint8_t {
  Pose,  ///< what the control points make
  Take,  ///< the take as it was recorded
  Keys,  ///< the animation of the take's keys
};

enum class StudioState : std::uint8_t {
  Closed,
  Opening,    ///< the take is read and reduced; the live face is still on the stream
  Ready,      ///< a face stands, or follows the control points
  Preparing,  ///< the animation's ways from key to key are sought
  Playing,
  Exporting,
};

const char* to_string(Shown shown);
const char* to_string(StudioState state);

/// Of the last events, ms.
struct StudioTimes {
  float mean = 0;
  float p95 = 0;
  float most = 0;
};

struct StudioStatus {
  StudioState state = StudioState::Closed;
  std::string take;  ///< its name; "" while closed
  std::string
      reason;  ///< for people: why the last command failed or the take was closed; "" where all is well
  std::int64_t done = 0;  ///< of total: frames read while opening, or written while exporting
  std::int64_t total = 0;
  bool posing = false;  ///< control points may be set
  Shown shown = Shown::Take;
  double time_s = 0;                            ///< of what is shown, from its beginning; 0 for a pose
  double duration_s = 0;                        ///< of the take
  std::chrono::seconds lease{0};                ///< as Studio::open has it
  std::uint64_t frame = 0;                      ///< shown of the take, MeshFrame::sequence there
  std::uint64_t events = 0;                     ///< poses that were asked for since the opening
  std::uint64_t superseded = 0;                 ///< of these, replaced by a newer one before they were solved
  std::uint64_t solved = 0;                     ///< the rest, on the stream
  StudioTimes latency;                          ///< of the last 256 poses, from the command to the stream
  StudioTimes work;                             ///< likewise, solving and blending alone
  std::vector<animate::ControlTarget> targets;  ///< of the pose that was solved last
  std::vector<animate::ControlOutcome> outcomes;  ///< [targets]
  std::vector<std::uint8_t> on_boundary;          ///< [targets] 1: the vertex is on the mesh's open edge
  std::vector<std::pair<std::string, std::int32_t>> places;
  std::vector<std::string> warnings;  ///< of the animation that was prepared last
  std::filesystem::path exported;     ///< the last take that was written
};

/// The soft regions of the pose's control points [SF04 eq. 22] in colours.
struct RegionColours {
  std::vector<std::int32_t> vertices;                ///< of the control points; one region each
  std::vector<std::array<std::uint8_t, 3>> colours;  ///< [vertices] sRGB
  std::vector<std::uint8_t> rgb;  ///< [finest vertex_count][3] each region's share of its colour
};

/// A take in the live face's place on the stream: replayed, posed by control points (puppeteering), animated
/// by keys. While one is open, `hold_live(true)` has been called and the pipeline goes on unseen.
///
/// One thread, `facet-studio`, which start begins and stop joins, and which alone solves and publishes; it
/// blocks on the disk, but for open, set_keys, save_key and export_keys, which look at files. The methods
/// below are for any thread: they check what is asked, leave it for the thread and return at once. What is
/// left has room for one: a pose, a place in time or a halt takes the place of the one before, so that a
/// controller of any speed holds nothing up (newest wins).
///
/// Methods throw Error(Usage) where what is asked makes no sense now, with a sentence for people;
/// Error(Unavailable) while a take is being opened. What fails later stands in status().reason.
class Studio {
 public:
  using Show = std::function<void(std::shared_ptr<const mesh::MeshFrame>)>;

  /// folder: of the takes. show: puts a face before everybody who follows the live one (the stream, the
  /// bridges); hold_live: whether the live face is kept from them. Both are called on the thread.
  Studio(std::filesystem::path folder, Show show, std::function<void(bool)> hold_live, std::string software);
  ~Studio();
  Studio(const Studio&) = delete;
  Studio& operator=(const Studio&) = delete;

  void start();
  void request_stop();    ///< first phase; any thread, idempotent
  bool finished() const;  ///< the thread has ended; a face graph that is being made ends first
  void stop();            ///< second phase: joins

  /// Closes what is open and opens a take; posing: for control points and keys too (makes the reduced basis
  /// where there is none, which takes long for long takes). lease: how long it stays open while nobody wants
  /// anything of it, for whoever opened it may be gone; 0: until it is closed.
  void open(const std::string& take, bool posing, std::chrono::seconds lease = kLease);
  void close();
  /// Somebody is still there: the lease begins anew, as with every other wish.
  void keep();

  /// Replaces, adds or moves, and removes control points. Returns the event's number, which stands in
  /// status().events.
  std::uint64_t set_controls(const std::vector<animate::KeyControl>& controls, bool whole, bool beyond);
  std::uint64_t move_control(const animate::KeyControl& control);
  std::uint64_t remove_control(const std::string& vertex);

  /// time_s: from the beginning of the take or of the animation; beyond the end is the end. At the end it
  /// stands or, looped, begins again.
  void play(Shown what, double from_s, bool loop);
  void seek(Shown what, double time_s);
  void pause();
  /// Breaks off what is prepared or exported; the take stays open. So does a pose, a pause or a place of the
  /// take that is asked for while an animation is prepared. A take that is being opened is closed.
  void cancel();

  /// The keys of the open take (docs/animation.md; JSON), kept beside it in NAME.keys.json; "" where there
  /// are none yet.
  std::string keys() const;
  void set_keys(const std::string& text);  ///< "": none
  /// The pose's control points as a key at a time, in place of one that is there. Returns the keys.
  std::string save_key(double time_s);
  /// Records the animation of the keys as a take of this name. Returns its file.
  std::filesystem::path export_keys(const std::string& name);

  /// Of the pose that was solved last; empty where it has no control points.
  RegionColours regions() const;
  StudioStatus status() const;

  static constexpr std::chrono::seconds kLease{300};
  /// A face that stands is sent again so often, for readers that come.
  static constexpr std::chrono::milliseconds kRepeat{500};

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::studio
