#include "avatar/phone_messages.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <span>
#include <string>
#include <string_view>

namespace facet::avatar {
namespace {

constexpr float kDegreesPerRadian = 57.29578F;

/// Live Link's yaw, pitch and roll (mesh::live_link_rotations), which begin at `first`, as the angles above.
std::array<float, 3> phone_angles(const std::array<float, 9>& rotations, std::size_t first) {
  // 0 less than 0 is 0; its negative would be written as "-0".
  return {kDegreesPerRadian * rotations.at(first + 1), 0 - kDegreesPerRadian * rotations.at(first),
          0 - kDegreesPerRadian * rotations.at(first + 2)};
}

/// "mouthSmile_L" of "MouthSmileLeft", but "mouthLeft" and "jawLeft" of names that are a side and no more.
std::string ifacialmocap_name(std::size_t index) {
  std::string name = mesh::arkit_name(index);
  if (name == "mouthLeft" || name == "mouthRight" || name == "jawLeft" || name == "jawRight") {
    return name;
  }
  for (const std::string_view side : {"Left", "Right"}) {
    if (name.ends_with(side)) {
      name.resize(name.size() - side.size());
      return name + '_' + side.front();
    }
  }
  return name;
}

void replace(std::vector<std::byte>& out, const std::string& text) {
  const auto bytes = std::as_bytes(std::span(text));
  out.assign(bytes.begin(), bytes.end());
}

std::string vector_json(std::string_view name, const std::array<float, 3>& v) {
  return fmt::format(R"("{}":{{"x":{:.6f},"y":{:.6f},"z":{:.6f}}})", name, v[0], v[1], v[2]);
}

}  // namespace

void write_ifacialmocap(const FaceState& state, IFacialMocapVersion version, std::vector<std::byte>& out) {
  const char between = version == IFacialMocapVersion::V2 ? '&' : '-';
  std::string text;
  const auto add = std::back_inserter(text);
  for (std::size_t i = 0; i < state.values.size(); ++i) {
    fmt::format_to(add, "{}{}{}|", ifacialmocap_name(i), between, std::lround(100 * state.values.at(i)));
  }
  const std::array<float, 9> rotations =
      mesh::live_link_rotations(state.values, state.upright_from_head.linear());
  const std::array<float, 3> head = phone_angles(rotations, 0);
  const std::array<float, 3> left = phone_angles(rotations, 3);
  const std::array<float, 3> right = phone_angles(rotations, 6);
  const Eigen::Vector3f place = state.upright_from_head.translation();
  fmt::format_to(add, "=head#{:.6f},{:.6f},{:.6f},{:.6f},{:.6f},{:.6f}|", head[0], head[1], head[2],
                 place.x(), place.y(), place.z());
  fmt::format_to(add, "rightEye#{:.6f},{:.6f},{:.6f}|leftEye#{:.6f},{:.6f},{:.6f}|", right[0], right[1],
                 right[2], left[0], left[1], left[2]);
  replace(out, text);
}

void write_vtube_studio(const FaceState& state, std::int64_t unix_ms, std::vector<std::byte>& out) {
  const bool found = state.tracked && state.has_expression;
  std::array<float, 9> rotations{};
  std::array<float, 3> place{};
  if (found) {
    constexpr float kPerMetre = 10;
    const Eigen::Vector3f metres = state.upright_from_head.translation();
    place = {kPerMetre * metres.x(), kPerMetre * metres.y(), -kPerMetre * metres.z()};
    rotations = mesh::live_link_rotations(state.values, state.upright_from_head.linear());
  }
  std::string text =
      fmt::format(R"({{"Timestamp":{},"Hotkey":-1,"FaceFound":{},{},{},{},{},"BlendShapes":[)", unix_ms,
                  found, vector_json("Rotation", phone_angles(rotations, 0)), vector_json("Position", place),
                  vector_json("EyeLeft", phone_angles(rotations, 3)),
                  vector_json("EyeRight", phone_angles(rotations, 6)));
  for (std::size_t i = 0; found && i < state.values.size(); ++i) {
    fmt::format_to(std::back_inserter(text), R"({}{{"k":"{}","v":{:.6f}}})", i == 0 ? "" : ",",
                   mesh::kArkitNames.at(i), state.values.at(i));
  }
  replace(out, text + "]}");
}

}  // namespace facet::avatar
