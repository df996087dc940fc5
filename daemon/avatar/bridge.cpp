#include "avatar/bridge.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <pthread.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <memory>
#include <random>
#include <string>
#include <system_error>
#include <thread>
#include <utility>

#include "avatar/protocols.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "files/output_file.hpp"

namespace facet::avatar {
namespace {

/// After so many that went well, what failed before is told no more.
constexpr int kSoundFrames = 30;

struct Address {
  sockaddr_storage storage{};
  socklen_t length = 0;
};

/// Length 0 where the text is no address in digits.
Address socket_address(const std::string& address, std::uint16_t port) {
  Address out;
  auto* v4 = reinterpret_cast<sockaddr_in*>(&out.storage);
  auto* v6 = reinterpret_cast<sockaddr_in6*>(&out.storage);
  if (::inet_pton(AF_INET, address.c_str(), &v4->sin_addr) == 1) {
    v4->sin_family = AF_INET;
    v4->sin_port = htons(port);
    out.length = sizeof(*v4);
  } else if (::inet_pton(AF_INET6, address.c_str(), &v6->sin6_addr) == 1) {
    v6->sin6_family = AF_INET6;
    v6->sin6_port = htons(port);
    out.length = sizeof(*v6);
  }
  return out;
}

/// Of a host name: letters, digits, "-", "_" and ".", of which the last part is no number (that would be an
/// address with a fault in it).
bool is_host_name(const std::string& text) {
  constexpr std::size_t kLongest = 253;
  const auto fits = [](unsigned char c) { return std::isalnum(c) != 0 || c == '-' || c == '_' || c == '.'; };
  const std::string last = text.substr(text.rfind('.') + 1);
  return !text.empty() && text.size() <= kLongest && std::all_of(text.begin(), text.end(), fits) &&
         std::any_of(last.begin(), last.end(), [](unsigned char c) { return std::isalpha(c) != 0; });
}

/// The host's first IPv4 address, else its first; receivers of these protocols rarely listen on others.
/// trouble: why there is none (length 0)
Address look_up(const BridgeTarget& target, std::string& trouble) {
  addrinfo wanted{};
  wanted.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  const int fault =
      ::getaddrinfo(target.address.c_str(), std::to_string(target.port).c_str(), &wanted, &found);
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> kept(found, ::freeaddrinfo);
  const addrinfo* chosen = found;
  for (const addrinfo* each = found; each != nullptr; each = each->ai_next) {
    if (each->ai_family == AF_INET) {
      chosen = each;
      break;
    }
  }
  Address out;
  if (fault != 0 || chosen == nullptr || chosen->ai_addrlen > sizeof(out.storage)) {
    trouble = fmt::format("no address of the host '{}' was found at the start: {}", target.address,
                          fault != 0 ? ::gai_strerror(fault) : "none of UDP");
    return out;
  }
  std::memcpy(&out.storage, chosen->ai_addr, chosen->ai_addrlen);
  out.length = chosen->ai_addrlen;
  return out;
}

/// A UUID by lot (RFC 4122, version 4): 36 characters.
std::string random_uuid() {
  std::random_device random;
  std::uniform_int_distribution<unsigned> digit(0, 15);
  std::string uuid = "xxxxxxxx-xxxx-4xxx-8xxx-xxxxxxxxxxxx";
  for (char& c : uuid) {
    c = c == 'x' ? "0123456789ABCDEF"[digit(random)] : c;
  }
  return uuid;
}

double time_of_day_s() {
  const auto now = Clock::utc();
  return std::chrono::duration<double>(now - std::chrono::floor<std::chrono::days>(now)).count();
}

}  // namespace

const char* to_string(BridgeProtocol protocol) {
  return protocol == BridgeProtocol::Vmc ? "vmc" : "live_link_face";
}

const char* to_string(NeutralState state) {
  switch (state) {
    case NeutralState::None:
      return "none";
    case NeutralState::Recording:
      return "recording";
    case NeutralState::Set:
      return "set";
    case NeutralState::Failed:
      return "failed";
  }
  return "";
}

std::string BridgeTarget::text() const {
  const bool six = address.find(':') != std::string::npos;
  return six ? fmt::format("[{}]:{}", address, port) : fmt::format("{}:{}", address, port);
}

std::optional<BridgeTarget> parse_target(BridgeProtocol protocol, const std::string& text) {
  const std::size_t colon = text.rfind(':');
  if (colon == std::string::npos || colon + 1 == text.size()) {
    return std::nullopt;
  }
  BridgeTarget target{protocol, text.substr(0, colon), 0};
  const bool brackets =
      target.address.size() > 2 && target.address.front() == '[' && target.address.back() == ']';
  if (brackets) {
    target.address = target.address.substr(1, target.address.size() - 2);
  }
  const char* end = text.data() + text.size();
  const auto [read, fault] = std::from_chars(text.data() + colon + 1, end, target.port);
  const bool six = target.address.find(':') != std::string::npos;
  if (fault != std::errc() || read != end || target.port == 0 || brackets != six ||
      (socket_address(target.address, target.port).length == 0 &&
       (brackets || !is_host_name(target.address)))) {
    return std::nullopt;
  }
  return target;
}

struct Bridge::Impl {
  explicit Impl(const BridgeConfig& given);
  ~Impl();

