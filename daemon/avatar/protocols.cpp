#include "avatar/protocols.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <span>

#include "avatar/sent_values.hpp"

namespace facet::avatar {
namespace {

/// VMC's OK: calibrated, in the normal mode.
constexpr std::int32_t kCalibrated = 3;
constexpr std::int32_t kNormalMode = 0;

constexpr std::uint8_t kLiveLinkVersion = 6;
constexpr std::int32_t kLiveLinkRate_hz = 60;

void append(std::vector<std::byte>& out, std::uint32_t value) {
  for (int shift = 24; shift >= 0; shift -= 8) {
    out.push_back(static_cast<std::byte>(value >> static_cast<unsigned>(shift)));
  }
}
void append(std::vector<std::byte>& out, float value) {
  append(out, std::bit_cast<std::uint32_t>(value));
}
void append(std::vector<std::byte>& out, const std::string& text) {
  append(out, static_cast<std::uint32_t>(text.size()));
  const auto bytes = std::as_bytes(std::span(text));
  out.insert(out.end(), bytes.begin(), bytes.end());
}

/// A bone that turns by yaw (to the subject's right) and pitch (down), radians. Unity's axes are left-handed,
/// so that both turn the way a positive angle about y and x does; pitch first, then yaw: q = q_y q_x.
void add_eye(std::string_view bone, float yaw, float pitch, OscBundles& out) {
  const Eigen::Quaternionf turn = Eigen::Quaternionf(Eigen::AngleAxisf(yaw, Eigen::Vector3f::UnitY())) *
                                  Eigen::Quaternionf(Eigen::AngleAxisf(pitch, Eigen::Vector3f::UnitX()));
  out.add("/VMC/Ext/Bone/Pos", {bone, 0.0F, 0.0F, 0.0F, turn.x(), turn.y(), turn.z(), turn.w()});
}

}  // namespace

VmcContent vmc_content(VmcShapes shapes, bool eye_bones, const MappedValues& chosen) {
  return {shapes != VmcShapes::Presets, eye_bones,
          replaced(shapes == VmcShapes::PerfectSync ? MappedValues() : vrm_presets(), chosen)};
}

void write_vmc(const FaceState& state, float time_s, bool neutral, const VmcContent& content,
               OscBundles& out) {
  out.add("/VMC/Ext/OK", {std::int32_t{1}, kCalibrated, kNormalMode, std::int32_t{state.tracked ? 1 : 0}});
  out.add("/VMC/Ext/T", {time_s});
  if (!state.tracked) {
    return;
  }
  // Unity's axes are ours with x turned round: so is the place's x, and turns about y and z go the other way.
  Eigen::Quaternionf turn(state.upright_from_head.linear());
  turn.normalize();
  const Eigen::Vector3f root = neutral ? state.upright_from_head.translation() : Eigen::Vector3f(0, 0, 0);
  out.add("/VMC/Ext/Root/Pos", {"root", -root.x(), root.y(), root.z(), 0.0F, 0.0F, 0.0F, 1.0F});
  out.add("/VMC/Ext/Bone/Pos", {"Head", 0.0F, 0.0F, 0.0F, turn.x(), -turn.y(), -turn.z(), turn.w()});
  if (!state.has_expression) {
    return;
  }
  if (content.eye_bones) {
    const std::array<float, 9> angles =
        mesh::live_link_rotations(state.values, state.upright_from_head.linear());
    add_eye("LeftEye", angles[3], angles[4], out);
    add_eye("RightEye", angles[6], angles[7], out);
  }
  const auto add_value = [&out](std::string_view name, float value) {
    out.add("/VMC/Ext/Blend/Val", {name, value});
  };
  for (std::size_t i = 0; content.arkit_names && i < state.values.size(); ++i) {
    const std::string_view name = mesh::kArkitNames.at(i);
    if (std::none_of(content.values.begin(), content.values.end(),
                     [name](const MappedValue& chosen) { return chosen.name == name; })) {
      add_value(name, state.values.at(i));
    }
  }
  for (const MappedValue& value : content.values) {
    add_value(value.name, std::clamp(value.formula.of(state.values), 0.0F, 1.0F));
  }
  out.add("/VMC/Ext/Blend/Apply", {});
}

void write_live_link_face(const FaceState& state, const std::string& device, const std::string& subject,
                          double time_of_day_s, std::vector<std::byte>& out) {
  out.clear();
  out.push_back(static_cast<std::byte>(kLiveLinkVersion));
  append(out, device);
  append(out, subject);
  const double frames = time_of_day_s * kLiveLinkRate_hz;
  append(out, static_cast<std::uint32_t>(frames));
  append(out, static_cast<float>(frames - std::floor(frames)));
  append(out, static_cast<std::uint32_t>(kLiveLinkRate_hz));
  append(out, 1U);
  const std::array<float, 9> angles =
      mesh::live_link_rotations(state.values, state.upright_from_head.linear());
  out.push_back(static_cast<std::byte>(state.values.size() + angles.size()));
  for (const float value : state.values) {
    append(out, value);
  }
  for (const float angle : angles) {
    append(out, angle);
  }
}

}  // namespace facet::avatar
