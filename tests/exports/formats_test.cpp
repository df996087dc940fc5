// The table of formats, what the documentation says of it, and the sample of docs/adding-an-exporter.md.

#include "exports/formats.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <set>
#include <sstream>
#include <string>

#include "facet/error.hpp"
#include "sample_format.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"

namespace facet::exports {
namespace {

using testing::HasSubstr;

std::string read_file(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

TEST(Formats, EachIsNamedOnceAndDocumented) {
  const std::string documented = read_file(std::filesystem::path(FACET_SOURCE_DIR) / "docs" / "exports.md");
  std::set<std::string> names;
  for (const ExportFormat& format : export_formats()) {
    EXPECT_TRUE(names.insert(format.name).second) << format.name << " is there twice";
    EXPECT_THAT(documented, HasSubstr(std::string("`") + format.name + "`"));
    EXPECT_NE(std::string(format.help), "") << format.name;
    EXPECT_EQ(
        std::string(format.extension).empty(),
        std::holds_alternative<Maps>(format.writes) || std::holds_alternative<CameraPictures>(format.writes))
        << format.name;
  }
  EXPECT_GT(names.size(), 10U);
}

TEST(Formats, OneMeshIsWrittenByItsFilesExtension) {
  EXPECT_NE(mesh_writer_for("a/b.ply"), nullptr);
  EXPECT_NE(mesh_writer_for("b.obj"), mesh_writer_for("b.glb"));
  for (const char* none : {"b.usda", "b.pc2", "b", "ply", "b.PLY", "b."}) {
    EXPECT_EQ(mesh_writer_for(none), nullptr) << none;
  }
}

class SampleFormat : public testing::Test {
 protected:
  SequenceFrame frame_at(std::uint64_t sequence) const {
    const auto frame = test::patch_frame(sequence, subject, test::patch_albedo(*subject));
    SequenceFrame out;
    out.sequence = sequence;
    build_export_mesh(frame, MeshLevel::Coarse, MeshSpace::Head, out.mesh);
    return out;
  }

  test::TemporaryFolder folder;
  std::shared_ptr<const mesh::Subject> subject = test::patch_subject();
  SequenceOptions options = [this] {
    SequenceOptions made;
    made.file = folder.path() / "a.txt";
    made.timeline.rate_hz = 25;
    made.timeline.sequences = {3, 5};
    return made;
  }();
};

TEST_F(SampleFormat, HoldsTheFramesAtTheirTimes) {
  ASSERT_TRUE(sample::kPoints.is_one_file());
  const auto writer = std::get<Animation>(sample::kPoints.writes).open(options, frame_at(3));
  writer->add(frame_at(3));
  writer->add(frame_at(5));
  EXPECT_FALSE(std::filesystem::exists(options.file));
  writer->commit();
  std::istringstream text(read_file(options.file));
  for (const auto& [sequence, time_s] : {std::pair(3U, 0.0), std::pair(5U, 0.08)}) {
    std::string word;
    std::uint64_t number = 0;
    double time = 0;
    text >> word >> number >> time;
    EXPECT_EQ(number, sequence);
    EXPECT_DOUBLE_EQ(time, time_s);
    const mesh::Vertices wanted_mm = frame_at(sequence).mesh.vertices_mm;
    for (Eigen::Index vertex = 0; vertex < wanted_mm.cols(); ++vertex) {
      Eigen::Vector3f point_mm;
      text >> point_mm.x() >> point_mm.y() >> point_mm.z();
      EXPECT_EQ(point_mm, Eigen::Vector3f(wanted_mm.col(vertex)));
    }
  }
  std::string rest;
  EXPECT_FALSE(text >> rest);
}

TEST_F(SampleFormat, AnotherMeshIsRefusedAndLeavesNothing) {
  {
    const auto writer = sample::open_points(options, frame_at(3));
    writer->add(frame_at(3));
    SequenceFrame other = frame_at(5);
    other.mesh.triangles.conservativeResize(3, other.mesh.triangles.cols() - 1);
    try {
      writer->add(other);
      FAIL() << "another mesh was taken";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
      EXPECT_THAT(error.what(), HasSubstr("5"));
    }
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

}  // namespace
}  // namespace facet::exports
