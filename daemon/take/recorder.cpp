#include "take/recorder.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <pthread.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <cerrno>
#include <cstring>
#include <exception>
#include <functional>
#include <map>
#include <new>
#include <optional>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "facet/assert.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "files/disk.hpp"
#include "files/output_file.hpp"
#include "stream/decoder.hpp"
#include "stream/encoder.hpp"
#include "take/database.hpp"
#include "take/picture_records.hpp"
#include "take/segment.hpp"
#include "take/take_file.hpp"
#include "take/take_tables.hpp"

namespace facet::take {
namespace {

// Half a second of frames is at risk; two syncs per second are no load for any disk.
constexpr auto kCommitPeriod = std::chrono::milliseconds(500);
// The write-ahead log is folded into the file every 8 MiB.
constexpr int kCheckpointPages = 512;
// A reader in the middle of a page may hold up the closing of the log for this long; the take is readable
// without it too.
constexpr auto kCloseTimeout = std::chrono::milliseconds(200);
// Who watches the folder may look into the new file before it is a take.
constexpr auto kCreateTimeout = std::chrono::seconds(2);
constexpr std::size_t kMaxTakeNameBytes = 100;
constexpr int kMostPackers = 16;

/// Makes an empty file that was not there before.
void create_file(const std::filesystem::path& file) {
  if (files::DiskFile::create(file, 0644)) {
    return;
  }
  const int error = errno;
  if (error == EEXIST) {
    throw Error(ErrorKind::Storage,
                fmt::format("take '{}' exists already: choose another name or move it away", file.string()));
  }
  throw Error(ErrorKind::Storage,
              fmt::format("cannot create take '{}': {}{}", file.string(), std::strerror(error),
                          error == ENOENT ? ": create its folder first" : ""));
}

/// What a recorder made that could not begin. The folder of pictures goes with its writer.
void remove_take(const std::filesystem::path& file) {
  for (const char* suffix : {"", "-wal", "-shm"}) {
    std::error_code ignored;
    std::filesystem::remove(file.string() + suffix, ignored);
  }
}

bool take_exists(const std::filesystem::path& file) {
  std::error_code ignored;
  return std::filesystem::exists(file, ignored) || std::filesystem::exists(segments_folder(file), ignored) ||
         std::filesystem::exists(sound_file_of(file), ignored);
}

std::int64_t stored_id(std::uint64_t id) {
  return std::bit_cast<std::int64_t>(id);
}

}  // namespace

const char* to_string(RecorderState state) {
  switch (state) {
    case RecorderState::Recording:
      return "recording";
    case RecorderState::Finished:
      return "finished";
    case RecorderState::Failed:
      return "failed";
  }
  return "unknown";
}

/// A frame as it is written. What it refers to is written before it.
struct PackedFrame {
  std::int64_t number = 0;
  std::uint64_t sequence = 0;
  std::int64_t timestamp_ns = 0;
  std::int64_t media_time_ns = 0;
  mesh::TrackingState state = mesh::TrackingState::Searching;
  bool has_mesh = false;
  std::shared_ptr<const mesh::Subject> subject;
  std::shared_ptr<const mesh::Albedo> albedo;
  std::vector<std::uint8_t> message;  ///< compressed
  std::vector<std::uint8_t> records;  ///< of the pictures; empty: none
  std::string fault;                  ///< why it could not be packed
};

/// Encodes frames: one in each facet-pack thread.
class FramePacker {
 public:
  explicit FramePacker(const TakeRecorderConfig& config)
      : with_images_(config.with_images),
        compressor_(config.compression_level),
        pictures_(config.picture_coding) {}

  void pack(const mesh::MeshFrame& frame, std::int64_t number, PackedFrame& out);

 private:
  void encode(const mesh::MeshFrame& frame, PackedFrame& out);

