#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "facet/frame.hpp"

namespace facet::render {

/// Thin strands, as of hair: chains of straight segments that show every ray their full width.
struct Strands {
  Eigen::Matrix4Xf points;              ///< [4][point_count] x, y, z, radius; mm
  std::vector<std::uint32_t> segments;  ///< [segment_count] each one's first point; its second is the next
};

/// Ray queries against strands (Embree's flat curves), beside a Raycaster for the surfaces. Any thread once
/// built. A query with numbers that are not finite finds nothing.
class StrandCaster {
 public:
  /// strands   none at all will do
  /// later     of strands in motion: their points ([4][point_count] each) at evenly spaced times after 0, the
  ///           last at 1, straight lines between. Only `first_hit` knows other times than 0
  /// Throws Error(UnreadableInput) where a segment names a point that is not there or a point is not finite,
  /// Error(Internal) where Embree cannot start or there are more or fewer points later on.
  explicit StrandCaster(Strands strands, std::vector<Eigen::Matrix4Xf> later = {});
  ~StrandCaster();
  StrandCaster(StrandCaster&& other) noexcept;
  StrandCaster& operator=(StrandCaster&& other) noexcept;

  const Strands& strands() const;
  const std::vector<Eigen::Matrix4Xf>& later() const;

  struct Hit {
    std::int32_t segment = -1;
    float along = 0;  ///< 0 at the segment's first point, 1 at its second
    float depth = 0;  ///< in lengths of the direction
  };
  /// First hit nearer than max_depth, in lengths of the direction; segment -1 where there is none. time: of
  /// strands in motion, clamped to 0 to 1.
  Hit first_hit(const Eigen::Vector3f& origin_mm, const Eigen::Vector3f& direction, float max_depth,
                float time = 0) const;

  /// Whether a strand lies between the two points.
  bool occluded(const Eigen::Vector3f& from_mm, const Eigen::Vector3f& to_mm) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::render
