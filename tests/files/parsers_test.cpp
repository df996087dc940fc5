// A parser from outside that is called past its door has no bounds.

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <regex>
#include <string>
#include <vector>

#include "support/paths.hpp"

namespace facet::files {
namespace {

struct Door {
  const char* call;  ///< a regular expression
  const char* file;  ///< the one that may have it; "": none
};

TEST(Parsers, AreCalledAtTheirDoorsAlone) {
  const Door doors[] = {
      {R"(sax_parse\s*\()", "daemon/files/json_text.cpp"},
      {R"((json|Json)::(parse|accept|from_\w+)\s*\()", ""},
      {R"(>>\s*(json|document|root)\b)", ""},
      {R"(toml::parse\w*\s*\()", "daemon/files/toml_section.cpp"},
      {R"(YAML::Load\w*\s*\()", "daemon/calibration/exchange.cpp"},
      {R"(\bFileStorage(\s+\w+)?\s*[({])", ""},
  };
  std::vector<std::regex> calls;
  for (const Door& door : doors) {
    calls.emplace_back(door.call);
  }
  int found[std::size(doors)] = {};
  int read = 0;
  const std::filesystem::path top = FACET_SOURCE_DIR;
  for (const char* folder : {"daemon", "drivers", "tools", "clients"}) {
    for (const auto& entry : std::filesystem::recursive_directory_iterator(top / folder)) {
      const std::string extension = entry.path().extension();
      if (extension != ".cpp" && extension != ".hpp" && extension != ".c" && extension != ".h") {
        continue;
      }
      ++read;
      std::ifstream stream(entry.path());
      const std::string text{std::istreambuf_iterator<char>(stream), {}};
      const std::string name = std::filesystem::relative(entry.path(), top);
      for (std::size_t i = 0; i < std::size(doors); ++i) {
        if (std::regex_search(text, calls[i])) {
          EXPECT_EQ(name, doors[i].file) << "calls " << doors[i].call;
          ++found[i];
        }
      }
    }
  }
  EXPECT_GT(read, 300) << "where are the sources?";
  for (std::size_t i = 0; i < std::size(doors); ++i) {
    EXPECT_EQ(found[i], *doors[i].file == '\0' ? 0 : 1) << doors[i].call;
  }
}

}  // namespace
}  // namespace facet::files
