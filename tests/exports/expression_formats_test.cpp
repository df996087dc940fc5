// Formats that are made of a person's expressions (GLB, FBX, USD), what they are made with, and how others
// read them: Assimp's importer, TinyUSDZ.

#include <assimp/scene.h>

#include <assimp/Exporter.hpp>
#include <assimp/Importer.hpp>
#include <numbers>

#include "export_fixture.hpp"
#include "exports/fbx_document.hpp"
#include "facet/error.hpp"
#include "mesh/arkit.hpp"

namespace facet::exports {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

/// Double cones of so many steps around.
struct Balls {
  std::vector<Eigen::Vector3f> places_mm;
  std::vector<Eigen::Vector3i> corners;

  std::int32_t add_vertex(const Eigen::Vector3f& place_mm) {
    places_mm.push_back(place_mm);
    return static_cast<std::int32_t>(places_mm.size()) - 1;
  }
  std::array<std::vector<std::int32_t>, 2> eyeballs(std::span<const std::uint8_t> is_eye) const {
    mesh::Vertices vertices_mm(3, static_cast<Eigen::Index>(places_mm.size()));
    mesh::Triangles triangles(3, static_cast<Eigen::Index>(corners.size()));
    for (Eigen::Index i = 0; i < vertices_mm.cols(); ++i) {
      vertices_mm.col(i) = places_mm[static_cast<std::size_t>(i)];
    }
    for (Eigen::Index i = 0; i < triangles.cols(); ++i) {
      triangles.col(i) = corners[static_cast<std::size_t>(i)];
    }
    return find_eyeballs(vertices_mm, triangles, is_eye);
  }
  /// Returns the number of its vertices.
  int add_ball(const Eigen::Vector3f& centre_mm, int steps) {
    std::vector<std::int32_t> ring;
    const std::int32_t top = add_vertex(centre_mm + Eigen::Vector3f(0, 12, 0));
    const std::int32_t bottom = add_vertex(centre_mm - Eigen::Vector3f(0, 12, 0));
    for (int i = 0; i < steps; ++i) {
      const float angle = 2 * std::numbers::pi_v<float> * static_cast<float>(i) / static_cast<float>(steps);
      ring.push_back(add_vertex(centre_mm + 12 * Eigen::Vector3f(std::sin(angle), 0, std::cos(angle))));
    }
    for (std::size_t i = 0; i < ring.size(); ++i) {
      corners.emplace_back(top, ring[i], ring[(i + 1) % ring.size()]);
      corners.emplace_back(bottom, ring[(i + 1) % ring.size()], ring[i]);
    }
    return steps + 2;
  }
};

TEST(Eyeballs, AreThePiecesOfEyesAlone) {
  Balls balls;
  const int skin = balls.add_ball({30, 0, -5}, 9);  // a lid that is joined to skin
  const int right = balls.add_ball({-31, 0, 0}, 8);
  const int left = balls.add_ball({31, 0, 0}, 7);
  balls.add_ball({28, 1, 0}, 5);  // a smaller one: a highlight
  std::vector<std::uint8_t> is_eye(balls.places_mm.size(), 1);
  is_eye[3] = 0;
  const auto eyeballs = balls.eyeballs(is_eye);
  std::vector<std::int32_t> wanted(static_cast<std::size_t>(left));
  std::iota(wanted.begin(), wanted.end(), skin + right);
  EXPECT_EQ(eyeballs[0], wanted);
  wanted.resize(static_cast<std::size_t>(right));
  std::iota(wanted.begin(), wanted.end(), skin);
  EXPECT_EQ(eyeballs[1], wanted);
  // Vertices that are not known go with their piece; a piece of which nothing is known is no eye.
  is_eye.resize(static_cast<std::size_t>(skin + 1));
  const auto known = balls.eyeballs(is_eye);
  EXPECT_THAT(known[0], IsEmpty());
  EXPECT_EQ(known[1], wanted);
}

/// What Assimp writes of a triangle with a shape that moves.
std::vector<std::byte> some_fbx() {
  aiScene scene;
  scene.mRootNode = new aiNode("root");
  auto* mesh = new aiMesh;
  mesh->mNumVertices = 3;
  mesh->mVertices = new aiVector3D[3]{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  mesh->mNumFaces = 1;
  mesh->mFaces = new aiFace[1];
  mesh->mFaces[0].mNumIndices = 3;
  mesh->mFaces[0].mIndices = new unsigned[3]{0, 1, 2};
  scene.mMeshes = new aiMesh* [1] { mesh };
  scene.mNumMeshes = 1;
  scene.mMaterials = new aiMaterial* [1] { new aiMaterial };
  scene.mNumMaterials = 1;
  Assimp::Exporter exporter;
  const aiExportDataBlob* blob = exporter.ExportToBlob(&scene, "fbx");
  EXPECT_NE(blob, nullptr) << exporter.GetErrorString();
  const auto* bytes = static_cast<const std::byte*>(blob->data);
  return {bytes, bytes + blob->size};
}

void expect_same(const FbxRecord& a, const FbxRecord& b) {
  EXPECT_EQ(a.name, b.name);
  EXPECT_EQ(a.property_count, b.property_count) << a.name;
  EXPECT_EQ(a.properties, b.properties) << a.name;
  ASSERT_EQ(a.children.size(), b.children.size()) << a.name;
  for (std::size_t i = 0; i < a.children.size(); ++i) {
    expect_same(a.children[i], b.children[i]);
  }
}

TEST(FbxDocument, ComesOutAsItWentIn) {
  const FbxDocument document(some_fbx());
  const std::vector<std::byte> bytes = document.bytes();
  const FbxDocument again(bytes);
  EXPECT_GT(again.root.children.size(), 5U);
  expect_same(document.root, again.root);
  EXPECT_EQ(again.bytes(), bytes);
}

TEST(FbxDocument, ARecordIsAdded) {
  FbxDocument document(some_fbx());
  constexpr std::array<float, 3> kValues = {1, 2.5F, -3};
  document.root.find("Objects")
      .child("Some")
      .add(std::int64_t{77})
      .add("text")
      .add(std::span<const float>(kValues));
  FbxDocument again(document.bytes());
  const FbxRecord& some = again.root.find("Objects").find("Some");
  const auto properties = some.split_properties();
  ASSERT_EQ(properties.size(), 3U);
  EXPECT_EQ(fbx_integer(properties[0]), 77);
  EXPECT_EQ(fbx_text(properties[1]), "text");
  std::array<float, 3> values{};
  ASSERT_EQ(properties[2].size(), 13 + sizeof(values));
  std::memcpy(values.data(), properties[2].data() + 13, sizeof(values));
  EXPECT_EQ(values, kValues);
  EXPECT_THROW(fbx_integer(properties[1]), Error);
  EXPECT_THROW(again.root.find("Elsewhere"), Error);
}

TEST(FbxDocument, WhatIsCutShortOrOlderIsRefused) {
  const std::vector<std::byte> bytes = some_fbx();
  for (std::size_t length = 0; length < bytes.size(); length += 97) {
    EXPECT_THROW(FbxDocument(std::span(bytes).first(length)), Error) << length;
  }
  std::vector<std::byte> older = bytes;
  older[24] = std::byte{0x1C};  // 7400 = 0x1CE8
  older[23] = std::byte{0xE8};
  EXPECT_THROW(FbxDocument{older}, Error);
}

/// Of the default model; skipped where that is not there.
class Expressions : public ExportPeers {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(test::default_model())) {
      GTEST_SKIP() << test::default_model() << " is not there: packaging/prepare makes it";
    }
  }
  void export_as(const std::string& take, const std::string& format, const std::string& name,
                 const std::string& frames = ":") {
    ASSERT_EQ(run({"export", take, "--format", format, "--size", "256", "--frames", frames, "--model",
                   test::default_model().string(), "-o", file(name)}),
              0)
        << output_;
  }
  /// The numbers of an accessor that an animation of a GLB gives a node.
  std::vector<float> channel(const avatar::GlbDocument& glb, const std::string& node,
                             const std::string& path) const {
    for (const auto& entry : glb.json["animations"][0]["channels"]) {
      const auto& target = entry["target"];
      if (glb.json["nodes"][target["node"].get<std::size_t>()]["name"] == node && target["path"] == path) {
        const auto& sampler = glb.json["animations"][0]["samplers"][entry["sampler"].get<std::size_t>()];
        const auto& accessor = glb.json["accessors"][sampler["output"].get<std::size_t>()];
        const auto& view = glb.json["bufferViews"][accessor["bufferView"].get<std::size_t>()];
        std::vector<float> values(view["byteLength"].get<std::size_t>() / 4);
        std::memcpy(values.data(), glb.binary.data() + view["byteOffset"].get<std::size_t>(),
                    4 * values.size());
        return values;
      }
    }
    ADD_FAILURE() << "nothing animates " << path << " of " << node;
    return {};
  }
};

