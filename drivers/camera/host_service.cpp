#include "camera/host_service.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <thread>

#include "camera/device_fault.hpp"
#include "camera/host_protocol.hpp"
#include "camera/host_sandbox.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/printable.hpp"

namespace facet::camera {
namespace {

/// How long the camera may block before the parent's wishes are looked at.
constexpr std::chrono::milliseconds kPatience{100};
/// From the parent's end to ours, whatever the camera does.
constexpr std::chrono::milliseconds kEndPatience{300};

// ---- arguments

struct Arguments {
  CameraConfig config;
  pid_t parent = 0;  ///< 0: a person
  bool list = false;
  bool check = false;
};

template <typename Number>
Number to_number(std::string_view key, std::string_view text) {
  Number number{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size()) {
    throw Error(ErrorKind::Usage, fmt::format("--{}={}: is no number", key, text));
  }
  return number;
}

/// One argument of a configuration: how it is written, and read.
struct Argument {
  const char* key;
  std::function<std::optional<std::string>(const CameraConfig&)> write;
  std::function<void(CameraConfig&, std::string_view)> read;
};

/// For a number, or one that need not be given, reached through `value(config)`.
template <typename Reach>
Argument number(const char* key, Reach value) {
  return {key,
          [value](const CameraConfig& config) -> std::optional<std::string> {
            auto copy = config;
            auto& found = value(copy);
            if constexpr (requires { found.has_value(); }) {
              return found ? std::optional(fmt::format("{}", *found)) : std::nullopt;
            } else {
              return fmt::format("{}", found);
            }
          },
          [key, value](CameraConfig& config, std::string_view text) {
            auto& found = value(config);
            if constexpr (requires { found.has_value(); }) {
              found = to_number<std::remove_reference_t<decltype(*found)>>(key, text);
            } else {
              found = to_number<std::remove_reference_t<decltype(found)>>(key, text);
            }
          }};
}

template <typename Reach>
Argument text(const char* key, Reach value) {
  return {key,
          [value](const CameraConfig& config) -> std::optional<std::string> {
            auto copy = config;
            return value(copy).empty() ? std::nullopt : std::optional<std::string>(value(copy));
          },
          [value](CameraConfig& config, std::string_view given) { value(config) = std::string(given); }};
}

const std::vector<Argument>& known_arguments() {
  static const std::vector<Argument> known = {
      text(
          "kind", [](CameraConfig & config) -> auto& { return config.kind; }),
      text(
          "id", [](CameraConfig & config) -> auto& { return config.libcamera.id; }),
      text(
          "format", [](CameraConfig & config) -> auto& { return config.live.format; }),
      number(
          "width-px", [](CameraConfig & config) -> auto& { return config.live.width_px; }),
      number(
          "height-px", [](CameraConfig & config) -> auto& { return config.live.height_px; }),
      number(
          "rate-hz", [](CameraConfig & config) -> auto& { return config.live.rate_hz; }),
      number(
          "exposure-us", [](CameraConfig & config) -> auto& { return config.live.exposure_us; }),
      number(
          "white-balance-k", [](CameraConfig & config) -> auto& { return config.live.white_balance_k; }),
      number(
          "buffers", [](CameraConfig & config) -> auto& { return config.live.buffers; }),
      number(
          "gain", [](CameraConfig & config) -> auto& { return config.libcamera.gain; }),
      number(
          "red-gain", [](CameraConfig & config) -> auto& { return config.libcamera.red_gain; }),
      number(
          "blue-gain", [](CameraConfig & config) -> auto& { return config.libcamera.blue_gain; }),
  };
  return known;
}

Arguments read_arguments(int argc, const char* const* argv) {
  Arguments arguments;
  arguments.config.kind = "libcamera";
  for (int i = 1; i < argc; ++i) {
    const std::string_view given = argv[i];
    const std::size_t equals = std::min(given.find('='), given.size());
    const std::string_view key = given.substr(0, equals);
    const std::string_view value = equals < given.size() ? given.substr(equals + 1) : std::string_view();
    const auto known = std::find_if(
        known_arguments().begin(), known_arguments().end(),
        [&](const Argument& argument) { return key.starts_with("--") && key.substr(2) == argument.key; });
    if (key == "--list") {
      arguments.list = true;
    } else if (key == "--check") {
      arguments.check = true;
    } else if (key == "--parent") {
      arguments.parent = to_number<pid_t>("parent", value);
    } else if (known != known_arguments().end()) {
      known->read(arguments.config, value);
    } else {
      throw Error(ErrorKind::Usage, fmt::format("unknown argument {}", given));
    }
  }
  return arguments;
}

// ---- talking to the parent

/// False where the parent is gone or does not read.
bool tell(const HostMessage& message) {
  std::array<std::uint8_t, kMaxHostMessage_bytes> bytes;
  const std::size_t size = write_host_message(message, bytes);
  return ::send(kHostSocket, bytes.data(), size, MSG_DONTWAIT | MSG_NOSIGNAL) >= 0;
}

void tell_fault(DeviceFault::Kind kind, const std::string& text) {
  HostMessage message;
  message.kind = HostMessage::Kind::Fault;
  message.fault = kind;
  message.text = text;
  tell(message);
}

/// Runs something of the camera's; false where that is told to the parent as a fault.
template <typename Action>
bool or_tell_fault(Action action) {
  try {
    action();
    return true;
  } catch (const DeviceFault& fault) {
    tell_fault(fault.kind, fault.what());
  } catch (const Error& error) {
    tell_fault(error.kind() == ErrorKind::Usage ? DeviceFault::Kind::Unsuitable : DeviceFault::Kind::Failing,
               error.what());
  } catch (const std::exception& error) {
    tell_fault(DeviceFault::Kind::Failing, error.what());
  }
  return false;
}

/// Ends this process soon after the parent closed its socket, should the camera hang.
void end_with_parent() {
  pollfd socket{kHostSocket, POLLRDHUP, 0};
  while (::poll(&socket, 1, -1) < 0 && errno == EINTR) {
  }
  std::this_thread::sleep_for(kEndPatience);
  std::_Exit(EXIT_FAILURE);
}

void become_host(pid_t parent) {
  ::fcntl(kHostSocket, F_SETFD, FD_CLOEXEC);
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) {
    std::_Exit(EXIT_FAILURE);  // it died before that could be noticed
  }
  // A service manager tells all of a service's processes to end: the parent sees to this one.
  std::signal(SIGTERM, SIG_IGN);
  std::signal(SIGINT, SIG_IGN);
  // Where memory runs out because a camera's library leaks, this process is the one to end.
  std::ofstream("/proc/self/oom_score_adj") << 500;
}

/// Before the camera's library has done anything, and before there is a thread.
void confine(const HostedCameras& cameras, bool tell_gaps) {
  const std::string unguarded = tell_gaps ? files_unguarded() : "";
  if (!unguarded.empty()) {
    fmt::print(stderr, "facet-camera-host: cameras can read and write all files of their user: {}\n",
               unguarded);
  }
  confine_host(cameras.reach ? cameras.reach() : HostReach{});
}

// ---- frames

/// The memory of one picture, to write into.
class Picture {
 public:
  Picture(int width_px, int height_px) : layout_(picture_layout(width_px, height_px)) {
    void* start = ::mmap(nullptr, layout_.total_bytes, PROT_READ | PROT_WRITE, MAP_SHARED, kHostMemory, 0);
    struct stat status {};
    if (start == MAP_FAILED || ::fstat(kHostMemory, &status) != 0 ||
        static_cast<std::size_t>(status.st_size) != layout_.total_bytes) {
      throw std::runtime_error("the parent gave no memory for a picture of that size");
    }
    start_ = static_cast<std::uint8_t*>(start);
  }

