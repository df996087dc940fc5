#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>

#include "files/disk.hpp"

namespace facet::files {

/// A file that is written on and on under its own name, for readers who know how far it is good: a take's
/// segment, a log. What was there at the last sync stays. One thread. Throws Error(Storage) naming the file.
class AppendFile {
 public:
  AppendFile() = default;  ///< none
  /// file: open, and empty. path: its name.
  AppendFile(DiskFile file, std::filesystem::path path) : file_(std::move(file)), path_(std::move(path)) {}
  /// A new file; something of its name is an error.
  static AppendFile create(const std::filesystem::path& path, mode_t mode = 0644);
  /// An empty file in the place of what is there.
  static AppendFile replace(const std::filesystem::path& path, mode_t mode = 0666);

  explicit operator bool() const { return static_cast<bool>(file_); }
  /// After a failure the file is only good to be cut.
  void append(std::span<const std::byte> bytes);
  /// Bytes appended; after a failure as many as may stand there.
  std::uint64_t size() const { return size_; }
  /// Tells the kernel to write what stands behind `position`: a hint, so that a later sync has less to do.
  void write_back(std::uint64_t position) const;
  /// All that was appended is on the disk when this returns; a new name is when its folder is.
  void sync() const;
  /// Takes what stands behind `size` away, as far as that can be done.
  void cut(std::uint64_t size);

 private:
  DiskFile file_;
  std::filesystem::path path_;
  std::uint64_t size_ = 0;
};

/// A folder held open: its names can be synced and files be made in it by a process that has no descriptors
/// left.
class Folder {
 public:
  /// Throws Error(Storage) naming it, as sync does.
  explicit Folder(const std::filesystem::path& path);

  /// The names in it are on the disk when this returns.
  void sync() const;
  /// A file in it that has no name yet (Disk::name); none where the file system knows no such files, or for
  /// want of descriptors.
  DiskFile nameless() const;

 private:
  DiskFile folder_;
  std::filesystem::path path_;
};

}  // namespace facet::files
