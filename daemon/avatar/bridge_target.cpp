#include "avatar/bridge_target.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <memory>
#include <system_error>

namespace facet::avatar {
namespace {

/// Of a host name: letters, digits, "-", "_" and ".", of which the last part is no number (that would be an
/// address with a fault in it).
bool is_host_name(const std::string& text) {
  constexpr std::size_t kLongest = 253;
  const auto fits = [](unsigned char c) { return std::isalnum(c) != 0 || c == '-' || c == '_' || c == '.'; };
  const std::string last = text.substr(text.rfind('.') + 1);
  return !text.empty() && text.size() <= kLongest && std::all_of(text.begin(), text.end(), fits) &&
         std::any_of(last.begin(), last.end(), [](unsigned char c) { return std::isalpha(c) != 0; });
}

const sockaddr_in& v4_of(const SocketAddress& address) {
  return reinterpret_cast<const sockaddr_in&>(address.storage);
}
const sockaddr_in6& v6_of(const SocketAddress& address) {
  return reinterpret_cast<const sockaddr_in6&>(address.storage);
}

}  // namespace

const char* to_string(BridgeProtocol protocol) {
  return kBridgeProtocols.at(static_cast<std::size_t>(protocol)).key;
}

std::string BridgeTarget::text() const {
  const bool six = address.find(':') != std::string::npos;
  return six ? fmt::format("[{}]:{}", address, port) : fmt::format("{}:{}", address, port);
}

SocketAddress socket_address(const std::string& address, std::uint16_t port) {
  SocketAddress out;
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

bool same_host(const SocketAddress& one, const SocketAddress& other) {
  if (one.length == 0 || other.length == 0 || one.storage.ss_family != other.storage.ss_family) {
    return false;
  }
  if (one.storage.ss_family == AF_INET) {
    return v4_of(one).sin_addr.s_addr == v4_of(other).sin_addr.s_addr;
  }
  return one.storage.ss_family == AF_INET6 && v6_of(one).sin6_scope_id == v6_of(other).sin6_scope_id &&
         std::memcmp(&v6_of(one).sin6_addr, &v6_of(other).sin6_addr, sizeof(in6_addr)) == 0;
}

bool same_address(const SocketAddress& one, const SocketAddress& other) {
  return same_host(one, other) &&
         (one.storage.ss_family == AF_INET ? v4_of(one).sin_port == v4_of(other).sin_port
                                           : v6_of(one).sin6_port == v6_of(other).sin6_port);
}

bool keep_in_network(int socket, int family) {
  const int hops = 1;
  return ::setsockopt(socket, IPPROTO_IP, IP_TTL, &hops, sizeof(hops)) == 0 &&
         (family != AF_INET6 ||
          ::setsockopt(socket, IPPROTO_IPV6, IPV6_UNICAST_HOPS, &hops, sizeof(hops)) == 0);
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

LookedUp look_up_host(const BridgeTarget& target) {
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
  LookedUp out;
  if (fault != 0 || chosen == nullptr || chosen->ai_addrlen > sizeof(out.address.storage)) {
    out.trouble = fmt::format("no address of the host '{}' was found: {}", target.address,
                              fault != 0 ? ::gai_strerror(fault) : "none of UDP");
    return out;
  }
  std::memcpy(&out.address.storage, chosen->ai_addr, chosen->ai_addrlen);
  out.address.length = chosen->ai_addrlen;
  return out;
}

Listener who_listens(const SocketAddress& address, bool is_tcp) {
  const int type = is_tcp ? SOCK_STREAM : SOCK_DGRAM;
  const int socket = ::socket(address.storage.ss_family, type | SOCK_CLOEXEC, 0);
  if (socket < 0) {
    return Listener::OtherMachine;
  }
  // Of TCP, connections that are over hold the port for a minute: they are nobody.
  const int reuse = is_tcp ? 1 : 0;
  ::setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &reuse, sizeof(reuse));
  const bool had = ::bind(socket, reinterpret_cast<const sockaddr*>(&address.storage), address.length) == 0;
  const int fault = errno;
  ::close(socket);
  return had ? Listener::Nobody : fault == EADDRINUSE ? Listener::Somebody : Listener::OtherMachine;
}

}  // namespace facet::avatar
