#include "face/subject_builder.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "support/synthetic_model.hpp"

namespace facet::face {
namespace {

/// A head in front of the camera, looking at it.
Eigen::Isometry3f frontal(float distance_mm) {
  Eigen::Isometry3f pose = Eigen::Isometry3f::Identity();
  pose.linear() = Eigen::Vector3f(1, -1, -1).asDiagonal();
  pose.translation() << 0, 0, distance_mm;
  return pose;
}

class SubjectBuilder : public ::testing::Test {
 protected:
  SubjectBuilder() {
    frame_.camera = {800, 800, 320, 240, 640, 480};
    frame_.camera_from_head = frontal(600);
    model_.evaluate({}, {}, frame_.control_vertices_mm);
  }
  FaceModel model_ = test::synthetic_model(17);
  mesh::MeshFrame frame_;
  std::vector<float> identity_ = std::vector<float>(static_cast<std::size_t>(model_.identity_count()), 0.0F);
};

TEST_F(SubjectBuilder, ProjectsWhatIsInFront) {
  mesh::Vertices points(3, 3);
  points << 0, 10, 0,  //
      0, 0, 0,         //
      0, 0, 700;
  const auto px = project(points, frontal(600), frame_.camera);
  EXPECT_TRUE(px.col(0).isApprox(Eigen::Vector2f(320, 240)));
  EXPECT_NEAR(px(0, 1), 320 + 800.0 * 10 / 600, 1e-3);
  EXPECT_TRUE(std::isnan(px(0, 2))) << "behind the camera";
}

TEST_F(SubjectBuilder, FacesTheCameraOrNot) {
  const auto front = facing_camera(model_.control.quads, frame_.control_vertices_mm, frontal(600));
  EXPECT_GT(std::count(front.begin(), front.end(), 1), 0.8 * static_cast<double>(front.size()));
  Eigen::Isometry3f turned = frontal(600);
  turned.linear() = Eigen::Vector3f(-1, -1, 1).asDiagonal();
  const auto back = facing_camera(model_.control.quads, frame_.control_vertices_mm, turned);
  EXPECT_LT(std::count(back.begin(), back.end(), 1), 0.2 * static_cast<double>(back.size()));
}

TEST_F(SubjectBuilder, RefinesMoreWhereTheFaceIsNearer) {
  mesh::HierarchyOptions options;
  options.min_edge_px = 3;
  const auto far = build_subject(model_, options, frame_, identity_, 1);
  frame_.camera_from_head = frontal(300);
  const auto near = build_subject(model_, options, frame_, identity_, 1);
  EXPECT_GT(near->hierarchy->finest().vertex_count, far->hierarchy->finest().vertex_count);
  EXPECT_EQ(far->expression_names, model_.expression_names);
  EXPECT_EQ(far->regions, model_.regions);
}

TEST_F(SubjectBuilder, TheIdIsThatOfTheContent) {
  const auto first = build_subject(model_, {}, frame_, identity_, 1);
  EXPECT_EQ(first->id, build_subject(model_, {}, frame_, identity_, 1)->id);
  EXPECT_NE(first->id, build_subject(model_, {}, frame_, identity_, 2)->id);
  const auto known = build_subject(model_, {}, frame_, identity_, 1, "ada");
  EXPECT_EQ(known->person, "ada");
  EXPECT_NE(first->id, known->id);
  identity_[0] = 0.5F;
  EXPECT_NE(first->id, build_subject(model_, {}, frame_, identity_, 1)->id);
}

}  // namespace
}  // namespace facet::face
