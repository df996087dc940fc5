// What each protocol's datagrams say, read by others' code, by what the protocols' pages say, or held against
// packets that were published.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <initializer_list>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <set>
#include <string>

#include "avatar/bridge_messages.hpp"
#include "avatar/phone_messages.hpp"
#include "avatar/sent_values.hpp"
#include "datagrams.hpp"
#include "support/child_process.hpp"
#include "support/paths.hpp"

namespace facet::avatar {
namespace {

using nlohmann::json;
using test::message;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr float kDegree = std::numbers::pi_v<float> / 180;

/// One value of ARKit's names.
struct Given {
  const char* name;
  float value;
};

FaceState face(std::initializer_list<Given> given) {
  FaceState state;
  state.tracked = true;
  state.has_expression = true;
  for (const auto& [name, value] : given) {
    state.values.at(static_cast<std::size_t>(mesh::arkit_index(name))) = value;
  }
  return state;
}

/// A head turned about y by so much (positive: to the own left), then about x (down), then about z (towards
/// the own right shoulder).
FaceState turned(float y, float x, float z) {
  FaceState state = face({});
  state.upright_from_head.linear() =
      (Eigen::AngleAxisf(y, Eigen::Vector3f::UnitY()) * Eigen::AngleAxisf(x, Eigen::Vector3f::UnitX()) *
       Eigen::AngleAxisf(z, Eigen::Vector3f::UnitZ()))
          .toRotationMatrix();
  return state;
}

/// As sent in the first place.
class Messages : public ::testing::Test {
 protected:
  json vmc(const FaceState& state, VmcShapes shapes, bool eye_bones = true,
           const MappedValues& chosen = {}) const {
    OscBundles out(kMostDatagram);
    write_vmc(state, 1, false, vmc_content(shapes, eye_bones, chosen), out);
    return test::decode("osc", test::texts(out.bundles()), folder_.path());
  }
  json vrchat(VrChatWriter& writer, const FaceState& state, float time_s) const {
    OscBundles out(kMostDatagram);
    writer.write(state, time_s, out);
    return test::decode("osc", test::texts(out.bundles()), folder_.path());
  }
  json ifacialmocap(const FaceState& state) const {
    std::vector<std::vector<std::byte>> out(1);
    write_ifacialmocap(state, IFacialMocapVersion::V1, out.front());
    return test::decode("ifacialmocap", test::texts(out), folder_.path())[0];
  }
  json vtube_studio(const FaceState& state) const {
    std::vector<std::vector<std::byte>> out(1);
    write_vtube_studio(state, 1'664'817'520'079, out.front());
    return test::decode("json", test::texts(out), folder_.path())[0];
  }

