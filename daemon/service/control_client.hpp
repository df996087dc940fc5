#pragma once

#include <chrono>
#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "stream/unix_socket.hpp"

namespace facet::service {

/// A connection to a daemon's control socket, for command-line programs. Blocking; one thread.
class ControlClient {
 public:
  /// patience: of each call, for all that it waits for together.
  explicit ControlClient(const std::filesystem::path& socket,
                         std::chrono::milliseconds patience = std::chrono::seconds(10));

  /// Connects, the first time, calls a method and waits for its result. Throws Error(Unavailable) where
  /// nobody answers, we may not connect, or the daemon goes away or has not answered in time, and the
  /// daemon's own error with its kind and message otherwise.
  nlohmann::json call(const std::string& method, const nlohmann::json& params);

 private:
  std::string exchange(const std::string& request, stream::Deadline deadline);

  std::filesystem::path socket_;
  std::chrono::milliseconds patience_;
  stream::FileDescriptor fd_;  ///< none before the first call
  int next_id_ = 1;
};

}  // namespace facet::service
