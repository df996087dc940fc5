#include "stream/server.hpp"

#include <fcntl.h>
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
#include "stream/decoder.hpp"
#include "stream/encoder.hpp"
#include "stream/framing.hpp"
#include "stream/places.hpp"
#include "stream/ring.hpp"
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

/// A message with its header, ready to be sent; shared by the readers that are in the middle of it.
struct Packet {
  std::vector<std::uint8_t> bytes;
};

/// A WebSocket in the place of the Unix socket's framing.
struct WebPeer {
  WebSocketAssembler requests{kMaxRequestBytes};
  WebSocketHeader header;            ///< of the message that goes out
  std::vector<std::uint8_t> answer;  ///< pong or close that is to be sent; empty: none
  bool answer_goes_out = false;      ///< outgoing is an answer, ready as it is
  Clock::time_point second;          ///< in which the requests are counted
  int requests_in_second = 0;
};

struct AdoptedConnection {
  FileDescriptor connection;
  std::vector<std::uint8_t> early;
};

struct Reader {
  explicit Reader(FileDescriptor connection) : fd(std::move(connection)) {}

  FileDescriptor fd;
  MessageAssembler requests{kMaxRequestBytes};
  Subscription subscription;
  ReaderStatistics statistics;
  std::shared_ptr<const Packet> outgoing;  ///< null: ready for the next message
  std::size_t sent_bytes = 0;              ///< of outgoing
  bool outgoing_is_frame = false;
  bool hello_sent = false;
  bool waits_for_room = false;  ///< EPOLLOUT is armed
  bool gone = false;            ///< to be removed after this round
  Clock::time_point came = Clock::now();
  std::uint64_t subject_number = 0;  ///< of the one that the reader was sent in its profile; 0: none
  std::uint64_t albedo_version = 0;
  std::uint64_t last_number = 0;  ///< newest publication that was sent or counted as dropped
  std::uint64_t dropped_since_frame = 0;
  std::uint64_t dropped_told = 0;

  /// Wake-ups of a ring's reader. A pipe and no eventfd: both ends of an eventfd are one open file, whose
  /// O_NONBLOCK the reader could take away, and then fill it so that the next wake-up never returns.
  FileDescriptor wake;
  FileDescriptor wake_far_end;         ///< the reader's, kept so that nobody gets SIGPIPE
  std::vector<FileDescriptor> passed;  ///< go with the first byte of outgoing
  std::uint64_t ring_generation = 0;   ///< of the ring that was offered last; 0: none
  int ring_offers = 0;

  std::optional<WebPeer> web;  ///< none: a Unix socket

  /// Frames come through a ring. Pictures never do.
  bool by_ring() const {
    return !web && statistics.subscribed && subscription.ring_version >= FACET_RING_VERSION &&
           !subscription.want_images;
  }
};

/// The ring of one profile, made when it is first asked for.
struct Ring {
  std::optional<RingWriter> writer;
  std::uint64_t generation = 0;  ///< another one for every ring of the server
  std::uint64_t number = 0;      ///< of the newest frame in it
};

FileDescriptor open_checked(int fd, const char* what) {
  if (fd < 0) {
    throw Error(ErrorKind::Internal, fmt::format("stream: {}: {}", what, std::strerror(errno)));
  }
  return FileDescriptor(fd);
}

/// What of head and body lies behind their first `sent` bytes.
std::array<iovec, 2> rest_of(std::span<const std::uint8_t> head, std::span<const std::uint8_t> body,
                             std::size_t sent) {
  FACET_ASSERT(sent < head.size() + body.size(), sent, head.size(), body.size());
  const std::size_t of_head = std::min(sent, head.size());
  head = head.subspan(of_head);
  body = body.subspan(sent - of_head);
  // The socket API takes what is sent by a pointer that is not const.
  return {{{const_cast<std::uint8_t*>(head.data()), head.size()},
           {const_cast<std::uint8_t*>(body.data()), body.size()}}};
}

