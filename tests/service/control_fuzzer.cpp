#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "facet/error.hpp"
#include "service/control_protocol.hpp"
#include "service/studio.hpp"
#include "service/studio_methods.hpp"

namespace {

/// The studio's methods, of which no take is open: what they are asked is read and checked, then refused.
facet::service::ControlMethods closed_studio() {
  const auto folder = std::filesystem::temp_directory_path();
  static facet::service::Studio studio(
      folder / "no-such-folder", [](const std::shared_ptr<const facet::mesh::MeshFrame>&) {}, [](bool) {},
      "fuzzer");
  return studio_methods(studio);
}

}  // namespace

/// Any line gets an answer that is one line of valid JSON-RPC, or none.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using facet::service::ControlMethods;
  using nlohmann::json;
  static ControlMethods methods = {
      {"status",
       {false,
        {},
        [](const json&) {
          return json{{"state", "running"}};
        }}},
      {"record.start",
       {true,
        {{"name", facet::service::ControlParam::Type::Text, true}},
        [](const json& params) { return json(params.at("name").get<std::string>()); }}},
      {"record.stop",
       {true,
        {},
        [](const json&) -> json { throw facet::Error(facet::ErrorKind::Usage, "nothing is recorded"); }}},
  };
  if (methods.count("pose.set") == 0) {
    methods.merge(closed_studio());
  }
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
