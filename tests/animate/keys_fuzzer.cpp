// Reads arbitrary bytes as a keys file. An Error is the right answer to nonsense; what is accepted must hold
// what its reader promises.

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "animate/keys_file.hpp"
#include "facet/error.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet;
  try {
    const animate::KeyList list = animate::parse_keys({reinterpret_cast<const char*>(data), size}, "keys");
    if (list.keys.empty()) {
      std::abort();
    }
    double before_s = -1;
    for (const animate::Key& key : list.keys) {
      if (!(key.time_s > before_s)) {
        std::abort();
      }
      before_s = key.time_s;
      for (const animate::KeyControl& control : key.controls) {
        if (!control.value.allFinite()) {
          std::abort();
        }
      }
    }
  } catch (const Error&) {
  }
  return 0;
}