/// send() that passes descriptors on with the first byte; it never blocks.
ssize_t send_some(int fd, std::span<iovec> parts, const std::vector<FileDescriptor>& passed) {
  constexpr std::size_t kMaxPassed = 2;
  FACET_ASSERT(passed.size() <= kMaxPassed, passed.size());
  msghdr message{};
  message.msg_iov = parts.data();
  message.msg_iovlen = parts.size();
  alignas(cmsghdr) std::array<char, CMSG_SPACE(kMaxPassed * sizeof(int))> control{};
  if (!passed.empty()) {
    std::array<int, kMaxPassed> fds{};
    std::transform(passed.begin(), passed.end(), fds.begin(),
                   [](const FileDescriptor& entry) { return entry.get(); });
    message.msg_control = control.data();
    message.msg_controllen = CMSG_SPACE(passed.size() * sizeof(int));
    cmsghdr* header = CMSG_FIRSTHDR(&message);
    header->cmsg_level = SOL_SOCKET;
    header->cmsg_type = SCM_RIGHTS;
    header->cmsg_len = CMSG_LEN(passed.size() * sizeof(int));
    std::memcpy(CMSG_DATA(header), fds.data(), passed.size() * sizeof(int));
  }
  return ::sendmsg(fd, &message, MSG_NOSIGNAL | MSG_DONTWAIT);
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
        places_of_web(web_places(given)) {
    Hello hello_message;
    hello_message.server = config.server_name;
    hello = packet(encoder.hello(hello_message));
  }

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
  Encoder encoder;
  std::vector<std::unique_ptr<Reader>> readers;
  std::uint64_t next_reader_id = kFirstReaderId;
  StreamStatistics statistics;
  std::vector<std::shared_ptr<Packet>> pool;
  std::shared_ptr<const Packet> hello;
  std::shared_ptr<const mesh::MeshFrame> current;
  std::uint64_t current_number = 0;              ///< publications up to and with current
  std::shared_ptr<const mesh::Subject> subject;  ///< of the newest frame that had one
  /// What readers know it by: one more with every subject, and from another start on in every server, so that
  /// a reader that connects anew never takes one subject for another.
  std::uint64_t subject_number = static_cast<std::uint64_t>(Clock::now_ns());
  std::shared_ptr<const mesh::Albedo> albedo;  ///< likewise, of that subject
  /// Of current, made when asked for: without pixels, then with them.
  std::array<std::array<std::shared_ptr<const Packet>, kProfileCount>, 2> frame_packets;
  std::array<std::shared_ptr<const Packet>, kProfileCount> subject_packets;  ///< of subject
  std::shared_ptr<const Packet> albedo_packet;                               ///< of albedo
  std::array<Ring, kProfileCount> rings;
  std::uint64_t ring_generations = 0;

  std::shared_ptr<const Packet> packet(std::span<const std::uint8_t> message);
  void run();
  void run_until_stopped();
  void take_newest();
  void accept_readers();
  void admit_adopted();
  void admit(FileDescriptor connection);
  Reader* admit(std::unique_ptr<Reader> reader, const Visitor& visitor);
  Places& places_for(const Reader& reader) { return reader.web ? places_of_web : places; }
  bool find_place(Reader& reader, const Visitor& visitor);
  int patience_ms() const;
  void drop_silent();
  void handle(Reader& reader, std::uint32_t events);
  void receive(Reader& reader);
  void read_requests(Reader& reader, std::span<const std::uint8_t> bytes);
  void read_web_requests(Reader& reader, std::span<const std::uint8_t> bytes);
  void accept_request(Reader& reader, std::span<const std::uint8_t> message);
  void refuse(Reader& reader, const std::string& why, WebSocketClose code = WebSocketClose::Refused);
  static void set_outgoing(Reader& reader, std::shared_ptr<const Packet> message);
  static void close_web(Reader& reader, WebSocketClose code, const std::string& why);
  void pump(Reader& reader);
  bool send_outgoing(Reader& reader);
  std::shared_ptr<const Packet> next_packet(Reader& reader);
  std::shared_ptr<const Packet> frame_packet(const Subscription& subscription);
  bool fill_ring(Profile profile);
  void announce(Reader& reader);
  void announce_to_all();
  std::shared_ptr<const Packet> ring_packet(Reader& reader);
  void arm(Reader& reader, bool waits_for_room);
  void remove_gone();
  void farewell();
  void show_statistics();

  std::jthread thread;  // last, so that it is joined before anything is freed
};

