// VTube Studio's API for plug-ins: what is said, and to a peer that speaks it on another's WebSockets.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <fstream>
#include <functional>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "avatar/bridge.hpp"
#include "avatar/vts_link.hpp"
#include "avatar/vts_session.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "support/child_process.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"

namespace facet::avatar {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

FaceState face_with(const std::vector<std::pair<const char*, float>>& values) {
  FaceState state;
  state.tracked = state.has_expression = true;
  for (const auto& [name, value] : values) {
    state.values.at(static_cast<std::size_t>(mesh::arkit_index(name))) = value;
  }
  return state;
}

std::map<std::string, float> by_name(const VtsParameters& parameters) {
  std::map<std::string, float> out;
  for (const VtsParameter& parameter : parameters) {
    EXPECT_TRUE(out.emplace(parameter.id, parameter.value).second) << parameter.id << " stands twice";
  }
  return out;
}

std::string answer(const char* type, const std::string& id, const json& data) {
  return json{{"apiName", "VTubeStudioPublicAPI"},
              {"apiVersion", "1.0"},
              {"timestamp", 1},
              {"messageType", type},
              {"requestID", id},
              {"data", data}}
      .dump();
}

std::string error(const std::string& id, int number) {
  return answer("APIError", id, {{"errorID", number}, {"message", "words"}});
}

VtsSession ready_session() {
  VtsSession session("abc");
  session.begin();
  session.take(answer("AuthenticationResponse", "token", {{"authenticated", true}}));
  EXPECT_EQ(session.state(), VtsSession::State::Ready);
  return session;
}

TEST(VtsParameters, AreVTubeStudiosOwnAtRestAndMoved) {
  const auto rest = by_name(vts_parameters(face_with({}), {}, false));
  EXPECT_THAT(rest, SizeIs(21));
  for (const char* half : {"MouthSmile", "Brows", "BrowLeftY", "BrowRightY"}) {
    EXPECT_EQ(rest.at(half), 0.5F) << half;
  }
  EXPECT_EQ(rest.at("EyeOpenLeft"), 1);
  for (const char* nothing :
       {"MouthOpen", "MouthX", "EyeLeftX", "FaceAngleX", "FacePositionZ", "TongueOut"}) {
    EXPECT_EQ(rest.at(nothing), 0) << nothing;
  }
  const auto moved = by_name(vts_parameters(face_with({{"mouthSmileLeft", 1},
                                                       {"mouthSmileRight", 1},
                                                       {"jawOpen", 0.75F},
                                                       {"mouthLeft", 0.5F},
                                                       {"browDownLeft", 1},
                                                       {"browOuterUpRight", 1},
                                                       {"browInnerUp", 1},
                                                       {"eyeBlinkRight", 0.25F},
                                                       {"eyeLookInLeft", 1},
                                                       {"eyeLookOutRight", 1},
                                                       {"eyeLookDownLeft", 1}}),
                                            {}, false));
  EXPECT_EQ(moved.at("MouthSmile"), 1);
  EXPECT_EQ(moved.at("MouthOpen"), 0.75F);
  EXPECT_EQ(moved.at("MouthX"), 0.5F) << "to the own left";
  EXPECT_EQ(moved.at("BrowRightY"), 1);
  EXPECT_EQ(moved.at("BrowLeftY"), 0.25F);
  EXPECT_EQ(moved.at("EyeOpenRight"), 0.75F);
  EXPECT_EQ(moved.at("EyeLeftX"), 1) << "to the own right";
  EXPECT_EQ(moved.at("EyeRightX"), 1);
  EXPECT_EQ(moved.at("EyeLeftY"), -1);
  FaceState gone = face_with({});
  gone.tracked = false;
  EXPECT_THAT(vts_parameters(gone, {}, true), IsEmpty());
}

/// The head's signs beside Live Link's, whose are documented (mesh::live_link_angles).
TEST(VtsParameters, TheHeadIsInDegreesAndCentimetres) {
  const auto turned = [](const Eigen::Vector3f& axis) {
    FaceState state = face_with({});
    state.upright_from_head.linear() = Eigen::AngleAxisf(0.5F, axis).toRotationMatrix();
    return std::pair(by_name(vts_parameters(state, {}, false)),
                     mesh::live_link_angles(state.upright_from_head.linear()));
  };
  const auto [side, side_angles] = turned(Eigen::Vector3f::UnitY());
  EXPECT_NEAR(side.at("FaceAngleX"), -57.29578F * side_angles[0], 1e-3F) << "to the own left";
  EXPECT_NEAR(std::abs(side.at("FaceAngleX")), 28.65F, 0.01F);
  const auto [nod, nod_angles] = turned(Eigen::Vector3f::UnitX());
  EXPECT_NEAR(nod.at("FaceAngleY"), -57.29578F * nod_angles[1], 1e-3F) << "up";
  EXPECT_NEAR(std::abs(nod.at("FaceAngleY")), 28.65F, 0.01F);
  const auto [lean, lean_angles] = turned(Eigen::Vector3f::UnitZ());
  EXPECT_NEAR(lean.at("FaceAngleZ"), 57.29578F * lean_angles[2], 1e-3F) << "to the own left shoulder";
  EXPECT_NEAR(std::abs(lean.at("FaceAngleZ")), 28.65F, 0.01F);
  FaceState moved = face_with({});
  moved.upright_from_head.translation() = Eigen::Vector3f(0.01F, 0.02F, 0.03F);
  const auto place = by_name(vts_parameters(moved, {}, false));
  EXPECT_FLOAT_EQ(place.at("FacePositionX"), 1);
  EXPECT_FLOAT_EQ(place.at("FacePositionY"), 2);
  EXPECT_FLOAT_EQ(place.at("FacePositionZ"), -3) << "further away is more";
}

TEST(VtsParameters, ChosenOnesAndArkitsStandBesides) {
  const MappedValues chosen = {{"MouthOpen", Formula("2 * jawOpen")}, {"Mood", Formula("7")}};
  const auto values = by_name(vts_parameters(face_with({{"jawOpen", 0.5F}}), chosen, true));
  EXPECT_EQ(values.at("MouthOpen"), 1);
  EXPECT_EQ(values.at("Mood"), 7);
  EXPECT_EQ(values.at("JawOpen"), 0.5F);
  EXPECT_THAT(values, SizeIs(21 + 1 + 52 - 2)) << "CheekPuff and TongueOut are VTube Studio's own";
}

TEST(VtsSession, APersonIsAskedOnceAndTheTokenIsShownFromThenOn) {
  VtsSession first("");
  const json asked = json::parse(first.begin());
  EXPECT_EQ(asked["messageType"], "AuthenticationTokenRequest");
  EXPECT_EQ(first.state(), VtsSession::State::Asking);
  EXPECT_THAT(first.trouble(), HasSubstr("waits for permission"));
  EXPECT_FALSE(first.waits()) << "a person may take as long as they like";
  const auto shown =
      first.take(answer("AuthenticationTokenResponse", "token", {{"authenticationToken", "abc"}}));
  ASSERT_THAT(shown, SizeIs(1));
  EXPECT_EQ(json::parse(shown[0])["data"]["authenticationToken"], "abc");
  EXPECT_EQ(first.token(), "abc");
  EXPECT_TRUE(first.waits());

  VtsSession later("abc");
  EXPECT_EQ(json::parse(later.begin())["messageType"], "AuthenticationRequest");
  const auto again = later.take(answer("AuthenticationResponse", "token", {{"authenticated", false}}));
  ASSERT_THAT(again, SizeIs(1)) << "permission was taken back";
  EXPECT_EQ(json::parse(again[0])["messageType"], "AuthenticationTokenRequest");
  EXPECT_EQ(later.token(), "");
  EXPECT_THAT(later.take(error("token", 50)), IsEmpty());
  EXPECT_EQ(later.state(), VtsSession::State::Refused);
  EXPECT_THAT(later.inject({{"MouthOpen", 1}}), IsEmpty());
}

TEST(VtsSession, CustomParametersAreCreatedBeforeTheyAreSent) {
  VtsSession session = ready_session();
  const VtsParameters frame = {{"MouthOpen", 1}, {"JawOpen", 0.5F}, {"OfAnother", 2}, {"Refused", 3}};
  const auto first = session.inject(frame);
  ASSERT_THAT(first, SizeIs(4));
  EXPECT_EQ(json::parse(first[0])["data"]["parameterName"], "JawOpen");
  EXPECT_THAT(json::parse(first[3])["data"]["parameterValues"], SizeIs(1));
  session.take(answer("ParameterCreationResponse", "create-JawOpen", {{"parameterName", "JawOpen"}}));
  session.take(error("create-OfAnother", 352));
  session.take(error("create-Refused", 350));
  EXPECT_THAT(session.trouble(), HasSubstr("words (error 350)"));
  const auto second = session.inject(frame);
  ASSERT_THAT(second, SizeIs(1)) << "each is created once";
  const json values = json::parse(second[0])["data"]["parameterValues"];
  EXPECT_THAT(values, SizeIs(3)) << values;
  EXPECT_EQ(values[2]["id"], "OfAnother") << "another plug-in's is there all the same";
}

TEST(VtsSession, FramesThatAreNotAnsweredAreBounded) {
  VtsSession session = ready_session();
  const auto sent = [&] { return session.inject({{"MouthOpen", 1}}).size(); };
  for (std::size_t i = 0; i < VtsSession::kMostUnanswered; ++i) {
    EXPECT_EQ(sent(), 1U);
  }
  EXPECT_EQ(sent(), 0U);
  session.take(error("frame", 454));
  EXPECT_THAT(session.trouble(), HasSubstr("words (error 454)"));
  EXPECT_EQ(sent(), 1U) << "an error is an answer";
  session.take(answer("InjectParameterDataResponse", "frame", json::object()));
  EXPECT_EQ(session.trouble(), "");
  session.take(error("frame", 8));
  EXPECT_EQ(session.state(), VtsSession::State::Over);
  EXPECT_EQ(session.token(), "") << "permission was taken back";
}

TEST(VtsSession, GarbageEndsIt) {
  for (const std::string& text :
       {std::string("}{"), std::string(""), std::string("[]"), std::string("{}"),
        std::string(R"({"messageType":7})"), std::string(100'000, '['),
        answer("AuthenticationTokenResponse", "token", json::object()),
        answer("AuthenticationTokenResponse", "token", {{"authenticationToken", std::string(300, 'x')}}),
        answer("AuthenticationTokenResponse", "token", {{"authenticationToken", "a\nb"}})}) {
    VtsSession session("");
    session.begin();
    EXPECT_THAT(session.take(text), IsEmpty()) << text.substr(0, 80);
    EXPECT_EQ(session.state(), VtsSession::State::Over) << text.substr(0, 80);
    EXPECT_EQ(session.token(), "");
  }
  VtsSession session = ready_session();
  EXPECT_THAT(session.take(answer("SomethingNewEvent", "x", {{"a", 1}})), IsEmpty());
  EXPECT_EQ(session.state(), VtsSession::State::Ready) << "what a later release says is passed over";
}

TEST(VtsTokens, AreKeptForTheOwnerAlone) {
  const test::TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "vtube-studio.json";
  {
    VtsTokens tokens(file);
    EXPECT_EQ(tokens.of("localhost:8001"), "");
    tokens.keep("localhost:8001", "abc");
    tokens.keep("[::1]:8001", "def");
  }
  struct stat about {};
  ASSERT_EQ(::stat(file.c_str(), &about), 0);
  EXPECT_EQ(about.st_mode & 0777U, 0600U);
  VtsTokens tokens(file);
  EXPECT_EQ(tokens.of("localhost:8001"), "abc");
  tokens.keep("localhost:8001", "");
  EXPECT_EQ(VtsTokens(file).of("localhost:8001"), "");
  EXPECT_EQ(VtsTokens(file).of("[::1]:8001"), "def");
  std::ofstream(file) << R"({"facet_vts": 1, "tokens": 7})";
  const VtsTokens damaged(file);
  EXPECT_THAT(damaged.fault(), HasSubstr("set aside"));
  EXPECT_EQ(damaged.of("[::1]:8001"), "");
  EXPECT_FALSE(std::filesystem::exists(file));
}

/// A VTube Studio on another's WebSockets (vts-server.mjs).
class VtsServer {
 public:
  VtsServer(const std::filesystem::path& folder, const std::string& scenario, int port = 0)
      : child_("/usr/bin/node", {VTS_SERVER_SCRIPT, PLAYWRIGHT_FOLDER, scenario, std::to_string(port)},
               folder / ("vts-" + scenario + std::to_string(port))) {
    port_ = wait_for([](const json& line) { return line.contains("port"); })["port"];
  }

  int port() const { return port_; }
  BridgeTarget target() const {
    return {BridgeProtocol::VTubeStudioPlugin, "127.0.0.1", static_cast<std::uint16_t>(port_)};
  }
  std::vector<json> lines() {
    std::vector<json> out;
    std::istringstream text(child_.output());
    for (std::string line; std::getline(text, line);) {
      if (!text.eof()) {  // the last one may be half
        out.push_back(json::parse(line));
      }
    }
    return out;
  }
  std::size_t count(const char* what) {
    std::size_t found = 0;
    for (const json& line : lines()) {
      EXPECT_FALSE(line.contains("fault")) << line;
      found += line.contains(what) ? 1 : 0;
    }
    return found;
  }
  /// The first line that is so; `meanwhile` again and again until then.
  json wait_for(
      const std::function<bool(const json&)>& is_it, const std::function<void()>& meanwhile = [] {}) {
    for (const auto end = Clock::now() + 60s; Clock::now() < end; std::this_thread::sleep_for(10ms)) {
      for (const json& line : lines()) {
        if (is_it(line)) {
          return line;
        }
      }
      meanwhile();
    }
    ADD_FAILURE() << "nothing of the kind came: " << child_.output();
    return json::object();
  }

 private:
  test::ChildProcess child_;
  int port_ = 0;
};

class VtsLinkTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists("/usr/bin/node") || !std::filesystem::exists(PLAYWRIGHT_FOLDER)) {
      GTEST_SKIP() << "Node.js or " << PLAYWRIGHT_FOLDER << " is not there (clients/kiosk/fetch-modules)";
    }
  }
  std::unique_ptr<VtsLink> link_to(const BridgeTarget& target) {
    const VtsPatience patience{10ms, 50ms, 400ms};
    auto link = std::make_unique<VtsLink>(target, tokens_, look_up_host, patience);
    link->start();
    return link;
  }
  static void publish(VtsLink& link, float open) {
    link.publish(
        std::make_shared<const VtsParameters>(VtsParameters{{"MouthOpen", open}, {"JawOpen", open}}));
  }
  /// part: "" where there is to be none.
  static void wait_for_reason(const VtsLink& link, const std::string& part) {
    for (const auto end = Clock::now() + 60s; Clock::now() < end; std::this_thread::sleep_for(5ms)) {
      const std::string reason = link.status().reason;
      if (part.empty() ? reason.empty() : reason.find(part) != std::string::npos) {
        return;
      }
    }
    ADD_FAILURE() << "'" << part << "' was not told, but '" << link.status().reason << "'";
  }
  static bool is_injected(const json& line) {
    return line.contains("injected") && line["injected"].contains("JawOpen");
  }

