// A ring whose writer lies: arbitrary bytes as the page and one slot, to the reader and the frame's decoder.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "facet/error.hpp"
#include "stream/decoder.hpp"
#include "stream/ring.hpp"
#include "support/mesh_frames.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet;
  static const auto subject = test::patch_subject(5, 3, 1);
  if (size < sizeof(facet_ring_page)) {
    return 0;
  }
  // The page's end is left out of the input; what follows it is the slots.
  std::vector<std::uint64_t> words((FACET_RING_PAGE_BYTES + size) / 8 + 1);
  auto* memory = reinterpret_cast<std::uint8_t*>(words.data());
  std::memcpy(memory, data, sizeof(facet_ring_page));
  std::memcpy(memory + FACET_RING_PAGE_BYTES, data + sizeof(facet_ring_page), size - sizeof(facet_ring_page));
  try {
    stream::RingReader reader({memory, FACET_RING_PAGE_BYTES + size - sizeof(facet_ring_page)});
    if (reader.newest() == stream::RingReader::Outcome::Frame) {
      std::uint64_t sum = 0;
      const auto add = [&](std::size_t, auto value) { sum += static_cast<std::uint64_t>(value); };
      for (std::size_t which = 0; which < FACET_RING_CONFIDENCE; ++which) {
        stream::for_each_number<std::int16_t>(reader.array(which), add);
      }
      stream::for_each_number<std::uint8_t>(reader.array(FACET_RING_CONFIDENCE), add);
      stream::DecodedFrame out;
      stream::decode_frame(reader, subject, nullptr, out);
    }
  } catch (const Error&) {
  }
  return 0;
}
