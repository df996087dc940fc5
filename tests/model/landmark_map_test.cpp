#include "model/landmark_map.hpp"

#include <gtest/gtest.h>

#include "facet/error.hpp"
#include "model/portrait.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::model {
namespace {

std::filesystem::path net_file() {
  return test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
}

Eigen::Vector3f anchor_mm(const face::FaceModel& model, int landmark) {
  return face::FaceModel::anchor_point(model.landmarks[static_cast<std::size_t>(landmark)],
                                       model.core_row(0, 0));
}

/// The built model with its landmarks found anew; skips where model or net is missing.
class LandmarkMap : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(net_file()) || !std::filesystem::exists(test::default_model())) {
      GTEST_SKIP() << "needs the landmark net (packaging/fetch-assets) and " << test::default_model()
                   << " (facet model build)";
    }
    model_ = face::FaceModel::load(test::default_model());
    landmarker_ = std::make_unique<landmark::Landmarker>(net_file());
    model_.landmarks = find_landmarks(model_, *landmarker_, [](int, int) {});
  }
  face::FaceModel model_;
  std::unique_ptr<landmark::Landmarker> landmarker_;
};

TEST_F(LandmarkMap, PutsEveryLandmarkOnTheSkinWhereItBelongs) {
  EXPECT_EQ(model_.check(), "");
  for (std::size_t i = 0; i < model_.landmarks.size(); ++i) {
    const face::LandmarkAnchor& anchor = model_.landmarks[i];
    EXPECT_GT(anchor.weights[0] + anchor.weights[1] + anchor.weights[2], 0.99F)
        << "landmark " << i << " has no place";
    for (const std::int32_t v : anchor.vertices) {
      EXPECT_FALSE(face::has_region(model_.regions[static_cast<std::size_t>(v)], face::Region::Eye)) << i;
      EXPECT_FALSE(face::has_region(model_.regions[static_cast<std::size_t>(v)], face::Region::MouthInterior))
          << i;
    }
  }
  // x to the subject's left: his right eye is on the negative side, outer corner 33, inner corner 133.
  EXPECT_LT(anchor_mm(model_, 33).x(), anchor_mm(model_, 133).x());
  EXPECT_LT(anchor_mm(model_, 133).x(), 0);
  EXPECT_NEAR(anchor_mm(model_, 33).x(), -anchor_mm(model_, 263).x(), 0.5F);
  // Adults' outer eye corners are 80 to 105 mm apart, mouths 40 to 62 mm wide.
  EXPECT_GT(anchor_mm(model_, 263).x() - anchor_mm(model_, 33).x(), 80);
  EXPECT_LT(anchor_mm(model_, 263).x() - anchor_mm(model_, 33).x(), 105);
  EXPECT_GT(anchor_mm(model_, 291).x() - anchor_mm(model_, 61).x(), 40);
  EXPECT_LT(anchor_mm(model_, 291).x() - anchor_mm(model_, 61).x(), 62);
  // Brow above lid above nose tip above upper lip above lower lip above chin.
  EXPECT_GT(anchor_mm(model_, 105).y(), anchor_mm(model_, 159).y());
  EXPECT_GT(anchor_mm(model_, 159).y(), anchor_mm(model_, 145).y());
  EXPECT_GT(anchor_mm(model_, 145).y(), anchor_mm(model_, 1).y());
  EXPECT_GT(anchor_mm(model_, 1).y(), anchor_mm(model_, 0).y());
  EXPECT_GT(anchor_mm(model_, 0).y(), anchor_mm(model_, 17).y());
  EXPECT_GT(anchor_mm(model_, 17).y(), anchor_mm(model_, 152).y());
  // The nose tip is the foremost of them.
  for (const int other : {0, 10, 33, 152, 168, 263}) {
    EXPECT_GT(anchor_mm(model_, 1).z(), anchor_mm(model_, other).z()) << other;
  }
}

TEST_F(LandmarkMap, LipsPartWhenTheJawOpens) {
  const int jaw = model_.expression_index("jawOpen");
  ASSERT_GE(jaw, 0);
  std::vector<float> open(static_cast<std::size_t>(jaw) + 1, 0.0F);
  open.back() = 1;
  mesh::Vertices vertices_mm;
  model_.evaluate({}, open, vertices_mm);
  const auto gap_mm = [&](const mesh::Vertices& vertices) {
    return face::FaceModel::anchor_point(model_.landmarks[13], vertices).y() -
           face::FaceModel::anchor_point(model_.landmarks[14], vertices).y();
  };
  EXPECT_LT(gap_mm(model_.core_row(0, 0)), 4);
  EXPECT_GT(gap_mm(vertices_mm), 20);
}

TEST_F(LandmarkMap, AgreesWithWhatTheNetSees) {
  const auto agreements = check_landmarks(model_, *landmarker_, [](int, int) {});
  ASSERT_FALSE(agreements.empty());
  for (const LandmarkAgreement& agreement : agreements) {
    EXPECT_TRUE(agreement.found) << agreement.pose;
  }
  // The neutral view is one of those that placed the anchors; contours, which slide with the view, are
  // looser.
  const auto group = [&](landmark::LandmarkGroup g) {
    return agreements[0].mean_mm[static_cast<std::size_t>(g)];
  };
  EXPECT_EQ(agreements[0].pose, "neutral");
  EXPECT_LT(group(landmark::LandmarkGroup::Eye), 1.2F);
  EXPECT_LT(group(landmark::LandmarkGroup::Lips), 1.5F);
  EXPECT_LT(group(landmark::LandmarkGroup::Nose), 1.2F);
  EXPECT_LT(group(landmark::LandmarkGroup::Skin), 1.5F);
  EXPECT_LT(group(landmark::LandmarkGroup::Contour), 3.5F);
}

TEST(LandmarkMapOfNoFace, IsAnErrorThatNamesThePicture) {
  if (!std::filesystem::exists(net_file())) {
    GTEST_SKIP() << "needs the landmark net (packaging/fetch-assets)";
  }
  face::FaceModel flat = test::synthetic_model(13);
  flat.core_row(0, 0) *= 0.05F;  // a speck in the picture
  landmark::Landmarker landmarker(net_file());
  try {
    find_landmarks(flat, landmarker, [](int, int) {});
    FAIL() << "a face was found";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::NoFace);
    EXPECT_NE(std::string(error.what()).find("neutral"), std::string::npos);
  }
}

TEST(PortraitView, PlacesTheHeadBeforeTheCamera) {
  View view;
  view.target_mm = {0, 0, 0};
  const Eigen::Vector3f nose = view.camera_from_head() * Eigen::Vector3f(0, 0, 100);
  EXPECT_NEAR(nose.z(), view.distance_mm - 100, 1e-3F);
  const Eigen::Vector3f left_ear = view.camera_from_head() * Eigen::Vector3f(80, 0, 0);
  EXPECT_GT(left_ear.x(), 0);  // the subject's left is at the picture's right
  const Eigen::Vector3f crown = view.camera_from_head() * Eigen::Vector3f(0, 100, 0);
  EXPECT_LT(crown.y(), 0);
  // From the subject's left his left ear comes nearer.
  view.yaw_rad = 0.5F;
  EXPECT_LT((view.camera_from_head() * Eigen::Vector3f(80, 0, 0)).z(), view.distance_mm);
  view.yaw_rad = 0;
  view.pitch_rad = 0.5F;
  EXPECT_LT((view.camera_from_head() * Eigen::Vector3f(0, 100, 0)).z(), view.distance_mm);
}

}  // namespace
}  // namespace facet::model
