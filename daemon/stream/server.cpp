#include "stream/server.hpp"

#include <fmt/format.h>
#include <pthread.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <exception>
#include <optional>
#include <span>
#include <thread>
#include <utility>

#include "facet/assert.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "stream/broadcast.hpp"
#include "stream/decoder.hpp"
#include "stream/places.hpp"
#include "stream/reader.hpp"
#include "stream/web_socket.hpp"

namespace facet::stream {
namespace {

constexpr auto kFarewellTime = std::chrono::milliseconds(100);
constexpr int kEventsPerWait = 64;
/// Connections that wait to be adopted; those beyond are closed.
constexpr std::size_t kMostWaiting = 64;
/// Requests and pings of one web reader in a second; a reader that sends more is refused.
constexpr int kMaxWebRequests = 50;
constexpr std::uint64_t kWakeTag = 0;    // epoll data of the eventfd
constexpr std::uint64_t kListenTag = 1;  // of the listening socket; readers' ids follow
constexpr std::uint64_t kFirstReaderId = 2;

struct AdoptedConnection {
  FileDescriptor connection;
  std::vector<std::uint8_t> early;
};

FileDescriptor open_checked(int fd, const char* what) {
  if (fd < 0) {
    throw Error(ErrorKind::Internal, fmt::format("stream: {}: {}", what, std::strerror(errno)));
  }
  return FileDescriptor(fd);
}

/// A reader who may only look connects this often, so that who does it without end is closed unheard.
constexpr int kConnectsAtOnce = 64;
constexpr int kConnectsPerSecond = 16;

PlacesConfig socket_places(const StreamServerConfig& config) {
  PlacesConfig places;
  places.total = static_cast<std::size_t>(config.max_readers);
  places.reserved = places.total / 8;
  places.per_peer = (places.total + 1) / 2;
  places.connects_at_once = kConnectsAtOnce;
  places.connects_per_s = kConnectsPerSecond;
  return places;
}

/// No limit of one address: behind a proxy all have the same. A page subscribes as soon as it is connected;
/// who does not gives way at once.
PlacesConfig web_places(const StreamServerConfig& config) {
  PlacesConfig places;
  places.total = static_cast<std::size_t>(config.max_web_readers);
  places.per_peer = places.total;
  places.unused_keeps = std::chrono::milliseconds(0);
  return places;
}

}  // namespace

struct StreamServer::Impl {
  Impl(const StreamServerConfig& given, FileDescriptor passed)
      : config(given),
        listening(std::in_place, given.socket, given.access, std::move(passed)),
        socket_path(given.socket),
        wake(open_checked(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK), "eventfd")),
        epoll(open_checked(::epoll_create1(EPOLL_CLOEXEC), "epoll")),
        places(socket_places(given)),
        places_of_web(web_places(given)),
        broadcast(given.server_name, statistics,
                  {.used = [this](const Reader& reader) { used(reader); },
                   .refuse = [this](Reader& reader, const std::string& why) { refuse(reader, why); }}) {}

  // Any thread.
  StreamServerConfig config;
  std::optional<ListeningSocket> listening;
  std::filesystem::path socket_path;
  FileDescriptor wake;
  std::atomic<bool> stopping{false};

  Mutex newest_mutex;  ///< held for a pointer's swap only
  std::shared_ptr<const mesh::MeshFrame> newest FACET_GUARDED_BY(newest_mutex);  ///< null once taken
  std::uint64_t published FACET_GUARDED_BY(newest_mutex) = 0;

  Mutex adopted_mutex;
  std::vector<AdoptedConnection> adopted FACET_GUARDED_BY(adopted_mutex);

  mutable Mutex statistics_mutex;
  StreamStatistics shown_statistics FACET_GUARDED_BY(statistics_mutex);

