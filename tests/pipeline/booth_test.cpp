// From a booth's frame sets to meshes: the parts alone, the whole on pictures of the virtual booth, and what
// becomes of it when cameras, projectors or the rig file are not as they should be.

#include "pipeline/booth.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <map>
#include <optional>
#include <thread>

#include "booth/face_in_space.hpp"
#include "booth/rig_check.hpp"
#include "booth/template_subject.hpp"
#include "booth/vertex_texture.hpp"
#include "camera/simulated_devices.hpp"
#include "capture/epipolar.hpp"
#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "pipeline/sets_on_stream.hpp"
#include "render/renderer.hpp"
#include "scripted_stages.hpp"
#include "simulation/virtual_booth.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"
#include "take/recorder.hpp"

namespace facet::pipeline {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;

capture::Lens plain_lens() {
  capture::Lens lens;
  lens.width_px = 200;
  lens.height_px = 160;
  lens.fx_px = lens.fy_px = 400;
  lens.cx_px = 100;
  lens.cy_px = 80;
  return lens;
}

Eigen::Isometry3d looking_along(const Eigen::Vector3d& at, double turn) {
  return (Eigen::Translation3d(at) * Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY())).inverse();
}

TEST(DepthRange, LiesAroundThePointThatThePairsLookAt) {
  capture::Rig rig;
  for (const double side : {-1.0, 1.0}) {
    capture::RigCamera camera;
    camera.lens = plain_lens();
    camera.lens.camera_from_rig = looking_along({side * 100, 0, 0}, -side * std::atan2(100.0, 700.0));
    rig.cameras.push_back(camera);
  }
  rig.pairs = {{0, 1}};
  const stereo::DepthRange range = booth::depth_range(rig);
  const double distance = std::hypot(100, 700);
  EXPECT_NEAR(range.nearest_mm, distance - 150, 0.1);
  EXPECT_NEAR(range.farthest_mm, distance + 250, 0.1);

  for (capture::RigCamera& camera : rig.cameras) {
    camera.lens.camera_from_rig.linear().setIdentity();
  }
  try {
    booth::depth_range(rig);
    FAIL() << "parallel cameras look at no point";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    EXPECT_THAT(error.what(), HasSubstr("depth_mm"));
  }
}

class Landmarks : public ::testing::Test {
 protected:
  /// A wall at 500 mm before a lens at the origin, with a hole on its right side.
  Landmarks() {
    map_.lens = plain_lens();
    map_.width_px = map_.lens.width_px;
    map_.height_px = map_.lens.height_px;
    map_.depth_mm.assign(static_cast<std::size_t>(map_.width_px * map_.height_px), 500.0F);
    for (int y = 0; y < map_.height_px; ++y) {
      std::fill_n(map_.depth_mm.begin() + y * map_.width_px + 150, 50, 0.0F);
    }
    anchors_.resize(468);
    for (int i = 0; i < 4; ++i) {
      anchors_[static_cast<std::size_t>(i)].weights = {1, 0, 0};
      anchors_[static_cast<std::size_t>(i)].vertices[0] = i;
    }
  }
  static landmark::FaceLandmarks none() {
    landmark::FaceLandmarks face;
    face.points_px = Eigen::Matrix3Xf::Zero(3, 468);
    face.confidence = Eigen::VectorXf::Zero(468);
    return face;
  }
  static void see(landmark::FaceLandmarks& face, int landmark, const capture::Lens& lens,
                  const Eigen::Vector3d& at) {
    face.points_px.col(landmark).head<2>() = lens.project(at).value().cast<float>();
    face.confidence[landmark] = 1;
  }
  capture::DepthMap map_;
  std::vector<face::LandmarkAnchor> anchors_;
};

TEST_F(Landmarks, MeetTheSurfaceOfTheDepthMaps) {
  capture::Lens side = plain_lens();
  side.camera_from_rig = looking_along({60, 10, 0}, -0.12);
  side.distortion.k1 = -0.1;
  landmark::FaceLandmarks face = none();
  const Eigen::Vector3d left(-40, 20, 500);
  const Eigen::Vector3d middle(5, -30, 500);
  see(face, 0, side, left);
  see(face, 1, side, middle);
  see(face, 2, side, {110, 0, 500});  // in the hole
  const booth::SeenLandmarks view{&side, &face};
  const auto found = booth::landmarks_in_space(std::span(&view, 1), std::span(&map_, 1), anchors_);
  ASSERT_EQ(found.size(), 2U);
  EXPECT_EQ(found[0].anchor.vertices[0], 0);
  EXPECT_NEAR((found[0].target_mm - left).norm(), 0, 0.01);
  EXPECT_NEAR((found[1].target_mm - middle).norm(), 0, 0.01);
}

TEST_F(Landmarks, OfSeveralCamerasAreJoinedWhereTheyAgree) {
  capture::Lens first = plain_lens();
  capture::Lens second = plain_lens();
  second.camera_from_rig = looking_along({-50, 0, 0}, 0.1);
  landmark::FaceLandmarks one = none();
  landmark::FaceLandmarks other = none();
  see(one, 0, first, {0, 0, 500});
  see(other, 0, second, {4, 0, 500});  // within reach: the mean
  see(one, 1, first, {-60, 0, 500});
  see(other, 1, second, {-20, 0, 500});  // far: the surer one
  one.confidence[1] = 0.6F;
  other.confidence[1] = 0.9F;
  const std::array views{booth::SeenLandmarks{&first, &one}, booth::SeenLandmarks{&second, &other}};
  const auto found = booth::landmarks_in_space(views, std::span(&map_, 1), anchors_);
  ASSERT_EQ(found.size(), 2U);
  EXPECT_NEAR(found[0].target_mm.x(), 2, 0.02);
  EXPECT_NEAR(found[1].target_mm.x(), -20, 0.02);
}

