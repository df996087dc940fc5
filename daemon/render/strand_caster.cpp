#include "render/strand_caster.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "facet/error.hpp"
#include "render/embree_api.hpp"
#include "render/embree_device.hpp"

namespace facet::render {

struct StrandCaster::Impl {
  std::shared_ptr<RTCDeviceTy> device;
  RTCScene scene = nullptr;
  Strands strands;
  std::vector<Eigen::Matrix4Xf> later;

  Impl() = default;
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  ~Impl() {
    if (scene != nullptr) {
      embree().rtcReleaseScene(scene);
    }
  }
};

StrandCaster::StrandCaster(Strands strands, std::vector<Eigen::Matrix4Xf> later)
    : impl_(std::make_unique<Impl>()) {
  bool finite = strands.points.allFinite();
  for (const Eigen::Matrix4Xf& points : later) {
    finite = finite && points.allFinite();
    if (points.cols() != strands.points.cols()) {
      throw Error(ErrorKind::Internal, "strands in motion have another number of points later on");
    }
  }
  if (!finite) {
    throw Error(ErrorKind::UnreadableInput, "strands to be rendered have a point that is not finite");
  }
  for (const std::uint32_t first : strands.segments) {
    if (static_cast<Eigen::Index>(first) + 1 >= strands.points.cols()) {
      throw Error(ErrorKind::UnreadableInput, fmt::format("a strand to be rendered names point {} of {}",
                                                          first + 1, strands.points.cols()));
    }
  }
  impl_->strands = std::move(strands);
  impl_->later = std::move(later);
  if (impl_->strands.segments.empty()) {
    return;
  }
  impl_->device = shared_device();
  impl_->scene = embree().rtcNewScene(impl_->device.get());
  RTCGeometry geometry = embree().rtcNewGeometry(impl_->device.get(), RTC_GEOMETRY_TYPE_FLAT_LINEAR_CURVE);
  embree().rtcSetGeometryTimeStepCount(geometry, static_cast<unsigned>(1 + impl_->later.size()));
  for (std::size_t key = 0; key <= impl_->later.size(); ++key) {
    const Eigen::Matrix4Xf& points = key == 0 ? impl_->strands.points : impl_->later[key - 1];
    embree().rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, static_cast<unsigned>(key),
                                        RTC_FORMAT_FLOAT4, points.data(), 0, 4 * sizeof(float),
                                        static_cast<std::size_t>(points.cols()));
  }
  embree().rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT,
                                      impl_->strands.segments.data(), 0, sizeof(std::uint32_t),
                                      impl_->strands.segments.size());
  embree().rtcCommitGeometry(geometry);
  embree().rtcAttachGeometry(impl_->scene, geometry);
  embree().rtcReleaseGeometry(geometry);
  embree().rtcCommitScene(impl_->scene);
  const RTCError error = embree().rtcGetDeviceError(impl_->device.get());
  if (error != RTC_ERROR_NONE) {
    throw Error(ErrorKind::Internal,
                fmt::format("the ray caster (Embree) refused {} segments of strands, error {}",
                            impl_->strands.segments.size(), static_cast<int>(error)));
  }
}

StrandCaster::~StrandCaster() = default;
StrandCaster::StrandCaster(StrandCaster&& other) noexcept = default;
StrandCaster& StrandCaster::operator=(StrandCaster&& other) noexcept = default;

const Strands& StrandCaster::strands() const {
  return impl_->strands;
}
const std::vector<Eigen::Matrix4Xf>& StrandCaster::later() const {
  return impl_->later;
}

StrandCaster::Hit StrandCaster::first_hit(const Eigen::Vector3f& origin_mm, const Eigen::Vector3f& direction,
                                          float max_depth, float time) const {
  if (impl_->scene == nullptr || !usable(origin_mm) || !usable(direction) || direction.isZero() ||
      !(max_depth > 0) || std::isnan(time)) {
    return {};
  }
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRayHit query{};
  query.ray.org_x = origin_mm.x();
  query.ray.org_y = origin_mm.y();
  query.ray.org_z = origin_mm.z();
  query.ray.dir_x = direction.x();
  query.ray.dir_y = direction.y();
  query.ray.dir_z = direction.z();
  query.ray.time = std::clamp(time, 0.0F, 1.0F);
  query.ray.tfar = max_depth;
  query.ray.mask = ~0U;
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  embree().rtcIntersect1(impl_->scene, &context, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
    return {};
  }
  return {static_cast<std::int32_t>(query.hit.primID), query.hit.u, query.ray.tfar};
}

bool StrandCaster::occluded(const Eigen::Vector3f& from_mm, const Eigen::Vector3f& to_mm) const {
  const Eigen::Vector3f between = to_mm - from_mm;
  if (impl_->scene == nullptr || !usable(from_mm) || !usable(to_mm) || between.isZero()) {
    return false;
  }
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRay ray{};
  ray.org_x = from_mm.x();
  ray.org_y = from_mm.y();
  ray.org_z = from_mm.z();
  ray.dir_x = between.x();
  ray.dir_y = between.y();
  ray.dir_z = between.z();
  ray.tfar = 1;
  ray.mask = ~0U;
  embree().rtcOccluded1(impl_->scene, &context, &ray);
  return ray.tfar < 0;  // Embree's sign of a hit: minus infinity
}

}  // namespace facet::render
