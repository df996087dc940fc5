#include "stream/client.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "stream/encoder.hpp"
#include "stream/framing.hpp"
#include "stream/ring.hpp"
#include "stream/unix_socket.hpp"

namespace facet::stream {
namespace {

constexpr std::size_t kReceiveBytes = 256U << 10;
constexpr std::size_t kMaxPassed = 2;  // descriptors with one message
// After its deadline a call still takes what has come; from a server that never pauses no longer than this.
constexpr auto kGrace = std::chrono::milliseconds(100);
// Frames of a ring that were overwritten while they were read, in a row: then it is time to look at the
// socket.
constexpr int kRingAttempts = 16;

/// recv() that takes in the descriptors that come beside the bytes.
ssize_t receive_some(int fd, std::span<std::uint8_t> out, std::vector<FileDescriptor>& passed) {
  iovec part{out.data(), out.size()};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  alignas(cmsghdr) std::array<char, CMSG_SPACE(kMaxPassed * sizeof(int))> control{};
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  const ssize_t count = ::recvmsg(fd, &message, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
  if (count < 0) {
    return count;
  }
  for (cmsghdr* header = CMSG_FIRSTHDR(&message); header != nullptr; header = CMSG_NXTHDR(&message, header)) {
    if (header->cmsg_level == SOL_SOCKET && header->cmsg_type == SCM_RIGHTS) {
      passed.clear();  // of one message at most
      const std::size_t bytes = header->cmsg_len - CMSG_LEN(0);
      for (std::size_t k = 0; k + sizeof(int) <= bytes; k += sizeof(int)) {
        int one = -1;
        std::memcpy(&one, CMSG_DATA(header) + k, sizeof(int));
        passed.emplace_back(one);
      }
    }
  }
  return count;
}

}  // namespace

struct StreamClient::Impl {
  Impl(const std::filesystem::path& socket, Clock::time_point deadline)
      : path(socket), fd(connect_unix(socket, deadline)) {}

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

  std::vector<FileDescriptor> passed;  ///< came beside the bytes, not yet taken
  std::optional<RingReader> ring;
  FileDescriptor ring_wake;       ///< readable with each frame of the ring
  std::uint64_t ring_number = 0;  ///< of the newest frame that was read; 0: none
  std::uint64_t overwritten = 0;
  bool waiting_for_subject = false;  ///< the ring's newest frame is known but for its subject

  enum class Event { Socket, Ring, Late };
  Event wait(Clock::time_point deadline);
  bool receive(Clock::time_point deadline);
  bool next_message(Clock::time_point deadline);
  bool next_ring_frame(DecodedFrame& out);
  void open_ring(const RingOffer& offer);
  void close(const std::string& reason);
  bool accept(std::span<const std::uint8_t> message, DecodedFrame& out);
  void send_all(std::span<const std::uint8_t> bytes, Clock::time_point deadline);
};

void StreamClient::Impl::close(const std::string& reason) {
  closed = true;
  if (closed_reason.empty()) {
    closed_reason = reason;
  }
}

StreamClient::Impl::Event StreamClient::Impl::wait(Clock::time_point deadline) {
  for (;;) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now());
    std::array<pollfd, 2> entries{pollfd{fd.get(), POLLIN, 0}, pollfd{ring_wake.get(), POLLIN, 0}};
    const int ready = ::poll(entries.data(), ring ? 2 : 1,
                             static_cast<int>(std::clamp<std::int64_t>(left.count(), 0, 1 << 30)));
    if (ready > 0) {
      return entries[0].revents != 0 ? Event::Socket : Event::Ring;
    }
    if (ready == 0) {
      return Event::Late;
    }
    if (errno != EINTR) {
      throw Error(ErrorKind::Unavailable,
                  fmt::format("stream '{}': {}", path.string(), std::strerror(errno)));
    }
  }
}