  // facet-stream only.
  FileDescriptor epoll;
  Places places;         ///< of the socket's readers
  Places places_of_web;  ///< these don't take the place of those who sit at the machine, nor these theirs
  std::vector<std::unique_ptr<Reader>> readers;
  std::uint64_t next_reader_id = kFirstReaderId;
  StreamStatistics statistics;
  Broadcast broadcast;

  void run();
  void run_until_stopped();
  void take_newest();
  void accept_readers();
  void admit_adopted();
  void admit(FileDescriptor connection);
  Reader* admit(std::unique_ptr<Reader> reader, const Visitor& visitor);
  Places& places_for(const Reader& reader) { return reader.web ? places_of_web : places; }
  void used(const Reader& reader) { places_for(reader).used(reader.statistics.id, Clock::now()); }
  bool find_place(Reader& reader, const Visitor& visitor);
  int patience_ms() const;
  void drop_silent();
  void handle(Reader& reader, std::uint32_t events);
  void receive(Reader& reader);
  void read_requests(Reader& reader, std::span<const std::uint8_t> bytes);
  void read_web_requests(Reader& reader, std::span<const std::uint8_t> bytes);
  void accept_request(Reader& reader, std::span<const std::uint8_t> message);
  void refuse(Reader& reader, const std::string& why, WebSocketClose code = WebSocketClose::Refused);
  void pump(Reader& reader);
  bool send_outgoing(Reader& reader);
  void arm(Reader& reader, bool waits_for_room);
  void remove_gone();
  void farewell();
  void show_statistics();

  std::jthread thread;  // last, so that it is joined before anything is freed
};

void StreamServer::Impl::take_newest() {
  std::shared_ptr<const mesh::MeshFrame> frame;
  std::uint64_t number = 0;
  {
    const Lock lock(newest_mutex);
    frame = std::exchange(newest, nullptr);
    number = published;
  }
  if (frame == nullptr) {
    return;
  }
  broadcast.take(std::move(frame), number);
}

void StreamServer::Impl::accept_readers() {
  for (int accepted = 0; accepted < kAcceptsPerRound; ++accepted) {
    const std::uint64_t turned_away = listening->turned_away();
    FileDescriptor connection = listening->accept();
    if (listening->turned_away() != turned_away) {
      statistics.refused += listening->turned_away() - turned_away;
      statistics.last_refusal = "no file descriptor left for a reader";
    }
    if (!connection) {
      return;
    }
    admit(std::move(connection));
  }
}

void StreamServer::Impl::admit_adopted() {
  std::vector<AdoptedConnection> waiting;
  {
    const Lock lock(adopted_mutex);
    waiting.swap(adopted);
  }
  FACET_ASSERT(waiting.size() <= kMostWaiting, waiting.size());
  for (AdoptedConnection& entry : waiting) {
    auto reader = std::make_unique<Reader>(std::move(entry.connection));
    reader->web.emplace();
    reader->statistics.web = true;
    const Visitor visitor{peer_address(reader->fd.get()), false};
    if (Reader* admitted = admit(std::move(reader), visitor)) {
      read_web_requests(*admitted, entry.early);
      if (!admitted->gone) {
        pump(*admitted);
      }
    }
  }
}

void StreamServer::Impl::admit(FileDescriptor connection) {
  const UnixPeer peer = listening->peer(connection.get());
  auto reader = std::make_unique<Reader>(std::move(connection));
  reader->statistics.pid = peer.pid;
  reader->statistics.uid = peer.uid;
  admit(std::move(reader), {fmt::format("uid {}", peer.uid), peer.may_command});
}

