#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "facet/clock.hpp"
#include "facet/mutex.hpp"
#include "service/config.hpp"
#include "service/control_protocol.hpp"
#include "stream/places.hpp"
#include "stream/unix_socket.hpp"
#include "stream/web_socket.hpp"

namespace facet::service {

/// Answers control requests of many clients over a Unix stream socket. It owns no thread: whoever runs the
/// daemon's loop waits for fd() to become readable, or for due(), and calls serve(), which never blocks on a
/// client and answers at most one request of each: what a round takes does not depend on how much was asked.
/// Requests of one client are answered in their order; what a method leaves to an errands' thread holds up
/// that client alone. There are config.max_clients places for clients of the socket and as many for those of
/// the page; one client more takes the place of who was silent longest (stream::Places), or is told so and
/// closed; a quarter of them is for those who may command. Who may connect is for the socket's mode and group
/// to say; who may change something is checked again by the peer's credentials. A client that asks and
/// doesn't read is dropped.
class ControlServer {
 public:
  /// Binds the socket, or takes the one passed; errors as ListeningSocket. The errands of `methods` are
  /// stopped before their objects are freed; they may outlive this object.
  ControlServer(const ControlConfig& config, ControlMethods methods, stream::FileDescriptor passed = {});
  ~ControlServer();
  ControlServer(const ControlServer&) = delete;
  ControlServer& operator=(const ControlServer&) = delete;

  /// Readable while there is something for serve() to do.
  int fd() const { return epoll_.get(); }
  /// When serve() has to be called at the latest though fd() is not readable; nothing: within a second.
  std::optional<Clock::time_point> due() const;

  /// Accepts, reads, answers and writes what can be done without waiting. Calls the methods. To be called
  /// once a second at least, so that clients who take no answers are noticed.
  void serve();

  /// Takes over a TCP connection whose WebSocket handshake is done; each text message is then a request line,
  /// and each answer a text message. `peer`: who it is for the limit of places (an address). `early`: what
  /// has come of the client's bytes already. Any thread; serve() does the rest. A connection too many is
  /// closed.
  void adopt(stream::FileDescriptor connection, const Caller& caller, std::string peer,
             std::vector<std::uint8_t> early);

  /// Nobody can connect any more, and the socket's path is free.
  void close_door();

  std::size_t client_count() const { return clients_.size(); }

  /// A client that takes nothing of its answers for so long is dropped.
  static constexpr std::chrono::seconds kPatience{10};
  /// All answers together that those who may only look leave unread, bytes: above it who leaves most is
  /// dropped.
  static constexpr std::size_t kMaxUnreadBytes = 16U << 20;
  /// Requests that a client who may only look has answered at once, and in a second after that.
  static constexpr int kLooksAtOnce = 40;
  static constexpr int kLooksPerSecond = 20;

 private:
  struct Client {
    stream::FileDescriptor fd;
    std::uint64_t id = 0;
    Caller caller;
    std::optional<stream::WebSocketAssembler> web;  ///< none: lines over a Unix socket
    std::string received;                           ///< what is not yet an exchange
    bool whole = true;                              ///< `received` may hold a whole request
    bool ended = false;                             ///< sends no more
    bool deaf = false;                              ///< takes no more
    std::optional<ControlExchange> exchange;        ///< what it asked, while it is answered
    bool at_work = false;                           ///< an errands' thread makes an answer
    bool notified = false;                          ///< what is at work wants no answer
    std::string unsent;
    std::size_t sent = 0;           ///< of unsent
    Clock::time_point waits_since;  ///< last time that it took something of unsent
    double looks_left = kLooksAtOnce;
    Clock::time_point counted;  ///< looks_left is of this time
    std::uint32_t watched = 0;  ///< epoll events
    bool last_words = false;    ///< to be closed once unsent is empty
    bool gone = false;
  };

  struct Adopted {
    stream::FileDescriptor connection;
    Caller caller;
    std::string peer;
    std::vector<std::uint8_t> early;
  };

  /// What errands' threads leave for the loop; they may outlive the server.
  struct Mailbox {
    stream::FileDescriptor wake;  ///< eventfd: there is something in it, or more to do at once
    Mutex mutex;
    std::vector<Adopted> adopted FACET_GUARDED_BY(mutex);
    /// Client's id, response.
    std::vector<std::pair<std::uint64_t, std::string>> answers FACET_GUARDED_BY(mutex);

    void rouse() const;
  };

  std::size_t request_limit(const Client& client) const;
  void accept_clients();
  void read_mailbox();
  void admit(Client& client, std::string peer);
  bool receive(Client& client);
  void hear_out(Client& client);
  void take_turns();
  void take_turn(Client& client);
  bool may_go_on(const Client& client, Clock::time_point now) const;
  bool has_looks(const Client& client, Clock::time_point now) const;
  static void charge(Client& client);
  static std::size_t unread_bytes(const Client& client);
  void begin_exchange(Client& client);
  void begin_line(Client& client);
  void begin_message(Client& client);
  static void refuse(Client& client, const std::string& why);
  static void close_web(Client& client, stream::WebSocketClose code, std::string_view why);
  static void say(Client& client, std::string response);
  void send_some(Client& client);
  void drop_greediest();
  void watch(Client& client);

  ControlMethods methods_;
  stream::ListeningSocket listening_;
  stream::FileDescriptor epoll_;
  std::deque<Client> clients_;
  stream::Places local_places_;  ///< Unix clients
  stream::Places page_places_;
  std::uint64_t next_id_ = 2;

  std::uint64_t turn_ = 0;  ///< id of the client whose turn was last
  std::vector<std::pair<std::uint64_t, std::string>> taken_answers_;  ///< of read_mailbox(): its room stays
  std::shared_ptr<Mailbox> mailbox_ = std::make_shared<Mailbox>();
};

}  // namespace facet::service