  test::TemporaryFolder folder_;
};

/// Names and values of /VMC/Ext/Blend/Val; a name that comes twice is an error.
std::map<std::string, float> blends(const json& messages) {
  std::map<std::string, float> out;
  for (const json& found : messages) {
    if (found[0] == "/VMC/Ext/Blend/Val") {
      EXPECT_TRUE(out.emplace(found[1], found[2]).second) << found;
    }
  }
  return out;
}

/// A bone's quaternion, and that it has no place of its own.
Eigen::Quaternionf bone(const json& messages, const std::string& name) {
  const json found = message(messages, "/VMC/Ext/Bone/Pos", name);
  if (found.size() != 9) {
    ADD_FAILURE() << name << ": " << found;
    return Eigen::Quaternionf::Identity();
  }
  for (const std::size_t axis : {2U, 3U, 4U}) {
    EXPECT_EQ(found[axis], 0);
  }
  return {found[8].get<float>(), found[5].get<float>(), found[6].get<float>(), found[7].get<float>()};
}

void expect_near(const Eigen::Quaternionf& found, const Eigen::Vector4f& xyzw) {
  EXPECT_LT((found.coeffs() - xyzw).norm(), 1e-5F) << found.coeffs().transpose();
}

/// Unity: x right, y up, z ahead, left-handed. Seen from above, a positive turn about y goes from z to x, to
/// the right; seen from the right, one about x goes from z to -y, down. Calculated by hand, sin and cos of
/// half the angle: 30 degrees aside and 28 down are the default face model's.
TEST_F(Messages, VmcTurnsTheEyesAsUnityDoes) {
  constexpr float kSin15 = 0.258819F;
  constexpr float kCos15 = 0.965926F;
  constexpr float kSin14 = 0.241922F;
  constexpr float kCos14 = 0.970296F;
  const json left = vmc(face({{"eyeLookOutLeft", 1}, {"eyeLookInRight", 1}}), VmcShapes::PerfectSync);
  expect_near(bone(left, "LeftEye"), {0, -kSin15, 0, kCos15});
  expect_near(bone(left, "RightEye"), {0, -kSin15, 0, kCos15});
  const json right = vmc(face({{"eyeLookInLeft", 1}, {"eyeLookOutRight", 1}}), VmcShapes::PerfectSync);
  expect_near(bone(right, "LeftEye"), {0, kSin15, 0, kCos15});
  const json down = vmc(face({{"eyeLookDownLeft", 1}, {"eyeLookDownRight", 1}}), VmcShapes::PerfectSync);
  expect_near(bone(down, "LeftEye"), {kSin14, 0, 0, kCos14});
  const json both = vmc(face({{"eyeLookOutLeft", 1}, {"eyeLookDownLeft", 1}}), VmcShapes::PerfectSync);
  // q_y q_x: (sin a / 2 cos b / 2 ...) with a = -30 about y, b = 28 about x.
  expect_near(bone(both, "LeftEye"), {kCos15 * kSin14, -kSin15 * kCos14, kSin15 * kSin14, kCos15 * kCos14});
  expect_near(bone(both, "RightEye"), {0, 0, 0, 1});
  // Where it looks then: to x < 0, the person's left, and down.
  const Eigen::Vector3f gaze = bone(both, "LeftEye") * Eigen::Vector3f::UnitZ();
  EXPECT_NEAR(gaze.x(), -0.5F * std::cos(28 * kDegree), 1e-5F);
  EXPECT_NEAR(gaze.y(), -std::sin(28 * kDegree), 1e-5F);

  EXPECT_EQ(message(vmc(face({}), VmcShapes::Both, false), "/VMC/Ext/Bone/Pos", "LeftEye"), nullptr);
  FaceState booth = face({});
  booth.has_expression = false;
  const json head_alone = vmc(booth, VmcShapes::Both);
  EXPECT_EQ(head_alone.size(), 4U) << "a booth's meshes tell no gaze: " << head_alone;
}

TEST_F(Messages, VmcSendsTheSortOfNamesThatIsWanted) {
  // https://github.com/vrm-c/vrm-specification, 0.0: all but Neutral.
  const std::set<std::string> presets = {"A",        "I",         "U",       "E",      "O",      "Blink",
                                         "Joy",      "Angry",     "Sorrow",  "Fun",    "LookUp", "LookDown",
                                         "LookLeft", "LookRight", "Blink_L", "Blink_R"};
  std::set<std::string> arkit(mesh::kArkitNames.begin(), mesh::kArkitNames.end());
  const auto names = [&](VmcShapes shapes) {
    std::set<std::string> out;
    for (const auto& [name, value] : blends(vmc(face({{"jawOpen", 0.5F}}), shapes))) {
      out.insert(name);
    }
    return out;
  };
  EXPECT_EQ(names(VmcShapes::PerfectSync), arkit);
  EXPECT_EQ(names(VmcShapes::Presets), presets);
  arkit.insert(presets.begin(), presets.end());
  EXPECT_EQ(names(VmcShapes::Both), arkit);
}

TEST_F(Messages, VrmPresetsMoveNothingTwice) {
  const auto preset = [this](std::initializer_list<Given> given) {
    return blends(vmc(face(given), VmcShapes::Presets));
  };
  auto found = preset({{"eyeBlinkLeft", 0.8F}, {"eyeBlinkRight", 0.3F}});
  EXPECT_NEAR(found["Blink"], 0.3F, 1e-6F);
  EXPECT_NEAR(found["Blink_L"], 0.5F, 1e-6F);
  EXPECT_EQ(found["Blink_R"], 0);
  found = preset({{"jawOpen", 0.7F}, {"mouthClose", 0.1F}});
  EXPECT_NEAR(found["A"], 0.6F, 1e-6F);
  EXPECT_EQ(found["I"] + found["U"] + found["E"] + found["O"], 0);
  found = preset({{"jawOpen", 0.5F}, {"mouthFunnel", 1}});
  EXPECT_NEAR(found["O"], 0.5F, 1e-6F);
  EXPECT_NEAR(found["U"], 0.5F, 1e-6F);
  EXPECT_EQ(found["A"], 0);
  found = preset({{"mouthStretchLeft", 1}, {"mouthStretchRight", 1}, {"jawOpen", 0.25F}});
  EXPECT_NEAR(found["E"], 0.25F, 1e-6F);
  EXPECT_NEAR(found["I"], 0.75F, 1e-6F);
  found = preset({{"mouthSmileLeft", 1}, {"mouthSmileRight", 1}, {"cheekSquintLeft", 0.5F}});
  EXPECT_NEAR(found["Joy"], 0.25F, 1e-6F);
  EXPECT_NEAR(found["Fun"], 0.75F, 1e-6F);
  found = preset({{"eyeLookOutLeft", 0.5F}, {"eyeLookInRight", 0.5F}, {"eyeLookUpLeft", 1}});
  EXPECT_NEAR(found["LookLeft"], 0.5F, 1e-6F) << "the person's and the avatar's left";
  EXPECT_NEAR(found["LookUp"], 0.5F, 1e-6F);
  EXPECT_EQ(found["LookRight"], 0);

  constexpr unsigned kSeed = 20'261'129;
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> any(0, 1);
  const MappedValues presets = vrm_presets();
  for (int round = 0; round < 1000; ++round) {
    FaceState state = face({});
    for (float& value : state.values) {
      value = any(random);
    }
    std::map<std::string, float> now;
    for (const MappedValue& one : presets) {
      now[one.name] = one.formula.of(state.values);
      EXPECT_GE(now[one.name], 0) << one.name << ", seed " << kSeed << ", round " << round;
    }
    EXPECT_LE(now["A"] + now["I"] + now["U"] + now["E"] + now["O"], 1 + 1e-5F) << kSeed << " " << round;
    EXPECT_LE(now["Joy"] + now["Angry"] + now["Sorrow"] + now["Fun"], 1 + 1e-5F) << kSeed << " " << round;
  }
}

TEST_F(Messages, AMappedNameTakesThePlaceOfWhatIsSentAnyway) {
  constexpr NamedFormula kChosen[] = {
      {"JawOpen", "2 * jawOpen"}, {"Joy", "0"}, {"Mood", "jawOpen - 1"}, {"Big", "3"}};
  const FaceState state = face({{"jawOpen", 0.25F}, {"mouthSmileLeft", 1}, {"cheekSquintLeft", 1}});
  auto found = blends(vmc(state, VmcShapes::Both, true, mapped_values(kChosen)));
  EXPECT_EQ(found.size(), 52 + 16 + 2U);
  EXPECT_EQ(found["JawOpen"], 0.5F);
  EXPECT_EQ(found["Joy"], 0);
  EXPECT_EQ(found["Mood"], 0) << "VMC's values are 0 to 1";
  EXPECT_EQ(found["Big"], 1);
  EXPECT_EQ(found["MouthSmileLeft"], 1);
}

/// Names of VRCFaceTracking's parameters that widespread avatars have.
TEST_F(Messages, VrChatGetsUnifiedExpressions) {
  VrChatWriter writer({});
  const FaceState state = face({{"jawOpen", 0.75F},
                                {"jawLeft", 0.5F},
                                {"eyeBlinkLeft", 1},
                                {"eyeWideRight", 1},
                                {"mouthSmileLeft", 0.5F},
                                {"mouthFrownLeft", 0.75F},
                                {"eyeLookUpLeft", 0.6F},
                                {"eyeLookUpRight", 0.6F},
                                {"eyeLookInLeft", 0.5F},
                                {"eyeLookOutRight", 0.5F}});
  const json messages = vrchat(writer, state, 0);
  const auto value = [&](const std::string& name) {
    return message(messages, "/avatar/parameters/" + name)[1];
  };
  for (const char* prefix : {"v2/", "FT/v2/"}) {
    const auto v2 = [&](const char* name) { return value(prefix + std::string(name)).get<float>(); };
    EXPECT_EQ(v2("JawOpen"), 0.75F);
    EXPECT_EQ(v2("JawX"), -0.5F) << "to the right is positive";
    EXPECT_EQ(v2("EyeLidLeft"), 0);
    EXPECT_EQ(v2("EyeLidRight"), 1) << "wide open; open is 0.75";
    EXPECT_EQ(v2("EyeClosedLeft"), 1);
    EXPECT_EQ(v2("SmileFrownLeft"), -0.25F);
    EXPECT_NEAR(v2("EyeY"), 0.6F, 1e-6F);
    EXPECT_EQ(v2("EyeLeftX"), 0.5F) << "to the right";
    EXPECT_EQ(v2("EyeRightX"), 0.5F);
  }
  for (const char* name : {"EyeTrackingActive", "ExpressionTrackingActive", "LipTrackingActive"}) {
    EXPECT_EQ(value(name), true) << name;
  }
  // https://docs.vrchat.com/docs/osc-eye-tracking: a target 15 degrees up and 20 to the right is
  // "-15.252, 20.128" as pitch and yaw, of each eye here: 0.6 of 25 degrees up, half of 30 aside.
  const json gaze = message(messages, "/tracking/eye/LeftRightPitchYaw");
  ASSERT_EQ(gaze.size(), 5U);
  for (const std::size_t eye : {1U, 3U}) {
    EXPECT_NEAR(gaze[eye].get<float>(), -15, 1e-4F);
    EXPECT_NEAR(gaze[eye + 1].get<float>(), 15, 1e-4F);
  }
  EXPECT_EQ(message(messages, "/tracking/eye/EyesClosedAmount")[1], 0.5F);
  std::set<std::string> addresses;
  for (const json& one : messages) {
    EXPECT_TRUE(addresses.insert(one[0]).second) << one;
  }
}

TEST_F(Messages, VrChatGetsWhatChangesAndAllEverySecond) {
  constexpr NamedFormula kChosen[] = {{"v2/JawOpen", "jawOpen / 2"}, {"Mood", "-2 * jawOpen"}};
  VrChatWriter writer(mapped_values(kChosen));
  const std::size_t all = vrchat(writer, face({}), 0).size();
  EXPECT_EQ(all, 3 + 2 * unified_expressions().size() + 1 + 2) << "v2/JawOpen is sent once";
  EXPECT_EQ(vrchat(writer, face({}), 0.2F).size(), 2U) << "the gaze alone, which VRChat forgets after 10 s";
  const json moved = vrchat(writer, face({{"jawOpen", 1}}), 0.4F);
  EXPECT_EQ(message(moved, "/avatar/parameters/v2/JawOpen")[1], 0.5F);
  EXPECT_EQ(message(moved, "/avatar/parameters/FT/v2/JawOpen")[1], 1);
  EXPECT_EQ(message(moved, "/avatar/parameters/Mood")[1], -1) << "-1 to 1";
  EXPECT_EQ(moved.size(), 3 + 2U);
  EXPECT_EQ(vrchat(writer, face({{"jawOpen", 0.9995F}}), 0.6F).size(), 2U) << "hardly a change";
  EXPECT_EQ(vrchat(writer, face({{"jawOpen", 1}}), 1).size(), all);

  FaceState gone = face({{"jawOpen", 1}});
  gone.tracked = false;
  const json lost = vrchat(writer, gone, 1.1F);
  EXPECT_EQ(lost.size(), 3U);
  EXPECT_EQ(message(lost, "/avatar/parameters/EyeTrackingActive")[1], false);
  EXPECT_EQ(vrchat(writer, gone, 1.2F).size(), 0U);
  EXPECT_EQ(vrchat(writer, gone, 2.1F).size(), 3U) << "an avatar that was changed meanwhile";
}

/// The packet of https://www.ifacialmocap.com/for-developer/, and one that was sent while its person looked
/// to the own left (the wiki of vpuppr, trackers).
constexpr const char* kPublished =
    "mouthSmile_R-0|eyeLookOut_L-0|mouthUpperUp_L-11|eyeWide_R-0|mouthClose-8|mouthPucker-4|mouthRollLower-9|"
    "eyeBlink_R-7|eyeLookDown_L-17|cheekSquint_R-11|eyeBlink_L-7|tongueOut-0|jawRight-0|eyeLookIn_R-6|"
    "cheekSquint_L-11|mouthDimple_L-10|mouthPress_L-4|eyeSquint_L-11|mouthRight-0|mouthShrugLower-9|"
    "eyeLookUp_R-0|eyeLookOut_R-0|mouthPress_R-5|cheekPuff-2|jawForward-11|mouthLowerDown_L-9|mouthFrown_L-6|"
    "mouthShrugUpper-26|browOuterUp_L-4|browInnerUp-20|mouthDimple_R-10|browDown_R-0|mouthUpperUp_R-10|"
    "mouthRollUpper-8|mouthFunnel-12|mouthStretch_R-21|mouthFrown_R-13|eyeLookDown_R-17|jawOpen-12|jawLeft-0|"
    "browDown_L-0|mouthSmile_L-0|noseSneer_R-18|mouthLowerDown_R-8|noseSneer_L-21|eyeWide_L-0|"
    "mouthStretch_L-21|browOuterUp_R-4|eyeLookIn_L-4|eyeSquint_R-11|eyeLookUp_L-0|mouthLeft-1|"
    "=head#-21.488958,-6.038993,-6.6019735,-0.030653415,-0.10287084,-0.6584072|"
    "rightEye#6.0297494,2.4403017,0.25649446|leftEye#6.034903,-1.6660284,-0.17520553|";
constexpr const char* kLooksLeft =
    "eyeLookIn_R-54|eyeLookDown_L-16|eyeLookDown_R-16|eyeLookOut_L-44|=head#-1.6704091,-7.3032465,2.886358,"
    "0.084120944,0.03458406,-0.4721467|rightEye#5.3555145,19.067966,1.8478252|"
    "leftEye#5.5607924,15.616646,1.5515244|";

TEST_F(Messages, IFacialMocapIsAsItWasPublished) {
  const json published = test::decode("ifacialmocap", {kPublished}, folder_.path())[0];
  const json looks_left = test::decode("ifacialmocap", {kLooksLeft}, folder_.path())[0];
  // Which of the 52 a name is: one packet for each, in which it alone is 1.
  std::vector<std::vector<std::byte>> ones(mesh::kArkitNames.size());
  for (std::size_t i = 0; i < ones.size(); ++i) {
    FaceState one = face({});
    one.values.at(i) = 1;
    write_ifacialmocap(one, IFacialMocapVersion::V1, ones[i]);
  }
  const json packets = test::decode("ifacialmocap", test::texts(ones), folder_.path());
  std::map<std::string, std::size_t> index_of;
  for (std::size_t i = 0; i < packets.size(); ++i) {
    for (const auto& [name, value] : packets[i]["values"].items()) {
      if (value == 100) {
        EXPECT_TRUE(index_of.emplace(name, i).second) << name;
      }
    }
  }
  EXPECT_EQ(index_of.size(), 52U);
  const auto with_values_of = [&](const json& packet) {
    FaceState out = face({});
    for (const auto& [name, value] : packet["values"].items()) {
      EXPECT_TRUE(index_of.contains(name)) << name;
      out.values.at(index_of[name]) = 0.01F * value.get<float>();
    }
    return out;
  };
  const json again = ifacialmocap(with_values_of(published));
  EXPECT_EQ(again["values"], published["values"]) << "names and numbers";
  EXPECT_EQ(mesh::arkit_name(index_of["mouthSmile_L"]), "mouthSmileLeft");
  // The eyes turn the same way by the same values; how far is another model's.
  for (const json& packet : {published, looks_left}) {
    const json ours = ifacialmocap(with_values_of(packet));
    for (const char* eye : {"leftEye", "rightEye"}) {
      ASSERT_EQ(ours[eye].size(), 3U);
      for (const std::size_t axis : {0U, 1U}) {
        EXPECT_GT(ours[eye][axis].get<float>() * packet[eye][axis].get<float>(), 0) << eye << axis;
      }
    }
    EXPECT_EQ(ours["=head"].size(), packet["=head"].size());
  }
}

TEST_F(Messages, IFacialMocapsSecondVersionDiffersBeforeTheNumbersAlone) {
  FaceState state = turned(20 * kDegree, 10 * kDegree, -5 * kDegree);
  state.values.fill(0.25F);
  std::vector<std::vector<std::byte>> out(2);
  write_ifacialmocap(state, IFacialMocapVersion::V1, out[0]);
  write_ifacialmocap(state, IFacialMocapVersion::V2, out[1]);
  const std::string first = test::texts(out)[0];
  std::string second = test::texts(out)[1];
  EXPECT_THAT(first, HasSubstr("mouthSmile_L-25|"));
  EXPECT_THAT(second, HasSubstr("mouthSmile_L&25|"));
  EXPECT_EQ(std::count(first.begin(), first.end(), '&'), 0);
  EXPECT_EQ(std::count(second.begin(), second.end(), '&'), 52);
  std::replace(second.begin(), second.end(), '&', '-');
  EXPECT_EQ(second, first);
}

TEST_F(Messages, IFacialMocapTellsTheHeadInDegreesAndMetres) {
  FaceState state = turned(20 * kDegree, 10 * kDegree, 5 * kDegree);
  state.upright_from_head.translation() << 0.084F, 0.035F, -0.472F;
  const json head = ifacialmocap(state)["=head"];
  ASSERT_EQ(head.size(), 6U);
  EXPECT_NEAR(head[0].get<float>(), 10, 1e-3F) << "down";
  EXPECT_NEAR(head[1].get<float>(), 20, 1e-3F) << "to the own left";
  EXPECT_NEAR(head[2].get<float>(), 5, 1e-3F) << "towards the own right shoulder";
  EXPECT_NEAR(head[3].get<float>(), 0.084F, 1e-5F);
  EXPECT_NEAR(head[4].get<float>(), 0.035F, 1e-5F);
  EXPECT_NEAR(head[5].get<float>(), -0.472F, 1e-5F) << "before the camera";
}

/// A packet of the app (the same wiki), without most of its values: its person looks to the own left.
constexpr const char* kVTubeStudio = R"({"Timestamp":1664817520079,"Hotkey":-1,"FaceFound":true,
"Rotation":{"x":-11.091268539428711,"y":9.422998428344727,"z":3.1646311283111574},
"Position":{"x":0.4682624340057373,"y":1.3167941570281983,"z":4.734524726867676},
"EyeLeft":{"x":3.5520474910736086,"y":9.085052490234375,"z":0.5114284753799439},
"EyeRight":{"x":3.459942579269409,"y":12.89495849609375,"z":0.7132274508476257},
"BlendShapes":[{"k":"EyeLookInLeft","v":0.0},{"k":"EyeLookOutLeft","v":0.2591644525527954},
{"k":"EyeLookInRight","v":0.3678726553916931},{"k":"EyeLookDownLeft","v":0.09258905798196793},
{"k":"EyeLookDownRight","v":0.09135865420103073},{"k":"JawOpen","v":0.10355126112699509}]})";

