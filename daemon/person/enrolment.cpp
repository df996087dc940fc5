#include "person/enrolment.hpp"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

#include "face/person_model.hpp"
#include "maths/statistics.hpp"
#include "mesh/quads.hpp"
#include "person/skin_flow.hpp"

namespace facet::person {
namespace {

/// Every so many-th keyframe judges the shape and is not solved for.
constexpr std::size_t kJudgeEvery = 5;
constexpr std::size_t kFirstJudge = 3;
constexpr int kPoseSteps = 3;
constexpr int kShapeSteps = 2;
constexpr int kTurns = 2;  ///< of shape and the keyframes' own unknowns in the last round; one in the others
constexpr int kJudgeSteps = 10;
/// Of what lies far off: in the earlier rounds, whose shape is still wrong, and in the last.
constexpr double kWideBoundPx = 4;
constexpr double kBoundPx = 1;
constexpr std::size_t kFewestKeyframes = 6;
/// Skin that has turned further, in degrees, has folded over.
constexpr double kFolds = 75;
/// Of the guess's depth (docs/decisions/person.md, "A photo").
constexpr double kFlat = 0.78;
/// Under a light from about one side gloss is taken for relief (docs/decisions/person.md, "The relief of a
/// turn").
constexpr double kReliefYawDeg = 20;

double median_of_finite(std::vector<double> values) {
  values.erase(std::remove_if(values.begin(), values.end(), [](double v) { return !std::isfinite(v); }),
               values.end());
  return values.empty() ? std::numeric_limits<double>::quiet_NaN() : maths::median_of(values);
}

/// EnrolmentProgress said to stop.
struct BrokenOff {};

/// The solve of one head.
class Enrolment {
 public:
  Enrolment(const face::FaceModel& model, const Observed& observed, const EnrolmentOptions& options,
            const EnrolmentProgress& progress)
      : model_(model),
        observed_(observed),
        options_(options),
        progress_(progress),
        pictures_(observed.keyframes),
        centre_px_(observed.camera.cx, observed.camera.cy),
        solver_(model, observed.identity, observed.camera.fx, centre_px_, options.focal_is_known,
                options.anchor),
        early_flow_(model, options.chart_texels * 7 / 10),
        flow_(model, options.chart_texels) {
    choose_roles();
    pictures_.insert(pictures_.end(), observed.burst.begin(), observed.burst.end());
    for (const Keyframe& keyframe : pictures_) {
      HeadState head{keyframe.camera_from_head.linear(), keyframe.camera_from_head.translation(),
                     options.expression == KeyframeExpression::Rest ? observed.rest : keyframe.expression};
      priors_.push_back(head.expression);
      solver_.heads().push_back(std::move(head));
    }
  }

  LearnedShape run() {
    LearnedShape out;
    out.identity = observed_.identity;
    out.rest = observed_.rest;
    out.focal_px = solver_.focal_px();
    for (const Keyframe& keyframe : observed_.keyframes) {
      out.keyframes.push_back(keyframe.sequence);
    }
    try {
      if (turned_enough(out)) {
        solve(out);
      }
    } catch (const BrokenOff&) {
      out.gates.push_back({"solve", 0, 1, false, "it was broken off"});
    }
    const auto refusing =
        std::find_if(out.gates.begin(), out.gates.end(), [](const Gate& gate) { return !gate.passed; });
    out.accepted = refusing == out.gates.end();
    out.refused = out.accepted ? "" : refusing->sentence;
    return out;
  }

