// Reads arbitrary bytes as the records of a frame's pictures. An Error is the right answer to damaged bytes;
// a crash, a hang or an endless allocation is a finding. Once as they are, and once with every checksum put
// right, so that what stands behind it is reached.

#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "facet/error.hpp"
#include "take/checksum.hpp"
#include "take/picture_records.hpp"

namespace {

using namespace facet;

/// A set of three cameras whose pixels are to be read; sizes as in the seeds.
FrameSet described() {
  FrameSet set;
  set.slot = 0;
  set.frames.resize(4);
  set.missing = 1U << 3U;
  for (std::size_t camera = 0; camera < 3; ++camera) {
    set.frames[camera].width_px = camera == 1 ? 39 : 32;
    set.frames[camera].height_px = 24;
    set.frames[camera].stride_bytes = 4 * static_cast<std::size_t>(set.frames[camera].width_px);
  }
  return set;
}

void read(std::span<const std::uint8_t> bytes) {
  static take::PictureReader reader;
  FrameSet set = described();
  try {
    reader.read(bytes, 0, set);
  } catch (const Error&) {
  }
}

void mend_checksums(std::span<std::uint8_t> bytes) {
  constexpr std::size_t kCrcEnd = offsetof(take::PictureRecord, frame_number);
  while (bytes.size() >= sizeof(take::PictureRecord)) {
    take::PictureRecord record;
    std::memcpy(&record, bytes.data(), sizeof(record));
    const std::size_t end = sizeof(record) + record.payload_bytes;
    if (end > bytes.size()) {
      return;
    }
    record.crc = take::crc32c(bytes.subspan(kCrcEnd, end - kCrcEnd));
    std::memcpy(bytes.data() + offsetof(take::PictureRecord, crc), &record.crc, sizeof(record.crc));
    const std::size_t padded = (end + 7) / 8 * 8;
    bytes = bytes.subspan(std::min(padded, bytes.size()));
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  read({data, size});
  std::vector<std::uint8_t> mended(data, data + size);
  mend_checksums(mended);
  read(mended);
  return 0;
}