  test::TemporaryFolder folder_;
  VtsTokens tokens_{folder_.path() / "tokens.json"};
};

TEST_F(VtsLinkTest, OnceAllowedItSendsAndNobodyIsAskedAgain) {
  VtsServer server(folder_.path(), "allow");
  {
    const auto link = link_to(server.target());
    const json frame = server.wait_for(is_injected, [&] { publish(*link, 0.25F); });
    EXPECT_EQ(frame["injected"]["MouthOpen"], 0.25);
    EXPECT_EQ(frame["faceFound"], true);
    EXPECT_FALSE(frame.contains("wrong")) << frame;
    wait_for_reason(*link, "");
    EXPECT_GE(link->status().frames, 1U);
    // A face that holds still is sent again before VTube Studio takes it for lost.
    const std::size_t before = server.count("injected");
    server.wait_for([&](const json&) { return server.count("injected") > before + 2; });
  }
  EXPECT_EQ(server.count("asked"), 1U);
  EXPECT_EQ(tokens_.of(server.target().text()), "token-1");
  const std::size_t shown = server.count("shown");
  const auto link = link_to(server.target());
  server.wait_for([&](const json&) { return server.count("shown") > shown; });
  publish(*link, 0.5F);
  server.wait_for([](const json& line) { return is_injected(line) && line["injected"]["MouthOpen"] == 0.5; },
                  [&] { publish(*link, 0.5F); });
  EXPECT_EQ(server.count("asked"), 1U) << "the token is enough";
  EXPECT_EQ(server.count("created"), 2U) << "once a connection";
}