TEST_F(Expressions, EyesTurnAsLiveLinkSays) {
  const face::FaceModel model = face::FaceModel::load(test::default_model());
  const std::string person = model_take(model, 5);
  std::vector<mesh::MeshFrame> frames;
  take::TakeReader reader(person);
  const std::vector<std::pair<std::string, float>> looks = {{"eyeLookOutLeft", 1.0F},
                                                            {"eyeLookInLeft", 0.5F},
                                                            {"eyeLookUpRight", 1.0F},
                                                            {"eyeLookDownRight", 0.4F}};
  for (std::size_t i = 0; i < looks.size(); ++i) {
    mesh::MeshFrame frame = *reader.frame(static_cast<std::int64_t>(i));
    frame.expression.assign(frame.expression.size(), 0.0F);
    frame.expression[static_cast<std::size_t>(model.expression_index(looks[i].first))] = looks[i].second;
    model.evaluate(frame.subject->identity, frame.expression, frame.control_vertices_mm);
    frames.push_back(frame);
  }
  const std::string take = record("looks.take", frames);
  export_as(take, "glb-expressions", "looks.glb");
  const avatar::GlbDocument glb = avatar::read_glb(file("looks.glb"));
  EXPECT_EQ(glb.json["nodes"][0]["children"], nlohmann::ordered_json({1, 2}));
  for (const auto& [node, first] : {std::pair{"eyeLeft", 3U}, {"eyeRight", 6U}}) {
    const std::vector<float> turns = channel(glb, node, "rotation");
    ASSERT_EQ(turns.size(), 4 * looks.size());
    for (std::size_t i = 0; i < looks.size(); ++i) {
      const auto angles = mesh::live_link_rotations(
          mesh::arkit_values(model.expression_names, frames[i].expression), Eigen::Matrix3f::Identity());
      const Eigen::Quaternionf turn{Eigen::Map<const Eigen::Vector4f>(&turns[4 * i])};
      // Where the eye looks: yaw to the subject's right, pitch down.
      const Eigen::Vector3f gaze = turn * Eigen::Vector3f::UnitZ();
      constexpr float kTolerance_rad = 0.01F;  // a blend of shapes is not quite in proportion
      EXPECT_NEAR(-std::atan2(gaze.x(), gaze.z()), angles.at(first), kTolerance_rad)
          << looks[i].first << node;
      EXPECT_NEAR(-std::asin(gaze.y()), angles.at(first + 1), kTolerance_rad) << looks[i].first << node;
    }
  }
  for (std::size_t eye = 1; eye < 3; ++eye) {
    EXPECT_THAT(glb.json["meshes"][eye]["extras"]["targetNames"].dump(),
                AllOf(HasSubstr("eyeLookUp"), Not(HasSubstr("jawOpen")), Not(HasSubstr("eyeBlink"))));
  }
}

