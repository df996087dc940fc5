// The reduced basis of a take: what it holds, how near it is, and what it refuses.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/SVD>
#include <array>
#include <cmath>
#include <cstring>
#include <fstream>
#include <random>

#include "animate/streaming_basis.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "support/mesh_frames.hpp"
#include "support/take_actor.hpp"

namespace facet::animate {
namespace {

using ::testing::HasSubstr;

Eigen::MatrixXf random_matrix(Eigen::Index rows, Eigen::Index columns, std::mt19937& random) {
  std::normal_distribution<float> normal;
  return Eigen::MatrixXf::NullaryExpr(rows, columns, [&] { return normal(random); });
}

template <typename Work>
std::string error_of(const Work& work, ErrorKind kind) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), kind) << error.what();
    return error.what();
  }
  return "no error";
}

TEST(StreamingBasis, IsTheSingularValueDecompositionOfAllBlocks) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    std::mt19937 random(seed);
    // Rank 7 and noise that is weaker than the least direction.
    const Eigen::MatrixXf strong = random_matrix(301, 7, random) * random_matrix(7, 113, random);
    const Eigen::MatrixXf all = strong + 0.01F * random_matrix(301, 113, random);
    StreamingBasis basis(301, 12);
    for (Eigen::Index at = 0; at < all.cols();) {
      const Eigen::Index count =
          std::min<Eigen::Index>(1 + static_cast<Eigen::Index>(random() % 30), all.cols() - at);
      basis.add(all.middleCols(at, count));
      at += count;
    }
    const Eigen::JacobiSVD<Eigen::MatrixXd> exact(all.cast<double>());
    for (Eigen::Index k = 0; k < 7; ++k) {
      EXPECT_NEAR(basis.strengths()[k], exact.singularValues()[k], 1e-4 * exact.singularValues()[0])
          << "seed " << seed;
    }
    const Eigen::MatrixXf directions = basis.directions();
    EXPECT_LT((directions.transpose() * directions - Eigen::MatrixXf::Identity(12, 12)).cwiseAbs().maxCoeff(),
              1e-5F);
    const Eigen::MatrixXf left = all - directions.leftCols(7) * (directions.leftCols(7).transpose() * all);
    const double best = exact.singularValues().tail(exact.singularValues().size() - 7).norm();
    EXPECT_LT(static_cast<double>(left.norm()), 1.05 * best) << "seed " << seed;
  }
}

TEST(StreamingBasis, TakesFewerVectorsThanDirectionsAndNone) {
  std::mt19937 random(4);
  const Eigen::MatrixXf all = random_matrix(50, 3, random);
  StreamingBasis basis(50, 10);
  basis.add(Eigen::MatrixXf(50, 0));
  basis.add(all);
  basis.add(all);  // nothing new
  const Eigen::MatrixXf directions = basis.directions();
  EXPECT_GE(directions.cols(), 3);
  EXPECT_LT((all - directions * (directions.transpose() * all)).norm(), 1e-4F * all.norm());
}

class TakeBasisTest : public ::testing::Test {
 protected:
  std::filesystem::path file(const std::string& name) const { return folder_.path() / name; }
  test::TemporaryFolder folder_;
};

TEST_F(TakeBasisTest, ReproducesEveryFrameWithinTheErrorItReports) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const auto basis = TakeBasis::open(test::record_actor(folder_.path(), seed, 90));
    ASSERT_EQ(basis->frame_count(), 90);
    const BasisHeader& header = basis->header();
    EXPECT_LT(header.coarse_max_mm, 0.05F);
    EXPECT_LT(header.detail_max_mm, 0.05F);
    EXPECT_GE(header.coarse_max_mm, header.coarse_rms_mm);
    Pose pose;
    pose.maps = std::make_shared<const InfluenceMaps>(*basis, std::span<const std::int32_t>());
    for (const Eigen::Index face : {0, 31, 89}) {
      pose.state = captured_state(*basis, face);
      const mesh::Vertices made = test::finest_of(*basis, pose);
      const mesh::Vertices real = test::captured(*basis, static_cast<std::size_t>(face));
      EXPECT_LT((made - real).colwise().norm().maxCoeff(),
                header.coarse_max_mm + header.detail_max_mm + 0.01F)
          << "seed " << seed << " face " << face;
    }
  }
}