 private:
  /// How far the head was seen to turn to both sides: without that there is nothing to solve for.
  bool turned_enough(LearnedShape& out) const {
    OrientationSpan span;
    for (const Keyframe& keyframe : observed_.keyframes) {
      span.largest_yaw = std::max(span.largest_yaw, keyframe.yaw_deg);
      span.least_yaw = std::min(span.least_yaw, keyframe.yaw_deg);
    }
    // The camera stands to the head's left where the head is turned to its right.
    const double left = -span.least_yaw;
    const double right = span.largest_yaw;
    for (const auto& [side, degrees] : {std::pair("left", left), std::pair("right", right)}) {
      const bool passed = degrees >= kLeastYawDeg;
      out.gates.push_back(
          {fmt::format("turned to the {}, degrees", side), degrees, kLeastYawDeg, passed,
           passed ? ""
                  : fmt::format("the head was not turned far enough to its {} with the face at rest ({:.0f} "
                                "degrees, {:.0f} are needed, 20 are better)",
                                side, degrees, kLeastYawDeg)});
    }
    const std::size_t count = observed_.keyframes.size();
    out.gates.push_back({"pictures of the face at rest", static_cast<double>(count),
                         static_cast<double>(kFewestKeyframes), count >= kFewestKeyframes,
                         count >= kFewestKeyframes ? "" : "too few pictures show the face at rest"});
    return person::turned_enough(span) && count >= kFewestKeyframes;
  }

  void solve(LearnedShape& out) {
    bool solved = true;
    for (int round = 0; round < options_.rounds && solved; ++round) {
      solved = run_round(round);
    }
    out.neutral_mm = solver_.control_in_gauge();
    if (options_.expression == KeyframeExpression::Rest) {
      add_rest(out.neutral_mm);
    }
    face::bring_loose_pieces(model_, solver_.generic_control(), out.neutral_mm);
    if (!solved) {
      out.gates.push_back({"solve", 0, 1, false, "the shape could not be solved from these pictures"});
    } else {
      judge(out);
    }
    out.focal_px = solver_.focal_px();
    const bool passed =
        std::all_of(out.gates.begin(), out.gates.end(), [](const Gate& gate) { return gate.passed; });
    if (passed && options_.skin) {
      find_relief(out);
    }
    if (solved && options_.uncertainty) {
      out.sigma_mm = solver_.uncertainty_mm([this] { return go_on(); });
    }
  }

  /// Whether the light came from sides far enough apart for a relief to be looked for.
  bool turned_for_relief() const {
    double left = 0;
    double right = 0;
    for (const Keyframe& keyframe : observed_.keyframes) {
      left = std::max(left, -keyframe.yaw_deg);
      right = std::max(right, keyframe.yaw_deg);
    }
    return std::min(left, right) >= kReliefYawDeg;
  }

  /// What fails here costs the relief, not the shape.
  void find_relief(LearnedShape& out) {
    if (!looks_for_relief()) {
      out.skin_note = fmt::format(
          "its relief was not looked for: for that the head must turn by {:.0f} degrees to both sides",
          kReliefYawDeg);
      return;
    }
    try {
      out.skin = find_skin(model_, options_.skin_texels, pictures_, solver_, centre_px_, [this] { say(); });
    } catch (const std::exception& error) {
      out.skin = {};
      out.skin_note = fmt::format("its relief was not found: {}", error.what());
      return;
    }
    if (!out.skin.believed) {
      out.skin_note = fmt::format(
          "its relief is not kept: the pictures don't agree on one ({:.2f} of one half's is in the other, "
          "0.5 is needed; light and albedo leave {:.0f} % of the brightness, 12 are allowed)",
          out.skin.agreement, 100 * out.skin.residual);
    }
  }

  bool last(int round) const { return round + 1 == options_.rounds; }
  int turns_of(int round) const { return last(round) ? kTurns : 1; }

  bool looks_for_relief() const {
    return options_.skin && options_.expression == KeyframeExpression::Rest &&
           (turned_for_relief() || observed_.light_count() >= kFewestLights);
  }

  bool go_on() const {
    const int pictures =
        2 * options_.rounds * static_cast<int>(pictures_.size()) + static_cast<int>(order_.size());
    const int steps = (options_.rounds + kTurns - 1) * kShapeSteps;
    const int skin =
        looks_for_relief() ? skin_pieces(static_cast<int>(pictures_.size()), observed_.light_count()) : 0;
    return !progress_ || progress_(done_, pictures + steps + skin);
  }

  /// A piece of work is done. Throws BrokenOff.
  void say() {
    if (!go_on()) {
      throw BrokenOff();
    }
    ++done_;
  }

