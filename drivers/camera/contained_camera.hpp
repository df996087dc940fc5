#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "camera/host_service.hpp"

namespace facet::camera {

/// How long a camera's process may take for what.
struct HostPatience {
  std::chrono::milliseconds open{10'000};         ///< from its start until the camera is open
  std::chrono::milliseconds first_frame{5'000};   ///< at least; then it is LiveConfig::stall_after
  std::chrono::milliseconds shortest_pause{250};  ///< before it is started anew; doubled each time
  std::chrono::milliseconds longest_pause{2'000};
  std::chrono::milliseconds absent_pause{1'000};  ///< between two looks for a device that is not there
  std::chrono::milliseconds proven{10'000};       ///< once it has streamed for so long, pauses begin anew
};

/// A live camera in a process of its own: a library that crashes, hangs, leaks or writes where it should not
/// ends that process, which is started anew with pauses that grow. CameraStatus::reason says how it ended.
///
/// A frame costs a copy on either side (1280x720 px: less than 0.2 ms each): what a reader holds must never
/// change, and memory that the other process can write into may. So there is one place for a picture, the
/// host fills it when it is asked for a frame, and no slot can be held by a slow reader.
///
/// Frame::timestamp_ns comes from the host; one that lies in the future or before the host's start is a
/// fault, as is a sequence number that does not grow.
///
/// config   what the host opens: kind, size, rate and stall_after count here too
/// program  the host; empty: host_program()
///
/// Opens it once, to check (HostPatience::open at most): throws Error(Usage) where the camera is there and
/// can't do what the configuration asks.
std::unique_ptr<Camera> open_contained_camera(const CameraConfig& config,
                                              const std::filesystem::path& program = {},
                                              const HostPatience& patience = {});

/// Cameras of libcamera, which run in facet-camera-host.
extern const CameraKind kLibcamera;

/// The cameras that a host program finds. Throws Error(Unavailable), saying why, where it can't tell within
/// `patience`.
std::vector<CameraListing> list_contained_cameras(
    const std::filesystem::path& program = {},
    std::chrono::milliseconds patience = std::chrono::milliseconds(10'000));

}  // namespace facet::camera