/// False where the reader was refused.
bool StreamServer::Impl::find_place(Reader& reader, const Visitor& visitor) {
  const auto now = Clock::now();
  Places& own = places_for(reader);
  const PlacesConfig& limits = own.config();
  if (own.size() >= std::min(limits.per_peer, limits.total - limits.reserved)) {
    // Who has taken all that there was makes use of its place, also while nothing comes.
    for (const std::unique_ptr<Reader>& entry : readers) {
      int unseen = 0;
      if (entry->web.has_value() == reader.web.has_value() && entry->statistics.subscribed &&
          entry->outgoing == nullptr &&
          (!entry->wake_far_end ||
           (::ioctl(entry->wake_far_end.get(), FIONREAD, &unseen) == 0 && unseen == 0))) {
        own.used(entry->statistics.id, now);
      }
    }
  }
  const Places::Outcome outcome = own.enter(reader.statistics.id, visitor, now);
  if (outcome.gives_way) {
    const auto idle = std::find_if(readers.begin(), readers.end(), [&](const std::unique_ptr<Reader>& entry) {
      return entry->statistics.id == *outcome.gives_way;
    });
    if (idle != readers.end()) {
      refuse(**idle, "an idle reader, which gave its place to another");
    }
  }
  switch (outcome.answer) {
    case Places::Answer::Admitted:
      return true;
    case Places::Answer::NoPlace:
      refuse(reader, fmt::format("{} readers are connected already, which is the limit", own.config().total));
      return false;
    case Places::Answer::TooManyOfPeer:
      refuse(reader, fmt::format("{} readers of this user are connected already, which is the limit",
                                 own.config().per_peer));
      return false;
    case Places::Answer::TooManyConnects:
      // Not even told so: that is what would cost the others.
      ++statistics.refused;
      statistics.last_refusal = to_string(outcome.answer);
      return false;
  }
  return false;
}

/// The reader in its place, or null where it was refused.
Reader* StreamServer::Impl::admit(std::unique_ptr<Reader> reader, const Visitor& visitor) {
  FACET_ASSERT(next_reader_id >= kFirstReaderId, next_reader_id);  // others are epoll tags
  reader->statistics.id = next_reader_id++;
  ++statistics.connections;
  if (!find_place(*reader, visitor)) {
    return nullptr;
  }
  epoll_event event{};
  event.events = EPOLLIN | EPOLLRDHUP;
  event.data.u64 = reader->statistics.id;
  if (::epoll_ctl(epoll.get(), EPOLL_CTL_ADD, reader->fd.get(), &event) != 0) {
    refuse(*reader, "no memory for one more reader");
    places_for(*reader).leave(reader->statistics.id);
    return nullptr;
  }
  readers.push_back(std::move(reader));
  pump(*readers.back());
  return readers.back().get();
}

void StreamServer::Impl::arm(Reader& reader, bool waits_for_room) {
  if (reader.waits_for_room == waits_for_room) {
    return;
  }
  reader.waits_for_room = waits_for_room;
  epoll_event event{};
  event.events = EPOLLIN | EPOLLRDHUP | (waits_for_room ? static_cast<std::uint32_t>(EPOLLOUT) : 0U);
  event.data.u64 = reader.statistics.id;
  if (::epoll_ctl(epoll.get(), EPOLL_CTL_MOD, reader.fd.get(), &event) != 0) {
    reader.gone = true;
  }
}

void StreamServer::Impl::handle(Reader& reader, std::uint32_t events) {
  if ((events & EPOLLIN) != 0) {
    receive(reader);
  }
  if ((events & (EPOLLHUP | EPOLLERR | EPOLLRDHUP)) != 0 && (events & EPOLLIN) == 0) {
    reader.gone = true;
  }
  if (!reader.gone) {
    pump(reader);
  }
}

void StreamServer::Impl::receive(Reader& reader) {
  // One piece a round: a peer that talks without end does not keep the thread from the others.
  std::array<std::uint8_t, kMaxRequestBytes> piece{};
  const ssize_t count = ::recv(reader.fd.get(), piece.data(), piece.size(), 0);
  if (count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR)) {
    reader.gone = true;
    return;
  }
  const std::span<const std::uint8_t> bytes(piece.data(), count > 0 ? static_cast<std::size_t>(count) : 0);
  if (reader.web) {
    read_web_requests(reader, bytes);
  } else {
    read_requests(reader, bytes);
  }
}

