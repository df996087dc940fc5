#include "capture/rig_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <random>
#include <regex>

#include "facet/error.hpp"
#include "files/text_file.hpp"
#include "support/paths.hpp"

namespace facet::capture {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::StartsWith;

std::string sample() {
  return files::read_text(std::filesystem::path(FACET_SOURCE_DIR) / "config/rig.toml", kMaxRigFileBytes,
                          "sample");
}

std::string error_of(const std::string& text) {
  try {
    parse_rig(text, "/etc/facet/rig.toml");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "no error";
}

/// The sample with one part replaced.
std::string changed(const std::string& from, const std::string& to) {
  const std::string text = sample();
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return std::string(text).replace(at, from.size(), to);
}

void expect_same(const Lens& a, const Lens& b) {
  EXPECT_EQ(a.width_px, b.width_px);
  EXPECT_EQ(a.height_px, b.height_px);
  EXPECT_EQ(a.fx_px, b.fx_px);
  EXPECT_EQ(a.fy_px, b.fy_px);
  EXPECT_EQ(a.cx_px, b.cx_px);
  EXPECT_EQ(a.cy_px, b.cy_px);
  EXPECT_EQ(a.distortion.k1, b.distortion.k1);
  EXPECT_EQ(a.distortion.k2, b.distortion.k2);
  EXPECT_EQ(a.distortion.p1, b.distortion.p1);
  EXPECT_EQ(a.distortion.p2, b.distortion.p2);
  EXPECT_EQ(a.distortion.k3, b.distortion.k3);
  EXPECT_EQ(a.camera_from_rig.matrix(), b.camera_from_rig.matrix());
}

TEST(RigFile, SampleIsRead) {
  const Rig rig = parse_rig(sample(), "rig.toml");
  ASSERT_EQ(rig.cameras.size(), 3U);
  ASSERT_EQ(rig.pairs.size(), 1U);
  ASSERT_EQ(rig.projectors.size(), 1U);
  ASSERT_EQ(rig.lights.size(), 1U);
  EXPECT_EQ(rig.lights[0].position_mm.y(), 550);
  EXPECT_EQ(rig.cameras[rig.pairs[0].left].name, "left-a");
  EXPECT_EQ(rig.cameras[rig.pairs[0].right].name, "left-b");
  EXPECT_TRUE(rig.cameras[2].colour);
  EXPECT_EQ(rig.cameras[0].lens.distortion.p1, 0.0004);
  EXPECT_NEAR(rig.cameras[1].lens.camera_from_rig.linear()(0, 2), std::sin(10 * M_PI / 180), 1e-12);
}

TEST(RigFile, WhatIsWrittenReadsBackExactly) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int repeat = 0; repeat < 50; ++repeat) {
    Rig rig;
    for (const char* name : {"a", "with \"quotes\" and \\", "b ü"}) {
      RigCamera camera;
      camera.name = name;
      Lens& lens = camera.lens;
      lens.width_px = 640;
      lens.height_px = 480;
      lens.fx_px = 900 + 300 * uniform(random);
      lens.fy_px = 900 + 300 * uniform(random);
      lens.cx_px = 320 + 20 * uniform(random);
      lens.cy_px = 240 + 20 * uniform(random);
      lens.distortion = {uniform(random), 1e-9 * uniform(random), 1e-300 * uniform(random), 0,
                         uniform(random)};
      lens.camera_from_rig.linear() =
          Eigen::Quaterniond(uniform(random), uniform(random), uniform(random), uniform(random))
              .normalized()
              .toRotationMatrix();
      lens.camera_from_rig.translation() << 1e3 * uniform(random), 1e-7 * uniform(random), 1e5;
      camera.colour = uniform(random) > 0;
      rig.cameras.push_back(camera);
      rig.projectors.push_back({name, lens});
      rig.lights.push_back(
          {std::string(name) + " light", lens.camera_from_rig.translation(), 1 + 0.5 * uniform(random)});
    }
    rig.pairs = {{0, 1}, {2, 0}};
    const Rig back = parse_rig(format_rig(rig), "rig.toml");
    ASSERT_EQ(back.cameras.size(), rig.cameras.size());
    ASSERT_EQ(back.projectors.size(), rig.projectors.size());
    ASSERT_EQ(back.pairs.size(), rig.pairs.size());
    for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
      EXPECT_EQ(back.cameras[i].name, rig.cameras[i].name);
      EXPECT_EQ(back.cameras[i].colour, rig.cameras[i].colour);
      expect_same(back.cameras[i].lens, rig.cameras[i].lens);
      expect_same(back.projectors[i].lens, rig.projectors[i].lens);
      EXPECT_EQ(back.lights.at(i).name, rig.lights[i].name);
      EXPECT_EQ(back.lights[i].position_mm, rig.lights[i].position_mm);
      EXPECT_EQ(back.lights[i].strength, rig.lights[i].strength);
    }
    EXPECT_EQ(back.pairs[1].left, 2U);
    EXPECT_EQ(back.pairs[1].right, 0U);
  }
}

TEST(RigFile, SmallNumbersAndTheSignOfZeroAreKept) {
  Rig rig = parse_rig(sample(), "rig.toml");
  Lens& lens = rig.cameras[0].lens;
  lens.distortion = {-0.0, 4e-5, -1e-300, 5e-324, 0.0};
  lens.camera_from_rig.translation() << -0.0, 1e-7, 1e6;
  const Lens back = parse_rig(format_rig(rig), "rig.toml").cameras[0].lens;
  expect_same(back, lens);
  EXPECT_TRUE(std::signbit(back.distortion.k1));
  EXPECT_TRUE(std::signbit(back.camera_from_rig.translation().x()));
}

