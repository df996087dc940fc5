#include "booth/face_points.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "facet/error.hpp"

namespace facet::booth {
namespace {

using testing::AllOf;
using testing::HasSubstr;

std::string why(const std::string& text) {
  try {
    parse_face_points(text, "points.toml");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "nothing";
}

TEST(FacePoints, NamesAndNumbersOfLandmarks) {
  const FacePoints points = parse_face_points(
      "slot = 152\n[camera.front]\nnose_tip = [320.5, 240]\n\"33\" = [280, 200.25]\n[camera.\"left "
      "one\"]\nchin = "
      "[-3, 7]\n",
      "points.toml");
  EXPECT_EQ(points.slot, 152U);
  ASSERT_EQ(points.cameras.size(), 2U);
  const FacePoints::Camera& front = points.cameras[0];
  EXPECT_EQ(front.name, "front");
  EXPECT_EQ(front.face.confidence.sum(), 2);
  EXPECT_EQ(front.face.confidence[1], 1);
  EXPECT_EQ(front.face.points_px.col(1), Eigen::Vector3f(320.5F, 240, 0));
  EXPECT_EQ(front.face.points_px.col(33), Eigen::Vector3f(280, 200.25F, 0));
  EXPECT_EQ(points.cameras[1].name, "left one");
  EXPECT_EQ(points.cameras[1].face.points_px.col(152), Eigen::Vector3f(-3, 7, 0));
}

TEST(FacePoints, SaysWhatIsWrongAndWhere) {
  EXPECT_THAT(why("slot = 1\n[camera.a]\nnose = [1, 2]\n"),
              AllOf(HasSubstr("points.toml"), HasSubstr("3"), HasSubstr("nose_tip"), HasSubstr("467")));
  EXPECT_THAT(why("slot = 1\n[camera.a]\n468 = [1, 2]\n"), HasSubstr("is no landmark"));
  EXPECT_THAT(why("slot = 1\n[camera.a]\nnose_tip = [1]\n"), HasSubstr("nose_tip"));
  EXPECT_THAT(why("slot = 1\n[camera.a]\nnose_tip = [1, 1e9]\n"), HasSubstr("nose_tip"));
  EXPECT_THAT(why("slot = 1\n[camera.a]\nnose_tip = [1, 2]\n1 = [1, 2]\n"), HasSubstr("has a place already"));
  EXPECT_THAT(why("[camera.a]\nnose_tip = [1, 2]\n"), HasSubstr("slot"));
  EXPECT_THAT(why("slot = 1\n"), HasSubstr("camera"));
  EXPECT_THAT(why("slot = 1\n[camera]\na = 3\n"), HasSubstr("camera.a"));
  EXPECT_THAT(why("slot = 1\nsolt = 2\n[camera.a]\nnose_tip = [1, 2]\n"), HasSubstr("solt"));
  EXPECT_THAT(why("slot = "), HasSubstr("points.toml"));
  EXPECT_THROW(read_face_points("/nowhere/points.toml"), Error);
}

TEST(FacePoints, DepthIsRefused) {
  std::string deep = "a";
  for (int i = 0; i < 200'000; ++i) {
    deep += ".a";
  }
  for (const std::string& text :
       {deep + " = 1", "[" + deep + "]", "[[" + deep + "]]", "x = {" + deep + " = 1}"}) {
    EXPECT_THAT(why(text), HasSubstr("more than 16 names in one key"));
  }
}

}  // namespace
}  // namespace facet::booth
