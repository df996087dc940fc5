#include "fit/skin_tracker.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <optional>
#include <utility>

#include "facet/error.hpp"
#include "fit/optical_flow.hpp"
#include "fit/projected_light.hpp"
#include "fit/reference_picture.hpp"
#include "fit/visibility.hpp"

namespace facet::fit {
namespace {

constexpr int kPlacingSteps = 30;
constexpr int kPlacingCgIterations = 200;
/// How far behind the mesh's own surface a vertex counts as hidden.
constexpr float kVisibleMargin_mm = 4;
/// How often a mesh that was found again is drawn to its skin: landmarks leave it millimetres off.
constexpr int kPasses = 3;
/// A person's shape is at most 2.5 mm from its own at rest; others' 2.4 mm (told by their skin) and more.
constexpr double kSamePerson_mm = 3;
/// Flow from the first picture's skin comes back on 0.63 of it and more, from others' on 0.14 to 0.35.
constexpr double kSameSkinTrust = 0.5;
/// Around the mesh, in shares of its size in the picture: what may have moved from slot to slot, and what
/// lies around skin that was drawn where it is.
constexpr double kReach = 0.3;
constexpr double kRim = 0.1;

bool usable(const Frame& picture) {
  return !picture.empty() && !picture.corrupt;
}

/// A camera that sees texture, and what is remembered of its pictures.
struct View {
  explicit View(capture::Lens given) : lens(std::move(given)) {}

  capture::Lens lens;
  OpticalFlow flow;
  Flow from_before;
  Flow from_drawn;
  Flow from_reference;
  Frame before;                              ///< empty where the slot before had none
  std::optional<ReferencePicture> previous;  ///< the same, with the mesh that it shows
  std::optional<ReferencePicture> reference;
};

}  // namespace

struct SkinTracker::Impl {
  Impl(std::shared_ptr<const TemplateMesh> given_surface, std::vector<capture::Lens> lenses,
       std::vector<capture::Lens> projectors, const SkinTrackerOptions& given_options)
      : surface(std::move(given_surface)),
        options(given_options),
        fitter(surface, options.fit),
        light(std::move(projectors)) {
    for (capture::Lens& lens : lenses) {
      views.emplace_back(std::move(lens));
    }
  }

  std::shared_ptr<const TemplateMesh> surface;
  SkinTrackerOptions options;
  TemplateFitter fitter;
  ProjectedLight light;  ///< its shadows are cast by the mesh that `normals` belong to
  std::deque<View> views;
  mesh::Vertices now_mm;
  Eigen::VectorXd expression;         ///< of now_mm
  mesh::Vertices before_mm;           ///< of the slot that now_mm follows on; no columns: it follows on none
  Eigen::VectorXd expression_before;  ///< of before_mm
  mesh::Vertices expected_mm;
  std::vector<float> depth_weight;
  Eigen::Matrix3Xf normals;
  std::vector<std::uint8_t> visible;
  std::vector<std::uint8_t> drawn;

  void check(std::span<const Frame> pictures, bool started) const {
    if (pictures.size() != views.size()) {
      throw Error(ErrorKind::Usage, "the skin tracker needs a picture, or an empty one, of every camera");
    }
    if (started && now_mm.cols() == 0) {
      throw Error(ErrorKind::Usage, "the skin tracker was not started");
    }
  }
  /// Normals and shadows of a mesh that is about to be drawn or remembered.
  void stand_on(const mesh::Vertices& vertices_mm) {
    mesh::vertex_normals(vertices_mm, surface->triangles, normals);
    light.cast_shadows(vertices_mm, surface->triangles);
  }
  /// Eyes and what is in the mouth move by themselves.
  void find_visible_skin(const View& view, const mesh::Vertices& vertices_mm) {
    find_visible(view.lens, vertices_mm, normals, surface->triangles, kVisibleMargin_mm, 0, visible);
    for (std::size_t v = 0; v < visible.size(); ++v) {
      visible[v] &= surface->is_skin[v];
    }
  }
  ReferencePicture picture_of_skin(const View& view, const Frame& picture,
                                   const mesh::Vertices& vertices_mm) {
    find_visible_skin(view, vertices_mm);
    return {view.lens, picture, vertices_mm, normals, surface->triangles, visible, light};
  }
  PixelBox box_of(const View& view, const Frame& picture, const mesh::Vertices& vertices_mm,
                  double reach) const;
  void flow_from(const ReferencePicture& skin, View& view, const Frame& picture,
                 const mesh::Vertices& vertices_mm, Flow& found);
  static void add(const View& view, const Flow& flow, const mesh::Vertices* from_mm,
                  std::vector<FlowView>& flows, float sigma_px = 0);
  TemplateFitReport conclude(const TemplateFitReport& report, const TemplateFitter& by,
                             mesh::Vertices&& found_mm, std::span<const Frame> pictures);
};

/// The part of a picture that a mesh covers, and some more.
PixelBox SkinTracker::Impl::box_of(const View& view, const Frame& picture, const mesh::Vertices& vertices_mm,
                                   double reach) const {
  Eigen::AlignedBox2d box;
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    if (surface->is_skin[static_cast<std::size_t>(v)] != 0) {
      if (const auto pixel = view.lens.project(vertices_mm.col(v).cast<double>())) {
        box.extend(*pixel);
      }
    }
  }
  if (box.isEmpty()) {
    return {0, 0, picture.width_px, picture.height_px};
  }
  const double more = reach * box.sizes().maxCoeff();
  const auto whole = [](double at, int limit) {
    return static_cast<int>(std::clamp(at, 0.0, static_cast<double>(limit)));
  };
  PixelBox result;
  result.left = whole(std::floor(box.min().x() - more), picture.width_px);
  result.top = whole(std::floor(box.min().y() - more), picture.height_px);
  result.width = whole(std::ceil(box.max().x() + more), picture.width_px) - result.left;
  result.height = whole(std::ceil(box.max().y() + more), picture.height_px) - result.top;
  return result;
}