  bool with_images_;
  stream::Encoder encoder_;
  BlobCompressor compressor_;
  PictureWriter pictures_;
};

void FramePacker::encode(const mesh::MeshFrame& frame, PackedFrame& out) {
  const auto message = encoder_.frame(frame, stream::Profile::Displacements);
  out.has_mesh = stream::frame_references(message).subject_id != 0;
  const auto blob = compressor_.compress(message);
  out.message.assign(blob.begin(), blob.end());
}

void FramePacker::pack(const mesh::MeshFrame& frame, std::int64_t number, PackedFrame& out) {
  out.number = number;
  out.sequence = frame.sequence;
  out.timestamp_ns = frame.timestamp_ns;
  out.media_time_ns = frame.media_time_ns;
  out.state = frame.state;
  out.subject = frame.subject;
  out.albedo = frame.albedo;
  out.records.clear();
  out.fault.clear();
  if (with_images_ && frame.images != nullptr &&
      !pictures_.append(*frame.images, static_cast<std::uint64_t>(number), out.records)) {
    mesh::MeshFrame without = frame;
    without.degraded = true;
    without.degraded_reason = "pictures left out: too large for a take";
    encode(without, out);
    return;
  }
  encode(frame, out);
}

/// The files and their statements: facet-take only, once started.
class TakeWriter {
 public:
  explicit TakeWriter(const TakeRecorderConfig& config)
      : id_(new_take_id()),
        compressor_(config.compression_level),
        database_(config.file, Database::Mode::ReadWrite),
        file_(NamedFile::of(config.file)),
        schema_(make_schema(config)),
        insert_subject_(database_, "INSERT OR IGNORE INTO subject(id, data) VALUES(?, ?)"),
        insert_albedo_(database_, "INSERT OR IGNORE INTO albedo(subject_id, version, data) VALUES(?, ?, ?)"),
        insert_frame_(database_, "INSERT INTO frame VALUES(?, ?, ?, ?, ?, ?)"),
        insert_data_(database_, "INSERT INTO frame_data VALUES(?, ?)"),
        insert_pictures_(database_, "INSERT INTO pictures VALUES(?, ?, ?, ?)"),
        set_meta_(database_, "INSERT OR REPLACE INTO meta VALUES(?, ?)"),
        log_(NamedFile::of(std::filesystem::canonical(config.file).string() + "-wal")) {
    if (config.with_images) {
      segments_.emplace(config.file, id_, config.segment_bytes);
    }
    files::sync_folder(config.file.parent_path());
  }

  /// Writes a frame and what it refers to into the open transaction. Returns how many bytes these are.
  std::uint64_t write(const PackedFrame& frame);
  /// Begins a transaction where none is open.
  void begin() {
    if (!database_.in_transaction()) {
      database_.execute("BEGIN");
    }
  }
  /// The pictures first: no index ever names what is not on the disk. Throws where the files are no longer
  /// there under their names, too: what is written into them then is for nobody.
  void commit() {
    FACET_ASSERT(database_.in_transaction(), subject_id_);
    if (segments_) {
      segments_->sync();
    }
    database_.execute("COMMIT");
    try {
      file_.is_there();
      log_.is_there();
      if (segments_) {
        segments_->is_there();
      }
    } catch (const Error&) {
      database_.keep_log();  // what now bears its name may be another take's
      throw;
    }
  }
  /// Gives up the open transaction and the pictures of it.
  void give_up() {
    segments_.reset();
    if (database_.in_transaction()) {
      database_.execute("ROLLBACK");
    }
  }
  void mark_closed(std::uint64_t dropped, std::uint64_t mesh_frames, std::string_view reason);
  /// Of these what has changed.
  void put_meta(const MetaEntries& entries);
  /// Folds the write-ahead log into the file and removes it, as far as readers let it. What can't be written
  /// stays in the log.
  void close_log();
  /// Throws where the take's files are not what and where they were written; false where that can't be seen
  /// now. frames: committed.
  bool is_whole(std::uint64_t frames);

