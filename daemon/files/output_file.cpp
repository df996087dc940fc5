#include "files/output_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/random.h>
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

namespace facet::files {
namespace {

constexpr int kAttempts = 100;
constexpr int kMostBroken = 1000;

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
  int descriptor = -1;
  for (int attempt = 0; descriptor < 0 && attempt < kAttempts; ++attempt) {
    std::uint64_t lot = 0;
    if (::getrandom(&lot, sizeof(lot), 0) != static_cast<ssize_t>(sizeof(lot))) {
      fail(errno);
    }
    temporary_ = file.parent_path() / fmt::format(".{}.{:016x}.part", shortened(file), lot);
    descriptor = ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, mode);
    if (descriptor < 0 && errno != EEXIST) {
      break;
    }
  }
  if (descriptor < 0) {
    fail(errno);
  }
  stream_.reset(::fdopen(descriptor, "wb"));
  if (stream_ == nullptr) {
    const int error = errno;
    ::close(descriptor);
    ::unlink(temporary_.c_str());
    fail(error);
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
  if (std::fwrite(bytes.data(), 1, bytes.size(), stream_.get()) != bytes.size()) {
    fail(errno);
  }
}

void OutputFile::commit() {
  // Some files (of FUSE, of devices) can't be synced and say EINVAL: there is nothing more to be had there.
  if (std::fflush(stream_.get()) != 0 || (::fsync(::fileno(stream_.get())) != 0 && errno != EINVAL) ||
      std::fclose(stream_.release()) != 0 || std::rename(temporary_.c_str(), file_.c_str()) != 0) {
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
  const std::filesystem::path& named = folder.empty() ? std::filesystem::path(".") : folder;
  const int descriptor = ::open(named.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  // Some file systems (FUSE, CIFS) can't sync a folder and say EINVAL: there is nothing more to be had there.
  const bool synced = descriptor >= 0 && (::fsync(descriptor) == 0 || errno == EINVAL);
  const int error = errno;
  if (descriptor >= 0) {
    ::close(descriptor);
  }
  if (!synced) {
    throw Error(ErrorKind::Storage,
                fmt::format("cannot sync the folder '{}': {}", named.string(), std::strerror(error)));
  }
}

std::string set_aside(const std::filesystem::path& file) {
  for (int number = 1; number <= kMostBroken; ++number) {
    std::filesystem::path to = file;
    to += fmt::format(".broken-{}", number);
    if (::renameat2(AT_FDCWD, file.c_str(), AT_FDCWD, to.c_str(), RENAME_NOREPLACE) == 0) {
      return fmt::format("set aside as '{}'", to.string());
    }
    if (errno != EEXIST) {
      break;
    }
  }
  return fmt::format("it could not be set aside: {}", std::strerror(errno));
}

void make_folder(const std::filesystem::path& folder) {
  std::error_code failure;
  std::filesystem::create_directories(folder, failure);
  if (failure) {
    throw Error(ErrorKind::Storage,
                fmt::format("{}: cannot make the folder ({})", folder.string(), failure.message()));
  }
}

}  // namespace facet::files
