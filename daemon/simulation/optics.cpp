#include "simulation/optics.hpp"

#include <algorithm>
#include <cstddef>

#include "simulation/random.hpp"

namespace facet::simulation {

using Eigen::Vector2f;
using Eigen::Vector3f;

Optics pinhole_optics(const CameraIntrinsics& camera) {
  return {
      camera.width_px, camera.height_px,
      [camera](int x, int y, const std::vector<Vector2f>& offsets_px, std::vector<PictureRay>& rays) {
        for (std::size_t k = 0; k < offsets_px.size(); ++k) {
          rays[k].direction = Vector3f((static_cast<float>(x) + offsets_px[k].x() - camera.cx) / camera.fx,
                                       (static_cast<float>(y) + offsets_px[k].y() - camera.cy) / camera.fy, 1)
                                  .normalized();
        }
      },
      [camera](const Vector3f& point_mm) -> std::optional<Vector2f> {
        const float z = std::max(point_mm.z(), 1.0F);
        return Vector2f(camera.fx * point_mm.x() / z + camera.cx, camera.fy * point_mm.y() / z + camera.cy);
      }};
}

Optics webcam_optics(const capture::Lens& lens, const LensRays& rays, const Webcam& webcam,
                     std::uint64_t noise_seed) {
  const double span_s = std::max(webcam.span_s(), 1e-9);
  return {
      lens.width_px, lens.height_px,
      [&lens, &rays, webcam, span_s, noise_seed](int x, int y, const std::vector<Vector2f>& offsets_px,
                                                 std::vector<PictureRay>& out) {
        const auto count = static_cast<int>(offsets_px.size());
        const auto share = 1 / static_cast<float>(count);
        Random dice(noise_seed, static_cast<std::uint64_t>(y) * static_cast<std::uint64_t>(lens.width_px) +
                                    static_cast<std::uint64_t>(x));
        const int turn = dice.below(count);  // pairs parts of the exposure with parts of the pixel
        for (int k = 0; k < count; ++k) {
          const Vector2f& offset_px = offsets_px[static_cast<std::size_t>(k)];
          const double row_part = (y + static_cast<double>(offset_px.y())) / (lens.height_px - 1) - 0.5;
          const double blur_part =
              ((k + turn) % count + static_cast<double>(dice.uniform())) * static_cast<double>(share) - 0.5;
          const double late_s = row_part * webcam.readout_s + blur_part * webcam.exposure_s;
          out[static_cast<std::size_t>(k)] = {rays.direction(x, y, offset_px).normalized(),
                                              static_cast<float>(0.5 + late_s / span_s)};
        }
      },
      [&lens](const Vector3f& point_mm) -> std::optional<Vector2f> {
        const auto px = lens.project(lens.camera_from_rig.inverse() * point_mm.cast<double>());
        return px ? std::optional<Vector2f>(px->cast<float>()) : std::nullopt;
      }};
}

}  // namespace facet::simulation