TEST_F(Landmarks, WithoutAnyDepthThereAreNone) {
  std::fill(map_.depth_mm.begin(), map_.depth_mm.end(), 0.0F);
  const capture::Lens lens = plain_lens();
  landmark::FaceLandmarks face = none();
  see(face, 0, lens, {0, 0, 500});
  const booth::SeenLandmarks view{&lens, &face};
  EXPECT_TRUE(booth::landmarks_in_space(std::span(&view, 1), std::span(&map_, 1), anchors_).empty());
}

/// Two triangles before the camera, turned to it; the camera sees red on the left and blue on the right.
class Texture : public ::testing::Test {
 protected:
  Texture() {
    vertices_mm_.resize(3, 4);
    vertices_mm_ << -50, 50, 50, -50,  //
        -40, -40, 40, 40,              //
        500, 500, 500, 500;
    triangles_.resize(3, 2);
    triangles_ << 0, 0,  //
        3, 2,            //
        2, 1;
    mesh::vertex_normals(vertices_mm_, triangles_, normals_);
    render::Picture picture = render::plain_picture(200, 160, {200, 0, 0});
    for (std::size_t pixel = 0; pixel < 200 * 160; ++pixel) {
      if (pixel % 200 >= 100) {
        picture.rgb[3 * pixel] = 0;
        picture.rgb[3 * pixel + 2] = 100;
      }
    }
    frame_ = render::to_frame(picture);
  }
  mesh::Vertices vertices_mm_;
  mesh::Triangles triangles_;
  Eigen::Matrix3Xf normals_;
  Frame frame_;
};

TEST_F(Texture, IsTheMeanOfWhatIsSeen) {
  booth::VertexTexture texture;
  texture.begin(4);
  EXPECT_EQ(texture.latest(), nullptr);
  // The mesh's rim is left out by the visibility test, so the vertices are looked at from the middle of a
  // larger mesh: here every vertex is on the rim, and none is seen.
  texture.add(plain_lens(), frame_, vertices_mm_, normals_, triangles_);
  texture.publish();
  ASSERT_NE(texture.latest(), nullptr);
  EXPECT_EQ(texture.latest()->version, 1U);

  // A grid whose inner vertices are away from any rim.
  constexpr int kSide = 9;
  mesh::Vertices grid(3, kSide * kSide);
  for (int i = 0; i < kSide * kSide; ++i) {
    grid.col(i) << -60.0F + 15.0F * static_cast<float>(i % kSide),
        -60.0F + 15.0F * static_cast<float>(i / kSide), 500;
  }
  mesh::Triangles triangles(3, 2 * (kSide - 1) * (kSide - 1));
  Eigen::Index next = 0;
  for (int row = 0; row + 1 < kSide; ++row) {
    for (int column = 0; column + 1 < kSide; ++column) {
      const int at = row * kSide + column;
      triangles.col(next++) << at, at + kSide, at + 1;
      triangles.col(next++) << at + 1, at + kSide, at + kSide + 1;
    }
  }
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(grid, triangles, normals);
  texture.begin(grid.cols());
  texture.add(plain_lens(), frame_, grid, normals, triangles);
  texture.publish();
  const auto first = texture.latest();
  ASSERT_NE(first, nullptr);
  EXPECT_EQ(first->version, 2U) << "never a version again";
  const auto colour = [&](const mesh::Albedo& albedo, int vertex) {
    return Eigen::Vector3f(albedo.linear_rgb.data() + 3 * vertex);
  };
  const int left = 4 * kSide + 2;
  const int right = 4 * kSide + 6;
  EXPECT_NEAR(colour(*first, left).x(), render::srgb8_to_linear(200), 1e-4);
  EXPECT_NEAR(colour(*first, left).z(), 0, 1e-4);
  EXPECT_NEAR(colour(*first, right).z(), render::srgb8_to_linear(100), 1e-4);

  // A second slot in which everything is black halves it; the third makes no new version.
  const Frame black = render::to_frame(render::plain_picture(200, 160, {0, 0, 0}));
  texture.add(plain_lens(), black, grid, normals, triangles);
  texture.publish();
  EXPECT_NEAR(colour(*texture.latest(), left).x(), render::srgb8_to_linear(200) / 2, 1e-4);
  const auto second = texture.latest();
  texture.add(plain_lens(), black, grid, normals, triangles);
  texture.publish();
  EXPECT_EQ(texture.latest(), second);
}

TEST(TemplateSubject, CarriesTheTemplateAsItIs) {
  const face::FaceModel model = test::synthetic_model(17);
  const fit::TemplateMesh surface = fit::make_template(model, 3000);
  const auto hierarchy = mesh::build_hierarchy_below(model.control, surface.vertex_count(), 1);
  const auto subject = booth::build_template_subject(surface, hierarchy, model, 1);
  EXPECT_EQ(subject->hierarchy->control_vertex_count, surface.vertex_count());
  EXPECT_EQ(subject->regions.size(), static_cast<std::size_t>(surface.vertex_count()));
  EXPECT_NE(subject->id, booth::build_template_subject(surface, hierarchy, model, 2)->id);
  std::vector<mesh::Vertices> levels;
  mesh::push_positions(*subject->hierarchy, surface.neutral_mm, levels);
  EXPECT_EQ(levels.front(), surface.neutral_mm);
  // Control vertices keep their places in the template, and with them their regions.
  for (std::size_t v = 0; v < model.regions.size(); ++v) {
    EXPECT_EQ(subject->regions[v], model.regions[v]);
  }
}

