// Avatars made of the face model: other people with other axes, units and texture coordinates, of which every
// vertex's place on the take's person is known.

#include "avatar/skin.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <cstring>
#include <iostream>
#include <random>

#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "mesh/arkit.hpp"
#include "support/paths.hpp"

namespace facet::avatar {
namespace {

using Json = nlohmann::ordered_json;
using ::testing::AllOf;
using ::testing::HasSubstr;

std::size_t append_shorts(GlbDocument& glb, const std::vector<std::uint16_t>& values, const char* type,
                          std::size_t count, bool normalized) {
  glb.binary.resize((glb.binary.size() + 3) / 4 * 4);
  const std::size_t offset = glb.binary.size();
  const auto bytes = std::as_bytes(std::span(values));
  glb.binary.insert(glb.binary.end(), bytes.begin(), bytes.end());
  glb.json["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", offset}, {"byteLength", bytes.size()}});
  glb.json["accessors"].push_back({{"bufferView", glb.json["bufferViews"].size() - 1},
                                   {"componentType", 5123},
                                   {"normalized", normalized},
                                   {"count", count},
                                   {"type", type}});
  glb.json["buffers"][0]["byteLength"] = glb.binary.size();
  return glb.json["accessors"].size() - 1;
}

std::span<const float> values_of(const mesh::Vertices& vertices) {
  return {vertices.data(), static_cast<std::size_t>(vertices.size())};
}

