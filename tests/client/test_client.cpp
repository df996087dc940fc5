// libfacet-client against a live stream server, beside the C++ client.

#include <facet-client.h>
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstring>
#include <fstream>
#include <memory>
#include <sstream>
#include <thread>

#include "stream/client.hpp"
#include "stream/encoder.hpp"
#include "stream/framing.hpp"
#include "stream/ring.hpp"
#include "stream/server.hpp"
#include "support/child_process.hpp"
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
constexpr int kPatienceMs = 60'000;
constexpr auto kPatience = std::chrono::milliseconds(kPatienceMs);

struct Free {
  void operator()(facet_client* client) const { facet_client_free(client); }
};
using CClient = std::unique_ptr<facet_client, Free>;

bool same_bits(const float* got, const float* expected, std::size_t count) {
  return std::memcmp(got, expected, count * sizeof(float)) == 0;
}

class Client : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  std::filesystem::path path = folder.path() / "stream.sock";
  std::shared_ptr<const mesh::Subject> subject = test::patch_subject();
  std::shared_ptr<const mesh::Albedo> albedo = test::patch_albedo(*subject, 1);
  std::unique_ptr<StreamServer> server;

  void start() {
    StreamServerConfig config;
    config.socket = path;
    server = std::make_unique<StreamServer>(config);
    server->start();
  }
  void publish(std::uint64_t sequence) {
    mesh::MeshFrame frame = test::patch_frame(sequence, subject, albedo);
    frame.expression_confidence.assign(frame.expression.size(), 0.2F);
    frame.expression_confidence.back() = 1;
    if (sequence % 2 == 1) {
      frame.avatar_values = {0.5F, 0.25F, 1.0F};
    }
    frame.origin = mesh::Origin::Pose;
    server->publish(std::make_shared<mesh::MeshFrame>(std::move(frame)));
  }
  void wait_for_readers(std::size_t count) {
    ASSERT_TRUE(eventually([&] {
      std::size_t subscribed = 0;
      for (const ReaderStatistics& reader : server->statistics().readers) {
        subscribed += reader.subscribed ? 1 : 0;
      }
      return subscribed == count;
    }));
  }
  CClient connect(int profile, unsigned flags) {
    CClient client(facet_client_new(path.c_str(), profile, flags, "test"));
    EXPECT_NE(client, nullptr);
    return client;
  }
};

/// Every level's triangles come with either profile that has a mesh.
void expect_levels(const facet_subject& got, const mesh::Hierarchy& hierarchy, int profile) {
  if (profile == FACET_SIGNALS) {
    EXPECT_EQ(got.level_count, 0U);
    return;
  }
  ASSERT_EQ(got.level_count, hierarchy.levels.size());
  for (std::uint32_t k = 0; k < got.level_count; ++k) {
    const mesh::Level& level = hierarchy.levels[k];
    EXPECT_EQ(got.levels[k].vertex_count, static_cast<std::uint32_t>(level.vertex_count));
    ASSERT_EQ(got.levels[k].triangle_count, static_cast<std::uint32_t>(level.triangles.cols()));
    EXPECT_EQ(std::memcmp(got.levels[k].triangles, level.triangles.data(),
                          sizeof(std::uint32_t) * 3 * got.levels[k].triangle_count),
              0);
  }
  EXPECT_EQ(got.vertex_count, got.levels[got.level_count - 1].vertex_count);
  EXPECT_EQ(got.triangles, got.levels[got.level_count - 1].triangles);
}

class EveryWay : public Client, public testing::WithParamInterface<std::tuple<int, unsigned>> {};

