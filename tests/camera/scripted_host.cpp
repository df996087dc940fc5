// A camera host whose camera does what its id says, for the tests of contained cameras:
//   ACTION[:FRAME[:FILE]]   it does it instead of frame FRAME (0: the first); with a FILE it does it once and
//   is
//                           well from then on, because it makes that file first
// The pixels of frame n are n % 251, its exposure begins when it is asked for.

#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "camera/device_fault.hpp"
#include "camera/host_process.hpp"
#include "camera/host_protocol.hpp"
#include "camera/host_service.hpp"

namespace facet::test {
namespace {

using namespace std::chrono_literals;
using camera::DeviceFault;
using camera::HostMessage;

[[noreturn]] void hang() {
  for (;;) {
    std::this_thread::sleep_for(1h);
  }
}

/// Ends with the signal even where a sanitizer would answer it.
void crash() {
  std::signal(SIGSEGV, SIG_DFL);
  ::raise(SIGSEGV);
}

void send_bytes(const void* bytes, std::size_t size) {
  ::send(camera::kHostSocket, bytes, size, MSG_NOSIGNAL);
}

/// Sends a message as the host would, changed by `change`.
void send_message(const std::function<void(HostMessage&)>& change) {
  HostMessage message;
  message.kind = HostMessage::Kind::Frame;
  message.sequence = 1;
  message.timestamp_ns = camera::monotonic_ns();
  change(message);
  std::array<std::uint8_t, camera::kMaxHostMessage_bytes> bytes;
  send_bytes(bytes.data(), write_host_message(message, bytes));
}

class ScriptedCamera final : public Camera {
 public:
  explicit ScriptedCamera(const camera::CameraConfig& config) : config_(config) {
    std::istringstream words(config.libcamera.id);
    std::getline(words, action_, ':');
    std::string frame;
    if (std::getline(words, frame, ':')) {
      at_ = std::stoull(frame);
    }
    std::getline(words, once_);
    if (action_ == "absent") {
      throw DeviceFault(DeviceFault::Kind::Absent, "is not plugged in");
    }
    if (action_ == "unsuitable") {
      throw DeviceFault(DeviceFault::Kind::Unsuitable, "source.rate_hz = 30: the camera takes 5 to 25");
    }
    if (action_ == "hang-open" && due(0)) {
      hang();
    }
    if (action_ == "slow-open") {
      std::this_thread::sleep_for(500ms);
    }
    if (action_ == "crash-open" && due(0)) {
      std::abort();
    }
  }

  CameraInfo info() const override {
    CameraInfo info;
    info.name = "scripted \x1b[31m camera";
    return info;
  }
  CameraStatus status() const override { return status_; }
  void start() override {
    status_.state = CameraState::Streaming;
    if (!once_.empty() && action_ == "tell-pid") {
      std::ofstream(once_) << ::getpid();
    }
  }
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    if (silent_ || (sequence_ == at_ && due(at_))) {
      return misbehave(out, timeout);
    }
    std::this_thread::sleep_for(2ms);
    out.corrupt = false;
    return deliver(out);
  }
  void stop() override {}
  std::string last_error() const override { return status_.reason; }

 private:
  bool due(std::uint64_t frame) {
    if (frame != at_ || (!once_.empty() && std::filesystem::exists(once_))) {
      return false;
    }
    if (!once_.empty()) {
      std::ofstream made(once_);
    }
    return true;
  }

  CaptureOutcome deliver(Frame& out) {
    out.sequence = sequence_++;
    out.timestamp_ns = camera::monotonic_ns();
    out.width_px = config_.live.width_px;
    out.height_px = config_.live.height_px;
    out.stride_bytes = std::size_t{4} * static_cast<std::size_t>(out.width_px);
    const std::size_t size = out.stride_bytes * static_cast<std::size_t>(out.height_px);
    std::shared_ptr<std::uint8_t[]> pixels(new std::uint8_t[size]);
    std::memset(pixels.get(), static_cast<int>(out.sequence % 251), size);
    out.pixels = std::move(pixels);
    ++status_.counters.delivered;
    status_.counters.damaged += out.corrupt ? 1 : 0;
    return CaptureOutcome::Delivered;
  }

  CaptureOutcome misbehave(Frame& out, std::chrono::milliseconds timeout);