class SkinOfAnAvatar : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(test::default_model())) {
      GTEST_SKIP() << test::default_model() << " is not there: packaging/prepare makes it";
    }
    model_ = face::FaceModel::load(test::default_model());
    mesh::HierarchyOptions options;
    options.max_levels = 1;
    hierarchy_ = mesh::build_hierarchy(
        model_.control, mesh::TextureCoordinates::Zero(2, model_.vertex_count()),
        std::vector<std::uint8_t>(static_cast<std::size_t>(model_.vertex_count()), 0), options);
  }
  const mesh::Level& level() const { return hierarchy_->levels.front(); }

  face::ExpressionBasis somebody(std::uint32_t seed) const {
    std::mt19937 random(seed);
    std::normal_distribution<float> normal;
    std::vector<float> identity(static_cast<std::size_t>(model_.identity_count()));
    for (float& one : identity) {
      one = std::clamp(normal(random), -2.0F, 2.0F);
    }
    return model_.contract_identity(identity);
  }
  mesh::Vertices coarse(const mesh::Vertices& control) const {
    mesh::Vertices out;
    mesh::apply(level().from_coarser, control, out);
    return out;
  }
  PersonShapes person(const face::ExpressionBasis& basis) const {
    PersonShapes out;
    out.neutral_mm = coarse(basis.neutral_mm);
    out.triangles = level().triangles;
    for (std::size_t e = 0; e < basis.deltas_mm.size(); ++e) {
      if (const int shape = mesh::arkit_index(model_.expression_names[e]); shape >= 0) {
        out.shapes.emplace_back(shape, coarse(basis.deltas_mm[e]));
      }
    }
    std::vector<Eigen::Index> skin;
    for (Eigen::Index v = 0; v < model_.vertex_count(); ++v) {
      if (on_skin(v)) {
        skin.push_back(v);
      }
    }
    out.skin_mm = basis.neutral_mm(Eigen::all, skin);
    return out;
  }
  bool on_skin(Eigen::Index control) const {
    return face::has_region(model_.regions[static_cast<std::size_t>(control)], face::Region::Refinable);
  }
  /// A GLB with z up, in centimetres, far from the origin; its first shape is a sparse accessor, its texture
  /// coordinates are 16-bit. shapes: how many of them.
  GlbDocument avatar(const face::ExpressionBasis& basis, std::size_t shapes = 99) const {
    GlbDocument glb;
    glb.json = Json::parse(R"({"asset": {"version": "2.0"}, "nodes": [{"name": "head", "mesh": 0}],
        "materials": [{"name": "skin"}], "buffers": [{"byteLength": 0}]})");
    const auto count = static_cast<std::size_t>(level().vertex_count);
    const auto as_avatar = [this](const mesh::Vertices& vertices) -> mesh::Vertices {
      return 0.1F * (turn_ * coarse(vertices));
    };
    mesh::Vertices rest = as_avatar(basis.neutral_mm);
    rest.colwise() += Eigen::Vector3f(30, -12, 155);
    Json primitive = {{"material", 0}};
    primitive["attributes"]["POSITION"] = append_floats(glb, values_of(rest), "VEC3", count, Json::object());
    std::vector<std::uint16_t> uv;
    for (Eigen::Index v = 0; v < rest.cols(); ++v) {
      const Eigen::Vector2f at = hierarchy_->texture_coordinates.col(v);
      uv.push_back(static_cast<std::uint16_t>(std::lround(65535 * at.y())));
      uv.push_back(static_cast<std::uint16_t>(std::lround(65535 * at.x())));
    }
    primitive["attributes"]["TEXCOORD_0"] = append_shorts(glb, uv, "VEC2", count, true);
    std::vector<std::uint16_t> corners(level().triangles.data(),
                                       level().triangles.data() + level().triangles.size());
    primitive["indices"] = append_shorts(glb, corners, "SCALAR", corners.size(), false);
    Json names = Json::array();
    for (std::size_t e = 0; e < std::min(shapes, basis.deltas_mm.size()); ++e) {
      const mesh::Vertices delta = as_avatar(basis.deltas_mm[e]);
      std::size_t accessor = 0;
      if (e == 0) {
        std::vector<std::uint16_t> moved;
        std::vector<float> by;
        for (Eigen::Index v = 0; v < delta.cols(); ++v) {
          if (delta.col(v).squaredNorm() > 0) {
            moved.push_back(static_cast<std::uint16_t>(v));
            by.insert(by.end(), delta.col(v).data(), delta.col(v).data() + 3);
          }
        }
        const std::size_t indices = append_shorts(glb, moved, "SCALAR", moved.size(), false);
        const std::size_t values = append_floats(glb, by, "VEC3", moved.size(), Json::object());
        const auto view = [&](std::size_t index) { return glb.json["accessors"][index]["bufferView"]; };
        glb.json["accessors"].push_back(
            {{"componentType", 5126},
             {"count", count},
             {"type", "VEC3"},
             {"sparse",
              {{"count", moved.size()},
               {"indices", {{"bufferView", view(indices)}, {"componentType", 5123}}},
               {"values", {{"bufferView", view(values)}}}}}});
        accessor = glb.json["accessors"].size() - 1;
      } else {
        accessor = append_floats(glb, values_of(delta), "VEC3", count, Json::object());
      }
      primitive["targets"].push_back({{"POSITION", accessor}});
      names.push_back(model_.expression_names[e]);
    }
    glb.json["meshes"].push_back(
        {{"name", "Face"}, {"primitives", Json::array({primitive})}, {"extras", {{"targetNames", names}}}});
    return glb;
  }
  static std::vector<Skin> skins(const GlbDocument& glb) {
    return read_skins(glb, inspect_avatar(glb, std::nullopt));
  }
  template <typename Work>
  static std::string fault(const Work& work) {
    try {
      work();
    } catch (const Error& error) {
      return error.what();
    }
    return "none";
  }

  face::FaceModel model_;
  std::shared_ptr<const mesh::Hierarchy> hierarchy_;
  Eigen::Matrix3f turn_ =
      Eigen::AngleAxisf(1.5707963F, Eigen::Vector3f::UnitX()).toRotationMatrix() *
      Eigen::AngleAxisf(0.4F, Eigen::Vector3f(0.2F, 0.9F, -0.3F).normalized()).toRotationMatrix();
};

