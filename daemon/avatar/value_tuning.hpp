#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>

#include "avatar/face_state.hpp"
#include "facet/setting.hpp"
#include "mesh/arkit.hpp"

namespace facet::avatar {

/// The most that a ValueTuning may have.
inline constexpr double kMostGain = 10;
inline constexpr double kMostDeadZone = 0.9;
inline constexpr double kMostValueSmoothing_ms = 2000;

/// How far an avatar follows one of ARKit's values.
struct ValueTuning {
  double gain = 1;          ///< of what the dead zone leaves; the value stays within 0 to 1
  double dead_zone = 0;     ///< below it the value is 0; the range above is stretched to 0 to 1
  double smoothing_ms = 0;  ///< time constant; 0: none

  bool operator==(const ValueTuning&) const = default;
};

inline constexpr Setting<ValueTuning> kValueTuningSettings[] = {
    {"gain", &at<&ValueTuning::gain>, 0, kMostGain},
    {"dead_zone", &at<&ValueTuning::dead_zone>, 0, kMostDeadZone},
    {"smoothing_ms", &at<&ValueTuning::smoothing_ms>, 0, kMostValueSmoothing_ms},
};

/// What `ValueTunings::all` is called where values are named.
inline constexpr const char* kAllValues = "all";

struct ValueTunings {
  ValueTuning all;                           ///< of every value that `named` does not have
  std::map<std::size_t, ValueTuning> named;  ///< by the index into mesh::kArkitNames

  const ValueTuning& of(std::size_t index) const;
  /// True: every value stays as it comes.
  bool plain() const { return all == ValueTuning() && named.empty(); }
  bool operator==(const ValueTunings&) const = default;
};

/// Tunes the values of states as they come: dead zone, then gain, then smoothing.
class ValueTuner {
 public:
  /// The smoothing begins anew after a pause without a face. The tunings may be others each time.
  void apply(const ValueTunings& tunings, FaceState& state);

 private:
  struct Before {
    std::int64_t timestamp_ns;
    mesh::ArkitValues values;
  };
  std::optional<Before> before_;
};

}  // namespace facet::avatar
