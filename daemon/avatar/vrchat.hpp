#pragma once

#include <optional>
#include <string>
#include <vector>

#include "avatar/face_state.hpp"
#include "avatar/osc.hpp"
#include "avatar/value_mapping.hpp"

namespace facet::avatar {

/// VRChat's OSC messages (https://docs.vrchat.com/docs/osc-avatar-parameters, .../osc-eye-tracking): the
/// Unified Expressions as floats, "/avatar/parameters/v2/NAME" and "/avatar/parameters/FT/v2/NAME" (as
/// widespread templates of avatars call them); EyeTrackingActive, ExpressionTrackingActive and
/// LipTrackingActive, by which such avatars take them or leave them; "/tracking/eye/EyesClosedAmount" and
/// "/tracking/eye/LeftRightPitchYaw" (degrees, down and to the right positive), which move the eyes of every
/// avatar that has eyes. One thread.
class VrChatWriter {
 public:
  /// A value that has changed by less than this is sent again only with all, every second.
  static constexpr float kLeastChange = 0.001F;
  static constexpr float kAllEvery_s = 1;

  /// chosen: further parameters ("/avatar/parameters/NAME"), or others' formulas (ValueMapping::vrchat).
  explicit VrChatWriter(const MappedValues& chosen);

  /// What has changed since the last call, or all. Without a face, or without its expression, the "Active"
  /// ones are false and no values are sent.
  ///
  /// time_s  since the sender began
  void write(const FaceState& state, float time_s, OscBundles& out);

 private:
  struct Parameter {
    std::string address;
    Formula formula;
    std::optional<float> sent;
  };
  std::vector<Parameter> parameters_;
  std::optional<bool> active_;  ///< sent
  float all_sent_s_ = 0;
};

}  // namespace facet::avatar
