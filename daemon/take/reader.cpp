#include "take/reader.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sqlite3.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstddef>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string_view>
#include <system_error>
#include <unordered_map>
#include <utility>

#include "facet/error.hpp"
#include "stream/decoder.hpp"
#include "take/database.hpp"
#include "take/picture_records.hpp"
#include "take/segment.hpp"
#include "take/take_file.hpp"

namespace facet::take {
namespace {

std::uint64_t id_from(std::int64_t stored) {
  return std::bit_cast<std::uint64_t>(stored);
}

[[noreturn]] void reject(const std::filesystem::path& file, std::string_view what) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("take '{}': {}", file.string(), what));
}

[[noreturn]] void unavailable(const std::filesystem::path& file, std::string_view what) {
  throw Error(ErrorKind::Unavailable, fmt::format("take '{}': {}", file.string(), what));
}

/// Where SQLite can't open the file, or what stands beside it.
[[noreturn]] void reject_unopened(const std::filesystem::path& file, const DatabaseError& error) {
  if (::faccessat(AT_FDCWD, file.c_str(), R_OK, AT_EACCESS) != 0) {
    reject(file, fmt::format("it can't be opened ({})", std::generic_category().message(errno)));
  }
  std::error_code unknown;
  const auto folder = std::filesystem::weakly_canonical(file, unknown).parent_path();
  if (log_bytes(file) > 0 && ::faccessat(AT_FDCWD, folder.c_str(), W_OK, AT_EACCESS) != 0) {
    reject(file,
           "a part of it is still in its -wal file and its folder is read-only: copy it together with its "
           "-wal file to a folder that can be written");
  }
  unavailable(file, fmt::format("it can't be opened now ({}): another program holds it, or too many files "
                                "are open: try again",
                                error.what()));
}

/// Turns what SQLite reports into an Error that names the file. What another program has in its hands is as
/// sound as it was: it is not to be taken for damaged.
[[noreturn]] void reject(const std::filesystem::path& file, const DatabaseError& error) {
  switch (error.code()) {
    case SQLITE_NOTADB:
      reject(file, "this is not a take (not an SQLite file)");
    case SQLITE_CORRUPT:
      reject(file, fmt::format("the file is damaged ({})", error.what()));
    case SQLITE_CANTOPEN:
    case SQLITE_READONLY:
      reject_unopened(file, error);
    case SQLITE_TOOBIG:
      reject(file, "the file is damaged (a text or blob in it is longer than any of a take)");
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      unavailable(file, "another program holds it locked: try again");
    default:
      reject(file, error.what());
  }
}

constexpr int kBusyTimeoutMs = 2000;

/// A connection that reads texts of `meta` at most, until it is let read blobs.
Database open_briefly(const std::filesystem::path& file, Database::Mode mode) {
  Database database(file, mode);
  // SQLite looks at a value's length before it reads it: nothing longer takes time or memory.
  database.set_longest_value(kMaxMetaBytes);
  return database;
}

Database open_database(const std::filesystem::path& file) {
  std::error_code error;
  const auto status = std::filesystem::status(file, error);
  if (!std::filesystem::exists(status)) {
    reject(file, "there is no such file");
  }
  if (!std::filesystem::is_regular_file(status)) {
    reject(file, "this is not a file");
  }
  Database database = open_briefly(file, Database::Mode::ReadOnly);
  try {
    database.set_busy_timeout_ms(kBusyTimeoutMs);
    database.query_int64("PRAGMA schema_version");
  } catch (const DatabaseError& unreadable) {
    // A take whose log was folded in while a reader had it open keeps the log's mode; in a folder that can't
    // be written SQLite would refuse it, though nothing is missing.
    const bool no_room = unreadable.code() == SQLITE_CANTOPEN || unreadable.code() == SQLITE_READONLY;
    if (!no_room || log_bytes(file) > 0) {
      throw;
    }
    return open_briefly(file, Database::Mode::Immutable);
  }
  return database;
}

/// Bytes of the segments beside a take, whether its index names them or not.
std::uint64_t segment_bytes(const std::filesystem::path& take) {
  std::uint64_t bytes = 0;
  std::int64_t files = 0;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(segments_folder(take), error), end;
       !error && entry != end && files < kMaxSegments; entry.increment(error), ++files) {
    std::error_code unknown;
    const std::uintmax_t size = entry->file_size(unknown);
    bytes += unknown || entry->path().extension() != ".seg" ? 0 : size;
  }
  return bytes;
}