 private:
  bool make_schema(const TakeRecorderConfig& config);
  void set_meta(std::string_view key, std::string_view value);

  std::map<std::string, std::string> put_;  ///< by put_meta
  TakeId id_;
  stream::Encoder encoder_;
  BlobCompressor compressor_;
  Database database_;
  NamedFile file_;
  bool schema_;  ///< only orders the construction: the statements need the tables
  Statement insert_subject_;
  Statement insert_albedo_;
  Statement insert_frame_;
  Statement insert_data_;
  Statement insert_pictures_;
  Statement set_meta_;
  NamedFile log_;                          ///< there since the statements were prepared
  std::optional<SegmentWriter> segments_;  ///< none without pictures
  std::uint64_t subject_id_ = 0;           ///< written last
  std::uint64_t albedo_version_ = 0;
};

/// With one sync at its end: on a slow disk each takes seconds, and of a take that is being made nothing is
/// lost.
bool TakeWriter::make_schema(const TakeRecorderConfig& config) {
  database_.set_busy_timeout_ms(static_cast<int>(config.lock_patience.count()));
  database_.execute(fmt::format("PRAGMA page_size = {}", kPageBytes));
  database_.execute("PRAGMA synchronous = OFF");
  if (!database_.begin_log(kCreateTimeout)) {
    throw Error(ErrorKind::Storage, "another program holds the new file");
  }
  database_.execute("BEGIN");
  make_tables(database_, {config.source, config.software, id_});
  database_.execute("COMMIT");
  // Where a reader prevents it, the first frames' commit brings the tables to the disk with the log.
  database_.execute("PRAGMA wal_checkpoint(PASSIVE)");
  database_.sync();
  // FULL: a commit survives a power cut, not only a killed process.
  database_.execute("PRAGMA synchronous = FULL");
  database_.execute(fmt::format("PRAGMA wal_autocheckpoint = {}", kCheckpointPages));
  return true;
}

std::uint64_t TakeWriter::write(const PackedFrame& frame) {
  FACET_ASSERT(database_.in_transaction(), frame.number);
  std::uint64_t bytes = frame.message.size() + frame.records.size();
  if (!frame.fault.empty()) {
    throw Error(ErrorKind::Internal, frame.fault);
  }
  if (frame.subject != nullptr && frame.subject->id != subject_id_) {
    if (const std::string_view fault = stream::subject_fault(*frame.subject); !fault.empty()) {
      throw Error(ErrorKind::Usage, std::string(fault));
    }
    insert_subject_.bind(1, stored_id(frame.subject->id));
    const auto blob = compressor_.compress(encoder_.subject(*frame.subject, stream::Profile::Displacements));
    insert_subject_.bind(2, blob);
    insert_subject_.run();
    bytes += blob.size();
    subject_id_ = frame.subject->id;
    albedo_version_ = 0;
  }
  if (frame.subject != nullptr && frame.albedo != nullptr && frame.albedo->version != albedo_version_) {
    insert_albedo_.bind(1, stored_id(frame.subject->id));
    insert_albedo_.bind(2, stored_id(frame.albedo->version));
    const auto blob = compressor_.compress(encoder_.albedo(frame.subject->id, *frame.albedo));
    insert_albedo_.bind(3, blob);
    insert_albedo_.run();
    bytes += blob.size();
    albedo_version_ = frame.albedo->version;
  }
  insert_frame_.bind(1, frame.number);
  insert_frame_.bind(2, stored_id(frame.sequence));
  insert_frame_.bind(3, frame.timestamp_ns);
  insert_frame_.bind(4, frame.media_time_ns);
  insert_frame_.bind(5, static_cast<std::int64_t>(frame.state));
  insert_frame_.bind(6, static_cast<std::int64_t>(frame.has_mesh));
  insert_frame_.run();
  insert_data_.bind(1, frame.number);
  insert_data_.bind(2, std::span(frame.message));
  insert_data_.run();
  if (!frame.records.empty()) {
    FACET_ASSERT(segments_.has_value(), frame.number, frame.records.size());
    const Extent extent = segments_->append(frame.records);
    insert_pictures_.bind(1, frame.number);
    insert_pictures_.bind(2, extent.segment);
    insert_pictures_.bind(3, extent.position);
    insert_pictures_.bind(4, extent.bytes);
    insert_pictures_.run();
  }
  return bytes;
}

void TakeWriter::set_meta(std::string_view key, std::string_view value) {
  const std::string stored = cut_text(value, kMaxMetaBytes);
  set_meta_.bind(1, key);
  set_meta_.bind(2, std::string_view(stored));
  set_meta_.run();
}

void TakeWriter::put_meta(const MetaEntries& entries) {
  for (const auto& [key, value] : entries) {
    if (const auto known = put_.find(key); known == put_.end() || known->second != value) {
      set_meta(key, value);
      put_.insert_or_assign(key, value);
    }
  }
}

void TakeWriter::mark_closed(std::uint64_t dropped, std::uint64_t mesh_frames, std::string_view reason) {
  begin();
  set_meta("dropped", std::to_string(dropped));
  set_meta("mesh_frames", std::to_string(mesh_frames));
  set_meta("end_reason", reason);
  set_meta("closed", "1");
}

void TakeWriter::close_log() {
  FACET_ASSERT(!database_.in_transaction(), subject_id_);
  try {
    database_.set_busy_timeout_ms(static_cast<int>(kCloseTimeout.count()));
    database_.execute("PRAGMA wal_checkpoint(TRUNCATE)");
    database_.end_log(kCloseTimeout);
  } catch (...) {
    // The kernel tells of a page that it could not write once: a second sync that succeeds proves nothing.
    database_.keep_log();
    throw;
  }
}

bool TakeWriter::is_whole(std::uint64_t frames) {
  bool seen = file_.is_there();
  if (segments_) {
    seen = segments_->are_all_there() && seen;
  }
  database_.execute("PRAGMA shrink_memory");  // from the file, not from what is remembered of it
  const auto found = static_cast<std::uint64_t>(database_.query_int64("SELECT count(*) FROM frame"));
  if (found != frames) {
    throw Error(ErrorKind::Storage, fmt::format("'{}' holds {} frames of the {} that were written",
                                                file_.path.string(), found, frames));
  }
  return seen;
}

struct TakeRecorder::Impl {
  explicit Impl(const TakeRecorderConfig& given) : config(given) {
    ring.resize(static_cast<std::size_t>(std::max(1, config.queue_frames)));
    shown.file = config.file;
  }

