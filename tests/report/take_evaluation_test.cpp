// Takes against truths whose figures are known: a face against itself, and what is refused or left out.

#include "report/take_evaluation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "face/subject_builder.hpp"
#include "facet/error.hpp"
#include "report/take_pictures.hpp"
#include "simulation/truth_mesh.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/recorder.hpp"

namespace facet::report {
namespace {

using testing::HasSubstr;

class TakeEvaluationTest : public ::testing::Test {
 protected:
  void SetUp() override { std::filesystem::create_directories(folder_.path() / "truth"); }

  void record(const std::vector<mesh::MeshFrame>& frames) const {
    take::TakeRecorder recorder({.file = take_file(),
                                 .source = "elsewhere.mkv",
                                 .software = "test",
                                 .when_full = take::WhenFull::Wait,
                                 .disk_reserve_bytes = 0});
    recorder.start();
    for (const mesh::MeshFrame& frame : frames) {
      recorder.record(std::make_shared<mesh::MeshFrame>(frame));
    }
    recorder.stop();
  }
  std::filesystem::path take_file() const { return folder_.path() / "some.take"; }

  /// The frame's own finest mesh as its truth.
  void put_truth(const mesh::MeshFrame& frame, const std::string& name) const {
    FrameGeometry geometry = geometry_of(frame);
    simulation::TruthMesh truth;
    truth.vertices_mm = std::move(geometry.refined_mm);
    truth.normals = std::move(geometry.refined_normals);
    truth.albedo = mesh::Vertices::Constant(3, truth.vertices_mm.cols(), 0.5F);
    truth.triangles = frame.subject->hierarchy->finest().triangles;
    simulation::write_truth_ply(truth, folder_.path() / "truth" / name);
  }

  TakeEvaluation evaluate(const EvaluationOptions& options = {}) const {
    take::TakeReader take(take_file());
    return evaluate_take(take, folder_.path(), options, [](std::uint64_t, std::uint64_t) {});
  }
  std::string refusal(const EvaluationOptions& options = {}) const {
    try {
      evaluate(options);
    } catch (const Error& error) {
      return error.what();
    }
    return "measured";
  }

