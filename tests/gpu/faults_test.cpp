// What becomes of a device that lacks something, runs out of memory, goes, or hangs: the faults are those of
// a Vulkan layer between the loader and the driver.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "gpu/batch.hpp"
#include "gpu/context.hpp"
#include "gpu/facts.hpp"
#include "support/gpu_faults.hpp"

namespace facet::gpu {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

/// Skipped where there is no Vulkan device at all.
class FaultsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    try {
      name_ = Context(options()).info().name;
    } catch (const Error& error) {
      GTEST_SKIP() << error.what();
    }
    faults_.emplace();
  }

  /// Without the validation layer, from which the faults would have to be hidden.
  static ContextOptions options(std::chrono::milliseconds patience = {}) {
    ContextOptions out;
    out.validation = Validation::Off;
    out.patience = patience;
    return out;
  }

  /// The message of the Error(NoDevice) that opening the device gives.
  static std::string refusal() {
    try {
      const Context context(options());
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::NoDevice);
      return error.what();
    }
    ADD_FAILURE() << "a device was opened";
    return {};
  }

  void set(const std::string& faults) const { faults_->set(faults); }
  const std::string& name() const { return name_; }

 private:
  std::string name_;
  std::optional<test::OwnGpuFaults> faults_;
};

TEST_F(FaultsTest, ADeviceThatLacksSomethingIsListedWithWhatItLacks) {
  const std::array<std::array<const char*, 2>, 4> cases{{{"api-version 1.1", "Vulkan 1.2"},
                                                         {"no-compute-queue", "a compute queue"},
                                                         {"no-subgroup-arithmetic", "subgroup arithmetic"},
                                                         {"texel-buffers 65536", "it ends at 65536"}}};
  for (const auto& [fault, lacked] : cases) {
    set(fault);
    EXPECT_THAT(refusal(),
                AllOf(HasSubstr("'" + name() + "'"), HasSubstr("unusable: it lacks"), HasSubstr(lacked)));
    for (const DeviceInfo& info : list_devices(options())) {
      EXPECT_FALSE(info.usable);
      EXPECT_THAT(info.why_unusable, HasSubstr(lacked));
    }
  }
}

// MoltenVK and other drivers that lack a part of Vulkan show themselves to those alone who ask for them.
TEST_F(FaultsTest, DriversOfAPartOfVulkanAreSeen) {
  const std::filesystem::path manifests = "/usr/share/vulkan/icd.d";
  std::string lavapipe;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(manifests, error)) {
    if (entry.path().filename().string().starts_with("lvp_icd")) {
      std::ifstream file(entry.path());
      lavapipe.assign(std::istreambuf_iterator<char>(file), {});
    }
  }
  const std::size_t place = lavapipe.find("\"library_path\"");
  if (place == std::string::npos) {
    GTEST_SKIP() << "no manifest of lavapipe in " << manifests;
  }
  const test::TemporaryFolder folder;
  const std::filesystem::path manifest = folder.path() / "part.json";
  std::ofstream(manifest) << lavapipe.insert(place, "\"is_portability_driver\": true, ");
  const char* before = std::getenv("VK_DRIVER_FILES");
  const std::optional<std::string> kept =
      before == nullptr ? std::nullopt : std::optional<std::string>(before);
  ::setenv("VK_DRIVER_FILES", manifest.c_str(), 1);
  EXPECT_NO_THROW({
    const Context context(options());
    EXPECT_TRUE(context.info().is_software);
  });
  if (kept) {
    ::setenv("VK_DRIVER_FILES", kept->c_str(), 1);
  } else {
    ::unsetenv("VK_DRIVER_FILES");
  }
}

TEST_F(FaultsTest, ADeviceThatCannotBeOpenedSaysWhatToDo) {
  set("cannot-be-opened");
  EXPECT_THAT(refusal(), AllOf(HasSubstr(name()), HasSubstr("cannot be opened"), HasSubstr("kernel module")));
}

