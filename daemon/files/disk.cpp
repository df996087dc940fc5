#include "files/disk.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>

namespace facet::files {
namespace {

std::atomic<Disk*> installed = nullptr;

}  // namespace

int Disk::open(int folder, const char* file, int flags, mode_t mode) {
  return ::openat(folder, file, flags, mode);
}

ssize_t Disk::write(int fd, std::span<const std::byte> bytes, std::uint64_t position) {
  return ::pwrite(fd, bytes.data(), bytes.size(), static_cast<off_t>(position));
}

int Disk::write_back(int fd, std::uint64_t position, std::uint64_t bytes) {
  return ::sync_file_range(fd, static_cast<off_t>(position), static_cast<off_t>(bytes),
                           SYNC_FILE_RANGE_WRITE);
}

int Disk::sync(int fd) {
  return ::fsync(fd);
}

int Disk::sync_data(int fd) {
  return ::fdatasync(fd);
}

int Disk::cut(int fd, std::uint64_t size) {
  return ::ftruncate(fd, static_cast<off_t>(size));
}

int Disk::close(int fd) {
  return ::close(fd);
}

int Disk::name(int fd, const char* file) {
  const std::string nameless = fmt::format("/proc/self/fd/{}", fd);
  return ::linkat(AT_FDCWD, nameless.c_str(), AT_FDCWD, file, AT_SYMLINK_FOLLOW);
}

int Disk::rename(const char* from, const char* to, unsigned flags) {
  // Not every file system knows renameat2's flags, every one can rename.
  return flags == 0 ? std::rename(from, to) : ::renameat2(AT_FDCWD, from, AT_FDCWD, to, flags);
}

Disk& disk() noexcept {
  static Disk kernels;
  Disk* const found = installed.load(std::memory_order_acquire);
  return found == nullptr ? kernels : *found;
}

InstalledDisk::InstalledDisk(Disk& disk) : before_(installed.exchange(&disk, std::memory_order_acq_rel)) {}

InstalledDisk::~InstalledDisk() {
  installed.store(before_, std::memory_order_release);
}

DiskFile DiskFile::open(int folder, const std::filesystem::path& file, int flags, mode_t mode) {
  DiskFile opened;
  opened.fd_ = disk().open(folder, file.c_str(), flags | O_CLOEXEC, mode);
  return opened;
}

bool DiskFile::write(std::span<const std::byte> bytes, std::uint64_t position) const {
  while (!bytes.empty()) {
    const ssize_t written = disk().write(fd_, bytes, position);
    if (written < 0 && errno != EINTR) {
      return false;
    }
    const auto count = static_cast<std::size_t>(std::max<ssize_t>(written, 0));
    position += count;
    bytes = bytes.subspan(count);
  }
  return true;
}

bool DiskFile::close() {
  return fd_ < 0 || disk().close(std::exchange(fd_, -1)) == 0;
}

}  // namespace facet::files
