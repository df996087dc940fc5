#include "persons.hpp"

#include "service/config.hpp"
#include "service/default_paths.hpp"

namespace facet::tools {

std::filesystem::path persons_folder(const std::string& config) {
  const std::string file = config.empty() ? service::installed_config_file() : config;
  return file.empty() ? std::filesystem::path() : service::load_config(file).pipeline.persons_folder;
}

}  // namespace facet::tools
