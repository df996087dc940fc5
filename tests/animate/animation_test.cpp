// Key frames and walks over time, and `facet pose`, `facet animate` and `facet play` as a user meets them.

#include "animate/animation.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <fstream>
#include <iterator>
#include <thread>

#include "animate/places.hpp"
#include "camera/factory.hpp"
#include "facet/error.hpp"
#include "support/child_process.hpp"
#include "support/take_actor.hpp"

namespace facet::animate {
namespace {

using test::ChildProcess;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr std::int32_t kLip = 33 * 6 + 16;
constexpr std::int32_t kCorner = 33 * 7 + 21;
constexpr std::int32_t kBrow = 33 * 22 + 16;

class AnimationTest : public ::testing::Test {
 protected:
  std::shared_ptr<const TakeBasis> open(std::uint64_t seed, int frames = 120) const {
    return TakeBasis::open(test::record_actor(folder_.path(), seed, frames));
  }
  test::TemporaryFolder folder_;
};

KeyControl at(std::int32_t vertex, const Eigen::Vector3f& where) {
  return {std::to_string(vertex), KeyControl::How::At, where};
}

/// Largest rms speed over the face between frames, mm.
float largest_step(const Animation& animation) {
  mesh::Vertices before;
  float largest = 0;
  const double period_s = animation.basis().frame_period_s();
  for (double time_s = 0; time_s <= animation.duration_s(); time_s += period_s) {
    Pose pose;
    animation.pose(time_s, pose);
    const mesh::Vertices made = test::finest_of(animation.basis(), pose);
    EXPECT_TRUE(made.allFinite());
    if (before.cols() > 0) {
      largest = std::max(largest, (made - before).norm() / std::sqrt(static_cast<float>(made.cols())));
    }
    before = made;
  }
  return largest;
}

float largest_captured_step(const TakeBasis& basis) {
  float largest = 0;
  mesh::Vertices before = test::captured(basis, 0);
  for (std::size_t face = 1; face < static_cast<std::size_t>(basis.frame_count()); ++face) {
    const mesh::Vertices made = test::captured(basis, face);
    largest = std::max(largest, (made - before).norm() / std::sqrt(static_cast<float>(made.cols())));
    before = made;
  }
  return largest;
}

TEST_F(AnimationTest, KeysAreMetAndTheFaceMovesAsCaptured) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const auto basis = open(seed);
    KeyList list;
    for (const auto& [time_s, a, b] : {std::tuple(0.0, 10, 10), std::tuple(1.1, 60, 40),
                                       std::tuple(2.5, 90, 15), std::tuple(4.0, 30, 80)}) {
      const mesh::Vertices one = test::captured(*basis, static_cast<std::size_t>(a));
      const mesh::Vertices other = test::captured(*basis, static_cast<std::size_t>(b));
      list.keys.push_back(
          {time_s,
           {},
           {at(kLip, one.col(kLip)), at(kCorner, one.col(kCorner)), at(kBrow, other.col(kBrow))}});
    }
    for (const Pace pace : {Pace::Captured, Pace::Shortest}) {
      list.pace = pace;
      AnimationReport report;
      const Animation animation = Animation::of_keys(basis, list, report);
      EXPECT_DOUBLE_EQ(animation.duration_s(), 4.0);
      for (const Key& key : list.keys) {
        Pose pose;
        animation.pose(key.time_s, pose);
        const mesh::Vertices made = test::finest_of(*basis, pose);
        for (const KeyControl& control : key.controls) {
          EXPECT_LT((made.col(std::stoi(control.vertex)) - control.value).norm(), kMetHead_mm)
              << "seed " << seed << ", key at " << key.time_s << " s, vertex " << control.vertex;
        }
      }
      ASSERT_EQ(report.transitions.size(), 9U);
      for (const TransitionReport& one : report.transitions) {
        EXPECT_LE(one.shortest_cost, one.direct_cost + 1e-6);
        EXPECT_NEAR(one.speed, 1, pace == Pace::Captured ? 0.02 : 100);
      }
      if (pace == Pace::Captured) {
        EXPECT_LT(largest_step(animation), 1.6F * largest_captured_step(*basis)) << "seed " << seed;
      }
    }
  }
}