TEST_F(VtsLinkTest, WhoSaysNoIsNotAskedAgain) {
  VtsServer server(folder_.path(), "deny");
  const auto link = link_to(server.target());
  wait_for_reason(*link, "permission was refused");
  publish(*link, 0.5F);
  std::this_thread::sleep_for(300ms);
  EXPECT_EQ(server.count("asked"), 1U);
  EXPECT_EQ(server.count("injected"), 0U);
  EXPECT_EQ(link->status().frames, 0U);
}

TEST_F(VtsLinkTest, PermissionThatWasTakenBackIsAskedForAgain) {
  VtsServer server(folder_.path(), "revoked");
  tokens_.keep(server.target().text(), "token-1");
  const auto link = link_to(server.target());
  server.wait_for(is_injected, [&] { publish(*link, 0.5F); });
  EXPECT_EQ(server.count("asked"), 1U);
  EXPECT_EQ(tokens_.of(server.target().text()), "token-2");
}

TEST_F(VtsLinkTest, PermissionThatIsTakenBackWhileItSendsIsAskedForAgain) {
  VtsServer server(folder_.path(), "revoke");
  tokens_.keep(server.target().text(), "token-1");
  const auto link = link_to(server.target());
  server.wait_for([](const json& line) { return line.contains("asked"); }, [&] { publish(*link, 0.5F); });
  const std::size_t before = server.count("injected");
  server.wait_for([&](const json&) { return server.count("injected") > before; },
                  [&] { publish(*link, 0.5F); });
}