  test::TemporaryFolder folder_;
};

std::vector<mesh::MeshFrame> patches(std::uint64_t first, std::uint64_t end) {
  const auto subject = test::patch_subject();
  std::vector<mesh::MeshFrame> frames;
  for (std::uint64_t sequence = first; sequence < end; ++sequence) {
    frames.push_back(test::patch_frame(sequence, subject, nullptr));
  }
  return frames;
}

TEST_F(TakeEvaluationTest, MeasuresWhatIsThereAndSaysWhatIsNot) {
  const auto frames = patches(100, 104);
  record(frames);
  put_truth(frames[1], "frame_000101.ply");
  put_truth(frames[3], "frame_000103.ply");
  const TakeEvaluation evaluation = evaluate();
  ASSERT_EQ(evaluation.frames.size(), 2U);
  EXPECT_EQ(evaluation.frames[1].index, 3);
  EXPECT_LT(evaluation.by_frame.refined.whole.mean_mm, 0.05);
  EXPECT_GT(evaluation.by_frame.coarse.whole.mean_mm, 0.2);
  EXPECT_LT(evaluation.by_sequence.refined.whole.mean_mm, 0.05);
  EXPECT_NEAR(evaluation.by_sequence.scale, 1, 0.002);
  EXPECT_LT(evaluation.by_frame.refined.skin.mean_mm, 0.1);
  EXPECT_FALSE(evaluation.has_parts);
  EXPECT_FALSE(evaluation.neutral.has_value());
  EXPECT_TRUE(evaluation.weights.empty());
  for (const char* what : {"regions", "neutral", "expressions", "pose"}) {
    EXPECT_TRUE(evaluation.left_out.contains(what)) << what;
  }
  EXPECT_FALSE(evaluation.left_out.contains("skin_point"));
}

TEST_F(TakeEvaluationTest, RefusesTruthsOfOtherFramesAndOtherModels) {
  const auto frames = patches(100, 103);
  record(frames);
  put_truth(frames[0], "frame_000001.ply");
  EXPECT_THAT(refusal(), AllOf(HasSubstr("no frame has both"), HasSubstr("frames 1 to 1")));
  std::filesystem::remove(folder_.path() / "truth" / "frame_000001.ply");
  put_truth(frames[2], "frame_000102.ply");
  put_truth(frames[2], "frame_000103.ply");
  EXPECT_THAT(refusal(), AllOf(HasSubstr("2 frames, 102 to 103"), HasSubstr("--frames 102:103")));
  EXPECT_EQ(evaluate({.frames = {2}}).frames.size(), 1U);
  EXPECT_EQ(refusal({.frames = {0}}).find("measured"), std::string::npos);
  if (std::filesystem::exists(test::default_model())) {
    EXPECT_THAT(refusal({.frames = {2}, .model = test::default_model()}), HasSubstr("--model"));
  }
  EXPECT_NE(refusal({.frames = {2}, .model = "no.facemodel"}), "measured");
}

TEST_F(TakeEvaluationTest, TruthOfChangingTrianglesHasNoSkinPoints) {
  const auto frames = patches(0, 3);
  record(frames);
  put_truth(frames[0], "frame_0.ply");
  put_truth(frames[1], "frame_1.ply");
  put_truth(frames[2], "frame_2.ply");
  const std::filesystem::path file = folder_.path() / "truth" / "frame_1.ply";
  simulation::TruthMesh turned = simulation::read_truth_ply(file);
  turned.triangles = turned.triangles.rowwise().reverse().eval();
  simulation::write_truth_ply(turned, file);
  const TakeEvaluation evaluation = evaluate();
  EXPECT_THAT(evaluation.left_out.at("skin_point"), HasSubstr("triangles change"));
  EXPECT_TRUE(std::isnan(evaluation.by_frame.refined.skin.mean_mm));
  EXPECT_LT(evaluation.by_frame.refined.whole.mean_mm, 0.05);
}

/// Frames of the default model's mean face that opens its mouth and turns.
std::vector<mesh::MeshFrame> talking_face(const face::FaceModel& model) {
  std::vector<mesh::MeshFrame> frames;
  const std::vector<float> identity(static_cast<std::size_t>(model.identity_count()), 0.5F);
  const face::ExpressionBasis basis = model.contract_identity(identity);
  for (std::uint64_t k = 0; k < 11; ++k) {
    mesh::MeshFrame frame;
    frame.sequence = k;
    frame.media_time_ns = static_cast<std::int64_t>(k) * 100'000'000;
    frame.state = mesh::TrackingState::Tracking;
    frame.camera = {900, 900, 319.5F, 239.5F, 640, 480};
    frame.camera_from_head = Eigen::AngleAxisf(0.02F * static_cast<float>(k), Eigen::Vector3f::UnitY()) *
                             Eigen::AngleAxisf(3.14159265F, Eigen::Vector3f::UnitX());
    frame.camera_from_head.pretranslate(Eigen::Vector3f(0, 0, 600));
    frame.expression.assign(static_cast<std::size_t>(model.expression_count()), 0.0F);
    frame.expression[static_cast<std::size_t>(model.expression_index("jawOpen"))] =
        0.05F * static_cast<float>(k);
    basis.evaluate(frame.expression, frame.control_vertices_mm);
    frame.subject = k > 0
                        ? frames.front().subject
                        : face::build_subject(model, {.min_edge_px = 8, .max_levels = 2}, frame, identity, 1);
    frame.displacements_mm.assign(static_cast<std::size_t>(frame.subject->hierarchy->finest().vertex_count),
                                  0);
    frames.push_back(std::move(frame));
  }
  return frames;
}

TEST_F(TakeEvaluationTest, AFaceAgainstItselfIsRightInEveryPart) {
  if (!std::filesystem::exists(test::default_model())) {
    GTEST_SKIP() << "no default face model";
  }
  const face::FaceModel model = face::FaceModel::load(test::default_model());
  const auto frames = talking_face(model);
  record(frames);
  nlohmann::json notes = {{"fx", 1000}, {"frames", nlohmann::json::array()}};
  for (const mesh::MeshFrame& frame : frames) {
    put_truth(frame, "frame_" + std::to_string(frame.sequence) + ".ply");
    nlohmann::json pose = nlohmann::json::array();
    for (Eigen::Index row = 0; row < 4; ++row) {
      pose.push_back(nlohmann::json::array());
      for (Eigen::Index column = 0; column < 4; ++column) {
        pose.back().push_back(frame.camera_from_head.matrix()(row, column));
      }
    }
    notes["frames"].push_back(
        {{"index", frame.sequence},
         {"camera_from_head", pose},
         {"expression", {{"jawOpen", 0.1 * static_cast<double>(frame.sequence)}, {"cheekPuff", 0}}}});
  }
  std::ofstream(folder_.path() / "camera.json") << notes;
  mesh::MeshFrame at_rest = frames.front();  // with jawOpen 0, in its head frame
  at_rest.camera_from_head = Eigen::Isometry3f::Identity();
  put_truth(at_rest, "neutral.ply");

  const TakeEvaluation evaluation = evaluate({.model = test::default_model()});
  EXPECT_TRUE(evaluation.left_out.empty());
  ASSERT_TRUE(evaluation.neutral.has_value());
  EXPECT_LT(evaluation.neutral->face.whole.mean_mm, 0.03);
  EXPECT_NEAR(evaluation.neutral->scale, 1, 1e-3);
  ASSERT_TRUE(evaluation.has_parts);
  for (std::size_t part = 0; part < kFaceParts; ++part) {
    EXPECT_LT(evaluation.by_frame.refined.parts[part].mean_mm, 0.03) << face::kFacePartNames[part];
    EXPECT_LT(evaluation.by_sequence.coarse.parts[part].mean_mm, 0.03) << face::kFacePartNames[part];
    EXPECT_LT(evaluation.neutral->face.parts[part].mean_mm, 0.03) << face::kFacePartNames[part];
    EXPECT_LT(evaluation.by_frame.refined.part_skin_mm[part], 0.05) << face::kFacePartNames[part];
    EXPECT_GT(evaluation.part_bands[part][0].point_count(), 100U) << face::kFacePartNames[part];
  }
  EXPECT_LT(evaluation.by_frame.refined.skin.mean_mm, 0.05);
  EXPECT_LT(std::abs(evaluation.by_frame.refined.skin.drift_mm()), 0.02);
  EXPECT_LT(evaluation.pose.rotation_deg, 0.01);
  EXPECT_LT(evaluation.pose.translation_mm, 0.01);
  EXPECT_NEAR(evaluation.pose.focal_percent, -10, 1e-3);
  ASSERT_EQ(evaluation.weights.size(), 2U);
  EXPECT_EQ(evaluation.weights[1].name, "jawOpen");
  EXPECT_NEAR(evaluation.weights[1].correlation, 1, 1e-4);
  EXPECT_NEAR(evaluation.weights[1].slope, 0.5, 1e-4);
}

}  // namespace
}  // namespace facet::report