  void write(const Frame& frame) {
    const std::uint64_t mark = frame.sequence + 1;
    __atomic_store_n(reinterpret_cast<std::uint64_t*>(start_), mark, __ATOMIC_SEQ_CST);
    const std::size_t row_bytes = std::size_t{4} * static_cast<std::size_t>(frame.width_px);
    for (int y = 0; y < frame.height_px; ++y) {
      std::memcpy(start_ + layout_.pixels_at + static_cast<std::size_t>(y) * layout_.stride_bytes,
                  frame.row(y), row_bytes);
    }
    __atomic_store_n(reinterpret_cast<std::uint64_t*>(start_ + layout_.end_mark_at), mark, __ATOMIC_SEQ_CST);
  }

 private:
  PictureLayout layout_;
  std::uint8_t* start_ = nullptr;  // unmapped by the end of the process
};

/// What the parent wants: a frame, nothing, or the end.
enum class Wish { Frame, Nothing, End };
Wish next_wish(std::chrono::milliseconds patience) {
  pollfd socket{kHostSocket, POLLIN | POLLRDHUP, 0};
  ::poll(&socket, 1, static_cast<int>(patience.count()));
  std::uint8_t letter = 0;
  const ssize_t size = ::recv(kHostSocket, &letter, sizeof letter, MSG_DONTWAIT);
  if (size < 0) {
    return errno == EAGAIN || errno == EINTR ? Wish::Nothing : Wish::End;
  }
  return size == 1 && letter == kFrameRequest ? Wish::Frame : Wish::End;
}

/// Hands over frames; returns once the parent wants no more or the camera can't go on.
class Delivery {
 public:
  Delivery(Camera& camera, const LiveConfig& size)
      : camera_(camera), size_(size), picture_(size.width_px, size.height_px) {}

