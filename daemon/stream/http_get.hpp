#pragma once

#include <sys/socket.h>

#include <cstddef>
#include <string>
#include <string_view>

#include "stream/unix_socket.hpp"

namespace facet::stream {

/// The answer to a GET (HTTP/1.1, RFC 9112), in pieces as they come: taken is a status of 200 alone, with a
/// body of a length that is told, in chunks, or until the connection is closed. One thread.
class HttpAnswer {
 public:
  /// most_bytes of the body.
  explicit HttpAnswer(std::size_t most_bytes) : most_(most_bytes) {}

  /// closed: this piece, which may be empty, was the last. False: nothing more is looked at, for the answer
  /// is whole or fault() says what is wrong with it.
  bool feed(std::string_view bytes, bool closed = false);
  const std::string& fault() const { return fault_; }
  /// Once it is whole.
  const std::string& body() const { return body_; }

 private:
  enum class Body { Unknown, OfLength, InChunks, UntilClosed };

  bool refuse(std::string why);
  bool read_head(std::size_t end);
  bool read_field(std::string_view line);
  bool read_chunks();

  std::size_t most_;
  Body kind_ = Body::Unknown;
  std::size_t length_ = 0;  ///< OfLength
  std::string raw_;         ///< not looked at yet
  std::string body_;
  std::string fault_;
};

/// A GET to somebody else's server, without TLS; nothing else is followed, no redirection and no proxy. Waits
/// for nothing. One thread.
class HttpGet {
 public:
  /// socket: of TCP, not connected yet, that does not wait. host: "ADDRESS:PORT". path: with its query.
  HttpGet(FileDescriptor socket, const std::string& host, const std::string& path, std::size_t most_bytes);

  void connect(const sockaddr* address, socklen_t length);
  int socket() const { return socket_.get(); }
  /// What of the socket is waited for, as poll() names it.
  short events() const;
  /// Reads and writes what there is. False: it is over, and fault() empty where it went well.
  bool work();
  const std::string& fault() const { return fault_.empty() ? answer_.fault() : fault_; }
  const std::string& body() const { return answer_.body(); }

 private:
  bool fail(int fault);

  FileDescriptor socket_;
  std::string out_;
  HttpAnswer answer_;
  std::string fault_;
};

}  // namespace facet::stream
