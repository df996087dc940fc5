// Messages of one stream or take, each decoded with what the ones before it have left: a frame with a subject
// and an albedo that are not the ones it was made with. Each message stands behind its length, two bytes.

#include <algorithm>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "facet/error.hpp"
#include "stream/decoder.hpp"
#include "stream/encoder.hpp"

namespace {

using namespace facet;

class Reader {
 public:
  void read(std::span<const std::uint8_t> message) {
    switch (stream::message_type(message)) {
      case stream::MessageType::Subject:
        subject_ = stream::decode_subject(message);
        break;
      case stream::MessageType::Albedo:
        albedo_ = stream::decode_albedo(message).albedo;
        break;
      case stream::MessageType::Frame:
        stream::decode_frame(message, subject_, albedo_, out_);
        break;
      default:
        break;
    }
  }

 private:
  std::shared_ptr<const mesh::Subject> subject_;
  std::shared_ptr<const mesh::Albedo> albedo_;
  stream::DecodedFrame out_;  ///< one for all frames, as readers have it
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Reader reader;
  for (std::span<const std::uint8_t> rest(data, size); rest.size() > 2;) {
    const std::size_t length = rest[0] | std::size_t{rest[1]} << 8U;
    rest = rest.subspan(2);
    const auto message = rest.first(std::min(length, rest.size()));
    rest = rest.subspan(message.size());
    try {
      reader.read(std::vector<std::uint8_t>(message.begin(), message.end()));
    } catch (const Error&) {
      continue;  // the rest may be read all the same
    }
  }
  return 0;
}