// The same frames to both clients: the same numbers, bit by bit, rebuilt ones too.
TEST_P(EveryWay, SameBitsAsTheCppClient) {
  const auto [profile, flags] = GetParam();
  start();
  publish(0);
  Subscription wanted;
  wanted.profile = static_cast<Profile>(profile);
  StreamClient reference(path, wanted);
  const CClient client = connect(profile, flags | FACET_WANT_ALBEDO);
  DecodedFrame expected;
  for (std::uint64_t sequence = 0; sequence < 12; ++sequence) {
    ASSERT_EQ(reference.next(expected, kPatience), ReceiveOutcome::Received);
    ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK) << facet_client_message(client.get());
    const facet_frame* frame = facet_client_frame(client.get());
    ASSERT_EQ(frame->sequence, expected.frame.sequence);
    EXPECT_EQ(frame->timestamp_ns, expected.frame.timestamp_ns);
    EXPECT_EQ(frame->state, FACET_TRACKING);
    EXPECT_EQ(frame->origin, FACET_POSE);
    EXPECT_EQ(frame->fx, expected.frame.camera.fx);
    EXPECT_EQ(frame->width_px, expected.frame.camera.width_px);
    EXPECT_EQ(frame->latency_ms, expected.frame.stage_ms.latency_ms);
    EXPECT_EQ(frame->camera_from_head[1][3], expected.frame.camera_from_head.matrix()(1, 3));
    EXPECT_EQ(frame->lighting[4], expected.frame.lighting[4]);
    EXPECT_EQ(frame->photometric_rms, expected.frame.photometric_rms);
    ASSERT_EQ(frame->expression_count, 3U);
    EXPECT_TRUE(same_bits(frame->expression, expected.frame.expression.data(), 3));
    const bool tuned = !expected.frame.avatar_values.empty();
    EXPECT_EQ(tuned, sequence % 2 == 1);
    EXPECT_TRUE(same_bits(frame->avatar_values,
                          (tuned ? expected.frame.avatar_values : expected.frame.expression).data(), 3));
    EXPECT_EQ(facet_client_avatar_value(client.get(), "jawOpen"),
              tuned ? 0.5F : expected.frame.expression[0]);
    ASSERT_NE(frame->expression_confidence, nullptr);
    EXPECT_EQ(frame->expression_confidence[0], 51);
    EXPECT_EQ(frame->expression_confidence[2], 255);
    ASSERT_EQ(frame->landmark_count, expected.frame.landmarks_px.size());
    EXPECT_TRUE(
        same_bits(frame->landmarks_px, expected.frame.landmarks_px[0].data(), 2 * frame->landmark_count));
    const facet_subject* known = facet_client_subject(client.get());
    ASSERT_NE(known, nullptr);
    EXPECT_EQ(known->id, reference.subject()->id);
    EXPECT_EQ(frame->subject_id, known->id);
    EXPECT_STREQ(known->expression_names[1], "eyeBlinkLeft");
    EXPECT_EQ(known->identity_count, 4U);
    expect_levels(*known, *subject->hierarchy, profile);

    const facet_mesh* mesh = nullptr;
    if (profile == FACET_SIGNALS) {
      EXPECT_EQ(facet_client_mesh(client.get(), &mesh), FACET_NO_MESH);
    } else {
      ASSERT_EQ(facet_client_mesh(client.get(), &mesh), FACET_OK);
      mesh::Vertices vertices_mm = expected.vertices_mm;
      Eigen::Matrix3Xf normals = expected.normals;
      if (profile == FACET_DISPLACEMENTS) {
        mesh::rebuild_finest(*reference.subject()->hierarchy, expected.frame.control_vertices_mm,
                             expected.frame.displacements_mm, vertices_mm, normals);
      }
      ASSERT_EQ(mesh->vertex_count, static_cast<std::uint32_t>(vertices_mm.cols()));
      EXPECT_TRUE(
          same_bits(mesh->vertices_mm, vertices_mm.data(), static_cast<std::size_t>(vertices_mm.size())));
      EXPECT_TRUE(same_bits(mesh->normals, normals.data(), static_cast<std::size_t>(normals.size())));
      const auto& finest = reference.subject()->hierarchy->finest();
      ASSERT_EQ(known->triangle_count, static_cast<std::uint32_t>(finest.triangles.cols()));
      EXPECT_EQ(known->triangles[7], static_cast<std::uint32_t>(finest.triangles.data()[7]));
      EXPECT_EQ(known->vertex_count, mesh->vertex_count);
      EXPECT_NEAR(static_cast<float>(frame->confidence[5]) / 255.0F, expected.frame.confidence[5], 1e-6F);
      EXPECT_EQ(frame->in_ring, (flags & FACET_WANT_RING) != 0 ? 1 : 0);
    }
    EXPECT_EQ(facet_client_intact(client.get()), 1);
    publish(sequence + 1);
  }
  if (profile != FACET_SIGNALS) {
    const facet_albedo* colours = facet_client_albedo(client.get());
    ASSERT_NE(colours, nullptr);
    EXPECT_EQ(colours->version, 1U);
    EXPECT_EQ(3 * colours->vertex_count, albedo->linear_rgb.size());
    EXPECT_NEAR(static_cast<float>(colours->linear_rgb[4]) / 65535.0F * colours->scale, albedo->linear_rgb[4],
                1e-4F);
  }
  const facet_statistics* statistics = facet_client_statistics(client.get());
  EXPECT_EQ(statistics->received, 12U);
  EXPECT_EQ(statistics->dropped, 0U);
  EXPECT_EQ(statistics->connections, 1U);
  EXPECT_EQ(statistics->by_ring, (flags & FACET_WANT_RING) != 0 ? 1 : 0);
}

