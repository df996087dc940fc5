// Whom a bridge sends to: names that are found later, and programs that ask as they ask a phone.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <thread>

#include "avatar/bridge.hpp"
#include "avatar/phone_requests.hpp"
#include "datagrams.hpp"
#include "facet/error.hpp"
#include "support/eventually.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"

namespace facet::avatar {
namespace {

using nlohmann::json;
using namespace std::chrono_literals;
using test::Receiver;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class BridgeTargetsTest : public ::testing::Test {
 protected:
  BridgeConfig config(std::vector<BridgeTarget> targets) const {
    BridgeConfig out;
    out.targets = std::move(targets);
    out.rate_hz = 240;
    out.neutral_file = folder_.path() / "neutral.json";
    out.look_up_every = 50ms;
    return out;
  }
  static void publish(Bridge& bridge) {
    static const auto subject = test::patch_subject();
    auto frame = std::make_shared<mesh::MeshFrame>(test::patch_frame(0, subject, nullptr));
    frame->expression = {0.75F, 0.25F, 0.0F};
    bridge.publish(frame);
  }
  /// Publishes frames until this is so, for ten seconds at most.
  template <typename Condition>
  static bool publish_until(Bridge& bridge, const Condition& condition) {
    for (int i = 0; i < 1000; ++i) {
      publish(bridge);
      std::this_thread::sleep_for(10ms);
      if (condition()) {
        return true;
      }
    }
    return false;
  }

  test::TemporaryFolder folder_;
};

TEST_F(BridgeTargetsTest, ANameIsLookedUpUntilItIsFoundAndNobodyWaits) {
  const Receiver receiver;
  const Receiver other;
  BridgeTarget late = receiver.target(BridgeProtocol::Vmc);
  late.address = "late.example";
  std::atomic<int> asked = 0;
  std::atomic<bool> answer = false;
  std::atomic<bool> hang = false;
  Bridge bridge(config({late, other.target(BridgeProtocol::Vmc)}), [&](const BridgeTarget& target) {
    ++asked;
    while (hang) {
      std::this_thread::sleep_for(1ms);
    }
    return answer ? LookedUp{socket_address("127.0.0.1", target.port), ""}
                  : LookedUp{{}, "no address of the host was found: test"};
  });
  EXPECT_EQ(asked, 1) << "at the start; addresses in digits are none";
  EXPECT_THAT(bridge.status().targets.at(0).reason,
              AllOf(HasSubstr("was found: test"), HasSubstr("looked up again every 0.05 s")));
  bridge.start();
  ASSERT_TRUE(publish_until(bridge, [&] { return asked >= 3; })) << "again and again";
  EXPECT_THAT(bridge.status().targets.at(0).reason, HasSubstr("looked up again"));

  hang = true;
  const int before = asked;
  ASSERT_TRUE(publish_until(bridge, [&] { return asked > before; }));
  other.receive(20ms);
  const std::uint64_t sent = bridge.status().targets.at(1).frames;
  EXPECT_TRUE(publish_until(bridge, [&] { return bridge.status().targets.at(1).frames > sent + 5; }))
      << "the resolver does not answer, the others get their frames";
  EXPECT_EQ(asked, before + 1);
  EXPECT_FALSE(bridge.finished()) << "who ends it knows that it would wait";
  answer = true;
  hang = false;
  ASSERT_TRUE(publish_until(bridge, [&] { return bridge.status().targets.at(0).reason.empty(); }));
  publish(bridge);
  EXPECT_FALSE(receiver.receive().empty());
  const int found = asked;
  std::this_thread::sleep_for(200ms);
  EXPECT_EQ(asked, found) << "found is found";
  EXPECT_TRUE(bridge.finished());
}

TEST(WhoListens, IsKnownOfThisMachineAlone) {
  Receiver receiver;
  const SocketAddress address = socket_address("127.0.0.1", receiver.port());
  EXPECT_EQ(who_listens(address), Listener::Somebody);
  receiver.close();
  EXPECT_EQ(who_listens(address), Listener::Nobody);
  const Receiver everywhere("0.0.0.0");
  EXPECT_EQ(who_listens(socket_address("127.0.0.1", everywhere.port())), Listener::Somebody);
  EXPECT_EQ(who_listens(socket_address("192.0.2.7", receiver.port())), Listener::OtherMachine)
      << "an address for documents";
}

TEST_F(BridgeTargetsTest, AWrongMappingIsToldAtTheStart) {
  BridgeConfig wrong = config({});
  wrong.mapping_file = folder_.path() / "avatar.toml";
  std::ofstream(wrong.mapping_file) << "[vmc]\nA = \"jaw\"\n";
  try {
    Bridge bridge(wrong);
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    EXPECT_THAT(error.what(), HasSubstr("avatar.toml:2: vmc.A"));
  }
}

TEST_F(BridgeTargetsTest, AMappingIsSent) {
  const Receiver receiver;
  BridgeConfig wanted = config({receiver.target(BridgeProtocol::Vmc)});
  wanted.vmc_shapes = VmcShapes::Presets;
  wanted.vmc_eye_bones = false;
  wanted.mapping_file = folder_.path() / "avatar.toml";
  std::ofstream(wanted.mapping_file) << "[vmc]\nA = \"jawOpen / 3\"\n";
  Bridge bridge(wanted);
  bridge.start();
  publish(bridge);
  const json messages = test::decode("osc", receiver.receive(), folder_.path());
  EXPECT_NEAR(test::message(messages, "/VMC/Ext/Blend/Val", "A")[2].get<float>(), 0.25F, 1e-6F);
  EXPECT_EQ(messages.size(), 4 + 16 + 1U);

  ValueMapping other = bridge.mapping();
  EXPECT_EQ(other.vmc[0].formula.text(), "jawOpen / 3");
  other.vmc[0].formula = Formula("jawOpen / 6");
  other.vmc.push_back({"Grin", Formula("1")});
  bridge.map(other);
  publish(bridge);
  const json changed = test::decode("osc", receiver.receive(), folder_.path());
  EXPECT_NEAR(test::message(changed, "/VMC/Ext/Blend/Val", "A")[2].get<float>(), 0.125F, 1e-6F);
  EXPECT_EQ(test::message(changed, "/VMC/Ext/Blend/Val", "Grin")[2], 1.0);
  EXPECT_EQ(changed.size(), 4 + 17 + 1U);
  EXPECT_NEAR(Formula("jawOpen").of(bridge.sent_values()), 0.75F, 1e-6F);
}

constexpr const char* kIFacialMocapRequest = "iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719";

TEST(PhoneRequests, AreWhatReceiversSend) {
  const auto phone = parse_phone_request(kIFacialMocapRequest);
  ASSERT_TRUE(phone);
  EXPECT_EQ(phone->protocol, BridgeProtocol::IFacialMocap);
  EXPECT_THAT(phone->ports, ElementsAre(49983));
  EXPECT_EQ(phone->version, IFacialMocapVersion::V1);
  const auto version = [](const std::string& options) {
    return parse_phone_request(kIFacialMocapRequest + options)->version;
  };
  EXPECT_EQ(version("|sendDataVersion=v2"), IFacialMocapVersion::V2);
  EXPECT_EQ(version("|other=1|sendDataVersion=v2|"), IFacialMocapVersion::V2);
  for (const char* options :
       {"|", "||", "|sendDataVersion=v1", "|sendDataVersion=v22", "|x=sendDataVersion=v2"}) {
    EXPECT_EQ(version(options), IFacialMocapVersion::V1) << options;
  }
  // https://github.com/DenchiSoft/VTubeStudioBlendshapeUDPReceiverTest
  const auto studio = parse_phone_request(
      R"({"messageType": "iOSTrackingDataRequest", "time": 2.5, "sentBy": "MyApp", "ports": [11125, 11126]})");
  ASSERT_TRUE(studio);
  EXPECT_EQ(studio->protocol, BridgeProtocol::VTubeStudio);
  EXPECT_THAT(studio->ports, ElementsAre(11125, 11126));
  EXPECT_EQ(studio->lasting, 2500ms);
  const auto lasting = [](const std::string& time) {
    return parse_phone_request(R"({"messageType":"iOSTrackingDataRequest","ports":[1],"time":)" + time + "}")
        ->lasting;
  };
  EXPECT_EQ(lasting("0"), 500ms);
  EXPECT_EQ(lasting("1e300"), 10'000ms);
  EXPECT_EQ(lasting("-1"), 500ms);
}

TEST(PhoneRequests, AllElseIsNone) {
  const std::string many = "[1" + [] {
    std::string more;
    for (int i = 0; i < 16; ++i) {
      more += ",1";
    }
    return more;
  }() + "]";
  for (const std::string& datagram : std::initializer_list<std::string>{
           "", "iFacialMocap", std::string(kIFacialMocapRequest) + "x",
           std::string(kIFacialMocapRequest) + "|" + std::string(kMostRequestBytes, 'a'), "{}", "[]", "{",
           R"({"messageType":"iOSTrackingDataRequest","time":1})",
           R"({"messageType":"iOSTrackingDataRequest","time":1,"ports":[]})",
           R"({"messageType":"iOSTrackingDataRequest","time":1,"ports":[0]})",
           R"({"messageType":"iOSTrackingDataRequest","time":1,"ports":[65536]})",
           R"({"messageType":"iOSTrackingDataRequest","time":1,"ports":["1"]})",
           R"({"messageType":"iOSTrackingDataRequest","time":"1","ports":[1]})",
           R"({"messageType":"iOSTrackingDataRequest","time":1,"ports":)" + many + "}",
           R"({"messageType":"other","time":1,"ports":[1]})"}) {
    EXPECT_FALSE(parse_phone_request(datagram)) << datagram;
  }
}

/// Addresses of loopback that no other test has: the ports are the protocols' own.
TEST_F(BridgeTargetsTest, WhoAsksAsOfAPhoneGetsItsData) {
  BridgeConfig wanted = config({});
  wanted.answer = "127.71.4.1";
  Bridge bridge(wanted);
  bridge.start();
  const Receiver nobody("127.71.4.2", kIFacialMocapPort);
  EXPECT_TRUE(publish_until(bridge, [] { return true; }));
  EXPECT_TRUE(nobody.receive(100ms).empty()) << "nothing before it asks";
  EXPECT_TRUE(bridge.status().targets.empty());
  ASSERT_EQ(bridge.status().answer_reason, "");

  nobody.send(kIFacialMocapRequest, wanted.answer, kIFacialMocapPort);
  const Receiver studio("127.71.4.3");
  const auto ask = [&](double time_s) {
    studio.send(
        fmt::format(R"({{"messageType":"iOSTrackingDataRequest","time":{},"sentBy":"test","ports":[{}]}})",
                    time_s, studio.port()),
        wanted.answer, kVTubeStudioPort);
  };
  ask(10);
  ask(10);
  ASSERT_TRUE(publish_until(bridge, [&] { return bridge.status().targets.size() == 2; }));
  publish(bridge);
  const json mocap = test::decode("ifacialmocap", nobody.receive(), folder_.path());
  ASSERT_FALSE(mocap.empty());
  EXPECT_EQ(mocap[0]["values"]["jawOpen"], 75);
  const json tracking = test::decode("json", studio.receive(), folder_.path());
  ASSERT_FALSE(tracking.empty());
  EXPECT_EQ(tracking[0]["FaceFound"], true);
  const BridgeTargetStatus told = bridge.status().targets.at(0);
  EXPECT_TRUE(told.asked);
  EXPECT_EQ(told.target.text(), "127.71.4.2:49983");

  ask(0.5);
  EXPECT_TRUE(publish_until(bridge, [&] { return bridge.status().targets.size() == 1; }))
      << "what was asked last counts, and ends";
  EXPECT_EQ(bridge.status().targets.at(0).target.protocol, BridgeProtocol::IFacialMocap);
}

TEST_F(BridgeTargetsTest, EachAskerGetsTheVersionThatItAskedForLast) {
  BridgeConfig wanted = config({});
  wanted.answer = "127.71.8.1";
  Bridge bridge(wanted);
  bridge.start();
  const Receiver one("127.71.8.2", kIFacialMocapPort);
  const Receiver two("127.71.8.3", kIFacialMocapPort);
  const std::string second = std::string(kIFacialMocapRequest) + "|sendDataVersion=v2";
  ASSERT_TRUE(publish_until(bridge, [&] {
    one.send(kIFacialMocapRequest, wanted.answer, kIFacialMocapPort);
    two.send(second, wanted.answer, kIFacialMocapPort);
    return bridge.status().targets.size() == 2;
  }));
  publish(bridge);
  const auto last = [](const Receiver& receiver) {
    const std::vector<std::string> datagrams = receiver.receive();
    return datagrams.empty() ? std::string() : datagrams.back();
  };
  EXPECT_THAT(last(one), HasSubstr("jawOpen-75|"));
  EXPECT_THAT(last(two), HasSubstr("jawOpen&75|"));
  one.send(second, wanted.answer, kIFacialMocapPort);
  EXPECT_TRUE(publish_until(bridge, [&] {
    const std::vector<std::string> datagrams = one.receive(20ms);
    return !datagrams.empty() && datagrams.back().find("jawOpen&75|") != std::string::npos;
  }));
  EXPECT_EQ(bridge.status().targets.size(), 2U);
}

TEST(SocketAddresses, AreComparedAsNumbers) {
  const auto at = [](const char* digits, std::uint16_t port) { return socket_address(digits, port); };
  EXPECT_TRUE(same_address(at("127.0.0.1", 1), at("127.0.0.1", 1)));
  EXPECT_FALSE(same_address(at("127.0.0.1", 1), at("127.0.0.1", 2)));
  EXPECT_TRUE(same_host(at("127.0.0.1", 1), at("127.0.0.1", 2)));
  EXPECT_FALSE(same_host(at("127.0.0.1", 1), at("127.0.0.2", 1)));
  EXPECT_TRUE(same_address(at("2001:db8::1", 1), at("2001:db8:0:0:0:0:0:1", 1)));
  EXPECT_FALSE(same_address(at("2001:db8::1", 1), at("2001:db8::1", 2)));
  EXPECT_FALSE(same_host(at("2001:db8::1", 1), at("2001:db8::2", 1)));
  EXPECT_FALSE(same_host(at("::1", 1), at("127.0.0.1", 1)));
  EXPECT_FALSE(same_address({}, {})) << "of a name that is not found";
}

/// A socket of IPv6 sends to IPv4 addresses too, which have a count of their own.
TEST(SocketAddresses, KeptInTheNetworkIsWhatASocketSendsToEither) {
  const auto option = [](int socket, int level, int name) {
    int value = -1;
    socklen_t size = sizeof(value);
    EXPECT_EQ(::getsockopt(socket, level, name, &value, &size), 0);
    return value;
  };
  for (const int family : {AF_INET, AF_INET6}) {
    const int socket = ::socket(family, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (socket < 0) {
      ASSERT_EQ(family, AF_INET6);
      GTEST_SKIP() << "there is no IPv6 here";
    }
    EXPECT_TRUE(keep_in_network(socket, family));
    EXPECT_EQ(option(socket, IPPROTO_IP, IP_TTL), 1);
    if (family == AF_INET6) {
      EXPECT_EQ(option(socket, IPPROTO_IPV6, IPV6_UNICAST_HOPS), 1);
    }
    ::close(socket);
  }
}

TEST_F(BridgeTargetsTest, WhoAskedAndIsGoneIsForgotten) {
  BridgeConfig wanted = config({});
  wanted.answer = "127.71.5.1";
  Bridge bridge(wanted);
  bridge.start();
  Receiver asker("127.71.5.2", kIFacialMocapPort);
  ASSERT_TRUE(publish_until(bridge, [&] {
    asker.send(kIFacialMocapRequest, wanted.answer, kIFacialMocapPort);
    return bridge.status().targets.size() == 1;
  }));
  asker.close();
  EXPECT_TRUE(publish_until(bridge, [&] { return bridge.status().targets.empty(); }));
}

TEST_F(BridgeTargetsTest, NoMoreThanSixteenAskersAreServed) {
  BridgeConfig wanted = config({});
  wanted.answer = "127.71.6.1";
  Bridge bridge(wanted);
  bridge.start();
  const Receiver asker("127.71.6.2");
  ASSERT_TRUE(publish_until(bridge, [&] {
    for (int first = 1; first <= 31; first += 10) {
      std::string ports;
      for (int i = 0; i < 10; ++i) {
        ports += fmt::format("{}{}", i == 0 ? "" : ",", 20'000 + first + i);
      }
      asker.send(R"({"messageType":"iOSTrackingDataRequest","time":10,"ports":[)" + ports + "]}",
                 wanted.answer, kVTubeStudioPort);
    }
    return bridge.status().targets.size() >= 10;
  }));
  for (int i = 0; i < 5; ++i) {
    publish(bridge);
    std::this_thread::sleep_for(10ms);
    EXPECT_LE(bridge.status().targets.size(), 16U);
  }
}

TEST_F(BridgeTargetsTest, APortThatAnotherHasIsToldAndTriedAgain) {
  BridgeConfig wanted = config({});
  wanted.answer = "127.71.7.1";
  Receiver first(wanted.answer, kVTubeStudioPort);
  Bridge bridge(wanted);
  bridge.start();
  ASSERT_TRUE(test::eventually([&] { return !bridge.status().answer_reason.empty(); }));
  EXPECT_THAT(bridge.status().answer_reason,
              AllOf(HasSubstr("127.71.7.1:21412"), HasSubstr("Address already in use")));
  first.close();
  EXPECT_TRUE(test::eventually([&] { return bridge.status().answer_reason.empty(); }));
}

}  // namespace
}  // namespace facet::avatar
