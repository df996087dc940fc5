#include "simulation/performance.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <span>
#include <string_view>

#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

struct Part {
  std::string_view name;
  float weight;
};

// One row per action: what a strong but natural one moves.
constexpr std::array<Part, 3> kBrowRaise{
    {{"browInnerUp", 0.9F}, {"browOuterUpLeft", 0.8F}, {"browOuterUpRight", 0.8F}}};
constexpr std::array<Part, 8> kSmile{{{"mouthSmileLeft", 0.85F},
                                      {"mouthSmileRight", 0.8F},
                                      {"cheekSquintLeft", 0.55F},
                                      {"cheekSquintRight", 0.5F},
                                      {"eyeSquintLeft", 0.45F},
                                      {"eyeSquintRight", 0.45F},
                                      {"mouthUpperUpLeft", 0.25F},
                                      {"mouthUpperUpRight", 0.25F}}};
constexpr std::array<Part, 7> kFrown{{{"browDownLeft", 0.9F},
                                      {"browDownRight", 0.9F},
                                      {"eyeSquintLeft", 0.3F},
                                      {"eyeSquintRight", 0.3F},
                                      {"mouthFrownLeft", 0.5F},
                                      {"mouthFrownRight", 0.5F},
                                      {"mouthShrugLower", 0.4F}}};
constexpr std::array<Part, 7> kLaugh{{{"mouthSmileLeft", 0.8F},
                                      {"mouthSmileRight", 0.85F},
                                      {"jawOpen", 0.3F},
                                      {"eyeSquintLeft", 0.85F},
                                      {"eyeSquintRight", 0.85F},
                                      {"cheekSquintLeft", 0.8F},
                                      {"cheekSquintRight", 0.8F}}};
constexpr std::array<Part, 6> kSurprise{{{"browInnerUp", 1.0F},
                                         {"browOuterUpLeft", 0.9F},
                                         {"browOuterUpRight", 0.9F},
                                         {"eyeWideLeft", 0.6F},
                                         {"eyeWideRight", 0.6F},
                                         {"jawOpen", 0.4F}}};
constexpr std::array<Part, 2> kPucker{{{"mouthPucker", 0.8F}, {"mouthFunnel", 0.2F}}};
constexpr std::array<Part, 5> kSneer{{{"noseSneerLeft", 0.8F},
                                      {"noseSneerRight", 0.6F},
                                      {"mouthUpperUpLeft", 0.4F},
                                      {"browDownLeft", 0.4F},
                                      {"browDownRight", 0.4F}}};
constexpr std::array<std::span<const Part>, 7> kActions{kBrowRaise, kSmile,  kFrown, kLaugh,
                                                        kSurprise,  kPucker, kSneer};

constexpr std::array<Part, 5> kOpenVowel{{{"jawOpen", 0.45F},
                                          {"mouthLowerDownLeft", 0.2F},
                                          {"mouthLowerDownRight", 0.2F},
                                          {"mouthUpperUpLeft", 0.1F},
                                          {"mouthUpperUpRight", 0.1F}}};
constexpr std::array<Part, 5> kWideVowel{{{"jawOpen", 0.16F},
                                          {"mouthStretchLeft", 0.3F},
                                          {"mouthStretchRight", 0.3F},
                                          {"mouthLowerDownLeft", 0.25F},
                                          {"mouthLowerDownRight", 0.25F}}};
constexpr std::array<Part, 2> kRoundVowel{{{"jawOpen", 0.32F}, {"mouthFunnel", 0.45F}}};
constexpr std::array<Part, 3> kNarrowVowel{{{"jawOpen", 0.1F}, {"mouthPucker", 0.5F}, {"mouthFunnel", 0.2F}}};
constexpr std::array<Part, 4> kLipsShut{{{"mouthPressLeft", 0.35F},
                                         {"mouthPressRight", 0.35F},
                                         {"mouthRollLower", 0.15F},
                                         {"mouthRollUpper", 0.1F}}};
constexpr std::array<Part, 4> kLipOnTeeth{{{"mouthRollLower", 0.35F},
                                           {"mouthUpperUpLeft", 0.12F},
                                           {"mouthUpperUpRight", 0.12F},
                                           {"jawOpen", 0.06F}}};
