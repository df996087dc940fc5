#include "files/text_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>

#include "facet/error.hpp"

namespace facet::files {

std::string read_text(const std::filesystem::path& file, std::size_t most_bytes, std::string_view what) {
  std::ifstream stream(file, std::ios::binary);
  std::string text;
  // In growing blocks: the most is far beyond what files of its kind usually have.
  for (std::size_t block = 1U << 16; stream && text.size() <= most_bytes; block *= 2) {
    const std::size_t before = text.size();
    text.resize(std::min(before + block, most_bytes + 1));
    stream.read(text.data() + before, static_cast<std::streamsize>(text.size() - before));
    text.resize(before + static_cast<std::size_t>(stream.gcount()));
  }
  if (stream.bad() || !stream.is_open() || std::filesystem::is_directory(file)) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("{}: cannot read this {}: check that it exists and may be read", file.string(), what));
  }
  if (text.size() > most_bytes) {
    throw Error(ErrorKind::Usage,
                fmt::format("{}: larger than {} bytes: this is no {}", file.string(), most_bytes, what));
  }
  return text;
}

}  // namespace facet::files
