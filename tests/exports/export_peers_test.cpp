// `facet export` into files of many frames, and these as other programs read them: Khronos' glTF validator,
// TinyUSDZ, Blender.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <random>
#include <sstream>

#include "avatar/glb_document.hpp"
#include "export_fixture.hpp"
#include "exports/export.hpp"
#include "face/face_model.hpp"
#include "files/image_file.hpp"
#include "mesh/arkit.hpp"
#include "support/child_process.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "support/png_head.hpp"
#include "support/small_disk.hpp"

namespace facet::exports {
namespace {

using ::testing::AllOf;
using ::testing::DoubleNear;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::FloatNear;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::Pointwise;

TEST_F(Export, OneFileForAllFrames) {
  const std::string take = patch_take();
  for (const auto& [format, ending] : kOneFile) {
    EXPECT_EQ(run({"export", take, "--format", format, "-o", file("all." + ending)}), 0) << output_;
    EXPECT_TRUE(std::filesystem::is_regular_file(file("all." + ending))) << format;
  }
  EXPECT_TRUE(std::filesystem::is_regular_file(file("all.obj"))) << "what the caches are put on";
  EXPECT_EQ(run({"export", take, "--format", "pc2", "--frames", "101:106", "--level", "coarse", "-o",
                 file("part.pc2")}),
            0);
  EXPECT_THAT(output_,
              AllOf(HasSubstr("left out: 103"), HasSubstr("4 frames, 101 to 105 of the source at 30 Hz")));
  const auto vertices = static_cast<std::uintmax_t>(test::patch_hierarchy()->levels.front().vertex_count);
  EXPECT_EQ(std::filesystem::file_size(file("part.pc2")), 32 + 5 * 12 * vertices) << "frame 103 is held";
  EXPECT_EQ(run({"export", take, "--format", "usda-frames", "-o", file("folder")}), 2);
  EXPECT_THAT(output_, HasSubstr("-o NAME.usda"));
  EXPECT_EQ(run({"export", take, "--format", "mdd", "--frames", "103:104", "-o", file("none.mdd")}), 4);
  EXPECT_FALSE(std::filesystem::exists(file("none.mdd")));
}

TEST_F(Export, MapsForEachFrame) {
  const std::string take = patch_take();
  for (const char* format : {"displacement", "normal", "tangent-normal"}) {
    EXPECT_EQ(run({"export", take, "--format", format, "--size", "64", "--pictures", "png", "--frames",
                   "102:105", "-o", file(format)}),
              0)
        << output_;
    EXPECT_THAT(files_in(format), ElementsAre("frame_000102.png", "frame_000104.png"));
  }
  EXPECT_EQ(run({"export", take, "--format", "albedo", "--size", "64", "-o", file("albedo")}), 0) << output_;
  EXPECT_THAT(files_in("albedo"), ElementsAre("frame_000100.exr")) << "it never changes";
}

TEST_F(Export, TwoPeopleAreNotOneFile) {
  const auto one = test::patch_subject(1);
  const auto other = test::patch_subject(2, 7);
  const std::string take =
      record("two.take", {test::patch_frame(1, one, nullptr), test::patch_frame(2, one, nullptr),
                          test::patch_frame(3, other, nullptr)});
  for (const auto& [format, ending] : kOneFile) {
    const bool curves = format == "csv" || format == "jsonl";
    EXPECT_EQ(run({"export", take, "--format", format, "-o", file("all." + ending)}), curves ? 0 : 2)
        << format;
    if (!curves) {
      EXPECT_THAT(output_, AllOf(HasSubstr("all." + ending), HasSubstr("frame 3 has another mesh"),
                                 HasSubstr("--frames :3 and --frames 3:")));
      EXPECT_FALSE(std::filesystem::exists(file("all." + ending)));
    }
  }
  EXPECT_EQ(run({"export", take, "--format", "pc2", "--frames", ":3", "-o", file("first.pc2")}), 0)
      << output_;
}

TEST_F(Export, BrokenOffLeavesNothing) {
  const std::string take = patch_take();
  const Birth birth{.environment = {}, .pending_signal = SIGTERM};
  for (const auto& [format, ending] : kOneFile) {
    EXPECT_EQ(run({"export", take, "--format", format, "-o", file("all." + ending)}, birth), 128 + SIGTERM)
        << format;
    EXPECT_THAT(output_, HasSubstr("nothing was written to"));
  }
  EXPECT_THAT(files_in("."), ElementsAre("log", "some.take"));
}

TEST_F(Export, AFullDiskIsTold) {
  const std::string take = patch_take();
  const test::SmallDisk disk(folder_.path() / "disk");
  if (!disk.mounted()) {
    GTEST_SKIP() << "mounting a small tmpfs needs root";
  }
  // All but a hundredth of it is taken.
  std::ofstream(file("disk/ballast")) << std::string(4150 * 1000, 'x');
  for (const auto& [format, ending] : kOneFile) {
    if (format == "csv" || format == "jsonl") {
      continue;  // a few kilobytes
    }
    const std::string name = file("disk/all." + ending);
    EXPECT_EQ(run({"export", take, "--format", format, "-o", name}), 6) << format << ": " << output_;
    EXPECT_THAT(output_,
                AllOf(HasSubstr("cannot write '"), HasSubstr("disk/all."), HasSubstr("No space left")));
    EXPECT_THAT(files_in("disk"), ElementsAre("ballast")) << format;
  }
  EXPECT_EQ(run({"export", take, "--format", "normal", "--size", "512", "-o", file("disk/maps")}), 6)
      << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("frame_000100.exr"), HasSubstr("No space left")));
  EXPECT_TRUE(files_in("disk/maps").empty());
}

