#include "simulation/webcam.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <utility>

#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "simulation/actor_sequence.hpp"
#include "simulation/sensor.hpp"
#include "simulation/sequence.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::simulation {
namespace {

const face::FaceModel& model() {
  static const face::FaceModel made = test::synthetic_model();
  return made;
}

/// Small, without noise; the head turns by 80 degrees and back within 0.2 s.
ActorSequenceConfig turning(int rate_hz, const std::string& camera, int skin_type = Look::kPainted) {
  ActorSequenceConfig config;
  config.seed = 5;
  config.width_px = 192;
  config.height_px = 144;
  config.rate_hz = rate_hz;
  config.frame_count = rate_hz / 5 + 1;
  config.turn_deg = 80;
  config.sensor_noise = false;
  config.webcam = parse_webcam_effects(camera);
  config.look.skin_type = skin_type;
  return config;
}

/// Linear values of a row, or of all rows.
std::vector<float> linear(const render::Picture& picture, int row = -1) {
  const auto width = 3 * static_cast<std::size_t>(picture.width_px);
  const auto first = picture.rgb.begin() + (row < 0 ? 0 : static_cast<std::ptrdiff_t>(width) * row);
  const auto end = row < 0 ? picture.rgb.end() : first + static_cast<std::ptrdiff_t>(width);
  std::vector<float> values;
  std::transform(first, end, std::back_inserter(values), render::srgb8_to_linear);
  return values;
}

/// How far what was seen is from what is expected, over how far from another picture, where these two differ
/// plainly: at outlines. Colours within the face follow its light and say less.
struct Closeness {
  double to_expected = 0;
  double to_other = 0;
  int count = 0;

  void add(const std::vector<float>& seen, const std::vector<float>& expected,
           const std::vector<float>& other) {
    constexpr float kPlain = 0.03F;
    for (std::size_t k = 0; k < seen.size(); ++k) {
      if (std::abs(expected.at(k) - other.at(k)) > kPlain) {
        to_expected += static_cast<double>(std::abs(seen[k] - expected[k]));
        to_other += static_cast<double>(std::abs(seen[k] - other[k]));
        ++count;
      }
    }
  }
  double ratio() const { return to_expected / to_other; }
};

TEST(WebcamEffects, AreNamedAndChecked) {
  EXPECT_FALSE(parse_webcam_effects("clean").any());
  const WebcamEffects all = parse_webcam_effects("webcam");
  const std::vector<std::string> names{"h264",        "exposure",  "white-balance", "rolling-shutter",
                                       "motion-blur", "distortion"};
  EXPECT_EQ(names_of(all), names);
  for (const std::string& name : {std::string("mjpeg"), std::string("exposure,distortion")}) {
    const WebcamEffects some = parse_webcam_effects(name);
    EXPECT_TRUE(some.any());
    std::string joined;
    for (const std::string& one : names_of(some)) {
      joined += (joined.empty() ? "" : ",") + one;
    }
    EXPECT_EQ(joined, name);
  }
  for (const char* wrong : {"", "blur", "h264,mjpeg", "exposure,,distortion", "clean,h264"}) {
    try {
      parse_webcam_effects(wrong);
      FAIL() << "accepted '" << wrong << "'";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
    }
  }
}

TEST(Webcam, ConstantsAreThoseOfCamerasAndKeepWhenOthersAreSwitchedOff) {
  capture::Lens lens;
  lens.width_px = 640;
  lens.height_px = 360;
  lens.fx_px = lens.fy_px = 600;
  lens.cx_px = 319.5;
  lens.cy_px = 179.5;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const Webcam all = draw_webcam(parse_webcam_effects("webcam"), seed, lens, 30);
    EXPECT_GE(all.readout_s, 0.010);
    EXPECT_LE(all.readout_s, 0.025);
    EXPECT_GE(all.exposure_s, 0.008);
    EXPECT_LE(all.exposure_s, 0.0301);
    lens.distortion = all.distortion;
    const auto corner =
        lens.project(lens.camera_from_rig.inverse() * Eigen::Vector3d(319.5 / 600, 179.5 / 600, 1));
    ASSERT_TRUE(corner.has_value());
    const double inwards = 1 - (*corner - Eigen::Vector2d(319.5, 179.5)).norm() / std::hypot(319.5, 179.5);
    EXPECT_GE(inwards, 0.0199);
    EXPECT_LE(inwards, 0.0601);
    lens.distortion = {};
    const Webcam blur = draw_webcam(parse_webcam_effects("motion-blur"), seed, lens, 30);
    EXPECT_EQ(blur.exposure_s, all.exposure_s);
    EXPECT_EQ(blur.readout_s, 0);
    EXPECT_EQ(blur.distortion.k1, 0);
    EXPECT_EQ(draw_webcam(parse_webcam_effects("rolling-shutter"), seed, lens, 30).readout_s, all.readout_s);
  }
}

