#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace facet::simulation {

enum class LightKind {
  SphericalHarmonics,  ///< distant, one for all channels: exactly the model of [MD19 eq. 1], no
                       ///< shadows
  Area,                ///< rectangles near the head with soft shadows, a little tinted, over an ambient
  Lamps,               ///< two or three small desk lamps 0.4 to 0.8 m away
  Window,              ///< a large bluish rectangle at one side, a warm room
  Ring,                ///< a ring of diodes round the camera
  Strobe,              ///< six small lamps all round, of which one fires in each frame, in turn
};

/// "sh", "area", "lamps", "window", "ring", "strobe": the command line's and camera.json's word.
std::string light_name(LightKind kind);
/// All of them, in order.
std::vector<std::string> light_names();
/// The other way round. Throws Error(Usage).
LightKind parse_light(const std::string& name);

/// A one-sided light-giving rectangle, camera frame.
struct AreaLight {
  Eigen::Vector3f centre_mm{0, 0, 0};
  Eigen::Vector3f half_u_mm{0, 0, 0};  ///< from the centre to the middle of one edge
  Eigen::Vector3f half_v_mm{0, 0, 0};
  Eigen::Vector3f normal{0, 0, 1};  ///< unit, the side that gives light
  float reference_distance_mm = 1;  ///< from its centre to the head
  /// What a surface at the head that faces the light gets from it, linear RGB, before exposure.
  Eigen::Vector3f irradiance{0, 0, 0};
};

/// The light of one sequence.
struct Lighting {
  LightKind kind = LightKind::SphericalHarmonics;
  /// Coefficients of [MD19 eq. 1], camera frame with y up and z towards the camera. Area light: the ambient
  /// part.
  std::array<float, 9> spherical_harmonics{};
  std::vector<AreaLight> area_lights;  ///< empty for SphericalHarmonics; of a strobe in firing order
  /// Unit directions from the head to the main lights, camera frame; what highlights reflect.
  std::vector<Eigen::Vector3f> main_directions;
  std::vector<float> main_strengths;  ///< [main_directions.size()] irradiance
};

/// The second-order SH form of max(0, n . w), the irradiance of a distant light [RH01],
/// in the basis of [MD19 eq. 1]: max(0, c) is about 1/4 + c/2 + 5/32 (3 c^2 - 1).
/// direction: unit, lighting frame (y up, z towards the camera).
std::array<float, 9> distant_light_sh(const Eigen::Vector3f& direction);

/// A plausible light for a seed: a key from one side and above, a weaker fill from the other, sky and floor.
/// head_mm: where the head is, camera frame.
Lighting make_lighting(LightKind kind, std::uint64_t seed, const Eigen::Vector3f& head_mm);

/// What fires in turn around a kiosk's camera while the head is still.
enum class Burst {
  None,
  Lamps,   ///< four small ones 27 to 30 degrees off the camera's axis, 0.6 m from the head, as bright as the
           ///< room
  Screen,  ///< the left, right, upper and lower half of a screen of 24 inches, the camera on its upper
           ///< edge: a quarter as bright as a lit room
  DimScreen,  ///< the same in a room that is dimmed until both are equal
};

/// "lamps", "screen", "dim-screen" and what they are: the command line's and camera.json's words.
Burst parse_burst(const std::string& name);  ///< Throws Error(Usage).
std::string burst_name(Burst burst);         ///< "" for None

/// The light of a burst: of the room and each of its four lights in turn.
///
/// room       of the sequence, exposed
/// frame      since the burst began; each light fires for three frames, then none for three
/// returns    the room's light and the fired one's, together as bright as the room's was; `lamp` is which of
///            the four, -1 for none
Lighting burst_light(Burst burst, const Lighting& room, const Eigen::Vector3f& head_mm, int frame, int& lamp);

/// The light of one frame: of a strobe the lamp that fires then, of all others all that there is.
Lighting lighting_of_frame(const Lighting& lighting, int frame);

/// Where shadow rays go: count^2 points spread over the rectangle.
std::vector<Eigen::Vector3f> light_points_mm(const AreaLight& light, int count);

}  // namespace facet::simulation
