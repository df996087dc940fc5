#include "service/listen_address.hpp"

#include <sys/socket.h>

#include <algorithm>

namespace facet::service {

HostAndPort split_host(const std::string& text) {
  HostAndPort apart;
  const std::size_t bracket = text.rfind(']');
  const std::size_t colon = text.rfind(':');
  const bool port = colon != std::string::npos && (bracket == std::string::npos || bracket < colon);
  apart.host = text.substr(0, port ? colon : std::string::npos);
  apart.port = port ? text.substr(colon + 1) : "";
  if (apart.host.size() > 2 && apart.host.front() == '[' && apart.host.back() == ']') {
    apart.host = apart.host.substr(1, apart.host.size() - 2);
  }
  std::transform(apart.host.begin(), apart.host.end(), apart.host.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  return apart;
}

std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> resolve_listen(const std::string& listen) {
  const HostAndPort apart = split_host(listen);
  addrinfo wanted{};
  wanted.ai_socktype = SOCK_STREAM;
  wanted.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  if (::getaddrinfo(apart.host.c_str(), apart.port.c_str(), &wanted, &found) != 0) {
    found = nullptr;
  }
  return {found, &::freeaddrinfo};
}

}  // namespace facet::service