/// Flow from skin that was seen before, drawn where the mesh is, to the picture.
void SkinTracker::Impl::flow_from(const ReferencePicture& skin, View& view, const Frame& picture,
                                  const mesh::Vertices& vertices_mm, Flow& found) {
  view.flow.find(skin.draw(picture, vertices_mm, normals, visible, light, drawn), picture,
                 box_of(view, picture, vertices_mm, kRim), found);
  for (std::size_t i = 0; i < drawn.size(); ++i) {
    found.confidence[i] *= static_cast<float>(drawn[i]);
  }
}

/// sigma_px  Tukey's; 0: the options'
void SkinTracker::Impl::add(const View& view, const Flow& flow, const mesh::Vertices* from_mm,
                            std::vector<FlowView>& flows, float sigma_px) {
  flows.push_back(
      {view.lens, flow.width_px, flow.height_px, flow.flow_px, flow.confidence, from_mm, sigma_px});
}

/// Takes over what was found, unless it is lost.
TemplateFitReport SkinTracker::Impl::conclude(const TemplateFitReport& report, const TemplateFitter& by,
                                              mesh::Vertices&& found_mm, std::span<const Frame> pictures) {
  depth_weight = by.depth_weight();
  before_mm.resize(3, 0);
  if (report.lost) {
    fitter.forget();
    for (View& view : views) {
      view.before = {};
      view.previous.reset();
    }
    return report;
  }
  now_mm = std::move(found_mm);
  expression = by.expression();
  fitter.remember(now_mm);
  stand_on(now_mm);
  for (std::size_t k = 0; k < views.size(); ++k) {
    View& view = views[k];
    view.previous.reset();
    view.before = {};
    if (!usable(pictures[k])) {
      continue;
    }
    view.before = pictures[k];
    view.previous.emplace(picture_of_skin(view, pictures[k], now_mm));
    if (!view.reference) {  // the camera's first picture
      view.reference.emplace(picture_of_skin(view, pictures[k], now_mm));
    }
  }
  return report;
}

SkinTracker::SkinTracker(std::shared_ptr<const TemplateMesh> surface, std::vector<capture::Lens> lenses,
                         std::vector<capture::Lens> projectors, const SkinTrackerOptions& options)
    : impl_(std::make_unique<Impl>(std::move(surface), std::move(lenses), std::move(projectors), options)) {}

SkinTracker::~SkinTracker() = default;

TemplateFitReport SkinTracker::start(const Placement& placed, std::span<const capture::DepthMap> maps,
                                     std::span<const Frame> pictures) {
  Impl& impl = *impl_;
  impl.check(pictures, false);
  FitOptions options = impl.options.fit;
  options.steps = kPlacingSteps;
  options.cg_iterations = kPlacingCgIterations;
  // What the face does is known (FirstShape): whatever else depth shows is the person's own.
  options.knows_expressions = false;
  TemplateFitter first(impl.surface, options);
  first.set_rest({placed.shown_mm, {}});
  mesh::Vertices found_mm = placed.shown_mm;
  TemplateFitReport report = first.fit(maps, found_mm);
  if (report.lost) {
    return report;
  }
  impl.fitter.set_rest({found_mm - (placed.shown_mm - placed.rest.vertices_mm), placed.rest.expressions_mm});
  for (View& view : impl.views) {
    view.reference.reset();
  }
  report = impl.conclude(report, first, std::move(found_mm), pictures);
  impl.expression = placed.expression;
  return report;
}