INSTANTIATE_TEST_SUITE_P(Profiles, EveryWay,
                         testing::Combine(testing::Values(FACET_SIGNALS, FACET_DISPLACEMENTS, FACET_VERTICES),
                                          testing::Values(0U, static_cast<unsigned>(FACET_WANT_RING))));

TEST_F(Client, TellsWhoseShapeIsFollowed) {
  start();
  const CClient displacements = connect(FACET_DISPLACEMENTS, 0);
  const CClient vertices = connect(FACET_VERTICES, 0);
  publish(0);
  for (const CClient* client : {&displacements, &vertices}) {
    ASSERT_EQ(facet_client_next(client->get(), kPatienceMs), FACET_OK);
    EXPECT_EQ(facet_client_subject(client->get())->person, nullptr);
    EXPECT_EQ(facet_client_subject(client->get())->neutral_mm, nullptr);
  }
  auto known = std::make_shared<mesh::Subject>(*test::patch_subject(subject->id + 1, 7));
  known->person = "Zo\xC3\xAB";
  known->neutral_mm = mesh::Vertices::Random(3, known->hierarchy->control_vertex_count);
  subject = known;
  albedo = test::patch_albedo(*subject, 1);
  publish(1);
  for (const CClient* client : {&displacements, &vertices}) {
    ASSERT_EQ(facet_client_next(client->get(), kPatienceMs), FACET_OK);
    EXPECT_STREQ(facet_client_subject(client->get())->person, known->person.c_str());
  }
  const facet_subject* shown = facet_client_subject(displacements.get());
  ASSERT_NE(shown->neutral_mm, nullptr);
  ASSERT_EQ(shown->control_vertex_count, known->hierarchy->control_vertex_count);
  EXPECT_TRUE(same_bits(shown->neutral_mm, known->neutral_mm.data(),
                        static_cast<std::size_t>(known->neutral_mm.size())));
  EXPECT_EQ(facet_client_subject(vertices.get())->neutral_mm, nullptr);
}

TEST_F(Client, SeveralSeedsOfMeshesAreRebuiltToTheBit) {
  start();
  const CClient client = connect(FACET_DISPLACEMENTS, 0);
  for (const int side : {2, 7, 13, 40}) {
    subject = test::patch_subject(static_cast<std::uint64_t>(side), side, 4);
    albedo = nullptr;
    for (const std::uint64_t seed : {11U, 222U, 3333U}) {
      publish(seed);
      do {
        ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK)
            << facet_client_message(client.get());
      } while (facet_client_frame(client.get())->sequence != seed);
      const facet_mesh* mesh = nullptr;
      ASSERT_EQ(facet_client_mesh(client.get(), &mesh), FACET_OK);
      Encoder encoder;
      DecodedFrame expected;
      decode_frame(encoder.frame(test::patch_frame(seed, subject, nullptr), Profile::Displacements), subject,
                   nullptr, expected);
      mesh::Vertices vertices_mm;
      Eigen::Matrix3Xf normals;
      mesh::rebuild_finest(*subject->hierarchy, expected.frame.control_vertices_mm,
                           expected.frame.displacements_mm, vertices_mm, normals);
      EXPECT_TRUE(
          same_bits(mesh->vertices_mm, vertices_mm.data(), static_cast<std::size_t>(vertices_mm.size())));
      EXPECT_TRUE(same_bits(mesh->normals, normals.data(), static_cast<std::size_t>(normals.size())));
    }
  }
}