/// The subjects that were used last, and those that somebody else still has: frames that share a subject
/// share the object, and a take of many keeps no memory of each.
class SubjectCache {
 public:
  /// Null where it has to be read.
  std::shared_ptr<const mesh::Subject> find(std::uint64_t id) {
    const auto known = all_.find(id);
    auto subject = known != all_.end() ? known->second.lock() : nullptr;
    if (subject != nullptr && subject != newest_) {
      before_ = std::exchange(newest_, subject);
    }
    return subject;
  }
  void keep(const std::shared_ptr<const mesh::Subject>& subject) {
    before_ = std::exchange(newest_, subject);
    // Seldom, so that it costs little: twice what is alive.
    if (all_.size() >= clean_at_) {
      std::erase_if(all_, [](const auto& entry) { return entry.second.expired(); });
      clean_at_ = std::max(kLeastEntries, 2 * all_.size());
    }
    all_.insert_or_assign(subject->id, subject);
  }

 private:
  static constexpr std::size_t kLeastEntries = 64;
  std::shared_ptr<const mesh::Subject> newest_;
  std::shared_ptr<const mesh::Subject> before_;
  std::unordered_map<std::uint64_t, std::weak_ptr<const mesh::Subject>> all_;
  std::size_t clean_at_ = kLeastEntries;
};

enum class Detail {
  Listed,  ///< meshes as the recorder counted them, segments by their size alone
  Whole
};

/// A take's file with what it says of itself, checked.
struct OpenTake {
  OpenTake(const std::filesystem::path& take, Detail detail) : file(take), database(open_checked(take)) {
    info.file = file;
    guarded([&] {
      database.execute("BEGIN");  // one state of a take that is being recorded
      check_schema();
      read_meta();
      read_counts(detail);
      database.execute("COMMIT");
    });
  }

  std::filesystem::path file;
  Database database;
  TakeInfo info;
  std::map<std::string, std::string, std::less<>> meta;

  static Database open_checked(const std::filesystem::path& take) {
    try {
      return open_database(take);
    } catch (const DatabaseError& error) {
      reject(take, error);
    }
  }

  /// Runs `work` and turns what SQLite reports into an Error that names the file.
  template <typename Work>
  auto guarded(Work&& work) -> decltype(work()) {
    try {
      return work();
    } catch (const DatabaseError& error) {
      reject(file, error);
    }
  }

  void check_schema();
  void read_meta();
  void read_counts(Detail detail);
  /// Empty where it is not there.
  std::string text(std::string_view key) const {
    const auto found = meta.find(key);
    return found != meta.end() ? found->second : std::string();
  }
};

}  // namespace

struct TakeReader::Impl : OpenTake {
  explicit Impl(const std::filesystem::path& take) : OpenTake(take, Detail::Whole) {
    database.set_longest_value(kMaxStoredBytes);
    if (info.format_version >= 2) {
      guarded([this] { read_segments(); });
    }
  }

  std::vector<std::uint8_t> message;  ///< reused
  SubjectCache subjects;
  std::unordered_map<std::uint64_t, std::uint64_t> topologies;  ///< what was found under each hierarchy's id
  stream::DecodedAlbedo albedo;                                 ///< the last one read
  std::unique_ptr<Statement> select_entry{
      prepare("SELECT sequence, timestamp_ns, media_time_ns, state, has_mesh FROM frame WHERE number = ?")};
  std::unique_ptr<Statement> select_data{prepare("SELECT data FROM frame_data WHERE number = ?")};
  std::unique_ptr<Statement> select_subject{prepare("SELECT data FROM subject WHERE id = ?")};
  std::unique_ptr<Statement> select_albedo{
      prepare("SELECT data FROM albedo WHERE subject_id = ? AND version = ?")};
  std::unique_ptr<Statement> select_pictures{
      info.format_version < 2
          ? nullptr
          : prepare("SELECT segment, position, bytes FROM pictures WHERE number = ?")};  ///< null before
                                                                                         ///< version 2
  std::unique_ptr<SegmentReader> segments;  ///< null before version 2
  PictureReader pictures;

  std::unique_ptr<Statement> prepare(std::string_view sql) {
    return guarded([&] { return std::make_unique<Statement>(database, sql); });
  }