  /// The keyframes from the most frontal outwards, and which of them judge.
  void choose_roles() {
    const auto& keyframes = observed_.keyframes;
    order_.resize(keyframes.size());
    std::iota(order_.begin(), order_.end(), std::size_t{0});
    const auto turned = [&](std::size_t k) {
      return std::abs(keyframes[k].yaw_deg) + std::abs(keyframes[k].pitch_deg);
    };
    const std::size_t front = *std::min_element(
        order_.begin(), order_.end(), [&](std::size_t a, std::size_t b) { return turned(a) < turned(b); });
    const auto from_front = [&](std::size_t k) {
      return std::hypot(keyframes[k].yaw_deg - keyframes[front].yaw_deg,
                        keyframes[k].pitch_deg - keyframes[front].pitch_deg);
    };
    std::sort(order_.begin(), order_.end(),
              [&](std::size_t a, std::size_t b) { return from_front(a) < from_front(b); });
    solves_.assign(keyframes.size(), 1);
    for (std::size_t i = kFirstJudge; i < order_.size(); i += kJudgeEvery) {
      solves_[order_[i]] = 0;
      judges_.push_back(order_[i]);
    }
    // A burst shows one side of the head: it tells of its skin alone.
    solves_.resize(keyframes.size() + observed_.burst.size(), 0);
  }

  bool run_round(int round) {
    solver_.set_points(
        (last(round) ? flow_ : early_flow_)
            .find(pictures_, solver_, centre_px_, round == 0 ? order_ : std::vector<std::size_t>(), solves_,
                  [this] { say(); }),
        solves_);
    solver_.set_least_bound_px(round + 1 < options_.rounds ? kWideBoundPx : kBoundPx);
    const auto everybody = [&](int steps, bool expression) {
      for (std::size_t k = 0; k < pictures_.size(); ++k) {
        solver_.resect(
            k, steps,
            expression && options_.expression == KeyframeExpression::Solved ? &priors_[k] : nullptr);
      }
    };
    everybody(kPoseSteps, false);
    for (int turn = 0; turn < turns_of(round); ++turn) {
      for (int step = 0; step < kShapeSteps; ++step) {
        if (!solver_.bundle(1, true, round == 0)) {
          return false;
        }
        say();
      }
      everybody(kPoseSteps, true);
    }
    solver_.measure_noise();
    return true;
  }

  /// What the face at rest looked like to the nets is part of the face, and no expression.
  void add_rest(Eigen::Matrix3Xd& neutral_mm) const {
    const face::ExpressionBasis basis = model_.contract_identity(observed_.identity);
    for (std::size_t e = 0; e < basis.deltas_mm.size(); ++e) {
      if (model_.expression_names[e].find("Look") == std::string::npos) {
        neutral_mm += observed_.rest[static_cast<Eigen::Index>(e)] * basis.deltas_mm[e].cast<double>();
      }
    }
  }

  /// Median residual of the keyframes that were not solved for, with poses of their own.
  double held_out(bool generic) {
    const std::vector<HeadState> kept = solver_.heads();
    const double nearer = solver_.generic_focal_px() / solver_.focal_px();
    solver_.use_generic(generic);
    std::vector<double> residuals;
    for (const std::size_t k : judges_) {
      if (!go_on()) {
        throw BrokenOff();
      }
      solver_.heads()[k].translation_mm.z() *= generic ? nearer : 1;
      solver_.resect(k, kJudgeSteps,
                     options_.expression == KeyframeExpression::Solved ? &priors_[k] : nullptr);
      residuals.push_back(solver_.residual_px(k));
    }
    solver_.use_generic(false);
    solver_.heads() = kept;
    return median_of_finite(residuals);
  }

  /// How far the normal of any of the skin has turned from where the generic face has it.
  double most_turned_deg(const Eigen::Matrix3Xd& neutral_mm) const {
    const mesh::Triangles triangles = mesh::split_quads(model_.control.quads);
    Eigen::Matrix3Xf before;
    Eigen::Matrix3Xf after;
    mesh::vertex_normals(solver_.generic_control().cast<float>(), triangles, before);
    mesh::vertex_normals(neutral_mm.cast<float>(), triangles, after);
    float least = 1;
    for (const std::int32_t v : solver_.skin()) {
      least = std::min(least, before.col(v).dot(after.col(v)) /
                                  std::max(before.col(v).norm() * after.col(v).norm(), 1e-9F));
    }
    return std::acos(std::clamp(static_cast<double>(least), -1.0, 1.0)) * 180 / std::numbers::pi;
  }

