#include "avatar/protocols.hpp"

#include <bit>
#include <cmath>

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

}  // namespace

void write_vmc(const FaceState& state, float time_s, bool neutral, OscBundles& out) {
  out.add("/VMC/Ext/OK", {std::int32_t{1}, kCalibrated, kNormalMode, std::int32_t{state.tracked ? 1 : 0}});
  out.add("/VMC/Ext/T", {time_s});
  if (!state.tracked) {
    return;
  }
  // Unity's axes are ours with x turned round: so is the place's x, and turns about y and z go the other way.
  Eigen::Quaternionf turn(state.upright_from_head.linear());
  turn.normalize();
  const Eigen::Vector3f place = state.upright_from_head.translation();
  const Eigen::Vector3f root = neutral ? place : Eigen::Vector3f(0, 0, 0);
  const Eigen::Vector3f head = place - root;
  out.add("/VMC/Ext/Root/Pos", {"root", -root.x(), root.y(), root.z(), 0.0F, 0.0F, 0.0F, 1.0F});
  out.add("/VMC/Ext/Bone/Pos",
          {"Head", -head.x(), head.y(), head.z(), turn.x(), -turn.y(), -turn.z(), turn.w()});
  if (!state.has_expression) {
    return;
  }
  for (std::size_t i = 0; i < state.values.size(); ++i) {
    out.add("/VMC/Ext/Blend/Val", {mesh::kArkitNames.at(i), state.values.at(i)});
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
