// What a WebSocket's server may answer: its head, and then its frames, in pieces of changing size; the first
// byte says where they are cut.

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <string_view>

#include "stream/web_socket_client.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet::stream;
  constexpr std::size_t kLimitBytes = 300;
  if (size == 0) {
    return 0;
  }
  constexpr std::string_view kKey = "dGhlIHNhbXBsZSBub25jZQ==";
  const std::string_view head(reinterpret_cast<const char*>(data + 1), size - 1);
  if (web_socket_refusal(head, kKey).empty() &&
      head.find(web_socket_accept(kKey)) == std::string_view::npos) {
    std::abort();  // what does not know the key has not read the request
  }
  WebSocketAssembler assembler(kLimitBytes, WebSocketPeer::Server);
  std::span<const std::uint8_t> bytes(data + 1, size - 1);
  while (!bytes.empty()) {
    std::span<const std::uint8_t> piece = bytes.first(std::min<std::size_t>(bytes.size(), 1 + data[0]));
    bytes = bytes.subspan(piece.size());
    while (!piece.empty()) {
      const auto outcome = assembler.feed(piece);
      if (assembler.message().size() > kLimitBytes || assembler.control().size() > 125) {
        std::abort();
      }
      if (outcome == WebSocketAssembler::Outcome::Message) {
        assembler.next();
      } else if (outcome != WebSocketAssembler::Outcome::Incomplete &&
                 outcome != WebSocketAssembler::Outcome::Ping) {
        return 0;
      }
    }
  }
  return 0;
}
