#include "model/expression_shapes.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <string_view>

#include "facet/error.hpp"
#include "mesh/quads.hpp"

namespace facet::model {
namespace {

using Field = Eigen::Matrix3Xd;
using Mask = Eigen::VectorXd;

constexpr double radians(double degrees) {
  return degrees * std::numbers::pi / 180.0;
}

double smoothstep(double low, double high, double x) {
  const double t = std::clamp((x - low) / (high - low), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

/// How far an eye turns for a weight of 1 and which way: pitch turns the gaze down, yaw to the subject's
/// left.
struct Gaze {
  const char* name;
  Part eyeball;
  double pitch_rad;
  double yaw_rad;
};
constexpr double kLookUp = radians(25);
constexpr double kLookDown = radians(28);
constexpr double kLookSideways = radians(30);
constexpr std::array<Gaze, 8> kGazes = {{
    {"eyeLookDownLeft", Part::LeftEyeball, kLookDown, 0},
    {"eyeLookInLeft", Part::LeftEyeball, 0, -kLookSideways},
    {"eyeLookOutLeft", Part::LeftEyeball, 0, kLookSideways},
    {"eyeLookUpLeft", Part::LeftEyeball, -kLookUp, 0},
    {"eyeLookDownRight", Part::RightEyeball, kLookDown, 0},
    {"eyeLookInRight", Part::RightEyeball, 0, kLookSideways},
    {"eyeLookOutRight", Part::RightEyeball, 0, -kLookSideways},
    {"eyeLookUpRight", Part::RightEyeball, -kLookUp, 0},
}};

Eigen::Vector3d centroid(const Field& positions, const std::vector<int>& vertices) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const int v : vertices) {
    sum += positions.col(v);
  }
  return sum / static_cast<double>(vertices.size());
}

Field masked(const Field& field, const Mask& mask) {
  return field * mask.asDiagonal();
}

/// The places and masks on one neutral head that split and derive shapes.
class Anatomy {
 public:
  Anatomy(const HeadMesh& head, const Field& neutral_mm, const Field& mouth_open_mm)
      : head_(head), at_(neutral_mm), normals_(normals(head, neutral_mm)) {
    const double widest = mouth_open_mm.row(1).cwiseAbs().maxCoeff();
    jaw_ = (-mouth_open_mm.row(1).transpose() / widest).cwiseMax(0.0);
    mouth_ = centroid(at_, head.lip_seam);
    for (const int v : head.lip_seam) {
      mouth_half_width_mm_ = std::max(mouth_half_width_mm_, std::abs(at_(0, v)));
    }
    left_eye_ = centroid(at_, head.left_lid_seam);
  }

  /// Smooth split at the mid-line; left and right add up to 1.
  Mask side(bool left, double half_width_mm) const {
    return each([&](const Eigen::Vector3d& p) {
      const double to_left = smoothstep(-half_width_mm, half_width_mm, p.x());
      return left ? to_left : 1 - to_left;
    });
  }
  /// 1 on what the jaw carries below the lips' corners: the lower lip and all under it.
  Mask lower_lip() const {
    return each_vertex([&](int v) { return smoothstep(0.2, 0.5, jaw_[v]); });
  }
  Mask upper_lip() const { return Mask::Ones(at_.cols()) - lower_lip(); }
  /// How far a vertex moves with the jawbone: 1 at chin and lower lip, 0 above the mouth.
  Mask jawbone() const {
    constexpr double kFirm = 0.75;  // mouth-open moves the chin three quarters as far as the lower lip
    return (jaw_ / kFirm).cwiseMin(1.0);
  }
  /// 1 on the lips, falling to 0 at `reach` times the mouth's half width from its centre.
  Mask lips(double reach, double height_ratio = 0.6) const {
    return each([&](const Eigen::Vector3d& p) {
      const double dx = (p.x() - mouth_.x()) / mouth_half_width_mm_;
      const double dy = (p.y() - mouth_.y()) / (height_ratio * mouth_half_width_mm_);
      return p.z() < kBehindFaceMm ? 0.0 : 1 - smoothstep(0.75, reach, std::hypot(dx, dy));
    });
  }
  /// A soft round spot on the skin, seen from the front; x is mirrored for the right side.
  Mask spot(bool left, double x_mm, double y_mm, double radius_mm) const {
    return each_vertex([&](int v) {
      const Eigen::Vector3d p = at_.col(v);
      if (head_.part[static_cast<std::size_t>(v)] != Part::Skin || p.z() < kBehindFaceMm) {
        return 0.0;
      }
      const double dx = (left ? p.x() : -p.x()) - x_mm;
      const double distance = std::hypot(dx, p.y() - y_mm) / radius_mm;
      constexpr double kNothing = 2.5;  // radii beyond which the bell is cut off smoothly
      return std::exp(-0.5 * distance * distance) * (1 - smoothstep(0.7 * kNothing, kNothing, distance));
    });
  }
  /// 1 below the eyes' middle, 0 above.
  Mask lower_lids() const {
    return each([&](const Eigen::Vector3d& p) {
      return 1 - smoothstep(left_eye_.y() - 1.5, left_eye_.y() + 2.0, p.y());
    });
  }

