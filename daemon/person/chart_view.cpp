#include "person/chart_view.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "mesh/triangle_points.hpp"

namespace facet::person {
namespace {

/// Cosines of the angle to the camera between which skin begins to count.
constexpr float kGrazing = 0.25F;
constexpr float kFacing = 0.55F;
/// A texel that lies so far behind what is nearest to the camera there is hidden.
constexpr float kHiddenMm = 4;
constexpr float kDepthCellMm = 1.5F;
constexpr int kMostCells = 1024;  ///< of a side
constexpr float kSaturated = 250;
/// Wider blurs are made of pictures that many times as small.
constexpr double kWideTexels = 8;
constexpr int kCoarser = 4;
constexpr double kGreyMiddle = 128;
constexpr double kGreyPerDeviation = 42;

/// What of a mesh is nearest to the camera, in cells of the picture plane.
class NearestDepth {
 public:
  NearestDepth(const mesh::Vertices& camera_mm, const mesh::Triangles& triangles) {
    least_ = Eigen::Vector2f::Constant(1e9F);
    Eigen::Vector2f largest = Eigen::Vector2f::Constant(-1e9F);
    const Eigen::Index count = camera_mm.cols();
    const float depth = std::max(camera_mm.row(2).mean(), 1.0F);
    scale_ = depth / kDepthCellMm;
    Eigen::Matrix2Xf cells(2, count);
    for (Eigen::Index v = 0; v < count; ++v) {
      cells.col(v) = scale_ * camera_mm.col(v).head<2>() / std::max(camera_mm(2, v), 1.0F);
      least_ = least_.cwiseMin(cells.col(v));
      largest = largest.cwiseMax(cells.col(v));
    }
    const Eigen::Vector2f extent = (largest - least_).cwiseMin(static_cast<float>(kMostCells - 2));
    nearest_ = cv::Mat(static_cast<int>(extent.y()) + 2, static_cast<int>(extent.x()) + 2, CV_32F,
                       cv::Scalar(std::numeric_limits<float>::max()));
    for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
      const auto corners = triangles.col(t);
      const Eigen::Vector3f depths(camera_mm(2, corners[0]), camera_mm(2, corners[1]),
                                   camera_mm(2, corners[2]));
      if (depths.minCoeff() < 1) {
        continue;
      }
      mesh::for_each_point(cells.col(corners[0]) - least_, cells.col(corners[1]) - least_,
                           cells.col(corners[2]) - least_, nearest_.cols, nearest_.rows,
                           [&](int x, int y, const Eigen::Vector3f& barycentric) {
                             float& nearest = nearest_.at<float>(y, x);
                             nearest = std::min(nearest, barycentric.dot(depths));
                           });
    }
  }

  bool hides(const Eigen::Vector3f& point_mm) const {
    const Eigen::Vector2f cell = scale_ * point_mm.head<2>() / std::max(point_mm.z(), 1.0F) - least_;
    const int x = std::clamp(static_cast<int>(std::lround(cell.x())), 0, nearest_.cols - 1);
    const int y = std::clamp(static_cast<int>(std::lround(cell.y())), 0, nearest_.rows - 1);
    return point_mm.z() > nearest_.at<float>(y, x) + kHiddenMm;
  }

 private:
  Eigen::Vector2f least_;
  float scale_ = 1;
  cv::Mat nearest_;
};

/// [height][width] 1 where a pixel tells no brightness.
cv::Mat saturated(const cv::Mat& rgb) {
  cv::Mat out = cv::Mat::zeros(rgb.size(), CV_32F);
  for (int row = 0; row < rgb.rows; ++row) {
    for (int column = 0; column < rgb.cols; ++column) {
      const auto& pixel = rgb.at<cv::Vec3b>(row, column);
      out.at<float>(row, column) =
          static_cast<float>(std::max({pixel[0], pixel[1], pixel[2]})) >= kSaturated ? 1.0F : 0.0F;
    }
  }
  return out;
}

}  // namespace

cv::Mat rgb_of(const HeadPicture& picture) {
  return {picture.height_px, picture.width_px, CV_8UC3, const_cast<std::uint8_t*>(picture.rgb.data())};
}

