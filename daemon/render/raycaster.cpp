#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "facet/error.hpp"
#include "render/closest.hpp"
#include "render/embree.hpp"
#include "render/embree_api.hpp"
#include "render/embree_device.hpp"
#include "render/renderer.hpp"

namespace facet::render {

void require_embree() {
  embree();
}

std::shared_ptr<RTCDeviceTy> shared_device() {
  static const std::shared_ptr<RTCDeviceTy> device = [] {
    // Two build threads: the appliance's picture making must leave the other cores to the pipeline.
    RTCDevice made = embree().rtcNewDevice("threads=2");
    if (made == nullptr) {
      throw Error(ErrorKind::Internal, fmt::format("the ray caster (Embree) cannot start, error {}",
                                                   static_cast<int>(embree().rtcGetDeviceError(nullptr))));
    }
    return std::shared_ptr<RTCDeviceTy>(made, embree().rtcReleaseDevice);
  }();
  return device;
}

bool usable(const Eigen::Vector3f& vector) {
  constexpr float kLargest = 1e18F;
  return vector.allFinite() && vector.cwiseAbs().maxCoeff() < kLargest;
}

namespace {

void pass_back_faces(const RTCFilterFunctionNArguments* arguments) {
  // Single rays only: N is 1, and the N-wide structures have the layout of RTCRay and RTCHit.
  const auto* ray = reinterpret_cast<const RTCRay*>(arguments->ray);
  const auto* hit = reinterpret_cast<const RTCHit*>(arguments->hit);
  if (arguments->valid[0] == -1 &&
      ray->dir_x * hit->Ng_x + ray->dir_y * hit->Ng_y + ray->dir_z * hit->Ng_z > 0) {
    arguments->valid[0] = 0;
  }
}

}  // namespace

Eigen::Vector2f closest_barycentric(const Eigen::Vector3f& a, const Eigen::Vector3f& b,
                                    const Eigen::Vector3f& c, const Eigen::Vector3f& p) {
  const Eigen::Vector3f ab = b - a;
  const Eigen::Vector3f ac = c - a;
  const Eigen::Vector3f ap = p - a;
  const float bb = ab.squaredNorm();
  const float bc = ab.dot(ac);
  const float cc = ac.squaredNorm();
  const float pb = ap.dot(ab);
  const float pc = ap.dot(ac);
  const float determinant = bb * cc - bc * bc;
  if (determinant > std::numeric_limits<float>::epsilon() * bb * cc) {
    const float u = (cc * pb - bc * pc) / determinant;
    const float v = (bb * pc - bc * pb) / determinant;
    if (u >= 0 && v >= 0 && u + v <= 1) {
      return {u, v};
    }
  }
  const auto along = [](float numerator, float denominator) {
    return denominator > 0 ? std::clamp(numerator / denominator, 0.0F, 1.0F) : 0.0F;
  };
  const Eigen::Vector3f edge_bc = c - b;
  const float on_ab = along(pb, bb);
  const float on_ac = along(pc, cc);
  const float on_bc = along((p - b).dot(edge_bc), edge_bc.squaredNorm());
  // The nearest point of the plane where it lies inside, else the nearest of three edges' nearest points.
  const float off_ab = (on_ab * ab - ap).squaredNorm();
  const float off_ac = (on_ac * ac - ap).squaredNorm();
  const float off_bc = (ab + on_bc * edge_bc - ap).squaredNorm();
  if (off_ab <= off_ac && off_ab <= off_bc) {
    return {on_ab, 0};
  }
  return off_ac <= off_bc ? Eigen::Vector2f{0, on_ac} : Eigen::Vector2f{1 - on_bc, on_bc};
}

struct Raycaster::Impl {
  std::shared_ptr<RTCDeviceTy> device;
  RTCScene scene = nullptr;
  /// Each with one column more than vertices: Embree reads 16 bytes per vertex.
  std::vector<mesh::Vertices> keys_mm;
  mesh::Triangles triangles;
  Eigen::Matrix4Xf
      balls_mm;  ///< [4][triangles] centre and radius of one round each triangle of the first key

