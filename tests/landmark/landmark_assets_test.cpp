#include "landmark/landmark_assets.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <fstream>

#include "facet/error.hpp"
#include "landmark/canonical_face.hpp"
#include "landmark/landmarker.hpp"
#include "support/frames.hpp"
#include "support/paths.hpp"

namespace facet::landmark {
namespace {

using testing::HasSubstr;

std::string load_error(const std::filesystem::path& file) {
  try {
    const Landmarker landmarker(file);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  return {};
}

void write(const std::filesystem::path& file, const std::vector<char>& bytes) {
  std::ofstream(file, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

TEST(LandmarkAssets, ComputesTheStandardCrc) {
  constexpr std::array<std::uint8_t, 9> digits{'1', '2', '3', '4', '5', '6', '7', '8', '9'};
  EXPECT_EQ(crc32(digits), 0xCBF43926U);
  EXPECT_EQ(crc32({}), 0U);
}

TEST(LandmarkAssets, SaysWhatIsWrongWithAFile) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "nets.data";
  EXPECT_THAT(load_error(file),
              AllOf(HasSubstr("nets.data"), HasSubstr("cannot open"), HasSubstr("fetch-assets")));
  write(file, {});
  EXPECT_THAT(load_error(file), HasSubstr("only 0 bytes"));
  write(file, std::vector<char>(3'986'255, 'x'));
  EXPECT_THAT(load_error(file), HasSubstr("only 3986255 bytes"));
  write(file, std::vector<char>(5'000'000, 'x'));
  EXPECT_THAT(load_error(file), HasSubstr("more than 3986256 bytes"));
  write(file, std::vector<char>(3'986'256, 'x'));
  EXPECT_THAT(load_error(file), AllOf(HasSubstr("damaged (CRC-32"), HasSubstr("fetch-assets")));
  EXPECT_FALSE(load_error(folder.path()).empty());
}

TEST(LandmarkAssets, OneFlippedBitIsFound) {
  const auto source = test::landmark_nets();
  if (!std::filesystem::exists(source)) {
    GTEST_SKIP() << source << " is missing (packaging/fetch-assets)";
  }
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "nets.data";
  std::filesystem::copy_file(source, file);
  std::fstream stream(file, std::ios::binary | std::ios::in | std::ios::out);
  stream.seekg(3'000'000);
  const auto byte = static_cast<char>(stream.get() ^ 0x10);
  stream.seekp(3'000'000);
  stream.put(byte);
  stream.close();
  EXPECT_THAT(load_error(file), HasSubstr("damaged (CRC-32"));
}

/// Writes protobuf messages of the few kinds that the metadata uses.
class MessageWriter {
 public:
  MessageWriter& varint(std::uint32_t field, std::uint64_t value) {
    number(field << 3U);
    number(value);
    return *this;
  }
  MessageWriter& fixed(std::uint32_t field, float value) {
    number((field << 3U) | 5U);
    std::array<std::uint8_t, 4> raw{};
    std::memcpy(raw.data(), &value, 4);
    bytes.insert(bytes.end(), raw.begin(), raw.end());
    return *this;
  }
  MessageWriter& message(std::uint32_t field, const std::vector<std::uint8_t>& content) {
    number((field << 3U) | 2U);
    number(content.size());
    bytes.insert(bytes.end(), content.begin(), content.end());
    return *this;
  }
  std::vector<std::uint8_t> bytes;

 private:
  void number(std::uint64_t value) {
    for (; value >= 0x80; value >>= 7U) {
      bytes.push_back(static_cast<std::uint8_t>(value | 0x80U));
    }
    bytes.push_back(static_cast<std::uint8_t>(value));
  }
};

std::vector<std::uint8_t> sheet(std::uint64_t last_index) {
  MessageWriter mesh;
  mesh.varint(1, 0).varint(2, 0);
  for (int v = 0; v < landmark_count; ++v) {
    for (const int value : {v % 26, v / 26, 1, 0, 0}) {
      mesh.fixed(3, static_cast<float>(value));
    }
  }
  mesh.varint(4, 0).varint(4, 1).varint(4, last_index);
  MessageWriter metadata;
  metadata.message(1, mesh.bytes).message(2, {0x08, 0x04}).varint(3, 1);
  return metadata.bytes;
}

TEST(CanonicalFace, ReadsAMesh) {
  const CanonicalFace face = parse_canonical_face(sheet(26), "metadata");
  EXPECT_EQ(face.vertices_cm.col(27), Eigen::Vector3f(1, 1, 1));
  ASSERT_EQ(face.triangles.size(), 1U);
  EXPECT_EQ(face.triangles[0], (std::array<std::int32_t, 3>{0, 1, 26}));
  EXPECT_TRUE(face.normals.col(1).isApprox(Eigen::Vector3f::UnitZ()));
}

TEST(CanonicalFace, RefusesDamage) {
  EXPECT_THROW(parse_canonical_face(sheet(468), "metadata"), Error);
  EXPECT_THROW(parse_canonical_face({}, "metadata"), Error);
  const auto whole = sheet(26);
  for (std::size_t size = 0; size < whole.size() - 8; size += 7) {
    const std::vector<std::uint8_t> cut(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
    EXPECT_THROW(parse_canonical_face(cut, "metadata"), Error) << size;
  }
  const std::vector<std::uint8_t> endless(40, 0xFF);
  EXPECT_THROW(parse_canonical_face(endless, "metadata"), Error);
}

TEST(CanonicalFace, TheRealOneIsAFace) {
  const auto file = test::landmark_nets();
  if (!std::filesystem::exists(file)) {
    GTEST_SKIP() << file << " is missing (packaging/fetch-assets)";
  }
  const CanonicalFace face = parse_canonical_face(LandmarkAssets::load(file).geometry(), "metadata");
  EXPECT_EQ(face.triangles.size(), 898U);
  constexpr int nose_tip = 1;
  constexpr int right_eye_outer = 33;
  constexpr int left_eye_outer = 263;
  constexpr int chin = 152;
  EXPECT_LT(face.vertices_cm(0, right_eye_outer), -3);
  EXPECT_GT(face.vertices_cm(0, left_eye_outer), 3);
  EXPECT_LT(face.vertices_cm(1, chin), face.vertices_cm(1, nose_tip));
  EXPECT_GT(face.vertices_cm(2, nose_tip), face.vertices_cm(2, chin));
  EXPECT_GT(face.normals(2, nose_tip), 0.8F);
}

}  // namespace
}  // namespace facet::landmark
