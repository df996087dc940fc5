#include "service/http_connections.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <linux/tcp.h>  // the C library's has no acknowledged bytes
#include <netinet/in.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <exception>
#include <new>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "service/listen_address.hpp"
#include "stream/web_socket.hpp"

namespace facet::service {
namespace {

constexpr std::size_t kConnectionBytes = 16384;  ///< request and buffers

/// A connection that has asked for nothing gives way at once: whoever connects next asks sooner than one who
/// sends a byte now and then.
stream::PlacesConfig places_of(std::size_t total) {
  stream::PlacesConfig config;
  config.total = total;
  config.per_peer = total - total / 4;
  config.unused_keeps = std::chrono::milliseconds(0);
  config.idle_keeps = std::chrono::milliseconds(1000);
  return config;
}

/// What the peer has acknowledged since it connected, bytes.
std::uint64_t acknowledged_bytes(int fd) {
  tcp_info info{};
  socklen_t size = sizeof(info);
  return ::getsockopt(fd, IPPROTO_TCP, TCP_INFO, &info, &size) == 0 ? info.tcpi_bytes_acked : 0;
}

/// The address at which a connection came in, as a Host header would have it.
std::string own_address(int fd) {
  sockaddr_storage address{};
  socklen_t size = sizeof(address);
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (::getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
    return {};
  }
  if (address.ss_family == AF_INET) {
    ::inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in&>(address).sin_addr, text.data(), text.size());
  } else if (address.ss_family == AF_INET6) {
    ::inet_ntop(AF_INET6, &reinterpret_cast<const sockaddr_in6&>(address).sin6_addr, text.data(),
                text.size());
  }
  return text.data();
}

int socket_of(MHD_Connection* connection) {
  const MHD_ConnectionInfo* info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
  return info != nullptr ? info->connect_fd : -1;
}

}  // namespace