void StreamServer::Impl::read_web_requests(Reader& reader, std::span<const std::uint8_t> bytes) {
  using Outcome = WebSocketAssembler::Outcome;
  WebPeer& web = *reader.web;
  while (!bytes.empty() && !reader.gone) {
    const Outcome outcome = web.requests.feed(bytes);
    if (outcome == Outcome::Message || outcome == Outcome::Ping) {
      const auto now = Clock::now();
      if (now - web.second >= std::chrono::seconds(1)) {
        web.second = now;
        web.requests_in_second = 0;
      }
      if (++web.requests_in_second > kMaxWebRequests) {
        refuse(reader, fmt::format("more than {} requests in a second", kMaxWebRequests));
        return;
      }
    }
    switch (outcome) {
      case Outcome::Incomplete:
        break;
      case Outcome::Message:
        if (web.requests.is_text()) {
          refuse(reader, "requests are binary messages");
          break;
        }
        accept_request(reader, web.requests.message());
        web.requests.next();
        break;
      case Outcome::Ping:
        web.answer = web_socket_pong(web.requests.control());
        break;
      case Outcome::Close:
        reader.close_web(WebSocketClose::GoingAway, "");
        break;
      case Outcome::Violation:
        refuse(reader, "request breaks the WebSocket protocol", WebSocketClose::Violation);
        break;
      case Outcome::TooLong:
        refuse(reader, fmt::format("request is longer than {} bytes", kMaxRequestBytes),
               WebSocketClose::TooLong);
        break;
    }
  }
}

void StreamServer::Impl::read_requests(Reader& reader, std::span<const std::uint8_t> bytes) {
  while (!bytes.empty() && !reader.gone) {
    switch (reader.requests.feed(bytes)) {
      case MessageAssembler::Outcome::Incomplete:
        break;
      case MessageAssembler::Outcome::Complete:
        accept_request(reader, reader.requests.message());
        reader.requests.next();
        break;
      case MessageAssembler::Outcome::WrongMagic:
        refuse(reader, "request does not begin with the protocol's magic");
        break;
      case MessageAssembler::Outcome::TooLong:
        refuse(reader, fmt::format("request is longer than {} bytes", kMaxRequestBytes));
        break;
    }
  }
}

void StreamServer::Impl::accept_request(Reader& reader, std::span<const std::uint8_t> message) {
  Subscription wanted;
  try {
    wanted = decode_subscription(message);
  } catch (const Error& error) {
    refuse(reader, error.what());
    return;
  }
  if (wanted.protocol_version != kProtocolVersion) {
    refuse(reader, fmt::format("client speaks protocol version {}, this server speaks {}",
                               wanted.protocol_version, kProtocolVersion));
    return;
  }
  if (!reader.statistics.subscribed) {
    // The first frame is the current one, so that a reader sees something even while the source pauses.
    reader.last_number = broadcast.current_number() > 0 ? broadcast.current_number() - 1 : 0;
  }
  if (!reader.statistics.subscribed || wanted.profile != reader.subscription.profile) {
    reader.subject_number = 0;
    reader.albedo_version = 0;
  }
  FACET_ASSERT(reader.last_number <= broadcast.current_number(), reader.last_number,
               broadcast.current_number());
  used(reader);
  reader.subscription = wanted;
  reader.statistics.subscribed = true;
  reader.statistics.ring = reader.by_ring();
  if (!reader.by_ring()) {
    reader.ring_generation = 0;
    reader.wake.reset();
    reader.wake_far_end.reset();
  }
  reader.statistics.profile = wanted.profile;
  reader.statistics.client = wanted.client;
}

/// Says goodbye and drops the reader. In the middle of a message no goodbye can be sent.
void StreamServer::Impl::refuse(Reader& reader, const std::string& why, WebSocketClose code) {
  ++statistics.refused;
  statistics.last_refusal = why;
  if (reader.outgoing == nullptr) {
    reader.set_outgoing(broadcast.goodbye(why));
    send_outgoing(reader);
  }
  if (reader.web) {
    reader.close_web(code, why);
  }
  reader.gone = true;
}