TEST_F(Expressions, AssimpReadsShapesAndCurvesOfAnFbx) {
  const std::string take = model_take(face::FaceModel::load(test::default_model()), 11);
  export_as(take, "fbx", "a.fbx");
  write_curves(take);
  const auto curves = nlohmann::json::parse(std::ifstream(file("curves.json")));
  Assimp::Importer importer;
  const aiScene* scene = importer.ReadFile(file("a.fbx"), 0);
  ASSERT_NE(scene, nullptr) << importer.GetErrorString();
  ASSERT_EQ(scene->mNumMeshes, 1U);
  const std::vector<std::string> names = curves["names"];
  ASSERT_EQ(scene->mMeshes[0]->mNumAnimMeshes, names.size());
  EXPECT_TRUE(scene->mMeshes[0]->HasTextureCoords(0));
  EXPECT_FALSE(scene->mMeshes[0]->HasVertexColors(0)) << "it has a picture";
  EXPECT_EQ(scene->mNumTextures, 1U);
  ASSERT_EQ(scene->mNumAnimations, 1U);
  ASSERT_EQ(scene->mAnimations[0]->mNumMorphMeshChannels, 1U);
  const aiMeshMorphAnim& morphs = *scene->mAnimations[0]->mMorphMeshChannels[0];
  ASSERT_EQ(morphs.mNumKeys, 4U);
  for (unsigned key = 0; key < 4; ++key) {
    const std::vector<float> weights = curves["weights"][std::to_string(100 + key)];
    ASSERT_EQ(morphs.mKeys[key].mNumValuesAndWeights, weights.size());
    for (unsigned i = 0; i < weights.size(); ++i) {
      const unsigned shape = morphs.mKeys[key].mValues[i];
      const std::string name = scene->mMeshes[0]->mAnimMeshes[shape]->mName.C_Str();
      const auto at = std::find(names.begin(), names.end(), name) - names.begin();
      ASSERT_LT(at, std::ssize(names)) << name;
      EXPECT_NEAR(morphs.mKeys[key].mWeights[i], weights.at(static_cast<std::size_t>(at)), 1e-5) << name;
    }
  }
}

