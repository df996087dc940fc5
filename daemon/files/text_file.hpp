#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

namespace facet::files {

/// The bytes of a file. `what` names it in messages: "configuration file". Throws Error(UnreadableInput)
/// where it can't be read, Error(Usage) where it is larger than most_bytes.
std::string read_text(const std::filesystem::path& file, std::size_t most_bytes, std::string_view what);

}  // namespace facet::files