TemplateFitReport SkinTracker::follow(std::span<const capture::DepthMap> maps,
                                      std::span<const Frame> pictures) {
  Impl& impl = *impl_;
  impl.check(pictures, true);
  std::vector<FlowView> flows;
  for (std::size_t k = 0; k < impl.views.size(); ++k) {
    View& view = impl.views[k];
    if (usable(pictures[k]) && !view.before.empty()) {
      view.flow.find(view.before, pictures[k], impl.box_of(view, pictures[k], impl.now_mm, kReach),
                     view.from_before);
      impl.add(view, view.from_before, nullptr, flows);
    }
  }
  mesh::Vertices found_mm = impl.now_mm;
  impl.fitter.move(maps, flows, impl.now_mm, found_mm);
  // The way that is left is short: once more from the skin drawn where it was found.
  const mesh::Vertices drawn_mm = found_mm;
  if (impl.options.redraws) {
    flows.clear();
  }
  impl.stand_on(drawn_mm);
  for (std::size_t k = 0; k < impl.views.size(); ++k) {
    View& view = impl.views[k];
    const bool redraws = impl.options.redraws && view.previous;
    const bool compares = impl.options.uses_reference && view.reference;
    if (!usable(pictures[k]) || !(redraws || compares)) {
      continue;
    }
    impl.find_visible_skin(view, drawn_mm);
    if (redraws) {
      impl.flow_from(*view.previous, view, pictures[k], drawn_mm, view.from_drawn);
      impl.add(view, view.from_drawn, &drawn_mm, flows);
    }
    if (compares) {
      impl.flow_from(*view.reference, view, pictures[k], drawn_mm, view.from_reference);
      impl.add(view, view.from_reference, &drawn_mm, flows, impl.options.reference_sigma_px);
    }
  }
  TemplateFitReport report = impl.fitter.track(maps, flows, impl.now_mm, found_mm);
  mesh::Vertices before_mm = impl.now_mm;
  impl.expression_before = impl.expression;
  report = impl.conclude(report, impl.fitter, std::move(found_mm), pictures);
  if (!report.lost) {
    impl.before_mm = std::move(before_mm);
  }
  return report;
}

bool SkinTracker::follows() const {
  return impl_->before_mm.cols() > 0;
}

TemplateFitReport SkinTracker::between(double fraction, std::span<const capture::DepthMap> maps,
                                       mesh::Vertices& vertices_mm, Eigen::VectorXd& expression) {
  Impl& impl = *impl_;
  if (!follows()) {
    throw Error(ErrorKind::Usage, "the skin tracker's last slot did not follow on the one before");
  }
  impl.expected_mm = impl.before_mm + static_cast<float>(fraction) * (impl.now_mm - impl.before_mm);
  expression = impl.expression_before + fraction * (impl.expression - impl.expression_before);
  return impl.fitter.settle(maps, impl.expected_mm, vertices_mm);
}

TemplateFitReport SkinTracker::find_again(const Placement& placed, std::span<const capture::DepthMap> maps,
                                          std::span<const Frame> pictures) {
  Impl& impl = *impl_;
  impl.check(pictures, true);
  impl.fitter.forget();
  mesh::Vertices found_mm = impl.fitter.shape_like(placed.shown_mm);
  TemplateFitReport report = impl.fitter.fit(maps, found_mm);
  const TemplateFitReport fitted = report;
  bool compared = false;
  for (int pass = 0; pass < kPasses && impl.options.uses_reference && !report.lost; ++pass) {
    const mesh::Vertices drawn_mm = found_mm;
    impl.stand_on(drawn_mm);
    std::vector<FlowView> flows;
    for (std::size_t k = 0; k < impl.views.size(); ++k) {
      View& view = impl.views[k];
      if (usable(pictures[k]) && view.reference) {
        impl.find_visible_skin(view, drawn_mm);
        impl.flow_from(*view.reference, view, pictures[k], drawn_mm, view.from_reference);
        impl.add(view, view.from_reference, nullptr, flows, impl.options.reference_sigma_px);
      }
    }
    if (flows.empty()) {
      break;
    }
    report = impl.fitter.track(maps, flows, drawn_mm, found_mm);
    compared = true;
  }
  report.mouth_bend = std::max(report.mouth_bend, fitted.mouth_bend);
  report.mouth_off = std::max(report.mouth_off, fitted.mouth_off);
  report.shape_rms_mm = std::max(report.shape_rms_mm, fitted.shape_rms_mm);
  if (!report.lost && report.shape_rms_mm > kSamePerson_mm) {
    report.lost = true;
    report.lost_because = fmt::format("the face differs by {:.1f} mm from the one that was followed before",
                                      report.shape_rms_mm);
  } else if (!report.lost && compared && report.flow_trust < kSameSkinTrust) {
    report.lost = true;
    report.lost_because =
        fmt::format("the skin is like that of the face that was followed before on {:.0f} % of it only",
                    100 * report.flow_trust);
  }
  return impl.conclude(report, impl.fitter, std::move(found_mm), pictures);
}

const mesh::Vertices& SkinTracker::vertices_mm() const {
  return impl_->now_mm;
}

const Eigen::VectorXd& SkinTracker::expression() const {
  return impl_->expression;
}

const std::vector<float>& SkinTracker::depth_weight() const {
  return impl_->depth_weight;
}

}  // namespace facet::fit
