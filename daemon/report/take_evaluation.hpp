#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "face/face_parts.hpp"
#include "render/renderer.hpp"
#include "report/bands.hpp"
#include "report/evaluation.hpp"
#include "report/skin_points.hpp"
#include "report/tracking_figures.hpp"
#include "take/reader.hpp"

namespace facet::report {

constexpr std::size_t kFaceParts = face::kFacePartNames.size();

/// How one frame's meshes compare with the truth.
struct FrameEvaluation {
  std::int64_t index = 0;  ///< in the take
  FrameMeans coarse;
  FrameMeans refined;
};

/// Figures of one kind of mesh under one alignment. Figures of parts by face::FacePart; without points NaN.
struct MeshFigures {
  AccuracyFigures whole;
  std::array<AccuracyFigures, kFaceParts> parts;
  SkinPointFigures skin;
  std::array<double, kFaceParts> part_skin_mm{};  ///< SkinPointFigures::mean_mm
};

struct PosedFigures {
  double scale = 1;  ///< of the refined meshes' alignment, on average
  MeshFigures coarse;
  MeshFigures refined;
};

/// The take's face at rest, expressions 0, against the truth's.
struct NeutralFigures {
  double scale = 1;
  MeshFigures face;  ///< skin, flicker and photometric error are not measured
};

/// True and recovered displacements over all points of all frames; by kBandNames.
using BandSums = std::array<FieldSum, 3>;
inline constexpr std::array<const char*, 3> kBandNames{"whole", "4_to_15_mm", "wrinkles"};

struct TakeEvaluation {
  std::vector<FrameEvaluation> frames;  ///< those with a mesh and a truth
  int without_mesh = 0;                 ///< frames with a truth alone
  std::uint64_t points = 0;
  PosedFigures by_frame;     ///< every frame and mesh aligned by itself
  PosedFigures by_sequence;  ///< all of them by one similarity
  std::optional<NeutralFigures> neutral;
  BandSums bands;
  std::array<BandSums, kFaceParts> part_bands;
  bool has_parts = false;              ///< false: figures of parts are empty
  std::vector<WeightFigures> weights;  ///< empty without true weights
  PoseFigures pose;
  std::map<std::string, std::string> left_out;  ///< what is not measured, and why
  render::Picture heat_map;                     ///< of four frames
};

struct EvaluationOptions {
  Alignment alignment = Alignment::Similarity;
  float mm_per_unit = 1;  ///< of the truth's lengths
  /// Indices in the take, ascending; empty: all, and then every frame of the truth must be one of the take's.
  std::vector<std::int64_t> frames = {};
  /// The face model that the take was made with, for the parts of the face and the face at rest; empty: the
  /// default one, and where that is not it, these are left out.
  std::filesystem::path model = {};
};

/// A take against the truth in a folder (docs/evaluation.md), which may be of every frame or of some. Two
/// frames are measured at a time.
///
/// folder     as TruthFolder; the photometric error needs its video.mkv
/// progress   is told how many of how many frames are done
/// Throws Error(UnreadableInput) where no frame has both a mesh and a truth, where the truth is of frames
/// that the take has not, and for what TruthFolder and its meshes refuse; Error(Usage) where the model given
/// is not the take's.
TakeEvaluation evaluate_take(take::TakeReader& take, const std::filesystem::path& folder,
                             const EvaluationOptions& options,
                             const std::function<void(std::uint64_t done, std::uint64_t total)>& progress);

}  // namespace facet::report