  /// How deep the skin is from nose to ears against how wide and high it is, as a factor of the guess's.
  double depth_against_guess(const Eigen::Matrix3Xd& neutral_mm) const {
    const std::vector<std::int32_t>& skin = solver_.skin();
    Eigen::Matrix3Xd before = solver_.generic_control()(Eigen::all, skin);
    Eigen::Matrix3Xd after = neutral_mm(Eigen::all, skin);
    before.colwise() -= before.rowwise().mean().eval();
    after.colwise() -= after.rowwise().mean().eval();
    const Eigen::Matrix3d map =
        (before * before.transpose()).ldlt().solve(before * after.transpose()).transpose();
    const bool upright = map(0, 0) > 0 && map(1, 1) > 0 && map(2, 2) > 0;
    return upright ? map(2, 2) / std::sqrt(map(0, 0) * map(1, 1)) : 0;
  }

  void judge(LearnedShape& out) {
    const auto gate = [&](const char* name, double value, double limit, bool passed, std::string sentence) {
      out.gates.push_back({name, value, limit, passed, passed ? "" : std::move(sentence)});
    };
    const double before = held_out(true);
    const double after = held_out(false);
    gate("held-out flow, px", after, 0.85 * before, after <= 0.85 * before && before - after >= 0.05,
         fmt::format("the shape found explains pictures that it was not found from no better ({:.2f} px) "
                     "than the one before ({:.2f} px)",
                     after, before));
    const double turned = most_turned_deg(out.neutral_mm);
    gate("skin turned against the model's, degrees", turned, kFolds, turned <= kFolds,
         "the shape found folds");
    const double depth = depth_against_guess(out.neutral_mm);
    gate("depth against the model's", depth, kFlat, depth >= kFlat,
         "what was seen is flat, as a photo of a face is");
    gate("distance from the model's heads", solver_.identity_distance(), 2.5,
         solver_.identity_distance() <= 2.5, "this is no head, or not one head");
    gate("offset from the model, mm", solver_.offset_mm(), 8, solver_.offset_mm() <= 8,
         "this is no head, or not one head");
    const double log_focal = std::log(solver_.focal_px() / solver_.generic_focal_px());
    gate("focal length, ln", std::abs(log_focal), 0.45, std::abs(log_focal) <= 0.45,
         "the camera's focal length can't be what the solve says");
    gate("noise, px", solver_.noise_px(), 1, solver_.noise_px() < 1,
         "the pictures are too blurred, dark or compressed");
  }

  const face::FaceModel& model_;
  const Observed& observed_;
  EnrolmentOptions options_;
  EnrolmentProgress progress_;
  std::vector<Keyframe> pictures_;  ///< the keyframes, then the burst's
  Eigen::Vector2d centre_px_;
  ShapeSolver solver_;
  SkinFlow early_flow_;  ///< of the rounds but the last, which need not be as fine
  SkinFlow flow_;
  std::vector<std::size_t> order_;
  std::vector<char> solves_;         ///< [pictures]
  std::vector<std::size_t> judges_;  ///< keyframes that are not solved for
  std::vector<Eigen::VectorXd> priors_;
  int done_ = 0;  ///< pieces of work
};

}  // namespace

bool turned_enough(const OrientationSpan& span) {
  return span.largest_yaw >= kLeastYawDeg && -span.least_yaw >= kLeastYawDeg;
}

LearnedShape learn_shape(const face::FaceModel& model, const Observed& observed,
                         const EnrolmentOptions& options, const EnrolmentProgress& progress) {
  if (observed.keyframes.empty()) {
    LearnedShape none;
    none.identity = observed.identity;
    none.refused = "no picture shows the face at rest";
    return none;
  }
  return Enrolment(model, observed, options, progress).run();
}

}  // namespace facet::person
