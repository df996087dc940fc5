#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

#include "support/source_folder.hpp"

namespace facet::test {

/// The folder of downloaded and built assets: $FACET_ASSETS, else assets/ in the source tree.
inline std::filesystem::path assets() {
  const char* set = std::getenv("FACET_ASSETS");
  return set != nullptr ? std::filesystem::path(set) : std::filesystem::path(FACET_SOURCE_DIR) / "assets";
}

/// The built default face model; tests that need it skip with a word where it is missing.
inline std::filesystem::path default_model() {
  return assets() / "default.facemodel";
}

/// A folder made for one test and removed with its contents at the end of the scope.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "facet-test-XXXXXX").string();
    if (::mkdtemp(pattern.data()) != nullptr) {
      path_ = pattern;
    }
  }
  ~TemporaryFolder() {
    if (!path_.empty()) {
      std::error_code ignored;
      std::filesystem::remove_all(path_, ignored);
    }
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace facet::test
