#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "capture/rig.hpp"
#include "render/video_writer.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {

/// What of a webcam stands between the actor and the video. All off: a pinhole whose picture is one moment,
/// with a small sensor's noise, stored without loss.
struct WebcamEffects {
  render::VideoCodec codec = render::VideoCodec::Lossless;
  bool exposure = false;         ///< automatic gain that hunts; noise grows with it
  bool white_balance = false;    ///< automatic, and seldom sure
  bool rolling_shutter = false;  ///< every row has a time of its own
  bool motion_blur = false;      ///< pictures are exposed for 8 to 30 ms
  bool distortion = false;       ///< of a wide lens: barrel

  bool operator==(const WebcamEffects&) const = default;
  bool any() const { return !(*this == WebcamEffects{}); }
};

/// From "clean" (none), "webcam" (all, with H.264) or names with commas between: h264 or mjpeg, exposure,
/// white-balance, rolling-shutter, motion-blur, distortion. Throws Error(Usage) that lists the names.
WebcamEffects parse_webcam_effects(const std::string& text);
/// Those that are on, as parse_webcam_effects reads them.
std::vector<std::string> names_of(const WebcamEffects& effects);

/// One camera's constants.
struct Webcam {
  double readout_s = 0;   ///< from the first row's middle of exposure to the last row's; 10 to 25 ms
  double exposure_s = 0;  ///< of each row: periods of the mains' flicker, 8 to 30 ms, at most a frame's
  capture::LensDistortion distortion;  ///< moves the picture's corners 2 to 6 % inwards

  /// From the first row's first light to the last row's last one.
  double span_s() const { return readout_s + exposure_s; }
};

/// What a seed's camera is like; what is switched off is 0, the rest does not depend on the switches.
/// lens: without distortion
Webcam draw_webcam(const WebcamEffects& effects, std::uint64_t seed, const capture::Lens& lens, int rate_hz);

/// What the camera does to a frame's light before it is coded.
struct CameraSettings {
  float gain = 1;                          ///< over the first frame's, in steps of 1/8 f-stop
  Eigen::Vector3f white_balance{1, 1, 1};  ///< factors of R, G, B over the first frame's; green's is 1
};

/// Mean linear light over the picture, as the sensor gets it.
struct Metering {
  Eigen::Vector3f centre{0, 0, 0};  ///< where a camera looks for faces
  Eigen::Vector3f whole{0, 0, 0};
};

/// A webcam's automatic exposure and white balance. Each meters the picture's centre and now and then (every
/// 1.5 to 4.5 s by the seed) loses it for a mean with the whole picture. The exposure follows with a delay of
/// 0.13 s, so that it overshoots; neither moves before the error is plain, and then to the end. A function of
/// seed and metering alone, whatever frame is asked for first. One thread.
class AutoControls {
 public:
  /// meter: the light at a time, s; asked three times a second of the sequence.
  AutoControls(const WebcamEffects& effects, std::uint64_t seed, int rate_hz,
               std::function<Metering(double time_s)> meter);

  const CameraSettings& at(int index);

 private:
  /// Whether the centre is metered, by turns.
  struct Attention {
    Random random;
    double next_switch_s = 0;
    bool on_centre = true;

    /// Of light at ascending times.
    Eigen::Vector3f weigh(const Metering& light, double time_s);
  };
  /// Of one frame, as the two see it.
  struct Seen {
    float luminance = 0;
    Eigen::Vector2f grey{1, 1};  ///< factors of red and blue that would make it grey
  };

  std::size_t delay_frames() const;
  Metering metering(double time_s);
  void step();
  float follow_exposure(const Seen& seen, float seen_gain);
  Eigen::Vector3f follow_white_balance(const Seen& seen);

  WebcamEffects effects_;
  double period_s_;
  std::function<Metering(double)> meter_;
  std::vector<Metering> keys_;
  Attention exposure_attention_;
  Attention white_balance_attention_;
  std::vector<Seen> seen_;
  std::vector<CameraSettings> settings_;
  float exposure_ev_ = 0;
  bool exposure_moves_ = false;
  Eigen::Vector2f balance_{1, 1};
  bool balance_moves_ = false;
};

}  // namespace facet::simulation
