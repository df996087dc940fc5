#include "face/face_parts.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <vector>

#include "support/paths.hpp"

namespace facet::face {
namespace {

TEST(FaceParts, LandmarksAreInTheirParts) {
  if (!std::filesystem::exists(test::default_model())) {
    GTEST_SKIP() << "no default face model";
  }
  const FaceModel model = FaceModel::load(test::default_model());
  const std::vector<FacePart> parts = control_parts(model);
  ASSERT_EQ(parts.size(), static_cast<std::size_t>(model.vertex_count()));
  const std::vector<float> trust = shading_trust(model);
  ASSERT_EQ(trust.size(), parts.size());
  struct Place {
    int landmark;
    FacePart part;
  };
  for (const auto& [landmark, part] : std::vector<Place>{{10, FacePart::Forehead},
                                                         {151, FacePart::Forehead},
                                                         {105, FacePart::Brows},
                                                         {334, FacePart::Brows},
                                                         {159, FacePart::Lids},
                                                         {145, FacePart::Lids},
                                                         {386, FacePart::Lids},
                                                         {374, FacePart::Lids},
                                                         {4, FacePart::Nose},
                                                         {195, FacePart::Nose},
                                                         {0, FacePart::Mouth},
                                                         {17, FacePart::Mouth},
                                                         {61, FacePart::Mouth},
                                                         {50, FacePart::Cheeks},
                                                         {280, FacePart::Cheeks},
                                                         {152, FacePart::ChinAndJaw},
                                                         {199, FacePart::ChinAndJaw},
                                                         {136, FacePart::ChinAndJaw}}) {
    const LandmarkAnchor& anchor = model.landmarks[static_cast<std::size_t>(landmark)];
    const auto largest = std::max_element(anchor.weights.begin(), anchor.weights.end());
    const auto vertex =
        static_cast<std::size_t>(anchor.vertices[static_cast<std::size_t>(largest - anchor.weights.begin())]);
    EXPECT_EQ(parts[vertex], part) << "landmark " << landmark << " is of "
                                   << kFacePartNames[static_cast<std::size_t>(parts[vertex])];
    if (part == FacePart::Brows) {
      EXPECT_EQ(trust[vertex], 0) << "hair is no shape, landmark " << landmark;
    }
    if (part == FacePart::Cheeks || part == FacePart::ChinAndJaw || landmark == 10) {
      EXPECT_EQ(trust[vertex], 1) << "landmark " << landmark;
    }
  }
}

TEST(FaceParts, WithoutLandmarksShadingIsTrustedEverywhere) {
  if (!std::filesystem::exists(test::default_model())) {
    GTEST_SKIP() << "no default face model";
  }
  FaceModel model = FaceModel::load(test::default_model());
  model.landmarks.clear();
  EXPECT_EQ(shading_trust(model), std::vector<float>(static_cast<std::size_t>(model.vertex_count()), 1));
}

}  // namespace
}  // namespace facet::face
