// What a recogniser is shown of a take: square pictures of the face in some of its frames (bench/likeness).

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "footage/face_views.hpp"
#include "report/take_pictures.hpp"
#include "take/reader.hpp"

namespace {

struct Options {
  std::string take;
  std::string video;
  std::filesystem::path folder;
  std::string name;
  std::vector<std::uint64_t> frames{20, 40};
  int side_px = 150;
};

void write_views(const Options& options) {
  facet::take::TakeReader take(options.take);
  const auto images = facet::report::open_source_images(take.info(), options.video);
  if (!images) {
    throw facet::Error(facet::ErrorKind::UnreadableInput,
                       fmt::format("{}: its source '{}' is not a video file here; give it with --video",
                                   options.take, take.info().source));
  }
  std::filesystem::create_directories(options.folder);
  for (std::int64_t index = 0; index < take.frame_count(); ++index) {
    const std::uint64_t sequence = take.entry(index).sequence;
    if (std::find(options.frames.begin(), options.frames.end(), sequence) == options.frames.end()) {
      continue;
    }
    const auto frame = take.frame(index, facet::take::Pictures::Described);
    const auto image = images->at(sequence);
    if (!facet::mesh::has_mesh(*frame) || !image) {
      fmt::print(stderr, "face_pictures: {}: frame {} has no {}\n", options.take, sequence,
                 image ? "mesh" : "image");
      continue;
    }
    for (const auto& view : facet::footage::face_views(*frame, *image, options.side_px)) {
      const auto file = options.folder / fmt::format("{}-{:06}-{}.png", options.name, sequence, view.kind);
      facet::render::write_png(view.picture, file);
      fmt::print("{}\n", file.string());
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Writes square pictures of the face in a take's frames, FOLDER/NAME-FRAME-KIND.png, and prints their "
      "names. Kinds: photo, cut (the photo where the mesh covers it), grey (the refined mesh), albedo, lit "
      "(the albedo in the frame's light)");
  Options options;
  app.add_option("take", options.take, "take of one person")->required();
  app.add_option("-o,--output", options.folder, "folder for the pictures")->required();
  app.add_option("--name", options.name, "of the person; default: the take's");
  app.add_option("--video", options.video, "the video that the take was made from, where it has moved");
  app.add_option("--frames", options.frames, "frames by their number in the source")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->capture_default_str();
  app.add_option("--side", options.side_px, "of the square, px")
      ->check(CLI::Range(8, 4096))
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  if (options.name.empty()) {
    options.name = std::filesystem::path(options.take).stem().string();
  }
  try {
    write_views(options);
  } catch (const std::exception& error) {
    fmt::print(stderr, "face_pictures: {}\n", error.what());
    return 1;
  }
  return 0;
}
