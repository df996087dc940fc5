// Golden bytes: what version 1 of the protocol looks like. A program of a later release must still read them.
// FACET_WRITE_GOLDEN=1 in the environment writes the files of the current version anew; commit them only
// together with a new version, under its own name.

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <vector>

#include "facet/error.hpp"
#include "stream/decoder.hpp"
#include "stream/encoder.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"

namespace facet::stream {
namespace {

const std::filesystem::path kFolder = std::filesystem::path(FACET_SOURCE_DIR) / "tests/stream/golden";

std::vector<std::uint8_t> read_file(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

/// One quad with its centre: every number is exact in binary.
std::shared_ptr<const mesh::Subject> tiny_subject() {
  auto hierarchy = std::make_shared<mesh::Hierarchy>();
  hierarchy->id = 0x0123456789ABCDEFULL;
  hierarchy->control_vertex_count = 4;
  mesh::Level level;
  level.vertex_count = 5;
  level.triangles.resize(3, 4);
  level.triangles << 0, 1, 2, 3, 1, 2, 3, 0, 4, 4, 4, 4;
  level.from_coarser.row_offsets = {0, 1, 2, 3, 4, 8};
  level.from_coarser.columns = {0, 1, 2, 3, 0, 1, 2, 3};
  level.from_coarser.weights = {1, 1, 1, 1, 0.25F, 0.25F, 0.25F, 0.25F};
  level.one_rings = mesh::build_one_rings(level.triangles, 5);
  hierarchy->levels = {level};
  hierarchy->texture_coordinates.resize(2, 5);
  hierarchy->texture_coordinates << 0, 1, 1, 0, 0.5F, 0, 0, 1, 1, 0.5F;
  auto subject = std::make_shared<mesh::Subject>();
  subject->id = 42;
  subject->hierarchy = hierarchy;
  subject->expression_names = {"jawOpen", "mouthPucker"};
  subject->identity = {0.5F, -2.0F};
  subject->regions = {1, 1, 17, 1};
  return subject;
}

std::shared_ptr<const mesh::Albedo> tiny_albedo() {
  auto albedo = std::make_shared<mesh::Albedo>();
  albedo->version = 2;
  albedo->linear_rgb = {0, 0, 0, 1, 1, 1, 0.5F, 0.25F, 0.125F, 0.75F, 0.5F, 0.25F, 1, 0.5F, 0};
  return albedo;
}

mesh::MeshFrame tiny_frame() {
  mesh::MeshFrame frame;
  frame.sequence = 77;
  frame.timestamp_ns = 123'456'789'012;
  frame.media_time_ns = 2'566'666'666;
  frame.state = mesh::TrackingState::Tracking;
  frame.degraded = true;
  frame.degraded_reason = "test";
  frame.camera = {1000, 1000, 319.5F, 239.5F, 640, 480};
  frame.subject = tiny_subject();
  frame.camera_from_head.linear() << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  frame.camera_from_head.translation() << 8, -16, 512;
  frame.expression = {0.25F, 0.5F};
  frame.landmarks_px = {{100.5F, 200.25F}, {300, 400}};
  frame.reprojection_px = 0.75F;
  frame.control_vertices_mm.resize(3, 4);
  frame.control_vertices_mm << -10, 10, 10, -10, -10, -10, 10, 10, 0, 1, 2, 3;
  frame.displacements_mm = {0, 0.25F, -0.5F, 1, 2};
  frame.confidence = {0, 0.2F, 0.4F, 0.6F, 1};
  frame.lighting = {0.5F, 0.25F, 0.125F, 0, -0.25F, 0, 0, 1, 0.0625F};
  frame.albedo = tiny_albedo();
  frame.photometric_rms = 0.03125F;
  frame.stage_ms = {1, 2, 3, 4, 5, 6, 7, 8, 9, 45};
  return frame;
}

bool writes_golden() {
  return std::getenv("FACET_WRITE_GOLDEN") != nullptr;
}

void write_file(const std::filesystem::path& file, std::span<const std::uint8_t> bytes) {
  std::filesystem::create_directories(file.parent_path());
  std::ofstream(file, std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

/// Compares the encoder's bytes with the file's and gives the file's.
std::vector<std::uint8_t> golden(const std::string& name, std::span<const std::uint8_t> encoded,
                                 bool same_bytes = true) {
  const std::filesystem::path file = kFolder / ("v1_" + name + ".bin");
  if (writes_golden()) {
    write_file(file, encoded);
  }
  std::vector<std::uint8_t> bytes = read_file(file);
  EXPECT_FALSE(bytes.empty()) << file << " is missing";
  if (same_bytes) {
    EXPECT_EQ(bytes, std::vector<std::uint8_t>(encoded.begin(), encoded.end()))
        << name << ": the layout changed: raise the protocol version";
  }
  return bytes;
}

TEST(Golden, SmallMessagesOfVersion1) {
  Encoder encoder;
  Hello hello;
  hello.server = "facetd 0.1.0";
  EXPECT_EQ(decode_hello(golden("hello", encoder.hello(hello))).server, "facetd 0.1.0");
  const auto subscription = decode_subscription(
      golden("subscribe", encoder.subscription({1, Profile::Vertices, false, "example"})));
  EXPECT_EQ(subscription.protocol_version, 1U);
  EXPECT_EQ(subscription.profile, Profile::Vertices);
  EXPECT_FALSE(subscription.want_albedo);
  EXPECT_EQ(subscription.client, "example");
  EXPECT_EQ(decode_dropped(golden("dropped", encoder.dropped({3, 1000}))).total, 1000U);
  EXPECT_EQ(decode_goodbye(golden("goodbye", encoder.goodbye("the server stops"))), "the server stops");
}

TEST(Golden, SubjectAndAlbedoOfVersion1) {
  Encoder encoder;
  const auto subject =
      decode_subject(golden("subject", encoder.subject(*tiny_subject(), Profile::Displacements)));
  EXPECT_EQ(subject->id, 42U);
  EXPECT_EQ(subject->hierarchy->id, 0x0123456789ABCDEFULL);
  EXPECT_EQ(subject->expression_names, (std::vector<std::string>{"jawOpen", "mouthPucker"}));
  EXPECT_EQ(subject->hierarchy->finest().triangles, tiny_subject()->hierarchy->finest().triangles);
  EXPECT_EQ(subject->hierarchy->finest().from_coarser.weights,
            tiny_subject()->hierarchy->finest().from_coarser.weights);
  const auto albedo = decode_albedo(golden("albedo", encoder.albedo(42, *tiny_albedo())));
  EXPECT_EQ(albedo.albedo->version, 2U);
  EXPECT_NEAR(albedo.albedo->linear_rgb[7], 0.25F, 1e-5F);
}

TEST(Golden, FramesOfVersion1) {
  Encoder encoder;
  const mesh::MeshFrame sent = tiny_frame();
  DecodedFrame got;
  decode_frame(golden("frame_displacements", encoder.frame(sent, Profile::Displacements)), sent.subject,
               sent.albedo, got);
  EXPECT_EQ(got.frame.sequence, 77U);
  EXPECT_EQ(got.frame.timestamp_ns, 123'456'789'012);
  EXPECT_EQ(got.frame.degraded_reason, "test");
  EXPECT_EQ(got.frame.camera_from_head.matrix(), sent.camera_from_head.matrix());
  EXPECT_LE((got.frame.control_vertices_mm - sent.control_vertices_mm).cwiseAbs().maxCoeff(), 0.001F);
  EXPECT_NEAR(got.frame.displacements_mm[2], -0.5F, 0.001F);
  EXPECT_NEAR(got.frame.confidence[3], 0.6F, 0.002F);
  EXPECT_EQ(got.frame.landmarks_px, sent.landmarks_px);
  EXPECT_EQ(got.frame.lighting, sent.lighting);
  EXPECT_EQ(got.frame.stage_ms.upload_ms, 5.0F);
  EXPECT_EQ(got.frame.stage_ms.latency_ms, 45.0F);

  const auto topology = decode_subject(encoder.subject(*sent.subject, Profile::Vertices));
  // The rebuilt positions may differ in the last bit between compilers: the values are compared, not the
  // bytes.
  decode_frame(golden("frame_vertices", encoder.frame(sent, Profile::Vertices), false), topology, nullptr,
               got);
  ASSERT_EQ(got.vertices_mm.cols(), 5);
  mesh::Vertices vertices_mm;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(*sent.subject->hierarchy, sent.control_vertices_mm, sent.displacements_mm, vertices_mm,
                       normals);
  EXPECT_LE((got.vertices_mm - vertices_mm).cwiseAbs().maxCoeff(), 0.01F);
  EXPECT_LE((got.normals - normals).cwiseAbs().maxCoeff(), 1e-3F);

  decode_frame(golden("frame_signals", encoder.frame(sent, Profile::Signals)),
               decode_subject(encoder.subject(*sent.subject, Profile::Signals)), nullptr, got);
  EXPECT_EQ(got.frame.expression, sent.expression);
}

// The fuzzer's seeds: each kind of message, of the subject that the fuzzer knows, and some broken ones.
TEST(Golden, SeedsOfTheFuzzerAreWhatTheirNamesSay) {
  const std::filesystem::path corpus =
      std::filesystem::path(FACET_SOURCE_DIR) / "tests/fuzz/corpus/stream_message";
  if (writes_golden()) {
    Encoder encoder;
    const auto subject = test::patch_subject(5, 3, 1);
    const auto albedo = test::patch_albedo(*subject);
    write_file(corpus / "hello", encoder.hello({}));
    write_file(corpus / "subscribe", encoder.subscription({}));
    write_file(corpus / "dropped", encoder.dropped({1, 2}));
    write_file(corpus / "goodbye", encoder.goodbye("seed"));
    write_file(corpus / "albedo", encoder.albedo(subject->id, *albedo));
    for (const Profile profile : {Profile::Signals, Profile::Displacements, Profile::Vertices}) {
      const std::string suffix = std::string("_") + to_string(profile);
      write_file(corpus / ("subject" + suffix), encoder.subject(*subject, profile));
      write_file(corpus / ("frame" + suffix), encoder.frame(test::patch_frame(1, subject, albedo), profile));
    }
  }
  int seeds = 0;
  for (const auto& entry : std::filesystem::directory_iterator(corpus)) {
    if (entry.path().filename().string().starts_with("broken")) {
      EXPECT_THROW(message_type(read_file(entry.path())), Error) << entry.path();
      continue;
    }
    EXPECT_NE(message_type(read_file(entry.path())), MessageType::Unknown) << entry.path();
    ++seeds;
  }
  EXPECT_GE(seeds, 11);
}

}  // namespace
}  // namespace facet::stream
