#include "simulation/performance.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <span>
#include <string_view>
#include <utility>

#include "facet/error.hpp"
#include "simulation/random.hpp"
#include "simulation/recorded_curves.hpp"

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
constexpr float kDegree = std::numbers::pi_v<float> / 180;

/// Where the head looks in a calm turn, between its keys with ease.
struct TurnKey {
  double at_s;
  float yaw_deg;
  float pitch_deg;
};
constexpr std::array<TurnKey, 9> kCalmTurn{{{0, 0, 0},
                                            {0.7, 0, 0},
                                            {2.4, 30, 0},
                                            {5.2, -30, 0},
                                            {6.9, 0, 0},
                                            {7.7, 0, -10},
                                            {9.1, 0, 10},
                                            {9.8, 0, 0},
                                            {kCalmTurn_s, 0, 0}}};

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

Performance::Performance(PerformanceConfig config) : config_(std::move(config)) {
  const double end_s = config_.start_s + config_.duration_s;
  if (config_.curves && config_.curves->duration_s() < end_s) {
    throw Error(ErrorKind::Usage,
                fmt::format("{} ends after {:.2f} s, the sequence would need it until {:.2f} s; take fewer "
                            "frames or an earlier start",
                            config_.curves->source(), config_.curves->duration_s(), end_s));
  }
  write_script(end_s);
}

void Performance::write_script(double duration_s) {
  Random random(config_.seed, 1);
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

void Performance::act(double at_s, const AddWeight& add) const {
  for (const Event& event : events_) {
    const float strength =
        event.strength * envelope(at_s - event.start_s, event.attack_s, event.hold_s, event.release_s);
    if (strength > 0) {
      for (const Part& part : kActions[static_cast<std::size_t>(event.action)]) {
        add(part.name, strength * part.weight);
      }
    }
  }

  const auto next = std::find_if(syllables_.begin(), syllables_.end(),
                                 [&](const Syllable& syllable) { return syllable.time_s > at_s; });
  if (next != syllables_.begin() && next != syllables_.end()) {
    const Syllable& last = *(next - 1);
    const float part = ease((at_s - last.time_s) / (next->time_s - last.time_s));
    for (const auto& [syllable, share] : {std::pair(&last, 1 - part), std::pair(&*next, part)}) {
      for (const Part& each : kVisemes[static_cast<std::size_t>(syllable->viseme)]) {
        add(each.name, share * syllable->strength * each.weight);
      }
    }
  }

  // Nobody is ever quite still, or quite symmetric.
  std::uint64_t stream = 100;
  for (const std::string_view name : {"browInnerUp", "browDownLeft", "browDownRight", "mouthSmileLeft",
                                      "mouthSmileRight", "mouthPressLeft", "mouthPressRight", "eyeSquintLeft",
                                      "eyeSquintRight", "mouthLeft", "mouthRight", "jawLeft", "jawRight"}) {
    add(name, 0.06F * std::max(0.0F, wander(config_.seed, ++stream, at_s, 0.9)));
  }
}

std::vector<float> Performance::expression(double time_s, const std::vector<std::string>& names) const {
  const double at_s = config_.start_s + time_s;
  std::vector<float> weights(names.size(), 0.0F);
  if (config_.curves) {
    const mesh::ArkitValues values = config_.curves->values(at_s);
    for (std::size_t k = 0; k < names.size(); ++k) {
      const int index = mesh::arkit_index(names[k]);
      weights[k] = index < 0 ? 0 : values[static_cast<std::size_t>(index)];
    }
    return weights;
  }
  const auto add = [&](std::string_view name, float weight) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found != names.end()) {
      weights[static_cast<std::size_t>(found - names.begin())] += weight;
    }
  };
  if (!config_.calm_turn) {
    act(at_s, add);
  }
  for (const double blink_s : blinks_s_) {
    const float shut = envelope(at_s - blink_s, kBlinkClose_s, 0.03, kBlinkOpen_s);
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
  for (float& weight : weights) {
    weight = std::clamp(weight, 0.0F, 1.0F);
  }
  return weights;
}

