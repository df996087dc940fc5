#include "files/text_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <system_error>

#include "facet/error.hpp"
#include "facet/system_error.hpp"

namespace facet::files {

std::string read_text(const std::filesystem::path& file, std::size_t most_bytes, std::string_view what) {
  // The streams of the library say that something failed, and leave in errno what.
  errno = 0;
  std::ifstream stream(file, std::ios::binary);
  std::string text;
  // In growing blocks: the most is far beyond what files of its kind usually have.
  for (std::size_t block = 1U << 16; stream && text.size() <= most_bytes; block *= 2) {
    const std::size_t before = text.size();
    text.resize(std::min(before + block, most_bytes + 1));
    stream.read(text.data() + before, static_cast<std::streamsize>(text.size() - before));
    text.resize(before + static_cast<std::size_t>(stream.gcount()));
  }
  const int error = errno;
  std::error_code ignored;
  if (stream.bad() || !stream.is_open() || std::filesystem::is_directory(file, ignored)) {
    throw Error(kind_of_errno(error), fmt::format("{}: cannot read this {}: {}", file.string(), what,
                                                  may_pass(error) ? describe_errno(error)
                                                                  : "check that it exists and may be read"));
  }
  if (text.size() > most_bytes) {
    throw Error(ErrorKind::Usage,
                fmt::format("{}: larger than {} bytes: this is no {}", file.string(), most_bytes, what));
  }
  return text;
}

}  // namespace facet::files
