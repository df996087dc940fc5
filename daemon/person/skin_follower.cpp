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

constexpr int kTexels = 256;  ///< of the chart's longer side
constexpr int kRow = 1024;    ///< cv::remap takes no rows as long as some meshes have vertices
/// What is wider is shading, which stays with the light.
constexpr double kWindowMm = 2.5;
/// A point moves as what is believed so far around does on average; without any it stays.
constexpr double kSmoothMm = 8;
constexpr double kLeastBelieved = 0.05;
constexpr float kTripTexels = 1.5F;
constexpr float kWhole = 0.9999F;  ///< of a texel, that has to be known
/// A place is known again by its deviations from this mean square on, of what is so far around.
constexpr double kTelling = 0.6;
constexpr double kTellingMm = 2;
constexpr float kShown = 0.05F;  ///< a texel's weight in the picture
constexpr float kDarkest = 0.01F;
constexpr float kCertainMm = 0.6F;  ///< what a flow errs by: so much nearer it leaves a point than it says
constexpr float kMostMm = 4;        ///< no tracker is further off along the skin
/// Of the skin seen, that has to be known again: between them the mesh begins to follow.
constexpr float kLeastKnown = 0.1F;
constexpr float kEnoughKnown = 0.25F;

/// [height][width] logarithm of what skin is judged by, of linear RGB.
cv::Mat log_of_brightness(const cv::Mat& rgb) {
  cv::Mat out(rgb.size(), CV_32F);
  for (std::size_t i = 0; i < rgb.total(); ++i) {
    const auto& pixel = rgb.ptr<cv::Vec3f>()[i];
    out.ptr<float>()[i] = std::log(std::max(brightness({pixel[0], pixel[1], pixel[2]}), kDarkest));
  }
  return out;
}

