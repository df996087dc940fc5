#pragma once

#include <atomic>
#include <cerrno>
#include <cstdint>

#include "files/disk.hpp"

namespace facet::test {

/// A disk whose n-th call fails, once: a write has no room for its second half, all else is an I/O error. The
/// process's while it lives. Closing is done all the same, as the kernel does it.
class FailingDisk final : public files::Disk {
 public:
  explicit FailingDisk(std::int64_t n) : n_(n) {}

  /// Whether there were so many calls.
  bool has_failed() const { return calls_ >= n_; }

  int open(int folder, const char* file, int flags, mode_t mode) override {
    return fails() ? error(EMFILE) : Disk::open(folder, file, flags, mode);
  }
  ssize_t write(int fd, std::span<const std::byte> bytes, std::uint64_t position) override {
    if (!fails()) {
      return Disk::write(fd, bytes, position);
    }
    Disk::write(fd, bytes.first(bytes.size() / 2), position);
    return error(ENOSPC);
  }
  int write_back(int fd, std::uint64_t position, std::uint64_t bytes) override {
    return fails() ? error(EIO) : Disk::write_back(fd, position, bytes);
  }
  int sync(int fd) override { return fails() ? error(EIO) : Disk::sync(fd); }
  int sync_data(int fd) override { return fails() ? error(EIO) : Disk::sync_data(fd); }
  int cut(int fd, std::uint64_t size) override { return fails() ? error(EIO) : Disk::cut(fd, size); }
  int close(int fd) override {
    const int closed = Disk::close(fd);
    return fails() ? error(EIO) : closed;
  }
  int name(int fd, const char* file) override { return fails() ? error(EIO) : Disk::name(fd, file); }
  int rename(const char* from, const char* to, unsigned flags) override {
    return fails() ? error(EIO) : Disk::rename(from, to, flags);
  }

 private:
  bool fails() { return ++calls_ == n_; }
  static int error(int number) {
    errno = number;
    return -1;
  }

  const std::int64_t n_;
  std::atomic<std::int64_t> calls_ = 0;
  files::InstalledDisk installed_{*this};
};

}  // namespace facet::test
