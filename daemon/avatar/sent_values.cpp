#include "avatar/sent_values.hpp"

namespace facet::avatar {
namespace {

// A mouth is open by jawOpen less mouthClose, round by funnel or pucker, else wide by the stretched corners:
// A open, O open and round, E open and wide, U round, I wide.
constexpr NamedFormula kVrmPresets[] = {
    {"A",
     "max(0, jawOpen - mouthClose) * (1 - max(mouthFunnel, mouthPucker)) * "
     "(1 - (mouthStretchLeft + mouthStretchRight) / 2)"},
    {"I",
     "(1 - max(0, jawOpen - mouthClose)) * (1 - max(mouthFunnel, mouthPucker)) * "
     "(mouthStretchLeft + mouthStretchRight) / 2"},
    {"U", "(1 - max(0, jawOpen - mouthClose)) * max(mouthFunnel, mouthPucker)"},
    {"E",
     "max(0, jawOpen - mouthClose) * (1 - max(mouthFunnel, mouthPucker)) * "
     "(mouthStretchLeft + mouthStretchRight) / 2"},
    {"O", "max(0, jawOpen - mouthClose) * max(mouthFunnel, mouthPucker)"},
    {"Blink", "min(eyeBlinkLeft, eyeBlinkRight)"},
    {"Blink_L", "max(0, eyeBlinkLeft - eyeBlinkRight)"},
    {"Blink_R", "max(0, eyeBlinkRight - eyeBlinkLeft)"},
    {"Joy", "(mouthSmileLeft + mouthSmileRight) / 2 * (cheekSquintLeft + cheekSquintRight) / 2"},
    {"Fun", "(mouthSmileLeft + mouthSmileRight) / 2 * (1 - (cheekSquintLeft + cheekSquintRight) / 2)"},
    {"Angry", "(browDownLeft + browDownRight) / 2 * (1 - (mouthSmileLeft + mouthSmileRight) / 2)"},
    {"Sorrow",
     "(mouthFrownLeft + mouthFrownRight) / 2 * (1 - (mouthSmileLeft + mouthSmileRight) / 2) * "
     "(1 - (browDownLeft + browDownRight) / 2)"},
    {"LookUp", "(eyeLookUpLeft + eyeLookUpRight) / 2"},
    {"LookDown", "(eyeLookDownLeft + eyeLookDownRight) / 2"},
    {"LookLeft", "(eyeLookOutLeft + eyeLookInRight) / 2"},
    {"LookRight", "(eyeLookInLeft + eyeLookOutRight) / 2"},
};

// Smile and brows: 0.5 at rest, as VTube Studio's own set-up of a model takes them. Eyes: X to the subject's
// right, Y up; the mouth's X to the left.
constexpr NamedFormula kVtsValues[] = {
    {"MouthSmile", "0.5 + (mouthSmileLeft + mouthSmileRight - mouthFrownLeft - mouthFrownRight) / 4"},
    {"MouthOpen", "max(0, jawOpen - mouthClose)"},
    {"MouthX", "mouthLeft - mouthRight"},
    {"Brows",
     "0.5 + (2 * browInnerUp + browOuterUpLeft + browOuterUpRight) / 8 - (browDownLeft + browDownRight) / 4"},
    {"BrowLeftY", "0.5 + (browInnerUp + browOuterUpLeft) / 4 - browDownLeft / 2"},
    {"BrowRightY", "0.5 + (browInnerUp + browOuterUpRight) / 4 - browDownRight / 2"},
    {"EyeOpenLeft", "1 - eyeBlinkLeft"},
    {"EyeOpenRight", "1 - eyeBlinkRight"},
    {"EyeLeftX", "eyeLookInLeft - eyeLookOutLeft"},
    {"EyeLeftY", "eyeLookUpLeft - eyeLookDownLeft"},
    {"EyeRightX", "eyeLookOutRight - eyeLookInRight"},
    {"EyeRightY", "eyeLookUpRight - eyeLookDownRight"},
    {"CheekPuff", "cheekPuff"},
    {"TongueOut", "tongueOut"},
    {"FaceAngry", "(browDownLeft + browDownRight) / 2 * (1 - (mouthSmileLeft + mouthSmileRight) / 2)"},
};

constexpr NamedFormula kUnifiedExpressions[] = {
    // Eyes: X to the subject's right, Y up.
    {"EyeLeftX", "eyeLookInLeft - eyeLookOutLeft"},
    {"EyeLeftY", "eyeLookUpLeft - eyeLookDownLeft"},
    {"EyeRightX", "eyeLookOutRight - eyeLookInRight"},
    {"EyeRightY", "eyeLookUpRight - eyeLookDownRight"},
    {"EyeX", "(eyeLookInLeft - eyeLookOutLeft + eyeLookOutRight - eyeLookInRight) / 2"},
    {"EyeY", "(eyeLookUpLeft - eyeLookDownLeft + eyeLookUpRight - eyeLookDownRight) / 2"},
    // Lids: open 0.75, wide open 1.
    {"EyeLidLeft", "0.75 * (1 - eyeBlinkLeft) + 0.25 * eyeWideLeft"},
    {"EyeLidRight", "0.75 * (1 - eyeBlinkRight) + 0.25 * eyeWideRight"},
    {"EyeLid", "0.375 * (2 - eyeBlinkLeft - eyeBlinkRight) + 0.125 * (eyeWideLeft + eyeWideRight)"},
    {"EyeOpenLeft", "1 - eyeBlinkLeft"},
    {"EyeOpenRight", "1 - eyeBlinkRight"},
    {"EyeOpen", "1 - (eyeBlinkLeft + eyeBlinkRight) / 2"},
    {"EyeClosedLeft", "eyeBlinkLeft"},
    {"EyeClosedRight", "eyeBlinkRight"},
    {"EyeClosed", "(eyeBlinkLeft + eyeBlinkRight) / 2"},
    {"EyeWideLeft", "eyeWideLeft"},
    {"EyeWideRight", "eyeWideRight"},
    {"EyeWide", "max(eyeWideLeft, eyeWideRight)"},
    {"EyeSquintLeft", "eyeSquintLeft"},
    {"EyeSquintRight", "eyeSquintRight"},
    {"EyeSquint", "max(eyeSquintLeft, eyeSquintRight)"},
    // Brows.
    {"BrowPinchLeft", "browDownLeft"},
    {"BrowPinchRight", "browDownRight"},
    {"BrowLowererLeft", "browDownLeft"},
    {"BrowLowererRight", "browDownRight"},
    {"BrowDownLeft", "browDownLeft"},
    {"BrowDownRight", "browDownRight"},
    {"BrowDown", "(browDownLeft + browDownRight) / 2"},
    {"BrowInnerUpLeft", "browInnerUp"},
    {"BrowInnerUpRight", "browInnerUp"},
    {"BrowInnerUp", "browInnerUp"},
    {"BrowOuterUpLeft", "browOuterUpLeft"},
    {"BrowOuterUpRight", "browOuterUpRight"},
    {"BrowOuterUp", "(browOuterUpLeft + browOuterUpRight) / 2"},
    {"BrowUpLeft", "0.6 * browOuterUpLeft + 0.4 * browInnerUp"},
    {"BrowUpRight", "0.6 * browOuterUpRight + 0.4 * browInnerUp"},
    {"BrowUp", "0.3 * (browOuterUpLeft + browOuterUpRight) + 0.4 * browInnerUp"},
    {"BrowExpressionLeft", "(browInnerUp + browOuterUpLeft) / 2 - browDownLeft"},
    {"BrowExpressionRight", "(browInnerUp + browOuterUpRight) / 2 - browDownRight"},
    {"BrowExpression",
     "browInnerUp / 2 + (browOuterUpLeft + browOuterUpRight) / 4 - (browDownLeft + browDownRight) / 2"},
    // Cheeks and nose.
    {"CheekSquintLeft", "cheekSquintLeft"},
    {"CheekSquintRight", "cheekSquintRight"},
    {"CheekSquint", "(cheekSquintLeft + cheekSquintRight) / 2"},
    {"CheekPuffLeft", "cheekPuff"},
    {"CheekPuffRight", "cheekPuff"},
    {"CheekPuffSuckLeft", "cheekPuff"},
    {"CheekPuffSuckRight", "cheekPuff"},
    {"CheekPuffSuck", "cheekPuff"},
    {"NoseSneerLeft", "noseSneerLeft"},
    {"NoseSneerRight", "noseSneerRight"},
    {"NoseSneer", "(noseSneerLeft + noseSneerRight) / 2"},
    // Jaw: X to the subject's right, Z forward.
    {"JawOpen", "jawOpen"},
    {"JawLeft", "jawLeft"},
    {"JawRight", "jawRight"},
    {"JawForward", "jawForward"},
    {"JawX", "jawRight - jawLeft"},
    {"JawZ", "jawForward"},
    {"MouthClosed", "mouthClose"},
    // Lips.
    {"LipSuckUpperLeft", "mouthRollUpper"},
    {"LipSuckUpperRight", "mouthRollUpper"},
    {"LipSuckUpper", "mouthRollUpper"},
    {"LipSuckLowerLeft", "mouthRollLower"},
    {"LipSuckLowerRight", "mouthRollLower"},
    {"LipSuckLower", "mouthRollLower"},
    {"LipSuck", "(mouthRollUpper + mouthRollLower) / 2"},
    {"LipFunnelUpperLeft", "mouthFunnel"},
    {"LipFunnelUpperRight", "mouthFunnel"},
    {"LipFunnelUpper", "mouthFunnel"},
    {"LipFunnelLowerLeft", "mouthFunnel"},
    {"LipFunnelLowerRight", "mouthFunnel"},
    {"LipFunnelLower", "mouthFunnel"},
    {"LipFunnel", "mouthFunnel"},
    {"LipPuckerUpperLeft", "mouthPucker"},
    {"LipPuckerUpperRight", "mouthPucker"},
    {"LipPuckerUpper", "mouthPucker"},
    {"LipPuckerLowerLeft", "mouthPucker"},
    {"LipPuckerLowerRight", "mouthPucker"},
    {"LipPuckerLower", "mouthPucker"},
    {"LipPuckerLeft", "mouthPucker"},
    {"LipPuckerRight", "mouthPucker"},
    {"LipPucker", "mouthPucker"},
    {"LipSuckFunnelUpper", "mouthRollUpper - mouthFunnel"},
    {"LipSuckFunnelLower", "mouthRollLower - mouthFunnel"},
    // Mouth: X to the subject's right.
    {"MouthUpperLeft", "mouthLeft"},
    {"MouthUpperRight", "mouthRight"},
    {"MouthLowerLeft", "mouthLeft"},
    {"MouthLowerRight", "mouthRight"},
    {"MouthUpperX", "mouthRight - mouthLeft"},
    {"MouthLowerX", "mouthRight - mouthLeft"},
    {"MouthX", "mouthRight - mouthLeft"},
    {"MouthUpperUpLeft", "mouthUpperUpLeft"},
    {"MouthUpperUpRight", "mouthUpperUpRight"},
    {"MouthUpperUp", "(mouthUpperUpLeft + mouthUpperUpRight) / 2"},
    {"MouthUpperDeepenLeft", "mouthUpperUpLeft"},
    {"MouthUpperDeepenRight", "mouthUpperUpRight"},
    {"MouthLowerDownLeft", "mouthLowerDownLeft"},
    {"MouthLowerDownRight", "mouthLowerDownRight"},
    {"MouthLowerDown", "(mouthLowerDownLeft + mouthLowerDownRight) / 2"},
    {"MouthOpen", "(mouthUpperUpLeft + mouthUpperUpRight + mouthLowerDownLeft + mouthLowerDownRight) / 4"},
    {"MouthCornerPullLeft", "mouthSmileLeft"},
    {"MouthCornerPullRight", "mouthSmileRight"},
    {"MouthCornerSlantLeft", "mouthSmileLeft"},
    {"MouthCornerSlantRight", "mouthSmileRight"},
    {"MouthCornerYLeft", "mouthSmileLeft - mouthFrownLeft"},
    {"MouthCornerYRight", "mouthSmileRight - mouthFrownRight"},
    {"MouthCornerY", "(mouthSmileLeft + mouthSmileRight - mouthFrownLeft - mouthFrownRight) / 2"},
    {"MouthSmileLeft", "mouthSmileLeft"},
    {"MouthSmileRight", "mouthSmileRight"},
    {"MouthFrownLeft", "mouthFrownLeft"},
    {"MouthFrownRight", "mouthFrownRight"},
    {"MouthSadLeft", "max(mouthFrownLeft, mouthStretchLeft)"},
    {"MouthSadRight", "max(mouthFrownRight, mouthStretchRight)"},
    {"SmileFrownLeft", "mouthSmileLeft - mouthFrownLeft"},
    {"SmileFrownRight", "mouthSmileRight - mouthFrownRight"},
    {"SmileFrown", "(mouthSmileLeft + mouthSmileRight - mouthFrownLeft - mouthFrownRight) / 2"},
    {"SmileSadLeft", "mouthSmileLeft - max(mouthFrownLeft, mouthStretchLeft)"},
    {"SmileSadRight", "mouthSmileRight - max(mouthFrownRight, mouthStretchRight)"},
    {"SmileSad",
     "(mouthSmileLeft + mouthSmileRight - max(mouthFrownLeft, mouthStretchLeft) - "
     "max(mouthFrownRight, mouthStretchRight)) / 2"},
    {"MouthStretchLeft", "mouthStretchLeft"},
    {"MouthStretchRight", "mouthStretchRight"},
    {"MouthStretch", "(mouthStretchLeft + mouthStretchRight) / 2"},
    {"MouthTightenerStretchLeft", "-mouthStretchLeft"},
    {"MouthTightenerStretchRight", "-mouthStretchRight"},
    {"MouthTightenerStretch", "-(mouthStretchLeft + mouthStretchRight) / 2"},
    {"MouthDimpleLeft", "mouthDimpleLeft"},
    {"MouthDimpleRight", "mouthDimpleRight"},
    {"MouthDimple", "(mouthDimpleLeft + mouthDimpleRight) / 2"},
    {"MouthRaiserUpper", "mouthShrugUpper"},
    {"MouthRaiserLower", "mouthShrugLower"},
    {"MouthPressLeft", "mouthPressLeft"},
    {"MouthPressRight", "mouthPressRight"},
    {"MouthPress", "(mouthPressLeft + mouthPressRight) / 2"},
    {"TongueOut", "tongueOut"},
};

}  // namespace

MappedValues vrm_presets() {
  return mapped_values(kVrmPresets);
}

MappedValues unified_expressions() {
  return mapped_values(kUnifiedExpressions);
}

MappedValues vts_values() {
  return mapped_values(kVtsValues);
}

}  // namespace facet::avatar
