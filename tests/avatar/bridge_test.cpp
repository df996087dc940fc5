#include "avatar/bridge.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "avatar/face_state.hpp"
#include "avatar/protocols.hpp"
#include "datagrams.hpp"
#include "facet/error.hpp"
#include "support/child_process.hpp"
#include "support/eventually.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"

namespace facet::avatar {
namespace {

using nlohmann::json;
using namespace std::chrono_literals;
using test::message;
using test::Receiver;
using ::testing::HasSubstr;

const auto kJawOpen = static_cast<std::size_t>(mesh::arkit_index("jawOpen"));
const auto kEyeBlinkLeft = static_cast<std::size_t>(mesh::arkit_index("eyeBlinkLeft"));

/// A frame of somebody who says "ah" and turns the head by 0.3 rad to the own left.
std::shared_ptr<mesh::MeshFrame> frame(std::uint64_t sequence = 0) {
  static const auto subject = test::patch_subject();  // jawOpen, eyeBlinkLeft, mouthSmileRight
  auto out = std::make_shared<mesh::MeshFrame>(test::patch_frame(sequence, subject, nullptr));
  out->expression = {0.75F, 0.25F, 0.0F};
  out->camera_from_head.linear() = (Eigen::AngleAxisf(3.14159265F, Eigen::Vector3f::UnitX()) *
                                    Eigen::AngleAxisf(0.3F, Eigen::Vector3f::UnitY()))
                                       .toRotationMatrix();
  out->camera_from_head.translation() << 100, -50, 600;
  return out;
}

class BridgeTest : public ::testing::Test {
 protected:
  BridgeConfig config(std::vector<BridgeTarget> targets) const {
    BridgeConfig out;
    out.targets = std::move(targets);
    out.rate_hz = 240;
    out.subject = "A. Person";
    out.neutral_file = folder_.path() / "neutral.json";
    return out;
  }

  json decode(const std::string& kind, const std::vector<std::string>& datagrams) const {
    return test::decode(kind, datagrams, folder_.path());
  }

  /// Publishes frames until the state of the neutral pose is another one than Recording.
  static void record_neutral(Bridge& bridge) {
    bridge.record_neutral(200ms);
    for (std::uint64_t sequence = 0; bridge.status().neutral == NeutralState::Recording && sequence < 1000;
         ++sequence) {
      publish(bridge, frame(sequence));
      std::this_thread::sleep_for(10ms);
    }
  }

  /// As a pipeline hands a frame over.
  static void publish(Bridge& bridge, const std::shared_ptr<mesh::MeshFrame>& shown) {
    bridge.complete(*shown);
    bridge.publish(shown);
  }

  /// A frame with this jawOpen comes out of a bridge as so much.
  float sent_jaw(Bridge& bridge, const Receiver& receiver, float jaw) const {
    const auto shown = frame();
    shown->expression = {jaw, 0.25F, 0.0F};
    publish(bridge, shown);
    return message(decode("osc", receiver.receive()), "/VMC/Ext/Blend/Val", "JawOpen")[2].get<float>();
  }