TEST(BoothConfig, NeedsRigStripesAndBlankSlots) {
  const auto refusal = [](const BoothConfig& config) -> std::string {
    try {
      check(config);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
      return error.what();
    }
    return "";
  };
  BoothConfig config;
  EXPECT_THAT(refusal(config), HasSubstr("rig.file"));
  config.rig_file = "rig.toml";
  EXPECT_EQ(refusal(config), "");
  using Kind = capture::SlotLight::Kind;
  config.program = {{Kind::Stripes, {}}, {Kind::Lit, {"lamp"}}};
  EXPECT_THAT(refusal(config), HasSubstr("blank"));
  config.program = {{Kind::Blank, {}}};
  EXPECT_THAT(refusal(config), HasSubstr("blank"));
  config.program = capture::parse_slot_program("fringes:0,fringes:2,blank");
  EXPECT_THAT(refusal(config),
              AllOf(HasSubstr("slot 2"), HasSubstr("fringes:0,fringes:1,blank,fringes:2,fringes:3,blank")));
  for (const char* good : {"fringes", "fringes:0,fringes:2,blank,stripes",
                           "fringes:0,fringes:1,blank,fringes:2,fringes:3,light:a"}) {
    config.program = capture::parse_slot_program(good);
    EXPECT_EQ(refusal(config), "") << good;
  }
  config.program = {{Kind::Stripes, {}}, {Kind::Blank, {}}};
  config.gpu_device = "none";
  EXPECT_THAT(refusal(config), HasSubstr("gpu.device"));
}

/// Slots 150 to 157 of the virtual booth, rendered once: blank are 152 and 155.
class Booth : public ::testing::Test {
 protected:
  static constexpr std::uint64_t kFirst = 150;
  static constexpr std::uint64_t kSlots = 8;

  struct Footage {
    explicit Footage(const face::FaceModel& face_model) : model(face_model), booth(&model, config()) {
      for (std::uint64_t slot = kFirst; slot < kFirst + kSlots; ++slot) {
        sets.push_back(booth.slot(slot).frame_set());
      }
    }
    static simulation::VirtualBoothConfig config() {
      simulation::VirtualBoothConfig booth;
      booth.seed = 5;
      booth.samples = 1;
      booth.resolution = 0.625;  // a third of the time
      return booth;
    }
    face::FaceModel model;
    simulation::VirtualBooth booth;
    std::vector<FrameSet> sets;
  };

