#pragma once

#include <cstdio>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>

namespace facet::files {

/// A file that comes into being whole: written under a temporary name beside its place and renamed by
/// commit(). Without commit the temporary file is removed and an earlier file of the name stays as it was.
class OutputFile {
 public:
  /// Throws Error(Storage) naming the file, as do the others.
  explicit OutputFile(const std::filesystem::path& file);
  ~OutputFile();
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;

  void write(std::string_view text);
  void write(std::span<const std::byte> bytes);
  void commit();

 private:
  struct Close {
    void operator()(std::FILE* stream) const { std::fclose(stream); }
  };
  [[noreturn]] void fail(int error) const;

  std::filesystem::path file_;
  std::filesystem::path temporary_;
  std::unique_ptr<std::FILE, Close> stream_;
};

/// Makes a folder and those above it, where they are not there yet. Throws Error(Storage) naming it.
void make_folder(const std::filesystem::path& folder);

}  // namespace facet::files