TEST_F(Export, CurvesHaveTheColumnsOfLiveLinkFace) {
  auto subject = std::make_shared<mesh::Subject>(*test::patch_subject());
  subject->expression_names = {"jawOpen", "eyeLookOutLeft", "mouthLeft"};
  std::vector<mesh::MeshFrame> frames;
  for (std::uint64_t sequence = 59; sequence < 62; ++sequence) {
    frames.push_back(sequence == 60 ? test::searching_frame(sequence)
                                    : test::patch_frame(sequence, subject, nullptr));
    frames.back().media_time_ns = static_cast<std::int64_t>(sequence) * 16'683'350;  // 59.94 Hz
  }
  frames[0].expression = {0.25F, 1, 0.5F};
  // The head turned by 0.2 about the axis that goes up: to the subject's left.
  frames[0].camera_from_head.linear() = (Eigen::AngleAxisf(3.14159265F, Eigen::Vector3f::UnitX()) *
                                         Eigen::AngleAxisf(0.2F, Eigen::Vector3f::UnitY()))
                                            .toRotationMatrix();
  const std::string take = record("curves.take", frames);
  ASSERT_EQ(run({"export", take, "--format", "csv", "-o", file("curves.csv")}), 0) << output_;
  std::vector<std::vector<std::string>> table;
  std::ifstream stream(file("curves.csv"));
  for (std::string line; std::getline(stream, line);) {
    std::istringstream cells(line);
    table.emplace_back();
    for (std::string cell; std::getline(cells, cell, ',');) {
      table.back().push_back(cell);
    }
  }
  ASSERT_EQ(table.size(), 4U);
  for (const auto& row : table) {
    ASSERT_EQ(row.size(), 63U);
  }
  const auto value = [&](std::size_t row, const std::string& name) {
    const auto column = std::find(table[0].begin(), table[0].end(), name) - table[0].begin();
    EXPECT_LT(column, 63) << name;
    return std::stof(table.at(row).at(static_cast<std::size_t>(column)));
  };
  EXPECT_EQ(table[0][0], "Timecode");
  EXPECT_EQ(table[0][1], "BlendShapeCount");
  EXPECT_EQ(table[0][17], "JawRight");
  EXPECT_EQ(table[0][18], "JawLeft");
  EXPECT_EQ(table[0][53], "TongueOut");
  EXPECT_EQ(table[0][62], "RightEyeRoll");
  EXPECT_EQ(table[1][0], "00:00:00:00.000");
  EXPECT_EQ(table[3][0], "00:00:00:02.000");
  EXPECT_EQ(table[1][1], "61");
  EXPECT_NEAR(value(1, "JawOpen"), 0.25F, 1e-6F);
  EXPECT_NEAR(value(1, "MouthLeft"), 0.5F, 1e-6F);
  EXPECT_EQ(value(1, "MouthRight"), 0.0F);
  EXPECT_NEAR(value(1, "HeadYaw"), -0.2F, 1e-4F);
  EXPECT_NEAR(value(1, "HeadPitch"), 0.0F, 1e-4F);
  EXPECT_NEAR(value(1, "LeftEyeYaw"), -30 * 3.14159265F / 180, 1e-4F);
  EXPECT_EQ(value(1, "RightEyeYaw"), 0.0F);
  for (std::size_t column = 2; column < 63; ++column) {
    EXPECT_EQ(std::stof(table[2][column]), 0.0F) << "no face";
  }
}