TEST_F(AnimationTest, FramesAsKeysAreThoseFrames) {
  const auto basis = open(2);
  KeyList list;
  list.regions = {std::to_string(kLip), std::to_string(kBrow)};
  list.keys = {{0, 20, {}}, {1, 77, {}}, {1.5, 21, {}}};
  AnimationReport report;
  const Animation animation = Animation::of_keys(basis, list, report);
  for (const Key& key : list.keys) {
    Pose pose;
    animation.pose(key.time_s, pose);
    const mesh::Vertices expected = test::captured(*basis, static_cast<std::size_t>(*key.frame));
    EXPECT_LT((test::finest_of(*basis, pose) - expected).colwise().norm().maxCoeff(), 0.1F) << key.time_s;
  }
}

TEST_F(AnimationTest, CanBeBrokenOffAtAnyTime) {
  const auto basis = open(2);
  KeyList list;
  list.regions = {std::to_string(kLip), std::to_string(kBrow)};
  list.keys = {{0, 20, {}}, {1, 77, {}}, {1.5, 21, {}}};
  std::atomic<int> asked = 0;
  AnimationReport report;
  Animation::of_keys(basis, list, report, [&] { return ++asked > 0; });
  const int all = asked;
  EXPECT_GT(all, 20) << "while keys are solved, faces compared and paths sought";
  for (const int last : {1, 2, 4, 7, all / 2, all - 1}) {
    asked = 0;
    try {
      Animation::of_keys(basis, list, report, [&] { return ++asked < last; });
      ADD_FAILURE() << last;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
    }
    EXPECT_LT(asked, last + 3) << "both threads heard of it soon";
  }
}

TEST_F(AnimationTest, ControlPointsMayComeAndGo) {
  const auto basis = open(1);
  const mesh::Vertices one = test::captured(*basis, 50);
  KeyList list;
  list.keys = {{0, {}, {at(kLip, one.col(kLip))}},
               {1, {}, {at(kBrow, one.col(kBrow)), at(kCorner, one.col(kCorner))}},
               {2, {}, {}},
               {3, 50, {}},
               {4, {}, {at(kLip, one.col(kLip))}}};
  AnimationReport report;
  const Animation animation = Animation::of_keys(basis, list, report);
  for (const Key& key : list.keys) {
    Pose pose;
    animation.pose(key.time_s, pose);
    const mesh::Vertices made = test::finest_of(*basis, pose);
    for (const KeyControl& control : key.controls) {
      EXPECT_LT((made.col(std::stoi(control.vertex)) - control.value).norm(), kMetHead_mm) << key.time_s;
    }
  }
}

TEST_F(AnimationTest, OneKeyIsAStill) {
  const auto basis = open(1, 40);
  KeyList list;
  list.keys = {{0.5, 7, {}}};
  AnimationReport report;
  const Animation animation = Animation::of_keys(basis, list, report);
  Pose pose;
  animation.pose(0.5, pose);
  EXPECT_LT((test::finest_of(*basis, pose) - test::captured(*basis, 7)).colwise().norm().maxCoeff(), 0.1F);
}

