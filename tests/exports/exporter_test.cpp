#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "exports/export.hpp"
#include "facet/error.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"

namespace facet::exports {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

std::string read_file(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

template <typename T>
T take_value(const std::string& bytes, std::size_t& at) {
  T value{};
  std::memcpy(&value, bytes.data() + at, sizeof(T));
  at += sizeof(T);
  return value;
}

class Exporter : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  std::shared_ptr<const mesh::Subject> subject = test::patch_subject();
  mesh::MeshFrame frame = test::patch_frame(3, subject, test::patch_albedo(*subject));

  ExportMesh mesh_of(MeshLevel level) const {
    ExportMesh out;
    build_export_mesh(frame, level, MeshSpace::Camera, out);
    return out;
  }
};

TEST_F(Exporter, FinestMeshIsTheRebuiltOneInTheCameraFrame) {
  const ExportMesh mesh = mesh_of(MeshLevel::Finest);
  mesh::Vertices head_mm;
  Eigen::Matrix3Xf head_normals;
  mesh::rebuild_finest(*subject->hierarchy, frame.control_vertices_mm, frame.displacements_mm, head_mm,
                       head_normals);
  ASSERT_EQ(mesh.vertices_mm.cols(), head_mm.cols());
  for (Eigen::Index i = 0; i < head_mm.cols(); ++i) {
    EXPECT_LT((mesh.vertices_mm.col(i) - frame.camera_from_head * Eigen::Vector3f(head_mm.col(i))).norm(),
              1e-3F);
    EXPECT_NEAR(mesh.normals.col(i).norm(), 1.0F, 1e-5F);
    EXPECT_LT(mesh.normals.col(i).dot(mesh.vertices_mm.col(i)), 0) << "the patch faces the camera";
  }
  EXPECT_EQ(mesh.displacements_mm, frame.displacements_mm);
  EXPECT_EQ(mesh.confidence, frame.confidence);
  EXPECT_EQ(mesh.albedo.cols(), mesh.vertices_mm.cols());
}

TEST_F(Exporter, CoarseMeshIsLevelZeroWithoutDisplacements) {
  const ExportMesh mesh = mesh_of(MeshLevel::Coarse);
  const mesh::Level& level = subject->hierarchy->levels.front();
  EXPECT_EQ(mesh.vertices_mm.cols(), level.vertex_count);
  EXPECT_EQ(mesh.triangles, level.triangles);
  EXPECT_THAT(mesh.displacements_mm, testing::Each(0.0F));
  // The same vertices of the finest level lie within a displacement and the subdivision's smoothing.
  const ExportMesh finest = mesh_of(MeshLevel::Finest);
  EXPECT_LT((finest.vertices_mm.leftCols(level.vertex_count) - mesh.vertices_mm).colwise().norm().maxCoeff(),
            8.0F);
  EXPECT_EQ(mesh.albedo, finest.albedo.leftCols(level.vertex_count));
}

TEST_F(Exporter, FrameWithoutMeshHasNone) {
  EXPECT_FALSE(mesh::has_mesh(test::searching_frame(0)));
  EXPECT_TRUE(mesh::has_mesh(frame));
}

class EitherAxes : public Exporter, public testing::WithParamInterface<MeshAxes> {
 protected:
  /// A mesh as it was made, with the numbers that a file of these axes must have.
  ExportMesh as_written(const ExportMesh& mesh) const {
    ExportMesh out = mesh;
    if (GetParam() == MeshAxes::Upright) {
      out.vertices_mm.bottomRows<2>() *= -1;
      out.vertices_mm *= 0.001F;
      out.normals.bottomRows<2>() *= -1;
    }
    return out;
  }
};
INSTANTIATE_TEST_SUITE_P(Axes, EitherAxes, testing::Values(MeshAxes::Upright, MeshAxes::Camera),
                         [](const auto& of) { return of.param == MeshAxes::Upright ? "Upright" : "Camera"; });

float srgb_of(double linear) {
  return static_cast<float>(linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055);
}

TEST_P(EitherAxes, PlyReadsBack) {
  const ExportMesh made = mesh_of(MeshLevel::Finest);
  const ExportMesh mesh = as_written(made);
  write_ply(made, folder.path() / "a.ply", GetParam());
  const std::string bytes = read_file(folder.path() / "a.ply");
  EXPECT_THAT(bytes,
              HasSubstr(GetParam() == MeshAxes::Upright ? "Facet: metres" : "Facet: camera frame, mi"));
  const std::size_t body = bytes.find("end_header\n") + 11;
  const std::string header = bytes.substr(0, body);
  EXPECT_EQ(header.rfind("ply\nformat binary_little_endian 1.0\n", 0), 0U);
  std::vector<std::string> properties;
  std::size_t vertex_count = 0;
  std::size_t face_count = 0;
  std::istringstream lines(header);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string word;
    std::string type;
    std::string name;
    words >> word >> type >> name;
    if (word == "element") {
      (type == "vertex" ? vertex_count : face_count) = std::stoul(name);
    } else if (word == "property") {
      properties.push_back(type == "list" ? "faces" : name);
    }
  }
  EXPECT_THAT(properties, ElementsAre("x", "y", "z", "nx", "ny", "nz", "s", "t", "red", "green", "blue",
                                      "displacement_mm", "confidence", "faces"));
  ASSERT_EQ(vertex_count, static_cast<std::size_t>(mesh.vertices_mm.cols()));
  ASSERT_EQ(face_count, static_cast<std::size_t>(mesh.triangles.cols()));
  ASSERT_EQ(bytes.size(), body + vertex_count * 43 + face_count * 13);
  std::size_t at = body;
  for (std::size_t i = 0; i < vertex_count; ++i) {
    const auto column = static_cast<Eigen::Index>(i);
    for (int axis = 0; axis < 3; ++axis) {
      ASSERT_FLOAT_EQ(take_value<float>(bytes, at), mesh.vertices_mm(axis, column));
    }
    for (int axis = 0; axis < 3; ++axis) {
      ASSERT_EQ(take_value<float>(bytes, at), mesh.normals(axis, column));
    }
    at += 2 * sizeof(float);
    for (int channel = 0; channel < 3; ++channel) {
      const float srgb = srgb_of(mesh.albedo(channel, column));
      ASSERT_NEAR(take_value<std::uint8_t>(bytes, at), 255 * srgb, 0.51);
    }
    ASSERT_EQ(take_value<float>(bytes, at), mesh.displacements_mm[i]);
    ASSERT_EQ(take_value<float>(bytes, at), mesh.confidence[i]);
  }
  for (std::size_t i = 0; i < face_count; ++i) {
    ASSERT_EQ(take_value<std::uint8_t>(bytes, at), 3);
    for (int corner = 0; corner < 3; ++corner) {
      ASSERT_EQ(take_value<std::int32_t>(bytes, at), mesh.triangles(corner, static_cast<Eigen::Index>(i)));
    }
  }
}

