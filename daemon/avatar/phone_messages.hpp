#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "avatar/face_state.hpp"

namespace facet::avatar {

/// What phones with a face tracker send. Names are of the person's own sides. Angles in degrees about axes x
/// to the subject's left, y up, z out of the face, the head turned about y, x, z in that order: x > 0 looks
/// down, y > 0 to the subject's left, z > 0 tilts towards the subject's right shoulder.

/// What stands between a value's name and its number: '-', or '&' for receivers that asked for
/// "sendDataVersion=v2".
enum class IFacialMocapVersion { V1, V2 };

/// iFacialMocap's text (https://www.ifacialmocap.com/for-developer/), one datagram a frame: 52 times
/// "NAME-NUMBER|" ("NAME&NUMBER|" in version 2), 0 to 100, the sides "_L" and "_R"; then
/// "=head#X,Y,Z,X,Y,Z|rightEye#X,Y,Z|leftEye#X,Y,Z|": angles, and the head's place in metres, in the camera's
/// axes turned upright (z < 0 before it), or against the neutral pose where one was taken away. Without a
/// face nothing is sent.
void write_ifacialmocap(const FaceState& state, IFacialMocapVersion version, std::vector<std::byte>& out);

/// VTube Studio's tracking data for programs on PCs
/// (https://github.com/DenchiSoft/VTubeStudioBlendshapeUDPReceiverTest), one datagram of JSON a frame:
/// Timestamp (ms since 1970), Hotkey (-1: none), FaceFound, Rotation, Position, EyeLeft, EyeRight (each x, y,
/// z), BlendShapes (each k, v). Position is in tenths of a metre, z away from the camera, as the app's
/// packets have it. Without a face FaceFound is false, all else 0 and there are no BlendShapes.
void write_vtube_studio(const FaceState& state, std::int64_t unix_ms, std::vector<std::byte>& out);

}  // namespace facet::avatar