/// Fills `unread`. False at the deadline, once closed and when the ring has a frame.
bool StreamClient::Impl::receive(Clock::time_point deadline) {
  while (!closed) {
    if (wait(deadline) != Event::Socket) {
      return false;
    }
    const ssize_t count = receive_some(fd.get(), received, passed);
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

/// Puts the next whole message into the assembler. False at the deadline, once closed and when the ring has a
/// frame.
bool StreamClient::Impl::next_message(Clock::time_point deadline) {
  for (;;) {
    if (unread.empty() && !receive(deadline)) {
      return false;
    }
    switch (assembler.feed(unread)) {
      case MessageAssembler::Outcome::Complete:
        return true;
      case MessageAssembler::Outcome::Incomplete:
        if (Clock::now() >= deadline + kGrace) {
          return false;
        }
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

/// From here on frames come through the ring whose descriptors came with the offer.
void StreamClient::Impl::open_ring(const RingOffer& offer) {
  if (offer.version != FACET_RING_VERSION || passed.size() != 2) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("stream '{}': a ring of version {} with {} descriptors", path.string(),
                            offer.version, passed.size()));
  }
  struct stat status {};
  if (::fstat(passed[1].get(), &status) != 0 || !S_ISFIFO(status.st_mode)) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("stream '{}': a ring whose wake-ups come through no pipe", path.string()));
  }
  ring.emplace(passed[0]);
  ring_wake = std::move(passed[1]);
  waiting_for_subject = false;
  passed.clear();
  ::fcntl(ring_wake.get(), F_SETFL, O_NONBLOCK);
}

/// True where a frame is in `out`. False where the newest is known already, or its subject is still on the
/// way.
bool StreamClient::Impl::next_ring_frame(DecodedFrame& out) {
  // First the wake-ups, then the frame: one that comes in between wakes again. Looked for first, since a
  // server may take O_NONBLOCK away from its pipe.
  if (wait_for(ring_wake.get(), POLLIN, Clock::time_point())) {
    std::array<char, 64> wake_ups{};
    [[maybe_unused]] const ssize_t ignored = ::read(ring_wake.get(), wake_ups.data(), wake_ups.size());
  }
  for (int attempt = 0; attempt < kRingAttempts; ++attempt) {
    if (ring->newest() != RingReader::Outcome::Frame && !waiting_for_subject) {
      return false;
    }
    const FrameReferences wanted = frame_references(ring->head());
    waiting_for_subject = wanted.subject_id != 0 && (subject == nullptr || subject->id != wanted.subject_id);
    if (waiting_for_subject) {
      return false;
    }
    const bool albedo_fits = albedo.albedo != nullptr && albedo.subject_id == wanted.subject_id &&
                             albedo.albedo->version == wanted.albedo_version;
    decode_frame(*ring, wanted.subject_id != 0 ? subject : nullptr, albedo_fits ? albedo.albedo : nullptr,
                 out);
    if (!ring->intact()) {
      ++overwritten;
      continue;
    }
    dropped += ring_number > 0 && ring->number() > ring_number ? ring->number() - ring_number - 1 : 0;
    ring_number = ring->number();
    return true;
  }
  return false;
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
    case MessageType::Ring:
      open_ring(decode_ring(message));
      break;
    case MessageType::Subscribe:
    case MessageType::Unknown:
      break;
  }
  return false;
}

void StreamClient::Impl::send_all(std::span<const std::uint8_t> bytes, Clock::time_point deadline) {
  const auto fail = [&](const char* why) {
    throw Error(ErrorKind::Unavailable, fmt::format("stream '{}': {}", path.string(), why));
  };
  while (!bytes.empty()) {
    if (!wait_for(fd.get(), POLLOUT, deadline)) {
      fail("the server takes no requests");
    }
    const ssize_t count = ::send(fd.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (count < 0 && errno != EINTR && errno != EAGAIN) {
      fail(std::strerror(errno));
    }
    bytes = bytes.subspan(count > 0 ? static_cast<std::size_t>(count) : 0);
  }
}

StreamClient::StreamClient(const std::filesystem::path& socket, const Subscription& subscription,
                           std::chrono::milliseconds timeout) {
  const auto deadline = Clock::now() + timeout;
  impl_ = std::make_unique<Impl>(socket, deadline);
  const auto late = [&] {
    return Error(ErrorKind::Unavailable,
                 fmt::format("stream '{}': no answer within {} ms", socket.string(), timeout.count()));
  };
  DecodedFrame none;
  while (!impl_->hello_received) {
    if (!impl_->next_message(deadline)) {
      if (impl_->closed) {
        throw Error(ErrorKind::Unavailable,
                    fmt::format("stream '{}': {}", socket.string(), impl_->closed_reason));
      }
      throw late();
    }
    impl_->accept(impl_->assembler.message(), none);
    impl_->assembler.next();
    if (!impl_->hello_received && Clock::now() >= deadline) {
      throw late();
    }
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
  impl_->send_all(header, deadline);
  impl_->send_all(request, deadline);
}

StreamClient::~StreamClient() = default;

ReceiveOutcome StreamClient::next(DecodedFrame& out, std::chrono::milliseconds timeout) {
  const auto deadline = Clock::now() + timeout;
  const auto late = [&] { return Clock::now() >= deadline + kGrace; };
  for (;;) {
    if (impl_->ring && impl_->next_ring_frame(out)) {
      return ReceiveOutcome::Received;
    }
    if (impl_->next_message(deadline)) {
      const bool is_frame = impl_->accept(impl_->assembler.message(), out);
      impl_->assembler.next();
      if (is_frame) {
        return ReceiveOutcome::Received;
      }
      if (late()) {
        return ReceiveOutcome::Timeout;
      }
    } else if (impl_->closed) {
      return ReceiveOutcome::Closed;
    } else if (!impl_->ring || Clock::now() >= deadline) {
      return ReceiveOutcome::Timeout;
    }
  }
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

bool StreamClient::by_ring() const {
  return impl_->ring.has_value();
}

std::uint64_t StreamClient::overwritten() const {
  return impl_->overwritten;
}

std::uint64_t StreamClient::bytes_received() const {
  return impl_->bytes_received;
}

const std::string& StreamClient::closed_reason() const {
  return impl_->closed_reason;
}

}  // namespace facet::stream
