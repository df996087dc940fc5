#pragma once

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <numeric>
#include <random>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "avatar/glb_document.hpp"
#include "exports/export.hpp"
#include "face/face_model.hpp"
#include "support/child_process.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::exports {

using test::Birth;
using test::ChildProcess;

/// Formats that any take can be written in, and how their files end.
inline const std::vector<std::pair<std::string, std::string>> kOneFile = {
    {"glb-frames", "glb"}, {"usda-frames", "usda"}, {"pc2", "pc2"},
    {"mdd", "mdd"},        {"csv", "csv"},          {"jsonl", "jsonl"}};

/// Where a program of $PATH lies; empty where it does not.
inline std::string program(const std::string& name) {
  std::istringstream folders(std::getenv("PATH"));
  for (std::string folder; std::getline(folders, folder, ':');) {
    if (std::filesystem::exists(folder + "/" + name)) {
      return folder + "/" + name;
    }
  }
  return {};
}

/// `facet export` run in a folder of its own.
class Export : public ::testing::Test {
 protected:
  int run(const std::string& what, const std::vector<std::string>& arguments, const Birth& birth = {}) {
    ChildProcess child(what, arguments, folder_.path() / "log", birth);
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  int run(const std::vector<std::string>& arguments, const Birth& birth = {}) {
    return run(FACET_PROGRAM, arguments, birth);
  }
  static std::string script(const std::string& name) {
    return (std::filesystem::path(FACET_SOURCE_DIR) / "tests" / "exports" / name).string();
  }
  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }

  std::string record(const std::string& name, const std::vector<mesh::MeshFrame>& frames) const {
    take::TakeRecorderConfig config;
    config.file = file(name);
    config.source = "elsewhere.mp4";
    config.software = "test";
    config.when_full = take::WhenFull::Wait;
    config.disk_reserve_bytes = 0;
    take::TakeRecorder recorder(config);
    recorder.start();
    for (const mesh::MeshFrame& frame : frames) {
      recorder.record(std::make_shared<mesh::MeshFrame>(frame));
    }
    EXPECT_EQ(recorder.stop().state, take::RecorderState::Finished);
    return file(name);
  }

  /// Frames 100 to 106 of the source at 30 Hz; 103 has no face.
  std::string patch_take() const {
    const auto subject = test::patch_subject();
    const auto albedo = test::patch_albedo(*subject);
    std::vector<mesh::MeshFrame> frames;
    for (std::uint64_t sequence = 100; sequence < 107; ++sequence) {
      frames.push_back(sequence == 103 ? test::searching_frame(sequence)
                                       : test::patch_frame(sequence, subject, albedo));
    }
    return record("some.take", frames);
  }

  /// The same, but each frame's media time is changed.
  std::string patch_take(const std::function<std::int64_t(std::int64_t frame)>& media_time_ns) const {
    const auto subject = test::patch_subject();
    std::vector<mesh::MeshFrame> frames;
    for (std::int64_t frame = 0; frame < 7; ++frame) {
      const auto sequence = static_cast<std::uint64_t>(100 + frame);
      frames.push_back(frame == 3 ? test::searching_frame(sequence)
                                  : test::patch_frame(sequence, subject, nullptr));
      frames.back().media_time_ns = media_time_ns(frame);
    }
    return record("timed.take", frames);
  }

  /// Of the last animation of a GLB, seconds.
  std::vector<float> key_times_s(const std::string& name) const {
    const avatar::GlbDocument glb = avatar::read_glb(file(name));
    const auto& sampler = glb.json["animations"].back()["samplers"][0];
    const auto& accessor = glb.json["accessors"][sampler["input"].get<std::size_t>()];
    const auto& view = glb.json["bufferViews"][accessor["bufferView"].get<std::size_t>()];
    std::vector<float> times_s(accessor["count"].get<std::size_t>());
    const auto offset =
        view.value("byteOffset", std::size_t{0}) + accessor.value("byteOffset", std::size_t{0});
    EXPECT_LE(offset + 4 * times_s.size(), glb.binary.size());
    std::memcpy(times_s.data(), glb.binary.data() + offset, 4 * times_s.size());
    return times_s;
  }

