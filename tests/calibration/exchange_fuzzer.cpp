#include <cstddef>
#include <cstdint>
#include <string_view>

#include "calibration/exchange.hpp"
#include "capture/rig_file.hpp"
#include "facet/error.hpp"

/// Any text is a rig that can be written as a rig file, or an Error of kind UnreadableInput.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  namespace calibration = facet::calibration;
  if (size > calibration::kMaxYamlBytes) {
    return 0;
  }
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto attempt = [](const auto& parse) {
    facet::capture::Rig rig;
    try {
      rig = parse();
    } catch (const facet::Error& error) {
      if (error.kind() != facet::ErrorKind::UnreadableInput) {
        __builtin_trap();
      }
      return;
    }
    facet::capture::parse_rig(facet::capture::format_rig(rig), "again.toml");
  };
  attempt([&] { return calibration::parse_kalibr(text, "fuzz.yaml"); });
  attempt([&] { return calibration::parse_opencv(text, "fuzz.yml", text, "fuzz.yml", {}); });
  return 0;
}