/// As Reader::send_outgoing; what was sent whole was taken.
bool StreamServer::Impl::send_outgoing(Reader& reader) {
  const bool all = reader.send_outgoing();
  if (all && reader.statistics.subscribed) {
    used(reader);
  }
  return all;
}

void StreamServer::Impl::pump(Reader& reader) {
  while (!reader.gone) {
    if (reader.outgoing == nullptr && reader.web && !reader.web->answer.empty()) {
      auto answer = std::make_shared<Packet>();
      answer->bytes.swap(reader.web->answer);
      reader.outgoing = std::move(answer);
      reader.sent_bytes = 0;
      reader.outgoing_is_frame = false;
      reader.web->answer_goes_out = true;
    } else if (reader.outgoing == nullptr) {
      if (auto message = broadcast.next_packet(reader)) {
        const bool is_frame = reader.outgoing_is_frame;
        reader.set_outgoing(std::move(message));
        reader.outgoing_is_frame = is_frame;
      }
    }
    if (reader.gone) {
      return;
    }
    if (reader.outgoing == nullptr) {
      arm(reader, false);
      return;
    }
    if (!send_outgoing(reader)) {
      if (!reader.gone) {
        arm(reader, true);
      }
      return;
    }
  }
}

void StreamServer::Impl::remove_gone() {
  // Closing the descriptor takes it out of epoll as well.
  std::erase_if(readers, [this](const std::unique_ptr<Reader>& reader) {
    if (reader->gone) {
      places_for(*reader).leave(reader->statistics.id);
    }
    return reader->gone;
  });
  FACET_ASSERT(places.size() + places_of_web.size() == readers.size(), places.size(), places_of_web.size(),
               readers.size());  // each has one
}

void StreamServer::Impl::show_statistics() {
  statistics.readers.resize(readers.size());
  std::transform(readers.begin(), readers.end(), statistics.readers.begin(),
                 [](const std::unique_ptr<Reader>& reader) { return reader->statistics; });
  const Lock lock(statistics_mutex);
  shown_statistics = statistics;
}

/// Until the next reader has had its time to subscribe; -1 where none is awaited.
int StreamServer::Impl::patience_ms() const {
  std::optional<Clock::time_point> next;
  for (const std::unique_ptr<Reader>& reader : readers) {
    if (!reader->statistics.subscribed && (!next || reader->came < *next)) {
      next = reader->came;
    }
  }
  if (!next) {
    return -1;
  }
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(*next + kSubscribeTime - Clock::now());
  return static_cast<int>(std::max<std::chrono::milliseconds::rep>(0, left.count()));
}

void StreamServer::Impl::drop_silent() {
  const auto now = Clock::now();
  for (const std::unique_ptr<Reader>& reader : readers) {
    if (!reader->gone && !reader->statistics.subscribed && now - reader->came >= kSubscribeTime) {
      refuse(*reader, fmt::format("nothing was subscribed to in {} s", kSubscribeTime.count()));
    }
  }
}

void StreamServer::Impl::run_until_stopped() {
  std::array<epoll_event, kEventsPerWait> events{};
  while (!stopping.load()) {
    const int count = ::epoll_wait(epoll.get(), events.data(), kEventsPerWait, patience_ms());
    if (count < 0 && errno != EINTR) {
      throw Error(ErrorKind::Internal, fmt::format("stream: epoll: {}", std::strerror(errno)));
    }
    bool woken = false;
    for (int i = 0; i < count; ++i) {
      const epoll_event& event = events[static_cast<std::size_t>(i)];
      if (event.data.u64 == kWakeTag) {
        woken = true;
      } else if (event.data.u64 == kListenTag) {
        accept_readers();
      } else {
        const auto reader = std::find_if(
            readers.begin(), readers.end(),
            [&](const std::unique_ptr<Reader>& entry) { return entry->statistics.id == event.data.u64; });
        if (reader != readers.end() && !(*reader)->gone) {
          handle(**reader, event.events);
        }
      }
    }
    drop_silent();
    remove_gone();
    if (woken) {
      std::uint64_t wakes = 0;
      // Non-blocking; only empties the counter.
      [[maybe_unused]] const ssize_t ignored = ::read(wake.get(), &wakes, sizeof(wakes));
      admit_adopted();
      take_newest();
      broadcast.announce(readers);
      for (const std::unique_ptr<Reader>& reader : readers) {
        if (reader->outgoing == nullptr) {
          pump(*reader);
        }
      }
      remove_gone();
    }
    ++statistics.rounds;
    show_statistics();
  }
}

