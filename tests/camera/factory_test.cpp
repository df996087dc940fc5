#include "camera/factory.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>
#include <string>
#include <string_view>

#include "camera/contained_camera.hpp"
#include "camera/simulated_devices.hpp"
#include "facet/error.hpp"

namespace facet::camera {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;

std::set<std::string_view> keys_of(const CameraKind& kind) {
  std::set<std::string_view> keys;
  for (const CameraSetting& setting : kind.settings) {
    EXPECT_TRUE(keys.insert(setting.key).second) << kind.name << " has " << setting.key << " twice";
  }
  return keys;
}

TEST(CameraKinds, ARowNamesItsOwnKeys) {
  std::set<std::string_view> names;
  for (const CameraKind* kind : camera_kinds()) {
    EXPECT_TRUE(names.insert(kind->name).second) << kind->name;
    const std::set<std::string_view> keys = keys_of(*kind);
    EXPECT_FALSE(keys.empty()) << kind->name;
    EXPECT_NE(kind->open, nullptr) << kind->name;
    EXPECT_EQ(kind->needs != nullptr, kind->advice != nullptr) << kind->name;
    EXPECT_TRUE(kind->needs == nullptr || keys.contains(kind->needs)) << kind->name;
    if (kind->pair) {
      EXPECT_TRUE(keys.contains((*kind->pair)[0]) && keys.contains((*kind->pair)[1])) << kind->name;
    }
    for (const CameraSetting& setting : kind->settings) {
      EXPECT_LE(setting.least, setting.most) << kind->name << "." << setting.key;
    }
  }
}

TEST(CameraKinds, AnUnknownOneIsToldTheKnown) {
  try {
    open_camera({.kind = "webcam"});
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    EXPECT_THAT(error.what(),
                HasSubstr("unknown kind of camera \"webcam\"; known: file, v4l2, libcamera, simulated"));
  }
}

TEST(CameraKinds, ASourceIsNamedByWhatItsKindNeeds) {
  EXPECT_FALSE(names_source({.kind = "file"}));
  EXPECT_TRUE(names_source({.kind = "file", .path = "a.mp4"}));
  EXPECT_FALSE(names_source({.kind = "v4l2", .path = "a.mp4"}));
  EXPECT_TRUE(names_source({.kind = "v4l2", .live = {.device = "/dev/video0"}}));
  EXPECT_TRUE(names_source({.kind = "libcamera"}));
  EXPECT_TRUE(names_source({.kind = "simulated"}));
  EXPECT_TRUE(kLibcamera.says("red_gain", {.libcamera = {.red_gain = 2}}));
  EXPECT_FALSE(kLibcamera.says("red_gain", {}));
}

TEST(CameraKinds, ASimulatedOneRunsByItself) {
  const auto camera =
      open_camera({.kind = "simulated", .live = {.width_px = 64, .height_px = 48, .rate_hz = 500}});
  EXPECT_EQ(camera->info().name, "simulated camera");
  EXPECT_EQ(camera->info().rate_hz, 500);
  camera->start();
  Frame frame;
  for (std::uint64_t i = 0; i < 3; ++i) {
    ASSERT_EQ(camera->next(frame, 1s), CaptureOutcome::Delivered);
    EXPECT_EQ(simulated::read_marker(frame, simulated::Marker::Count), i);
  }
  EXPECT_EQ(frame.height_px, 48);
}

}  // namespace
}  // namespace facet::camera
