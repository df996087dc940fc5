#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "service/config.hpp"
#include "service/control_protocol.hpp"
#include "stream/unix_socket.hpp"
#include "stream/web_socket.hpp"

namespace facet::service {

/// Answers control requests of many clients over a Unix stream socket. It owns no thread: whoever runs the
/// daemon's loop waits for fd() to become readable and calls serve(), which never blocks on a client. Who may
/// connect is for the socket's mode and group to say; who may change something is checked again by the
/// peer's credentials. A client that asks and doesn't read is dropped.
class ControlServer {
 public:
  /// Binds the socket, or takes the one passed; errors as ListeningSocket.
  ControlServer(const ControlConfig& config, ControlMethods methods, stream::FileDescriptor passed = {});
  ~ControlServer();
  ControlServer(const ControlServer&) = delete;
  ControlServer& operator=(const ControlServer&) = delete;

  /// Readable while there is something for serve() to do.
  int fd() const { return epoll_.get(); }

  /// Accepts, reads, answers and writes what can be done without waiting. Calls the methods. To be called
  /// once a second at least, so that clients who take no answers are noticed.
  void serve();

  /// Takes over a TCP connection whose WebSocket handshake is done; each text message is then a request line,
  /// and each answer a text message. `early`: what has come of the client's bytes already. Any thread;
  /// serve() does the rest. A connection too many is told so and closed.
  void adopt(stream::FileDescriptor connection, const Caller& caller, std::vector<std::uint8_t> early);

  std::size_t client_count() const { return clients_.size(); }

  /// Clients connected at a time; one more is told so and closed.
  static constexpr std::size_t kMaxClients = 64;
  /// A client that leaves this much unread is dropped, bytes.
  static constexpr std::size_t kMaxUnreadBytes = 4U << 20;
  /// A client that takes nothing of its answers for so long is dropped.
  static constexpr std::chrono::seconds kPatience{10};

 private:
  struct Client {
    stream::FileDescriptor fd;
    std::uint64_t id = 0;
    Caller caller;
    std::optional<stream::WebSocketAssembler> web;  ///< none: lines over a Unix socket
    std::string unanswered;                         ///< received, up to one incomplete line
    std::string unsent;
    std::chrono::steady_clock::time_point waits_since;  ///< last time that it took something of unsent
    bool last_words = false;                            ///< to be closed once unsent is empty
    bool gone = false;
  };

  struct Adopted {
    stream::FileDescriptor connection;
    Caller caller;
    std::vector<std::uint8_t> early;
  };

  void accept_clients();
  void admit_adopted();
  void admit(Client& client);
  void receive(Client& client);
  void answer(Client& client);
  void answer_web(Client& client, std::span<const std::uint8_t> bytes);
  static void refuse_line(Client& client);
  static void say(Client& client, const std::string& response);
  void send_some(Client& client);
  void watch(const Client& client, int operation);

  ControlMethods methods_;
  std::size_t max_clients_;
  stream::ListeningSocket listening_;
  stream::FileDescriptor epoll_;
  stream::FileDescriptor spare_;  ///< given up for a moment to turn a client away when descriptors run out
  std::deque<Client> clients_;
  std::uint64_t next_id_ = 2;

  stream::FileDescriptor wake_;  ///< eventfd: adopted_ has something
  std::mutex adopted_mutex_;
  std::vector<Adopted> adopted_;  ///< guarded by adopted_mutex_
};

}  // namespace facet::service
