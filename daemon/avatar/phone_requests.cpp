#include "avatar/phone_requests.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>

#include "files/json_text.hpp"

namespace facet::avatar {
namespace {

using nlohmann::json;

constexpr std::string_view kIFacialMocapRequest = "iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719";
constexpr std::size_t kMostPorts = 16;
constexpr double kLeastTime_s = 0.5;
constexpr double kMostTime_s = 10;

/// Throws std::exception where it is none.
PhoneRequest vtube_studio_request(std::string_view datagram) {
  constexpr std::size_t kMostValues = 64;
  const json text = files::parse_json(datagram, {kMostRequestBytes, kMostValues, 4}, "request");
  if (text.at("messageType") != "iOSTrackingDataRequest") {
    throw std::runtime_error("another message");
  }
  PhoneRequest request;
  request.protocol = BridgeProtocol::VTubeStudio;
  const auto time_s = text.at("time").get<double>();
  request.lasting = std::chrono::milliseconds(
      static_cast<std::int64_t>(1000 * std::clamp(time_s, kLeastTime_s, kMostTime_s)));
  const json& ports = text.at("ports");
  if (!ports.is_array() || ports.empty() || ports.size() > kMostPorts) {
    throw std::runtime_error("no ports, or too many");
  }
  for (const json& port : ports) {
    const auto number = port.is_number_integer() ? port.get<std::int64_t>() : 0;
    if (number < 1 || number > 65535) {
      throw std::runtime_error("no port");
    }
    request.ports.push_back(static_cast<std::uint16_t>(number));
  }
  return request;
}

/// A socket of "::" hears who has an IPv4 address as ::ffff:A.B.C.D: that address as such.
SocketAddress without_mapping(const SocketAddress& address) {
  const auto& v6 = reinterpret_cast<const sockaddr_in6&>(address.storage);
  if (address.storage.ss_family != AF_INET6 || !IN6_IS_ADDR_V4MAPPED(&v6.sin6_addr)) {
    return address;
  }
  SocketAddress out;
  auto& v4 = reinterpret_cast<sockaddr_in&>(out.storage);
  v4.sin_family = AF_INET;
  v4.sin_port = v6.sin6_port;
  std::memcpy(&v4.sin_addr, &v6.sin6_addr.s6_addr[12], sizeof(v4.sin_addr));
  out.length = sizeof(v4);
  return out;
}

void set_port(SocketAddress& address, std::uint16_t port) {
  if (address.storage.ss_family == AF_INET6) {
    reinterpret_cast<sockaddr_in6&>(address.storage).sin6_port = htons(port);
  } else {
    reinterpret_cast<sockaddr_in&>(address.storage).sin_port = htons(port);
  }
}

/// Of what stands behind the request, "|A|B".
IFacialMocapVersion version_of(std::string_view options) {
  while (!options.empty()) {
    options.remove_prefix(1);
    const std::string_view option = options.substr(0, options.find('|'));
    if (option == "sendDataVersion=v2") {
      return IFacialMocapVersion::V2;
    }
    options.remove_prefix(option.size());
  }
  return IFacialMocapVersion::V1;
}

}  // namespace

std::optional<PhoneRequest> parse_phone_request(std::string_view datagram) {
  if (datagram.size() > kMostRequestBytes) {
    return std::nullopt;
  }
  if (datagram.starts_with(kIFacialMocapRequest)) {
    const std::string_view rest = datagram.substr(kIFacialMocapRequest.size());
    if (!rest.empty() && rest.front() != '|') {
      return std::nullopt;
    }
    return PhoneRequest{
        BridgeProtocol::IFacialMocap, {kIFacialMocapPort}, kIFacialMocapLasts, version_of(rest)};
  }
  try {
    return vtube_studio_request(datagram);
  } catch (const std::exception&) {
    return std::nullopt;
  }
}

PhoneRequests::PhoneRequests(const std::string& address) {
  for (const std::uint16_t port : {kIFacialMocapPort, kVTubeStudioPort}) {
    const SocketAddress own = socket_address(address, port);
    const int socket = ::socket(own.storage.ss_family, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (socket < 0 || ::bind(socket, reinterpret_cast<const sockaddr*>(&own.storage), own.length) < 0) {
      fault_ =
          fmt::format("requests can't be heard at {}: {}",
                      BridgeTarget{BridgeProtocol::IFacialMocap, address, port}.text(), std::strerror(errno));
    }
    if (socket >= 0) {
      sockets_.push_back(socket);
    }
  }
}

PhoneRequests::~PhoneRequests() {
  for (const int socket : sockets_) {
    ::close(socket);
  }
}

BridgeTarget Asker::target() const {
  const bool six = address.storage.ss_family == AF_INET6;
  const auto& v4 = reinterpret_cast<const sockaddr_in&>(address.storage);
  const auto& v6 = reinterpret_cast<const sockaddr_in6&>(address.storage);
  std::array<char, INET6_ADDRSTRLEN> text{};
  const void* const bytes =
      six ? static_cast<const void*>(&v6.sin6_addr) : static_cast<const void*>(&v4.sin_addr);
  const char* const digits = ::inet_ntop(address.storage.ss_family, bytes, text.data(), text.size());
  return {protocol, digits != nullptr ? digits : "", ntohs(six ? v6.sin6_port : v4.sin_port)};
}

void PhoneRequests::hear(const Welcome& welcome, const Take& take) const {
  constexpr int kMostDatagrams = 64;
  std::array<char, kMostRequestBytes + 1> datagram{};
  int left = kMostDatagrams;
  for (const int socket : sockets_) {
    for (; left > 0; --left) {
      SocketAddress from;
      from.length = sizeof(from.storage);
      const auto size = ::recvfrom(socket, datagram.data(), datagram.size(), 0,
                                   reinterpret_cast<sockaddr*>(&from.storage), &from.length);
      if (size < 0) {
        break;
      }
      from = without_mapping(from);
      if (!welcome(from)) {
        continue;
      }
      const auto request = parse_phone_request({datagram.data(), static_cast<std::size_t>(size)});
      for (const std::uint16_t port : request ? request->ports : std::vector<std::uint16_t>()) {
        Asker asker{request->protocol, from, request->lasting, request->version};
        set_port(asker.address, port);
        take(asker);
      }
    }
  }
}

}  // namespace facet::avatar
