// Arbitrary bytes to the C library's reading of messages, beside the C++ library's: what the latter takes,
// the former takes too and reads the same numbers.

#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <span>
#include <vector>

#include "facet/error.hpp"
#include "stream/decoder.hpp"
#include "stream/encoder.hpp"
#include "support/mesh_frames.hpp"

extern "C" {
#include "rebuild.h"
#include "wire.h"
}

namespace {

using namespace facet;

/// A finding where it does not hold.
void must(bool holds) {
  if (!holds) {
    std::abort();
  }
}

template <typename Decode>
auto accepted(Decode&& decode) -> std::optional<decltype(decode())> {
  try {
    return decode();
  } catch (const Error&) {
    return std::nullopt;
  }
}

/// Reads every number, so that one that is not there is found.
template <typename T>
std::uint64_t sum(const T* values, std::size_t count) {
  std::uint64_t out = 0;
  for (std::size_t k = 0; values != nullptr && k < count; ++k) {
    std::uint32_t bits = 0;
    std::memcpy(&bits, values + k, sizeof(T));
    out += bits;
  }
  return out;
}

/// The corpus' frames are of this subject, in its three profiles.
struct Known {
  Known() {
    stream::Encoder encoder;
    const auto subject = test::patch_subject(5, 3, 1);
    for (int profile = 0; profile < stream::kProfileCount; ++profile) {
      const auto message = encoder.subject(*subject, static_cast<stream::Profile>(profile));
      auto& kept = messages.emplace_back(message.size() / 8 + 1);
      std::memcpy(kept.data(), message.data(), message.size());
      decoded.push_back(stream::decode_subject(message));
      must(wire_subject(reinterpret_cast<const std::uint8_t*>(kept.data()), message.size(),
                        &parsed.emplace_back()) == nullptr);
    }
    for (std::size_t k = 0; k < parsed.size(); ++k) {  // they moved as the vector grew
      parsed[k].shown.expression_names = parsed[k].names;
    }
  }
  std::vector<std::vector<std::uint64_t>> messages;
  std::vector<std::shared_ptr<const mesh::Subject>> decoded;
  std::vector<struct wire_subject> parsed;
};

void check_frame(std::span<const std::uint8_t> message) {
  static const Known known;
  static mesh_memory memory{};
  for (std::size_t k = 0; k < known.parsed.size(); ++k) {
    facet_frame frame;
    const bool sound =
        wire_frame(message.data(), message.size(), &known.parsed[k], nullptr, &frame) == nullptr;
    facet_mesh mesh{};
    const bool built = sound && rebuild_mesh(&frame, &known.parsed[k], &memory, &mesh) == FACET_OK;
    [[maybe_unused]] std::uint64_t read = 0;
    if (sound) {
      read += sum(frame.landmarks_px, 2 * frame.landmark_count) +
              sum(frame.expression, frame.expression_count) +
              sum(frame.avatar_values, frame.expression_count) +
              sum(frame.expression_confidence,
                  frame.expression_confidence != nullptr ? frame.expression_count : 0) +
              sum(frame.confidence, frame.confidence != nullptr ? known.parsed[k].shown.vertex_count : 0) +
              std::strlen(frame.degraded_reason);
    }
    const auto decoded = accepted([&] {
      stream::DecodedFrame out;
      stream::decode_frame(message, known.decoded[k], nullptr, out);
      return out;
    });
    if (!decoded) {
      continue;
    }
    must(sound);
    must(frame.sequence == decoded->frame.sequence && frame.subject_id == (decoded->frame.subject ? 5U : 0U));
    must(frame.landmark_count == decoded->frame.landmarks_px.size());
    const auto& control = decoded->frame.control_vertices_mm;
    must(built == (control.cols() > 0 || decoded->vertices_mm.cols() > 0));
    if (decoded->vertices_mm.cols() > 0) {
      must(std::memcmp(mesh.vertices_mm, decoded->vertices_mm.data(),
                       static_cast<std::size_t>(decoded->vertices_mm.size()) * sizeof(float)) == 0);
    }
  }
}

void check(std::span<const std::uint8_t> message) {
  static struct wire_subject subject;
  facet_albedo albedo;
  std::uint32_t number = 0;
  std::uint64_t total = 0;
  const char* reason = nullptr;
  const std::uint8_t* bytes = message.data();
  const std::size_t size = message.size();
  switch (wire_kind(bytes, size)) {
    case WIRE_HELLO:
      if (const auto decoded = accepted([&] { return stream::decode_hello(message); })) {
        must(wire_hello(bytes, size, &number) == nullptr && number == decoded->protocol_version);
      }
      break;
    case WIRE_DROPPED:
      if (const auto decoded = accepted([&] { return stream::decode_dropped(message); })) {
        must(wire_dropped(bytes, size, &total) == nullptr && total == decoded->total);
      }
      break;
    case WIRE_GOODBYE: {
      const bool sound = wire_goodbye(bytes, size, &reason) == nullptr;
      must(std::strlen(reason) <= 1024);
      must(sound || !accepted([&] { return stream::decode_goodbye(message); }));
      break;
    }
    case WIRE_RING:
      if (const auto decoded = accepted([&] { return stream::decode_ring(message); })) {
        must(wire_ring(bytes, size, &number) == nullptr && number == decoded->version);
      }
      break;
    case WIRE_SUBJECT: {
      const bool sound = wire_subject(bytes, size, &subject) == nullptr;
      if (sound) {
        sum(subject.shown.triangles, std::size_t{3} * subject.shown.triangle_count);
        for (std::uint32_t k = 0; k < subject.shown.level_count; ++k) {
          sum(subject.shown.levels[k].triangles, std::size_t{3} * subject.shown.levels[k].triangle_count);
        }
        sum(subject.shown.texture_coordinates, std::size_t{2} * subject.shown.vertex_count);
        for (std::size_t k = 0; k < subject.shown.expression_count; ++k) {
          must(std::strlen(subject.names[k]) <= 64);
        }
        must(subject.shown.person == nullptr || std::strlen(subject.shown.person) <= 64);
        sum(subject.shown.neutral_mm,
            subject.shown.neutral_mm != nullptr ? std::size_t{3} * subject.shown.control_vertex_count : 0);
      }
      if (const auto decoded = accepted([&] { return stream::decode_subject(message); })) {
        must(sound && subject.shown.id == (*decoded)->id);
        must(subject.shown.expression_count == (*decoded)->expression_names.size());
      }
      break;
    }
    case WIRE_ALBEDO: {
      const bool sound = wire_albedo(bytes, size, &albedo) == nullptr;
      if (sound) {
        sum(albedo.linear_rgb, 3 * albedo.vertex_count);
      }
      if (const auto decoded = accepted([&] { return stream::decode_albedo(message); })) {
        must(sound && albedo.version == decoded->albedo->version);
        must(3 * albedo.vertex_count == decoded->albedo->linear_rgb.size());
      }
      break;
    }
    case WIRE_FRAME:
      check_frame(message);
      break;
    default:
      break;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  // Of exactly this size, so that the address sanitizer sees what is read beyond it; malloc aligns it.
  std::vector<std::uint8_t> message(data, data + size);
  check(message);
  return 0;
}
