#include "service/take_index.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "facet/error.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/recorder.hpp"

namespace facet::service {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

class TakeIndexTest : public ::testing::Test {
 protected:
  std::filesystem::path file(const std::string& name) const { return folder_.path() / (name + ".take"); }

  void record(const std::string& name, int frames) const {
    take::TakeRecorderConfig config;
    config.file = file(name);
    config.when_full = take::WhenFull::Wait;
    take::TakeRecorder recorder(config);
    recorder.start();
    add(recorder, frames);
    recorder.stop();
  }
  static void add(take::TakeRecorder& recorder, int frames) {
    for (int i = 0; i < frames; ++i) {
      auto frame = std::make_shared<mesh::MeshFrame>();
      frame->sequence = static_cast<std::uint64_t>(i);
      frame->timestamp_ns = frame->media_time_ns = std::int64_t{33'333'333} * i;
      recorder.record(std::move(frame));
    }
  }
  json list() {
    index_.changed();
    return json::parse(index_.list());
  }
  static const json& entry(const json& list, const std::string& name) {
    static const json none;
    for (const json& one : list["takes"]) {
      if (one["name"] == name) {
        return one;
      }
    }
    ADD_FAILURE() << name << " is not listed";
    return none;
  }

  test::TemporaryFolder folder_;
  Thumbnails thumbnails_{folder_.path()};
  TakeIndex index_{folder_.path(), thumbnails_};
};

TEST_F(TakeIndexTest, ReadsATakeOnceUntilItChanges) {
  for (int i = 0; i < 5; ++i) {
    record(fmt::format("t{}", i), 1 + i);
  }
  EXPECT_EQ(index_.number(), 0U);
  json listed = list();
  EXPECT_EQ(listed["count"], 5);
  EXPECT_EQ(entry(listed, "t3")["frames"], 4);
  EXPECT_EQ(index_.reads(), 5U);
  EXPECT_EQ(index_.number(), 1U);
  list();
  EXPECT_EQ(index_.reads(), 5U) << "nothing changed";
  EXPECT_EQ(index_.number(), 1U);
  std::filesystem::remove(file("t3"));
  std::filesystem::rename(file("t1"), file("t3"));
  listed = list();
  EXPECT_EQ(listed["count"], 4);
  EXPECT_EQ(entry(listed, "t3")["frames"], 2);
  EXPECT_EQ(index_.reads(), 6U);
  EXPECT_EQ(index_.number(), 2U);
}

TEST_F(TakeIndexTest, AskedWithoutEndItRests) {
  record("one", 3);
  index_.list();
  record("two", 3);
  // Whatever the machine does meanwhile: at once it is the list from before, and in the end the new one.
  const auto soon = std::chrono::steady_clock::now() + std::chrono::milliseconds(50);
  const std::string at_once = index_.list();
  if (std::chrono::steady_clock::now() < soon && json::parse(at_once)["count"] == 1) {
    EXPECT_EQ(index_.number(), 1U);
  }
  while (json::parse(index_.list())["count"] != 2) {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  EXPECT_EQ(index_.number(), 2U);
}

TEST_F(TakeIndexTest, OneBadFileSpoilsNothing) {
  record("good", 2);
  const std::string long_name(101, 'n');
  for (const std::string& name :
       {long_name, std::string(".dot"), std::string("tab\there"), std::string("\xff\xfe")}) {
    std::filesystem::copy_file(file("good"), file(name));
  }
  std::ofstream(file("text")) << "this is no take";
  std::filesystem::create_directory(file("folder"));
  std::filesystem::create_symlink("nowhere", file("link"));
  ASSERT_EQ(::mkfifo(file("pipe").c_str(), 0600), 0);
  const json listed = list();
  EXPECT_EQ(entry(listed, "good")["frames"], 2);
  EXPECT_FALSE(entry(listed, "good").contains("error"));
  EXPECT_THAT(entry(listed, long_name)["error"].get<std::string>(), HasSubstr("100 bytes"));
  EXPECT_TRUE(entry(listed, ".dot").contains("error"));
  EXPECT_TRUE(entry(listed, "tab\there").contains("error"));
  EXPECT_TRUE(entry(listed, "text").contains("error"));
  EXPECT_EQ(listed["count"], 6) << "what is no file is no take";
}

TEST_F(TakeIndexTest, OnlyTheNewestAreLookedInto) {
  record("t0", 1);
  for (std::size_t i = 1; i < TakeIndex::kMostListed + 30; ++i) {
    std::filesystem::copy_file(file("t0"), file(fmt::format("t{}", i)));
  }
  json listed = list();
  EXPECT_EQ(listed["count"], TakeIndex::kMostListed + 30);
  EXPECT_EQ(listed["takes"].size(), TakeIndex::kMostListed);
  EXPECT_EQ(index_.reads(), TakeIndex::kMostListed);
  // At the start only those with a log beside them are closed.
  index_.close_broken_off(Log(LogLevel::Error), [] { return true; });
  EXPECT_EQ(index_.reads(), TakeIndex::kMostListed);
}

TEST_F(TakeIndexTest, ClosesWhatWasBrokenOffAndNothingElse) {
  record("whole", 2);
  take::TakeRecorderConfig config;
  config.file = file("going-on");
  config.when_full = take::WhenFull::Wait;
  take::TakeRecorder recorder(config);
  recorder.start();
  add(recorder, 4);
  while (recorder.status().frames < 4) {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  // As a kill would leave it.
  std::filesystem::copy_file(file("going-on"), file("killed"));
  std::filesystem::copy_file(file("going-on").string() + "-wal", file("killed").string() + "-wal");
  json listed = list();
  EXPECT_FALSE(entry(listed, "killed")["closed"].get<bool>());
  index_.close_broken_off(Log(LogLevel::Error), [] { return true; });
  listed = list();
  EXPECT_TRUE(entry(listed, "killed")["closed"].get<bool>());
  EXPECT_EQ(entry(listed, "killed")["frames"], 4);
  EXPECT_THAT(entry(listed, "killed")["end_reason"].get<std::string>(), HasSubstr("broken off"));
  EXPECT_FALSE(entry(listed, "going-on")["closed"].get<bool>());
  add(recorder, 1);
  EXPECT_EQ(recorder.stop().state, take::RecorderState::Finished);
  EXPECT_EQ(entry(list(), "going-on")["frames"], 5);
}

}  // namespace
}  // namespace facet::service
