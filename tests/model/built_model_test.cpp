// Properties of the model that is built from MakeHuman's data, built here with few identities.
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <set>

#include "facet/error.hpp"
#include "mesh/mesh.hpp"
#include "model/build_model.hpp"
#include "model/portrait.hpp"
#include "support/paths.hpp"

namespace facet::model {
namespace {

using face::FaceModel;
using face::Region;

struct Built {
  FaceModel model;
  BuildReport report;
};

BuildOptions small_build() {
  BuildOptions options;
  options.makehuman = test::assets() / "makehuman";
  options.identities = 24;
  options.check_identities = 2;
  options.core.max_modes = 20;
  return options;
}

/// Built once for all tests.
const Built& built() {
  static const std::unique_ptr<Built> kBuilt = [] {
    auto result = std::make_unique<Built>();
    result->model = build_model(
        small_build(), [](std::uint64_t, std::uint64_t, const std::string&) {}, result->report);
    return result;
  }();
  return *kBuilt;
}

class BuiltModel : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(test::assets() / "makehuman" / "public")) {
      GTEST_SKIP() << "needs MakeHuman's data in " << test::assets() << " (packaging/fetch-assets)";
    }
  }
  static const FaceModel& model() { return built().model; }
  static mesh::Vertices delta_mm(const std::string& expression) {
    return model().core_row(0, model().expression_index(expression) + 1);
  }
  /// Largest displacement of an expression over the skin vertices that a rule picks.
  template <typename Rule>
  static float largest_mm(const std::string& expression, Rule rule) {
    const mesh::Vertices delta = delta_mm(expression);
    const auto mean_mm = model().core_row(0, 0);
    float largest = 0;
    for (Eigen::Index v = 0; v < delta.cols(); ++v) {
      const std::uint8_t bits = model().regions[static_cast<std::size_t>(v)];
      if (!face::has_region(bits, Region::Eye) && !face::has_region(bits, Region::MouthInterior) &&
          rule(Eigen::Vector3f(mean_mm.col(v)))) {
        largest = std::max(largest, delta.col(v).norm());
      }
    }
    return largest;
  }
};

TEST_F(BuiltModel, IsWholeAndHasThe51ArkitExpressions) {
  EXPECT_EQ(model().check(), "");
  EXPECT_EQ(model().expression_count(), 51);
  EXPECT_EQ(model().expression_index("tongueOut"), -1);
  for (const char* name : {"jawOpen", "eyeBlinkLeft", "mouthSmileRight", "browInnerUp", "cheekPuff",
                           "mouthClose", "noseSneerLeft"}) {
    EXPECT_GE(model().expression_index(name), 0) << name;
  }
}

TEST_F(BuiltModel, SurfaceIsManifoldAndOpenOnlyAtTheNeckAndTheSlit) {
  const mesh::Triangles triangles = model_triangles(model());
  const mesh::OneRings rings = mesh::build_one_rings(triangles, model().vertex_count());
  for (int v = 0; v < model().vertex_count(); ++v) {
    EXPECT_EQ(rings.on_boundary[static_cast<std::size_t>(v)] != 0,
              face::has_region(model().regions[static_cast<std::size_t>(v)], Region::Boundary))
        << v;
  }
  // The slit's two sides coincide, so nothing shows through it: every boundary vertex off the neck has a
  // twin.
  const auto mean_mm = model().core_row(0, 0);
  for (int v = 0; v < model().vertex_count(); ++v) {
    if (rings.on_boundary[static_cast<std::size_t>(v)] == 0 || mean_mm(1, v) < 0) {
      continue;
    }
    EXPECT_LT(std::abs(mean_mm(0, v)), 0.1F) << v;
  }
}

TEST_F(BuiltModel, HasAdultProportions) {
  EXPECT_NEAR(built().report.eye_distance_mm, 63, 2.5);
  EXPECT_GT(built().report.identity_rms_mm, 3.0);
  EXPECT_LT(built().report.identity_rms_mm, 5.5);
  const auto mean_mm = model().core_row(0, 0);
  EXPECT_NEAR(mean_mm.row(1).minCoeff(), -117, 8);  // chin below the eyes
}

