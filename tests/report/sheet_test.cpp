// Sheets of a recorded take: with and without the source's images.

#include "report/sheet.hpp"

#include <gtest/gtest.h>

#include <filesystem>

#include "render/video_writer.hpp"
#include "report/film.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/recorder.hpp"

namespace facet::report {
namespace {

/// Two frames with a mesh and one without.
std::filesystem::path record_take(const std::filesystem::path& folder) {
  const auto subject = test::patch_subject();
  const auto albedo = test::patch_albedo(*subject);
  take::TakeRecorder recorder({.file = folder / "test.take",
                               .source = (folder / "video.mkv").string(),
                               .software = "test",
                               .when_full = take::WhenFull::Wait,
                               .disk_reserve_bytes = 0});
  recorder.start();
  recorder.record(std::make_shared<mesh::MeshFrame>(test::searching_frame(0)));
  recorder.record(std::make_shared<mesh::MeshFrame>(test::patch_frame(1, subject, nullptr)));
  recorder.record(std::make_shared<mesh::MeshFrame>(test::patch_frame(2, subject, albedo)));
  recorder.request_stop();
  recorder.stop();
  return folder / "test.take";
}

void write_video(const std::filesystem::path& folder) {
  render::VideoWriter video(folder / "video.mkv", 1280, 720, 30);
  for (int k = 0; k < 3; ++k) {
    video.append(render::plain_picture(1280, 720, {static_cast<std::uint8_t>(60 * k), 120, 90}));
  }
  video.finish();
}

TEST(SourceImages, GivesFramesInAnyOrder) {
  const test::TemporaryFolder folder;
  write_video(folder.path());
  SourceImages images(folder.path() / "video.mkv");
  for (const std::uint64_t sequence : {0U, 2U, 1U, 1U, 0U}) {
    const auto image = images.at(sequence);
    ASSERT_TRUE(image.has_value()) << sequence;
    EXPECT_EQ(image->row(10)[40], 60 * sequence);
  }
  EXPECT_FALSE(images.at(3).has_value());
  EXPECT_TRUE(images.at(1).has_value());
}

// A loop of a video counts on. Minutes of video are not read for a frame that it can not have.
TEST(SourceImages, AFrameThatTheVideoCantHaveIsNotLookedFor) {
  const test::TemporaryFolder folder;
  write_video(folder.path());
  SourceImages images(folder.path() / "video.mkv");
  std::filesystem::remove(folder.path() / "video.mkv");
  EXPECT_FALSE(images.at(9052).has_value());
  EXPECT_TRUE(images.at(0).has_value()) << "nothing was read for the other";
}

TEST(SourceImages, AreATakesOwnPicturesWhereItHoldsThem) {
  const test::TemporaryFolder folder;
  take::TakeRecorder recorder({.file = folder.path() / "own.take",
                               .source = "/dev/video0",
                               .software = "test",
                               .when_full = take::WhenFull::Wait,
                               .disk_reserve_bytes = 0,
                               .with_images = true,
                               .picture_coding = take::PictureCoding::Jpeg});
  recorder.start();
  const auto names = std::make_shared<const std::vector<std::string>>(1, "webcam");
  for (const std::uint64_t sequence : {3U, 5U, 9U}) {
    auto set = std::make_shared<FrameSet>();
    set->slot = sequence;
    set->camera_names = names;
    Frame& picture = set->frames.emplace_back();
    picture.sequence = sequence;
    picture.width_px = 64;
    picture.height_px = 48;
    picture.stride_bytes = 256;
    picture.pixels =
        std::make_shared<std::uint8_t[]>(std::size_t{256} * 48, static_cast<std::uint8_t>(20 * sequence));
    auto frame = std::make_shared<mesh::MeshFrame>(test::searching_frame(sequence));
    frame->images = set;
    recorder.record(frame);
  }
  recorder.stop();
  const auto images = open_source_images(take::TakeReader(folder.path() / "own.take").info(), "");
  ASSERT_NE(images, nullptr);
  for (const std::uint64_t sequence : {9U, 3U, 5U}) {
    const auto image = images->at(sequence);
    ASSERT_TRUE(image.has_value()) << sequence;
    EXPECT_NEAR(image->row(10)[40], 20 * static_cast<int>(sequence), 2);
  }
  EXPECT_FALSE(images->at(4).has_value());
  EXPECT_FALSE(images->at(10).has_value());
}

TEST(Sheet, ShowsWhatIsThereAndSaysWhatIsNot) {
  const test::TemporaryFolder folder;
  const auto file = record_take(folder.path());
  take::TakeReader take(file);
  EXPECT_EQ(open_source_images(take.info(), ""), nullptr);  // the video is not there yet
  int rows = 0;
  const render::Picture without = make_sheet(take, {0, 1, 2}, nullptr, [&](int done) { rows = done; });
  EXPECT_EQ(rows, 3);
  write_video(folder.path());
  const auto images = open_source_images(take.info(), "");
  ASSERT_NE(images, nullptr);
  const render::Picture with = make_sheet(take, {0, 1, 2}, images.get(), [](int) {});
  EXPECT_EQ(with.width_px, without.width_px);
  EXPECT_EQ(with.height_px, without.height_px);
  // The image's colour fills the upper left corner of the last row's first cell only where there is an image.
  const auto pixel = [](const render::Picture& picture, int x, int y) {
    const auto* at = &picture.rgb[3 * static_cast<std::size_t>(y * picture.width_px + x)];
    return std::array<std::uint8_t, 3>{at[0], at[1], at[2]};
  };
  const int last_row_y = with.height_px - 400;
  EXPECT_EQ(pixel(with, 20, last_row_y), (std::array<std::uint8_t, 3>{120, 120, 90}));
  EXPECT_NE(pixel(without, 20, last_row_y), (std::array<std::uint8_t, 3>{120, 120, 90}));
}

TEST(CellAround, MapsTheCutOutOntoTheCell) {
  mesh::Vertices box(3, 2);
  box << -50, 50,  //
      -60, 60,     //
      600, 600;
  const CameraIntrinsics camera{1000, 1000, 639.5F, 359.5F, 1280, 720};
  const Cell cell = cell_around(box, camera, 400, 480);
  // The same direction falls on the same place of the cut-out.
  const Eigen::Vector2f in_picture(camera.fx * 0.05F + camera.cx, camera.fy * -0.04F + camera.cy);
  const Eigen::Vector2f in_cell(cell.camera.fx * 0.05F + cell.camera.cx,
                                cell.camera.fy * -0.04F + cell.camera.cy);
  const float scale = 400 / cell.width_px;
  EXPECT_NEAR(in_cell.x(), (in_picture.x() + 0.5F - cell.x_px) * scale - 0.5F, 1e-2F);
  EXPECT_NEAR(in_cell.y(), (in_picture.y() + 0.5F - cell.y_px) * scale - 0.5F, 1e-2F);
  EXPECT_NEAR(cell.width_px / cell.height_px, 400.0F / 480, 1e-4F);
  EXPECT_GT(cell.width_px, 1000 * 100 / 600.0F);
}

/// A focal length that becomes better known on the way moves nothing in the film's pictures.
TEST(Film, EveryFrameIsDrawnByItsOwnCamera) {
  const test::TemporaryFolder folder;
  const auto subject = test::patch_subject();
  const auto albedo = test::patch_albedo(*subject);
  {
    take::TakeRecorder recorder({.file = folder.path() / "focal.take",
                                 .source = "/dev/video0",
                                 .software = "test",
                                 .when_full = take::WhenFull::Wait,
                                 .disk_reserve_bytes = 0});
    recorder.start();
    for (const std::uint64_t sequence : {0U, 1U}) {
      mesh::MeshFrame frame = test::patch_frame(sequence, subject, albedo);
      if (sequence == 1) {  // the same picture: twice the focal length, twice as far
        frame.camera.fx *= 2;
        frame.camera.fy *= 2;
        frame.camera_from_head.translation().z() *= 2;
      }
      recorder.record(std::make_shared<mesh::MeshFrame>(frame));
    }
    recorder.stop();
  }
  take::TakeReader take(folder.path() / "focal.take");
  FilmPainter painter(take, {0, 1}, nullptr, parse_film_panels("grey"), 200);
  const auto lit_box = [&](std::int64_t index) {
    const render::Picture film = painter.paint(*take.frame(index), "");
    Eigen::AlignedBox2i box;
    for (int y = 0; y < 200; ++y) {
      for (int x = 0; x < film.width_px; ++x) {
        if (film.rgb[3 * static_cast<std::size_t>(y * film.width_px + x)] > 60) {
          box.extend(Eigen::Vector2i(x, y));
        }
      }
    }
    return box;
  };
  const Eigen::AlignedBox2i first = lit_box(0);
  const Eigen::AlignedBox2i second = lit_box(1);
  ASSERT_FALSE(first.isEmpty());
  EXPECT_NEAR(first.sizes().x(), second.sizes().x(), 0.1 * first.sizes().x() + 2);
  EXPECT_NEAR(first.center().x(), second.center().x(), 0.1 * first.sizes().x() + 2);
}

}  // namespace
}  // namespace facet::report
