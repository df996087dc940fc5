#include "landmark/attention_net.hpp"

#include <gtest/gtest.h>

#include <filesystem>

#include "facet/error.hpp"
#include "landmark/face_geometry.hpp"
#include "landmark/landmark_assets.hpp"
#include "landmark/landmark_layout.hpp"
#include "landmark/landmarker.hpp"
#include "reference_graph.hpp"
#include "support/frames.hpp"
#include "support/paths.hpp"

namespace facet::landmark {
namespace {

class AttentionNetTest : public testing::Test {
 protected:
  void SetUp() override {
    file = test::assets() / "mediapipe/face_mesh_solution_packed_assets.data";
    if (!std::filesystem::exists(file) || test::read_photo("sample1.jpg").empty()) {
      GTEST_SKIP() << file << " or the photographs are missing (packaging/fetch-assets)";
    }
    frame = test::frame_of(test::read_photo("sample1.jpg"));
    Landmarker landmarker(file, {.smooth = false});
    faces = landmarker.find_all(frame);
    ASSERT_FALSE(faces.empty());
  }

  std::filesystem::path file;
  Frame frame;
  std::vector<FaceLandmarks> faces;
};

TEST_F(AttentionNetTest, FindsWhatTheWholeGraphSays) {
  const LandmarkAssets assets = LandmarkAssets::load(file);
  AttentionNet net(assets.attention_landmarks(), "net");
  const TfliteModel model = parse_tflite(assets.attention_landmarks(), "net");
  constexpr int side = FacePicture::side;
  constexpr std::size_t plane = std::size_t{side} * side;
  FacePicture picture;
  std::vector<float> image(3 * plane);
  for (const FaceLandmarks& face : faces) {
    // An upright window of the net's own size, so that its pixels are the image's.
    const Region window{face.window.centre_px, side, face.window.rotation_rad};
    Eigen::Matrix3Xf points_px, irises_px;
    picture.sample(frame, window);
    const float presence = net.find(picture, points_px, irises_px);
    for (std::size_t i = 0; i < plane; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        image[3 * i + c] = picture.values()[c * plane + i];
      }
    }
    const auto expected = test::run_reference(model, image);  // mesh, lips, eye, iris, eye, iris, presence
    const auto place = [&](const std::vector<float>& values, std::size_t i, std::size_t stride) {
      return window.image_from_window(Eigen::Vector2f(values[stride * i], values[stride * i + 1]) / side);
    };
    constexpr float kTolerancePx = 0.01F;  // another order of some million float additions
    const auto compare_part = [&](std::span<const int> landmarks, std::size_t output) {
      for (std::size_t i = 0; i < landmarks.size(); ++i) {
        EXPECT_LT((points_px.col(landmarks[i]).head<2>() - place(expected[output], i, 2)).norm(),
                  kTolerancePx)
            << "output " << output << ", landmark " << landmarks[i];
      }
    };
    std::vector<std::size_t> of_name;
    for (const std::string_view name : {"output_lips", "output_left_eye", "output_right_eye",
                                        "output_left_iris", "output_right_iris", "conv_faceflag"}) {
      for (std::size_t o = 0; o < model.outputs.size(); ++o) {
        if (model.tensors[static_cast<std::size_t>(model.outputs[o])].name == name) {
          of_name.push_back(o);
        }
      }
    }
    ASSERT_EQ(of_name.size(), 6U);
    compare_part(lip_landmarks(), of_name[0]);
    compare_part(right_eye_landmarks(), of_name[1]);
    compare_part(left_eye_landmarks(), of_name[2]);
    EXPECT_LT((irises_px.col(0).head<2>() - place(expected[of_name[3]], 0, 2)).norm(), kTolerancePx);
    EXPECT_LT((irises_px.col(1).head<2>() - place(expected[of_name[4]], 0, 2)).norm(), kTolerancePx);
    EXPECT_NEAR(presence, 1 / (1 + std::exp(-expected[of_name[5]][0])), 1e-3F);
  }
}

TEST_F(AttentionNetTest, IrisesLieBetweenTheLidsOfOpenEyes) {
  int open = 0;
  for (const FaceLandmarks& face : faces) {
    ASSERT_EQ(face.irises_px.cols(), 2);
    const int corners[2][2] = {{33, 133}, {263, 362}};
    for (int eye = 0; eye < 2; ++eye) {
      if (face.iris_confidence[static_cast<std::size_t>(eye)] < 0.5F) {
        continue;
      }
      ++open;
      const Eigen::Vector2f outer = face.points_px.col(corners[eye][0]).head<2>();
      const Eigen::Vector2f inner = face.points_px.col(corners[eye][1]).head<2>();
      const Eigen::Vector2f iris = face.irises_px.col(eye).head<2>();
      EXPECT_LT((iris - 0.5F * (outer + inner)).norm(), 0.4F * (outer - inner).norm());
    }
  }
  EXPECT_GE(open, 2) << "the photograph shows open eyes";
}

TEST_F(AttentionNetTest, RefusesOtherNets) {
  const LandmarkAssets assets = LandmarkAssets::load(file);
  EXPECT_THROW(AttentionNet(assets.landmarks(), "net"), Error);
  EXPECT_THROW(AttentionNet(assets.detector(), "net"), Error);
}

TEST(IrisConfidence, FallsToZeroBehindShutLids) {
  FaceLandmarks face;
  face.points_px.setZero(3, landmark_count);
  face.confidence.setOnes(landmark_count);
  face.irises_px.setZero(3, 2);
  const auto open = [&](float height_px) {
    for (const auto& [outer, inner, upper, lower] :
         {std::array{33, 133, 159, 145}, std::array{263, 362, 386, 374}}) {
      face.points_px.col(inner) << 30, 0, 0;
      face.points_px.col(outer) << 0, 0, 0;
      face.points_px.col(upper) << 15, -height_px / 2, 0;
      face.points_px.col(lower) << 15, height_px / 2, 0;
    }
    measure_iris_confidence(face);
    return face.iris_confidence[0] + face.iris_confidence[1];
  };
  EXPECT_FLOAT_EQ(open(9), 2);
  EXPECT_FLOAT_EQ(open(2), 0);
  face.confidence[133] = 0;
  EXPECT_FLOAT_EQ(open(9), 1) << "an eye that is turned away is not seen";
}

}  // namespace
}  // namespace facet::landmark