TEST_F(Messages, VTubeStudioIsAsTheAppSendsIt) {
  const json published = json::parse(kVTubeStudio);
  FaceState state = turned(20 * kDegree, 10 * kDegree, 0);
  state.upright_from_head.translation() << 0.05F, 0.13F, -0.47F;
  for (const json& shape : published["BlendShapes"]) {
    const int index = mesh::arkit_index(shape["k"].get<std::string>());
    ASSERT_GE(index, 0) << shape;
    state.values.at(static_cast<std::size_t>(index)) = shape["v"].get<float>();
  }
  const json ours = vtube_studio(state);
  const auto keys = [](const json& object) {
    std::set<std::string> out;
    for (const auto& [key, value] : object.items()) {
      out.insert(key);
    }
    return out;
  };
  EXPECT_EQ(keys(ours), keys(published));
  EXPECT_EQ(ours["Timestamp"], published["Timestamp"]);
  EXPECT_EQ(ours["Hotkey"], -1);
  EXPECT_EQ(ours["FaceFound"], true);
  EXPECT_EQ(ours["BlendShapes"].size(), 52U);
  EXPECT_EQ(keys(ours["BlendShapes"][0]), keys(published["BlendShapes"][0]));
  EXPECT_THAT(ours["BlendShapes"], ::testing::Contains(json{{"k", "JawOpen"}, {"v", 0.103551}}));
  for (const char* eye : {"EyeLeft", "EyeRight"}) {
    for (const char* axis : {"x", "y"}) {
      EXPECT_GT(ours[eye][axis].get<float>() * published[eye][axis].get<float>(), 0) << eye << axis;
    }
  }
  EXPECT_NEAR(ours["Rotation"]["y"].get<float>(), 20, 1e-3F);
  EXPECT_NEAR(ours["Rotation"]["x"].get<float>(), 10, 1e-3F);
  EXPECT_NEAR(ours["Position"]["z"].get<float>(), 4.7F, 1e-4F) << "tenths of a metre from the camera";
  EXPECT_NEAR(ours["Position"]["y"].get<float>(), 1.3F, 1e-4F);

  state.tracked = false;
  const json lost = vtube_studio(state);
  EXPECT_EQ(lost["FaceFound"], false);
  EXPECT_TRUE(lost["BlendShapes"].empty());
  EXPECT_EQ(keys(lost), keys(published)) << "Unity's reader wants every key";
}

