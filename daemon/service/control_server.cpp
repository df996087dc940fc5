#include "service/control_server.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include "facet/error.hpp"

namespace facet::service {
namespace {

constexpr std::uint64_t kListenTag = 0;  // epoll data
constexpr std::uint64_t kWakeTag = 1;    // clients' ids follow

stream::FileDescriptor open_spare() {
  return stream::FileDescriptor(::open("/dev/null", O_RDONLY | O_CLOEXEC));
}

bool is_member(int fd, gid_t primary, gid_t wanted) {
  std::vector<gid_t> groups(64);
  socklen_t size = static_cast<socklen_t>(groups.size() * sizeof(gid_t));
  if (::getsockopt(fd, SOL_SOCKET, SO_PEERGROUPS, groups.data(), &size) != 0) {
    // ERANGE: `size` now says how much it takes.
    groups.resize(size / sizeof(gid_t));
    if (errno != ERANGE || ::getsockopt(fd, SOL_SOCKET, SO_PEERGROUPS, groups.data(), &size) != 0) {
      return primary == wanted;
    }
  }
  groups.resize(size / sizeof(gid_t));
  return primary == wanted || std::find(groups.begin(), groups.end(), wanted) != groups.end();
}

/// Root, the daemon's own user and members of the socket's group may command.
Caller caller_at(int fd, const std::filesystem::path& socket) {
  ucred peer{};
  socklen_t size = sizeof(peer);
  struct stat status {};
  if (::getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0 || ::stat(socket.c_str(), &status) != 0) {
    return {};
  }
  const bool may_command = peer.uid == 0 || peer.uid == ::geteuid() || is_member(fd, peer.gid, status.st_gid);
  return {peer.pid, peer.uid, may_command};
}

}  // namespace

ControlServer::ControlServer(const ControlConfig& config, ControlMethods methods,
                             stream::FileDescriptor passed)
    : methods_(std::move(methods)),
      max_clients_(config.max_clients),
      listening_(config.socket, config.access, std::move(passed)),
      epoll_(::epoll_create1(EPOLL_CLOEXEC)),
      spare_(open_spare()),
      wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  for (const auto& [fd, tag] : {std::pair(listening_.fd(), kListenTag), std::pair(wake_.get(), kWakeTag)}) {
    epoll_event event{};
    event.events = EPOLLIN;
    event.data.u64 = tag;
    if (!epoll_ || ::epoll_ctl(epoll_.get(), EPOLL_CTL_ADD, fd, &event) != 0) {
      throw Error(ErrorKind::Internal, fmt::format("control socket: epoll: {}", std::strerror(errno)));
    }
  }
}

ControlServer::~ControlServer() = default;

void ControlServer::serve() {
  std::array<epoll_event, 64> events{};
  const int count = ::epoll_wait(epoll_.get(), events.data(), static_cast<int>(events.size()), 0);
  for (int e = 0; e < count; ++e) {
    const epoll_event& event = events.at(static_cast<std::size_t>(e));
    if (event.data.u64 == kListenTag) {
      accept_clients();
      continue;
    }
    if (event.data.u64 == kWakeTag) {
      admit_adopted();
      continue;
    }
    const auto client = std::find_if(clients_.begin(), clients_.end(),
                                     [&](const Client& entry) { return entry.id == event.data.u64; });
    if (client == clients_.end()) {
      continue;
    }
    if ((event.events & (EPOLLIN | EPOLLHUP | EPOLLERR)) != 0) {
      receive(*client);
    }
    if (!client->gone) {
      send_some(*client);
    }
  }
  const auto now = std::chrono::steady_clock::now();
  std::erase_if(clients_, [&](const Client& client) {
    return client.gone || (!client.unsent.empty() && now - client.waits_since > kPatience);
  });
}

