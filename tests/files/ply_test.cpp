#include "files/ply.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <string>

#include "facet/error.hpp"
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

PlySurface parse(const std::string& bytes) {
  return parse_ply(std::as_bytes(std::span(bytes)), "test");
}

/// A body's numbers one after the other, in either byte order.
class Body {
 public:
  explicit Body(bool big_endian) : swapped_(big_endian != (std::endian::native == std::endian::big)) {}
  template <typename Number>
  Body& put(Number number) {
    std::array<char, sizeof(Number)> raw{};
    std::memcpy(raw.data(), &number, sizeof(Number));
    if (swapped_) {
      std::reverse(raw.begin(), raw.end());
    }
    bytes_.append(raw.data(), raw.size());
    return *this;
  }
  const std::string& bytes() const { return bytes_; }

 private:
  bool swapped_;
  std::string bytes_;
};

/// What each of the samples below holds: a square of two triangles and a triangle.
void expect_house(const PlySurface& house) {
  ASSERT_EQ(house.vertex_count, 5U);
  ASSERT_NE(house.find("x"), nullptr);
  ASSERT_NE(house.find("y"), nullptr);
  EXPECT_EQ(*house.find("x"), (std::vector<float>{0, 1, 1, 0, 0.5F}));
  EXPECT_EQ(*house.find("y"), (std::vector<float>{0, 0, 1, 1, 1.5F}));
  EXPECT_EQ(house.find("z"), nullptr);
  EXPECT_EQ(house.corners, (std::vector<std::int32_t>{0, 1, 2, 0, 2, 3, 3, 2, 4}));
}

TEST(PlyReader, ReadsTextWithAnyLineEndsAndElements) {
  const std::string text =
      "ply\nformat ascii 1.0\ncomment made by hand\nobj_info none\nelement camera 1\nproperty float f\n"
      "property list uchar int parts\nelement vertex 5\nproperty double x\nproperty double y\n"
      "property uchar red\nelement face 2\nproperty uchar flags\nproperty list int short vertex_index\n"
      "property list uchar float texcoord\nelement edge 1\nproperty int vertex1\nproperty int vertex2\n"
      "end_header\n35.5 2 8 9\n0 0 255\n1 0 255\n1 +1.0 255\n0 1e0 255\n5e-1 1.5 255\n"
      "1 4 0 1 2 3 0\n2 3 3 2 4 2 0.25 0.5\n0 1\n\n";
  expect_house(parse(text));
  EXPECT_EQ(*parse(text).find("red"), std::vector<float>(5, 255));
  std::string dos;
  for (const char c : text) {
    dos += c == '\n' ? "\r\n" : std::string(1, c);
  }
  expect_house(parse(dos));
}

TEST(PlyReader, ReadsBothByteOrdersAndOtherSizes) {
  for (const bool big : {false, true}) {
    Body body(big);
    const std::array<double, 5> x{0, 1, 1, 0, 0.5};
    const std::array<double, 5> y{0, 0, 1, 1, 1.5};
    for (std::size_t v = 0; v < 5; ++v) {
      body.put(std::uint16_t{7}).put(x[v]).put(static_cast<float>(y[v])).put(std::uint8_t{1}).put(1.0F);
    }
    for (const std::vector<int>& face : {std::vector{0, 1, 2, 3}, std::vector{3, 2, 4}}) {
      body.put(static_cast<std::int32_t>(face.size()));
      for (const int corner : face) {
        body.put(static_cast<std::uint16_t>(corner));
      }
      body.put(std::int8_t{-1});
    }
    body.put(3.0).put(std::uint8_t{0});  // an element after the faces
    const std::string header = std::string("ply\nformat binary_") + (big ? "big" : "little") +
                               "_endian 1.0\nelement vertex 5\nproperty ushort tag\nproperty float64 x\n"
                               "property float32 y\nproperty list uint8 float weights\nelement face 2\n"
                               "property list int32 uint16 vertex_indices\nproperty char flag\n"
                               "element light 1\nproperty double watts\nproperty list uchar int on\n"
                               "end_header\n";
    expect_house(parse(header + body.bytes()));
    for (std::size_t length = 0; length < header.size() + body.bytes().size(); ++length) {
      EXPECT_THROW(parse((header + body.bytes()).substr(0, length)), Error) << length;
    }
    EXPECT_THROW(parse(header + body.bytes() + '\0'), Error);
  }
}

TEST(PlyReader, ReadsWhatIsWritten) {
  const test::TemporaryFolder folder;
  const std::array<float, 2> x{1.5F, -2};
  const std::array<std::int32_t, 3> corners{0, 1, 0};
  write_ply({.comments = {},
             .fields = {"float x"},
             .vertices = std::as_bytes(std::span(x)),
             .vertex_count = 2,
             .corners = corners},
            folder.path() / "a.ply");
  const PlySurface read = parse_ply(read_bytes(folder.path() / "a.ply", 1000, "PLY file"), "a.ply");
  EXPECT_EQ(*read.find("x"), (std::vector<float>{1.5F, -2}));
  EXPECT_EQ(read.corners, (std::vector<std::int32_t>{0, 1, 0}));
}

TEST(PlyReader, SaysWhatIsWrong) {
  const std::string vertices = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n";
  const std::string faces = vertices + "element face 1\nproperty list uchar int vertex_indices\n";
  struct Case {
    std::string bytes;
    std::string words;
  };
  for (const auto& [bytes, words] : std::vector<Case>{
           {"", "does not begin with 'ply'"},
           {"solid\n", "does not begin with 'ply'"},
           {"ply\n", "has no end"},
           {"ply\nend_header\n", "lacks the format"},
           {"ply\nformat utf8 1.0\n", "line 2: format 'utf8'"},
           {"ply\nformat ascii 1.0\nelement vertex -1\n", "line 3: '-1' is not a number of elements"},
           {"ply\nformat ascii 1.0\nelement vertex 99999999999\n", "not a number of elements"},
           {"ply\nformat ascii 1.0\nproperty float x\n", "without its element"},
           {"ply\nformat ascii 1.0\nelement a 1\nelement a 1\n", "one too many"},
           {"ply\nformat ascii 1.0\nelement tristrips 1\n", "triangle strips"},
           {vertices + "property quad y\n", "type 'quad' is unknown"},
           {vertices + "property list float int y\n", "not a list with a count"},
           {vertices + "end_header\n0 1\n", "room for 2"},
           {vertices + "end_header\n0.125 1\n", "cut off?"},
           {vertices + "end_header\n0 1 2 3\n", "more follows"},
           {vertices + "end_header\n0 one 2\n", "'one' in its body"},
           {vertices + "element face 1\nproperty int a\nend_header\n0 1 2 3\n", "lack a list vertex_indices"},
           {faces + "end_header\n0 1 2 2 0 1\n", "face 0 has 2 corners"},
           {faces + "end_header\n0 1 2 3 0 1 3\n", "names vertex 3 of 3"},
           {faces + "end_header\n0 1 2 3 0 1 -1\n", "names vertex -1"},
           {faces + "end_header\n0 1 2 3 0 1 1.5\n", "'1.5' in its body"},
           {faces + "end_header\n0 1 2 200 0 1\n", "list 'vertex_indices' of 200"}}) {
    try {
      parse(bytes);
      ADD_FAILURE() << "read: " << bytes;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      EXPECT_THAT(error.what(), testing::HasSubstr(words));
      EXPECT_THAT(error.what(), testing::StartsWith("test: not a PLY file: "));
    }
  }
}

}  // namespace
}  // namespace facet::files
