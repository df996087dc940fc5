#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "landmark/landmarker.hpp"
#include "track/landmark_movements.hpp"
#include "track/landmark_term.hpp"

namespace facet::track {

/// What a fit and one view say of how far landmarks have moved.
///
/// model     whose landmarks these are
/// basis     of the person, bias included
/// face      what the view shows
/// camera    of that view; focal_px: of the reference camera
/// state     the frame's fit
/// out       resized at its first use only
void landmark_movements(const LandmarkModel& model, const LandmarkBasis& basis,
                        const landmark::FaceLandmarks& face, const FitCamera& camera, double focal_px,
                        const FrameState& state, LandmarkMovements& out);

/// What reads expressions off landmarks, found by bench/expression-reading on faces that the model was not
/// made from (docs/tracking.md, "Values"). The values w, 0 to 1, of a frame are those of least
///   1/2 w^T P w - w^T E x + rare sum w,   x = (movements in mm, kFittedMm times the fit's weights)
/// P: how certain they are together, C^-1 + D S^-1 D^T; E: D S^-1. Plain data.
struct ExpressionReading {
  using Numbers = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  std::vector<std::string> names;  ///< ARKit's
  std::vector<int> landmarks;      ///< of the face mesh, and irises; ascending
  Numbers evidence;   ///< E [names][2 landmarks + names]: movements to the left and up, then fitted weights
  Numbers certainty;  ///< P [names][names]
  float rare = 0;     ///< few values rather than many small ones
  /// [names] 0 to 1: share of a value's ups and downs that reading tells, of strangers that it was not
  /// learned from: the square of the mean correlation with the truth. Empty: not known.
  Eigen::VectorXf told;
};

/// A fitted weight of 1 counts as so many mm of a landmark.
inline constexpr float kFittedMm = 4;

/// The one that the product has: of the default model's fit.
const ExpressionReading& learned_reading();

/// Reads a frame's expression, 0.1 ms. One thread; no allocation after construction.
class ExpressionReader {
 public:
  /// Reads nothing where the model lacks a landmark or is without an expression of the reading's.
  ///
  /// expression_names   the face model's
  ExpressionReader(const LandmarkModel& model, std::span<const std::string> expression_names,
                   const ExpressionReading& reading);

  /// Puts what it reads, 0 to 1, into `values`; the others stay, and all where nothing is read.
  ///
  /// values      in: the fit's weights, [the face model's expression_count]
  /// confidence  [the same count] ExpressionReading::told, times how far the view shows what the value is
  ///             read off; 0 of what is not read, and empty where nothing is or nothing is known of it
  void read(const LandmarkMovements& movements, std::vector<float>& values, std::vector<float>& confidence);

  /// Somebody else is read from here on: forgets where the face before rested sideways.
  void forget();

 private:
  /// A mouth or a jaw that stands to one side most of the time rests there, whoever's face it is.
  struct Sideways {
    Eigen::Index left;  ///< in the reading's names
    Eigen::Index right;
    float rest = 0;  ///< running median of right - left
  };
  void take_rest_off();

  std::vector<int> places_;   ///< [landmarks of the reading] in the model's landmarks
  std::vector<int> indices_;  ///< [names of the reading] in the face model's expressions
  const ExpressionReading* reading_;
  Eigen::MatrixXf shares_;  ///< [names][landmarks] how much of a value is read off each; sums to told
  Eigen::VectorXf seen_;    ///< x, scratch
  Eigen::VectorXf pull_;    ///< E x - rare, then the confidences, scratch
  Eigen::VectorXf read_;    ///< w, scratch
  Eigen::VectorXf shown_;   ///< [landmarks of the reading], scratch
  std::vector<Sideways> sideways_;
  int read_before_ = 0;  ///< frames of this face
};

}  // namespace facet::track
