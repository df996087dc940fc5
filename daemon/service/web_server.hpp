#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "facet/clock.hpp"
#include "service/config.hpp"
#include "service/control_server.hpp"
#include "stream/server.hpp"

namespace facet::service {

struct WebStatistics {
  std::uint64_t requests = 0;      ///< of HTTP, handshakes counted
  std::uint64_t refused = 0;       ///< for their host, origin, method, path or token
  std::uint64_t wrong_tokens = 0;  ///< also those that were not looked at, because too many had come
  std::string last_refusal;        ///< for people
  /// Connections that were closed because they took too long, or gave their place to another, or had none.
  std::uint64_t broken_off = 0;
};

/// The files of a take, for whoever wants to download it.
struct TakeFiles {
  std::filesystem::path take;
  std::vector<std::filesystem::path> segments;  ///< of its pictures, in their order
  std::string obstacle;  ///< empty; else why it can't be downloaded now, for people and without paths
};
/// The take of a name; none where there is no such take. Called on the server's thread: it must not wait, for
/// no lock and no disk.
using FindTake = std::function<std::optional<TakeFiles>(const std::string& name)>;

/// Looks it up in the folder. Reads the take's index, but waits for nobody who has it locked.
std::optional<TakeFiles> find_take(const std::filesystem::path& folder, const std::string& name);

/// Serves the page, takes for download and the handshakes of two WebSockets over HTTP (docs/web.md): /stream
/// is handed over to the stream server, /control to the control server. A request counts only where it names
/// a host that is ours (a name that a stranger points at this machine is none) and comes from a page that is
/// ours. On this machine looking needs no more; where others are meant to reach the address (web.public) it
/// needs a token, and who wants to change something shows one in the handshake everywhere (WebTokens).
///
/// The page's files are read once, so that no request ever names a file of the disk but a take. One thread,
/// of libmicrohttpd, which blocks on nobody; connections that ask for nothing or take nothing are closed
/// (HttpConnections). A download has one file open at a time. Destroying it ends the thread; connections that
/// were handed over live on.
class WebServer {
 public:
  /// Borrows both servers. Makes the token's file where there is none, or no token in it. Throws
  /// Error(Unavailable) where it can't listen, Error(Storage) where the token can't be read or made.
  WebServer(const WebConfig& config, std::filesystem::path takes, FindTake find_take,
            stream::StreamServer& stream, ControlServer& control);
  ~WebServer();
  WebServer(const WebServer&) = delete;
  WebServer& operator=(const WebServer&) = delete;

  int port() const;
  std::string url() const;  ///< for people, "http://ADDRESS:PORT/"
  bool has_page() const;
  /// What was wrong with the token's file, which was set aside and made anew; empty: nothing.
  const std::string& token_fault() const;
  WebStatistics statistics() const;  ///< any thread

  /// Ends connections that take too long; to be called once a second at least. Any thread.
  void look_after(Clock::time_point now = Clock::now());

  static constexpr std::size_t kMostPageBytes = 32U << 20;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::service