TEST_F(FaultsTest, NoMemoryIsSaidWithTheBufferAndPasses) {
  Context context(options());
  const Buffer target(context, 4096, Memory::Device, "target");
  const std::vector<std::uint32_t> words(1024, 7);
  set("memory 1");  // the target itself
  try {
    upload<std::uint32_t>(context, target, words);
    FAIL() << "there was memory";
  } catch (const DeviceLostError& error) {
    FAIL() << "too little memory is no loss: " << error.what();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::NoDevice);
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("'upload staging'"), HasSubstr(name()), HasSubstr("not enough memory")));
  }
  EXPECT_THROW(Image(context, ImageFormat::Rgba16f, 64, 64, 0, "image"), Error);
  EXPECT_FALSE(context.lost());
  set("");
  upload<std::uint32_t>(context, target, words);
  std::vector<std::uint32_t> back(1024);
  download<std::uint32_t>(context, target, back);
  EXPECT_EQ(back, words);
}

/// The number of the memory type that buffers of a kind come from.
std::size_t type_used_for(Context& context, const std::string& kind) {
  const std::vector<DeviceFacts::MemoryType> types = device_facts(context).memory_types;
  return static_cast<std::size_t>(
      std::ranges::find_if(types,
                           [&](const DeviceFacts::MemoryType& type) { return type.used_for == kind; }) -
      types.begin());
}

TEST_F(FaultsTest, UploadsLieInTheMemoryOfAGpuWhereTheHostSeesIt) {
  set("three-memories");
  {
    Context context(options());
    EXPECT_FALSE(context.info().uploads_to_device);  // still a software device
    EXPECT_EQ(device_facts(context).memory_types[1].used_for, "Upload Readback");
  }
  set("three-memories\ndiscrete");
  Context context(options());
  EXPECT_TRUE(context.info().uploads_to_device);
  EXPECT_EQ(type_used_for(context, "Device"), 0U);
  EXPECT_EQ(type_used_for(context, "Readback"), 1U);
  EXPECT_EQ(type_used_for(context, "Upload"), 2U);
  ContextOptions host = options();
  host.upload_memory = UploadMemory::Host;
  Context drill(host);
  EXPECT_EQ(device_facts(drill).memory_types[1].used_for, "Upload Readback");
}

TEST_F(FaultsTest, UploadsGoToTheHostsMemoryWhereTheMappedPartOfAGpusIsFull) {
  set("three-memories\ndiscrete\nfull 2");
  Context context(options());
  EXPECT_EQ(device_facts(context).memory_types[1].used_for, "Upload Readback");
  const std::vector<std::uint32_t> words(1024, 7);
  const Buffer target(context, 4096, Memory::Device, "target");
  upload<std::uint32_t>(context, target, words);
  std::vector<std::uint32_t> back(1024);
  download<std::uint32_t>(context, target, back);
  EXPECT_EQ(back, words);
  // What only kernels see is not worth having there.
  set("three-memories\ndiscrete\nfull 0");
  EXPECT_THROW(Buffer(context, 4096, Memory::Device, "more"), Error);
}

TEST_F(FaultsTest, ALossIsSeenWhereADriverReportsIt) {
  for (const char* fault : {"lost-at-submit", "lost-at-wait"}) {
    set("");
    Context context(options());
    const Buffer buffer(context, 64, Memory::Readback, "buffer");
    Batch batch(context, "frame");
    batch.fill(buffer, 1);
    batch.finish();
    ASSERT_EQ(batch.submit(), Outcome::Done);
    ASSERT_EQ(batch.wait(), Outcome::Done);
    set(fault);
    const Outcome submitted = batch.submit();
    EXPECT_EQ(submitted == Outcome::Done ? batch.wait() : submitted, Outcome::DeviceLost) << fault;
    EXPECT_TRUE(context.lost());
    EXPECT_FALSE(context.hung());
    EXPECT_THROW(run_now(context, "set-up", [&](Batch& more) { more.fill(buffer, 2); }), DeviceLostError);
  }
}

