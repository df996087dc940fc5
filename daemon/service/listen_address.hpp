#pragma once

#include <netdb.h>

#include <memory>
#include <string>

namespace facet::service {

/// "ADDRESS:PORT" of a configuration or a Host header, apart.
struct HostAndPort {
  std::string host;  ///< in lower case; of IPv6 without its brackets
  std::string port;  ///< empty: none was named
};

/// Any text; what is no host or port comes back as it is.
HostAndPort split_host(const std::string& text);

/// "ADDRESS:PORT" as a socket address; null where there is none.
std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> resolve_listen(const std::string& listen);

}  // namespace facet::service
