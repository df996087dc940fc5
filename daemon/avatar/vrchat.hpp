#pragma once

#include <optional>
#include <string>
#include <vector>

#include "avatar/face_state.hpp"
#include "avatar/osc.hpp"
#include "avatar/oscquery.hpp"
#include "avatar/value_mapping.hpp"

namespace facet::avatar {

/// One of the bools that an avatar has in a float's place, NAME1, NAME2, NAME4 ... and NAMENegative.
struct BinaryPart {
  unsigned bit = 0;       ///< of the bools with numbers: which power of two
  bool is_sign = false;   ///< NAMENegative; `bit` has no meaning
  int bits = 0;           ///< how many with numbers there are
  bool has_sign = false;  ///< whether there is NAMENegative

  /// As VRCFaceTracking writes it (BinaryBaseParameter.cs since its pull request 286): of |value| * 2^bits,
  /// rounded down, this bit; all bits from 0.99999 on; none of a negative value where there is no sign.
  bool of(float value) const;
};

/// VRChat's OSC messages (https://docs.vrchat.com/docs/osc-avatar-parameters, .../osc-eye-tracking): the
/// Unified Expressions as floats, "/avatar/parameters/v2/NAME" and "/avatar/parameters/FT/v2/NAME" (as
/// widespread templates of avatars call them); EyeTrackingActive, ExpressionTrackingActive and
/// LipTrackingActive, by which such avatars take them or leave them; "/tracking/eye/EyesClosedAmount" and
/// "/tracking/eye/LeftRightPitchYaw" (degrees, down and to the right positive), which move the eyes of every
/// avatar that has eyes. Of an avatar whose parameters are known, these alone: floats and bools, whatever
/// stands before "v2/NAME". One thread.
class VrChatWriter {
 public:
  /// A value that has changed by less than this is sent again only with all, every second.
  static constexpr float kLeastChange = 0.001F;
  static constexpr float kAllEvery_s = 1;

  /// chosen: further parameters ("/avatar/parameters/NAME"), or others' formulas (ValueMapping::vrchat).
  /// avatar: null where its parameters are not known.
  explicit VrChatWriter(const MappedValues& chosen, const AvatarParameters* avatar = nullptr);

  /// What has changed since the last call, or all. Without a face, or without its expression, the "Active"
  /// ones are false and no values are sent.
  ///
  /// time_s  since the sender began
  void write(const FaceState& state, float time_s, OscBundles& out);

  /// How many of the avatar's parameters are sent.
  int driven() const { return driven_; }

 private:
  struct Output {
    std::string address;
    std::optional<BinaryPart> part{};  ///< none: the value as a float
    std::optional<float> sent{};       ///< of a part 0 or 1
  };
  struct Value {
    Formula formula;
    std::vector<Output> outputs;
  };
  void take_avatar(const MappedValues& chosen, const AvatarParameters& avatar);

  std::vector<Value> values_;
  std::vector<std::string> active_addresses_;
  int driven_ = 0;
  std::optional<bool> active_;  ///< sent
  float all_sent_s_ = 0;
};

}  // namespace facet::avatar
