#include "gpu/context.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <vector>

#include "gpu/batch.hpp"
#include "gpu/buffer.hpp"
#include "gpu/facts.hpp"
#include "shaders/layout.h"
#include "support/gpu.hpp"
#include "test_gpu_shaders.hpp"

namespace facet::gpu {
namespace {

using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::Not;

class ContextTest : public test::GpuTest {};

/// The message of the Error(NoDevice) that opening a device gives.
std::string refusal(const ContextOptions& options) {
  try {
    const Context context(options);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::NoDevice);
    return error.what();
  }
  ADD_FAILURE() << "a device was opened";
  return {};
}

TEST_F(ContextTest, TellsWhatTheDeviceIs) {
  const DeviceInfo& info = context().info();
  EXPECT_FALSE(info.name.empty());
  EXPECT_TRUE(info.usable);
  EXPECT_EQ(info.is_software, info.type == DeviceType::Software);
  EXPECT_GE(info.subgroup_size, 4U);
  EXPECT_GE(info.workgroup_count, info.is_software ? 8U : 64U);
  EXPECT_GE(info.shared_memory_bytes, 16384U);    // the least that Vulkan allows
  EXPECT_GE(info.max_push_constant_bytes, 128U);  // likewise
  EXPECT_GE(info.max_storage_buffer_bytes, 1U << 27U);
  EXPECT_GE(info.buffer_alignment_bytes, 16U);
  EXPECT_FALSE(context().lost());
  EXPECT_FALSE(context().hung());
  EXPECT_EQ(info.patience.count(), info.is_software ? 60'000 : 2'000);
}

TEST_F(ContextTest, FactsNameEveryMemoryAndTheQueueInUse) {
  const DeviceFacts facts = device_facts(context());
  EXPECT_FALSE(facts.heap_bytes.empty());
  EXPECT_THAT(facts.api_version, ContainsRegex("^1\\.[0-9]+\\.[0-9]+$"));
  std::string uses;
  for (const DeviceFacts::MemoryType& type : facts.memory_types) {
    ASSERT_LT(type.heap, facts.heap_bytes.size());
    uses += " " + type.used_for;
    if (type.used_for.find("Upload") != std::string::npos ||
        type.used_for.find("Readback") != std::string::npos) {
      EXPECT_THAT(type.properties, HasSubstr("host-visible host-coherent"));
    }
  }
  for (const char* kind : {"Device", "Upload", "Readback"}) {
    const std::size_t at = uses.find(kind);
    EXPECT_NE(at, std::string::npos) << kind;
    EXPECT_EQ(uses.find(kind, at + 1), std::string::npos) << kind;
  }
  int used = 0;
  for (const DeviceFacts::QueueFamily& family : facts.queue_families) {
    used += family.used ? 1 : 0;
    EXPECT_TRUE(!family.used || family.does.find("compute") != std::string::npos);
  }
  EXPECT_EQ(used, 1);
  EXPECT_LE(facts.subgroup_size_least, context().info().subgroup_size);
  EXPECT_GE(facts.workgroup_invocations, 128U);  // the least that Vulkan allows
}

TEST_F(ContextTest, ListsDevicesBestFirst) {
  const std::vector<DeviceInfo> devices = list_devices();
  ASSERT_FALSE(devices.empty());
  EXPECT_EQ(devices.front().name, context().info().name);
  for (std::size_t index = 1; index < devices.size(); ++index) {
    EXPECT_GE(devices[index - 1].usable, devices[index].usable);
    if (devices[index - 1].usable == devices[index].usable) {
      EXPECT_LE(devices[index - 1].type, devices[index].type);
    }
  }
}

TEST_F(ContextTest, ChoosesByAPartOfTheNameInAnyCase) {
  std::string part = context().info().name.substr(1, 5);
  for (char& letter : part) {
    letter = static_cast<char>(std::toupper(static_cast<unsigned char>(letter)));
  }
  ContextOptions options;
  options.device = part;
  const Context chosen(options);
  EXPECT_EQ(chosen.info().name, context().info().name);
}

TEST_F(ContextTest, UnknownNameListsWhatThereIs) {
  ContextOptions options;
  options.device = "Voodoo 2";
  const std::string message = refusal(options);
  EXPECT_THAT(message, HasSubstr("Voodoo 2"));
  EXPECT_THAT(message, HasSubstr(context().info().name));
}

TEST(ContextErrorTest, NoLoaderSaysWhatToInstall) {
  ContextOptions options;
  options.loader_library = "libfacet-there-is-no-such.so.1";
  EXPECT_THAT(refusal(options), ContainsRegex("no Vulkan loader.*apt install libvulkan1"));
}

TEST(ContextErrorTest, ALibraryThatIsNoLoaderIsRefused) {
  ContextOptions options;
  options.loader_library = "libm.so.6";
  EXPECT_THAT(refusal(options), HasSubstr("vkGetInstanceProcAddr"));
}

// In a child process, since the loader and its environment belong to the whole process.
TEST(ContextErrorDeathTest, NoDriverSaysWhatToInstall) {
  ::testing::FLAGS_gtest_death_test_style = "threadsafe";
  for (const char* variable : {"VK_ICD_FILENAMES", "VK_DRIVER_FILES"}) {
    const auto open_without_driver = [variable] {
      ::setenv(variable, "/nonexistent/driver.json", 1);
      try {
        const Context context;
      } catch (const Error& error) {
        std::cerr << error.what() << '\n';
        std::_Exit(static_cast<int>(error.kind()));
      }
      std::_Exit(0);
    };
    EXPECT_EXIT(open_without_driver(), ::testing::ExitedWithCode(static_cast<int>(ErrorKind::NoDevice)),
                "no Vulkan device.*apt install mesa-vulkan-drivers");
  }
}

TEST_F(ContextTest, ValidationSpeaksWhereItIsAsked) {
  ContextOptions options;
  options.validation = Validation::Off;
  EXPECT_FALSE(Context(options).validation_active());
  options.validation = Validation::Required;
  if (context().validation_active()) {
    EXPECT_TRUE(Context(options).validation_active());
  } else {
    EXPECT_THAT(refusal(options), HasSubstr("vulkan-validationlayers"));
  }
}

// The layer must be seen to work, or the absence of its messages would mean nothing. A kernel that reads
// integers from a view of floats is a misuse that only the layer notices, and that does no harm.
TEST_F(ContextTest, ValidationReportsMisuse) {
  if (!context().validation_active()) {
    GTEST_SKIP() << "the validation layer is not installed";
  }
  ContextOptions options;
  options.validation = Validation::Required;
  Context watched(options);
  const Buffer floats(watched, 64, Memory::Device, "floats");
  const TexelView view(floats, TexelFormat::R32f);
  const Buffer target(watched, 256, Memory::Device, "target");
  const Kernel widen(watched, shaders::test_gpu::kernels(), "widen_integers");
  run_now(watched, "misuse", [&](Batch& batch) {
    batch.fill(floats, 0);
    batch.dispatch(widen, {{"source", view}, {"target", target}}, {1}, shaders::test_gpu::CountPush{16});
  });
  EXPECT_FALSE(watched.validation_messages().empty());
}

TEST_F(ContextTest, ResourcesKeepTheDeviceAlive) {
  ContextOptions options;
  auto owner = std::make_unique<Context>(options);
  const Buffer buffer(*owner, 64, Memory::Readback, "left over");
  const Image image(*owner, ImageFormat::Rgba8, 13, 7, 0, "left over");
  Batch batch(*owner, "left over");
  batch.fill(buffer, 5);
  batch.finish();
  owner.reset();
  EXPECT_EQ(batch.submit(), Outcome::Done);
  EXPECT_EQ(batch.wait(), Outcome::Done);
  EXPECT_EQ(buffer.mapped_as<std::uint32_t>()[15], 5U);
}

TEST_F(ContextTest, ResourcesOfAnotherContextAreRefused) {
  Context other;
  const Buffer foreign(other, 64, Memory::Device, "foreign");
  Batch batch(context(), "batch");
  EXPECT_THROW(batch.fill(foreign), Error);
}

TEST_F(ContextTest, LossIsReportedByEveryCallAndMendedByANewContext) {
  auto lost = std::make_unique<Context>();
  const Buffer buffer(*lost, 1 << 20, Memory::Device, "buffer");
  Batch in_flight(*lost, "in flight");
  in_flight.fill(buffer, 1);
  in_flight.finish();
  Batch waiting(*lost, "not yet submitted");
  waiting.fill(buffer, 2);
  waiting.finish();
  ASSERT_EQ(in_flight.submit(), Outcome::Done);

  lost->simulate_loss();
  EXPECT_TRUE(lost->lost());
  EXPECT_FALSE(lost->hung());
  EXPECT_EQ(in_flight.wait(), Outcome::DeviceLost);
  EXPECT_FALSE(in_flight.in_flight());
  EXPECT_EQ(in_flight.submit(), Outcome::DeviceLost);
  EXPECT_EQ(waiting.submit(), Outcome::DeviceLost);
  EXPECT_EQ(waiting.wait(), Outcome::DeviceLost);
  EXPECT_THROW(Buffer(*lost, 64, Memory::Device, "too late"), DeviceLostError);
  EXPECT_THROW(Image(*lost, ImageFormat::Rgba8, 4, 4, 1, "too late"), DeviceLostError);
  EXPECT_THROW(TexelView(buffer, TexelFormat::R32f), DeviceLostError);
  EXPECT_THROW(Sampler{*lost}, DeviceLostError);
  EXPECT_THROW(Batch(*lost, "too late"), DeviceLostError);
  EXPECT_THROW(Kernel(*lost, shaders::test_gpu::kernels(), "scale"), DeviceLostError);
  EXPECT_THROW(run_now(*lost, "too late", [](Batch&) {}), DeviceLostError);

  lost = std::make_unique<Context>();  // while objects of the lost one are still there
  const Buffer again(*lost, 64, Memory::Readback, "again");
  run_now(*lost, "again", [&](Batch& batch) { batch.fill(again, 3); });
  EXPECT_EQ(again.mapped_as<std::uint32_t>()[0], 3U);
}

std::size_t entries(const char* folder) {
  std::size_t count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    count += entry.exists() ? 1 : 0;
  }
  return count;
}