TEST_F(SkinOfAnAvatar, IsReadAsItIs) {
  const face::ExpressionBasis basis = somebody(1);
  const std::vector<Skin> found = skins(avatar(basis));
  ASSERT_EQ(found.size(), 1U);
  const Skin& skin = found.front();
  EXPECT_EQ(skin.name, "Face, skin");
  EXPECT_EQ(skin.triangles, level().triangles);
  const mesh::Vertices rest = 0.1F * (turn_ * coarse(basis.neutral_mm));
  EXPECT_LT(((skin.vertices - rest).colwise() - Eigen::Vector3f(30, -12, 155)).norm(), 1e-2F);
  ASSERT_EQ(skin.shapes.size(), model_.expression_names.size());
  for (std::size_t e = 0; e < skin.shapes.size(); ++e) {
    EXPECT_EQ(skin.shapes[e].first, mesh::arkit_index(model_.expression_names[e]));
    EXPECT_LT((skin.shapes[e].second - 0.1F * (turn_ * coarse(basis.deltas_mm[e]))).norm(), 1e-3F) << e;
  }
  const mesh::TextureCoordinates& uv = hierarchy_->texture_coordinates;
  EXPECT_LT((skin.texture_coordinates.row(0) - uv.row(1)).cwiseAbs().maxCoeff(), 1e-5F);
  EXPECT_LT((skin.texture_coordinates.row(1).array() + uv.row(0).array() - 1).abs().maxCoeff(), 1e-5F)
      << "v is up";
}

TEST_F(SkinOfAnAvatar, OfTheSamePersonLiesWhereItIs) {
  for (const std::uint32_t seed : {1U, 2U, 3U}) {
    const face::ExpressionBasis basis = somebody(seed);
    const Placement placement = place_skin(skins(avatar(basis)).front(), person(basis));
    EXPECT_NEAR(placement.mm_per_unit, 10, 1e-3F);
    EXPECT_LT((placement.head_from_skin * turn_ - Eigen::Matrix3f::Identity()).norm(), 1e-4F);
    EXPECT_LT(placement.surface_distance_mm, 0.01F);
    EXPECT_LT(placement.shape_distance_mm, 0.01F);
    EXPECT_GT(placement.covered, 0.999F);
  }
}

/// How far from where it should be a point of another person's skin gets: the two people's faces differ, the
/// nearest point is not the same skin. Means and worst over nine pairs of people.
TEST_F(SkinOfAnAvatar, OfAnotherPersonLiesNearWhereItShould) {
  for (const std::uint32_t seed : {1U, 2U, 3U}) {
    const face::ExpressionBasis wearer = somebody(seed);
    const mesh::Vertices wearer_mm = coarse(wearer.neutral_mm);
    const FaceUnderSkin face(wearer_mm, level().triangles);
    for (const std::uint32_t other : {101U, 102U, 103U}) {
      const std::vector<Skin> found = skins(avatar(somebody(other)));
      const auto [chosen, placement] = choose_skin(found, person(wearer));
      const Skin& skin = found[chosen];
      const mesh::Vertices placed_mm = placement.to_head_mm(skin.vertices);
      double sum = 0;
      double rigid = 0;
      int count = 0;
      int placed = 0;
      std::vector<float> misses;
      for (Eigen::Index v = 0; v < model_.vertex_count(); ++v) {  // the first of level 0 are the control's
        if (!on_skin(v)) {
          continue;
        }
        ++count;
        rigid += static_cast<double>((placed_mm.col(v) - wearer_mm.col(v)).norm());
        const FaceUnderSkin::Point under =
            face.under(placed_mm.col(v), placement.head_from_skin * skin.normals.col(v));
        if (under.triangle < 0) {
          continue;
        }
        ++placed;
        const Eigen::Vector3f at_mm = wearer_mm(Eigen::all, level().triangles.col(under.triangle)) *
                                      Eigen::Vector3f(under.weights.data());
        misses.push_back((at_mm - wearer_mm.col(v)).norm());
        sum += static_cast<double>(misses.back());
      }
      std::sort(misses.begin(), misses.end());
      const double mean = sum / placed;
      std::cout << "person " << seed << ", avatar " << other << ": shapes " << placement.shape_distance_mm
                << " mm, surfaces " << placement.surface_distance_mm << " mm; placed " << placed << " of "
                << count << ", apart " << rigid / count << " mm, missed by " << mean << " mm (mean), "
                << misses[misses.size() * 95 / 100] << " mm (95 %)\n";
      EXPECT_GT(placed, 0.88 * count);
      EXPECT_LT(mean, 3.2);
    }
  }
}

