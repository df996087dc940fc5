// An AVI file of any bytes: pictures that lie in it, in their order, or none.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>

#include "camera/avi_index.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto index = facet::camera::read_avi_index(
      [&](std::uint64_t position, std::span<std::byte> out) {
        if (position > size || out.size() > size - position) {
          return false;
        }
        std::memcpy(out.data(), data + position, out.size());
        return true;
      },
      size);
  if (!index) {
    return 0;
  }
  bool sound = index->width_px >= 1 && index->height_px >= 1 && index->rate_hz >= 0 &&
               index->frame_count >= index->pictures.size();
  for (std::size_t k = 0; k < index->pictures.size(); ++k) {
    const facet::camera::AviPicture& picture = index->pictures[k];
    sound = sound && picture.size_bytes > 0 && picture.position + picture.size_bytes <= size &&
            (k == 0 || (picture.position > index->pictures[k - 1].position &&
                        picture.number > index->pictures[k - 1].number));
  }
  if (!sound) {
    std::abort();
  }
  return 0;
}
