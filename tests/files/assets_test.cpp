// Where programs find what lies beside them, wherever they were moved to.

#include "facet/assets.hpp"

#include <gtest/gtest.h>

#include <cstdlib>

namespace facet {
namespace {

TEST(Assets, TheVariableComesFirstThenWhatLiesBesideThenWhatWasBuiltIn) {
  const char* before = std::getenv("FACET_ASSETS");
  const std::string kept = before != nullptr ? before : "";
  ::setenv("FACET_ASSETS", "/elsewhere", 1);
  EXPECT_EQ(assets_folder(), "/elsewhere");
  ::unsetenv("FACET_ASSETS");

  const auto program = std::filesystem::read_symlink("/proc/self/exe");
  const auto share = program.parent_path().parent_path() / "share";
  ASSERT_FALSE(std::filesystem::exists(share)) << share << " is in the way of this test";
  EXPECT_EQ(share_beside_program(), "");
  EXPECT_EQ(assets_folder(), FACET_ASSETS_FOLDER);
  std::filesystem::create_directories(share / "facet");
  EXPECT_EQ(assets_folder(), share / "facet");
  EXPECT_EQ(default_model_file(), share / "facet" / "default.facemodel");
  std::filesystem::remove_all(share);
  if (!kept.empty()) {
    ::setenv("FACET_ASSETS", kept.c_str(), 1);
  }
}

}  // namespace
}  // namespace facet
