// Compiled kernels kept from one start to the next: whatever stands in the file, a device opens and computes.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <optional>
#include <string>
#include <vector>

#include "gpu/batch.hpp"
#include "gpu/context.hpp"
#include "gpu/kernel.hpp"
#include "support/failing_disk.hpp"
#include "support/gpu.hpp"
#include "support/paths.hpp"
#include "test_gpu_shaders.hpp"

namespace facet::gpu {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

// As in kernel_cache.cpp: magic, key, bytes, checksum, data.
constexpr std::size_t key_at = 16;
constexpr std::size_t bytes_at = 64;
constexpr std::size_t checksum_at = 72;
constexpr std::size_t data_at = 80;

class KernelCacheTest : public test::GpuTest {
 protected:
  ContextOptions options() const { return options(folder_.path()); }
  static ContextOptions options(const fs::path& folder) {
    ContextOptions out;
    out.validation = Validation::IfAvailable;
    out.kernel_cache = folder.string();
    return out;
  }

  /// Opens the device, compiles a kernel and runs it.
  static KernelCacheState start(const ContextOptions& chosen) {
    Context context(chosen);
    const Kernel kernel(context, shaders::test_gpu::kernels(), "constants");
    const Kernel decide(context, shaders::test_gpu::kernels(), "counts");
    const Buffer wanted(context, 4, Memory::Upload, "wanted");
    const Buffer counts(context, 16, Memory::Readback, "counts");
    wanted.mapped_as<std::uint32_t>()[0] = 5;
    run_now(context, "counts", [&](Batch& batch) {
      batch.dispatch(decide, {{"wanted", wanted}, {"counts", counts}}, {1});
    });
    EXPECT_EQ(counts.mapped_as<std::uint32_t>()[0], 5U);
    context.keep_kernels();
    for (const std::string& message : context.validation_messages()) {
      ADD_FAILURE() << "validation: " << message;
    }
    return context.kernel_cache();
  }

  std::vector<fs::path> files() const {
    std::vector<fs::path> found;
    for (const auto& entry : fs::directory_iterator(folder_.path())) {
      found.push_back(entry.path());
    }
    return found;
  }

  const fs::path& folder() const { return folder_.path(); }

