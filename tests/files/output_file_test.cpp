#include "files/output_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <fstream>
#include <functional>
#include <iterator>
#include <optional>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "support/paths.hpp"

namespace {

/// What a sync of a descriptor does in this program; none: what the system does.
std::function<int(int)> on_sync;  // one thread

}  // namespace

// In the place of the C library's.
extern "C" int fsync(int fd) {
  return on_sync ? on_sync(fd) : static_cast<int>(::syscall(SYS_fsync, fd));
}

namespace facet::files {
namespace {

using ::testing::ElementsAre;
using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::StartsWith;

class Output : public testing::Test {
 protected:
  ~Output() override { on_sync = nullptr; }

  std::string text() const {
    std::ifstream stream(file_);
    return {std::istreambuf_iterator<char>(stream), {}};
  }
  std::vector<std::string> names() const {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder_.path())) {
      names.push_back(entry.path().filename());
    }
    return names;
  }
  void write(const std::string& what) const {
    OutputFile output(file_);
    output.write(what);
    output.commit();
  }

  test::TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "state.json";
};

TEST_F(Output, WithoutACommitNothingIsLeft) {
  write("old");
  {
    OutputFile output(file_);
    output.write("half of the new");
  }
  EXPECT_EQ(text(), "old");
  EXPECT_THAT(names(), ElementsAre("state.json"));
}

/// A power cut may keep a name and lose the bytes behind it, where these were not asked for before.
TEST_F(Output, IsOnTheDiskBeforeItsNameAndItsNameBeforeTheReturn) {
  write("old");
  std::vector<std::string> synced;
  on_sync = [&](int fd) {
    synced.push_back(std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(fd)).filename());
    synced.back() += text() == "old" ? " before" : " after";
    return 0;
  };
  write("new");
  EXPECT_THAT(synced, ElementsAre(AllOf(StartsWith(".state.json."), EndsWith(".part before")),
                                  folder_.path().filename().string() + " after"));
}

TEST_F(Output, ThatCanNotBeSyncedLeavesTheOldOne) {
  write("old");
  on_sync = [](int) {
    errno = EIO;
    return -1;
  };
  try {
    write("new");
    ADD_FAILURE() << "written";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    EXPECT_THAT(error.what(), HasSubstr(file_.string()));
  }
  EXPECT_EQ(text(), "old");
  EXPECT_THAT(names(), ElementsAre("state.json"));
}

/// Whoever may write the folder can't have another file written by laying a link in the way.
TEST_F(Output, FollowsNoLinkThatLiesInItsWay) {
  const std::filesystem::path precious = folder_.path() / "precious";
  std::ofstream(precious) << "precious";
  std::filesystem::create_symlink(precious,
                                  folder_.path() / (".state.json." + std::to_string(::getpid()) + ".part"));
  std::filesystem::create_symlink(precious, file_);
  write("new");
  EXPECT_EQ(text(), "new");
  EXPECT_FALSE(std::filesystem::is_symlink(file_));
  EXPECT_EQ(std::filesystem::file_size(precious), 8U);
}

TEST_F(Output, TwoOfOneNameDoNotMeet) {
  OutputFile one(file_);
  OutputFile other(file_);
  one.write("one, which is long");
  other.write("other");
  one.commit();
  EXPECT_EQ(text(), "one, which is long");
  other.commit();
  EXPECT_EQ(text(), "other");
  EXPECT_THAT(names(), ElementsAre("state.json"));
}

TEST_F(Output, HasTheModeThatIsWanted) {
  OutputFile output(file_, 0640);
  output.commit();
  struct stat status {};
  ASSERT_EQ(::stat(file_.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777 & ~0640U, 0U);
  EXPECT_NE(status.st_mode & 0400, 0U);
}

/// Whatever the file system knows of renaming.
TEST_F(Output, OfANameThatMustBeFreeReplacesNothing) {
  class OldDisk final : public Disk {
    int rename(const char* from, const char* to, unsigned flags) override {
      return flags == 0 ? Disk::rename(from, to, 0) : (errno = EINVAL, -1);
    }
  };
  const auto write_new = [this] {
    OutputFile output(file_);
    output.write("new");
    output.commit_new();
  };
  for (const bool old : {false, true}) {
    SCOPED_TRACE(old);
    OldDisk disk;
    std::optional<InstalledDisk> installed;
    if (old) {
      installed.emplace(disk);
    }
    std::filesystem::remove(file_);
    write_new();
    EXPECT_EQ(text(), "new");
    write("older");
    try {
      write_new();
      FAIL() << "replaced";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
      EXPECT_THAT(error.what(), HasSubstr("state.json' exists already"));
    }
    EXPECT_EQ(text(), "older");
    EXPECT_THAT(names(), ElementsAre("state.json"));
  }
}

TEST_F(Output, AFolderHasItsModeHoweverItIsWritten) {
  for (const std::string name : {"a/b", "c/d/"}) {
    make_folder(folder_.path() / name, 0700);
    struct stat status {};
    ASSERT_EQ(::stat((folder_.path() / name).c_str(), &status), 0);
    EXPECT_EQ(status.st_mode & 0777U, 0700U) << name;
  }
}

TEST_F(Output, TheLongestNameWorks) {
  file_ = folder_.path() / std::string(255, 'n');
  write("long");
  EXPECT_EQ(text(), "long");
}

TEST_F(Output, WhatIsSetAsideIsNeitherInTheWayNorLost) {
  for (const std::string number : {"1", "2"}) {
    std::ofstream(file_) << "broken " << number;
    const std::filesystem::path to = file_.string() + ".broken-" + number;
    EXPECT_THAT(set_aside(file_), HasSubstr(to.string()));
    EXPECT_FALSE(std::filesystem::exists(file_));
    EXPECT_EQ(std::filesystem::file_size(to), 8U);
  }
  EXPECT_THAT(set_aside(file_), HasSubstr("could not be set aside"));
}

}  // namespace
}  // namespace facet::files