TEST_F(Expressions, TinyUsdzReadsBlendShapes) {
  const std::filesystem::path reader = test::assets() / "tinyusdz";
  if (program("node").empty() || !std::filesystem::exists(reader)) {
    GTEST_SKIP() << "Node.js or " << reader << " is not there (packaging/fetch-assets)";
  }
  export_all();
  EXPECT_EQ(run_node({script("check-usda-skel.mjs"), std::filesystem::absolute(reader).string(),
                      file("expressions.usda"), file("coarse"), file("curves.json")}),
            0)
      << output_;
  std::cout << output_;
}

TEST_F(Expressions, AFrameOfUsdIsSmall) {
  const std::string take = model_take(face::FaceModel::load(test::default_model()), 3);
  export_as(take, "usda", "all.usda");
  export_as(take, "usda", "one.usda", "100:101");
  const auto sizes =
      std::pair(std::filesystem::file_size(file("all.usda")), std::filesystem::file_size(file("one.usda")));
  EXPECT_GT(sizes.first, sizes.second);
  EXPECT_LT((sizes.first - sizes.second) / 3, 2048U) << "bytes a frame";
}

TEST_F(Expressions, ATakeWithoutThemIsTold) {
  for (const std::string& take : {script("golden/booth.take"), patch_take()}) {
    for (const std::string format : {"fbx", "usda"}) {
      EXPECT_EQ(run({"export", take, "--format", format, "--model", test::default_model().string(), "-o",
                     file("a." + format)}),
                2);
      EXPECT_THAT(output_, AllOf(HasSubstr(take), HasSubstr("usda-frames do without expressions")));
      EXPECT_FALSE(std::filesystem::exists(file("a." + format)));
    }
  }
}

}  // namespace
}  // namespace facet::exports
