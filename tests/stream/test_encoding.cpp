#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "facet/error.hpp"
#include "facet_generated.h"
#include "stream/decoder.hpp"
#include "stream/encoder.hpp"
#include "support/mesh_frames.hpp"

namespace facet::stream {
namespace {

using testing::HasSubstr;

constexpr float kMaxErrorMm = 0.01F;

std::vector<std::uint8_t> copy(std::span<const std::uint8_t> bytes) {
  return {bytes.begin(), bytes.end()};
}

std::string rejection(std::span<const std::uint8_t> message, auto&& decode) {
  try {
    decode(message);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  return "";
}

class Encoding : public testing::Test {
 protected:
  std::shared_ptr<const mesh::Subject> subject = test::patch_subject();
  std::shared_ptr<const mesh::Albedo> albedo = test::patch_albedo(*subject, 3);
  Encoder encoder;

  DecodedFrame round_trip(const mesh::MeshFrame& frame, Profile profile) {
    const auto known = decode_subject(encoder.subject(*frame.subject, profile));
    const auto colours = frame.albedo != nullptr
                             ? decode_albedo(encoder.albedo(frame.subject->id, *frame.albedo)).albedo
                             : nullptr;
    DecodedFrame out;
    decode_frame(encoder.frame(frame, profile), known, colours, out);
    return out;
  }
};

float largest_difference(const std::vector<float>& a, const std::vector<float>& b) {
  float largest = a.size() == b.size() ? 0.0F : std::numeric_limits<float>::infinity();
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
    largest = std::max(largest, std::abs(a[i] - b[i]));
  }
  return largest;
}

void expect_same_signals(const mesh::MeshFrame& got, const mesh::MeshFrame& sent) {
  EXPECT_EQ(got.sequence, sent.sequence);
  EXPECT_EQ(got.timestamp_ns, sent.timestamp_ns);
  EXPECT_EQ(got.media_time_ns, sent.media_time_ns);
  EXPECT_EQ(got.state, sent.state);
  EXPECT_EQ(got.degraded, sent.degraded);
  EXPECT_EQ(got.degraded_reason, sent.degraded_reason);
  EXPECT_EQ(got.camera.fx, sent.camera.fx);
  EXPECT_EQ(got.camera.cy, sent.camera.cy);
  EXPECT_EQ(got.camera.width_px, sent.camera.width_px);
  EXPECT_EQ(got.camera.height_px, sent.camera.height_px);
  EXPECT_EQ(got.landmarks_px, sent.landmarks_px);
  EXPECT_EQ(got.reprojection_px, sent.reprojection_px);
  EXPECT_EQ(got.stage_ms.landmarks_ms, sent.stage_ms.landmarks_ms);
  EXPECT_EQ(got.stage_ms.displacement_ms, sent.stage_ms.displacement_ms);
  EXPECT_EQ(got.stage_ms.latency_ms, sent.stage_ms.latency_ms);
  EXPECT_EQ(got.stage_ms.depth_ms, sent.stage_ms.depth_ms);
  EXPECT_EQ(got.camera_from_head.matrix(), sent.camera_from_head.matrix());
  EXPECT_EQ(got.expression, sent.expression);
  EXPECT_EQ(got.avatar_values, sent.avatar_values);
  EXPECT_EQ(got.model_weights, sent.model_weights);
  EXPECT_LE(largest_difference(got.expression_confidence, sent.expression_confidence), 0.5F / 255 + 1e-6F);
  EXPECT_EQ(got.lighting, sent.lighting);
  EXPECT_EQ(got.photometric_rms, sent.photometric_rms);
}

TEST_F(Encoding, DisplacementsKeepEverythingWithinAHundredthOfAMillimetre) {
  mesh::MeshFrame sent = test::patch_frame(7, subject, albedo);
  sent.stage_ms.depth_ms = 7.25F;
  sent.model_weights = sent.expression;
  sent.model_weights.front() += 0.125F;
  sent.avatar_values.assign(sent.expression.size(), 0.75F);
  sent.avatar_values.back() = 0.1F;
  sent.expression_confidence.assign(sent.expression.size(), 0.25F);
  sent.expression_confidence.back() = 1;
  const mesh::MeshFrame got = round_trip(sent, Profile::Displacements).frame;
  expect_same_signals(got, sent);
  ASSERT_EQ(got.control_vertices_mm.cols(), sent.control_vertices_mm.cols());
  EXPECT_LE((got.control_vertices_mm - sent.control_vertices_mm).cwiseAbs().maxCoeff(), kMaxErrorMm);
  EXPECT_LE(largest_difference(got.displacements_mm, sent.displacements_mm),
            0.5F * kDisplacementStepMm * 1.01F);
  EXPECT_LE(largest_difference(got.confidence, sent.confidence), 0.5F / 255 + 1e-6F);
  ASSERT_NE(got.albedo, nullptr);
  EXPECT_EQ(got.albedo->version, 3U);
  EXPECT_LE(largest_difference(got.albedo->linear_rgb, sent.albedo->linear_rgb), 1e-5F);
}

TEST_F(Encoding, ErrorStaysBoundedForWideExtents) {
  mesh::MeshFrame sent = test::patch_frame(8, subject, nullptr);
  sent.control_vertices_mm *= 7.5F;  // 560 mm from the centre
  for (float& displacement : sent.displacements_mm) {
    displacement *= 40;  // 60 mm
  }
  const mesh::MeshFrame got = round_trip(sent, Profile::Displacements).frame;
  EXPECT_LE((got.control_vertices_mm - sent.control_vertices_mm).cwiseAbs().maxCoeff(), kMaxErrorMm);
  EXPECT_LE(largest_difference(got.displacements_mm, sent.displacements_mm), kMaxErrorMm);
}

TEST_F(Encoding, VerticesAreTheRebuiltFinestMesh) {
  const mesh::MeshFrame sent = test::patch_frame(9, subject, albedo);
  const DecodedFrame got = round_trip(sent, Profile::Vertices);
  expect_same_signals(got.frame, sent);
  EXPECT_EQ(got.frame.control_vertices_mm.cols(), 0);
  mesh::Vertices vertices_mm;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(*subject->hierarchy, sent.control_vertices_mm, sent.displacements_mm, vertices_mm,
                       normals);
  ASSERT_EQ(got.vertices_mm.cols(), vertices_mm.cols());
  EXPECT_LE((got.vertices_mm - vertices_mm).cwiseAbs().maxCoeff(), kMaxErrorMm);
  EXPECT_LE((got.normals - normals).cwiseAbs().maxCoeff(), 1e-4F);
  EXPECT_EQ(got.frame.confidence.size(), sent.confidence.size());
}

TEST_F(Encoding, SignalsCarryNoGeometry) {
  const mesh::MeshFrame sent = test::patch_frame(10, subject, albedo);
  const DecodedFrame got = round_trip(sent, Profile::Signals);
  expect_same_signals(got.frame, sent);
  EXPECT_EQ(got.frame.subject->hierarchy, nullptr);
  EXPECT_EQ(got.frame.control_vertices_mm.cols(), 0);
  EXPECT_TRUE(got.frame.displacements_mm.empty());
  EXPECT_EQ(got.vertices_mm.cols(), 0);
  EXPECT_LT(encoder.frame(sent, Profile::Signals).size(), 8192U);
}

TEST_F(Encoding, UnrefinedFrameHasNoDisplacements) {
  mesh::MeshFrame sent = test::patch_frame(11, subject, nullptr);
  sent.displacements_mm.clear();
  sent.confidence.clear();
  const mesh::MeshFrame got = round_trip(sent, Profile::Displacements).frame;
  EXPECT_TRUE(got.displacements_mm.empty());
  EXPECT_TRUE(got.confidence.empty());
  EXPECT_EQ(got.albedo, nullptr);
  EXPECT_GT(got.control_vertices_mm.cols(), 0);
}

TEST_F(Encoding, FrameWithoutFaceRefersToNothing) {
  mesh::MeshFrame sent = test::searching_frame(12);
  sent.degraded = true;
  sent.degraded_reason = "corrupt image";
  const auto message = encoder.frame(sent, Profile::Displacements);
  EXPECT_EQ(frame_references(message).subject_id, 0U);
  DecodedFrame got;
  decode_frame(message, nullptr, nullptr, got);
  expect_same_signals(got.frame, sent);
  EXPECT_EQ(got.frame.subject, nullptr);
}

TEST_F(Encoding, SubjectComesBackWhole) {
  const auto got = decode_subject(encoder.subject(*subject, Profile::Displacements));
  EXPECT_EQ(got->id, subject->id);
  EXPECT_EQ(got->expression_names, subject->expression_names);
  EXPECT_EQ(got->identity, subject->identity);
  EXPECT_EQ(got->regions, subject->regions);
  EXPECT_EQ(got->person, "");
  const mesh::Hierarchy& a = *got->hierarchy;
  const mesh::Hierarchy& b = *subject->hierarchy;
  EXPECT_EQ(a.id, b.id);
  EXPECT_EQ(a.control_vertex_count, b.control_vertex_count);
  EXPECT_EQ(a.texture_coordinates, b.texture_coordinates);
  ASSERT_EQ(a.levels.size(), b.levels.size());
  for (std::size_t level = 0; level < a.levels.size(); ++level) {
    EXPECT_EQ(a.levels[level].vertex_count, b.levels[level].vertex_count);
    EXPECT_EQ(a.levels[level].triangles, b.levels[level].triangles);
    EXPECT_EQ(a.levels[level].from_coarser.row_offsets, b.levels[level].from_coarser.row_offsets);
    EXPECT_EQ(a.levels[level].from_coarser.columns, b.levels[level].from_coarser.columns);
    EXPECT_EQ(a.levels[level].from_coarser.weights, b.levels[level].from_coarser.weights);
    EXPECT_EQ(a.levels[level].one_rings.neighbours, b.levels[level].one_rings.neighbours);
  }
}

TEST_F(Encoding, SubjectNamesThePersonInEveryProfile) {
  mesh::Subject known = *subject;
  known.person = "Zo\xC3\xAB";
  for (const Profile profile : {Profile::Signals, Profile::Displacements, Profile::Vertices}) {
    EXPECT_EQ(decode_subject(encoder.subject(known, profile))->person, known.person);
  }
  known.person.assign(kMaxNameBytes + 1, 'x');
  EXPECT_EQ(decode_subject(encoder.subject(known, Profile::Signals))->person.size(), kMaxNameBytes);
}

TEST_F(Encoding, AFaceOfItsOwnGoesWithTheSubjectThatRebuildsItAlone) {
  auto known = std::make_shared<mesh::Subject>(*subject);
  known->neutral_mm = mesh::Vertices::Random(3, subject->hierarchy->control_vertex_count);
  EXPECT_EQ(decode_subject(encoder.subject(*known, Profile::Displacements))->neutral_mm, known->neutral_mm);
  EXPECT_EQ(decode_subject(encoder.subject(*known, Profile::Vertices))->neutral_mm.size(), 0);
  EXPECT_EQ(decode_subject(encoder.subject(*known, Profile::Signals))->neutral_mm.size(), 0);
  EXPECT_NE(mesh::subject_id(*known, 1), mesh::subject_id(*subject, 1));
  known->neutral_mm.conservativeResize(3, known->neutral_mm.cols() - 1);
  EXPECT_THROW(decode_subject(encoder.subject(*known, Profile::Displacements)), std::exception);
  known->neutral_mm(0, 0) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(decode_subject(encoder.subject(*known, Profile::Displacements)), std::exception);
}

TEST_F(Encoding, VerticesSubjectHasTheFinestTrianglesOnly) {
  const auto got = decode_subject(encoder.subject(*subject, Profile::Vertices));
  ASSERT_EQ(got->hierarchy->levels.size(), 1U);
  EXPECT_EQ(got->hierarchy->control_vertex_count, 0);
  EXPECT_EQ(got->hierarchy->finest().triangles, subject->hierarchy->finest().triangles);
}

TEST_F(Encoding, UnsoundMeshIsLeftOutWithAReason) {
  const auto reason_for = [&](auto&& spoil) {
    mesh::MeshFrame frame = test::patch_frame(13, subject, albedo);
    spoil(frame);
    const auto message = encoder.frame(frame, Profile::Displacements);
    EXPECT_EQ(frame_references(message).subject_id, 0U);
    DecodedFrame got;
    decode_frame(message, nullptr, nullptr, got);
    EXPECT_TRUE(got.frame.degraded);
    return got.frame.degraded_reason;
  };
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) { f.expression.pop_back(); }), HasSubstr("expression"));
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) { f.model_weights.assign(f.expression.size() + 1, 0); }),
              HasSubstr("model's weights"));
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) {
                f.model_weights.assign(f.expression.size(), 1);
                f.model_weights.front() = kNaN;
              }),
              HasSubstr("finite"));
  EXPECT_THAT(
      reason_for([](mesh::MeshFrame& f) { f.expression_confidence.assign(f.expression.size() + 1, 1); }),
      HasSubstr("expression's confidences"));
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) {
                f.expression_confidence.assign(f.expression.size(), std::numeric_limits<float>::quiet_NaN());
              }),
              HasSubstr("finite"));
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) { f.avatar_values.assign(f.expression.size() + 1, 1); }),
              HasSubstr("avatar values"));
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) {
                f.avatar_values.assign(f.expression.size(), std::numeric_limits<float>::quiet_NaN());
              }),
              HasSubstr("finite"));
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) { f.displacements_mm.pop_back(); }),
              HasSubstr("displacements"));
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) { f.confidence.pop_back(); }), HasSubstr("confidences"));
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) { f.camera_from_head.matrix()(0, 3) = kNaN; }),
              HasSubstr("finite"));
  EXPECT_THAT(reason_for([](mesh::MeshFrame& f) { f.lighting[4] = kNaN; }), HasSubstr("finite"));
}

