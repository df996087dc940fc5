#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <optional>
#include <set>
#include <thread>
#include <vector>

#include "facet/error.hpp"
#include "stream/client.hpp"
#include "stream/encoder.hpp"
#include "stream/framing.hpp"
#include "stream/server.hpp"
#include "support/eventually.hpp"
#include "support/full_queue.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"

namespace facet::stream {
namespace {

using namespace std::chrono_literals;
using test::eventually;
using testing::HasSubstr;

// How long a test waits before it gives up on something that must come; passing never takes it.
constexpr auto kPatience = 60s;

/// A peer that speaks the protocol by hand, to misbehave where StreamClient can't.
class RawPeer {
 public:
  explicit RawPeer(const std::filesystem::path& socket) : fd_(connect_unix(socket)) {}

  void send(std::span<const std::uint8_t> bytes) {
    while (!bytes.empty()) {
      const ssize_t count = ::send(fd_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (count <= 0) {
        return;  // the server hung up, which the test looks for elsewhere
      }
      bytes = bytes.subspan(static_cast<std::size_t>(count));
    }
  }
  void send_message(std::span<const std::uint8_t> message) {
    const auto header = make_header(message.size());
    send(header);
    send(message);
  }
  void subscribe(Profile profile) {
    Encoder encoder;
    send_message(encoder.subscription({kProtocolVersion, profile, true, "raw"}));
  }
  /// The next message; empty once the server has closed the connection.
  std::optional<std::vector<std::uint8_t>> receive() {
    for (;;) {
      if (unread_.empty()) {
        const ssize_t count = ::recv(fd_.get(), buffer_.data(), buffer_.size(), 0);
        if (count <= 0) {
          return std::nullopt;
        }
        unread_ = {buffer_.data(), static_cast<std::size_t>(count)};
      }
      const auto outcome = assembler_.feed(unread_);
      if (outcome == MessageAssembler::Outcome::Complete) {
        std::vector<std::uint8_t> message(assembler_.message().begin(), assembler_.message().end());
        assembler_.next();
        return message;
      }
      EXPECT_EQ(outcome, MessageAssembler::Outcome::Incomplete);
    }
  }
  /// Reads to the end of the connection; the reason of the goodbye, or "" where none came.
  std::string farewell() {
    std::string reason;
    while (const auto message = receive()) {
      if (message_type(*message) == MessageType::Goodbye) {
        reason = decode_goodbye(*message);
      }
    }
    return reason;
  }
  void hang_up() { fd_.reset(); }

 private:
  FileDescriptor fd_;
  std::vector<std::uint8_t> buffer_ = std::vector<std::uint8_t>(65536);
  std::span<const std::uint8_t> unread_;
  MessageAssembler assembler_{kMaxMessageBytes};
};

class Server : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  std::filesystem::path path = folder.path() / "stream.sock";
  std::shared_ptr<const mesh::Subject> subject = test::patch_subject();
  std::shared_ptr<const mesh::Albedo> albedo = test::patch_albedo(*subject, 1);
  std::unique_ptr<StreamServer> server;

