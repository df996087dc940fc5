// [bridges.values] of the configuration, and values.* and mapping.* of the control protocol.

#include "service/value_methods.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <regex>
#include <string>

#include "avatar/mapping_file.hpp"
#include "facet/error.hpp"
#include "mesh/arkit.hpp"
#include "service/config.hpp"
#include "service/errands.hpp"
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
    const json request = {{"jsonrpc", "2.0"}, {"id", 1}, {"method", method}, {"params", params}};
    return json::parse(answer_request(methods_, request.dump(), {1, 1000, member}));
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
  Errands writer_{"writer"};
  ControlMethods methods_ = value_methods(bridge_, config_, writer_);
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

class MappingMethods : public ValueMethods {
 protected:
  json map(const std::string& table, const std::string& name, const std::string& formula) {
    return ask("mapping.set", {{"table", table}, {"name", name}, {"formula", formula}});
  }
  std::string why_not(const std::string& table, const std::string& name, const std::string& formula) {
    const json answer = map(table, name, formula);
    return answer.contains("error") ? answer["error"]["message"].get<std::string>() : "";
  }
  json mapping() { return ask("mapping.get", json::object(), false)["result"]; }
  json save() { return ask("mapping.save", json::object()); }
  void save_to(const std::filesystem::path& file) {
    config_.mapping_file = file;
    methods_ = value_methods(bridge_, config_, writer_);
  }
};

TEST_F(MappingMethods, SetOneAfterTheOtherAndTakeItAway) {
  EXPECT_EQ(mapping(),
            json::parse(R"({"file": null, "saved": true, "vmc": [], "vrchat": [], "vtube_studio": []})"));
  EXPECT_EQ(map("vmc", "A", "0.8 * jawOpen")["result"],
            json::parse(R"({"table": "vmc", "name": "A", "formula": "0.8 * jawOpen"})"));
  map("vmc", "Grin", "mouthSmileLeft");
  map("vrchat", "v2/JawOpen", "-2");
  map("vtube_studio", "MouthOpen", "jawOpen - 20");
  map("vmc", "A", "jawOpen + 0.25");
  const json now = mapping();
  EXPECT_EQ(now["vmc"], json::parse(R"([{"name": "A", "formula": "jawOpen + 0.25"},
                                        {"name": "Grin", "formula": "mouthSmileLeft"}])"))
      << "a name keeps its place";
  EXPECT_EQ(now["saved"], false);
  EXPECT_EQ(ask("mapping.values", json::object(), false)["result"],
            json::parse(R"({"vmc": {"A": 0.25, "Grin": 0.0}, "vrchat": {"v2/JawOpen": -1.0},
                            "vtube_studio": {"MouthOpen": -20.0}})"))
      << "as sent: cut, of a face at rest";
  EXPECT_EQ(bridge_.mapping().vmc.size(), 2U);

  EXPECT_EQ(ask("mapping.unset", {{"table", "vmc"}, {"name", "A"}})["result"], json::object());
  EXPECT_EQ(mapping()["vmc"].size(), 1U);
  EXPECT_THAT(ask("mapping.unset", {{"table", "vmc"}, {"name", "A"}})["error"]["message"].get<std::string>(),
              HasSubstr("vmc has no formula for 'A'"));
  EXPECT_EQ(ask("mapping.reset", json::object())["result"], json::object());
  EXPECT_TRUE(mapping()["vmc"].empty());
  EXPECT_EQ(mapping()["saved"], true);
}

