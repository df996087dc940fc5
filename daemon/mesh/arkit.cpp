#include "mesh/arkit.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstddef>

namespace facet::mesh {
namespace {

constexpr float kRadiansPerDegree = 0.017453293F;
/// How far the default model's eyeballs turn at weight 1 (docs/face-model.md).
constexpr float kLookUp = 25.0F * kRadiansPerDegree;
constexpr float kLookDown = 28.0F * kRadiansPerDegree;
constexpr float kLookAside = 30.0F * kRadiansPerDegree;

}  // namespace

int arkit_index(std::string_view name) {
  const auto found = std::find_if(kArkitNames.begin(), kArkitNames.end(), [name](std::string_view known) {
    return name.size() == known.size() && !name.empty() && name.substr(1) == known.substr(1) &&
           std::toupper(static_cast<unsigned char>(name[0])) == known[0];
  });
  return found == kArkitNames.end() ? -1 : static_cast<int>(found - kArkitNames.begin());
}

std::string arkit_name(std::size_t index) {
  std::string name(kArkitNames.at(index));
  name[0] = static_cast<char>(std::tolower(static_cast<unsigned char>(name[0])));
  return name;
}

ArkitValues arkit_values(std::span<const std::string> names, std::span<const float> expression) {
  ArkitValues values{};
  for (std::size_t i = 0; i < std::min(names.size(), expression.size()); ++i) {
    if (const int index = arkit_index(names[i]); index >= 0) {
      values.at(static_cast<std::size_t>(index)) = std::clamp(expression[i], 0.0F, 1.0F);
    }
  }
  return values;
}

std::array<float, 3> live_link_angles(const Eigen::Matrix3f& upright_from_head) {
  // R = Ry Rx Rz, right-handed about y up, x to the subject's left and z out of the face. Unreal's frame (x
  // away from the viewer, y to the viewer's right, z up) is its mirror image: rotations about y and z change
  // their sign.
  const auto& r = upright_from_head;
  const float about_x = std::asin(std::clamp(-r(1, 2), -1.0F, 1.0F));
  const float about_y = std::atan2(r(0, 2), r(2, 2));
  const float about_z = std::atan2(r(1, 0), r(1, 1));
  return {-about_y, about_x, -about_z};
}

std::array<float, 9> live_link_rotations(const ArkitValues& values,
                                         const Eigen::Matrix3f& upright_from_head) {
  const auto value = [&values](std::string_view name) {
    return values.at(static_cast<std::size_t>(arkit_index(name)));
  };
  const std::array<float, 3> head = live_link_angles(upright_from_head);
  return {head[0],
          head[1],
          head[2],
          kLookAside * (value("EyeLookInLeft") - value("EyeLookOutLeft")),
          kLookDown * value("EyeLookDownLeft") - kLookUp * value("EyeLookUpLeft"),
          0.0F,
          kLookAside * (value("EyeLookOutRight") - value("EyeLookInRight")),
          kLookDown * value("EyeLookDownRight") - kLookUp * value("EyeLookUpRight"),
          0.0F};
}

}  // namespace facet::mesh
