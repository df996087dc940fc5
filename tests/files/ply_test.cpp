#include "files/ply.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstring>

#include "files/text_file.hpp"
#include "support/paths.hpp"

namespace facet::files {
namespace {

#pragma pack(push, 1)
struct Vertex {
  float x;
  std::uint8_t red;
};
#pragma pack(pop)

class Ply : public ::testing::Test {
 protected:
  PlyMesh mesh() const {
    return {.comments = {"one", "two"},
            .fields = {"float x", "uchar red"},
            .vertices = std::as_bytes(std::span(vertices_)),
            .vertex_count = vertices_.size(),
            .corners = corners_};
  }

  test::TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "a.ply";
  std::array<Vertex, 2> vertices_ = {{{1.5F, 7}, {-2.0F, 255}}};
  std::array<std::int32_t, 6> corners_ = {0, 1, 0, 1, 0, 1};
};

TEST_F(Ply, LiesInTheFileByteByByte) {
  write_ply(mesh(), file_);
  const std::string header =
      "ply\nformat binary_little_endian 1.0\ncomment one\ncomment two\nelement vertex 2\nproperty float x\n"
      "property uchar red\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n";
  const std::string text = read_text(file_, 1000, "PLY file");
  ASSERT_EQ(text.size(), header.size() + 2 * 5 + 2 * 13);
  EXPECT_EQ(text.substr(0, header.size()), header);
  EXPECT_EQ(std::memcmp(text.data() + header.size(), vertices_.data(), 10), 0);
  for (std::size_t f = 0; f < 2; ++f) {
    const char* face = text.data() + header.size() + 10 + 13 * f;
    EXPECT_EQ(face[0], 3);
    EXPECT_EQ(std::memcmp(face + 1, corners_.data() + 3 * f, 12), 0);
  }
}

using PlyDeathTest = Ply;

TEST_F(PlyDeathTest, SizesThatDoNotAgreeEndTheProgram) {
  PlyMesh wrong = mesh();
  wrong.vertex_count = 3;
  EXPECT_DEATH(write_ply(wrong, file_), "10, 3, 5");
  EXPECT_FALSE(std::filesystem::exists(file_));
}

}  // namespace
}  // namespace facet::files