  void start(int max_readers = 64) {
    StreamServerConfig config;
    config.socket = path;
    config.max_readers = max_readers;
    config.server_name = "test server";
    server = std::make_unique<StreamServer>(config);
    server->start();
  }
  void publish(std::uint64_t sequence) {
    server->publish(std::make_shared<mesh::MeshFrame>(test::patch_frame(sequence, subject, albedo)));
  }
  /// Publishes and waits until the stream thread has taken the frame.
  void publish_and_wait(std::uint64_t sequence) {
    publish(sequence);
    const std::uint64_t count = ++published;
    ASSERT_TRUE(eventually([&] { return server->statistics().published == count; }));
  }
  void wait_for_subscribers(std::size_t count) {
    ASSERT_TRUE(eventually([&] {
      const auto readers = server->statistics().readers;
      return static_cast<std::size_t>(std::count_if(
                 readers.begin(), readers.end(), [](const ReaderStatistics& r) { return r.subscribed; })) ==
             count;
    }));
  }
  static Subscription wanted(Profile profile, bool want_albedo = true) {
    return {kProtocolVersion, profile, want_albedo, "test"};
  }
  static Subscription by_ring_wanted(Profile profile) {
    Subscription subscription = wanted(profile);
    subscription.ring_version = FACET_RING_VERSION;
    return subscription;
  }
  std::uint64_t published = 0;
};

TEST_F(Server, ReaderGetsEveryFrameItKeepsUpWith) {
  start();
  StreamClient client(path, wanted(Profile::Displacements));
  EXPECT_EQ(client.hello().server, "test server");
  wait_for_subscribers(1);
  DecodedFrame got;
  for (std::uint64_t sequence = 0; sequence < 20; ++sequence) {
    publish(sequence);
    ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
    EXPECT_EQ(got.frame.sequence, sequence);
    EXPECT_EQ(got.frame.displacements_mm.size(),
              static_cast<std::size_t>(subject->hierarchy->finest().vertex_count));
    ASSERT_NE(got.frame.albedo, nullptr);
  }
  EXPECT_EQ(client.dropped(), 0U);
  EXPECT_EQ(client.next(got, 0ms), ReceiveOutcome::Timeout);
}

TEST_F(Server, LateReaderGetsSubjectAlbedoAndCurrentFrame) {
  start();
  publish_and_wait(0);
  publish_and_wait(1);
  StreamClient client(path, wanted(Profile::Vertices));
  DecodedFrame got;
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.sequence, 1U);
  EXPECT_EQ(got.vertices_mm.cols(), subject->hierarchy->finest().vertex_count);
  ASSERT_NE(client.albedo(), nullptr);
  EXPECT_EQ(got.frame.subject, client.subject());
  EXPECT_EQ(client.subject()->identity, subject->identity);
  EXPECT_EQ(client.dropped(), 0U) << "frames from before the connection are not lost ones";
}

TEST_F(Server, PicturesGoToThoseWhoWantThem) {
  start();
  Subscription with_images = wanted(Profile::Signals);
  with_images.want_images = true;
  StreamClient viewer(path, with_images);
  StreamClient other(path, wanted(Profile::Signals));
  wait_for_subscribers(2);
  auto set = std::make_shared<FrameSet>();
  set->slot = 5;
  set->camera_names = std::make_shared<const std::vector<std::string>>(1, "left");
  set->frames.resize(1);
  set->frames[0].width_px = 2;
  set->frames[0].height_px = 1;
  set->frames[0].stride_bytes = 8;
  set->frames[0].pixels = std::make_shared<std::uint8_t[]>(8);
  auto frame = std::make_shared<mesh::MeshFrame>();
  frame->sequence = 5;
  frame->images = set;
  server->publish(frame);
  DecodedFrame got;
  ASSERT_EQ(viewer.next(got, kPatience), ReceiveOutcome::Received);
  ASSERT_NE(got.frame.images, nullptr);
  EXPECT_FALSE(got.frame.images->frames[0].empty());
  ASSERT_EQ(other.next(got, kPatience), ReceiveOutcome::Received);
  ASSERT_NE(got.frame.images, nullptr);
  EXPECT_EQ(got.frame.images->slot, 5U);
  EXPECT_TRUE(got.frame.images->frames[0].empty());
}

TEST_F(Server, ReadersOfARingGetTheSameFrames) {
  start();
  publish_and_wait(0);
  for (const Profile profile : {Profile::Signals, Profile::Displacements, Profile::Vertices}) {
    StreamClient by_ring(path, by_ring_wanted(profile));
    StreamClient by_socket(path, wanted(profile));
    DecodedFrame got;
    DecodedFrame expected;
    for (int round = 0; round < 12; ++round) {  // once round the ring
      ASSERT_EQ(by_socket.next(expected, kPatience), ReceiveOutcome::Received);
      ASSERT_EQ(by_ring.next(got, kPatience), ReceiveOutcome::Received);
      EXPECT_EQ(got.frame.sequence, expected.frame.sequence);
      EXPECT_EQ(got.frame.timestamp_ns, expected.frame.timestamp_ns);
      EXPECT_EQ(got.frame.control_vertices_mm, expected.frame.control_vertices_mm);
      EXPECT_EQ(got.frame.displacements_mm, expected.frame.displacements_mm);
      EXPECT_EQ(got.frame.confidence, expected.frame.confidence);
      EXPECT_EQ(got.vertices_mm, expected.vertices_mm);
      EXPECT_EQ(got.normals, expected.normals);
      EXPECT_EQ(got.frame.expression, expected.frame.expression);
      publish_and_wait(published);
    }
    EXPECT_TRUE(by_ring.by_ring());
    EXPECT_FALSE(by_socket.by_ring());
    EXPECT_EQ(by_ring.dropped(), 0U);
    ASSERT_EQ(by_ring.subject() == nullptr, false);
    EXPECT_EQ(by_ring.subject()->id, by_socket.subject()->id);
  }
  EXPECT_TRUE(
      eventually([&] { return server->statistics().readers.empty() || (publish(0), ++published, false); }));
}

TEST_F(Server, ARingOfferedBeforeTheFirstFaceGrowsWithIt) {
  start();
  StreamClient client(path, by_ring_wanted(Profile::Displacements));
  wait_for_subscribers(1);
  DecodedFrame got;
  EXPECT_EQ(client.next(got, 0ms), ReceiveOutcome::Timeout);
  server->publish(std::make_shared<mesh::MeshFrame>(test::searching_frame(0)));
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.state, mesh::TrackingState::Searching);
  EXPECT_TRUE(client.by_ring());
  publish(1);
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.sequence, 1U);
  EXPECT_EQ(got.frame.displacements_mm.size(),
            static_cast<std::size_t>(subject->hierarchy->finest().vertex_count));
  subject = test::patch_subject(7, 20);  // four times the vertices
  albedo = nullptr;
  publish(2);
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.sequence, 2U);
  EXPECT_EQ(got.frame.subject->hierarchy->id, subject->hierarchy->id);
  EXPECT_EQ(client.dropped(), 0U);
}

