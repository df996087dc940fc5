// Reads arbitrary bytes as the sound beside a take. An Error is the right answer to damaged bytes; a crash, a
// hang or an endless allocation is a finding.

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>

#include "facet/error.hpp"
#include "sound/flac_file.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const int memory = ::memfd_create("sound", MFD_CLOEXEC);
  if (::ftruncate(memory, 0) != 0 || ::pwrite(memory, data, size, 0) != static_cast<ssize_t>(size)) {
    return 0;
  }
  try {
    facet::sound::FlacReader reader("/proc/self/fd/" + std::to_string(memory));
    facet::sound::FlacReader::Block block;
    while (reader.next(block)) {
      if (block.samples.size() % static_cast<std::size_t>(reader.format().channels) != 0) {
        __builtin_trap();
      }
    }
  } catch (const facet::Error&) {
  }
  return 0;
}