TEST_F(Encoding, WhatNoReaderWouldAcceptIsLeftOutWithAdvice) {
  EXPECT_EQ(subject_fault(*subject), "");
  const auto reason_for = [&](auto&& spoil) {
    auto too_big = std::make_shared<mesh::Subject>(*subject);
    auto hierarchy = std::make_shared<mesh::Hierarchy>(*subject->hierarchy);
    spoil(*too_big, *hierarchy);
    too_big->hierarchy = hierarchy;
    const auto message = encoder.frame(test::patch_frame(13, too_big, nullptr), Profile::Displacements);
    EXPECT_EQ(frame_references(message).subject_id, 0U);
    DecodedFrame got;
    decode_frame(message, nullptr, nullptr, got);
    EXPECT_TRUE(got.frame.degraded);
    EXPECT_EQ(got.frame.degraded_reason, subject_fault(*too_big));
    return got.frame.degraded_reason;
  };
  EXPECT_THAT(reason_for([](mesh::Subject& s, mesh::Hierarchy&) { s.identity.resize(kMaxCoefficients + 1); }),
              HasSubstr("smaller model"));
  EXPECT_THAT(reason_for([](mesh::Subject&, mesh::Hierarchy& h) {
                h.levels.back().vertex_count = static_cast<std::int32_t>(kMaxVertices) + 1;
              }),
              HasSubstr("lower hierarchy.max_vertices"));
  EXPECT_THAT(reason_for([](mesh::Subject&, mesh::Hierarchy& h) {
                h.levels.back().from_coarser.weights.resize(kMaxMessageBytes / sizeof(float));
              }),
              HasSubstr("lower hierarchy.max_vertices"));
}

