#include "simulation/truth_mesh.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <fstream>

#include "facet/error.hpp"
#include "simulation/random.hpp"
#include "support/paths.hpp"

namespace facet::simulation {
namespace {

TruthMesh small_mesh() {
  TruthMesh mesh;
  mesh.vertices_mm.resize(3, 4);
  mesh.vertices_mm << 0, 10, 10, 0,  //
      0, 0, 10, 10,                  //
      500, 501, 502, 503;
  mesh.normals = Eigen::Vector3f(0, 0, -1).replicate(1, 4);
  mesh.albedo = Eigen::Vector3f(0.5F, 0.25F, 0.125F).replicate(1, 4);
  mesh.triangles.resize(3, 2);
  mesh.triangles << 0, 0,  //
      2, 3,                //
      1, 2;
  return mesh;
}

std::string bytes_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

TruthMesh parse(const std::string& bytes) {
  return parse_truth_ply(std::as_bytes(std::span(bytes)), "test");
}

std::string written() {
  const test::TemporaryFolder folder;
  write_truth_ply(small_mesh(), folder.path() / "mesh.ply");
  return bytes_of(folder.path() / "mesh.ply");
}

TEST(TruthMesh, RoundTrips) {
  const test::TemporaryFolder folder;
  const TruthMesh mesh = small_mesh();
  write_truth_ply(mesh, folder.path() / "mesh.ply");
  const TruthMesh read = read_truth_ply(folder.path() / "mesh.ply");
  EXPECT_EQ(read.vertices_mm, mesh.vertices_mm);
  EXPECT_EQ(read.normals, mesh.normals);
  EXPECT_EQ(read.albedo, mesh.albedo);
  EXPECT_EQ(read.triangles, mesh.triangles);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1);
}

TEST(TruthMesh, ReadsPositionsAlone) {
  std::string bytes =
      "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty uchar tag\nproperty float z\n"
      "property float x\nproperty float y\nelement face 1\nproperty list uchar uint "
      "vertex_indices\nend_header\n";
  const auto put = [&bytes](const auto& value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof(value));
  };
  for (int v = 0; v < 3; ++v) {
    put(static_cast<char>(7));
    put(5.0F);
    put(v == 1 ? 1.0F : 0.0F);
    put(v == 2 ? 1.0F : 0.0F);
  }
  put(static_cast<char>(3));
  put(0);
  put(1);
  put(2);
  const TruthMesh mesh = parse(bytes);
  EXPECT_EQ(mesh.vertices_mm.col(1), Eigen::Vector3f(1, 0, 5));
  EXPECT_EQ(mesh.normals.col(0), Eigen::Vector3f(0, 0, 1));  // from the faces
  EXPECT_EQ(mesh.albedo(0, 0), mesh.albedo(2, 2));
}

TEST(TruthMesh, RefusesEveryTruncation) {
  const std::string whole = written();
  EXPECT_NO_THROW(parse(whole));
  for (std::size_t length = 0; length < whole.size(); ++length) {
    EXPECT_THROW(parse(whole.substr(0, length)), Error) << length;
  }
  EXPECT_THROW(parse(whole + '\0'), Error);
}

TEST(TruthMesh, NamesTheFileAndWhatIsWrong) {
  const auto message = [](std::string bytes, const std::string& from, const std::string& to) -> std::string {
    const std::size_t at = bytes.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    bytes.replace(at, from.size(), to);
    try {
      parse(bytes);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      return error.what();
    }
    return "accepted";
  };
  const std::string whole = written();
  EXPECT_THAT(message(whole, "ply\n", "plx\n"), testing::HasSubstr("test: not a PLY file"));
  EXPECT_THAT(message(whole, "binary_little_endian", "ascii"), testing::HasSubstr("body"));
  EXPECT_THAT(message(whole, "vertex 4", "vertex 99999999999"), testing::HasSubstr("number of elements"));
  EXPECT_THAT(message(whole, "vertex 4", "vertex -4"), testing::HasSubstr("number of elements"));
  EXPECT_THAT(message(whole, "vertex 4", "vertex 5"), testing::HasSubstr("cut off?"));
  EXPECT_THAT(message(whole, "float x\n", "float q\n"), testing::HasSubstr("lack x, y and z"));
  EXPECT_THAT(message(whole, "float x\n", "quad x\n"), testing::HasSubstr("quad"));
  EXPECT_THAT(message(whole, "element face", "element cell"),
              testing::HasSubstr("test: not a truth mesh: it has no faces"));
  EXPECT_THROW(read_truth_ply("no-such-folder/mesh.ply"), Error);
}

TEST(TruthMesh, RefusesIndicesAndNumbersThatCannotBe) {
  const std::string whole = written();
  std::string bytes = whole;
  const std::int32_t outside = 4;
  std::memcpy(&bytes[bytes.size() - 4], &outside, 4);
  EXPECT_THROW(parse(bytes), Error);
  bytes = whole;
  bytes[bytes.size() - 13] = 4;  // corners of the last face
  EXPECT_THROW(parse(bytes), Error);
  bytes = whole;
  const float infinite = INFINITY;
  std::memcpy(&bytes[bytes.find("end_header\n") + 11], &infinite, 4);
  EXPECT_THROW(parse(bytes), Error);
}

TEST(TruthMesh, SurvivesRandomDamage) {
  const std::string whole = written();
  Random random(17, 0);
  int refused = 0;
  for (int trial = 0; trial < 3000; ++trial) {
    std::string bytes = whole;
    for (int change = 0; change <= trial % 4; ++change) {
      bytes[static_cast<std::size_t>(random.below(static_cast<int>(bytes.size())))] =
          static_cast<char>(random.below(256));
    }
    try {
      const TruthMesh mesh = parse(bytes);
      EXPECT_TRUE(mesh.vertices_mm.allFinite());
    } catch (const Error&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 1000);
}

TEST(TruthMesh, SaysWhereItCannotWrite) {
  const test::TemporaryFolder folder;
  try {
    write_truth_ply(small_mesh(), folder.path() / "missing" / "mesh.ply");
    FAIL() << "wrote into a folder that is not there";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
  }
}

}  // namespace
}  // namespace facet::simulation