// Takes from elsewhere may share an id. Smaller meshes fit into the ring that is there.
TEST_F(Client, AnotherMeshUnderAnIdThatIsKnownIsNotTakenForTheFirst) {
  start();
  const CClient by_socket = connect(FACET_DISPLACEMENTS, FACET_WANT_ALBEDO);
  const CClient by_ring = connect(FACET_DISPLACEMENTS, FACET_WANT_RING | FACET_WANT_ALBEDO);
  std::uint64_t shown_id = 0;
  std::uint64_t sequence = 0;
  for (const int side : {9, 5, 9, 4}) {
    subject = test::patch_subject(subject->id, side);
    albedo = test::patch_albedo(*subject, 1);
    publish(++sequence);
    const auto count = static_cast<std::uint32_t>(subject->hierarchy->finest().vertex_count);
    for (const CClient* client : {&by_socket, &by_ring}) {
      ASSERT_EQ(facet_client_next(client->get(), kPatienceMs), FACET_OK)
          << facet_client_message(client->get());
      EXPECT_EQ(facet_client_frame(client->get())->sequence, sequence);
      const facet_mesh* mesh = nullptr;
      ASSERT_EQ(facet_client_mesh(client->get(), &mesh), FACET_OK);
      EXPECT_EQ(mesh->vertex_count, count);
      EXPECT_EQ(facet_client_subject(client->get())->vertex_count, count);
    }
    EXPECT_NE(facet_client_frame(by_ring.get())->subject_id, shown_id)
        << "by which a game tells that it needs other triangles";
    shown_id = facet_client_frame(by_ring.get())->subject_id;
    EXPECT_EQ(facet_client_frame(by_socket.get())->subject_id, shown_id);
  }
  EXPECT_EQ(facet_client_statistics(by_ring.get())->connections, 1U);
}

TEST_F(Client, FramesWithoutAFaceAndAFaceAfterwards) {
  start();
  for (const unsigned flags : {0U, static_cast<unsigned>(FACET_WANT_RING)}) {
    server->publish(std::make_shared<mesh::MeshFrame>(test::searching_frame(1)));
    const CClient client = connect(FACET_DISPLACEMENTS, flags);
    do {
      ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK);
    } while (facet_client_frame(client.get())->sequence != 1);
    const facet_mesh* mesh = nullptr;
    EXPECT_EQ(facet_client_frame(client.get())->subject_id, 0U);
    EXPECT_EQ(facet_client_mesh(client.get(), &mesh), FACET_NO_MESH);
    publish(2);
    ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK);
    EXPECT_EQ(facet_client_mesh(client.get(), &mesh), FACET_OK);
  }
}

TEST_F(Client, AFrameThatWasOverwrittenIsNotTakenForOne) {
  start();
  publish(0);
  const CClient client = connect(FACET_VERTICES, FACET_WANT_RING);
  ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK);
  EXPECT_EQ(facet_client_intact(client.get()), 1);
  for (std::uint64_t k = 1; k <= kRingSlots; ++k) {
    publish(k);
    ASSERT_TRUE(eventually([&] { return server->statistics().published == k + 1; }));
  }
  const facet_mesh* mesh = nullptr;
  EXPECT_EQ(facet_client_intact(client.get()), 0);
  EXPECT_EQ(facet_client_mesh(client.get(), &mesh), FACET_OVERWRITTEN);
  EXPECT_EQ(mesh, nullptr);
  ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK);
  EXPECT_EQ(facet_client_mesh(client.get(), &mesh), FACET_OK);
  EXPECT_EQ(facet_client_statistics(client.get())->dropped, kRingSlots - 1U);
  EXPECT_EQ(facet_client_statistics(client.get())->overwritten, 1U);
}