constexpr std::array<Part, 5> kHiss{{{"jawOpen", 0.07F},
                                     {"mouthStretchLeft", 0.2F},
                                     {"mouthStretchRight", 0.2F},
                                     {"mouthLowerDownLeft", 0.15F},
                                     {"mouthLowerDownRight", 0.15F}}};
constexpr std::array<std::span<const Part>, 7> kVisemes{kOpenVowel, kWideVowel,  kRoundVowel, kNarrowVowel,
                                                        kLipsShut,  kLipOnTeeth, kHiss};

constexpr double kFirstEvent_s = 0.8;
constexpr double kCalmStart_s = 2.4;  // the head leaves the frontal pose over this time
constexpr double kBlinkClose_s = 0.07;
constexpr double kBlinkOpen_s = 0.17;
constexpr double kSaccade_s = 0.05;
constexpr float kGazeOfFullWeight_rad = 0.52F;  // an eyeLook weight of 1 turns the eyeball by 30 degrees

float ease(double part) {
  return smooth_step(0, 1, static_cast<float>(part));
}

/// Rises to 1 over attack, holds, falls over release.
float envelope(double since_s, double attack_s, double hold_s, double release_s) {
  if (since_s <= 0 || since_s >= attack_s + hold_s + release_s) {
    return 0;
  }
  if (since_s < attack_s) {
    return ease(since_s / attack_s);
  }
  return 1 - ease((since_s - attack_s - hold_s) / release_s);
}

/// A slow wander of about -1 to 1, never the same twice.
float wander(std::uint64_t seed, std::uint64_t stream, double time_s, double period_s) {
  return Noise(seed, stream).fractal({static_cast<float>(time_s / period_s), 0.37F, 0.71F}, 2);
}

}  // namespace

Performance::Performance(std::uint64_t seed, double duration_s) : seed_(seed) {
  Random random(seed, 1);
  // The first two actions of every actor are a brow raise and a smile, in either order; then any.
  const int first = random.below(2);
  double at_s = kFirstEvent_s + random.uniform(0, 0.2F);
  for (int count = 0; at_s < duration_s; ++count) {
    Event event;
    event.action = count == 0   ? first
                   : count == 1 ? 1 - first
                                : random.below(static_cast<int>(kActions.size()));
    event.strength = random.uniform(0.75F, 1.0F);
    event.start_s = at_s;
    event.attack_s = random.uniform(0.2F, 0.35F);
    event.hold_s = random.uniform(0.35F, 0.9F);
    event.release_s = random.uniform(0.3F, 0.5F);
    at_s += event.attack_s + event.hold_s + 0.6 * event.release_s + random.uniform(0.1F, 0.6F);
    events_.push_back(event);
  }

  for (at_s = 0.3; at_s < duration_s; at_s += random.uniform(0.5F, 1.1F)) {  // phrases and their pauses
    const double phrase_end_s = at_s + random.uniform(1.0F, 2.4F);
    syllables_.push_back({at_s, 0, 0.0F});
    while (at_s < phrase_end_s) {
      at_s += random.uniform(0.11F, 0.2F);
      syllables_.push_back(
          {at_s, random.below(static_cast<int>(kVisemes.size())), random.uniform(0.6F, 1.0F)});
    }
    at_s += 0.15;
    syllables_.push_back({at_s, 0, 0.0F});
  }

  for (at_s = random.uniform(0.9F, 1.8F); at_s < duration_s; at_s += random.uniform(1.8F, 4.0F)) {
    blinks_s_.push_back(at_s);
  }
  fixations_.push_back({0, {}});
  for (at_s = random.uniform(0.6F, 1.2F); at_s < duration_s; at_s += random.uniform(0.6F, 1.8F)) {
    fixations_.push_back({at_s, {0.12F * random.normal(), 0.07F * random.normal()}});
  }
}

