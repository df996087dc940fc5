// How facetd ends: on a signal in every state, with its source, and killed.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include "daemon_fixture.hpp"
#include "support/videos.hpp"
#include "take/reader.hpp"

namespace facet::service {
namespace {

TEST_F(DaemonWithAssets, StopsWhileStarting) {
  const auto daemon = start(configure(looped()));
  await(*daemon, [](const json&) { return true; });
  daemon->send(SIGTERM);
  expect_end(*daemon);
}

TEST_F(DaemonWithAssets, StopsWhileWaitingForAReader) {
  const auto daemon = start(configure(looped() + "\nwait_for_reader = true"));
  await(*daemon, [](const json& status) { return status["state"] == "waiting for a reader"; });
  daemon->send(SIGINT);
  expect_clean_end(*daemon);
}

/// How long a frame's work takes depends on the machine: a thread that does not end at all is left behind
/// every time.
TEST_F(DaemonWithAssets, StopsWithAllItsThreads) {
  const std::string nobody = grey_source(600);  // looked at ahead whole, which takes a while
  const std::filesystem::path broken = folder_.path() / "broken.mkv";
  std::filesystem::copy_file(grey(), broken);
  test::cut_before_first_frame(broken);
  const std::vector<std::pair<std::string, std::string>> sources = {
      {nobody, "preparing"},
      {looped(), "running"},
      {fmt::format("path = \"{}\"", broken.string()), "failed"}};
  for (const auto& [source, state] : sources) {
    std::string output;
    for (int attempt = 0; attempt < 5 && output.find("stopped") == std::string::npos; ++attempt) {
      const auto daemon = start(configure(source));
      const json now = await(*daemon, [](const json& status) { return status["state"] != "starting"; });
      if (state != "preparing") {
        await(*daemon, [&, wanted = state](const json& status) { return status["state"] == wanted; });
      } else {
        EXPECT_EQ(now["state"], state);
      }
      ASSERT_FALSE(HasFailure());
      daemon->send(SIGTERM);
      expect_clean_end(*daemon);
      output = daemon->output();
    }
#ifndef FACET_SANITIZED  // slowed down, any frame's work may outlast the daemon's patience
    EXPECT_THAT(output, HasSubstr("stopped")) << state;
#endif
  }
}

TEST_F(DaemonWithAssets, ExitsAtTheEndWithEveryFrameRecorded) {
  const auto daemon =
      start(configure(fmt::format("path = \"{}\"\nframes = \"5:45\"\nexit_at_end = true", clip().string()),
                      "record_at_start = \"all\""));
  expect_clean_end(*daemon);
  take::TakeReader reader(folder_.path() / "takes/all.take");
  ASSERT_EQ(reader.frame_count(), 40);
  EXPECT_EQ(reader.entry(0).sequence, 5U);
  EXPECT_EQ(reader.entry(39).sequence, 44U);
  EXPECT_GT(reader.info().mesh_frame_count, 30);
}

TEST_F(DaemonWithAssets, StaysAfterTheEndUnlessToldOtherwise) {
  const auto daemon = start(configure(fmt::format("path = \"{}\"\nframes = \":8\"", clip().string())));
  const json status = await(*daemon, [](const json& now) { return now["state"] == "ended"; });
  EXPECT_EQ(status["frames"]["processed"], 8);
  EXPECT_EQ(status["frames"]["dropped"], 0);
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
}

TEST_F(DaemonWithAssets, AFailedSourceIsReportedAndTheDaemonStays) {
  const std::string source = grey_source(3);
  test::cut_before_first_frame(grey());
  const auto daemon = start(configure(source));
  const json status = await(*daemon, [](const json& now) { return now["state"] == "failed"; });
  EXPECT_THAT(status["reason"].get<std::string>(), AllOf(HasSubstr("grey.mkv"), HasSubstr("no frame")));
  EXPECT_EQ(ask("takes.list")["count"], 0);
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
  EXPECT_THAT(daemon->output(), HasSubstr("grey.mkv"));
  std::string output;
  EXPECT_EQ(run({"--config", configure(source + "\nexit_at_end = true")}, output), 3);
  EXPECT_THAT(output, HasSubstr("grey.mkv"));
}

TEST_F(DaemonWithAssets, ATruncatedSourceEndsWithItsReason) {
  const std::string source = grey_source(40);
  std::filesystem::resize_file(grey(), std::filesystem::file_size(grey()) * 3 / 4);
  const auto daemon = start(configure(source));
  const json status = await(*daemon, [](const json& now) { return now["state"] == "ended"; });
  EXPECT_THAT(status["reason"].get<std::string>(), HasSubstr("grey.mkv"));
  EXPECT_GT(status["frames"]["processed"], 10);
  EXPECT_LT(status["frames"]["processed"], 40);
  ask("shutdown");
  expect_clean_end(*daemon);
}

TEST_F(DaemonWithAssets, ExitsAtAnEarlyEndWithStatus3AndATakeThatKnowsItsVideo) {
  const std::string config_file =
      configure(grey_source(40) + "\nexit_at_end = true", "record_at_start = \"rest\"");
  std::filesystem::resize_file(grey(), std::filesystem::file_size(grey()) * 3 / 4);
  std::string text;
  std::getline(std::ifstream(config_file), text, '\0');
  text.replace(text.find(grey().string()), grey().string().size(), "grey.mkv");
  std::ofstream(config_file) << text;
  // Every path is then relative to where the daemon was started.
  const auto config = std::filesystem::path(config_file).lexically_relative(std::filesystem::current_path());
  std::string output;
  EXPECT_EQ(run({"--config", config.string()}, output), 3) << output;
  EXPECT_THAT(output, AllOf(HasSubstr("grey.mkv"), HasSubstr("the source ended early")));
  const take::TakeReader reader(folder_.path() / "takes/rest.take");
  EXPECT_TRUE(reader.info().closed);
  EXPECT_GT(reader.frame_count(), 10);
  EXPECT_LT(reader.frame_count(), 40);
  EXPECT_EQ(reader.info().source, grey().string());
}

TEST_F(DaemonWithAssets, SurvivesItsOwnKill) {
  const std::string config = configure(looped());
  {
    const auto daemon = start(config);
    await(*daemon, is_running);
    ask("record.start", {{"name", "killed"}});
    await(*daemon, [](const json& now) { return now["recording"]["frames"] > 20; });
    daemon->send(SIGKILL);
    EXPECT_EQ(daemon->wait(), 128 + SIGKILL);
  }
  EXPECT_TRUE(std::filesystem::exists(control())) << "the stale socket that the next one finds";
  const auto next = start(config);
  await(*next, is_running);
  const json listed = ask("takes.list");
  ASSERT_EQ(listed["count"], 1);
  EXPECT_TRUE(listed["takes"][0]["closed"].get<bool>()) << "closed by the next one";
  EXPECT_GT(listed["takes"][0]["frames"], 20);
  std::string output;
  ChildProcess second(FACETD_PROGRAM, {"--config", config}, folder_.path() / "second-log");
  EXPECT_EQ(second.wait(), 6);
  EXPECT_THAT(second.output(), HasSubstr("in use by another running program"));
  EXPECT_EQ(ask("status")["state"], "running") << "the running one is not disturbed";
  next->send(SIGTERM);
  expect_clean_end(*next);
}

}  // namespace
}  // namespace facet::service