  /// Displacement of a rigid turn about the vertical axis through (0, 0, z_mm).
  Field turn_sideways(double angle_rad, double z_mm) const {
    const Eigen::Matrix3d turn = Eigen::AngleAxisd(angle_rad, Eigen::Vector3d::UnitY()).toRotationMatrix() -
                                 Eigen::Matrix3d::Identity();
    return turn * (at_.colwise() - Eigen::Vector3d(0, 0, z_mm));
  }
  Field constant(double x_mm, double y_mm, double z_mm) const {
    return Eigen::Vector3d(x_mm, y_mm, z_mm).replicate(1, at_.cols());
  }
  const Field& outwards() const { return normals_; }
  const Eigen::Vector3d& mouth() const { return mouth_; }
  /// Depth below or above the lips' seam as a part of a lip's height, 0 at its outer border, 1 at the seam.
  Mask towards_seam(double lip_height_mm) const {
    return each([&](const Eigen::Vector3d& p) {
      return std::clamp(1 - std::abs(p.y() - mouth_.y()) / lip_height_mm, 0.0, 1.0);
    });
  }

 private:
  static constexpr double kBehindFaceMm = -25;  // behind it lie ears and skull

  template <typename Function>
  Mask each_vertex(Function value) const {
    Mask mask(at_.cols());
    for (Eigen::Index v = 0; v < at_.cols(); ++v) {
      mask[v] = value(static_cast<int>(v));
    }
    return mask;
  }
  template <typename Function>
  Mask each(Function value) const {
    return each_vertex([&](int v) { return value(Eigen::Vector3d(at_.col(v))); });
  }
  static Field normals(const HeadMesh& head, const Field& positions) {
    Eigen::Matrix3Xf unit;
    mesh::vertex_normals(positions.cast<float>(), mesh::split_quads(head.quads), unit);
    return unit.cast<double>();
  }