TEST_F(TakeBasisTest, FewerDirectionsAreFurtherOffAndSaySo) {
  const auto take = test::record_actor(folder_.path(), 5, 60);
  BasisOptions few;
  few.coarse_rank = 2;
  few.detail_rank = 1;
  few.file = file("few.basis");
  const auto coarse = TakeBasis::open(take, few);
  const auto fine = TakeBasis::open(take);
  EXPECT_EQ(coarse->coarse_rank(), 2);
  EXPECT_GT(coarse->header().coarse_max_mm, 5 * fine->header().coarse_max_mm);
  EXPECT_GT(coarse->header().detail_max_mm, fine->header().detail_max_mm);
}

TEST_F(TakeBasisTest, IsKeptBesideTheTakeAndMadeAnewWhereItDoesNotFit) {
  const auto take = test::record_actor(folder_.path(), 1, 40);
  EXPECT_FALSE(TakeBasis::open(take)->was_kept());
  const auto again = TakeBasis::open(take);
  EXPECT_TRUE(again->was_kept());
  EXPECT_EQ(again->coefficients().cols(), 40);
  // Cut off, and with a byte changed.
  std::filesystem::resize_file(file("actor1.basis"), 5000);
  EXPECT_FALSE(TakeBasis::open(take)->was_kept());
  {
    std::fstream stream(file("actor1.basis"), std::ios::in | std::ios::out | std::ios::binary);
    stream.seekp(4000);
    stream.put('\x55');
    stream.put('\x56');
  }
  EXPECT_FALSE(TakeBasis::open(take)->was_kept());
  // Other options.
  BasisOptions options;
  options.coarse_rank = 5;
  EXPECT_FALSE(TakeBasis::open(take, options)->was_kept());
}

TEST_F(TakeBasisTest, LivesInMemoryWhereItCantBeKept) {
  BasisOptions options;
  options.file = file("no such folder/x.basis");
  const auto basis = TakeBasis::open(test::record_actor(folder_.path(), 1, 20), options);
  EXPECT_EQ(basis->frame_count(), 20);
  EXPECT_TRUE(basis->coefficients().allFinite());
}

TEST_F(TakeBasisTest, NoticesThatTheTakeChanged) {
  const auto take = test::record_actor(folder_.path(), 1, 20);
  const auto basis = TakeBasis::open(take);
  basis->check_unchanged();
  std::filesystem::last_write_time(take, std::filesystem::last_write_time(take) + std::chrono::seconds(5));
  EXPECT_THAT(error_of([&] { basis->check_unchanged(); }, ErrorKind::UnreadableInput),
              HasSubstr("changed on disk"));
  FaceIk ik(basis);
  Pose pose;
  const std::vector<ControlTarget> targets{{700, ControlTarget::Space::Head, basis->rest_mm().col(700)}};
  EXPECT_THAT(error_of([&] { ik.solve(targets, pose); }, ErrorKind::UnreadableInput),
              HasSubstr("changed on disk"));
  std::filesystem::remove(take);
  EXPECT_THAT(error_of([&] { basis->check_unchanged(); }, ErrorKind::UnreadableInput),
              HasSubstr("actor1.take"));
}

TEST_F(TakeBasisTest, RefusesTakesOfWhichNothingCanBeMade) {
  const auto open = [&](const std::string& name) {
    return error_of([&] { TakeBasis::open(file(name)); }, ErrorKind::UnreadableInput);
  };
  const simulation::ActorTake actor = test::small_actor(1, 4);
  test::record_frames(file("one.take"), 1, [&](int index) { return actor.frame(index); });
  EXPECT_THAT(open("one.take"), HasSubstr("1 mesh; posing and animating need 3"));
  test::record_frames(file("two.take"), 2, [&](int index) { return actor.frame(index); });
  EXPECT_THAT(open("two.take"), HasSubstr("2 meshes"));
  test::record_frames(file("none.take"), 5, [&](int index) {
    return std::make_shared<const mesh::MeshFrame>(test::searching_frame(static_cast<std::uint64_t>(index)));
  });
  EXPECT_THAT(open("none.take"), HasSubstr("no meshes"));
  const auto patch = test::patch_subject();
  test::record_frames(file("mixed.take"), 6, [&](int index) {
    return index < 4 ? actor.frame(index)
                     : std::make_shared<const mesh::MeshFrame>(
                           test::patch_frame(static_cast<std::uint64_t>(index), patch, nullptr));
  });
  EXPECT_THAT(open("mixed.take"), HasSubstr("more than one topology: frame 4"));
  EXPECT_THAT(open("missing.take"), HasSubstr("missing.take"));
  BasisOptions wrong;
  wrong.coarse_rank = 0;
  EXPECT_THAT(error_of([&] { TakeBasis::open(file("one.take"), wrong); }, ErrorKind::Usage),
              HasSubstr("directions"));
}