TEST_F(Client, ServerGoneAndBack) {
  for (const unsigned flags : {0U, static_cast<unsigned>(FACET_WANT_RING)}) {
    const CClient client = connect(FACET_DISPLACEMENTS, flags | FACET_RECONNECT);
    EXPECT_EQ(facet_client_next(client.get(), 0), FACET_TIMEOUT);
    EXPECT_THAT(facet_client_message(client.get()), HasSubstr("nobody answers"));
    for (std::uint64_t life = 1; life <= 3; ++life) {
      start();
      publish(100 * life);
      ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK) << facet_client_message(client.get());
      EXPECT_EQ(facet_client_frame(client.get())->sequence, 100 * life);
      const facet_mesh* mesh = nullptr;
      EXPECT_EQ(facet_client_mesh(client.get(), &mesh), FACET_OK);
      server.reset();
      EXPECT_EQ(facet_client_next(client.get(), 1), FACET_TIMEOUT);
      EXPECT_EQ(facet_client_frame(client.get()), nullptr);
    }
    EXPECT_EQ(facet_client_statistics(client.get())->connections, 3U);
  }
}

TEST_F(Client, WithoutReconnectTheEndIsTold) {
  const CClient client = connect(FACET_SIGNALS, 0);
  EXPECT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_UNAVAILABLE);
  start();
  publish(0);
  ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK);
  server.reset();
  EXPECT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_CLOSED);
  EXPECT_STREQ(facet_client_message(client.get()), "the server stops");
}

TEST_F(Client, WrongArgumentsAreNamed) {
  EXPECT_EQ(facet_client_new(path.c_str(), 3, 0, nullptr), nullptr);
  EXPECT_EQ(errno, EINVAL);
  EXPECT_EQ(facet_client_new(std::string(200, 'x').c_str(), 0, 0, nullptr), nullptr);
  facet_client_free(nullptr);
}

/// A server by hand, for what a real one never sends: says what it is told to every connection, then hangs
/// up.
class Impostor {
 public:
  /// passes: two descriptors that go with the first bytes; {}: none
  Impostor(const std::filesystem::path& path, std::vector<std::uint8_t> says, std::vector<int> passes = {})
      : socket_(path, {}), says_(std::move(says)), passes_(std::move(passes)), thread_([this] { run(); }) {}
  ~Impostor() {
    done_.store(true);
    thread_.join();
  }

 private:
  void run() {
    while (!done_.load()) {
      pollfd entry{socket_.fd(), POLLIN, 0};
      if (::poll(&entry, 1, 10) <= 0) {
        continue;
      }
      const FileDescriptor connection(::accept(socket_.fd(), nullptr, nullptr));
      std::span<const std::uint8_t> left = says_;
      if (!passes_.empty()) {
        left = left.subspan(pass(connection.get()));
      }
      while (!left.empty()) {
        const ssize_t count = ::send(connection.get(), left.data(), left.size(), MSG_NOSIGNAL);
        if (count <= 0) {
          break;
        }
        left = left.subspan(static_cast<std::size_t>(count));
      }
      ::shutdown(connection.get(), SHUT_WR);
      char byte = 0;
      while (::recv(connection.get(), &byte, 1, 0) > 0) {
      }
    }
  }
  /// Sends the descriptors with as many of the bytes as the socket takes; how many.
  std::size_t pass(int connection) {
    alignas(cmsghdr) std::array<char, CMSG_SPACE(2 * sizeof(int))> control{};
    iovec part{says_.data(), says_.size()};
    msghdr message{};
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    cmsghdr* header = CMSG_FIRSTHDR(&message);
    header->cmsg_level = SOL_SOCKET;
    header->cmsg_type = SCM_RIGHTS;
    header->cmsg_len = CMSG_LEN(2 * sizeof(int));
    std::memcpy(CMSG_DATA(header), passes_.data(), 2 * sizeof(int));
    return static_cast<std::size_t>(std::max<ssize_t>(0, ::sendmsg(connection, &message, MSG_NOSIGNAL)));
  }
  ListeningSocket socket_;
  std::vector<std::uint8_t> says_;
  std::vector<int> passes_;
  std::atomic<bool> done_{false};
  std::thread thread_;
};

class BadServer : public Client {
 protected:
  Encoder encoder;