/// A free packet of the pool, or one more: the pool is bounded by the packets in use, one per reader and
/// those cached above.
std::shared_ptr<const Packet> StreamServer::Impl::packet(std::span<const std::uint8_t> message) {
  auto free = std::find_if(pool.begin(), pool.end(),
                           [](const std::shared_ptr<Packet>& entry) { return entry.use_count() == 1; });
  if (free == pool.end()) {
    free = pool.insert(pool.end(), std::make_shared<Packet>());
  }
  const auto header = make_header(message.size());
  std::vector<std::uint8_t>& bytes = (*free)->bytes;
  bytes.resize(kHeaderBytes + message.size());
  std::copy(header.begin(), header.end(), bytes.begin());
  std::copy(message.begin(), message.end(), bytes.begin() + kHeaderBytes);
  return *free;
}

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
  FACET_ASSERT(number > current_number, number, current_number);
  statistics.skipped += number - current_number - 1;
  statistics.published = number;
  current_number = number;
  current = std::move(frame);
  frame_packets = {};
  if (current->subject == nullptr || !subject_fault(*current->subject).empty()) {
    return;
  }
  // Takes come from elsewhere too: one may show another mesh under an id that is known.
  if (subject != current->subject) {
    subject = current->subject;
    encoder.number_subject(++subject_number);
    subject_packets.fill(nullptr);
    albedo = nullptr;
    albedo_packet = nullptr;
  }
  if (current->albedo != nullptr && (albedo == nullptr || albedo->version != current->albedo->version)) {
    albedo = current->albedo;
    albedo_packet = nullptr;
  }
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
        close_web(reader, WebSocketClose::GoingAway, "");
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
    reader.last_number = current_number > 0 ? current_number - 1 : 0;
  }
  if (!reader.statistics.subscribed || wanted.profile != reader.subscription.profile) {
    reader.subject_number = 0;
    reader.albedo_version = 0;
  }
  places_for(reader).used(reader.statistics.id, Clock::now());
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
    set_outgoing(reader, packet(encoder.goodbye(why)));
    send_outgoing(reader);
  }
  if (reader.web) {
    close_web(reader, code, why);
  }
  reader.gone = true;
}

void StreamServer::Impl::set_outgoing(Reader& reader, std::shared_ptr<const Packet> message) {
  reader.sent_bytes = 0;
  if (reader.web) {
    reader.web->answer_goes_out = false;
    reader.web->header = WebSocketHeader(WebSocketOpcode::Binary, message->bytes.size() - kHeaderBytes);
  }
  reader.outgoing_is_frame = false;
  reader.outgoing = std::move(message);
}

