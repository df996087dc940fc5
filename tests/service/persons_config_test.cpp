// [model] person and [persons] of the configuration.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "facet/error.hpp"
#include "service/config.hpp"

namespace facet::service {
namespace {

using ::testing::HasSubstr;

pipeline::ShadingConfig read(const std::string& text) {
  return parse_config(text, "/etc/facet/facet.toml").pipeline;
}

std::string error_of(const std::string& text) {
  try {
    read(text);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "";
}

TEST(PersonsConfig, APersonIsANameOrAFile) {
  EXPECT_EQ(read("[model]\nperson = \"ada\"\n").person, "ada");
  EXPECT_EQ(read("[model]\nperson = \"ada.person\"\n").person, "/etc/facet/ada.person");
  EXPECT_EQ(read("[model]\nperson = \"kept/ada\"\n").person, "/etc/facet/kept/ada");
  EXPECT_EQ(read("[model]\nperson = \"/x/ada.person\"\n").person, "/x/ada.person");
  EXPECT_THAT(error_of("[model]\nperson = \"\""), HasSubstr("facet.toml:2: model.person: '' is no name"));
  EXPECT_THAT(error_of("[model]\nperson = \"..\""), HasSubstr("model.person: '..' is no name"));
  EXPECT_THAT(error_of("[model]\nperson = \"auto\""), HasSubstr("model.person: 'auto' is no name"));
  EXPECT_THAT(error_of("[model]\nperson = 3"), HasSubstr("model.person: must be a name or a file"));
}

TEST(PersonsConfig, WhoTurnsBeforeALiveCameraIsLearnedUnlessThatIsLeftOut) {
  EXPECT_TRUE(read("").learn_live);
  EXPECT_FALSE(read("[model]\nlearn = false\n").learn_live);
  EXPECT_FALSE(read("").learn_ahead) << "a daemon does not look at a recording for a minute before it begins";
  EXPECT_THAT(error_of("[model]\nlearn = \"yes\""), HasSubstr("model.learn: must be"));
}

TEST(PersonsConfig, NobodyIsKeptUnlessAsked) {
  EXPECT_EQ(default_config().pipeline.persons_folder, "");
  EXPECT_EQ(read("[persons]\nfolder = \"\"\n").persons_folder, "");
  EXPECT_EQ(read("[persons]\nfolder = \"kept\"\n").persons_folder, "/etc/facet/kept");
  EXPECT_THAT(error_of("[persons]\nfolder = true"), HasSubstr("persons.folder: must be a path"));
}

}  // namespace
}  // namespace facet::service
