#pragma once

#include <chrono>
#include <filesystem>
#include <thread>
#include <utility>

#include "service/control_server.hpp"

namespace facet::test {

/// A daemon's control socket: what it answers is the test's.
class Answering {
 public:
  Answering(const std::filesystem::path& socket, service::ControlMethods methods)
      : server_(config(socket), std::move(methods)) {}

 private:
  static service::ControlConfig config(const std::filesystem::path& socket) {
    service::ControlConfig config;
    config.socket = socket;
    return config;
  }

  service::ControlServer server_;
  std::jthread thread_{[this](const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      server_.serve();
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
  }};
};

}  // namespace facet::test
