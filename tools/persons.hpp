#pragma once

#include <filesystem>
#include <string>

namespace facet::tools {

/// Help of every --config that names the folder of persons alone.
inline constexpr const char* kPersonsConfigHelp =
    "Configuration whose [persons] folder holds the persons; default: the installed one, where it exists";

/// The folder of persons of a configuration file; of the installed one where none is given. Empty: nobody is
/// kept. Throws what service::load_config throws.
std::filesystem::path persons_folder(const std::string& config);

}  // namespace facet::tools
