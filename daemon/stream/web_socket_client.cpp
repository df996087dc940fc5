#include "stream/web_socket_client.hpp"

#include <fmt/format.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <random>
#include <utility>

#include "facet/printable.hpp"
#include "stream/base64.hpp"

namespace facet::stream {
namespace {

constexpr std::size_t kMostHeadBytes = 8192;
/// Who sends more than this before it is read is answered no more.
constexpr std::size_t kMostWaiting = 64;

template <std::size_t Count>
std::array<std::uint8_t, Count> random_bytes() {
  std::random_device random;
  std::uniform_int_distribution<unsigned> byte(0, 255);
  std::array<std::uint8_t, Count> bytes{};
  std::generate(bytes.begin(), bytes.end(), [&] { return static_cast<std::uint8_t>(byte(random)); });
  return bytes;
}

std::string_view trimmed(std::string_view text) {
  const auto is_space = [](char c) { return c == ' ' || c == '\t'; };
  while (!text.empty() && is_space(text.front())) {
    text.remove_prefix(1);
  }
  while (!text.empty() && is_space(text.back())) {
    text.remove_suffix(1);
  }
  return text;
}

bool same_word(std::string_view one, std::string_view other) {
  return std::equal(one.begin(), one.end(), other.begin(), other.end(),
                    [](unsigned char a, unsigned char b) { return std::tolower(a) == std::tolower(b); });
}

}  // namespace

std::string web_socket_refusal(std::string_view head, std::string_view key) {
  constexpr std::string_view kBegin = "HTTP/1.1 ";
  const std::string_view first = head.substr(0, head.find("\r\n"));
  if (!first.starts_with(kBegin)) {
    return "is no WebSocket's server";
  }
  if (!first.substr(kBegin.size()).starts_with("101")) {
    return fmt::format("refuses a WebSocket: {}", printable(first.substr(kBegin.size())));
  }
  std::string_view rest = head.substr(std::min(head.size(), first.size() + 2));
  while (!rest.empty()) {
    const std::size_t end = rest.find("\r\n");
    const std::string_view line = rest.substr(0, end);
    rest = end == std::string_view::npos ? "" : rest.substr(end + 2);
    const std::size_t colon = line.find(':');
    if (colon != std::string_view::npos && same_word(line.substr(0, colon), "Sec-WebSocket-Accept")) {
      return trimmed(line.substr(colon + 1)) == web_socket_accept(key)
                 ? ""
                 : "answers another's WebSocket request";
    }
  }
  return "is no WebSocket's server";
}

void signal_event(int event) {
  const std::uint64_t one = 1;
  [[maybe_unused]] const auto ignored = ::write(event, &one, sizeof(one));
}

void wait_for_event(int event, Clock::duration most) {
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(most).count();
  pollfd waited{event, POLLIN, 0};
  ::poll(&waited, 1, static_cast<int>(std::clamp<std::int64_t>(left, 0, 60'000)));
  std::uint64_t ignored = 0;
  [[maybe_unused]] const auto read = ::read(event, &ignored, sizeof(ignored));
}

WebSocketClient::WebSocketClient(std::string host, std::size_t limit_bytes)
    : host_(std::move(host)),
      key_(base64(random_bytes<16>())),
      assembler_(limit_bytes, WebSocketPeer::Server) {}

std::string WebSocketClient::connect(const sockaddr* address, socklen_t length) {
  socket_.reset(::socket(address->sa_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const int at_once = 1;
  if (!socket_ || (::connect(socket_.get(), address, length) < 0 && errno != EINPROGRESS)) {
    return std::strerror(errno);
  }
  ::setsockopt(socket_.get(), IPPROTO_TCP, TCP_NODELAY, &at_once, sizeof(at_once));
  const std::string request = fmt::format(
      "GET / HTTP/1.1\r\nHost: {}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {}\r\n"
      "Sec-WebSocket-Version: 13\r\n\r\n",
      host_, key_);
  out_.assign(request.begin(), request.end());
  return "";
}

void WebSocketClient::wait(int event, Clock::duration most) const {
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(most).count();
  std::array<pollfd, 2> waited{
      {{socket_.get(), static_cast<short>(out_.empty() ? POLLIN : POLLIN | POLLOUT), 0}, {event, POLLIN, 0}}};
  ::poll(waited.data(), waited.size(), static_cast<int>(std::clamp<std::int64_t>(left, 0, 60'000)));
  std::uint64_t ignored = 0;
  [[maybe_unused]] const auto read = ::read(event, &ignored, sizeof(ignored));
}

std::string WebSocketClient::write() {
  while (!out_.empty()) {
    const ssize_t sent = ::send(socket_.get(), out_.data(), out_.size(), MSG_NOSIGNAL);
    if (sent < 0) {
      return errno == EAGAIN || errno == EINTR || errno == ENOTCONN || errno == EINPROGRESS
                 ? ""
                 : std::strerror(errno);
    }
    out_.erase(out_.begin(), out_.begin() + sent);
  }
  return "";
}

std::string WebSocketClient::work() {
  std::array<std::uint8_t, 16384> piece{};
  for (;;) {
    const ssize_t got = ::recv(socket_.get(), piece.data(), piece.size(), 0);
    if (got == 0) {
      return "closed the connection";
    }
    if (got < 0) {
      if (errno != EAGAIN && errno != EINTR && errno != ENOTCONN) {
        return std::strerror(errno);
      }
      return write();
    }
    if (std::string fault = take(std::span(piece).first(static_cast<std::size_t>(got))); !fault.empty()) {
      return fault;
    }
  }
}

std::string WebSocketClient::take(std::span<const std::uint8_t> bytes) {
  if (!is_open_) {
    head_.append(bytes.begin(), bytes.end());
    const std::size_t end = head_.find("\r\n\r\n");
    if (end == std::string::npos) {
      return head_.size() > kMostHeadBytes ? "is no WebSocket's server" : "";
    }
    if (std::string fault = web_socket_refusal(std::string_view(head_).substr(0, end + 4), key_);
        !fault.empty()) {
      return fault;
    }
    is_open_ = true;
    const std::string rest = head_.substr(end + 4);
    head_.clear();
    return take({reinterpret_cast<const std::uint8_t*>(rest.data()), rest.size()});
  }
  while (!bytes.empty()) {
    switch (assembler_.feed(bytes)) {
      case WebSocketAssembler::Outcome::Incomplete:
        break;
      case WebSocketAssembler::Outcome::Message:
        if (messages_.size() >= kMostWaiting) {
          return "sends more than can be read";
        }
        messages_.emplace_back(assembler_.message().begin(), assembler_.message().end());
        assembler_.next();
        break;
      case WebSocketAssembler::Outcome::Ping:
        if (out_.size() < kMostHeadBytes) {
          send(WebSocketOpcode::Pong,
               {reinterpret_cast<const char*>(assembler_.control().data()), assembler_.control().size()});
        }
        break;
      case WebSocketAssembler::Outcome::Close:
        return "closed the connection";
      case WebSocketAssembler::Outcome::Violation:
        return "breaks the WebSocket's protocol";
      case WebSocketAssembler::Outcome::TooLong:
        return "sends a message that is too long";
    }
  }
  return "";
}

void WebSocketClient::send(std::string_view text) {
  send(WebSocketOpcode::Text, text);
}

void WebSocketClient::send(WebSocketOpcode opcode, std::string_view payload) {
  const std::array<std::uint8_t, 4> mask = random_bytes<4>();
  const WebSocketHeader header(opcode, payload.size());
  out_.insert(out_.end(), header.view().begin(), header.view().end());
  out_[out_.size() - header.size + 1] |= 0x80U;
  out_.insert(out_.end(), mask.begin(), mask.end());
  for (std::size_t i = 0; i < payload.size(); ++i) {
    out_.push_back(static_cast<std::uint8_t>(payload[i]) ^ mask.at(i % mask.size()));
  }
}

std::optional<std::string> WebSocketClient::next() {
  if (messages_.empty()) {
    return std::nullopt;
  }
  std::string message = std::move(messages_.front());
  messages_.pop_front();
  return message;
}

}  // namespace facet::stream