TEST_F(BuiltModel, MeanIsSymmetric) {
  // Every vertex has one at the mirrored place; expressions swap left and right with it.
  const auto mean_mm = model().core_row(0, 0);
  std::map<std::tuple<int, int, int>, int> cells;
  const auto cell = [](const Eigen::Vector3f& p) {
    return std::tuple(static_cast<int>(std::lround(p.x() * 2)), static_cast<int>(std::lround(p.y() * 2)),
                      static_cast<int>(std::lround(p.z() * 2)));
  };
  for (int v = 0; v < model().vertex_count(); ++v) {
    cells[cell(mean_mm.col(v))] = v;
  }
  const mesh::Vertices left = delta_mm("mouthSmileLeft");
  const mesh::Vertices right = delta_mm("mouthSmileRight");
  int matched = 0;
  for (int v = 0; v < model().vertex_count(); ++v) {
    const Eigen::Vector3f mirrored = Eigen::Vector3f(mean_mm.col(v)).cwiseProduct(Eigen::Vector3f(-1, 1, 1));
    const auto found = cells.find(cell(mirrored));
    if (found == cells.end() || (mean_mm.col(found->second) - mirrored).norm() > 0.01F) {
      continue;
    }
    ++matched;
    const Eigen::Vector3f expected = Eigen::Vector3f(left.col(v)).cwiseProduct(Eigen::Vector3f(-1, 1, 1));
    EXPECT_LT((right.col(found->second) - expected).norm(), 0.05F) << v;
  }
  EXPECT_GT(matched, model().vertex_count() * 9 / 10);  // the others fall across a cell's border
}

TEST_F(BuiltModel, EveryExpressionMovesTheFaceAndStaysWhereItBelongs) {
  const auto everywhere = [](const Eigen::Vector3f&) { return true; };
  for (const std::string& name : model().expression_names) {
    const mesh::Vertices delta = delta_mm(name);
    EXPECT_GT(delta.colwise().norm().maxCoeff(), 2.0F) << name;
    EXPECT_LT(largest_mm(name, everywhere), 45.0F) << name;
    // No expression moves the skull.
    EXPECT_LT(largest_mm(name, [](const Eigen::Vector3f& p) { return p.y() > 75 || p.z() < -110; }), 0.5F)
        << name;
  }
  const auto chin = [](const Eigen::Vector3f& p) { return p.y() < -85; };
  const auto brows = [](const Eigen::Vector3f& p) { return p.y() > 12; };
  for (const char* name :
       {"eyeBlinkLeft", "eyeLookUpRight", "browInnerUp", "browDownLeft", "eyeSquintRight"}) {
    EXPECT_LT(largest_mm(name, chin), 0.1F) << name;
  }
  for (const char* name :
       {"jawOpen", "mouthSmileLeft", "mouthPucker", "jawLeft", "mouthShrugLower", "mouthRollUpper"}) {
    EXPECT_LT(largest_mm(name, brows), 0.3F) << name;
  }
  const auto right_half = [](const Eigen::Vector3f& p) { return p.x() < -14; };
  for (const char* name : {"eyeBlinkLeft", "mouthSmileLeft", "browDownLeft", "mouthLowerDownLeft",
                           "cheekSquintLeft", "noseSneerLeft"}) {
    EXPECT_LT(largest_mm(name, right_half), 0.6F) << name;
  }
}

TEST_F(BuiltModel, ExpressionsGoTheRightWay) {
  const auto centre_of_move = [](const std::string& name, int axis) {
    const mesh::Vertices delta = delta_mm(name);
    return delta.row(axis).sum() / delta.row(axis).cwiseAbs().sum();  // -1 to 1
  };
  EXPECT_LT(centre_of_move("jawOpen", 1), -0.8F);
  EXPECT_GT(centre_of_move("jawForward", 2), 0.8F);
  EXPECT_GT(centre_of_move("jawLeft", 0), 0.8F);  // the subject's left is +x
  EXPECT_LT(centre_of_move("jawRight", 0), -0.8F);
  EXPECT_GT(centre_of_move("mouthLeft", 0), 0.8F);
  EXPECT_GT(centre_of_move("browInnerUp", 1), 0.5F);
  EXPECT_LT(centre_of_move("browDownLeft", 1), -0.5F);
  EXPECT_GT(centre_of_move("noseSneerLeft", 1), 0.5F);
  EXPECT_GT(centre_of_move("mouthSmileLeft", 1), 0.3F);
  EXPECT_LT(centre_of_move("mouthFrownLeft", 1), 0.0F);
  EXPECT_GT(centre_of_move("mouthPucker", 2), 0.2F);
}

TEST_F(BuiltModel, EyeballsTurnTheRightWay) {
  // What turns is the foremost vertex of each eyeball.
  const auto mean_mm = model().core_row(0, 0);
  const auto pole_move = [&](const std::string& name, bool left) {
    int pole = -1;
    for (int v = 0; v < model().vertex_count(); ++v) {
      // Eyeball vertices belong to the eye; the foremost eye vertices near the eyes' axes are theirs.
      const Eigen::Vector3f p = mean_mm.col(v);
      if (face::has_region(model().regions[static_cast<std::size_t>(v)], Region::Eye) &&
          (p.x() > 0) == left && std::abs(p.y()) < 4 && std::abs(std::abs(p.x()) - 31.7F) < 4 &&
          (pole < 0 || p.z() > mean_mm(2, pole))) {
        pole = v;
      }
    }
    return Eigen::Vector3f(delta_mm(name).col(pole));
  };
  EXPECT_GT(pole_move("eyeLookUpLeft", true).y(), 3);
  EXPECT_LT(pole_move("eyeLookDownLeft", true).y(), -3);
  EXPECT_LT(pole_move("eyeLookInLeft", true).x(), -3);
  EXPECT_GT(pole_move("eyeLookOutLeft", true).x(), 3);
  EXPECT_GT(pole_move("eyeLookInRight", false).x(), 3);
  EXPECT_LT(pole_move("eyeLookOutRight", false).x(), -3);
  EXPECT_TRUE(pole_move("eyeLookUpLeft", false).isZero(0.01F));
}

