#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "mesh/mesh_frame.hpp"
#include "stream/protocol.hpp"
#include "stream/ring.hpp"

namespace facet::stream {

enum class MessageType : std::uint8_t {
  Hello,
  Subscribe,
  Dropped,
  Goodbye,
  Subject,
  Albedo,
  Frame,
  Ring,
  Unknown,  ///< sound, but of a kind that came with a later version: a client skips it
};

const char* to_string(MessageType type);

/// What a frame refers to: read it first, fetch these, then decode the frame with them.
struct FrameReferences {
  std::uint64_t subject_id = 0;      ///< 0: none
  std::uint64_t albedo_version = 0;  ///< 0: none
};

struct DecodedAlbedo {
  std::uint64_t subject_id = 0;
  std::shared_ptr<const mesh::Albedo> albedo;
};

/// A frame as it was published, up to the fixed point's half step. With profile Signals the geometry is
/// empty; with Vertices control vertices and displacements are empty and the two arrays below are filled.
struct DecodedFrame {
  mesh::MeshFrame frame;
  mesh::Vertices vertices_mm;  ///< [3][finest vertex_count] head frame
  Eigen::Matrix3Xf normals;    ///< [3][finest vertex_count] head frame, unit length
};

/// The functions below parse bytes from outside: `message` is one whole FlatBuffer without the socket's
/// header, its memory aligned to 8 bytes. They verify structure, sizes, index ranges and that every number is
/// finite, and throw Error(UnreadableInput) with the field that is wrong; nothing is half decoded. Any
/// thread; they allocate.
MessageType message_type(std::span<const std::uint8_t> message);
Hello decode_hello(std::span<const std::uint8_t> message);
Subscription decode_subscription(std::span<const std::uint8_t> message);
Dropped decode_dropped(std::span<const std::uint8_t> message);
std::string decode_goodbye(std::span<const std::uint8_t> message);
RingOffer decode_ring(std::span<const std::uint8_t> message);

/// Profile Displacements gives the Subject as it was published. Profile Vertices: its hierarchy has one
/// level, the finest, without stencils, and control_vertex_count 0. Profile Signals: hierarchy is null.
std::shared_ptr<const mesh::Subject> decode_subject(std::span<const std::uint8_t> message);
DecodedAlbedo decode_albedo(std::span<const std::uint8_t> message);

FrameReferences frame_references(std::span<const std::uint8_t> message);
/// subject and albedo must be those of frame_references (null where 0; albedo may be null if not wanted).
void decode_frame(std::span<const std::uint8_t> message, std::shared_ptr<const mesh::Subject> subject,
                  std::shared_ptr<const mesh::Albedo> albedo, DecodedFrame& out);
/// The newest frame of a ring: its head message as above, its arrays from where they lie. What comes out
/// counts only where ring.intact() holds afterwards.
void decode_frame(const RingReader& ring, std::shared_ptr<const mesh::Subject> subject,
                  std::shared_ptr<const mesh::Albedo> albedo, DecodedFrame& out);

}  // namespace facet::stream