  // What holds poses stands first: it is aligned to 32 bytes.
  Smoother smoother;  ///< the thread's own
  ValueTuner tuner;   ///< the same
  std::optional<NeutralPose> neutral FACET_GUARDED_BY(mutex);
  std::optional<NeutralRecorder> recorder FACET_GUARDED_BY(mutex);  ///< while a neutral pose is recorded

  BridgeConfig config;
  std::string device = random_uuid();
  Clock::time_point started = Clock::now();
  struct Destination {
    Address address;
    int socket = -1;
    std::string unknown;  ///< why there is no address
    bool connected = false;
    int sound_frames = 0;  ///< since the last that failed
  };
  std::vector<Destination> destinations;  ///< [targets]

  mutable Mutex mutex;
  Condition changed;
  bool stopping FACET_GUARDED_BY(mutex) = false;
  std::shared_ptr<const mesh::MeshFrame> newest FACET_GUARDED_BY(mutex);  ///< not sent yet
  BridgeStatus status FACET_GUARDED_BY(mutex);
  std::shared_ptr<const ValueTunings> values FACET_GUARDED_BY(mutex);  ///< those of the status
  Clock::time_point recorded_until FACET_GUARDED_BY(mutex);

  // The thread's own.
  OscBundles vmc{kMostDatagram};
  std::vector<std::vector<std::byte>> live_link{1};

  std::jthread thread;  // last, so that it is joined before anything is freed

  static int open_socket(int family);
  void run();
  void work_once(Clock::time_point& next_send) FACET_REQUIRES(mutex);
  void finish_recording() FACET_REQUIRES(mutex);
  void send(const FaceState& state, bool with_neutral);
  static std::string send_all(Destination& to, const std::vector<std::vector<std::byte>>& datagrams);
};

Bridge::Impl::Impl(const BridgeConfig& given)
    : smoother(static_cast<float>(given.smoothing_ms * 1e-3)), config(given) {
  try {
    neutral = load_neutral(config.neutral_file);
  } catch (const Error& error) {
    // A file that a power cut left empty must not keep the daemon from its work.
    status.neutral_reason = fmt::format("{}; {}", error.what(), files::set_aside(config.neutral_file));
  }
  status.neutral = neutral ? NeutralState::Set : NeutralState::None;
  status.values = config.values;
  values = std::make_shared<const ValueTunings>(config.values);
  for (const BridgeTarget& target : config.targets) {
    std::string unknown;
    Address address = socket_address(target.address, target.port);
    address = address.length == 0 ? look_up(target, unknown) : address;
    const int socket = address.length == 0 ? -1 : open_socket(address.storage.ss_family);
    destinations.push_back({address, socket, unknown});
    status.targets.push_back({target, 0, 0, unknown});
  }
}

Bridge::Impl::~Impl() {
  for (const Destination& destination : destinations) {
    if (destination.socket >= 0) {
      ::close(destination.socket);
    }
  }
}

/// A connected socket for each target: a refusal that comes back from it (nobody listens there) is told with
/// the next datagram.
int Bridge::Impl::open_socket(int family) {
  const int descriptor = ::socket(family, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (descriptor < 0) {
    throw Error(ErrorKind::Internal,
                fmt::format("bridge: cannot open a UDP socket: {}", std::strerror(errno)));
  }
  return descriptor;
}

void Bridge::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-bridge");
  Clock::time_point next_send = Clock::now();
  const Lock lock(mutex);
  while (!stopping) {
    try {
      work_once(next_send);
    } catch (const std::exception& error) {
      // A frame for which there was no memory: the next one finds some, or not.
      for (BridgeTargetStatus& target : status.targets) {
        ++target.failed;
        target.reason = error.what();
      }
    }
  }
}

/// Waits for a frame or the time to send it, sends it, or ends the recording of a neutral pose.
void Bridge::Impl::work_once(Clock::time_point& next_send) {
  const auto period =
      std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1 / config.rate_hz));
  const auto now = Clock::now();
  if (recorder && now >= recorded_until) {
    finish_recording();
  }
  if (newest == nullptr || now < next_send) {
    // A recording ends without a frame too.
    const auto until = newest != nullptr ? next_send : now + std::chrono::milliseconds(100);
    changed.wait_until(mutex, Clock::wake(until));
    return;
  }
  // A frame that comes a little early is in time all the same: a camera at rate_hz loses none.
  next_send = std::max(next_send + period, now - period / 2);
  FaceState state = face_state(*std::exchange(newest, nullptr));
  if (recorder) {
    recorder->add(state);
    status.neutral_frames = recorder->frames();
  }
  const bool with_neutral = neutral.has_value();
  const auto tunings = values;
  if (neutral && state.tracked) {
    subtract(*neutral, state);
  }
  const Unlock unlock(mutex);
  tuner.apply(*tunings, state);
  smoother.apply(state);
  send(state, with_neutral);
}

