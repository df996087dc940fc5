#pragma once

#include <Eigen/Geometry>
#include <array>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace facet::mesh {

/// The 52 blend shapes of ARKit, in the order of Live Link Face's packets and with its capitals
/// ("EyeBlinkLeft"). Models and takes write them as ARKit does, with a small first letter.
inline constexpr std::array<std::string_view, 52> kArkitNames = {
    "EyeBlinkLeft",      "EyeLookDownLeft",    "EyeLookInLeft",
    "EyeLookOutLeft",    "EyeLookUpLeft",      "EyeSquintLeft",
    "EyeWideLeft",       "EyeBlinkRight",      "EyeLookDownRight",
    "EyeLookInRight",    "EyeLookOutRight",    "EyeLookUpRight",
    "EyeSquintRight",    "EyeWideRight",       "JawForward",
    "JawLeft",           "JawRight",           "JawOpen",
    "MouthClose",        "MouthFunnel",        "MouthPucker",
    "MouthLeft",         "MouthRight",         "MouthSmileLeft",
    "MouthSmileRight",   "MouthFrownLeft",     "MouthFrownRight",
    "MouthDimpleLeft",   "MouthDimpleRight",   "MouthStretchLeft",
    "MouthStretchRight", "MouthRollLower",     "MouthRollUpper",
    "MouthShrugLower",   "MouthShrugUpper",    "MouthPressLeft",
    "MouthPressRight",   "MouthLowerDownLeft", "MouthLowerDownRight",
    "MouthUpperUpLeft",  "MouthUpperUpRight",  "BrowDownLeft",
    "BrowDownRight",     "BrowInnerUp",        "BrowOuterUpLeft",
    "BrowOuterUpRight",  "CheekPuff",          "CheekSquintLeft",
    "CheekSquintRight",  "NoseSneerLeft",      "NoseSneerRight",
    "TongueOut"};

/// Index into kArkitNames, whatever the first letter's case; -1 where it is none of them.
int arkit_index(std::string_view name);

/// The name as ARKit writes it: "eyeBlinkLeft".
std::string arkit_name(std::size_t index);

using ArkitValues = std::array<float, kArkitNames.size()>;

/// A frame's expression in the order of kArkitNames, 0 to 1; 0 for what the model lacks. names and expression
/// [expression_count].
ArkitValues arkit_values(std::span<const std::string> names, std::span<const float> expression);

/// Yaw, pitch and roll of a rotation, radians, as Unreal's ARKit source has them, whose axes are left-handed:
/// yaw > 0 turns to the subject's right, pitch > 0 looks down, roll > 0 tilts towards the subject's left
/// shoulder. upright_from_head: a frame with x to the subject's left, y up, z out of the face when the
/// subject looks straight at the camera.
std::array<float, 3> live_link_angles(const Eigen::Matrix3f& upright_from_head);

/// The nine angles that Live Link Face sends behind the blend shapes, radians: yaw, pitch, roll of head, left
/// eye and right eye. The eyes' are those of the default face model's eyeLook shapes; their roll is 0.
std::array<float, 9> live_link_rotations(const ArkitValues& values, const Eigen::Matrix3f& upright_from_head);

/// The camera's frame turned upright: x right, y up, z towards the viewer. A face that looks straight into
/// the camera has no rotation in it.
inline Eigen::Isometry3f upright_from_camera() {
  Eigen::Isometry3f turn = Eigen::Isometry3f::Identity();
  turn.linear() = Eigen::Vector3f(1.0F, -1.0F, -1.0F).asDiagonal();
  return turn;
}

}  // namespace facet::mesh
