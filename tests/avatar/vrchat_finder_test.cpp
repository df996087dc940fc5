// VRChats that are found: stand-ins of this test. tests/avatar/check-vrchat has somebody else's server of
// OSCQuery.

#include "avatar/vrchat_finder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "avatar/bridge.hpp"
#include "datagrams.hpp"
#include "support/eventually.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "vrchat_stand_in.hpp"

namespace facet::avatar {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;
using test::eventually;
using test::MdnsStandIn;
using test::WebStandIn;
using ::testing::Contains;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

/// Asks a stand-in, often; has all the time there is for an answer.
VrChatFinderConfig asking(const MdnsStandIn& mdns) {
  return {.where = VrChatFind::Machine, .every = 20ms, .patience = 1h, .asked = mdns.address()};
}

bool knows(const FoundVrChat& found, const std::string& avatar, std::size_t parameters) {
  return found.avatar != nullptr && found.avatar->avatar == avatar && found.avatar->list.size() == parameters;
}

TEST(VrChatFinder, TellsWhereAVrChatIsAndWhatItsAvatarHas) {
  MdnsStandIn mdns;
  WebStandIn web;
  web.tell_all(9007, "avtr_1", {{"v2/JawOpen", "f"}, {"v2/JawX1", "T"}});
  VrChatFinder finder(asking(mdns));
  finder.start();
  EXPECT_THAT(finder.found(), IsEmpty());
  mdns.tell({{"VRCFT-1", web.port()}, {"VRChat-Client-A1", web.port()}});
  ASSERT_TRUE(
      eventually([&] { return finder.found().size() == 1 && knows(finder.found()[0], "avtr_1", 2); }));
  EXPECT_EQ(finder.found()[0].name, "VRChat-Client-A1");
  EXPECT_EQ(finder.found()[0].target().text(), "127.0.0.1:9007");
  EXPECT_EQ(finder.fault(), "");

  web.tell_all(9007, "avtr_2", {{"v2/JawOpen", "f"}});
  EXPECT_TRUE(eventually([&] { return knows(finder.found().at(0), "avtr_2", 1); }))
      << "the avatar is another";
  web.tell("/avatar/change", "}{");
  web.tell("/avatar", "}{");
  EXPECT_TRUE(eventually([&] { return finder.found().at(0).avatar == nullptr; }))
      << "it says no more what it has";
  web.tell_all(9008, "avtr_2", {{"v2/JawOpen", "f"}});
  EXPECT_TRUE(eventually([&] { return finder.found().at(0).target().port == 9008; }));
  web.close();
  EXPECT_TRUE(eventually([&] { return finder.found().empty(); })) << "it is gone";
}

TEST(VrChatFinder, AsksForAPortThatAnAnswerLacks) {
  MdnsStandIn mdns;
  WebStandIn web;
  web.tell_all(9007, "avtr_1", {});
  mdns.tell({{"VRChat-Client-A1", web.port()}}, true);
  VrChatFinder finder(asking(mdns));
  finder.start();
  EXPECT_TRUE(eventually([&] { return finder.found().size() == 1; }));
  EXPECT_EQ(finder.found().at(0).avatar, nullptr) << "while an avatar is loaded it has nothing";
}

TEST(VrChatFinder, NobodyIsSentOnToAnotherMachine) {
  MdnsStandIn mdns;
  WebStandIn web;
  WebStandIn tcp;
  web.tell_all(9007, "avtr_1", {}, "192.0.2.99");
  tcp.tell("/?HOST_INFO", R"({"OSC_IP":"127.0.0.1","OSC_PORT":9000,"OSC_TRANSPORT":"TCP"})");
  mdns.tell({{"VRChat-Client-A1", web.port()}, {"VRChat-Client-A2", tcp.port()}});
  VrChatFinder finder(asking(mdns));
  finder.start();
  ASSERT_TRUE(eventually([&] { return !finder.found().empty() && tcp.asked() > 3; }));
  EXPECT_EQ(finder.found().at(0).target().text(), "127.0.0.1:9007");
  EXPECT_THAT(finder.found(), SizeIs(1)) << "OSC over TCP is none";
}

TEST(VrChatFinder, OneThatNeverAnswersDelaysNobody) {
  MdnsStandIn mdns;
  WebStandIn silent(true);
  WebStandIn web;
  web.tell_all(9007, "avtr_1", {{"v2/JawOpen", "f"}});
  mdns.tell({{"VRChat-Client-A1", silent.port()}, {"VRChat-Client-A2", web.port()}});
  VrChatFinder finder(asking(mdns));
  finder.start();
  ASSERT_TRUE(eventually([&] { return finder.found().size() == 1 && silent.asked() == 1; }));
  web.tell_all(9007, "avtr_2", {{"v2/JawOpen", "f"}});
  EXPECT_TRUE(eventually([&] { return knows(finder.found().at(0), "avtr_2", 1); }));
  EXPECT_EQ(silent.asked(), 1) << "it has an hour, and still ends at once";
}

TEST(VrChatFinder, HasEnoughOfFour) {
  MdnsStandIn mdns;
  WebStandIn web;
  web.tell_all(9007, "avtr_1", {});
  std::vector<test::MdnsService> services;
  for (int i = 0; i < 12; ++i) {
    services.push_back({"VRChat-Client-" + std::to_string(i), web.port()});
  }
  mdns.tell(services);
  VrChatFinder finder(asking(mdns));
  finder.start();
  ASSERT_TRUE(eventually([&] { return web.asked() > 100 && finder.found().size() >= kMostFoundVrChats; }));
  EXPECT_THAT(finder.found(), SizeIs(kMostFoundVrChats));
}

class FoundTargets : public ::testing::Test {
 protected:
  BridgeConfig config(const VrChatFinderConfig& find) const {
    BridgeConfig out;
    out.rate_hz = 240;
    out.neutral_file = folder_.path() / "neutral.json";
    out.find = find;
    return out;
  }
  /// Publishes frames until this is so, for a minute at most.
  static bool publish_until(Bridge& bridge, const std::function<bool()>& condition) {
    const auto subject = test::patch_subject();
    return eventually([&] {
      auto frame = std::make_shared<mesh::MeshFrame>(test::patch_frame(0, subject, nullptr));
      frame->expression = {0.75F, 0.25F, 0.0F};
      bridge.publish(frame);
      std::this_thread::sleep_for(5ms);
      return condition();
    });
  }
  /// Addresses of what has come.
  std::multiset<std::string> received(const test::Receiver& receiver) const {
    std::multiset<std::string> addresses;
    for (const json& message : test::decode("osc", receiver.receive(20ms), folder_.path())) {
      addresses.insert(message[0]);
    }
    return addresses;
  }
  static bool drives(const Bridge& bridge, std::optional<int> driven) {
    const BridgeStatus status = bridge.status();
    return status.targets.size() == 1 && status.targets[0].driven == driven;
  }

