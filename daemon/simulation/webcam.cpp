#include "simulation/webcam.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>
#include <utility>

#include "facet/error.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr std::uint64_t kShutterStream = 85;
constexpr std::uint64_t kLensStream = 86;
constexpr std::uint64_t kExposureStream = 87;
constexpr std::uint64_t kWhiteBalanceStream = 88;

constexpr double kMeterPeriod_s = 1.0 / 3;
constexpr double kDelay_s = 0.13;      // from light to settings
constexpr float kWholeShare = 0.6F;    // of the whole picture while the centre is lost
constexpr float kExposurePull = 0.9F;  // of the error within the delay: more than 1/e overshoots
constexpr float kExposureLimit_ev = 0.75F;
constexpr float kExposureStart_ev = 0.15F;  // errors below are let be
constexpr float kExposureEnd_ev = 0.06F;    // and from here on, once it moves
constexpr float kStepsPerStop = 8;
constexpr float kBalanceRate = 2;  // per second
constexpr float kBalanceLimit = 0.12F;
constexpr float kBalanceStart = 0.03F;
constexpr float kBalanceEnd = 0.006F;
constexpr float kBalanceTrust = 0.5F;  // how far a picture is believed to be grey on the whole
const Vector3f kLuminance(0.2126F, 0.7152F, 0.0722F);

struct Switch {
  const char* name;
  bool WebcamEffects::*on;
};
constexpr std::array<Switch, 5> kSwitches{{{"exposure", &WebcamEffects::exposure},
                                           {"white-balance", &WebcamEffects::white_balance},
                                           {"rolling-shutter", &WebcamEffects::rolling_shutter},
                                           {"motion-blur", &WebcamEffects::motion_blur},
                                           {"distortion", &WebcamEffects::distortion}}};

}  // namespace

WebcamEffects parse_webcam_effects(const std::string& text) {
  WebcamEffects effects;
  if (text == "clean") {
    return effects;
  }
  if (text == "webcam") {
    effects.codec = render::VideoCodec::H264;
    for (const Switch& one : kSwitches) {
      effects.*one.on = true;
    }
    return effects;
  }
  std::istringstream names(text);
  for (std::string name; std::getline(names, name, ',');) {
    const auto* found =
        std::find_if(kSwitches.begin(), kSwitches.end(), [&](const Switch& one) { return one.name == name; });
    const bool codec = name == "h264" || name == "mjpeg";
    if (found != kSwitches.end()) {
      effects.*found->on = true;
    } else if (codec && effects.codec == render::VideoCodec::Lossless) {
      effects.codec = name == "h264" ? render::VideoCodec::H264 : render::VideoCodec::MotionJpeg;
    } else if (codec) {
      throw Error(ErrorKind::Usage, fmt::format("camera '{}': a video has one codec, h264 or mjpeg", text));
    } else {
      throw Error(
          ErrorKind::Usage,
          fmt::format("camera '{}': there is no effect '{}'; say clean, webcam (all with h264), or, with "
                      "commas between, some of h264 or mjpeg, exposure, white-balance, "
                      "rolling-shutter, motion-blur, distortion",
                      text, name));
    }
  }
  if (!effects.any()) {
    throw Error(ErrorKind::Usage, "a camera needs a name; say clean, webcam or names of effects");
  }
  return effects;
}

std::vector<std::string> names_of(const WebcamEffects& effects) {
  std::vector<std::string> names;
  if (effects.codec != render::VideoCodec::Lossless) {
    names.emplace_back(effects.codec == render::VideoCodec::H264 ? "h264" : "mjpeg");
  }
  for (const Switch& one : kSwitches) {
    if (effects.*one.on) {
      names.emplace_back(one.name);
    }
  }
  return names;
}

Webcam draw_webcam(const WebcamEffects& effects, std::uint64_t seed, const capture::Lens& lens, int rate_hz) {
  Webcam webcam;
  Random shutter(seed, kShutterStream);
  const double readout_s = static_cast<double>(shutter.uniform(0.010F, 0.025F));
  // Whole periods of lamps on the mains of 50 or 60 Hz, lest they flicker.
  const double flicker_s = shutter.below(2) == 0 ? 1.0 / 100 : 1.0 / 120;
  const double exposure_s = std::min((1 + shutter.below(3)) * flicker_s, 1.0 / rate_hz);
  webcam.readout_s = effects.rolling_shutter ? readout_s : 0;
  webcam.exposure_s = effects.motion_blur ? exposure_s : 0;
  if (effects.distortion) {
    Random glass(seed, kLensStream);
    const double inwards = static_cast<double>(glass.uniform(0.02F, 0.06F));
    const double bend = static_cast<double>(glass.uniform(0.2F, 0.4F));  // share that k2 takes back
    const double x = 0.5 * (lens.width_px - 1) / lens.fx_px;
    const double y = 0.5 * (lens.height_px - 1) / lens.fy_px;
    const double corner2 = x * x + y * y;
    webcam.distortion.k1 = -(1 + bend) * inwards / corner2;
    webcam.distortion.k2 = bend * inwards / (corner2 * corner2);
  }
  return webcam;
}