TEST_F(Exporter, PlyBeforeTheAlbedoIsGrey) {
  frame.albedo = nullptr;
  frame.displacements_mm.clear();
  frame.confidence.clear();
  const ExportMesh mesh = mesh_of(MeshLevel::Finest);
  EXPECT_EQ(mesh.albedo.cols(), 0);
  EXPECT_THAT(mesh.confidence, testing::Each(0.0F));
  write_ply(mesh, folder.path() / "a.ply", MeshAxes::Upright);
  EXPECT_THAT(read_file(folder.path() / "a.ply"), HasSubstr("not learned yet"));
}

TEST_P(EitherAxes, ObjReadsBack) {
  const ExportMesh made = mesh_of(MeshLevel::Coarse);
  const ExportMesh mesh = as_written(made);
  const float tolerance = GetParam() == MeshAxes::Upright ? 1e-7F : 1e-4F;
  write_obj(made, folder.path() / "a.obj", GetParam());
  EXPECT_THAT(read_file(folder.path() / "a.obj"), HasSubstr("r g b: albedo, sRGB"));
  std::map<std::string, Eigen::Index> counts;
  std::istringstream lines(read_file(folder.path() / "a.obj"));
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string kind;
    words >> kind;
    const Eigen::Index i = counts[kind]++;
    if (kind == "v" || kind == "vn") {
      const auto& expected = kind == "v" ? mesh.vertices_mm : mesh.normals;
      for (int axis = 0; axis < 3; ++axis) {
        float value = 0;
        words >> value;
        ASSERT_NEAR(value, expected(axis, i), kind == "v" ? tolerance : 1e-4F);
      }
      for (int channel = 0; kind == "v" && channel < 3; ++channel) {
        float value = 0;
        words >> value;
        ASSERT_NEAR(value, srgb_of(std::clamp(mesh.albedo(channel, i), 0.0F, 1.0F)), 1e-4F);
      }
    } else if (kind == "f") {
      for (int corner = 0; corner < 3; ++corner) {
        std::string indices;
        words >> indices;
        const std::string number = std::to_string(mesh.triangles(corner, i) + 1);
        ASSERT_EQ(indices, number + "/" + number + "/" + number);
      }
    }
  }
  EXPECT_EQ(counts["v"], mesh.vertices_mm.cols());
  EXPECT_EQ(counts["vt"], mesh.vertices_mm.cols());
  EXPECT_EQ(counts["vn"], mesh.vertices_mm.cols());
  EXPECT_EQ(counts["f"], mesh.triangles.cols());
}

