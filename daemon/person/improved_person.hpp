#pragma once

#include "face/face_model.hpp"
#include "person/person_file.hpp"

namespace facet::person {

/// What two enrolments say together.
struct ImprovedPerson {
  /// Median over the skin of how far the two faces lie apart along the normal, in standard deviations of the
  /// difference as each solve says it; infinite where one of them says none.
  double disagreement = 0;
  bool same_head = false;  ///< disagreement is at most kSameHead
  PersonFile person;       ///< of both; where they are not the same head, the one before
};

/// What one head's two enrolments stay below and two heads' do not, by little (docs/decisions/person.md).
inline constexpr double kSameHead = 0.75;

/// Every vertex' mean of two enrolments of one head, each weighted by 1 / sigma^2, the second brought to the
/// size and place of the first; beside the skin weights go on as at its edge. sigma is no smaller than the
/// better one's, for both may err alike. Reliefs on one chart are weighted by what the shapes count as on the
/// whole; the albedo, and reliefs on two, are the surer one's. Name, model and the expressions' origin are
/// those of the first; camera, gates and date those of the second. Allocates; any thread. Throws Error(Usage)
/// naming both models where one of them was found with another one.
ImprovedPerson improved(const face::FaceModel& model, const PersonFile& before, const PersonFile& second);

}  // namespace facet::person
