// [bridges.values] of the configuration, and values.* of the control protocol.

#include "service/value_methods.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <regex>
#include <string>

#include "facet/error.hpp"
#include "mesh/arkit.hpp"
#include "service/config.hpp"
#include "service/status_report.hpp"
#include "support/paths.hpp"

namespace facet::service {
namespace {

using avatar::ValueTuning;
using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

std::size_t index_of(const char* name) {
  return static_cast<std::size_t>(mesh::arkit_index(name));
}

avatar::ValueTunings read(const std::string& rows) {
  return parse_config("[bridges.values]\n" + rows, "/etc/facet/facet.toml").bridges.values;
}

std::string error_of(const std::string& rows) {
  try {
    read(rows);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "no error";
}

TEST(ConfiguredValues, AreByNameAndForAllOthers) {
  const avatar::ValueTunings values =
      read("jawOpen = { gain = 1.2, dead_zone = 0.02 }\nall = { smoothing_ms = 40, dead_zone = 0.9 }\n");
  EXPECT_EQ(values.all, (ValueTuning{1, 0.9, 40}));
  EXPECT_EQ(values.named.size(), 1U);
  EXPECT_EQ(values.of(index_of("jawOpen")), (ValueTuning{1.2, 0.02, 0}))
      << "what it leaves out is plain, whatever is said of all";
  EXPECT_EQ(values.of(index_of("tongueOut")), values.all);
  EXPECT_EQ(read("").all, ValueTuning());
  EXPECT_EQ(read("[bridges.values.jawOpen]\ngain = 10\n").of(index_of("jawOpen")).gain, 10);
}

TEST(ConfiguredValues, WhatIsWrongIsToldByLine) {
  EXPECT_THAT(error_of("jawOpen = { gain = 1 }\njawOpne = { gain = 1 }\n"),
              AllOf(HasSubstr("facet.toml:3: bridges.values.jawOpne: unknown key"), HasSubstr("'jawOpen'?")));
  EXPECT_THAT(error_of("JawOpen = { gain = 1 }\n"), HasSubstr("did you mean 'jawOpen'?"));
  EXPECT_THAT(
      error_of("\njawOpen = { gian = 1 }\n"),
      AllOf(HasSubstr("facet.toml:3: bridges.values.jawOpen.gian: unknown key"), HasSubstr("'gain'?")));
  EXPECT_THAT(error_of("jawOpen = { gain = 10.1 }\n"),
              HasSubstr("facet.toml:2: bridges.values.jawOpen.gain: must be a number from 0 to 10"));
  EXPECT_THAT(error_of("all = { dead_zone = 0.91 }\n"),
              HasSubstr("facet.toml:2: bridges.values.all.dead_zone: must be a number from 0 to 0.9"));
  EXPECT_THAT(error_of("all = { smoothing_ms = 2001 }\n"), HasSubstr("must be a number from 0 to 2000"));
  EXPECT_THAT(error_of("all = { gain = -0.1 }\n"), HasSubstr("from 0 to 10"));
  EXPECT_THAT(error_of("all = { gain = nan }\n"), HasSubstr("from 0 to 10"));
  EXPECT_THAT(error_of("jawOpen = 1.2\n"),
              HasSubstr("facet.toml:2: bridges.values.jawOpen: must be a section"));
}

/// The sample's rows are comments; they can be taken as they are, and say the bounds.
TEST(ConfiguredValues, TheSampleShowsThem) {
  std::ifstream file(std::filesystem::path(FACET_SOURCE_DIR) / "config" / "facet.toml");
  std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  EXPECT_TRUE(parse_config(text, "facet.toml").bridges.values.named.empty());
  for (const char* bounds : {"gain, 0 to 10:", "dead_zone, 0 to 0.9:", "smoothing_ms, 0 to 2000:"}) {
    EXPECT_THAT(text, HasSubstr(bounds));
  }
  text = std::regex_replace(text, std::regex("\n#(all|jawOpen) = "), "\n$1 = ");
  const avatar::ValueTunings shown = parse_config(text, "facet.toml").bridges.values;
  EXPECT_EQ(shown.all, ValueTuning()) << "the default";
  EXPECT_EQ(shown.of(index_of("jawOpen")), (ValueTuning{1.2, 0.02, 40}));
}

class ValueMethods : public ::testing::Test {
 protected:
  json ask(const std::string& method, const json& params, bool member = true) {
    const auto methods = value_methods(bridge_, config_.values);
    const json request = {{"jsonrpc", "2.0"}, {"id", 1}, {"method", method}, {"params", params}};
    return json::parse(answer_request(methods, request.dump(), {1, 1000, member}));
  }
  json set(const json& params) { return ask("values.set", params)["result"]; }
  std::string refusal(const json& params) {
    const json answer = ask("values.set", params);
    return answer.contains("error") ? answer["error"]["message"].get<std::string>() : "";
  }
  json shown() const { return to_json(bridge_.status())["values"]; }

  static avatar::BridgeConfig config(const std::filesystem::path& folder) {
    avatar::BridgeConfig config;
    config.neutral_file = folder / "neutral.json";
    config.values.named[index_of("jawOpen")] = {1.5, 0, 0};
    return config;
  }

  test::TemporaryFolder folder_;
  avatar::BridgeConfig config_ = config(folder_.path());
  avatar::Bridge bridge_{config_};
};

TEST_F(ValueMethods, SetWhatIsGivenAndGoBackToTheConfiguration) {
  const json configured = json::parse(R"({"jawOpen": {"gain": 1.5, "dead_zone": 0, "smoothing_ms": 0}})");
  EXPECT_EQ(shown(), configured) << "those alone that are not plain";
  EXPECT_EQ(set({{"name", "jawOpen"}, {"dead_zone", 0.05}}),
            json::parse(R"({"name": "jawOpen", "gain": 1.5, "dead_zone": 0.05, "smoothing_ms": 0})"));
  EXPECT_EQ(bridge_.status().values.of(index_of("jawOpen")), (ValueTuning{1.5, 0.05, 0}));
  EXPECT_EQ(set({{"name", "TongueOut"}, {"smoothing_ms", 40}})["name"], "tongueOut") << "as ARKit writes it";
  EXPECT_EQ(shown()["tongueOut"]["smoothing_ms"], 40);

  EXPECT_EQ(set({{"name", "all"}, {"gain", 0.5}})["name"], "all");
  EXPECT_EQ(bridge_.status().values.of(index_of("jawForward")).gain, 0.5);
  EXPECT_EQ(bridge_.status().values.of(index_of("jawOpen")).gain, 1.5) << "named otherwise";
  EXPECT_EQ(shown()["all"]["gain"], 0.5);
  EXPECT_EQ(shown().size(), 3U);
  EXPECT_EQ(set({{"name", "jawLeft"}, {"dead_zone", 0.1}})["gain"], 0.5) << "what is not given stays";

  EXPECT_EQ(ask("values.reset", json::object())["result"], json::object());
  EXPECT_EQ(shown(), configured);
  set({{"name", "jawOpen"}, {"gain", 1}});
  EXPECT_EQ(shown(), json::object()) << "the plain one is not shown";
}

TEST_F(ValueMethods, RefuseWhatIsNoTuning) {
  EXPECT_THAT(refusal({{"name", "jaw"}, {"gain", 1}}), HasSubstr("'jaw' is none of ARKit's values"));
  EXPECT_THAT(refusal({{"gain", 1}}), HasSubstr("name is missing"));
  EXPECT_THAT(refusal({{"name", "jawOpen"}}), HasSubstr("nothing to set"));
  EXPECT_THAT(refusal({{"name", "jawOpen"}, {"gain", 10.5}}), HasSubstr("gain must be from 0 to 10"));
  EXPECT_THAT(refusal({{"name", "jawOpen"}, {"gain", -1}}), HasSubstr("gain must be from 0 to 10"));
  EXPECT_THAT(refusal({{"name", "jawOpen"}, {"dead_zone", 1}}), HasSubstr("dead_zone must be from 0 to 0.9"));
  EXPECT_THAT(refusal({{"name", "all"}, {"gain", 2}, {"smoothing_ms", 2001}}),
              HasSubstr("smoothing_ms must be from 0 to 2000"));
  EXPECT_THAT(refusal({{"name", "jawOpen"}, {"gain", "2"}}), HasSubstr("gain must be a number"));
  EXPECT_THAT(refusal({{"name", "jawOpen"}, {"gian", 2}}), HasSubstr("unknown param"));
  for (const char* method : {"values.set", "values.reset"}) {
    EXPECT_EQ(ask(method, json::object(), false)["error"]["code"], kPermissionDenied) << method;
  }
  EXPECT_EQ(bridge_.status().values.all, ValueTuning()) << "nothing of what is refused is taken";
  EXPECT_EQ(bridge_.status().values.named, config_.values.named);
}

}  // namespace
}  // namespace facet::service