TEST_F(Server, ARingReaderThatStandsStillLosesFramesAlone) {
  start();
  StreamClient still(path, by_ring_wanted(Profile::Displacements));
  StreamClient quick(path, by_ring_wanted(Profile::Displacements));
  wait_for_subscribers(2);
  DecodedFrame got;
  publish(0);
  ASSERT_EQ(still.next(got, kPatience), ReceiveOutcome::Received);
  ASSERT_EQ(quick.next(got, kPatience), ReceiveOutcome::Received);
  constexpr std::uint64_t kFrames = 100;
  for (std::uint64_t sequence = 1; sequence <= kFrames; ++sequence) {
    publish(sequence);
    ASSERT_EQ(quick.next(got, kPatience), ReceiveOutcome::Received);
    ASSERT_EQ(got.frame.sequence, sequence);
  }
  EXPECT_EQ(quick.dropped(), 0U);
  ASSERT_EQ(still.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.sequence, kFrames) << "the newest wins";
  EXPECT_EQ(still.dropped(), kFrames - 1);
  ASSERT_TRUE(eventually([&] { return server->statistics().published == kFrames + 1; }));
  publish(kFrames + 1);
  ASSERT_TRUE(eventually([&] { return server->statistics().published == kFrames + 2; }));
  const StreamStatistics statistics = server->statistics();
  ASSERT_EQ(statistics.readers.size(), 2U);
  EXPECT_TRUE(statistics.readers[0].ring);
  EXPECT_EQ(statistics.readers[0].frames_dropped, kFrames - 1) << "counted for that reader";
  EXPECT_EQ(statistics.readers[1].frames_dropped, 0U);
}

TEST_F(Server, PicturesNeverGoThroughARing) {
  start();
  Subscription with_images = by_ring_wanted(Profile::Signals);
  with_images.want_images = true;
  StreamClient client(path, with_images);
  wait_for_subscribers(1);
  publish(0);
  DecodedFrame got;
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_FALSE(client.by_ring());
  EXPECT_FALSE(server->statistics().readers.at(0).ring);
}

// Readers of older releases never see the message; one of a later release that asks for a layout of its own,
// and at least this one, gets this one.
TEST_F(Server, OnlyThoseWhoAskAreOfferedARing) {
  start();
  publish_and_wait(0);
  RawPeer old(path);
  old.subscribe(Profile::Signals);
  RawPeer later(path);
  Encoder encoder;
  Subscription asks = wanted(Profile::Signals);
  asks.ring_version = FACET_RING_VERSION + 1;
  later.send_message(encoder.subscription(asks));
  const auto types = [](RawPeer& peer, int count) {
    std::vector<MessageType> got;
    for (int i = 0; i < count; ++i) {
      const auto message = peer.receive();
      got.push_back(message ? message_type(*message) : MessageType::Unknown);
    }
    return got;
  };
  using enum MessageType;
  EXPECT_THAT(types(old, 3), testing::ElementsAre(Hello, Subject, Frame));
  EXPECT_THAT(types(later, 3), testing::ElementsAre(Hello, Subject, Ring));
}