/// VRCFaceTracking's module for Live Link takes packets of this length alone
/// (https://github.com/VRCFaceTracking/LiveLinkTrackingModule, ArKitPacketReader).
TEST(LiveLink, ASubjectOfSixLettersMakesAPacketOf312Bytes) {
  std::vector<std::byte> out;
  write_live_link_face(face({}), std::string(36, 'x'), "facets", 0, out);
  EXPECT_EQ(out.size(), 312U);
}

/// Another's reader of Open Sound Control makes of VMC's and VRChat's bundles what ours does.
TEST_F(Messages, OscMinReadsVmcAndVrChat) {
  const std::filesystem::path reader = test::assets() / "osc-min";
  const std::string node = "/usr/bin/node";
  if (!std::filesystem::exists(node) || !std::filesystem::exists(reader / "package.json")) {
    GTEST_SKIP() << "Node.js or " << reader << " is not there (packaging/fetch-assets)";
  }
  const FaceState state =
      face({{"jawOpen", 0.75F}, {"eyeLookOutLeft", 1}, {"eyeBlinkRight", 0.3F}, {"mouthSmileLeft", 0.5F}});
  constexpr NamedFormula kChosen[] = {{"Mood", "jawOpen / 3"}};
  OscBundles vmc_bundles(kMostDatagram);
  write_vmc(state, 1, false, vmc_content(VmcShapes::Both, true, mapped_values(kChosen)), vmc_bundles);
  OscBundles vrchat_bundles(kMostDatagram);
  VrChatWriter(mapped_values(kChosen)).write(state, 0, vrchat_bundles);
  for (const OscBundles& bundles : {vmc_bundles, vrchat_bundles}) {
    const std::vector<std::string> datagrams = test::texts(bundles.bundles());
    EXPECT_GT(datagrams.size(), 1U);
    const json ours = test::decode("osc", datagrams, folder_.path());
    const std::filesystem::path file = test::write_datagrams(datagrams, folder_.path());
    test::ChildProcess child(node,
                             {READ_OSC_SCRIPT, std::filesystem::absolute(reader).string(), file.string()},
                             folder_.path() / "read");
    ASSERT_EQ(child.wait(), 0) << child.output();
    EXPECT_EQ(json::parse(child.output()), ours);
  }
}