std::size_t resident_bytes() {
  std::ifstream statm("/proc/self/statm");
  std::size_t total_pages = 0;
  std::size_t resident_pages = 0;
  statm >> total_pages >> resident_pages;
  return resident_pages * static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
}

/// Everything there is, made, used once and destroyed.
void live_once(Context& context) {
  const Buffer from(context, 4096, Memory::Device, "from");
  const Buffer to(context, 4096, Memory::Readback, "to");
  const TexelView view(from, TexelFormat::Rgba32f);
  const Image image(context, ImageFormat::Rgba16f, 33, 17, 0, "image");
  const Kernel scale(context, shaders::test_gpu::kernels(), "scale");
  run_now(context, "life", [&](Batch& batch) {
    batch.stage("fill");
    batch.fill(from, 0);
    batch.stage("scale");
    batch.dispatch(scale, {{"source", view}, {"target", to}}, {4},
                   shaders::test_gpu::ScalePush{{1.0F, 0.0F, 0.0F, 0.0F}, 256, 1.0F});
    batch.copy(from, image, 2);
  });
  ASSERT_EQ(to.mapped_as<float>()[0], 1.0F);
}

#ifdef FACET_SANITIZED
constexpr int cycles = 100;  // everything is many times slower, and leaks are found by counting
#else
constexpr int cycles = 500;
#endif

