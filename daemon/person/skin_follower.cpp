#include "person/skin_follower.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "facet/error.hpp"
#include "maths/srgb.hpp"
#include "maths/statistics.hpp"
#include "mesh/quads.hpp"
#include "person/chart_view.hpp"
#include "person/keyframes.hpp"
#include "person/skin_albedo.hpp"
#include "person/skin_registration.hpp"
#include "person/surface_anchor.hpp"
#include "person/texture_chart.hpp"

namespace facet::person {
namespace {

constexpr int kTexels = 384;  ///< of the chart's longer side
/// What is wider is shading, which stays with the light.
constexpr double kWindowMm = 10;
/// A point moves as what is believed so far around does on average; without any it stays.
constexpr double kSmoothMm = 8;
constexpr double kLeastBelieved = 0.05;
constexpr float kTripTexels = 1.5F;
constexpr float kWhole = 0.99F;  ///< of a texel, that has to be known
/// A place is known again by its deviations from this mean square on, of what is so far around.
constexpr double kTelling = 0.6;
constexpr double kTellingMm = 2;
constexpr float kShown = 0.05F;  ///< a texel's weight in the picture
constexpr float kDarkest = 0.01F;
constexpr float kCertainMm = 0.6F;    ///< what a flow errs by: so much nearer it leaves a point than it says
constexpr float kMostMm = 4;          ///< no tracker is further off along the skin
constexpr double kLeastKnown = 0.15;  ///< of the skin seen, that has to be known again

/// [256] what a camera's value is of light.
cv::Mat linear_of_byte() {
  cv::Mat table(1, 256, CV_32F);
  std::copy(maths::decoded_srgb8().begin(), maths::decoded_srgb8().end(), table.ptr<float>());
  return table;
}

/// [height][width] logarithm of what skin is judged by.
cv::Mat log_of_brightness(const cv::Mat& rgb) {
  std::array<cv::Mat, 3> planes;
  cv::split(rgb, planes.data());
  cv::Mat out;
  cv::log(cv::max(0.5 * (planes[0] + planes[1]), kDarkest), out);
  return out;
}

std::vector<Eigen::Index> on_chart(const face::FaceModel& model) {
  const std::vector<std::uint8_t> rim = skin_with_rim(model);
  std::vector<Eigen::Index> out;
  for (std::size_t v = 0; v < rim.size(); ++v) {
    if (rim[v] != 0) {
      out.push_back(static_cast<Eigen::Index>(v));
    }
  }
  return out;
}

}  // namespace

struct SkinFollower::Impl {
  explicit Impl(const face::FaceModel& model)
      : triangles(mesh::split_quads(model.control.quads)),
        chart(face_chart(model, kTexels)),
        to_surface(surface_rows(model)),
        vertices(on_chart(model)),
        at_x(1, static_cast<int>(vertices.size()), CV_32F),
        at_y(1, static_cast<int>(vertices.size()), CV_32F),
        decoded(linear_of_byte()),
        known(chart.height(), chart.width(), CV_32F, cv::Scalar(0)) {
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      at_x.ptr<float>()[i] = chart.at(vertices[i]).x();
      at_y.ptr<float>()[i] = chart.at(vertices[i]).y();
    }
    const std::size_t count = chart.triangle().size();
    std::vector<double> lengths;
    const mesh::Vertices neutral_mm = model.core_row(0, 0);
    mesh::TextureCoordinates coordinates(2, static_cast<Eigen::Index>(count));
    for (std::size_t texel = 0; texel < count; ++texel) {
      const auto x = static_cast<float>(texel % static_cast<std::size_t>(chart.width()));
      const auto y = static_cast<float>(texel / static_cast<std::size_t>(chart.width()));
      coordinates.col(static_cast<Eigen::Index>(texel)) =
          chart.least() + Eigen::Vector2f(x, y) / chart.texels_per_unit();
      const bool beside = texel > 0 && chart.triangle()[texel] >= 0 && chart.triangle()[texel - 1] >= 0;
      if (beside && x > 0) {
        lengths.push_back(static_cast<double>(
            (chart.spread(neutral_mm, texel) - chart.spread(neutral_mm, texel - 1)).norm()));
      }
    }
    texel_mm = lengths.empty() ? 1 : std::max(maths::median_of(std::move(lengths)), 0.01);
    const mesh::Vertices nothing = mesh::Vertices::Zero(3, coordinates.cols());
    const mesh::Vertices albedo = face::albedo_at(model.skin, coordinates, nothing);
    cv::Mat rgb(known.size(), CV_32FC3, cv::Scalar(0, 0, 0));
    for (std::size_t texel = 0; texel < count; ++texel) {
      const Eigen::Vector3f colour = albedo.col(static_cast<Eigen::Index>(texel));
      if (chart.triangle()[texel] >= 0 && colour.maxCoeff() > 0) {
        rgb.ptr<cv::Vec3f>()[texel] = {colour.x(), colour.y(), colour.z()};
        known.ptr<float>()[texel] = 1;
      }
    }
    reference = deviations(log_of_brightness(rgb), known, kWindowMm / texel_mm);
    telling = blurred(reference.mul(reference), kTellingMm / texel_mm) / kTelling;
    telling = cv::min(telling, 1).mul(known);
  }

