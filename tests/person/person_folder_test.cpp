#include "person/person_folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::person {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class PersonFolder : public ::testing::Test {
 protected:
  PersonFolder() : model_(test::synthetic_model(21)) {}

  std::filesystem::path folder() const { return folder_.path(); }

  std::filesystem::path store(const std::string& name, const std::string& file) {
    PersonFile person;
    person.name = name;
    person.created_utc = "2026-11-25T15:04:05Z";
    person.model_name = model_.name;
    person.model_checksum = model_checksum(model_);
    person.focal_px = 1000;
    person.width_px = 640;
    person.height_px = 360;
    person.identity.assign(static_cast<std::size_t>(model_.identity_count()), 0);
    person.neutral_mm = model_.contract_identity(person.identity).neutral_mm;
    write_person(person, folder() / file);
    return folder() / file;
  }

  /// What a refusal says; kind: of it.
  static std::string refusal(ErrorKind kind, const std::function<void()>& call) {
    try {
      call();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), kind) << error.what();
      return error.what();
    }
    return "";
  }

  face::FaceModel model_;
  test::TemporaryFolder folder_;
};

TEST_F(PersonFolder, ListsBadFilesByNameBesideTheGoodOnes) {
  store("grace", "grace.person");
  const std::filesystem::path cut = store("ada", "ada.person");
  std::filesystem::resize_file(cut, std::filesystem::file_size(cut) / 2);
  std::ofstream(folder() / "notes.txt") << "no person";
  std::ofstream(folder() / "empty.person");
  std::filesystem::create_directory(folder() / "folder.person");
  std::vector<std::string> names;
  for (const StoredPerson& stored : stored_persons(folder())) {
    names.push_back(stored.name());
    EXPECT_EQ(stored.fault.empty(), stored.name() == "grace") << stored.fault;
    EXPECT_TRUE(stored.fault.empty() || stored.fault.find(stored.file.filename()) != std::string::npos);
  }
  EXPECT_THAT(names, ElementsAre("ada", "empty", "folder", "grace"));
}

TEST_F(PersonFolder, AFolderThatIsNotThereIsNamed) {
  EXPECT_THAT(refusal(ErrorKind::UnreadableInput, [&] { stored_persons(folder() / "none"); }),
              HasSubstr("none': No such file"));
  EXPECT_THAT(refusal(ErrorKind::Storage, [&] { new_person_file(folder() / "none", "ada"); }),
              HasSubstr("is not there: make it"));
  EXPECT_THAT(refusal(ErrorKind::Usage, [&] { new_person_file("", "ada"); }), HasSubstr("[persons] folder"));
  EXPECT_THAT(refusal(ErrorKind::Usage, [&] { person_file("ada", ""); }), HasSubstr("[persons] folder"));
}

TEST_F(PersonFolder, AFolderThatCannotBeWrittenToIsNamed) {
  ASSERT_EQ(::chmod(folder().c_str(), 0555), 0);
  const bool root = ::geteuid() == 0;
  ASSERT_TRUE(!root || ::seteuid(65534) == 0);  // root may write everywhere
  const std::string said = refusal(ErrorKind::Storage, [&] { new_person_file(folder(), "ada"); });
  ASSERT_TRUE(!root || ::seteuid(0) == 0);
  ASSERT_EQ(::chmod(folder().c_str(), 0755), 0);
  EXPECT_THAT(said, HasSubstr("can't be written to: Permission denied"));
}

TEST_F(PersonFolder, NamesThatAreNoneAreRefused) {
  for (const std::string& name :
       {std::string(), std::string(".."), std::string("."), std::string("../ada"), std::string("a/b"),
        std::string("a\nb"), std::string("auto"), std::string("ada.person"), std::string("a\xFF"),
        std::string(65, 'a'), std::string("a\x7F")}) {
    EXPECT_THAT(refusal(ErrorKind::Usage, [&] { new_person_file(folder(), name); }),
                HasSubstr("is no name for a person"))
        << name;
  }
  for (const std::string name : {"ada", "Ada Lovelace", "Zo\xC3\xAB", "a.b", "-"}) {
    EXPECT_EQ(new_person_file(folder(), name), folder() / (name + ".person"));
  }
}

TEST_F(PersonFolder, FindsByNameAndByFile) {
  const std::filesystem::path ada = store("ada", "ada.person");
  const std::filesystem::path moved = store("grace", "hopper.person");
  EXPECT_EQ(person_file("ada", folder()), ada);
  EXPECT_EQ(person_file("grace", folder()), moved);
  EXPECT_EQ(person_file("hopper", folder()), moved);
  EXPECT_EQ(person_file("./x", folder()), "./x") << "a path is a path";
  EXPECT_EQ(person_file("x.person", ""), "x.person");
  EXPECT_THAT(refusal(ErrorKind::Usage, [&] { person_file("alan", folder()); }),
              AllOf(HasSubstr("nobody is called 'alan'"), HasSubstr("stored there: ada, grace")));
  EXPECT_THAT(refusal(ErrorKind::Usage, [&] { person_file("..", folder()); }), HasSubstr("is no name"));
}

TEST_F(PersonFolder, TwoOfOneNameAreAskedFor) {
  store("ada", "ada.person");
  store("ada", "copy.person");
  EXPECT_THAT(
      refusal(ErrorKind::Usage, [&] { person_file("ada", folder()); }),
      AllOf(HasSubstr("2 persons are called 'ada'"), HasSubstr("ada.person"), HasSubstr("copy.person")));
  EXPECT_EQ(person_file("copy", folder()), folder() / "copy.person");
  EXPECT_THAT(refusal(ErrorKind::Usage, [&] { new_person_file(folder(), "copy"); }),
              HasSubstr("somebody is called 'copy' already"));
}

TEST_F(PersonFolder, DeletesPersonsAlone) {
  const std::filesystem::path ada = store("ada", "ada.person");
  const std::filesystem::path grace = store("grace", "grace.person");
  delete_person(ada);
  EXPECT_FALSE(std::filesystem::exists(ada));
  EXPECT_TRUE(std::filesystem::exists(grace));
  EXPECT_THAT(refusal(ErrorKind::UnreadableInput, [&] { delete_person(ada); }), HasSubstr("is not there"));

  const std::filesystem::path notes = folder() / "notes.person";
  std::ofstream(notes) << "these are notes, longer than a header of a person is";
  EXPECT_THAT(refusal(ErrorKind::Usage, [&] { delete_person(notes); }), HasSubstr("is no person's file"));
  EXPECT_TRUE(std::filesystem::exists(notes));
  std::filesystem::create_symlink(grace, folder() / "link.person");
  EXPECT_THAT(refusal(ErrorKind::Usage, [&] { delete_person(folder() / "link.person"); }),
              HasSubstr("a link"));
  EXPECT_THAT(refusal(ErrorKind::Usage, [&] { delete_person(folder()); }), HasSubstr("a folder"));
  EXPECT_TRUE(std::filesystem::exists(grace));

  std::filesystem::resize_file(grace, std::filesystem::file_size(grace) / 2);
  delete_person(grace);
  EXPECT_FALSE(std::filesystem::exists(grace)) << "half a face is one, too";
}

}  // namespace
}  // namespace facet::person