TEST_F(BuiltModel, CoreIsGenuinelyBilinear) {
  // The same expression moves two people differently: not only in size, but by more than the truncation
  // loses.
  const std::vector<float> person = {2.0F};
  const auto mean = model().contract_identity({});
  const auto other = model().contract_identity(person);
  int coupled = 0;
  for (std::size_t e = 0; e < mean.deltas_mm.size(); ++e) {
    coupled += (mean.deltas_mm[e] - other.deltas_mm[e]).colwise().norm().maxCoeff() > 0.1F ? 1 : 0;
  }
  EXPECT_GT(coupled, 40);
}

TEST_F(BuiltModel, TruncationLosesLittle) {
  // 24 people can't span all; the full build is measured by `facet model build`.
  EXPECT_GT(built().report.explained_variance, 0.9);
  EXPECT_LT(built().report.neutral_error_mm, 4.0);
  EXPECT_LT(built().report.expression_error_mm, 0.5);
}

TEST_F(BuiltModel, RegionsMakeSense) {
  const auto mean_mm = model().core_row(0, 0);
  std::map<Region, int> count;
  for (int v = 0; v < model().vertex_count(); ++v) {
    const std::uint8_t bits = model().regions[static_cast<std::size_t>(v)];
    for (const Region region : {Region::Refinable, Region::Eye, Region::Lips, Region::MouthInterior,
                                Region::Boundary, Region::Scalp, Region::Brow}) {
      count[region] += face::has_region(bits, region) ? 1 : 0;
    }
    EXPECT_EQ(model().control.refinable[static_cast<std::size_t>(v)] != 0,
              face::has_region(bits, Region::Refinable));
    if (face::has_region(bits, Region::Refinable)) {
      EXPECT_FALSE(face::has_region(bits, Region::Eye) || face::has_region(bits, Region::MouthInterior) ||
                   face::has_region(bits, Region::Scalp) || face::has_region(bits, Region::Boundary))
          << v;
    }
    if (face::has_region(bits, Region::Lips)) {
      EXPECT_NEAR(mean_mm(1, v), -72, 22) << v;
      EXPECT_LT(std::abs(mean_mm(0, v)), 32) << v;
    }
  }
  for (const auto& [region, vertices] : count) {
    EXPECT_GT(vertices, 10) << static_cast<int>(region);
  }
}

TEST_F(BuiltModel, LipsAreRedderThanTheForehead) {
  const auto mean_mm = model().core_row(0, 0);
  const auto redness = [&](auto rule) {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    for (int v = 0; v < model().vertex_count(); ++v) {
      if (rule(v)) {
        sum += model().mean_albedo.col(v);
      }
    }
    return sum.x() / sum.y();
  };
  const float lips = redness(
      [&](int v) { return face::has_region(model().regions[static_cast<std::size_t>(v)], Region::Lips); });
  const float forehead =
      redness([&](int v) { return mean_mm(1, v) > 35 && mean_mm(1, v) < 60 && mean_mm(2, v) > 0; });
  EXPECT_GT(lips, 1.15F * forehead);
  EXPECT_GT(model().mean_albedo.minCoeff(), 0);
  EXPECT_LT(model().mean_albedo.maxCoeff(), 1);
}

TEST_F(BuiltModel, TheSameSeedGivesTheSameModel) {
  BuildOptions options = small_build();
  options.identities = 3;
  options.check_identities = 0;
  BuildReport report;
  const auto quiet = [](std::uint64_t, std::uint64_t, const std::string&) {};
  const FaceModel once = build_model(options, quiet, report);
  const FaceModel again = build_model(options, quiet, report);
  EXPECT_EQ(once.core_mm, again.core_mm);
  options.seed = 1;
  EXPECT_NE(build_model(options, quiet, report).core_mm, once.core_mm);
}

TEST(BuildModel, MissingDataIsNamed) {
  BuildOptions options;
  options.makehuman = "/nonexistent-folder";
  BuildReport report;
  try {
    build_model(
        options, [](std::uint64_t, std::uint64_t, const std::string&) {}, report);
    FAIL() << "built from nothing";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    EXPECT_NE(std::string(error.what()).find("fetch-assets"), std::string::npos);
  }
}

}  // namespace
}  // namespace facet::model