/// Footage of a phone in the dusk: 8 frames a second, then 24; 12 on average.
std::int64_t dusk_ns(std::int64_t frame) {
  return 1'000'000'000 * (std::min(frame, std::int64_t{3}) * 3 + std::max(frame - 3, std::int64_t{0})) / 24;
}

/// Of those of seven frames that have a face.
const std::vector<float> kDuskTimes_s = {0, 3 / 24.0F, 6 / 24.0F, 10 / 24.0F, 11 / 24.0F, 12 / 24.0F};

TEST_F(Export, AVaryingRateKeepsTheSourcesTimes) {
  const std::string take = patch_take(dusk_ns);
  ASSERT_EQ(run({"export", take, "--format", "glb-frames", "-o", file("a.glb")}), 0) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("at a varying rate, on average 12 Hz"), Not(HasSubstr("warning"))));
  EXPECT_THAT(key_times_s("a.glb"), Pointwise(FloatNear(1e-6F), kDuskTimes_s));

  ASSERT_EQ(run({"export", take, "--format", "usda-frames", "-o", file("a.usda")}), 0) << output_;
  EXPECT_THAT(output_, Not(HasSubstr("warning")));
  const std::string usda = bytes_of("a.usda");
  EXPECT_THAT(usda, AllOf(HasSubstr("startTimeCode = 100\n"), HasSubstr("endTimeCode = 106\n"),
                          HasSubstr("timeCodesPerSecond = 12\n")));
  std::vector<double> codes;
  std::istringstream poses(usda.substr(usda.find("xformOp:transform.timeSamples")));
  std::string line;
  std::getline(poses, line);
  while (std::getline(poses, line) && line.find(": (") != std::string::npos) {
    codes.push_back(std::stod(line));
  }
  EXPECT_THAT(codes, Pointwise(DoubleNear(1e-6), std::vector<double>{100, 101.5, 103, 105, 105.5, 106}));

  ASSERT_EQ(run({"export", take, "--format", "csv", "-o", file("a.csv")}), 0) << output_;
  std::istringstream csv(bytes_of("a.csv"));
  std::vector<std::string> timecodes;
  while (std::getline(csv, line)) {
    timecodes.push_back(line.substr(0, line.find(',')));
  }
  EXPECT_THAT(timecodes,
              ElementsAre("Timecode", "00:00:00:00.000", "00:00:00:01.500", "00:00:00:03.000",
                          "00:00:00:04.500", "00:00:00:05.000", "00:00:00:05.500", "00:00:00:06.000"));

  // A cache has a sample for each number: that of frame 103, which has no face, lies between its neighbours.
  ASSERT_EQ(run({"export", take, "--format", "mdd", "-o", file("a.mdd")}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("is up to 0.083 s beside the source"));
  const std::string mdd = bytes_of("a.mdd");
  std::vector<float> expected_s = kDuskTimes_s;
  expected_s.insert(expected_s.begin() + 3, 8 / 24.0F);
  std::vector<float> times_s;
  for (std::size_t sample = 0; sample < 7; ++sample) {
    std::string big_endian = mdd.substr(8 + 4 * sample, 4);
    std::reverse(big_endian.begin(), big_endian.end());
    std::memcpy(&times_s.emplace_back(), big_endian.data(), 4);
  }
  EXPECT_THAT(times_s, Pointwise(FloatNear(1e-6F), expected_s));
}

TEST_F(Export, WhatHasNoTimesWarnsOfAVaryingRate) {
  const std::string take = patch_take(dusk_ns);
  const std::string steady = patch_take();
  for (const auto& [format, output] : {std::pair{"pc2", "a.pc2"}, {"obj", "meshes"}, {"normal", "maps"}}) {
    ASSERT_EQ(run({"export", take, "--format", format, "--size", "64", "-o", file(output)}), 0) << output_;
    EXPECT_THAT(output_,
                AllOf(HasSubstr("warning: the source's rate varies: '" + file(output) + "'"),
                      HasSubstr("12 Hz"), HasSubstr(format == std::string("pc2") ? "0.083 s" : "0.125 s")));
    ASSERT_EQ(run({"export", steady, "--format", format, "--size", "64", "-o", file(output)}), 0) << output_;
    EXPECT_THAT(output_, Not(HasSubstr("warning")));
  }
}

