// `facet patterns`: what the projectors of a booth show.

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/code_sequence.hpp"
#include "capture/patterns.hpp"
#include "capture/rig_file.hpp"
#include "capture/slot_program.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "options.hpp"
#include "picture_size.hpp"
#include "progress.hpp"
#include "render/renderer.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct PatternsOptions {
  capture::PatternConfig patterns;
  std::string size;
  std::string rig;
  std::string sequence;
  std::string program = "fringes";
  std::uint64_t periods = 60;
  std::string folder;
};

/// Who shows the patterns: a folder inside the one given ("" for the folder itself), a size.
struct Screen {
  std::string name;  ///< of the projector in the rig; empty without one
  std::filesystem::path folder;
  int width_px = 0;
  int height_px = 0;
};

std::vector<Screen> screens_of(const PatternsOptions& options) {
  if (options.rig.empty()) {
    const PictureSize size = parse_picture_size("--size", options.size);
    return {{"", options.folder, size.width_px, size.height_px}};
  }
  std::vector<Screen> screens;
  for (const capture::RigProjector& projector : capture::read_rig(options.rig).projectors) {
    if (projector.name.find('/') != std::string::npos || projector.name.starts_with('.')) {
      throw Error(ErrorKind::Usage, fmt::format("{}: the projector's name '{}' can't be a folder's",
                                                options.rig, projector.name));
    }
    screens.push_back({projector.name, std::filesystem::path(options.folder) / projector.name,
                       projector.lens.width_px, projector.lens.height_px});
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

/// A slot's picture; white in one that the projector alone lights, or with lamps.
capture::GreyImage draw_slot(const capture::PatternConfig& config, const capture::SlotProgram& program,
                             std::uint64_t slot, const Screen& screen, std::size_t projector) {
  capture::GreyImage image = capture::draw_pattern(config, capture::shown_in_slot(program, slot), projector);
  const std::vector<std::string>& lights = capture::light_of_slot(program, slot).lights;
  if (!screen.name.empty() && std::find(lights.begin(), lights.end(), screen.name) != lights.end()) {
    std::fill(image.values.begin(), image.values.end(), std::uint8_t{255});
  }
  return image;
}

void run_write(const PatternsOptions& options) {
  const std::vector<Screen> screens = screens_of(options);
  std::optional<capture::CodeSequence> sequence;
  if (!options.sequence.empty()) {
    sequence = capture::parse_sequence(options.sequence);
  }
  const capture::SlotProgram program = capture::parse_slot_program(options.program);
  const bool repeats = std::none_of(program.begin(), program.end(), [](const capture::SlotLight& light) {
    return light.kind == capture::SlotLight::Kind::Stripes;
  });
  const std::uint64_t slots =
      sequence ? sequence->pictures.size() : (repeats ? 1 : options.periods) * program.size();
  Progress progress("Drawing", slots * screens.size(), "pictures");
  for (std::size_t k = 0; k < screens.size(); ++k) {
    const Screen& screen = screens[k];
    files::make_folder(screen.folder);
    capture::PatternConfig config = options.patterns;
    config.width_px = screen.width_px;
    config.height_px = screen.height_px;
    for (std::uint64_t slot = 0; slot < slots; ++slot) {
      const capture::GreyImage image = sequence ? capture::draw_coded(config, *sequence, slot)
                                                : draw_slot(config, program, slot, screen, k);
      const std::string name = sequence ? fmt::format("{:03}-{}.png", slot, capture::name_of(*sequence, slot))
                                        : fmt::format("slot_{:06}.png", slot);
      render::write_png(to_picture(image), screen.folder / name);
      progress.advance();
    }
  }
  progress.finish();
  std::vector<std::string> words;
  std::transform(program.begin(), program.end(), std::back_inserter(words), capture::to_word);
  const std::string projectors =
      fmt::format("{} projector{}", screens.size(), screens.size() == 1 ? "" : "s");
  if (sequence) {
    tell(
        "{}: {} pictures for {}, to be shown by one projector at a time. Folders of the cameras' pictures, "
        "named "
        "in the same order, go to `facet scan --sequence {}`\n",
        options.folder, slots, projectors, options.sequence);
  } else {
    tell("{}: {} slots for {}, again and again. In facetd's configuration: trigger.light = [\"{}\"]\n",
         options.folder, slots, projectors, fmt::format("{}", fmt::join(words, "\", \"")));
  }
}

struct ShowOptions {
  std::string folder;
  double rate_hz = 0;
  int screen = -1;
  bool console = false;
  std::string connector;
  std::vector<std::string> player;
};

/// Becomes the player: its keys, its signals and its exit status are the command's.
void run_show(const ShowOptions& options) {
  std::vector<std::string> pictures;
  try {
    for (const auto& entry : std::filesystem::directory_iterator(options.folder)) {
      if (entry.path().extension() == ".png") {
        pictures.push_back(std::filesystem::absolute(entry.path()).string());
      }
    }
  } catch (const std::filesystem::filesystem_error& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", options.folder, error.code().message()));
  }
  if (pictures.empty()) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("{}: no PNG pictures there; `facet patterns write` makes them, a folder of its own for "
                    "each projector of a rig",
                    options.folder));
  }
  std::sort(pictures.begin(), pictures.end());
  std::vector<std::string> words = {"mpv",
                                    "--no-config",
                                    "--fullscreen",
                                    "--no-audio",
                                    "--no-osc",
                                    "--msg-level=all=warn",
                                    "--osd-level=0",
                                    "--cursor-autohide=always",
                                    "--background=#000000",
                                    "--video-unscaled=yes",
                                    "--stop-screensaver=yes",
                                    "--loop-playlist=inf"};
  words.push_back(options.rate_hz > 0 ? fmt::format("--image-display-duration={:.9f}", 1 / options.rate_hz)
                                      : "--image-display-duration=inf");
  words.emplace_back("--prefetch-playlist=yes");
  if (options.screen >= 0) {
    words.push_back(fmt::format("--fs-screen={}", options.screen));
  }
  if (options.console) {
    words.emplace_back("--vo=drm");
    if (!options.connector.empty()) {
      words.push_back("--drm-connector=" + options.connector);
    }
  }
  words.insert(words.end(), options.player.begin(), options.player.end());
  words.emplace_back("--");
  words.insert(words.end(), pictures.begin(), pictures.end());
  std::vector<char*> arguments;
  arguments.reserve(words.size() + 1);
  for (std::string& word : words) {
    arguments.push_back(word.data());
  }
  arguments.push_back(nullptr);
  ::execvp(arguments[0], arguments.data());
  throw Error(ErrorKind::Usage,
              fmt::format("the player mpv can't be started ({}): apt install mpv", std::strerror(errno)));
}

