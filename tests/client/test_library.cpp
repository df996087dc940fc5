// What programs that were built before rely on: the library's symbols, its structs, what it needs.

#include <facet-client.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdio>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "support/source_folder.hpp"

namespace facet {
namespace {

std::string output(const std::string& command) {
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> pipe(::popen(command.c_str(), "r"), ::pclose);
  std::string text;
  std::array<char, 4096> piece{};
  for (std::size_t count = 0; (count = std::fread(piece.data(), 1, piece.size(), pipe.get())) > 0;) {
    text.append(piece.data(), count);
  }
  return text;
}

std::vector<std::string> lines(std::istream& stream) {
  std::vector<std::string> out;
  for (std::string line; std::getline(stream, line);) {
    out.push_back(line);
  }
  return out;
}

// A symbol that goes, or one that nobody wrote down, breaks programs: raise SOVERSION, or add it to the list.
TEST(ClientLibrary, GivesTheSymbolsOnTheList) {
#ifdef FACET_SANITIZED
  GTEST_SKIP() << "sanitizers add symbols";
#endif
  std::istringstream shown(
      output(std::string("nm -D --defined-only -j ") + FACET_CLIENT_LIBRARY + " | sort"));
  std::ifstream listed(FACET_SOURCE_DIR "/clients/c/facet-client.symbols");
  EXPECT_EQ(lines(shown), lines(listed));
}

TEST(ClientLibrary, NeedsLibcAlone) {
#ifdef FACET_SANITIZED
  GTEST_SKIP() << "sanitizers add libraries";
#endif
  const std::string said = output(std::string("readelf -d ") + FACET_CLIENT_LIBRARY);
  EXPECT_THAT(said, testing::HasSubstr("soname: [libfacet-client.so.0]"));
  std::istringstream stream(said);
  std::vector<std::string> needed;
  for (const std::string& line : lines(stream)) {
    if (line.find("(NEEDED)") != std::string::npos) {
      needed.push_back(line.substr(line.find('[')));
    }
  }
  EXPECT_THAT(needed, testing::ElementsAre("[libc.so.6]"));
}

// Fields are only ever appended: those that are there stay where they are.
static_assert(sizeof(facet_fixed_point) == 24);
static_assert(offsetof(facet_frame, state) == 24 && offsetof(facet_frame, landmarks_px) == 64 &&
              offsetof(facet_frame, subject_id) == 88 && offsetof(facet_frame, camera_from_head) == 104 &&
              offsetof(facet_frame, expression) == 152 && offsetof(facet_frame, lighting) == 172 &&
              offsetof(facet_frame, control_vertices) == 208 && offsetof(facet_frame, normals) == 280 &&
              offsetof(facet_frame, in_ring) == 296 && offsetof(facet_frame, expression_confidence) == 304 &&
              offsetof(facet_frame, origin) == 312 && offsetof(facet_frame, avatar_values) == 320 &&
              offsetof(facet_frame, upright_rotation) == 340);
static_assert(offsetof(facet_subject, control_vertex_count) == 40 &&
              offsetof(facet_subject, texture_coordinates) == 64 && offsetof(facet_subject, levels) == 88);
static_assert(offsetof(facet_albedo, linear_rgb) == 24 && offsetof(facet_mesh, normals) == 16);
static_assert(offsetof(facet_statistics, by_ring) == 40);
static_assert(FACET_OK == 0 && FACET_OUT_OF_MEMORY == 7 && FACET_WANT_RING == 2 && FACET_RECONNECT == 4);

TEST(ClientLibrary, TellsItsVersion) {
  EXPECT_STREQ(facet_client_version(), "0.1.0");
}

}  // namespace
}  // namespace facet
