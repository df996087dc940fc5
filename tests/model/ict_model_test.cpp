// ICT-FaceKit's files as they come, a subset of them: three identities, six expression files.
#include "model/ict_model.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <string>

#include "facet/error.hpp"
#include "landmark/landmarker.hpp"
#include "mesh/mesh.hpp"
#include "model/landmark_map.hpp"
#include "model/portrait.hpp"
#include "support/paths.hpp"

namespace facet::model {
namespace {

using face::FaceModel;
using face::Region;
using testing::ElementsAre;
using testing::HasSubstr;

TEST(Obj, ReadsQuadsAndCountsOtherFaces) {
  const ObjMesh mesh = parse_obj(
      "v 0 0 0\nv 1 0 0\nv 1 2 0\nv 0 1 0.5\nvt 0 0\nf 1/1 2/1 3/1 4/1\nf 1 2 3\nf -4//1 -3 -2 -1\r\n",
      "f.obj");
  ASSERT_EQ(mesh.vertices.cols(), 4);
  EXPECT_EQ(mesh.vertices.col(2), Eigen::Vector3d(1, 2, 0));
  ASSERT_EQ(mesh.quads.cols(), 2);
  EXPECT_EQ(mesh.quads.col(1), Eigen::Vector4i(0, 1, 2, 3));
  EXPECT_EQ(mesh.quads.col(0), Eigen::Vector4i(0, 1, 2, 3));
  EXPECT_EQ(mesh.other_faces, 1U);
}

TEST(Obj, WhatIsNoMeshIsRefusedByName) {
  for (const char* text :
       {"", "hello", "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3 9\n", "v nan 0 0\n", "v 1 2\n",
        "v 0 0 0\nf 1 2 a/1 4\n", "v 0 0 0\nf 0 1 1 1\n", "v 0 0 0\nf 1 1 1 99999999999999999999\n"}) {
    try {
      parse_obj(text, "f.obj");
      ADD_FAILURE() << text;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      EXPECT_THAT(error.what(), HasSubstr("f.obj"));
    }
  }
}

class IctModel : public testing::Test {
 protected:
  static std::filesystem::path folder() {
    return std::filesystem::path(FACET_SOURCE_DIR) / "../shared/data/ict-facekit-subset";
  }
  void SetUp() override {
    if (!std::filesystem::exists(folder())) {
      GTEST_SKIP() << "needs the test data's ict-facekit-subset";
    }
  }
  static FaceModel import(IctReport& report, int modes = 40) {
    return import_ict(
        {folder(), modes}, [](int, int) {}, report);
  }
};

TEST_F(IctModel, HoldsTheFilesShapesInMillimetres) {
  IctReport report;
  const FaceModel model = import(report);
  EXPECT_EQ(model.check(), "");
  EXPECT_EQ(report.identity_modes, 3);
  EXPECT_THAT(report.expressions,
              ElementsAre("eyeBlinkLeft", "jawOpen", "mouthPucker", "mouthSmileLeft", "mouthSmileRight"));
  EXPECT_EQ(report.missing.size(), 46U) << "browInnerUp needs both its halves";
  const auto mean_mm = model.core_row(0, 0);
  const Eigen::Vector3f size_mm = mean_mm.rowwise().maxCoeff() - mean_mm.rowwise().minCoeff();
  EXPECT_NEAR(size_mm.x(), 184, 2) << "a face of life size";
  // The jaw drops, the lid of the subject's left eye (x > 0) closes, the smile is on its side.
  const auto largest_at = [&](const char* name) {
    Eigen::Index at = 0;
    model.core_row(0, model.expression_index(name) + 1).colwise().norm().maxCoeff(&at);
    return Eigen::Vector3f(mean_mm.col(at));
  };
  EXPECT_LT(largest_at("jawOpen").y(), -60);
  EXPECT_NEAR(largest_at("eyeBlinkLeft").x(), 32, 10);
  EXPECT_NEAR(largest_at("eyeBlinkLeft").y(), 0, 12);
  EXPECT_GT(largest_at("mouthSmileLeft").x(), 10);
  EXPECT_LT(largest_at("mouthSmileRight").x(), -10);
  EXPECT_EQ(model.core_row(2, 1).cwiseAbs().maxCoeff(), 0) << "identity does not change expressions";
  EXPECT_GT(model.core_row(2, 0).colwise().norm().maxCoeff(), 2);
}

TEST_F(IctModel, RegionsLieWhereTheyShould) {
  IctReport report;
  const FaceModel model = import(report, 0);
  EXPECT_EQ(model.identity_count(), 0);
  const auto mean_mm = model.core_row(0, 0);
  const auto expect_within = [&](Region region, std::size_t least, const Eigen::Vector3f& low,
                                 const Eigen::Vector3f& high) {
    std::size_t count = 0;
    for (std::size_t v = 0; v < model.regions.size(); ++v) {
      if (face::has_region(model.regions[v], region)) {
        ++count;
        const Eigen::Vector3f p = mean_mm.col(static_cast<Eigen::Index>(v));
        EXPECT_TRUE((p.array() >= low.array()).all() && (p.array() <= high.array()).all())
            << static_cast<int>(region) << ": " << p.transpose();
      }
    }
    EXPECT_GE(count, least) << static_cast<int>(region);
  };
  expect_within(Region::Refinable, 4000, {-90, -145, -60}, {90, 90, 60});
  expect_within(Region::Lips, 100, {-40, -90, -20}, {40, -45, 45});
  expect_within(Region::Brow, 60, {-60, 5, -40}, {60, 30, 40});
  expect_within(Region::Eye, 1500, {-50, -20, -30}, {50, 20, 20});
  expect_within(Region::MouthInterior, 1500, {-40, -100, -90}, {40, -35, 40});
  EXPECT_GE(model.control.texture_coordinates.minCoeff(), 0);
  EXPECT_LE(model.control.texture_coordinates.maxCoeff(), 1);
}

TEST_F(IctModel, TheNetFindsItsLandmarks) {
  const std::filesystem::path assets = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
  if (!std::filesystem::exists(assets) || !std::filesystem::exists(test::default_model())) {
    GTEST_SKIP() << "needs the landmark nets and the default model in " << test::assets();
  }
  IctReport report;
  FaceModel model = import(report);
  landmark::Landmarker landmarker(assets);
  const auto quiet = [](int, int) {};
  model.landmarks = find_landmarks(model, landmarker, quiet);
  for (const LandmarkAgreement& agreement : check_landmarks(model, landmarker, quiet)) {
    ASSERT_TRUE(agreement.found) << agreement.pose;
    if (agreement.pose == "neutral") {
      for (const auto group :
           {landmark::LandmarkGroup::Skin, landmark::LandmarkGroup::Eye, landmark::LandmarkGroup::Nose}) {
        EXPECT_LT(agreement.mean_mm.at(static_cast<std::size_t>(group)), 1.5F) << static_cast<int>(group);
      }
    }
  }
  const mesh::Vertices plain = model.mean_albedo;
  borrow_albedo(FaceModel::load(test::default_model()), model);
  EXPECT_GT((model.mean_albedo - plain).cwiseAbs().maxCoeff(), 0.05F);
  const test::TemporaryFolder temporary;
  model.save(temporary.path() / "ict.facemodel");
  const FaceModel loaded = FaceModel::load(temporary.path() / "ict.facemodel");
  EXPECT_EQ(loaded.landmarks.size(), model.landmarks.size());
  EXPECT_LT((loaded.core_row(1, 0) - model.core_row(1, 0)).cwiseAbs().maxCoeff(), 0.002F);
}

TEST_F(IctModel, WhatIsMissingOrAnotherMeshIsNamed) {
  const test::TemporaryFolder temporary;
  IctReport report;
  const auto message = [&] {
    try {
      import_ict(
          {temporary.path(), 3}, [](int, int) {}, report);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      return std::string(error.what());
    }
    return std::string("nothing thrown");
  };
  EXPECT_THAT(message(), HasSubstr("generic_neutral_mesh.obj: cannot read this mesh"));
  const std::filesystem::path neutral = temporary.path() / "generic_neutral_mesh.obj";
  std::ofstream(neutral) << "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
  EXPECT_THAT(message(), HasSubstr("4 vertices; ICT-FaceKit's meshes have 26719"));
  std::filesystem::remove(neutral);
  std::filesystem::copy_file(folder() / "FaceXModel" / "generic_neutral_mesh.obj", neutral);
  EXPECT_THAT(message(), HasSubstr("no expression in it"));
}

}  // namespace
}  // namespace facet::model
