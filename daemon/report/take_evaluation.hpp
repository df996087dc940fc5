#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "render/renderer.hpp"
#include "report/evaluation.hpp"
#include "take/reader.hpp"

namespace facet::report {

/// How one frame's meshes compare with the truth.
struct FrameEvaluation {
  std::int64_t index = 0;  ///< in the take
  FrameMeans coarse;
  FrameMeans refined;
};

struct TakeEvaluation {
  std::vector<FrameEvaluation> frames;  ///< those with a mesh and a truth
  int without_mesh = 0;                 ///< frames with a truth alone
  std::uint64_t points = 0;
  double mean_scale = 1;  ///< of the refined meshes' alignment
  AccuracyFigures coarse;
  AccuracyFigures refined;
  WrinkleSum wrinkles;
  render::Picture heat_map;  ///< of four frames
};

struct EvaluationOptions {
  Alignment alignment = Alignment::Similarity;
  float mm_per_unit = 1;  ///< of the truth's lengths
  /// Indices in the take, ascending; empty: all, and then every frame of the truth must be one of the take's.
  std::vector<std::int64_t> frames;
};

/// A take against the truth in a folder (docs/evaluation.md), which may be of every frame or of some.
///
/// folder     as TruthFolder; the photometric error needs its video.mkv
/// progress   is told how many of how many frames are done
/// Throws Error(UnreadableInput) where no frame has both a mesh and a truth, where the truth is of frames
/// that the take has not, and for what TruthFolder and its meshes refuse.
TakeEvaluation evaluate_take(take::TakeReader& take, const std::filesystem::path& folder,
                             const EvaluationOptions& options,
                             const std::function<void(std::uint64_t done, std::uint64_t total)>& progress);

}  // namespace facet::report