  /// A frame in the queue: first as it came, then packed; in between a facet-pack has it.
  struct Place {
    std::shared_ptr<const mesh::MeshFrame> frame;
    std::unique_ptr<PackedFrame> packed;
  };

  TakeRecorderConfig config;
  std::optional<TakeWriter> writer;  ///< facet-take only, once started

  mutable Mutex mutex;
  Condition to_pack;  ///< a frame came, or the end
  Condition work;     ///< the next frame is packed, or the end
  Condition room;     ///< WhenFull::Wait: a place came free, or the end
  /// Frame n of the take is in place n % size, from when it is taken until it is written.
  std::vector<Place> ring FACET_GUARDED_BY(mutex);
  std::uint64_t taken FACET_GUARDED_BY(mutex) = 0;    ///< frames so far
  std::uint64_t packing FACET_GUARDED_BY(mutex) = 0;  ///< of these, given to a facet-pack
  std::uint64_t written FACET_GUARDED_BY(mutex) = 0;  ///< of these, given to facet-take
  /// Keep their memory; as many as were ever in use.
  std::vector<std::unique_ptr<PackedFrame>> spare FACET_GUARDED_BY(mutex);
  bool stopping FACET_GUARDED_BY(mutex) = false;   ///< takes no more frames
  std::string end_reason FACET_GUARDED_BY(mutex);  ///< given by who asked for the end
  std::string pack_fault FACET_GUARDED_BY(mutex);  ///< why a facet-pack ended early; else empty
  RecorderStatus shown FACET_GUARDED_BY(mutex);

