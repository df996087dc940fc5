#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
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

class RecordedCurves;

struct PerformanceConfig {
  std::uint64_t seed = 1;
  double duration_s = 10;  ///< after it an acted face rests; the head goes on moving
  /// The moment of the performance at which time 0 lies: the actor is met in the middle of it.
  double start_s = 0;
  /// Instead of acting: the face rests but for blinks while the head turns to both sides, up and down
  /// (kCalmTurn_s), as somebody does who is asked to.
  bool calm_turn = false;
  /// Instead of the acted expressions; the head's turns, too, where they are recorded.
  std::shared_ptr<const RecordedCurves> curves = nullptr;
};

/// A calm turn's length, s: 30 degrees to the subject's left and to the right, then 10 up and 10 down.
inline constexpr double kCalmTurn_s = 10;
/// Of lamps that fire in turn after it.
inline constexpr double kBurst_s = 1.5;

/// What the virtual actor does over time. Acted: it talks in phrases, smiles, raises and knits the brows,
/// squints, puckers, sneers, blinks, moves the eyes and turns the head up to 25 degrees; a function of the
/// seed and the time alone. It begins near rest and frontal, so that a tracker can get hold. Or as recorded,
/// or a calm turn. Any thread once built.
class Performance {
 public:
  /// Throws Error(Usage) where recorded curves end before start_s + duration_s.
  explicit Performance(PerformanceConfig config);

  /// Weights 0 to 1 for the given ARKit names; names that the performance does not use stay 0. time_s: from
  /// the start on, here and below; before it, where a first picture's shutter opens, all goes on smoothly.
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

  using AddWeight = std::function<void(std::string_view name, float weight)>;

  void write_script(double end_s);
  // at_s: from the beginning of the performance.
  void act(double at_s, const AddWeight& add) const;
  HeadMotion acted_head(double at_s) const;
  HeadMotion calmly_turned_head(double at_s) const;

  PerformanceConfig config_;
  std::vector<Event> events_;
  std::vector<Syllable> syllables_;
  std::vector<double> blinks_s_;
  std::vector<Fixation> fixations_;
};

}  // namespace facet::simulation
