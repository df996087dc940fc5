#include "files/append_file.hpp"

#include <fmt/format.h>

#include <cerrno>
#include <cstring>

#include "facet/error.hpp"

namespace facet::files {
namespace {

[[noreturn]] void fail(const char* what, const std::filesystem::path& path, int error) {
  throw Error(ErrorKind::Storage,
              fmt::format("cannot {} '{}': {}", what, path.string(), std::strerror(error)));
}

AppendFile opened(DiskFile file, const std::filesystem::path& path) {
  if (!file) {
    fail("create", path, errno);
  }
  return {std::move(file), path};
}

}  // namespace

AppendFile AppendFile::create(const std::filesystem::path& path, mode_t mode) {
  return opened(DiskFile::create(path, mode), path);
}

AppendFile AppendFile::replace(const std::filesystem::path& path, mode_t mode) {
  return opened(DiskFile::open(AT_FDCWD, path, O_WRONLY | O_CREAT | O_TRUNC, mode), path);
}

void AppendFile::append(std::span<const std::byte> bytes) {
  const std::uint64_t position = size_;
  size_ += bytes.size();
  if (!file_.write(bytes, position)) {
    fail("write", path_, errno);
  }
}

void AppendFile::write_back(std::uint64_t position) const {
  disk().write_back(file_.get(), position, size_ - position);
}

void AppendFile::sync() const {
  if (disk().sync_data(file_.get()) != 0) {
    fail("sync", path_, errno);
  }
}

void AppendFile::cut(std::uint64_t size) {
  if (disk().cut(file_.get(), size) == 0) {
    size_ = size;
  }
}

Folder::Folder(const std::filesystem::path& path)
    : folder_(DiskFile::open(AT_FDCWD, path, O_RDONLY | O_DIRECTORY)), path_(path) {
  if (!folder_) {
    fail("open the folder", path_, errno);
  }
}

void Folder::sync() const {
  // Some file systems (FUSE, CIFS) can't sync a folder and say EINVAL: there is nothing more to be had there.
  if (disk().sync(folder_.get()) != 0 && errno != EINVAL) {
    fail("sync the folder", path_, errno);
  }
}

DiskFile Folder::nameless() const {
  return DiskFile::open(folder_.get(), ".", O_TMPFILE | O_WRONLY, 0644);
}

}  // namespace facet::files
