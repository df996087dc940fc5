#include "service/control_client.hpp"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "service/control_protocol.hpp"

namespace facet::service {
namespace {

using nlohmann::json;

constexpr std::size_t kMaxResponseBytes = 64U << 20;
constexpr std::size_t kMaxResponseValues = 4'000'000;

/// The kind of the facet::Error that the daemon met.
ErrorKind kind_of(int code) {
  const int kind = kServerErrorBase - code;
  if (kind >= static_cast<int>(ErrorKind::Internal) && kind <= static_cast<int>(ErrorKind::Unavailable)) {
    return static_cast<ErrorKind>(kind);
  }
  return code == kInvalidParams ? ErrorKind::Usage : ErrorKind::Unavailable;
}

}  // namespace

ControlClient::ControlClient(const std::filesystem::path& socket, std::chrono::milliseconds patience)
    : socket_(socket), patience_(patience) {}

std::string ControlClient::exchange(const std::string& request, stream::Deadline deadline) {
  const auto fail = [&](const std::string& what) {
    return Error(ErrorKind::Unavailable, fmt::format("control socket '{}': {}", socket_.string(), what));
  };
  for (std::size_t sent = 0; sent < request.size();) {
    if (!stream::wait_for(fd_.get(), POLLOUT, deadline)) {
      throw fail(fmt::format("the daemon took no request for {} ms", patience_.count()));
    }
    const ssize_t count =
        ::send(fd_.get(), request.data() + sent, request.size() - sent, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (count < 0 && (errno == EPIPE || errno == ECONNRESET)) {
      break;  // a daemon that hangs up in the middle has said why
    }
    if (count < 0 && errno != EINTR && errno != EAGAIN) {
      throw fail(fmt::format("the daemon takes no requests: {}", std::strerror(errno)));
    }
    sent += count > 0 ? static_cast<std::size_t>(count) : 0;
  }
  std::string response;
  std::array<char, 65536> piece{};
  while (response.empty() || response.back() != '\n') {
    // By the clock, too: an answer that comes byte by byte is always there to be read.
    if (!stream::wait_for(fd_.get(), POLLIN, deadline) || (!response.empty() && Clock::now() >= deadline)) {
      throw fail(fmt::format("the daemon gave no {}answer for {} ms", response.empty() ? "" : "whole ",
                             patience_.count()));
    }
    const ssize_t count = ::recv(fd_.get(), piece.data(), piece.size(), MSG_DONTWAIT);
    if (count == 0) {
      throw fail("the daemon went away without an answer");
    }
    if (count < 0 && errno != EINTR && errno != EAGAIN) {
      throw fail(std::strerror(errno));
    }
    response.append(piece.data(), count > 0 ? static_cast<std::size_t>(count) : 0);
    if (response.size() > kMaxResponseBytes) {
      throw fail("the answer is too long to be one of facetd");
    }
  }
  return response;
}

json ControlClient::call(const std::string& method, const json& params) {
  const stream::Deadline deadline = Clock::now() + patience_;
  if (!fd_) {
    fd_ = stream::connect_unix(socket_, deadline);
  }
  const int id = next_id_++;
  const json request = {{"jsonrpc", "2.0"}, {"method", method}, {"params", params}, {"id", id}};
  const std::string line = request.dump(-1, ' ', false, json::error_handler_t::replace) + '\n';
  const std::string text = exchange(line, deadline);
  json response;
  try {
    response = files::parse_json(text, {kMaxResponseBytes, kMaxResponseValues}, "its answer");
  } catch (const Error& error) {
    throw Error(ErrorKind::Unavailable, fmt::format("'{}' does not answer like a facet control socket: {}",
                                                    socket_.string(), error.what()));
  }
  if (!response.is_object() || (!response.contains("result") && !response.contains("error"))) {
    throw Error(ErrorKind::Unavailable,
                fmt::format("'{}' does not answer like a facet control socket", socket_.string()));
  }
  if (response.contains("error")) {
    const json& error = response["error"];
    throw Error(kind_of(error.value("code", 0)),
                error.value("message", std::string("error without a message")));
  }
  return std::move(response["result"]);
}

}  // namespace facet::service
