#include "files/toml_section.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <string_view>

#include "facet/error.hpp"

namespace facet::files {
namespace {

using ::testing::HasSubstr;

std::string why_refused(const std::string& text) {
  try {
    read_toml(text, "some.toml", [](TomlDocument&) {});
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "taken";
}

std::string repeated(std::string_view text, std::size_t times) {
  std::string all;
  all.reserve(text.size() * times);
  for (std::size_t i = 0; i < times; ++i) {
    all += text;
  }
  return all;
}

TEST(TomlText, NamesInOneKeyAreBounded) {
  EXPECT_EQ(why_refused("a" + repeated(".a", 15) + " = 1"), "taken");
  const char* const kReason = "more than 16 names in one key";
  EXPECT_THAT(why_refused("x = 1\na" + repeated(".a", 16) + " = 1"),
              HasSubstr(std::string("some.toml:2: it has ") + kReason));
  EXPECT_THAT(why_refused("a" + repeated(".a", 200'000) + " = 1"), HasSubstr(kReason));
  EXPECT_THAT(why_refused("a" + repeated(".a", 200'000)), HasSubstr(kReason));
  EXPECT_THAT(why_refused("[a" + repeated(".a", 200'000) + "]"), HasSubstr(kReason));
  EXPECT_THAT(why_refused("[[a" + repeated(" . a", 100'000) + "]]"), HasSubstr(kReason));
  EXPECT_THAT(why_refused("x = {a" + repeated(".a", 200'000) + " = 1}"), HasSubstr(kReason));
  EXPECT_THAT(why_refused("x = [{b = 1}, {\"a\"" + repeated(".'a'", 20'000) + " = 1}]"), HasSubstr(kReason));
}

TEST(TomlText, NestingIsBounded) {
  EXPECT_EQ(why_refused("a = " + std::string(32, '[') + std::string(32, ']')), "taken");
  const char* const kReason = "more than 32 lists and tables in one another";
  EXPECT_THAT(why_refused("a = " + std::string(500'000, '[') + std::string(500'000, ']')),
              HasSubstr(kReason));
  EXPECT_THAT(why_refused("a = " + repeated("{a = ", 100'000)), HasSubstr(kReason));
  EXPECT_THAT(why_refused("a = [" + repeated("\n[", 33)), HasSubstr("some.toml:33: it has "));
}

TEST(TomlText, NumbersOfThingsAreBounded) {
  std::string tables;
  std::string keys;
  for (int i = 0; i < 50'001; ++i) {
    tables += fmt::format("[t{}]\n", i);
    keys += fmt::format("k{} = 1\n", i);
  }
  EXPECT_THAT(why_refused(tables), HasSubstr("some.toml:10001: it has more than 10000 tables"));
  EXPECT_THAT(why_refused(repeated("[[t]]\n", 10'001)), HasSubstr("more than 10000 tables"));
  EXPECT_THAT(why_refused("t = [" + repeated("{},", 10'001) + "]"), HasSubstr("more than 10000 tables"));
  EXPECT_THAT(why_refused(repeated("a.b.c.d.e = 1\n", 2'501)), HasSubstr("more than 10000 tables"));
  EXPECT_THAT(why_refused(keys), HasSubstr("more than 50000 keys"));
  EXPECT_THAT(why_refused("a = [" + repeated("1,", 200'001) + "]"), HasSubstr("more than 200000 values"));
  EXPECT_THAT(why_refused(std::string(kMostTomlBytes + 1, ' ')), HasSubstr("more than 1048576 bytes"));
}

/// What looks like keys in strings and comments is none.
TEST(TomlText, StringsAndCommentsDoNotCount) {
  const std::string dots(40'000, '.');
  const std::string open(40'000, '[');
  for (const std::string& text : {dots, open, std::string(40'000, '='), std::string(250'000, ',')}) {
    EXPECT_EQ(why_refused("# \" ' \"\"\" " + text + "\na = 1 # '''" + text), "taken");
    EXPECT_EQ(why_refused("a = \"\\\"" + text + "\\\\\" # \"\n'b" + text + "' = '\\'"), "taken");
    EXPECT_EQ(why_refused("a = \"\"\"\n\\\"\"\"" + text + "\n\"\" " + text + "\"\"\"\"\"\nb = 1"), "taken");
    EXPECT_EQ(why_refused("a = '''" + text + "\n'' " + text + "'''''\nb = '''''' # ''' " + text), "taken");
    EXPECT_EQ(why_refused("\"\" = ''\n\"a" + text + "\".b = \"\"\"\"\"\""), "taken");
  }
  // Behind all of them keys count again.
  const std::string deep = "\na" + repeated(".a", 200'000) + " = 1";
  for (const char* before : {"# '''", "a = \"\\\"\"", "a = '\\'", "a = \"\"\"\n\\\"\"\"\"\"\"",
                             "a = '''\n'''''", "a = ''", "'a\"' = \"'\" # \""}) {
    EXPECT_THAT(why_refused(before + deep), HasSubstr("names in one key")) << before;
  }
}

TEST(TomlText, WhatFilesOfOursHoldIsTaken) {
  std::string text = "slot = 3\n";
  for (int camera = 0; camera < 64; ++camera) {
    text += fmt::format("[camera.name-{}]\n", camera);
    for (int landmark = 0; landmark < 468; ++landmark) {
      text += fmt::format("{} = [1234.5, -678.25]\n", landmark);
    }
  }
  EXPECT_EQ(why_refused(text), "taken") << text.size();
}

/// The square of the keys would be 10^9 comparisons of names for each of the readers' steps.
TEST(TomlText, SectionsThatNameTheirKeysMayBeLong) {
  std::string text;
  for (int i = 0; i < 50'000; ++i) {
    text += fmt::format("k{} = 1\n", i);
  }
  read_toml(text, "some.toml", [](TomlDocument& document) {
    TomlSection root(document, &document.root(), "");
    EXPECT_EQ(root.entries().size(), 50'000U);
    root.finish();
  });
}

}  // namespace
}  // namespace facet::files
