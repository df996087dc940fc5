#include "files/output_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <system_error>
#include <vector>

#include "facet/error.hpp"
#include "files/append_file.hpp"

namespace facet::files {
namespace {

constexpr int kAttempts = 100;
constexpr int kMostBroken = 1000;
constexpr std::size_t kMostWaiting = std::size_t{1} << 16;

[[noreturn]] void fail_to_write(const std::filesystem::path& file, int error) {
  throw Error(ErrorKind::Storage, fmt::format("cannot write '{}': {}", file.string(), std::strerror(error)));
}

/// Of a file's name as much as leaves room for what a temporary name has besides.
std::string shortened(const std::filesystem::path& file) {
  return file.filename().string().substr(0, NAME_MAX - 32);
}

}  // namespace

OutputFile::OutputFile(const std::filesystem::path& file, mode_t mode) : file_(file) {
  // As mkostemp does it, which knows no mode: nothing that lies there already is opened.
  for (int attempt = 0; !out_ && attempt < kAttempts; ++attempt) {
    std::uint64_t lot = 0;
    if (::getrandom(&lot, sizeof(lot), 0) != static_cast<ssize_t>(sizeof(lot))) {
      fail(errno);
    }
    temporary_ = file.parent_path() / fmt::format(".{}.{:016x}.part", shortened(file), lot);
    out_ = DiskFile::create(temporary_, mode);
    if (!out_ && errno != EEXIST) {
      break;
    }
  }
  if (!out_) {
    fail(errno);
  }
}

OutputFile::~OutputFile() {
  if (!committed_) {
    ::unlink(temporary_.c_str());
  }
}

void OutputFile::fail(int error) const {
  fail_to_write(file_, error);
}

void OutputFile::write(std::string_view text) {
  write(std::as_bytes(std::span(text)));
}

void OutputFile::write(std::span<const std::byte> bytes) {
  if (waiting_.size() + bytes.size() > kMostWaiting) {
    flush();
    if (bytes.size() > kMostWaiting) {
      write_at(position_, bytes);
      return;
    }
  }
  waiting_.insert(waiting_.end(), bytes.begin(), bytes.end());
}

void OutputFile::write_at(std::uint64_t position, std::span<const std::byte> bytes) {
  flush();
  if (!out_.write(bytes, position)) {
    fail(errno);
  }
  position_ = position + bytes.size();
}

void OutputFile::flush() {
  if (!out_.write(waiting_, position_)) {
    fail(errno);
  }
  position_ += waiting_.size();
  waiting_.clear();
}

void OutputFile::commit() {
  finish(0);
}

void OutputFile::commit_new() {
  finish(RENAME_NOREPLACE);
}

void OutputFile::finish(unsigned rename_flags) {
  flush();
  // Some files (of FUSE, of devices) can't be synced and say EINVAL: there is nothing more to be had there.
  if ((disk().sync(out_.get()) != 0 && errno != EINVAL) || !out_.close()) {
    fail(errno);
  }
  int renamed = disk().rename(temporary_.c_str(), file_.c_str(), rename_flags);
  if (renamed != 0 && errno == EINVAL && rename_flags != 0) {
    // A file system that knows no flags: a look must do.
    errno = EEXIST;
    renamed = ::access(file_.c_str(), F_OK) == 0 ? -1 : disk().rename(temporary_.c_str(), file_.c_str(), 0);
  }
  if (renamed != 0 && errno == EEXIST) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' exists already: give another name, or remove it", file_.string()));
  }
  if (renamed != 0) {
    fail(errno);
  }
  committed_ = true;
  sync_folder(file_.parent_path());
}

ScratchFile::ScratchFile(const std::filesystem::path& beside) : beside_(beside) {
  std::string name = (beside.parent_path() / fmt::format(".{}.XXXXXX.part", shortened(beside))).string();
  const int descriptor = ::mkostemps(name.data(), 5, O_CLOEXEC);
  if (descriptor < 0) {
    fail(errno);
  }
  ::unlink(name.c_str());
  stream_.reset(::fdopen(descriptor, "w+b"));
  if (stream_ == nullptr) {
    const int error = errno;
    ::close(descriptor);
    fail(error);
  }
}

void ScratchFile::fail(int error) const {
  fail_to_write(beside_, error);
}

void ScratchFile::write(std::string_view text) {
  write(std::as_bytes(std::span(text)));
}

void ScratchFile::write(std::span<const std::byte> bytes) {
  if (std::fwrite(bytes.data(), 1, bytes.size(), stream_.get()) != bytes.size()) {
    fail(errno);
  }
  size_ += bytes.size();
}

void ScratchFile::move_to(OutputFile& out) {
  if (std::fflush(stream_.get()) != 0 || ::fseeko(stream_.get(), 0, SEEK_SET) != 0) {
    fail(errno);
  }
  std::vector<std::byte> block(std::size_t{1} << 20);
  for (std::uint64_t left = size_; left > 0;) {
    const std::size_t count = std::min<std::uint64_t>(block.size(), left);
    if (std::fread(block.data(), 1, count, stream_.get()) != count) {
      fail(errno);
    }
    out.write(std::span(block).first(count));
    left -= count;
  }
  stream_.reset();
}

void sync_folder(const std::filesystem::path& folder) {
  Folder(folder.empty() ? "." : folder).sync();
}

std::string set_aside(const std::filesystem::path& file) {
  for (int number = 1; number <= kMostBroken; ++number) {
    std::filesystem::path to = file;
    to += fmt::format(".broken-{}", number);
    if (disk().rename(file.c_str(), to.c_str(), RENAME_NOREPLACE) == 0) {
      return fmt::format("set aside as '{}'", to.string());
    }
    if (errno != EEXIST) {
      break;
    }
  }
  return fmt::format("it could not be set aside: {}", std::strerror(errno));
}

void make_folder(const std::filesystem::path& given, mode_t mode) {
  const std::filesystem::path folder = given.has_filename() ? given : given.parent_path();  // "a/b/" is "a/b"
  std::error_code failure;
  if (folder.has_parent_path()) {
    std::filesystem::create_directories(folder.parent_path(), failure);
  }
  if (!failure) {
    ::mkdir(folder.c_str(), mode);  // the next call knows whether it is there now
    std::filesystem::create_directories(folder, failure);
  }
  if (failure) {
    throw Error(ErrorKind::Storage,
                fmt::format("{}: cannot make the folder ({})", folder.string(), failure.message()));
  }
}

}  // namespace facet::files
