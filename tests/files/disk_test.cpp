#include "files/disk.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <optional>
#include <span>
#include <string>

#include "facet/error.hpp"
#include "files/append_file.hpp"
#include "files/output_file.hpp"
#include "support/failing_disk.hpp"
#include "support/paths.hpp"

namespace facet::files {
namespace {

using ::testing::HasSubstr;

std::string text_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// Bytes that no shift leaves as they are.
std::string text_of_length(std::size_t length) {
  std::string text;
  while (text.size() < length) {
    text += std::to_string(text.size()) + ' ';
  }
  text.resize(length);
  return text;
}

std::span<const std::byte> bytes_of(const std::string& text) {
  return std::as_bytes(std::span(text));
}

/// What is told of a failure; none where there was none.
std::optional<std::string> failure_of(auto&& work) {
  try {
    work();
    return std::nullopt;
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    return error.what();
  }
}

TEST(Disk, AnOutputFileIsTheOldOrTheNewOneWhicheverCallFails) {
  const std::string old_text = "old";
  const std::string new_text = text_of_length(300'000);
  std::int64_t failures = 0;
  for (std::int64_t n = 1;; ++n) {
    const test::TemporaryFolder folder;
    const std::filesystem::path file = folder.path() / "state.json";
    std::ofstream(file) << old_text;
    test::FailingDisk disk(n);
    const std::optional<std::string> told = failure_of([&] {
      OutputFile output(file);
      output.write(std::string_view(new_text).substr(0, 100));
      output.write(std::string_view(new_text).substr(100, 50'000));
      output.write(std::string_view(new_text).substr(50'100, 200'000));
      output.write(std::string_view(new_text).substr(250'100));
      output.commit();
    });
    const std::string left = text_of(file);
    EXPECT_TRUE(left == old_text || left == new_text) << "call " << n << ": " << left.size() << " bytes";
    EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1) << "call " << n;
    if (!disk.has_failed()) {
      EXPECT_EQ(told, std::nullopt);
      EXPECT_EQ(left, new_text);
      break;
    }
    ++failures;
    if (told) {
      EXPECT_THAT(*told, HasSubstr(folder.path().string())) << "call " << n;
    } else {
      EXPECT_EQ(left, new_text) << "call " << n;
    }
  }
  EXPECT_GE(failures, 8);  // open, 3 writes, sync, close, rename, the folder's open and sync
}

TEST(Disk, AnAppendedFileKeepsWhatWasSyncedWhicheverCallFails) {
  const std::string text = text_of_length(10'000);
  for (std::int64_t n = 1;; ++n) {
    const test::TemporaryFolder folder;
    const std::filesystem::path file = folder.path() / "log";
    std::uint64_t synced = 0;
    test::FailingDisk disk(n);
    const std::optional<std::string> told = failure_of([&] {
      AppendFile out = AppendFile::create(file);
      const std::optional<std::string> failure = failure_of([&] {
        for (std::size_t at = 0; at < text.size(); at += 2500) {
          out.append(bytes_of(text.substr(at, 2500)));
          out.write_back(at);
          out.sync();
          synced = out.size();
        }
      });
      if (failure) {
        out.cut(synced);
        throw Error(ErrorKind::Storage, *failure);
      }
    });
    if (told) {
      EXPECT_THAT(*told, HasSubstr(file.string()));
    }
    EXPECT_EQ(text_of(file), text.substr(0, synced)) << "call " << n;
    if (!disk.has_failed()) {
      EXPECT_EQ(synced, text.size());
      EXPECT_GT(n, 12);
      break;
    }
  }
}

/// The kernel may take less than it is given, or be interrupted.
TEST(Disk, WritesThatComeShortAreGoneOnWith) {
  class ShortDisk final : public Disk {
   public:
    ssize_t write(int fd, std::span<const std::byte> bytes, std::uint64_t position) override {
      if (++calls_ % 3 == 0) {
        errno = EINTR;
        return -1;
      }
      return Disk::write(fd, bytes.first(std::min<std::size_t>(bytes.size(), 999)), position);
    }

   private:
    int calls_ = 0;
    InstalledDisk installed_{*this};
  };
  const std::string text = text_of_length(100'000);
  const test::TemporaryFolder folder;
  ShortDisk disk;
  {
    OutputFile output(folder.path() / "whole");
    output.write(text);
    output.commit();
    AppendFile::create(folder.path() / "appended").append(bytes_of(text));
  }
  EXPECT_EQ(text_of(folder.path() / "whole"), text);
  EXPECT_EQ(text_of(folder.path() / "appended"), text);
}

TEST(Disk, AnOutputFileIsWrittenWhereItsWriterWants) {
  const test::TemporaryFolder folder;
  {
    OutputFile output(folder.path() / "file");
    output.write("0123456789");
    output.write_at(2, bytes_of("ab"));
    output.write("cd");
    output.commit();
  }
  EXPECT_EQ(text_of(folder.path() / "file"), "01abcd6789");
}

TEST(Disk, NewFilesAreNewAndReplacedOnesEmpty) {
  const test::TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "log";
  AppendFile::create(file).append(bytes_of("first"));
  EXPECT_THAT(failure_of([&] { AppendFile::create(file); }).value_or(""), HasSubstr("cannot create"));
  EXPECT_EQ(text_of(file), "first");
  AppendFile::replace(file).append(bytes_of("2nd"));
  EXPECT_EQ(text_of(file), "2nd");
}

}  // namespace
}  // namespace facet::files