  std::string bytes_of(const std::string& name) const {
    std::ifstream in(file(name), std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  }

  /// A person of the default model who moves all expressions and the head, frames 100 to 103 of the source.
  std::string model_take(const face::FaceModel& model, std::uint32_t seed) const {
    const auto count = static_cast<std::size_t>(model.vertex_count());
    mesh::HierarchyOptions options;
    options.max_levels = 1;
    auto subject = std::make_shared<mesh::Subject>();
    subject->id = seed;
    subject->hierarchy =
        mesh::build_hierarchy(model.control, mesh::TextureCoordinates::Zero(2, model.vertex_count()),
                              std::vector<std::uint8_t>(count, 0), options);
    subject->expression_names = model.expression_names;
    subject->regions = model.regions;
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> uniform(0, 1);
    for (int i = 0; i < model.identity_count(); ++i) {
      subject->identity.push_back(2 * uniform(random) - 1);
    }
    auto albedo = std::make_shared<mesh::Albedo>();
    albedo->version = 1;
    mesh::Vertices colours = model.mean_albedo;
    for (const mesh::Level& level : subject->hierarchy->levels) {
      mesh::apply(level.from_coarser, mesh::Vertices(colours), colours);
    }
    albedo->linear_rgb.assign(colours.data(), colours.data() + colours.size());
    std::vector<mesh::MeshFrame> frames;
    for (std::uint64_t sequence = 100; sequence < 104; ++sequence) {
      mesh::MeshFrame frame = test::searching_frame(sequence);
      frame.state = mesh::TrackingState::Tracking;
      frame.subject = subject;
      for (int i = 0; i < model.expression_count(); ++i) {
        frame.expression.push_back(uniform(random) * uniform(random));
      }
      model.evaluate(subject->identity, frame.expression, frame.control_vertices_mm);
      frame.albedo = albedo;
      const mesh::TextureCoordinates& uv = subject->hierarchy->texture_coordinates;
      for (Eigen::Index v = 0; v < uv.cols(); ++v) {
        frame.displacements_mm.push_back(std::sin(80 * uv(0, v)) * std::cos(60 * uv(1, v)));
      }
      frame.camera_from_head.linear() =
          (Eigen::AngleAxisf(3.14159265F, Eigen::Vector3f::UnitX()) *
           Eigen::AngleAxisf(uniform(random) - 0.5F, Eigen::Vector3f(0.3F, 0.9F, 0.1F).normalized()))
              .toRotationMatrix();
      frame.camera_from_head.translation() << 20 * uniform(random), 10, 600;
      frames.push_back(frame);
    }
    return record("person.take", frames);
  }

  /// What the exports of a take should show: a file of floats for every frame with a mesh.
  void write_truth(const std::string& take_file, exports::MeshLevel level, const std::string& folder) const {
    std::filesystem::create_directories(file(folder));
    take::TakeReader reader(take_file);
    exports::ExportMesh mesh;
    for (std::int64_t index = 0; index < reader.frame_count(); ++index) {
      const auto frame = reader.frame(index);
      if (!mesh::has_mesh(*frame)) {
        continue;
      }
      exports::build_export_mesh(*frame, level, exports::MeshSpace::Camera, mesh);
      const mesh::Vertices upright_m =
          Eigen::Vector3f(0.001F, -0.001F, -0.001F).asDiagonal() * mesh.vertices_mm;
      std::ofstream(file(fmt::format("{}/frame_{:06}.f32", folder, frame->sequence)), std::ios::binary)
          .write(reinterpret_cast<const char*>(upright_m.data()),
                 static_cast<std::streamsize>(sizeof(float)) * upright_m.size());
    }
  }

  /// What moves a take's shapes, for scripts: curves.json {"names": [...], "weights": {"FRAME": [...]}}.
  void write_curves(const std::string& take_file) const {
    take::TakeReader reader(take_file);
    nlohmann::json curves;
    for (std::int64_t index = 0; index < reader.frame_count(); ++index) {
      const auto frame = reader.frame(index);
      curves["names"] = frame->subject->expression_names;
      curves["weights"][std::to_string(frame->sequence)] = mesh::shape_weights(*frame);
    }
    std::ofstream(file("curves.json")) << curves;
  }

  /// Which vertices of the coarse mesh are of which node in a GLB of expressions, by the model's regions and
  /// what triangles join: parts/head.i32, eyeLeft.i32, eyeRight.i32.
  void write_parts(const std::string& take_file) const {
    take::TakeReader reader(take_file);
    const auto frame = reader.frame(0);
    const mesh::Triangles& triangles = frame->subject->hierarchy->levels.front().triangles;
    std::vector<std::int32_t> piece(
        static_cast<std::size_t>(frame->subject->hierarchy->levels.front().vertex_count));
    std::iota(piece.begin(), piece.end(), 0);
    const auto at = [&](std::int32_t vertex) -> std::int32_t& {
      return piece[static_cast<std::size_t>(vertex)];
    };
    for (bool changed = true; changed;) {
      changed = false;
      for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
        const Eigen::Vector3i corners = triangles.col(t);
        const std::int32_t least = std::min({at(corners[0]), at(corners[1]), at(corners[2])});
        for (const std::int32_t corner : corners) {
          changed = changed || at(corner) != least;
          at(corner) = least;
        }
      }
    }
    std::set<std::int32_t> with_skin;
    for (std::size_t v = 0; v < frame->subject->regions.size(); ++v) {
      if (!face::has_region(frame->subject->regions[v], face::Region::Eye)) {
        with_skin.insert(piece[v]);
      }
    }
    std::array<std::vector<std::int32_t>, 3> parts;
    for (std::size_t v = 0; v < piece.size(); ++v) {
      const bool left = frame->control_vertices_mm(0, piece[v]) > 0;
      parts.at(with_skin.contains(piece[v]) ? 0 : left ? 1 : 2).push_back(static_cast<std::int32_t>(v));
    }
    std::filesystem::create_directories(file("parts"));
    for (const auto& [index, name] : {std::pair{0U, "head"}, {1U, "eyeLeft"}, {2U, "eyeRight"}}) {
      EXPECT_GT(parts.at(index).size(), 50U) << name;
      std::ofstream(file(fmt::format("parts/{}.i32", name)), std::ios::binary)
          .write(reinterpret_cast<const char*>(parts.at(index).data()),
                 static_cast<std::streamsize>(4 * parts.at(index).size()));
    }
  }

