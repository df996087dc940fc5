#include "camera/factory.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "camera/contained_camera.hpp"
#include "camera/simulated_devices.hpp"
#include "camera/v4l2_camera.hpp"
#include "camera/video_file.hpp"
#include "facet/error.hpp"

namespace facet::camera {

std::span<const CameraKind* const> camera_kinds() {
  static constexpr std::array kKinds = {
      &kVideoFile,
      &kV4l2Camera,
      &kLibcamera,
      &kSimulatedCamera,
  };
  return kKinds;
}

const CameraSetting* CameraKind::find(std::string_view key) const {
  const auto at = std::find_if(settings.begin(), settings.end(),
                               [&](const CameraSetting& setting) { return setting.key == key; });
  return at != settings.end() ? &*at : nullptr;
}

bool CameraKind::says(std::string_view key, CameraConfig config) const {
  return std::visit(
      [&](auto place) {
        if constexpr (requires { place(config).has_value(); }) {
          return place(config).has_value();
        } else if constexpr (requires { place(config).empty(); }) {
          return !place(config).empty();
        } else {
          return true;
        }
      },
      find(key)->place);
}

const CameraKind& camera_kind(std::string_view name) {
  std::vector<const char*> known;
  for (const CameraKind* kind : camera_kinds()) {
    if (kind->name == name) {
      return *kind;
    }
    known.push_back(kind->name);
  }
  throw Error(ErrorKind::Usage,
              fmt::format("unknown kind of camera \"{}\"; known: {}", name, fmt::join(known, ", ")));
}

bool names_source(const CameraConfig& config) {
  const CameraKind& kind = camera_kind(config.kind);
  return kind.needs == nullptr || kind.says(kind.needs, config);
}

std::unique_ptr<Camera> open_camera(const CameraConfig& config) {
  return turn_pictures(camera_kind(config.kind).open(config), config.turn);
}

}  // namespace facet::camera