TEST_F(TakeBasisTest, TwoTopologiesOfOneIdAreRefused) {
  const auto patch_of = [](std::uint64_t id, int side) {
    auto subject = std::make_shared<mesh::Subject>(*test::patch_subject(id, side, 1));
    auto hierarchy = std::make_shared<mesh::Hierarchy>(*subject->hierarchy);
    hierarchy->id = 7;
    subject->hierarchy = std::move(hierarchy);
    return subject;
  };
  const std::array subjects = {patch_of(1, 40), patch_of(2, 4)};
  test::record_frames(file("shrink.take"), 8, [&](int index) {
    return std::make_shared<const mesh::MeshFrame>(test::patch_frame(
        static_cast<std::uint64_t>(index), subjects[static_cast<std::size_t>(index % 2)], nullptr));
  });
  EXPECT_THAT(error_of([&] { TakeBasis::open(file("shrink.take")); }, ErrorKind::UnreadableInput),
              HasSubstr("another topology of the id 0000000000000007"));
}

TEST_F(TakeBasisTest, AFileThatIsShortenedWhileItIsOpenDoesNoHarm) {
  const auto take = test::record_actor(folder_.path(), 1, 20);
  const float sum = TakeBasis::open(take)->coefficients().sum();
  const auto basis = TakeBasis::open(take);
  ASSERT_TRUE(basis->was_kept());
  std::filesystem::resize_file(file("actor1.basis"), 0);
  EXPECT_EQ(basis->coefficients().sum(), sum) << "the same bits, wherever they lie";
  EXPECT_TRUE(basis->coarse().allFinite());
  EXPECT_FALSE(TakeBasis::open(take)->was_kept());
}

TEST_F(TakeBasisTest, ABasisOfAnotherSizeThanItsHeaderSaysIsNotRead) {
  const auto take = test::record_actor(folder_.path(), 1, 20);
  TakeBasis::open(take);
  const auto kept = file("actor1.basis");
  ASSERT_TRUE(read_basis(kept).has_value());
  std::filesystem::resize_file(kept, std::uintmax_t{1} << 40);  // sparse: reading it would take all memory
  EXPECT_FALSE(read_basis(kept).has_value());
  EXPECT_FALSE(read_basis("/dev/zero").has_value());
  EXPECT_FALSE(read_basis(folder_.path()).has_value());
}

TEST_F(TakeBasisTest, TakesWithoutRefinementHaveNoDetail) {
  const simulation::ActorTake actor = test::small_actor(2, 30);
  test::record_frames(file("coarse.take"), 30, [&](int index) {
    auto frame = std::make_shared<mesh::MeshFrame>(*actor.frame(index));
    frame->displacements_mm.clear();
    frame->confidence.clear();
    return frame;
  });
  const auto basis = TakeBasis::open(file("coarse.take"));
  EXPECT_EQ(basis->detail_rank(), 0);
  FaceIk ik(basis);
  Pose pose;
  const std::vector<ControlTarget> targets{
      {700, ControlTarget::Space::Head, test::captured(*basis, 20).col(700)}};
  EXPECT_TRUE(ik.solve(targets, pose).front().met);
}

TEST_F(TakeBasisTest, FramesWithoutTheRefinementThatMostHaveAreLeftOut) {
  const simulation::ActorTake actor = test::small_actor(2, 30);
  test::record_frames(file("some.take"), 30, [&](int index) {
    auto frame = std::make_shared<mesh::MeshFrame>(*actor.frame(index));
    if (index % 10 == 3) {
      frame->displacements_mm.clear();
      frame->confidence.clear();
    }
    return frame;
  });
  const auto basis = TakeBasis::open(file("some.take"));
  EXPECT_EQ(basis->frame_count(), 27);
  EXPECT_EQ(basis->header().left_out, 3);
  EXPECT_EQ(basis->frames()[3].sequence, 4);
  EXPECT_EQ(basis->frames()[3].follows, 0);
  EXPECT_EQ(basis->frames()[4].follows, 1);
}

