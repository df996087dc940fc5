#include "person/skin_flow.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "face/face_parts.hpp"
#include "maths/srgb.hpp"
#include "maths/statistics.hpp"
#include "mesh/quads.hpp"
#include "mesh/triangle_points.hpp"
#include "person/texture_chart.hpp"

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
/// What is wider than this is mostly shading, which stays with the light while the skin turns under it.
constexpr double kWindowMm = 0.7;
/// Of the brightness; what stands out less is the camera's noise.
constexpr float kLeastContrast = 0.03F;
constexpr float kDarkest = 0.01F;  ///< linear, below which brightness tells nothing
constexpr double kSmoothTexels = 0.6;
constexpr float kGreyMiddle = 128;
constexpr float kGreyPerDeviation = 42;
constexpr int kPatchTexels = 13;

float smoothstep(float x, float low, float high) {
  const float t = std::clamp((x - low) / (high - low), 0.0F, 1.0F);
  return t * t * (3 - 2 * t);
}

/// A keyframe's picture on the chart.
struct Unwrapped {
  cv::Mat texture;   ///< [height][width] deviations from the mean around
  cv::Mat weight;    ///< [height][width] 0: the picture does not show it
  cv::Mat position;  ///< [height][width][3] camera frame, mm
};

cv::Mat sample(const cv::Mat& image, const cv::Mat& x, const cv::Mat& y) {
  cv::Mat out;
  cv::remap(image, out, x, y, cv::INTER_LINEAR, cv::BORDER_CONSTANT);
  return out;
}

/// [256] the logarithm of what a camera's value is of light.
cv::Mat log_of_grey() {
  cv::Mat table(1, 256, CV_32F);
  for (int value = 0; value < 256; ++value) {
    table.at<float>(value) = std::log(maths::decode_srgb(static_cast<float>(value) / 255) + kDarkest);
  }
  return table;
}

cv::Mat blurred(const cv::Mat& image, double sigma) {
  cv::Mat out;
  cv::GaussianBlur(image, out, {0, 0}, sigma);
  return out;
}

cv::Mat boxed(const cv::Mat& image) {
  cv::Mat out;
  cv::blur(image, out, {kPatchTexels, kPatchTexels});
  return out;
}

/// The skin whose flow is believed: not the nose's, which is plain, steep and hides itself. There the edges
/// of shading are all that moves, and they stay with the light: a nose would come out flat.
std::vector<std::uint8_t> telling_of(const face::FaceModel& model) {
  std::vector<std::uint8_t> telling = model.control.refinable;
  if (!model.landmarks.empty()) {
    const std::vector<face::FacePart> parts = face::control_parts(model);
    for (std::size_t v = 0; v < telling.size(); ++v) {
      telling[v] = parts[v] == face::FacePart::Nose ? 0 : telling[v];
    }
  }
  return telling;
}

/// The skin, and what shares a quad with it.
std::vector<std::uint8_t> face_of(const face::FaceModel& model) {
  std::vector<std::uint8_t> face = model.control.refinable;
  for (Eigen::Index q = 0; q < model.control.quads.cols(); ++q) {
    const auto corners = model.control.quads.col(q);
    if (std::any_of(corners.begin(), corners.end(), [&](std::int32_t v) {
          return model.control.refinable[static_cast<std::size_t>(v)] != 0;
        })) {
      for (const std::int32_t v : corners) {
        face[static_cast<std::size_t>(v)] = 1;
      }
    }
  }
  return face;
}

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

cv::Mat as_bytes(const cv::Mat& texture) {
  cv::Mat out;
  texture.convertTo(out, CV_8U, kGreyPerDeviation, kGreyMiddle);
  return out;
}

}  // namespace

struct SkinFlow::Impl {
  const face::FaceModel& model;
  mesh::Triangles triangles;
  TextureChart chart;
  std::vector<std::uint8_t> telling;  ///< [vertex_count]
  cv::Mat x, y;                       ///< [height][width] of every texel
  cv::Mat covered;                    ///< [height][width] 1: a triangle holds the texel
  double texel_mm = 0;

