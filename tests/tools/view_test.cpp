// `facet view` where there is no screen.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "support/child_process.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/recorder.hpp"

namespace facet::tools {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

TEST(View, ShowsAFrameInATerminalWhereThereIsNoScreen) {
  const test::TemporaryFolder folder;
  const std::string take = folder.path() / "some.take";
  const std::string sheet = folder.path() / "sheet.png";
  take::TakeRecorder recorder({.file = take,
                               .source = "elsewhere.mp4",
                               .software = "test",
                               .when_full = take::WhenFull::Wait,
                               .disk_reserve_bytes = 0});
  recorder.start();
  for (std::uint64_t sequence = 0; sequence < 3; ++sequence) {
    recorder.record(
        std::make_shared<mesh::MeshFrame>(test::patch_frame(sequence, test::patch_subject(), nullptr)));
  }
  ASSERT_EQ(recorder.stop().state, take::RecorderState::Finished);
  std::string output;
  const auto run = [&](const std::vector<std::string>& arguments) {
    test::ChildProcess child(FACET_PROGRAM, arguments, folder.path() / "log");
    const int status = child.wait();
    output = child.output();
    return status;
  };
  ASSERT_EQ(run({"view", take, "--terminal"}), 0) << output;
  EXPECT_THAT(output, AllOf(HasSubstr("\x1b[38;"), HasSubstr("\u2580"), HasSubstr("\x1b[0m\n")));
  EXPECT_FALSE(std::filesystem::exists(sheet));
  ASSERT_EQ(run({"view", take, "--terminal", "-o", sheet}), 0) << output;
  EXPECT_TRUE(std::filesystem::exists(sheet));
  EXPECT_EQ(run({"view", take}), 2);
  EXPECT_THAT(output, AllOf(HasSubstr("-o"), HasSubstr("--terminal")));
}

}  // namespace
}  // namespace facet::tools