TEST_F(Server, AReaderThatAsksForRingsWithoutEndIsRefused) {
  start();
  server->publish(std::make_shared<mesh::MeshFrame>(test::searching_frame(0)));
  ASSERT_TRUE(eventually([&] { return server->statistics().published == 1; }));
  RawPeer greedy(path);
  Encoder encoder;
  int offers = 0;
  std::string reason;
  for (int i = 0; i <= kMaxRingOffers && reason.empty(); ++i) {
    Subscription asks = wanted(i % 2 == 0 ? Profile::Signals : Profile::Displacements);
    asks.ring_version = FACET_RING_VERSION;
    greedy.send_message(encoder.subscription(asks));
    for (MessageType type = MessageType::Hello; type == MessageType::Hello;) {
      const auto message = greedy.receive();
      ASSERT_TRUE(message.has_value());
      type = message_type(*message);
      offers += type == MessageType::Ring ? 1 : 0;
      reason = type == MessageType::Goodbye ? decode_goodbye(*message) : "";
    }
  }
  EXPECT_EQ(offers, kMaxRingOffers);
  EXPECT_THAT(reason, HasSubstr("no ring"));
  StreamClient client(path, by_ring_wanted(Profile::Signals));
  DecodedFrame got;
  EXPECT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
}

TEST_F(Server, RingReadersThatDieAreForgotten) {
  start();
  for (int round = 0; round < 20; ++round) {
    StreamClient client(path, by_ring_wanted(static_cast<Profile>(round % kProfileCount)));
    publish_and_wait(static_cast<std::uint64_t>(round));
    DecodedFrame got;
    ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  }
  EXPECT_TRUE(eventually([&] {
    publish(100);
    return server->statistics().readers.empty();
  }));
  EXPECT_EQ(server->statistics().failure, "");
}

TEST_F(Server, RingReadersWhileThePublisherNeverPauses) {
  start();
  publish(0);
  std::atomic<bool> done{false};
  std::thread publisher([&] {
    // Made before: the publisher is to be faster than the readers.
    std::vector<std::shared_ptr<const mesh::MeshFrame>> frames;
    for (std::uint64_t sequence = 0; sequence < 16; ++sequence) {
      frames.push_back(std::make_shared<mesh::MeshFrame>(test::patch_frame(sequence, subject, albedo)));
    }
    for (std::uint64_t count = 0; !done.load(); ++count) {
      server->publish(frames[count % frames.size()]);
    }
  });
  std::vector<DecodedFrame> expected(16);
  {
    Encoder encoder;
    for (std::uint64_t sequence = 0; sequence < 16; ++sequence) {
      decode_frame(encoder.frame(test::patch_frame(sequence, subject, albedo), Profile::Displacements),
                   subject, nullptr, expected[sequence]);
    }
  }
  std::vector<std::thread> readers;
  std::atomic<int> wrong{0};
  for (int i = 0; i < 3; ++i) {
    readers.emplace_back([&] {
      StreamClient client(path, by_ring_wanted(Profile::Displacements));
      DecodedFrame got;
      for (int frame = 0; frame < 200; ++frame) {
        if (client.next(got, kPatience) != ReceiveOutcome::Received) {
          ++wrong;
          return;
        }
        const DecodedFrame& same = expected[got.frame.sequence % 16];
        wrong += got.frame.displacements_mm == same.frame.displacements_mm &&
                         got.frame.control_vertices_mm == same.frame.control_vertices_mm &&
                         got.frame.confidence == same.frame.confidence
                     ? 0
                     : 1;
      }
    });
  }
  for (std::thread& reader : readers) {
    reader.join();
  }
  done.store(true);
  publisher.join();
  EXPECT_EQ(wrong.load(), 0);
}

