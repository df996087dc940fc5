#include "take/cutting.hpp"

#include <fmt/format.h>
#include <sys/statvfs.h>

#include <algorithm>
#include <bit>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "files/disk.hpp"
#include "files/output_file.hpp"
#include "stream/decoder.hpp"
#include "take/database.hpp"
#include "take/moving.hpp"
#include "take/picture_records.hpp"
#include "take/segment.hpp"
#include "take/take_file.hpp"
#include "take/take_tables.hpp"
#include "take/take_time.hpp"

namespace facet::take {
namespace {

constexpr std::uint64_t kSegmentBytes = 1ULL << 30;
constexpr double kSameTime_s = 1e-6;

std::int64_t stored(std::uint64_t id) {
  return std::bit_cast<std::int64_t>(id);
}

void check_disk(const CutConfig& config) {
  struct statvfs status {};
  if (::statvfs(config.to.parent_path().c_str(), &status) != 0) {
    return;
  }
  const std::uint64_t free_bytes = static_cast<std::uint64_t>(status.f_bavail) * status.f_frsize;
  if (free_bytes < config.disk_reserve_bytes) {
    throw Error(ErrorKind::Storage,
                fmt::format("disk nearly full: {} MiB are free, {} MiB are kept in reserve: free some space",
                            free_bytes >> 20, config.disk_reserve_bytes >> 20));
  }
}

/// A folder that goes with its owner.
class WorkFolder {
 public:
  explicit WorkFolder(std::filesystem::path path) : path_(std::move(path)) {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);  // of a cut whose process was killed
    files::make_folder(path_);
  }
  ~WorkFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  WorkFolder(const WorkFolder&) = delete;
  WorkFolder& operator=(const WorkFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

Database made_database(const std::filesystem::path& file) {
  if (!files::DiskFile::create(file, 0644)) {
    throw Error(ErrorKind::Storage, fmt::format("cannot create '{}'", file.string()));
  }
  Database database(file, Database::Mode::ReadWrite);
  database.execute(fmt::format("PRAGMA page_size = {}", kPageBytes));
  // Until the end nobody knows the file: only then it must be on the disk.
  database.execute("PRAGMA journal_mode = MEMORY");
  database.execute("PRAGMA synchronous = OFF");
  return database;
}

/// One cut: reads from one take, writes into another that nobody knows yet.
class Cut {
 public:
  Cut(const CutConfig& config, TakeReader& reader, std::filesystem::path file)
      : config_(config),
        reader_(reader),
        file_(std::move(file)),
        source_(config.from, Database::Mode::ReadOnly),
        target_(made_database(file_)),
        begun_(begin()),
        data_(source_, "SELECT data FROM frame_data WHERE number = ?"),
        put_frame_(target_, "INSERT INTO frame VALUES(?, ?, ?, ?, ?, ?)"),
        put_data_(target_, "INSERT INTO frame_data VALUES(?, ?)"),
        put_pictures_(target_, "INSERT INTO pictures VALUES(?, ?, ?, ?)") {
    if (reader.info().format_version >= 2) {
      pictures_.emplace(source_, "SELECT segment, position, bytes FROM pictures WHERE number = ?");
      segments_.emplace(config.from, take_id_from(source_text("take_id")));
    }
  }

  void copy(std::int64_t number);
  void finish();

 private:
  bool begin();
  std::string source_text(std::string_view key);
  void put_meta(std::string_view key, std::string_view value);
  std::span<const std::uint8_t> blob_of(Statement& select, const std::string& what);
  void copy_references(const stream::FrameReferences& wanted);
  void copy_pictures(std::int64_t number);
  [[noreturn]] void reject(const std::string& what) const {
    throw Error(ErrorKind::UnreadableInput, fmt::format("take '{}': {}", config_.from.string(), what));
  }

  const CutConfig& config_;
  TakeReader& reader_;
  std::filesystem::path file_;
  TakeId id_ = new_take_id();
  Database source_;
  Database target_;
  bool begun_;  ///< only orders the construction: the statements need the tables
  Statement data_;
  Statement put_frame_;
  Statement put_data_;
  Statement put_pictures_;
  std::optional<Statement> pictures_;      ///< none before version 2
  std::optional<SegmentReader> segments_;  ///< likewise
  std::optional<SegmentWriter> written_;   ///< with the first frame that has pictures
  std::vector<std::uint8_t> message_;      ///< reused
  std::vector<std::uint8_t> records_;      ///< reused
  stream::FrameReferences last_;           ///< copied
  std::int64_t mesh_frames_ = 0;
};

/// Both takes stay as they are from here on: the source for this connection, the new one for everybody.
bool Cut::begin() {
  source_.execute("BEGIN");
  target_.execute("BEGIN");
  make_tables(target_, {source_text("source"), config_.software, id_});
  return true;
}

std::string Cut::source_text(std::string_view key) {
  Statement select(source_, "SELECT value FROM meta WHERE key = ?");
  select.bind(1, key);
  return select.step() ? select.column_text(0) : std::string();
}

void Cut::put_meta(std::string_view key, std::string_view value) {
  Statement put(target_, "INSERT OR REPLACE INTO meta VALUES(?, ?)");
  put.bind(1, key);
  put.bind(2, value);
  put.run();
}

/// The only column of the row of a bound statement, valid until that is reset. What is in it stands in
/// message_ then: its checksum is right.
std::span<const std::uint8_t> Cut::blob_of(Statement& select, const std::string& what) {
  if (!select.step()) {
    reject(fmt::format("the file is damaged ({} is missing)", what));
  }
  const auto blob = select.column_blob(0);
  try {
    decompress_blob(blob, message_);
  } catch (const Error& damaged) {
    reject(fmt::format("{}: {}", what, damaged.what()));
  }
  return blob;
}

/// Subject and albedo of a frame, where the frame before has others.
void Cut::copy_references(const stream::FrameReferences& wanted) {
  if (wanted.subject_id != 0 && wanted.subject_id != last_.subject_id) {
    Statement select(source_, "SELECT data FROM subject WHERE id = ?");
    Statement put(target_, "INSERT OR IGNORE INTO subject(id, data) VALUES(?, ?)");
    select.bind(1, stored(wanted.subject_id));
    put.bind(1, stored(wanted.subject_id));
    put.bind(2, blob_of(select, fmt::format("subject {:016x}", wanted.subject_id)));
    put.run();
    last_ = {wanted.subject_id, 0};
  }
  if (wanted.albedo_version != 0 && wanted.albedo_version != last_.albedo_version) {
    Statement select(source_, "SELECT data FROM albedo WHERE subject_id = ? AND version = ?");
    Statement put(target_, "INSERT OR IGNORE INTO albedo(subject_id, version, data) VALUES(?, ?, ?)");
    select.bind(1, stored(wanted.subject_id));
    select.bind(2, stored(wanted.albedo_version));
    put.bind(1, stored(wanted.subject_id));
    put.bind(2, stored(wanted.albedo_version));
    put.bind(3, blob_of(select, fmt::format("albedo {} of subject {:016x}", wanted.albedo_version,
                                            wanted.subject_id)));
    put.run();
    last_.albedo_version = wanted.albedo_version;
  }
}

void Cut::copy_pictures(std::int64_t number) {
  if (!pictures_) {
    return;
  }
  pictures_->bind(1, number);
  if (!pictures_->step()) {
    pictures_->reset();
    return;
  }
  const Extent from{pictures_->column_int64(0), pictures_->column_int64(1), pictures_->column_int64(2)};
  pictures_->reset();
  const std::int64_t cut_number = number - config_.frames.first;
  try {
    const auto records = segments_->read(from);
    records_.assign(records.begin(), records.end());
    renumber(records_, static_cast<std::uint64_t>(number), static_cast<std::uint64_t>(cut_number));
  } catch (const Error& damaged) {
    reject(fmt::format("pictures of frame {}: {}", number, damaged.what()));
  }
  if (!written_) {
    written_.emplace(file_, id_, kSegmentBytes);
  }
  const Extent to = written_->append(records_);
  put_pictures_.bind(1, cut_number);
  put_pictures_.bind(2, to.segment);
  put_pictures_.bind(3, to.position);
  put_pictures_.bind(4, to.bytes);
  put_pictures_.run();
}

void Cut::copy(std::int64_t number) {
  const FrameEntry entry = reader_.entry(number);
  const std::int64_t cut_number = number - config_.frames.first;
  data_.bind(1, number);
  const auto blob = blob_of(data_, fmt::format("frame {}", number));
  put_data_.bind(1, cut_number);
  put_data_.bind(2, blob);
  put_data_.run();
  data_.reset();
  copy_references(stream::frame_references(message_));
  put_frame_.bind(1, cut_number);
  put_frame_.bind(2, stored(entry.sequence));
  put_frame_.bind(3, entry.timestamp_ns);
  put_frame_.bind(4, entry.media_time_ns);
  put_frame_.bind(5, static_cast<std::int64_t>(entry.state));
  put_frame_.bind(6, static_cast<std::int64_t>(entry.has_mesh));
  put_frame_.run();
  mesh_frames_ += entry.has_mesh ? 1 : 0;
  copy_pictures(number);
}

/// Marks it as closed and brings it to the disk: the pictures first.
void Cut::finish() {
  for (const char* kept : {"note", "note_more", "scene", "scene_take"}) {
    if (const std::string text = source_text(kept); !text.empty()) {
      put_meta(kept, cut_text(text, kMaxMetaBytes));
    }
  }
  for (const auto& [key, value] : to_meta(reader_.info().timecode)) {
    put_meta(key, value);
  }
  if (config_.beside) {
    const std::int64_t first_ns = reader_.entry(config_.frames.first).timestamp_ns;
    const std::int64_t last_ns = reader_.entry(config_.frames.last).timestamp_ns;
    const std::int64_t frame_ns =
        (last_ns - first_ns) / std::max<std::int64_t>(1, config_.frames.count() - 1);
    for (const auto& [key, value] : config_.beside(reader_.info(), first_ns, last_ns + frame_ns, file_)) {
      put_meta(key, value);
    }
  }
  put_meta("cut_from", cut_text(fmt::format("{}, frames {} to {} of {}", config_.from.stem().string(),
                                            config_.frames.first, config_.frames.last, reader_.frame_count()),
                                kMaxShownBytes));
  put_meta("mesh_frames", std::to_string(mesh_frames_));
  put_meta("end_reason", "");
  put_meta("closed", "1");
  if (written_) {
    written_->sync();
    written_->close();
  }
  target_.execute("COMMIT");
  target_.execute("PRAGMA journal_mode = DELETE");
  target_.sync();
}

/// Throws where it does not hold what it should.
void check_cut(const std::filesystem::path& file, std::int64_t frames) {
  const TakeInfo info = TakeReader(file).info();
  std::string fault = info.frame_count == frames ? "" : fmt::format("it holds {} frames", info.frame_count);
  for (const TakeSegment& segment : info.segments) {
    fault = fault.empty() ? segment.fault : fault;
  }
  if (!fault.empty()) {
    throw Error(ErrorKind::Storage, fmt::format("the new take is not as it was written: {}", fault));
  }
}

bool copy_all(const CutConfig& config, TakeReader& reader, const std::filesystem::path& file,
              const std::function<bool(std::int64_t done)>& progress) {
  Cut cut(config, reader, file);
  for (std::int64_t number = config.frames.first; number <= config.frames.last; ++number) {
    check_disk(config);  // a frame of a booth's pictures has tens of megabytes
    cut.copy(number);
    if (!progress(number - config.frames.first + 1)) {
      return false;
    }
  }
  cut.finish();
  return true;
}

}  // namespace

FrameSpan frames_between(TakeReader& take, double from_s, double to_s) {
  if (take.frame_count() == 0) {
    throw Error(ErrorKind::Usage, "the take has no frames");
  }
  // As TakeInfo::duration_s and the studio have it: the source's time, where it has one.
  const bool has_media_time = take.entry(take.frame_count() - 1).media_time_ns > take.entry(0).media_time_ns;
  std::vector<std::pair<std::int64_t, bool>> frames;  // each: its time, whether it has a mesh
  for (std::int64_t number = 0; number < take.frame_count(); ++number) {
    const FrameEntry entry = take.entry(number);
    frames.emplace_back(has_media_time ? entry.media_time_ns : entry.timestamp_ns, entry.has_mesh);
  }
  const auto first_mesh =
      std::find_if(frames.begin(), frames.end(), [](const auto& frame) { return frame.second; });
  const std::int64_t zero_ns = (first_mesh != frames.end() ? first_mesh : frames.begin())->first;
  FrameSpan span{std::numeric_limits<std::int64_t>::max(), -1};
  double last_s = 0;
  for (std::size_t number = 0; number < frames.size(); ++number) {
    const double time_s = static_cast<double>(frames[number].first - zero_ns) * 1e-9;
    last_s = std::max(last_s, time_s);
    if (time_s >= from_s - kSameTime_s && time_s <= to_s + kSameTime_s) {
      span.first = std::min(span.first, static_cast<std::int64_t>(number));
      span.last = static_cast<std::int64_t>(number);
    }
  }
  if (span.last < 0) {
    throw Error(ErrorKind::Usage,
                fmt::format("no frame lies between {:.3f} and {:.3f} s: the take ends at {:.3f} s", from_s,
                            to_s, last_s));
  }
  return span;
}

bool cut_take(const CutConfig& config, const std::function<bool(std::int64_t done)>& progress) {
  const WorkFolder work(cutting_folder(config.to.parent_path()));
  const std::filesystem::path file = work.path() / config.to.filename();
  try {
    TakeReader reader(config.from);
    if (!copy_all(config, reader, file, progress)) {
      return false;
    }
    check_cut(file, config.frames.count());
  } catch (const DatabaseError& error) {
    throw Error(ErrorKind::Storage, fmt::format("cannot write '{}': {}", config.to.string(), error.what()));
  }
  move_all(moves_of_take(file, config.to), cutting_journal(config.to.parent_path()));
  return true;
}

std::filesystem::path cutting_journal(const std::filesystem::path& takes) {
  return takes / ".cutting.moves";
}

std::filesystem::path cutting_folder(const std::filesystem::path& takes) {
  return takes / ".cutting";
}

}  // namespace facet::take
