// Refinement on a device that runs out of memory, goes, or hangs: at start, in a frame, at the end. The
// faults are those of a Vulkan layer.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "facet/messages.hpp"
#include "refine/recovering_refiner.hpp"
#include "refine/refine_stage.hpp"
#include "support/eventually.hpp"
#include "support/gpu_faults.hpp"
#include "support/paths.hpp"
#include "support/synthetic_face.hpp"

namespace facet::refine {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::StartsWith;

synthetic::Scene small_scene() {
  synthetic::Scene scene;
  scene.image_width_px = 125;
  scene.image_height_px = 150;
  scene.quad_mm = 12;
  return scene;
}

constexpr std::chrono::seconds kGpuPatience{2};

class DeviceFaultsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    try {
      const gpu::Context context(options());
    } catch (const Error& error) {
      GTEST_SKIP() << error.what();
    }
    faults_.emplace();
    const synthetic::Scene scene = small_scene();
    cap_ = synthetic::make_cap(scene);
    hierarchy_ = synthetic::hierarchy(scene, cap_, {});
    subject_ = {hierarchy_, cap_.mean_albedo, cap_.control.refinable};
    input_.image = synthetic::render(scene);
    input_.camera = synthetic::camera(scene);
    input_.camera_from_head = synthetic::camera_from_head(scene);
    input_.control_vertices_mm = &cap_.vertices_mm;
  }

  /// patience: 0: the device's own, longer than any machine is busy.
  static gpu::ContextOptions options(std::chrono::seconds patience = {}) {
    gpu::ContextOptions out;
    out.validation = gpu::Validation::Off;
    out.patience = patience;
    return out;
  }

  static std::unique_ptr<RecoveringRefiner> recovering(Messages& messages,
                                                       std::chrono::seconds patience = {}) {
    const OpenRefiner open = refiner_opener(options(patience), {});
    return std::make_unique<RecoveringRefiner>(
        open(), open, messages,
        RecoveringRefiner::Pauses{std::chrono::milliseconds(1), std::chrono::milliseconds(20)});
  }

  bool refined_again(RecoveringRefiner& refiner) {
    return test::eventually([&] { return refiner.refine(input_, output_).empty(); });
  }

  void set(const std::string& faults) const { faults_->set(faults); }

  SubjectSetup subject_;
  RefineInput input_;
  RefineOutput output_;

 private:
  std::optional<test::OwnGpuFaults> faults_;
  synthetic::Cap cap_;
  std::shared_ptr<const mesh::Hierarchy> hierarchy_;
};

TEST_F(DeviceFaultsTest, AGpusPatchesInSharedMemoryGiveWhatASoftwareDevicesGive) {
  const auto refined = [&](const gpu::ContextOptions& chosen) {
    gpu::Context context(chosen);
    Refiner refiner(context, {});
    refiner.set_subject(subject_);
    RefineOutput out;
    for (int frame = 0; frame < 3; ++frame) {
      refiner.submit(input_);
      EXPECT_EQ(refiner.collect(out), RefineOutcome::Refined) << out.failure;
    }
    return std::pair(context.info().patch_places, out.displacements_mm);
  };
  const auto [no_places, expected] = refined(options());
  ASSERT_EQ(no_places, 0U);
  set("discrete");
  const auto [places, found] = refined(options(std::chrono::seconds(60)));
  ASSERT_GT(places, 0U);
  ASSERT_EQ(found.size(), expected.size());
  double squares = 0;
  double differences = 0;
  for (std::size_t i = 0; i < found.size(); ++i) {
    squares += static_cast<double>(expected[i]) * static_cast<double>(expected[i]);
    differences += std::pow(static_cast<double>(found[i]) - static_cast<double>(expected[i]), 2);
  }
  EXPECT_GT(squares, 0);
  // Other patches, and sums of more lanes.
  EXPECT_LT(std::sqrt(differences / squares), 0.05);
}