TEST_F(Encoding, NumbersThatAreNotFiniteBecomeZero) {
  mesh::MeshFrame sent = test::patch_frame(14, subject, nullptr);
  sent.displacements_mm[5] = std::numeric_limits<float>::quiet_NaN();
  sent.displacements_mm[6] = std::numeric_limits<float>::infinity();
  sent.confidence[5] = std::numeric_limits<float>::quiet_NaN();
  const mesh::MeshFrame got = round_trip(sent, Profile::Displacements).frame;
  EXPECT_EQ(got.displacements_mm[5], 0.0F);
  EXPECT_EQ(got.displacements_mm[6], 0.0F);
  EXPECT_EQ(got.confidence[5], 0.0F);
  EXPECT_NEAR(got.displacements_mm[7], sent.displacements_mm[7], kMaxErrorMm);
}

Frame picture(int width_px, int height_px, bool grey) {
  Frame frame;
  frame.sequence = 77;
  frame.timestamp_ns = 123'456'789;
  frame.width_px = width_px;
  frame.height_px = height_px;
  frame.stride_bytes = static_cast<std::size_t>(width_px) * 4 + 64;  // rows are padded
  const std::size_t size = frame.stride_bytes * static_cast<std::size_t>(height_px);
  auto pixels = std::make_shared<std::uint8_t[]>(size);
  for (std::size_t i = 0; i < size; ++i) {
    const std::size_t value = grey ? i / 4 : i;
    pixels.get()[i] = i % 4 == 3 ? std::uint8_t{255} : static_cast<std::uint8_t>(value * 37 % 251);
  }
  frame.pixels = std::move(pixels);
  return frame;
}