  void SetUp() override {
    config_.model_file = test::default_model();
    config_.landmark_nets = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
    for (const auto& needed : {config_.model_file, config_.landmark_nets}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
    if (footage_ == nullptr) {
      footage_ = std::make_unique<Footage>(face::FaceModel::load(config_.model_file));
    }
    config_.rig_file = folder_.path() / "rig.toml";
    write_rig(footage_->booth.rig());
  }
  static void TearDownTestSuite() { footage_.reset(); }

  void write_rig(const capture::Rig& rig) {
    capture::write_rig(rig, config_.rig_file);
    pairs_ = rig.pairs;
  }
  /// One pair is enough where it is not about the other.
  void write_half_a_rig() {
    capture::Rig rig = footage_->booth.rig();
    rig.pairs.resize(1);
    write_rig(rig);
  }

  static void lose(FrameSet& set, std::size_t camera) {
    set.frames[camera] = {};
    set.missing |= std::uint64_t{1} << camera;
  }

  /// Nothing where there is no Vulkan device.
  static std::optional<BoothParts> open(const BoothConfig& config) {
    try {
      return open_booth(config, 2);
    } catch (const Error& error) {
      if (error.kind() != ErrorKind::NoDevice) {
        throw;
      }
      return std::nullopt;
    }
  }

  /// Runs some sets through; what came out, and how it ended.
  void run(const std::vector<FrameSet>& sets) {
    std::optional<BoothParts> stages = open(config_);
    if (!stages) {
      GTEST_SKIP() << "no Vulkan device";
    }
    test::CollectingSink sink;
    BoothMeshes meshes(std::move(*stages), BoothMeshes::WhenBusy::Wait, {&sink});
    meshes.start();
    for (const FrameSet& set : sets) {
      meshes.deliver(std::make_shared<const FrameSet>(set));
    }
    meshes.finish();
    while (!meshes.finished()) {
      std::this_thread::sleep_for(5ms);
    }
    meshes.stop();
    status_ = meshes.status();
    frames_ = sink.frames();
  }

  /// Whether both cameras of a pair that the rig file has see a point of a surface, and not too steeply.
  bool is_seen(const render::Raycaster& surface, const Eigen::Vector3f& point_mm,
               const Eigen::Vector3f& normal) const {
    const capture::Rig& rig = footage_->booth.rig();
    const auto sees = [&](std::size_t camera) {
      const Eigen::Vector3f eye = rig.cameras[camera].lens.centre_mm().cast<float>();
      return normal.dot((eye - point_mm).normalized()) > 0.5F && !surface.occluded(point_mm, eye, 1);
    };
    return std::any_of(pairs_.begin(), pairs_.end(),
                       [&](const capture::StereoPair& pair) { return sees(pair.left) && sees(pair.right); });
  }

  /// Mean distance of the face's skin to the truth, mm, where a pair sees the truth. The rest is the model's
  /// guess, which one grey value more or less in every ten thousandth pixel moves by more than half a
  /// millimetre: other rounding would do, too.
  double distance_to_truth(const mesh::MeshFrame& frame) {
    const capture::Rig& rig = footage_->booth.rig();
    const simulation::TruthMesh truth = footage_->booth.slot(frame.sequence).surface();
    const auto colour =
        std::find_if(rig.cameras.begin(), rig.cameras.end(), [](const auto& c) { return c.colour; });
    const Eigen::Isometry3f rig_from_head =
        colour->lens.camera_from_rig.inverse().cast<float>() * frame.camera_from_head;
    const render::Raycaster caster(truth.vertices_mm, truth.triangles);
    double sum = 0;
    double count = 0;
    for (Eigen::Index v = 0; v < frame.control_vertices_mm.cols(); ++v) {
      const auto bits = frame.subject->regions[static_cast<std::size_t>(v)];
      // The middle of the face: the rim is seen steeply.
      const Eigen::Vector3f at = frame.control_vertices_mm.col(v);
      if (face::has_region(bits, face::Region::Refinable) && std::abs(at.x()) < 40) {
        const auto nearest = caster.closest_point(rig_from_head * at, 20);
        if (nearest.triangle < 0) {
          sum += 20;
          ++count;
          continue;
        }
        const auto corners = truth.triangles.col(nearest.triangle);
        const Eigen::Vector3f first = truth.vertices_mm.col(corners[0]);
        const Eigen::Vector3f across = truth.vertices_mm.col(corners[1]) - first;
        const Eigen::Vector3f along = truth.vertices_mm.col(corners[2]) - first;
        if (is_seen(caster, nearest.point_mm, across.cross(along).normalized())) {
          sum += static_cast<double>(nearest.distance_mm);
          ++count;
        }
      }
    }
    EXPECT_GT(count, 500);
    RecordProperty("distance_um", static_cast<int>(1000 * sum / std::max(count, 1.0)));
    return sum / std::max(count, 1.0);
  }

  /// Gives every channel of every picture another value, cut to 0 to 255.
  static void change(FrameSet& set,
                     const std::function<float(std::size_t camera, int x, int y, int value)>& to) {
    for (std::size_t camera = 0; camera < set.frames.size(); ++camera) {
      Frame& frame = set.frames[camera];
      const auto size = frame.stride_bytes * static_cast<std::size_t>(frame.height_px);
      auto pixels = std::make_shared<std::uint8_t[]>(size);
      std::copy_n(frame.pixels.get(), size, pixels.get());
      for (int y = 0; y < frame.height_px; ++y) {
        for (int x = 0; x < frame.width_px; ++x) {
          std::uint8_t* const pixel = pixels.get() + static_cast<std::size_t>(y) * frame.stride_bytes +
                                      4 * static_cast<std::size_t>(x);
          for (int c = 0; c < 3; ++c) {
            pixel[c] = static_cast<std::uint8_t>(std::clamp(to(camera, x, y, pixel[c]), 0.0F, 255.0F));
          }
        }
      }
      frame.pixels = pixels;
    }
  }

  /// A mesh that lies on the face, or none and why: never an invented surface.
  void expect_true_or_none(const mesh::MeshFrame& frame) {
    if (frame.state == mesh::TrackingState::Tracking) {
      EXPECT_LT(distance_to_truth(frame), 1.5);
    } else {
      EXPECT_TRUE(frame.degraded);
      EXPECT_FALSE(frame.degraded_reason.empty());
    }
  }

  static std::unique_ptr<Footage> footage_;
  test::TemporaryFolder folder_;
  BoothConfig config_;
  std::vector<capture::StereoPair> pairs_;  ///< of the rig file
  PipelineStatus status_;
  std::vector<std::shared_ptr<const mesh::MeshFrame>> frames_;
};
std::unique_ptr<Booth::Footage> Booth::footage_;

TEST_F(Booth, EveryBlankSlotBecomesAMesh) {
  run(footage_->sets);
  ASSERT_EQ(frames_.size(), 2U) << status_.reason;
  std::uint64_t subject = 0;
  for (std::size_t i = 0; i < 2; ++i) {
    const mesh::MeshFrame& frame = *frames_[i];
    EXPECT_EQ(frame.sequence, kFirst + 2 + 3 * i);
    ASSERT_EQ(frame.state, mesh::TrackingState::Tracking) << frame.degraded_reason;
    EXPECT_FALSE(frame.degraded) << frame.degraded_reason;
    EXPECT_LT(distance_to_truth(frame), 0.6);
    EXPECT_GT(frame.stage_ms.depth_ms, 0);
    EXPECT_EQ(frame.expression.size(), frame.subject->expression_names.size());
    ASSERT_NE(frame.albedo, nullptr);
    ASSERT_EQ(frame.displacements_mm.size(),
              static_cast<std::size_t>(frame.subject->hierarchy->finest().vertex_count));
    EXPECT_EQ(frame.confidence.size(), frame.displacements_mm.size());
    EXPECT_EQ(frame.albedo->linear_rgb.size(), 3 * frame.displacements_mm.size());
    EXPECT_TRUE(subject == 0 || subject == frame.subject->id) << "it is the same person";
    subject = frame.subject->id;
  }
  // One vertex is one point of the skin: in 50 ms it goes where the head goes, and little farther.
  const auto moved = (frames_[1]->control_vertices_mm - frames_[0]->control_vertices_mm).colwise().norm();
  EXPECT_LT(moved.mean(), 1);
  EXPECT_EQ(status_.mesh_frames, 2U);
  EXPECT_EQ(status_.subjects, 1U);
}

TEST_F(Booth, BlankSlotsWithPatternsOnOneSideAloneAreToldToBeRougher) {
  run({footage_->sets.begin() + 2, footage_->sets.begin() + 6});
  ASSERT_EQ(frames_.size(), 2U) << status_.reason;
  EXPECT_TRUE(frames_[0]->degraded);
  EXPECT_THAT(frames_[0]->degraded_reason, HasSubstr("no slot before this one"));
  EXPECT_TRUE(frames_[1]->degraded);
  EXPECT_THAT(frames_[1]->degraded_reason, HasSubstr("no slot after this one"));
  for (const auto& frame : frames_) {
    expect_true_or_none(*frame);
  }
}

TEST_F(Booth, EverySlotBetweenBlankOnesBecomesAMesh) {
  write_half_a_rig();
  config_.every_slot = true;
  run(footage_->sets);
  ASSERT_EQ(frames_.size(), kSlots) << status_.reason;
  for (std::size_t i = 0; i < kSlots; ++i) {
    const mesh::MeshFrame& frame = *frames_[i];
    EXPECT_EQ(frame.sequence, kFirst + i);
    EXPECT_EQ(frame.timestamp_ns, footage_->sets[i].trigger_ns);
    if (i >= 2 && i <= 5) {
      ASSERT_EQ(frame.state, mesh::TrackingState::Tracking) << i << ": " << frame.degraded_reason;
      EXPECT_LT(distance_to_truth(frame), 1);
      EXPECT_EQ(frame.subject->id, frames_[2]->subject->id);
      EXPECT_FALSE(frame.displacements_mm.empty());
    } else {
      EXPECT_NE(frame.state, mesh::TrackingState::Tracking);
      EXPECT_EQ(frame.control_vertices_mm.cols(), 0);
      EXPECT_THAT(frame.degraded_reason, HasSubstr("blank slot"));
    }
  }
  EXPECT_EQ(status_.mesh_frames, 4U);
  EXPECT_EQ(status_.processed, kSlots);
}

TEST_F(Booth, ShadingAddsToTheFineLevelsOfEverySlot) {
  write_half_a_rig();
  config_.every_slot = true;
  run(footage_->sets);
  ASSERT_EQ(frames_.size(), kSlots) << status_.reason;
  const std::vector<std::shared_ptr<const mesh::MeshFrame>> by_depth = frames_;
  config_.shading = true;
  run(footage_->sets);
  ASSERT_EQ(frames_.size(), kSlots) << status_.reason;
  std::vector<std::vector<float>> added_mm(kSlots);
  for (std::size_t i = 2; i <= 5; ++i) {
    SCOPED_TRACE(i);
    const mesh::MeshFrame& shaded = *frames_[i];
    ASSERT_EQ(shaded.state, mesh::TrackingState::Tracking) << shaded.degraded_reason;
    EXPECT_EQ(shaded.degraded_reason, by_depth[i]->degraded_reason);
    EXPECT_EQ(shaded.control_vertices_mm, by_depth[i]->control_vertices_mm);
    ASSERT_EQ(shaded.displacements_mm.size(), by_depth[i]->displacements_mm.size());
    double sum = 0;
    double moved = 0;
    for (std::size_t v = 0; v < shaded.displacements_mm.size(); ++v) {
      const float added = shaded.displacements_mm[v] - by_depth[i]->displacements_mm[v];
      ASSERT_LT(std::abs(added), 2) << v;
      sum += static_cast<double>(std::abs(added));
      moved += added != 0 ? 1 : 0;
      added_mm[i].push_back(added);
    }
    EXPECT_GT(moved, 5000) << "vertices of the face";
    EXPECT_LT(sum / moved, 0.1) << "depth says where the skin is, shading how it slopes";
  }
  // Stripes show no shading: those slots get what the blank slot after them got.
  for (const std::size_t i : {std::size_t{3}, std::size_t{4}}) {
    std::size_t alike = 0;
    for (std::size_t v = 0; v < added_mm[i].size(); ++v) {
      alike += std::abs(added_mm[i][v] - added_mm[5][v]) < 1e-4F ? 1 : 0;
    }
    EXPECT_GT(alike, added_mm[i].size() * 98 / 100) << "but for what would fold";
  }
}

TEST_F(Booth, GoesOnWithoutOnePairsCameraAndWithoutASlot) {
  std::vector<FrameSet> sets(footage_->sets.begin(), footage_->sets.begin() + 5);
  sets.erase(sets.begin() + 3);  // slot 153
  const std::size_t lost = footage_->booth.rig().pairs[1].right;
  for (FrameSet& set : sets) {
    lose(set, lost);
  }
  run(sets);
  ASSERT_EQ(frames_.size(), 1U) << status_.reason;
  EXPECT_EQ(frames_[0]->state, mesh::TrackingState::Tracking) << frames_[0]->degraded_reason;
  EXPECT_TRUE(frames_[0]->degraded) << "a camera is missing, and that is said";
}

TEST_F(Booth, SomebodyElseBecomesANewSubject) {
  simulation::VirtualBoothConfig other_config = Footage::config();
  other_config.actor_seed = 11;
  const simulation::VirtualBooth other(&footage_->model, other_config);
  std::vector<FrameSet> sets(footage_->sets.begin(), footage_->sets.begin() + 6);
  for (std::uint64_t slot = kFirst + 6; slot < kFirst + 15; ++slot) {
    sets.push_back(other.slot(slot).frame_set());
  }
  run(sets);
  ASSERT_EQ(frames_.size(), 5U) << status_.reason;
  ASSERT_EQ(frames_[0]->state, mesh::TrackingState::Tracking) << frames_[0]->degraded_reason;
  // Half of the second's slots show the one, half the other: who is seen in it is not said.
  EXPECT_EQ(frames_[2]->state, mesh::TrackingState::Lost);
  ASSERT_EQ(frames_[4]->state, mesh::TrackingState::Tracking) << frames_[4]->degraded_reason;
  EXPECT_NE(frames_[4]->subject->id, frames_[0]->subject->id);
  EXPECT_EQ(status_.subjects, 2U);
}

TEST_F(Booth, AFaceThatIsPointedAtNeedsNoLandmarkNet) {
  // The colour cameras see nothing; a person has marked landmarks in a stripe camera's blank picture of slot
  // 155.
  write_half_a_rig();
  const capture::Rig& rig = footage_->booth.rig();
  const capture::RigCamera& camera = rig.cameras[rig.pairs[0].left];
  const std::uint64_t slot = kFirst + 5;
  const simulation::TruthMesh truth = footage_->booth.slot(slot).surface();
  config_.points_file = folder_.path() / "points.toml";
  {
    std::ofstream points(config_.points_file);
    points << "slot = " << slot << "\n[camera.\"" << camera.name << "\"]\n";
    for (const int landmark : {33, 133, 362, 263, 46, 55, 285, 276, 168, 1, 129, 358, 61, 291, 0, 17, 152}) {
      const Eigen::Vector3f at =
          face::FaceModel::anchor_point(footage_->model.landmarks.at(static_cast<std::size_t>(landmark)),
                                        truth.vertices_mm.leftCols(footage_->model.vertex_count()));
      const Eigen::Vector2d pixel = camera.lens.project(at.cast<double>()).value();
      points << landmark << " = [" << std::lround(pixel.x()) << ", " << std::lround(pixel.y()) << "]\n";
    }
  }
  std::vector<FrameSet> sets = footage_->sets;
  for (FrameSet& set : sets) {
    for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
      if (rig.cameras[i].colour) {
        lose(set, i);
      }
    }
  }
  run(sets);
  ASSERT_EQ(frames_.size(), 2U) << status_.reason;
  EXPECT_EQ(frames_[0]->state, mesh::TrackingState::Searching);
  EXPECT_THAT(frames_[0]->degraded_reason, HasSubstr("pointed at in slot 155"));
  ASSERT_EQ(frames_[1]->state, mesh::TrackingState::Tracking) << frames_[1]->degraded_reason;
  EXPECT_LT(distance_to_truth(*frames_[1]), 1);