  // facet-take only.
  RecorderStatus counted;                       ///< with what the open transaction holds
  std::optional<Clock::time_point> commit_due;  ///< set while a transaction is open

  std::atomic<bool> ended{false};  ///< the take is closed, or never will be
  // Last, so that they are joined before anything is freed.
  std::vector<std::jthread> packers;  ///< facet-pack-N
  std::jthread thread;                ///< facet-take

  void put_more_meta() {
    if (config.more_meta) {
      writer->put_meta(config.more_meta());
    }
  }
  std::size_t queued() const FACET_REQUIRES(mutex) { return static_cast<std::size_t>(taken - written); }
  bool take_in(std::shared_ptr<const mesh::MeshFrame> frame);
  void pack_until_stopped();
  void run_packer(int index);
  std::string told(const char* doing, const std::exception& error) const;
  bool attempt(const char* doing, const std::function<void()>& work);
  std::unique_ptr<PackedFrame> wait_for_frame(bool& at_end);
  void write_until_stopped();
  void write(const PackedFrame& frame);
  void show_committed();
  void check_disk() const;
  void fail(std::string reason);
  void close();
  void finish();
  void run();
  void join();
};

/// What went wrong, for people. Where there is no memory for that, it says so without any.
std::string TakeRecorder::Impl::told(const char* doing, const std::exception& error) const {
  try {
    if (dynamic_cast<const std::bad_alloc*>(&error) == nullptr) {
      return dynamic_cast<const Error*>(&error) != nullptr
                 ? error.what()
                 : fmt::format("cannot {} take '{}': {}", doing, config.file.string(), error.what());
    }
  } catch (const std::bad_alloc&) {
    // The same end.
  }
  return "out of memory";
}

/// Does some of the take's work; what prevents it ends the recording. False then.
bool TakeRecorder::Impl::attempt(const char* doing, const std::function<void()>& step) {
  try {
    step();
    return true;
  } catch (const std::exception& error) {
    fail(told(doing, error));
    return false;
  }
}

void TakeRecorder::Impl::run_packer(int index) {
  ::pthread_setname_np(::pthread_self(), fmt::format("facet-pack-{}", index).c_str());
  // Who hands a frame in must not give up its processor to the one whom it wakes.
  const sched_param any{};
  ::pthread_setschedparam(::pthread_self(), SCHED_BATCH, &any);
  try {
    pack_until_stopped();
  } catch (const std::exception& error) {
    std::string why = told("encode", error);
    const Lock lock(mutex);
    pack_fault = std::move(why);
    work.notify_one();
  }
}

void TakeRecorder::Impl::pack_until_stopped() {
  FramePacker packer(config);
  const Lock lock(mutex);
  while (true) {
    to_pack.wait(mutex, [this]() FACET_REQUIRES(mutex) { return packing < taken || stopping; });
    if (packing >= taken) {
      return;
    }
    FACET_ASSERT(written <= packing && taken - written <= ring.size(), written, packing, taken, ring.size());
    const std::uint64_t number = packing++;
    std::shared_ptr<const mesh::MeshFrame> frame = std::exchange(ring[number % ring.size()].frame, nullptr);
    FACET_ASSERT(frame != nullptr, number, written, taken);
    std::unique_ptr<PackedFrame> packed;
    if (!spare.empty()) {
      packed = std::move(spare.back());
      spare.pop_back();
    }
    {
      const Unlock unlock(mutex);
      if (packed == nullptr) {
        packed = std::make_unique<PackedFrame>();
      }
      try {
        packer.pack(*frame, static_cast<std::int64_t>(number), *packed);
      } catch (const std::exception& error) {
        packed->fault = told("encode", error);
      }
      frame = nullptr;  // the pictures go back to their cameras
    }
    FACET_ASSERT(ring[number % ring.size()].packed == nullptr, number, written, taken);
    ring[number % ring.size()].packed = std::move(packed);
    if (number == written) {
      work.notify_one();
    }
  }
}

/// The next frame; null at the commit's time or, with `ended`, at the end of the queue after request_stop.
/// Throws where the frames can't be encoded.
std::unique_ptr<PackedFrame> TakeRecorder::Impl::wait_for_frame(bool& at_end) {
  const Lock lock(mutex);
  const auto ready = [this]() FACET_REQUIRES(mutex) {
    const bool next = queued() > 0 ? ring[written % ring.size()].packed != nullptr : stopping;
    return next || !pack_fault.empty();
  };
  if (commit_due) {
    work.wait_until(mutex, Clock::wake(*commit_due), ready);
  } else {
    work.wait(mutex, ready);
  }
  if (!pack_fault.empty()) {
    throw Error(ErrorKind::Internal, pack_fault);
  }
  FACET_ASSERT(written <= packing && packing <= taken, written, packing, taken);
  at_end = stopping && queued() == 0;
  if (queued() == 0) {
    return nullptr;
  }
  std::unique_ptr<PackedFrame> frame = std::move(ring[written % ring.size()].packed);
  if (frame != nullptr) {
    FACET_ASSERT(std::cmp_equal(frame->number, written), frame->number, written, packing, taken);
    ++written;
    room.notify_one();
  }
  return frame;
}

/// Throws Error(Storage) where the reserve is touched. A file system that can't tell is trusted.
void TakeRecorder::Impl::check_disk() const {
  struct statvfs status {};
  if (::statvfs(config.file.c_str(), &status) != 0) {
    return;
  }
  const std::uint64_t free_bytes = static_cast<std::uint64_t>(status.f_bavail) * status.f_frsize;
  if (free_bytes < config.disk_reserve_bytes) {
    throw Error(ErrorKind::Storage,
                fmt::format("disk nearly full: {} MiB are free, {} MiB are kept in reserve: free some space",
                            free_bytes >> 20, config.disk_reserve_bytes >> 20));
  }
}

void TakeRecorder::Impl::show_committed() {
  commit_due.reset();
  const Lock lock(mutex);
  FACET_ASSERT(counted.frames >= shown.frames && counted.mesh_frames <= counted.frames, counted.frames,
               shown.frames, counted.mesh_frames);
  FACET_ASSERT(counted.frames <= written, counted.frames, written);
  shown.frames = counted.frames;
  shown.mesh_frames = counted.mesh_frames;
  shown.bytes = counted.bytes;
}

void TakeRecorder::Impl::write(const PackedFrame& frame) {
  FACET_ASSERT(std::cmp_equal(frame.number, counted.frames), frame.number, counted.frames);
  if (!commit_due) {
    writer->begin();
    commit_due = Clock::now() + kCommitPeriod;
  }
  counted.bytes += writer->write(frame);
  ++counted.frames;
  counted.mesh_frames += frame.has_mesh ? 1 : 0;
}

/// The last transaction stays open: the marks of the end go into it.
void TakeRecorder::Impl::write_until_stopped() {
  for (bool at_end = false; !at_end;) {
    std::unique_ptr<PackedFrame> frame = wait_for_frame(at_end);
    if (frame != nullptr) {
      write(*frame);
      frame->subject = nullptr;
      frame->albedo = nullptr;
      const Lock lock(mutex);
      spare.push_back(std::move(frame));
    }
    if (commit_due && !at_end && Clock::now() >= *commit_due) {
      put_more_meta();
      writer->commit();
      show_committed();
      check_disk();
    }
  }
}

/// Takes no more frames and lets nobody wait; what is queued or not committed counts as dropped. The first
/// reason stays.
void TakeRecorder::Impl::fail(std::string reason) {
  const Lock lock(mutex);
  stopping = true;
  if (shown.state == RecorderState::Failed) {
    return;
  }
  shown.state = RecorderState::Failed;
  shown.reason = std::move(reason);
  FACET_ASSERT(shown.frames <= taken, shown.frames, taken);
  shown.dropped += taken - shown.frames;
  FACET_ASSERT(queued() <= ring.size(), taken, written, ring.size());
  for (Place& place : ring) {
    place.frame = nullptr;
  }
  packing = taken;
  written = taken;
  to_pack.notify_all();
  room.notify_all();
}

/// Commits the last frames with the marks of the end, folds the log and looks at what is there then. Throws
/// where the take is not what was recorded.
void TakeRecorder::Impl::close() {
  std::uint64_t dropped = 0;
  std::string reason;
  {
    const Lock lock(mutex);
    dropped = shown.dropped;
    reason = end_reason;
    shown.reason = reason;
  }
  writer->mark_closed(dropped, counted.mesh_frames, reason);
  put_more_meta();
  writer->commit();
  show_committed();
  {
    const Lock lock(mutex);
    shown.marked = true;
  }
  std::string warning;
  try {
    writer->close_log();
  } catch (const DatabaseError& error) {
    warning = fmt::format("not known to be on the disk: {}", error.what());
  }
  try {
    if (!writer->is_whole(counted.frames) && warning.empty()) {
      warning = "not known to be whole: its files can't be looked at";
    }
  } catch (const DatabaseError& error) {
    warning = fmt::format("not known to be readable: {}", error.what());
  }
  const Lock lock(mutex);
  shown.warning = std::move(warning);
}

/// The take's end, whatever it was. On a full disk the last marks may fail: the take is readable as it is.
void TakeRecorder::Impl::finish() {
  bool failed = false;
  {
    const Lock lock(mutex);
    failed = shown.state == RecorderState::Failed;
  }
  if (failed || !attempt("close", [this] { close(); })) {
    try {
      writer->give_up();
      const RecorderStatus end = [this] {
        const Lock lock(mutex);
        return shown;
      }();
      writer->mark_closed(end.dropped, end.mesh_frames, end.reason);
      put_more_meta();
      writer->commit();
      writer->close_log();
    } catch (const std::exception&) {
      // It failed for a reason that is told; what is missing in it now is only that.
    }
  }
  writer.reset();
  std::uint64_t left = 0;
  try {
    left = log_bytes(config.file);
  } catch (const std::bad_alloc&) {
    // It is a note for people.
  }
  const Lock lock(mutex);
  shown.log_left = left > 0;
  if (shown.state == RecorderState::Recording) {
    shown.state = RecorderState::Finished;
  }
}

void TakeRecorder::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-take");
  attempt("write", [this] { write_until_stopped(); });
  finish();
  ended = true;
}