  camera::CameraConfig config_;
  std::string action_;
  std::uint64_t at_ = 0;
  std::string once_;
  std::uint64_t sequence_ = 0;
  bool silent_ = false;
  CameraStatus status_;
};

CaptureOutcome ScriptedCamera::misbehave(Frame& out, std::chrono::milliseconds timeout) {
  const std::map<std::string, std::function<void()>> actions = {
      {"segv", [] { crash(); }},
      {"abort", [] { std::abort(); }},
      {"exit", [] { std::_Exit(3); }},
      {"hang", [] { hang(); }},
      {"stop", [] { ::raise(SIGSTOP); }},
      {"close",
       [] {
         ::shutdown(camera::kHostSocket, SHUT_RDWR);
         hang();
       }},
      {"garbage",
       [] {
         send_bytes("no message", 10);
         hang();
       }},
      {"huge",
       [] {
         send_bytes(std::vector<char>(100'000).data(), 100'000);
         hang();
       }},
      {"unasked",
       [] {
         send_message([](HostMessage&) {});
         send_message([](HostMessage&) {});
         hang();
       }},
      {"again",
       [this] {
         send_message([&](HostMessage& m) { m.sequence = sequence_ - 1; });
         hang();
       }},
      {"far",
       [] {
         send_message([](HostMessage& m) { m.sequence = ~0ULL; });
         hang();
       }},
      {"future",
       [this] {
         send_message([&](HostMessage& m) {
           m.sequence = sequence_;
           m.timestamp_ns += 3'600'000'000'000;
         });
         hang();
       }},
      {"torn",
       [this] {
         send_message([&](HostMessage& m) { m.sequence = sequence_; });
         hang();
       }},
      {"backwards",
       [] {
         send_message([](HostMessage& m) {
           m.kind = HostMessage::Kind::Alive;
           m.counters.lost = 7;
         });
         send_message([](HostMessage& m) {
           m.kind = HostMessage::Kind::Alive;
           m.counters.lost = 6;
         });
         hang();
       }},
      {"list",
       [] {
         send_message([](HostMessage& m) { m.kind = HostMessage::Kind::Listed; });
         hang();
       }},
      // A grandchild must not outlive the camera, nor keep the socket open.
      {"fork",
       [this] {
         if (const pid_t child = ::fork(); child == 0) {
           hang();
         } else {
           std::ofstream(once_) << child;
           crash();
         }
       }},
  };
  if (const auto found = actions.find(action_); found != actions.end()) {
    found->second();
  }
  if (action_ == "silent") {
    silent_ = true;
    std::this_thread::sleep_for(timeout);
    return CaptureOutcome::Timeout;
  }
  if (action_ == "unplug") {
    status_.state = CameraState::Absent;
    status_.reason = "was unplugged";
    return CaptureOutcome::Timeout;
  }
  if (action_ == "fail") {
    status_.reason = "the sensor is too hot";
    return CaptureOutcome::Failed;
  }
  if (action_ == "damage") {
    out.corrupt = true;
    status_.counters.lost += 4;
    sequence_ += 4;
    return deliver(out);
  }
  if (action_ == "wrong-size") {
    config_.live.width_px *= 4;
    config_.live.height_px *= 4;
  }
  return deliver(out);
}

std::unique_ptr<Camera> open(const camera::CameraConfig& config) {
  return std::make_unique<ScriptedCamera>(config);
}

/// What there is to list is in the environment, which a parent hands on.
std::vector<camera::CameraListing> list() {
  const char* how = std::getenv("FACET_TEST_LIST");
  const std::string wanted = how == nullptr ? "" : how;
  if (wanted == "hang") {
    hang();
  }
  if (wanted == "crash") {
    std::abort();
  }
  if (wanted == "fail") {
    throw DeviceFault(DeviceFault::Kind::Failing, "libcamera does not start");
  }
  if (wanted == "endless") {
    return std::vector<camera::CameraListing>(100'000, {"camera", "again"});
  }
  return {{"one", "a camera"}, {"two", "another"}};
}

}  // namespace
}  // namespace facet::test

int main(int argc, char** argv) {
  if (const char* starts = std::getenv("FACET_TEST_STARTS")) {
    std::ofstream(starts, std::ios::app) << '.';
  }
  return facet::camera::run_camera_host(argc, argv, {facet::test::open, facet::test::list});
}