std::shared_ptr<FrameSet> three_cameras() {
  auto set = std::make_shared<FrameSet>();
  set->slot = 4711;
  set->trigger_ns = 123'000'000;
  set->skew_ns = 250;
  set->light = "light:led.top";
  set->frames = {picture(21, 5, false), {}, picture(7, 9, true)};
  set->frames[2].corrupt = true;
  set->missing = 0b010;
  set->camera_names =
      std::make_shared<const std::vector<std::string>>(std::vector<std::string>{"left", "middle", "right"});
  return set;
}

TEST_F(Encoding, PicturesComeBackPixelByPixel) {
  mesh::MeshFrame frame = test::searching_frame(4711);
  const auto sent = three_cameras();
  frame.images = sent;
  const auto message = copy(encoder.frame(frame, Profile::Signals, {true}));
  DecodedFrame out;
  decode_frame(message, nullptr, nullptr, out);
  ASSERT_NE(out.frame.images, nullptr);
  const FrameSet& got = *out.frame.images;
  EXPECT_EQ(got.slot, sent->slot);
  EXPECT_EQ(got.trigger_ns, sent->trigger_ns);
  EXPECT_EQ(got.skew_ns, sent->skew_ns);
  EXPECT_EQ(got.light, sent->light);
  EXPECT_EQ(got.missing, sent->missing);
  EXPECT_EQ(*got.camera_names, *sent->camera_names);
  for (const std::size_t camera : {0U, 2U}) {
    const Frame& a = sent->frames[camera];
    const Frame& b = got.frames[camera];
    EXPECT_EQ(b.sequence, a.sequence);
    EXPECT_EQ(b.timestamp_ns, a.timestamp_ns);
    EXPECT_EQ(b.corrupt, a.corrupt);
    ASSERT_EQ(b.width_px, a.width_px);
    ASSERT_EQ(b.height_px, a.height_px);
    for (int y = 0; y < a.height_px; ++y) {
      EXPECT_TRUE(std::equal(a.row(y), a.row(y) + 4 * a.width_px, b.row(y))) << "row " << y;
    }
  }
  EXPECT_LT(message.size(), 21U * 5 * 3 + 7 * 9 + 600) << "a grey picture has one channel";

  // Without pixels the rest stays.
  decode_frame(copy(encoder.frame(frame, Profile::Signals)), nullptr, nullptr, out);
  EXPECT_EQ(out.frame.images->missing, sent->missing);
  EXPECT_TRUE(out.frame.images->frames[0].empty());
  EXPECT_EQ(out.frame.images->frames[0].sequence, 77U);
  EXPECT_EQ(out.frame.images->frames[0].width_px, 21);
}