void TakeRecorder::Impl::join() {
  if (thread.joinable()) {
    thread.join();
    packers.clear();
  } else if (writer) {
    finish();  // never started: the empty take is closed properly
    ended = true;
  }
}

TakeRecorder::TakeRecorder(const TakeRecorderConfig& config) : impl_(std::make_unique<Impl>(config)) {
  create_file(config.file);
  try {
    impl_->check_disk();
    impl_->writer.emplace(config);
  } catch (const std::exception& error) {
    remove_take(config.file);
    const auto* known = dynamic_cast<const Error*>(&error);
    throw Error(known != nullptr ? known->kind() : ErrorKind::Storage,
                fmt::format("cannot create take '{}': {}", config.file.string(), error.what()));
  }
}

TakeRecorder::~TakeRecorder() {
  request_stop();
  impl_->join();
}

void TakeRecorder::start() {
  Impl& impl = *impl_;
  const int processors = static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1U, 4U));
  const int automatic = impl.config.with_images ? processors : 1;
  const int count =
      impl.config.pack_threads > 0 ? std::min(impl.config.pack_threads, kMostPackers) : automatic;
  try {
    for (int i = 0; i < count; ++i) {
      impl.packers.emplace_back([&impl, i] { impl.run_packer(i); });
    }
    impl.thread = std::jthread([&impl] { impl.run(); });
  } catch (const std::exception& error) {
    request_stop();
    impl.packers.clear();
    impl.fail("no thread");
    impl.writer.reset();
    remove_take(impl.config.file);
    throw Error(ErrorKind::Internal, fmt::format("cannot record take '{}': no thread for it: {}",
                                                 impl.config.file.string(), error.what()));
  }
}

