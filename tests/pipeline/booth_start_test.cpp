// With which slot of a recording a booth's meshes begin.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "pipeline/booth.hpp"
#include "scripted_stages.hpp"
#include "simulation/recorded_curves.hpp"
#include "simulation/virtual_booth.hpp"
#include "support/paths.hpp"

namespace facet::pipeline {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::HasSubstr;

constexpr std::uint64_t kSlots = 17;  ///< blank are 2, 5, 8, 11, 14

/// An open mouth that smiles under raised brows, by one value at the first slot and by the other at the last.
std::shared_ptr<const simulation::RecordedCurves> smile(float first, float last) {
  std::string text = "Timecode,BlendShapeCount";
  for (const std::string_view name : mesh::kArkitNames) {
    text += fmt::format(",{}", name);
  }
  for (const auto& [time, open] : {std::pair{"00:00:00:00.000", first}, {"00:00:00:15.000", last}}) {
    text += fmt::format("\n{},52", time);
    for (const std::string_view name : mesh::kArkitNames) {
      const bool moves = name == "JawOpen" || name.starts_with("BrowInnerUp") ||
                         name.starts_with("BrowOuterUp") || name.starts_with("MouthSmile");
      text += fmt::format(",{}", moves ? open : 0);
    }
  }
  return std::make_shared<simulation::RecordedCurves>(
      simulation::RecordedCurves::parse(text + "\n", "smile"));
}

class BoothStart : public ::testing::Test {
 protected:
  struct Outcome {
    std::vector<std::uint64_t> slots;  ///< of frames that have a mesh
    std::string said;
  };

  /// Skips where model or device are missing.
  void run(float first, float last, Outcome& outcome) {
    BoothConfig config;
    config.model_file = test::default_model();
    config.landmark_nets = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
    for (const auto& needed : {config.model_file, config.landmark_nets}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
    const face::FaceModel model = face::FaceModel::load(config.model_file);
    simulation::VirtualBoothConfig scene;
    scene.seed = 5;
    scene.samples = 1;
    scene.resolution = 0.625;
    scene.head_motion = 0;
    scene.curves = smile(first, last);
    const simulation::VirtualBooth booth(&model, scene);
    capture::Rig rig = booth.rig();
    rig.pairs.resize(1);
    config.rig_file = folder_.path() / "rig.toml";
    capture::write_rig(rig, config.rig_file);
    std::optional<BoothParts> parts;
    try {
      parts = open_booth(config, 2);
    } catch (const Error& error) {
      if (error.kind() != ErrorKind::NoDevice) {
        throw;
      }
      GTEST_SKIP() << "no Vulkan device";
    }
    test::CollectingSink sink;
    BoothMeshes meshes(std::move(*parts), BoothMeshes::WhenBusy::Wait, {&sink});
    meshes.start();
    for (std::uint64_t slot = 0; slot < kSlots; ++slot) {
      meshes.deliver(std::make_shared<const FrameSet>(booth.slot(slot).frame_set()));
    }
    meshes.finish();
    while (!meshes.finished()) {
      std::this_thread::sleep_for(5ms);
    }
    meshes.stop();
    for (const auto& frame : sink.frames()) {
      if (frame->state == mesh::TrackingState::Tracking) {
        outcome.slots.push_back(frame->sequence);
      }
    }
    for (const Messages::Message& message : meshes.take_messages()) {
      outcome.said += message.text + "\n";
    }
  }

 private:
  test::TemporaryFolder folder_;
};

TEST_F(BoothStart, ThePersonIsTakenFromTheCalmestSlotAndAllComeInTheirOrder) {
  Outcome outcome;
  run(0.9F, 0, outcome);
  if (IsSkipped()) {
    return;
  }
  EXPECT_THAT(outcome.slots, ElementsAre(2, 5, 8, 11, 14)) << outcome.said;
  EXPECT_THAT(outcome.said, testing::ContainsRegex("slot (8|11|14): the calmest face of the first 5"));
}

TEST_F(BoothStart, ARecordingThatBeginsAtRestIsGoneThroughOnce) {
  Outcome outcome;
  run(0, 0.9F, outcome);
  if (IsSkipped()) {
    return;
  }
  EXPECT_THAT(outcome.slots, ElementsAre(2, 5, 8, 11, 14)) << outcome.said;
  EXPECT_THAT(outcome.said, Not(HasSubstr("calmest")));
}

}  // namespace
}  // namespace facet::pipeline