TEST_F(Exporter, GlbHasSoundStructureAndMetresWithYUp) {
  const ExportMesh mesh = mesh_of(MeshLevel::Finest);
  write_glb(mesh, folder.path() / "a.glb");
  const std::string bytes = read_file(folder.path() / "a.glb");
  std::size_t at = 0;
  EXPECT_EQ(bytes.substr(0, 4), "glTF");
  at = 4;
  EXPECT_EQ(take_value<std::uint32_t>(bytes, at), 2U);
  EXPECT_EQ(take_value<std::uint32_t>(bytes, at), bytes.size());
  const auto json_length = take_value<std::uint32_t>(bytes, at);
  EXPECT_EQ(json_length % 4, 0U);
  EXPECT_EQ(bytes.substr(at, 4), "JSON");
  at += 4;
  const auto document = nlohmann::json::parse(bytes.substr(at, json_length));
  at += json_length;
  const auto binary_length = take_value<std::uint32_t>(bytes, at);
  EXPECT_EQ(bytes.substr(at, 4), std::string("BIN\0", 4));
  at += 4;
  ASSERT_EQ(at + binary_length, bytes.size());
  const std::string binary = bytes.substr(at);
  EXPECT_EQ(document["asset"]["version"], "2.0");
  EXPECT_EQ(document["buffers"][0]["byteLength"], binary_length);

  const std::map<std::string, std::size_t> widths = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}};
  const auto bytes_of = [&](const nlohmann::json& accessor) {
    const auto& view = document["bufferViews"][accessor["bufferView"].get<std::size_t>()];
    const auto offset = view["byteOffset"].get<std::size_t>();
    const auto length = view["byteLength"].get<std::size_t>();
    EXPECT_EQ(offset % 4, 0U);
    EXPECT_LE(offset + length, binary.size());
    EXPECT_EQ(length, 4 * widths.at(accessor["type"]) * accessor["count"].get<std::size_t>());
    return binary.substr(offset, length);
  };
  const auto& primitive = document["meshes"][0]["primitives"][0];
  const auto vertex_count = static_cast<std::size_t>(mesh.vertices_mm.cols());
  for (const auto& [name, index] : primitive["attributes"].items()) {
    const auto& accessor = document["accessors"][index.get<std::size_t>()];
    EXPECT_EQ(accessor["count"], vertex_count) << name;
    EXPECT_EQ(accessor["componentType"], 5126) << name;
    bytes_of(accessor);
  }
  const auto& positions = document["accessors"][primitive["attributes"]["POSITION"].get<std::size_t>()];
  const std::string position_bytes = bytes_of(positions);
  std::size_t read = 0;
  Eigen::Vector3f low = Eigen::Vector3f::Constant(1e9F);
  Eigen::Vector3f high = -low;
  for (std::size_t i = 0; i < vertex_count; ++i) {
    Eigen::Vector3f got;
    for (int axis = 0; axis < 3; ++axis) {
      got[axis] = take_value<float>(position_bytes, read);
    }
    low = low.cwiseMin(got);
    high = high.cwiseMax(got);
    const Eigen::Vector3f sent = mesh.vertices_mm.col(static_cast<Eigen::Index>(i));
    ASSERT_LT((got - 0.001F * Eigen::Vector3f(sent.x(), -sent.y(), -sent.z())).norm(), 1e-6F);
  }
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_FLOAT_EQ(positions["min"][static_cast<std::size_t>(axis)], low[axis]);
    EXPECT_FLOAT_EQ(positions["max"][static_cast<std::size_t>(axis)], high[axis]);
  }
  const std::string index_bytes = bytes_of(document["accessors"][primitive["indices"].get<std::size_t>()]);
  read = 0;
  for (Eigen::Index i = 0; i < mesh.triangles.size(); ++i) {
    ASSERT_EQ(take_value<std::uint32_t>(index_bytes, read),
              static_cast<std::uint32_t>(mesh.triangles.data()[i]));
  }
}