TEST_F(FaultsTest, ALossAtStartIsReportedBySetUp) {
  for (const char* fault : {"lost-at-submit", "lost-at-wait"}) {
    set(fault);
    Context context(options());
    EXPECT_THROW(Image(context, ImageFormat::Rgba16f, 4, 4, 1, "first"), DeviceLostError);
    EXPECT_TRUE(context.lost());
  }
}

// Work that is never done must neither hold up who waits for it nor who destroys it, and what it may still
// use must stay. On a device that hangs at once, whose patience is long enough for whatever comes before.
TEST_F(FaultsTest, ADeviceThatHangsIsLostAndLeftBehind) {
  const std::chrono::milliseconds patience(200);
  set("");
  auto context = std::make_unique<Context>(options(patience));
  auto buffer = std::make_unique<Buffer>(*context, 64, Memory::Upload, "buffer");
  auto waited_for = std::make_unique<Batch>(*context, "waited for");
  waited_for->fill(*buffer, 1);
  waited_for->finish();
  auto dropped = std::make_unique<Batch>(*context, "dropped in flight");
  dropped->fill(*buffer, 2);
  dropped->finish();
  set("hang");
  ASSERT_EQ(waited_for->submit(), Outcome::Done);
  ASSERT_EQ(dropped->submit(), Outcome::Done);
  EXPECT_EQ(waited_for->wait(std::chrono::milliseconds(1)), Outcome::TimedOut);
  EXPECT_FALSE(context->lost());
  const auto start = std::chrono::steady_clock::now();
  EXPECT_EQ(waited_for->wait(), Outcome::DeviceLost);
  EXPECT_GE(std::chrono::steady_clock::now() - start, patience);
  EXPECT_FALSE(waited_for->in_flight());
  EXPECT_TRUE(context->hung());
  EXPECT_EQ(waited_for->submit(), Outcome::DeviceLost);
  EXPECT_THROW(waited_for->reset(), DeviceLostError);
  try {
    const Buffer late(*context, 64, Memory::Device, "too late");
    FAIL() << "a buffer was made";
  } catch (const DeviceLostError& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr(name()), HasSubstr("hangs"), HasSubstr("open it again")));
  }
  dropped.reset();
  waited_for.reset();
  const std::span<std::uint32_t> words = buffer->mapped_as<std::uint32_t>();
  buffer.reset();
  words[0] = 3;  // as the device may do at any time
  context.reset();

  set("");
  Context again(options());
  const Buffer other(again, 64, Memory::Readback, "other");
  run_now(again, "again", [&](Batch& batch) { batch.fill(other, 4); });
  EXPECT_EQ(other.mapped_as<std::uint32_t>()[0], 4U);
}

TEST_F(FaultsTest, SetUpOnADeviceThatHangsEnds) {
  set("hang");
  Context context(options(std::chrono::milliseconds(20)));
  EXPECT_THROW(Image(context, ImageFormat::Rgba16f, 4, 4, 1, "image"), DeviceLostError);
  EXPECT_TRUE(context.hung());
  Context other(options(std::chrono::milliseconds(20)));
  const Buffer buffer(other, 64, Memory::Device, "buffer");
  EXPECT_THROW(run_now(other, "set-up", [&](Batch& batch) { batch.fill(buffer, 1); }), DeviceLostError);
  EXPECT_TRUE(other.hung());
}

// A batch that nobody waited for is waited for, with patience, where it is destroyed.
TEST_F(FaultsTest, ABatchDroppedOnADeviceThatHangsEnds) {
  Context context(options(std::chrono::milliseconds(20)));
  const Buffer buffer(context, 64, Memory::Device, "buffer");
  {
    Batch batch(context, "dropped");
    batch.fill(buffer, 1);
    batch.finish();
    set("hang");
    ASSERT_EQ(batch.submit(), Outcome::Done);
  }
  EXPECT_TRUE(context.hung());
}

}  // namespace
}  // namespace facet::gpu
