// `facet calibrate` and `facet rig` as a user meets them, on rendered pictures of a board before two cameras.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <fstream>
#include <memory>
#include <thread>

#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "render/renderer.hpp"
#include "stream/server.hpp"
#include "support/board_views.hpp"
#include "support/child_process.hpp"
#include "support/paths.hpp"
#include "take/recorder.hpp"

namespace facet::tools {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr int kViews = 14;

/// Rendered once for all cases.
class Calibrate : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    shots_ = std::make_unique<test::TemporaryFolder>();
    truth_ = std::make_unique<capture::Rig>(calibration::booth_rig(12));
    truth_->cameras.resize(2);
    truth_->pairs = {{0, 1}};
    const auto poses = calibration::held_board_poses({}, kViews, 4);
    simulation::Random random(9, 9);
    sets_.assign(kViews, {});
    const auto names = std::make_shared<std::vector<std::string>>();
    for (const capture::RigCamera& camera : truth_->cameras) {
      names->push_back(camera.name);
      std::filesystem::create_directory(shots_->path() / camera.name);
      const calibration::BoardCamera photographer({}, camera.lens);
      for (int i = 0; i < kViews; ++i) {
        const Frame frame = photographer.take(poses[static_cast<std::size_t>(i)], {}, random);
        render::write_png(render::to_picture(frame),
                          shots_->path() / camera.name / fmt::format("{:03}.png", i));
        sets_[static_cast<std::size_t>(i)].frames.push_back(frame);
      }
    }
    for (FrameSet& set : sets_) {
      set.camera_names = names;
    }
  }
  static void TearDownTestSuite() {
    shots_.reset();
    truth_.reset();
    sets_.clear();
  }

  int run(std::vector<std::string> arguments) {
    test::ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log");
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }
  static std::string shots(const std::string& camera) { return (shots_->path() / camera).string(); }

  /// A rig file that came of the pictures: focal lengths to 0.1 %, the baseline to 0.1 mm.
  void expect_truth(const std::string& name) const {
    const capture::Rig rig = capture::read_rig(file(name));
    ASSERT_EQ(rig.cameras.size(), 2U);
    ASSERT_EQ(rig.pairs.size(), 1U);
    EXPECT_EQ(rig.pairs[0].left, 0U);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_EQ(rig.cameras[i].name, truth_->cameras[i].name);
      EXPECT_NEAR(rig.cameras[i].lens.fx_px / truth_->cameras[i].lens.fx_px, 1, 1e-3);
    }
    const auto baseline = [](const capture::Rig& one) {
      return (one.cameras[0].lens.centre_mm() - one.cameras[1].lens.centre_mm()).norm();
    };
    EXPECT_NEAR(baseline(rig), baseline(*truth_), 0.1);
  }

  /// The sets as a camera at 60 fps sees a board that is held still, then moved on.
  static std::shared_ptr<const mesh::MeshFrame> frame_of(std::uint64_t slot) {
    auto set = std::make_shared<FrameSet>(sets_[slot / 2 % kViews]);
    set->slot = slot;
    set->trigger_ns = static_cast<std::int64_t>(slot) * 16'666'667;
    auto frame = std::make_shared<mesh::MeshFrame>();
    frame->sequence = slot;
    frame->timestamp_ns = set->trigger_ns;
    frame->images = std::move(set);
    return frame;
  }

  static inline std::unique_ptr<test::TemporaryFolder> shots_;
  static inline std::unique_ptr<capture::Rig> truth_;
  static inline std::vector<FrameSet> sets_;
  const test::TemporaryFolder folder_;
  std::string output_;
};