/// Runs `cycle` again and again; after a tenth of all cycles, when caches are warm, nothing may grow. Memory
/// may take one step (the heap gets another piece of address space), but a leak grows in both halves: half a
/// megabyte over 225 cycles is two kilobytes each, less than any of the objects above.
template <typename Cycle>
void expect_no_growth(const Cycle& cycle) {
  std::size_t threads = 0;
  std::size_t descriptors = 0;
  std::size_t resident = 0;
  std::size_t resident_midway = 0;
  for (int index = 0; index < cycles; ++index) {
    cycle();
    if (index == cycles / 10) {
      threads = entries("/proc/self/task");
      descriptors = entries("/proc/self/fd");
      resident = resident_bytes();
    } else if (index == cycles / 2 + cycles / 20) {
      resident_midway = resident_bytes();
    }
  }
  EXPECT_LE(entries("/proc/self/task"), threads);
  EXPECT_LE(entries("/proc/self/fd"), descriptors);
#ifndef FACET_SANITIZED  // the sanitizers keep freed memory back; they find leaks in their own way
  constexpr std::size_t kStep = std::size_t{1} << 19U;
  const std::size_t resident_at_the_end = resident_bytes();
  EXPECT_TRUE(resident_midway <= resident + kStep || resident_at_the_end <= resident_midway + kStep)
      << resident << ", " << resident_midway << ", " << resident_at_the_end;
#else
  EXPECT_GT(resident, 0U);
  EXPECT_GT(resident_midway, 0U);
#endif
}

TEST_F(ContextTest, ManyLivesOfEveryResourceLeakNothing) {
  ContextOptions options;
  options.validation = Validation::Off;  // the layer keeps records of its own
  Context plain(options);
  expect_no_growth([&] { live_once(plain); });
}

TEST_F(ContextTest, ManyContextsLeakNothing) {
  ContextOptions options;
  options.validation = Validation::Off;
  expect_no_growth([&] {
    Context context(options);
    const Buffer buffer(context, 64, Memory::Readback, "buffer");
    run_now(context, "once", [&](Batch& batch) { batch.fill(buffer, 9); });
    ASSERT_EQ(buffer.mapped_as<std::uint32_t>()[0], 9U);
  });
}

}  // namespace
}  // namespace facet::gpu