TEST_F(Encoding, PicturesComeAsSmallAsTheyAreWanted) {
  mesh::MeshFrame frame = test::searching_frame(4711);
  const auto sent = three_cameras();
  frame.images = sent;
  const auto message = copy(encoder.frame(frame, Profile::Signals, {true, 10}));
  DecodedFrame out;
  decode_frame(message, nullptr, nullptr, out);
  const Frame& whole = sent->frames[0];  // 21x5, in thirds
  const Frame& small = out.frame.images->frames[0];
  ASSERT_EQ(small.width_px, 7);
  ASSERT_EQ(small.height_px, 1);
  for (int x = 0; x < 7; ++x) {
    for (int channel = 0; channel < 3; ++channel) {
      double sum = 0;
      for (int k = 0; k < 9; ++k) {
        sum += whole.row(k / 3)[4 * (3 * x + k % 3) + channel];
      }
      EXPECT_NEAR(small.row(0)[4 * x + channel], sum / 9, 0.51) << "pixel " << x;
    }
  }
  const Frame& other = out.frame.images->frames[2];  // 7x9 is small enough
  EXPECT_EQ(other.width_px, 7);
  EXPECT_EQ(std::memcmp(other.row(3), sent->frames[2].row(3), 28), 0);
}

TEST_F(Encoding, AFrameSaysWhereItComesFrom) {
  mesh::MeshFrame frame = test::searching_frame(1);
  DecodedFrame out;
  for (const mesh::Origin origin : {mesh::Origin::Live, mesh::Origin::Take, mesh::Origin::Pose}) {
    frame.origin = origin;
    decode_frame(copy(encoder.frame(frame, Profile::Signals)), nullptr, nullptr, out);
    EXPECT_EQ(out.frame.origin, origin);
  }
}

