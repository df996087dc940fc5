#include "files/json_text.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "facet/error.hpp"

namespace facet::files {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

constexpr JsonLimits kLimits{1U << 20, 400'000};

/// The same of both readers.
std::string why_refused(const std::string& text, const JsonLimits& limits = kLimits) {
  std::string why = "taken";
  try {
    parse_json(text, limits, "some.json");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    why = error.what();
  }
  std::string of_ordered = "taken";
  try {
    parse_ordered_json(text, limits, "some.json");
  } catch (const Error& error) {
    of_ordered = error.what();
  }
  EXPECT_EQ(of_ordered, why);
  return why;
}

std::string repeated(std::string_view text, std::size_t times) {
  std::string all;
  all.reserve(text.size() * times);
  for (std::size_t i = 0; i < times; ++i) {
    all += text;
  }
  return all;
}

TEST(JsonText, IsReadAsTheLibraryReadsIt) {
  for (const char* text :
       {"null", "true", "-3", "18446744073709551615", "0.25", "\"a\\u00e9\\n\"", "[]", "{}", "[[],{},[[1]]]",
        R"({"z": [1, {"y": null, "x": [false, "t"]}], "a": {"b": {"c": -1.5e3}}, "": 0})"}) {
    EXPECT_EQ(parse_json(text, kLimits, ""), json::parse(text)) << text;
    EXPECT_EQ(parse_ordered_json(text, kLimits, "").dump(), nlohmann::ordered_json::parse(text).dump())
        << text;
  }
}

TEST(JsonText, WhatIsNoneIsRefusedWithTheReason) {
  for (const char* text : {"", "{", "[1,", "{\"a\" 1}", "1 2", "nul", "\"\xff\"", "1e999", "[1]]"}) {
    EXPECT_THAT(why_refused(text), HasSubstr("some.json: it is not JSON: ")) << text;
  }
  EXPECT_LT(why_refused("\"" + std::string(500'000, 'x')).size(), 300U) << "a long text is not quoted whole";
}

TEST(JsonText, DepthIsBoundedWhileItIsRead) {
  const auto nested = [](std::size_t depth) { return std::string(depth, '[') + std::string(depth, ']'); };
  EXPECT_EQ(why_refused(nested(32)), "taken");
  EXPECT_THAT(why_refused(nested(33)), HasSubstr("nests deeper than 32 levels"));
  EXPECT_THAT(why_refused(nested(500'000)), HasSubstr("nests deeper"));
  EXPECT_THAT(why_refused(std::string(1U << 20, '[')), HasSubstr("nests deeper"));
  EXPECT_THAT(why_refused(repeated("{\"a\":", 200'000)), HasSubstr("nests deeper"));
  EXPECT_THAT(why_refused(repeated("[{\"a\":", 150'000)), HasSubstr("nests deeper"));
  EXPECT_EQ(why_refused(nested(100), {1U << 20, 1000, 100}), "taken");
}

TEST(JsonText, NumberOfValuesIsBounded) {
  EXPECT_EQ(why_refused("[1,[2],{\"a\":3}]", {100, 6}), "taken") << "the lists and the object count";
  EXPECT_THAT(why_refused("[1,[2],{\"a\":3}]", {100, 5}), HasSubstr("more than 5 values"));
  EXPECT_THAT(why_refused("[[]" + repeated(",[]", 300'000) + "]", {1U << 20, 250'000}),
              HasSubstr("more than 250000 values"));
}

TEST(JsonText, LengthIsBounded) {
  EXPECT_EQ(why_refused("[1,2]", {5, 10}), "taken");
  EXPECT_THAT(why_refused("[1,2] ", {5, 10}), HasSubstr("more than 5 bytes"));
}

TEST(JsonText, NamesThatStandTwiceAreRefused) {
  EXPECT_THAT(why_refused(R"({"a": 1, "b": 2, "a": 3})"), HasSubstr("has 'a' twice"));
  EXPECT_EQ(why_refused(R"([{"a": 1}, {"a": 1, "b": {"a": 2}}])"), "taken");
}

/// A list's or an object's length squared would be 10^10 steps: that does not end within a test's time.
TEST(JsonText, LongListsAndObjectsTakeNoSquare) {
  const std::string objects = "[{}" + repeated(",{}", 300'000) + "]";
  EXPECT_EQ(parse_json(objects, kLimits, "").size(), 300'001U);
  EXPECT_EQ(parse_ordered_json(objects, kLimits, "").size(), 300'001U);
  std::string names = "{\"first\":0";
  for (int i = 0; i < 80'000; ++i) {
    names += fmt::format(",\"{}\":1", i);
  }
  names += "}";
  EXPECT_EQ(parse_json(names, kLimits, "").size(), 80'001U);
  const nlohmann::ordered_json ordered = parse_ordered_json(names, kLimits, "");
  EXPECT_EQ(ordered.size(), 80'001U);
  EXPECT_EQ(ordered.begin().key(), "first");
}

}  // namespace
}  // namespace facet::files