/// False where the frame is not taken.
bool TakeRecorder::Impl::take_in(std::shared_ptr<const mesh::MeshFrame> frame) {
  const Lock lock(mutex);
  const auto has_room = [this]() FACET_REQUIRES(mutex) { return queued() < ring.size() || stopping; };
  if (config.when_full == WhenFull::Wait) {
    room.wait(mutex, has_room);
  }
  if (frame == nullptr) {
    return false;
  }
  if (stopping || !has_room()) {
    // A frame that comes after the take's end is none of its losses.
    const bool ended_on_request = stopping && shown.state != RecorderState::Failed;
    shown.dropped += ended_on_request ? 0 : 1;
    return false;
  }
  Place& place = ring[taken % ring.size()];
  FACET_ASSERT(place.frame == nullptr && place.packed == nullptr, taken, written, ring.size());
  place.frame = std::move(frame);
  ++taken;
  return true;
}

bool TakeRecorder::record(std::shared_ptr<const mesh::MeshFrame> frame) {
  const bool taken = impl_->take_in(std::move(frame));
  if (taken) {
    impl_->to_pack.notify_one();
  }
  return taken;
}

void TakeRecorder::request_stop(std::string reason) {
  const Lock lock(impl_->mutex);
  if (!std::exchange(impl_->stopping, true)) {
    impl_->end_reason = std::move(reason);
  }
  impl_->to_pack.notify_all();
  impl_->work.notify_all();
  impl_->room.notify_all();
}