// Readers of finest vertices draw a coarser level over the same vertices.
TEST_F(Encoding, CoarserLevelsComeWithTheFinest) {
  const auto several = test::patch_subject(5, 3, 3);
  const mesh::Hierarchy& sent = *several->hierarchy;
  ASSERT_GE(sent.levels.size(), 2U);
  const auto message = copy(encoder.subject(*several, Profile::Vertices));
  const auto* levels = wire::GetMessage(message.data())->body_as_Subject()->hierarchy()->coarser_levels();
  ASSERT_NE(levels, nullptr);
  ASSERT_EQ(levels->size() + 1, sent.levels.size());
  for (std::uint32_t k = 0; k < levels->size(); ++k) {
    const mesh::Level& level = sent.levels[k];
    EXPECT_EQ(levels->Get(k)->vertex_count(), static_cast<std::uint32_t>(level.vertex_count));
    ASSERT_EQ(levels->Get(k)->triangles()->size(), static_cast<std::uint32_t>(level.triangles.size()));
    EXPECT_EQ(levels->Get(k)->triangles()->Get(4), static_cast<std::uint32_t>(level.triangles(1, 1)));
  }
  EXPECT_EQ(decode_subject(message)->hierarchy->finest().triangles, sent.finest().triangles);
  const auto whole = copy(encoder.subject(*several, Profile::Displacements));
  EXPECT_EQ(wire::GetMessage(whole.data())->body_as_Subject()->hierarchy()->coarser_levels(), nullptr);
}

TEST_F(Encoding, PicturesTooLargeForAMessageAreLeftOutWithAdvice) {
  mesh::MeshFrame frame = test::searching_frame(1);
  const auto set = three_cameras();
  set->frames[0] = picture(4200, 4200, false);
  frame.images = set;
  const auto message = copy(encoder.frame(frame, Profile::Signals, {true}));
  EXPECT_LT(message.size(), 4096U);
  DecodedFrame out;
  decode_frame(message, nullptr, nullptr, out);
  EXPECT_TRUE(out.frame.degraded);
  EXPECT_THAT(out.frame.degraded_reason, HasSubstr("use smaller pictures"));
}

