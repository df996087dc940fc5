#include "take/segment.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstddef>
#include <cstring>
#include <optional>
#include <system_error>
#include <utility>

#include "facet/assert.hpp"
#include "facet/error.hpp"
#include "files/append_file.hpp"
#include "files/disk.hpp"
#include "take/checksum.hpp"
#include "take/picture_records.hpp"

namespace facet::take {
namespace {

constexpr std::array<char, 8> kSegmentMagic = {'F', 'C', 'T', 'K', 'S', 'E', 'G', '\n'};
/// The kernel is told to write as soon as so much is new, so that the sync has little left to wait for.
constexpr std::uint64_t kWriteBackBytes = 4U << 20;
/// zstd cannot make a set's pixels longer than this, heads of records included.
constexpr std::int64_t kMaxExtentBytes = kMaxSetBytes + (kMaxSetBytes >> 6U);

/// The head of a segment, little-endian as it lies in the file.
struct SegmentHead {
  std::array<char, 8> magic = kSegmentMagic;
  std::uint32_t version = kSegmentVersion;
  std::uint32_t number = 0;
  TakeId take_id{};
  std::uint8_t unused[28] = {};
  std::uint32_t crc = 0;  ///< crc32c of what stands before it
};
static_assert(sizeof(SegmentHead) == 64 && offsetof(SegmentHead, crc) == 60);

std::span<const std::uint8_t> bytes_of(const SegmentHead& head) {
  return {reinterpret_cast<const std::uint8_t*>(&head), sizeof(head)};
}

[[noreturn]] void storage_error(const std::filesystem::path& file, const char* what, int error) {
  throw Error(ErrorKind::Storage,
              fmt::format("cannot {} '{}': {}", what, file.string(), std::strerror(error)));
}

[[noreturn]] void no_longer_there(const std::filesystem::path& file) {
  throw Error(ErrorKind::Storage,
              fmt::format("'{}' is no longer there: it was removed or moved", file.string()));
}

}  // namespace

TakeId new_take_id() {
  TakeId id{};
  if (::getrandom(id.data(), id.size(), 0) != static_cast<ssize_t>(id.size())) {
    throw Error(ErrorKind::Internal, fmt::format("no random numbers: {}", std::strerror(errno)));
  }
  return id;
}

std::string to_text(const TakeId& id) {
  std::string text;
  for (const std::uint8_t byte : id) {
    text += fmt::format("{:02x}", byte);
  }
  return text;
}

TakeId take_id_from(const std::string& text) {
  TakeId id{};
  if (text.size() != 2 * id.size()) {
    return {};
  }
  for (std::size_t i = 0; i < id.size(); ++i) {
    const char* digits = text.data() + 2 * i;
    if (std::from_chars(digits, digits + 2, id[i], 16).ptr != digits + 2) {
      return {};
    }
  }
  return id;
}

std::filesystem::path segments_folder(const std::filesystem::path& take) {
  return std::filesystem::path(take).replace_extension(".frames");
}

std::filesystem::path segment_file(const std::filesystem::path& take, std::int64_t number) {
  return segments_folder(take) / fmt::format("{:06}.seg", number);
}

NamedFile NamedFile::of(const std::filesystem::path& path) {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0) {
    storage_error(path, "look at", errno);
  }
  return {path, status.st_dev, status.st_ino};
}

bool NamedFile::is_there() const {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0) {
    if (errno == ENOENT || errno == ENOTDIR) {
      no_longer_there(path);
    }
    return false;
  }
  if (status.st_dev != device || status.st_ino != inode) {
    no_longer_there(path);
  }
  return true;
}

struct SegmentWriter::Impl {
  /// A segment that is written to its end.
  struct Ended {
    NamedFile file;
    std::uint64_t size = 0;
  };

  std::filesystem::path take;
  std::filesystem::path folder_path;
  TakeId id{};
  std::uint64_t segment_bytes = 0;
  std::optional<files::Folder> folder;  ///< held for its syncs
  files::DiskFile next;                 ///< of the next segment, without a name yet
  files::AppendFile file;
  NamedFile named;  ///< `file`
  std::vector<Ended> ended;
  std::int64_t number = 0;
  std::uint64_t written_back = 0;  ///< the kernel was told to write what stands before
  std::uint64_t synced = 0;
  bool new_name = false;  ///< the folder does not know the file yet
  bool closed = false;

  files::AppendFile open_next(const std::filesystem::path& path);
  void begin_next();
  void sync();
};

