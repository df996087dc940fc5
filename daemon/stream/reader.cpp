#include "stream/reader.hpp"

#include <sys/socket.h>
#include <sys/uio.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <span>
#include <utility>

#include "facet/assert.hpp"

namespace facet::stream {
namespace {

/// What of head and body lies behind their first `sent` bytes.
std::array<iovec, 2> rest_of(std::span<const std::uint8_t> head, std::span<const std::uint8_t> body,
                             std::size_t sent) {
  FACET_ASSERT(sent < head.size() + body.size(), sent, head.size(), body.size());
  const std::size_t of_head = std::min(sent, head.size());
  head = head.subspan(of_head);
  body = body.subspan(sent - of_head);
  // The socket API takes what is sent by a pointer that is not const.
  return {{{const_cast<std::uint8_t*>(head.data()), head.size()},
           {const_cast<std::uint8_t*>(body.data()), body.size()}}};
}

/// send() that passes descriptors on with the first byte; it never blocks.
ssize_t send_some(int fd, std::span<iovec> parts, const std::vector<FileDescriptor>& passed) {
  constexpr std::size_t kMaxPassed = 2;
  FACET_ASSERT(passed.size() <= kMaxPassed, passed.size());
  msghdr message{};
  message.msg_iov = parts.data();
  message.msg_iovlen = parts.size();
  alignas(cmsghdr) std::array<char, CMSG_SPACE(kMaxPassed * sizeof(int))> control{};
  if (!passed.empty()) {
    std::array<int, kMaxPassed> fds{};
    std::transform(passed.begin(), passed.end(), fds.begin(),
                   [](const FileDescriptor& entry) { return entry.get(); });
    message.msg_control = control.data();
    message.msg_controllen = CMSG_SPACE(passed.size() * sizeof(int));
    cmsghdr* header = CMSG_FIRSTHDR(&message);
    header->cmsg_level = SOL_SOCKET;
    header->cmsg_type = SCM_RIGHTS;
    header->cmsg_len = CMSG_LEN(passed.size() * sizeof(int));
    std::memcpy(CMSG_DATA(header), fds.data(), passed.size() * sizeof(int));
  }
  return ::sendmsg(fd, &message, MSG_NOSIGNAL | MSG_DONTWAIT);
}

}  // namespace

void Reader::set_outgoing(std::shared_ptr<const Packet> message) {
  FACET_ASSERT(outgoing == nullptr, statistics.id, sent_bytes);
  FACET_ASSERT(message != nullptr && message->bytes.size() >= kHeaderBytes, statistics.id);
  sent_bytes = 0;
  if (web) {
    web->answer_goes_out = false;
    web->header = WebSocketHeader(WebSocketOpcode::Binary, message->bytes.size() - kHeaderBytes);
  }
  outgoing_is_frame = false;
  outgoing = std::move(message);
}

void Reader::close_web(WebSocketClose code, const std::string& why) {
  if (outgoing == nullptr) {
    const std::vector<std::uint8_t> frame = web_socket_close(code, why);
    [[maybe_unused]] const ssize_t ignored =
        ::send(fd.get(), frame.data(), frame.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    // What lies unread when a TCP connection is closed makes the kernel throw away what was just sent.
    std::array<std::uint8_t, kMaxRequestBytes> unread{};
    for (int piece = 0; piece < 16 && ::recv(fd.get(), unread.data(), unread.size(), MSG_DONTWAIT) > 0;
         ++piece) {
    }
  }
  gone = true;
}

bool Reader::send_outgoing() {
  std::span<const std::uint8_t> body = outgoing->bytes;
  std::span<const std::uint8_t> head;
  FACET_ASSERT(body.size() >= kHeaderBytes || (web && web->answer_goes_out), body.size());
  if (web && !web->answer_goes_out) {
    head = web->header.view();
    body = body.subspan(kHeaderBytes);
  }
  while (sent_bytes < head.size() + body.size()) {
    std::array<iovec, 2> parts = rest_of(head, body, sent_bytes);
    const ssize_t count = send_some(fd.get(), parts, passed);
    if (count < 0 && errno == EINTR) {
      continue;
    }
    if (count < 0) {
      gone = errno != EAGAIN && errno != EWOULDBLOCK;
      return false;
    }
    passed.clear();
    sent_bytes += static_cast<std::size_t>(count);
    statistics.bytes_sent += static_cast<std::uint64_t>(count);
  }
  statistics.frames_sent += outgoing_is_frame ? 1 : 0;
  outgoing = nullptr;
  return true;
}

}  // namespace facet::stream
