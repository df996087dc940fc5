#include "stream/client.hpp"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <span>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "stream/encoder.hpp"
#include "stream/framing.hpp"
#include "stream/unix_socket.hpp"

namespace facet::stream {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kReceiveBytes = 256U << 10;

}  // namespace

struct StreamClient::Impl {
  explicit Impl(const std::filesystem::path& socket) : path(socket), fd(connect_unix(socket)) {}

  std::filesystem::path path;
  FileDescriptor fd;
  std::vector<std::uint8_t> received = std::vector<std::uint8_t>(kReceiveBytes);
  std::span<const std::uint8_t> unread;  ///< of received
  MessageAssembler assembler{kMaxMessageBytes};
  bool hello_received = false;
  Hello hello;
  std::shared_ptr<const mesh::Subject> subject;
  DecodedAlbedo albedo;
  std::uint64_t dropped = 0;
  std::uint64_t bytes_received = 0;
  bool closed = false;
  std::string closed_reason;

  bool wait_readable(Clock::time_point deadline);
  bool receive(Clock::time_point deadline);
  bool next_message(Clock::time_point deadline);
  void close(const std::string& reason);
  bool accept(std::span<const std::uint8_t> message, DecodedFrame& out);
  void send_all(std::span<const std::uint8_t> bytes);
};

void StreamClient::Impl::close(const std::string& reason) {
  closed = true;
  if (closed_reason.empty()) {
    closed_reason = reason;
  }
}

/// False at the deadline.
bool StreamClient::Impl::wait_readable(Clock::time_point deadline) {
  for (;;) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now());
    pollfd entry{fd.get(), POLLIN, 0};
    const int ready = ::poll(&entry, 1, static_cast<int>(std::clamp<std::int64_t>(left.count(), 0, 1 << 30)));
    if (ready > 0) {
      return true;
    }
    if (ready == 0) {
      return false;
    }
    if (errno != EINTR) {
      throw Error(ErrorKind::Unavailable,
                  fmt::format("stream '{}': {}", path.string(), std::strerror(errno)));
    }
  }
}

/// Fills `unread`. False at the deadline or once closed.
bool StreamClient::Impl::receive(Clock::time_point deadline) {
  while (!closed) {
    if (!wait_readable(deadline)) {
      return false;
    }
    const ssize_t count = ::recv(fd.get(), received.data(), received.size(), MSG_DONTWAIT);
    if (count > 0) {
      unread = {received.data(), static_cast<std::size_t>(count)};
      bytes_received += static_cast<std::uint64_t>(count);
      return true;
    }
    if (count == 0) {
      close("the server closed the connection");
    } else if (errno != EINTR && errno != EAGAIN) {
      close(std::strerror(errno));
    }
  }
  return false;
}

/// Puts the next whole message into the assembler. False at the deadline or once closed.
bool StreamClient::Impl::next_message(Clock::time_point deadline) {
  for (;;) {
    if (unread.empty() && !receive(deadline)) {
      return false;
    }
    switch (assembler.feed(unread)) {
      case MessageAssembler::Outcome::Complete:
        return true;
      case MessageAssembler::Outcome::Incomplete:
        break;
      case MessageAssembler::Outcome::WrongMagic:
        throw Error(
            ErrorKind::UnreadableInput,
            fmt::format("'{}' does not speak Facet's stream protocol: is it another socket?", path.string()));
      case MessageAssembler::Outcome::TooLong:
        throw Error(ErrorKind::UnreadableInput, fmt::format("stream '{}': a message is longer than {} bytes",
                                                            path.string(), kMaxMessageBytes));
    }
  }
}

/// Takes in one message. True where it was a frame.
bool StreamClient::Impl::accept(std::span<const std::uint8_t> message, DecodedFrame& out) {
  switch (message_type(message)) {
    case MessageType::Hello:
      hello = decode_hello(message);
      hello_received = true;
      break;
    case MessageType::Subject:
      subject = decode_subject(message);
      albedo = {};
      break;
    case MessageType::Albedo:
      albedo = decode_albedo(message);
      break;
    case MessageType::Dropped:
      dropped = decode_dropped(message).total;
      break;
    case MessageType::Goodbye:
      close(decode_goodbye(message));
      break;
    case MessageType::Frame: {
      const FrameReferences wanted = frame_references(message);
      const bool albedo_fits = albedo.albedo != nullptr && albedo.subject_id == wanted.subject_id &&
                               albedo.albedo->version == wanted.albedo_version;
      decode_frame(message, wanted.subject_id != 0 ? subject : nullptr, albedo_fits ? albedo.albedo : nullptr,
                   out);
      return true;
    }
    case MessageType::Subscribe:
    case MessageType::Unknown:
      break;
  }
  return false;
}

void StreamClient::Impl::send_all(std::span<const std::uint8_t> bytes) {
  while (!bytes.empty()) {
    const ssize_t count = ::send(fd.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (count < 0 && errno != EINTR) {
      throw Error(ErrorKind::Unavailable,
                  fmt::format("stream '{}': {}", path.string(), std::strerror(errno)));
    }
    bytes = bytes.subspan(count > 0 ? static_cast<std::size_t>(count) : 0);
  }
}

StreamClient::StreamClient(const std::filesystem::path& socket, const Subscription& subscription,
                           std::chrono::milliseconds timeout)
    : impl_(std::make_unique<Impl>(socket)) {
  const auto deadline = Clock::now() + timeout;
  DecodedFrame none;
  while (!impl_->hello_received) {
    if (!impl_->next_message(deadline)) {
      throw Error(ErrorKind::Unavailable,
                  impl_->closed
                      ? fmt::format("stream '{}': {}", socket.string(), impl_->closed_reason)
                      : fmt::format("stream '{}': no answer within {} ms", socket.string(), timeout.count()));
    }
    impl_->accept(impl_->assembler.message(), none);
    impl_->assembler.next();
  }
  if (impl_->hello.protocol_version != kProtocolVersion) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("stream '{}' speaks protocol version {}, this program version {}: use programs of one "
                    "release",
                    socket.string(), impl_->hello.protocol_version, kProtocolVersion));
  }
  Encoder encoder;
  const auto request = encoder.subscription(subscription);
  const auto header = make_header(request.size());
  impl_->send_all(header);
  impl_->send_all(request);
}

StreamClient::~StreamClient() = default;

ReceiveOutcome StreamClient::next(DecodedFrame& out, std::chrono::milliseconds timeout) {
  const auto deadline = Clock::now() + timeout;
  while (impl_->next_message(deadline)) {
    const bool is_frame = impl_->accept(impl_->assembler.message(), out);
    impl_->assembler.next();
    if (is_frame) {
      return ReceiveOutcome::Received;
    }
  }
  return impl_->closed ? ReceiveOutcome::Closed : ReceiveOutcome::Timeout;
}

const Hello& StreamClient::hello() const {
  return impl_->hello;
}

std::shared_ptr<const mesh::Subject> StreamClient::subject() const {
  return impl_->subject;
}

std::shared_ptr<const mesh::Albedo> StreamClient::albedo() const {
  return impl_->albedo.albedo;
}

std::uint64_t StreamClient::dropped() const {
  return impl_->dropped;
}

std::uint64_t StreamClient::bytes_received() const {
  return impl_->bytes_received;
}

const std::string& StreamClient::closed_reason() const {
  return impl_->closed_reason;
}

}  // namespace facet::stream