/// Grey light that is `factor` times as bright from 1 s on.
AutoControls grey_light(float factor) {
  return {parse_webcam_effects("exposure,white-balance"), 3, 30, [factor](double time_s) {
            const Eigen::Vector3f light = Eigen::Vector3f::Constant(time_s < 0.99 ? 0.3F : 0.3F * factor);
            return Metering{light, light};
          }};
}

TEST(AutoControls, LetSteadyLightBe) {
  AutoControls controls = grey_light(1);
  for (int index = 0; index < 300; ++index) {
    EXPECT_EQ(controls.at(index).gain, 1);
    EXPECT_EQ(controls.at(index).white_balance, Eigen::Vector3f(1, 1, 1));
  }
}

TEST(AutoControls, ExposureFollowsLateOvershootsAndSettlesInSteps) {
  for (const float factor : {0.7F, 1.4F}) {
    AutoControls controls = grey_light(factor);
    const float wanted_ev = -std::log2(factor);
    float farthest_ev = 0;
    for (int index = 0; index < 120; ++index) {
      const float ev = std::log2(controls.at(index).gain);
      EXPECT_NEAR(8 * ev, std::round(8 * ev), 1e-4);
      farthest_ev = std::max(farthest_ev, ev / wanted_ev);
      if (index <= 20 + 3) {  // the light changes after frame 20
        EXPECT_EQ(ev, 0) << index;
      }
    }
    EXPECT_GT(farthest_ev, 1.2F);
    EXPECT_LT(farthest_ev, 1.8F);
    EXPECT_NEAR(std::log2(controls.at(119).gain), wanted_ev, 0.151F);  // less does not start it
    EXPECT_EQ(controls.at(119).white_balance, Eigen::Vector3f(1, 1, 1));
  }
}

TEST(AutoControls, HuntBetweenCentreAndWholeWhateverFrameIsAskedForFirst) {
  const auto meter = [](double) { return Metering{{0.4F, 0.3F, 0.25F}, {0.15F, 0.2F, 0.3F}}; };
  AutoControls forward(parse_webcam_effects("exposure,white-balance"), 7, 30, meter);
  AutoControls late(parse_webcam_effects("exposure,white-balance"), 7, 30, meter);
  late.at(299);
  int gain_changes = 0;
  Eigen::Vector3f low(1, 1, 1);
  Eigen::Vector3f high(1, 1, 1);
  for (int index = 0; index < 300; ++index) {
    const CameraSettings& now = forward.at(index);
    EXPECT_EQ(now.gain, late.at(index).gain);
    EXPECT_EQ(now.white_balance, late.at(index).white_balance);
    gain_changes += index > 0 && now.gain != forward.at(index - 1).gain ? 1 : 0;
    low = low.cwiseMin(now.white_balance);
    high = high.cwiseMax(now.white_balance);
    // The whole is bluer than the centre: blue goes down, red up, by the limit at most.
    EXPECT_EQ(now.white_balance.y(), 1);
  }
  EXPECT_GE(gain_changes, 6);
  EXPECT_LT(low.z(), 0.95F);
  EXPECT_GE(low.z(), 0.879F);
  EXPECT_GT(high.x(), 1.05F);
  EXPECT_LE(high.x(), 1.121F);
}