  Impl() = default;
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  ~Impl() {
    if (scene != nullptr) {
      embree().rtcReleaseScene(scene);
    }
  }
};

Raycaster::Raycaster(const mesh::Vertices& vertices_mm, const mesh::Triangles& triangles, Build build)
    : Raycaster(std::vector<mesh::Vertices>{vertices_mm}, triangles, build) {}

Raycaster::Raycaster(const std::vector<mesh::Vertices>& keys_mm, const mesh::Triangles& triangles,
                     Build build)
    : impl_(std::make_unique<Impl>()) {
  const Eigen::Index vertex_count = keys_mm.empty() ? 0 : keys_mm.front().cols();
  for (const mesh::Vertices& key_mm : keys_mm) {
    if (!key_mm.allFinite()) {
      throw Error(ErrorKind::UnreadableInput, "a mesh to be rendered has a position that is not finite");
    }
    if (key_mm.cols() != vertex_count) {
      throw Error(ErrorKind::Internal, "a mesh in motion has another number of vertices later on");
    }
    impl_->keys_mm.emplace_back(mesh::Vertices::Zero(3, vertex_count + 1)).leftCols(vertex_count) = key_mm;
  }
  if (keys_mm.empty()) {
    throw Error(ErrorKind::Internal, "a mesh in motion is nowhere at any time");
  }
  if (triangles.size() > 0 &&
      (triangles.minCoeff() < 0 || triangles.maxCoeff() >= static_cast<std::int32_t>(vertex_count))) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("a mesh to be rendered names vertex {} of {}",
                    triangles.minCoeff() < 0 ? triangles.minCoeff() : triangles.maxCoeff(), vertex_count));
  }
  impl_->triangles = triangles;
  impl_->balls_mm.resize(4, triangles.cols());
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const Eigen::Matrix3f corners = impl_->keys_mm.front()(Eigen::all, triangles.col(t));
    const Eigen::Vector3f centre = corners.rowwise().mean();
    impl_->balls_mm.col(t) << centre, (corners.colwise() - centre).colwise().norm().maxCoeff();
  }
  impl_->device = shared_device();
  impl_->scene = embree().rtcNewScene(impl_->device.get());
  embree().rtcSetSceneFlags(impl_->scene, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_ROBUST |
                                                                     RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION));
  const RTCBuildQuality quality = build == Build::Quick ? RTC_BUILD_QUALITY_LOW : RTC_BUILD_QUALITY_MEDIUM;
  embree().rtcSetSceneBuildQuality(impl_->scene, quality);
  if (triangles.cols() > 0) {
    RTCGeometry geometry = embree().rtcNewGeometry(impl_->device.get(), RTC_GEOMETRY_TYPE_TRIANGLE);
    embree().rtcSetGeometryBuildQuality(geometry, quality);
    embree().rtcSetGeometryTimeStepCount(geometry, static_cast<unsigned>(impl_->keys_mm.size()));
    for (std::size_t key = 0; key < impl_->keys_mm.size(); ++key) {
      embree().rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, static_cast<unsigned>(key),
                                          RTC_FORMAT_FLOAT3, impl_->keys_mm[key].data(), 0, 3 * sizeof(float),
                                          static_cast<std::size_t>(vertex_count));
    }
    embree().rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                        impl_->triangles.data(), 0, 3 * sizeof(std::int32_t),
                                        static_cast<std::size_t>(triangles.cols()));
    embree().rtcCommitGeometry(geometry);
    embree().rtcAttachGeometry(impl_->scene, geometry);
    embree().rtcReleaseGeometry(geometry);
  }
  embree().rtcCommitScene(impl_->scene);
  const RTCError error = embree().rtcGetDeviceError(impl_->device.get());
  if (error != RTC_ERROR_NONE) {
    throw Error(ErrorKind::Internal,
                fmt::format("the ray caster (Embree) refused a mesh of {} triangles, error {}",
                            triangles.cols(), static_cast<int>(error)));
  }
}

Raycaster::~Raycaster() = default;
Raycaster::Raycaster(Raycaster&& other) noexcept = default;
Raycaster& Raycaster::operator=(Raycaster&& other) noexcept = default;

HitImage Raycaster::cast(const CameraIntrinsics& camera, Eigen::Vector2f offset_px) const {
  HitImage image;
  image.width_px = camera.width_px;
  image.height_px = camera.height_px;
  const auto pixel_count =
      static_cast<std::size_t>(camera.width_px) * static_cast<std::size_t>(camera.height_px);
  image.triangle.assign(pixel_count, -1);
  image.barycentric.assign(pixel_count, Eigen::Vector2f::Zero());
  image.depth_mm.assign(pixel_count, 0.0F);
  const Eigen::Vector3f corner((offset_px.x() - camera.cx) / camera.fx,
                               (offset_px.y() - camera.cy) / camera.fy, 1);
  if (!usable(corner)) {
    return image;
  }
  for_each_row(camera.height_px, [&](int y) {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    const float dy = (static_cast<float>(y) + offset_px.y() - camera.cy) / camera.fy;
    std::size_t pixel = static_cast<std::size_t>(y) * static_cast<std::size_t>(camera.width_px);
    for (int x = 0; x < camera.width_px; ++x, ++pixel) {
      // The direction's z is 1, so that the ray's length parameter is the depth.
      RTCRayHit query{};
      query.ray.dir_x = (static_cast<float>(x) + offset_px.x() - camera.cx) / camera.fx;
      query.ray.dir_y = dy;
      query.ray.dir_z = 1;
      query.ray.tfar = std::numeric_limits<float>::infinity();
      query.ray.mask = ~0U;
      query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
      embree().rtcIntersect1(impl_->scene, &context, &query);
      if (query.hit.geomID != RTC_INVALID_GEOMETRY_ID) {
        image.triangle[pixel] = static_cast<std::int32_t>(query.hit.primID);
        image.barycentric[pixel] = {query.hit.u, query.hit.v};
        image.depth_mm[pixel] = query.ray.tfar;
      }
    }
  });
  return image;
}

