#pragma once

// Private to this room: the functions of Embree that it uses, fetched from its library when the first picture
// is rendered.

#include <embree3/rtcore.h>
#include <fmt/format.h>

#include "facet/shared_library.hpp"

namespace facet::render {

#define FACET_EMBREE_FUNCTIONS(X) \
  X(rtcAttachGeometry)            \
  X(rtcCommitGeometry)            \
  X(rtcCommitScene)               \
  X(rtcGetDeviceError)            \
  X(rtcIntersect1)                \
  X(rtcNewDevice)                 \
  X(rtcNewGeometry)               \
  X(rtcNewScene)                  \
  X(rtcOccluded1)                 \
  X(rtcPointQuery)                \
  X(rtcReleaseDevice)             \
  X(rtcReleaseGeometry)           \
  X(rtcReleaseScene)              \
  X(rtcSetGeometryBuildQuality)   \
  X(rtcSetGeometryTimeStepCount)  \
  X(rtcSetSceneBuildQuality)      \
  X(rtcSetSceneFlags)             \
  X(rtcSetSharedGeometryBuffer)

struct EmbreeApi {
#define FACET_MEMBER(name) decltype(&::name) name = nullptr;
  FACET_EMBREE_FUNCTIONS(FACET_MEMBER)
#undef FACET_MEMBER

  EmbreeApi() {
    const SharedLibrary library(fmt::format("libembree{0}.so.{0}", RTC_VERSION_MAJOR),
                                fmt::format("libembree{0}-{0}", RTC_VERSION_MAJOR));
#define FACET_FIND(name) library.find(name, #name);
    FACET_EMBREE_FUNCTIONS(FACET_FIND)
#undef FACET_FIND
  }
};

/// Opened at the first call; throws Error(Unavailable) naming the library and its package, and tries again at
/// the next.
inline const EmbreeApi& embree() {
  static const EmbreeApi api;
  return api;
}

}  // namespace facet::render
