#include "calibration/footage.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "support/board_views.hpp"
#include "support/paths.hpp"

namespace facet::calibration {
namespace {

using simulation::Random;
using Verdict = ViewPicker::Verdict;

Frame board_picture(const Board& board, const BoardDetector& detector) {
  const capture::Rig rig = booth_rig(3);
  const BoardCamera camera(board, rig.cameras[0].lens);
  Random random(11, 0);
  for (const Eigen::Isometry3d& pose : held_board_poses(board, 8, 5)) {
    if (Frame frame = camera.take(pose, {}, random); detector.detect(frame).usable()) {
      return frame;
    }
  }
  return {};
}

FrameSet set_of(std::uint64_t slot, std::vector<Frame> frames) {
  FrameSet set;
  set.slot = slot;
  set.camera_names = std::make_shared<std::vector<std::string>>(std::vector<std::string>{"left", "right"});
  set.frames = std::move(frames);
  return set;
}

TEST(SetCollector, KeepsASetAtRestAndItsPictures) {
  const test::TemporaryFolder folder;
  const Board board;
  const BoardDetector detector(board);
  const Frame frame = board_picture(board, detector);
  ASSERT_FALSE(frame.empty());
  SetCollector collector(detector, folder.path());
  EXPECT_EQ(collector.offer(set_of(6, {frame, frame})), Verdict::Moving);
  EXPECT_EQ(collector.kept(), 0U);
  EXPECT_EQ(collector.offer(set_of(9, {frame, frame})), Verdict::Kept);
  EXPECT_EQ(collector.offer(set_of(12, {frame, frame})), Verdict::SeenBefore);
  ASSERT_EQ(collector.kept(), 1U);
  EXPECT_EQ(collector.footage().views[0].name, "slot 9");
  EXPECT_EQ(collector.footage().cameras[1].name, "right");
  EXPECT_EQ(collector.footage().cameras[1].width_px, frame.width_px);
  EXPECT_GT(collector.coverage()[1].part(), 0);
  EXPECT_TRUE(std::filesystem::exists(folder.path() / "left" / "00000009.png"));
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "left" / "00000006.png"));
  EXPECT_THROW(collector.offer(set_of(15, {frame})), Error);
}

TEST(Footage, ACamerasPicturesHaveOneSize) {
  const Frame large = render::to_frame(render::plain_picture(32, 24, {128, 128, 128}));
  const Frame small = render::to_frame(render::plain_picture(16, 24, {128, 128, 128}));
  const Frame red = render::to_frame(render::plain_picture(32, 24, {230, 20, 20}));
  CalibrationCamera camera{"left", 0, 0, false};
  admit(camera, large, "first");
  EXPECT_EQ(camera.width_px, 32);
  EXPECT_FALSE(camera.colour);
  admit(camera, red, "second");
  EXPECT_TRUE(camera.colour);
  EXPECT_THROW(admit(camera, small, "third"), Error);
  EXPECT_TRUE(has_all_pictures(set_of(1, {large, small})));
  EXPECT_FALSE(has_all_pictures(set_of(1, {large, Frame{}})));
  EXPECT_FALSE(has_all_pictures(FrameSet{}));
}

}  // namespace
}  // namespace facet::calibration