void add_show_command(Command command) {
  auto options = std::make_shared<ShowOptions>();
  const Command show = command.subcommand(
      "show",
      "Show a folder's pictures on a projector's screen: full-screen, pixel by pixel, again and again");
  show.option("folder", options->folder, "Of one projector, as `facet patterns write` made it").required();
  show.option("--rate", options->rate_hz,
              "Pictures a second; without it each stays until the key > (or <, back) is pressed. A desktop's "
              "player keeps no exact time: projectors that the trigger steps play the pictures themselves")
      .range(0.01, 1000.0);
  show.option("--screen", options->screen, "Number of the screen, from 0").range(0, 31);
  show.flag("--console", options->console, "Without a desktop, on the kernel's own display (DRM/KMS)");
  show.option("--connector", options->connector, "Of the projector, such as HDMI-A-1: see /sys/class/drm")
      .needs("--console");
  show.option("--player", options->player, "More options of the player, mpv");
  show.footer("Key q ends it. Needs the program mpv.");
  show.callback([options] { run_show(*options); });
}

}  // namespace

void add_patterns_command(Command app) {
  auto options = std::make_shared<PatternsOptions>();
  const Command command = app.subcommand(
      "patterns", "Patterns for the projectors of a booth: fringes, random stripes, structured light");
  command.requires_subcommand();
  const Command write = command.subcommand(
      "write", "Write what the projectors show, slot by slot, as PNG pictures for their player");
  write.option("folder", options->folder, "Folder to write the numbered PNG pictures into").required();
  write.option("--rig", options->rig, "Rig file: sizes of its projectors, a folder of its name for each");
  write.option("--size", options->size, "WIDTHxHEIGHT of one projector in pixels").excludes("--rig");
  write.option(
      "--sequence", options->sequence,
      "Structured light for something still instead of stripes, such as phase:8x64,gray:6,gray-inverse:6: "
      "8 shifts of a sine of 64 periods over the picture, Gray bits that count them, and their inverses; "
      "`facet scan --help` has all groups");
  write
      .option(
          "--program", options->program,
          "What the slots show in turn: fringes (four shifts of them and blank slots, six pictures), stripes "
          "(two random ones and a blank slot), or a word for each slot, as in trigger.light")
      .shows_default()
      .excludes("--sequence");
  write
      .option("--periods", options->periods,
              "Of a program with stripes, each with others; a player that begins again repeats them")
      .shows_default()
      .range(1, 100'000)
      .excludes("--sequence");
  write.option("--seed", options->patterns.seed, "All patterns follow from it").shows_default();
  write
      .option("--stripe", options->patterns.stripe_px,
              "Mean width of a stripe in the projector's pixels; 3 pixels of the cameras at least")
      .shows_default();
  write
      .option("--fringe", options->patterns.fringe_px,
              "Period of the fringes in the projector's pixels; 6 pixels of the cameras at least")
      .shows_default();
  write.option("--gamma", options->patterns.gamma, "Of the projector: light = (value / 255)^gamma")
      .shows_default();
  write.callback([options] {
    if (options->rig.empty() && options->size.empty()) {
      throw Error(ErrorKind::Usage, "give --rig FILE or --size WIDTHxHEIGHT");
    }
    run_write(*options);
  });
  add_show_command(command);
}

}  // namespace facet::tools
