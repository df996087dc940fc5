// Takes of real people without a truth: do the same folds come back, do halves of a clip agree, does what was
// learned foretell the next frames. bench/real-footage makes the takes and the table;
// bench/results/likeness.md says what the figures mean.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "footage/figures.hpp"
#include "report/take_pictures.hpp"
#include "take/reader.hpp"

namespace {

using facet::Error;
using facet::ErrorKind;
using facet::take::Pictures;
using facet::take::TakeReader;

struct Options {
  std::filesystem::path model = facet::default_model_file();
  std::vector<std::string> takes;
  std::string video;
  double min_gap_s = 2;
  std::size_t pairs = 10;
  std::vector<std::int64_t> gaps{1, 5, 25};
  std::int64_t every = 10;
};

std::vector<std::unique_ptr<TakeReader>> open_takes(const Options& options) {
  std::vector<std::unique_ptr<TakeReader>> takes;
  for (const std::string& file : options.takes) {
    takes.push_back(std::make_unique<TakeReader>(file));
  }
  return takes;
}

void repeat(const Options& options) {
  const auto takes = open_takes(options);
  std::vector<TakeReader*> readers;
  for (const auto& take : takes) {
    readers.push_back(take.get());
  }
  fmt::print("expressions,pairs,distance,correlation,share\n");
  for (const auto& [which, name] : {std::pair{facet::footage::Expressions::Alike, "alike"},
                                    std::pair{facet::footage::Expressions::Unlike, "unlike"}}) {
    int done = 0;
    const auto found = facet::footage::repeatability(
        readers, which, options.min_gap_s, options.pairs,
        [&, called = name] { fmt::print(stderr, "\r{}: {} pairs", called, ++done); });
    fmt::print(stderr, "\n");
    fmt::print("{},{},{:.3f},{:.3f},{:.3f}\n", name, found.pairs, found.distance, found.correlation,
               found.share);
  }
}

/// The frame in the middle of those that have a mesh.
std::shared_ptr<const facet::mesh::MeshFrame> middle_frame(TakeReader& take) {
  std::vector<std::int64_t> with_mesh;
  for (std::int64_t index = 0; index < take.frame_count(); ++index) {
    if (take.entry(index).has_mesh) {
      with_mesh.push_back(index);
    }
  }
  if (with_mesh.empty()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: no frame has a mesh", take.info().file.string()));
  }
  return take.frame(with_mesh[with_mesh.size() / 2], Pictures::Described);
}

void halves(const Options& options) {
  const auto model = facet::face::FaceModel::load(options.model);
  const auto takes = open_takes(options);
  const auto found =
      facet::footage::compare_halves(model, *middle_frame(*takes[0]), *middle_frame(*takes[1]));
  fmt::print("shape_mm,albedo_rms,albedo_spread,albedo_points\n{:.3f},{:.4f},{:.4f},{}\n", found.shape_mm,
             found.albedo_rms, found.albedo_spread, found.albedo_points);
}

/// Sums over frames of one gap.
struct Sum {
  int frames = 0;
  facet::footage::PredictionErrors squares;

  void add(const facet::footage::PredictionErrors& errors) {
    ++frames;
    squares.fitted += errors.fitted * errors.fitted;
    squares.predicted += errors.predicted * errors.predicted;
    squares.coarse += errors.coarse * errors.coarse;
    squares.before += errors.before * errors.before;
  }
  double rms(double sum) const { return std::sqrt(sum / frames); }
};

void predict(const Options& options) {
  const auto takes = open_takes(options);
  std::vector<Sum> sums(options.gaps.size());
  for (const auto& take : takes) {
    const auto images = facet::report::open_source_images(take->info(), options.video);
    if (!images) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("{}: its source '{}' is not a video file here; give it with --video",
                              take->info().file.string(), take->info().source));
    }
    struct Seen {
      std::shared_ptr<const facet::mesh::MeshFrame> frame;  // null without mesh or albedo
      std::optional<facet::Frame> image;
    };
    std::map<std::int64_t, Seen> seen;  // the last ones, as far back as the longest gap
    const std::int64_t longest = *std::max_element(options.gaps.begin(), options.gaps.end());
    for (std::int64_t index = 0; index < take->frame_count(); ++index) {
      auto frame = take->frame(index, Pictures::Described);
      const auto image = images->at(frame->sequence);
      if (!facet::mesh::has_mesh(*frame) || !frame->albedo) {
        frame = nullptr;
      }
      seen[index] = {frame, image};
      seen.erase(index - longest - 1);
      if (index % options.every != 0 || !frame || !image) {
        continue;
      }
      fmt::print(stderr, "\rframe {} of {}", index, take->frame_count());
      for (std::size_t g = 0; g < options.gaps.size(); ++g) {
        const auto earlier = seen.find(index - options.gaps[g]);
        if (earlier == seen.end() || !earlier->second.frame || !earlier->second.image ||
            earlier->second.frame->subject->id != frame->subject->id) {
          continue;
        }
        if (const auto errors = facet::footage::prediction_errors(*frame, *earlier->second.frame, *image,
                                                                  *earlier->second.image)) {
          sums[g].add(*errors);
        }
      }
    }
    fmt::print(stderr, "\n");
  }
  fmt::print("gap,frames,fitted,predicted,coarse,before\n");
  for (std::size_t g = 0; g < sums.size(); ++g) {
    const Sum& sum = sums[g];
    fmt::print("{},{},{:.4f},{:.4f},{:.4f},{:.4f}\n", options.gaps[g], sum.frames,
               sum.rms(sum.squares.fitted), sum.rms(sum.squares.predicted), sum.rms(sum.squares.coarse),
               sum.rms(sum.squares.before));
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Figures of takes of real people, of whom no truth is known; CSV");
  app.require_subcommand(1);
  Options options;
  const auto add = [&](const char* name, const char* what, int least, int most) {
    CLI::App* command = app.add_subcommand(name, what);
    command->add_option("takes", options.takes, "takes of one person")->required()->expected(least, most);
    return command;
  };
  CLI::App* repeat_command =
      add("repeat",
          "Displacements of frames far apart in time, alike and unlike in expression: how they correlate at "
          "the width of wrinkles, and which share of the skin folds",
          1, 100);
  repeat_command->add_option("--min-gap", options.min_gap_s, "seconds between a pair's frames, at least")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  repeat_command->add_option("--pairs", options.pairs, "of each take, at most")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  CLI::App* halves_command =
      add("halves",
          "Two takes of one person learned apart: mean distance of the neutral faces after a similarity, rms "
          "between the albedos after one gain, the second one's rms about its mean colour",
          2, 2);
  halves_command->add_option("--model", options.model, "face model")->capture_default_str();
  CLI::App* predict_command =
      add("predict",
          "Frames drawn with light, albedo and displacements of an earlier frame, and pose and expression of "
          "their own: rms inside the face against their image, beside the earlier picture's",
          1, 100);
  predict_command->add_option("--gaps", options.gaps, "frames from the earlier frame to the drawn one")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  predict_command->add_option("--every", options.every, "frames from one drawn frame to the next")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  predict_command->add_option("--video", options.video,
                              "the video that the takes were made from, where it has moved");
  CLI11_PARSE(app, argc, argv);
  try {
    if (repeat_command->parsed()) {
      repeat(options);
    } else if (halves_command->parsed()) {
      halves(options);
    } else {
      predict(options);
    }
  } catch (const std::exception& error) {
    fmt::print(stderr, "real_footage: {}\n", error.what());
    return 1;
  }
  return 0;
}
