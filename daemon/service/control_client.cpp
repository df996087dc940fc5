#include "service/control_client.hpp"

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/time.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>

#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "service/control_protocol.hpp"

namespace facet::service {
namespace {

using nlohmann::json;

constexpr timeval kTimeout{10, 0};
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

ControlClient::ControlClient(const std::filesystem::path& socket)
    : socket_(socket), fd_(stream::connect_unix(socket)) {
  ::setsockopt(fd_.get(), SOL_SOCKET, SO_RCVTIMEO, &kTimeout, sizeof(kTimeout));
  ::setsockopt(fd_.get(), SOL_SOCKET, SO_SNDTIMEO, &kTimeout, sizeof(kTimeout));
}

std::string ControlClient::exchange(const std::string& request) {
  const auto fail = [&](const std::string& what) {
    return Error(ErrorKind::Unavailable, fmt::format("control socket '{}': {}", socket_.string(), what));
  };
  for (std::size_t sent = 0; sent < request.size();) {
    const ssize_t count = ::send(fd_.get(), request.data() + sent, request.size() - sent, MSG_NOSIGNAL);
    if (count < 0 && (errno == EPIPE || errno == ECONNRESET)) {
      break;  // a daemon that hangs up in the middle has said why
    }
    if (count < 0 && errno != EINTR) {
      throw fail(fmt::format("the daemon takes no requests: {}", std::strerror(errno)));
    }
    sent += count > 0 ? static_cast<std::size_t>(count) : 0;
  }
  std::string response;
  std::array<char, 65536> piece{};
  while (response.empty() || response.back() != '\n') {
    const ssize_t count = ::recv(fd_.get(), piece.data(), piece.size(), 0);
    if (count == 0) {
      throw fail("the daemon went away without an answer");
    }
    if (count < 0 && errno != EINTR) {
      throw fail(errno == EAGAIN ? std::string("the daemon gave no answer for 10 s") : std::strerror(errno));
    }
    response.append(piece.data(), count > 0 ? static_cast<std::size_t>(count) : 0);
    if (response.size() > kMaxResponseBytes) {
      throw fail("the answer is too long to be one of facetd");
    }
  }
  return response;
}

json ControlClient::call(const std::string& method, const json& params) {
  const int id = next_id_++;
  const json request = {{"jsonrpc", "2.0"}, {"method", method}, {"params", params}, {"id", id}};
  const std::string line = request.dump(-1, ' ', false, json::error_handler_t::replace) + '\n';
  json response;
  try {
    response = files::parse_json(exchange(line), {kMaxResponseBytes, kMaxResponseValues}, "its answer");
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
  return response["result"];
}

}  // namespace facet::service