// Wherever memory ends, what was made by then is given back: at the next place it ends one further.
TEST_F(DeviceFaultsTest, MemoryThatEndsAnywhereInTheSubjectIsSaid) {
  const std::unique_ptr<RefineStage> stage = refiner_opener(options(), {})();
  int room = 0;
  for (;; room += 7) {
    set("memory " + std::to_string(room));
    try {
      stage->set_subject(subject_);
      break;
    } catch (const gpu::DeviceLostError& error) {
      FAIL() << error.what();
    } catch (const Error& error) {
      ASSERT_EQ(error.kind(), ErrorKind::NoDevice);
      ASSERT_THAT(error.what(), HasSubstr("not enough memory left"));
    }
  }
  EXPECT_GT(room, 30) << "a subject takes more buffers than that";
  set("memory 0");
  EXPECT_THROW(stage->refine(input_, output_), Error) << "no room for the picture";
  set("");
  EXPECT_EQ(stage->refine(input_, output_), RefineOutcome::Refined) << output_.failure;
}

// shaderStorageImageWriteWithoutFormat, which some phones' GPUs lack: every kernel names its format.
TEST_F(DeviceFaultsTest, ImagesNeedNoWritesWithoutFormat) {
  set("no-writes-without-format");
  const std::unique_ptr<RefineStage> stage = refiner_opener(options(), {})();
  stage->set_subject(subject_);
  EXPECT_EQ(stage->refine(input_, output_), RefineOutcome::Refined) << output_.failure;
}

TEST_F(DeviceFaultsTest, APictureWithoutRoomLeavesFramesCoarse) {
  Messages messages;
  const auto refiner = recovering(messages);
  refiner->set_subject(subject_);
  set("memory 0");
  EXPECT_THAT(refiner->refine(input_, output_), HasSubstr("no room for pictures of this size"));
  EXPECT_THAT(refiner->refine(input_, output_), HasSubstr("not enough memory left"));
  EXPECT_EQ(messages.take().size(), 1U) << "said once";
  set("");
  EXPECT_EQ(refiner->refine(input_, output_), "");
}

TEST_F(DeviceFaultsTest, ASubjectWithoutRoomLeavesFramesCoarseOnADeviceThatIsThere) {
  Messages messages;
  const auto refiner = recovering(messages);
  refiner->set_subject(subject_);
  ASSERT_EQ(refiner->refine(input_, output_), "");
  const std::string device = refiner->device();
  set("memory 0");
  refiner->set_subject(subject_);
  for (int frame = 0; frame < 3; ++frame) {
    EXPECT_THAT(refiner->refine(input_, output_),
                AllOf(HasSubstr("no room for this face's vertices on " + device),
                      HasSubstr("not enough memory left")));
    std::this_thread::sleep_for(std::chrono::milliseconds(25));  // a pause: it is tried again
  }
  EXPECT_EQ(refiner->device(), device);
  std::vector<Messages::Message> said = messages.take();
  ASSERT_EQ(said.size(), 1U) << "said once, and nothing of a lost device";
  EXPECT_THAT(said.front().text, StartsWith("no room"));
  set("");
  EXPECT_TRUE(refined_again(*refiner));
  EXPECT_TRUE(messages.take().empty());
}

TEST_F(DeviceFaultsTest, ASubjectThatIsWrongIsNoLostDevice) {
  Messages messages;
  const auto refiner = recovering(messages);
  SubjectSetup wrong = subject_;
  wrong.refinable.pop_back();
  try {
    refiner->set_subject(wrong);
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage) << error.what();
  }
  EXPECT_NE(refiner->device(), "");
  EXPECT_TRUE(messages.take().empty());
  refiner->set_subject(subject_);
  EXPECT_EQ(refiner->refine(input_, output_), "");
}