  Impl(const face::FaceModel& given, int texels)
      : model(given),
        triangles(mesh::split_quads(given.control.quads)),
        chart(given.control.texture_coordinates, triangles, face_of(given), texels),
        telling(telling_of(given)),
        x(chart.height(), chart.width(), CV_32F),
        y(chart.height(), chart.width(), CV_32F),
        covered(chart.height(), chart.width(), CV_32F) {
    for (int row = 0; row < chart.height(); ++row) {
      for (int column = 0; column < chart.width(); ++column) {
        x.at<float>(row, column) = static_cast<float>(column);
        y.at<float>(row, column) = static_cast<float>(row);
        covered.at<float>(row, column) =
            chart.triangle()[static_cast<std::size_t>(row * chart.width() + column)] >= 0 ? 1.0F : 0.0F;
      }
    }
  }

  Unwrapped unwrap(const Keyframe& keyframe, const ShapeSolver& solver, const HeadState& head,
                   const Eigen::Vector2d& centre_px) {
    const mesh::Vertices camera_mm =
        ((head.rotation * solver.surface(head.expression)).colwise() + head.translation_mm).cast<float>();
    Eigen::Matrix3Xf normals;
    mesh::vertex_normals(camera_mm, triangles, normals);
    const NearestDepth nearest(camera_mm, triangles);
    const HeadPicture& picture = keyframe.picture;
    const cv::Mat rgb(picture.height_px, picture.width_px, CV_8UC3,
                      const_cast<std::uint8_t*>(picture.rgb.data()));
    cv::Mat grey;
    cv::cvtColor(rgb, grey, cv::COLOR_RGB2GRAY);
    cv::LUT(grey, log_of_grey(), grey);
    cv::Mat brightest = cv::Mat::zeros(rgb.size(), CV_32F);
    for (int row = 0; row < rgb.rows; ++row) {
      for (int column = 0; column < rgb.cols; ++column) {
        const auto& pixel = rgb.at<cv::Vec3b>(row, column);
        brightest.at<float>(row, column) =
            static_cast<float>(std::max({pixel[0], pixel[1], pixel[2]})) >= kSaturated ? 1.0F : 0.0F;
      }
    }
    const auto focal = static_cast<float>(solver.focal_px());
    const Eigen::Vector2f origin =
        centre_px.cast<float>() -
        Eigen::Vector2f(static_cast<float>(picture.left_px), static_cast<float>(picture.top_px));
    Unwrapped out{{}, cv::Mat::zeros(covered.size(), CV_32F), cv::Mat::zeros(covered.size(), CV_32FC3)};
    cv::Mat px(covered.size(), CV_32F, cv::Scalar(-10));
    cv::Mat py(covered.size(), CV_32F, cv::Scalar(-10));
    for (int row = 0; row < chart.height(); ++row) {
      for (int column = 0; column < chart.width(); ++column) {
        const auto texel = static_cast<std::size_t>(row * chart.width() + column);
        if (chart.triangle()[texel] < 0) {
          continue;
        }
        const Eigen::Vector3f point = chart.spread(camera_mm, texel);
        const Eigen::Vector3f normal = chart.spread(normals, texel);
        out.position.at<cv::Vec3f>(row, column) = {point.x(), point.y(), point.z()};
        const Eigen::Vector2f at = focal / std::max(point.z(), 1.0F) * point.head<2>() + origin;
        px.at<float>(row, column) = at.x();
        py.at<float>(row, column) = at.y();
        const bool inside = at.x() > 1 && at.y() > 1 && at.x() < static_cast<float>(rgb.cols - 2) &&
                            at.y() < static_cast<float>(rgb.rows - 2);
        if (!inside || nearest.hides(point)) {
          continue;
        }
        const float facing = -normal.dot(point) / std::max(normal.norm() * point.norm(), 1e-9F);
        out.weight.at<float>(row, column) = smoothstep(facing, kGrazing, kFacing);
      }
    }
    const cv::Mat saturated = sample(brightest, px, py);
    out.weight.setTo(0, saturated > 0.1F);
    normalise(sample(grey, px, py), out);
    return out;
  }