  // A camera that the rig does not have is named.
  config_.points_file = folder_.path() / "other.toml";
  std::ofstream(config_.points_file) << "slot = 155\n[camera.nose]\nnose_tip = [1, 2]\n";
  EXPECT_THAT([&] { open_booth(config_, 1); }, testing::ThrowsMessage<Error>(HasSubstr("'nose'")));
}

TEST_F(Booth, WithTheProjectorsOffThereIsNoMesh) {
  write_half_a_rig();
  std::vector<FrameSet> sets;
  for (std::uint64_t slot = kFirst; slot < kFirst + 5; ++slot) {
    sets.push_back(footage_->booth.slot(slot, {capture::Shown::Kind::Dark, 0}).frame_set());
  }
  run(sets);
  ASSERT_EQ(frames_.size(), 1U) << status_.reason;
  EXPECT_EQ(frames_[0]->state, mesh::TrackingState::Searching);
  EXPECT_EQ(frames_[0]->subject, nullptr);
  EXPECT_TRUE(frames_[0]->degraded);
}

TEST_F(Booth, WithFrozenProjectorsNoSurfaceIsInvented) {
  // Without stripes there is still the skin's own texture: what is found of it must be true.
  write_half_a_rig();
  std::vector<FrameSet> sets;
  for (std::uint64_t slot = kFirst; slot < kFirst + 5; ++slot) {
    sets.push_back(footage_->booth.slot(slot, {capture::Shown::Kind::Blank, 0}).frame_set());
  }
  run(sets);
  ASSERT_EQ(frames_.size(), 1U) << status_.reason;
  if (frames_[0]->state == mesh::TrackingState::Tracking) {
    EXPECT_LT(distance_to_truth(*frames_[0]), 1.5);
  } else {
    EXPECT_THAT(frames_[0]->degraded_reason, HasSubstr("are the projectors on"));
  }
}

