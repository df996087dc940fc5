// A mouth that is wide open, and landmarks that say it is not.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <memory>

#include "booth/performance_tracker.hpp"
#include "face/face_model.hpp"
#include "mesh/mesh_frame.hpp"
#include "render/renderer.hpp"
#include "simulation/recorded_curves.hpp"
#include "simulation/virtual_booth.hpp"
#include "support/paths.hpp"

namespace facet::booth {
namespace {

using Eigen::Vector3f;
using testing::HasSubstr;

/// Wide, not to its end: with 1 the mouth bends as much as a torn one's in its soundest mesh (0.219 of 0.22),
/// and the compiler decides.
std::shared_ptr<const simulation::RecordedCurves> open_jaw() {
  std::string names = "Timecode,BlendShapeCount";
  std::string values;
  for (const std::string_view name : mesh::kArkitNames) {
    names += fmt::format(",{}", name);
    values += name == "JawOpen" ? ",0.8" : ",0";
  }
  return std::make_shared<simulation::RecordedCurves>(simulation::RecordedCurves::parse(
      fmt::format("{}\n00:00:00:00.000,52{}\n00:00:01:00.000,52{}\n", names, values, values), "jaw"));
}

capture::DepthMap depth_of(const simulation::TruthMesh& truth, capture::Lens lens) {
  lens.distortion = {};
  const Eigen::Isometry3f camera_from_rig = lens.camera_from_rig.cast<float>();
  const mesh::Vertices seen =
      (camera_from_rig.linear() * truth.vertices_mm).colwise() + camera_from_rig.translation();
  capture::DepthMap map;
  map.width_px = lens.width_px;
  map.height_px = lens.height_px;
  map.lens = lens;
  map.depth_mm = render::Raycaster(seen, truth.triangles).cast(capture::pinhole_of(lens)).depth_mm;
  map.sigma_mm.assign(map.depth_mm.size(), 0.1F);
  for (const float depth : map.depth_mm) {
    map.confidence.push_back(depth > 0 ? 1.0F : 0.0F);
  }
  return map;
}

class TornMouth : public ::testing::Test {
 protected:
  void SetUp() override {
    nets_ = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
    for (const auto& needed : {test::default_model(), nets_}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
    model_ = std::make_shared<const face::FaceModel>(face::FaceModel::load(test::default_model()));
    simulation::VirtualBoothConfig scene;
    scene.seed = 5;
    scene.samples = 1;
    scene.head_motion = 0;
    scene.curves = open_jaw();
    booth_ = std::make_unique<simulation::VirtualBooth>(model_.get(), scene);
  }

  /// The true landmarks of a slot, those of the jaw raised by so much where it moves most.
  FacePoints landmarks(const simulation::BoothSlot& slot, float raised_mm) const {
    const auto jaw = std::find(model_->expression_names.begin(), model_->expression_names.end(), "jawOpen") -
                     model_->expression_names.begin();
    Eigen::VectorXf one = Eigen::VectorXf::Zero(std::ssize(model_->expression_names));
    one[jaw] = 1;
    mesh::Vertices rest_mm;
    mesh::Vertices open_mm;
    model_->evaluate({}, {}, rest_mm);
    model_->evaluate({}, std::span<const float>(one.data(), static_cast<std::size_t>(one.size())), open_mm);
    const mesh::Vertices truth_mm = slot.surface().vertices_mm.leftCols(model_->vertex_count());
    FacePoints points;
    points.slot = slot.number();
    for (const capture::RigCamera& camera : booth_->rig().cameras) {
      if (!camera.colour) {
        continue;
      }
      FacePoints::Camera& made = points.cameras.emplace_back();
      made.name = camera.name;
      made.face.points_px = Eigen::Matrix3Xf::Zero(3, 468);
      made.face.confidence = Eigen::VectorXf::Zero(468);
      for (Eigen::Index i = 0; i < 468; ++i) {
        const face::LandmarkAnchor& anchor = model_->landmarks[static_cast<std::size_t>(i)];
        const float lowers = face::FaceModel::anchor_point(anchor, rest_mm).y() -
                             face::FaceModel::anchor_point(anchor, open_mm).y();
        const Vector3f at_mm = face::FaceModel::anchor_point(anchor, truth_mm) +
                               Vector3f(0, raised_mm * std::clamp(lowers / 15, 0.0F, 1.0F), 0);
        const auto pixel = camera.lens.project(at_mm.cast<double>());
        if (pixel && anchor.weights[0] + anchor.weights[1] + anchor.weights[2] > 0.5F) {
          made.face.points_px.col(i).head<2>() = pixel->cast<float>();
          made.face.confidence[i] = 1;
        }
      }
    }
    return points;
  }

  /// The first mesh and the one of the next blank slot.
  std::vector<mesh::MeshFrame> meshes(float raised_mm) const {
    const simulation::BoothSlot first = booth_->slot(2);
    PerformanceTracker tracker(model_, nets_, std::make_shared<const capture::Rig>(booth_->rig()), {},
                               landmarks(first, raised_mm));
    std::vector<mesh::MeshFrame> made(2);
    for (const std::uint64_t number : std::initializer_list<std::uint64_t>{2, 5}) {
      const simulation::BoothSlot slot = booth_->slot(number);
      std::vector<capture::DepthMap> maps;
      for (const capture::StereoPair& pair : booth_->rig().pairs) {
        maps.push_back(depth_of(slot.surface(), booth_->rig().cameras[pair.left].lens));
      }
      tracker.process(slot.frame_set(), maps, made[number / 5]);
    }
    return made;
  }

 private:
  std::filesystem::path nets_;
  std::shared_ptr<const face::FaceModel> model_;
  std::unique_ptr<simulation::VirtualBooth> booth_;
};

TEST_F(TornMouth, IsToldOnEveryMeshThatBeganWithIt) {
  for (const mesh::MeshFrame& frame : meshes(20)) {
    EXPECT_EQ(frame.state, mesh::TrackingState::Tracking);
    EXPECT_THAT(frame.degraded_reason, HasSubstr("too wide open in its first slot"));
  }
}

TEST_F(TornMouth, AnOpenMouthThatIsSeenRightIsSound) {
  for (const mesh::MeshFrame& frame : meshes(0)) {
    EXPECT_EQ(frame.state, mesh::TrackingState::Tracking);
    EXPECT_THAT(frame.degraded_reason, testing::IsEmpty());
  }
}

}  // namespace
}  // namespace facet::booth
