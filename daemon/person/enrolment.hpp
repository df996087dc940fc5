#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "person/keyframes.hpp"
#include "person/shape_solver.hpp"
#include "person/skin_relief.hpp"

namespace facet::person {

/// What is done of the frames' expressions while the shape is solved.
enum class KeyframeExpression {
  Rest,    ///< everybody's median: the nets see expressions in a turned face that are not there
  Solved,  ///< each frame's own, found from the skin's flow
};

struct EnrolmentOptions {
  int keyframes = 14;
  int lit = 24;  ///< pictures of a burst
  int rounds = 3;
  int chart_texels = 640;
  bool focal_is_known = false;
  bool uncertainty = true;  ///< LearnedShape::sigma_mm is asked for: seconds
  bool skin = true;         ///< LearnedShape::skin is asked for: some ten seconds
  int skin_texels = 768;
  KeyframeExpression expression = KeyframeExpression::Rest;
  AnchorStrength anchor;
};

/// What one gate measured (docs/person.md, "Gates").
struct Gate {
  std::string name;
  double value = 0;
  double limit = 0;
  bool passed = false;
  std::string sentence;  ///< for people, where it refuses
};

/// The shape that a turning head showed.
struct LearnedShape {
  bool accepted = false;
  std::string refused;  ///< why not: the sentence of the first gate that refuses
  std::vector<Gate> gates;
  std::vector<float> identity;  ///< [identity_count] of the model's face that the solve began with
  Eigen::Matrix3Xd neutral_mm;  ///< [3][vertex_count] head frame, of the generic face's size
  double focal_px = 0;          ///< for pictures of Observed::camera's size
  Eigen::VectorXd sigma_mm;  ///< [vertex_count] standard deviation along the normal; NaN: held to the model;
                             ///< empty where it was not asked for or nothing was solved
  Skin skin;                 ///< without texels where it was not asked for or a gate refused
  std::string skin_note;     ///< for people: why there is no relief though the shape was learned
  Eigen::VectorXd rest;      ///< [expression_count] that it was solved with
  std::vector<std::uint64_t> keyframes;  ///< sequence numbers
};

/// Asked several times a second with what is done of the total; false breaks the solve off. May be empty.
using EnrolmentProgress = std::function<bool(int done, int total)>;

/// Lights of a burst that do without a wide turn for the relief.
inline constexpr int kFewestLights = 3;

/// A head's turn to each side that its shape is solved from, degrees; 20 are better.
inline constexpr double kLeastYawDeg = 12;

/// Whether a head was seen to turn far enough to both sides for its shape to be solved for.
bool turned_enough(const OrientationSpan& span);

/// Solves a head's shape from what it showed. Refusals are results, not errors, and so is what was broken
/// off. Half a minute; allocates; any thread.
LearnedShape learn_shape(const face::FaceModel& model, const Observed& observed,
                         const EnrolmentOptions& options, const EnrolmentProgress& progress);

}  // namespace facet::person