TEST_F(VtsLinkTest, AServerThatGoesAwayIsToldAndFoundAgain) {
  auto server = std::make_unique<VtsServer>(folder_.path(), "allow");
  const int port = server->port();
  const auto link = link_to(server->target());
  server->wait_for(is_injected, [&] { publish(*link, 0.5F); });
  server.reset();
  wait_for_reason(*link, "Connection refused");
  VtsServer again(folder_.path(), "allow", port);
  again.wait_for(is_injected, [&] { publish(*link, 0.5F); });
  wait_for_reason(*link, "");
}

TEST_F(VtsLinkTest, GarbageAndSilenceAreTold) {
  VtsServer garbage(folder_.path(), "garbage");
  const auto link = link_to(garbage.target());
  wait_for_reason(*link, "no message of VTube Studio's API");
  VtsServer silent(folder_.path(), "silent");
  tokens_.keep(silent.target().text(), "token-1");
  const auto other = link_to(silent.target());
  wait_for_reason(*other, "does not answer");
}

TEST_F(VtsLinkTest, ABridgeHasItAmongItsTargets) {
  VtsServer server(folder_.path(), "allow");
  BridgeConfig config;
  config.neutral_file = folder_.path() / "neutral.json";
  config.vts_tokens_file = folder_.path() / "bridge-tokens.json";
  config.targets = {server.target()};
  Bridge bridge(config);
  bridge.start();
  const auto subject = test::patch_subject();
  auto frame = std::make_shared<mesh::MeshFrame>(test::patch_frame(0, subject, nullptr));
  frame->expression = {0.75F, 0.25F, 0.0F};
  const json sent = server.wait_for([](const json& line) { return line.contains("injected"); },
                                    [&] { bridge.publish(frame); });
  EXPECT_EQ(sent["injected"]["MouthOpen"], 0.75);
  EXPECT_EQ(sent["injected"].size(), 21U) << "none of ARKit's unless it is asked for";
  EXPECT_EQ(bridge.status().targets.at(0).reason, "");
  EXPECT_GE(bridge.status().targets.at(0).frames, 1U);
  EXPECT_EQ(bridge.status().targets.at(0).target.text(), server.target().text());
}

}  // namespace
}  // namespace facet::avatar