TEST_F(Export, ACamerasJitterIsNoVaryingRate) {
  // 12 ms early or late at 30 Hz; the ends are in time.
  const std::string take = patch_take([](std::int64_t frame) {
    return 1'000'000'000 * frame / 30 + (frame % 6 == 0 ? 0 : frame % 2 == 0 ? 12'000'000 : -12'000'000);
  });
  ASSERT_EQ(run({"export", take, "--format", "glb-frames", "-o", file("a.glb")}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("of the source at 30 Hz"));
  EXPECT_THAT(key_times_s("a.glb"), ElementsAre(0, static_cast<float>(1 / 30.0), static_cast<float>(2 / 30.0),
                                                static_cast<float>(4 / 30.0), static_cast<float>(5 / 30.0),
                                                static_cast<float>(6 / 30.0)));
}

/// The times of a performance on an avatar are those of the take's own export.
TEST_F(Export, RetargetingKeepsAVaryingRate) {
  nlohmann::ordered_json rig = {
      {"asset", {{"version", "2.0"}}},
      {"nodes", {{{"name", "head"}, {"mesh", 0}}}},
      {"meshes",
       {{{"primitives", {{{"targets", nlohmann::json::array({nlohmann::json::object()})}}}},
         {"extras", {{"targetNames", {"jawOpen"}}}}}}}};
  avatar::write_glb({std::move(rig), {}}, file("avatar.glb"));
  ASSERT_EQ(run({"retarget", patch_take(dusk_ns), "--rig", file("avatar.glb"), "--allow-missing", "-o",
                 file("anim.glb")}),
            0)
      << output_;
  EXPECT_THAT(key_times_s("anim.glb"), Pointwise(FloatNear(1e-6F), kDuskTimes_s));
}

TEST_F(Export, ExpressionsNeedTheTakesOwnModel) {
  const std::string take = patch_take();
  if (!std::filesystem::exists(test::default_model())) {
    GTEST_SKIP() << test::default_model() << " is not there: packaging/prepare makes it";
  }
  EXPECT_EQ(run({"export", take, "--format", "glb-expressions", "--model", test::default_model().string(),
                 "-o", file("a.glb")}),
            2);
  EXPECT_THAT(output_,
              AllOf(HasSubstr(take), HasSubstr("was not made with the model"), HasSubstr("--model")));
}

TEST_F(ExportPeers, KhronosValidatorFindsNothing) {
  const std::filesystem::path validator = test::assets() / "gltf-validator";
  if (program("node").empty() || !std::filesystem::exists(validator)) {
    GTEST_SKIP() << "Node.js or " << validator << " is not there (packaging/fetch-assets)";
  }
  export_all();
  const std::string take = file("some.take");
  ASSERT_EQ(run({"export", take, "--format", "glb", "--frames", "100:101", "-o", file("one.glb")}), 0)
      << output_;
  ASSERT_EQ(run({"export", take, "--format", "glb-frames", "--frames", "100:101", "-o", file("single.glb")}),
            0);
  std::vector<std::string> arguments = {script("check-glb.mjs"), validator.string()};
  for (const char* name : {"one.glb", "single.glb", "frames.glb", "expressions.glb"}) {
    if (std::filesystem::exists(file(name))) {
      arguments.push_back(file(name));
    }
  }
  EXPECT_EQ(run_node(arguments), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("frames.glb: 0 errors"));
}

/// golden/booth.take: `facet synth-booth --program stripes --seed 5 --slots 12 --samples 1 --resolution 0.5
/// --meshes none`, then `facet process --rig`. Meshes without expressions, with gaps between the blank slots.
TEST_F(ExportPeers, ABoothsTakeComesOutWhole) {
  const std::string take = script("golden/booth.take");
  for (const auto& [name, format] :
       {std::pair{"frames.glb", "glb-frames"}, {"face.usda", "usda-frames"}, {"cache.pc2", "pc2"}}) {
    ASSERT_EQ(run({"export", take, "--format", format, "--frames", "152:156", "-o", file(name)}), 0)
        << output_;
    EXPECT_THAT(output_, HasSubstr("2 frames, 152 to 155 of the source at 60 Hz, 36016 vertices"));
  }
  ASSERT_EQ(run({"export", take, "--format", "normal", "--size", "128", "--pictures", "png", "--frames",
                 "152:153", "-o", file("normal")}),
            0)
      << output_;
  EXPECT_EQ(test::png_head_of(file("normal/frame_000152.png")), (test::PngHead{128, 128, 16, true}));
  const auto map = files::read_image<std::uint16_t>(file("normal/frame_000152.png"));
  Eigen::Map<const Eigen::Array<std::uint16_t, 3, Eigen::Dynamic>> colours(map.values.data(), 3, 128 * 128);
  for (int channel = 0; channel < 3; ++channel) {
    const Eigen::ArrayXd values = colours.row(channel).cast<double>();
    EXPECT_GT(std::sqrt((values - values.mean()).square().mean()), 2000) << "a face looks to many sides";
  }
  write_truth(take, exports::MeshLevel::Finest, "truth");
  const std::string cache = bytes_of("cache.pc2");
  constexpr std::size_t kSample = 12 * 36016;
  ASSERT_EQ(cache.size(), 32 + 4 * kSample) << "152 to 155, those without a mesh held";
  for (const std::size_t index : {0U, 3U}) {
    const std::string truth = bytes_of(fmt::format("truth/frame_{:06}.f32", 152 + index));
    ASSERT_EQ(truth.size(), kSample);
    const auto floats = [](const std::string& from, std::size_t at) {
      Eigen::VectorXf out(kSample / 4);
      std::memcpy(out.data(), from.data() + at, kSample);
      return out;
    };
    EXPECT_LT((floats(cache, 32 + index * kSample) - floats(truth, 0)).cwiseAbs().maxCoeff(), 1e-6F) << "m";
  }
  const std::filesystem::path validator = test::assets() / "gltf-validator";
  const std::filesystem::path reader = test::assets() / "tinyusdz";
  if (program("node").empty() || !std::filesystem::exists(validator) || !std::filesystem::exists(reader)) {
    GTEST_SKIP() << "Node.js, " << validator << " or " << reader << " is not there (packaging/fetch-assets)";
  }
  EXPECT_EQ(run_node({script("check-glb.mjs"), validator.string(), file("frames.glb")}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("frames.glb: 0 errors"));
  for (const char* left_out : {"truth/frame_000158.f32", "truth/frame_000161.f32"}) {
    std::filesystem::remove(file(left_out));
  }
  EXPECT_EQ(run_node({script("check-usda.mjs"), std::filesystem::absolute(reader).string(), file("face.usda"),
                      file("truth")}),
            0)
      << output_;
}

TEST_F(ExportPeers, TinyUsdzReadsEveryVertex) {
  const std::filesystem::path reader = test::assets() / "tinyusdz";
  if (program("node").empty() || !std::filesystem::exists(reader)) {
    GTEST_SKIP() << "Node.js or " << reader << " is not there (packaging/fetch-assets)";
  }
  export_all();
  EXPECT_EQ(run_node({script("check-usda.mjs"), std::filesystem::absolute(reader).string(), file("face.usda"),
                      file("truth")}),
            0)
      << output_;
}

TEST_F(ExportPeers, ThreeReadsCompressedMeshes) {
  const auto three = std::filesystem::path(FACET_SOURCE_DIR) / "clients/kiosk/node_modules/three";
  const std::filesystem::path validator = test::assets() / "gltf-validator";
  if (program("node").empty() || !std::filesystem::exists(three) || !std::filesystem::exists(validator)) {
    GTEST_SKIP() << "Node.js, " << three << " (clients/kiosk/fetch-modules) or " << validator
                 << " (packaging/fetch-assets) is not there";
  }
  export_all();
  std::vector<std::string> validated = {script("check-glb.mjs"), validator.string()};
  const auto compare = [&](std::vector<std::string> arguments, const std::string& name,
                           const std::string& truth, const std::vector<std::string>& parts) {
    arguments.insert(arguments.begin(), "export");
    arguments.insert(arguments.end(), {"--compress", "meshopt", "-o", file("small-" + name)});
    ASSERT_EQ(run(arguments), 0) << output_;
    validated.push_back(file("small-" + name));
    std::vector<std::string> words = {script("check-meshopt.mjs"), three.string(), file("small-" + name),
                                      file(name), file(truth)};
    words.insert(words.end(), parts.begin(), parts.end());
    EXPECT_EQ(run_node(words), 0) << output_;
    std::cout << output_;
  };
  compare({file("some.take"), "--format", "glb-frames"}, "frames.glb", "truth", {});
  if (std::filesystem::exists(test::default_model())) {
    compare({file("person.take"), "--format", "glb-expressions", "--size", "256", "--model",
             test::default_model().string()},
            "expressions.glb", "coarse", {file("parts")});
  }
  EXPECT_EQ(run_node(validated), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("small-frames.glb: 0 errors"));
  // Where it means nothing it is refused.
  EXPECT_EQ(run({"export", file("some.take"), "--format", "usda", "--compress", "meshopt", "-o",
                 file("small.usda")}),
            2);
  EXPECT_THAT(output_, HasSubstr("--compress is for glb-frames and glb-expressions, not for usda"));
}

TEST_F(ExportPeers, BlenderImportsEveryVertex) {
  if (program("blender").empty()) {
    GTEST_SKIP() << "Blender is not installed (apt-get install blender)";
  }
  export_all();
  const char* pictures = std::getenv("FACET_EXPORT_PICTURES");  // a folder for renders of what was imported
  std::vector<std::string> arguments = {"--background",
                                        "--factory-startup",
                                        "--python-exit-code",
                                        "1",
                                        "--python",
                                        script("check-blender.py"),
                                        "--",
                                        folder_.path().string()};
  if (pictures != nullptr) {
    arguments.emplace_back(pictures);
  }
  EXPECT_EQ(run(program("blender"), arguments), 0) << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("frames.glb: 6 frames"), HasSubstr("cache.pc2: 6 frames"),
                             HasSubstr("cache.mdd: 6 frames"), HasSubstr("all as it should be")));
  std::cout << output_;
}