  /// Runs a decoder over a blob and adds to its Error which one is damaged.
  template <typename Work>
  auto decoded(std::string_view what, Work&& work) -> decltype(work()) {
    try {
      return work();
    } catch (const Error& error) {
      reject(file, fmt::format("{}: {}", what, error.what()));
    }
  }

  void read_segments();
  void require_index(std::int64_t index) const;
  /// The blob of the only row of a bound statement, decompressed into `message`.
  void load(Statement& statement, const std::string& what);
  std::shared_ptr<const mesh::Subject> subject(std::uint64_t id);
  std::shared_ptr<const mesh::Albedo> albedo_of(std::uint64_t subject_id, std::uint64_t version);
  std::shared_ptr<const mesh::MeshFrame> frame(std::int64_t index, Pictures wanted_pictures);
  std::shared_ptr<const FrameSet> with_pixels(std::int64_t index, const FrameSet& described);
};

void OpenTake::check_schema() {
  const std::int64_t application = database.query_int64("PRAGMA application_id");
  if (application != kApplicationId) {
    reject(file, "this is an SQLite file, but not a take");
  }
  const std::int64_t version = database.query_int64("PRAGMA user_version");
  if (version < 1 || version > kFormatVersion) {
    reject(file, fmt::format("its format version is {}, this program reads 1 to {}: use a newer Facet",
                             version, kFormatVersion));
  }
  info.format_version = static_cast<std::int32_t>(version);
  // Exact text: a view, trigger or computed column in a table's place could run anything on reading.
  Statement schema(database, "SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL");
  std::size_t known = 0;
  while (schema.step()) {
    const std::string name = schema.column_text(0);
    const std::string sql = schema.column_text(1);
    if (std::none_of(kTables.begin(), kTables.end(), [&](const TableDefinition& table) {
          return table.name == name && table.sql == sql && table.since <= version;
        })) {
      reject(file, fmt::format("its table '{}' is not that of a take", name));
    }
    ++known;
  }
  if (known != static_cast<std::size_t>(
                   std::count_if(kTables.begin(), kTables.end(),
                                 [&](const TableDefinition& table) { return table.since <= version; }))) {
    reject(file, "tables are missing");
  }
}

void OpenTake::read_meta() {
  // Not by key: a search reads the keys that it compares, however long they are.
  Statement select(database, "SELECT key, value FROM meta NOT INDEXED");
  while (select.step()) {
    if (meta.size() == kMaxMetaEntries) {
      reject(file, fmt::format("it says more than {} things of itself", kMaxMetaEntries));
    }
    meta.insert_or_assign(select.column_text(0), select.column_text(1));
  }
  info.source = text("source");
  info.software = cut_text(text("software"), kMaxShownBytes);
  info.created_utc = cut_text(text("created_utc"), kMaxShownBytes);
  info.closed = text("closed") == "1";
  info.end_reason = cut_text(text("end_reason"), kMaxShownBytes);
  info.cut_from = cut_text(text("cut_from"), kMaxShownBytes);
  const auto text_of = [this](std::string_view key) { return text(key); };
  info.notes = notes_of(text_of);
  info.timecode = timecode_of(text_of);
  info.sound = sound_of(text_of);
  info.dropped = std::strtoull(text("dropped").c_str(), nullptr, 10);
}

