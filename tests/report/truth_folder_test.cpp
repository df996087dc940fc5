// Folders of truth from anywhere, and what is wrong with some.

#include "report/truth_folder.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <numbers>

#include "facet/error.hpp"
#include "support/paths.hpp"

namespace facet::report {
namespace {

using Eigen::Vector3f;
using testing::HasSubstr;

/// An egg of a head's size, 600 mm away; counter-clockwise seen from outside.
simulation::TruthMesh egg() {
  constexpr int kRings = 16;
  constexpr int kSides = 24;
  simulation::TruthMesh mesh;
  mesh.vertices_mm.resize(3, kRings * kSides);
  std::vector<std::int32_t> corners;
  for (int ring = 0; ring < kRings; ++ring) {
    const float polar = std::numbers::pi_v<float> * (static_cast<float>(ring) + 0.5F) / kRings;
    for (int side = 0; side < kSides; ++side) {
      const float around = 2 * std::numbers::pi_v<float> * static_cast<float>(side) / kSides;
      const int v = ring * kSides + side;
      mesh.vertices_mm.col(v) << 75 * std::sin(polar) * std::cos(around), -110 * std::cos(polar),
          600 + 95 * std::sin(polar) * std::sin(around);
      const int next = ring * kSides + (side + 1) % kSides;
      if (ring + 1 < kRings) {
        for (const int corner : {v, v + kSides, next, next, v + kSides, next + kSides}) {
          corners.push_back(corner);
        }
      }
    }
  }
  mesh.triangles =
      Eigen::Map<const mesh::Triangles>(corners.data(), 3, static_cast<Eigen::Index>(corners.size() / 3));
  mesh::vertex_normals(mesh.vertices_mm, mesh.triangles, mesh.normals);
  mesh.albedo = mesh::Vertices::Constant(3, mesh.vertices_mm.cols(), 0.5F);
  return mesh;
}

/// How far the normals point away from the axis of the egg, on average.
float outwardness(const simulation::TruthMesh& mesh) {
  const Vector3f centre = mesh.vertices_mm.rowwise().mean();
  return (mesh.vertices_mm.colwise() - centre)
      .colwise()
      .normalized()
      .cwiseProduct(mesh.normals)
      .colwise()
      .sum()
      .mean();
}

class TruthFolderTest : public ::testing::Test {
 protected:
  void SetUp() override { std::filesystem::create_directory(folder_.path() / "truth"); }
  void put(const simulation::TruthMesh& mesh, const std::string& name) const {
    simulation::write_truth_ply(mesh, folder_.path() / "truth" / name);
  }
  void put_notes(const std::string& text) const { std::ofstream(folder_.path() / "camera.json") << text; }
  TruthFolder open(float mm_per_unit = 1) const { return TruthFolder(folder_.path(), mm_per_unit); }
  /// What opening, or reading frame 0, is refused with.
  std::string refusal(float mm_per_unit = 1) const {
    try {
      open(mm_per_unit).mesh(0);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      return error.what();
    }
    return "read";
  }

  test::TemporaryFolder folder_;
};

TEST_F(TruthFolderTest, TakesEveryNthFrameAndNoNotes) {
  put(egg(), "frame_000000.ply");
  put(egg(), "frame_000010.ply");
  put(egg(), "frame_20.ply");
  std::ofstream(folder_.path() / "truth" / "frame_x.ply") << "not one of them";
  const TruthFolder folder = open();
  EXPECT_EQ(folder.frames(), (std::vector<std::uint64_t>{0, 10, 20}));
  EXPECT_TRUE(folder.has(10));
  EXPECT_FALSE(folder.has(1));
  EXPECT_FALSE(folder.focal_px().has_value());
  EXPECT_EQ(folder.notes(0), nullptr);
  EXPECT_FALSE(folder.neutral().has_value());
  EXPECT_TRUE(folder.mesh(10).vertices_mm == egg().vertices_mm);
  EXPECT_TRUE(folder.mesh(10).triangles == egg().triangles);
  put(egg(), "neutral.ply");
  EXPECT_TRUE(open().neutral().has_value());
}

TEST_F(TruthFolderTest, ReadsOnlyWhatTheNotesHave) {
  put(egg(), "frame_000000.ply");
  put_notes(R"({"fx": 900.5, "lens": "none", "frames": [
      {"index": 3, "camera_from_head": [[1,0,0,1],[0,-1,0,2],[0,0,-1,3],[0,0,0,1]]},
      {"index": 4, "expression": {"jawOpen": 0.5, "of no model": 1}}, {"index": 5}]})");
  const TruthFolder folder = open(10);
  EXPECT_EQ(folder.focal_px(), 900.5F);
  ASSERT_NE(folder.notes(3), nullptr);
  ASSERT_TRUE(folder.notes(3)->camera_from_head.has_value());
  EXPECT_EQ(folder.notes(3)->camera_from_head->translation(), Vector3f(10, 20, 30));
  EXPECT_EQ(folder.notes(3)->camera_from_head->linear()(1, 1), -1);
  EXPECT_TRUE(folder.notes(3)->expression.empty());
  EXPECT_FALSE(folder.notes(4)->camera_from_head.has_value());
  EXPECT_EQ(folder.notes(4)->expression.at("jawOpen"), 0.5F);
  EXPECT_TRUE(folder.notes(5)->expression.empty());
}