void ControlServer::accept_clients() {
  for (;;) {
    stream::FileDescriptor connection(
        ::accept4(listening_.fd(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (!connection) {
      if (errno == EMFILE || errno == ENFILE) {
        // Left in the backlog the connection would wake the loop without end.
        spare_.reset();
        stream::FileDescriptor refused(::accept4(listening_.fd(), nullptr, nullptr, SOCK_CLOEXEC));
        refused.reset();
        spare_ = open_spare();
      }
      return;
    }
    Client& client = clients_.emplace_back();
    client.fd = std::move(connection);
    client.caller = caller_at(client.fd.get(), listening_.path());
    admit(client);
  }
}

void ControlServer::admit(Client& client) {
  client.id = next_id_++;
  watch(client, EPOLL_CTL_ADD);
  // Pages don't take the place of those who sit at the machine, nor these theirs.
  const auto alike =
      static_cast<std::size_t>(std::count_if(clients_.begin(), clients_.end(), [&](const Client& entry) {
        return entry.web.has_value() == client.web.has_value();
      }));
  if (alike > max_clients_) {
    say(client, error_response(kServerErrorBase - static_cast<int>(ErrorKind::Unavailable),
                               "too many control clients; try again"));
    client.last_words = true;
    send_some(client);
    client.gone = true;
  }
}

void ControlServer::adopt(stream::FileDescriptor connection, const Caller& caller,
                          std::vector<std::uint8_t> early) {
  {
    const std::lock_guard lock(adopted_mutex_);
    if (adopted_.size() >= kMaxClients) {
      return;
    }
    adopted_.push_back({std::move(connection), caller, std::move(early)});
  }
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t ignored = ::write(wake_.get(), &one, sizeof(one));
}

void ControlServer::admit_adopted() {
  std::uint64_t wakes = 0;
  [[maybe_unused]] const ssize_t ignored = ::read(wake_.get(), &wakes, sizeof(wakes));
  std::vector<Adopted> waiting;
  {
    const std::lock_guard lock(adopted_mutex_);
    waiting.swap(adopted_);
  }
  for (Adopted& entry : waiting) {
    Client& client = clients_.emplace_back();
    client.fd = std::move(entry.connection);
    client.caller = entry.caller;
    client.web.emplace(kMaxRequestBytes);
    admit(client);
    if (!client.gone) {
      answer_web(client, entry.early);
      send_some(client);
    }
  }
}

void ControlServer::watch(const Client& client, int operation) {
  epoll_event event{};
  // While a client has answers to take, it may not ask more.
  event.events = client.unsent.empty() ? EPOLLIN : EPOLLOUT;
  event.data.u64 = client.id;
  // Can fail for want of kernel memory only; the client then hears nothing and goes away by itself.
  ::epoll_ctl(epoll_.get(), operation, client.fd.get(), &event);
}

void ControlServer::receive(Client& client) {
  std::array<std::uint8_t, 16384> piece{};
  const ssize_t count = ::recv(client.fd.get(), piece.data(), piece.size(), 0);
  if (count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR)) {
    client.gone = true;
    return;
  }
  const std::span<const std::uint8_t> bytes(piece.data(), count > 0 ? static_cast<std::size_t>(count) : 0);
  if (client.web) {
    answer_web(client, bytes);
  } else if (!bytes.empty()) {
    client.unanswered.append(bytes.begin(), bytes.end());
    answer(client);
  }
}

void ControlServer::answer_web(Client& client, std::span<const std::uint8_t> bytes) {
  using Outcome = stream::WebSocketAssembler::Outcome;
  const auto close = [&](stream::WebSocketClose code, std::string_view why) {
    const auto frame = stream::web_socket_close(code, why);
    client.unsent.append(frame.begin(), frame.end());
    client.last_words = true;
  };
  while (!bytes.empty() && !client.last_words) {
    switch (client.web->feed(bytes)) {
      case Outcome::Incomplete:
        break;
      case Outcome::Message: {
        if (!client.web->is_text()) {
          close(stream::WebSocketClose::Violation, "requests are text messages");
          break;
        }
        const std::span<const std::uint8_t> message = client.web->message();
        say(client, answer_request(methods_, std::string(message.begin(), message.end()), client.caller));
        client.web->next();
        client.last_words = client.unsent.size() > kMaxUnreadBytes;
        break;
      }
      case Outcome::Ping: {
        const auto pong = stream::web_socket_pong(client.web->control());
        client.unsent.append(pong.begin(), pong.end());
        client.last_words = client.unsent.size() > kMaxUnreadBytes;
        break;
      }
      case Outcome::Close:
        close(stream::WebSocketClose::GoingAway, "");
        break;
      case Outcome::Violation:
        close(stream::WebSocketClose::Violation, "not the WebSocket protocol");
        break;
      case Outcome::TooLong:
        say(client,
            error_response(kInvalidRequest, fmt::format("a request has {} bytes at most", kMaxRequestBytes)));
        close(stream::WebSocketClose::TooLong, "request too long");
        break;
    }
  }
}

void ControlServer::answer(Client& client) {
  std::size_t start = 0;
  for (std::size_t end = client.unanswered.find('\n'); end != std::string::npos && !client.last_words;
       end = client.unanswered.find('\n', start)) {
    const std::string_view line = std::string_view(client.unanswered).substr(start, end - start);
    start = end + 1;
    if (line.empty() || line == "\r") {
      continue;
    }
    if (line.size() > kMaxRequestBytes) {
      refuse_line(client);
      break;
    }
    say(client, answer_request(methods_, line, client.caller));
    client.last_words = client.unsent.size() > kMaxUnreadBytes;
  }
  client.unanswered.erase(0, start);
  if (!client.last_words && client.unanswered.size() > kMaxRequestBytes) {
    refuse_line(client);
  }
}

void ControlServer::refuse_line(Client& client) {
  say(client,
      error_response(kInvalidRequest, fmt::format("a request line has {} bytes at most", kMaxRequestBytes)));
  client.last_words = true;
}

void ControlServer::say(Client& client, const std::string& response) {
  if (response.empty()) {
    return;
  }
  if (client.unsent.empty()) {
    client.waits_since = std::chrono::steady_clock::now();
  }
  if (client.web) {
    const stream::WebSocketHeader header(stream::WebSocketOpcode::Text, response.size());
    client.unsent.append(header.view().begin(), header.view().end());
    client.unsent += response;
  } else {
    client.unsent += response + '\n';
  }
}

void ControlServer::send_some(Client& client) {
  const bool had_unsent = !client.unsent.empty();
  while (!client.unsent.empty()) {
    const ssize_t count =
        ::send(client.fd.get(), client.unsent.data(), client.unsent.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (count < 0 && errno == EINTR) {
      continue;
    }
    if (count < 0) {
      client.gone = errno != EAGAIN && errno != EWOULDBLOCK;
      break;
    }
    client.unsent.erase(0, static_cast<std::size_t>(count));
    client.waits_since = std::chrono::steady_clock::now();
  }
  if (client.last_words && client.unsent.empty()) {
    client.gone = true;
  }
  if (had_unsent && !client.gone) {
    watch(client, EPOLL_CTL_MOD);
  }
}

}  // namespace facet::service
