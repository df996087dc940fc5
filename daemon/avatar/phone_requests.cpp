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

/// In digits, with another port. False for what is no address of IP.
bool readdress(SocketAddress& address, std::uint16_t port, std::string& digits) {
  std::array<char, INET6_ADDRSTRLEN> text{};
  const char* done = nullptr;
  if (address.storage.ss_family == AF_INET) {
    auto* v4 = reinterpret_cast<sockaddr_in*>(&address.storage);
    v4->sin_port = htons(port);
    done = ::inet_ntop(AF_INET, &v4->sin_addr, text.data(), text.size());
  } else if (address.storage.ss_family == AF_INET6) {
    auto* v6 = reinterpret_cast<sockaddr_in6*>(&address.storage);
    v6->sin6_port = htons(port);
    done = ::inet_ntop(AF_INET6, &v6->sin6_addr, text.data(), text.size());
  }
  digits = done == nullptr ? "" : done;
  return done != nullptr;
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
    return PhoneRequest{BridgeProtocol::IFacialMocap, {kIFacialMocapPort}, kIFacialMocapLasts};
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

std::vector<Asker> PhoneRequests::heard() const {
  constexpr int kMostDatagrams = 64;
  std::vector<Asker> askers;
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
      const auto request = parse_phone_request({datagram.data(), static_cast<std::size_t>(size)});
      for (const std::uint16_t port : request ? request->ports : std::vector<std::uint16_t>()) {
        Asker asker{{request->protocol, "", port}, from, request->lasting};
        if (readdress(asker.address, port, asker.target.address)) {
          askers.push_back(std::move(asker));
        }
      }
    }
  }
  return askers;
}

}  // namespace facet::avatar
