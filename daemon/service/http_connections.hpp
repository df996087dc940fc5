#pragma once

#include <microhttpd.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "facet/clock.hpp"
#include "facet/mutex.hpp"
#include "stream/places.hpp"

namespace facet::service {

/// What a request says of a header: the value where it is there once.
struct HeaderValue {
  std::string name;  ///< in lower case
  std::optional<std::string> value;
  int count = 0;
};
HeaderValue header(MHD_Connection* connection, std::string_view name);

std::string lower_case(std::string_view text);

/// The address that a connection comes from, without its port.
std::string peer_of(MHD_Connection* connection);

/// The names by which a server may be asked for: this machine's own, the address that it listens on, and
/// those of a configuration.
std::set<std::string> own_hosts(const std::string& listen, const std::vector<std::string>& more);

/// Empty where a request names one of these hosts, or the very address that it came to; else why not. A name
/// that a stranger points at this machine is none of them (DNS rebinding).
std::string foreign_host(MHD_Connection* connection, const std::set<std::string>& hosts);

/// Ends those connections of a libmicrohttpd daemon that would keep others out: the library has one thread
/// and so many places, and counts a connection's silence anew with every byte. Here a request has a time as a
/// whole, an answer that nobody takes ends, and the longest idle connection gives way to a new one.
///
/// Give the daemon options(), and call asked() with every request. Any thread; the lock is never held across
/// anything that waits.
class HttpConnections {
 public:
  /// places: connections at a time, those that were handed over not counted.
  explicit HttpConnections(std::size_t places, std::size_t downloads = 0);

  /// With MHD_OPTION_END behind them; valid as long as this.
  MHD_OptionItem* options() { return options_.data(); }

  /// The head of a request has come whole.
  void asked(MHD_Connection* connection);
  /// Its answer is long. False where too many of them are under way.
  bool begin_download(MHD_Connection* connection);
  /// The connection is somebody else's now.
  void handed_over(MHD_Connection* connection);

  /// Ends what takes too long; to be called once a second at least. A new connection that finds no place does
  /// it too.
  void look_after(Clock::time_point now = Clock::now());

  std::size_t size() const;
  std::uint64_t broken_off() const;  ///< connections that were ended here, and that had no place

  /// For the head of a request: a connection brings one.
  static constexpr std::chrono::seconds kRequestTime{5};
  /// An answer of which less is acknowledged in this time is ended.
  static constexpr std::uint64_t kLeastBytes = 64U << 10;
  static constexpr std::chrono::seconds kLeastBytesTime{10};
  /// What the library may have open beyond the places: connections that were ended and that it has not closed
  /// yet.
  static constexpr unsigned kEnding = 16;

 private:
  struct Entry {
    stream::Places::Id id = 0;
    int fd = -1;
    bool asked = false;  ///< it is being answered
    bool download = false;
    bool ended = false;       ///< shut down, the library is to close it
    Clock::time_point since;  ///< it came, or acknowledged so much as it had before
    std::uint64_t acknowledged = 0;
    std::uint64_t acknowledged_before = 0;  ///< at `since`
  };

  static void on_connection(void* self, MHD_Connection* connection, void** /*context*/,
                            MHD_ConnectionNotificationCode what);
  void begin(MHD_Connection* connection);
  void look_after_locked(Clock::time_point now) FACET_REQUIRES(mutex_);
  void end_locked(Entry& entry) FACET_REQUIRES(mutex_);

  std::vector<MHD_OptionItem> options_;
  const std::size_t downloads_;
  mutable Mutex mutex_;
  stream::Places places_ FACET_GUARDED_BY(mutex_);
  /// An entry's descriptor is open: the library says before it closes.
  std::map<MHD_Connection*, Entry> entries_ FACET_GUARDED_BY(mutex_);
  stream::Places::Id next_id_ FACET_GUARDED_BY(mutex_) = 1;
  std::uint64_t broken_off_ FACET_GUARDED_BY(mutex_) = 0;
};

/// Answers a request; what it throws closes the connection.
using HttpAnswer =
    std::function<MHD_Result(MHD_Connection* connection, const char* path, std::string_view method)>;

/// A running server. Destroying it ends its thread.
struct HttpStop {
  void operator()(MHD_Daemon* daemon) const { MHD_stop_daemon(daemon); }
};
using HttpServer = std::unique_ptr<MHD_Daemon, HttpStop>;

/// Serves "ADDRESS:PORT" by one thread, which calls `answer`. Throws Error(Unavailable) where it can't
/// listen: `key` is the configuration's for the address, `what` is off without it. Connections and answer
/// outlive the server.
HttpServer start_http(const std::string& listen, HttpConnections& connections, const HttpAnswer& answer,
                      std::string_view key, std::string_view what, unsigned flags = 0);

int port_of(const HttpServer& server);

}  // namespace facet::service
