#pragma once

#include <filesystem>
#include <string>
#include <system_error>

namespace facet::service {

/// The configuration file that facetd reads where none is named (FACET_CONFIG_FILE of the build,
/// /etc/facet/facet.toml unless set). It need not exist.
inline std::filesystem::path default_config_file() {
  return FACET_CONFIG_FILE;
}

/// The same for programs that can do without: empty where it does not exist.
inline std::string installed_config_file() {
  std::error_code ignored;
  const std::filesystem::path file = default_config_file();
  return std::filesystem::exists(file, ignored) ? file.string() : std::string();
}

}  // namespace facet::service