  std::vector<std::string> files_in(const std::string& name) const {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(file(name))) {
      names.push_back(entry.path().filename().string());
    }
    std::sort(names.begin(), names.end());
    return names;
  }

  test::TemporaryFolder folder_;
  std::string output_;
};

/// The same as others read it.
class ExportPeers : public Export {
 protected:
  /// Runs a script as the oldest Node.js that counts does, Debian's 18: newer ones are told not to guess
  /// which files are modules.
  int run_node(std::vector<std::string> arguments) {
    const std::vector<std::string> as_old = {"--no-experimental-detect-module",
                                             "--no-experimental-require-module"};
    for (const std::string& option : as_old) {
      if (run(program("node"), {option, "--eval", "0"}) == 0) {
        arguments.insert(arguments.begin(), option);
      }
    }
    return run(program("node"), arguments);
  }
  void export_all() {
    const std::string take = patch_take();
    for (const auto& [name, format] : {std::pair{"frames.glb", "glb-frames"},
                                       {"face.usda", "usda-frames"},
                                       {"cache.pc2", "pc2"},
                                       {"cache.mdd", "mdd"}}) {
      ASSERT_EQ(run({"export", take, "--format", format, "-o", file(name)}), 0) << output_;
    }
    write_truth(take, exports::MeshLevel::Finest, "truth");
    if (std::filesystem::exists(test::default_model())) {
      const face::FaceModel model = face::FaceModel::load(test::default_model());
      const std::string person = model_take(model, 20260301);
      for (const auto& [name, format] : {std::pair{"expressions.glb", "glb-expressions"},
                                         {"expressions.fbx", "fbx"},
                                         {"expressions.usda", "usda"}}) {
        ASSERT_EQ(run({"export", person, "--format", format, "--size", "256", "--model",
                       test::default_model().string(), "-o", file(name)}),
                  0)
            << output_;
      }
      write_truth(person, exports::MeshLevel::Coarse, "coarse");
      write_curves(person);
      write_parts(person);
    }
  }
};

}  // namespace facet::exports