TEST_F(AnimationTest, RefusesKeysThatCantBe) {
  const auto basis = open(1, 40);
  const auto error = [&](KeyList list) -> std::string {
    try {
      AnimationReport report;
      Animation::of_keys(basis, list, report);
    } catch (const Error& thrown) {
      EXPECT_EQ(thrown.kind(), ErrorKind::Usage);
      return thrown.what();
    }
    return "no error";
  };
  KeyList list;
  EXPECT_THAT(error(list), HasSubstr("needs a key"));
  list.keys = {{0, 5, {}}, {1, 40, {}}};
  EXPECT_THAT(error(list), HasSubstr("key 2 (1 s): the take has no mesh of frame 40: it has frames 0 to 39"));
  list.keys = {{0, {}, {at(kLip, {0, 1e6F, 0})}}};
  EXPECT_THAT(error(list), HasSubstr("key 1 (0 s): vertex"));
  list.keys = {{0, {}, {at(kLip, {0, 0, 0}), at(kLip, {1, 0, 0})}}};
  EXPECT_THAT(error(list), HasSubstr("two control points are on vertex"));
  list.keys = {{0, {}, {{"mouth-middle", KeyControl::How::At, {0, 0, 0}}}}};
  EXPECT_THAT(error(list), HasSubstr("lip-lower"));
  list.keys = {{0, {}, {{"99999", KeyControl::How::Move, {0, 0, 0}}}}};
  EXPECT_THAT(error(list), HasSubstr("vertex 99999 is not on the mesh"));
}

TEST_F(AnimationTest, WalksGoOnWithoutAJerk) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const auto basis = open(seed, 240);
    for (const bool with_regions : {false, true}) {
      WalkOptions options;
      options.duration_s = 20;
      options.seed = seed;
      if (with_regions) {
        options.regions = {kLip, kBrow};
      }
      AnimationReport report;
      const Animation animation = Animation::of_walk(basis, options, report);
      EXPECT_GT(report.jumps, 1);
      EXPECT_LT(largest_step(animation), 2 * largest_captured_step(*basis)) << "seed " << seed;
      AnimationReport ignored;
      const Animation again = Animation::of_walk(basis, options, ignored);
      Pose a;
      Pose b;
      animation.pose(13.37, a);
      again.pose(13.37, b);
      EXPECT_EQ(a.state, b.state);
    }
  }
}