TEST_F(Server, SubjectAndAlbedoAreSentAnewWhenTheyChange) {
  start();
  StreamClient client(path, wanted(Profile::Displacements));
  wait_for_subscribers(1);
  DecodedFrame got;
  publish(0);
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  albedo = test::patch_albedo(*subject, 2);
  publish(1);
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.albedo->version, 2U);
  subject = test::patch_subject(99, 5);
  albedo = nullptr;
  publish(2);
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.subject->hierarchy->id, subject->hierarchy->id);
  EXPECT_EQ(got.frame.albedo, nullptr);
  server->publish(std::make_shared<mesh::MeshFrame>(test::searching_frame(3)));
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.state, mesh::TrackingState::Searching);
  EXPECT_EQ(got.frame.subject, nullptr);
}

// Takes from elsewhere may share an id; readers tell one subject from another by nothing else.
TEST_F(Server, NoTwoSubjectsHaveOneIdForReadersWhateverTheirOwn) {
  start();
  StreamClient by_socket(path, wanted(Profile::Displacements));
  StreamClient by_ring(path, by_ring_wanted(Profile::Displacements));
  wait_for_subscribers(2);
  DecodedFrame got;
  std::set<std::uint64_t> seen;
  const auto first = subject;
  // Smaller ones fit into the ring of the larger: no new one tells its reader of the change. The first comes
  // back; the last has the mesh of the one before, and other names.
  auto renamed = std::make_shared<mesh::Subject>(*test::patch_subject(first->id, 5));
  renamed->expression_names = {"browInnerUp"};
  std::uint64_t sequence = 0;
  for (const auto& shown :
       {first, test::patch_subject(first->id, 5), first, test::patch_subject(first->id, 4),
        test::patch_subject(first->id, 5), std::shared_ptr<const mesh::Subject>(renamed)}) {
    subject = shown;
    albedo = test::patch_albedo(*subject, 1);
    publish_and_wait(sequence);
    for (StreamClient* client : {&by_socket, &by_ring}) {
      ASSERT_EQ(client->next(got, kPatience), ReceiveOutcome::Received);
      EXPECT_EQ(got.frame.sequence, sequence);
      EXPECT_EQ(got.frame.subject->hierarchy->id, subject->hierarchy->id);
      EXPECT_EQ(got.frame.subject->expression_names, subject->expression_names);
      EXPECT_EQ(got.frame.expression.size(), subject->expression_names.size());
      EXPECT_EQ(got.frame.displacements_mm.size(),
                static_cast<std::size_t>(subject->hierarchy->finest().vertex_count));
    }
    seen.insert(got.frame.subject->id);
    ++sequence;
    EXPECT_EQ(seen.size(), sequence);
    EXPECT_EQ(by_socket.subject()->id, by_ring.subject()->id);
  }
  StreamClient late(path, wanted(Profile::Displacements));
  ASSERT_EQ(late.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.subject->id, by_ring.subject()->id);
  EXPECT_EQ(got.frame.albedo->linear_rgb.size(), albedo->linear_rgb.size());
  // Nor after a restart, where readers that come back may have kept what they built.
  server.reset();
  start();
  published = 0;
  publish_and_wait(0);
  StreamClient again(path, wanted(Profile::Displacements));
  ASSERT_EQ(again.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(seen.count(got.frame.subject->id), 0U);
}

TEST_F(Server, ReaderWithoutWishForAlbedoGetsNone) {
  start();
  StreamClient client(path, wanted(Profile::Displacements, false));
  wait_for_subscribers(1);
  publish(0);
  DecodedFrame got;
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(client.albedo(), nullptr);
  EXPECT_EQ(got.frame.albedo, nullptr);
}

TEST_F(Server, ReaderMayChangeItsProfile) {
  start();
  publish_and_wait(0);
  RawPeer peer(path);
  peer.subscribe(Profile::Signals);
  const auto expect = [&](MessageType type) {
    const auto message = peer.receive();
    ASSERT_TRUE(message.has_value());
    EXPECT_EQ(message_type(*message), type);
  };
  expect(MessageType::Hello);
  expect(MessageType::Subject);
  expect(MessageType::Frame);
  peer.subscribe(Profile::Displacements);
  expect(MessageType::Subject);
  expect(MessageType::Albedo);
  publish(1);
  expect(MessageType::Frame);
}

// A reader that stands still loses frames and is told exactly how many; another reader loses none by it.
TEST_F(Server, SlowReaderLosesWholeFramesAndHarmsNobody) {
  start();
  RawPeer slow(path);
  slow.subscribe(Profile::Displacements);
  wait_for_subscribers(1);
  StreamClient quick(path, wanted(Profile::Displacements));
  wait_for_subscribers(2);
  constexpr std::uint64_t kFrames = 300;
  DecodedFrame got;
  for (std::uint64_t sequence = 0; sequence < kFrames; ++sequence) {
    publish(sequence);
    ASSERT_EQ(quick.next(got, kPatience), ReceiveOutcome::Received);
    ASSERT_EQ(got.frame.sequence, sequence);
  }
  EXPECT_EQ(quick.dropped(), 0U);

  std::uint64_t received = 0;
  std::uint64_t dropped = 0;
  std::uint64_t last_sequence = 0;
  std::uint64_t announced = 0;
  std::shared_ptr<const mesh::Subject> sent;
  do {
    const auto message = slow.receive();
    ASSERT_TRUE(message.has_value());
    if (message_type(*message) == MessageType::Dropped) {
      const Dropped notice = decode_dropped(*message);
      dropped = notice.total;
      announced = notice.since_last;
    } else if (message_type(*message) == MessageType::Subject) {
      sent = decode_subject(*message);
    } else if (message_type(*message) == MessageType::Frame) {
      decode_frame(*message, sent, nullptr, got);
      if (received > 0) {
        EXPECT_EQ(got.frame.sequence - last_sequence - 1, announced)
            << "the notice tells the gap before the frame";
      }
      last_sequence = got.frame.sequence;
      announced = 0;
      ++received;
    }
  } while (last_sequence + 1 < kFrames);
  EXPECT_GT(dropped, 0U);
  EXPECT_EQ(received + dropped, kFrames);
}

TEST_F(Server, AMeshThatNoReaderWouldAcceptIsNotSent) {
  start();
  StreamClient client(path, wanted(Profile::Displacements));
  wait_for_subscribers(1);
  auto too_big = std::make_shared<mesh::Subject>(*subject);
  too_big->id = 1;
  too_big->identity.resize(kMaxCoefficients + 1);
  auto frame = test::patch_frame(1, too_big, albedo);
  server->publish(std::make_shared<mesh::MeshFrame>(std::move(frame)));
  DecodedFrame got;
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_EQ(got.frame.subject, nullptr);
  EXPECT_TRUE(got.frame.degraded);
  EXPECT_THAT(got.frame.degraded_reason, HasSubstr("smaller model"));
  publish(2);
  ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_FALSE(got.frame.degraded) << "the next subject is none the worse";
  EXPECT_EQ(got.frame.subject->hierarchy->id, subject->hierarchy->id);
}

TEST_F(Server, ReaderThatNeverReadsHoldsNothingUp) {
  start();
  RawPeer deaf(path);
  deaf.subscribe(Profile::Vertices);
  wait_for_subscribers(1);
  for (std::uint64_t sequence = 0; sequence < 200; ++sequence) {
    publish_and_wait(sequence);
  }
  const StreamStatistics statistics = server->statistics();
  EXPECT_EQ(statistics.skipped, 0U);
  ASSERT_EQ(statistics.readers.size(), 1U);
  EXPECT_LT(statistics.readers[0].frames_sent, 200U);
  server->stop();
  EXPECT_EQ(server->statistics().failure, "");
}

TEST_F(Server, FiftyReaders) {
  start();
  constexpr std::size_t kReaders = 50;
  constexpr std::uint64_t kFrames = 40;
  std::vector<std::unique_ptr<StreamClient>> clients;
  clients.reserve(kReaders);
  for (std::size_t i = 0; i < kReaders; ++i) {
    clients.push_back(std::make_unique<StreamClient>(path, wanted(static_cast<Profile>(i % kProfileCount))));
  }
  wait_for_subscribers(kReaders);
  std::vector<std::uint64_t> received(kReaders, 0);
  std::vector<std::uint64_t> last(kReaders, 0);
  // Two threads serve all clients, so many of them are slow.
  std::vector<std::thread> threads;
  threads.reserve(2);
  for (std::size_t part = 0; part < 2; ++part) {
    threads.emplace_back([&, part] {
      DecodedFrame got;
      for (std::size_t i = part; i < kReaders; i += 2) {
        while (last[i] + 1 < kFrames && clients[i]->next(got, kPatience) == ReceiveOutcome::Received) {
          ++received[i];
          last[i] = got.frame.sequence;
        }
      }
    });
  }
  for (std::uint64_t sequence = 0; sequence < kFrames; ++sequence) {
    publish_and_wait(sequence);
  }
  for (std::thread& thread : threads) {
    thread.join();
  }
  for (std::size_t i = 0; i < kReaders; ++i) {
    EXPECT_EQ(last[i], kFrames - 1) << "reader " << i;
    EXPECT_EQ(received[i] + clients[i]->dropped(), kFrames) << "reader " << i;
  }
}

TEST_F(Server, ReadersThatDieAreForgotten) {
  start();
  for (int round = 0; round < 20; ++round) {
    RawPeer peer(path);
    peer.subscribe(Profile::Displacements);
    publish_and_wait(static_cast<std::uint64_t>(round));
    peer.hang_up();
  }
  EXPECT_TRUE(eventually([&] {
    publish(100);
    return server->statistics().readers.empty();
  }));
  StreamClient client(path, wanted(Profile::Displacements));
  DecodedFrame got;
  EXPECT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
}

TEST_F(Server, WrongRequestsAreRefusedWithAReason) {
  start();
  const auto refusal = [&](auto&& talk) {
    RawPeer peer(path);
    talk(peer);
    return peer.farewell();
  };
  Encoder encoder;
  EXPECT_THAT(refusal([](RawPeer& peer) {
                const std::string text = "GET / HTTP/1.1\r\n\r\n";
                peer.send({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
              }),
              HasSubstr("magic"));
  EXPECT_THAT(refusal([](RawPeer& peer) { peer.send(make_header(kMaxRequestBytes + 1)); }),
              HasSubstr("longer than"));
  EXPECT_THAT(refusal([](RawPeer& peer) { peer.send_message(std::vector<std::uint8_t>(100, 0xA5)); }),
              HasSubstr("identifier"));
  EXPECT_THAT(refusal([&](RawPeer& peer) { peer.send_message(encoder.goodbye("x")); }),
              HasSubstr("subscription"));
  EXPECT_THAT(refusal([&](RawPeer& peer) {
                peer.send_message(encoder.subscription({kProtocolVersion + 1, Profile::Signals, true, ""}));
              }),
              HasSubstr("protocol version"));
  EXPECT_TRUE(eventually([&] { return server->statistics().refused == 5; }));
  StreamClient client(path, wanted(Profile::Signals));
  publish(0);
  DecodedFrame got;
  EXPECT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
}

TEST_F(Server, OneReaderTooManyIsToldSo) {
  start(2);
  StreamClient first(path, wanted(Profile::Signals));
  StreamClient second(path, wanted(Profile::Signals));
  wait_for_subscribers(2);
  RawPeer third(path);
  EXPECT_THAT(third.farewell(), HasSubstr("limit"));
}

TEST_F(Server, SilentConnectionsLockNobodyOut) {
  start(8);
  std::vector<RawPeer> silent;
  for (int i = 0; i < 8; ++i) {
    silent.emplace_back(path);
  }
  ASSERT_TRUE(eventually([&] { return server->statistics().readers.size() == 8; }));
  StreamClient client(path, wanted(Profile::Signals));
  publish(1);
  DecodedFrame got;
  EXPECT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
  EXPECT_THAT(silent.front().farewell(), HasSubstr("idle")) << "the longest idle one gave way";
}

TEST_F(Server, AReaderThatNeverSubscribesIsClosed) {
  start();
  StreamClient client(path, wanted(Profile::Signals));
  wait_for_subscribers(1);
  RawPeer silent(path);
  EXPECT_THAT(silent.farewell(), HasSubstr("nothing was subscribed to"));
  EXPECT_TRUE(eventually([&] { return server->statistics().readers.size() == 1; }));
  EXPECT_TRUE(server->statistics().readers.at(0).subscribed)
      << "who has subscribed stays, with nothing to read";
}

/// Readers that take nothing give way; those that have taken all that there is do not, however long it is
/// ago.
TEST_F(Server, ReadersThatStandStillGiveWayAndReadersDoNot) {
  subject = test::patch_subject(1, 65, 5);
  albedo = test::patch_albedo(*subject, 1);
  start(2);
  StreamClient good(path, wanted(Profile::Signals));
  RawPeer stuck(path);
  stuck.subscribe(Profile::Vertices);
  wait_for_subscribers(2);
  DecodedFrame got;
  std::uint64_t sequence = 0;
  ASSERT_TRUE(eventually([&] {
    publish(++sequence);
    EXPECT_EQ(good.next(got, kPatience), ReceiveOutcome::Received);
    const StreamStatistics now = server->statistics();
    return std::any_of(now.readers.begin(), now.readers.end(), [&](const ReaderStatistics& reader) {
      return reader.client == "raw" && now.published - reader.frames_sent > 100;
    });
  }));
  // Refused as long as the other may yet come back, then let in; the good one is never asked to go.
  ASSERT_TRUE(eventually([&] {
    RawPeer third(path);
    const auto first = third.receive();
    return first && message_type(*first) != MessageType::Goodbye;
  }));
  publish(++sequence);
  EXPECT_EQ(good.next(got, kPatience), ReceiveOutcome::Received);
}

/// However many connects wait, a round takes a few of them, and then it is the readers' turn.
TEST_F(Server, ConnectsAreTakenAFewARound) {
  StreamServerConfig config;
  config.socket = path;
  server = std::make_unique<StreamServer>(config);
  RawPeer reader(path);
  reader.subscribe(Profile::Signals);
  std::vector<FileDescriptor> crowd;
  for (int i = 0; i < 63; ++i) {
    crowd.push_back(connect_unix(path));
  }
  server->start();
  ASSERT_TRUE(eventually([&] { return server->statistics().connections == 64; }));
  EXPECT_GE(server->statistics().rounds, 4U);
  ASSERT_TRUE(reader.receive().has_value());
}

TEST_F(Server, ClientNamesAServerThatSpeaksSomethingElse) {
  const ListeningSocket foreign(path, {});
  std::thread answer([&] {
    pollfd entry{foreign.fd(), POLLIN, 0};
    ::poll(&entry, 1, -1);
    const FileDescriptor connection(::accept(foreign.fd(), nullptr, nullptr));
    const std::string text = "HTTP/1.1 400 Bad Request\r\n";
    ::send(connection.get(), text.data(), text.size(), MSG_NOSIGNAL);
  });
  try {
    const StreamClient client(path, wanted(Profile::Signals), kPatience);
    ADD_FAILURE() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    EXPECT_THAT(error.what(), HasSubstr("another socket"));
  }
  answer.join();
}

TEST_F(Server, SilentServerIsUnavailable) {
  const ListeningSocket silent(path, {});
  try {
    const StreamClient client(path, wanted(Profile::Signals), 1ms);
    ADD_FAILURE() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
  }
}

TEST_F(Server, AStoppedServerWithAFullQueueIsUnavailable) {
  const ListeningSocket stopped(path, {});
  const auto queued = test::fill_queue(path);
  try {
    const StreamClient client(path, wanted(Profile::Signals), 50ms);
    ADD_FAILURE() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
    EXPECT_THAT(error.what(), HasSubstr("does not answer"));
  }
}

TEST_F(Server, StopSaysGoodbyeAndRemovesTheSocket) {
  start();
  StreamClient client(path, wanted(Profile::Signals));
  wait_for_subscribers(1);
  server->request_stop();
  server->request_stop();
  server->stop();
  server->stop();
  publish(0);
  DecodedFrame got;
  EXPECT_EQ(client.next(got, kPatience), ReceiveOutcome::Closed);
  EXPECT_EQ(client.closed_reason(), "the server stops");
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST_F(Server, NeverStartedServerStops) {
  StreamServerConfig config;
  config.socket = path;
  const StreamServer idle(config);
  EXPECT_TRUE(std::filesystem::exists(path));
}

TEST_F(Server, PublishingFromAnotherThreadWhileReadersComeAndGo) {
  start();
  std::atomic<bool> done{false};
  std::thread publisher([&] {
    for (std::uint64_t sequence = 0; !done.load(); ++sequence) {
      publish(sequence);
    }
  });
  for (int round = 0; round < 10; ++round) {
    StreamClient client(path, wanted(static_cast<Profile>(round % kProfileCount)));
    DecodedFrame got;
    std::uint64_t last = 0;
    for (int frame = 0; frame < 5; ++frame) {
      ASSERT_EQ(client.next(got, kPatience), ReceiveOutcome::Received);
      EXPECT_TRUE(frame == 0 || got.frame.sequence > last);
      last = got.frame.sequence;
    }
  }
  done.store(true);
  publisher.join();
}

}  // namespace
}  // namespace facet::stream
