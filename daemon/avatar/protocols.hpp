#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "avatar/face_state.hpp"
#include "avatar/osc.hpp"
#include "avatar/value_mapping.hpp"

namespace facet::avatar {

/// Datagrams no longer than this are not torn apart on their way, bytes.
inline constexpr std::size_t kMostDatagram = 1400;

/// Which names of values VMC sends: an avatar that has both sorts would make every movement twice.
enum class VmcShapes {
  PerfectSync,  ///< ARKit's 52, with a capital first letter
  Presets,      ///< VRM's (vrm_presets), of avatars without ARKit's
  Both
};
inline constexpr std::array kVmcShapes = {"perfect_sync", "presets", "both"};

/// What does not change from frame to frame.
struct VmcContent {
  bool arkit_names = true;  ///< the 52 are sent
  bool eye_bones = true;
  MappedValues values;  ///< sent too; of a name that is one of the 52 these are sent alone
};
VmcContent vmc_content(VmcShapes shapes, bool eye_bones, const MappedValues& chosen);

/// The VMC protocol's messages of one frame (https://protocol.vmc.info, "performer to marionette"):
/// /VMC/Ext/OK, /T, /Root/Pos, /Bone/Pos of "Head", "LeftEye" and "RightEye", /Blend/Val for each value,
/// /Blend/Apply. Without a face: OK and T alone, OK with tracking status 0. Poses in Unity's left-handed
/// axes: x to the subject's right, y up, z out of the face. Bones are turned and have no place of their own:
/// a receiver that takes places leaves them where the avatar has them.
///
/// time_s    since the sender began
/// neutral   whether a neutral pose was taken away: then the root has the head's movement in metres; else it
/// stays at the origin
void write_vmc(const FaceState& state, float time_s, bool neutral, const VmcContent& content,
               OscBundles& out);

/// The packet that Epic's Live Link Face app sends (its version 6), numbers with the most significant byte
/// first: u8 6; device and subject name, each i32 length and UTF-8; frame time: i32 frame, f32 part of a
/// frame, i32 rate's numerator, i32 denominator; u8 61; 61 f32: 52 blend shapes in the order of
/// mesh::kArkitNames and mesh::live_link_rotations. Without a face nothing is sent.
///
/// device        36 characters that tell senders apart, of a UUID's form
/// time_of_day_s seconds since midnight, from which the frame is counted at 60 Hz
void write_live_link_face(const FaceState& state, const std::string& device, const std::string& subject,
                          double time_of_day_s, std::vector<std::byte>& out);

}  // namespace facet::avatar
