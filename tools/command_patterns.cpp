// `facet patterns`: what the projectors of a booth show.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

#include "capture/code_sequence.hpp"
#include "capture/patterns.hpp"
#include "capture/rig_file.hpp"
#include "commands.hpp"
#include "facet/error.hpp"
#include "picture_size.hpp"
#include "progress.hpp"
#include "render/renderer.hpp"

namespace facet::tools {
namespace {

struct PatternsOptions {
  capture::PatternConfig patterns;
  std::string size;
  std::string rig;
  std::string sequence;
  std::uint64_t periods = 60;
  std::string folder;
};

/// Who shows the patterns: a folder inside the one given ("" for the folder itself), a size.
struct Screen {
  std::filesystem::path folder;
  int width_px = 0;
  int height_px = 0;
};

std::vector<Screen> screens_of(const PatternsOptions& options) {
  if (options.rig.empty()) {
    const PictureSize size = parse_picture_size("--size", options.size);
    return {{options.folder, size.width_px, size.height_px}};
  }
  std::vector<Screen> screens;
  for (const capture::RigProjector& projector : capture::read_rig(options.rig).projectors) {
    if (projector.name.find('/') != std::string::npos || projector.name.starts_with('.')) {
      throw Error(ErrorKind::Usage, fmt::format("{}: the projector's name '{}' can't be a folder's",
                                                options.rig, projector.name));
    }
    screens.push_back({std::filesystem::path(options.folder) / projector.name, projector.lens.width_px,
                       projector.lens.height_px});
  }
  if (screens.empty()) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("{}: the rig has no projector; give its [[projector]] sections or --size", options.rig));
  }
  return screens;
}

render::Picture to_picture(const capture::GreyImage& image) {
  render::Picture picture = render::plain_picture(image.width_px, image.height_px, {0, 0, 0});
  for (std::size_t k = 0; k < picture.rgb.size(); ++k) {
    picture.rgb[k] = image.values[k / 3];
  }
  return picture;
}

void make_folder(const std::filesystem::path& folder) {
  std::error_code failure;
  std::filesystem::create_directories(folder, failure);
  if (failure) {
    throw Error(ErrorKind::Storage,
                fmt::format("{}: cannot make the folder ({})", folder.string(), failure.message()));
  }
}

void run_write(const PatternsOptions& options) {
  const std::vector<Screen> screens = screens_of(options);
  std::optional<capture::CodeSequence> sequence;
  if (!options.sequence.empty()) {
    sequence = capture::parse_sequence(options.sequence);
  }
  const std::uint64_t slots =
      sequence ? sequence->pictures.size() : options.periods * capture::kSlotsPerPeriod;
  Progress progress("Drawing", slots * screens.size(), "pictures");
  for (std::size_t k = 0; k < screens.size(); ++k) {
    const Screen& screen = screens[k];
    make_folder(screen.folder);
    capture::PatternConfig config = options.patterns;
    config.width_px = screen.width_px;
    config.height_px = screen.height_px;
    for (std::uint64_t slot = 0; slot < slots; ++slot) {
      const capture::GreyImage image = sequence
                                           ? capture::draw_coded(config, *sequence, slot)
                                           : capture::draw_pattern(config, capture::shown_in_slot(slot), k);
      const std::string name = sequence ? fmt::format("{:03}-{}.png", slot, capture::name_of(*sequence, slot))
                                        : fmt::format("slot_{:06}.png", slot);
      render::write_png(to_picture(image), screen.folder / name);
      progress.advance();
    }
  }
  progress.finish();
  const std::string projectors =
      fmt::format("{} projector{}", screens.size(), screens.size() == 1 ? "" : "s");
  if (sequence) {
    fmt::print(
        "{}: {} pictures for {}, to be shown by one projector at a time. Folders of the cameras' pictures, "
        "named "
        "in the same order, go to `facet scan --sequence {}`\n",
        options.folder, slots, projectors, options.sequence);
  } else {
    fmt::print("{}: {} slots (stripes A, stripes B, blank, and again) for {}\n", options.folder, slots,
               projectors);
  }
}

}  // namespace

void add_patterns_command(CLI::App& app) {
  auto options = std::make_shared<PatternsOptions>();
  CLI::App* command = app.add_subcommand(
      "patterns", "Patterns for the projectors of a booth: random stripes, structured light");
  command->require_subcommand(1);
  CLI::App* write = command->add_subcommand(
      "write", "Write what the projectors show, slot by slot, as PNG pictures for their player");
  write->add_option("folder", options->folder, "Folder to write the numbered PNG pictures into")->required();
  auto* rig = write->add_option("--rig", options->rig,
                                "Rig file: sizes of its projectors, a folder of its name for each");
  auto* size = write->add_option("--size", options->size, "WIDTHxHEIGHT of one projector in pixels");
  rig->excludes(size);
  auto* sequence = write->add_option(
      "--sequence", options->sequence,
      "Structured light for something still instead of stripes, such as phase:8x64,gray:6,gray-inverse:6: "
      "8 shifts of a sine of 64 periods over the picture, Gray bits that count them, and their inverses; "
      "`facet scan --help` has all groups");
  write
      ->add_option("--periods", options->periods,
                   "Periods of three slots; a player that begins again repeats the stripes")
      ->capture_default_str()
      ->check(CLI::Range(1, 100'000))
      ->excludes(sequence);
  write->add_option("--seed", options->patterns.seed, "All stripes follow from it")->capture_default_str();
  write
      ->add_option("--stripe", options->patterns.stripe_px,
                   "Mean width of a stripe in the projector's pixels; 3 pixels of the cameras at least")
      ->capture_default_str();
  write->add_option("--gamma", options->patterns.gamma, "Of the projector: light = (value / 255)^gamma")
      ->capture_default_str();
  write->callback([options] {
    if (options->rig.empty() && options->size.empty()) {
      throw Error(ErrorKind::Usage, "give --rig FILE or --size WIDTHxHEIGHT");
    }
    run_write(*options);
  });
}

}  // namespace facet::tools
