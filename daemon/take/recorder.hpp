#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "mesh/mesh_frame.hpp"
#include "take/picture_records.hpp"
#include "take/take_time.hpp"

namespace facet::take {

/// What record() does when the queue is full.
enum class WhenFull {
  Drop,  ///< live sources: the frame is not recorded and counted
  Wait,  ///< files: the caller waits, nothing is lost
};

struct TakeRecorderConfig {
  std::filesystem::path file;  ///< must not exist yet
  std::string source;          ///< for people: device or file that the frames come from
  std::string software;        ///< for people: program and version
  WhenFull when_full = WhenFull::Drop;
  int queue_frames = 64;
  /// Recording stops with a reason while this much of the disk is still free, bytes.
  std::uint64_t disk_reserve_bytes = 256ULL << 20;
  int compression_level = 1;  ///< of zstd, 1 to 19; pictures have a codec of their own
  bool with_images = false;   ///< the pictures of MeshFrame::images too, in segments
  PictureCoding picture_coding = PictureCoding::Lossless;
  /// A segment of pictures is ended before it would be longer, bytes.
  std::uint64_t segment_bytes = 1ULL << 30;
  /// How long another process may hold SQLite's write lock of the take, as a backup does, until recording
  /// stops.
  std::chrono::milliseconds lock_patience{2000};
  /// Asked on facet-take before every commit: what `meta` is to say besides (kMaxMetaEntries, kMaxMetaBytes).
  /// It must not wait. Null: nothing.
  std::function<MetaEntries()> more_meta{};
  int pack_threads = 0;  ///< 1 to 16; 0: as many as there are processors, 4 at most, and one without pictures
};

enum class RecorderState {
  Recording,
  /// Stopped on request: every frame that is counted was found in the take, under its name and on the disk,
  /// or RecorderStatus::warning says what is not known of that.
  Finished,
  /// Stopped by itself (disk full, take removed ...): `reason` says why. What was committed stays readable,
  /// where it lies.
  Failed,
};

const char* to_string(RecorderState state);

struct RecorderStatus {
  RecorderState state = RecorderState::Recording;
  std::string reason;   ///< why it ended, unless somebody asked for that
  std::string warning;  ///< Finished, but this is not known to be so; else empty
  std::filesystem::path file;
  std::uint64_t frames = 0;       ///< committed
  std::uint64_t mesh_frames = 0;  ///< of these, with a mesh
  std::uint64_t dropped = 0;      ///< lost to a full queue, or after a failure
  std::uint64_t bytes = 0;        ///< of blobs (frames, subjects, albedos) and pictures committed
  std::size_t queued = 0;         ///< waiting to be written
  bool marked = false;    ///< all is committed, with the marks of the end; what is left is to fold the log
  bool log_left = false;  ///< stopped, but a part is still in the log beside it, as a reader has it open
};

/// Writes one take: one SQLite file, and beside it the segments of its pictures. Both are committed every
/// half second, so that a killed process or a full disk loses one second at most. The threads `facet-pack-N`
/// encode frames and let go of their pictures; `facet-take` writes in the frames' order and alone blocks on
/// the disk. What waits for the disk is encoded: `queue_frames` of it.
///
/// Life: construct (creates the file, may throw Error) -> start -> record ... -> request_stop -> stop ->
/// destroy.
class TakeRecorder {
 public:
  /// Throws Error(Storage) where the file exists already or can't be written.
  explicit TakeRecorder(const TakeRecorderConfig& config);
  ~TakeRecorder();
  TakeRecorder(const TakeRecorder&) = delete;
  TakeRecorder& operator=(const TakeRecorder&) = delete;

  /// Throws Error(Internal) where a thread can't be made: nothing of the take is left then.
  void start();

  /// Queues one frame; one thread at a time. With WhenFull::Drop real-time safe (a lock held for a pointer's
  /// move). Returns false where the frame was not taken: queue full, failed or stopped.
  bool record(std::shared_ptr<const mesh::MeshFrame> frame);

  /// First phase: takes no more frames. reason: why, for RecorderStatus and the take's `end_reason`; empty
  /// where it was asked for; that of the first call stays. Any thread, returns at once.
  void request_stop(std::string reason = {});
  /// Second phase: what is queued is written, the write-ahead log is folded into the one file
  /// (RecorderStatus::log_left where a reader prevents it: close_take does it later), the threads join.
  /// Idempotent; the destructor calls both.
  RecorderStatus stop();

  /// True once the take is closed and its threads are through. Any thread, returns at once.
  bool ended() const;

  RecorderStatus status() const;  ///< any thread; never waits for the disk

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// FOLDER/NAME.take of a take, be it there or not. Throws Error(Usage) where it is no name of a take, as
/// below.
std::filesystem::path named_take(const std::filesystem::path& folder, const std::string& name);

/// FOLDER/NAME.take for `facet record start NAME`. Throws Error(Usage) where the name is empty, longer than
/// 100 bytes, starts with a dot or has a slash or control character, and Error(Storage) where such a take is
/// there already: a take is never overwritten and never renamed behind the user's back.
std::filesystem::path take_path(const std::filesystem::path& folder, const std::string& name);

/// `base`, or with a suffix -2, -3 ... where the folder has a take of that name already.
std::string free_take_name(const std::filesystem::path& folder, const std::string& base);

/// Name for a take that the user did not name: UTC start time, "2026-11-21T09-30-00Z", made free as above.
std::string default_take_name(const std::filesystem::path& folder,
                              std::chrono::system_clock::time_point start);

}  // namespace facet::take