/// Writes the file with the lock open: whoever hands frames over does not wait for the disk.
void Bridge::Impl::finish_recording() {
  const NeutralRecorder recorded = *std::exchange(recorder, std::nullopt);
  std::optional<NeutralPose> mean;
  std::string fault;
  {
    const Unlock unlock(mutex);
    mean = recorded.mean();
    if (mean) {
      try {
        save_neutral(*mean, config.neutral_file);
      } catch (const Error& error) {
        fault = error.what();
      }
    } else {
      fault = fmt::format("a face was tracked in {} frames, {} are needed", recorded.frames(),
                          NeutralRecorder::kFewestFrames);
    }
  }
  status.neutral = fault.empty() ? NeutralState::Set : NeutralState::Failed;
  status.neutral_reason = fault;
  status.neutral_frames = recorded.frames();
  if (fault.empty()) {
    neutral = mean;
  }
}

/// Empty, or what the network said.
std::string Bridge::Impl::send_all(Destination& to, const std::vector<std::vector<std::byte>>& datagrams) {
  if (to.socket < 0) {
    return to.unknown;
  }
  // Where there is no route yet, the next frame tries again.
  if (!to.connected &&
      ::connect(to.socket, reinterpret_cast<const sockaddr*>(&to.address.storage), to.address.length) < 0) {
    return std::strerror(errno);
  }
  to.connected = true;
  std::string reason;
  for (const std::vector<std::byte>& datagram : datagrams) {
    if (::send(to.socket, datagram.data(), datagram.size(), MSG_NOSIGNAL) < 0) {
      reason = errno == EAGAIN ? "the network is busy" : std::strerror(errno);
    }
  }
  return reason;
}

void Bridge::Impl::send(const FaceState& state, bool with_neutral) {
  vmc.clear();
  write_vmc(state, std::chrono::duration<float>(Clock::now() - started).count(), with_neutral, vmc);
  write_live_link_face(state, device, config.subject, time_of_day_s(), live_link.front());
  for (std::size_t i = 0; i < destinations.size(); ++i) {
    const bool is_vmc = config.targets[i].protocol == BridgeProtocol::Vmc;
    if (!is_vmc && !(state.tracked && state.has_expression)) {
      continue;
    }
    const std::string reason = send_all(destinations[i], is_vmc ? vmc.bundles() : live_link);
    const Lock lock(mutex);
    BridgeTargetStatus& target = status.targets[i];
    ++target.frames;
    target.failed += reason.empty() ? 0 : 1;
    // Where nobody listens, every second datagram is refused: those between went out, to nobody.
    destinations[i].sound_frames = reason.empty() ? destinations[i].sound_frames + 1 : 0;
    if (!reason.empty() || destinations[i].sound_frames >= kSoundFrames) {
      target.reason = reason;
    }
  }
}

Bridge::Bridge(const BridgeConfig& config) : impl_(std::make_unique<Impl>(config)) {}

Bridge::~Bridge() {
  request_stop();
  stop();
}

void Bridge::start() {
  impl_->thread = std::jthread([this] { impl_->run(); });
}

void Bridge::request_stop() {
  {
    const Lock lock(impl_->mutex);
    impl_->stopping = true;
  }
  impl_->changed.notify_one();
}

void Bridge::stop() {
  if (impl_->thread.joinable()) {
    impl_->thread.join();
  }
}

void Bridge::publish(std::shared_ptr<const mesh::MeshFrame> frame) {
  {
    const Lock lock(impl_->mutex);
    impl_->newest.swap(frame);
  }
  impl_->changed.notify_one();
}

BridgeStatus Bridge::status() const {
  const Lock lock(impl_->mutex);
  return impl_->status;
}

void Bridge::record_neutral(std::chrono::milliseconds duration) {
  const Lock lock(impl_->mutex);
  if (impl_->recorder) {
    throw Error(ErrorKind::Usage, "a neutral pose is being recorded already");
  }
  impl_->recorder.emplace();
  impl_->recorded_until = Clock::now() + duration;
  impl_->status.neutral = NeutralState::Recording;
  impl_->status.neutral_reason.clear();
  impl_->status.neutral_frames = 0;
}

void Bridge::clear_neutral() {
  std::error_code failure;
  std::filesystem::remove(impl_->config.neutral_file, failure);
  if (failure) {
    throw Error(ErrorKind::Storage, fmt::format("cannot remove '{}': {}", impl_->config.neutral_file.string(),
                                                failure.message()));
  }
  const Lock lock(impl_->mutex);
  impl_->recorder.reset();
  impl_->neutral.reset();
  impl_->status.neutral = NeutralState::None;
  impl_->status.neutral_reason.clear();
}

void Bridge::tune(const ValueTunings& values) {
  auto taken = std::make_shared<const ValueTunings>(values);
  const Lock lock(impl_->mutex);
  impl_->status.values = values;
  impl_->values.swap(taken);
}

}  // namespace facet::avatar
