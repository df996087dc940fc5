// A take as format version 1 wrote it must stay readable for ever. FACET_WRITE_GOLDEN=1 in the environment
// records the file of the current version anew; commit it only under a new version's name.

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
  if (std::getenv("FACET_WRITE_GOLDEN") != nullptr) {
    std::filesystem::create_directories(file.parent_path());
    std::filesystem::remove(file);
    ASSERT_EQ(test::record_take(file, 12, subject).frames, 12U);
  }
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

}  // namespace
}  // namespace facet::take
