#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "service/config.hpp"
#include "service/control_server.hpp"
#include "stream/server.hpp"

namespace facet::service {

struct WebStatistics {
  std::uint64_t requests = 0;      ///< of HTTP, handshakes counted
  std::uint64_t refused = 0;       ///< for their host, origin, method, path or token
  std::uint64_t wrong_tokens = 0;  ///< also those that were not looked at, because too many had come
  std::string last_refusal;        ///< for people
};

/// Serves the page, takes for download and the handshakes of two WebSockets over HTTP (docs/web.md): /stream
/// is handed over to the stream server, /control to the control server. A request counts only where it names
/// a host that is ours (a name that a stranger points at this machine is none) and comes from a page that is
/// ours. Looking needs no more; who wants to change something shows the token in the handshake.
///
/// The page's files are read once, so that no request ever names a file of the disk but a take. One thread,
/// of libmicrohttpd, which blocks on nobody. Destroying it ends the thread; connections that were handed over
/// live on.
class WebServer {
 public:
  /// Borrows both servers. Makes the token's file where there is none or no token in it. Throws
  /// Error(Unavailable) where it can't listen, Error(Storage) where the token can't be read or made.
  WebServer(const WebConfig& config, std::filesystem::path takes, stream::StreamServer& stream,
            ControlServer& control);
  ~WebServer();
  WebServer(const WebServer&) = delete;
  WebServer& operator=(const WebServer&) = delete;

  int port() const;
  std::string url() const;  ///< for people, "http://ADDRESS:PORT/"
  bool has_page() const;
  /// What was wrong with the token's file, which was set aside and made anew; empty: nothing.
  const std::string& token_fault() const;
  WebStatistics statistics() const;  ///< any thread

  /// Guesses of the token that are looked at in a row; after them one in kGuessPeriod.
  static constexpr int kGuesses = 5;
  static constexpr std::chrono::seconds kGuessPeriod{10};
  /// Requests at a time, those that are handed over not counted.
  static constexpr unsigned kMostConnections = 64;
  static constexpr std::size_t kMostPageBytes = 32U << 20;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::service
