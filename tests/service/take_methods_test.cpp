// Takes renamed, deleted, brought back, noted and trimmed by way of the control protocol.

#include "service/take_methods.hpp"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string_view>
#include <thread>

#include "facet/error.hpp"
#include "files/disk.hpp"
#include "service/take_bin.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/database.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::service {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::UnorderedElementsAre;
namespace fs = std::filesystem;

constexpr std::chrono::seconds kPatience{60};  // for what must come; passing never takes it

class TakeMethods : public ::testing::Test {
 protected:
  fs::path file(const std::string& name) const { return folder_.path() / name; }
  void record(const std::string& name, int frames = 10) const {
    take::TakeRecorderConfig config;
    config.file = file(name + ".take");
    config.when_full = take::WhenFull::Wait;
    config.disk_reserve_bytes = 0;
    take::TakeRecorder recorder(config);
    recorder.start();
    const auto subject = test::patch_subject();
    const auto albedo = test::patch_albedo(*subject);
    for (int i = 0; i < frames; ++i) {
      recorder.record(std::make_shared<mesh::MeshFrame>(
          test::patch_frame(static_cast<std::uint64_t>(i), subject, albedo)));
    }
    recorder.stop();
  }
  json ask(const std::string& method, const json& params = json::object(), bool member = true) {
    const json request = {{"jsonrpc", "2.0"}, {"id", 1}, {"method", method}, {"params", params}};
    return json::parse(answer_request(desk_.methods(), request.dump(), {1, 1000, member}));
  }
  json result(const std::string& method, const json& params = json::object()) {
    json answer = ask(method, params);
    EXPECT_TRUE(answer.contains("result")) << method << ": " << answer;
    return answer.contains("result") ? answer["result"] : json();
  }
  std::string refusal(const std::string& method, const json& params) {
    const json answer = ask(method, params);
    return answer.contains("error") ? answer["error"]["message"].get<std::string>()
                                    : "no error: " + answer.dump();
  }
  /// Of the folder, and of what is hidden in it.
  std::vector<std::string> names(const fs::path& folder) const {
    std::vector<std::string> found;
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(folder, error)) {
      found.push_back(entry.path().filename().string());
    }
    return found;
  }
  json listed(const std::string& name) {
    index_.changed();
    const json list = json::parse(index_.list());
    for (const json& take : list["takes"]) {
      if (take["name"] == name) {
        return take;
      }
    }
    return nullptr;
  }
  json trimmed() {
    const auto end = std::chrono::steady_clock::now() + kPatience;
    while (std::chrono::steady_clock::now() < end) {
      json now = desk_.trim_status();
      if (!now.is_null() && now["state"] != "working") {
        return now;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    ADD_FAILURE() << "not within a minute";
    return nullptr;
  }

  test::TemporaryFolder folder_;
  std::string recorded_;
  std::string in_studio_;
  Log log_{LogLevel::Error};
  Thumbnails thumbnails_{folder_.path()};
  TakeIndex index_{folder_.path(), thumbnails_};
  TakeDesk desk_{
      {folder_.path(), 0, "facet tests", [this] { return recorded_; }, [this] { return in_studio_; }},
      index_,
      log_};
};

TEST_F(TakeMethods, RenamesWithAllThatIsMadeOfATake) {
  record("monday");
  fs::create_directory(file(".thumbnails"));
  for (const char* made : {"monday.keys.json", "monday.basis", ".thumbnails/monday.png"}) {
    std::ofstream(file(made)) << made;
  }
  fs::create_directory(file("monday.frames"));
  EXPECT_EQ(result("takes.rename", {{"name", "monday"}, {"to", "tuesday 1"}})["file"],
            file("tuesday 1.take").string());
  EXPECT_THAT(names(folder_.path()),
              UnorderedElementsAre("tuesday 1.take", "tuesday 1.keys.json", "tuesday 1.basis",
                                   "tuesday 1.frames", ".thumbnails"));
  EXPECT_THAT(names(file(".thumbnails")), UnorderedElementsAre("tuesday 1.png"));
  EXPECT_EQ(listed("tuesday 1")["frames"], 10);
  EXPECT_EQ(listed("monday"), nullptr);
}

TEST_F(TakeMethods, RefusesWhatIsInUseUnknownOrTaken) {
  record("monday");
  record("tuesday");
  const json trim = {{"name", "monday"}, {"from_s", 0}, {"to_s", 1}, {"to", "short"}};
  const auto each = [&](const std::string& name, const auto& told) {
    json cut = trim;
    cut["name"] = name;
    EXPECT_THAT(refusal("takes.rename", {{"name", name}, {"to", "new"}}), told);
    EXPECT_THAT(refusal("takes.delete", {{"name", name}}), told);
    EXPECT_THAT(refusal("takes.delete", {{"name", name}, {"now", true}}), told);
    EXPECT_THAT(refusal("takes.note", {{"name", name}, {"note", "x"}}), told);
    if (in_studio_.empty()) {
      EXPECT_THAT(refusal("takes.trim", cut), told);
    }
  };
  each("nobody", HasSubstr("there is no take 'nobody'"));
  for (const char* bad : {"", ".deleted", "a/b", "../monday", "tab\t", "."}) {
    each(bad, HasSubstr("is no name for a take"));
    EXPECT_THAT(refusal("takes.rename", {{"name", "monday"}, {"to", bad}}),
                HasSubstr("is no name for a take"));
    EXPECT_THAT(refusal("takes.restore", {{"name", bad}}), HasSubstr("is no name for a take"));
    json cut = trim;
    cut["to"] = bad;
    EXPECT_THAT(refusal("takes.trim", cut), HasSubstr("is no name for a take"));
  }
  recorded_ = "monday";
  each("monday", AllOf(HasSubstr("'monday' is being recorded"), HasSubstr("record.stop")));
  recorded_.clear();
  in_studio_ = "monday";
  each("monday", AllOf(HasSubstr("'monday' is open in the studio"), HasSubstr("studio.close")));
  in_studio_.clear();
  EXPECT_THAT(refusal("takes.rename", {{"name", "monday"}, {"to", "tuesday"}}), HasSubstr("exists already"));
  EXPECT_THAT(refusal("takes.rename", {{"name", "monday"}, {"to", "monday"}}), HasSubstr("exists already"));
  json onto = trim;
  onto["to"] = "tuesday";
  EXPECT_THAT(refusal("takes.trim", onto), HasSubstr("exists already"));
  EXPECT_THAT(names(folder_.path()), UnorderedElementsAre("monday.take", "tuesday.take"));
  // Not closed, and its recorder is still there.
  take::TakeRecorderConfig config;
  config.file = file("running.take");
  config.disk_reserve_bytes = 0;
  take::TakeRecorder recorder(config);
  recorder.start();
  each("running", HasSubstr("another program records or reads it"));
  recorder.stop();
}

TEST_F(TakeMethods, WhatAnotherHoldsLockedStaysWhereItIsAndWhatIsDamagedMoves) {
  record("held");
  std::ofstream(file("damaged.take")) << "no take";
  take::Database holder(file("held.take"), take::Database::Mode::ReadWrite);
  holder.execute("BEGIN EXCLUSIVE");
  for (const char* method : {"takes.delete", "takes.rename"}) {
    json params = {{"name", "held"}};
    if (method == std::string_view("takes.rename")) {
      params["to"] = "new";
    }
    const json answer = ask(method, params);
    EXPECT_EQ(answer["error"]["code"], -32000 - static_cast<int>(ErrorKind::Unavailable)) << answer;
    EXPECT_THAT(answer["error"]["message"].get<std::string>(), HasSubstr("another program holds it locked"));
  }
  EXPECT_TRUE(fs::exists(file("held.take")));
  EXPECT_THAT(listed("held")["error"].get<std::string>(), HasSubstr("locked"));
  holder.execute("ROLLBACK");
  EXPECT_FALSE(listed("held").contains("error")) << "it was never unreadable";
  result("takes.rename", {{"name", "damaged"}, {"to", "broken"}});
  result("takes.delete", {{"name", "broken"}});
}

TEST_F(TakeMethods, OnlyMembersMayAndParamsAreChecked) {
  record("monday");
  const json name = {{"name", "monday"}};
  for (const char* method : {"takes.rename", "takes.delete", "takes.restore", "takes.deleted", "takes.purge",
                             "takes.note", "takes.trim", "takes.cancel"}) {
    EXPECT_EQ(ask(method, name, false)["error"]["code"], kPermissionDenied) << method;
  }
  EXPECT_THAT(refusal("takes.rename", name), HasSubstr("to is missing"));
  EXPECT_THAT(refusal("takes.delete", json::object()), HasSubstr("name is missing"));
  EXPECT_THAT(refusal("takes.delete", {{"name", "monday"}, {"now", "yes"}}), HasSubstr("true or false"));
  EXPECT_THAT(refusal("takes.note", name), HasSubstr("note or slate is missing"));
  EXPECT_THAT(refusal("takes.note", {{"name", "monday"}, {"slate", "1"}}),
              HasSubstr("slate must be an object"));
  for (const json& slate : {json{{"scene", 1}}, json{{"roll", "1"}}}) {
    EXPECT_THAT(refusal("takes.note", {{"name", "monday"}, {"slate", slate}}), HasSubstr("scene and take"));
  }
  for (const auto& [from_s, to_s] : {std::pair(-1.0, 1.0), {0.5, 0.5}, {2.0, 1.0}, {0.0, 1e9}}) {
    EXPECT_THAT(
        refusal("takes.trim", {{"name", "monday"}, {"from_s", from_s}, {"to_s", to_s}, {"to", "short"}}),
        HasSubstr("the first below the second"));
  }
  EXPECT_THAT(refusal("takes.cancel", json::object()), HasSubstr("nothing is being trimmed"));
  EXPECT_TRUE(desk_.trim_status().is_null());
}

/// Over the page nobody has a user: what is missing there is the token.
TEST_F(TakeMethods, OverTheWebTheTokenIsNamed) {
  const std::string line = R"({"jsonrpc":"2.0","id":1,"method":"takes.purge"})";
  Caller caller{0, 0, false, true};
  const auto asked = [&] { return json::parse(answer_request(desk_.methods(), line, caller))["error"]; };
  EXPECT_EQ(asked()["code"], kPermissionDenied);
  EXPECT_THAT(asked()["message"].get<std::string>(),
              AllOf(HasSubstr("takes.purge needs the token"), HasSubstr("facet.token.TOKEN"),
                    ::testing::Not(HasSubstr("user 0"))));
  caller = {77, 1001, false};
  EXPECT_THAT(asked()["message"].get<std::string>(),
              AllOf(HasSubstr("user 1001 may not call"), ::testing::Not(HasSubstr("token"))));
}

TEST_F(TakeMethods, WhatIsDeletedComesBackUntilItIsPurged) {
  record("monday", 4);
  std::ofstream(file("monday.basis")) << "made of it";
  fs::create_directory(file(".thumbnails"));
  std::ofstream(file(".thumbnails/monday.png")) << "a face";
  const json gone = result("takes.delete", {{"name", "monday"}});
  EXPECT_EQ(gone["gone"], false);
  EXPECT_EQ(gone["kept_until_utc"].get<std::string>().size(), 20U);
  EXPECT_THAT(names(folder_.path()), UnorderedElementsAre(".thumbnails", ".deleted"));
  EXPECT_TRUE(names(file(".thumbnails")).empty()) << "no picture of the face stays";
  EXPECT_EQ(listed("monday"), nullptr);
  EXPECT_THAT(refusal("takes.delete", {{"name", "monday"}}), HasSubstr("there is no take"));

  // Another of the name, deleted too: the later one comes back first.
  record("monday", 7);
  result("takes.delete", {{"name", "monday"}});
  EXPECT_EQ(result("takes.deleted")["takes"].size(), 2U);
  EXPECT_EQ(result("takes.restore", {{"name", "monday"}})["file"], file("monday.take").string());
  EXPECT_EQ(listed("monday")["frames"], 7);
  EXPECT_THAT(refusal("takes.restore", {{"name", "monday"}}), HasSubstr("exists already"));
  result("takes.restore", {{"name", "monday"}, {"to", "monday before"}});
  EXPECT_EQ(listed("monday before")["frames"], 4);
  EXPECT_TRUE(fs::exists(file("monday before.basis")));
  EXPECT_TRUE(names(file(".deleted")).empty());
  EXPECT_THAT(refusal("takes.restore", {{"name", "monday"}}), HasSubstr("no take 'monday' was deleted"));

  result("takes.delete", {{"name", "monday"}});
  EXPECT_EQ(result("takes.purge", {{"name", "other"}})["takes"], 0);
  const json purged = result("takes.purge");
  EXPECT_EQ(purged["takes"], 1);
  EXPECT_GT(purged["bytes"], 1000);
  EXPECT_TRUE(names(file(".deleted")).empty());
  EXPECT_EQ(listed("monday before")["frames"], 4) << "what was not deleted stays";
}

TEST_F(TakeMethods, AtOnceMeansForGood) {
  record("ada", 4);
  result("takes.delete", {{"name", "ada"}});
  record("ada", 5);
  record("bob", 5);
  result("takes.delete", {{"name", "bob"}});
  const json gone = result("takes.delete", {{"name", "ada"}, {"now", true}});
  EXPECT_EQ(gone["gone"], true);
  EXPECT_EQ(gone["takes"], 2) << "what was deleted before goes with it";
  EXPECT_THAT(refusal("takes.restore", {{"name", "ada"}}), HasSubstr("no take 'ada'"));
  // What only lies in the bin any more.
  EXPECT_EQ(result("takes.delete", {{"name", "bob"}, {"now", true}})["takes"], 1);
  EXPECT_TRUE(names(file(".deleted")).empty());
  EXPECT_THAT(refusal("takes.delete", {{"name", "bob"}, {"now", true}}), HasSubstr("there is no take"));
  // A file that is no take, too.
  std::ofstream(file("broken.take")) << "not a take";
  EXPECT_EQ(result("takes.delete", {{"name", "broken"}, {"now", true}})["gone"], true);
  EXPECT_FALSE(fs::exists(file("broken.take")));
}

TEST_F(TakeMethods, TheBinIsEmptiedAfterAWeek) {
  record("old");
  record("new");
  result("takes.delete", {{"name", "old"}});
  const auto folder = names(file(".deleted")).at(0);
  const auto eight_days = std::chrono::milliseconds(std::chrono::hours(8 * 24)).count();
  fs::rename(file(".deleted") / folder, file(".deleted") / std::to_string(std::stoll(folder) - eight_days));
  result("takes.delete", {{"name", "new"}});
  fs::create_directories(file(".cutting"));
  desk_.start();
  desk_.look_after(Clock::now() + std::chrono::minutes(59));
  EXPECT_EQ(result("takes.deleted")["takes"].size(), 2U) << "the clock may have to be set first";
  desk_.look_after(Clock::now() + std::chrono::minutes(61));
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (std::chrono::steady_clock::now() < end &&
         (names(file(".deleted")).size() > 1 || fs::exists(file(".cutting")))) {
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  desk_.stop();
  EXPECT_EQ(names(file(".deleted")).size(), 1U);
  EXPECT_FALSE(fs::exists(file(".cutting"))) << "left by a process that was killed while it cut";
  EXPECT_EQ(result("takes.deleted")["takes"][0]["name"], "new");
}

TEST_F(TakeMethods, WhatAKilledDaemonHadHalfDeletedIsThereAgain) {
  record("half", 4);
  std::ofstream(file("half.basis")) << "made of it";
  const fs::path folder = file(".deleted/1700000000000");  // longer ago than takes are kept
  fs::create_directories(folder);
  fs::rename(file("half.basis"), folder / "half.basis");
  const auto move = [&](const char* part) {
    return file(part).string() + '\0' + (folder / part).string() + '\0';
  };
  std::ofstream(file(".moves")) << move("half.basis") + move("half.take");
  desk_.start();
  desk_.look_after(Clock::now() + std::chrono::minutes(61));
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (std::chrono::steady_clock::now() < end && fs::exists(folder)) {
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  desk_.stop();
  EXPECT_FALSE(fs::exists(folder));
  EXPECT_TRUE(fs::exists(file("half.basis")));
  EXPECT_EQ(listed("half")["frames"], 4);
  EXPECT_FALSE(fs::exists(file(".moves")));
}

TEST_F(TakeMethods, NotesAndSlateStandInTheList) {
  record("monday");
  EXPECT_FALSE(listed("monday").contains("note"));
  EXPECT_EQ(result("takes.note",
                   {{"name", "monday"}, {"note", "good \"one\"\nagain?"}, {"slate", {{"scene", "12a"}}}}),
            json::parse(R"({"note": "good \"one\"\nagain?", "slate": {"scene": "12a", "take": ""}})"));
  EXPECT_EQ(listed("monday")["note"], "good \"one\"\nagain?");
  EXPECT_EQ(listed("monday")["slate"]["scene"], "12a");
  result("takes.note", {{"name", "monday"}, {"slate", {{"take", "3"}}}});
  EXPECT_EQ(listed("monday")["slate"], json::parse(R"({"scene": "12a", "take": "3"})"));
  EXPECT_EQ(listed("monday")["note"], "good \"one\"\nagain?") << "what is not given stays";
  result("takes.rename", {{"name", "monday"}, {"to", "tuesday"}});
  EXPECT_EQ(listed("tuesday")["slate"]["take"], "3") << "a name changes no note";
  result("takes.note", {{"name", "tuesday"}, {"note", ""}});
  EXPECT_FALSE(listed("tuesday").contains("note"));
  EXPECT_THAT(refusal("takes.note", {{"name", "tuesday"}, {"note", std::string(2001, 'n')}}),
              HasSubstr("2001 characters"));
  EXPECT_EQ(listed("tuesday")["frames"], 10);
}

TEST_F(TakeMethods, ANoteDoesNotMakeAnOldTakeNew) {
  record("first", 2);
  record("second", 2);
  take::Database(file("first.take"), take::Database::Mode::ReadWrite)
      .execute("UPDATE meta SET value = '2020-01-01T00:00:00Z' WHERE key = 'created_utc'");
  result("takes.note", {{"name", "first"}, {"note", "later"}});
  index_.changed();
  EXPECT_EQ(json::parse(index_.list())["takes"][0]["name"], "second");
}

TEST_F(TakeMethods, TrimsIntoANewTake) {
  record("monday", 30);
  in_studio_ = "monday";  // where its replay shows what to keep
  desk_.start();
  const json begun =
      result("takes.trim", {{"name", "monday"}, {"from_s", 0.2}, {"to_s", 0.6}, {"to", "short"}});
  EXPECT_EQ(begun["file"], file("short.take").string());
  EXPECT_EQ(begun["frames"], 13);
  EXPECT_EQ(
      trimmed(),
      json::parse(
          R"({"take": "monday", "to": "short", "done": 13, "total": 13, "state": "done", "reason": ""})"));
  EXPECT_EQ(listed("short")["frames"], 13);
  EXPECT_EQ(listed("short")["cut_from"], "monday, frames 6 to 18 of 30");
  EXPECT_EQ(listed("monday")["frames"], 30);
  EXPECT_NE(take::TakeReader(file("short.take")).frame(0)->albedo, nullptr);
  EXPECT_THAT(refusal("takes.trim", {{"name", "monday"}, {"from_s", 50}, {"to_s", 60}, {"to", "late"}}),
              HasSubstr("no frame lies between"));
  EXPECT_THAT(names(folder_.path()), UnorderedElementsAre("monday.take", "short.take"));
}

/// Holds up a cut where it makes its file, until it is let go.
class HeldDisk : public files::Disk {
 public:
  int open(int folder, const char* file, int flags, mode_t mode) override {
    if ((flags & O_CREAT) != 0 && std::string(file).find("/.cutting/") != std::string::npos) {
      reached = true;
      while (!let_go) {
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
    }
    return Disk::open(folder, file, flags, mode);
  }
  std::atomic<bool> reached{false};
  std::atomic<bool> let_go{false};
};

TEST_F(TakeMethods, ATrimGuardsItsTakesAndCanBeBrokenOff) {
  record("monday");
  record("tuesday");
  HeldDisk disk;
  const files::InstalledDisk installed(disk);
  desk_.start();
  const json trim = {{"name", "monday"}, {"from_s", 0}, {"to_s", 100}, {"to", "copy"}};
  result("takes.trim", trim);
  while (!disk.reached) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_EQ(desk_.trim_status()["state"], "working");
  EXPECT_THAT(refusal("takes.rename", {{"name", "monday"}, {"to", "other"}}),
              HasSubstr("'monday' is being trimmed"));
  EXPECT_THAT(refusal("takes.delete", {{"name", "monday"}}), HasSubstr("takes.cancel"));
  EXPECT_THAT(refusal("takes.rename", {{"name", "tuesday"}, {"to", "copy"}}),
              HasSubstr("'copy' is being trimmed"));
  EXPECT_THAT(refusal("takes.trim", {{"name", "tuesday"}, {"from_s", 0}, {"to_s", 100}, {"to", "other"}}),
              HasSubstr("one after the other"));
  result("takes.cancel");
  disk.let_go = true;
  const json broken = trimmed();
  EXPECT_EQ(broken["state"], "broken off") << broken["reason"];
  EXPECT_THAT(names(folder_.path()), UnorderedElementsAre("monday.take", "tuesday.take"));
  // The next is not broken off with it.
  result("takes.trim", trim);
  EXPECT_EQ(trimmed()["state"], "done");
  desk_.stop();
}

TEST_F(TakeMethods, WhyATrimFailedIsTold) {
  record("monday");
  HeldDisk disk;
  const files::InstalledDisk installed(disk);
  desk_.start();
  result("takes.trim", {{"name", "monday"}, {"from_s", 0}, {"to_s", 100}, {"to", "copy"}});
  while (!disk.reached) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  std::ofstream(file("copy.take")) << "another's";  // by another program, past the daemon
  disk.let_go = true;
  const json failed = trimmed();
  EXPECT_EQ(failed["state"], "failed");
  EXPECT_THAT(failed["reason"].get<std::string>(), HasSubstr("is there already"));
  EXPECT_EQ(fs::file_size(file("copy.take")), 9U);
  EXPECT_EQ(result("takes.rename", {{"name", "monday"}, {"to", "tuesday"}})["file"],
            file("tuesday.take").string());
  desk_.stop();
}

}  // namespace
}  // namespace facet::service