TEST_F(MappingMethods, SayWhatIsWrongAndAtWhichLetter) {
  EXPECT_THAT(why_not("vmc", "A", "0.5 * jawOpne"),
              AllOf(HasSubstr("'jawOpne' is no value of ARKit's"), HasSubstr("(letter 7)")));
  EXPECT_THAT(why_not("vmc", "A", ""), HasSubstr("(letter 1)"));
  EXPECT_THAT(why_not("vmc", "", "1"), HasSubstr("is no name that can be sent"));
  EXPECT_THAT(why_not("vrchat", "Jaw Open", "1"), HasSubstr("without spaces"));
  EXPECT_THAT(why_not("vtube_studio", "Jaw", "1"), HasSubstr("4 to 32 letters and digits"));
  EXPECT_THAT(why_not("vtube_studio", "JawÖpen", "1"), HasSubstr("4 to 32 letters and digits"));
  EXPECT_EQ(why_not("vmc", "Jaw Open", "1"), "");
  EXPECT_THAT(why_not("osc", "A", "1"), HasSubstr("'osc' is no table"));
  for (std::size_t i = mapping()["vmc"].size(); i < avatar::kMostMappedValues; ++i) {
    EXPECT_EQ(why_not("vmc", "name" + std::to_string(i), "1"), "");
  }
  EXPECT_THAT(why_not("vmc", "A", "1"), HasSubstr("256 names already"));
  EXPECT_EQ(why_not("vmc", "Jaw Open", "2"), "") << "one that is there can be changed";
  for (const char* method : {"mapping.set", "mapping.unset", "mapping.save", "mapping.reset"}) {
    EXPECT_EQ(ask(method, json::object(), false)["error"]["code"], kPermissionDenied) << method;
  }
}

TEST_F(MappingMethods, WithoutAFileSayWhichKeyIsMissing) {
  map("vmc", "A", "jawOpen");
  EXPECT_THAT(save()["error"]["message"].get<std::string>(), HasSubstr("[bridges] mapping ="));
  EXPECT_EQ(mapping()["saved"], false);
}

TEST_F(MappingMethods, WhatWasSavedIsThereAtTheNextStart) {
  save_to(folder_.path() / "avatar.toml");
  map("vrchat", "FT/v2/JawOpen", "clamp(1.5 * jawOpen, 0, 1)");
  map("vmc", "笑い \"2\\", "mouthSmileLeft\n+ 0.1");
  set({{"name", "jawOpen"}, {"gain", 1.25}, {"smoothing_ms", 33}});
  const avatar::ValueTunings tuned = bridge_.status().values;
  EXPECT_EQ(save()["result"]["file"], config_.mapping_file.string());

  const avatar::Bridge next(config_);
  EXPECT_EQ(next.mapping(), bridge_.mapping());
  EXPECT_EQ(next.status().values, tuned) << "and not those of the configuration";
  std::ofstream(config_.mapping_file, std::ios::app) << "[vmc]\n";
  EXPECT_THROW(avatar::Bridge{config_}, Error) << "it is read";
}

TEST_F(MappingMethods, ResetGoesBackToWhatWasSaved) {
  save_to(folder_.path() / "avatar.toml");
  const auto call = [&](const char* method, const json& params) { return ask(method, params)["result"]; };
  call("mapping.set", {{"table", "vmc"}, {"name", "A"}, {"formula", "1"}});
  call("values.set", {{"name", "jawOpen"}, {"gain", 2}});
  call("mapping.save", json::object());
  EXPECT_EQ(call("mapping.get", json::object())["saved"], true);
  call("mapping.set", {{"table", "vmc"}, {"name", "A"}, {"formula", "2"}});
  call("values.set", {{"name", "jawOpen"}, {"gain", 3}});
  EXPECT_EQ(call("mapping.get", json::object())["saved"], false);
  call("values.reset", json::object());
  EXPECT_EQ(bridge_.status().values.of(index_of("jawOpen")).gain, 2);
  EXPECT_EQ(call("mapping.get", json::object())["saved"], false) << "the formula is another yet";
  call("mapping.reset", json::object());
  EXPECT_EQ(call("mapping.get", json::object())["saved"], true);
  EXPECT_EQ(call("mapping.get", json::object())["vmc"][0]["formula"], "1");
}

TEST_F(MappingMethods, AFolderThatCantBeWrittenIsToldAndNothingIsSaved) {
  save_to(folder_.path() / "none" / "avatar.toml");
  map("vmc", "A", "1");
  const json answer = save();
  EXPECT_EQ(answer["error"]["code"], kServerErrorBase - static_cast<int>(ErrorKind::Storage));
  EXPECT_THAT(answer["error"]["message"].get<std::string>(), HasSubstr("avatar.toml"));
  EXPECT_EQ(mapping()["saved"], false);
}

}  // namespace
}  // namespace facet::service