  mesh::Triangles triangles;
  TextureChart chart;
  mesh::SparseRows to_surface;
  std::vector<Eigen::Index> vertices;  ///< that lie on the chart
  cv::Mat at_x, at_y;                  ///< [1][vertices] texels
  cv::Mat decoded;
  cv::Mat known;      ///< [height][width] 1 where the skin's albedo is known
  cv::Mat reference;  ///< [height][width] its deviations
  cv::Mat telling;    ///< [height][width] 0 to 1: how much there is to be known again by
  double texel_mm = 1;

  /// How the skin lies in the picture's chart, texels; confidence 0 where nothing is known.
  BelievedFlow flow(const HeadPicture& head, const ChartView& view) const {
    cv::Mat linear;
    cv::LUT(rgb_of(head), decoded, linear);
    const cv::Mat logs = sample(log_of_brightness(linear), view.x_px, view.y_px);
    cv::Mat shows = cv::Mat::zeros(known.size(), CV_32F);
    shows.setTo(1, (view.weight > kShown) & (known > 0));
    cv::Mat texture = deviations(logs, shows, kWindowMm / texel_mm);
    reference.copyTo(texture, shows == 0);  // nothing is seen to move there
    BelievedFlow out = flow_there_and_back(reference, texture, kTripTexels);
    out.confidence = out.confidence.mul(telling).mul(view.weight);
    out.confidence.setTo(0, shows == 0);
    return out;
  }
};

SkinFollower::SkinFollower(const face::FaceModel& model) {
  if (model.skin.albedo.empty()) {
    throw Error(ErrorKind::Usage, "a person's skin can't be followed: the model has no albedo of it");
  }
  impl_ = std::make_unique<Impl>(model);
}
SkinFollower::~SkinFollower() = default;

double SkinFollower::follow(const Frame& picture, const track::TrackResult& tracked,
                            mesh::Vertices& vertices_mm) {
  const Impl& impl = *impl_;
  vertices_mm = tracked.vertices_mm;
  const HeadPicture head = head_picture(picture, tracked);
  if (head.width_px < 2 || head.height_px < 2) {
    return 0;
  }
  mesh::Vertices camera_mm = tracked.camera_from_head * tracked.vertices_mm;
  mesh::Vertices surface_mm;
  mesh::apply(impl.to_surface, camera_mm, surface_mm);
  const ChartView view = chart_view(impl.chart, impl.triangles, head, tracked.camera, surface_mm);
  BelievedFlow found = impl.flow(head, view);
  const double seen = cv::sum(view.weight.mul(impl.telling))[0];
  const double again = seen > 0 ? cv::sum(found.confidence)[0] / seen : 0;
  if (again < kLeastKnown) {
    return again;
  }
  const double sigma = kSmoothMm / impl.texel_mm;
  const cv::Mat around = blurred(found.confidence, sigma) + kLeastBelieved;
  for (cv::Mat& step : found.step) {
    step = blurred(found.confidence.mul(step), sigma) / around;
  }
  const cv::Mat to_x = impl.at_x + sample(found.step[0], impl.at_x, impl.at_y);
  const cv::Mat to_y = impl.at_y + sample(found.step[1], impl.at_x, impl.at_y);
  const cv::Mat here = sample(view.position_mm, impl.at_x, impl.at_y);
  const cv::Mat there = sample(view.position_mm, to_x, to_y);
  const cv::Mat whole = sample(impl.known, impl.at_x, impl.at_y).mul(sample(impl.known, to_x, to_y));
  const Eigen::Matrix3f head_from_camera = tracked.camera_from_head.linear().transpose();
  for (int i = 0; i < whole.cols; ++i) {
    const cv::Vec3f step = there.at<cv::Vec3f>(i) - here.at<cv::Vec3f>(i);
    Eigen::Vector3f slide(step[0], step[1], step[2]);
    const float length = slide.norm();
    if (whole.at<float>(i) > kWhole && length > 0) {  // beside what is known positions are none
      slide *= std::clamp(length - kCertainMm, 0.0F, kMostMm) / length;
      vertices_mm.col(impl.vertices[static_cast<std::size_t>(i)]) += head_from_camera * slide;
    }
  }
  return again;
}

}  // namespace facet::person