TEST_F(Booth, AFaceOutOfTheVolumeIsNotFoundElsewhere) {
  write_half_a_rig();
  const stereo::DepthRange around = booth::depth_range(footage_->booth.rig());
  config_.depths = {around.farthest_mm + 50, around.farthest_mm + 400};
  run({footage_->sets.begin(), footage_->sets.begin() + 5});
  ASSERT_EQ(frames_.size(), 1U) << status_.reason;
  EXPECT_EQ(frames_[0]->state, mesh::TrackingState::Searching);
  EXPECT_TRUE(frames_[0]->degraded);
  EXPECT_FALSE(frames_[0]->degraded_reason.empty());
}

TEST_F(Booth, OverAndUnderExposedPicturesGiveATrueMeshOrNone) {
  write_half_a_rig();
  for (const float gain : {4.0F, 0.04F}) {
    SCOPED_TRACE(gain);
    std::vector<FrameSet> sets(footage_->sets.begin(), footage_->sets.begin() + 5);
    for (FrameSet& set : sets) {
      change(set, [&](std::size_t, int, int, int value) { return gain * static_cast<float>(value); });
    }
    run(sets);
    ASSERT_EQ(frames_.size(), 1U) << status_.reason;
    expect_true_or_none(*frames_[0]);
  }
}

