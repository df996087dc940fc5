// The part of the Unreal sample that needs no Unreal, before the server that it will meet.

#include <gtest/gtest.h>

#include "FacetReader.h"
#include "mesh/hierarchy.hpp"
#include "stream/server.hpp"
#include "support/eventually.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"

namespace facet {
namespace {

using facet_unreal::Face;
using facet_unreal::FacetReader;

class UnrealReader : public ::testing::Test {
 protected:
  void SetUp() override { config_.socket = folder_.path() / "stream.sock"; }
  void start() {
    server_ = std::make_unique<stream::StreamServer>(config_);
    server_->start();
  }
  bool next(FacetReader& reader) const {
    return test::eventually([&] { return reader.poll(); });
  }

  test::TemporaryFolder folder_;
  stream::StreamServerConfig config_;
  std::unique_ptr<stream::StreamServer> server_;
  std::shared_ptr<const mesh::Subject> subject_ = test::patch_subject();
};

/// From the head's axes to Unreal's on the head: x out of the face, y to the subject's right, z up.
Eigen::Matrix3f head_axes() {
  return (Eigen::Matrix3f() << 0, 0, 1, -1, 0, 0, 0, 1, 0).finished();
}

TEST_F(UnrealReader, GivesTheMeshInUnrealsAxes) {
  start();
  const auto albedo = test::patch_albedo(*subject_);
  const mesh::MeshFrame frame = test::patch_frame(7, subject_, albedo);
  mesh::Vertices vertices_mm;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(*subject_->hierarchy, frame.control_vertices_mm, frame.displacements_mm, vertices_mm,
                       normals);
  FacetReader reader(config_.socket.string());
  server_->publish(std::make_shared<mesh::MeshFrame>(frame));
  ASSERT_TRUE(next(reader)) << reader.message();
  const Face& face = reader.face();
  EXPECT_EQ(face.sequence, 7U);
  EXPECT_EQ(face.expression_names, subject_->expression_names);
  EXPECT_EQ(face.avatar_values, frame.expression) << "no neutral pose";
  const auto count = static_cast<Eigen::Index>(vertices_mm.cols());
  ASSERT_EQ(face.vertices_cm.size(), 3 * static_cast<std::size_t>(count));
  const Eigen::Map<const Eigen::Matrix3Xf> shown(face.vertices_cm.data(), 3, count);
  EXPECT_LT((shown - 0.1F * head_axes() * vertices_mm).cwiseAbs().maxCoeff(), 0.001F);  // 0.01 mm
  const Eigen::Map<const Eigen::Matrix3Xf> shown_normals(face.normals.data(), 3, count);
  EXPECT_LT((shown_normals - head_axes() * normals).cwiseAbs().maxCoeff(), 0.02F);
  ASSERT_EQ(face.linear_rgb.size(), albedo->linear_rgb.size());
  EXPECT_NEAR(face.linear_rgb[100], albedo->linear_rgb[100], 1e-4);
  ASSERT_EQ(face.triangles.size(), static_cast<std::size_t>(subject_->hierarchy->finest().triangles.size()));
  EXPECT_EQ(face.triangles[5], static_cast<std::int32_t>(subject_->hierarchy->finest().triangles.data()[5]));
  EXPECT_FLOAT_EQ(face.texture_coordinates[3], 1 - subject_->hierarchy->texture_coordinates(1, 1));

  // A point of the head lands where the camera sees it: right, up and forward there are y, z and x here.
  Eigen::Matrix3f turn;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      turn(row, column) = face.turn[static_cast<std::size_t>(row)][static_cast<std::size_t>(column)];
    }
  }
  const Eigen::Vector3f nose_mm(3, -20, 60);
  const Eigen::Vector3f camera = frame.camera_from_head.linear() * nose_mm;
  EXPECT_LT((turn * head_axes() * nose_mm - Eigen::Vector3f(camera.z(), camera.x(), -camera.y())).norm(),
            1e-3F);
  EXPECT_NEAR(turn.determinant(), 1, 1e-5);
}

TEST_F(UnrealReader, WaitsForADaemonThatIsAwayAndTakesAnotherPerson) {
  FacetReader reader(config_.socket.string());
  EXPECT_FALSE(reader.poll());
  start();
  server_->publish(std::make_shared<mesh::MeshFrame>(test::patch_frame(1, subject_, nullptr)));
  ASSERT_TRUE(next(reader)) << reader.message();
  EXPECT_TRUE(reader.face().linear_rgb.empty());
  EXPECT_FALSE(reader.poll()) << "each frame comes once";
  // Others, also under an id that was there: over this connection, then before another daemon.
  std::uint64_t sequence = 1;
  for (const auto& other : {test::patch_subject(0xBEEF, 7, 2), test::patch_subject(0xBEEF, 5, 2)}) {
    for (const bool restarted : {false, true}) {
      if (restarted) {
        server_.reset();
        start();
      }
      const std::uint64_t shown = reader.face().subject_id;
      server_->publish(std::make_shared<mesh::MeshFrame>(test::patch_frame(++sequence, other, nullptr)));
      ASSERT_TRUE(next(reader)) << reader.message();
      EXPECT_EQ(reader.face().sequence, sequence);
      EXPECT_NE(reader.face().subject_id, shown) << "by which the component knows to build another section";
      EXPECT_EQ(reader.face().vertices_cm.size(),
                3 * static_cast<std::size_t>(other->hierarchy->finest().vertex_count));
      EXPECT_EQ(reader.face().triangles.size(),
                static_cast<std::size_t>(other->hierarchy->finest().triangles.size()));
    }
  }
}

TEST(UnrealReaderAlone, RefusesAPathThatNoSocketCanHave) {
  FacetReader reader(std::string(500, 'x'));
  EXPECT_FALSE(reader.poll());
  EXPECT_STRNE(reader.message(), "");
}

}  // namespace
}  // namespace facet
