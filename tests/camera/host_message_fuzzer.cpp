#include <array>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "camera/host_protocol.hpp"
#include "facet/printable.hpp"

/// Any bytes as a message of a camera host: a reason, or a message that is the same once written and read
/// again.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  namespace camera = facet::camera;
  std::string wrong;
  const auto message = camera::read_host_message({data, size}, wrong);
  if (message.has_value() == !wrong.empty()) {
    std::abort();
  }
  if (!message || size > camera::kMaxHostMessage_bytes) {
    return 0;
  }
  std::array<std::uint8_t, camera::kMaxHostMessage_bytes> bytes{};
  const std::size_t written = camera::write_host_message(*message, bytes);
  const auto again = camera::read_host_message({bytes.data(), written}, wrong);
  bool same = again && again->kind == message->kind && again->sequence == message->sequence &&
              again->timestamp_ns == message->timestamp_ns && again->corrupt == message->corrupt &&
              again->fault == message->fault && again->name == message->name && again->text == message->text;
  for (const facet::CameraCount& count : facet::kCameraCounts) {
    same = same && again->counters.*count.value == message->counters.*count.value;
  }
  same = same && facet::printable(message->name) == message->name &&
         facet::printable(message->text) == message->text;
  if (!same) {
    std::abort();
  }
  return 0;
}
