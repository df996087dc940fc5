#pragma once

#include <cstddef>
#include <cstdint>

/// What a take file is: docs/take-format.md.
namespace facet::take {

/// SQLite application_id of a take: "FCTK".
inline constexpr std::int32_t kApplicationId = 0x4643544B;
/// SQLite user_version: version of tables and blobs. History in docs/take-format.md.
inline constexpr std::int32_t kFormatVersion = 1;

/// Biggest uncompressed blob that a reader accepts (stream::kMaxMessageBytes).
inline constexpr std::size_t kMaxBlobBytes = 64U << 20;

}  // namespace facet::take
