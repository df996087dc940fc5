#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "facet/error.hpp"
#include "service/control_protocol.hpp"

/// Any line gets an answer that is one line of valid JSON-RPC, or none.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using facet::service::ControlMethods;
  using nlohmann::json;
  static const ControlMethods methods = {
      {"status",
       {false,
        {},
        [](const json&) {
          return json{{"state", "running"}};
        }}},
      {"record.start",
       {true, {"name"}, [](const json& params) { return json(params.at("name").get<std::string>()); }}},
      {"record.stop",
       {true,
        {},
        [](const json&) -> json { throw facet::Error(facet::ErrorKind::Usage, "nothing is recorded"); }}},
  };
  if (size < 1 || size > facet::service::kMaxRequestBytes) {
    return 0;
  }
  const facet::service::Caller caller{1, 1000, (data[0] & 1U) != 0};
  const std::string answer =
      answer_request(methods, {reinterpret_cast<const char*>(data + 1), size - 1}, caller);
  if (answer.empty()) {
    return 0;
  }
  const json response = json::parse(answer, nullptr, false);
  if (response.is_discarded() || answer.find('\n') != std::string::npos) {
    __builtin_trap();
  }
  return 0;
}