std::vector<float> Performance::expression(double time_s, const std::vector<std::string>& names) const {
  std::vector<float> weights(names.size(), 0.0F);
  const auto add = [&](std::string_view name, float weight) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found != names.end()) {
      weights[static_cast<std::size_t>(found - names.begin())] += weight;
    }
  };

  for (const Event& event : events_) {
    const float strength =
        event.strength * envelope(time_s - event.start_s, event.attack_s, event.hold_s, event.release_s);
    if (strength > 0) {
      for (const Part& part : kActions[static_cast<std::size_t>(event.action)]) {
        add(part.name, strength * part.weight);
      }
    }
  }

  const auto next = std::find_if(syllables_.begin(), syllables_.end(),
                                 [&](const Syllable& syllable) { return syllable.time_s > time_s; });
  if (next != syllables_.begin() && next != syllables_.end()) {
    const Syllable& last = *(next - 1);
    const float part = ease((time_s - last.time_s) / (next->time_s - last.time_s));
    for (const auto& [syllable, share] : {std::pair(&last, 1 - part), std::pair(&*next, part)}) {
      for (const Part& each : kVisemes[static_cast<std::size_t>(syllable->viseme)]) {
        add(each.name, share * syllable->strength * each.weight);
      }
    }
  }

  for (const double blink_s : blinks_s_) {
    const float shut = envelope(time_s - blink_s, kBlinkClose_s, 0.03, kBlinkOpen_s);
    add("eyeBlinkLeft", shut);
    add("eyeBlinkRight", shut);
  }

  const Gaze looks = gaze(time_s);
  const float left = looks.yaw_rad / kGazeOfFullWeight_rad;
  const float up = looks.pitch_rad / kGazeOfFullWeight_rad;
  add("eyeLookOutLeft", left);
  add("eyeLookInRight", left);
  add("eyeLookInLeft", -left);
  add("eyeLookOutRight", -left);
  for (const std::string_view side : {"Left", "Right"}) {
    add(std::string("eyeLookUp").append(side), up);
    add(std::string("eyeLookDown").append(side), -up);
  }

  // Nobody is ever quite still, or quite symmetric.
  std::uint64_t stream = 100;
  for (const std::string_view name : {"browInnerUp", "browDownLeft", "browDownRight", "mouthSmileLeft",
                                      "mouthSmileRight", "mouthPressLeft", "mouthPressRight", "eyeSquintLeft",
                                      "eyeSquintRight", "mouthLeft", "mouthRight", "jawLeft", "jawRight"}) {
    add(name, 0.06F * std::max(0.0F, wander(seed_, ++stream, time_s, 0.9)));
  }
  for (float& weight : weights) {
    weight = std::clamp(weight, 0.0F, 1.0F);
  }
  return weights;
}

HeadMotion Performance::head(double time_s) const {
  constexpr float kDegree = std::numbers::pi_v<float> / 180;
  const float calm = 0.15F + 0.85F * ease(time_s / kCalmStart_s);
  const auto turn = [&](std::uint64_t stream, double period_s, float limit_deg) {
    return std::clamp(1.6F * calm * wander(seed_, stream, time_s, period_s), -1.0F, 1.0F) * limit_deg *
           kDegree;
  };
  HeadMotion motion;
  motion.yaw_rad = turn(21, 2.3, 25);
  motion.pitch_rad = turn(22, 1.9, 13);
  motion.roll_rad = turn(23, 2.7, 9);
  motion.shift_mm =
      calm * Eigen::Vector3f(22 * wander(seed_, 24, time_s, 2.5), 14 * wander(seed_, 25, time_s, 2.1),
                             30 * wander(seed_, 26, time_s, 3.1));
  return motion;
}

Gaze Performance::gaze(double time_s) const {
  const auto next = std::find_if(fixations_.begin(), fixations_.end(),
                                 [&](const Fixation& fixation) { return fixation.time_s > time_s; });
  const Fixation& last = *(next - 1);  // the first fixation is at 0
  const Gaze before = next - 1 == fixations_.begin() ? last.offset : (next - 2)->offset;
  const float part = ease((time_s - last.time_s) / kSaccade_s);
  // The eyes mostly stay on the camera while the head turns.
  const HeadMotion motion = head(time_s);
  return {std::clamp(before.yaw_rad + part * (last.offset.yaw_rad - before.yaw_rad) - 0.8F * motion.yaw_rad,
                     -0.5F, 0.5F),
          std::clamp(
              before.pitch_rad + part * (last.offset.pitch_rad - before.pitch_rad) + 0.5F * motion.pitch_rad,
              -0.4F, 0.4F)};
}

}  // namespace facet::simulation