Raycaster::Closest Raycaster::closest_point(const Eigen::Vector3f& query_mm, float max_distance_mm) const {
  struct Search {
    const Impl* impl;
    Eigen::Vector3f query_mm;
    Closest best;
  } search{impl_.get(), query_mm, {}};
  search.best.distance_mm = max_distance_mm;
  constexpr float kRoundedUp = 1.0001F;  // what a ball's rounding may take from a triangle
  if (!usable(query_mm) || !(max_distance_mm >= 0)) {
    return {};
  }

  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  RTCPointQuery query{};
  query.x = query_mm.x();
  query.y = query_mm.y();
  query.z = query_mm.z();
  query.radius = max_distance_mm;
  embree().rtcPointQuery(
      impl_->scene, &query, &context,
      [](RTCPointQueryFunctionArguments* arguments) {
        auto& found = *static_cast<Search*>(arguments->userPtr);
        const Eigen::Vector4f ball = found.impl->balls_mm.col(arguments->primID);
        const float reach_mm = found.best.distance_mm + ball.w();
        if ((ball.head<3>() - found.query_mm).squaredNorm() > kRoundedUp * reach_mm * reach_mm) {
          return false;
        }
        const auto corners = found.impl->triangles.col(arguments->primID);
        const Eigen::Vector3f a = found.impl->keys_mm.front().col(corners[0]);
        const Eigen::Vector3f b = found.impl->keys_mm.front().col(corners[1]);
        const Eigen::Vector3f c = found.impl->keys_mm.front().col(corners[2]);
        const Eigen::Vector2f at = closest_barycentric(a, b, c, found.query_mm);
        const Eigen::Vector3f point = a + at.x() * (b - a) + at.y() * (c - a);
        const float distance = (point - found.query_mm).norm();
        if (distance < found.best.distance_mm ||
            (found.best.triangle < 0 && distance <= found.best.distance_mm)) {
          found.best = {static_cast<std::int32_t>(arguments->primID), at, point, distance};
          arguments->query->radius = distance;
          return true;
        }
        return false;
      },
      &search);
  if (search.best.triangle < 0) {
    search.best.distance_mm = 0;
  }
  return search.best;
}

Raycaster::Hit Raycaster::first_hit(const Eigen::Vector3f& origin_mm, const Eigen::Vector3f& direction,
                                    float min_distance_mm, bool cull_back, float time) const {
  if (!usable(origin_mm) || !usable(direction) || direction.isZero() || !std::isfinite(min_distance_mm) ||
      std::isnan(time)) {
    return {};
  }
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.filter = cull_back ? pass_back_faces : nullptr;
  RTCRayHit query{};
  query.ray.org_x = origin_mm.x();
  query.ray.org_y = origin_mm.y();
  query.ray.org_z = origin_mm.z();
  query.ray.dir_x = direction.x();
  query.ray.dir_y = direction.y();
  query.ray.dir_z = direction.z();
  query.ray.tnear = min_distance_mm;
  query.ray.time = std::clamp(time, 0.0F, 1.0F);
  query.ray.tfar = std::numeric_limits<float>::infinity();
  query.ray.mask = ~0U;
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  embree().rtcIntersect1(impl_->scene, &context, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
    return {};
  }
  return {static_cast<std::int32_t>(query.hit.primID), {query.hit.u, query.hit.v}, query.ray.tfar};
}

bool Raycaster::occluded(const Eigen::Vector3f& from_mm, const Eigen::Vector3f& to_mm,
                         float margin_mm) const {
  const Eigen::Vector3f between = to_mm - from_mm;
  const float distance_mm = between.norm();
  if (!usable(from_mm) || !usable(to_mm) || !(distance_mm > 2 * margin_mm)) {
    return false;
  }
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRay ray{};
  ray.org_x = from_mm.x();
  ray.org_y = from_mm.y();
  ray.org_z = from_mm.z();
  ray.dir_x = between.x() / distance_mm;
  ray.dir_y = between.y() / distance_mm;
  ray.dir_z = between.z() / distance_mm;
  ray.tnear = margin_mm;
  ray.tfar = distance_mm - margin_mm;
  ray.mask = ~0U;
  embree().rtcOccluded1(impl_->scene, &context, &ray);
  return ray.tfar < 0;  // Embree's sign of a hit: minus infinity
}

}  // namespace facet::render
