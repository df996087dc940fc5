#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

namespace facet::simulation {

/// How the actor holds the head, relative to looking straight into the camera.
struct HeadMotion {
  float pitch_rad = 0;  ///< about x to the subject's left: positive looks down
  float yaw_rad = 0;    ///< about y up: positive turns to the subject's left
  float roll_rad = 0;   ///< about z out of the face: positive tips the crown to the subject's right
  Eigen::Vector3f shift_mm{0, 0, 0};  ///< of the head, camera frame
};

/// Where the eyes look, relative to the head; positive yaw to the subject's left, positive pitch up.
struct Gaze {
  float yaw_rad = 0;
  float pitch_rad = 0;
};

/// What the virtual actor does over time: talks in phrases, smiles, raises and knits the brows, squints,
/// puckers, sneers, blinks, moves the eyes and turns the head up to 25 degrees. A function of the seed and
/// the time alone. It begins near rest and frontal, so that a tracker can get hold. Any thread once built.
class Performance {
 public:
  /// duration_s: after it the face rests; the head goes on moving.
  Performance(std::uint64_t seed, double duration_s);

  /// Weights 0 to 1 for the given ARKit names; names that the performance does not use stay 0.
  std::vector<float> expression(double time_s, const std::vector<std::string>& names) const;
  HeadMotion head(double time_s) const;
  Gaze gaze(double time_s) const;

 private:
  struct Event {
    int action = 0;  ///< row of the table of actions
    float strength = 0;
    double start_s = 0;
    double attack_s = 0;
    double hold_s = 0;
    double release_s = 0;
  };
  struct Syllable {
    double time_s = 0;
    int viseme = 0;  ///< row of the table of visemes
    float strength = 0;
  };
  struct Fixation {
    double time_s = 0;
    Gaze offset;
  };

  std::vector<Event> events_;
  std::vector<Syllable> syllables_;
  std::vector<double> blinks_s_;
  std::vector<Fixation> fixations_;
  std::uint64_t seed_;
};

}  // namespace facet::simulation