RecorderStatus TakeRecorder::stop() {
  request_stop();
  impl_->join();
  return status();
}

bool TakeRecorder::ended() const {
  return impl_->ended;
}

RecorderStatus TakeRecorder::status() const {
  const Lock lock(impl_->mutex);
  RecorderStatus status = impl_->shown;
  status.queued = impl_->queued();
  return status;
}

std::filesystem::path named_take(const std::filesystem::path& folder, const std::string& name) {
  const bool bad_character = std::any_of(name.begin(), name.end(), [](char character) {
    const auto code = static_cast<unsigned char>(character);
    return character == '/' || code < 0x20 || code == 0x7F;
  });
  if (name.empty() || name.size() > kMaxTakeNameBytes || name.front() == '.' || bad_character) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' is no name for a take: 1 to {} bytes, no slash, no control character, not "
                            "beginning with a dot",
                            name, kMaxTakeNameBytes));
  }
  return folder / (name + ".take");
}

std::filesystem::path take_path(const std::filesystem::path& folder, const std::string& name) {
  std::filesystem::path file = named_take(folder, name);
  if (take_exists(file)) {
    throw Error(ErrorKind::Storage,
                fmt::format("take '{}', or its folder of pictures or its sound, exists already: choose "
                            "another name or move it away",
                            file.string()));
  }
  return file;
}

std::string default_take_name(const std::filesystem::path& folder,
                              std::chrono::system_clock::time_point start) {
  return free_take_name(folder, utc_text(start, "{:%Y-%m-%dT%H-%M-%SZ}"));
}

std::string free_take_name(const std::filesystem::path& folder, const std::string& base) {
  std::string name = base;
  for (int next = 2; take_exists(folder / (name + ".take")); ++next) {
    name = fmt::format("{}-{}", base, next);
  }
  return name;
}

}  // namespace facet::take
