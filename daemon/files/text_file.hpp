#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace facet::files {

/// The bytes of a file. `what` names it in messages: "configuration file". Throws Error(UnreadableInput)
/// where it can't be read, Error(Usage) where it is larger than most_bytes.
std::string read_text(const std::filesystem::path& file, std::size_t most_bytes, std::string_view what);

/// A file from outside, read in pieces. Such a file is never mapped: whoever shortens it, or a disk that
/// fails, would end the process (SIGBUS); here it is an Error. Any thread.
class InputFile {
 public:
  /// `what` names the file in messages. Throws Error(UnreadableInput) where it can't be opened or is not a
  /// regular file.
  InputFile(std::filesystem::path file, std::string_view what);
  ~InputFile();
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;

  std::size_t size() const { return size_; }  ///< when it was opened, bytes
  /// Whether it was this process's user's or root's when it was opened, and nobody else might write it: what
  /// stands in it was written by whom the process trusts anyway.
  bool trusted() const { return trusted_; }
  /// Fills `out` with the bytes from `position` on. Throws Error(UnreadableInput) where they are not there
  /// (any more) or can't be read.
  void read(std::size_t position, std::span<std::byte> out) const;
  /// All of it. Throws Error(UnreadableInput) where it is larger than most_bytes, before memory is taken,
  /// too.
  std::vector<std::byte> read_all(std::size_t most_bytes) const;

 private:
  [[noreturn]] void fail(int error) const;
  [[noreturn]] void fail(const std::string& why) const;

  std::filesystem::path file_;
  std::string what_;
  int descriptor_ = -1;
  std::size_t size_ = 0;
  bool trusted_ = false;
};

/// The bytes of a regular file; memory is taken once its size is known. Throws as InputFile, and
/// Error(UnreadableInput) where it is larger than most_bytes.
std::vector<std::byte> read_bytes(const std::filesystem::path& file, std::size_t most_bytes,
                                  std::string_view what);

}  // namespace facet::files