TEST_F(Exporter, GlbShowsAPictureOrColoursButNeverBoth) {
  ExportMesh mesh = mesh_of(MeshLevel::Coarse);
  const std::string png = "no picture, but its bytes";  // of a length that is no multiple of 4
  for (const bool picture : {false, true}) {
    if (picture) {
      mesh.skin_png = std::make_shared<const std::vector<std::uint8_t>>(png.begin(), png.end());
    }
    write_glb(mesh, folder.path() / "a.glb");
    const std::string bytes = read_file(folder.path() / "a.glb");
    std::size_t at = 12;
    const auto json_length = take_value<std::uint32_t>(bytes, at);
    const auto document = nlohmann::json::parse(bytes.substr(20, json_length));
    const auto& attributes = document["meshes"][0]["primitives"][0]["attributes"];
    const auto& look = document["materials"][0]["pbrMetallicRoughness"];
    EXPECT_EQ(attributes.contains("COLOR_0"), !picture) << "the format multiplies them";
    EXPECT_EQ(look.contains("baseColorTexture"), picture);
    EXPECT_EQ(document.contains("images"), picture);
    if (picture) {
      const auto& view = document["bufferViews"][document["images"][0]["bufferView"].get<std::size_t>()];
      EXPECT_EQ(bytes.substr(28 + json_length + view["byteOffset"].get<std::size_t>(),
                             view["byteLength"].get<std::size_t>()),
                png);
      EXPECT_EQ(document["buffers"][0]["byteLength"].get<std::size_t>() % 4, 0U);
    }
  }
}

TEST_F(Exporter, FailedWriteLeavesTheEarlierFile) {
  const std::filesystem::path file = folder.path() / "a.ply";
  const ExportMesh mesh = mesh_of(MeshLevel::Coarse);
  write_ply(mesh, file, MeshAxes::Upright);
  const std::string before = read_file(file);
  try {
    write_ply(mesh, folder.path() / "missing" / "a.ply", MeshAxes::Upright);
    ADD_FAILURE() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    EXPECT_THAT(error.what(), HasSubstr("missing"));
  }
  EXPECT_EQ(read_file(file), before);
  int files = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder.path())) {
    ++files;
  }
  EXPECT_EQ(files, 1) << "temporary files were left behind";
}