TEST(RigFile, ErrorsNameFileLineKeyAndWhatIsAllowed) {
  EXPECT_THAT(error_of(""), AllOf(StartsWith("/etc/facet/rig.toml: camera:"), HasSubstr("[[camera]]")));
  EXPECT_THAT(error_of("[[camera]]\nname = 3"),
              AllOf(StartsWith("/etc/facet/rig.toml:2: camera.name:"), HasSubstr("text")));
  EXPECT_THAT(error_of("[[camera]"), HasSubstr("/etc/facet/rig.toml:1: not valid TOML"));
  EXPECT_THAT(error_of(changed("fx_px = 905.25\n", "")), HasSubstr("camera.fx_px: is missing"));
  EXPECT_THAT(error_of(changed("fx_px = 905.25", "fx_px = nan")), HasSubstr("number from 1 to"));
  EXPECT_THAT(error_of(changed("cx_px = 321.5", "cx_px = 3210.5")), HasSubstr("number from -640 to 1280"));
  EXPECT_THAT(error_of(changed("fx_px = 905.25", "fx_px = 905.25\nfz_px = 1")),
              AllOf(HasSubstr("camera.fz_px: unknown key"), HasSubstr("did you mean")));
  EXPECT_THAT(error_of(changed("-0.0002, 0.0]", "-0.0002]")), HasSubstr("a list of 5 numbers"));
  EXPECT_THAT(error_of(changed("\"left-b\"", "\"left-a\"")), HasSubstr("there is a camera 'left-a' already"));
  EXPECT_THAT(error_of(changed("\"left-b\"", "\"\"")), HasSubstr("1 to 128 characters"));
  EXPECT_THAT(error_of(changed("\"left-b\"", "\"left\\nb\"")), HasSubstr("control characters"));
}

TEST(RigFile, RotationsThatAreNoneAreRefused) {
  EXPECT_THAT(error_of(changed("[1.0, 0.0, 0.0]", "[1.0, 0.001, 0.0]")), HasSubstr("no rotation"));
  EXPECT_THAT(error_of(changed("[1.0, 0.0, 0.0]", "[-1.0, 0.0, 0.0]")), HasSubstr("mirror image"));
  EXPECT_THAT(error_of(changed("[1.0, 0.0, 0.0]", "[1.0, 0.0]")), HasSubstr("three rows"));
  EXPECT_THAT(error_of(changed("[1.0, 0.0, 0.0]", "[1.0, \"0\", 0.0]")), HasSubstr("three rows"));
  EXPECT_THAT(error_of(changed("quaternion = [1.0, 0.0, 0.0, 0.0]", "quaternion = [0.9, 0.0, 0.0, 0.0]")),
              HasSubstr("length 1"));
  EXPECT_THAT(error_of(changed("quaternion = [1.0, 0.0, 0.0, 0.0]\n", "")), HasSubstr("either rotation"));
  EXPECT_THAT(error_of(changed("translation_mm = [60.0",
                               "quaternion = [1.0, 0.0, 0.0, 0.0]\ntranslation_mm = [60.0")),
              HasSubstr("either rotation"));
}

TEST(RigFile, PairsNameTwoCamerasOnce) {
  EXPECT_THAT(error_of(changed("right = \"left-b\"", "right = \"nobody\"")),
              HasSubstr("pair.right: there is no camera 'nobody'"));
  EXPECT_THAT(error_of(changed("right = \"left-b\"", "right = \"left-a\"")), HasSubstr("two cameras"));
  EXPECT_THAT(error_of(changed("right = \"left-b\"",
                               "right = \"left-b\"\n[[pair]]\nleft = \"left-b\"\nright = \"left-a\"")),
              HasSubstr("a pair already"));
}

TEST(RigFile, ALightHasANameOfItsOwnAndAPlace) {
  const std::string light = "[[light]]\nname = \"led\"\nposition_mm = [0, 500, 800]\n";
  EXPECT_EQ(parse_rig(sample() + light, "rig.toml").lights.size(), 2U);
  EXPECT_THAT(error_of(sample() + light + light), HasSubstr("there is a light 'led' already"));
  EXPECT_THAT(error_of(sample() + "[[light]]\nname = \"led\"\n"), HasSubstr("light.position_mm: is missing"));
  EXPECT_THAT(error_of(sample() + light + "strength = 0"), HasSubstr("light.strength"));
  EXPECT_THAT(error_of(sample() + "[[light]]\nname = \"stripes.a\"\nposition_mm = [0, 0, 800]\n"),
              HasSubstr("there is a projector 'stripes.a'"));
}

TEST(RigFile, WritingIsWholeOrNotAtAll) {
  const test::TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "rig.toml";
  const Rig rig = parse_rig(sample(), "rig.toml");
  write_rig(rig, file);
  EXPECT_EQ(format_rig(read_rig(file)), format_rig(rig));
  Rig broken = rig;
  broken.cameras[0].lens.fx_px = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(write_rig(broken, file), Error);
  EXPECT_EQ(format_rig(read_rig(file)), format_rig(rig));
  try {
    write_rig(rig, folder.path() / "nowhere/rig.toml");
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    EXPECT_THAT(error.what(), HasSubstr("nowhere/rig.toml"));
  }
  try {
    read_rig(folder.path() / "missing.toml");
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    EXPECT_THAT(error.what(), HasSubstr("missing.toml"));
  }
}

TEST(RigFile, DepthIsRefused) {
  std::string deep = "a";
  for (int i = 0; i < 200'000; ++i) {
    deep += ".a";
  }
  for (const std::string& text :
       {deep + " = 1", "[" + deep + "]", "[[" + deep + "]]", "x = {" + deep + " = 1}"}) {
    EXPECT_THAT(error_of(text), HasSubstr("more than 16 names in one key"));
  }
}

}  // namespace
}  // namespace facet::capture