TEST_F(Calibrate, PicturesBecomeARigFile) {
  ASSERT_EQ(run({"calibrate", "pictures", "left-a=" + shots("left-a"), "left-b=" + shots("left-b"), "-o",
                 file("rig.toml")}),
            0)
      << output_;
  EXPECT_THAT(output_,
              AllOf(HasSubstr("left-a | left-b"), HasSubstr("reprojection error 0.0"), HasSubstr("1 pair")));
  expect_truth("rig.toml");
  EXPECT_TRUE(std::filesystem::exists(file("rig-coverage.png")));
  EXPECT_TRUE(std::filesystem::exists(file("rig-errors.png")));
  ASSERT_EQ(run({"rig", "show", file("rig.toml")}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("baseline"));
  // There and back through the others' files.
  ASSERT_EQ(run({"rig", "convert", file("rig.toml"), "--to", "kalibr", "-o", file("chain.yaml")}), 0)
      << output_;
  ASSERT_EQ(run({"rig", "convert", file("rig.toml"), "--to", "opencv", "-o", file("cv")}), 0) << output_;
  ASSERT_EQ(run({"rig", "convert", file("cv/intrinsics.yml"), "--extrinsics", file("cv/extrinsics.yml"), "-o",
                 file("b.toml")}),
            0)
      << output_;
  const capture::Rig back = capture::read_rig(file("b.toml"));
  EXPECT_EQ(back.cameras[1].lens.fx_px, capture::read_rig(file("rig.toml")).cameras[1].lens.fx_px);
}

TEST_F(Calibrate, ATakeBecomesARigFile) {
  take::TakeRecorder recorder({.file = file("board.take"),
                               .source = "booth",
                               .software = "test",
                               .when_full = take::WhenFull::Wait,
                               .disk_reserve_bytes = 0,
                               .with_images = true});
  recorder.start();
  for (std::uint64_t slot = 0; slot < 2 * kViews; ++slot) {
    recorder.record(frame_of(slot));
  }
  recorder.stop();
  ASSERT_EQ(run({"calibrate", "take", file("board.take"), "-o", file("rig.toml"), "--save", file("kept")}), 0)
      << output_;
  expect_truth("rig.toml");
  EXPECT_EQ(
      run({"calibrate", "take", file("board.take"), "-o", file("none.toml"), "--dictionary", "6X6_250"}),
      static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, HasSubstr("no view was taken"));
  // What was kept gives the same rig again.
  ASSERT_EQ(run({"calibrate", "pictures", "left-a=" + file("kept/left-a"), "left-b=" + file("kept/left-b"),
                 "-o", file("again.toml")}),
            0)
      << output_;
  EXPECT_EQ(capture::format_rig(capture::read_rig(file("again.toml"))),
            capture::format_rig(capture::read_rig(file("rig.toml"))));
}

TEST_F(Calibrate, ARunningDaemonsStreamBecomesARigFile) {
  stream::StreamServerConfig config;
  config.socket = file("stream.sock");
  stream::StreamServer server(config);
  server.start();
  std::jthread publisher([&](const std::stop_token& stop) {
    // Each frame once the reader has begun with the one before, however slow the machine is.
    for (std::uint64_t slot = 0; !stop.stop_requested();) {
      const stream::StreamStatistics now = server.statistics();
      const std::uint64_t sent = now.readers.empty() ? 0 : now.readers[0].frames_sent;
      if (!now.readers.empty() && now.readers[0].subscribed && sent >= slot) {
        server.publish(frame_of(slot++));
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  });
  EXPECT_EQ(
      run({"calibrate", "live", "--socket", file("stream.sock"), "--views", "10", "-o", file("rig.toml")}), 0)
      << output_;
  publisher.request_stop();
  publisher.join();
  server.request_stop();
  server.stop();
  expect_truth("rig.toml");
}

TEST_F(Calibrate, BadInputIsNamed) {
  const auto from = [&](const std::string& left, const std::string& right,
                        std::vector<std::string> more = {}) {
    std::vector<std::string> words = {"calibrate",       "pictures", "left-a=" + left,
                                      "left-b=" + right, "-o",       file("rig.toml")};
    words.insert(words.end(), more.begin(), more.end());
    return run(words);
  };
  const int usage = static_cast<int>(ErrorKind::Usage);
  const int unreadable = static_cast<int>(ErrorKind::UnreadableInput);
  EXPECT_EQ(from(shots("left-a"), file("nowhere")), unreadable);
  EXPECT_THAT(output_, HasSubstr("nowhere"));
  // Another board than that in the pictures.
  EXPECT_EQ(from(shots("left-a"), shots("left-b"), {"--dictionary", "6X6_250"}), unreadable);
  EXPECT_THAT(output_,
              AllOf(HasSubstr("camera 'left-a'"), HasSubstr("no marker"), HasSubstr("--dictionary")));
  // Swapped cameras.
  EXPECT_EQ(from(shots("left-b"), shots("left-a"), {"--pair", "left-a:left-b"}), usage);
  EXPECT_THAT(output_, HasSubstr("swapped"));
  // Folders of different moments.
  std::filesystem::create_directory(file("other"));
  std::filesystem::copy(shots("left-b") + "/000.png", file("other/x000.png"));
  EXPECT_EQ(from(shots("left-a"), file("other")), unreadable);
  EXPECT_THAT(output_, HasSubstr("belong to one moment"));
  // A picture that is none.
  std::ofstream(file("other/000.png")) << "no picture";
  EXPECT_EQ(from(shots("left-a"), file("other")), unreadable);
  EXPECT_THAT(output_, HasSubstr("other/000.png"));
  EXPECT_FALSE(std::filesystem::exists(file("rig.toml")));
  EXPECT_EQ(from(shots("left-a"), shots("left-b"), {"--squares", "9"}), usage);
  EXPECT_THAT(output_, HasSubstr("COLUMNSxROWS"));
  EXPECT_EQ(run({"calibrate", "pictures", "left-a", "-o", file("rig.toml")}), usage);
  EXPECT_THAT(output_, HasSubstr("CAMERA=FOLDER"));
}

TEST_F(Calibrate, TheBoardIsDrawn) {
  ASSERT_EQ(run({"calibrate", "board", "-o", file("board.pdf"), "--square-mm", "25"}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("250 x 200 mm"));
  ASSERT_EQ(
      run({"calibrate", "board", "-o", file("board.png"), "--board", "checkerboard", "--squares", "10x7"}), 0)
      << output_;
  EXPECT_EQ(render::read_image(file("board.png")).width_px, 2200);
  EXPECT_EQ(run({"calibrate", "board", "-o", file("board.gif")}), static_cast<int>(ErrorKind::Usage));
}

}  // namespace
}  // namespace facet::tools
