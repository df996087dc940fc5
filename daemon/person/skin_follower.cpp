#include "person/skin_follower.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "facet/aside.hpp"
#include "facet/error.hpp"
#include "maths/srgb.hpp"
#include "maths/statistics.hpp"
#include "mesh/quads.hpp"
#include "person/chart_flow.hpp"
#include "person/chart_view.hpp"
#include "person/keyframes.hpp"
#include "person/skin_albedo.hpp"
#include "person/skin_motion.hpp"
#include "person/skin_registration.hpp"
#include "person/surface_anchor.hpp"
#include "person/texture_chart.hpp"

namespace facet::person {
namespace {

constexpr int kTexels = 256;  ///< of the chart's longer side
constexpr int kRow = 1024;    ///< cv::remap takes no rows as long as some meshes have vertices
/// What is wider is shading, which stays with the light.
constexpr double kWindowMm = 2.5;
/// How far skin is beside where it was tracked, and what of that the head's movement does not explain.
constexpr double kTrackedMm = 1.5;
constexpr double kLeftMm = 0.7;
constexpr double kSmoothMm = 7;  ///< of slides: what is rougher costs normals
/// A place is known again by its deviations from this mean square on, of what is so far around.
constexpr double kTelling = 0.6;
constexpr double kTellingMm = 2;
constexpr float kWhole = 0.9999F;  ///< of a texel, that has to be known
constexpr float kShown = 0.05F;    ///< a texel's weight in the picture
constexpr float kDarkest = 0.01F;
constexpr float kMostMm = 4;  ///< no tracker is further off along the skin
constexpr float kBelieved = 0.02F;
constexpr std::size_t kEvery = 3;  ///< of the vertices that the movement is found by
/// Of the skin seen, that has to be known again: between them the mesh begins to follow.
constexpr float kLeastKnown = 0.15F;
constexpr float kEnoughKnown = 0.3F;
/// Pace::Beside: frames from one look to the next.
constexpr int kLookEvery = 10;

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
  Impl(const face::FaceModel& model, Pace given)
      : triangles(mesh::split_quads(model.control.quads)),
        chart(face_chart(model, kTexels)),
        to_surface(surface_rows(model)),
        vertices(on_chart(model)),
        at_x(rows_for(vertices.size()), kRow, CV_32F, cv::Scalar(-10)),
        at_y(at_x.clone()),
        known(chart.height(), chart.width(), CV_32F, cv::Scalar(0)),
        pace(given) {
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
    followed.slides_mm = Eigen::Matrix3Xf::Zero(3, static_cast<Eigen::Index>(vertices.size()));
    wanted = seen.wanted = followed;
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

  /// How a mesh is moved from where it was tracked.
  struct Correction {
    Motion head = Motion::Zero();  ///< head frame
    Eigen::Matrix3Xf slides_mm;    ///< [3][vertices] head frame
  };
  /// What a look is at, and what it found. Between Aside::begin and wait it is the helper's.
  struct Look {
    track::TrackResult tracked;
    double again = 0;  ///< share of the skin seen that was known again
    HeadPicture head;
    Correction wanted;
  };
  Look seen;
  double again = 0;     ///< by the last look
  Correction wanted;    ///< by the last look
  Correction followed;  ///< as handed out last
  Pace pace;
  int frames_since = kLookEvery;  ///< frames since the last look was begun
  bool dropped = false;           ///< what is being looked at is of no interest any more

  /// [height][width] 0 to 1: how much deviations say of a place.
  cv::Mat told_by(const cv::Mat& deviations) const {
    return cv::min(blurred(deviations.mul(deviations), kTellingMm / texel_mm) / kTelling, 1);
  }

  /// How the skin lies in the picture's chart.
  struct Sight {
    cv::Mat weight;  ///< [height][width] 0 to 1: known and shown
    cv::Mat shown;   ///< [height][width] deviations
    ChartFlow flow;
  };
  Sight sight(const HeadPicture& head, const ChartView& view, double usual_mm) const {
    const cv::Mat bytes = sample(rgb_of(head), view.x_px, view.y_px);
    cv::Mat linear(bytes.size(), CV_32FC3);
    const std::array<float, 256>& decoded = maths::decoded_srgb8();
    std::transform(bytes.ptr<std::uint8_t>(), bytes.ptr<std::uint8_t>() + 3 * bytes.total(),
                   linear.ptr<float>(), [&](std::uint8_t byte) { return decoded[byte]; });
    cv::Mat shows = cv::Mat::zeros(known.size(), CV_32F);
    shows.setTo(1, (view.weight > kShown) & (known > 0));
    Sight out{view.weight.mul(shows), deviations(log_of_brightness(linear), shows, kWindowMm / texel_mm), {}};
    out.flow = flow_on_chart(reference, out.shown, out.weight, texel_mm, usual_mm);
    return out;
  }

  /// The chart's vertices where a view has them and where a flow says that they are.
  struct AtVertices {
    cv::Mat here, there;  ///< in rows of kRow: camera frame, mm
    cv::Mat normal;       ///< their normals' mean, any length
    cv::Mat whole;        ///< 1 where both are known
  };
  AtVertices at_vertices(const ChartView& view, const ChartFlow& flow) const {
    const cv::Mat to_x = at_x + sample(flow.step[0], at_x, at_y);
    const cv::Mat to_y = at_y + sample(flow.step[1], at_x, at_y);
    return {sample(view.position_mm, at_x, at_y), sample(view.position_mm, to_x, to_y),
            sample(view.normal, at_x, at_y) + sample(view.normal, to_x, to_y),
            sample(known, at_x, at_y).mul(sample(known, to_x, to_y))};
  }

  /// How the head has to move in the camera's frame. told  [height][width] 0 to 1
  Eigen::Isometry3f moved(const ChartView& view, const ChartFlow& flow, const cv::Mat& told,
                          const CameraIntrinsics& camera) const {
    const AtVertices at = at_vertices(view, flow);
    const cv::Mat confidence = sample(told, at_x, at_y);
    const cv::Mat could_tell = sample(telling, at_x, at_y);
    float whole = 0;
    std::vector<std::size_t> chosen;
    for (std::size_t i = 0; i < vertices.size(); i += kEvery) {
      whole += could_tell.ptr<float>()[i];
      if (at.whole.ptr<float>()[i] > kWhole && confidence.ptr<float>()[i] > kBelieved) {
        chosen.push_back(i);
      }
    }
    const auto count = static_cast<Eigen::Index>(chosen.size());
    SeenSkin skin{Eigen::Matrix3Xf(3, count), Eigen::Matrix3Xf(3, count), Eigen::VectorXf(count), whole};
    for (Eigen::Index k = 0; k < count; ++k) {
      const std::size_t i = chosen[static_cast<std::size_t>(k)];
      const cv::Vec3f here = at.here.ptr<cv::Vec3f>()[i];
      const cv::Vec3f there = at.there.ptr<cv::Vec3f>()[i];
      skin.tracked_mm.col(k) << here[0], here[1], here[2];
      skin.seen_mm.col(k) << there[0], there[1], there[2];
      skin.weight[k] = confidence.ptr<float>()[i];
    }
    return motion_of(skin, camera);
  }

  ChartView view_of(const HeadPicture& head, const track::TrackResult& tracked,
                    const Eigen::Isometry3f& camera_from_head) const {
    mesh::Vertices surface_mm;
    mesh::apply(to_surface, mesh::Vertices(camera_from_head * tracked.vertices_mm), surface_mm);
    return chart_view(chart, triangles, head, tracked.camera, surface_mm);
  }

  /// Finds what the picture wants of the mesh.
  void look(Look& now) const {
    const HeadPicture& head = now.head;
    const track::TrackResult& tracked = now.tracked;
    now.wanted.head.setZero();
    now.wanted.slides_mm.setZero();
    now.again = 0;
    if (head.width_px < 2 || head.height_px < 2) {
      return;
    }
    ChartView view = view_of(head, tracked, tracked.camera_from_head);
    Sight sight_now = sight(head, view, kTrackedMm);
    const cv::Mat could_tell = sight_now.weight.mul(telling);
    const cv::Mat told = could_tell.mul(told_by(sight_now.shown)).mul(sight_now.flow.agreement);
    const double all = cv::sum(could_tell)[0];
    now.again = all > 0 ? cv::sum(told)[0] / all : 0;
    const float trusted = smoothstep(static_cast<float>(now.again), kLeastKnown, kEnoughKnown);
    if (!(trusted > 0)) {
      return;
    }
    if (tracked.view_used.size() < 2) {  // several cameras know the pose better than one of them
      const Eigen::Isometry3f found = moved(view, sight_now.flow, told, tracked.camera);
      now.wanted.head =
          trusted * motion(tracked.camera_from_head.inverse() * found * tracked.camera_from_head);
      view = view_of(head, tracked, tracked.camera_from_head * isometry(now.wanted.head));
      sight_now = sight(head, view, kLeftMm);
    }
    for (cv::Mat& step : sight_now.flow.step) {
      step = blurred(step, kSmoothMm / texel_mm);
    }
    const AtVertices at = at_vertices(view, sight_now.flow);
    const Eigen::Matrix3f head_from_camera =
        (tracked.camera_from_head * isometry(now.wanted.head)).linear().transpose();
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      const cv::Vec3f step = at.there.ptr<cv::Vec3f>()[i] - at.here.ptr<cv::Vec3f>()[i];
      const cv::Vec3f mean = at.normal.ptr<cv::Vec3f>()[i];
      const Eigen::Vector3f normal = Eigen::Vector3f(mean[0], mean[1], mean[2]).normalized();
      Eigen::Vector3f slide(step[0], step[1], step[2]);
      slide -= slide.dot(normal) * normal;      // a chord of the surface, which triangles lie below
      if (at.whole.ptr<float>()[i] > kWhole) {  // beside what is known positions are none
        now.wanted.slides_mm.col(static_cast<Eigen::Index>(i)) =
            trusted * std::min(1.0F, kMostMm / std::max(slide.norm(), kMostMm)) * (head_from_camera * slide);
      }
    }
    if (!now.wanted.head.allFinite() || !now.wanted.slides_mm.allFinite()) {
      now.wanted.head.setZero();
      now.wanted.slides_mm.setZero();
    }
  }