SegmentWriter::SegmentWriter(const std::filesystem::path& take, const TakeId& id, std::uint64_t segment_bytes)
    : impl_(std::make_unique<Impl>()) {
  impl_->take = take;
  impl_->id = id;
  impl_->segment_bytes = segment_bytes;
  impl_->folder_path = segments_folder(take);
  const std::filesystem::path& folder = impl_->folder_path;
  if (::mkdir(folder.c_str(), 0755) != 0) {
    const int error = errno;
    if (error == EEXIST) {
      throw Error(
          ErrorKind::Storage,
          fmt::format("'{}' exists already, perhaps of a take that was deleted or moved away without it: "
                      "choose another name or move it away",
                      folder.string()));
    }
    storage_error(folder, "create the folder", error);
  }
  try {
    impl_->folder.emplace(folder);
  } catch (const Error&) {
    ::rmdir(folder.c_str());
    throw;
  }
  impl_->next = impl_->folder->nameless();
}

SegmentWriter::~SegmentWriter() {
  close();
}

/// The file in reserve under its name, else one opened now.
files::AppendFile SegmentWriter::Impl::open_next(const std::filesystem::path& path) {
  if (next && files::disk().name(next.get(), path.c_str()) == 0) {
    return {std::exchange(next, {}), path};
  }
  return files::AppendFile::create(path);
}

void SegmentWriter::Impl::begin_next() {
  sync();
  FACET_ASSERT(synced == file.size(), number, synced, file.size());
  if (file) {
    ended.push_back({named, file.size()});
    if (!next) {
      file = {};  // its descriptor may be the only one to be had for the next
      synced = 0;
    }
  }
  const std::filesystem::path path = segment_file(take, number + 1);
  file = open_next(path);
  ++number;
  written_back = synced = 0;
  named.path = path;
  named = NamedFile::of(path);
  new_name = true;
  SegmentHead head;
  head.number = static_cast<std::uint32_t>(number);
  head.take_id = id;
  head.crc = crc32c(bytes_of(head).first(offsetof(SegmentHead, crc)));
  file.append(std::as_bytes(bytes_of(head)));
}

Extent SegmentWriter::append(std::span<const std::uint8_t> records) {
  Impl& impl = *impl_;
  const bool full =
      impl.file.size() > sizeof(SegmentHead) && impl.file.size() + records.size() > impl.segment_bytes;
  if (!impl.file || full) {
    impl.begin_next();
  }
  const Extent extent{impl.number, static_cast<std::int64_t>(impl.file.size()),
                      static_cast<std::int64_t>(records.size())};
  impl.file.append(std::as_bytes(records));
  const std::uint64_t size = impl.file.size();
  FACET_ASSERT(std::cmp_equal(size, extent.position + extent.bytes), size, extent.position, extent.bytes);
  FACET_ASSERT(impl.synced <= size && impl.written_back <= size, impl.synced, impl.written_back, size);
  if (size - impl.written_back >= kWriteBackBytes) {
    impl.file.write_back(impl.written_back);
    impl.written_back = size;
  }
  return extent;
}

void SegmentWriter::Impl::sync() {
  if (!file || synced == file.size()) {
    return;
  }
  FACET_ASSERT(synced < file.size(), number, synced, file.size());
  file.sync();
  synced = file.size();
  if (new_name) {
    folder->sync();  // a new name is on the disk when its folder is
    new_name = false;
  }
  if (!next) {
    next = folder->nameless();  // tried with every sync: a want of descriptors passes
  }
}

void SegmentWriter::sync() {
  impl_->sync();
}

bool SegmentWriter::is_there() const {
  return !impl_->file || impl_->named.is_there();
}

bool SegmentWriter::are_all_there() const {
  std::vector<Impl::Ended> all = impl_->ended;
  if (impl_->file) {
    all.push_back({impl_->named, impl_->file.size()});
  }
  bool seen = true;
  for (const Impl::Ended& one : all) {
    seen = one.file.is_there() && seen;
    std::error_code unseen;
    const std::uintmax_t bytes = std::filesystem::file_size(one.file.path, unseen);
    if (!unseen && bytes < one.size) {
      throw Error(ErrorKind::Storage,
                  fmt::format("'{}' has {} bytes of the {} that were written: it was cut off",
                              one.file.path.string(), bytes, one.size));
    }
    seen = seen && !unseen;
  }
  return seen;
}

void SegmentWriter::close() {
  Impl& impl = *impl_;
  if (std::exchange(impl.closed, true)) {
    return;
  }
  FACET_ASSERT(!impl.file || impl.synced <= impl.file.size(), impl.number, impl.synced, impl.file.size());
  // What follows the last sync is in no index; should it stay, it is only a waste.
  if (impl.file && impl.synced == 0) {
    ::unlink(impl.named.path.c_str());
  } else if (impl.file && impl.synced != impl.file.size()) {
    impl.file.cut(impl.synced);
  }
  impl.file = {};
  impl.next = {};
  impl.folder.reset();
  ::rmdir(impl.folder_path.c_str());  // fails, as it should, where segments lie in it
}