std::string lower_case(std::string_view text) {
  std::string out(text);
  std::transform(out.begin(), out.end(), out.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  return out;
}

HeaderValue header(MHD_Connection* connection, std::string_view name) {
  HeaderValue found{lower_case(name), std::nullopt, 0};
  const auto visit = [](void* cls, MHD_ValueKind /*kind*/, const char* key, const char* value) {
    auto& wanted = *static_cast<HeaderValue*>(cls);
    if (lower_case(key) == wanted.name) {
      wanted.value =
          value != nullptr && ++wanted.count == 1 ? std::optional<std::string>(value) : std::nullopt;
    }
    return MHD_YES;
  };
  MHD_get_connection_values(connection, MHD_HEADER_KIND, visit, &found);
  return found;
}

std::string peer_of(MHD_Connection* connection) {
  return stream::peer_address(socket_of(connection));
}

std::set<std::string> own_hosts(const std::string& listen, const std::vector<std::string>& more) {
  std::set<std::string> hosts{"localhost", "127.0.0.1", "::1", split_host(listen).host};
  for (const std::string& host : more) {
    hosts.insert(split_host(host).host);
  }
  return hosts;
}

std::string foreign_host(MHD_Connection* connection, const std::set<std::string>& hosts) {
  const auto named = header(connection, MHD_HTTP_HEADER_HOST).value;
  if (named) {
    const std::string host = split_host(*named).host;
    if (hosts.count(host) != 0 || (!host.empty() && host == own_address(socket_of(connection)))) {
      return {};
    }
  }
  return fmt::format("'{}' is no name of this machine: ask for it by one of web.hosts",
                     named.value_or("").substr(0, 100));
}

HttpConnections::HttpConnections(std::size_t places, std::size_t downloads)
    : options_{{MHD_OPTION_NOTIFY_CONNECTION, reinterpret_cast<intptr_t>(&on_connection), this},
               {MHD_OPTION_CONNECTION_LIMIT, static_cast<intptr_t>(places + kEnding), nullptr},
               {MHD_OPTION_CONNECTION_TIMEOUT, static_cast<intptr_t>(kLeastBytesTime.count()), nullptr},
               {MHD_OPTION_CONNECTION_MEMORY_LIMIT, static_cast<intptr_t>(kConnectionBytes), nullptr},
               {MHD_OPTION_END, 0, nullptr}},
      downloads_(downloads),
      places_(places_of(places)) {}

void HttpConnections::on_connection(void* self, MHD_Connection* connection, void** /*context*/,
                                    MHD_ConnectionNotificationCode what) {
  auto& all = *static_cast<HttpConnections*>(self);
  if (what == MHD_CONNECTION_NOTIFY_STARTED) {
    try {
      all.begin(connection);
    } catch (const std::bad_alloc&) {
      ::shutdown(socket_of(connection), SHUT_RDWR);  // nothing may be thrown through the library
    }
  } else {
    all.handed_over(connection);
  }
}

void HttpConnections::begin(MHD_Connection* connection) {
  Entry entry;
  entry.fd = socket_of(connection);
  entry.since = Clock::now();
  const stream::Visitor visitor{stream::peer_address(entry.fd), false};
  const Lock lock(mutex_);
  if (places_.size() >= places_.config().per_peer) {
    look_after_locked(entry.since);
  }
  entry.id = next_id_++;
  const stream::Places::Outcome outcome = places_.enter(entry.id, visitor, entry.since);
  if (outcome.gives_way) {
    const auto idle = std::find_if(entries_.begin(), entries_.end(),
                                   [&](const auto& other) { return other.second.id == *outcome.gives_way; });
    if (idle != entries_.end()) {
      end_locked(idle->second);
    }
  }
  Entry* kept = nullptr;
  try {
    kept = &entries_.insert_or_assign(connection, entry).first->second;
  } catch (const std::bad_alloc&) {
    places_.leave(entry.id);
    throw;
  }
  if (outcome.answer != stream::Places::Answer::Admitted) {
    end_locked(*kept);
  }
}

void HttpConnections::asked(MHD_Connection* connection) {
  const Lock lock(mutex_);
  if (const auto found = entries_.find(connection); found != entries_.end()) {
    Entry& entry = found->second;
    entry.asked = true;
    entry.download = false;
    entry.since = Clock::now();
    entry.acknowledged = acknowledged_bytes(entry.fd);
    entry.acknowledged_before = entry.acknowledged;
    places_.used(entry.id, entry.since);
  }
}

bool HttpConnections::begin_download(MHD_Connection* connection) {
  const Lock lock(mutex_);
  const auto under_way = static_cast<std::size_t>(std::count_if(
      entries_.begin(), entries_.end(), [](const auto& entry) { return entry.second.download; }));
  const auto found = entries_.find(connection);
  if (under_way >= downloads_ || found == entries_.end()) {
    return false;
  }
  found->second.download = true;
  return true;
}

void HttpConnections::handed_over(MHD_Connection* connection) {
  const Lock lock(mutex_);
  if (const auto found = entries_.find(connection); found != entries_.end()) {
    places_.leave(found->second.id);
    entries_.erase(found);
  }
}

/// The library finds the end of the connection and closes it.
void HttpConnections::end_locked(Entry& entry) {
  ::shutdown(entry.fd, SHUT_RDWR);
  places_.leave(entry.id);
  entry.ended = true;
  ++broken_off_;
}

void HttpConnections::look_after_locked(Clock::time_point now) {
  for (auto& [connection, entry] : entries_) {
    if (entry.ended) {
      continue;
    }
    if (!entry.asked) {
      if (now - entry.since >= kRequestTime) {
        end_locked(entry);
      }
      continue;
    }
    const std::uint64_t acknowledged = acknowledged_bytes(entry.fd);
    if (acknowledged != entry.acknowledged) {
      entry.acknowledged = acknowledged;
      places_.used(entry.id, now);
    }
    if (now - entry.since >= kLeastBytesTime) {
      if (acknowledged - entry.acknowledged_before < kLeastBytes) {
        end_locked(entry);
      }
      entry.since = now;
      entry.acknowledged_before = acknowledged;
    }
  }
}

void HttpConnections::look_after(Clock::time_point now) {
  const Lock lock(mutex_);
  look_after_locked(now);
}

std::size_t HttpConnections::size() const {
  const Lock lock(mutex_);
  return places_.size();
}

std::uint64_t HttpConnections::broken_off() const {
  const Lock lock(mutex_);
  return broken_off_;
}

namespace {

MHD_Result on_request(void* answer, MHD_Connection* connection, const char* path, const char* method,
                      const char* /*version*/, const char* /*upload*/, std::size_t* /*upload_size*/,
                      void** /*state*/) {
  try {
    return (*static_cast<const HttpAnswer*>(answer))(connection, path, method);
  } catch (const std::exception&) {
    return MHD_NO;  // closes the connection
  }
}

}  // namespace

HttpServer start_http(const std::string& listen, HttpConnections& connections, const HttpAnswer& answer,
                      std::string_view key, std::string_view what, unsigned flags) {
  if (const auto address = resolve_listen(listen)) {
    flags |= MHD_USE_AUTO_INTERNAL_THREAD | (address->ai_family == AF_INET6 ? MHD_USE_IPv6 : MHD_NO_FLAG);
    if (HttpServer server{MHD_start_daemon(
            flags, 0, nullptr, nullptr, &on_request, const_cast<HttpAnswer*>(&answer), MHD_OPTION_SOCK_ADDR,
            address->ai_addr, MHD_OPTION_ARRAY, connections.options(), MHD_OPTION_END)}) {
      return server;
    }
  }
  throw Error(ErrorKind::Unavailable,
              fmt::format("{0} = \"{1}\": can't listen there: is the port in use, or the address not one of "
                          "this machine? {0} = \"\" turns {2} off",
                          key, listen, what));
}

int port_of(const HttpServer& server) {
  const MHD_DaemonInfo* info = MHD_get_daemon_info(server.get(), MHD_DAEMON_INFO_BIND_PORT);
  return info != nullptr ? info->port : 0;
}

}  // namespace facet::service
