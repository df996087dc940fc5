#include "stream/http_get.hpp"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <utility>

#include "facet/printable.hpp"

namespace facet::stream {
namespace {

constexpr std::size_t kMostAnswerHeadBytes = 8192;
constexpr std::size_t kMostChunkLine = 256;
/// At a time, so that others have their turn.
constexpr int kMostReads = 16;
constexpr std::string_view kLineEnd = "\r\n";

/// The digits at the text's beginning; end: what may follow them.
bool read_number(std::string_view text, int base, std::string_view end, std::size_t& number) {
  const auto [read, fault] = std::from_chars(text.data(), text.data() + text.size(), number, base);
  const auto count = static_cast<std::size_t>(read - text.data());
  return fault == std::errc() && (count == text.size() || end.find(text[count]) != std::string_view::npos);
}

std::string lower_case(std::string_view text) {
  std::string out(text);
  std::transform(out.begin(), out.end(), out.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return out;
}

}  // namespace

bool HttpAnswer::refuse(std::string why) {
  fault_ = std::move(why);
  return false;
}

bool HttpAnswer::feed(std::string_view bytes, bool closed) {
  raw_.append(bytes);
  if (kind_ == Body::Unknown) {
    const std::size_t end = raw_.find("\r\n\r\n");
    if (end == std::string::npos) {
      return raw_.size() <= kMostAnswerHeadBytes && !closed ? true : refuse("is no web server");
    }
    if (!read_head(end)) {
      return false;
    }
    raw_.erase(0, end + 4);
  }
  switch (kind_) {
    case Body::Unknown:
      break;
    case Body::OfLength:
      if (raw_.size() >= length_) {
        body_ = raw_.substr(0, length_);
        return false;
      }
      break;
    case Body::InChunks:
      if (!read_chunks()) {
        return false;
      }
      break;
    case Body::UntilClosed:
      if (raw_.size() > most_) {
        return refuse("sends more than is wanted");
      }
      if (closed) {
        body_ = std::move(raw_);
        return false;
      }
      break;
  }
  return closed ? refuse("closed the connection") : true;
}

bool HttpAnswer::read_head(std::size_t end) {
  constexpr std::string_view kBegin = "HTTP/1.";
  std::string_view rest = std::string_view(raw_).substr(0, end + kLineEnd.size());
  const std::string_view status = rest.substr(0, rest.find(kLineEnd));
  if (!status.starts_with(kBegin) || status.size() < 12) {
    return refuse("is no web server");
  }
  if (status.substr(8, 4) != " 200") {
    return refuse(fmt::format("answers {}", printable(status.substr(9), 80)));
  }
  kind_ = Body::UntilClosed;
  rest.remove_prefix(status.size() + kLineEnd.size());
  while (!rest.empty()) {
    const std::string_view line = rest.substr(0, rest.find(kLineEnd));
    rest.remove_prefix(line.size() + kLineEnd.size());
    if (!read_field(line)) {
      return false;
    }
  }
  return true;
}

bool HttpAnswer::read_field(std::string_view line) {
  const std::size_t colon = line.find(':');
  if (colon == std::string_view::npos) {
    return refuse("is no web server");
  }
  const std::string name = lower_case(line.substr(0, colon));
  std::string_view value = line.substr(colon + 1);
  value.remove_prefix(std::min(value.size(), value.find_first_not_of(" \t")));
  if (name == "transfer-encoding") {
    kind_ = Body::InChunks;  // goes before a length (RFC 9112, 6.3)
    return lower_case(value).starts_with("chunked") || refuse("sends what it packs in a way of its own");
  }
  if (name == "content-length" && kind_ != Body::InChunks) {
    kind_ = Body::OfLength;
    if (!read_number(value, 10, " \t", length_) || length_ > most_) {
      return refuse("sends more than is wanted");
    }
  }
  return true;
}

/// Of each chunk its length in hex, what it says of itself, a line's end, its bytes, a line's end; one of
/// length 0 is the last.
bool HttpAnswer::read_chunks() {
  std::size_t at = 0;
  for (;;) {
    const std::size_t end = raw_.find(kLineEnd, at);
    if (std::min(end, raw_.size()) - at > kMostChunkLine) {
      return refuse("is no web server");
    }
    if (end == std::string::npos) {
      break;
    }
    std::size_t size = 0;
    if (!read_number(std::string_view(raw_).substr(at, end - at), 16, "; \t", size)) {
      return refuse("is no web server");
    }
    if (size > most_ - body_.size()) {
      return refuse("sends more than is wanted");
    }
    if (size == 0) {
      return false;
    }
    const std::size_t begin = end + kLineEnd.size();
    if (raw_.size() < begin + size + kLineEnd.size()) {
      break;
    }
    if (raw_.compare(begin + size, kLineEnd.size(), kLineEnd) != 0) {
      return refuse("is no web server");
    }
    body_.append(raw_, begin, size);
    at = begin + size + kLineEnd.size();
  }
  raw_.erase(0, at);
  return true;
}

HttpGet::HttpGet(FileDescriptor socket, const std::string& host, const std::string& path,
                 std::size_t most_bytes)
    : socket_(std::move(socket)),
      out_(fmt::format("GET {} HTTP/1.1\r\nHost: {}\r\nAccept: application/json\r\nConnection: close\r\n\r\n",
                       path, host)),
      answer_(most_bytes) {}

bool HttpGet::fail(int fault) {
  fault_ = std::strerror(fault);
  return false;
}

void HttpGet::connect(const sockaddr* address, socklen_t length) {
  if (!socket_ || (::connect(socket_.get(), address, length) < 0 && errno != EINPROGRESS)) {
    fail(errno);
  }
}

short HttpGet::events() const {
  return static_cast<short>(out_.empty() ? POLLIN : POLLIN | POLLOUT);
}

bool HttpGet::work() {
  if (!fault_.empty()) {
    return false;
  }
  const auto passes = [](int fault) {
    return fault == EAGAIN || fault == EINTR || fault == ENOTCONN || fault == EINPROGRESS;
  };
  while (!out_.empty()) {
    const ssize_t sent = ::send(socket_.get(), out_.data(), out_.size(), MSG_NOSIGNAL);
    if (sent < 0) {
      return passes(errno) ? true : fail(errno);
    }
    out_.erase(0, static_cast<std::size_t>(sent));
  }
  std::array<char, 16384> piece{};
  for (int reads = 0; reads < kMostReads; ++reads) {
    const ssize_t got = ::recv(socket_.get(), piece.data(), piece.size(), 0);
    if (got < 0) {
      return passes(errno) ? true : fail(errno);
    }
    if (!answer_.feed({piece.data(), static_cast<std::size_t>(got)}, got == 0)) {
      return false;
    }
  }
  return true;
}

}  // namespace facet::stream
