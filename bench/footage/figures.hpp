#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "face/face_model.hpp"
#include "mesh/mesh_frame.hpp"
#include "report/take_pictures.hpp"
#include "take/reader.hpp"

namespace facet::footage {

/// What is known of a frame when pairs of frames are looked for.
struct Moment {
  std::int64_t index = 0;  ///< in the take
  double time_s = 0;
  std::uint64_t subject_id = 0;   ///< frames of two subjects are no pair
  std::vector<float> expression;  ///< [expression_count] 0 to 1
};

/// Two frames at least some time apart.
struct FramePair {
  std::int64_t first = 0;  ///< Moment::index
  std::int64_t second = 0;
  double distance = 0;  ///< between their expressions, Euclidean
};

/// Which pairs are wanted: those whose expressions are most alike, or least.
enum class Expressions { Alike, Unlike };

/// Up to `count` pairs of one subject's frames that are min_gap_s apart or more, the best ones first; every
/// frame is in one pair at most.
std::vector<FramePair> choose_pairs(std::span<const Moment> moments, Expressions which, double min_gap_s,
                                    std::size_t count);

/// Do the same folds come back? Displacements of both frames of each pair in the band of wrinkles, at the
/// points where one of them folds (report::WrinkleSum, each frame once in the truth's place).
struct Repeatability {
  int pairs = 0;
  double distance = 0;     ///< mean of FramePair::distance
  double correlation = 0;  ///< NaN without folds
  double share = 0;        ///< of the points that both frames show: those within folds
};

/// Takes of real people, one after the other: frames with displacements, pairs of each take alone. progress
/// is called after every pair. Throws Error(UnreadableInput) as the reader does.
Repeatability repeatability(std::span<take::TakeReader* const> takes, Expressions which, double min_gap_s,
                            std::size_t count, const std::function<void()>& progress);

/// How far two takes of one person differ that were learned apart.
struct Halves {
  double shape_mm = 0;       ///< mean distance of the neutral faces' skin after the best similarity
  double albedo_rms = 0;     ///< after the gain of all channels that fits best, linear
  double albedo_spread = 0;  ///< rms of the second albedo about its mean colour: what it has to say
  int albedo_points = 0;     ///< vertices of level 0 that both show
};

/// Compares what was learned up to two frames with a mesh and an albedo. The neutral face: the control mesh
/// without the part that the model's expressions have in it. Throws Error(UnreadableInput) where a frame has
/// no albedo or is of another face model.
Halves compare_halves(const face::FaceModel& model, const mesh::MeshFrame& first,
                      const mesh::MeshFrame& second);

/// A frame drawn from what other frames have told, beside the frame itself.
struct PredictionErrors {
  double fitted = 0;     ///< the frame's own light, albedo and displacements
  double predicted = 0;  ///< those of the earlier frame
  double coarse = 0;     ///< light and albedo of the earlier frame, no displacements
  double before = 0;     ///< the earlier picture as it stands
};

/// rms of a frame's rendering minus its image inside the face [MD19 eq. 2], linear 0 to 1, over a cut-out of
/// 256 px: what is drawn is frame's mesh, posed by its own landmarks (pose and expression are all that it is
/// asked for), under the light, in the albedo and with the displacements of `earlier`.
///
/// frame, earlier               with mesh and albedo, of one subject
/// image, earlier_image         theirs
/// returns                      none where the frames show too little of the face's skin
std::optional<PredictionErrors> prediction_errors(const mesh::MeshFrame& frame,
                                                  const mesh::MeshFrame& earlier, const Frame& image,
                                                  const Frame& earlier_image);

}  // namespace facet::footage