TEST_F(Exporter, MoreFramesThanAGlbHoldsAreRefusedBeforeTheFirst) {
  SequenceFrame first;
  first.mesh = mesh_of(MeshLevel::Coarse);
  SequenceOptions options;
  options.file = folder.path() / "a.glb";
  const auto refused = [&](std::size_t frames, GlbCompression compression) -> std::string {
    options.timeline.sequences.resize(frames);
    options.compression = compression;
    try {
      open_glb_frames(options, first);
      return "";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
      return error.what();
    }
  };
  for (const GlbCompression compression : {GlbCompression::None, GlbCompression::Meshopt}) {
    EXPECT_EQ(refused(1, compression), "");
    EXPECT_EQ(refused(20'000, compression), "");
    EXPECT_THAT(refused(33'000, compression),
                testing::AllOf(HasSubstr("a.glb"), HasSubstr("--frames"), HasSubstr("usda-frames")));
  }
  // The same in larger meshes: 4000 frames of 50,000 vertices.
  first.mesh.vertices_mm.setZero(3, 50'000);
  first.mesh.normals.setZero(3, 50'000);
  first.mesh.texture_coordinates.setZero(2, 50'000);
  first.mesh.albedo.setZero(3, 50'000);
  EXPECT_THAT(refused(4000, GlbCompression::None), HasSubstr("4.9 GB"));
  EXPECT_EQ(refused(3000, GlbCompression::None), "");
  EXPECT_EQ(refused(4000, GlbCompression::Meshopt), "");
  EXPECT_TRUE(std::filesystem::is_empty(folder.path())) << "files were left behind";
}

TEST_F(Exporter, JsonHasEveryPromisedField) {
  const auto json = nlohmann::json::parse(frame_json(frame, 12));
  EXPECT_EQ(json["index"], 12);
  EXPECT_EQ(json["sequence"], 3);
  EXPECT_EQ(json["timestamp_ns"], frame.timestamp_ns);
  EXPECT_EQ(json["state"], "tracking");
  EXPECT_EQ(json["camera"]["fx"], 1100.0);
  EXPECT_EQ(json["camera"]["width"], 1280);
  ASSERT_EQ(json["camera_from_head"].size(), 4U);
  EXPECT_FLOAT_EQ(json["camera_from_head"][2][3], 600.0F);
  EXPECT_EQ(json["camera_from_head"][3], nlohmann::json({0, 0, 0, 1}));
  EXPECT_FLOAT_EQ(json["expression"]["jawOpen"], frame.expression[0]);
  EXPECT_TRUE(json["model_weights"].empty()) << "the expression is them";
  EXPECT_TRUE(json["expression_confidence"].empty()) << "not known";
  mesh::MeshFrame believed = frame;
  believed.expression_confidence.assign(frame.expression.size(), 0.25F);
  EXPECT_EQ(nlohmann::json::parse(frame_json(believed, 12))["expression_confidence"]["jawOpen"], 0.25);
  EXPECT_EQ(json["identity"].size(), 4U);
  EXPECT_TRUE(json["person"].is_null());
  auto known = std::make_shared<mesh::Subject>(*frame.subject);
  known->person = "Ada";
  mesh::MeshFrame named = frame;
  named.subject = known;
  EXPECT_EQ(nlohmann::json::parse(frame_json(named, 12))["person"], "Ada");
  EXPECT_EQ(json["lighting"].size(), 9U);
  EXPECT_EQ(json["landmarks_px"].size(), 468U);
  EXPECT_FLOAT_EQ(json["landmarks_px"][7][1], frame.landmarks_px[7].y());
  EXPECT_FLOAT_EQ(json["photometric_rms"], frame.photometric_rms);
  EXPECT_FLOAT_EQ(json["stage_ms"]["landmarks"], 3.5F);
}

TEST_F(Exporter, JsonOfAFrameWithoutFace) {
  mesh::MeshFrame searching = test::searching_frame(1);
  searching.degraded_reason = "bad \xFF byte";
  const auto json = nlohmann::json::parse(frame_json(searching, 0));
  EXPECT_EQ(json["state"], "searching");
  EXPECT_TRUE(json["camera_from_head"].is_null());
  EXPECT_TRUE(json["expression"].empty());
  EXPECT_TRUE(json["identity"].empty());
  EXPECT_TRUE(json["person"].is_null());
  EXPECT_TRUE(json["photometric_rms"].is_null());
}

}  // namespace
}  // namespace facet::exports
