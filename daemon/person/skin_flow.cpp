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
#include "person/chart_view.hpp"
#include "person/texture_chart.hpp"

namespace facet::person {
namespace {

/// What is wider than this is mostly shading, which stays with the light while the skin turns under it.
constexpr double kWindowMm = 0.7;
/// Of the brightness; what stands out less is the camera's noise.
constexpr float kLeastContrast = 0.03F;
constexpr float kDarkest = 0.01F;  ///< linear, below which brightness tells nothing
constexpr double kSmoothTexels = 0.6;
constexpr int kPatchTexels = 13;

/// A keyframe's picture on the chart.
struct Unwrapped {
  cv::Mat texture;   ///< [height][width] deviations from the mean around
  cv::Mat weight;    ///< [height][width] 0: the picture does not show it
  cv::Mat position;  ///< [height][width][3] camera frame, mm
};

/// [256] the logarithm of what a camera's value is of light.
cv::Mat log_of_grey() {
  cv::Mat table(1, 256, CV_32F);
  for (int value = 0; value < 256; ++value) {
    table.at<float>(value) = std::log(maths::decode_srgb(static_cast<float>(value) / 255) + kDarkest);
  }
  return table;
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
        chart(face_chart(given, texels)),
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
    ChartView view = chart_view(chart, triangles, keyframe.picture, solver, head, centre_px);
    cv::Mat grey;
    cv::cvtColor(rgb_of(keyframe.picture), grey, cv::COLOR_RGB2GRAY);
    cv::LUT(grey, log_of_grey(), grey);
    Unwrapped out{{}, std::move(view.weight), std::move(view.position_mm)};
    normalise(sample(grey, view.x_px, view.y_px), out);
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
