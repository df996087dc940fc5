// What VRChat tells by OSCQuery and what of it is sent: answers as others write them, and as nobody should.

#include "avatar/oscquery.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "avatar/vrchat.hpp"
#include "avatar/vrchat_finder.hpp"
#include "datagrams.hpp"
#include "facet/error.hpp"
#include "stream/http_get.hpp"
#include "support/paths.hpp"
#include "vrchat_stand_in.hpp"

namespace facet::avatar {
namespace {

using nlohmann::json;
using test::mdns_answer;
using test::mdns_name;
using test::mdns_record;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

std::vector<VrChatService> heard(const std::string& datagram) {
  return parse_mdns_answer({reinterpret_cast<const std::uint8_t*>(datagram.data()), datagram.size()});
}

TEST(MulticastDns, AsksAsRfc6762SaysInSection5) {
  const std::vector<std::uint8_t> question = mdns_question(kOscQueryService, 12);
  const std::string bytes(question.begin(), question.end());
  EXPECT_EQ(bytes, std::string("\0\0\0\0\0\1\0\0\0\0\0\0\x08_oscjson\x04_tcp\x05local\0\0\x0c\0\1", 37));
  EXPECT_THROW(mdns_question(std::string(70, 'a'), 12), Error);
}

TEST(MulticastDns, AnAnswerNamesVrChatsAlone) {
  EXPECT_THAT(heard(mdns_answer({{"VRChat-Client-A1B2C3", 18080}, {"VRCFT-1", 6970}})), SizeIs(1));
  const VrChatService found = heard(mdns_answer({{"VRChat-Client-A1B2C3", 18080}})).at(0);
  EXPECT_EQ(found.name, "VRChat-Client-A1B2C3");
  EXPECT_EQ(found.port, 18080);
  EXPECT_EQ(heard(mdns_answer({{"VRChat-Client-A1B2C3", 0}})).at(0).port, 0) << "its port is to be asked for";
  for (const char* other : {"VRChat-Client-A\x1b[2J", "VRChat-Client A", "vRChat-Client-A", "VRChat"}) {
    EXPECT_THAT(heard(mdns_answer({{other, 1}})), IsEmpty()) << other;
  }
  std::vector<test::MdnsService> many;
  for (std::uint16_t i = 1; i < 40; ++i) {
    many.push_back({fmt::format("VRChat-Client-{}", i), i});
  }
  EXPECT_THAT(heard(mdns_answer(many)), SizeIs(kMostServices));
}

/// Cut anywhere, changed anywhere, with names that point at themselves: nothing, or names that are sound.
TEST(MulticastDns, BytesThatAreNoAnswerDoNoHarm) {
  const std::string sound = mdns_answer({{"VRChat-Client-A1B2C3", 18080}});
  for (std::size_t size = 0; size < sound.size(); ++size) {
    EXPECT_THAT(heard(sound.substr(0, size)), IsEmpty());
    for (const char byte : {'\0', '\x3f', '\xc0', '\xff'}) {
      std::string changed = sound;
      changed[size] = byte;
      for (const VrChatService& service : heard(changed)) {
        EXPECT_THAT(service.name, ::testing::StartsWith("VRChat-Client"));
      }
    }
  }
  const std::string head("\0\0\x84\0\0\0\0\1\0\0\0\0", 12);
  const std::string loop("\xc0\x0c\0\x0c\0\1\0\0\0\x0a\0\2\xc0\x0c", 14);
  EXPECT_THAT(heard(head + loop), IsEmpty());
  const std::string service = mdns_name({"_oscjson", "_tcp", "local"});
  EXPECT_THAT(heard(head + mdns_record(service, 12, "")), IsEmpty());
  EXPECT_THAT(heard(head + mdns_record(service, 12, "\x3f")), IsEmpty());
  const std::string instance = mdns_name({"VRChat-Client-A", "_oscjson", "_tcp", "local"});
  EXPECT_THAT(heard(head + mdns_record(instance, 33, std::string(5, '\1'))), IsEmpty()) << "half a port";
  std::string question = sound;
  question[2] = '\0';
  EXPECT_THAT(heard(question), IsEmpty()) << "asks, and does not answer";
}

TEST(MulticastDns, OnlyWhatNeedsNoRouterIsNear) {
  const auto at = [](const char* digits) { return socket_address(digits, 1); };
  const std::vector<OwnNetwork> own = {{at("127.0.0.1"), htonl(0xff000000)},
                                       {at("192.168.1.20"), htonl(0xffffff00)},
                                       {at("10.8.0.6"), htonl(0xffffffff)},
                                       {at("172.16.0.1"), 0}};
  for (const char* here : {"127.0.0.1", "127.3.2.1", "192.168.1.20", "10.8.0.6"}) {
    EXPECT_EQ(nearness(at(here), own), Nearness::Own) << here;
  }
  EXPECT_EQ(nearness(at("192.168.1.77"), own), Nearness::Near);
  for (const char* far : {"192.168.2.20", "10.8.0.7", "8.8.8.8", "172.16.0.2", "::1", "fe80::1"}) {
    EXPECT_EQ(nearness(at(far), own), Nearness::Far) << far;
  }
  EXPECT_EQ(nearness({}, own), Nearness::Far);
}

/// What becomes of an answer in pieces of this size: its body, or "! " and what is wrong.
std::string got(const std::string& text, std::size_t piece, bool closed = true) {
  stream::HttpAnswer answer(20);
  for (std::size_t at = 0; at < text.size(); at += piece) {
    if (!answer.feed(text.substr(at, piece))) {
      return answer.fault().empty() ? answer.body() : "! " + answer.fault();
    }
  }
  if (!closed || answer.feed("", true)) {
    return "? more";
  }
  return answer.fault().empty() ? answer.body() : "! " + answer.fault();
}

TEST(HttpAnswer, IsReadWhateverItsPieces) {
  const std::string ok = "HTTP/1.1 200 OK\r\n";
  for (const std::size_t piece : std::initializer_list<std::size_t>{1, 2, 3, 7, 1000}) {
    EXPECT_EQ(got(ok + "Content-Length: 5\r\n\r\nhello", piece, false), "hello");
    EXPECT_EQ(
        got(ok + "transfer-encoding: Chunked\r\n\r\n2\r\nhe\r\n3;a=b\r\nllo\r\n0\r\n\r\n", piece, false),
        "hello");
    EXPECT_EQ(got("HTTP/1.0 200 OK\r\n\r\nhello", piece), "hello");
    EXPECT_EQ(got(ok + "Content-Length: 0\r\n\r\n", piece, false), "");
    EXPECT_EQ(got(ok + "Content-Length: 6\r\n\r\nhello", piece), "! closed the connection");
    EXPECT_EQ(got("HTTP/1.1 404 Not\x1b Found\r\n\r\n", piece), "! answers 404 Not\\x1b Found");
    EXPECT_EQ(got("HTTP/1.1 302 Found\r\nLocation: http://example.org/\r\n\r\n", piece),
              "! answers 302 Found");
    EXPECT_EQ(got(ok + "Transfer-Encoding: gzip, chunked\r\n\r\n", piece),
              "! sends what it packs in a way of its own");
    for (const char* much : {"Content-Length: 21\r\n\r\n", "Content-Length: 99999999999999999999999\r\n\r\n",
                             "Content-Length: -1\r\n\r\n", "Transfer-Encoding: chunked\r\n\r\n15\r\n",
                             "\r\n123456789012345678901"}) {
      EXPECT_EQ(got(ok + much, piece), "! sends more than is wanted") << much;
    }
    for (const char* wrong : {"colonless\r\n\r\n", "Transfer-Encoding: chunked\r\n\r\nzz\r\n",
                              "Transfer-Encoding: chunked\r\n\r\n2\r\nhello\r\n"}) {
      EXPECT_EQ(got(ok + wrong, piece), "! is no web server") << wrong;
    }
    EXPECT_EQ(got("SSH-2.0-OpenSSH\r\n\r\n", piece), "! is no web server");
    EXPECT_EQ(got(ok + std::string(9000, 'a'), piece), "! is no web server");
    EXPECT_EQ(got(ok + "Transfer-Encoding: chunked\r\n\r\n1;" + std::string(300, 'a'), piece),
              "! is no web server");
  }
}

TEST(OscQuery, SaysWhereOscIs) {
  const OscHostInfo info = parse_host_info(
      R"({"NAME":"VRChat-Client-A","OSC_IP":"127.0.0.1","OSC_PORT":9000,"OSC_TRANSPORT":"UDP","EXTENSIONS":{}})");
  EXPECT_EQ(info.address, "127.0.0.1");
  EXPECT_EQ(info.port, 9000);
  EXPECT_EQ(parse_host_info(R"({"OSC_PORT":1})").address, "");
  for (const char* text :
       {"", "[]", "9000", "{", R"({"OSC_PORT":"9000"})", R"({"OSC_PORT":0})", R"({"OSC_PORT":65536})",
        R"({"OSC_PORT":-1})", R"({"OSC_PORT":9000.5})", R"({"OSC_PORT":9000,"OSC_TRANSPORT":"TCP"})"}) {
    EXPECT_THROW(parse_host_info(text), Error) << text;
  }
}

TEST(OscQuery, SaysWhatAnAvatarHas) {
  const AvatarParameters avatar = parse_avatar(test::avatar_json(
      "avtr_1", {{"v2/JawOpen", "f"}, {"FT/v2/JawX1", "T"}, {"On", "F"}, {"VRCEmote", "i"}}));
  EXPECT_EQ(avatar.avatar, "avtr_1");
  EXPECT_THAT(avatar.list, ::testing::UnorderedElementsAre(
                               AvatarParameter{"v2/JawOpen", 'f'}, AvatarParameter{"FT/v2/JawX1", 'T'},
                               AvatarParameter{"On", 'T'}, AvatarParameter{"VRCEmote", 'i'}));
  EXPECT_EQ(parse_avatar_change(R"({"FULL_PATH":"/avatar/change","VALUE":["avtr_1"]})"), "avtr_1");
  for (const char* none :
       {"{}", R"({"VALUE":[]})", R"({"VALUE":"a"})", R"({"VALUE":[1]})", R"({"VALUE":["a\nb"]})"}) {
    EXPECT_EQ(parse_avatar_change(none), "") << none;
  }
}

TEST(OscQuery, TakesNoParameterThatIsNone) {
  const auto list = [](const std::string& leaf) {
    return parse_avatar(R"({"CONTENTS":{"a":)" + leaf + "}}").list;
  };
  EXPECT_THAT(list(R"({"FULL_PATH":"/avatar/parameters/A","TYPE":"f","ACCESS":3})"), SizeIs(1));
  EXPECT_THAT(list(R"({"FULL_PATH":"/avatar/parameters/A","TYPE":"f","ACCESS":2})"), SizeIs(1));
  for (const char* leaf :
       {R"({"FULL_PATH":"/avatar/parameters/A","TYPE":"f","ACCESS":1})",
        R"({"FULL_PATH":"/input/Jump","TYPE":"f"})", R"({"FULL_PATH":"/avatar/parameters/","TYPE":"f"})",
        R"({"FULL_PATH":"/avatar/parameters/A"})",
        R"({"FULL_PATH":"/avatar/parameters/A\u0000B","TYPE":"f"})",
        R"({"FULL_PATH":"/avatar/parameters/A","TYPE":"ff"})", R"({"FULL_PATH":3,"TYPE":"f"})", "3", "[]"}) {
    EXPECT_THAT(list(leaf), IsEmpty()) << leaf;
  }
  std::string deep;
  for (int i = 0; i < 100; ++i) {
    deep += R"({"CONTENTS":{"a":)";
  }
  EXPECT_THROW(parse_avatar(deep + "1" + std::string(200, '}')), Error);
  EXPECT_THROW(parse_avatar("[" + std::string(2U << 20U, ' ') + "]"), Error);
  std::vector<test::StandInParameter> many;
  for (int i = 0; i < 9000; ++i) {
    many.push_back({fmt::format("P{}", i), "f"});
  }
  EXPECT_THAT(parse_avatar(test::avatar_json("", many)).list, SizeIs(kMostAvatarParameters));
}

/// The bits of a value as a number, after VRCFaceTracking's ProcessBinary.
int number_of(float value, int bits, bool has_sign) {
  int number = 0;
  for (unsigned bit = 0; bit < static_cast<unsigned>(bits); ++bit) {
    number += BinaryPart{bit, false, bits, has_sign}.of(value) ? 1 << bit : 0;
  }
  return number;
}

TEST(BinaryPart, IsWhatVrcFaceTrackingWrites) {
  for (int bits = 1; bits <= 4; ++bits) {
    const int steps = 1 << bits;
    for (int step = 0; step < steps; ++step) {
      const float least = static_cast<float>(step) / static_cast<float>(steps);
      EXPECT_EQ(number_of(least, bits, false), step) << bits;
      EXPECT_EQ(number_of(std::nextafter(least + 1.0F / static_cast<float>(steps), 0.0F), bits, false), step);
      EXPECT_EQ(number_of(-least, bits, true), step);
      EXPECT_EQ(number_of(-least, bits, false), 0);
    }
    EXPECT_EQ(number_of(1, bits, false), steps - 1);
    EXPECT_EQ(number_of(-1, bits, true), steps - 1);
    EXPECT_EQ(number_of(-1, bits, false), 0);
  }
  const BinaryPart sign{0, true, 2, true};
  EXPECT_TRUE(sign.of(-0.01F));
  EXPECT_FALSE(sign.of(0));
  EXPECT_FALSE(sign.of(-0.0F));
  EXPECT_FALSE(sign.of(0.5F));
}

class AvatarOfVrChat : public ::testing::Test {
 protected:
  static FaceState face(const char* name, float value) {
    FaceState state;
    state.tracked = state.has_expression = true;
    state.values.at(static_cast<std::size_t>(mesh::arkit_index(name))) = value;
    return state;
  }
  /// What is sent, by address behind "/avatar/parameters/"; eyes left out.
  std::map<std::string, json> sent(VrChatWriter& writer, const FaceState& state, float time_s) const {
    OscBundles out(1400);
    writer.write(state, time_s, out);
    std::map<std::string, json> found;
    for (const json& message : test::decode("osc", test::texts(out.bundles()), folder_.path())) {
      const std::string root = "/avatar/parameters/";
      if (const std::string address = message[0]; address.starts_with(root)) {
        EXPECT_TRUE(found.emplace(address.substr(root.size()), message[1]).second) << address;
      }
    }
    return found;
  }
  test::TemporaryFolder folder_;
};

TEST_F(AvatarOfVrChat, GetsWhatItHasAloneUnderItsOwnPrefix) {
  const AvatarParameters avatar{"avtr_1",
                                {{"v2/JawOpen", 'f'},
                                 {"FT/v2/JawOpen1", 'T'},
                                 {"FT/v2/JawOpen2", 'T'},
                                 {"Some/Thing/v2/JawX4", 'T'},
                                 {"Some/Thing/v2/JawX1", 'T'},
                                 {"Some/Thing/v2/JawX2", 'T'},
                                 {"Some/Thing/v2/JawXNegative", 'T'},
                                 {"FT/EyeTrackingActive", 'T'},
                                 {"LipTrackingActive", 'f'},
                                 {"v2/JawOpen", 'i'},
                                 {"v2/JawLeft3", 'T'},
                                 {"v2/JawLeft02", 'T'},
                                 {"v2/NoSuch1", 'T'},
                                 {"JawOpen", 'f'},
                                 {"v2/JawRight", 'T'},
                                 {"Hat", 'T'}}};
  VrChatWriter writer({}, &avatar);
  EXPECT_EQ(writer.driven(), 8);
  const std::map<std::string, json> first = sent(writer, face("jawOpen", 0.8F), 0);
  EXPECT_THAT(first, SizeIs(8));
  EXPECT_NEAR(first.at("v2/JawOpen").get<float>(), 0.8F, 1e-6F);
  EXPECT_EQ(first.at("FT/v2/JawOpen1"), true);
  EXPECT_EQ(first.at("FT/v2/JawOpen2"), true);
  EXPECT_EQ(first.at("FT/EyeTrackingActive"), true);
  EXPECT_EQ(first.at("Some/Thing/v2/JawXNegative"), false);

  EXPECT_THAT(
      sent(writer, face("jawOpen", 0.6F), 0.1F),
      ElementsAre(::testing::Pair("FT/v2/JawOpen1", false), ::testing::Pair("v2/JawOpen", ::testing::_)))
      << "what has changed";
  const std::map<std::string, json> left = sent(writer, face("jawLeft", 0.7F), 0.2F);
  EXPECT_EQ(left.at("Some/Thing/v2/JawXNegative"), true);
  EXPECT_EQ(left.at("Some/Thing/v2/JawX4"), true);
  EXPECT_EQ(left.at("Some/Thing/v2/JawX1"), true);
  EXPECT_EQ(left.count("Some/Thing/v2/JawX2"), 0U) << "5 of 8, as before";
}

TEST_F(AvatarOfVrChat, TakesAMappingsFormulas) {
  const MappedValues chosen = {{"v2/JawOpen", Formula("jawOpen / 2")},
                               {"Mood", Formula("jawOpen / 4")},
                               {"Hat", Formula("1")},
                               {"Missing", Formula("1")}};
  const AvatarParameters avatar{"",
                                {{"v2/JawOpen", 'f'},
                                 {"v2/JawOpen1", 'T'},
                                 {"FT/v2/JawOpen", 'f'},
                                 {"Mood1", 'T'},
                                 {"Mood2", 'T'},
                                 {"Hat", 'T'}}};
  VrChatWriter writer(chosen, &avatar);
  const std::map<std::string, json> first = sent(writer, face("jawOpen", 1), 0);
  EXPECT_THAT(first, SizeIs(6));
  EXPECT_EQ(first.at("v2/JawOpen"), 0.5);
  EXPECT_EQ(first.at("v2/JawOpen1"), true) << "0.5 of two steps";
  EXPECT_EQ(first.at("FT/v2/JawOpen"), 1.0) << "another name, as without a list";
  EXPECT_EQ(first.at("Mood1"), true);
  EXPECT_EQ(first.at("Mood2"), false);
  EXPECT_EQ(first.at("Hat"), 1.0) << "VRChat makes a bool of it";
}

TEST_F(AvatarOfVrChat, OfWhichNothingIsKnownGetsAll) {
  VrChatWriter writer({});
  EXPECT_EQ(writer.driven(), 0);
  EXPECT_THAT(sent(writer, face("jawOpen", 0.8F), 0), SizeIs(3 + 2 * 133));
}

}  // namespace
}  // namespace facet::avatar