int rows_for(std::size_t values) {
  return static_cast<int>((values + kRow - 1) / kRow);
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
        at_x(rows_for(vertices.size()), kRow, CV_32F, cv::Scalar(-10)),
        at_y(at_x.clone()),
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
      const std::size_t row = texel / static_cast<std::size_t>(chart.width());
      const auto x = static_cast<float>(texel % static_cast<std::size_t>(chart.width()));
      const auto y = static_cast<float>(row);
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
    telling = told_by(reference);
    slides_mm = Eigen::Matrix3Xf::Zero(3, static_cast<Eigen::Index>(vertices.size()));
    wanted_mm = slides_mm;
  }

  mesh::Triangles triangles;
  TextureChart chart;
  mesh::SparseRows to_surface;
  std::vector<Eigen::Index> vertices;  ///< that lie on the chart
  cv::Mat at_x, at_y;                  ///< [vertices], in rows of kRow, texels
  cv::Mat known;                       ///< [height][width] 1 where the skin's albedo is known
  cv::Mat reference;                   ///< [height][width] its deviations
  cv::Mat telling;                     ///< [height][width] 0 to 1: how much there is to be known again by
  double texel_mm = 1;
  int look_every = 1;
  std::uint64_t frames = 0;
  double again = 0;            ///< share of the skin seen that the last look knew again
  Eigen::Matrix3Xf slides_mm;  ///< [3][vertices] head frame, as handed out last
  Eigen::Matrix3Xf wanted_mm;  ///< of the last look

  /// [height][width] 0 to 1: how much deviations say of a place.
  cv::Mat told_by(const cv::Mat& deviations) const {
    return cv::min(blurred(deviations.mul(deviations), kTellingMm / texel_mm) / kTelling, 1);
  }

  /// How the skin lies in the picture's chart, texels; confidence 0 where nothing is known.
  BelievedFlow flow(const HeadPicture& head, const ChartView& view) const {
    const cv::Mat bytes = sample(rgb_of(head), view.x_px, view.y_px);
    cv::Mat linear(bytes.size(), CV_32FC3);
    const std::array<float, 256>& decoded = maths::decoded_srgb8();
    std::transform(bytes.ptr<std::uint8_t>(), bytes.ptr<std::uint8_t>() + 3 * bytes.total(),
                   linear.ptr<float>(), [&](std::uint8_t byte) { return decoded[byte]; });
    cv::Mat shows = cv::Mat::zeros(known.size(), CV_32F);
    shows.setTo(1, (view.weight > kShown) & (known > 0));
    const cv::Mat shown = deviations(log_of_brightness(linear), shows, kWindowMm / texel_mm);
    cv::Mat texture = shown.clone();
    reference.copyTo(texture, shows == 0);  // nothing is seen to move there
    BelievedFlow out = flow_there_and_back(reference, texture, kTripTexels);
    // A picture that shows nothing comes back to where it began, too.
    out.confidence = out.confidence.mul(telling).mul(told_by(shown)).mul(view.weight);
    out.confidence.setTo(0, shows == 0);
    return out;
  }

  /// Sets what the picture wants of the mesh.
  void look(const HeadPicture& head, const track::TrackResult& tracked) {
    wanted_mm.setZero();
    again = 0;
    if (head.width_px < 2 || head.height_px < 2) {
      return;
    }
    mesh::Vertices surface_mm;
    mesh::apply(to_surface, mesh::Vertices(tracked.camera_from_head * tracked.vertices_mm), surface_mm);
    const ChartView view = chart_view(chart, triangles, head, tracked.camera, surface_mm);
    BelievedFlow found = flow(head, view);
    const double seen = cv::sum(view.weight.mul(telling))[0];
    again = seen > 0 ? cv::sum(found.confidence)[0] / seen : 0;
    const float trusted = smoothstep(static_cast<float>(again), kLeastKnown, kEnoughKnown);
    if (!(trusted > 0)) {
      return;
    }
    const double sigma = kSmoothMm / texel_mm;
    const cv::Mat around = blurred(found.confidence, sigma) + kLeastBelieved;
    for (cv::Mat& step : found.step) {
      step = blurred(found.confidence.mul(step), sigma) / around;
    }
    const cv::Mat to_x = at_x + sample(found.step[0], at_x, at_y);
    const cv::Mat to_y = at_y + sample(found.step[1], at_x, at_y);
    const cv::Mat here = sample(view.position_mm, at_x, at_y);
    const cv::Mat there = sample(view.position_mm, to_x, to_y);
    const cv::Mat whole = sample(known, at_x, at_y).mul(sample(known, to_x, to_y));
    const Eigen::Matrix3f head_from_camera = tracked.camera_from_head.linear().transpose();
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      const cv::Vec3f step = there.ptr<cv::Vec3f>()[i] - here.ptr<cv::Vec3f>()[i];
      const Eigen::Vector3f slide(step[0], step[1], step[2]);
      const float length = slide.norm();
      if (whole.ptr<float>()[i] > kWhole && length > kCertainMm) {  // beside what is known positions are none
        wanted_mm.col(static_cast<Eigen::Index>(i)) =
            trusted * std::min(length - kCertainMm, kMostMm) / length * (head_from_camera * slide);
      }
    }
  }
};

SkinFollower::SkinFollower(const face::FaceModel& model, int look_every) {
  if (model.skin.albedo.empty()) {
    throw Error(ErrorKind::Usage, "a person's skin can't be followed: the model has no albedo of it");
  }
  impl_ = std::make_unique<Impl>(model);
  impl_->look_every = std::max(1, look_every);
}
SkinFollower::~SkinFollower() = default;

double SkinFollower::follow(const Frame& picture, const track::TrackResult& tracked,
                            mesh::Vertices& vertices_mm) {
  Impl& impl = *impl_;
  if (!picture.empty() && impl.frames++ % static_cast<std::uint64_t>(impl.look_every) == 0) {
    impl.look(head_picture(picture, tracked), tracked);
  }
  const float nearer = 2.0F / static_cast<float>(1 + impl.look_every);
  impl.slides_mm += nearer * (impl.wanted_mm - impl.slides_mm);
  vertices_mm = tracked.vertices_mm;
  for (std::size_t i = 0; i < impl.vertices.size(); ++i) {
    vertices_mm.col(impl.vertices[i]) += impl.slides_mm.col(static_cast<Eigen::Index>(i));
  }
  return impl.again;
}

}  // namespace facet::person