/// Without a face, or with a booth's mesh, each protocol says what it can.
TEST(BridgeMessages, SayWhatThereIsToSay) {
  BridgeMessages messages("device", "facet", {VmcShapes::PerfectSync, true});
  FaceState state = face({});
  const auto counts = [&] {
    std::array<std::size_t, kBridgeProtocols.size()> out{};
    messages.begin(state, false);
    for (const BridgeProtocolNames& each : kBridgeProtocols) {
      out.at(static_cast<std::size_t>(each.protocol)) =
          std::min<std::size_t>(1, messages.of(each.protocol).size());
    }
    return out;
  };
  EXPECT_THAT(counts(), ElementsAre(1, 1, 1, 1, 1, 0)) << "plug-ins get none";
  state.has_expression = false;
  EXPECT_THAT(counts(), ElementsAre(1, 0, 0, 1, 1, 0))
      << "VRChat and VTube Studio hear that there are no values";
  state.tracked = false;
  EXPECT_THAT(counts(), ElementsAre(1, 0, 0, 0, 1, 0)) << "VRChat has heard it";
  EXPECT_EQ(&messages.of(BridgeProtocol::Vmc), &messages.of(BridgeProtocol::Vmc));
}

TEST(BridgeMessages, EachVersionIsWrittenOnce) {
  BridgeMessages messages("device", "facet", {VmcShapes::PerfectSync, true});
  messages.begin(face({}), false);
  const auto* first = &messages.of(BridgeProtocol::IFacialMocap, IFacialMocapVersion::V1);
  const auto* second = &messages.of(BridgeProtocol::IFacialMocap, IFacialMocapVersion::V2);
  ASSERT_EQ(first->size(), 1U);
  ASSERT_EQ(second->size(), 1U);
  EXPECT_NE(first->front(), second->front());
  const std::byte* const written = second->front().data();
  EXPECT_EQ(&messages.of(BridgeProtocol::IFacialMocap), first);
  EXPECT_EQ(&messages.of(BridgeProtocol::IFacialMocap, IFacialMocapVersion::V2), second);
  EXPECT_EQ(second->front().data(), written);
}

}  // namespace
}  // namespace facet::avatar