TEST_F(Booth, AHandInFrontIsNoPartOfTheFace) {
  // A disc of one grey, 35 mm wide, 70 mm before the middle of the face: where every camera sees it.
  const capture::Rig& rig = footage_->booth.rig();
  const Eigen::Vector3d face_mm =
      footage_->booth.slot(kFirst).surface().vertices_mm.cast<double>().rowwise().mean();
  const Eigen::Vector3d hand_mm = face_mm + 70 * (rig.cameras[0].lens.centre_mm() - face_mm).normalized();
  std::vector<FrameSet> sets = footage_->sets;
  for (FrameSet& set : sets) {
    change(set, [&](std::size_t camera, int x, int y, int value) {
      const capture::Lens& lens = rig.cameras[camera].lens;
      const auto at = lens.project(hand_mm);
      const double radius_px = 35 * lens.fx_px / (hand_mm - lens.centre_mm()).norm();
      return at && (*at - Eigen::Vector2d(x, y)).norm() < radius_px ? 120.0F : static_cast<float>(value);
    });
  }
  run(sets);
  ASSERT_EQ(frames_.size(), 2U) << status_.reason;
  for (const auto& frame : frames_) {
    expect_true_or_none(*frame);
  }
}

TEST_F(Booth, PicturesOfSwappedCamerasGiveNoMesh) {
  write_half_a_rig();
  std::vector<FrameSet> sets(footage_->sets.begin(), footage_->sets.begin() + 5);
  const capture::StereoPair pair = footage_->booth.rig().pairs[0];
  for (FrameSet& set : sets) {
    std::swap(set.frames[pair.left], set.frames[pair.right]);
  }
  run(sets);
  ASSERT_EQ(frames_.size(), 1U) << status_.reason;
  EXPECT_EQ(frames_[0]->state, mesh::TrackingState::Searching);
  EXPECT_TRUE(frames_[0]->degraded);
}

TEST_F(Booth, WithoutAFaceThereIsNoMesh) {
  simulation::VirtualBoothConfig plate = Footage::config();
  plate.scene = simulation::BoothScene::Plane;
  const simulation::VirtualBooth booth(nullptr, plate);
  capture::Rig rig = booth.rig();
  rig.pairs.resize(1);
  write_rig(rig);
  std::vector<FrameSet> sets;
  for (std::uint64_t slot = kFirst; slot < kFirst + 5; ++slot) {
    sets.push_back(booth.slot(slot).frame_set());
  }
  run(sets);
  ASSERT_EQ(frames_.size(), 1U) << status_.reason;
  EXPECT_EQ(frames_[0]->state, mesh::TrackingState::Searching);
  EXPECT_THAT(frames_[0]->degraded_reason, HasSubstr("no face"));
}

TEST_F(Booth, ACameraThatWasBumpedIsNoticed) {
  const FrameSet& blank = footage_->sets[2];
  const stereo::DepthRange depths = booth::depth_range(footage_->booth.rig());
  const auto look = [&](const capture::Rig& rig) {
    booth::RigCheck check(std::make_shared<const capture::Rig>(rig), depths);
    std::string wrong;
    for (int i = 0; i < 30; ++i) {
      wrong = check.look(blank);
    }
    // What it knows of the pairs is what it says.
    for (const booth::RigPairStatus& pair : check.pairs()) {
      EXPECT_GE(pair.matches, 30U);
      EXPECT_GE(pair.p95_px, pair.median_px);
      if (pair.wrong.empty()) {
        EXPECT_LT(pair.median_px, 0.7);
      } else {
        EXPECT_GT(pair.median_px, 0.7);
      }
      const auto seen =
          std::count_if(pair.error_px.begin(), pair.error_px.end(), [](float error) { return error >= 0; });
      EXPECT_GT(seen, 6) << "the face fills some of the picture";
      EXPECT_LT(seen, static_cast<std::ptrdiff_t>(pair.error_px.size())) << "and not all of it";
    }
    return wrong;
  };
  const capture::Rig good = footage_->booth.rig();
  EXPECT_EQ(look(good), "");
  for (const capture::StereoPair& pair : good.pairs) {
    const auto matches = booth::match_corners(good.cameras[pair.left].lens, good.cameras[pair.right].lens,
                                              blank.frames[pair.left], blank.frames[pair.right], depths);
    const capture::PairCheck check =
        capture::check_pair(good.cameras[pair.left], good.cameras[pair.right], matches, {10, 0.7});
    EXPECT_GE(check.matches, 20U);
    EXPECT_LT(check.median_px, 0.5) << check.message;
  }
  // One camera nods by a sixth of a degree, or rolls by two degrees.
  const Eigen::AngleAxisd nod(0.003, Eigen::Vector3d::UnitX());
  const Eigen::AngleAxisd roll(0.035, Eigen::Vector3d::UnitZ());
  for (const Eigen::AngleAxisd& turn : {nod, roll}) {
    capture::Rig bumped = good;
    capture::Lens& lens = bumped.cameras[good.pairs[1].right].lens;
    lens.camera_from_rig = turn * lens.camera_from_rig;
    EXPECT_THAT(look(bumped),
                AllOf(HasSubstr(good.cameras[good.pairs[1].right].name), HasSubstr("epipolar")));
  }
}