TEST_F(ExportPeers, RetargetedAvatarsAreValid) {
  if (!std::filesystem::exists(test::default_model())) {
    GTEST_SKIP() << test::default_model() << " is not there: packaging/prepare makes it";
  }
  const std::string model = test::default_model().string();
  const std::string person = model_take(face::FaceModel::load(model), 7);
  // Somebody else is the avatar.
  const std::string other = std::filesystem::path(person).replace_filename("other.take").string();
  std::filesystem::rename(person, other);
  ASSERT_EQ(run({"export", other, "--format", "glb-expressions", "--model", model, "--frames", "100:101",
                 "-o", file("avatar.glb")}),
            0)
      << output_;
  const std::string take = model_take(face::FaceModel::load(model), 8);
  ASSERT_EQ(run({"retarget", take, "--rig", file("avatar.glb"), "-o", file("anim.glb")}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("4 frames, 0.10 s, 3 meshes"));
  EXPECT_EQ(run({"retarget", take, "--rig", file("avatar.glb"), "--neutral", "101", "--no-head", "-o",
                 file("still.glb")}),
            0)
      << output_;

  const std::filesystem::path validator = test::assets() / "gltf-validator";
  if (program("node").empty() || !std::filesystem::exists(validator)) {
    GTEST_SKIP() << "Node.js or " << validator << " is not there (packaging/fetch-assets)";
  }
  EXPECT_EQ(run_node({script("check-glb.mjs"), validator.string(), file("anim.glb"), file("still.glb")}), 0)
      << output_;
  EXPECT_THAT(output_, HasSubstr("2 animations"));
}

/// The avatar is the take's own face with its own texture coordinates: its maps are those of the take.
TEST_F(Export, MapsOfAnAvatarThatIsThePersonAreTheTakesOwn) {
  if (!std::filesystem::exists(test::default_model())) {
    GTEST_SKIP() << test::default_model() << " is not there: packaging/prepare makes it";
  }
  const std::string model = test::default_model().string();
  for (const std::uint32_t seed : {7U, 8U, 9U}) {
    const std::string name = fmt::format("seed{}", seed);
    const std::string take = std::filesystem::path(file(name + ".take")).string();
    std::filesystem::rename(model_take(face::FaceModel::load(model), seed), take);
    ASSERT_EQ(run({"export", take, "--format", "glb-expressions", "--model", model, "--frames", "100:101",
                   "-o", file(name + ".glb")}),
              0)
        << output_;
    ASSERT_EQ(run({"export", take, "--format", "displacement", "--pictures", "png", "--size", "512",
                   "--frames", "101:102", "-o", file(name + "-own")}),
              0)
        << output_;
    ASSERT_EQ(run({"retarget", take, "--rig", file(name + ".glb"), "--model", model, "--frames", "101:102",
                   "--displacement-maps", file(name + "-maps"), "--normal-maps", file(name + "-normals"),
                   "--pictures", "png", "--size", "512", "-o", file(name + "-anim.glb")}),
              0)
        << output_;
    EXPECT_THAT(output_, HasSubstr("100 % of the face covered; 1 mm of the maps is 0.001 of its units"));
    for (const char* kind : {"-own", "-maps", "-normals"}) {
      const bool colour = kind == std::string("-normals");
      EXPECT_EQ(test::png_head_of(file(name + kind + "/frame_000101.png")),
                (test::PngHead{512, 512, 16, colour}));
    }
    const auto own = files::read_image<std::uint16_t>(file(name + "-own/frame_000101.png"));
    const auto maps = files::read_image<std::uint16_t>(file(name + "-maps/frame_000101.png"));
    int relief = 0;
    int others = 0;
    int bare = 0;
    for (std::size_t i = 0; i < own.values.size(); i += 3) {
      constexpr std::uint16_t kNothing = 32768;
      constexpr float kStep_mm = 2 * exports::kDisplacementRange_mm / 65535;
      const float truth_mm = kStep_mm * (static_cast<float>(own.values[i]) - 32767.5F);
      const float made_mm = kStep_mm * (static_cast<float>(maps.values[i]) - 32767.5F);
      relief += std::abs(truth_mm) > 0.1F ? 1 : 0;
      const bool is_bare = maps.values[i] == kNothing;
      bare += std::abs(truth_mm) > 0.1F && is_bare ? 1 : 0;
      others += std::abs(truth_mm - made_mm) > 0.05F && !is_bare ? 1 : 0;
    }
    EXPECT_GT(relief, 10'000);
    EXPECT_LT(bare, relief / 8) << "the eyeballs, which are meshes of their own";
    // Lids and lips, where skin lies on skin; what eyeLook shapes move are the lids alone on the avatar.
    EXPECT_LT(others, relief / 30) << "seed " << seed;
  }
}

TEST_F(Export, AnAvatarWithoutTheShapesIsTold) {
  const std::string take = patch_take();  // moves jawOpen, eyeBlinkLeft and mouthSmileRight
  ASSERT_EQ(run({"export", take, "--format", "glb-frames", "-o", file("frames.glb")}), 0) << output_;
  EXPECT_EQ(run({"retarget", take, "--rig", file("frames.glb"), "-o", file("anim.glb")}), 2);
  EXPECT_THAT(output_, AllOf(HasSubstr("frames.glb' lacks 3 shapes"),
                             HasSubstr("eyeBlinkLeft, jawOpen, mouthSmileRight"),
                             HasSubstr("are: frame_000101, frame_000102")));
  EXPECT_THAT(output_, testing::Not(HasSubstr("--no-head"))) << "it has a head";
  ASSERT_EQ(run({"export", take, "--format", "glb", "--frames", "101:102", "-o", file("still.glb")}), 0);
  EXPECT_EQ(run({"retarget", take, "--rig", file("still.glb"), "-o", file("anim.glb")}), 2);
  EXPECT_THAT(output_, AllOf(HasSubstr("no node that is named like a head"), HasSubstr("lacks 3 shapes")))
      << "all at once";
  EXPECT_EQ(run({"retarget", take, "--rig", take, "-o", file("anim.glb")}), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr(take), HasSubstr("it is no GLB file")));
  EXPECT_EQ(run({"retarget", take, "--rig", file("frames.glb"), "--head", "Kopf", "-o", file("anim.glb")}),
            2);
  EXPECT_THAT(output_, HasSubstr("no node 'Kopf'; it has 'head'"));
  EXPECT_FALSE(std::filesystem::exists(file("anim.glb")));
}

}  // namespace
}  // namespace facet::exports