TEST_F(TruthFolderTest, NamesTheKeyThatIsWrong) {
  put(egg(), "frame_000000.ply");
  const std::string pose = R"({"frames": [{"index": 0, "camera_from_head": )";
  for (const auto& [notes, words] : std::vector<std::pair<std::string, std::string>>{
           {"{", "camera.json"},
           {"[1]", "not an object"},
           {R"({"fx": "long"})", "fx: not a focal length"},
           {R"({"fx": -1})", "fx: not a focal length"},
           {R"({"frames": {}})", "frames: not a list"},
           {R"({"frames": [1]})", "frames[0]: not an object"},
           {R"({"frames": [{"index": 0}, {}]})", "frames[1].index: missing"},
           {R"({"frames": [{"index": -1}]})", "frames[0].index"},
           {R"({"frames": [{"index": 2}, {"index": 2}]})", "frames[1].index: 2 stands there twice"},
           {R"({"frames": [{"index": 0, "expression": [1]}]})", "frames[0].expression: not an object"},
           {R"({"frames": [{"index": 0, "expression": {"jawOpen": "wide"}}]})",
            "frames[0].expression.jawOpen: not a number"},
           {pose + "[1,2,3]}]}", "frames[0].camera_from_head: not four rows"},
           {pose + "[[1,0,0,0],[0,1,0,0],[0,0,1,9],[0,0,0,\"1\"]]}]}", "not four rows of four numbers"},
           {pose + "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,600,1]]}]}", "row by row"},
           {pose + "[[2,0,0,0],[0,2,0,0],[0,0,2,600],[0,0,0,1]]}]}", "without scale or mirror"},
           {pose + "[[-1,0,0,0],[0,1,0,0],[0,0,1,600],[0,0,0,1]]}]}", "without scale or mirror"},
           {pose + "[[1,0,0,0],[0,1,0,0],[0,0,1,-600],[0,0,0,1]]}]}", "behind the camera"}}) {
    put_notes(notes);
    EXPECT_THAT(refusal(), AllOf(HasSubstr("camera.json"), HasSubstr(words))) << notes;
  }
}

TEST_F(TruthFolderTest, SaysWhatAFolderLacks) {
  EXPECT_THAT(refusal(), HasSubstr("no meshes frame_000000.ply"));
  put(egg(), "frame_000000.ply");
  put(egg(), "frame_0.ply");
  EXPECT_THAT(refusal(), HasSubstr("is of frame 0 too"));
  std::filesystem::remove_all(folder_.path() / "truth");
  EXPECT_THAT(refusal(), HasSubstr("--truth is the folder above it"));
}

TEST_F(TruthFolderTest, AnotherUnitIsNamedAndHelps) {
  for (const auto& [factor, unit, mm] :
       std::vector<std::tuple<float, std::string, float>>{{0.001F, "m", 1000}, {0.1F, "cm", 10}}) {
    simulation::TruthMesh mesh = egg();
    mesh.vertices_mm *= factor;
    put(mesh, "frame_000000.ply");
    EXPECT_THAT(refusal(), AllOf(HasSubstr(fmt::format("times {:g}", mm)), HasSubstr("--unit " + unit)));
    EXPECT_LT((open(mm).mesh(0).vertices_mm - egg().vertices_mm).cwiseAbs().maxCoeff(), 1e-3F);
  }
  simulation::TruthMesh mesh = egg();
  put(mesh, "frame_000000.ply");
  EXPECT_THAT(refusal(1000), HasSubstr("--unit mm"));
  mesh.vertices_mm *= 1e6F;
  put(mesh, "frame_000000.ply");
  EXPECT_THAT(refusal(), HasSubstr("neither in mm nor in cm nor in m"));
}

TEST_F(TruthFolderTest, RefusesPointsAloneAndHeadsBehindTheCamera) {
  std::ofstream(folder_.path() / "truth" / "frame_000000.ply")
      << "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
         "end_header\n0 0 600\n";
  EXPECT_THAT(refusal(), AllOf(HasSubstr("frame_000000.ply"), HasSubstr("no faces")));
  simulation::TruthMesh mesh = egg();
  mesh.vertices_mm.row(2).array() -= 1200;
  put(mesh, "frame_000000.ply");
  EXPECT_THAT(refusal(), HasSubstr("behind the camera"));
}

TEST_F(TruthFolderTest, OutsideIsOutsideHoweverItIsWound) {
  ASSERT_GT(outwardness(egg()), 0.9F);
  simulation::TruthMesh turned = egg();
  turned.triangles.row(1).swap(turned.triangles.row(2));
  put(turned, "frame_000000.ply");  // normals as they were
  EXPECT_TRUE(open().mesh(0).triangles == egg().triangles);
  EXPECT_GT(outwardness(open().mesh(0)), 0.9F);
  turned.normals = -turned.normals;
  put(turned, "frame_000000.ply");  // all of it inside out
  EXPECT_GT(outwardness(open().mesh(0)), 0.9F);
  EXPECT_TRUE(open().mesh(0).triangles == egg().triangles);
}

}  // namespace
}  // namespace facet::report
