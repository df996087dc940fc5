// Makes one header a struct layout for GLSL and for the host alike. A room's header, for example
// shaders/refine/layout.h, includes this one and writes
//
//   FACET_LAYOUT_BEGIN(refine)
//   struct StepPush {
//     uint vertex_count;
//     float weight_smooth;
//   };
//   FACET_LAYOUT_SIZE(StepPush, 8)
//   FACET_LAYOUT_OFFSET(StepPush, weight_smooth, 4)
//   FACET_LAYOUT_END
//
// The host includes it as "shaders/refine/layout.h" and finds facet::shaders::refine::StepPush. The types
// below have the same size and alignment as in std430; vec3 and matrices with three rows are missing on
// purpose, since std430 packs a scalar into the fourth place and C++ does not.
#ifndef FACET_SHADERS_COMMON_LAYOUT_H
#define FACET_SHADERS_COMMON_LAYOUT_H

#ifdef __cplusplus

#include <cstddef>
#include <cstdint>

namespace facet::shaders {

using uint = std::uint32_t;
struct alignas(8) vec2 {
  float x, y;
};
struct alignas(16) vec4 {
  float x, y, z, w;
};
struct alignas(8) ivec2 {
  std::int32_t x, y;
};
struct alignas(16) ivec4 {
  std::int32_t x, y, z, w;
};
struct alignas(8) uvec2 {
  uint x, y;
};
struct alignas(16) uvec4 {
  uint x, y, z, w;
};
/// Column-major, as in GLSL.
struct mat4 {
  vec4 columns[4];
};

}  // namespace facet::shaders

#define FACET_LAYOUT_CONSTANT constexpr
#define FACET_LAYOUT_BEGIN(room) namespace facet::shaders::room {
#define FACET_LAYOUT_END }
#define FACET_LAYOUT_SIZE(type, size) static_assert(sizeof(type) == (size));
#define FACET_LAYOUT_OFFSET(type, member, offset) static_assert(offsetof(type, member) == (offset));

#else

#define FACET_LAYOUT_CONSTANT const
#define FACET_LAYOUT_BEGIN(room)
#define FACET_LAYOUT_END
#define FACET_LAYOUT_SIZE(type, size)
#define FACET_LAYOUT_OFFSET(type, member, offset)

#endif

#endif
