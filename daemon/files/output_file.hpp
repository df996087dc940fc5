#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "files/disk.hpp"

namespace facet::files {

struct CloseFile {
  void operator()(std::FILE* stream) const { std::fclose(stream); }
};

/// A file that comes into being whole: written under a temporary name beside its place, which nobody can
/// foresee, and renamed by commit(). Without commit the temporary file is removed and an earlier file of the
/// name stays as it was; so it does where the power is cut.
class OutputFile {
 public:
  /// mode: as of open(2), less the umask. Throws Error(Storage) naming the file, as do the others.
  explicit OutputFile(const std::filesystem::path& file, mode_t mode = 0666);
  ~OutputFile();
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;

  void write(std::string_view text);
  void write(std::span<const std::byte> bytes);
  /// In the place of what stands there, or with a gap before it; what write() writes follows it.
  void write_at(std::uint64_t position, std::span<const std::byte> bytes);
  /// The file is on the disk under its name when this returns.
  void commit();
  /// The same, for a name that must be free: throws Error(Usage) where something has it meanwhile.
  void commit_new();

 private:
  [[noreturn]] void fail(int error) const;
  void flush();
  void finish(unsigned rename_flags);

  std::filesystem::path file_;
  std::filesystem::path temporary_;
  DiskFile out_;
  std::vector<std::byte> waiting_;  ///< to be written at position_ when there is enough of it
  std::uint64_t position_ = 0;
  bool committed_ = false;
};

/// What is written now and goes into an output file later, behind something that is known only then. It has
/// no name: nothing of it is left, whatever ends the process.
class ScratchFile {
 public:
  /// beside: the output file, on whose disk it lies and which is named where something fails. Throws
  /// Error(Storage), as do the others.
  explicit ScratchFile(const std::filesystem::path& beside);

  void write(std::string_view text);
  void write(std::span<const std::byte> bytes);
  std::uint64_t size() const { return size_; }
  /// Appends all of it to a file; once.
  void move_to(OutputFile& out);

 private:
  [[noreturn]] void fail(int error) const;

  std::filesystem::path beside_;
  std::unique_ptr<std::FILE, CloseFile> stream_;
  std::uint64_t size_ = 0;
};

/// Waits until the names in a folder are on the disk; empty: the current one. Throws Error(Storage) naming
/// it.
void sync_folder(const std::filesystem::path& folder);

/// Renames a file whose contents are not what they should be to NAME.broken-N, so that it is neither in the
/// way nor lost. Returns what became of it, for people: "set aside as '...'", or why it could not be.
std::string set_aside(const std::filesystem::path& file);

/// Makes a folder and those above it, where they are not there yet. mode: of the folder, where it is made,
/// less the umask. Throws Error(Storage) naming it.
void make_folder(const std::filesystem::path& folder, mode_t mode = 0777);

}  // namespace facet::files