TEST_F(SkinOfAnAvatar, ThatDoesNotFitIsRefused) {
  const face::ExpressionBasis basis = somebody(1);
  const PersonShapes wearer = person(basis);
  EXPECT_THAT(
      fault([&] { choose_skin(skins(avatar(basis, 5)), wearer); }),
      AllOf(HasSubstr("can't be placed"), HasSubstr("mesh 'Face, skin': it has 5 of the take's shapes, 6")));
  EXPECT_THAT(fault([&] { choose_skin({}, wearer); }), HasSubstr("none of its meshes"));
  GlbDocument bare = avatar(basis);
  bare.json["meshes"][0]["primitives"][0]["attributes"].erase("TEXCOORD_0");
  EXPECT_THAT(fault([&] { choose_skin(skins(bare), wearer); }), HasSubstr("has no texture coordinates"));
  // An animal: the shapes are somewhere else.
  std::vector<Skin> animal = skins(avatar(basis));
  std::mt19937 random(4);
  std::shuffle(animal.front().shapes.begin(), animal.front().shapes.end(), random);
  for (std::size_t e = 0; e < animal.front().shapes.size(); ++e) {
    animal.front().shapes[e].first = wearer.shapes[e].first;
  }
  EXPECT_THAT(fault([&] { choose_skin(animal, wearer); }),
              HasSubstr("from the person's (median; 15 at most)"));
  // A mask of the forehead alone.
  std::vector<Skin> mask = skins(avatar(basis));
  std::vector<Eigen::Index> kept;
  const mesh::Vertices rest_mm = coarse(basis.neutral_mm);
  for (Eigen::Index t = 0; t < level().triangles.cols(); ++t) {
    if (rest_mm(1, level().triangles(0, t)) > 10) {
      kept.push_back(t);
    }
  }
  mask.front().triangles = mesh::Triangles(level().triangles(Eigen::all, kept));
  EXPECT_NE(fault([&] { choose_skin(mask, wearer); }), "none");
}

TEST_F(SkinOfAnAvatar, ThatIsBrokenIsNamed) {
  const GlbDocument sound = avatar(somebody(1));
  const auto changed = [&](const std::string& pointer, const Json& value) {
    GlbDocument broken = sound;
    broken.json[Json::json_pointer(pointer)] = value;
    return fault([&] { skins(broken); });
  };
  EXPECT_EQ(changed("/extras", "x"), "none");
  EXPECT_THAT(changed("/accessors/0/count", 1 << 20), HasSubstr("beyond its data"));
  EXPECT_THAT(changed("/accessors/0/byteOffset", 4), HasSubstr("beyond its data"));
  EXPECT_THAT(changed("/accessors/0/componentType", 5122), HasSubstr("not what its place wants"));
  EXPECT_THAT(changed("/bufferViews/0/byteOffset", -1), testing::Not("none"));
  EXPECT_THAT(changed("/bufferViews/0/byteStride", 8), HasSubstr("beyond its data"));
  EXPECT_THAT(changed("/bufferViews/0/extensions/EXT_meshopt_compression", Json::object()),
              HasSubstr("compressed"));
  EXPECT_THAT(changed("/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression", Json::object()),
              HasSubstr("compressed"));
  EXPECT_THAT(changed("/meshes/0/primitives/0/indices", 1), testing::Not("none"));
  EXPECT_THAT(changed("/meshes/0/primitives/0/targets/0/POSITION", 2), HasSubstr("not what its place wants"));
}

}  // namespace
}  // namespace facet::avatar
