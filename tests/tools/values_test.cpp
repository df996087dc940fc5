// `facet values` and `facet mapping` as a user meets them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "answering.hpp"
#include "avatar/mapping_file.hpp"
#include "facet/error.hpp"
#include "mesh/arkit.hpp"
#include "service/config.hpp"
#include "service/errands.hpp"
#include "service/status_report.hpp"
#include "service/value_methods.hpp"
#include "support/child_process.hpp"
#include "support/paths.hpp"

namespace facet::tools {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

class ValuesCommand : public ::testing::Test {
 protected:
  ValuesCommand() { writer_.start(); }
  int run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), command_);
    arguments.insert(arguments.end(), {"--socket", (folder_.path() / "control.sock").string()});
    test::ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log");
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  service::ControlMethods methods() {
    auto all = service::value_methods(bridge_, config_, writer_);
    all["status"] = {false, {}, [this](const json&) {
                       return json{{"bridges", service::to_json(bridge_.status())}};
                     }};
    return all;
  }
  static avatar::BridgeConfig config(const std::filesystem::path& folder) {
    avatar::BridgeConfig config;
    config.neutral_file = folder / "neutral.json";
    config.values.all.smoothing_ms = 20;
    config.mapping_file = folder / "avatar.toml";
    return config;
  }

  test::TemporaryFolder folder_;
  avatar::BridgeConfig config_ = config(folder_.path());
  avatar::Bridge bridge_{config_};
  service::Errands writer_{"writer"};
  test::Answering daemon_{folder_.path() / "control.sock", methods()};
  std::string command_ = "values";
  std::string output_;
};

TEST_F(ValuesCommand, SetsTellsTheLineToKeepAndGoesBack) {
  const std::string all = "all = { gain = 1, dead_zone = 0, smoothing_ms = 20 }\n";
  EXPECT_EQ(run({}), 0) << output_;
  EXPECT_EQ(output_, all);
  const std::string line = "jawOpen = { gain = 1.2, dead_zone = 0.05, smoothing_ms = 20 }\n";
  EXPECT_EQ(run({"jawOpen", "--gain", "1.2", "--dead-zone", "0.05"}), 0) << output_;
  EXPECT_THAT(output_,
              AllOf(HasSubstr("until the daemon ends"), HasSubstr("[bridges.values]"), HasSubstr(line)));
  // What it says to put into the configuration gives what the daemon has now.
  const avatar::ValueTunings now = bridge_.status().values;
  const avatar::ValueTunings kept =
      service::parse_config("[bridges.values]\n" + all + line, "facet.toml").bridges.values;
  EXPECT_EQ(kept.all, now.all);
  EXPECT_EQ(kept.named, now.named);
  EXPECT_EQ(run({}), 0);
  EXPECT_EQ(output_, all + line);
  EXPECT_EQ(run({"all", "--smoothing-ms", "0"}), 0) << output_;
  EXPECT_EQ(bridge_.status().values.all, avatar::ValueTuning());
  EXPECT_EQ(run({"--reset"}), 0) << output_;
  EXPECT_EQ(run({}), 0);
  EXPECT_EQ(output_, all) << "as configured";
  bridge_.tune({});
  EXPECT_EQ(run({}), 0);
  EXPECT_THAT(output_, HasSubstr("every value is sent as it comes"));
}

TEST_F(ValuesCommand, RefusesWhatIsNoTuning) {
  const int usage = static_cast<int>(ErrorKind::Usage);
  const auto refused = [&](const std::vector<std::string>& arguments, const char* why) {
    EXPECT_EQ(run(arguments), usage) << why;
    EXPECT_THAT(output_, HasSubstr(why));
  };
  refused({"jaw", "--gain", "2"}, "'jaw' is none of ARKit's values");
  refused({"jawOpen"}, "nothing to set");
  refused({"jawOpen", "--gain", "11"}, "--gain: Value 11 not in range 0");
  refused({"jawOpen", "--dead-zone", "0.95"}, "--dead-zone: Value 0.95 not in range 0");
  refused({"jawOpen", "--smoothing-ms", "2001"}, "--smoothing-ms: Value 2001 not in range 0");
  refused({"--gain", "2"}, "--gain requires name");
  refused({"jawOpen", "--reset"}, "name excludes --reset");
  EXPECT_EQ(bridge_.status().values.named.size(), 0U);
}

TEST_F(ValuesCommand, MappingIsSetShownSavedAndTakenAway) {
  command_ = "mapping";
  EXPECT_EQ(run({}), 0) << output_;
  EXPECT_EQ(output_, "nothing is mapped\n");
  EXPECT_EQ(run({"set", "vrchat", "v2/JawOpen", "0.25 + jawOpen"}), 0) << output_;
  EXPECT_EQ(run({"set", "vmc", "A", "jawOpen +"}), static_cast<int>(ErrorKind::Usage));
  EXPECT_THAT(output_, HasSubstr("(letter 10)"));
  EXPECT_EQ(run({"set", "osc", "A", "jawOpen"}), static_cast<int>(ErrorKind::Usage)) << output_;
  EXPECT_EQ(run({}), 0);
  EXPECT_THAT(output_, AllOf(HasSubstr("vrchat       v2/JawOpen                0.250  0.25 + jawOpen\n"),
                             HasSubstr("`facet mapping save` keeps it")));
  EXPECT_EQ(run({"save"}), 0) << output_;
  EXPECT_EQ(output_, config_.mapping_file.string() + "\n");
  EXPECT_EQ(avatar::load_mapping(config_.mapping_file), bridge_.mapping());
  EXPECT_EQ(run({"unset", "vrchat", "v2/JawOpen"}), 0) << output_;
  EXPECT_TRUE(bridge_.mapping().vrchat.empty());
  EXPECT_EQ(run({"reset"}), 0) << output_;
  EXPECT_EQ(avatar::load_mapping(config_.mapping_file), bridge_.mapping()) << "as saved";
}

}  // namespace
}  // namespace facet::tools
