#include "service/config.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <iterator>
#include <map>
#include <regex>
#include <set>
#include <sstream>

#include "facet/error.hpp"
#include "service/modes.hpp"
#include "support/paths.hpp"

namespace facet::service {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::StartsWith;

std::string error_of(const std::string& text) {
  try {
    parse_config(text, "/etc/facet/facet.toml");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "no error";
}

std::string sample(const std::string& name = "facet.toml") {
  std::ifstream file(std::filesystem::path(FACET_SOURCE_DIR) / "config" / name);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

TEST(Config, EmptyFileIsTheDefault) {
  const Config config = parse_config("", "facet.toml");
  EXPECT_EQ(config.pipeline.gpu_device, "auto");
  EXPECT_EQ(config.control.socket, "/run/facet/control.sock");
  EXPECT_EQ(config.stream.socket, "/run/facet/stream.sock");
  EXPECT_EQ(config.log_level, LogLevel::Info);
  EXPECT_FALSE(config.pipeline.tracker.intrinsics.has_value());
}

/// The sample's [source] as it is for a camera: the keys of files and of the other kind taken out, those of
/// cameras let in.
std::string camera_sample(const std::string& kind = "v4l2",
                          const std::string& others = "id|red_gain|blue_gain") {
  std::string text = sample();
  text = text.substr(0, text.find("#[source.intrinsics]"));
  text = std::regex_replace(text, std::regex("\nkind = \"file\""), "\nkind = \"" + kind + "\"");
  text = std::regex_replace(text, std::regex("\n#([a-z0-9_]+ = )"), "\n$1");
  return std::regex_replace(text, std::regex("\n(path|paced|loop|" + others + ") = [^\n]*"), "");
}

using Values = std::map<std::string, files::TomlKey>;

/// What a text makes of the keys; of sections that stand more than once, the first.
Values values_of(const std::string& text) {
  Values values;
  for (files::TomlKey& key : config_values(text, "/sample/facet.toml")) {
    values.emplace(key.name, std::move(key));
  }
  return values;
}

std::string of_kind(const camera::CameraKind& kind) {
  return fmt::format("[source]\nkind = \"{}\"\n", kind.name);
}

/// The part of a sample that shows a key: the comment above it, with the keys that share it, and its line.
/// Empty: the sample has none.
std::string shown_part(const std::string& text, const std::string& key) {
  const std::size_t dot = key.rfind('.');
  const std::string section = dot == std::string::npos ? "" : key.substr(0, dot);
  const std::regex header("#?\\[+([a-z_.]+)\\]+");
  const std::regex assignment("#?([a-z0-9_]+) = .*");
  std::istringstream lines(text);
  std::string now;
  std::string part;
  bool keys_begun = true;
  std::smatch match;
  for (std::string line; std::getline(lines, line);) {
    if (std::regex_match(line, match, header)) {
      now = match[1];
      part.clear();
    } else if (std::regex_match(line, match, assignment)) {
      keys_begun = true;
      if (now == section && match[1] == key.substr(dot + 1)) {
        return part + line;
      }
    } else {
      part = keys_begun ? line : part + " " + line;
      keys_begun = false;
    }
  }
  return "";
}

/// A sample shows the defaults but of what has none, and an example's own.
void expect_defaults(const std::string& text, const std::string& bare, const std::set<std::string>& others) {
  const Values shown = values_of(text);
  for (const auto& [name, key] : values_of(bare)) {
    const auto found = shown.find(name);
    ASSERT_NE(found, shown.end()) << name;
    if (key.value && found->second.value && !others.contains(name)) {
      EXPECT_EQ(*found->second.value, *key.value) << name;
    }
  }
}

TEST(Config, SamplesShowTheDefaults) {
  expect_defaults(sample(), "", {"source.path"});
  EXPECT_EQ(parse_config(sample(), "/sample/facet.toml").pipeline.source.path, "/sample/video.mp4");
  expect_defaults(sample("expert.toml"), "", {});
  expect_defaults(
      sample("devices.toml"), "[[camera]]\nname = \"a\"\nkind = \"simulated\"\n[[trigger.line]]\n",
      {"camera.name", "camera.width_px", "camera.height_px", "camera.rate_hz", "trigger.line.name"});
  expect_defaults(camera_sample(), "[source]\nkind = \"v4l2\"\n", {"source.device"});
  expect_defaults(camera_sample("libcamera", "device"), "[source]\nkind = \"libcamera\"\n", {"source.id"});
  const Config shown = parse_config(sample(), "/sample/facet.toml");
  const Config defaults = parse_config("", "/sample/facet.toml");
  EXPECT_EQ(shown.pipeline.refiner.budget, defaults.pipeline.refiner.budget);
  EXPECT_EQ(shown.pipeline.frames.end, defaults.pipeline.frames.end);
  EXPECT_EQ(shown.stream.access.mode, defaults.stream.access.mode);
  EXPECT_EQ(shown.control.access.mode, defaults.control.access.mode);
  EXPECT_EQ(shown.web.listen, defaults.web.listen);
  EXPECT_EQ(shown.metrics.listen, defaults.metrics.listen);
  EXPECT_EQ(shown.web.token_file, defaults.web.token_file);
  EXPECT_EQ(shown.log_level, defaults.log_level);
}

/// Each key stands in one sample, those for experts in expert.toml, and what a sample says of its bounds is
/// so.
TEST(Config, SamplesShowEveryKeyWithItsBounds) {
  const std::string experts = sample("expert.toml");
  const std::string others = sample() + sample("devices.toml");
  for (const camera::CameraKind* kind : camera::camera_kinds()) {
    for (const auto& [name, key] : values_of(of_kind(*kind))) {
      const bool expert = name.starts_with("expert.");
      const std::string part = shown_part(expert ? experts : others, name);
      EXPECT_FALSE(part.empty()) << name << " is in no sample";
      EXPECT_EQ(shown_part(expert ? others : experts, name), "") << name;
      // A [[camera]] is described as [source] is.
      const bool as_in_source = name.starts_with("camera.") && name != "camera.latency_us";
      if (key.least != key.most && !as_in_source) {
        const std::regex bounds(fmt::format("{}( \\([a-z ]+\\))? to {}(?![0-9])", key.least, key.most));
        EXPECT_TRUE(std::regex_search(part, bounds))
            << name << " is from " << key.least << " to " << key.most << "; its sample says: " << part;
      }
    }
  }
}

/// A key that has moved is read at its old place, with a warning that names file, line and the new one.
TEST(Config, KeysForExpertsHaveMoved) {
  const Config moved = parse_config(
      "[source]\nkind = \"v4l2\"\nbuffers = 9\n[tracker]\nacquisition_frames = 3\n[refiner]\npcg_iterations "
      "= 4\n"
      "[refiner.weights]\nalbedo_smooth = 5\n[stream]\nmax_readers = 6\n[sets]\ndeadline_ms = 7\n",
      "f.toml");
  EXPECT_EQ(moved.pipeline.source.live.buffers, 9U);
  EXPECT_EQ(moved.pipeline.tracker.acquisition_frames, 3);
  EXPECT_EQ(moved.pipeline.refiner.pcg_iterations, 4);
  EXPECT_EQ(moved.pipeline.refiner.weights.albedo_smooth, 5);
  EXPECT_EQ(moved.stream.max_readers, 6);
  EXPECT_EQ(moved.devices.deadline_ms, 7);
  ASSERT_EQ(moved.warnings.size(), 6U);
  EXPECT_THAT(moved.warnings, ::testing::Contains("f.toml:5: tracker.acquisition_frames: has moved to "
                                                  "[expert.tracker]; here it is read for one release more"));
  EXPECT_THAT(moved.warnings, ::testing::Contains(HasSubstr("source.buffers: has moved to [expert.camera]")));
  EXPECT_THAT(moved.warnings, ::testing::Contains(HasSubstr("has moved to [expert.refiner.weights]")));

  const Config now = parse_config(
      "[source]\nkind = \"v4l2\"\n[[camera]]\nname = \"a\"\ndevice = "
      "\"/dev/video0\"\n[expert.camera]\nbuffers = 9\n"
      "[expert.tracker]\nacquisition_frames = 3\n[expert.refiner]\nweights = { albedo_smooth = 5 }\n",
      "f.toml");
  EXPECT_EQ(now.pipeline.source.live.buffers, 9U);
  EXPECT_EQ(now.devices.cameras.at(0).source.live.buffers, 9U);
  EXPECT_EQ(now.pipeline.tracker.acquisition_frames, 3);
  EXPECT_EQ(now.pipeline.refiner.weights.albedo_smooth, 5);
  EXPECT_TRUE(now.warnings.empty());
  EXPECT_TRUE(parse_config(sample() + sample("expert.toml"), "f.toml").warnings.empty());
  EXPECT_THAT(error_of("[expert.tracker]\nacquisition_frames = 0"),
              HasSubstr("expert.tracker.acquisition_frames: must be a whole number from 1 to 1000"));
  EXPECT_THAT(error_of("[expert.traker]\n"), HasSubstr("did you mean 'tracker'?"));
}

TEST(Config, LampsAreLinesOfOneChip) {
  const Config config = parse_config(
      "[lamps]\nchip = \"gpiochip0\"\nlines = [\"17\", \"27\"]\nactive_low = true\neach_ms = 500\n",
      "f.toml");
  const pipeline::LampsConfig& lamps = config.pipeline.lamps;
  ASSERT_EQ(lamps.outputs.size(), 2U);
  EXPECT_EQ(lamps.outputs[1].name, "lamp.2");
  EXPECT_EQ(lamps.outputs[1].chip, "gpiochip0");
  EXPECT_EQ(lamps.outputs[1].line, "27");
  EXPECT_TRUE(lamps.active_low);
  EXPECT_EQ(lamps.each_ms, 500);
  EXPECT_TRUE(parse_config("[lamps]\nchip = \"\"\nlines = []\n", "f.toml").pipeline.lamps.outputs.empty());
  const std::string two = "[lamps]\nlines = [\"1\", \"2\"]\n";
  EXPECT_THAT(error_of(two), HasSubstr("lamps.chip: is missing"));
  const std::string chip = two + "chip = \"c\"\n";
  EXPECT_THAT(error_of("[lamps]\nchip = \"c\"\nlines = [\"1\"]\n"), HasSubstr("lamps.lines: must be 2 to 8"));
  EXPECT_THAT(error_of("[lamps]\nchip = \"c\"\nlines = [\"1\", \"1\"]\n"), HasSubstr("different lines"));
  EXPECT_THAT(error_of(chip + "each_ms = 99\n"), HasSubstr("lamps.each_ms: must be a whole number from 100"));
  EXPECT_THAT(error_of("mode = \"booth\"\n" + chip), HasSubstr("are for one camera in mode \"monocular\""));
  EXPECT_THAT(error_of(chip + "[model]\nlearn = false\n"), HasSubstr("must have learn = true and no person"));
  EXPECT_THAT(error_of(chip + "[model]\nperson = \"ada\"\n"), HasSubstr("must have learn = true"));
}

/// The same of keys that are spelled otherwise.
TEST(Config, OldSpellingsAreReadWithAWarning) {
  const Config old = parse_config(
      "[model]\nlandmark_assets = \"nets\"\n[booth]\nrig = \"r.toml\"\n[web]\nmax_clients = 7\n", "f.toml");
  EXPECT_EQ(old.pipeline.tracker.landmark_nets.filename(), "nets");
  EXPECT_EQ(old.rig_file.filename(), "r.toml");
  EXPECT_EQ(old.web.max_readers, 7);
  EXPECT_THAT(old.warnings,
              ::testing::UnorderedElementsAre(
                  HasSubstr("f.toml:2: model.landmark_assets: has moved to landmark_nets"),
                  HasSubstr("f.toml:4: booth.rig: has moved to [rig] file"),
                  HasSubstr("f.toml:6: web.max_clients: has moved to [expert.web] max_readers")));
}

TEST(Config, SampleOfARigIsOneThatRuns) {
  const Config config = parse_config(sample("devices.toml"), "/sample/devices.toml");
  EXPECT_EQ(config.mode, Mode::Frames);
  require_source(config, "/sample/devices.toml");
  ASSERT_EQ(config.devices.cameras.size(), 2U);
  EXPECT_EQ(config.devices.cameras[1].name, "right");
  EXPECT_EQ(config.devices.cameras[1].source.kind, "simulated");
  EXPECT_EQ(config.devices.trigger, pipeline::TriggerKind::Virtual);
  EXPECT_EQ(config.devices.program.patterns, (std::vector<LineMask>{0b010, 0b100, 0}));
  EXPECT_EQ(config.devices.program.lines[0].role, LineRole::Camera);
}

TEST(Config, ReadsARigOnGpioLines) {
  const Config config = parse_config(R"(
mode = "frames"
[[camera]]
name = "left"
device = "/dev/video0"
format = "GREY"
latency_us = -300
[[camera]]
name = "right"
device = "/dev/video2"
[trigger]
kind = "gpio"
slots_per_second = 20
settle_us = 1000
exposure_us = 8000
patterns = [["p1", "p2"], []]
[[trigger.line]]
name = "cams"
chip = "gpiochip0"
line = "17"
active_low = true
drive = "open-drain"
pulse_us = 100
read_back_line = "27"
[[trigger.line]]
name = "p1"
role = "projector"
chip = "gpiochip0"
line = "22"
rest_active = true
[[trigger.line]]
name = "p2"
role = "projector"
chip = "gpiochip1"
line = "lamp"
[sets]
deadline_ms = 200
)",
                                     "/etc/facet/facet.toml");
  require_source(config, "facet.toml");
  const pipeline::DevicesConfig& rig = config.devices;
  EXPECT_EQ(rig.cameras[0].source.live.format, "GREY");
  EXPECT_EQ(rig.cameras[0].latency_ns, -300'000);
  EXPECT_EQ(rig.cameras[1].source.live.device, "/dev/video2");
  EXPECT_EQ(rig.trigger, pipeline::TriggerKind::Gpio);
  EXPECT_EQ(rig.program.patterns, (std::vector<LineMask>{0b110, 0}));
  EXPECT_EQ(rig.program.settle_ns, 1'000'000);
  EXPECT_TRUE(rig.program.lines[0].active_low);
  EXPECT_EQ(rig.program.lines[0].pulse_ns, 100'000);
  EXPECT_TRUE(rig.program.lines[1].safe_active);
  EXPECT_EQ(rig.program.lines[1].role, LineRole::Projector);
  EXPECT_EQ(rig.gpio.outputs[0].drive, trigger::LineDrive::OpenDrain);
  EXPECT_EQ(rig.gpio.outputs[2].line, "lamp");
  ASSERT_EQ(rig.gpio.read_backs.size(), 1U);
  EXPECT_EQ(rig.gpio.read_backs[0].name, "cams");
  EXPECT_EQ(rig.gpio.read_backs[0].chip, "gpiochip0");
  EXPECT_EQ(rig.deadline_ms, 200);
}

TEST(Config, BridgesHaveTargetsInDigits) {
  const Config config = parse_config(
      "[bridges]\nvmc = [\"127.0.0.1:39539\", \"[::1]:1\"]\nlive_link_face = [\"192.0.2.7:11111\"]\nrate_hz "
      "= 30\n"
      "smoothing_ms = 40\nsubject = \"Ada\"\nneutral = \"n.json\"\n",
      "/etc/facet/facet.toml");
  ASSERT_EQ(config.bridges.targets.size(), 3U);
  EXPECT_EQ(config.bridges.targets[1].text(), "[::1]:1");
  EXPECT_EQ(config.bridges.targets[2].protocol, avatar::BridgeProtocol::LiveLinkFace);
  EXPECT_EQ(config.bridges.rate_hz, 30);
  EXPECT_EQ(config.bridges.neutral_file, "/etc/facet/n.json");
  EXPECT_THAT(error_of("[bridges]\nvmc = [\"studio one:39539\"]\n"),
              AllOf(HasSubstr("facet.toml:2: bridges.vmc"), HasSubstr("\"studio one:39539\" is none"),
                    HasSubstr("IP address in digits")));
  EXPECT_THAT(error_of("[bridges]\nrate_hz = 0\n"), HasSubstr("from 1 to 240"));
  EXPECT_THAT(error_of("[bridges]\nsubject = \"\"\n"), HasSubstr("1 to 64 bytes"));
}

TEST(Config, ARigThatCannotBeIsToldByKey) {
  const auto refusal = [](const std::string& text) -> std::string {
    try {
      require_source(parse_config("mode = \"frames\"\n" + text, "f.toml"), "f.toml");
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
      return error.what();
    }
    return "";
  };
  const std::string camera = "[[camera]]\nname = \"a\"\nkind = \"simulated\"\n";
  EXPECT_EQ(refusal(camera), "");
  EXPECT_THAT(refusal(""), HasSubstr("there is no camera"));
  EXPECT_THAT(refusal("[camera]\nname = \"a\""), HasSubstr("double square brackets"));
  EXPECT_THAT(refusal("[[camera]]\nname = \"a\""), HasSubstr("f.toml:2: camera.device: is missing"));
  EXPECT_THAT(refusal("[[camera]]\nname = \"a\"\nkind = \"file\""), HasSubstr("camera.path: is missing"));
  EXPECT_THAT(refusal(camera + "buffers = 3"),
              AllOf(HasSubstr("f.toml:5: camera.buffers: is for kind = \"v4l2\" or \"libcamera\""),
                    HasSubstr("the kind of this one is \"simulated\"")));
  EXPECT_THAT(refusal("[[camera]]\nname = \"a\"\nkind = \"file\"\npath = \"v\"\npaced = true"),
              HasSubstr("camera.paced: unknown key"));
  EXPECT_THAT(refusal(camera + "paht = \"x\""), HasSubstr("did you mean 'path'?"));
  EXPECT_THAT(refusal(camera + camera), HasSubstr("two cameras are named 'a'"));
  EXPECT_THAT(refusal(camera + "[trigger]\nkind = \"virtual\"\n"), HasSubstr("needs 1 to 64 lines"));
  EXPECT_THAT(
      refusal(camera + "[trigger]\nkind = \"virtual\"\npatterns = [[\"q\"]]\n[[trigger.line]]\nname = \"c\""),
      HasSubstr("trigger.patterns: there is no trigger line 'q'"));
  EXPECT_THAT(refusal(camera + "[trigger]\npatterns = \"q\"\n"),
              HasSubstr("must be a list of 1 to 65536 lists"));
  EXPECT_THAT(refusal(camera + "[trigger]\npatterns = [[1]]\n"),
              HasSubstr("must be a list of texts in quotes"));
  EXPECT_THAT(refusal("[[camera]]\nname = \"a\"\ndevice = \"/dev/video0\"\n[trigger]\nkind = \"gpio\"\n"
                      "[[trigger.line]]\nname = \"c\"\nchip = \"gpiochip0\""),
              HasSubstr("a line of a GPIO trigger needs chip and line"));
}

/// Why a daemon can't run with this configuration; empty where it can.
std::string refusal(const std::string& text) {
  try {
    require_source(parse_config(text, "f.toml"), "f.toml");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "";
}

TEST(Config, SeveralCamerasCanMakeMeshes) {
  const std::string cameras =
      "[[camera]]\nname = \"a\"\nkind = \"simulated\"\n[[camera]]\nname = \"b\"\nkind = \"simulated\"\n";
  const std::string rig = "[rig]\nfile = \"r.toml\"\n";
  const Config config = parse_config(cameras + rig, "/folder/f.toml");
  EXPECT_EQ(config.mode, Mode::Monocular);
  EXPECT_TRUE(has_live_cameras(config));
  EXPECT_EQ(config.rig_file, "/folder/r.toml");
  EXPECT_FALSE(has_live_cameras(parse_config("[source]\npath = \"v\"\n", "f.toml")));
  EXPECT_FALSE(has_live_cameras(parse_config("mode = \"frames\"\n" + cameras, "f.toml")));
  EXPECT_EQ(refusal(cameras + rig), "");
  EXPECT_THAT(refusal(cameras),
              AllOf(HasSubstr("f.toml: rig.file is missing"), HasSubstr("facet calibrate")));
  EXPECT_THAT(refusal("[source]\npath = \"v\"\n" + cameras + rig),
              AllOf(HasSubstr("f.toml: "), HasSubstr("one [source] or from [[camera]]s")));
  EXPECT_THAT(refusal(cameras + rig +
                      "[trigger]\nkind = \"virtual\"\npatterns = [[\"p\"], []]\n[[trigger.line]]\nname = "
                      "\"c\"\n[[trigger.line]]\nname = \"p\"\nrole = \"projector\"\n"),
              HasSubstr("trigger.patterns"));
}

/// The least that a booth's configuration says.
std::string booth_text(const std::string& more) {
  return "mode = \"booth\"\n[[camera]]\nname = \"a\"\nkind = \"simulated\"\n"
         "[trigger]\nkind = \"virtual\"\npatterns = [[\"p\"], [], [\"p\"], []]\n"
         "[[trigger.line]]\nname = \"c\"\n[[trigger.line]]\nname = \"p\"\nrole = \"projector\"\n" +
         more;
}

TEST(Config, ReadsABooth) {
  const Config config = parse_config(
      booth_text(
          "[rig]\nfile = \"rig.toml\"\n[booth]\ndepth_mm = [700, 1100.5]\n"
          "record = \"meshes\"\nevery_slot = true\nshading = true\n[simulation]\nfootage = \"x.take\"\n"
          "[model]\npath = \"m\"\n[gpu]\ndevice = \"llvm\"\n"),
      "/folder/f.toml");
  EXPECT_EQ(config.mode, Mode::Booth);
  EXPECT_EQ(config.booth_record, BoothRecord::Meshes);
  EXPECT_EQ(config.devices.footage, "/folder/x.take");
  const pipeline::BoothConfig booth = booth_config(config);
  EXPECT_EQ(booth.rig_file, "/folder/rig.toml");
  EXPECT_EQ(booth.depths.nearest_mm, 700);
  EXPECT_TRUE(booth.every_slot);
  EXPECT_TRUE(booth.shading);
  EXPECT_EQ(booth.depths.farthest_mm, 1100.5F);
  EXPECT_EQ(capture::to_text(booth.program), "stripes,blank,stripes,blank");
  EXPECT_EQ(booth.model_file, "/folder/m");
  EXPECT_EQ(booth.gpu_device, "llvm");
  require_source(config, "/folder/f.toml");

  const Config bare = parse_config("", "f.toml");
  EXPECT_EQ(bare.booth_record, BoothRecord::Pictures);
  EXPECT_FALSE(booth_config(bare).every_slot);
  EXPECT_FALSE(booth_config(bare).shading);
  EXPECT_EQ(booth_config(bare).program, capture::standard_program());
  EXPECT_EQ(booth_config(bare).depths.farthest_mm, 0) << "found from the rig";
}

TEST(Config, ABoothThatCannotBeIsToldByKey) {
  EXPECT_THAT(refusal(booth_text("")), HasSubstr("rig.file is missing"));
  for (const char* range : {"[1100, 700]", "[700]", "[10, 700]", "[\"a\", 3]", "\"far\"", "700"}) {
    EXPECT_THAT(refusal(booth_text("[rig]\nfile = \"r\"\n[booth]\ndepth_mm = " + std::string(range) + "\n")),
                AllOf(HasSubstr("f.toml:"), HasSubstr("booth.depth_mm"), HasSubstr("[nearest, farthest]")))
        << range;
  }
  EXPECT_THAT(refusal(booth_text("[rig]\nfile = \"r\"\n[booth]\nrecord = \"both\"\n")),
              HasSubstr("\"meshes\""));
  EXPECT_THAT(
      refusal("mode = \"booth\"\n[[camera]]\nname = \"a\"\nkind = \"simulated\"\n[rig]\nfile = \"r\"\n"),
      HasSubstr("needs a trigger"));
  std::string no_blank = booth_text("[rig]\nfile = \"r\"\n");
  no_blank.replace(no_blank.find("[[\"p\"], [], [\"p\"], []]"), 22, "[[\"p\"]]");
  EXPECT_THAT(refusal(no_blank), HasSubstr("trigger.patterns"));
}

TEST(Config, ASlotsLightIsSaidInWords) {
  std::string lit = booth_text("[rig]\nfile = \"r\"\n");
  const std::string patterns = "[[\"p\"], [], [\"p\"], []]";
  const auto with = [&](const std::string& light) {
    return std::string(lit).replace(lit.find(patterns), patterns.size(), patterns + "\nlight = " + light);
  };
  const Config config = parse_config(with("[\"stripes\", \"blank\", \"light:p+top\", \"dark\"]"), "f.toml");
  EXPECT_EQ(capture::to_text(booth_config(config).program), "stripes,blank,light:p+top,dark");
  EXPECT_TRUE(booth_config(config).lights);
  EXPECT_THAT(refusal(with("[\"stripes\", \"blank\"]")),
              AllOf(HasSubstr("f.toml:"), HasSubstr("trigger.light"), HasSubstr("4 slots")));
  EXPECT_THAT(refusal(with("[\"stripes\", \"blank\", \"light:\", \"dark\"]")), HasSubstr("trigger.light"));
  EXPECT_THAT(refusal(with("[\"stripes\", \"light:p\", \"dark\", \"dark\"]")), HasSubstr("blank"));
}

TEST(Config, ReadsACamera) {
  const Config config = parse_config(R"(
[source]
kind = "v4l2"
device = "/dev/video2"
format = "MJPEG"
width_px = 1920
height_px = 1080
rate_hz = 29.97
exposure_us = 8000
gain = 12
white_balance_k = 4600
buffers = 6
stall_after_ms = 500
)",
                                     "/etc/facet/facet.toml");
  const camera::LiveConfig& live = config.pipeline.source.live;
  EXPECT_EQ(live.device, "/dev/video2");
  EXPECT_EQ(live.format, "MJPEG");
  EXPECT_EQ(live.width_px, 1920);
  EXPECT_EQ(live.height_px, 1080);
  EXPECT_EQ(live.rate_hz, 29.97);
  EXPECT_EQ(live.exposure_us, 8000);
  EXPECT_EQ(live.gain, 12);
  EXPECT_EQ(live.white_balance_k, 4600);
  EXPECT_EQ(live.buffers, 6U);
  EXPECT_EQ(live.stall_after, std::chrono::milliseconds(500));
  require_source(config, "facet.toml");
}

TEST(Config, ReadsControlsByTheirNamesInTheirOrder) {
  const Config config = parse_config(R"(
mode = "frames"
[source]
kind = "v4l2"
controls = { "Power Line Frequency" = "50 Hz" }
[[camera]]
name = "left"
device = "/dev/video0"
[camera.controls]
trigger_source = "Line 1"
"Trigger Mode" = true
a_number = -5000000000
[[camera]]
name = "right"
device = "/dev/video1"
)",
                                     "/etc/facet/facet.toml");
  const auto& one = config.pipeline.source.live.controls;
  ASSERT_EQ(one.size(), 1U);
  EXPECT_EQ(one[0].name, "Power Line Frequency");
  EXPECT_EQ(std::get<std::string>(one[0].value), "50 Hz");
  const auto& left = config.devices.cameras.at(0).source.live.controls;
  ASSERT_EQ(left.size(), 3U);
  EXPECT_EQ(left[0].name, "trigger_source");
  EXPECT_EQ(std::get<std::string>(left[0].value), "Line 1");
  EXPECT_EQ(left[1].name, "Trigger Mode");
  EXPECT_EQ(std::get<bool>(left[1].value), true);
  EXPECT_EQ(std::get<std::int64_t>(left[2].value), -5'000'000'000);
  EXPECT_TRUE(config.devices.cameras.at(1).source.live.controls.empty());
}

TEST(Config, ErrorsOfControls) {
  const std::string camera = "[source]\nkind = \"v4l2\"\n[source.controls]\n";
  EXPECT_THAT(
      error_of(camera + "gain = 0.5"),
      HasSubstr("facet.toml:4: source.controls.gain: must be true or false, a whole number, or the text"));
  EXPECT_THAT(error_of(camera + "gain = [1]"), HasSubstr("must be true or false"));
  EXPECT_THAT(error_of(camera + "gain = 1\n\"Gain\" = 2"),
              HasSubstr("facet.toml:5: source.controls.Gain: is set twice"));
  EXPECT_THAT(error_of(camera + "\"\" = 1"), HasSubstr("is no name of a control"));
  EXPECT_THAT(error_of("[source]\nkind = \"v4l2\"\ncontrols = 3"), HasSubstr("must be a section"));
  EXPECT_THAT(error_of("[source]\nkind = \"libcamera\"\n[source.controls]\ngain = 1"),
              HasSubstr("source.controls: is for kind = \"v4l2\""));
  EXPECT_THAT(error_of("[[camera]]\nkind = \"simulated\"\n[camera.controls]\ngain = 1"),
              HasSubstr("camera.controls: is for kind = \"v4l2\""));
}

TEST(Config, ReadsACameraOfLibcamera) {
  const Config config = parse_config(R"(
[source]
kind = "libcamera"
id = "imx477"
format = "RGB"
width_px = 640
exposure_us = 8000
gain = 1.5
red_gain = 2
blue_gain = 1.75
stall_after_ms = 500
)",
                                     "/etc/facet/facet.toml");
  const camera::CameraConfig& source = config.pipeline.source;
  EXPECT_EQ(source.kind, "libcamera");
  EXPECT_EQ(source.libcamera.id, "imx477");
  EXPECT_EQ(source.live.format, "RGB");
  EXPECT_EQ(source.live.width_px, 640);
  EXPECT_EQ(source.live.exposure_us, 8000);
  EXPECT_EQ(source.libcamera.gain, 1.5);
  EXPECT_EQ(source.libcamera.red_gain, 2.0);
  EXPECT_EQ(source.libcamera.blue_gain, 1.75);
  EXPECT_EQ(source.live.gain, std::nullopt);
  EXPECT_EQ(source.live.stall_after, std::chrono::milliseconds(500));
  require_source(config, "facet.toml");
  require_source(parse_config("[source]\nkind = \"libcamera\"", "facet.toml"), "facet.toml");
}

TEST(Config, ASimulatedSourceNeedsNothing) {
  const Config config = parse_config("[source]\nkind = \"simulated\"\nwidth_px = 64\n", "f.toml");
  EXPECT_EQ(config.pipeline.source.live.width_px, 64);
  require_source(config, "f.toml");
}

TEST(Config, ErrorsOfACameraOfLibcamera) {
  const std::string camera = "[source]\nkind = \"libcamera\"\n";
  EXPECT_THAT(error_of(camera + "device = \"/dev/video0\""),
              HasSubstr("source.device: is for kind = \"v4l2\"; the kind of this one is \"libcamera\""));
  EXPECT_THAT(error_of(camera + "loop = true"), HasSubstr("source.loop: is for kind = \"file\""));
  EXPECT_THAT(error_of(camera + "format = \"Y16\""), HasSubstr("\"RGB\""));
  EXPECT_THAT(error_of(camera + "gain = 0"), HasSubstr("must be \"auto\" or a number from 0.01 to 1000"));
  EXPECT_THAT(error_of(camera + "red_gain = 2"), HasSubstr("red_gain and blue_gain need one another"));
  EXPECT_THAT(error_of("[source]\nkind = \"v4l2\"\nid = \"a\""),
              HasSubstr("source.id: is for kind = \"libcamera\""));
}

TEST(Config, ErrorsOfACamera) {
  const std::string camera = "[source]\nkind = \"v4l2\"\n";
  EXPECT_THAT(error_of(camera + "format = \"RGB\""),
              AllOf(StartsWith("/etc/facet/facet.toml:3: source.format: "),
                    HasSubstr("\"auto\", \"YUYV\", \"NV12\", \"MJPEG\", \"GREY\", \"Y16\", \"Y10\"")));
  EXPECT_THAT(error_of(camera + "exposure_us = \"long\""),
              HasSubstr("source.exposure_us: must be \"auto\" or a whole number from 1 to 10000000"));
  EXPECT_THAT(error_of(camera + "exposure_us = 0"), HasSubstr("from 1 to 10000000"));
  EXPECT_THAT(error_of(camera + "gain = 0.5"), HasSubstr("source.gain: must be \"auto\" or a whole number"));
  EXPECT_THAT(error_of(camera + "white_balance_k = 999"), HasSubstr("from 1000 to 20000"));
  EXPECT_THAT(error_of(camera + "width_px = 15"), HasSubstr("a whole number from 16 to 16384"));
  EXPECT_THAT(error_of(camera + "rate_hz = 0"), HasSubstr("a number from 1 to 1000"));
  EXPECT_THAT(error_of(camera + "buffers = 1"), HasSubstr("from 2 to 32"));
  EXPECT_THAT(error_of(camera + "stall_after_ms = 0"), HasSubstr("from 100 to 3600000"));
  EXPECT_THAT(error_of(camera + "devise = \"/dev/video0\""), HasSubstr("did you mean 'device'?"));
  EXPECT_THAT(error_of(camera + "path = \"a.mp4\""),
              AllOf(HasSubstr("source.path: is for kind = \"file\""), HasSubstr("is \"v4l2\"")));
  EXPECT_THAT(error_of("[source]\ngain = 3"),
              HasSubstr("source.gain: is for kind = \"v4l2\" or \"libcamera\""));
  EXPECT_THROW(require_source(parse_config(camera, "facet.toml"), "facet.toml"), Error);
}

TEST(Config, ReadsEveryKindOfValue) {
  const Config config = parse_config(R"(
[source]
path = "clips/face.mp4"
paced = true
frames = "10:20"
[source.intrinsics]
fx = 1000
fy = 1001.5
cx = 319.5
cy = 239.5
width_px = 640
height_px = 480
[refiner]
budget = "paper"
[refiner.weights]
displacement_smooth = 1e-3
[gpu]
device = "llvmpipe"
[stream]
socket = "/run/s"
mode = 0o600
[takes]
disk_reserve_mb = 5
[log]
level = "debug"
)",
                                     "/etc/facet/facet.toml");
  EXPECT_EQ(config.pipeline.source.path, "/etc/facet/clips/face.mp4");
  EXPECT_TRUE(config.pipeline.source.paced);
  EXPECT_EQ(config.pipeline.frames.first, 10U);
  EXPECT_EQ(config.pipeline.frames.end, 20U);
  ASSERT_TRUE(config.pipeline.tracker.intrinsics.has_value());
  EXPECT_FLOAT_EQ(config.pipeline.tracker.intrinsics->fy, 1001.5F);
  EXPECT_EQ(config.pipeline.tracker.intrinsics->width_px, 640);
  EXPECT_EQ(config.pipeline.refiner.budget, refine::Budget::Paper);
  EXPECT_FLOAT_EQ(config.pipeline.refiner.weights.displacement_smooth, 1e-3F);
  EXPECT_EQ(config.pipeline.gpu_device, "llvmpipe");
  EXPECT_EQ(config.stream.socket, "/run/s");
  EXPECT_EQ(config.stream.access.mode, 0600U);
  EXPECT_EQ(config.takes.disk_reserve_bytes, 5U << 20);
  EXPECT_EQ(config.log_level, LogLevel::Debug);
  const refine::RefinerConfig five = parse_config("[refiner]\nbudget = 5", "f").pipeline.refiner;
  EXPECT_EQ(five.budget, refine::Budget::Fixed);
  EXPECT_EQ(five.gauss_newton_steps, 5);
  EXPECT_EQ(parse_config("[refiner]\nbudget = \"auto\"", "f").pipeline.refiner.budget, refine::Budget::Auto);
}

TEST(Config, ErrorsNameFileLineKeyAndWhatIsAllowed) {
  EXPECT_THAT(error_of("[source]\npaced = 1"),
              AllOf(StartsWith("/etc/facet/facet.toml:2: source.paced: "), HasSubstr("true or false")));
  EXPECT_THAT(error_of("\n[source]\nkind = \"webcam\""),
              AllOf(StartsWith("/etc/facet/facet.toml:3: source.kind: "),
                    HasSubstr("one of: \"file\", \"v4l2\", \"libcamera\", \"simulated\"")));
  EXPECT_THAT(error_of("[source]\nframes = \"20:10\""), HasSubstr("facet.toml:2: source.frames: "));
  EXPECT_THAT(error_of("[source]\npath = \"\""), HasSubstr("source.path: must be a path"));
  EXPECT_THAT(error_of("[source]\npath = 3"), HasSubstr("source.path: must be a path"));
  EXPECT_THAT(error_of("[source.intrinsics]\nfx = 1000"), HasSubstr("needs fx, fy, cx, cy, width_px"));
  EXPECT_THAT(error_of("[hierarchy]\nmax_levels = 99"),
              AllOf(HasSubstr("hierarchy.max_levels"), HasSubstr("from 1 to 12")));
  EXPECT_THAT(error_of("[hierarchy]\nmax_levels = 2.5"), HasSubstr("a whole number from 1 to 12"));
  EXPECT_THAT(error_of("[hierarchy]\nmin_edge_px = nan"), HasSubstr("a number from 0.1 to 1000"));
  EXPECT_THAT(error_of("[refiner]\nbudget = \"fast\""), HasSubstr("\"paper\" or a whole number"));
  EXPECT_THAT(error_of("[refiner]\nbudget = 0"), HasSubstr("from 1 to 100"));
  EXPECT_THAT(error_of("[refiner.weights]\nalbedo_smooth = -1"), HasSubstr("refiner.weights.albedo_smooth"));
  EXPECT_THAT(error_of("[stream]\nmode = 0o1777"), HasSubstr("0o660"));
  EXPECT_THAT(error_of("[log]\nlevel = \"loud\""), HasSubstr("\"error\", \"warning\", \"info\", \"debug\""));
  EXPECT_THAT(error_of("source = 3"), HasSubstr("source: must be a section"));
  EXPECT_THAT(error_of("[source]\npath = \"x"),
              AllOf(HasSubstr("facet.toml:2: "), HasSubstr("not valid TOML")));
  EXPECT_THAT(error_of("[source]\npaced = true\npaced = false"), HasSubstr("facet.toml:3: "));
}

TEST(Config, ListenersThatCannotBeAreErrors) {
  EXPECT_THAT(error_of("[stream]\nsocket = \"a/one.sock\"\n[control]\nsocket = \"b/../a/one.sock\""),
              AllOf(StartsWith("/etc/facet/facet.toml:4: control.socket: "), HasSubstr("stream.socket")));
  EXPECT_THAT(error_of("[stream]\nsocket = \"/run/facet/control.sock\""),
              HasSubstr("control.socket: '/run/facet/control.sock' is stream.socket"));
  const std::string longest = "/" + std::string(106, 's');
  EXPECT_EQ(parse_config("[stream]\nsocket = \"" + longest + "\"", "f").stream.socket, longest);
  for (const std::string section : {"stream", "control"}) {
    EXPECT_THAT(error_of("[" + section + "]\nsocket = \"" + longest + "s\""),
                AllOf(StartsWith("/etc/facet/facet.toml:2: " + section + ".socket: "), HasSubstr("107")));
  }
  const auto listening = [](const std::string& metrics, const std::string& web) {
    return "[metrics]\nlisten = \"" + metrics + "\"\n[web]\nlisten = \"" + web + "\"";
  };
  for (const auto& [metrics, web] : {std::pair{"127.0.0.1:80", "127.0.0.1:80"},
                                     {"127.0.0.1:80", "localhost:080"},
                                     {"0.0.0.0:80", "192.168.0.7:80"},
                                     {"[::1]:80", "[::]:80"}}) {
    EXPECT_THAT(error_of(listening(metrics, web)),
                AllOf(StartsWith("/etc/facet/facet.toml:4: web.listen: "), HasSubstr("metrics.listen")));
  }
  EXPECT_THAT(error_of("[web]\nlisten = \"127.0.0.1:9464\""), HasSubstr("facet.toml:2: web.listen: "));
  for (const auto& [metrics, web] : {std::pair{"127.0.0.1:80", "127.0.0.1:81"},
                                     {"127.0.0.1:80", "127.0.0.2:80"},
                                     {"127.0.0.1:0", "127.0.0.1:0"},
                                     {"", ""},
                                     {"", "127.0.0.1:80"}}) {
    EXPECT_EQ(parse_config(listening(metrics, web), "f").web.listen, web);
  }
}

TEST(Config, UnknownKeysAreErrorsWithASuggestion) {
  EXPECT_THAT(error_of("[source]\npth = \"x\""),
              AllOf(HasSubstr("facet.toml:2: source.pth: unknown key"), HasSubstr("did you mean 'path'?")));
  EXPECT_THAT(error_of("[sources]\npath = \"x\""), HasSubstr("did you mean 'source'?"));
  EXPECT_THAT(error_of("[gpu]\nwattage = 3"), HasSubstr("known are: device"));
  EXPECT_THAT(error_of("[gpu]\n" + std::string(1000, 'x') + " = 3"), HasSubstr("known are: device"));
}

TEST(Config, FilesThatCannotBeRead) {
  const test::TemporaryFolder folder;
  const auto kind_of = [](const std::filesystem::path& file) {
    try {
      load_config(file);
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), HasSubstr(file.string()));
      return error.kind();
    }
    return ErrorKind::Internal;
  };
  EXPECT_EQ(kind_of(folder.path() / "missing.toml"), ErrorKind::UnreadableInput);
  EXPECT_EQ(kind_of(folder.path()), ErrorKind::UnreadableInput);
  const auto huge = folder.path() / "huge.toml";
  std::ofstream(huge) << std::string(kMaxConfigBytes + 1, '#');
  EXPECT_EQ(kind_of(huge), ErrorKind::Usage);
  const auto binary = folder.path() / "binary.toml";
  std::ofstream(binary) << std::string("\0\xff\xfe\x01", 4);
  EXPECT_EQ(kind_of(binary), ErrorKind::Usage);
}

TEST(Config, ADaemonNeedsASource) {
  EXPECT_THROW(require_source(default_config(), "facet.toml"), Error);
  require_source(parse_config("[source]\npath = \"a.mp4\"", "facet.toml"), "facet.toml");
}

TEST(Config, DepthIsRefused) {
  std::string deep = "a";
  for (int i = 0; i < 200'000; ++i) {
    deep += ".a";
  }
  for (const std::string& text :
       {deep + " = 1", "[" + deep + "]", "[[" + deep + "]]", "x = {" + deep + " = 1}"}) {
    EXPECT_THAT(error_of(text), HasSubstr("more than 16 names in one key"));
  }
}

}  // namespace
}  // namespace facet::service