  /// A look at this picture, at once or beside the frames.
  void begin_look(const Frame& picture, const track::TrackResult& tracked) {
    frames_since = 0;
    seen.head = head_picture(picture, tracked);
    seen.tracked = tracked;
    if (pace == Pace::Beside) {
      aside.begin();
    } else {
      look(seen);
      take_seen();
    }
  }

  /// Ends a look beside the frames that is done, or that nobody else does.
  void end_look() {
    if (!aside.begun() || !(aside.ready() || !aside.helped())) {
      return;
    }
    if (!std::exchange(dropped, false)) {
      aside.wait();
      take_seen();
      return;
    }
    try {
      aside.wait();
    } catch (const std::exception&) {
      // It was of somebody else.
    }
  }

  void take_seen() {
    std::swap(wanted, seen.wanted);
    again = seen.again;
  }

  void forget() {
    for (Correction* each : {&wanted, &followed}) {
      each->head.setZero();
      each->slides_mm.setZero();
    }
    again = 0;
    dropped = aside.begun();
    frames_since = kLookEvery;
  }

  Aside aside{"facet-skin", [this] { look(seen); }};
};

SkinFollower::SkinFollower(const face::FaceModel& model, Pace pace) {
  if (model.skin.albedo.empty()) {
    throw Error(ErrorKind::Usage, "a person's skin can't be followed: the model has no albedo of it");
  }
  impl_ = std::make_unique<Impl>(model, pace);
}
SkinFollower::~SkinFollower() = default;

void SkinFollower::forget() {
  impl_->forget();
}

double SkinFollower::follow(const Frame& picture, const track::TrackResult& tracked, FollowedHead& out) {
  Impl& impl = *impl_;
  const int every = impl.pace == Pace::Beside ? kLookEvery : 1;
  impl.end_look();
  if (!picture.empty() && ++impl.frames_since >= every && !impl.aside.begun()) {
    impl.begin_look(picture, tracked);
  }
  const float nearer = 2.0F / static_cast<float>(1 + every);
  Impl::Correction& followed = impl.followed;
  followed.slides_mm += nearer * (impl.wanted.slides_mm - followed.slides_mm);
  followed.head += nearer * (impl.wanted.head - followed.head);
  out.camera_from_head = tracked.camera_from_head * isometry(followed.head);
  out.vertices_mm = tracked.vertices_mm;
  for (std::size_t i = 0; i < impl.vertices.size(); ++i) {
    out.vertices_mm.col(impl.vertices[i]) += followed.slides_mm.col(static_cast<Eigen::Index>(i));
  }
  return impl.again;
}

}  // namespace facet::person