/// A patch of skin, and an eyeball behind it: a piece of its own that turns.
std::shared_ptr<const mesh::Subject> subject_with_eye() {
  constexpr int kSide = 5;
  mesh::ControlMesh control;
  control.vertex_count = 2 * kSide * kSide;
  control.refinable.assign(static_cast<std::size_t>(control.vertex_count), 1);
  control.texture_coordinates.resize(2, control.vertex_count);
  control.quads.resize(4, 2 * (kSide - 1) * (kSide - 1));
  auto subject = std::make_shared<mesh::Subject>();
  Eigen::Index quad = 0;
  for (int piece = 0; piece < 2; ++piece) {
    for (int row = 0; row < kSide; ++row) {
      for (int column = 0; column < kSide; ++column) {
        const int vertex = piece * kSide * kSide + row * kSide + column;
        control.texture_coordinates.col(vertex) << static_cast<float>(column) / kSide,
            static_cast<float>(row) / kSide;
        subject->regions.push_back(
            static_cast<std::uint8_t>(piece == 0 ? face::Region::Refinable : face::Region::Eye));
        if (row + 1 < kSide && column + 1 < kSide) {
          control.quads.col(quad++) << vertex, vertex + 1, vertex + kSide + 1, vertex + kSide;
        }
      }
    }
  }
  const std::vector<std::uint8_t> facing(static_cast<std::size_t>(control.vertex_count), 1);
  mesh::HierarchyOptions options;
  options.max_levels = 1;
  subject->hierarchy = mesh::build_hierarchy(control, 100 * control.texture_coordinates, facing, options);
  subject->id = 77;
  return subject;
}

TEST_F(TakeBasisTest, EyeballsTurnAsAWhole) {
  const auto subject = subject_with_eye();
  constexpr int kSide = 5;
  test::record_frames(file("eye.take"), 21, [&](int index) {
    auto frame = std::make_shared<mesh::MeshFrame>();
    frame->sequence = static_cast<std::uint64_t>(index);
    frame->media_time_ns = std::int64_t{index} * 33'333'333;
    frame->state = mesh::TrackingState::Tracking;
    frame->camera = {1000, 1000, 320, 240, 640, 480};
    frame->camera_from_head.translation().z() = 500;
    frame->subject = subject;
    frame->control_vertices_mm.resize(3, 2 * kSide * kSide);
    const float turn = 0.06F * static_cast<float>(index - 10);
    const Eigen::AngleAxisf rotation(turn, Eigen::Vector3f::UnitY());
    for (int v = 0; v < 2 * kSide * kSide; ++v) {
      const int within = v % (kSide * kSide);
      Eigen::Vector3f at(6.0F * static_cast<float>(within % kSide - 2),
                         6.0F * static_cast<float>(within / kSide - 2), 0);
      if (v < kSide * kSide) {
        at.z() = 40 + 2 * turn * at.x();
      } else {
        at.z() = std::sqrt(std::max(0.0F, 400 - at.squaredNorm()));
        at = rotation * at;
      }
      frame->control_vertices_mm.col(v) = at;
    }
    return frame;
  });
  const auto basis = TakeBasis::open(file("eye.take"));
  ASSERT_EQ(basis->eye_count(), 1);
  EXPECT_LT(basis->header().coarse_max_mm, 0.02F);
  // Half-way between looks of 69 degrees to the left and right a linear blend would have lost an eighth of
  // its width.
  Pose pose;
  pose.maps = std::make_shared<const InfluenceMaps>(*basis, std::span<const std::int32_t>());
  pose.state = 0.5F * (captured_state(*basis, 0) + captured_state(*basis, 20));
  mesh::MeshFrame frame = blank_frame(*basis);
  blend(*basis, pose, frame);
  const auto eye = frame.control_vertices_mm.rightCols(kSide * kSide);
  EXPECT_NEAR((eye.col(2 * kSide) - eye.col(3 * kSide - 1)).norm(), 24, 0.05);
  EXPECT_NEAR((eye.col(0) - eye.col(kSide * kSide - 1)).norm(), 24 * std::sqrt(2.0), 0.05);
}

}  // namespace
}  // namespace facet::animate