 private:
  test::TemporaryFolder folder_;
};

std::string bytes_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

TEST_F(KernelCacheTest, WhatOneStartCompiledTheNextReads) {
  const KernelCacheState first = start(options(folder() / "made" / "here"));
  EXPECT_EQ(first.read_bytes, 0U);
  EXPECT_GE(first.written_bytes, 32U);  // the head that Vulkan asks for
  EXPECT_EQ(first.why, "");
  EXPECT_EQ(fs::path(first.file).parent_path(), folder() / "made" / "here");
  EXPECT_EQ(fs::file_size(first.file), data_at + first.written_bytes);
  const std::string kept = bytes_of(first.file);
  const KernelCacheState second = start(options(folder() / "made" / "here"));
  EXPECT_EQ(second.read_bytes, first.written_bytes);
  EXPECT_EQ(second.file, first.file);
  EXPECT_EQ(second.why, "");
  if (second.written_bytes == 0) {
    EXPECT_EQ(bytes_of(first.file), kept);
  }
}

TEST_F(KernelCacheTest, AFileThatIsNotWhatItShouldBeIsIgnoredAndReplaced) {
  start(options());
  ASSERT_EQ(files().size(), 1U);
  const fs::path file = files().front();
  const std::string good = bytes_of(file);
  const auto flipped = [](std::size_t at) {
    return [at](std::string& bytes) { bytes[at] = static_cast<char>(bytes[at] ^ 0x10); };
  };
  struct Case {
    std::function<void(std::string&)> spoil;
    std::string why;
  };
  const std::vector<Case> cases{
      {[](std::string& bytes) { bytes.clear(); }, "cut"},
      {[](std::string& bytes) { bytes.resize(data_at - 1); }, "cut"},
      {[](std::string& bytes) { bytes.pop_back(); }, "damaged"},
      {[](std::string& bytes) { bytes.resize(data_at); }, "damaged"},
      {[](std::string& bytes) { bytes += "more"; }, "damaged"},
      {flipped(0), "none of kernels"},
      {flipped(key_at), "another driver's"},       // driver UUID
      {flipped(key_at + 16), "another driver's"},  // UUID of the pipeline cache
      {flipped(key_at + 32), "another driver's"},  // vendor
      {flipped(key_at + 40), "another driver's"},  // version of the driver
      {flipped(bytes_at), "damaged"},
      {flipped(checksum_at), "damaged"},
      {flipped(data_at), "damaged"},
      {flipped(good.size() - 1), "damaged"},
      {[](std::string& bytes) { bytes.assign(1U << 20U, 'x'); }, "none of kernels"},
  };
  for (std::size_t n = 0; n < cases.size(); ++n) {
    std::string bytes = good;
    cases[n].spoil(bytes);
    ASSERT_NE(bytes, good) << n;
    std::ofstream(file, std::ios::binary) << bytes;
    {
      const Context context(options());
      EXPECT_EQ(context.kernel_cache().read_bytes, 0U) << n;
      EXPECT_THAT(context.kernel_cache().why, HasSubstr(cases[n].why)) << n;
    }
    const KernelCacheState replaced = start(options());
    EXPECT_EQ(replaced.why, "") << n;
    EXPECT_GT(start(options()).read_bytes, 0U) << n;
    ASSERT_EQ(files().size(), 1U) << n;
  }
}

TEST_F(KernelCacheTest, AFileThatOthersMayWriteIsIgnoredAndReplaced) {
  start(options());
  ASSERT_EQ(files().size(), 1U);
  const fs::path file = files().front();
  for (const fs::perms others : {fs::perms::group_write, fs::perms::others_write}) {
    fs::permissions(file, others, fs::perm_options::add);
    {
      const Context context(options());
      EXPECT_EQ(context.kernel_cache().read_bytes, 0U);
      EXPECT_THAT(context.kernel_cache().ignored,
                  AllOf(HasSubstr(file.string()), HasSubstr("alone to write")));
    }
    const KernelCacheState replaced = start(options());
    EXPECT_EQ(replaced.why, "");
    EXPECT_EQ(fs::status(file).permissions(), fs::perms::owner_read | fs::perms::owner_write);
    const KernelCacheState next = start(options());
    EXPECT_GT(next.read_bytes, 0U);
    EXPECT_EQ(next.ignored, "");
  }
  if (::geteuid() == 0) {
    ASSERT_EQ(::chown(file.c_str(), 65534, 65534), 0);
    EXPECT_THAT(Context(options()).kernel_cache().ignored, HasSubstr("alone to write")) << "another user's";
  }
}

TEST_F(KernelCacheTest, FileAndFolderAreTheUsersAlone) {
  const KernelCacheState kept = start(options(folder() / "made" / "here"));
  EXPECT_EQ(fs::status(kept.file).permissions(), fs::perms::owner_read | fs::perms::owner_write);
  EXPECT_EQ(fs::status(folder() / "made" / "here").permissions(), fs::perms::owner_all);
}

TEST_F(KernelCacheTest, WhatCannotBeAFileIsIgnored) {
  const KernelCacheState known = start(options());
  fs::remove(known.file);
  fs::create_directory(known.file);
  const KernelCacheState blocked = start(options());
  EXPECT_EQ(blocked.read_bytes, 0U);
  EXPECT_EQ(blocked.written_bytes, 0U);
  EXPECT_THAT(blocked.why, HasSubstr(known.file));
  fs::remove(known.file);
  { std::ofstream(known.file, std::ios::binary) << "x"; }
  fs::resize_file(known.file,
                  (std::size_t{64} << 20U) + 1);  // larger than any that is read; no bytes on the disk
  const Context context(options());
  EXPECT_EQ(context.kernel_cache().read_bytes, 0U);
  EXPECT_NE(context.kernel_cache().why, "");
}

TEST_F(KernelCacheTest, NothingIsWrittenWhereNoFolderCanBe) {
  const fs::path file = folder() / "file";
  { std::ofstream(file) << "no folder"; }
  const KernelCacheState below = start(options(file / "kernels"));
  EXPECT_EQ(below.written_bytes, 0U);
  EXPECT_THAT(below.why, HasSubstr((file / "kernels").string()));
  const KernelCacheState none = start(options(""));
  EXPECT_EQ(none.file, "");
  EXPECT_EQ(none.written_bytes, 0U);
  EXPECT_EQ(none.why, "");
  ASSERT_EQ(files().size(), 1U);
  EXPECT_EQ(bytes_of(file), "no folder");
}

TEST_F(KernelCacheTest, AFullDiskLeavesNoHalfOfAFile) {
  bool all_tried = false;
  for (std::int64_t n = 1; !all_tried; ++n) {
    ASSERT_LT(n, 100);
    const ContextOptions chosen = options(folder() / std::to_string(n));
    std::optional<KernelCacheState> state;
    {
      test::FailingDisk disk(n);
      Context context(chosen);
      context.keep_kernels();
      state = context.kernel_cache();
      all_tried = !disk.has_failed();
    }
    EXPECT_EQ(state->why.empty(), all_tried || state->written_bytes > 0) << n << ": " << state->why;
    for (const auto& entry : fs::directory_iterator(chosen.kernel_cache)) {
      EXPECT_EQ(entry.path(), state->file) << n << ": left behind";
    }
    EXPECT_EQ(Context(chosen).kernel_cache().why, "") << n;
  }
}

TEST_F(KernelCacheTest, ALostDeviceWritesNothing) {
  {
    Context context(options());
    const Kernel kernel(context, shaders::test_gpu::kernels(), "constants");
    context.simulate_loss();
    context.keep_kernels();
  }
  EXPECT_TRUE(files().empty());
}

TEST(KernelCacheFolderTest, IsTheOneOfTheEnvironment) {
  struct Variable {
    explicit Variable(const char* called) : name(called) {
      const char* set = std::getenv(called);
      before = set == nullptr ? std::nullopt : std::optional<std::string>(set);
    }
    ~Variable() { put(before); }
    void put(const std::optional<std::string>& value) const {
      if (value) {
        ::setenv(name, value->c_str(), 1);
      } else {
        ::unsetenv(name);
      }
    }
    const char* name;
    std::optional<std::string> before;
  };
  const Variable own("FACET_KERNEL_CACHE");
  const Variable cache("XDG_CACHE_HOME");
  const Variable home("HOME");
  own.put("/own");
  cache.put("/cache");
  home.put("/home");
  EXPECT_EQ(kernel_cache_folder("/given"), "/given");
  EXPECT_EQ(kernel_cache_folder(""), "");
  EXPECT_EQ(kernel_cache_folder("auto"), "/own");
  own.put("");
  EXPECT_EQ(kernel_cache_folder("auto"), "");
  own.put(std::nullopt);
  EXPECT_EQ(kernel_cache_folder("auto"), "/cache/facet");
  cache.put("relative");
  EXPECT_EQ(kernel_cache_folder("auto"), "/home/.cache/facet");
  home.put(std::nullopt);
  EXPECT_EQ(kernel_cache_folder("auto"), "");
}

}  // namespace
}  // namespace facet::gpu
