#pragma once

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "avatar/bridge_target.hpp"
#include "support/child_process.hpp"

namespace facet::test {

/// A program that listens on a port of this machine.
class Receiver {
 public:
  /// digits: of loopback. port 0: any free one.
  explicit Receiver(const std::string& digits = "127.0.0.1", std::uint16_t port = 0)
      : socket_(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    address_.sin_family = AF_INET;
    EXPECT_EQ(::inet_pton(AF_INET, digits.c_str(), &address_.sin_addr), 1);
    address_.sin_port = htons(port);
    socklen_t length = sizeof(address_);
    EXPECT_EQ(::bind(socket_, reinterpret_cast<sockaddr*>(&address_), length), 0);
    EXPECT_EQ(::getsockname(socket_, reinterpret_cast<sockaddr*>(&address_), &length), 0);
  }
  ~Receiver() { close(); }
  Receiver(const Receiver&) = delete;
  Receiver& operator=(const Receiver&) = delete;

  void close() {
    if (socket_ >= 0) {
      ::close(std::exchange(socket_, -1));
    }
  }
  /// Of one at 127.0.0.1.
  avatar::BridgeTarget target(avatar::BridgeProtocol protocol) const {
    return {protocol, "127.0.0.1", ntohs(address_.sin_port)};
  }
  std::uint16_t port() const { return ntohs(address_.sin_port); }

  /// From this port.
  void send(const std::string& text, const std::string& digits, std::uint16_t port) const {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(port);
    EXPECT_EQ(::inet_pton(AF_INET, digits.c_str(), &to.sin_addr), 1);
    EXPECT_EQ(
        ::sendto(socket_, text.data(), text.size(), 0, reinterpret_cast<const sockaddr*>(&to), sizeof(to)),
        static_cast<ssize_t>(text.size()));
  }

  /// The datagrams that come until nothing came for `patience`.
  std::vector<std::string> receive(
      std::chrono::milliseconds patience = std::chrono::milliseconds(300)) const {
    std::vector<std::string> datagrams;
    pollfd waiting{socket_, POLLIN, 0};
    while (::poll(&waiting, 1, static_cast<int>(patience.count())) == 1) {
      std::string datagram(65536, '\0');
      datagram.resize(static_cast<std::size_t>(::recv(socket_, datagram.data(), datagram.size(), 0)));
      datagrams.push_back(std::move(datagram));
    }
    return datagrams;
  }

 private:
  int socket_ = -1;
  sockaddr_in address_{};
};

/// Writes datagrams as the decoders read them: each behind its length.
inline std::filesystem::path write_datagrams(const std::vector<std::string>& datagrams,
                                             const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / "datagrams";
  std::ofstream stream(file, std::ios::binary);
  for (const std::string& datagram : datagrams) {
    const auto length = static_cast<std::uint32_t>(datagram.size());
    stream.write(reinterpret_cast<const char*>(&length), sizeof(length));
    stream << datagram;
  }
  return file;
}

inline std::vector<std::string> texts(const std::vector<std::vector<std::byte>>& datagrams) {
  std::vector<std::string> out;
  for (const std::vector<std::byte>& datagram : datagrams) {
    out.emplace_back(reinterpret_cast<const char*>(datagram.data()), datagram.size());
  }
  return out;
}

/// What decode.py makes of datagrams of a kind.
inline nlohmann::json decode(const std::string& kind, const std::vector<std::string>& datagrams,
                             const std::filesystem::path& folder) {
  ChildProcess python(FACET_PYTHON, {DECODE_SCRIPT, kind, write_datagrams(datagrams, folder).string()},
                      folder / "decoded");
  EXPECT_EQ(python.wait(), 0) << python.output();
  return nlohmann::json::parse(python.output());
}

/// The first message of an address, and with this first argument; null where there is none.
inline nlohmann::json message(const nlohmann::json& messages, const std::string& address,
                              const std::string& name = "") {
  for (const nlohmann::json& found : messages) {
    if (found[0] == address && (name.empty() || found[1] == name)) {
      return found;
    }
  }
  return nullptr;
}

}  // namespace facet::test
