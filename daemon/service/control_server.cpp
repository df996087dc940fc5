#include "service/control_server.hpp"

#include <fmt/format.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <iterator>
#include <new>
#include <utility>
#include <vector>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "service/errands.hpp"

namespace facet::service {
namespace {

constexpr std::uint64_t kListenTag = 0;  // epoll data
constexpr std::uint64_t kWakeTag = 1;    // clients' ids follow
/// What is left of the turns after so long has to wait for the next round.
constexpr std::chrono::milliseconds kRoundBudget{20};

stream::Places places(std::size_t count) {
  stream::PlacesConfig config;
  config.total = count;
  config.reserved = count / 4;
  config.per_peer = std::max<std::size_t>(1, (count - config.reserved) / 2);
  config.connects_at_once = 100;
  config.connects_per_s = 50;
  return stream::Places(config);
}

}  // namespace

void ControlServer::Mailbox::rouse() const {
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t ignored = ::write(wake.get(), &one, sizeof(one));
}

ControlServer::ControlServer(const ControlConfig& config, ControlMethods methods,
                             stream::FileDescriptor passed)
    : methods_(std::move(methods)),
      listening_(config.socket, config.access, std::move(passed)),
      epoll_(::epoll_create1(EPOLL_CLOEXEC)),
      local_places_(places(config.max_clients)),
      page_places_(places(config.max_clients)) {
  mailbox_->wake = stream::FileDescriptor(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  mailbox_->answers.reserve(2 * config.max_clients + 64);
  taken_answers_.reserve(mailbox_->answers.capacity());
  for (const auto& [fd, tag] :
       {std::pair(listening_.fd(), kListenTag), std::pair(mailbox_->wake.get(), kWakeTag)}) {
    epoll_event event{};
    event.events = EPOLLIN;
    event.data.u64 = tag;
    if (!epoll_ || ::epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0) {
      throw Error(ErrorKind::Internal, fmt::format("control socket: epoll: {}", std::strerror(errno)));
    }
  }
}

ControlServer::~ControlServer() = default;

void ControlServer::close_door() {
  listening_.close();
}

void ControlServer::serve() {
  std::array<epoll_event, 64> events{};
  const int count = ::epoll_wait(epoll_.get(), events.data(), static_cast<int>(events.size()), 0);
  for (int e = 0; e < count; ++e) {
    const epoll_event& event = events.at(static_cast<std::size_t>(e));
    if (event.data.u64 == kListenTag) {
      try {
        accept_clients();
      } catch (const std::bad_alloc&) {
        // Who was being accepted is closed; the others wait for the next round.
      }
      continue;
    }
    if (event.data.u64 == kWakeTag) {
      read_mailbox();
      continue;
    }
    const auto client = std::find_if(clients_.begin(), clients_.end(),
                                     [&](const Client& entry) { return entry.id == event.data.u64; });
    if (client == clients_.end() || client->gone) {
      continue;
    }
    if ((event.events & (EPOLLHUP | EPOLLERR)) != 0 && !client->caller.may_command) {
      client->gone = true;  // nobody reads what it would be told, and what it asked changes nothing
    } else if ((event.events & (EPOLLIN | EPOLLHUP | EPOLLERR)) != 0 && !client->ended &&
               (client->watched & EPOLLIN) != 0) {
      try {
        receive(*client);
      } catch (const std::bad_alloc&) {
        client->gone = true;
      }
    } else if ((event.events & (EPOLLHUP | EPOLLERR)) != 0) {
      // Watched on, its end would wake the loop without end.
      ::epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, client->fd.get(), nullptr);
      hear_out(*client);
    }
    if (!client->gone) {
      send_some(*client);
    }
  }
  take_turns();
  drop_greediest();
  const auto now = Clock::now();
  std::erase_if(clients_, [&](const Client& client) {
    const bool over = client.gone || (!client.unsent.empty() && now - client.waits_since > kPatience);
    if (over) {
      (client.web ? page_places_ : local_places_).leave(client.id);
    }
    return over;
  });
}

void ControlServer::accept_clients() {
  for (int accepted = 0; accepted < stream::kAcceptsPerRound; ++accepted) {
    stream::FileDescriptor connection = listening_.accept();
    if (!connection) {
      return;
    }
    Client client;
    client.fd = std::move(connection);
    const stream::UnixPeer peer = listening_.peer(client.fd.get());
    client.caller = {peer.pid, peer.uid, peer.may_command};
    admit(client, fmt::format("uid {}", client.caller.uid));
  }
}

/// The client becomes one of clients_, or is told why not and closed.
void ControlServer::admit(Client& client, std::string peer) {
  const auto now = Clock::now();
  client.id = next_id_++;
  client.counted = now;
  client.waits_since = now;
  stream::Places& places = client.web ? page_places_ : local_places_;
  const auto outcome = places.enter(client.id, {std::move(peer), client.caller.may_command}, now);
  if (outcome.gives_way) {
    const auto other = std::find_if(clients_.begin(), clients_.end(),
                                    [&](const Client& entry) { return entry.id == *outcome.gives_way; });
    if (other != clients_.end()) {
      other->gone = true;
    }
  }
  if (outcome.answer != stream::Places::Answer::Admitted) {
    say(client, error_response(kServerErrorBase - static_cast<int>(ErrorKind::Unavailable),
                               fmt::format("too many control clients ({}); try again",
                                           stream::to_string(outcome.answer))));
    // An empty buffer takes these words.
    [[maybe_unused]] const ssize_t ignored =
        ::send(client.fd.get(), client.unsent.data(), client.unsent.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    return;
  }
  epoll_event event{};
  event.events = client.watched = EPOLLIN;
  event.data.u64 = client.id;
  if (::epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, client.fd.get(), &event) != 0) {
    places.leave(client.id);
    return;
  }
  try {
    clients_.push_back(std::move(client));
  } catch (const std::bad_alloc&) {
    places.leave(client.id);
  }
}

void ControlServer::adopt(stream::FileDescriptor connection, const Caller& caller, std::string peer,
                          std::vector<std::uint8_t> early) {
  {
    const Lock lock(mailbox_->mutex);
    if (mailbox_->adopted.size() >= page_places_.config().total) {
      return;
    }
    mailbox_->adopted.push_back({std::move(connection), caller, std::move(peer), std::move(early)});
  }
  mailbox_->rouse();
}

void ControlServer::read_mailbox() {
  std::uint64_t wakes = 0;
  [[maybe_unused]] const ssize_t ignored = ::read(mailbox_->wake.get(), &wakes, sizeof(wakes));
  std::vector<Adopted> adopted;
  taken_answers_.clear();
  {
    const Lock lock(mailbox_->mutex);
    adopted.swap(mailbox_->adopted);
    taken_answers_.swap(mailbox_->answers);  // both have room for one answer of every client
  }
  for (Adopted& entry : adopted) {
    try {
      Client client;
      client.fd = std::move(entry.connection);
      client.caller = entry.caller;
      client.web.emplace(request_limit(client));
      client.received.assign(entry.early.begin(), entry.early.end());
      admit(client, std::move(entry.peer));
    } catch (const std::bad_alloc&) {
      // It is closed: nobody has been promised anything.
    }
  }
  for (auto& [id, response] : taken_answers_) {
    const auto client = std::find_if(clients_.begin(), clients_.end(),
                                     [wanted = id](const Client& entry) { return entry.id == wanted; });
    if (client != clients_.end()) {
      client->at_work = false;
      client->gone = response.empty() && !client->notified;
      try {
        client->exchange->answer(std::move(response));
      } catch (const std::bad_alloc&) {
        client->gone = true;
      }
    }
  }
}

std::size_t ControlServer::request_limit(const Client& client) const {
  return client.caller.may_command ? kMaxRequestBytes : kMaxLookBytes;
}

/// A client is heard again once it has all its answers, so that none can leave more undone than one request
/// of the greatest length.
void ControlServer::watch(Client& client) {
  const bool has_to_do = client.exchange || client.whole || client.ended || client.last_words;
  const std::uint32_t wanted = !client.unsent.empty() ? std::uint32_t{EPOLLOUT}
                               : has_to_do            ? 0U
                                                      : std::uint32_t{EPOLLIN};
  if (wanted != client.watched && !client.gone) {
    epoll_event event{};
    event.events = client.watched = wanted;
    event.data.u64 = client.id;
    // Fails where the client was taken off the list, having hung up.
    ::epoll_ctl(epoll_.get(), EPOLL_CTL_MOD, client.fd.get(), &event);
  }
}

/// False where nothing has come.
bool ControlServer::receive(Client& client) {
  std::array<char, 16384> piece{};
  ssize_t count = 0;
  do {
    count = ::recv(client.fd.get(), piece.data(), piece.size(), 0);
  } while (count < 0 && errno == EINTR);
  if (count < 0 && errno == EAGAIN) {
    return false;
  }
  // Who sends no more may still wait for answers; who broke off may have asked for something before.
  client.ended = count <= 0;
  client.gone = count < 0 && !client.caller.may_command;
  client.received.append(piece.data(), count > 0 ? static_cast<std::size_t>(count) : 0);
  client.whole = true;
  return count > 0;
}

/// What has come of a client that hears no answers any more is still done, if it may change something: it is
/// read now, and nothing after it.
void ControlServer::hear_out(Client& client) {
  client.gone = !client.caller.may_command;
  try {
    while (!client.gone && !client.ended && client.received.size() <= kMaxRequestBytes && receive(client)) {
    }
  } catch (const std::bad_alloc&) {
    client.gone = true;
  }
  client.ended = true;
}

/// One request of each client at most, and of one that may only look no more than its share.
void ControlServer::take_turns() {
  const auto began = Clock::now();
  const auto later =
      std::find_if(clients_.begin(), clients_.end(), [&](const Client& client) { return client.id > turn_; });
  const auto first = static_cast<std::size_t>(later - clients_.begin());
  for (std::size_t i = 0; i < clients_.size(); ++i) {
    Client& client = clients_[(first + i) % clients_.size()];
    if (client.gone) {
      continue;
    }
    const auto now = Clock::now();
    if (now - began > kRoundBudget) {
      break;
    }
    if (client.at_work && !client.ended) {
      (client.web ? page_places_ : local_places_).used(client.id, now);
    }
    if (may_go_on(client, now)) {
      turn_ = client.id;
      try {
        take_turn(client);
      } catch (const std::bad_alloc&) {
        client.gone = true;
      }
    }
    if (!client.gone) {
      send_some(client);
    }
  }
}

bool ControlServer::has_looks(const Client& client, Clock::time_point now) const {
  return client.caller.may_command ||
         client.looks_left + kLooksPerSecond * std::chrono::duration<double>(now - client.counted).count() >=
             1;
}

bool ControlServer::may_go_on(const Client& client, Clock::time_point now) const {
  return !client.gone && !client.at_work && !client.last_words && client.unsent.empty() &&
         (client.exchange || client.whole || client.ended) && has_looks(client, now);
}

std::optional<Clock::time_point> ControlServer::due() const {
  const auto now = Clock::now();
  std::optional<Clock::time_point> due;
  for (const Client& client : clients_) {
    if (may_go_on(client, now)) {
      return now;
    }
    if (may_go_on(client, Clock::time_point::max())) {
      const auto share = now + std::chrono::milliseconds(1000 / kLooksPerSecond);
      due = due ? std::min(*due, share) : share;
    }
  }
  return due;
}

void ControlServer::charge(Client& client) {
  const auto now = Clock::now();
  const double since_s = std::chrono::duration<double>(now - client.counted).count();
  client.looks_left = std::min<double>(kLooksAtOnce, client.looks_left + kLooksPerSecond * since_s) - 1;
  client.counted = now;
}

void ControlServer::take_turn(Client& client) {
  if (!client.exchange) {
    const std::size_t before = client.received.size();
    begin_exchange(client);
    if (!client.exchange || client.exchange->done()) {
      // What is no request costs as much as one.
      if (client.received.size() != before) {
        charge(client);
      }
      if (!client.exchange) {
        return;
      }
    }
    (client.web ? page_places_ : local_places_).used(client.id, Clock::now());
  }
  if (!client.exchange->done()) {
    charge(client);
    if (const auto job = client.exchange->step(methods_)) {
      client.at_work = true;
      client.notified = job->notification;
      job->errands->ask([mailbox = mailbox_, id = client.id, run = job->run] {
        std::string response;
        try {
          response = run();
        } catch (const std::exception&) {
          // Not even the memory for an answer: an empty one says so to the loop, which hangs up.
        }
        {
          const Lock lock(mailbox->mutex);
          mailbox->answers.emplace_back(id, std::move(response));
        }
        mailbox->rouse();
      });
      return;
    }
  }
  if (client.exchange->done()) {
    say(client, std::move(*client.exchange).response());
    client.exchange.reset();
  }
}

void ControlServer::begin_exchange(Client& client) {
  if (client.web) {
    begin_message(client);
  } else {
    begin_line(client);
  }
  if (!client.exchange && !client.whole && client.ended && client.unsent.empty()) {
    client.gone = true;
  }
}

void ControlServer::begin_message(Client& client) {
  using Outcome = stream::WebSocketAssembler::Outcome;
  std::span<const std::uint8_t> bytes(reinterpret_cast<const std::uint8_t*>(client.received.data()),
                                      client.received.size());
  switch (client.web->feed(bytes)) {
    case Outcome::Incomplete:
      break;
    case Outcome::Message: {
      if (!client.web->is_text()) {
        close_web(client, stream::WebSocketClose::Violation, "requests are text messages");
        break;
      }
      const std::span<const std::uint8_t> message = client.web->message();
      client.exchange.emplace(std::string_view(reinterpret_cast<const char*>(message.data()), message.size()),
                              client.caller);
      client.web->next();
      break;
    }
    case Outcome::Ping: {
      const auto pong = stream::web_socket_pong(client.web->control());
      client.unsent.append(pong.begin(), pong.end());
      break;
    }
    case Outcome::Close:
      close_web(client, stream::WebSocketClose::GoingAway, "");
      break;
    case Outcome::Violation:
      close_web(client, stream::WebSocketClose::Violation, "not the WebSocket protocol");
      break;
    case Outcome::TooLong:
      refuse(client, fmt::format("a request has {} bytes at most", request_limit(client)));
      close_web(client, stream::WebSocketClose::TooLong, "request too long");
      break;
  }
  client.received.erase(0, client.received.size() - bytes.size());
  client.whole = !client.received.empty();
}

void ControlServer::begin_line(Client& client) {
  std::size_t start = 0;
  std::size_t end = client.received.find('\n');
  // Empty lines ask nothing.
  while (end != std::string::npos && (end == start || (end == start + 1 && client.received[start] == '\r'))) {
    start = end + 1;
    end = client.received.find('\n', start);
  }
  const std::size_t length = (end == std::string::npos ? client.received.size() : end) - start;
  if (length > request_limit(client)) {
    refuse(client, fmt::format("a request line has {} bytes at most", request_limit(client)));
    return;
  }
  client.whole = end != std::string::npos;
  if (client.whole) {
    client.exchange.emplace(std::string_view(client.received).substr(start, length), client.caller);
    start = end + 1;
  }
  client.received.erase(0, start);
}

void ControlServer::close_web(Client& client, stream::WebSocketClose code, std::string_view why) {
  const auto frame = stream::web_socket_close(code, why);
  client.unsent.append(frame.begin(), frame.end());
  client.last_words = true;
}

void ControlServer::refuse(Client& client, const std::string& why) {
  say(client, error_response(kInvalidRequest, why));
  client.last_words = true;
}

void ControlServer::say(Client& client, std::string response) {
  if (response.empty() || client.deaf) {
    return;
  }
  if (client.unsent.empty()) {
    client.waits_since = Clock::now();
  }
  if (client.web) {
    const stream::WebSocketHeader header(stream::WebSocketOpcode::Text, response.size());
    client.unsent.append(header.view().begin(), header.view().end());
    client.unsent += response;
    return;
  }
  // An answer has megabytes at times, and nobody needs it twice.
  response += '\n';
  if (client.unsent.empty()) {
    client.unsent = std::move(response);
  } else {
    client.unsent += response;
  }
}

void ControlServer::send_some(Client& client) {
  while (client.sent < client.unsent.size()) {
    const ssize_t count = ::send(client.fd.get(), client.unsent.data() + client.sent,
                                 client.unsent.size() - client.sent, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (count < 0 && errno == EINTR) {
      continue;
    }
    if (count < 0) {
      if (errno != EAGAIN && errno != EWOULDBLOCK) {
        client.sent = client.unsent.size();
        client.deaf = true;
        hear_out(client);
      }
      break;
    }
    client.sent += static_cast<std::size_t>(count);
    client.waits_since = Clock::now();
  }
  if (client.sent == client.unsent.size()) {
    client.unsent = {};
    client.sent = 0;
    client.gone = client.gone || client.last_words;
  }
  watch(client);
}

std::size_t ControlServer::unread_bytes(const Client& client) {
  return client.unsent.size() + (client.exchange ? client.exchange->response_bytes() : 0);
}

void ControlServer::drop_greediest() {
  std::size_t bytes = 0;
  Client* greediest = nullptr;
  for (Client& client : clients_) {
    if (!client.caller.may_command && !client.gone) {
      const std::size_t held = unread_bytes(client);
      bytes += held;
      greediest = greediest == nullptr || held > unread_bytes(*greediest) ? &client : greediest;
    }
  }
  if (bytes > kMaxUnreadBytes) {
    greediest->gone = true;
  }
}

}  // namespace facet::service
