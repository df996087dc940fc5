// Opens arbitrary bytes as a take and reads all of it. An Error is the right answer to a damaged file; a
// crash, a hang or an endless allocation is a finding. The bytes are also tried as one compressed blob.

#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "take/reader.hpp"
#include "take/take_file.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet;
  // In memory where the system has it: thousands of files per second.
  static const std::filesystem::path folder = std::filesystem::exists("/dev/shm")
                                                  ? std::filesystem::path("/dev/shm")
                                                  : std::filesystem::temp_directory_path();
  static const std::filesystem::path file = folder / ("facet-fuzz-" + std::to_string(::getpid()) + ".take");
  std::ofstream(file, std::ios::binary)
      .write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  try {
    take::TakeReader reader(file);
    constexpr std::int64_t kMaxFrames = 32;
    for (std::int64_t index = 0; index < std::min(reader.frame_count(), kMaxFrames); ++index) {
      try {
        reader.entry(index);
        reader.frame(index);
      } catch (const Error&) {
        continue;
      }
    }
    take::listed_info(file);
  } catch (const Error&) {
  }
  std::filesystem::remove(file);
  try {
    std::vector<std::uint8_t> out;
    take::decompress_blob({data, size}, out);
  } catch (const Error&) {
  }
  return 0;
}
