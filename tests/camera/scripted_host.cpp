// A camera host whose camera does what its id says, for the tests of contained cameras:
//   ACTION[:FRAME[:FILE]]   it does it instead of frame FRAME (0: the first); with a FILE it does it once and
//                           is well from then on, because it writes into that file first
// The pixels of frame n are n % 251, its exposure begins when it is asked for.

#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "camera/device_fault.hpp"
#include "camera/host_process.hpp"
#include "camera/host_protocol.hpp"
#include "camera/host_sandbox.hpp"
#include "camera/host_service.hpp"
#include "escapes.hpp"
#include "facet/clock.hpp"

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
  message.timestamp_ns = Clock::now_ns();
  change(message);
  std::array<std::uint8_t, camera::kMaxHostMessage_bytes> bytes;
  send_bytes(bytes.data(), write_host_message(message, bytes));
}

struct Script {
  explicit Script(const std::string& id) {
    std::istringstream words(id);
    std::getline(words, action, ':');
    std::string frame;
    if (std::getline(words, frame, ':')) {
      at = std::stoull(frame);
    }
    std::getline(words, file);
  }
  std::string action;
  std::uint64_t at = 0;
  std::string file;
};

/// The script's file, open from before the host is confined; -1 where it has none.
int marker = -1;

bool is_marked() {
  struct stat status {};
  return ::fstat(marker, &status) == 0 && status.st_size > 0;
}

void mark(const std::string& text) {
  if (::ftruncate(marker, 0) != 0 || ::pwrite(marker, text.data(), text.size(), 0) < 0) {
    std::abort();
  }
}

/// Whether the kernel keeps files from this process once it is confined, which can't ask then.
bool files_guarded = false;

/// What of all that a host must not do this one could do.
std::string escaped() {
  const char* folder = std::getenv("FACET_TEST_FOLDER");
  const char* port = std::getenv("FACET_TEST_PORT");
  std::vector<std::string> done;
  for (const Escape& escape : escapes({folder, std::atoi(port)})) {
    const bool guarded = escape.guard != Escape::Guard::Files || files_guarded;
    if (guarded && escape.attempt()) {
      done.push_back(escape.name);
    }
  }
  return done.empty() ? "it could do nothing of it" : fmt::format("it could {}", fmt::join(done, ", "));
}

class ScriptedCamera final : public Camera {
 public:
  explicit ScriptedCamera(const camera::CameraConfig& config)
      : config_(config), script_(config.libcamera.id), action_(script_.action), at_(script_.at) {
    if (action_ == "escape") {
      throw DeviceFault(DeviceFault::Kind::Failing, escaped());
    }
    if (action_ == "alive-before") {
      send_message([](HostMessage& m) { m.kind = HostMessage::Kind::Alive; });
      hang();
    }
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
    if (action_ == "child") {
      crash();
    }
    if (action_ == "tell-pid") {
      mark(std::to_string(::getpid()));
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
    if (frame != at_ || is_marked()) {
      return false;
    }
    if (marker >= 0) {
      mark("done");
    }
    return true;
  }

  CaptureOutcome deliver(Frame& out) {
    out.sequence = sequence_++;
    out.timestamp_ns = Clock::now_ns();
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

  std::map<std::string, std::function<void()>> actions() const;
  CaptureOutcome misbehave(Frame& out, std::chrono::milliseconds timeout);

  camera::CameraConfig config_;
  Script script_;
  std::string action_;
  std::uint64_t at_ = 0;
  std::uint64_t sequence_ = 0;
  bool silent_ = false;
  CameraStatus status_;
};

/// What the process does in place of an answer; of most of it no answer comes.
std::map<std::string, std::function<void()>> ScriptedCamera::actions() const {
  return {
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
      {"open-again",
       [] {
         send_message([](HostMessage& m) { m.kind = HostMessage::Kind::Opened; });
         hang();
       }},
      {"flood",
       [] {
         for (;;) {
           send_message([](HostMessage& m) { m.kind = HostMessage::Kind::Alive; });
         }
       }},
  };
}

CaptureOutcome ScriptedCamera::misbehave(Frame& out, std::chrono::milliseconds timeout) {
  const auto all = actions();
  if (const auto found = all.find(action_); found != all.end()) {
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

/// What the script needs that a confined process can't have.
void prepare(const Script& script) {
  files_guarded = camera::files_unguarded().empty();
  if (!script.file.empty()) {
    marker = ::open(script.file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  }
  // A child, as a library may have one that it started when it was loaded, must not outlive the camera nor
  // keep its socket open.
  if (script.action == "child") {
    if (const pid_t child = ::fork(); child == 0) {
      hang();
    } else {
      mark(std::to_string(child));
    }
  }
}

}  // namespace
}  // namespace facet::test

#ifdef FACET_SANITIZED
// Looking for leaks takes what a confined process can't do: a second process that stops the first.
// NOLINTNEXTLINE(bugprone-reserved-identifier): the name that the sanitizer looks for
extern "C" int __lsan_is_turned_off() {
  return 1;
}
#endif

int main(int argc, char** argv) {
  if (const char* starts = std::getenv("FACET_TEST_STARTS")) {
    std::ofstream(starts, std::ios::app) << '.';
  }
  for (int i = 1; i < argc; ++i) {
    if (const std::string_view word = argv[i]; word.starts_with("--id=")) {
      facet::test::prepare(facet::test::Script(std::string(word.substr(5))));
    }
  }
  return facet::camera::run_camera_host(argc, argv, {facet::test::open, facet::test::list, {}});
}