  /// What light does to the skin is wider than what the skin shows.
  void normalise(const cv::Mat& texture, Unwrapped& out) {
    if (texel_mm == 0) {
      measure_texel(out.position);
    }
    const double sigma = kWindowMm / texel_mm;
    const cv::Mat around = blurred(out.weight, sigma) + 1e-4F;
    cv::Mat deviation = texture - blurred(out.weight.mul(texture), sigma) / around;
    cv::Mat spread;
    cv::sqrt(blurred(out.weight.mul(deviation.mul(deviation)), sigma) / around, spread);
    deviation /= spread + kLeastContrast;
    deviation.setTo(0, out.weight == 0);
    out.texture = blurred(deviation, kSmoothTexels);
  }

  void measure_texel(const cv::Mat& position) {
    std::vector<double> lengths;
    for (int row = 0; row < chart.height(); ++row) {
      for (int column = 1; column < chart.width(); ++column) {
        if (covered.at<float>(row, column) > 0 && covered.at<float>(row, column - 1) > 0) {
          lengths.push_back(
              cv::norm(position.at<cv::Vec3f>(row, column) - position.at<cv::Vec3f>(row, column - 1)));
        }
      }
    }
    texel_mm = lengths.empty() ? 1 : std::max(maths::median_of(lengths), 0.01);
  }

  /// From the mean to one keyframe's texture, with how far it is to be trusted.
  struct Registered {
    cv::Mat x, y;             ///< [height][width] where each texel of the mean lies in the keyframe
    cv::Mat confidence;       ///< [height][width]
    cv::Mat texture, weight;  ///< the keyframe's, moved onto the mean
  };

  Registered itself(const Unwrapped& shot) const { return {x, y, shot.weight, shot.texture, shot.weight}; }

  Registered registered(const cv::Mat& mean, const cv::Mat& known, const Unwrapped& shot) const {
    cv::Mat from = mean.clone();
    cv::Mat to = shot.texture.clone();
    mean.copyTo(to, shot.weight == 0);  // where one knows nothing the other stands, and nothing moves
    to.copyTo(from, known == 0);
    const cv::Mat earlier = as_bytes(from);
    const cv::Mat later = as_bytes(to);
    cv::Mat there;
    cv::Mat back;
    // One for each: DIS keeps buffers of the picture before.
    for (const bool forth : {true, false}) {
      const cv::Ptr<cv::DISOpticalFlow> dis = cv::DISOpticalFlow::create(cv::DISOpticalFlow::PRESET_MEDIUM);
      dis->setFinestScale(0);
      dis->setUseSpatialPropagation(true);
      dis->calc(forth ? earlier : later, forth ? later : earlier, forth ? there : back);
    }
    std::array<cv::Mat, 2> step;
    cv::split(there, step.data());
    Registered out{x + step[0], y + step[1], {}, {}, {}};
    std::array<cv::Mat, 2> again;
    cv::split(sample(back, out.x, out.y), again.data());
    cv::Mat trip;
    cv::magnitude(step[0] + again[0], step[1] + again[1], trip);
    out.confidence = cv::max(1 - trip, 0);
    out.confidence = out.confidence.mul(out.confidence);
    out.confidence.setTo(0, known == 0);
    out.confidence.setTo(0, shot.weight == 0);
    out.texture = sample(shot.texture, out.x, out.y);
    out.weight = sample(shot.weight, out.x, out.y);
    const cv::Mat mean_here = boxed(mean);
    const cv::Mat mean_there = boxed(out.texture);
    cv::Mat norm = (boxed(mean.mul(mean)) - mean_here.mul(mean_here))
                       .mul(boxed(out.texture.mul(out.texture)) - mean_there.mul(mean_there));
    cv::sqrt(cv::max(norm, 1e-6), norm);
    const cv::Mat correlation = (boxed(mean.mul(out.texture)) - mean_here.mul(mean_there)) / norm;
    for (int row = 0; row < correlation.rows; ++row) {
      for (int column = 0; column < correlation.cols; ++column) {
        out.confidence.at<float>(row, column) *= smoothstep(correlation.at<float>(row, column), 0.3F, 0.7F);
      }
    }
    out.confidence = out.confidence.mul(out.weight);
    return out;
  }

  /// The mean of textures and where it is known.
  struct Mean {
    cv::Mat sum, weight;
    cv::Mat texture, known;

    explicit Mean(cv::Size size) : sum(cv::Mat::zeros(size, CV_32F)), weight(cv::Mat::zeros(size, CV_32F)) {}
    void add(const cv::Mat& shot, const cv::Mat& weight_of_shot) {
      sum += weight_of_shot.mul(shot);
      weight += weight_of_shot;
    }
    void settle(float least) {
      known = weight > least;
      texture = sum / cv::max(weight, 1e-4);
      texture.setTo(0, known == 0);
    }
  };

