// The recorder without memory: every single allocation of a recording fails once, and from each on all of
// them.

#include <gtest/gtest.h>

#include <atomic>
#include <cerrno>
#include <cstddef>
#include <limits>
#include <optional>
#include <string>

#include "facet/error.hpp"
#include "record_take.hpp"
#include "support/paths.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace {

std::atomic<bool> armed{false};
std::atomic<bool> for_good{false};
std::atomic<long> allocations{0};
std::atomic<long> refused_one{0};

/// Whether this allocation is the one that fails, or one behind it.
bool refused() {
  if (!armed) {
    return false;
  }
  const long now = ++allocations;
  return now == refused_one || (for_good && now > refused_one);
}

void* refuse() {
  errno = ENOMEM;
  return nullptr;
}

}  // namespace

// In the place of the C library's, for C++, SQLite and zstd alike. NOLINTBEGIN(bugprone-reserved-identifier)
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* memory, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);

void* malloc(std::size_t size) {
  return refused() ? refuse() : __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  return refused() ? refuse() : __libc_calloc(count, size);
}
void* realloc(void* memory, std::size_t size) {
  return refused() ? refuse() : __libc_realloc(memory, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {
  return refused() ? refuse() : __libc_memalign(alignment, size);
}
int posix_memalign(void** out, std::size_t alignment, std::size_t size) {
  void* const memory = refused() ? nullptr : __libc_memalign(alignment, size);
  if (memory == nullptr) {
    return ENOMEM;
  }
  *out = memory;
  return 0;
}
}
// NOLINTEND(bugprone-reserved-identifier)

namespace facet::take {
namespace {

constexpr std::uint64_t kFrames = 6;

class Memory : public testing::Test {
 protected:
  /// A recording with pictures and a mesh; nothing where it could not begin.
  std::optional<RecorderStatus> record(long refused_allocation) {
    for (const auto& entry : std::filesystem::directory_iterator(folder_.path())) {
      std::filesystem::remove_all(entry.path());
    }
    std::optional<RecorderStatus> status;
    TakeRecorderConfig config = test::picture_config(file_, 3000);
    config.pack_threads = 2;
    allocations = 0;
    refused_one = refused_allocation;
    armed = true;
    try {
      TakeRecorder recorder(config);
      recorder.start();
      for (const auto& frame : frames_) {
        recorder.record(frame);
      }
      status = recorder.stop();
    } catch (const Error&) {
      // It could not begin, and says so.
    } catch (const std::bad_alloc&) {
      // There is no memory for its status.
    }
    armed = false;
    made_ = allocations;
    return status;
  }

  /// Whatever failed, the process is here, and what was told is so.
  void expect_honest(const std::optional<RecorderStatus>& status, long n) const {
    if (status && status->state == RecorderState::Finished) {
      EXPECT_EQ(status->frames, kFrames) << n;
      TakeReader reader(file_);
      EXPECT_TRUE(reader.info().closed) << n;
      ASSERT_EQ(reader.frame_count(), static_cast<std::int64_t>(kFrames)) << n;
      for (std::uint64_t index = 0; index < kFrames; ++index) {
        const auto frame = reader.frame(static_cast<std::int64_t>(index));
        EXPECT_TRUE(frame->images == nullptr || frame->subject != nullptr ||
                    test::same_pictures(*frame->images, 16, 12))
            << n;
      }
    } else if (status) {
      EXPECT_EQ(status->state, RecorderState::Failed) << n;
      EXPECT_FALSE(status->reason.empty()) << n;
      EXPECT_EQ(status->frames + status->dropped, kFrames) << n;
    }
  }

  void sweep(long step) {
    const auto whole = record(std::numeric_limits<long>::max());
    ASSERT_TRUE(whole && whole->state == RecorderState::Finished);
    const long count = made_;
    EXPECT_GT(count, 100);
    int failed = 0;
    // Threads take turns differently each time: some more than were counted.
    for (long n = 1; n <= count + 20; n += step) {
      const auto status = record(n);
      expect_honest(status, n);
      failed += status && status->state == RecorderState::Finished ? 0 : 1;
      ASSERT_FALSE(HasFatalFailure());
    }
    EXPECT_GT(failed, 10) << "of " << count;
    RecordProperty("allocations", static_cast<int>(count));
  }

  test::TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "one.take";
  std::vector<std::shared_ptr<const mesh::MeshFrame>> frames_ = [] {
    const auto subject = test::patch_subject();
    std::vector<std::shared_ptr<const mesh::MeshFrame>> frames;
    for (std::uint64_t slot = 0; slot < kFrames; ++slot) {
      frames.push_back(slot % 2 == 0 ? test::picture_frame(slot, 16, 12) : test::take_frame(slot, subject));
    }
    return frames;
  }();
  long made_ = 0;
};

TEST_F(Memory, EveryAllocationMayFailOnce) {
  sweep(1);
}

TEST_F(Memory, AllFromAnyOnMayFail) {
  for_good = true;
  sweep(3);
  for_good = false;
}

}  // namespace
}  // namespace facet::take
