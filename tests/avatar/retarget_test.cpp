#include "avatar/retarget.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <fstream>
#include <iterator>

#include "facet/error.hpp"
#include "support/paths.hpp"

namespace facet::avatar {
namespace {

using Json = nlohmann::ordered_json;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// A GLB with a JSON and a binary chunk.
std::string glb_bytes(const std::string& text, const std::string& binary = {}) {
  const auto word = [](std::size_t value) {
    const auto number = static_cast<std::uint32_t>(value);
    std::string bytes(4, '\0');
    std::memcpy(bytes.data(), &number, 4);
    return bytes;
  };
  std::string json = text;
  json.resize((json.size() + 3) / 4 * 4, ' ');
  std::string out = "glTF" + word(2) + word(28 + json.size() + binary.size()) + word(json.size()) + "JSON" +
                    json + word(binary.size()) + std::string("BIN\0", 4) + binary;
  return out;
}

GlbDocument parse(const std::string& bytes) {
  return parse_glb(std::as_bytes(std::span(bytes)), "avatar.glb");
}

/// An avatar whose head hangs on a neck that leans by 90 degrees about x, with two meshes.
Json avatar_json() {
  return Json::parse(R"({
    "asset": {"version": "2.0"}, "extensionsUsed": ["KHR_of_another"], "extras": {"kept": 1.5},
    "buffers": [{"byteLength": 5}],
    "nodes": [{"name": "Neck", "rotation": [0.70710678, 0, 0, 0.70710678], "children": [1]},
              {"name": "mixamorig:Head", "translation": [0, 1, 0]},
              {"name": "Face", "mesh": 0}, {"name": "Teeth", "mesh": 1}, {"name": "Shirt", "mesh": 2}],
    "meshes": [{"primitives": [{"targets": [{}, {}, {}]}], "weights": [0, 0.5, 0],
                "extras": {"targetNames": ["eyeBlink_L", "hat", "face.JawOpen"]}},
               {"primitives": [{"targets": [{}]}], "extras": {"targetNames": ["jawopen"]}},
               {"primitives": [{}]}]})");
}

FaceState state(float jaw, float yaw) {
  FaceState out;
  out.tracked = true;
  out.values.at(static_cast<std::size_t>(mesh::arkit_index("jawOpen"))) = jaw;
  out.upright_from_head.linear() = Eigen::AngleAxisf(yaw, Eigen::Vector3f::UnitY()).toRotationMatrix();
  return out;
}

/// The floats of an accessor.
std::vector<float> floats(const GlbDocument& glb, std::size_t accessor) {
  const Json& view =
      glb.json["bufferViews"][glb.json["accessors"][accessor]["bufferView"].get<std::size_t>()];
  std::vector<float> values(view["byteLength"].get<std::size_t>() / sizeof(float));
  std::memcpy(values.data(), glb.binary.data() + view["byteOffset"].get<std::size_t>(),
              values.size() * sizeof(float));
  return values;
}

TEST(AvatarFile, KeepsWhatItDoesNotKnow) {
  const GlbDocument glb = parse(glb_bytes(avatar_json().dump(), "12345678"));
  EXPECT_EQ(glb.json, avatar_json());
  EXPECT_EQ(glb.binary.size(), 5U);
  const test::TemporaryFolder folder;
  write_glb(glb, folder.path() / "a.glb");
  const GlbDocument again = read_glb(folder.path() / "a.glb");
  EXPECT_EQ(again.json, glb.json);
  EXPECT_EQ(again.binary, glb.binary);
}

TEST(AvatarFile, WhatIsNoneIsNamed) {
  const std::string sound = glb_bytes(avatar_json().dump(), "12345678");
  const auto fault = [](const std::string& bytes) -> std::string {
    try {
      inspect_avatar(parse(bytes), std::nullopt);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      return error.what();
    }
    return "none";
  };
  EXPECT_EQ(fault(sound), "none");
  EXPECT_THAT(fault(""), HasSubstr("avatar.glb: it is no GLB file"));
  EXPECT_THAT(fault("{\"asset\": {}}"), HasSubstr("no GLB file"));
  for (std::size_t length = 12; length < sound.size(); length += 7) {
    EXPECT_NE(fault(sound.substr(0, length)), "none") << length;
  }
  EXPECT_THAT(fault(glb_bytes("[]")), HasSubstr("no object"));
  EXPECT_THAT(fault(glb_bytes(std::string(5000, '['))), HasSubstr("nests deeper than 100 levels"));
  const auto changed = [&](const std::string& pointer, const Json& value) {
    Json json = avatar_json();
    json[Json::json_pointer(pointer)] = value;
    return fault(glb_bytes(json.dump(), "12345678"));
  };
  EXPECT_THAT(changed("/buffers/0/uri", "face.bin"), HasSubstr("in another file"));
  EXPECT_THAT(changed("/buffers/0/byteLength", 9), HasSubstr("cut off"));
  EXPECT_NE(changed("/nodes/0/children/0", 99), "none");
  EXPECT_THAT(changed("/nodes/1/children", Json::array({0})), HasSubstr("circle"));
  EXPECT_NE(changed("/nodes/0/rotation", {0, 0, 0, 0}), "none");
  EXPECT_NE(changed("/nodes/2/mesh", -1), "none");
  EXPECT_NE(changed("/nodes/2/mesh", 3), "none");
  EXPECT_NE(changed("/meshes/0/primitives", Json::array()), "none");
  EXPECT_NE(changed("/meshes/0/extras/targetNames/0", 7), "none");
  EXPECT_NE(changed("/meshes", "x"), "none");
}

TEST(Retarget, FindsShapesAndHead) {
  const Avatar avatar = inspect_avatar(parse(glb_bytes(avatar_json().dump(), "12345678")), std::nullopt);
  ASSERT_EQ(avatar.meshes.size(), 2U);
  EXPECT_THAT(avatar.meshes[0].shapes,
              ElementsAre(mesh::arkit_index("EyeBlinkLeft"), -1, mesh::arkit_index("JawOpen")));
  EXPECT_THAT(avatar.meshes[0].nodes, ElementsAre(2U));
  EXPECT_THAT(avatar.meshes[1].shapes, ElementsAre(mesh::arkit_index("JawOpen")));
  EXPECT_THAT(avatar.shape_names, ElementsAre("eyeBlink_L", "hat", "face.JawOpen", "jawopen"));
  EXPECT_EQ(avatar.head, 1U);
  EXPECT_FALSE(avatar.faces_backwards);
  EXPECT_THAT(missing_shapes(avatar, {0, 17, 51}), ElementsAre(51U));
}

TEST(Retarget, AskedForHeadsAndVrms) {
  const std::string plain = glb_bytes(avatar_json().dump(), "12345678");
  EXPECT_EQ(inspect_avatar(parse(plain), "Neck").head, 0U);
  try {
    inspect_avatar(parse(plain), "Skull");
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    EXPECT_THAT(error.what(), HasSubstr("no node 'Skull'; it has 'Neck', 'mixamorig:Head'"));
  }
  Json vrm = avatar_json();
  vrm["extensions"]["VRM"]["humanoid"]["humanBones"] = {{{"bone", "hips"}, {"node", 2}},
                                                        {{"bone", "head"}, {"node", 0}}};
  const Avatar old = inspect_avatar(parse(glb_bytes(vrm.dump(), "12345678")), std::nullopt);
  EXPECT_EQ(old.head, 0U);
  EXPECT_TRUE(old.faces_backwards);
  vrm["extensions"] = {{"VRMC_vrm", {{"humanoid", {{"humanBones", {{"head", {{"node", 3}}}}}}}}}};
  EXPECT_EQ(inspect_avatar(parse(glb_bytes(vrm.dump(), "12345678")), std::nullopt).head, 3U);
}

TEST(Retarget, AnimatesWeightsAndHead) {
  GlbDocument glb = parse(glb_bytes(avatar_json().dump(), "12345678"));
  const Avatar avatar = inspect_avatar(glb, std::nullopt);
  add_animation(glb, avatar, {state(0.25F, 0), state(0.75F, 0.4F)}, {0, 0.5F}, true);
  const Json& animation = glb.json["animations"][0];
  ASSERT_EQ(animation["channels"].size(), 3U);
  const auto output = [&](std::size_t channel) {
    const auto sampler = animation["channels"][channel]["sampler"].get<std::size_t>();
    return floats(glb, animation["samplers"][sampler]["output"].get<std::size_t>());
  };
  EXPECT_EQ(animation["channels"][0]["target"], Json::parse(R"({"node": 2, "path": "weights"})"));
  EXPECT_THAT(output(0), ElementsAre(0, 0.5F, 0.25F, 0, 0.5F, 0.75F)) << "the hat stays as it is";
  EXPECT_THAT(output(1), ElementsAre(0.25F, 0.75F));
  EXPECT_EQ(animation["channels"][2]["target"], Json::parse(R"({"node": 1, "path": "rotation"})"));
  const std::vector<float> turns = output(2);
  ASSERT_EQ(turns.size(), 8U);
  EXPECT_NEAR(turns[3], 1, 1e-5F) << "at rest";
  // In the world the head turns about y, whatever its parent does.
  const Eigen::Quaternionf neck(0.70710678F, 0.70710678F, 0, 0);
  const Eigen::Quaternionf local(turns[7], turns[4], turns[5], turns[6]);
  const Eigen::Quaternionf world = neck * local * neck.conjugate();
  EXPECT_NEAR(world.y(), std::sin(0.2F), 1e-5F);
  EXPECT_NEAR(std::hypot(world.x(), world.z()), 0, 1e-5F);
  EXPECT_EQ(glb.json["buffers"][0]["byteLength"], glb.binary.size());
  EXPECT_EQ(glb.json["extras"]["kept"], 1.5);
}

TEST(Retarget, AnAvatarThatLooksBackwardsTurnsToItsOwnLeft) {
  Json vrm = avatar_json();
  vrm["nodes"][0]["rotation"] = {0, 0, 0, 1};
  vrm["extensions"]["VRM"]["humanoid"]["humanBones"] = {{{"bone", "head"}, {"node", 1}}};
  GlbDocument glb = parse(glb_bytes(vrm.dump(), "12345678"));
  FaceState nod = state(0, 0);
  nod.upright_from_head.linear() = Eigen::AngleAxisf(0.4F, Eigen::Vector3f::UnitX()).toRotationMatrix();
  add_animation(glb, inspect_avatar(glb, std::nullopt), {state(0, 0.4F), nod}, {0, 0.5F}, true);
  const std::vector<float> turns = floats(glb, glb.json["accessors"].size() - 1);
  EXPECT_NEAR(turns[1], std::sin(0.2F), 1e-5F) << "about y it is the same";
  EXPECT_NEAR(turns[4], -std::sin(0.2F), 1e-5F) << "down is the other way about x";
}

}  // namespace
}  // namespace facet::avatar
