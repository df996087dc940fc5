#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "stream/unix_socket.hpp"

namespace facet::service {

/// A connection to a daemon's control socket, for command-line programs. Blocking; one thread.
class ControlClient {
 public:
  /// Throws Error(Unavailable) where nobody answers or we may not connect.
  explicit ControlClient(const std::filesystem::path& socket);

  /// Calls a method and waits for its result, ten seconds at most. Throws Error(Unavailable) where the daemon
  /// does not answer or goes away, and the daemon's own error with its kind and message otherwise.
  nlohmann::json call(const std::string& method, const nlohmann::json& params);

 private:
  std::string exchange(const std::string& request);

  std::filesystem::path socket_;
  stream::FileDescriptor fd_;
  int next_id_ = 1;
};

}  // namespace facet::service