  static void append(std::vector<std::uint8_t>& out, std::span<const std::uint8_t> message) {
    const auto header = make_header(message.size());
    out.insert(out.end(), header.begin(), header.end());
    out.insert(out.end(), message.begin(), message.end());
  }
  std::vector<std::uint8_t> greeting(std::uint32_t version = kProtocolVersion) {
    std::vector<std::uint8_t> out;
    Hello hello;
    hello.protocol_version = version;
    append(out, encoder.hello(hello));
    return out;
  }
  /// What the client says of a server that says `bytes`, and then nothing.
  std::pair<int, std::string> verdict(std::vector<std::uint8_t> bytes, unsigned flags = 0,
                                      std::vector<int> passes = {}) {
    const Impostor impostor(path, std::move(bytes), std::move(passes));
    const CClient client = connect(FACET_DISPLACEMENTS, flags);
    const int outcome = facet_client_next(client.get(), kPatienceMs);
    return {outcome, facet_client_message(client.get())};
  }
};

TEST_F(BadServer, ForeignAndFutureOnesAreNamed) {
  const std::string http = "HTTP/1.1 400 Bad Request\r\n\r\n";
  const auto foreign = verdict({http.begin(), http.end()});
  EXPECT_EQ(foreign.first, FACET_BAD_DATA);
  EXPECT_THAT(foreign.second, HasSubstr("another socket"));
  const auto future = verdict(greeting(kProtocolVersion + 1));
  EXPECT_EQ(future.first, FACET_BAD_DATA);
  EXPECT_THAT(future.second, HasSubstr("version 2"));
  auto long_message = greeting();
  const auto header = make_header(kMaxMessageBytes + 1);
  long_message.insert(long_message.end(), header.begin(), header.end());
  const auto oversized = verdict(long_message);
  EXPECT_EQ(oversized.first, FACET_BAD_DATA);
  EXPECT_THAT(oversized.second, HasSubstr("64 MiB"));
}

TEST_F(BadServer, TruncatedAndDamagedMessagesAreRefused) {
  auto whole = greeting();
  append(whole, encoder.subject(*subject, Profile::Displacements));
  const std::size_t before_frame = whole.size();
  append(whole, encoder.frame(test::patch_frame(1, subject, nullptr), Profile::Displacements));
  EXPECT_EQ(verdict(whole).first, FACET_OK);
  // Cut anywhere, the connection ends in the middle of a message.
  for (std::size_t cut = 1; cut < whole.size(); cut += whole.size() / 7) {
    EXPECT_EQ(verdict({whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(cut)}).first, FACET_CLOSED);
  }
  // A message that is shorter than what it holds.
  auto frame = encoder.frame(test::patch_frame(1, subject, nullptr), Profile::Displacements);
  std::vector<std::uint8_t> short_frame(whole.begin(),
                                        whole.begin() + static_cast<std::ptrdiff_t>(before_frame));
  append(short_frame, frame.first(frame.size() / 2));
  EXPECT_EQ(verdict(short_frame).first, FACET_BAD_DATA);
  // A frame of a subject that was never sent.
  auto orphan = greeting();
  append(orphan, encoder.frame(test::patch_frame(1, subject, nullptr), Profile::Displacements));
  EXPECT_THAT(verdict(orphan).second, HasSubstr("subject was not sent"));
  auto empty = greeting();
  append(empty, {});
  EXPECT_EQ(verdict(empty).first, FACET_BAD_DATA);
}

TEST_F(BadServer, AMessageOfALaterReleaseIsSkipped) {
  auto bytes = greeting();
  // A Goodbye whose kind is one that is not known yet.
  const auto goodbye = encoder.goodbye("later");
  std::vector<std::uint8_t> later(goodbye.begin(), goodbye.end());
  const auto kind = std::find(later.begin() + 8, later.end(), std::uint8_t{4});
  std::vector<std::ptrdiff_t> fours;
  for (auto at = later.begin() + 8; at != later.end(); ++at) {
    if (*at == 4) {
      fours.push_back(at - later.begin());
    }
  }
  ASSERT_NE(kind, later.end());
  bool changed = false;
  for (const std::ptrdiff_t at : fours) {
    auto copy = later;
    copy[static_cast<std::size_t>(at)] = 99;
    try {
      if (message_type(copy) == MessageType::Unknown) {
        append(bytes, copy);
        changed = true;
        break;
      }
    } catch (const std::exception&) {
    }
  }
  ASSERT_TRUE(changed);
  append(bytes, encoder.frame(test::searching_frame(9), Profile::Displacements));
  EXPECT_EQ(verdict(bytes).first, FACET_OK);
}