TEST(WebcamSequence, GainAndWhiteBalanceAreThoseThatAreTold) {
  ActorSequenceConfig config = turning(4, "exposure,white-balance");
  config.seed = 3;
  config.frame_count = 28;
  config.turn_deg = 0;
  config.width_px = 96;
  config.height_px = 64;
  const ActorSequence automatic(model(), config);
  config.webcam = {};
  const ActorSequence fixed(model(), config);
  EXPECT_EQ(automatic.render(0, nullptr).picture.rgb, fixed.render(0, nullptr).picture.rgb);
  int changed = 0;
  for (int index = 27; index >= 0 && changed < 2; index -= 3) {
    const SyntheticFrame frame = automatic.render(index, nullptr);
    if (frame.settings.gain == 1) {
      continue;
    }
    ++changed;
    const std::vector<float> seen = linear(frame.picture);
    const std::vector<float> expected = linear(fixed.render(index, nullptr).picture);
    std::array<double, 3> seen_sum{};
    std::array<double, 3> expected_sum{};
    for (std::size_t k = 0; k < seen.size(); ++k) {
      const float value =
          expected[k] * frame.settings.gain * frame.settings.white_balance[static_cast<Eigen::Index>(k % 3)];
      if (value < 0.9F) {  // what isn't clipped
        seen_sum.at(k % 3) += static_cast<double>(seen[k]);
        expected_sum.at(k % 3) += static_cast<double>(value);
      }
    }
    for (std::size_t channel = 0; channel < 3; ++channel) {
      EXPECT_NEAR(seen_sum.at(channel) / expected_sum.at(channel), 1, 0.01) << index;
    }
  }
  EXPECT_EQ(changed, 2);
}

TEST(WebcamSequence, NoiseGrowsWithGain) {
  // The same light at twice the gain: half the electrons, sqrt(2) of the noise in what comes out.
  const Eigen::MatrixXf grey = Eigen::MatrixXf::Constant(3, 64 * 64, 0.4F);
  const auto rms = [&](float gain) {
    const auto bytes = develop(grey, 64, 64, {6000 / gain, 5, true}, 9);
    const double middle = render::linear_to_srgb8(0.4F);
    double sum = 0;
    for (const std::uint8_t byte : bytes) {
      sum += (byte - middle) * (byte - middle);
    }
    return std::sqrt(sum / static_cast<double>(bytes.size()));
  };
  EXPECT_NEAR(rms(4) / rms(1), 2, 0.25);
}

/// Of painted actors and of those with strands for hair.
class LensAndShutter : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Skins, LensAndShutter, testing::Values(Look::kPainted, 3));

TEST_P(LensAndShutter, RowsOfARollingShutterSeeTheirOwnTime) {
  const ActorSequence rolling(model(), turning(30, "rolling-shutter", GetParam()));
  const ActorSequence clean(model(), turning(30, "clean", GetParam()));
  const ActorSequence fine(model(), turning(9600, "clean", GetParam()));
  const double readout_s = rolling.webcam().readout_s;
  constexpr int kFrame = 2;  // in the midst of the turn
  const render::Picture seen = rolling.render(kFrame, nullptr).picture;
  const render::Picture at_once = clean.render(kFrame, nullptr).picture;
  for (const auto& rows : {std::array{40, 44, 50}, {88, 94, 100}}) {  // hair, above the middle; below it
    if (GetParam() != Look::kPainted && rows[0] > 72) {
      continue;  // there the mask's edge meets the hollow neck, whose shade is that of the frame's time
    }
    Closeness closeness;
    for (const int row : rows) {
      const double late_s = (row / 143.0 - 0.5) * readout_s;
      const render::Picture then =
          fine.render(320 * kFrame + static_cast<int>(std::lround(9600 * late_s)), nullptr).picture;
      closeness.add(linear(seen, row), linear(then, row), linear(at_once, row));
    }
    EXPECT_GT(closeness.count, 12) << rows[0];
    EXPECT_LT(closeness.ratio(), 0.4);
  }
}

TEST_P(LensAndShutter, BlurIsTheMeanOverTheExposure) {
  const ActorSequence blurred(model(), turning(30, "motion-blur", GetParam()));
  const ActorSequence clean(model(), turning(30, "clean", GetParam()));
  const ActorSequence fine(model(), turning(1200, "clean", GetParam()));
  constexpr int kFrame = 2;
  const int steps = static_cast<int>(std::lround(1200 * blurred.webcam().exposure_s));
  std::vector<float> mean;
  int count = 0;
  for (int step = -steps / 2; step <= steps / 2; step += 2, ++count) {
    const std::vector<float> then = linear(fine.render(40 * kFrame + step, nullptr).picture);
    mean.resize(then.size());
    std::transform(mean.begin(), mean.end(), then.begin(), mean.begin(), std::plus<>());
  }
  std::transform(mean.begin(), mean.end(), mean.begin(),
                 [&](float sum) { return sum / static_cast<float>(count); });
  Closeness closeness;
  closeness.add(linear(blurred.render(kFrame, nullptr).picture), mean,
                linear(clean.render(kFrame, nullptr).picture));
  EXPECT_GT(closeness.count, 100);
  EXPECT_LT(closeness.ratio(), 0.4);
}

