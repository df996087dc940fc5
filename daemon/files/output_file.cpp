#include "files/output_file.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstring>
#include <system_error>

#include "facet/error.hpp"

namespace facet::files {

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
  throw Error(ErrorKind::Storage, fmt::format("cannot write '{}': {}", file_.string(), std::strerror(error)));
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

void make_folder(const std::filesystem::path& folder) {
  std::error_code failure;
  std::filesystem::create_directories(folder, failure);
  if (failure) {
    throw Error(ErrorKind::Storage,
                fmt::format("{}: cannot make the folder ({})", folder.string(), failure.message()));
  }
}

}  // namespace facet::files