  const HeadMesh& head_;
  Field at_;
  Field normals_;
  Mask jaw_;
  Eigen::Vector3d mouth_;
  Eigen::Vector3d left_eye_;
  double mouth_half_width_mm_ = 0;
};

/// All shapes of one ethnicity by name.
Field shape(std::string_view name, const Anatomy& face,
            const std::function<Field(const std::string&)>& unit) {
  constexpr double kMouthSplitMm = 12;
  constexpr double kLipReach = 1.75;
  const bool left = name.ends_with("Left");
  const std::string side = left ? "left" : "right";
  const auto is = [&](std::string_view stem) {
    return name == stem || (name.starts_with(stem) &&
                            (name.substr(stem.size()) == "Left" || name.substr(stem.size()) == "Right"));
  };
  const auto half = [&](const Field& both) { return masked(both, face.side(left, kMouthSplitMm)); };
  const auto jaw_open = [&] { return Field(0.8 * unit("mouth-open")); };

  if (is("eyeBlink")) return unit("eye-" + side + "-closure");
  if (is("eyeWide")) return unit("eye-" + side + "-opened-up");
  if (is("eyeSquint")) {
    const Mask lower = face.lower_lids();
    return masked(unit("eye-" + side + "-slit"), (0.4 + 0.6 * lower.array()).matrix());
  }
  // Lids follow the gaze: the upper one rides on the eyeball, the lower one a little.
  if (is("eyeLookDown")) return 0.38 * unit("eye-" + side + "-closure");
  if (is("eyeLookUp"))
    return 0.55 * unit("eye-" + side + "-opened-up") +
           0.3 * masked(unit("eye-" + side + "-slit"), face.lower_lids());
  if (is("eyeLookIn")) return masked(face.constant(left ? -0.8 : 0.8, 0, 0), face.spot(left, 32, 0, 7));
  if (is("eyeLookOut")) return masked(face.constant(left ? 0.8 : -0.8, 0, 0), face.spot(left, 32, 0, 7));
  if (name == "jawOpen") return jaw_open();
  if (name == "jawForward") return masked(face.constant(0, -0.5, 6), face.jawbone());
  constexpr double kCondyleDepthMm = -75;
  if (name == "jawLeft") return masked(face.turn_sideways(radians(4.5), kCondyleDepthMm), face.jawbone());
  if (name == "jawRight") return masked(face.turn_sideways(radians(-4.5), kCondyleDepthMm), face.jawbone());
  // Takes back what jawOpen does to the lips, so that both together drop the jaw behind closed lips.
  if (name == "mouthClose") return masked(-jaw_open(), face.lips(1.9, 0.55));
  if (name == "mouthFunnel") return 0.75 * unit("mouth-protusion");
  if (name == "mouthPucker") return 0.85 * unit("mouth-pursing");
  constexpr double kDentalArchMm = 45;  // the lips slide around the teeth
  if (name == "mouthLeft")
    return masked(face.turn_sideways(radians(10), face.mouth().z() - kDentalArchMm), face.lips(kLipReach));
  if (name == "mouthRight")
    return masked(face.turn_sideways(radians(-10), face.mouth().z() - kDentalArchMm), face.lips(kLipReach));
  if (is("mouthSmile")) return half(unit("mouth-corner-puller"));
  if (is("mouthFrown")) return half(unit("mouth-depression"));
  if (is("mouthDimple")) return half(unit("mouth-retraction"));
  if (is("mouthStretch")) return half(masked(unit("neck-platysma"), face.lips(2.6, 0.75)));
  constexpr double kUpperLipMm = 10;
  constexpr double kLowerLipMm = 14;
  if (name == "mouthRollLower") {
    const Mask roll =
        face.lips(1.5).cwiseProduct(face.lower_lip()).cwiseProduct(face.towards_seam(kLowerLipMm));
    return masked(face.constant(0, 3, -8), roll);
  }
  if (name == "mouthRollUpper") {
    const Mask roll =
        face.lips(1.5).cwiseProduct(face.upper_lip()).cwiseProduct(face.towards_seam(kUpperLipMm));
    return masked(face.constant(0, -3, -8), roll);
  }
  if (name == "mouthShrugLower") return unit("mouth-eversion");
  if (name == "mouthShrugUpper")
    return masked(face.constant(0, 4, 2), face.lips(1.6).cwiseProduct(face.upper_lip()));
  if (is("mouthPress")) {
    const Mask lips = face.lips(1.4);
    const Field upper = masked(face.constant(0, -1.5, -1.5), lips.cwiseProduct(face.upper_lip()));
    const Field lower = masked(face.constant(0, 3.0, -1.5), lips.cwiseProduct(face.lower_lip()));
    return half(upper + lower);
  }
  if (is("mouthLowerDown")) return half(masked(0.9 * unit("mouth-depression-retraction"), face.lower_lip()));
  if (is("mouthUpperUp")) return half(masked(unit("mouth-elevation"), face.upper_lip()));
  if (is("browDown")) return 0.85 * unit("eyebrows-" + side + "-down");
  if (name == "browInnerUp") return unit("eyebrows-left-inner-up") + unit("eyebrows-right-inner-up");
  if (is("browOuterUp")) return 0.75 * unit("eyebrows-" + side + "-extern-up");
  if (name == "cheekPuff")
    return 8.0 * masked(face.outwards(), face.spot(true, 44, -62, 15) + face.spot(false, 44, -62, 15));
  if (is("cheekSquint")) {
    return masked(face.constant(left ? 1.0 : -1.0, 4.5, 1.5), face.spot(left, 38, -30, 13)) +
           0.35 * masked(unit("eye-" + side + "-slit"), face.lower_lids());
  }
  if (is("noseSneer")) return unit("nose-" + side + "-elevation");
  throw Error(ErrorKind::Internal, fmt::format("no recipe for the expression '{}'", name));
}

}  // namespace

const std::vector<ExpressionName>& expression_names() {
  static const std::vector<ExpressionName> kNames = {
      {"eyeBlinkLeft", 0.35F, "eye-left-closure"},
      {"eyeLookDownLeft", 0.3F, "eyeball turn, 38 % of the closure"},
      {"eyeLookInLeft", 0.25F, "eyeball turn, lids follow"},
      {"eyeLookOutLeft", 0.25F, "eyeball turn, lids follow"},
      {"eyeLookUpLeft", 0.2F, "eyeball turn, 55 % of eye-left-opened-up"},
      {"eyeSquintLeft", 0.25F, "eye-left-slit, mostly the lower lid"},
      {"eyeWideLeft", 0.2F, "eye-left-opened-up"},
      {"eyeBlinkRight", 0.35F, "eye-right-closure"},
      {"eyeLookDownRight", 0.3F, "eyeball turn, 38 % of the closure"},
      {"eyeLookInRight", 0.25F, "eyeball turn, lids follow"},
      {"eyeLookOutRight", 0.25F, "eyeball turn, lids follow"},
      {"eyeLookUpRight", 0.2F, "eyeball turn, 55 % of eye-right-opened-up"},
      {"eyeSquintRight", 0.25F, "eye-right-slit, mostly the lower lid"},
      {"eyeWideRight", 0.2F, "eye-right-opened-up"},
      {"jawForward", 0.15F, "jaw moved forward (derived)"},
      {"jawLeft", 0.1F, "jaw turned about the condyles (derived)"},
      {"jawRight", 0.1F, "jaw turned about the condyles (derived)"},
      {"jawOpen", 0.3F, "80 % of mouth-open"},
      {"mouthClose", 0.15F, "jawOpen taken back on the lips (derived)"},
      {"mouthFunnel", 0.25F, "75 % of mouth-protusion"},
      {"mouthPucker", 0.35F, "85 % of mouth-pursing"},
      {"mouthLeft", 0.15F, "lips turned around the teeth (derived)"},
      {"mouthRight", 0.15F, "lips turned around the teeth (derived)"},
      {"mouthSmileLeft", 0.4F, "left half of mouth-corner-puller"},
      {"mouthSmileRight", 0.4F, "right half of mouth-corner-puller"},
      {"mouthFrownLeft", 0.2F, "left half of mouth-depression"},
      {"mouthFrownRight", 0.2F, "right half of mouth-depression"},
      {"mouthDimpleLeft", 0.2F, "left half of mouth-retraction"},
      {"mouthDimpleRight", 0.2F, "right half of mouth-retraction"},
      {"mouthStretchLeft", 0.25F, "left half of neck-platysma"},
      {"mouthStretchRight", 0.25F, "right half of neck-platysma"},
      {"mouthRollLower", 0.2F, "lower lip rolled in (derived)"},
      {"mouthRollUpper", 0.2F, "upper lip rolled in (derived)"},
      {"mouthShrugLower", 0.25F, "mouth-eversion"},
      {"mouthShrugUpper", 0.2F, "upper lip pushed up (derived)"},
      {"mouthPressLeft", 0.2F, "lips pressed together (derived)"},
      {"mouthPressRight", 0.2F, "lips pressed together (derived)"},
      {"mouthLowerDownLeft", 0.25F, "lower left part of mouth-depression-retraction"},
      {"mouthLowerDownRight", 0.25F, "lower right part of mouth-depression-retraction"},
      {"mouthUpperUpLeft", 0.25F, "upper left part of mouth-elevation"},
      {"mouthUpperUpRight", 0.25F, "upper right part of mouth-elevation"},
      {"browDownLeft", 0.3F, "85 % of eyebrows-left-down"},
      {"browDownRight", 0.3F, "85 % of eyebrows-right-down"},
      {"browInnerUp", 0.35F, "eyebrows-left-inner-up and -right-inner-up"},
      {"browOuterUpLeft", 0.25F, "75 % of eyebrows-left-extern-up"},
      {"browOuterUpRight", 0.25F, "75 % of eyebrows-right-extern-up"},
      {"cheekPuff", 0.15F, "cheeks pushed outwards (derived)"},
      {"cheekSquintLeft", 0.2F, "cheek raised (derived), some of eye-left-slit"},
      {"cheekSquintRight", 0.2F, "cheek raised (derived), some of eye-right-slit"},
      {"noseSneerLeft", 0.25F, "nose-left-elevation"},
      {"noseSneerRight", 0.25F, "nose-right-elevation"},
  };
  return kNames;
}

ExpressionShapes::ExpressionShapes(const MakeHumanTargets& targets, const HeadMesh& head,
                                   const Field& neutral_mm) {
  for (std::size_t e = 0; e < kEthnicities.size(); ++e) {
    const auto unit = [&](const std::string& name) {
      return Field(HeadFrame::kMmPerDm *
                   targets.displacements_dm(fmt::format("expression/units/{}/{}", kEthnicities[e], name),
                                            head.base_vertex));
    };
    const Anatomy face(head, neutral_mm, unit("mouth-open"));
    for (const ExpressionName& expression : expression_names()) {
      Field& field = shapes_mm_[e].emplace_back(shape(expression.name, face, unit));
      for (int v = 0; v < head.vertex_count(); ++v) {
        const Part part = head.part[static_cast<std::size_t>(v)];
        if (part == Part::LeftEyeball || part == Part::RightEyeball) {
          field.col(v).setZero();
        }
      }
    }
  }
}

Field ExpressionShapes::blend_mm(int expression, const std::array<double, 3>& ethnicity) const {
  const auto at = static_cast<std::size_t>(expression);
  return ethnicity[0] * shapes_mm_[0][at] + ethnicity[1] * shapes_mm_[1][at] +
         ethnicity[2] * shapes_mm_[2][at];
}

void rotate_eyeballs(int expression, const HeadMesh& head, const Field& neutral_mm, Field& displacements_mm) {
  const std::string_view name = expression_names()[static_cast<std::size_t>(expression)].name;
  const auto gaze = std::find_if(kGazes.begin(), kGazes.end(), [&](const Gaze& g) { return name == g.name; });
  if (gaze == kGazes.end()) {
    return;
  }
  const std::vector<int> eyeball = head.vertices_of(gaze->eyeball);
  const Eigen::Vector3d centre_mm = centroid(neutral_mm, eyeball);
  // Positive pitch about x takes z towards -y (down); positive yaw about y takes z towards +x (subject's
  // left).
  const Eigen::Matrix3d change = (Eigen::AngleAxisd(gaze->pitch_rad, Eigen::Vector3d::UnitX()) *
                                  Eigen::AngleAxisd(gaze->yaw_rad, Eigen::Vector3d::UnitY()))
                                     .toRotationMatrix() -
                                 Eigen::Matrix3d::Identity();
  for (const int v : eyeball) {
    displacements_mm.col(v) += change * (neutral_mm.col(v) - centre_mm);
  }
}

}  // namespace facet::model