  SkinPoints at_vertices(const Registered& found, const Unwrapped& shot, double focal,
                         const Eigen::Vector2d& centre) const {
    const auto count = static_cast<std::size_t>(model.vertex_count());
    SkinPoints out{Eigen::Matrix2Xd::Zero(2, model.vertex_count()), std::vector<float>(count, 0)};
    cv::Mat vx(1, model.vertex_count(), CV_32F);
    cv::Mat vy(1, model.vertex_count(), CV_32F);
    for (int v = 0; v < model.vertex_count(); ++v) {
      const Eigen::Vector2f at = chart.at(v);
      vx.at<float>(v) = at.x();
      vy.at<float>(v) = at.y();
    }
    const cv::Mat to_x = sample(found.x, vx, vy);
    const cv::Mat to_y = sample(found.y, vx, vy);
    const cv::Mat confidence = sample(found.confidence, vx, vy);
    const cv::Mat position = sample(shot.position, to_x, to_y);
    const cv::Mat whole = sample(covered, to_x, to_y);
    for (int v = 0; v < model.vertex_count(); ++v) {
      const auto& point = position.at<cv::Vec3f>(v);
      if (telling[static_cast<std::size_t>(v)] == 0 || whole.at<float>(v) < 0.99F || point[2] < 1) {
        continue;
      }
      out.confidence[static_cast<std::size_t>(v)] = confidence.at<float>(v);
      out.measured_px.col(v) =
          Eigen::Vector2d(focal * point[0] / point[2], focal * point[1] / point[2]) + centre;
    }
    return out;
  }
};

SkinFlow::SkinFlow(const face::FaceModel& model, int chart_texels)
    : impl_(std::make_unique<Impl>(model, chart_texels)) {}
SkinFlow::~SkinFlow() = default;

std::vector<SkinPoints> SkinFlow::find(const std::vector<Keyframe>& keyframes, const ShapeSolver& solver,
                                       const Eigen::Vector2d& centre_px,
                                       const std::vector<std::size_t>& order, const std::vector<char>& joins,
                                       const std::function<void()>& between) {
  Impl& impl = *impl_;
  std::vector<Unwrapped> shots(keyframes.size());
  for (std::size_t k = 0; k < keyframes.size(); ++k) {
    between();
    shots[k] = impl.unwrap(keyframes[k], solver, solver.heads()[k], centre_px);
  }
  const cv::Size size = impl.covered.size();
  std::vector<Impl::Registered> found(keyframes.size());

  // First the mean grows from the most frontal picture to the ones that are turned further.
  Impl::Mean growing(size);
  for (std::size_t k = 0; order.empty() && k < keyframes.size(); ++k) {
    found[k] = impl.itself(shots[k]);
  }
  for (const std::size_t k : order) {
    between();
    found[k] = k == order.front() ? impl.itself(shots[k])
                                  : impl.registered(growing.texture, growing.known, shots[k]);
    if (joins[k] == 0) {
      continue;
    }
    cv::Mat weight = found[k].weight.clone();
    if (k != order.front()) {
      cv::Mat doubted = growing.known & (found[k].confidence <= 0.1F);
      weight.setTo(0, doubted);
    }
    growing.add(found[k].texture, weight);
    growing.settle(0.05F);
  }
  // Then once more against the mean of all, in which no picture's highlights stand.
  Impl::Mean mean(size);
  for (std::size_t k = 0; k < keyframes.size(); ++k) {
    if (joins[k] != 0) {
      cv::Mat weight = found[k].weight.mul(found[k].weight);
      weight.setTo(0, found[k].confidence <= 0.05F);
      mean.add(found[k].texture, weight);
    }
  }
  mean.settle(0.02F);
  std::vector<SkinPoints> out;
  for (std::size_t k = 0; k < keyframes.size(); ++k) {
    between();
    out.push_back(impl.at_vertices(impl.registered(mean.texture, mean.known, shots[k]), shots[k],
                                   solver.focal_px(), centre_px));
  }
  return out;
}

}  // namespace facet::person