TEST_F(Encoding, DamagedPicturesAreRejected) {
  mesh::MeshFrame frame = test::searching_frame(4711);
  frame.images = three_cameras();
  const auto sound = copy(encoder.frame(frame, Profile::Signals, {true}));
  std::mt19937 random(5);
  int rejected = 0;
  for (int trial = 0; trial < 2000; ++trial) {
    auto bytes = sound;
    bytes[random() % 400] = static_cast<std::uint8_t>(random());
    DecodedFrame out;
    rejected +=
        rejection(bytes, [&](auto message) { decode_frame(message, nullptr, nullptr, out); }).empty() ? 0 : 1;
  }
  EXPECT_GT(rejected, 500);
}

TEST_F(Encoding, SmallMessagesComeBack) {
  Hello hello;
  hello.server = "facetd 1";
  const Hello hello_back = decode_hello(encoder.hello(hello));
  EXPECT_EQ(hello_back.server, hello.server);
  EXPECT_EQ(hello_back.profiles, hello.profiles);
  EXPECT_EQ(hello_back.protocol_version, kProtocolVersion);
  const Subscription back =
      decode_subscription(encoder.subscription({kProtocolVersion, Profile::Vertices, false, "me"}));
  EXPECT_EQ(back.profile, Profile::Vertices);
  EXPECT_FALSE(back.want_albedo);
  EXPECT_EQ(back.client, "me");
  const Dropped dropped = decode_dropped(encoder.dropped({3, 90}));
  EXPECT_EQ(dropped.since_last, 3U);
  EXPECT_EQ(dropped.total, 90U);
  EXPECT_EQ(decode_goodbye(encoder.goodbye("enough")), "enough");
  EXPECT_EQ(message_type(encoder.goodbye("enough")), MessageType::Goodbye);
}

TEST_F(Encoding, LongTextsAreCutToTheirLimits) {
  const std::string text(5000, 'x');
  EXPECT_EQ(decode_goodbye(encoder.goodbye(text)).size(), kMaxTextBytes);
  EXPECT_EQ(decode_subscription(encoder.subscription({kProtocolVersion, Profile::Signals, true, text}))
                .client.size(),
            kMaxNameBytes);
}

TEST_F(Encoding, MessageOfAnotherKindIsRejected) {
  const auto message = copy(encoder.goodbye("x"));
  EXPECT_THAT(rejection(message, decode_hello), HasSubstr("not a hello"));
  EXPECT_THAT(rejection(message, decode_subject), HasSubstr("not a subject"));
  EXPECT_THAT(rejection(message, frame_references), HasSubstr("not a frame"));
}

TEST_F(Encoding, FrameNeedsItsOwnSubjectAndAlbedo) {
  const auto message = copy(encoder.frame(test::patch_frame(15, subject, albedo), Profile::Displacements));
  const auto decode_with = [&](std::shared_ptr<const mesh::Subject> s,
                               std::shared_ptr<const mesh::Albedo> a) {
    return rejection(message, [&](std::span<const std::uint8_t> bytes) {
      DecodedFrame out;
      decode_frame(bytes, std::move(s), std::move(a), out);
    });
  };
  EXPECT_THAT(decode_with(nullptr, nullptr), HasSubstr("subject was not sent"));
  EXPECT_THAT(decode_with(test::patch_subject(1), nullptr), HasSubstr("subject was not sent"));
  EXPECT_THAT(decode_with(test::patch_subject(subject->id, 5), nullptr), HasSubstr("control vertices"));
  EXPECT_THAT(decode_with(subject, test::patch_albedo(*subject, 4)), HasSubstr("another version"));
  EXPECT_EQ(decode_with(subject, nullptr), "");
}