  test::TemporaryFolder folder_;
};

TEST_F(FoundTargets, AreTargetsForAsLongAsTheyAnswer) {
  const test::Receiver osc;
  MdnsStandIn mdns;
  WebStandIn web;
  web.tell_all(osc.port(), "avtr_1", {{"v2/JawOpen", "f"}, {"FT/v2/JawOpen1", "T"}, {"Hat", "T"}});
  mdns.tell({{"VRChat-Client-A1", web.port()}});
  Bridge bridge(config(asking(mdns)));
  bridge.start();
  ASSERT_TRUE(publish_until(bridge, [&] { return drives(bridge, 2); }));
  const BridgeTargetStatus told = bridge.status().targets.at(0);
  EXPECT_TRUE(told.found);
  EXPECT_FALSE(told.asked);
  EXPECT_EQ(told.name, "VRChat-Client-A1");
  EXPECT_EQ(told.avatar, "avtr_1");
  EXPECT_EQ(told.target.port, osc.port());
  received(osc);  // what was sent before the list was known
  std::multiset<std::string> sent;
  ASSERT_TRUE(publish_until(bridge, [&] {
    sent.merge(received(osc));
    return sent.count("/avatar/parameters/v2/JawOpen") > 1;
  }));
  EXPECT_THAT(sent, Contains("/avatar/parameters/FT/v2/JawOpen1"));
  EXPECT_THAT(sent, Contains("/tracking/eye/EyesClosedAmount"));
  EXPECT_THAT(sent, Not(Contains("/avatar/parameters/v2/JawLeft")));
  EXPECT_THAT(sent, Not(Contains("/avatar/parameters/EyeTrackingActive")));

  ValueMapping mapping = bridge.mapping();
  mapping.vrchat.push_back({"Hat", Formula("1")});
  bridge.map(mapping);
  EXPECT_TRUE(publish_until(bridge, [&] { return drives(bridge, 3); }));
  web.close();
  EXPECT_TRUE(publish_until(bridge, [&] { return bridge.status().targets.empty(); }));
}

TEST_F(FoundTargets, OneThatIsConfiguredIsSentToOnce) {
  const test::Receiver osc;
  MdnsStandIn mdns;
  WebStandIn web;
  web.tell_all(osc.port(), "avtr_1", {{"v2/JawOpen", "f"}});
  mdns.tell({{"VRChat-Client-A1", web.port()}});
  BridgeConfig wanted = config(asking(mdns));
  wanted.targets = {osc.target(BridgeProtocol::VrChat)};
  Bridge bridge(wanted);
  bridge.start();
  ASSERT_TRUE(publish_until(bridge, [&] { return drives(bridge, 1); }));
  EXPECT_FALSE(bridge.status().targets.at(0).found);
  EXPECT_EQ(bridge.status().targets.at(0).name, "VRChat-Client-A1");
  received(osc);
  web.close();
  ASSERT_TRUE(publish_until(bridge, [&] { return drives(bridge, std::nullopt); })) << "it stays a target";
  EXPECT_EQ(bridge.status().targets.at(0).name, "");
  EXPECT_TRUE(publish_until(bridge, [&] { return received(osc).count("/avatar/parameters/v2/JawLeft") > 0; }))
      << "and gets everything again";
}

}  // namespace
}  // namespace facet::avatar