struct SegmentReader::Impl {
  std::filesystem::path take;
  TakeId id{};
  files::DiskFile file;
  std::int64_t number = 0;  ///< of `file`; 0: none
  std::uint64_t size = 0;   ///< of `file` when it was opened
  std::vector<std::uint8_t> buffer;

  [[noreturn]] void reject(std::int64_t segment, const std::string& what) const {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("segment '{}': {}", segment_file(take, segment).string(), what));
  }
  void read(std::int64_t segment, std::uint64_t position, std::span<std::uint8_t> out) const;
  void open(std::int64_t segment);
  void refresh();
};

SegmentReader::SegmentReader(std::filesystem::path take, const TakeId& id) : impl_(std::make_unique<Impl>()) {
  impl_->take = std::move(take);
  impl_->id = id;
}

SegmentReader::~SegmentReader() = default;
SegmentReader::SegmentReader(SegmentReader&&) noexcept = default;
SegmentReader& SegmentReader::operator=(SegmentReader&&) noexcept = default;

void SegmentReader::Impl::read(std::int64_t segment, std::uint64_t position,
                               std::span<std::uint8_t> out) const {
  while (!out.empty()) {
    const ssize_t got = ::pread(file.get(), out.data(), out.size(), static_cast<off_t>(position));
    if (got == 0) {
      reject(segment, fmt::format("it ends at byte {}: the rest is lost", position));
    }
    if (got < 0 && errno != EINTR) {
      reject(segment, fmt::format("cannot be read: {}", std::strerror(errno)));
    }
    const auto count = static_cast<std::size_t>(std::max<ssize_t>(got, 0));
    position += count;
    out = out.subspan(count);
  }
}

void SegmentReader::Impl::open(std::int64_t segment) {
  number = 0;
  // Not blocking: what stands in a segment's place may be no file.
  file = files::DiskFile::open(AT_FDCWD, segment_file(take, segment), O_RDONLY | O_NONBLOCK);
  if (!file) {
    reject(segment,
           errno == ENOENT ? "it is missing" : fmt::format("cannot be opened: {}", std::strerror(errno)));
  }
  struct stat status {};
  if (::fstat(file.get(), &status) != 0 || !S_ISREG(status.st_mode)) {
    reject(segment, "this is not a file");
  }
  size = static_cast<std::uint64_t>(status.st_size);
  SegmentHead head;
  read(segment, 0, {reinterpret_cast<std::uint8_t*>(&head), sizeof(head)});
  if (head.magic != kSegmentMagic) {
    reject(segment, "this is no segment of a take");
  }
  if (head.version != kSegmentVersion) {
    reject(segment, fmt::format("its version is {}, this program reads {}: use a newer Facet", head.version,
                                kSegmentVersion));
  }
  if (head.crc != crc32c(bytes_of(head).first(offsetof(SegmentHead, crc)))) {
    reject(segment, "its head is damaged");
  }
  if (head.take_id != id || head.number != segment) {
    reject(segment, head.take_id != id ? "it belongs to another take" : "it has another number");
  }
  number = segment;
}

void SegmentReader::Impl::refresh() {
  struct stat status {};
  size = ::fstat(file.get(), &status) == 0 ? static_cast<std::uint64_t>(status.st_size) : size;
}

std::uint64_t SegmentReader::check(std::int64_t number) {
  impl_->open(number);
  return impl_->size;
}

std::span<const std::uint8_t> SegmentReader::read(const Extent& extent) {
  Impl& impl = *impl_;
  if (extent.position < static_cast<std::int64_t>(sizeof(SegmentHead)) || extent.bytes <= 0 ||
      extent.bytes > kMaxExtentBytes) {
    throw Error(ErrorKind::UnreadableInput, "the index is damaged");
  }
  if (impl.number != extent.segment) {
    impl.open(extent.segment);
  }
  const auto position = static_cast<std::uint64_t>(extent.position);
  const auto bytes = static_cast<std::uint64_t>(extent.bytes);
  if (position > impl.size || bytes > impl.size - position) {
    impl.refresh();  // it may have grown: a take is read while it is recorded
    if (position > impl.size || bytes > impl.size - position) {
      impl.reject(extent.segment, fmt::format("it ends at byte {}: the rest is lost", impl.size));
    }
  }
  if (impl.buffer.size() < bytes) {
    impl.buffer.resize(bytes);
  }
  FACET_ASSERT(impl.number == extent.segment && impl.buffer.size() >= bytes, impl.number, extent.segment,
               bytes);
  const std::span<std::uint8_t> out = std::span(impl.buffer).first(bytes);
  impl.read(extent.segment, position, out);
  return out;
}

}  // namespace facet::take