AutoControls::AutoControls(const WebcamEffects& effects, std::uint64_t seed, int rate_hz,
                           std::function<Metering(double)> meter)
    : effects_(effects),
      period_s_(1.0 / rate_hz),
      meter_(std::move(meter)),
      exposure_attention_{Random(seed, kExposureStream)},
      white_balance_attention_{Random(seed, kWhiteBalanceStream)} {}

const CameraSettings& AutoControls::at(int index) {
  while (settings_.size() <= static_cast<std::size_t>(index)) {
    step();
  }
  return settings_[static_cast<std::size_t>(index)];
}

Metering AutoControls::metering(double time_s) {
  const double at = time_s / kMeterPeriod_s;
  const auto key = static_cast<std::size_t>(at);
  while (keys_.size() <= key + 1) {
    keys_.push_back(meter_(static_cast<double>(keys_.size()) * kMeterPeriod_s));
  }
  const auto part = static_cast<float>(at - static_cast<double>(key));
  return {(1 - part) * keys_[key].centre + part * keys_[key + 1].centre,
          (1 - part) * keys_[key].whole + part * keys_[key + 1].whole};
}

Vector3f AutoControls::Attention::weigh(const Metering& light, double time_s) {
  const auto hold_s = [&] { return static_cast<double>(random.uniform(1.5F, 4.5F)); };
  if (next_switch_s == 0) {
    next_switch_s = hold_s();
  }
  while (time_s >= next_switch_s) {
    on_centre = !on_centre;
    next_switch_s += hold_s();
  }
  const float share = on_centre ? 0 : kWholeShare;
  return (1 - share) * light.centre + share * light.whole;
}

std::size_t AutoControls::delay_frames() const {
  return static_cast<std::size_t>(std::max(1L, std::lround(kDelay_s / period_s_)));
}

void AutoControls::step() {
  const std::size_t index = settings_.size();
  const double time_s = static_cast<double>(index) * period_s_;
  constexpr float kDark = 1e-4F;  // light below says nothing
  const Metering light = metering(time_s);
  const Vector3f coloured = white_balance_attention_.weigh(light, time_s).cwiseMax(kDark);
  seen_.push_back(
      {std::max(kLuminance.dot(exposure_attention_.weigh(light, time_s)), kDark),
       Vector2f(coloured.y() / coloured.x(), coloured.y() / coloured.z()).array().pow(kBalanceTrust)});
  CameraSettings now;
  if (index > 0) {
    const std::size_t delay = delay_frames();
    const std::size_t then = index > delay ? index - delay : 0;
    if (effects_.exposure) {
      now.gain = follow_exposure(seen_[then], settings_[then].gain);
    }
    if (effects_.white_balance) {
      now.white_balance = follow_white_balance(seen_[then]);
    }
  }
  settings_.push_back(now);
}

float AutoControls::follow_exposure(const Seen& seen, float seen_gain) {
  const float error_ev = std::log2(seen_.front().luminance / (seen.luminance * seen_gain));
  exposure_moves_ = std::abs(error_ev) > (exposure_moves_ ? kExposureEnd_ev : kExposureStart_ev);
  if (exposure_moves_) {
    exposure_ev_ = std::clamp(exposure_ev_ + kExposurePull / static_cast<float>(delay_frames()) * error_ev,
                              -kExposureLimit_ev, kExposureLimit_ev);
  }
  return std::exp2(std::round(kStepsPerStop * exposure_ev_) / kStepsPerStop);
}

Vector3f AutoControls::follow_white_balance(const Seen& seen) {
  const Vector2f wanted = (seen.grey.array() / seen_.front().grey.array())
                              .cwiseMax(1 - kBalanceLimit)
                              .cwiseMin(1 + kBalanceLimit);
  const float error = (wanted - balance_).cwiseAbs().maxCoeff();
  balance_moves_ = error > (balance_moves_ ? kBalanceEnd : kBalanceStart);
  if (balance_moves_) {
    balance_ += std::min(kBalanceRate * static_cast<float>(period_s_), 1.0F) * (wanted - balance_);
  }
  return {balance_.x(), 1, balance_.y()};
}

}  // namespace facet::simulation
