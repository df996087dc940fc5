// Takes with sound and timecode beside them, begun and ended by hand and by OSC.

#include <arpa/inet.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <array>
#include <atomic>
#include <cmath>
#include <nlohmann/json.hpp>

#include "facet/error.hpp"
#include "pipeline/take_sink.hpp"
#include "service/osc_message.hpp"
#include "service/osc_remote.hpp"
#include "service/recording.hpp"
#include "service/sound_desk.hpp"
#include "service/take_index.hpp"
#include "service/thumbnails.hpp"
#include "sound/flac_file.hpp"
#include "sound/sound_export.hpp"
#include "stream/unix_socket.hpp"
#include "support/eventually.hpp"
#include "support/ltc_tape.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "support/virtual_card.hpp"
#include "take/cutting.hpp"
#include "take/notes.hpp"
#include "take/reader.hpp"

namespace facet::service {
namespace {

using testing::HasSubstr;

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr std::int64_t kBegin_ns = 5'000 * kSecond_ns;
/// 2023-11-14, 22:13:20 UTC.
const std::chrono::sys_seconds kUtc{std::chrono::seconds(1'700'000'000)};

class SoundTake : public testing::Test {
 protected:
  SoundTake() {
    recording_.start();
    card_->begin_ns = kBegin_ns;
  }
  ~SoundTake() override {
    recording_.request_stop("the test is over");
    recording_.finish();
  }

  take::TakeRecorderConfig config(const std::string& name) const {
    take::TakeRecorderConfig take;
    take.file = folder_.path() / (name + ".take");
    take.disk_reserve_bytes = 0;
    return take;
  }
  void deliver(std::uint64_t sequence, std::int64_t time_ns) {
    auto frame = std::make_shared<mesh::MeshFrame>(test::searching_frame(sequence));
    frame->timestamp_ns = time_ns;
    frame->media_time_ns = time_ns - kBegin_ns;
    sink_.deliver(frame);
  }
  take::TakeInfo info_of(const std::string& name) const {
    return take::TakeReader(folder_.path() / (name + ".take")).info();
  }
  std::filesystem::path sound_of(const std::string& name) const { return folder_.path() / (name + ".flac"); }

  test::TemporaryFolder folder_;
  test::SetClock clock_{kBegin_ns, kUtc};
  std::shared_ptr<test::CardScript> card_{new test::CardScript{clock_}};
  Log log_{LogLevel::Error};
  pipeline::TakeSink sink_;
  Thumbnails thumbnails_{folder_.path()};
  TakeIndex index_{folder_.path(), thumbnails_};
  SoundDesk desk_{{"virtual", 48000, 1, 1, true}, log_, std::make_unique<test::VirtualCard>(card_)};
  Recording recording_{sink_, desk_, index_, log_};
};

TEST_F(SoundTake, HasTheTimecodeOfItsSoundInEveryFrame) {
  const take::TimecodeRate rate{25};
  const auto tape = test::ltc_tape(rate, {10, 20, 30, 0}, 500, 48000);
  card_->wave = [&](std::int64_t sample, int) {
    return sample >= 0 && sample < static_cast<std::int64_t>(tape.size())
               ? 0.5 * tape[static_cast<std::size_t>(sample)]
               : 0.0;
  };
  desk_.start();
  card_->run_until(kBegin_ns + 3 * kSecond_ns);
  recording_.begin(config("a"));
  std::vector<std::int64_t> times_ns;
  for (int n = 0; n < 120; ++n) {
    times_ns.push_back(kBegin_ns + 5 * kSecond_ns / 2 + n * 33'333'333LL + 7'000'000);
    card_->run_until(times_ns.back() + 100'000'000);
    deliver(static_cast<std::uint64_t>(n), times_ns.back());
  }
  EXPECT_THAT(desk_.timecode_now(), HasSubstr("10:20:3"));
  const auto status = desk_.status();
  EXPECT_EQ(status["state"], "running");
  EXPECT_EQ(status["timecode"]["rate"], "25");
  // What a take that is broken off would say is there with the first commits.
  EXPECT_TRUE(test::eventually([&] { return info_of("a").sound.is_there(); }));
  EXPECT_FALSE(info_of("a").closed);
  EXPECT_EQ(info_of("a").timecode.source, take::TimecodeSource::Ltc);
  recording_.stop();
  const take::TakeInfo info = info_of("a");
  EXPECT_EQ(info.frame_count, 120);
  ASSERT_TRUE(info.sound.is_there());
  EXPECT_EQ(info.sound.reason, "");
  EXPECT_LE(info.sound.first_ns, times_ns.front());
  EXPECT_GE(info.sound.first_ns + info.sound.samples * kSecond_ns / 48000, times_ns.back());
  EXPECT_GT(info.file_bytes, std::filesystem::file_size(sound_of("a")));
  EXPECT_EQ(nlohmann::json::parse(index_.list())["takes"][0]["sound_bytes"],
            std::filesystem::file_size(sound_of("a")));
  EXPECT_EQ(take::to_text(info.timecode.rate), "25");
  for (const std::int64_t time_ns : times_ns) {
    const double truth = static_cast<double>(time_ns - kBegin_ns) * 25e-9;
    const auto place = take::timecode_at(info.timecode, time_ns, 30);
    ASSERT_TRUE(place);
    EXPECT_NEAR(static_cast<double>(place->count - take::frame_count({10, 20, 30, 0}, rate)) +
                    place->thousandths / 1000.0,
                truth, 0.05);
  }
  // What the file holds is what the take says of it.
  sound::FlacReader reader(sound_of("a"));
  sound::FlacReader::Block block;
  std::int64_t samples = 0;
  while (reader.next(block)) {
    samples += static_cast<std::int64_t>(block.samples.size());
  }
  EXPECT_EQ(samples, info.sound.samples);
}

TEST_F(SoundTake, IsTrimmedWithItsSound) {
  // Each sample says when it was taken.
  card_->wave = [](std::int64_t sample, int) {
    return static_cast<double>(sample % 2'000'000) / 4'000'000.0;
  };
  desk_.start();
  card_->run_until(kBegin_ns + 3 * kSecond_ns);
  recording_.begin(config("a"));
  for (int n = 0; n < 100; ++n) {
    const std::int64_t time_ns = kBegin_ns + 3 * kSecond_ns + n * 40'000'000LL;
    card_->run_until(time_ns + 20'000'000);
    deliver(static_cast<std::uint64_t>(n), time_ns);
  }
  recording_.stop();
  take::CutConfig cut;
  cut.from = folder_.path() / "a.take";
  cut.to = folder_.path() / "b.take";
  cut.frames = {25, 74};
  cut.disk_reserve_bytes = 0;
  cut.beside = sound::cut_beside;
  ASSERT_TRUE(take::cut_take(cut, [](std::int64_t) { return true; }));
  const take::TakeInfo info = info_of("b");
  EXPECT_EQ(info.frame_count, 50);
  EXPECT_NEAR(static_cast<double>(info.sound.samples), 2 * 48000, 100);
  EXPECT_NEAR(static_cast<double>(info.sound.first_ns), static_cast<double>(info.first_timestamp_ns), 1e5);
  sound::FlacReader reader(sound_of("b"));
  sound::FlacReader::Block block;
  ASSERT_TRUE(reader.next(block));
  EXPECT_NEAR(block.samples.at(0) / sound::kFullScale, 4 * 48000 / 4e6, 1e-4);
  // What can't be read is left out, and said.
  std::filesystem::remove(sound_of("a"));
  cut.to = folder_.path() / "c.take";
  ASSERT_TRUE(take::cut_take(cut, [](std::int64_t) { return true; }));
  EXPECT_FALSE(info_of("c").sound.is_there());
  EXPECT_THAT(info_of("c").sound.reason, HasSubstr("a.flac"));
}

TEST_F(SoundTake, WithoutASoundInputHasTheTimeOfDay) {
  card_->plugged = false;
  desk_.start();
  ASSERT_TRUE(test::eventually([&] { return desk_.status()["state"] == "absent"; }));
  recording_.begin(config("a"));
  deliver(0, kBegin_ns + kSecond_ns / 2);
  recording_.stop();
  const take::TakeInfo info = info_of("a");
  EXPECT_FALSE(info.sound.is_there());
  EXPECT_THAT(info.sound.reason, HasSubstr("not plugged in"));
  EXPECT_FALSE(std::filesystem::exists(sound_of("a")));
  EXPECT_EQ(info.timecode.source, take::TimecodeSource::Clock);
  EXPECT_EQ(take::to_text(*take::timecode_at(info.timecode, kBegin_ns + kSecond_ns / 2, 30)), "22:13:20:15");
}

TEST_F(SoundTake, OfRecordedFootageHasNeither) {
  desk_.start();
  card_->run_until(kBegin_ns + 3 * kSecond_ns);
  auto take = config("a");
  take.when_full = take::WhenFull::Wait;
  recording_.begin(take);
  deliver(0, 1000);
  recording_.stop();
  EXPECT_EQ(info_of("a").timecode.source, take::TimecodeSource::None);
  EXPECT_FALSE(std::filesystem::exists(sound_of("a")));
}

TEST_F(SoundTake, ThatCannotBeginLeavesNoSound) {
  desk_.start();
  card_->run_until(kBegin_ns + 3 * kSecond_ns);
  std::filesystem::create_directory(folder_.path() / "a.take");
  EXPECT_THROW(recording_.begin(config("a")), Error);
  EXPECT_FALSE(std::filesystem::exists(sound_of("a")));
  recording_.begin(config("b"));
  EXPECT_THROW(recording_.begin(config("c")), Error);
  EXPECT_TRUE(std::filesystem::exists(sound_of("b")));
  EXPECT_FALSE(std::filesystem::exists(sound_of("c")));
  EXPECT_THROW(take::take_path(folder_.path(), "b"), Error);
  recording_.stop();
}

/// What the remote control of a set is.
class OscTake : public SoundTake {
 protected:
  void open(bool with_target = false, const std::string& listen = "127.0.0.1:0") {
    remote_.emplace(OscConfig{listen, listen != "127.0.0.1:0"},
                    OscRemote::Desk{recording_, folder_.path(),
                                    [this] { return ready_ ? std::optional(config("")) : std::nullopt; },
                                    [this] { return desk_.timecode_now(); }},
                    log_);
    remote_->look_after();
    ASSERT_GE(remote_->fd(), 0);
    sockaddr_storage own{};
    socklen_t length = sizeof(own);
    ASSERT_EQ(::getsockname(remote_->fd(), reinterpret_cast<sockaddr*>(&own), &length), 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = own.ss_family == AF_INET6 ? reinterpret_cast<const sockaddr_in6&>(own).sin6_port
                                                 : reinterpret_cast<const sockaddr_in&>(own).sin_port;
    length = sizeof(address);
    ASSERT_EQ(::connect(sender_.get(), reinterpret_cast<sockaddr*>(&address), length), 0);
    if (with_target) {
      address.sin_port = 0;
      ASSERT_EQ(::bind(target_.get(), reinterpret_cast<sockaddr*>(&address), length), 0);
      ASSERT_EQ(::getsockname(target_.get(), reinterpret_cast<sockaddr*>(&address), &length), 0);
      target_port_ = ntohs(address.sin_port);
    }
  }
  void send(const OscMessage& message) {
    const auto packet = osc_packet(message);
    ASSERT_EQ(::send(sender_.get(), packet.data(), packet.size(), 0), static_cast<ssize_t>(packet.size()));
    remote_->serve();
  }
  /// The next answer; an address of "" where none comes.
  OscMessage answer(const stream::FileDescriptor& at) {
    std::array<std::byte, 4096> packet;
    ssize_t bytes = -1;
    test::eventually([&] {
      bytes = ::recv(at.get(), packet.data(), packet.size(), MSG_DONTWAIT);
      return bytes >= 0;
    });
    const auto messages =
        parse_osc(std::span(packet).first(static_cast<std::size_t>(std::max<ssize_t>(bytes, 0))));
    return messages && messages->size() == 1 ? messages->front() : OscMessage{};
  }

  std::atomic<bool> ready_{true};
  std::optional<OscRemote> remote_;
  stream::FileDescriptor sender_{::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)};
  stream::FileDescriptor target_{::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)};
  std::uint16_t target_port_ = 0;
};

TEST_F(OscTake, BeginsAndEndsAsThePhonesDo) {
  open();
  send({"/RecordStart", {std::string("Scene 7/b"), 3}});
  const OscMessage begun = answer(sender_);
  EXPECT_EQ(begun.address, "/RecordStartConfirm");
  ASSERT_EQ(begun.arguments.size(), 1U);
  EXPECT_EQ(std::get<std::string>(begun.arguments[0]), "22:13:20:00");
  deliver(0, kBegin_ns);
  send({"/RecordStop", {}});
  const OscMessage ended = answer(sender_);
  EXPECT_EQ(ended.address, "/RecordStopConfirm");
  ASSERT_EQ(ended.arguments.size(), 3U);
  EXPECT_EQ(std::get<std::string>(ended.arguments[1]), "Scene 7_b_3.take");
  EXPECT_EQ(std::get<std::string>(ended.arguments[2]), "");
  const take::TakeInfo info = info_of("Scene 7_b_3");
  EXPECT_EQ(info.notes.scene, "Scene 7/b");
  EXPECT_EQ(info.notes.number, "3");
  EXPECT_TRUE(info.closed);
}

TEST_F(OscTake, CountsOnAndNeverTakesANameTwice) {
  open(true);
  send({"/OSCSetSendTarget", {std::string("127.0.0.1"), static_cast<std::int32_t>(target_port_)}});
  EXPECT_EQ(answer(target_).address, "/OSCSetSendTargetConfirm");
  send({"/Slate", {std::string("walk")}});
  send({"/Take", {1}});
  for (const char* expected : {"walk_1.take", "walk_2.take", "walk_1-2.take"}) {
    if (std::string(expected) == "walk_1-2.take") {
      send({"/Take", {1}});
    }
    send({"/RecordStart", {}});
    EXPECT_EQ(answer(target_).address, "/RecordStartConfirm");
    send({"/RecordStop", {}});
    const OscMessage ended = answer(target_);
    ASSERT_EQ(ended.arguments.size(), 3U);
    EXPECT_EQ(std::get<std::string>(ended.arguments[1]), expected);
  }
}

TEST_F(OscTake, ARefusedStartLeavesTheNumber) {
  open();
  send({"/Slate", {std::string("walk")}});
  // All of it may wait for the disk together, and counts in its order all the same.
  for (const char* what : {"/RecordStart", "/RecordStart", "/RecordStop", "/RecordStart", "/RecordStart"}) {
    send({what, {}});
  }
  send({"/Take", {7}});
  send({"/RecordStop", {}});
  send({"/RecordStart", {}});
  send({"/RecordStop", {}});
  for (const char* expected : {"walk_1.take", "walk_2.take", "walk_7.take"}) {
    EXPECT_EQ(answer(sender_).address, "/RecordStartConfirm");
    const OscMessage ended = answer(sender_);
    ASSERT_EQ(ended.arguments.size(), 3U);
    EXPECT_EQ(std::get<std::string>(ended.arguments[1]), expected);
  }
}

TEST_F(OscTake, ASlateThatIsNoUtf8MakesANameAndANoteThatAre) {
  open();
  send({"/RecordStart", {std::string("M\xFCller"), 3}});
  EXPECT_EQ(answer(sender_).address, "/RecordStartConfirm");
  deliver(0, kBegin_ns);
  send({"/RecordStop", {}});
  const OscMessage ended = answer(sender_);
  ASSERT_EQ(ended.arguments.size(), 3U);
  EXPECT_EQ(std::get<std::string>(ended.arguments[1]), "M_ller_3.take");
  EXPECT_EQ(info_of("M_ller_3").notes.scene, "M_ller");
}

TEST_F(OscTake, AtAllAddressesTheSenderOfIpv4IsItself) {
  if (!stream::FileDescriptor(::socket(AF_INET6, SOCK_DGRAM | SOCK_CLOEXEC, 0))) {
    GTEST_SKIP() << "there is no IPv6 here";
  }
  open(true, "[::]:0");
  send({"/OSCSetSendTarget", {std::string("127.0.0.1"), static_cast<std::int32_t>(target_port_)}});
  EXPECT_EQ(answer(target_).address, "/OSCSetSendTargetConfirm");
  send({"/RecordStart", {std::string("a"), 1}});
  EXPECT_EQ(answer(target_).address, "/RecordStartConfirm");
}

TEST_F(OscTake, SaysNothingOfWhatItDoesNotDo) {
  open(true);
  // Answers for somebody else, no OSC, what has no sense, what can't be now.
  send({"/OSCSetSendTarget", {std::string("127.0.0.2"), static_cast<std::int32_t>(target_port_)}});
  send({"/OSCSetSendTarget", {}});
  send({"/ARSessionStart", {}});
  ASSERT_EQ(::send(sender_.get(), "nonsense", 8, 0), 8);
  remote_->serve();
  send({"/RecordStop", {}});
  ready_ = false;
  send({"/RecordStart", {std::string("a"), 1}});
  ready_ = true;
  send({"/RecordStart", {std::string("b"), 1}});
  send({"/RecordStart", {std::string("c"), 1}});
  send({"/RecordStop", {}});
  EXPECT_EQ(answer(sender_).address, "/RecordStartConfirm");
  EXPECT_EQ(std::get<std::string>(answer(sender_).arguments.at(1)), "b_1.take");
  EXPECT_FALSE(std::filesystem::exists(folder_.path() / "a_1.take"));
  EXPECT_FALSE(std::filesystem::exists(folder_.path() / "c_1.take"));
  std::byte more;
  EXPECT_LT(::recv(target_.get(), &more, 1, MSG_DONTWAIT), 0);
}

TEST(OscMessage, GoesThereAndBack) {
  const OscMessage message{"/a/b",
                           {std::int32_t{-5}, 1.5F, std::string("text"), true, false, std::monostate()}};
  const auto back = parse_osc(osc_packet(message));
  ASSERT_TRUE(back);
  EXPECT_EQ(back->front(), message);
}

TEST(OscMessage, BundlesAreTheirMessages) {
  const auto inner = osc_packet({"/one", {std::int32_t{1}}});
  const auto bundle_of = [](const std::vector<std::byte>& part) {
    std::vector<std::byte> bundle(20 + part.size());
    const std::string_view name = "#bundle";
    std::transform(name.begin(), name.end(), bundle.begin(),
                   [](char c) { return static_cast<std::byte>(c); });
    bundle[19] = static_cast<std::byte>(part.size());
    std::copy(part.begin(), part.end(), bundle.begin() + 20);
    return bundle;
  };
  auto packet = inner;
  for (int depth = 1; depth <= 5; ++depth) {
    packet = bundle_of(packet);
    const auto parsed = parse_osc(packet);
    ASSERT_EQ(parsed.has_value(), depth <= 4) << depth;
    if (parsed) {
      ASSERT_EQ(parsed->size(), 1U);
      EXPECT_EQ(parsed->front().address, "/one");
    }
  }
  // Cut off anywhere, it is none.
  const auto whole = bundle_of(inner);
  for (std::size_t bytes = 1; bytes < whole.size(); ++bytes) {
    const auto parsed = parse_osc(std::span(whole).first(bytes));
    EXPECT_TRUE(!parsed || parsed->empty()) << bytes;
  }
}

TEST(OscMessage, ASlateMakesANameThatATakeCanHave) {
  EXPECT_EQ(slate_take_name("a/b\n", 12), "a_b__12");
  EXPECT_EQ(slate_take_name("..", 1), "_._1");
  EXPECT_EQ(slate_take_name("", 1), "");
  EXPECT_EQ(slate_take_name("M\xFCller", 3), "M_ller_3");
  EXPECT_EQ(slate_take_name(std::string(200, '\xBF'), 3), std::string(80, '_') + "_3");
  EXPECT_NO_THROW(take::named_take("/tmp", slate_take_name(std::string(5000, 'x'), -2'147'483'647)));
}

TEST(OscMessage, EachByteThatIsNoUtf8IsReplaced) {
  for (const char* sound : {"", "walk", "M\xC3\xBCller", "\xE2\x82\xAC", "\xED\x9F\xBF\xEE\x80\x80",
                            "\xF0\x9F\x8E\xAC\xF4\x8F\xBF\xBF"}) {
    EXPECT_EQ(as_utf8(sound), sound);
  }
  EXPECT_EQ(as_utf8("M\xFCller"), "M_ller");
  EXPECT_EQ(as_utf8("\xC3"), "_") << "cut off";
  EXPECT_EQ(as_utf8("\xE2\x82|"), "__|");
  EXPECT_EQ(as_utf8("\xF0\x9F\x8E"), "___");
  EXPECT_EQ(as_utf8("\xC0\xAF\xE0\x80\xAF\xF0\x80\x80\xAF"), "_________") << "longer than need be";
  EXPECT_EQ(as_utf8("\xED\xA0\x80\xF4\x90\x80\x80\xFF"), "________") << "a half, beyond the last, never";
  EXPECT_EQ(as_utf8(std::string_view("a\0b", 3)), std::string_view("a\0b", 3));
}

}  // namespace
}  // namespace facet::service
