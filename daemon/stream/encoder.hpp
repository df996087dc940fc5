#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string_view>

#include "mesh/mesh_frame.hpp"
#include "stream/protocol.hpp"
#include "stream/ring.hpp"

namespace facet::stream {

/// Empty where every reader accepts the subject's messages; else which limit of protocol.hpp they would break
/// and what to do. Neither the subject nor a mesh of it may be sent or stored then.
std::string_view subject_fault(const mesh::Subject& subject);

/// Writes the messages of the protocol (facet.fbs) without the socket's header; a take stores the same bytes.
/// Each call returns a view into the encoder's own memory that the next call overwrites. One thread; after
/// the largest message has been written once, nothing is allocated.
///
/// Fixed point: positions and displacements are int16 times a step stated in the message. The step is the
/// smallest of kPositionStepMm / kDisplacementStepMm upwards with which the largest value fits, and at most
/// kMaxStepMm; the error is half a step, so never above 0.01 mm. A value that is not finite is written as 0,
/// one beyond the range (655 mm) at its end; neither comes out of a sound pipeline.
class Encoder {
 public:
  Encoder();
  ~Encoder();
  Encoder(const Encoder&) = delete;
  Encoder& operator=(const Encoder&) = delete;

  std::span<const std::uint8_t> hello(const Hello& hello);
  std::span<const std::uint8_t> subscription(const Subscription& subscription);
  std::span<const std::uint8_t> dropped(const Dropped& dropped);
  std::span<const std::uint8_t> goodbye(std::string_view reason);
  std::span<const std::uint8_t> ring(const RingOffer& offer);
  /// What the messages below say in place of Subject::id from here on; 0: the id itself, as takes have it.
  void number_subject(std::uint64_t number);
  std::span<const std::uint8_t> subject(const mesh::Subject& subject, Profile profile);
  std::span<const std::uint8_t> albedo(std::uint64_t subject_id, const mesh::Albedo& albedo);
  /// A frame without a subject, or with one that has a subject_fault, carries no geometry in any profile; the
  /// latter is degraded and says why. Profile Vertices rebuilds the finest mesh
  /// here (mesh::rebuild_finest): do it in the server's thread.
  ///
  /// MeshFrame::images go with it, their pixels only where wanted, grey ones in one channel. Pictures
  /// that would make the message too long come without pixels; the frame is degraded and says so.
  std::span<const std::uint8_t> frame(const mesh::MeshFrame& frame, Profile profile,
                                      const WantedPixels& wanted = {});
  /// The same frame in the two parts that a ring holds; never with pixels.
  RingFrame ring_frame(const mesh::MeshFrame& frame, Profile profile);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::stream