TEST_F(BadServer, ARingWithoutDescriptorsIsRefused) {
  auto bytes = greeting();
  append(bytes, encoder.ring({FACET_RING_VERSION, 65536}));
  const auto without = verdict(bytes, FACET_WANT_RING);
  EXPECT_EQ(without.first, FACET_BAD_DATA);
  EXPECT_THAT(without.second, HasSubstr("ring"));
}

TEST_F(BadServer, ARingThatLiesIsRefusedBeforeItIsMapped) {
  auto offer = greeting();
  append(offer, encoder.ring({FACET_RING_VERSION, 65536}));
  int ends[2];
  ASSERT_EQ(::pipe(ends), 0);
  const FileDescriptor wake(ends[0]);
  const FileDescriptor other_end(ends[1]);
  const FileDescriptor endless(::open("/dev/zero", O_RDONLY | O_CLOEXEC));
  /// What the client says of a ring, and how much memory it took of it.
  const auto verdict_of = [&](facet_ring_page page, off_t bytes, int wake_up) {
    const FileDescriptor memory(::memfd_create("ring", MFD_CLOEXEC | MFD_ALLOW_SEALING));
    EXPECT_EQ(::pwrite(memory.get(), &page, sizeof(page), 0), static_cast<ssize_t>(sizeof(page)));
    EXPECT_EQ(::ftruncate(memory.get(), bytes), 0);
    EXPECT_EQ(::fcntl(memory.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW), 0);
    const auto [outcome, why] = verdict(offer, FACET_WANT_RING, {memory.get(), wake_up});
    EXPECT_EQ(outcome, FACET_BAD_DATA);
    struct stat status {};
    EXPECT_EQ(::fstat(memory.get(), &status), 0);
    EXPECT_LT(status.st_blocks * 512, 1 << 20) << why;
    return why;
  };
  facet_ring_page page{};
  page.magic = FACET_RING_MAGIC;
  page.version = FACET_RING_VERSION;
  page.slot_count = FACET_RING_MAX_SLOTS;
  page.slot_bytes = kMaxMessageBytes;
  constexpr off_t kSparse = off_t{1} << 33;
  EXPECT_THAT(verdict_of(page, kSparse, wake.get()), HasSubstr("not all there"));
  EXPECT_THAT(verdict_of(page, 100'000, wake.get()), HasSubstr("not all there"));
  EXPECT_THAT(verdict_of({}, kSparse, wake.get()), HasSubstr("makes no sense"));
  facet_ring_page many = page;
  many.slot_count = FACET_RING_MAX_SLOTS + 1;
  EXPECT_THAT(verdict_of(many, kSparse, wake.get()), HasSubstr("makes no sense"));
  facet_ring_page long_slots = page;
  long_slots.slot_bytes = kMaxMessageBytes + FACET_RING_ALIGNMENT;
  EXPECT_THAT(verdict_of(long_slots, kSparse, wake.get()), HasSubstr("makes no sense"));
  facet_ring_page small = page;
  small.slot_count = 2;
  small.slot_bytes = 4096;
  EXPECT_THAT(verdict_of(small, 0x3000, endless.get()), HasSubstr("not all there"));
}

TEST_F(BadServer, WakeUpsWithoutEndAreNotWaitedFor) {
  auto offer = greeting();
  append(offer, encoder.ring({FACET_RING_VERSION, 65536}));
  const RingWriter ring(Profile::Displacements, 2, 4096);
  const FileDescriptor endless(::open("/dev/zero", O_RDONLY | O_CLOEXEC));
  const auto [outcome, why] = verdict(offer, FACET_WANT_RING, {ring.fd(), endless.get()});
  EXPECT_EQ(outcome, FACET_BAD_DATA);
  EXPECT_THAT(why, HasSubstr("no pipe"));
}

TEST_F(Client, AStoppedServerIsWaitedForUpToTheDeadline) {
  const ListeningSocket stopped(path, {});
  const auto queued = test::fill_queue(path);
  const CClient client = connect(FACET_SIGNALS, 0);
  EXPECT_EQ(facet_client_next(client.get(), 50), FACET_TIMEOUT);
  EXPECT_THAT(facet_client_message(client.get()), HasSubstr("does not answer"));
}

TEST_F(BadServer, MessagesWithoutEndDoNotKeepACallFromEnding) {
  const auto hello = greeting();
  std::vector<std::uint8_t> many;
  while (many.size() < 1 << 20) {
    append(many, encoder.dropped({1, 1}));
  }
  std::atomic<bool> done{false};
  const ListeningSocket socket(path, {});
  std::thread flood([&] {
    const auto send_all = [&](int fd, std::span<const std::uint8_t> bytes) {
      while (!bytes.empty()) {
        const ssize_t count = ::send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL);
        if (count <= 0) {
          return false;
        }
        bytes = bytes.subspan(static_cast<std::size_t>(count));
      }
      return true;
    };
    while (!done) {
      pollfd entry{socket.fd(), POLLIN, 0};
      if (::poll(&entry, 1, 10) <= 0) {
        continue;
      }
      const FileDescriptor connection(::accept(socket.fd(), nullptr, nullptr));
      for (bool sent = send_all(connection.get(), hello); sent && !done;) {
        sent = send_all(connection.get(), many);
      }
    }
  });
  {
    const CClient client = connect(FACET_SIGNALS, 0);
    EXPECT_EQ(facet_client_next(client.get(), 50), FACET_TIMEOUT);
  }
  {
    StreamClient client(path, {}, kPatience);
    DecodedFrame frame;
    EXPECT_EQ(client.next(frame, 50ms), ReceiveOutcome::Timeout);
  }
  done = true;
  flood.join();
}

std::string text_of(const std::filesystem::path& file) {
  std::ifstream stream(file);
  std::ostringstream out;
  out << stream.rdbuf();
  return out.str();
}

TEST_F(Client, ExamplePrints) {
  start();
  publish(7);
  test::ChildProcess print(FACET_CLIENT_PRINT, {path.string(), "1"}, folder.path() / "out");
  EXPECT_EQ(print.wait(), 0) << text_of(folder.path() / "out");
  EXPECT_THAT(text_of(folder.path() / "out"), testing::ContainsRegex("frame 7 jawOpen [0-9.]+ eyeBlinkLeft"));
}

TEST_F(Client, ExampleWritesObj) {
  start();
  publish(3);
  const auto file = folder.path() / "face.obj";
  test::ChildProcess write(FACET_CLIENT_WRITE_OBJ, {path.string(), file.string()}, folder.path() / "out");
  ASSERT_EQ(write.wait(), 0) << text_of(folder.path() / "out");
  Encoder encoder;
  DecodedFrame expected;
  decode_frame(encoder.frame(test::patch_frame(3, subject, nullptr), Profile::Displacements), subject,
               nullptr, expected);
  mesh::Vertices vertices_mm;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(*subject->hierarchy, expected.frame.control_vertices_mm,
                       expected.frame.displacements_mm, vertices_mm, normals);
  std::ifstream obj(file);
  std::string word;
  Eigen::Index vertex = 0;
  Eigen::Index faces = 0;
  for (std::string line; std::getline(obj, line);) {
    std::istringstream words(line);
    words >> word;
    faces += word == "f" ? 1 : 0;
    if (word == "v") {
      Eigen::Vector3f at;
      words >> at.x() >> at.y() >> at.z();
      ASSERT_EQ(at, vertices_mm.col(vertex)) << "nine digits bring back every bit";
      ++vertex;
    }
  }
  EXPECT_EQ(vertex, vertices_mm.cols());
  EXPECT_EQ(faces, subject->hierarchy->finest().triangles.cols());
}

}  // namespace
}  // namespace facet::stream