void OpenTake::read_counts(Detail detail) {
  // Each by itself: so SQLite counts entries of pages and searches, and reads no row.
  info.frame_count = database.query_int64("SELECT count(*) FROM frame");
  if (info.frame_count > 0) {
    if (database.query_int64("SELECT min(number) FROM frame") != 0 ||
        database.query_int64("SELECT max(number) FROM frame") != info.frame_count - 1) {
      reject(file, "the file is damaged (frames are missing)");
    }
    info.first_timestamp_ns = database.query_int64("SELECT timestamp_ns FROM frame WHERE number = 0");
    info.last_timestamp_ns = database.query_int64(
        fmt::format("SELECT timestamp_ns FROM frame WHERE number = {}", info.frame_count - 1));
    const std::int64_t media_ns = database.query_int64(
        fmt::format("SELECT (SELECT media_time_ns FROM frame WHERE number = {}) - (SELECT media_time_ns FROM "
                    "frame WHERE number = 0)",
                    info.frame_count - 1));
    info.duration_s =
        static_cast<double>(media_ns > 0 ? media_ns : info.last_timestamp_ns - info.first_timestamp_ns) *
        1e-9;
  }
  const std::string counted = text("mesh_frames");
  if (detail == Detail::Listed && info.closed && !counted.empty()) {
    info.mesh_frame_count =
        std::clamp<std::int64_t>(std::strtoll(counted.c_str(), nullptr, 10), 0, info.frame_count);
  } else {
    info.mesh_frame_count = database.query_int64("SELECT total(has_mesh <> 0) FROM frame");
  }
  info.subject_count = database.query_int64("SELECT count(*) FROM subject");
  std::error_code error;
  const std::uintmax_t bytes = std::filesystem::file_size(file, error);
  info.file_bytes = (error ? 0 : bytes) + log_bytes(file);
  if (info.sound.is_there()) {
    const std::uintmax_t sound_bytes = std::filesystem::file_size(sound_file_of(file), error);
    info.file_bytes += error ? 0 : sound_bytes;
  }
  if (detail == Detail::Listed && info.format_version >= 2) {
    info.picture_bytes = segment_bytes(file);
    info.file_bytes += info.picture_bytes;
  }
}

void TakeReader::Impl::read_segments() {
  segments = std::make_unique<SegmentReader>(file, take_id_from(text("take_id")));
  Statement select(
      database,
      "SELECT segment, min(number), max(number), count(*), sum(bytes), max(position + bytes) FROM "
      "pictures GROUP BY segment ORDER BY segment");
  while (select.step()) {
    TakeSegment segment;
    segment.number = select.column_int64(0);
    if (segment.number < 1 || segment.number > kMaxSegments) {
      reject(file, fmt::format("the file is damaged (it names a segment {})", segment.number));
    }
    segment.file = segment_file(file, segment.number);
    segment.first_frame = select.column_int64(1);
    segment.last_frame = select.column_int64(2);
    segment.frame_count = select.column_int64(3);
    segment.bytes = static_cast<std::uint64_t>(std::max<std::int64_t>(0, select.column_int64(4)));
    try {
      const std::uint64_t size = segments->check(segment.number);
      info.file_bytes += size;
      info.picture_bytes += size;
      if (std::cmp_less(size, select.column_int64(5))) {
        segment.fault = fmt::format("segment '{}': it ends at byte {} of {}: the rest is lost",
                                    segment.file.string(), size, select.column_int64(5));
      }
    } catch (const Error& fault) {
      segment.fault = fault.what();
    }
    info.segments.push_back(std::move(segment));
  }
}

void TakeReader::Impl::require_index(std::int64_t index) const {
  if (index < 0 || index >= info.frame_count) {
    throw Error(ErrorKind::Usage, fmt::format("take '{}' has frames 0 to {}, there is no frame {}",
                                              file.string(), info.frame_count - 1, index));
  }
}

void TakeReader::Impl::load(Statement& statement, const std::string& what) {
  if (!statement.step()) {
    reject(file, fmt::format("the file is damaged ({} is missing)", what));
  }
  decoded(what, [&] { decompress_blob(statement.column_blob(0), message); });
  statement.reset();
}

std::shared_ptr<const mesh::Subject> TakeReader::Impl::subject(std::uint64_t id) {
  if (auto known = subjects.find(id)) {
    return known;
  }
  const std::string what = fmt::format("subject {:016x}", id);
  select_subject->bind(1, std::bit_cast<std::int64_t>(id));
  load(*select_subject, what);
  auto read = decoded(what, [&] { return stream::decode_subject(message); });
  if (read->id != id || read->hierarchy == nullptr || read->hierarchy->control_vertex_count == 0) {
    reject(file, fmt::format("{}: not the topology that a take holds", what));
  }
  const std::uint64_t found = mesh::topology_id(*read->hierarchy);
  if (topologies.try_emplace(read->hierarchy->id, found).first->second != found) {
    reject(file,
           fmt::format("{}: the take has another topology of the id {:016x}", what, read->hierarchy->id));
  }
  subjects.keep(read);
  return read;
}