/// Ends a WebSocket. In the middle of a message there is no way to say why.
void StreamServer::Impl::close_web(Reader& reader, WebSocketClose code, const std::string& why) {
  if (reader.outgoing == nullptr) {
    const std::vector<std::uint8_t> frame = web_socket_close(code, why);
    [[maybe_unused]] const ssize_t ignored =
        ::send(reader.fd.get(), frame.data(), frame.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    // What lies unread when a TCP connection is closed makes the kernel throw away what was just sent.
    std::array<std::uint8_t, kMaxRequestBytes> unread{};
    for (int piece = 0; piece < 16 && ::recv(reader.fd.get(), unread.data(), unread.size(), MSG_DONTWAIT) > 0;
         ++piece) {
    }
  }
  reader.gone = true;
}

std::shared_ptr<const Packet> StreamServer::Impl::frame_packet(const Subscription& subscription) {
  FACET_ASSERT(current != nullptr, current_number);
  const bool with_pixels = subscription.want_images && current->images != nullptr;
  auto& cached = frame_packets.at(with_pixels ? 1 : 0).at(static_cast<std::size_t>(subscription.profile));
  if (cached == nullptr) {
    cached = packet(encoder.frame(*current, subscription.profile, with_pixels));
    statistics.encoded_bytes += cached->bytes.size();
  }
  return cached;
}

/// Puts the current frame into the ring of a profile; into a new, larger ring where it does not fit. False
/// where none is to be had.
bool StreamServer::Impl::fill_ring(Profile profile) {
  Ring& ring = rings.at(static_cast<std::size_t>(profile));
  if (ring.number == current_number) {
    return true;
  }
  FACET_ASSERT(current != nullptr && ring.number < current_number, ring.number, current_number);
  const RingFrame frame = encoder.ring_frame(*current, profile);
  const std::size_t bytes = ring_slot_bytes(frame);
  if (!ring.writer || ring.writer->slot_bytes() < bytes) {
    try {
      // Readers keep the ring that they have: only ever larger by a quarter, rings can't pile up.
      ring.writer = RingWriter(profile, kRingSlots, bytes + bytes / 4);
      ring.generation = ++ring_generations;
    } catch (const Error& error) {
      statistics.last_refusal = fmt::format("frames go over the socket: {}", error.what());
      return false;
    }
  }
  FACET_ASSERT(bytes <= ring.writer->slot_bytes(), bytes, ring.writer->slot_bytes());
  ring.writer->write(current_number, frame);
  ring.number = current_number;
  statistics.encoded_bytes += bytes;
  return true;
}

/// Wakes a ring's reader for the current frame. One that has not seen the last wake-up has lost that frame.
void StreamServer::Impl::announce(Reader& reader) {
  if (reader.last_number >= current_number) {
    return;
  }
  const std::uint64_t missed = current_number - reader.last_number - 1;
  reader.last_number = current_number;
  int unseen = 0;
  if (::ioctl(reader.wake_far_end.get(), FIONREAD, &unseen) == 0 && unseen > 0) {
    reader.statistics.frames_dropped += missed + 1;
  } else {
    const char wake_up = 1;
    [[maybe_unused]] const ssize_t ignored = ::write(reader.wake.get(), &wake_up, 1);
    reader.statistics.frames_dropped += missed;
    ++reader.statistics.frames_sent;
    places_for(reader).used(reader.statistics.id, Clock::now());
  }
  // Readers of a ring see what they lost by the frames' numbers.
  reader.dropped_told = reader.statistics.frames_dropped;
}

/// Rings come before sockets: their readers want the least delay.
void StreamServer::Impl::announce_to_all() {
  for (const std::unique_ptr<Reader>& reader : readers) {
    if (reader->by_ring() && reader->ring_generation != 0 && fill_ring(reader->subscription.profile) &&
        reader->ring_generation ==
            rings.at(static_cast<std::size_t>(reader->subscription.profile)).generation) {
      announce(*reader);
    }
  }
}

/// The offer of a ring that the reader does not have yet; else null.
std::shared_ptr<const Packet> StreamServer::Impl::ring_packet(Reader& reader) {
  const Ring& ring = rings.at(static_cast<std::size_t>(reader.subscription.profile));
  FACET_ASSERT(ring.writer && ring.number == current_number, ring.number, current_number);
  if (reader.ring_generation == ring.generation) {
    announce(reader);
    return nullptr;
  }
  std::array<int, 2> ends{-1, -1};
  FileDescriptor memory(::fcntl(ring.writer->fd(), F_DUPFD_CLOEXEC, 0));
  if (!memory || ::pipe2(ends.data(), O_CLOEXEC | O_NONBLOCK) != 0) {
    refuse(reader, fmt::format("no file descriptor left for a ring: {}", std::strerror(errno)));
    return nullptr;
  }
  reader.wake_far_end.reset(ends[0]);
  reader.wake.reset(ends[1]);
  reader.passed.clear();
  reader.passed.push_back(std::move(memory));
  reader.passed.emplace_back(::fcntl(reader.wake_far_end.get(), F_DUPFD_CLOEXEC, 0));
  if (!reader.passed.back() || ++reader.ring_offers > kMaxRingOffers) {
    reader.passed.clear();
    refuse(reader, fmt::format("no ring: descriptors used up, or more than {} asked for", kMaxRingOffers));
    return nullptr;
  }
  reader.ring_generation = ring.generation;
  announce(reader);
  return packet(encoder.ring({FACET_RING_VERSION, ring.writer->bytes()}));
}

/// What this reader needs next: hello, then subject, albedo and drop notice before the frame that needs them.
std::shared_ptr<const Packet> StreamServer::Impl::next_packet(Reader& reader) {
  reader.outgoing_is_frame = false;
  if (!reader.hello_sent) {
    reader.hello_sent = true;
    return hello;
  }
  if (!reader.statistics.subscribed) {
    return nullptr;
  }
  const Profile profile = reader.subscription.profile;
  if (subject != nullptr && reader.subject_number != subject_number) {
    reader.subject_number = subject_number;
    reader.albedo_version = 0;
    auto& cached = subject_packets[static_cast<std::size_t>(profile)];
    if (cached == nullptr) {
      cached = packet(encoder.subject(*subject, profile));
    }
    return cached;
  }
  if (albedo != nullptr && profile != Profile::Signals && reader.subscription.want_albedo &&
      reader.albedo_version != albedo->version) {
    reader.albedo_version = albedo->version;
    if (albedo_packet == nullptr) {
      albedo_packet = packet(encoder.albedo(subject_number, *albedo));
    }
    return albedo_packet;
  }
  if (reader.by_ring() && current_number > 0) {
    if (fill_ring(profile)) {
      return ring_packet(reader);
    }
    reader.subscription.ring_version = 0;
    reader.statistics.ring = false;
  }
  if (reader.last_number >= current_number) {
    return nullptr;
  }
  FACET_ASSERT(current != nullptr && reader.last_number < current_number, reader.last_number, current_number);
  const std::uint64_t missed = current_number - reader.last_number - 1;
  reader.last_number = current_number - 1;
  reader.dropped_since_frame += missed;
  reader.statistics.frames_dropped += missed;
  if (reader.statistics.frames_dropped != reader.dropped_told) {
    reader.dropped_told = reader.statistics.frames_dropped;
    return packet(encoder.dropped({reader.dropped_since_frame, reader.statistics.frames_dropped}));
  }
  reader.last_number = current_number;
  reader.dropped_since_frame = 0;
  reader.outgoing_is_frame = true;
  return frame_packet(reader.subscription);
}

/// Sends what the socket takes of the outgoing message. Returns true once it is all sent.
bool StreamServer::Impl::send_outgoing(Reader& reader) {
  std::span<const std::uint8_t> body = reader.outgoing->bytes;
  std::span<const std::uint8_t> head;
  FACET_ASSERT(body.size() >= kHeaderBytes || (reader.web && reader.web->answer_goes_out), body.size());
  if (reader.web && !reader.web->answer_goes_out) {
    head = reader.web->header.view();
    body = body.subspan(kHeaderBytes);
  }
  while (reader.sent_bytes < head.size() + body.size()) {
    std::array<iovec, 2> parts = rest_of(head, body, reader.sent_bytes);
    const ssize_t count = send_some(reader.fd.get(), parts, reader.passed);
    if (count < 0 && errno == EINTR) {
      continue;
    }
    if (count < 0) {
      reader.gone = errno != EAGAIN && errno != EWOULDBLOCK;
      return false;
    }
    reader.passed.clear();
    reader.sent_bytes += static_cast<std::size_t>(count);
    reader.statistics.bytes_sent += static_cast<std::uint64_t>(count);
  }
  reader.statistics.frames_sent += reader.outgoing_is_frame ? 1 : 0;
  reader.outgoing = nullptr;
  if (reader.statistics.subscribed) {
    places_for(reader).used(reader.statistics.id, Clock::now());
  }
  return true;
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
      if (auto message = next_packet(reader)) {
        const bool is_frame = reader.outgoing_is_frame;
        set_outgoing(reader, std::move(message));
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
      announce_to_all();
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
        set_outgoing(*reader, packet(encoder.goodbye("the server stops")));
        send_outgoing(*reader);
        if (reader->web) {
          close_web(*reader, WebSocketClose::GoingAway, "the server stops");
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
