#include "camera/contained_camera.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "camera/host_process.hpp"
#include "camera/host_protocol.hpp"
#include "camera/host_sandbox.hpp"
#include "escapes.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "support/paths.hpp"

namespace facet::test {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr auto kPatience = 60s;

std::size_t open_descriptors() {
  const std::filesystem::directory_iterator open("/proc/self/fd");
  return static_cast<std::size_t>(std::distance(begin(open), end(open))) - 1;  // the folder itself
}

long resident_kb() {
  long pages = 0;
  long resident = 0;
  std::ifstream("/proc/self/statm") >> pages >> resident;
  return resident * (::sysconf(_SC_PAGESIZE) / 1024);
}

/// Whether a process runs; a zombie does not.
bool runs(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/stat");
  std::string stat((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  const std::size_t name_end = stat.rfind(')');
  return name_end != std::string::npos && stat.at(name_end + 2) != 'Z';
}

bool eventually(const std::function<bool()>& holds) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (!holds()) {
    if (std::chrono::steady_clock::now() > end) {
      return false;
    }
    std::this_thread::sleep_for(5ms);
  }
  return true;
}

class ContainedCamera : public ::testing::Test {
 protected:
  ContainedCamera() {
    config_.kind = "scripted";
    config_.live.width_px = 34;
    config_.live.height_px = 18;
    config_.live.stall_after = 10s;
    patience_.open = 30s;
    patience_.first_frame = 10s;
    patience_.shortest_pause = 1ms;
    patience_.longest_pause = 20ms;
    patience_.absent_pause = 5ms;
  }

  std::unique_ptr<Camera> open(const std::string& script) {
    config_.libcamera.id = script;
    return camera::open_contained_camera(config_, FACET_SCRIPTED_HOST, patience_);
  }

  /// A script that does something instead of a frame, once.
  std::string once(const std::string& action, int frame) {
    return action + ":" + std::to_string(frame) + ":" + marker().string();
  }
  std::filesystem::path marker() const { return folder_.path() / "done"; }

  /// The pid that a script of the kind tell-pid or child told.
  pid_t told_pid() const {
    pid_t pid = 0;
    std::ifstream(marker()) >> pid;
    return pid;
  }

  /// The next frame, with all of its pixels checked against its number in the host.
  testing::AssertionResult next(Camera& camera, Frame& frame) {
    const auto end = std::chrono::steady_clock::now() + kPatience;
    while (camera.next(frame, 20ms) != CaptureOutcome::Delivered) {
      if (std::chrono::steady_clock::now() > end) {
        return testing::AssertionFailure()
               << "no frame; " << to_string(camera.status().state) << ": " << camera.status().reason;
      }
    }
    if (frame.width_px != config_.live.width_px || frame.height_px != config_.live.height_px) {
      return testing::AssertionFailure() << frame.width_px << " x " << frame.height_px << " px";
    }
    for (int y = 0; y < frame.height_px; ++y) {
      for (int i = 0; i < 4 * frame.width_px; ++i) {
        if (frame.row(y)[i] != frame.row(0)[0]) {
          return testing::AssertionFailure() << "pixels of frame " << frame.sequence << " differ";
        }
      }
    }
    return testing::AssertionSuccess();
  }

  bool becomes(Camera& camera, CameraState state) {
    Frame frame;
    return eventually([&] {
      camera.next(frame, 5ms);
      return camera.status().state == state;
    });
  }

  TemporaryFolder folder_;
  camera::CameraConfig config_;
  camera::HostPatience patience_;
};

TEST_F(ContainedCamera, HandsOverFrames) {
  const auto camera = open("well");
  EXPECT_EQ(camera->status().state, CameraState::Idle);
  EXPECT_EQ(camera->info().name, "scripted \\x1b[31m camera");
  EXPECT_TRUE(camera->info().live);
  Frame frame;
  EXPECT_EQ(camera->next(frame, 0ms), CaptureOutcome::EndOfStream) << "before start";
  camera->start();
  std::int64_t before_ns = 0;
  for (std::uint64_t n = 0; n < 300; ++n) {
    ASSERT_TRUE(next(*camera, frame));
    EXPECT_EQ(frame.sequence, n);
    EXPECT_EQ(frame.row(0)[0], n % 251);
    EXPECT_GT(frame.timestamp_ns, before_ns);
    EXPECT_LE(frame.timestamp_ns, Clock::now_ns());
    EXPECT_FALSE(frame.corrupt);
    before_ns = frame.timestamp_ns;
  }
  EXPECT_EQ(camera->status().state, CameraState::Streaming);
  EXPECT_EQ(camera->status().counters.delivered, 300U);
  EXPECT_EQ(camera->status().counters.reopened, 0U);
  camera->stop();
  camera->stop();
  EXPECT_EQ(camera->next(frame, 0ms), CaptureOutcome::EndOfStream);
  EXPECT_EQ(camera->last_error(), "");
}

TEST_F(ContainedCamera, AFrameThatIsHeldDoesNotChange) {
  const auto camera = open("well");
  camera->start();
  std::vector<Frame> held(40);
  for (Frame& frame : held) {
    ASSERT_TRUE(next(*camera, frame));
  }
  for (const Frame& frame : held) {
    EXPECT_EQ(frame.row(17)[135], frame.sequence % 251);
  }
}

/// What a host does wrong, and what is said of it.
struct Wrong {
  const char* action;
  const char* reason;
};
void PrintTo(const Wrong& wrong, std::ostream* out) {
  *out << wrong.action;
}

class WrongHost : public ContainedCamera, public ::testing::WithParamInterface<Wrong> {};

TEST_P(WrongHost, EndsItAndStartsAnew) {
  const auto camera = open(once(GetParam().action, 3));
  camera->start();
  Frame frame;
  for (std::uint64_t n = 0; n < 3; ++n) {
    ASSERT_TRUE(next(*camera, frame));
    ASSERT_EQ(frame.sequence, n);
  }
  ASSERT_TRUE(becomes(*camera, CameraState::Failing));
  EXPECT_THAT(camera->status().reason, AllOf(HasSubstr("scripted"), HasSubstr(GetParam().reason)));
  ASSERT_TRUE(next(*camera, frame));
  EXPECT_EQ(frame.sequence, 4U) << "numbers go on with a gap";
  EXPECT_EQ(frame.row(0)[0], 0) << "and are of another process";
  EXPECT_EQ(camera->status().state, CameraState::Streaming);
  EXPECT_EQ(camera->status().reason, "");
  EXPECT_EQ(camera->status().counters.reopened, 1U);
  EXPECT_THAT(camera->last_error(), HasSubstr(GetParam().reason));
}

INSTANTIATE_TEST_SUITE_P(
    All, WrongHost,
    ::testing::Values(
        Wrong{"segv", "was ended by SIGSEGV"}, Wrong{"abort", "was ended by SIGABRT"},
        Wrong{"exit", "ended with status 3"}, Wrong{"fail", "the sensor is too hot"},
        Wrong{"close", "its process"}, Wrong{"garbage", "a message of 10 bytes"},
        Wrong{"huge", "a message of 100000 bytes"}, Wrong{"unasked", "frame 1 where frame 3 is next"},
        Wrong{"again", "frame 2 where frame 3 is next"},
        Wrong{"far", "frame 18446744073709551615 where frame 3 is next"},
        Wrong{"future", "a time that is 3.6e+03 s from now"}, Wrong{"torn", "changed the pixels of frame 3"},
        Wrong{"wrong-size", "a picture of 136x72 px"}, Wrong{"backwards", "counts 'lost' backwards"},
        Wrong{"list", "says a camera of a list while it delivers frames"},
        Wrong{"open-again", "says that its camera is open while it delivers frames"},
        Wrong{"flood", "s that it is alive"}),
    [](const auto& wrong) {
      std::string name = wrong.param.action;
      std::erase(name, '-');
      return name;
    });

TEST_F(ContainedCamera, AHostThatHangsIsStalled) {
  for (const char* action : {"hang", "stop", "silent"}) {
    std::filesystem::remove(marker());
    config_.live.stall_after = 300ms;
    const auto camera = open(once(action, 3));
    camera->start();
    Frame frame;
    ASSERT_TRUE(next(*camera, frame));
    ASSERT_TRUE(becomes(*camera, CameraState::Stalled)) << action;
    EXPECT_THAT(camera->status().reason, HasSubstr("no frame for 0.3")) << action;
    ASSERT_TRUE(next(*camera, frame)) << action;
    EXPECT_EQ(camera->status().state, CameraState::Streaming);
    EXPECT_GE(camera->status().counters.reopened, 1U);
  }
}

TEST_F(ContainedCamera, AHostIsSilentWhileNoFramesAreDue) {
  config_.live.stall_after = 300ms;
  patience_.first_frame = 600ms;
  for (const char* action : {"silent", "hang"}) {
    std::filesystem::remove(marker());
    const auto camera = open(once(action, 3));
    camera->start();
    Frame frame;
    for (int i = 0; i < 3; ++i) {
      ASSERT_TRUE(next(*camera, frame));
    }
    camera->expect_frames(false);
    const auto end = std::chrono::steady_clock::now() + 1500ms;
    while (std::chrono::steady_clock::now() < end && camera->status().state == CameraState::Streaming) {
      ASSERT_EQ(camera->next(frame, 20ms), CaptureOutcome::Timeout);
    }
    if (action == std::string("hang")) {
      // The next call may start a process that is well, and the state has passed.
      ASSERT_EQ(camera->status().state, CameraState::Stalled);
      continue;
    }
    ASSERT_EQ(camera->status().state, CameraState::Streaming) << "it says that it is alive";
    camera->expect_frames(true);
    ASSERT_TRUE(becomes(*camera, CameraState::Stalled));
  }
}

TEST_F(ContainedCamera, AHostThatHangsWhileItOpens) {
  patience_.open = 500ms;
  const auto camera = open(once("hang-open", 0));
  EXPECT_EQ(camera->status().state, CameraState::Failing);
  EXPECT_THAT(camera->status().reason, HasSubstr("is not open after 0.5 s: its process hangs"));
  camera->start();
  ASSERT_TRUE(becomes(*camera, CameraState::Streaming));

  const auto never = open("hang-open");
  never->start();
  ASSERT_TRUE(becomes(*never, CameraState::Stalled));
  EXPECT_THAT(never->status().reason, HasSubstr("its process hung and was ended"));
}

TEST_F(ContainedCamera, AHostThatCrashesWhileItOpens) {
  const auto camera = open(once("crash-open", 0));
  EXPECT_EQ(camera->status().state, CameraState::Failing);
  EXPECT_THAT(camera->status().reason, HasSubstr("SIGABRT"));
  camera->start();
  ASSERT_TRUE(becomes(*camera, CameraState::Streaming));
}

TEST_F(ContainedCamera, AHostThatOpensSlowlyIsAwaited) {
  const auto camera = open("slow-open");
  EXPECT_EQ(camera->status().state, CameraState::Idle);
  camera->start();
  Frame frame;
  EXPECT_EQ(camera->next(frame, 1ms), CaptureOutcome::Timeout);
  EXPECT_EQ(camera->status().state, CameraState::Opening);
  ASSERT_TRUE(next(*camera, frame));
  EXPECT_EQ(camera->status().counters.reopened, 0U);
}

TEST_F(ContainedCamera, AHostThatOpensAndNeverDelivers) {
  config_.live.stall_after = 300ms;
  patience_.first_frame = 300ms;
  const auto camera = open("silent:0");
  camera->start();
  ASSERT_TRUE(becomes(*camera, CameraState::Stalled));
  EXPECT_THAT(camera->status().reason, HasSubstr("is open and has delivered nothing for 0.3"));
}

TEST_F(ContainedCamera, AHostThatSpeaksBeforeItsTurn) {
  const auto camera = open("alive-before");
  EXPECT_EQ(camera->status().state, CameraState::Failing);
  EXPECT_THAT(camera->status().reason, HasSubstr("says that it is alive while it opens its camera"));
}

TEST_F(ContainedCamera, ADeviceThatIsAbsent) {
  const auto camera = open("absent");
  EXPECT_EQ(camera->status().state, CameraState::Absent);
  EXPECT_THAT(camera->status().reason, HasSubstr("is not plugged in"));
  camera->start();
  Frame frame;
  EXPECT_EQ(camera->next(frame, 100ms), CaptureOutcome::Timeout);
  EXPECT_NE(camera->status().state, CameraState::Streaming);

  const auto unplugged = open(once("unplug", 3));
  unplugged->start();
  ASSERT_TRUE(becomes(*unplugged, CameraState::Absent));
  EXPECT_THAT(unplugged->status().reason, HasSubstr("was unplugged"));
  ASSERT_TRUE(next(*unplugged, frame));
}

TEST_F(ContainedCamera, WhatTheDeviceCannotDoIsAnError) {
  try {
    open("unsuitable");
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    EXPECT_THAT(error.what(), HasSubstr("source.rate_hz = 30: the camera takes 5 to 25"));
  }
}

TEST_F(ContainedCamera, AHostThatIsNotInstalled) {
  const auto camera = camera::open_contained_camera(config_, "/nowhere/facet-camera-host", patience_);
  EXPECT_EQ(camera->status().state, CameraState::Failing);
  EXPECT_THAT(camera->status().reason, HasSubstr("/nowhere/facet-camera-host: No such file"));
  camera->start();
  Frame frame;
  EXPECT_EQ(camera->next(frame, 20ms), CaptureOutcome::Timeout);
}

TEST_F(ContainedCamera, CountersOfTheHostAreAddedUp) {
  const auto camera = open("damage:3");
  camera->start();
  Frame frame;
  for (int n = 0; n < 5; ++n) {
    ASSERT_TRUE(next(*camera, frame));
    EXPECT_EQ(frame.corrupt, n == 3);
  }
  EXPECT_EQ(frame.sequence, 8U);
  camera->restart("tests");
  EXPECT_EQ(camera->status().state, CameraState::Failing);
  EXPECT_THAT(camera->status().reason, HasSubstr("tests"));
  for (int n = 0; n < 5; ++n) {
    ASSERT_TRUE(next(*camera, frame));
  }
  const CameraCounters counters = camera->status().counters;
  EXPECT_EQ(counters.delivered, 10U);
  EXPECT_EQ(counters.lost, 8U);
  EXPECT_EQ(counters.damaged, 2U);
  EXPECT_EQ(counters.reopened, 1U);
}

TEST_F(ContainedCamera, PausesGrow) {
  const std::filesystem::path starts = folder_.path() / "starts";
  ::setenv("FACET_TEST_STARTS", starts.c_str(), 1);
  patience_.shortest_pause = 20ms;
  patience_.longest_pause = 320ms;
  const auto camera = open("segv:1");  // a frame comes each time, and helps nothing
  camera->start();
  const auto end = std::chrono::steady_clock::now() + 2s;
  Frame frame;
  while (std::chrono::steady_clock::now() < end) {
    camera->next(frame, 20ms);
  }
  ::unsetenv("FACET_TEST_STARTS");
  // The check, and after 20, 40, 80, 160, 320, 320 ... ms: 11 in two seconds, were the starts for nothing.
  const auto count = std::filesystem::file_size(starts);
  EXPECT_GE(count, 3U);
  EXPECT_LE(count, 11U);
}

TEST_F(ContainedCamera, AHundredRestartsLeaveNothingBehind) {
  const auto camera = open("segv:1");
  camera->start();
  Frame frame;
  const auto until_reopened = [&](std::uint64_t times) {
    return eventually([&] {
      camera->next(frame, 5ms);
      return camera->status().counters.reopened >= times;
    });
  };
  ASSERT_TRUE(until_reopened(5));
  const std::size_t descriptors = open_descriptors();
  const long memory_kb = resident_kb();
  ASSERT_TRUE(until_reopened(105));
  EXPECT_EQ(open_descriptors(), descriptors);
#ifndef FACET_SANITIZED
  EXPECT_LT(resident_kb(), memory_kb + 1000);
#else
  static_cast<void>(memory_kb);
#endif
  camera->stop();
  EXPECT_EQ(::waitpid(-1, nullptr, WNOHANG), -1) << "no child is left, nor a zombie";
}

TEST_F(ContainedCamera, StopEndsTheProcess) {
  const auto camera = open(once("tell-pid", 1'000'000));
  camera->start();
  Frame frame;
  ASSERT_TRUE(next(*camera, frame));
  const pid_t pid = told_pid();
  ASSERT_TRUE(runs(pid));
  camera->stop();
  EXPECT_FALSE(runs(pid));
}

TEST_F(ContainedCamera, WhatTheHostStartedEndsWithIt) {
  const auto camera = open("child:0:" + marker().string());
  camera->start();
  ASSERT_TRUE(becomes(*camera, CameraState::Failing));
  const pid_t pid = told_pid();
  ASSERT_GT(pid, 0);
  EXPECT_TRUE(eventually([&] { return !runs(pid); }));
}

TEST_F(ContainedCamera, TheHostEndsWithADaemonThatIsKilled) {
  const pid_t daemon = ::fork();
  if (daemon == 0) {
    const auto camera = open("tell-pid:1000000:" + marker().string());
    camera->start();
    Frame frame;
    for (;;) {
      camera->next(frame, 100ms);
    }
  }
  ASSERT_TRUE(eventually([&] { return told_pid() > 0; }));
  const pid_t host = told_pid();
  EXPECT_TRUE(runs(host));
  ::kill(daemon, SIGKILL);
  ::waitpid(daemon, nullptr, 0);
  EXPECT_TRUE(eventually([&] { return !runs(host); }));
}

TEST_F(ContainedCamera, SignalsThatAreMeantForTheDaemonAreIgnored) {
  const auto camera = open(once("tell-pid", 1'000'000));
  camera->start();
  Frame frame;
  ASSERT_TRUE(next(*camera, frame));
  ::kill(told_pid(), SIGTERM);
  ::kill(told_pid(), SIGINT);
  for (int n = 0; n < 20; ++n) {
    ASSERT_TRUE(next(*camera, frame));
  }
  EXPECT_EQ(camera->status().counters.reopened, 0U);
}

/// Listens as the daemon's control socket does, and as another machine would.
class Listener {
 public:
  explicit Listener(const std::filesystem::path& folder) {
    sockaddr_un local{};
    local.sun_family = AF_UNIX;
    std::strncpy(local.sun_path, (folder / "control.sock").c_str(), sizeof local.sun_path - 1);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    if (::bind(local_, reinterpret_cast<const sockaddr*>(&local), sizeof local) != 0 ||
        ::listen(local_, 4) != 0 ||
        ::bind(network_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
        ::listen(network_, 4) != 0 ||
        ::getsockname(network_, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
      throw std::runtime_error("no sockets");
    }
    port_ = ntohs(address.sin_port);
  }
  ~Listener() {
    ::close(local_);
    ::close(network_);
  }
  Listener(const Listener&) = delete;
  Listener& operator=(const Listener&) = delete;
  int port() const { return port_; }

 private:
  int local_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  int network_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  int port_ = 0;
};

class Confinement : public ContainedCamera {
 protected:
  Confinement() {
    make_treasures(folder_.path());
    ::setenv("FACET_TEST_FOLDER", folder_.path().c_str(), 1);
    ::setenv("FACET_TEST_PORT", std::to_string(listener_.port()).c_str(), 1);
  }

  /// What fails to a process of this user that nobody confines, out of what should work for it.
  std::string fails_unconfined() {
    std::array<int, 2> ends{};
    EXPECT_EQ(::pipe(ends.data()), 0);
    // A parent of its own: a few of the attempts do harm to it.
    const pid_t parent = ::fork();
    if (parent == 0) {
      const pid_t child = ::fork();
      if (child == 0) {
        for (const Escape& escape : escapes({folder_.path(), listener_.port()})) {
          if (escape.guard != Escape::Guard::CallsOnly && !escape.attempt()) {
            dprintf(ends[1], "%s; ", escape.name.c_str());
          }
        }
        ::_exit(0);
      }
      ::waitpid(child, nullptr, 0);
      ::_exit(0);
    }
    ::close(ends[1]);
    std::string failed;
    std::array<char, 512> piece{};
    for (ssize_t size = 0; (size = ::read(ends[0], piece.data(), piece.size())) > 0;) {
      failed.append(piece.data(), static_cast<std::size_t>(size));
    }
    ::close(ends[0]);
    ::waitpid(parent, nullptr, 0);
    return failed;
  }

  Listener listener_{folder_.path()};
};

TEST_F(Confinement, TheAttemptsWorkWithoutIt) {
  EXPECT_EQ(fails_unconfined(), "");
}

TEST_F(Confinement, NothingOfTheDaemonsIsReached) {
  const auto camera = open("escape");
  EXPECT_EQ(camera->status().state, CameraState::Failing);
  EXPECT_THAT(camera->status().reason, HasSubstr("it could do nothing of it"));
  EXPECT_TRUE(std::filesystem::exists(folder_.path() / "token"));
  EXPECT_EQ(std::filesystem::file_size(folder_.path() / "a.take"), 8U);
}

TEST_F(Confinement, LibcameraStartsInIt) {
  EXPECT_NO_THROW(camera::list_contained_cameras(FACET_CAMERA_HOST_PROGRAM, 60s));
}

class ListContained : public ::testing::Test {
 protected:
  ~ListContained() override { ::unsetenv("FACET_TEST_LIST"); }

  static std::vector<camera::CameraListing> list(const char* how, std::chrono::milliseconds patience = 60s) {
    ::setenv("FACET_TEST_LIST", how, 1);
    return camera::list_contained_cameras(FACET_SCRIPTED_HOST, patience);
  }
  static std::string error(const char* how, std::chrono::milliseconds patience = 60s) {
    try {
      list(how, patience);
    } catch (const Error& failure) {
      EXPECT_EQ(failure.kind(), ErrorKind::Unavailable);
      return failure.what();
    }
    return {};
  }
};

TEST_F(ListContained, NamesTheCameras) {
  const auto found = list("");
  ASSERT_EQ(found.size(), 2U);
  EXPECT_EQ(found[0].id, "one");
  EXPECT_EQ(found[0].description, "a camera");
  EXPECT_EQ(found[1].id, "two");
}

TEST_F(ListContained, SaysWhyItCannot) {
  EXPECT_THAT(error("hang", 300ms), HasSubstr("does not answer within 0.3 s"));
  EXPECT_THAT(error("crash"), HasSubstr("SIGABRT"));
  EXPECT_THAT(error("fail"), HasSubstr("libcamera does not start"));
  EXPECT_THAT(error("endless"), HasSubstr("lists more than 256 cameras"));
}

TEST(HostArguments, AreReadAsTheyAreWritten) {
  camera::CameraConfig config;
  config.kind = "libcamera";
  config.libcamera = {"a = b", 1.25, 0.5, 2.0};
  config.live.format = "NV12";
  config.live.width_px = 640;
  config.live.height_px = 480;
  config.live.rate_hz = 29.97;
  config.live.exposure_us = 5000;
  config.live.white_balance_k = 4600;
  config.live.buffers = 6;
  EXPECT_THAT(
      camera::host_arguments(config),
      ElementsAre("--kind=libcamera", "--id=a = b", "--format=NV12", "--width-px=640", "--height-px=480",
                  "--rate-hz=29.97", "--exposure-us=5000", "--white-balance-k=4600", "--buffers=6",
                  "--gain=1.25", "--red-gain=0.5", "--blue-gain=2"));
}

TEST(HostMessage, TellsWhatIsWrong) {
  using camera::HostMessage;
  HostMessage message;
  message.kind = HostMessage::Kind::Fault;
  message.fault = camera::DeviceFault::Kind::Unsuitable;
  message.name = "n";
  message.text = "text";
  std::array<std::uint8_t, camera::kMaxHostMessage_bytes> bytes{};
  const std::size_t size = write_host_message(message, bytes);
  std::string wrong;
  const auto read = [&](std::size_t of_bytes) {
    wrong.clear();
    return camera::read_host_message({bytes.data(), of_bytes}, wrong);
  };
  ASSERT_TRUE(read(size));
  EXPECT_EQ(read(size)->text, "text");
  for (std::size_t cut = 0; cut < size; ++cut) {
    EXPECT_FALSE(read(cut)) << cut;
    EXPECT_NE(wrong, "");
  }
  EXPECT_FALSE(read(size + 1));
  for (const std::size_t at : {0U, 4U, 5U}) {
    bytes[at] ^= 0x40;
    EXPECT_FALSE(read(size)) << at;
    bytes[at] ^= 0x40;
  }
  message.text.assign(100'000, 'x');
  EXPECT_EQ(write_host_message(message, bytes), camera::kMaxHostMessage_bytes - 256 + 1);
}

}  // namespace
}  // namespace facet::test
