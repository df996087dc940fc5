// facetd as a user meets it: a child process, its exit status, its sockets, its takes.

#include <arpa/inet.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include <array>
#include <fstream>
#include <map>
#include <regex>
#include <set>

#include "camera/simulated_devices.hpp"
#include "daemon_fixture.hpp"
#include "facet/error.hpp"
#include "gpu/context.hpp"
#include "service/default_paths.hpp"
#include "simulation/sequence.hpp"
#include "stream/client.hpp"
#include "support/gpu_faults.hpp"
#include "support/small_disk.hpp"
#include "support/source_folder.hpp"
#include "support/take_actor.hpp"
#include "support/videos.hpp"
#include "take/reader.hpp"

namespace facet::service {
namespace {

/// A daemon that is killed leaves a take that the next one closes.
TEST_F(Daemon, BrokenOffTakeIsClosedAtTheNextStart) {
  const auto config = folder_.path() / "facet.toml";
  const auto write_config = [&config](const std::string& takes) {
    std::filesystem::copy_file(std::filesystem::path(FACET_SOURCE_DIR) / "config" / "devices.toml", config,
                               std::filesystem::copy_options::overwrite_existing);
    std::ofstream(config, std::ios::app)
        << "[stream]\nsocket = \"stream.sock\"\n[control]\nsocket = "
           "\"control.sock\"\n[takes]\nfolder = \"takes\"\ndisk_reserve_mb = 1\n"
        << takes;
  };
  write_config("record_at_start = \"killed\"\n");
  const auto killed = start(config.string());
  await(*killed,
        [](const json& now) { return now["recording"].is_object() && now["recording"]["frames"] > 5; });
  EXPECT_EQ(ask("takes.list")["takes"][0]["closed"], false) << "it is being recorded";
  killed->send(SIGKILL);
  killed->wait();
  const std::int64_t frames = take::TakeReader(folder_.path() / "takes" / "killed.take").frame_count();

  write_config("");
  const auto daemon = start(config.string());
  await(*daemon, [](const json& now) { return now["state"] == "running"; });
  const json listed = ask("takes.list")["takes"][0];
  EXPECT_EQ(listed["closed"], true);
  EXPECT_EQ(listed["frames"], frames);
  EXPECT_THAT(listed["end_reason"].get<std::string>(), HasSubstr("broken off"));
  EXPECT_THAT(daemon->output(), HasSubstr("killed.take had been broken off"));
  EXPECT_FALSE(std::filesystem::exists(folder_.path() / "takes" / "killed.take-wal"));
  ask("shutdown");
  expect_clean_end(*daemon);
}

std::set<std::string> words_in(const std::string& text, const std::regex& pattern) {
  std::set<std::string> found;
  for (std::sregex_iterator at(text.begin(), text.end(), pattern), end; at != end; ++at) {
    found.insert((*at)[1]);
  }
  return found;
}

/// What the daemon says that there is, of methods or of a method's params.
std::set<std::string> known_to(ControlClient& daemon, const std::string& method, const json& params) {
  try {
    daemon.call(method, params);
  } catch (const Error& error) {
    const std::string told = error.what();
    EXPECT_THAT(told, ::testing::AnyOf(HasSubstr("there are: "), HasSubstr("takes no params")));
    const std::size_t list = told.find("there are: ");
    return list == std::string::npos ? std::set<std::string>()
                                     : words_in(told.substr(list + 11), std::regex("([a-z_.]+)"));
  }
  ADD_FAILURE() << method << " " << params << " was taken";
  return {};
}

/// docs/control-protocol.md has every method and every param, and no other.
TEST_F(Daemon, EveryMethodAndParamIsDocumented) {
  std::map<std::string, std::set<std::string>> documented;
  std::ifstream page(std::filesystem::path(FACET_SOURCE_DIR) / "docs" / "control-protocol.md");
  const std::regex row("\\| `([a-z_.]+)` \\| ([^|]*) \\| [^|]* \\| (all|members) \\|");
  std::smatch cells;
  for (std::string line; std::getline(page, line);) {
    if (std::regex_match(line, cells, row)) {
      documented[cells[1]] = words_in(cells[2], std::regex("`([a-z_]+)`"));
    }
  }
  const auto config = folder_.path() / "facet.toml";
  std::ofstream(config)
      << "mode = \"frames\"\n[[camera]]\nname = \"a\"\nkind = \"simulated\"\n[stream]\nsocket "
         "= \"stream.sock\"\n[control]\nsocket = \"control.sock\"\n[takes]\nfolder = "
         "\"takes\"\n[metrics]\nlisten = \"\"\n";
  const auto daemon = start(config.string());
  await(*daemon, [](const json&) { return true; });
  ControlClient client(control());
  std::set<std::string> methods;
  for (const auto& [method, params] : documented) {
    methods.insert(method);
    EXPECT_EQ(known_to(client, method, {{"no such param", 1}}), params) << method;
  }
  EXPECT_EQ(known_to(client, "no such method", json::object()), methods);
  ask("shutdown");
  expect_clean_end(*daemon);
}

/// The sample of a rig runs as it is: simulated cameras on a virtual trigger, streamed and recorded.
TEST_F(Daemon, ModeFramesHandsOutAndRecordsFrameSets) {
  const auto sample = std::filesystem::path(FACET_SOURCE_DIR) / "config" / "devices.toml";
  const auto config = folder_.path() / "facet.toml";
  std::filesystem::copy_file(sample, config);
  std::ofstream(config, std::ios::app)
      << "[stream]\nsocket = \"stream.sock\"\n[control]\nsocket = \"control.sock\"\n[takes]\nfolder = "
         "\"takes\"\ndisk_reserve_mb = 1\nrecord_at_start = \"sets\"\n";
  const auto daemon = start(config.string());
  const json status = await(
      *daemon, [](const json& now) { return now["rig"].is_object() && now["rig"]["sets"]["complete"] > 30; });
  ASSERT_TRUE(status.is_object());
  EXPECT_EQ(status["state"], "running");
  EXPECT_TRUE(status["camera"].is_null());
  EXPECT_EQ(status["rig"]["cameras"][1]["name"], "right");
  EXPECT_EQ(status["rig"]["cameras"][1]["state"], "streaming");
  EXPECT_EQ(status["rig"]["trigger"]["state"], "running");
  EXPECT_THROW(ask("identity.reset"), Error);

  stream::Subscription subscription;
  subscription.want_images = true;
  subscription.profile = stream::Profile::Signals;
  stream::StreamClient reader(folder_.path() / "stream.sock", subscription);
  stream::DecodedFrame got;
  ASSERT_EQ(reader.next(got, std::chrono::seconds(20)), stream::ReceiveOutcome::Received);
  ASSERT_NE(got.frame.images, nullptr);
  EXPECT_EQ(got.frame.images->frames.size(), 2U);

  ask("shutdown");
  expect_clean_end(*daemon);
  take::TakeReader take(folder_.path() / "takes" / "sets.take");
  EXPECT_TRUE(take.info().closed);
  ASSERT_GT(take.frame_count(), 20);
  for (std::int64_t index = 0; index < take.frame_count(); ++index) {
    const auto set = take.frame(index)->images;
    ASSERT_NE(set, nullptr);
    for (const Frame& picture : set->frames) {
      if (!picture.empty()) {
        // Lines: cameras, stripes.a, stripes.b; patterns: a, b, blank.
        constexpr std::array<std::uint64_t, 3> kLit = {0b010, 0b100, 0};
        EXPECT_EQ(simulated::read_marker(picture, simulated::Marker::Lines), kLit.at(set->slot % 3));
      }
    }
  }
}

/// Several calibrated cameras: one stream of meshes, recorded; a camera that is gone is missing in them.
TEST_F(DaemonWithAssets, SeveralCamerasMakeOneMesh) {
  simulation::ActorSequenceConfig studio;
  studio.seed = 3;
  studio.width_px = 480;
  studio.height_px = 360;
  studio.frame_count = 8;
  studio.rays_per_pixel = 1;
  studio.camera_count = 3;
  simulation::write_sequence(simulation::ActorSequence(face::FaceModel::load(test::default_model()), studio),
                             folder_.path(), {}, [](int) {});
  const auto cameras = [](const std::string& third) {
    std::string text;
    for (const std::string& name : {std::string("video"), std::string("view-2"), third}) {
      text += fmt::format("[[camera]]\nname = \"{}\"\nkind = \"file\"\npath = \"{}.mkv\"\nloop = {}\n", name,
                          name == third ? "view-3" : name, name != third);
    }
    return text + "[rig]\nfile = \"rig.toml\"\n[expert.tracker]\nacquisition_frames = 5\n";
  };
  const std::string config = configure("exit_at_end = true", "record_at_start = \"smile\"");
  std::ofstream(config, std::ios::app) << cameras("view-3");
  const auto daemon = start(config);
  const json status = await(*daemon, [](const json& now) {
    return now["rig"].is_object() && now["rig"]["cameras"][2]["state"] == "ended" &&
           now["frames"]["mesh"] > 10;
  });
  ASSERT_TRUE(status.is_object());
  EXPECT_EQ(status["mode"], "monocular");
  EXPECT_EQ(status["state"], "running");
  EXPECT_TRUE(status["source"].is_null());
  EXPECT_EQ(status["rig"]["cameras"][0]["name"], "video");
  EXPECT_EQ(status["rig"]["cameras"][0]["state"], "streaming");
  EXPECT_GT(status["rig"]["cameras"][0]["sets"]["in_sets"], 10);
  EXPECT_THAT(status["degraded_reason"].get<std::string>(), HasSubstr("no picture of camera view-3"));
  ask("identity.reset");
  ask("shutdown");
  expect_clean_end(*daemon);
  EXPECT_THAT(daemon->output(),
              AllOf(HasSubstr("meshes are in the frame of camera video"), HasSubstr("camera view-3 ended")));

  // Where the head is to a hundredth and a half; which of the sequence's frames the first set shows is not
  // known.
  std::ifstream stream(folder_.path() / "camera.json");
  const auto truth = json::parse(stream).at("frames");
  take::TakeReader take(folder_.path() / "takes" / "smile.take");
  ASSERT_GT(take.info().mesh_frame_count, 10);
  double least = 1;
  for (std::size_t first = 0; first < truth.size(); ++first) {
    double worst = 0;
    for (std::int64_t i = 0; i < take.frame_count(); ++i) {
      const auto frame = take.frame(i);
      if (frame->state == mesh::TrackingState::Tracking) {
        const auto pose = truth.at((frame->sequence + first) % truth.size()).at("camera_from_head");
        const Eigen::Vector3f place(pose.at(0).at(3), pose.at(1).at(3), pose.at(2).at(3));
        worst =
            std::max<double>(worst, (frame->camera_from_head.translation() - place).norm() / place.norm());
      }
    }
    least = std::min(least, worst);
  }
  EXPECT_LT(least, 0.03);

  // A rig file of other cameras ends it with what is wrong.
  std::string output;
  const std::string other = configure("exit_at_end = true");
  std::ofstream(other, std::ios::app) << cameras("left");
  EXPECT_EQ(run({"--config", other}, output), static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output, AllOf(HasSubstr("rig.toml"), HasSubstr("no camera 'left'"),
                            HasSubstr("video, view-2, view-3")));
}

TEST_F(Daemon, CommandLine) {
  std::string output;
  EXPECT_EQ(run({"--version"}, output), 0);
  EXPECT_THAT(output, HasSubstr("0."));
  EXPECT_EQ(run({"--help"}, output), 0);
  EXPECT_THAT(output, AllOf(HasSubstr("--check-config"), HasSubstr(default_config_file().string())));
  EXPECT_EQ(run({"--no-such-option"}, output), 2);
}

TEST_F(Daemon, CheckConfig) {
  std::string output;
  EXPECT_EQ(run({"--check-config", "--config", configure("path = \"a.mp4\"")}, output), 0) << output;
  EXPECT_EQ(run({"--check-config", "--config", configure("pth = \"a.mp4\"")}, output), 2);
  EXPECT_THAT(output, AllOf(HasSubstr("facet.toml:2: source.pth"), HasSubstr("'path'")));
  EXPECT_EQ(run({"--check-config", "--config", configure("paced = true")}, output), 2);
  EXPECT_THAT(output, HasSubstr("source.path is missing"));
  EXPECT_EQ(run({"--check-config", "--config", (folder_.path() / "none.toml").string()}, output), 3);
}

TEST_F(Daemon, ACorruptConfigurationIsNamed) {
  std::string output;
  const std::string config = configure("path = \"a.mp4\"");
  const auto size = std::filesystem::file_size(config);
  std::filesystem::resize_file(config, size - 5);
  std::ofstream(config, std::ios::app) << "[takes";
  EXPECT_EQ(run({"--config", config}, output), 2);
  EXPECT_THAT(output, AllOf(HasSubstr(config + ":"), HasSubstr("not valid TOML")));
  std::ofstream(config) << std::string("\0\xff\xfe\x01 = [", 8);
  EXPECT_EQ(run({"--config", config}, output), 2);
  EXPECT_THAT(output, AllOf(HasSubstr(config + ":1"), HasSubstr("not valid TOML")));
  std::ofstream(config) << std::string(2U << 20U, '#');
  EXPECT_EQ(run({"--config", config}, output), 2);
  EXPECT_THAT(output, AllOf(HasSubstr(config), HasSubstr("no configuration file")));
  EXPECT_EQ(run({"--config", folder_.path().string()}, output), 3);
  EXPECT_THAT(output, AllOf(HasSubstr(folder_.path().string()), HasSubstr("check that it exists")));
  EXPECT_FALSE(std::filesystem::exists(control()));
}

TEST_F(Daemon, WhatIsMissingIsNamed) {
  std::string output;
  EXPECT_EQ(run({"--config", configure("path = \"none.mp4\"")}, output), 3);
  EXPECT_THAT(output, HasSubstr("none.mp4"));
  const std::string config = configure("path = \"none.mp4\"");
  std::filesystem::remove(folder_.path() / "takes");
  EXPECT_EQ(run({"--config", config}, output), 6);
  EXPECT_THAT(output, HasSubstr("takes.folder"));
}

TEST_F(Daemon, ATakenSocketPathIsNamed) {
  std::ofstream(folder_.path() / "control.sock") << "something else";
  std::string output;
  EXPECT_EQ(run({"--config", configure("path = \"none.mp4\"")}, output), 6);
  EXPECT_THAT(output, HasSubstr("control.sock"));
  EXPECT_TRUE(std::filesystem::exists(folder_.path() / "control.sock"));
}

TEST_F(DaemonWithAssets, AnUnknownDeviceIsNamed) {
  std::string output;
  EXPECT_EQ(run({"--config", configure(looped(), "", "No Such Device")}, output), 5);
  EXPECT_THAT(output, HasSubstr("No Such Device"));
}

TEST_F(DaemonWithAssets, ALoaderWithoutDriversIsNamed) {
  std::string output;
  EXPECT_EQ(run({"--config", configure(looped(), "", "auto")}, output,
                {.environment = {"VK_ICD_FILENAMES=/nowhere/icd.json", "VK_DRIVER_FILES=/nowhere/icd.json"},
                 .pending_signal = 0}),
            5);
  EXPECT_THAT(output, AllOf(HasSubstr("no Vulkan device"), HasSubstr("apt install")));
  EXPECT_FALSE(std::filesystem::exists(control()));
}

TEST_F(DaemonWithAssets, AForeignModelIsNamed) {
  const auto foreign = folder_.path() / "foreign.facemodel";
  std::ofstream(foreign) << std::string(5000, 'x');
  std::string output;
  EXPECT_EQ(run({"--config", configure(looped(), "", "none", foreign)}, output), 3);
  EXPECT_THAT(output, HasSubstr(foreign.string()));
}

TEST_F(DaemonWithAssets, RecordsOnCommand) {
  const auto daemon = start(configure(looped()));
  const json status = await(*daemon, is_running);
  EXPECT_EQ(status["source"]["width_px"], 400);
  EXPECT_EQ(status["camera"]["state"], "streaming");
  EXPECT_GT(status["camera"]["frames"]["delivered"], 0);
  EXPECT_EQ(status["recording"], nullptr);
  EXPECT_TRUE(status["bridges"]["targets"].empty()) << "off unless configured";
  EXPECT_EQ(ask("values.set", {{"name", "jawOpen"}, {"gain", 2}})["gain"], 2)
      << "readers of the stream follow it without a target, too";
  ask("values.reset");
  EXPECT_THROW(ask("record.stop"), Error);
  EXPECT_EQ(ask("record.start", {{"name", "first"}})["file"], (folder_.path() / "takes/first.take").string());
  EXPECT_THROW(ask("record.start", {{"name", "second"}}), Error);
  await(*daemon, [](const json& now) { return now["recording"]["frames"] > 5; });
  const json take = ask("record.stop");
  EXPECT_EQ(take["state"], "finished");
  EXPECT_THROW(ask("record.start", {{"name", "first"}}), Error) << "a take is never overwritten";
  EXPECT_THROW(ask("record.start", {{"name", "../outside"}}), Error);
  EXPECT_THROW(ask("record.start", {{"name", 3}}), Error);
  ask("record.start");
  const json listed = ask("takes.list");
  EXPECT_EQ(listed["count"], 2);
  ask("identity.reset");
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
  const take::TakeReader reader(folder_.path() / "takes/first.take");
  EXPECT_TRUE(reader.info().closed);
  EXPECT_EQ(reader.frame_count(), take["frames"].get<std::int64_t>());
  EXPECT_GT(reader.info().picture_bytes, 0U) << "a paced video is looked at as a camera";
  for (const auto& entry : std::filesystem::directory_iterator(folder_.path() / "takes")) {
    if (entry.is_directory()) {
      EXPECT_EQ(entry.path().extension(), ".frames");
      continue;
    }
    EXPECT_EQ(entry.path().extension(), ".take") << "takes are closed, nothing but pictures is beside them";
    EXPECT_TRUE(take::TakeReader(entry.path()).info().closed);
  }
}

TEST_F(DaemonWithAssets, BridgesSendAndHaveANeutralPose) {
  const int receiver = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t length = sizeof(address);
  ASSERT_EQ(::bind(receiver, reinterpret_cast<sockaddr*>(&address), length), 0);
  ASSERT_EQ(::getsockname(receiver, reinterpret_cast<sockaddr*>(&address), &length), 0);
  const auto daemon = start(configure(
      looped(), fmt::format("[bridges]\nvmc = [\"127.0.0.1:{}\"]\nneutral = \"takes/neutral.json\"\n"
                            "[bridges.values]\nmouthSmileLeft = {{ gain = 0.5 }}\n",
                            ntohs(address.sin_port))));
  const auto received = [receiver] {
    std::string all;
    std::array<char, 2048> datagram{};
    for (ssize_t size = 0; (size = ::recv(receiver, datagram.data(), datagram.size(), MSG_DONTWAIT)) >= 0;) {
      all.append(datagram.data(), static_cast<std::size_t>(size));
    }
    return all;
  };
  const json status = await(*daemon, [](const json& now) { return now["frames"]["mesh"] > 0; });
  EXPECT_EQ(status["bridges"]["targets"][0]["protocol"], "vmc");
  EXPECT_EQ(status["bridges"]["neutral"]["state"], "none");
  received();  // what was sent while the face was looked for
  await(*daemon, [](const json& now) { return now["frames"]["mesh"] > 10; });
  const std::string sent = received();
  EXPECT_NE(sent.find("/VMC/Ext/Blend/Val"), std::string::npos);
  EXPECT_NE(sent.find("JawOpen"), std::string::npos);

  EXPECT_EQ(status["bridges"]["values"]["mouthSmileLeft"]["gain"], 0.5) << status["bridges"];
  EXPECT_EQ(ask("values.set", {{"name", "jawOpen"}, {"gain", 2}})["gain"], 2);
  EXPECT_EQ(ask("status")["bridges"]["values"].size(), 2U);
  ask("values.reset");
  EXPECT_EQ(ask("status")["bridges"]["values"], status["bridges"]["values"]);

  EXPECT_THROW(ask("neutral.record", {{"seconds", 0}}), Error);
  json neutral = {{"state", "none"}};
  for (int attempt = 0; attempt < 5 && neutral["state"] != "set";
       ++attempt) {  // a busy machine makes few frames
    ask("neutral.record", {{"seconds", 1 + attempt}});
    const json now =
        await(*daemon, [](const json& later) { return later["bridges"]["neutral"]["state"] != "recording"; });
    neutral = now["bridges"]["neutral"];
  }
  EXPECT_EQ(neutral["state"], "set") << neutral;
  EXPECT_TRUE(std::filesystem::exists(folder_.path() / "takes/neutral.json"));
  ask("neutral.clear");
  EXPECT_FALSE(std::filesystem::exists(folder_.path() / "takes/neutral.json"));
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
  ::close(receiver);
}

TEST_F(DaemonWithAssets, AFullDiskEndsTheTakeAndNothingElse) {
  const test::SmallDisk disk(folder_.path() / "takes");
  if (!disk.mounted()) {
    GTEST_SKIP() << "mounting a small tmpfs needs root";
  }
  const auto daemon = start(configure(looped() + "\n[expert.hierarchy]\nmax_levels = 1"));
  await(*daemon, is_running);
  ask("record.start", {{"name", "full"}});
  const json status = await(*daemon, [](const json& now) {
    return !now["recording"].is_null() && now["recording"]["state"] == "failed";
  });
  EXPECT_THAT(status["recording"]["reason"].get<std::string>(), HasSubstr("free some space"));
  const auto processed = status["frames"]["processed"].get<std::uint64_t>();
  await(*daemon, [&](const json& now) { return now["frames"]["processed"] > processed; });
  EXPECT_THAT(daemon->output(), AllOf(HasSubstr("recording ended by itself"), HasSubstr("free some space")));
  EXPECT_THAT([&] { ask("record.stop"); },
              ::testing::ThrowsMessage<Error>(
                  AllOf(HasSubstr("nothing is being recorded"), HasSubstr("free some space"))));
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
  const take::TakeReader reader(folder_.path() / "takes/full.take");
  EXPECT_GT(reader.frame_count(), 0);
  EXPECT_THAT(reader.info().end_reason, HasSubstr("disk nearly full"));
}

TEST_F(DaemonWithAssets, ACameraThatIsNotThereIsAwaited) {
  const auto daemon = start(configure("kind = \"v4l2\"\ndevice = \"/dev/there-is-no-such-video-device\""));
  const json status = await(*daemon, [](const json& now) {
    return now["state"] == "running" && now["camera"]["state"] == "absent";
  });
  EXPECT_THAT(status["camera"]["reason"].get<std::string>(), HasSubstr("no such device"));
  EXPECT_EQ(status["source"]["width_px"], 1280);
  EXPECT_EQ(status["camera"]["frames"]["delivered"], 0);
  await(*daemon, [&](const json&) { return daemon->output().find("camera absent") != std::string::npos; });
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
}

TEST_F(DaemonWithAssets, CoarseOnlyIsSaid) {
  const auto daemon = start(configure(looped()));
  const json status = await(*daemon, [](const json& now) { return now["frames"]["degraded"] > 0; });
  EXPECT_EQ(status["degraded_reason"], "refinement off");
  EXPECT_EQ(status["gpu"], "");
  EXPECT_THAT(daemon->output(), HasSubstr("refinement off"));
  ask("shutdown");
  expect_clean_end(*daemon);
}

TEST_F(DaemonWithAssets, ALostDeviceIsReopenedAndAStopDoesNotWaitForIt) {
  try {
    gpu::list_devices();
  } catch (const Error& error) {
    GTEST_SKIP() << error.what();
  }
  // The loss comes from below the loader, as a driver would report it.
  const test::GpuFaults faults;
  const auto daemon = start(configure(looped() + "\n[expert.hierarchy]\nmin_edge_px = 10", "", "auto"),
                            {.environment = faults.environment(), .pending_signal = 0});
  const auto is_refining = [](const json& now) { return now["frames"]["refined"] > 1; };
  const std::string device = await(*daemon, is_refining)["gpu"];
  EXPECT_NE(device, "");
  const auto is_lost = [](const json& now) { return now["gpu"] == "" && now["frames"]["degraded"] > 0; };
  faults.set("lost-at-submit");
  const json lost = await(*daemon, is_lost);
  EXPECT_THAT(lost["degraded_reason"].get<std::string>(), HasSubstr("GPU lost"));
  EXPECT_EQ(lost["state"], "running") << "coarse meshes go on";
  faults.set("");
  const int refined_before = lost["frames"]["refined"];
  const json back =
      await(*daemon, [&](const json& now) { return now["frames"]["refined"] > refined_before; });
  EXPECT_EQ(back["gpu"], device);
  EXPECT_THAT(daemon->output(), AllOf(HasSubstr(device + " lost"), HasSubstr(device + " is back")));
  faults.set("lost-at-submit");
  await(*daemon, is_lost);
  daemon->send(SIGTERM);
  expect_end(*daemon);
}

TEST_F(Daemon, WarnsOfBridgesThatAModeLeavesSilent) {
  const auto file = folder_.path() / "facet.toml";
  std::ofstream(file) << R"(
mode = "frames"
[[camera]]
name = "left"
kind = "simulated"
width_px = 64
height_px = 48
rate_hz = 20.0
[trigger]
kind = "virtual"
slots_per_second = 20.0
real_time = false
[[trigger.line]]
name = "cameras"
role = "camera"
[stream]
socket = "stream.sock"
[control]
socket = "control.sock"
[takes]
folder = "takes"
disk_reserve_mb = 1
[metrics]
listen = ""
[bridges]
vmc = ["127.0.0.1:39539"]
neutral = "takes/neutral.json"
)";
  const auto daemon = start(file.string());
  await(*daemon, [](const json& now) { return now["bridges"]["targets"].size() == 1; });
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
  EXPECT_THAT(daemon->output(), HasSubstr("warning: bridges: mode \"frames\" finds no face, so that vmc at "
                                          "127.0.0.1:39539 gets no expression and no head"));
}

TEST_F(DaemonWithAssets, TheStudioIsBrokenOffOverTheSocket) {
  const std::filesystem::path takes = folder_.path() / "takes";
  test::record_actor(takes, 1, 4000);
  const auto files = [&] {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(takes)) {
      names.push_back(entry.path().filename());
    }
    std::sort(names.begin(), names.end());
    return names;
  };
  const std::vector<std::string> before = files();
  const auto daemon = start(configure(grey_source(3)));
  await(*daemon, [](const json& now) { return now["state"] == "ended"; });
  const auto await_studio = [&](const std::function<bool(const json&)>& passes) {
    json now = ask("studio.status");
    while (daemon->running() && !passes(now)) {
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
      now = ask("studio.status");
    }
    return now;
  };
  EXPECT_THROW(ask("studio.cancel"), Error) << "there is nothing to break off";
  // While the take is reduced.
  ask("studio.open", {{"take", "actor1"}});
  json now =
      await_studio([](const json& one) { return one["state"] != "opening" || one["done"].get<int>() > 0; });
  ASSERT_EQ(now["state"], "opening");
  ASSERT_LT(now["done"], now["total"]);
  ask("studio.cancel");
  now = await_studio([](const json& one) { return one["state"] != "opening"; });
  EXPECT_EQ(now["state"], "closed");
  EXPECT_EQ(now["take"], "");
  EXPECT_EQ(now["reason"], "");
  EXPECT_EQ(files(), before);
  // Before that has begun.
  ask("studio.open", {{"take", "actor1"}});
  ask("studio.cancel");
  EXPECT_EQ(await_studio([](const json& one) { return one["state"] != "opening"; })["state"], "closed");
  // While the ways from key to key are sought, or what they make is written.
  ask("studio.open", {{"take", "actor1"}});
  ASSERT_EQ(await_studio([](const json& one) { return one["state"] != "opening"; })["state"], "ready");
  json keys = json::array();
  for (int k = 0; k < 200; ++k) {
    keys.push_back({{"time_s", k}, {"frame", 20 * k}});
  }
  ask("keys.set", {{"keys", {{"regions", {"lip-lower", "brow-left"}}, {"keys", keys}}}});
  const std::vector<std::string> opened = files();
  for (const char* state : {"preparing", "exporting"}) {
    ask("keys.export", {{"name", "long"}});
    now = await_studio([&](const json& one) { return one["state"] == state || one["state"] == "ready"; });
    if (now["state"] == "ready") {  // not begun yet
      now = await_studio([&](const json& one) { return one["state"] == state || one["exported"] != ""; });
      ASSERT_EQ(now["exported"], "") << "done before anybody looked";
    }
    ask("studio.cancel");
    now = await_studio([](const json& one) { return one["state"] == "ready"; });
    EXPECT_EQ(now["take"], "actor1") << "it stays open";
    EXPECT_EQ(now["reason"], "broken off");
    EXPECT_EQ(files(), opened) << state;
  }
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
}

}  // namespace
}  // namespace facet::service