std::shared_ptr<const mesh::Albedo> TakeReader::Impl::albedo_of(std::uint64_t subject_id,
                                                                std::uint64_t version) {
  if (albedo.albedo == nullptr || albedo.subject_id != subject_id || albedo.albedo->version != version) {
    const std::string what = fmt::format("albedo {} of subject {:016x}", version, subject_id);
    select_albedo->bind(1, std::bit_cast<std::int64_t>(subject_id));
    select_albedo->bind(2, std::bit_cast<std::int64_t>(version));
    load(*select_albedo, what);
    stream::DecodedAlbedo read = decoded(what, [&] { return stream::decode_albedo(message); });
    if (read.subject_id != subject_id || read.albedo->version != version) {
      reject(file, fmt::format("{}: it holds another one", what));
    }
    albedo = std::move(read);
  }
  return albedo.albedo;
}

/// The set with its pictures' pixels, where they were recorded.
std::shared_ptr<const FrameSet> TakeReader::Impl::with_pixels(std::int64_t index, const FrameSet& described) {
  select_pictures->bind(1, index);
  if (!select_pictures->step()) {
    return nullptr;
  }
  const Extent extent{select_pictures->column_int64(0), select_pictures->column_int64(1),
                      select_pictures->column_int64(2)};
  select_pictures->reset();
  auto set = std::make_shared<FrameSet>(described);
  for (Frame& picture : set->frames) {
    picture.pixels = nullptr;
  }
  const auto records = segments->read(extent);
  try {
    pictures.read(records, static_cast<std::uint64_t>(index), *set);
  } catch (const Error& error) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("segment '{}', byte {}: {}", segment_file(file, extent.segment).string(),
                            extent.position, error.what()));
  }
  return set;
}

std::shared_ptr<const mesh::MeshFrame> TakeReader::Impl::frame(std::int64_t index, Pictures wanted_pictures) {
  const std::string what = fmt::format("frame {}", index);
  select_data->bind(1, index);
  load(*select_data, what);
  // Subject and albedo are read through the same buffer.
  const std::vector<std::uint8_t> frame_message = std::exchange(message, {});
  const auto wanted = decoded(what, [&] { return stream::frame_references(frame_message); });
  auto wanted_subject = wanted.subject_id != 0 ? subject(wanted.subject_id) : nullptr;
  auto wanted_albedo =
      wanted.albedo_version != 0 ? albedo_of(wanted.subject_id, wanted.albedo_version) : nullptr;
  stream::DecodedFrame out;
  decoded(what, [&] {
    stream::decode_frame(frame_message, std::move(wanted_subject), std::move(wanted_albedo), out);
  });
  if (wanted_pictures == Pictures::Decoded && select_pictures != nullptr && out.frame.images != nullptr) {
    if (auto set = decoded(what, [&] { return with_pixels(index, *out.frame.images); })) {
      out.frame.images = std::move(set);
    }
  }
  return std::make_shared<mesh::MeshFrame>(std::move(out.frame));
}

TakeInfo listed_info(const std::filesystem::path& file) {
  return OpenTake(file, Detail::Listed).info;
}

TakeReader::TakeReader(const std::filesystem::path& file) : impl_(std::make_unique<Impl>(file)) {}

TakeReader::~TakeReader() = default;
TakeReader::TakeReader(TakeReader&&) noexcept = default;
TakeReader& TakeReader::operator=(TakeReader&&) noexcept = default;

const TakeInfo& TakeReader::info() const {
  return impl_->info;
}

std::int64_t TakeReader::frame_count() const {
  return impl_->info.frame_count;
}

FrameEntry TakeReader::entry(std::int64_t index) {
  impl_->require_index(index);
  return impl_->guarded([&] {
    Statement& select = *impl_->select_entry;
    select.bind(1, index);
    if (!select.step()) {
      reject(impl_->file, fmt::format("the file is damaged (frame {} is missing)", index));
    }
    const std::int64_t state = select.column_int64(3);
    FrameEntry entry{index,
                     id_from(select.column_int64(0)),
                     select.column_int64(1),
                     select.column_int64(2),
                     static_cast<mesh::TrackingState>(state),
                     select.column_int64(4) != 0};
    select.reset();
    if (state < 0 || state > static_cast<std::int64_t>(mesh::TrackingState::Lost)) {
      reject(impl_->file, fmt::format("the file is damaged (frame {} has state {})", index, state));
    }
    return entry;
  });
}

std::shared_ptr<const mesh::MeshFrame> TakeReader::frame(std::int64_t index, Pictures pictures) {
  impl_->require_index(index);
  return impl_->guarded([&] { return impl_->frame(index, pictures); });
}

}  // namespace facet::take
