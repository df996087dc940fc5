#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "avatar/face_state.hpp"
#include "avatar/osc.hpp"

namespace facet::avatar {

/// Datagrams no longer than this are not torn apart on their way, bytes.
inline constexpr std::size_t kMostDatagram = 1400;

/// The VMC protocol's messages of one frame (https://protocol.vmc.info, "performer to marionette"):
/// /VMC/Ext/OK, /T, /Root/Pos, /Bone/Pos of "Head", /Blend/Val for each of ARKit's 52 with a capital first
/// letter, /Blend/Apply. Without a face: OK and T alone, OK with tracking status 0. Poses in Unity's
/// left-handed axes: x to the subject's right, y up, z out of the face.
///
/// time_s    since the sender began
/// neutral   whether a neutral pose was taken away: then the root has the head's movement and the bone's
/// place is 0; else the root stays at the origin and the bone has the head's place before the camera. Root
/// and bone together are where the head is, metres
void write_vmc(const FaceState& state, float time_s, bool neutral, OscBundles& out);

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
