// Any text is a neutral pose with values from 0 to 1 and a pose that is one, or an Error(UnreadableInput).

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "avatar/face_state.hpp"
#include "facet/error.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet;
  try {
    const avatar::NeutralPose neutral =
        avatar::parse_neutral({reinterpret_cast<const char*>(data), size}, "fuzz");
    bool sound = neutral.upright_from_head.matrix().allFinite();
    for (const float value : neutral.values) {
      sound = sound && value >= 0 && value <= 1;
    }
    if (!sound) {
      std::abort();
    }
  } catch (const Error& error) {
    if (error.kind() != ErrorKind::UnreadableInput) {
      std::abort();
    }
  }
  return 0;
}
