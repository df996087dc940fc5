#include "files/text_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <system_error>
#include <utility>

#include "facet/error.hpp"
#include "facet/system_error.hpp"

namespace facet::files {

std::string read_text(const std::filesystem::path& file, std::size_t most_bytes, std::string_view what) {
  // The streams of the library say that something failed, and leave in errno what.
  errno = 0;
  std::ifstream stream(file, std::ios::binary);
  std::string text;
  // In growing blocks: the most is far beyond what files of its kind usually have.
  for (std::size_t block = 1U << 16; stream && text.size() <= most_bytes; block *= 2) {
    const std::size_t before = text.size();
    text.resize(std::min(before + block, most_bytes + 1));
    stream.read(text.data() + before, static_cast<std::streamsize>(text.size() - before));
    text.resize(before + static_cast<std::size_t>(stream.gcount()));
  }
  const int error = errno;
  std::error_code ignored;
  if (stream.bad() || !stream.is_open() || std::filesystem::is_directory(file, ignored)) {
    throw Error(kind_of_errno(error), fmt::format("{}: cannot read this {}: {}", file.string(), what,
                                                  may_pass(error) ? describe_errno(error)
                                                                  : "check that it exists and may be read"));
  }
  if (text.size() > most_bytes) {
    throw Error(ErrorKind::Usage,
                fmt::format("{}: larger than {} bytes: this is no {}", file.string(), most_bytes, what));
  }
  return text;
}

InputFile::InputFile(std::filesystem::path file, std::string_view what)
    : file_(std::move(file)), what_(what) {
  // Not blocking: what stands in the file's place may be a pipe.
  descriptor_ = ::open(file_.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  struct stat status {};
  if (descriptor_ < 0 || ::fstat(descriptor_, &status) != 0) {
    const int error = errno;
    if (descriptor_ >= 0) {
      ::close(descriptor_);
    }
    fail(error);
  }
  if (!S_ISREG(status.st_mode)) {
    ::close(descriptor_);
    fail("not a regular file");
  }
  size_ = static_cast<std::size_t>(status.st_size);
  trusted_ =
      (status.st_uid == ::geteuid() || status.st_uid == 0) && (status.st_mode & (S_IWGRP | S_IWOTH)) == 0;
}

InputFile::~InputFile() {
  ::close(descriptor_);
}

void InputFile::fail(int error) const {
  throw Error(kind_of_errno(error),
              fmt::format("{}: can't read this {}: {}", file_.string(), what_, describe_errno(error)));
}

void InputFile::fail(const std::string& why) const {
  throw Error(ErrorKind::UnreadableInput,
              fmt::format("{}: can't read this {}: {}", file_.string(), what_, why));
}

void InputFile::read(std::size_t position, std::span<std::byte> out) const {
  while (!out.empty()) {
    const ssize_t count = ::pread(descriptor_, out.data(), out.size(), static_cast<off_t>(position));
    if (count == 0) {
      fail(fmt::format("it ends at byte {}", position));
    }
    if (count < 0 && errno != EINTR) {
      fail(errno);
    }
    const auto done = static_cast<std::size_t>(std::max<ssize_t>(count, 0));
    position += done;
    out = out.subspan(done);
  }
}

std::vector<std::byte> InputFile::read_all(std::size_t most_bytes) const {
  if (size_ > most_bytes) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: larger than {} bytes: this is no {}", file_.string(), most_bytes, what_));
  }
  std::vector<std::byte> bytes(size_);
  read(0, bytes);
  return bytes;
}

std::vector<std::byte> read_bytes(const std::filesystem::path& file, std::size_t most_bytes,
                                  std::string_view what) {
  return InputFile(file, what).read_all(most_bytes);
}

}  // namespace facet::files