/// `facet` itself.
class AnimateCommand : public AnimationTest {
 protected:
  int run(const std::vector<std::string>& arguments, const test::Birth& birth = {}) {
    ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log", birth);
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  std::vector<std::string> files() const {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder_.path())) {
      names.push_back(entry.path().filename());
    }
    std::sort(names.begin(), names.end());
    return names;
  }
  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }
  std::string file(const std::string& name, const std::string& text) const {
    std::ofstream(file(name)) << text;
    return file(name);
  }
  std::string bytes(const std::string& name) const {
    std::ifstream stream(file(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
  }
  std::string output_;
};

TEST_F(AnimateCommand, PosesAndSaysHowWell) {
  const std::string take = test::record_actor(folder_.path(), 1, 60);
  ASSERT_EQ(run({"pose", take, "--places"}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("lip-lower    vertex"));
  // Where two captured faces have them.
  const auto basis = TakeBasis::open(take);
  const std::int32_t lip = find_vertex(*basis, "lip-lower");
  const std::int32_t brow = find_vertex(*basis, "brow-left");
  const Eigen::Vector3f lip_mm = test::captured(*basis, 45).col(lip);
  const Eigen::Vector3f brow_mm = test::captured(*basis, 20).col(brow);
  ASSERT_EQ(run({"pose", "--control", fmt::format("lip-lower={},{},{}", lip_mm.x(), lip_mm.y(), lip_mm.z()),
                 "--control", fmt::format("brow-left={},{},{}", brow_mm.x(), brow_mm.y(), brow_mm.z()), take,
                 "-o", file("pose.glb")}),
            0)
      << output_;
  EXPECT_THAT(output_, HasSubstr("lip-lower: 0.0"));
  EXPECT_THAT(output_, HasSubstr("brow-left: 0.0"));
  EXPECT_THAT(output_, Not(HasSubstr("can't be met")));
  const std::vector<std::string> far = {"pose", "--move", "lip-lower=30,-40,9", take, "-o", file("far.glb")};
  ASSERT_EQ(run(far), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("pulled back, the target was"));
  EXPECT_THAT(output_, Not(HasSubstr("can't be met")));
  EXPECT_THAT(output_, Not(HasSubstr("warning")));
  std::vector<std::string> beyond = far;
  beyond.emplace_back("--beyond");
  ASSERT_EQ(run(beyond), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("lip-lower can't be met"));
  EXPECT_THAT(output_, HasSubstr("outside what was captured"));
  // A corner pulled up while the lip is pulled down: met, and no face.
  ASSERT_EQ(run({"pose", take, "--beyond", "--move", "lip-lower=0,-25,0", "--move", "mouth-left=0,12,0", "-o",
                 file("far.glb")}),
            0)
      << output_;
  EXPECT_THAT(output_, HasSubstr("warning: the region of lip-lower is"));
  EXPECT_EQ(bytes("pose.glb").substr(0, 4), "glTF");
  EXPECT_EQ(run({"pose", take, "--control", "lip-lower=0,nan,0", "-o", file("x.ply")}), 2);
  EXPECT_THAT(output_, HasSubstr("is not 3 numbers"));
  EXPECT_EQ(run({"pose", take, "--control", "5=0,0,1e9", "-o", file("x.ply")}), 2);
  EXPECT_EQ(run({"pose", take, "--control", "5:0,0,1", "-o", file("x.ply")}), 2);
  EXPECT_EQ(run({"pose", take, "-o", file("x.stl")}), 2);
  EXPECT_EQ(run({"pose", file("none.take"), "-o", file("x.ply")}), 3);
}

TEST_F(AnimateCommand, MakesTakesThatOtherCommandsRead) {
  const std::string take = test::record_actor(folder_.path(), 2, 60);
  const std::string keys = file("keys.json", R"({"keys": [{"time_s": 0, "frame": 5},
      {"time_s": 0.8, "controls": [{"vertex": "lip-lower", "move_mm": [0, -5, 0]}, {"vertex": "mouth-left", "move_mm": [1, 1, 0]}]},
      {"time_s": 1.5, "frame": 40}]})");
  ASSERT_EQ(run({"animate", take, "--keys", keys, "-o", file("anim.take"), "--report"}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("worst transition"));
  take::TakeReader reader(file("anim.take"));
  EXPECT_EQ(reader.info().mesh_frame_count, 45);
  EXPECT_TRUE(reader.info().closed);
  EXPECT_EQ(run({"export", file("anim.take"), "--format", "ply", "--frames", "3:5", "-o", file("meshes")}), 0)
      << output_;
  EXPECT_EQ(run({"summary", file("anim.take")}), 0) << output_;
  // An animation can be animated.
  EXPECT_EQ(run({"animate", file("anim.take"), "--walk", "2s", "--seed", "3", "-o", file("walk.take")}), 0)
      << output_;
  EXPECT_EQ(take::TakeReader(file("walk.take")).info().mesh_frame_count, 60);
  ASSERT_EQ(run({"animate", take, "--walk", "1s", "--head", "captured", "-o", file("walk.glb")}), 0)
      << output_;
  EXPECT_THAT(bytes("walk.glb"), HasSubstr("\"animations\""));
  // A film: as many pictures, and the face is in the middle of them.
  ASSERT_EQ(run({"animate", take, "--walk", "1s", "-o", file("walk.mkv")}), 0) << output_;
  const auto film = camera::open_camera({.kind = "file", .path = file("walk.mkv")});
  film->start();
  int pictures = 0;
  for (Frame frame; film->next(frame, std::chrono::seconds(10)) == CaptureOutcome::Delivered; ++pictures) {
    const auto brightness = [&](int x, int y) { return int{frame.row(y)[4 * x]}; };
    EXPECT_NE(brightness(frame.width_px / 2, frame.height_px / 2), brightness(2, 2)) << pictures;
  }
  EXPECT_EQ(pictures, 30);
  // Never over another take, and not without knowing what.
  EXPECT_EQ(run({"animate", take, "--walk", "1s", "-o", file("walk.take")}), 6) << output_;
  EXPECT_EQ(run({"animate", take, "-o", file("no.take")}), 2);
  EXPECT_EQ(run({"animate", take, "--walk", "-3s", "-o", file("no.take")}), 2);
  EXPECT_EQ(run({"animate", take, "--keys", file("bad.json", R"({"keys": []})"), "-o", file("no.take")}), 2);
  EXPECT_THAT(output_, HasSubstr("needs a key"));
  EXPECT_FALSE(std::filesystem::exists(file("no.take")));
}

TEST_F(AnimateCommand, ASignalWhileItPreparesLeavesNothing) {
  const std::string take = test::record_actor(folder_.path(), 1, 60);
  const std::string keys =
      file("keys.json", R"({"keys": [{"time_s": 0, "frame": 5}, {"time_s": 1, "frame": 40}]})");
  const std::vector<std::vector<std::string>> commands = {
      {"pose", take, "--move", "lip-lower=0,-5,0", "-o", file("out.glb")},
      {"animate", take, "--keys", keys, "-o", file("out.take")},
      {"animate", take, "--walk", "2s", "--region", "lip-lower", "-o", file("out.mkv")}};
  const std::vector<std::string> before = {"actor1.take", "keys.json", "log"};
  // The signal comes at the first look: while the take is reduced, and where that was done before, while the
  // pose is solved or faces are compared.
  for (const bool reduced : {false, true}) {
    std::vector<std::string> expected = before;
    if (reduced) {
      ASSERT_EQ(run({"pose", take, "--places"}), 0) << output_;
      expected.insert(expected.begin(), "actor1.basis");
    }
    for (const int signal : {SIGINT, SIGTERM}) {
      for (const std::vector<std::string>& command : commands) {
        EXPECT_EQ(run(command, {.environment = {}, .pending_signal = signal}), 128 + signal) << output_;
        EXPECT_THAT(output_, HasSubstr("broken off"));
        EXPECT_THAT(output_, HasSubstr(reduced ? command.back() : take));
        EXPECT_EQ(files(), expected);
      }
    }
  }
}

TEST_F(AnimateCommand, ASignalWhileItWritesLeavesNothing) {
  const std::string take = test::record_actor(folder_.path(), 1, 60);
  ASSERT_EQ(run({"pose", take, "--places"}), 0) << output_;
  const std::vector<std::string> before = files();
  // More than some minutes are refused for a GLB file before it is begun.
  const std::vector<std::pair<std::string, std::string>> long_ones = {
      {"long.take", "60min"}, {"long.glb", "2min"}, {"long.mkv", "60min"}};
  for (const auto& [name, length] : long_ones) {
    ChildProcess child(FACET_PROGRAM, {"animate", take, "--walk", length, "-o", file(name)},
                       folder_.path() / "log");
    for (int tries = 0; tries < 1200 && child.running() && files() == before; ++tries) {
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    ASSERT_TRUE(child.running()) << child.output();
    EXPECT_NE(files(), before) << name << " is begun";
    child.send(SIGINT);
    EXPECT_EQ(child.wait(), 128 + SIGINT) << child.output();
    EXPECT_THAT(child.output(), HasSubstr("broken off"));
    EXPECT_EQ(files(), before) << name;
  }
}

TEST_F(AnimateCommand, PlaysATakeOnASocket) {
  const std::string take = test::record_actor(folder_.path(), 1, 20);
  ChildProcess player(FACET_PROGRAM, {"play", take, "--socket", file("stream"), "--wait"},
                      folder_.path() / "player");
  for (int tries = 0; tries < 200 && !std::filesystem::exists(file("stream")); ++tries) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  ASSERT_EQ(run({"watch", "--socket", file("stream")}), 0) << output_;
  EXPECT_EQ(player.wait(), 0);
  EXPECT_THAT(output_, HasSubstr("frames"));
}

}  // namespace
}  // namespace facet::animate
