#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "camera/device_fault.hpp"
#include "facet/camera.hpp"

namespace facet::camera {

// What a camera host (a process with one camera in it) and its parent say to one another, over a socket that
// keeps messages whole (SOCK_SEQPACKET). The parent asks for one frame at a time (an empty message would be
// the socket's end, so it is kFrameRequest); the host tells HostMessages. Both are of one build; the version
// only keeps a host of another installation out. Pixels go through memory that both see, see picture_layout.

/// Descriptors of a host when it begins.
inline constexpr int kHostSocket = 3;
inline constexpr int kHostMemory = 4;

inline constexpr std::uint8_t kFrameRequest = 'f';
inline constexpr std::size_t kMaxHostMessage_bytes = 4096;
/// Between two signs of life, at least.
inline constexpr std::chrono::milliseconds kAlivePeriod{250};

struct HostMessage {
  enum class Kind : std::uint32_t {
    Listed = 1,  ///< a camera that there is: name is its id, text what it is and offers
    Opened,      ///< the camera is there and can do what is asked; name is the device, for people
    Frame,       ///< the answer to a request: a picture is in the memory
    Alive,       ///< said now and then while there is no frame, and at the end of a list
    Fault,       ///< the last message: fault and text say why
  };
  Kind kind = Kind::Alive;
  std::uint64_t sequence = 0;                            ///< Frame: as Frame::sequence
  std::int64_t timestamp_ns = 0;                         ///< Frame: as Frame::timestamp_ns
  bool corrupt = false;                                  ///< Frame: as Frame::corrupt
  CameraCounters counters;                               ///< Frame, Alive: since the host began
  DeviceFault::Kind fault = DeviceFault::Kind::Failing;  ///< Fault
  std::string name;
  std::string text;
};

/// What a host is at: it decides what it may say.
enum class HostPhase { Opening, Delivering, Listing };

/// Whether a host may say that now. (A frame must besides have been asked for.)
constexpr bool may_say(HostPhase phase, HostMessage::Kind kind) {
  using Kind = HostMessage::Kind;
  switch (phase) {
    case HostPhase::Opening:
      return kind == Kind::Opened || kind == Kind::Fault;
    case HostPhase::Delivering:
      return kind == Kind::Frame || kind == Kind::Alive || kind == Kind::Fault;
    case HostPhase::Listing:
      return kind == Kind::Listed || kind == Kind::Alive || kind == Kind::Fault;
  }
  return false;
}

/// For people: "a frame", "that its camera is open".
const char* to_string(HostMessage::Kind kind);

/// The bytes of a message, kMaxHostMessage_bytes at most: longer texts are cut.
///
/// buffer   [kMaxHostMessage_bytes]
/// returns  how many bytes of it were written
std::size_t write_host_message(const HostMessage& message, std::span<std::uint8_t> buffer);

/// Reads a message from a host that may be broken. Nothing where the bytes are none; `wrong` then says why.
/// Texts are printable (facet/printable.hpp).
std::optional<HostMessage> read_host_message(std::span<const std::uint8_t> bytes, std::string& wrong);

/// The memory of one picture: a mark, rows of R G B A, the mark again. The host sets both marks to the
/// frame's sequence + 1 after and before it writes the pixels, so that a picture that was touched since can
/// be told.
struct PictureLayout {
  std::size_t stride_bytes = 0;
  std::size_t pixels_at = 0;
  std::size_t end_mark_at = 0;
  std::size_t total_bytes = 0;
};
PictureLayout picture_layout(int width_px, int height_px);

}  // namespace facet::camera
