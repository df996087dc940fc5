#include "files/output_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <system_error>
#include <vector>

#include "facet/error.hpp"

namespace facet::files {
namespace {

[[noreturn]] void fail_to_write(const std::filesystem::path& file, int error) {
  throw Error(ErrorKind::Storage, fmt::format("cannot write '{}': {}", file.string(), std::strerror(error)));
}

}  // namespace

OutputFile::OutputFile(const std::filesystem::path& file)
    : file_(file),
      temporary_(file.parent_path() / fmt::format(".{}.{}.part", file.filename().string(), ::getpid())),
      stream_(std::fopen(temporary_.c_str(), "wbe")) {
  if (stream_ == nullptr) {
    fail(errno);
  }
}

OutputFile::~OutputFile() {
  if (stream_ != nullptr) {
    stream_.reset();
    std::error_code ignored;
    std::filesystem::remove(temporary_, ignored);
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
  if (std::fflush(stream_.get()) != 0 || std::rename(temporary_.c_str(), file_.c_str()) != 0) {
    fail(errno);
  }
  stream_.reset();
}

ScratchFile::ScratchFile(const std::filesystem::path& beside) : beside_(beside) {
  std::string name =
      (beside.parent_path() / fmt::format(".{}.XXXXXX.part", beside.filename().string())).string();
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

void make_folder(const std::filesystem::path& folder) {
  std::error_code failure;
  std::filesystem::create_directories(folder, failure);
  if (failure) {
    throw Error(ErrorKind::Storage,
                fmt::format("{}: cannot make the folder ({})", folder.string(), failure.message()));
  }
}

}  // namespace facet::files
