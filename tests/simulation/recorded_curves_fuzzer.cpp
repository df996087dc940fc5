// A recording of any bytes is read or refused, and what is read is finite at all times.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "facet/error.hpp"
#include "simulation/recorded_curves.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using facet::simulation::RecordedCurves;
  try {
    const auto curves = RecordedCurves::parse({reinterpret_cast<const char*>(data), size}, "fuzzed");
    for (const double part : {-0.1, 0.0, 0.5, 1.0, 2.0}) {
      for (const float value : curves.values(part * curves.duration_s())) {
        if (!(value >= 0 && value <= 1)) {
          std::abort();
        }
      }
      if (!std::isfinite(curves.head(part * curves.duration_s()).yaw_rad)) {
        std::abort();
      }
    }
  } catch (const facet::Error&) {
    return 0;
  }
  return 0;
}
