// Feeds arbitrary bytes to everything that parses messages from outside. An Error is the right answer to a
// wrong message; anything else (a crash, a hang, an endless allocation) is a finding.

#include <cstdint>
#include <span>
#include <vector>

#include "facet/error.hpp"
#include "stream/decoder.hpp"
#include "stream/encoder.hpp"
#include "stream/framing.hpp"
#include "support/mesh_frames.hpp"

namespace {

using namespace facet;

void decode(std::span<const std::uint8_t> message, const std::shared_ptr<const mesh::Subject>& subject) {
  switch (stream::message_type(message)) {
    case stream::MessageType::Hello:
      stream::decode_hello(message);
      break;
    case stream::MessageType::Subscribe:
      stream::decode_subscription(message);
      break;
    case stream::MessageType::Dropped:
      stream::decode_dropped(message);
      break;
    case stream::MessageType::Goodbye:
      stream::decode_goodbye(message);
      break;
    case stream::MessageType::Subject:
      stream::decode_subject(message);
      break;
    case stream::MessageType::Albedo:
      stream::decode_albedo(message);
      break;
    case stream::MessageType::Frame: {
      stream::DecodedFrame out;
      stream::decode_frame(message, subject, nullptr, out);
      break;
    }
    case stream::MessageType::Ring:
      stream::decode_ring(message);
      break;
    case stream::MessageType::Unknown:
      break;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  // The corpus' frames are of this subject.
  static const auto subject = test::patch_subject(5, 3, 1);
  try {
    decode(std::vector<std::uint8_t>(data, data + size), subject);
  } catch (const Error&) {
  }
  stream::MessageAssembler assembler(stream::kMaxRequestBytes);
  std::span<const std::uint8_t> bytes(data, size);
  while (!bytes.empty()) {
    const auto outcome = assembler.feed(bytes);
    if (outcome == stream::MessageAssembler::Outcome::Complete) {
      assembler.next();
    } else if (outcome != stream::MessageAssembler::Outcome::Incomplete) {
      break;
    }
  }
  return 0;
}
