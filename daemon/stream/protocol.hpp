#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

/// The stream protocol's constants and small messages; docs/stream-protocol.md is its page, facet.fbs its
/// schema.
namespace facet::stream {

/// Version of the message layouts. Appended fields don't raise it; anything an older reader would misread
/// does.
inline constexpr std::uint32_t kProtocolVersion = 1;

/// Where facetd listens unless its configuration says otherwise.
inline constexpr const char* kDefaultSocket = "/run/facet/stream.sock";

/// On the socket every message has this header before its FlatBuffer: the magic, then the length of what
/// follows, both little-endian uint32. The magic lets a peer notice at once that it talks to something else.
inline constexpr std::uint32_t kMessageMagic = 0x4D544346;  // "FCTM" in memory
inline constexpr std::size_t kHeaderBytes = 8;

/// Limits of what is parsed; a message beyond them is refused whole. They bound the memory that a hostile
/// peer or file can make a reader allocate.
inline constexpr std::size_t kMaxMessageBytes = 64U << 20;  ///< topology of 500,000 vertices: 47 MB
inline constexpr std::size_t kMaxRequestBytes = 4096;       ///< from a client to the server
inline constexpr std::uint32_t kMaxVertices = 500'000;
inline constexpr std::uint32_t kMaxTriangles = 2 * kMaxVertices + 2;
inline constexpr std::uint32_t kMaxLevels = 12;
inline constexpr std::uint32_t kMaxStencilEntriesPerRow = 64;  ///< on average over a level
inline constexpr std::uint32_t kMaxCoefficients = 1024;        ///< identity or expression
inline constexpr std::uint32_t kMaxLandmarks = 4096;
inline constexpr std::uint32_t kMaxImagePx = 16384;  ///< width and height
inline constexpr std::size_t kMaxNameBytes = 64;
inline constexpr std::size_t kMaxLightBytes = 512;  ///< of what lit a slot
inline constexpr std::size_t kMaxTextBytes = 1024;  ///< degraded_reason, goodbye reason, server

/// Frames of a ring: what a reader reads in place stays for this many frames but one.
inline constexpr std::uint32_t kRingSlots = 8;
/// Rings offered to one connection: descriptors that a reader lets lie in its socket are bounded.
inline constexpr int kMaxRingOffers = 32;

/// Coarsest errors of the fixed-point fields for values within their stated range (see Encoder).
inline constexpr float kDisplacementStepMm = 0.0005F;  ///< as long as |d| <= 16 mm
inline constexpr float kPositionStepMm = 0.002F;       ///< as long as |x| <= 65 mm; grows with the extent
inline constexpr float kMaxStepMm = 0.02F;             ///< error 0.01 mm, reached at |x| = 655 mm

/// How much of a frame a reader gets.
enum class Profile : std::uint8_t {
  Signals = 0,        ///< state, camera, pose, expression, lighting, times; no geometry
  Displacements = 1,  ///< and control vertices, displacements, confidence; topology with stencils. Compact.
  Vertices = 2,       ///< and finest vertices, normals, confidence; finest triangles. Nothing to rebuild.
};
inline constexpr int kProfileCount = 3;

const char* to_string(Profile profile);

struct Hello {
  std::uint32_t protocol_version = kProtocolVersion;
  std::string server;
  std::vector<Profile> profiles{Profile::Signals, Profile::Displacements, Profile::Vertices};
  std::uint32_t max_message_bytes = static_cast<std::uint32_t>(kMaxMessageBytes);
};

struct Subscription {
  std::uint32_t protocol_version = kProtocolVersion;
  Profile profile = Profile::Displacements;
  bool want_albedo = true;
  std::string client;  ///< for people, kMaxNameBytes at most
  bool want_images = false;
  /// Newest layout of a shared-memory ring that the client reads (ring_layout.h); 0: frames over the socket.
  std::uint32_t ring_version = 0;
  /// Longest side of the pictures that are wanted: larger ones come smaller, by a whole number; 0: as they
  /// are.
  std::uint16_t longest_image_px = 0;
};

/// Which of a frame's pictures come with their pixels.
struct WantedPixels {
  bool any = false;
  int longest_px = 0;  ///< Subscription::longest_image_px
};

/// A ring of frames for a reader that asked for one; its descriptors come beside the message.
struct RingOffer {
  std::uint32_t version = 0;
  std::uint64_t bytes = 0;
};

struct Dropped {
  std::uint64_t since_last = 0;  ///< frames, since the last one that this reader got
  std::uint64_t total = 0;       ///< frames, since it connected
};

}  // namespace facet::stream