TEST_F(Booth, AnotherRigsFileIsNamed) {
  capture::Rig rig = footage_->booth.rig();
  rig.cameras[0].name = "nobody";
  write_rig(rig);
  run(footage_->sets);
  EXPECT_TRUE(frames_.empty());
  EXPECT_EQ(status_.state, PipelineState::Failed);
  EXPECT_EQ(status_.failure_kind, ErrorKind::Usage);
  EXPECT_THAT(status_.reason, HasSubstr("'nobody'"));
}

TEST_F(Booth, PicturesOfAnotherSizeAreNamed) {
  std::vector<FrameSet> sets = footage_->sets;
  for (FrameSet& set : sets) {
    set.frames[1] = render::to_frame(render::plain_picture(320, 240, {90, 90, 90}));
  }
  run(sets);
  EXPECT_TRUE(frames_.empty());
  EXPECT_EQ(status_.state, PipelineState::Failed);
  EXPECT_THAT(status_.reason, HasSubstr("320 x 240"));
}

TEST_F(Booth, LiveDevicesGiveSetsAndMeshes) {
  write_half_a_rig();
  const std::filesystem::path take = folder_.path() / "footage.take";
  {
    take::TakeRecorderConfig recording;
    recording.file = take;
    recording.when_full = take::WhenFull::Wait;
    recording.with_images = true;
    take::TakeRecorder recorder(recording);
    recorder.start();
    for (const FrameSet& set : footage_->sets) {
      test::CollectingSink frame;
      SetsOnStream({&frame}).deliver(std::make_shared<const FrameSet>(set));
      recorder.record(frame.frames().front());
    }
    ASSERT_EQ(recorder.stop().state, take::RecorderState::Finished);
  }
  DevicesConfig devices;
  devices.footage = take;
  for (const capture::RigCamera& camera : footage_->booth.rig().cameras) {
    DeviceCamera device;
    device.name = camera.name;
    device.source.kind = camera::kSimulatedCamera.name;
    devices.cameras.push_back(device);
  }
  devices.trigger = TriggerKind::Virtual;
  devices.gpio.thread.real_time = false;
  devices.program.slots_per_second = 20;
  devices.program.exposure_ns = 2'000'000;
  devices.program.tolerance_ns = 20'000'000;
  for (const char* name : {"cameras", "a", "b"}) {
    TriggerLine line;
    line.name = name;
    line.role = devices.program.lines.empty() ? LineRole::Camera : LineRole::Projector;
    devices.program.lines.push_back(line);
  }
  devices.program.patterns = {2, 4, 0};
  std::optional<pipeline::Booth> booth;
  try {
    booth = open_booth(devices, config_);
  } catch (const Error& error) {
    ASSERT_EQ(error.kind(), ErrorKind::NoDevice) << error.what();
    GTEST_SKIP() << error.what();
  }
  test::CollectingSets sets;
  test::CollectingSink meshes;
  BoothPipeline pipeline(std::move(*booth), {&sets}, {&meshes});
  pipeline.start();
  const auto end = std::chrono::steady_clock::now() + 120s;
  while (pipeline.status().mesh_frames == 0 && std::chrono::steady_clock::now() < end) {
    std::this_thread::sleep_for(20ms);
  }
  pipeline.stop();
  const PipelineStatus status = pipeline.status();
  EXPECT_EQ(status.state, PipelineState::Stopped) << status.reason;
  EXPECT_GE(status.mesh_frames, 1U) << status.degraded_reason;
  ASSERT_TRUE(status.rig);
  EXPECT_EQ(status.rig->cameras.size(), 6U);
  EXPECT_FALSE(status.device.empty());
  ASSERT_FALSE(meshes.frames().empty());
  EXPECT_EQ(meshes.frames().back()->sequence % 3, 2U) << "a blank slot";
  // Every picture is that of the slot which the lines selected.
  std::size_t compared = 0;
  for (const auto& shown : sets.sets()) {
    const Frame& picture = shown->frames[0];
    if (picture.empty()) {
      continue;
    }
    const bool found = std::any_of(footage_->sets.begin(), footage_->sets.end(), [&](const FrameSet& set) {
      return set.slot % 3 == shown->slot % 3 &&
             std::equal(picture.row(150), picture.row(150) + 4 * picture.width_px, set.frames[0].row(150));
    });
    EXPECT_TRUE(found) << "slot " << shown->slot;
    ++compared;
  }
  EXPECT_GT(compared, 6U);
}

}  // namespace
}  // namespace facet::pipeline
