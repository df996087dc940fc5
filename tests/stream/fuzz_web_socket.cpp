// A WebSocket client's bytes, in pieces of changing size; the first byte says where they are cut.

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "stream/web_socket.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using facet::stream::WebSocketAssembler;
  constexpr std::size_t kLimitBytes = 300;
  if (size == 0) {
    return 0;
  }
  WebSocketAssembler assembler(kLimitBytes);
  std::span<const std::uint8_t> bytes(data + 1, size - 1);
  while (!bytes.empty()) {
    std::span<const std::uint8_t> piece = bytes.first(std::min<std::size_t>(bytes.size(), 1 + data[0]));
    bytes = bytes.subspan(piece.size());
    while (!piece.empty()) {
      const std::size_t before = piece.size();
      const auto outcome = assembler.feed(piece);
      if (assembler.message().size() > kLimitBytes || assembler.control().size() > 125) {
        std::abort();
      }
      switch (outcome) {
        case WebSocketAssembler::Outcome::Incomplete:
          if (!piece.empty()) {
            std::abort();
          }
          break;
        case WebSocketAssembler::Outcome::Message:
          assembler.next();
          [[fallthrough]];
        case WebSocketAssembler::Outcome::Ping:
          if (piece.size() == before) {
            std::abort();
          }
          break;
        case WebSocketAssembler::Outcome::Close:
        case WebSocketAssembler::Outcome::Violation:
        case WebSocketAssembler::Outcome::TooLong:
          return 0;
      }
    }
  }
  return 0;
}