/// One thing wrong in an otherwise sound topology.
TEST_F(Encoding, BrokenTopologyIsRejectedByName) {
  const auto reason_for = [&](auto&& spoil) {
    auto hierarchy = std::make_shared<mesh::Hierarchy>(*subject->hierarchy);
    spoil(*hierarchy);
    mesh::Subject broken = *subject;
    broken.hierarchy = hierarchy;
    return rejection(copy(encoder.subject(broken, Profile::Displacements)), decode_subject);
  };
  EXPECT_THAT(reason_for([](mesh::Hierarchy& h) { h.levels[0].triangles(1, 3) = h.levels[0].vertex_count; }),
              HasSubstr("triangle"));
  EXPECT_THAT(
      reason_for([](mesh::Hierarchy& h) { h.levels[0].triangles(1, 3) = h.levels[0].triangles(0, 3); }),
      testing::Not(testing::IsEmpty()));
  EXPECT_THAT(reason_for([](mesh::Hierarchy& h) { h.levels[1].from_coarser.columns[9] = 1 << 20; }),
              HasSubstr("column out of range"));
  EXPECT_THAT(reason_for([](mesh::Hierarchy& h) { h.levels[1].from_coarser.weights[9] += 0.5F; }),
              HasSubstr("sum to 1"));
  EXPECT_THAT(reason_for([](mesh::Hierarchy& h) {
                h.levels[1].from_coarser.weights[9] = std::numeric_limits<float>::quiet_NaN();
              }),
              HasSubstr("sum to 1"));
  EXPECT_THAT(reason_for([](mesh::Hierarchy& h) {
                std::swap(h.levels[0].from_coarser.row_offsets[3], h.levels[0].from_coarser.row_offsets[5]);
              }),
              HasSubstr("row offsets"));
  EXPECT_THAT(reason_for([](mesh::Hierarchy& h) { h.levels[0].from_coarser.weights.pop_back(); }),
              HasSubstr("numbers of columns and weights"));
  EXPECT_THAT(reason_for([](mesh::Hierarchy& h) { h.texture_coordinates.conservativeResize(2, 5); }),
              HasSubstr("texture coordinates"));
  EXPECT_THAT(reason_for([](mesh::Hierarchy& h) { h.levels.clear(); }), HasSubstr("number of levels"));
}

void decode_anything(std::span<const std::uint8_t> message,
                     const std::shared_ptr<const mesh::Subject>& subject) {
  switch (message_type(message)) {
    case MessageType::Subject:
      decode_subject(message);
      break;
    case MessageType::Frame: {
      DecodedFrame out;
      decode_frame(message, subject, nullptr, out);
      break;
    }
    case MessageType::Albedo:
      decode_albedo(message);
      break;
    default:
      break;
  }
}

TEST_F(Encoding, TruncatedMessagesAreRejected) {
  const auto small = test::patch_subject(5, 3, 1);
  for (const auto& message :
       {copy(encoder.subject(*small, Profile::Displacements)),
        copy(encoder.frame(test::patch_frame(1, small, nullptr), Profile::Displacements))}) {
    // The last bytes may be padding, whose loss changes nothing.
    for (std::size_t length = 0; length + sizeof(std::uint64_t) <= message.size(); ++length) {
      // In a buffer of its own length, so that a read past the end is seen by the address sanitizer.
      const std::vector<std::uint8_t> part(message.begin(),
                                           message.begin() + static_cast<std::ptrdiff_t>(length));
      const std::string why =
          rejection(part, [&](std::span<const std::uint8_t> m) { decode_anything(m, small); });
      ASSERT_NE(why, "") << "length " << length;
    }
  }
}

TEST_F(Encoding, FlippedBytesNeverBreakTheDecoder) {
  constexpr unsigned kSeed = 20261121;
  std::mt19937 random(kSeed);
  const auto small = test::patch_subject(5, 3, 1);
  const std::vector<std::vector<std::uint8_t>> sound = {
      copy(encoder.subject(*small, Profile::Displacements)),
      copy(encoder.frame(test::patch_frame(1, small, nullptr), Profile::Displacements)),
      copy(encoder.albedo(5, *test::patch_albedo(*small)))};
  int rejected = 0;
  for (int round = 0; round < 3000; ++round) {
    auto message = sound[static_cast<std::size_t>(round) % sound.size()];
    for (int flip = 0; flip < 3; ++flip) {
      message[random() % message.size()] = static_cast<std::uint8_t>(random());
    }
    rejected +=
        rejection(message, [&](std::span<const std::uint8_t> m) { decode_anything(m, small); }).empty() ? 0
                                                                                                        : 1;
  }
  EXPECT_GT(rejected, 100) << "seed " << kSeed;
}

}  // namespace
}  // namespace facet::stream
