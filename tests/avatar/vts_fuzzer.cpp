// Any text that VTube Studio may say, several in a row: a session ends or goes on, and says nothing that is
// no JSON. The first byte says where it stands.

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "avatar/vts_session.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet::avatar;
  std::string_view text(reinterpret_cast<const char*>(data), size);
  const bool has_token = !text.empty() && text.front() % 2 == 1;
  text.remove_prefix(text.empty() ? 0 : 1);
  VtsSession session(has_token ? "token" : "");
  const auto check = [](const std::string& message) {
    if (!nlohmann::json::accept(message)) {
      std::abort();
    }
  };
  check(session.begin());
  while (!text.empty() && session.state() != VtsSession::State::Over) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    for (const std::string& message : session.take(text.substr(0, end))) {
      check(message);
    }
    text.remove_prefix(std::min(text.size(), end + 1));
    for (const std::string& message : session.inject({{"MouthOpen", 1}, {"JawOpen", 0.5F}})) {
      check(message);
    }
  }
  return 0;
}