cv::Mat sample(const cv::Mat& image, const cv::Mat& x, const cv::Mat& y) {
  cv::Mat out;
  cv::remap(image, out, x, y, cv::INTER_LINEAR, cv::BORDER_CONSTANT);
  return out;
}

cv::Mat blurred(const cv::Mat& image, double sigma) {
  cv::Mat out;
  if (sigma < kWideTexels) {
    cv::GaussianBlur(image, out, {0, 0}, sigma);
    return out;
  }
  cv::Mat small;
  cv::resize(image, small, {}, 1.0 / kCoarser, 1.0 / kCoarser, cv::INTER_AREA);
  cv::GaussianBlur(small, small, {0, 0}, sigma / kCoarser);
  cv::resize(small, out, image.size(), 0, 0, cv::INTER_LINEAR);
  return out;
}

cv::Mat as_bytes(const cv::Mat& deviations) {
  cv::Mat out;
  deviations.convertTo(out, CV_8U, kGreyPerDeviation, kGreyMiddle);
  return out;
}

float smoothstep(float x, float low, float high) {
  const float t = std::clamp((x - low) / (high - low), 0.0F, 1.0F);
  return t * t * (3 - 2 * t);
}

ChartView chart_view(const TextureChart& chart, const mesh::Triangles& triangles, const HeadPicture& picture,
                     const CameraIntrinsics& camera, const mesh::Vertices& surface_mm) {
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(surface_mm, triangles, normals);
  const NearestDepth nearest(surface_mm, triangles);
  const cv::Mat rgb = rgb_of(picture);
  const Eigen::Array2f focal(camera.fx, camera.fy);
  const Eigen::Array2f origin(camera.cx - static_cast<float>(picture.left_px),
                              camera.cy - static_cast<float>(picture.top_px));
  const cv::Size size(chart.width(), chart.height());
  ChartView out{cv::Mat(size, CV_32F, cv::Scalar(-10)), cv::Mat(size, CV_32F, cv::Scalar(-10)),
                cv::Mat::zeros(size, CV_32F), cv::Mat::zeros(size, CV_32FC3), cv::Mat::zeros(size, CV_32FC3)};
  for (int row = 0; row < chart.height(); ++row) {
    for (int column = 0; column < chart.width(); ++column) {
      const auto texel = static_cast<std::size_t>(row * chart.width() + column);
      if (chart.triangle()[texel] < 0) {
        continue;
      }
      const Eigen::Vector3f point = chart.spread(surface_mm, texel);
      const Eigen::Vector3f normal = chart.spread(normals, texel).stableNormalized();
      out.position_mm.at<cv::Vec3f>(row, column) = {point.x(), point.y(), point.z()};
      out.normal.at<cv::Vec3f>(row, column) = {normal.x(), normal.y(), normal.z()};
      const Eigen::Array2f at = focal / std::max(point.z(), 1.0F) * point.head<2>().array() + origin;
      out.x_px.at<float>(row, column) = at.x();
      out.y_px.at<float>(row, column) = at.y();
      const bool inside = at.x() > 1 && at.y() > 1 && at.x() < static_cast<float>(rgb.cols - 2) &&
                          at.y() < static_cast<float>(rgb.rows - 2);
      if (inside && !nearest.hides(point)) {
        const float facing = -normal.dot(point) / std::max(point.norm(), 1e-9F);
        out.weight.at<float>(row, column) = smoothstep(facing, kGrazing, kFacing);
      }
    }
  }
  out.weight.setTo(0, sample(saturated(rgb), out.x_px, out.y_px) > 0.1F);
  return out;
}

ChartView chart_view(const TextureChart& chart, const mesh::Triangles& triangles, const HeadPicture& picture,
                     const ShapeSolver& solver, const HeadState& head, const Eigen::Vector2d& centre_px) {
  CameraIntrinsics camera;
  camera.fx = camera.fy = static_cast<float>(solver.focal_px());
  camera.cx = static_cast<float>(centre_px.x());
  camera.cy = static_cast<float>(centre_px.y());
  return chart_view(
      chart, triangles, picture, camera,
      ((head.rotation * solver.surface(head.expression)).colwise() + head.translation_mm).cast<float>());
}

}  // namespace facet::person
