#pragma once

#include <arpa/inet.h>
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <initializer_list>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "avatar/bridge_target.hpp"

namespace facet::test {

inline std::string big_endian(std::uint32_t number, int bytes) {
  std::string out;
  for (int i = bytes - 1; i >= 0; --i) {
    out += static_cast<char>(number >> static_cast<unsigned>(8 * i));
  }
  return out;
}

inline std::string mdns_name(const std::vector<std::string>& labels) {
  std::string out;
  for (const std::string& label : labels) {
    out += static_cast<char>(label.size()) + label;
  }
  return out + '\0';
}

inline std::string mdns_record(const std::string& name, std::uint32_t type, const std::string& data) {
  return name + big_endian(type, 2) + big_endian(1, 2) + big_endian(10, 4) +
         big_endian(static_cast<std::uint32_t>(data.size()), 2) + data;
}

struct MdnsService {
  std::string name;
  std::uint16_t port;  ///< 0: the answer has none
};
/// An answer of multicast DNS that names these.
inline std::string mdns_answer(const std::vector<MdnsService>& services) {
  std::string records;
  std::uint32_t count = 0;
  for (const auto& [name, port] : services) {
    const std::string instance = mdns_name({name, "_oscjson", "_tcp", "local"});
    records += mdns_record(mdns_name({"_oscjson", "_tcp", "local"}), 12, instance);
    ++count;
    if (port != 0) {
      records += mdns_record(instance, 33,
                             std::string(4, '\0') + big_endian(port, 2) + mdns_name({"host", "local"}));
      ++count;
    }
  }
  return big_endian(0, 2) + big_endian(0x8400, 2) + big_endian(0, 2) + big_endian(count, 2) +
         big_endian(0, 4) + records;
}

struct StandInParameter {
  std::string name;
  std::string type;
};
/// "/avatar" as VRChat tells it.
inline std::string avatar_json(const std::string& avatar, const std::vector<StandInParameter>& parameters) {
  using nlohmann::json;
  json leaves = json::object();
  for (const auto& [name, type] : parameters) {
    leaves[name] = {
        {"FULL_PATH", "/avatar/parameters/" + name}, {"ACCESS", 3}, {"TYPE", type}, {"VALUE", {0}}};
  }
  return json{
      {"FULL_PATH", "/avatar"},
      {"ACCESS", 0},
      {"CONTENTS",
       {{"change",
         {{"FULL_PATH", "/avatar/change"}, {"ACCESS", 3}, {"TYPE", "s"}, {"VALUE", json::array({avatar})}}},
        {"parameters", {{"FULL_PATH", "/avatar/parameters"}, {"ACCESS", 0}, {"CONTENTS", leaves}}}}}}
      .dump();
}

/// Answers questions of multicast DNS that come to a port of its own.
class MdnsStandIn {
 public:
  MdnsStandIn() : socket_(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    avatar::SocketAddress own = avatar::socket_address("127.0.0.1", 0);
    EXPECT_EQ(::bind(socket_, reinterpret_cast<sockaddr*>(&own.storage), own.length), 0);
    EXPECT_EQ(::getsockname(socket_, reinterpret_cast<sockaddr*>(&own.storage), &own.length), 0);
    address_ = own;
    thread_ = std::jthread([this] { run(); });
  }
  ~MdnsStandIn() {
    stopping_ = true;
    thread_.join();
    ::close(socket_);
  }
  MdnsStandIn(const MdnsStandIn&) = delete;
  MdnsStandIn& operator=(const MdnsStandIn&) = delete;

  const avatar::SocketAddress& address() const { return address_; }
  /// ports_alone: a port is told only to who asks for it.
  void tell(std::vector<MdnsService> services, bool ports_alone = false) {
    const std::scoped_lock lock(mutex_);
    services_ = std::move(services);
    ports_alone_ = ports_alone;
  }

