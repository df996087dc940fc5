#pragma once

#include <filesystem>
#include <string>

namespace facet::tools {

/// This program ("facet"), or one that was built or installed beside it. Throws Error(Unavailable).
std::filesystem::path program(const std::string& name);

}  // namespace facet::tools