/// Lets readers finish the message that they are in the middle of, then says goodbye.
void StreamServer::Impl::farewell() {
  const auto end = Clock::now() + kFarewellTime;
  while (!readers.empty()) {
    for (const std::unique_ptr<Reader>& reader : readers) {
      if (reader->outgoing == nullptr || send_outgoing(*reader)) {
        reader->set_outgoing(broadcast.goodbye("the server stops"));
        send_outgoing(*reader);
        if (reader->web) {
          reader->close_web(WebSocketClose::GoingAway, "the server stops");
        }
        reader->gone = true;
      }
    }
    remove_gone();
    if (Clock::now() >= end) {
      break;
    }
    if (!readers.empty()) {
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
  }
  readers.clear();
}

void StreamServer::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-stream");
  try {
    run_until_stopped();
    farewell();
  } catch (const std::exception& error) {
    statistics.failure = error.what();
    readers.clear();
  }
  show_statistics();
}

StreamServer::StreamServer(const StreamServerConfig& config, FileDescriptor passed)
    : impl_(std::make_unique<Impl>(config, std::move(passed))) {}

StreamServer::~StreamServer() {
  stop();
}

void StreamServer::start() {
  for (const auto& [fd, tag] :
       {std::pair(impl_->wake.get(), kWakeTag), std::pair(impl_->listening->fd(), kListenTag)}) {
    epoll_event event{};
    event.events = EPOLLIN;
    event.data.u64 = tag;
    if (::epoll_ctl(impl_->epoll.get(), EPOLL_CTL_ADD, fd, &event) != 0) {
      throw Error(ErrorKind::Internal, fmt::format("stream: epoll: {}", std::strerror(errno)));
    }
  }
  impl_->thread = std::jthread([this] { impl_->run(); });
}

void StreamServer::publish(std::shared_ptr<const mesh::MeshFrame> frame) {
  if (impl_->stopping.load() || frame == nullptr) {
    return;
  }
  {
    const Lock lock(impl_->newest_mutex);
    impl_->newest.swap(frame);
    ++impl_->published;
  }
  // An eventfd's counter can't overflow here: the write fails only where a wake-up is pending already.
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t ignored = ::write(impl_->wake.get(), &one, sizeof(one));
}

void StreamServer::adopt(FileDescriptor connection, std::vector<std::uint8_t> early) {
  {
    const Lock lock(impl_->adopted_mutex);
    if (impl_->stopping.load() || impl_->adopted.size() >= kMostWaiting) {
      return;
    }
    impl_->adopted.push_back({std::move(connection), std::move(early)});
  }
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t ignored = ::write(impl_->wake.get(), &one, sizeof(one));
}

void StreamServer::request_stop() {
  impl_->stopping.store(true);
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t ignored = ::write(impl_->wake.get(), &one, sizeof(one));
}

void StreamServer::stop() {
  request_stop();
  if (impl_->thread.joinable()) {
    impl_->thread.join();
  }
  impl_->listening.reset();
}

StreamStatistics StreamServer::statistics() const {
  const Lock lock(impl_->statistics_mutex);
  return impl_->shown_statistics;
}

const std::filesystem::path& StreamServer::socket() const {
  return impl_->socket_path;
}

}  // namespace facet::stream
