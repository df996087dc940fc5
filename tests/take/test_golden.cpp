// A take as any format version wrote it must stay readable for ever. FACET_WRITE_GOLDEN=1 in the environment
// records the files of the current version anew; commit them only under a new version's name.

#include <gtest/gtest.h>

#include <cstdlib>

#include "record_take.hpp"
#include "support/paths.hpp"
#include "take/reader.hpp"

namespace facet::take {
namespace {

TEST(Golden, TakeOfVersion1) {
  const std::filesystem::path file = std::filesystem::path(FACET_SOURCE_DIR) / "tests/take/golden/v1.take";
  const auto subject = test::patch_subject(5, 3, 1);
  TakeReader reader(file);
  EXPECT_EQ(reader.info().format_version, 1);
  EXPECT_EQ(reader.info().frame_count, 12);
  EXPECT_EQ(reader.info().mesh_frame_count, 10);
  EXPECT_EQ(reader.info().source, "synthetic patch");
  EXPECT_TRUE(reader.info().closed);
  for (std::int64_t index = 0; index < 12; ++index) {
    const auto got = reader.frame(index);
    EXPECT_EQ(got->sequence, static_cast<std::uint64_t>(index));
    EXPECT_EQ(got->camera.fx, 1100.0F);
    EXPECT_EQ(got->state, index % 5 == 4 ? mesh::TrackingState::Searching : mesh::TrackingState::Tracking);
    if (index % 5 == 4) {
      continue;
    }
    EXPECT_EQ(got->subject->id, 5U);
    EXPECT_EQ(got->subject->expression_names, subject->expression_names);
    EXPECT_EQ(got->subject->hierarchy->control_vertex_count, 9);
    EXPECT_EQ(got->albedo->version, index < 10 ? 1U : 2U);
    // The patch is 150 mm wide about the head's origin and 600 mm in front of the camera.
    EXPECT_NEAR(got->control_vertices_mm(0, 0), -75.0F, 0.01F);
    EXPECT_NEAR(got->control_vertices_mm(1, 8), 75.0F, 0.01F);
    EXPECT_EQ(got->camera_from_head.translation().z(), 600.0F);
    EXPECT_EQ(got->stage_ms.latency_ms, 42.0F);
    EXPECT_EQ(got->displacements_mm.size(), got->confidence.size());
  }
}

TEST(Golden, TakeOfVersion2) {
  const std::filesystem::path file = std::filesystem::path(FACET_SOURCE_DIR) / "tests/take/golden/v2.take";
  constexpr std::uint64_t kSegmentBytes = 6000;
  if (std::getenv("FACET_WRITE_GOLDEN") != nullptr) {
    std::filesystem::remove(file);
    std::filesystem::remove_all(std::filesystem::path(file).replace_extension(".frames"));
    ASSERT_EQ(test::record_pictures(test::picture_config(file, kSegmentBytes), 8).frames, 8U);
  }
  TakeReader reader(file);
  EXPECT_EQ(reader.info().format_version, 2);
  EXPECT_EQ(reader.info().source, "three cameras");
  EXPECT_TRUE(reader.info().closed);
  ASSERT_EQ(reader.frame_count(), 8);
  EXPECT_GT(reader.info().segments.size(), 1U);
  for (const TakeSegment& segment : reader.info().segments) {
    EXPECT_EQ(segment.fault, "");
    EXPECT_LE(std::filesystem::file_size(segment.file), kSegmentBytes);
  }
  for (std::int64_t index = 0; index < 8; ++index) {
    const auto frame = reader.frame(index);
    EXPECT_EQ(frame->sequence, static_cast<std::uint64_t>(index));
    ASSERT_NE(frame->images, nullptr);
    EXPECT_TRUE(test::same_pictures(*frame->images)) << index;
  }
}

}  // namespace
}  // namespace facet::take