 private:
  void run() {
    pollfd waited{socket_, POLLIN, 0};
    std::array<char, 2048> question{};
    while (!stopping_) {
      sockaddr_storage from{};
      socklen_t length = sizeof(from);
      if (::poll(&waited, 1, 10) != 1) {
        continue;
      }
      const auto size = ::recvfrom(socket_, question.data(), question.size(), 0,
                                   reinterpret_cast<sockaddr*>(&from), &length);
      const bool for_names = size > 4 && question.at(static_cast<std::size_t>(size) - 3) == 12;
      std::string answer;
      {
        const std::scoped_lock lock(mutex_);
        std::vector<MdnsService> told = services_;
        for (MdnsService& service : told) {
          service.port = for_names && ports_alone_ ? 0 : service.port;
        }
        answer = mdns_answer(told);
      }
      ::sendto(socket_, answer.data(), answer.size(), 0, reinterpret_cast<const sockaddr*>(&from), length);
    }
  }

  int socket_;
  avatar::SocketAddress address_;
  std::atomic<bool> stopping_ = false;
  std::mutex mutex_;
  std::vector<MdnsService> services_;
  bool ports_alone_ = false;
  std::jthread thread_;
};

/// A web server that tells what a VRChat does, one connection at a time; closed, nobody listens there.
class WebStandIn {
 public:
  /// silent: it takes connections and says nothing.
  explicit WebStandIn(bool silent = false)
      : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)), silent_(silent) {
    avatar::SocketAddress own = avatar::socket_address("127.0.0.1", 0);
    EXPECT_EQ(::bind(socket_, reinterpret_cast<sockaddr*>(&own.storage), own.length), 0);
    EXPECT_EQ(::listen(socket_, 16), 0);
    EXPECT_EQ(::getsockname(socket_, reinterpret_cast<sockaddr*>(&own.storage), &own.length), 0);
    port_ = ntohs(reinterpret_cast<const sockaddr_in&>(own.storage).sin_port);
    thread_ = std::jthread([this] { run(); });
  }
  ~WebStandIn() { close(); }
  WebStandIn(const WebStandIn&) = delete;
  WebStandIn& operator=(const WebStandIn&) = delete;

  void close() {
    stopping_ = true;
    if (thread_.joinable()) {
      thread_.join();
      ::close(socket_);
    }
  }
  std::uint16_t port() const { return port_; }
  int asked() const { return asked_; }
  void tell(const std::string& path, const std::string& body) {
    const std::scoped_lock lock(mutex_);
    pages_[path] = body;
  }
  /// All of a VRChat.
  void tell_all(std::uint16_t osc_port, const std::string& avatar,
                const std::vector<StandInParameter>& parameters, const std::string& osc_ip = "127.0.0.1") {
    tell("/?HOST_INFO",
         fmt::format(R"({{"OSC_IP":"{}","OSC_PORT":{},"OSC_TRANSPORT":"UDP"}})", osc_ip, osc_port));
    tell("/avatar/change",
         fmt::format(R"({{"FULL_PATH":"/avatar/change","TYPE":"s","VALUE":["{}"]}})", avatar));
    tell("/avatar", avatar_json(avatar, parameters));
  }

 private:
  void run() {
    pollfd waited{socket_, POLLIN, 0};
    std::vector<int> held;
    while (!stopping_) {
      if (::poll(&waited, 1, 10) != 1) {
        continue;
      }
      const int peer = ::accept4(socket_, nullptr, nullptr, SOCK_CLOEXEC);
      ++asked_;
      if (silent_) {
        held.push_back(peer);
        continue;
      }
      std::string request;
      std::array<char, 1024> piece{};
      while (request.find("\r\n\r\n") == std::string::npos) {
        const ssize_t size = ::recv(peer, piece.data(), piece.size(), 0);
        if (size <= 0) {
          break;
        }
        request.append(piece.data(), static_cast<std::size_t>(size));
      }
      const std::string path = request.substr(4, request.find(' ', 4) - 4);
      std::string answer = "HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n";
      {
        const std::scoped_lock lock(mutex_);
        if (const auto page = pages_.find(path); page != pages_.end()) {
          answer = fmt::format("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n{}", page->second.size(),
                               page->second);
        }
      }
      ::send(peer, answer.data(), answer.size(), MSG_NOSIGNAL);
      ::close(peer);
    }
    for (const int peer : held) {
      ::close(peer);
    }
  }

  int socket_;
  bool silent_;
  std::uint16_t port_ = 0;
  std::atomic<bool> stopping_ = false;
  std::atomic<int> asked_ = 0;
  std::mutex mutex_;
  std::map<std::string, std::string> pages_;
  std::jthread thread_;
};

}  // namespace facet::test