  test::TemporaryFolder folder_;
};

TEST_F(BridgeTest, VmcSendsBlendsAndHead) {
  const Receiver receiver;
  Bridge bridge(config({receiver.target(BridgeProtocol::Vmc)}));
  bridge.start();
  bridge.publish(frame());
  const std::vector<std::string> datagrams = receiver.receive();
  for (const std::string& datagram : datagrams) {
    EXPECT_LE(datagram.size(), kMostDatagram);
  }
  const json messages = decode("osc", datagrams);
  ASSERT_EQ(messages.size(), 4 + 2 + 52 + 1U);
  EXPECT_EQ(messages[0], json::parse(R"(["/VMC/Ext/OK", 1, 3, 0, 1])"));
  EXPECT_EQ(messages[1][0], "/VMC/Ext/T");
  EXPECT_EQ(messages.back(), json::parse(R"(["/VMC/Ext/Blend/Apply"])")) << "after all values";
  EXPECT_EQ(message(messages, "/VMC/Ext/Blend/Val", "JawOpen")[2], 0.75F);
  EXPECT_EQ(message(messages, "/VMC/Ext/Blend/Val", "EyeBlinkLeft")[2], 0.25F);
  EXPECT_EQ(message(messages, "/VMC/Ext/Blend/Val", "TongueOut")[2], 0.0F);
  EXPECT_EQ(message(messages, "/VMC/Ext/Root/Pos"),
            json::parse(R"(["/VMC/Ext/Root/Pos", "root", 0, 0, 0, 0, 0, 0, 1])"));
  const json head = message(messages, "/VMC/Ext/Bone/Pos", "Head");
  // Unity, seen from above: a left-handed turn about y by a positive angle goes from z (ahead) to x (right).
  // To the left it is negative.
  ASSERT_EQ(head.size(), 9U);
  for (const std::size_t axis : {2U, 3U, 4U}) {
    EXPECT_EQ(head[axis], 0) << "a receiver that takes places leaves the head on the neck";
  }
  EXPECT_NEAR(head[5].get<float>(), 0, 1e-5F);
  EXPECT_NEAR(head[6].get<float>(), -std::sin(0.15F), 1e-5F);
  EXPECT_NEAR(head[7].get<float>(), 0, 1e-5F);
  EXPECT_NEAR(head[8].get<float>(), std::cos(0.15F), 1e-5F);
  EXPECT_EQ(bridge.status().targets.at(0).frames, 1U);
  EXPECT_EQ(bridge.status().targets.at(0).failed, 0U);
}

TEST_F(BridgeTest, AHostIsFoundByItsNameOrTold) {
  const Receiver receiver;
  BridgeTarget local = receiver.target(BridgeProtocol::Vmc);
  local.address = "localhost";
  const BridgeTarget nowhere{BridgeProtocol::Vmc, std::string(64, 'a'),
                             39539};  // no part of a name is so long
  Bridge bridge(config({local, nowhere}));
  EXPECT_EQ(bridge.status().targets.at(0).reason, "");
  EXPECT_THAT(bridge.status().targets.at(1).reason, HasSubstr("no address of the host 'aaa"));
  bridge.start();
  bridge.publish(frame());
  EXPECT_EQ(decode("osc", receiver.receive())[0][0], "/VMC/Ext/OK");
  EXPECT_TRUE(test::eventually([&] { return bridge.status().targets.at(1).failed == 1; }));
  EXPECT_EQ(bridge.status().targets.at(0).failed, 0U);
}

TEST_F(BridgeTest, VmcSaysThatNobodyIsThere) {
  const Receiver receiver;
  Bridge bridge(config({receiver.target(BridgeProtocol::Vmc)}));
  bridge.start();
  bridge.publish(std::make_shared<mesh::MeshFrame>(test::searching_frame(1)));
  const json messages = decode("osc", receiver.receive());
  ASSERT_EQ(messages.size(), 2U);
  EXPECT_EQ(messages[0], json::parse(R"(["/VMC/Ext/OK", 1, 3, 0, 0])"));
}

TEST_F(BridgeTest, OscdumpReadsVmc) {
  const std::string oscdump = "/usr/bin/oscdump";
  if (!std::filesystem::exists(oscdump)) {
    GTEST_SKIP() << "oscdump is not installed (liblo-tools)";
  }
  Receiver receiver;
  const BridgeTarget target = receiver.target(BridgeProtocol::Vmc);
  receiver.close();  // the port is oscdump's now
  test::ChildProcess child(oscdump, {"-L", std::to_string(target.port)}, folder_.path() / "dump");
  Bridge bridge(config({target}));
  bridge.start();
  // It may begin to listen in the middle of a frame: a whole one begins with OK.
  const auto has_whole_frame = [&] {
    const std::string output = child.output();
    const std::size_t begin = output.find("/VMC/Ext/OK");
    return begin != std::string::npos && output.find("Blend/Apply", begin) != std::string::npos;
  };
  for (std::uint64_t sequence = 0; !has_whole_frame() && sequence < 300; ++sequence) {
    bridge.publish(frame(sequence));
    std::this_thread::sleep_for(20ms);
  }
  EXPECT_THAT(child.output(), HasSubstr("/VMC/Ext/Blend/Val sf \"JawOpen\" 0.750000"));
  EXPECT_THAT(child.output(),
              HasSubstr("/VMC/Ext/Bone/Pos sfffffff \"Head\" 0.000000 0.000000 0.000000 0.000000 -0.149438"));
}

TEST_F(BridgeTest, LiveLinkFaceSendsTheAppsPacket) {
  const Receiver receiver;
  Bridge bridge(config({receiver.target(BridgeProtocol::LiveLinkFace)}));
  bridge.start();
  bridge.publish(std::make_shared<mesh::MeshFrame>(test::searching_frame(1)));
  std::this_thread::sleep_for(50ms);
  bridge.publish(frame());
  const json packets = decode("live_link_face", receiver.receive());
  ASSERT_EQ(packets.size(), 1U) << "none without a face";
  const json& packet = packets[0];
  EXPECT_EQ(packet["subject"], "A. Person");
  EXPECT_EQ(packet["device"].get<std::string>().size(), 36U);
  EXPECT_EQ(packet["rate"], 60);
  EXPECT_EQ(packet["denominator"], 1);
  EXPECT_LT(packet["frame"].get<int>(), 24 * 3600 * 60);
  ASSERT_EQ(packet["values"].size(), 61U);
  EXPECT_EQ(packet["values"][17], 0.75F) << "JawOpen";
  EXPECT_EQ(packet["values"][0], 0.25F) << "EyeBlinkLeft";
  EXPECT_EQ(packet["values"][51], 0.0F) << "TongueOut";
  EXPECT_NEAR(packet["values"][52].get<float>(), -0.3F, 1e-5F) << "yaw, to the subject's left";
  EXPECT_NEAR(packet["values"][53].get<float>(), 0, 1e-5F);
  EXPECT_NEAR(packet["values"][54].get<float>(), 0, 1e-5F);
}

TEST_F(BridgeTest, SendsNoMoreThanItsRate) {
  const Receiver receiver;
  BridgeConfig slow = config({receiver.target(BridgeProtocol::LiveLinkFace)});
  slow.rate_hz = 10;
  Bridge bridge(slow);
  bridge.start();
  const auto start = std::chrono::steady_clock::now();
  for (std::uint64_t sequence = 0; sequence < 100; ++sequence) {
    bridge.publish(frame(sequence));
    std::this_thread::sleep_for(5ms);
  }
  const std::size_t received = receiver.receive(250ms).size();
  const double elapsed_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  EXPECT_GE(received, 2U);
  EXPECT_LE(static_cast<double>(received), 10 * elapsed_s + 2);
}

TEST_F(BridgeTest, NobodyListensAndNobodyWaits) {
  Receiver receiver;
  const BridgeTarget nobody = receiver.target(BridgeProtocol::Vmc);
  receiver.close();
  const Receiver other;
  // No route leads to a documentation address with a scope of its own; where one does, nothing answers.
  Bridge bridge(config({nobody, {BridgeProtocol::Vmc, "fe80::1", 39539}, other.target(BridgeProtocol::Vmc)}));
  bridge.start();
  for (std::uint64_t sequence = 0; sequence < 20; ++sequence) {
    bridge.publish(frame(sequence));
    std::this_thread::sleep_for(10ms);
  }
  EXPECT_GT(other.receive(100ms).size(), 2U) << "the others go on";
  const BridgeStatus status = bridge.status();
  EXPECT_GT(status.targets.at(0).failed, 0U);
  EXPECT_THAT(status.targets.at(0).reason, HasSubstr("refused"));
  EXPECT_GT(status.targets.at(1).failed, 0U);
  EXPECT_EQ(status.targets.at(2).failed, 0U);
}

TEST(NeutralRecorder, AFaceThatIsNotKnownYetDoesNotCount) {
  FaceState state;
  state.tracked = true;
  state.provisional = true;
  NeutralRecorder recorder;
  for (int i = 0; i < 2 * NeutralRecorder::kFewestFrames; ++i) {
    recorder.add(state);
  }
  EXPECT_EQ(recorder.frames(), 0);
  EXPECT_FALSE(recorder.mean().has_value());
}

TEST_F(BridgeTest, NeutralPoseIsTakenAwayAndKept) {
  const Receiver receiver;
  const BridgeConfig wanted = config({receiver.target(BridgeProtocol::Vmc)});
  {
    Bridge bridge(wanted);
    bridge.start();
    EXPECT_EQ(bridge.status().neutral, NeutralState::None);
    record_neutral(bridge);
    const BridgeStatus status = bridge.status();
    ASSERT_EQ(status.neutral, NeutralState::Set) << status.neutral_reason;
    EXPECT_GE(status.neutral_frames, NeutralRecorder::kFewestFrames);
  }
  receiver.receive(100ms);
  Bridge bridge(wanted);
  ASSERT_EQ(bridge.status().neutral, NeutralState::Set);
  bridge.start();
  const auto moved = frame();
  moved->expression = {0.875F, 0.25F, 0.5F};
  moved->camera_from_head.translation().x() += 30;
  publish(bridge, moved);
  const json messages = decode("osc", receiver.receive());
  EXPECT_NEAR(message(messages, "/VMC/Ext/Blend/Val", "JawOpen")[2].get<float>(), 0.5F, 1e-4F)
      << "(0.875 - 0.75) / 0.25";
  EXPECT_NEAR(message(messages, "/VMC/Ext/Blend/Val", "EyeBlinkLeft")[2].get<float>(), 0, 1e-4F);
  EXPECT_NEAR(message(messages, "/VMC/Ext/Blend/Val", "MouthSmileRight")[2].get<float>(), 0.5F, 1e-4F);
  EXPECT_NEAR(message(messages, "/VMC/Ext/Bone/Pos", "Head")[8].get<float>(), 1, 1e-5F) << "straight ahead";
  // 30 mm to the picture's right, which is the subject's left, by a head that is turned left by 0.3.
  const json root = message(messages, "/VMC/Ext/Root/Pos");
  EXPECT_NEAR(root[2].get<float>(), -0.030F * std::cos(0.3F), 1e-4F);
  EXPECT_NEAR(root[3].get<float>(), 0, 1e-4F);
  EXPECT_NEAR(root[4].get<float>(), 0.030F * std::sin(0.3F), 1e-4F);
  for (const std::size_t axis : {2U, 3U, 4U}) {
    EXPECT_EQ(message(messages, "/VMC/Ext/Bone/Pos", "Head")[axis].get<float>(), 0) << "told once";
  }

  bridge.clear_neutral();
  EXPECT_EQ(bridge.status().neutral, NeutralState::None);
  EXPECT_FALSE(std::filesystem::exists(wanted.neutral_file));
}

TEST_F(BridgeTest, ValuesAreTunedAfterTheNeutralPoseByNameAndLive) {
  const Receiver receiver;
  BridgeConfig wanted = config({receiver.target(BridgeProtocol::Vmc)});
  NeutralPose rest;
  rest.values.at(kJawOpen) = 0.5F;
  save_neutral(rest, wanted.neutral_file);
  wanted.values.named[kJawOpen] = {.gain = 1.5, .dead_zone = 0.2};
  Bridge bridge(wanted);
  bridge.start();
  publish(bridge, frame());  // jawOpen 0.75, which is 0.5 above rest
  const json messages = decode("osc", receiver.receive());
  EXPECT_NEAR(message(messages, "/VMC/Ext/Blend/Val", "JawOpen")[2].get<float>(), 0.5625F, 1e-4F)
      << "1.5 * (0.5 - 0.2) / 0.8";
  EXPECT_EQ(message(messages, "/VMC/Ext/Blend/Val", "EyeBlinkLeft")[2], 0.25F) << "as it comes";
  EXPECT_EQ(sent_jaw(bridge, receiver, 0.55F), 0) << "in the dead zone, which counts from the neutral pose";

  ValueTunings values;
  values.named[kJawOpen] = {.gain = 0.5};
  bridge.tune(values);
  EXPECT_EQ(bridge.status().values.of(kJawOpen).gain, 0.5);
  EXPECT_NEAR(sent_jaw(bridge, receiver, 0.75F), 0.25F, 1e-4F);
  bridge.tune({});
  EXPECT_NEAR(sent_jaw(bridge, receiver, 0.75F), 0.5F, 1e-4F);
}

TEST_F(BridgeTest, EveryFrameIsGivenItsAvatarValuesWithoutATarget) {
  BridgeConfig wanted = config({});
  Bridge plain(wanted);
  const auto shown = frame();
  shown->avatar_values = {1, 1, 1};
  plain.complete(*shown);
  EXPECT_TRUE(shown->avatar_values.empty()) << "of the take that it was recorded in";
  EXPECT_FALSE(plain.changes_values());

  NeutralPose rest;
  rest.values.at(kJawOpen) = 0.5F;
  save_neutral(rest, wanted.neutral_file);
  wanted.values.named[kEyeBlinkLeft] = {.gain = 2};
  Bridge bridge(wanted);
  EXPECT_TRUE(bridge.changes_values());
  bridge.complete(*shown);
  EXPECT_EQ(shown->avatar_values, (std::vector<float>{0.5F, 0.5F, 0.0F}));
  EXPECT_EQ(shown->expression, (std::vector<float>{0.75F, 0.25F, 0.0F})) << "as measured";
  mesh::MeshFrame lost = test::searching_frame(1);
  bridge.complete(lost);
  EXPECT_TRUE(lost.avatar_values.empty());
}

TEST_F(BridgeTest, NeutralPoseWithoutAFaceFails) {
  const Receiver receiver;
  Bridge bridge(config({receiver.target(BridgeProtocol::Vmc)}));
  bridge.start();
  bridge.record_neutral(100ms);
  EXPECT_THROW(bridge.record_neutral(100ms), Error);
  for (int i = 0; bridge.status().neutral == NeutralState::Recording && i < 500; ++i) {
    std::this_thread::sleep_for(10ms);
  }
  EXPECT_EQ(bridge.status().neutral, NeutralState::Failed);
  EXPECT_THAT(bridge.status().neutral_reason, HasSubstr("tracked in 0 frames"));
}

TEST_F(BridgeTest, ADamagedNeutralPoseIsSetAsideAndNamed) {
  const BridgeConfig wanted = config({});
  int number = 0;
  for (
      const std::string& text : std::initializer_list<std::string>{
          "", "{", "[]", std::string(60'000, '['), R"({"facet_neutral":)" + std::string(60'000, '['),
          R"({"facet_neutral": 2})",
          R"({"facet_neutral": 1, "values": {"jawOpen": 2}, "rotation": [0,0,0,1], "translation_m": [0,0,0]})",
          R"({"facet_neutral": 1, "values": {"jaw": 0}, "rotation": [0,0,0,1], "translation_m": [0,0,0]})",
          R"({"facet_neutral": 1, "values": {}, "rotation": [0,0,0,0], "translation_m": [0,0,0]})",
          R"({"facet_neutral": 1, "values": {}, "rotation": [0,0,0,1], "translation_m": [0,"x",0]})"}) {
    std::ofstream(wanted.neutral_file) << text;
    const Bridge bridge(wanted);
    EXPECT_EQ(bridge.status().neutral, NeutralState::None);
    const std::string aside = fmt::format("neutral.json.broken-{}", ++number);
    EXPECT_THAT(bridge.status().neutral_reason, AllOf(HasSubstr("neutral.json:"), HasSubstr(aside)));
    EXPECT_FALSE(std::filesystem::exists(wanted.neutral_file)) << text;
    EXPECT_TRUE(std::filesystem::exists(folder_.path() / aside)) << text;
  }
}

TEST(BridgeTargets, AreAddressesInDigitsOrNames) {
  const auto text = [](const std::string& given) {
    const auto target = parse_target(BridgeProtocol::Vmc, given);
    return target ? target->text() : "none";
  };
  EXPECT_EQ(text("127.0.0.1:39539"), "127.0.0.1:39539");
  EXPECT_EQ(text("[::1]:11111"), "[::1]:11111");
  EXPECT_EQ(text("localhost:39539"), "localhost:39539");
  EXPECT_EQ(text("studio-2.example.org:1"), "studio-2.example.org:1");
  for (const char* bad : {"", "127.0.0.1", "256.0.0.1:1", "127.0.0:1", "a b:1", "a/b:1", "[localhost]:1",
                          "localhost", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:65536", "127.0.0.1:39539 ",
                          "::1:11111", "[127.0.0.1]:1", "[::1]", ":39539", "127.0.0.1:-1"}) {
    EXPECT_EQ(text(bad), "none") << bad;
  }
}

/// What becomes of a value at once.
float tuned(const ValueTuning& tuning, float value) {
  ValueTunings tunings;
  tunings.named[kJawOpen] = tuning;
  FaceState state;
  state.tracked = true;
  state.values.fill(value);
  ValueTuner().apply(tunings, state);
  EXPECT_EQ(state.values.at(kEyeBlinkLeft), value) << "another name's stays";
  return state.values.at(kJawOpen);
}

TEST(ValueTuning, DeadZoneIsContinuousAndThenComesTheGain) {
  for (const float value : {0.0F, 0.1F, 0.7F, 1.0F}) {
    EXPECT_EQ(tuned({}, value), value) << "the plain one changes nothing";
  }
  const ValueTuning zone{.dead_zone = 0.2};
  EXPECT_EQ(tuned(zone, 0.1F), 0);
  EXPECT_EQ(tuned(zone, 0.2F - 1e-4F), 0);
  EXPECT_NEAR(tuned(zone, 0.2F + 1e-4F), 1.25e-4F, 1e-6F) << "no step";
  EXPECT_NEAR(tuned(zone, 0.6F), 0.5F, 1e-6F);
  EXPECT_EQ(tuned(zone, 1), 1);
  const ValueTuning both{.gain = 3, .dead_zone = 0.2};
  EXPECT_NEAR(tuned(both, 0.4F), 0.75F, 1e-6F) << "the gain is of what the dead zone leaves";
  EXPECT_EQ(tuned(both, 0.1F), 0) << "a gain first would lift it out of the dead zone";
  EXPECT_EQ(tuned(both, 0.9F), 1) << "cut";
  EXPECT_EQ(tuned({.gain = 0}, 0.9F), 0);
}

TEST(ValueTuning, AllIsForWhatIsNotNamed) {
  ValueTunings tunings;
  tunings.all.gain = 0.5;
  tunings.named[kJawOpen].gain = 0.25;
  FaceState state;
  state.tracked = true;
  state.values.fill(1);
  ValueTuner().apply(tunings, state);
  EXPECT_EQ(state.values.at(kJawOpen), 0.25F);
  EXPECT_EQ(state.values.at(kEyeBlinkLeft), 0.5F);
}

TEST(ValueTuning, SmoothsEachNameWithItsOwnTimeAndLast) {
  ValueTunings tunings;
  tunings.named[kJawOpen] = {.gain = 4, .smoothing_ms = 100};
  tunings.named[kEyeBlinkLeft].smoothing_ms = 50;
  ValueTuner tuner;
  FaceState state;
  state.tracked = true;
  const auto after = [&](int milliseconds, float value) {
    state.timestamp_ns += milliseconds * 1'000'000LL;
    state.values.fill(value);
    tuner.apply(tunings, state);
  };
  after(0, 0);
  after(100, 1);
  EXPECT_NEAR(state.values.at(kJawOpen), 1 - std::exp(-1.0F), 1e-5F) << "cut to 1 before it is smoothed";
  EXPECT_NEAR(state.values.at(kEyeBlinkLeft), 1 - std::exp(-2.0F), 1e-5F);
  EXPECT_EQ(state.values.back(), 1) << "not smoothed";
  after(100, 0);
  EXPECT_NEAR(state.values.at(kJawOpen), (1 - std::exp(-1.0F)) * std::exp(-1.0F), 1e-5F)
      << "from what was sent last";
  tunings = {};
  after(10, 0.5F);
  EXPECT_EQ(state.values.at(kJawOpen), 0.5F) << "changed live";
  tunings.all.smoothing_ms = 1000;
  state.tracked = false;
  after(10, 0);
  state.tracked = true;
  after(10, 1);
  EXPECT_EQ(state.values.at(kJawOpen), 1) << "anew after a pause";
}

TEST(Smoothing, ComesThroughAfterItsTime) {
  Smoother smoother(0.1F);
  FaceState state;
  state.tracked = true;
  smoother.apply(state);
  state.values[3] = 1;
  state.timestamp_ns += 100'000'000;
  smoother.apply(state);
  EXPECT_NEAR(state.values[3], 1 - std::exp(-1.0F), 1e-5F);
  state.tracked = false;
  smoother.apply(state);
  state.tracked = true;
  state.values[3] = 1;
  smoother.apply(state);
  EXPECT_EQ(state.values[3], 1.0F) << "anew after a pause";
}

}  // namespace
}  // namespace facet::avatar
