#pragma once

#include <fcntl.h>
#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <utility>

namespace facet::files {

/// The calls that change what is on a disk, each as the system's: what it returns, and errno. This class is
/// the kernel's; a test or a simulation overrides what shall fail, be cut short or be seen. Any thread,
/// several at once.
///
/// All that shall outlast the process is written by way of these (tests/style/check-seams): files that come
/// into being whole (OutputFile), and files that grow (AppendFile). Not by them: a take's index, which SQLite
/// writes by its VFS, a seam of its own that a test replaces there (sqlite3_vfs_register); what has no name
/// or no bytes on a disk (ScratchFile, memfds, sockets, /proc); and removals, which lose nothing that was
/// promised.
class Disk {
 public:
  Disk() = default;
  Disk(const Disk&) = delete;
  Disk& operator=(const Disk&) = delete;
  virtual ~Disk() = default;

  virtual int open(int folder, const char* file, int flags, mode_t mode);                   ///< openat(2)
  virtual ssize_t write(int fd, std::span<const std::byte> bytes, std::uint64_t position);  ///< pwrite(2)
  virtual int write_back(int fd, std::uint64_t position, std::uint64_t bytes);  ///< sync_file_range(2), begun
  virtual int sync(int fd);                                                     ///< fsync(2)
  virtual int sync_data(int fd);                                                ///< fdatasync(2)
  virtual int cut(int fd, std::uint64_t size);                                  ///< ftruncate(2)
  virtual int close(int fd);                                                    ///< close(2)
  virtual int name(int fd, const char* file);  ///< linkat(2) of what has no name yet
  virtual int rename(const char* from, const char* to, unsigned flags);  ///< renameat2(2)
};

/// The process's: the kernel's where none is installed.
Disk& disk() noexcept;

/// Puts a disk in the kernel's place until it is destroyed. Install before the threads start that shall meet
/// it, remove after they have ended.
class InstalledDisk {
 public:
  explicit InstalledDisk(Disk& disk);
  InstalledDisk(const InstalledDisk&) = delete;
  InstalledDisk& operator=(const InstalledDisk&) = delete;
  ~InstalledDisk();

 private:
  Disk* before_;
};

/// An open file or folder of the disk, or none; closed with its owner. What fails says why in errno.
class DiskFile {
 public:
  DiskFile() = default;
  /// openat(2), with O_CLOEXEC; none where that fails.
  static DiskFile open(int folder, const std::filesystem::path& file, int flags, mode_t mode = 0);
  /// A new file to be written; none where something of its name is there, or that fails.
  static DiskFile create(const std::filesystem::path& file, mode_t mode) {
    return open(AT_FDCWD, file, O_WRONLY | O_CREAT | O_EXCL, mode);
  }
  ~DiskFile() { close(); }
  DiskFile(DiskFile&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  DiskFile& operator=(DiskFile&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }

  explicit operator bool() const { return fd_ >= 0; }
  int get() const { return fd_; }
  /// All of it, by as many calls as it takes.
  bool write(std::span<const std::byte> bytes, std::uint64_t position) const;
  bool close();

 private:
  int fd_ = -1;
};

}  // namespace facet::files