  void run() {
    camera_.start();
    bool wanted = false;
    Frame frame;
    for (;;) {
      const Wish wish = next_wish(wanted ? std::chrono::milliseconds(0) : kPatience);
      if (wish == Wish::End) {
        return;
      }
      wanted = wanted || wish == Wish::Frame;
      const CaptureOutcome outcome = wanted ? camera_.next(frame, kPatience) : CaptureOutcome::Timeout;
      if (outcome == CaptureOutcome::Delivered) {
        deliver(frame);
        wanted = false;
      } else if (outcome != CaptureOutcome::Timeout) {
        const std::string error = camera_.last_error();
        throw DeviceFault(DeviceFault::Kind::Failing, error.empty() ? "the camera ended" : error);
      } else {
        look();
      }
    }
  }

 private:
  void deliver(const Frame& frame) {
    if (frame.width_px != size_.width_px || frame.height_px != size_.height_px) {
      throw DeviceFault(DeviceFault::Kind::Failing,
                        fmt::format("a picture of {}x{} px", frame.width_px, frame.height_px));
    }
    picture_.write(frame);
    HostMessage message;
    message.kind = HostMessage::Kind::Frame;
    message.sequence = frame.sequence;
    message.timestamp_ns = frame.timestamp_ns;
    message.corrupt = frame.corrupt;
    message.counters = camera_.status().counters;
    tell(message);
    told_ = Clock::now();
  }

  /// Gives up a camera that is in trouble, which the parent then opens anew; else tells that this process is
  /// alive.
  void look() {
    const CameraStatus status = camera_.status();
    if (status.state == CameraState::Absent || status.state == CameraState::Failing ||
        status.state == CameraState::Stalled) {
      throw DeviceFault(
          status.state == CameraState::Absent ? DeviceFault::Kind::Absent : DeviceFault::Kind::Failing,
          status.reason);
    }
    if (Clock::now() - told_ >= kAlivePeriod) {
      HostMessage message;
      message.kind = HostMessage::Kind::Alive;
      message.counters = status.counters;
      tell(message);
      told_ = Clock::now();
    }
  }

  Camera& camera_;
  const LiveConfig& size_;
  Picture picture_;
  Clock::time_point told_ = Clock::now();
};

bool list_to_parent(const HostedCameras& cameras) {
  return or_tell_fault([&] {
    for (const CameraListing& camera : cameras.list()) {
      HostMessage message;
      message.kind = HostMessage::Kind::Listed;
      message.name = camera.id;
      message.text = camera.description;
      tell(message);
    }
    tell({});  // the end of the list
  });
}

bool open_for_parent(const Arguments& arguments, const HostedCameras& cameras) {
  return or_tell_fault([&] {
    const std::unique_ptr<Camera> camera = cameras.open(arguments.config);
    const CameraStatus status = camera->status();
    if (status.state == CameraState::Absent || status.state == CameraState::Failing) {
      throw DeviceFault(
          status.state == CameraState::Absent ? DeviceFault::Kind::Absent : DeviceFault::Kind::Failing,
          status.reason);
    }
    HostMessage message;
    message.kind = HostMessage::Kind::Opened;
    message.name = camera->info().name;
    tell(message);
    if (!arguments.check) {
      Delivery(*camera, arguments.config.live).run();
      camera->stop();
    }
  });
}

}  // namespace

std::vector<std::string> host_arguments(const CameraConfig& config) {
  std::vector<std::string> arguments;
  for (const Argument& argument : known_arguments()) {
    if (const auto value = argument.write(config)) {
      arguments.push_back(fmt::format("--{}={}", argument.key, *value));
    }
  }
  return arguments;
}

int run_camera_host(int argc, const char* const* argv, const HostedCameras& cameras) {
  try {
    const Arguments arguments = read_arguments(argc, argv);
    if (arguments.parent != 0) {
      become_host(arguments.parent);
      // Once at a daemon's start is enough to hear of gaps.
      if (!or_tell_fault([&] { confine(cameras, arguments.check); })) {
        return EXIT_FAILURE;
      }
      std::thread(end_with_parent).detach();
      const bool done = arguments.list ? list_to_parent(cameras) : open_for_parent(arguments, cameras);
      return done ? EXIT_SUCCESS : EXIT_FAILURE;
    }
    if (!arguments.list) {
      throw Error(ErrorKind::Usage, "facetd starts this program; by hand it takes --list alone");
    }
    confine(cameras, true);
    for (const CameraListing& camera : cameras.list()) {
      fmt::print("{}\t{}\n", printable(camera.id), printable(camera.description));
    }
    return EXIT_SUCCESS;
  } catch (const Error& error) {
    fmt::print(stderr, "facet-camera-host: {}\n", printable(error.what()));
    return static_cast<int>(error.kind());
  } catch (const std::exception& error) {
    fmt::print(stderr, "facet-camera-host: {}\n", printable(error.what()));
    return EXIT_FAILURE;
  }
}

}  // namespace facet::camera