HeadMotion Performance::acted_head(double at_s) const {
  const float calm = 0.15F + 0.85F * ease(at_s / kCalmStart_s);
  const auto turn = [&](std::uint64_t stream, double period_s, float limit_deg) {
    return std::clamp(1.6F * calm * wander(config_.seed, stream, at_s, period_s), -1.0F, 1.0F) * limit_deg *
           kDegree;
  };
  HeadMotion motion;
  motion.yaw_rad = turn(21, 2.3, 25);
  motion.pitch_rad = turn(22, 1.9, 13);
  motion.roll_rad = turn(23, 2.7, 9);
  motion.shift_mm = calm * Eigen::Vector3f(22 * wander(config_.seed, 24, at_s, 2.5),
                                           14 * wander(config_.seed, 25, at_s, 2.1),
                                           30 * wander(config_.seed, 26, at_s, 3.1));
  return motion;
}

HeadMotion Performance::calmly_turned_head(double at_s) const {
  const auto* const next = std::find_if(kCalmTurn.begin() + 1, kCalmTurn.end() - 1,
                                        [&](const TurnKey& key) { return key.at_s > at_s; });
  const TurnKey& last = *(next - 1);
  const float part = ease((at_s - last.at_s) / (next->at_s - last.at_s));
  // Nobody turns about one axis alone, or holds the body still.
  HeadMotion motion = acted_head(at_s);
  constexpr float kSway = 0.08F;
  motion.yaw_rad = kSway * motion.yaw_rad + (last.yaw_deg + part * (next->yaw_deg - last.yaw_deg)) * kDegree;
  motion.pitch_rad =
      kSway * motion.pitch_rad + (last.pitch_deg + part * (next->pitch_deg - last.pitch_deg)) * kDegree;
  motion.roll_rad *= 2 * kSway;
  motion.shift_mm *= 2 * kSway;
  return motion;
}

HeadMotion Performance::head(double time_s) const {
  const double at_s = config_.start_s + time_s;
  if (config_.calm_turn) {
    return calmly_turned_head(at_s);
  }
  HeadMotion motion = acted_head(at_s);
  if (config_.curves && config_.curves->turns_head()) {
    const Eigen::Vector3f shift_mm = motion.shift_mm;
    motion = config_.curves->head(at_s);
    motion.shift_mm = shift_mm;
  }
  return motion;
}

Gaze Performance::gaze(double time_s) const {
  const double at_s = config_.start_s + time_s;
  if (config_.curves) {
    const mesh::ArkitValues values = config_.curves->values(at_s);
    const auto value = [&](std::string_view name) {
      return values[static_cast<std::size_t>(mesh::arkit_index(name))];
    };
    const float left =
        value("eyeLookOutLeft") - value("eyeLookInLeft") + value("eyeLookInRight") - value("eyeLookOutRight");
    const float up = value("eyeLookUpLeft") - value("eyeLookDownLeft") + value("eyeLookUpRight") -
                     value("eyeLookDownRight");
    return {0.5F * left * kGazeOfFullWeight_rad, 0.5F * up * kGazeOfFullWeight_rad};
  }
  const auto next = std::find_if(fixations_.begin() + 1, fixations_.end(),
                                 [&](const Fixation& fixation) { return fixation.time_s > at_s; });
  const Fixation& last = *(next - 1);  // the first one is at 0, and before it, where a shutter opens early
  const Gaze before = next - 1 == fixations_.begin() ? last.offset : (next - 2)->offset;
  const float part = ease((at_s - last.time_s) / kSaccade_s);
  // The eyes mostly stay on the camera while the head turns.
  const HeadMotion motion = head(time_s);
  return {std::clamp(before.yaw_rad + part * (last.offset.yaw_rad - before.yaw_rad) - 0.8F * motion.yaw_rad,
                     -0.5F, 0.5F),
          std::clamp(
              before.pitch_rad + part * (last.offset.pitch_rad - before.pitch_rad) + 0.5F * motion.pitch_rad,
              -0.4F, 0.4F)};
}

}  // namespace facet::simulation
