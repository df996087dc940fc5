// Any datagram is a request with 1 to 16 ports that ends, or none.

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "avatar/phone_requests.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet;
  const auto request = avatar::parse_phone_request({reinterpret_cast<const char*>(data), size});
  if (request) {
    bool sound = !request->ports.empty() && request->ports.size() <= 16 && request->lasting.count() > 0 &&
                 request->lasting <= avatar::kIFacialMocapLasts;
    for (const std::uint16_t port : request->ports) {
      sound = sound && port != 0;
    }
    if (!sound) {
      std::abort();
    }
  }
  return 0;
}