// What the log of a start says.
TEST_F(DeviceFaultsTest, KernelsThatOthersMayWriteAreSaidToBeIgnored) {
  const test::TemporaryFolder folder;
  gpu::ContextOptions chosen = options();
  chosen.kernel_cache = folder.path().string();
  EXPECT_EQ(refiner_opener(chosen, {})()->kernels_ignored(), "");
  for (const auto& entry : std::filesystem::directory_iterator(folder.path())) {
    std::filesystem::permissions(entry.path(), std::filesystem::perms::group_write,
                                 std::filesystem::perm_options::add);
  }
  EXPECT_THAT(refiner_opener(chosen, {})()->kernels_ignored(),
              AllOf(HasSubstr(folder.path().string()), HasSubstr("alone to write")));
  EXPECT_EQ(refiner_opener(chosen, {})()->kernels_ignored(), "") << "it was replaced";
}

TEST_F(DeviceFaultsTest, ADeviceLostAtStartIsOpenedAnew) {
  Messages messages;
  const auto refiner = recovering(messages);
  set("lost-at-wait");
  refiner->set_subject(subject_);
  EXPECT_THAT(refiner->refine(input_, output_), StartsWith("GPU lost, being reopened"));
  set("cannot-be-opened");
  ASSERT_TRUE(test::eventually([&] {
    bool said = false;
    for (const Messages::Message& message : messages.take()) {
      said = said || message.text.find("cannot be opened") != std::string::npos;
    }
    return said;
  }));
  EXPECT_THAT(refiner->refine(input_, output_), StartsWith("GPU lost, being reopened"));
  set("");
  EXPECT_TRUE(refined_again(*refiner));
  EXPECT_FALSE(refiner->device().empty());
}

TEST_F(DeviceFaultsTest, ADeviceLostInAFrameIsOpenedAnew) {
  for (const char* fault : {"lost-at-submit", "lost-at-wait"}) {
    set("");
    Messages messages;
    const auto refiner = recovering(messages);
    refiner->set_subject(subject_);
    ASSERT_EQ(refiner->refine(input_, output_), "");
    set(fault);
    EXPECT_THAT(refiner->refine(input_, output_), AllOf(StartsWith("GPU lost"), HasSubstr("was lost while")))
        << fault;
    EXPECT_TRUE(output_.displacements_mm.empty());
    EXPECT_EQ(refiner->device(), "");
    set("");
    EXPECT_TRUE(refined_again(*refiner));
  }
}

TEST_F(DeviceFaultsTest, ADeviceThatHangsInAFrameIsOpenedAnew) {
  Messages messages;
  const auto refiner = recovering(messages, kGpuPatience);
  refiner->set_subject(subject_);
  ASSERT_TRUE(refined_again(*refiner)) << "a device that is merely slow comes back";
  set("hang");
  EXPECT_THAT(refiner->refine(input_, output_), HasSubstr("hung while"));
  EXPECT_EQ(refiner->device(), "");
  set("");
  EXPECT_TRUE(refined_again(*refiner));
}

TEST_F(DeviceFaultsTest, ADeviceThatGoesAtShutdownHoldsNothingUp) {
  for (const std::string fault : {"lost-at-submit", "lost-at-wait", "hang", "memory 0"}) {
    set("");
    const gpu::ContextOptions chosen = options(fault == "hang" ? kGpuPatience : std::chrono::seconds(0));
    auto context = std::make_unique<gpu::Context>(chosen);
    auto refiner = std::make_unique<Refiner>(*context, RefinerConfig());
    refiner->set_subject(subject_);
    refiner->submit(input_);
    const RefineOutcome first = refiner->collect(output_);
    EXPECT_TRUE(first == RefineOutcome::Refined || (fault == "hang" && first == RefineOutcome::DeviceLost))
        << fault;
    set(fault);
    EXPECT_NO_THROW(refiner->submit(input_)) << fault;  // and never collected
    refiner.reset();
    EXPECT_EQ(context->lost(), fault.starts_with("lost") || fault == "hang") << fault;
    context.reset();
  }
}

}  // namespace
}  // namespace facet::refine
