// A segment of any bytes behind a head that is right or not, read where an index of any numbers says. An
// Error is the right answer to what is not there; what is read lies inside the file.

#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "take/checksum.hpp"
#include "take/segment.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet;
  constexpr std::size_t kHead = 64;
  constexpr std::size_t kExtents = 4;
  static const std::filesystem::path folder =
      (std::filesystem::exists("/dev/shm") ? std::filesystem::path("/dev/shm")
                                           : std::filesystem::temp_directory_path()) /
      ("facet-fuzz-segment-" + std::to_string(::getpid()));
  static const std::filesystem::path take = folder / "some.take";
  static const bool made = std::filesystem::create_directories(take::segments_folder(take));
  if (!made || size < kExtents * sizeof(take::Extent) + kHead + 1) {
    return 0;
  }
  take::Extent extents[kExtents];
  std::memcpy(extents, data, sizeof extents);
  std::vector<std::uint8_t> file(data + sizeof extents + 1, data + size);
  if ((data[sizeof extents] & 1U) != 0) {
    // The head of the first segment of a take whose identity is 0.
    std::fill_n(file.begin() + 16, 16, std::uint8_t{0});
    std::memcpy(file.data(), "FCTKSEG\n\1\0\0\0\1\0\0\0", 16);
    const std::uint32_t crc = take::crc32c({file.data(), kHead - 4});
    std::memcpy(file.data() + kHead - 4, &crc, sizeof crc);
  }
  std::ofstream(take::segment_file(take, 1), std::ios::binary)
      .write(reinterpret_cast<const char*>(file.data()), static_cast<std::streamsize>(file.size()));
  take::SegmentReader reader(take, {});
  for (const take::Extent& extent : extents) {
    try {
      reader.check(extent.segment);
    } catch (const Error&) {
      // read() says the same
    }
    try {
      const auto bytes = reader.read(extent);
      const auto* from = file.data() + extent.position;
      if (bytes.size() != static_cast<std::size_t>(extent.bytes) ||
          !std::equal(bytes.begin(), bytes.end(), from)) {
        std::abort();
      }
    } catch (const Error&) {
      continue;
    }
  }
  return 0;
}