TEST_P(LensAndShutter, DistortedPictureIsTheStraightOneBent) {
  const ActorSequence sequence(model(), turning(30, "distortion", GetParam()));
  TruthMesh truth;
  TruthMesh straight_truth;
  const render::Picture seen = sequence.render(3, &truth).picture;
  const render::Picture straight =
      ActorSequence(model(), turning(30, "clean", GetParam())).render(3, &straight_truth).picture;
  EXPECT_EQ(truth.vertices_mm, straight_truth.vertices_mm);
  const capture::Lens& lens = sequence.rig().cameras.front().lens;
  const auto& bend = lens.distortion;
  EXPECT_LT(bend.k1, 0);
  // Each point of the straight picture moves by [Bro71]'s polynomial.
  const std::vector<float> bright = linear(straight);
  std::vector<float> bent = linear(seen);  // where nothing lands it tells nothing
  for (int y = 0; y < seen.height_px; ++y) {
    for (int x = 0; x < seen.width_px; ++x) {
      Eigen::Vector2d from((x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px);
      const Eigen::Vector2d to = from;
      for (int step = 0; step < 20; ++step) {
        const double r2 = from.squaredNorm();
        from = to / (1 + bend.k1 * r2 + bend.k2 * r2 * r2);
      }
      const double column = lens.fx_px * from.x() + lens.cx_px;
      const double row = lens.fy_px * from.y() + lens.cy_px;
      if (!(column >= 0 && row >= 0 && column < seen.width_px - 1 && row < seen.height_px - 1)) {
        continue;
      }
      const auto u = static_cast<float>(column - std::floor(column));
      const auto v = static_cast<float>(row - std::floor(row));
      const auto width = 3 * static_cast<std::size_t>(seen.width_px);
      const std::size_t corner = static_cast<std::size_t>(row) * width + 3 * static_cast<std::size_t>(column);
      for (std::size_t c = corner; c < corner + 3; ++c) {
        bent[static_cast<std::size_t>(y) * width + 3 * static_cast<std::size_t>(x) + (c - corner)] =
            (1 - v) * ((1 - u) * bright[c] + u * bright[c + 3]) +
            v * ((1 - u) * bright[c + width] + u * bright[c + width + 3]);
      }
    }
  }
  Closeness closeness;
  closeness.add(linear(seen), bent, bright);
  EXPECT_GT(closeness.count, 100);
  EXPECT_LT(closeness.ratio(), 0.4);
}

TEST(WebcamSequence, FolderTellsOfTheCamera) {
  const test::TemporaryFolder folder;
  ActorSequenceConfig config = turning(30, "webcam");
  config.frame_count = 2;
  const ActorSequence sequence(model(), config);
  write_sequence(sequence, folder.path() / "a", {}, [](int) {});
  write_sequence(ActorSequence(model(), config), folder.path() / "b", {}, [](int) {});
  const auto bytes = [&](const char* name) {
    std::ifstream stream(folder.path() / name / "video.mkv", std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(stream), {});
  };
  EXPECT_GT(bytes("a").size(), 500U);
  EXPECT_TRUE(bytes("a") == bytes("b"));
  const capture::Rig rig = capture::read_rig(folder.path() / "a" / "rig.toml");
  ASSERT_EQ(rig.cameras.size(), 1U);
  EXPECT_EQ(rig.cameras.front().name, "video");
  EXPECT_NEAR(rig.cameras.front().lens.distortion.k1, sequence.webcam().distortion.k1, 1e-9);
  std::ifstream stream(folder.path() / "a" / "camera.json");
  const nlohmann::json document = nlohmann::json::parse(stream);
  EXPECT_EQ(document["webcam"]["effects"].size(), 6U);
  EXPECT_NEAR(document["webcam"]["readout_ms"].get<double>(), 1e3 * sequence.webcam().readout_s, 1e-9);
  EXPECT_EQ(document["frames"][1]["gain"], 1.0);
  EXPECT_EQ(document["frames"][1]["white_balance"].size(), 3U);
}

}  // namespace
}  // namespace facet::simulation
