#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "stream/web_socket.hpp"
#include "stream/web_socket_client.hpp"

namespace facet::stream {
namespace {

using Outcome = WebSocketAssembler::Outcome;

TEST(WebSocket, AcceptFollowsTheStandard) {
  // RFC 6455, section 1.3; the others by Python's hashlib and base64.
  EXPECT_EQ(web_socket_accept("dGhlIHNhbXBsZSBub25jZQ=="), "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=");
  EXPECT_EQ(web_socket_accept(""), "Kfh9QIsMVZcl6xEPYxPHzW8SZ8w=");
  EXPECT_EQ(web_socket_accept(std::string(100, 'a')), "+taVhj8zzaJPYE6HHo1ugamK/Ug=");
}

/// A client's frame: masked, its length in the shortest form.
std::vector<std::uint8_t> frame_of(unsigned first_byte, const std::vector<std::uint8_t>& payload) {
  const WebSocketHeader header(WebSocketOpcode::Binary, payload.size());
  std::vector<std::uint8_t> frame(header.view().begin(), header.view().end());
  frame[0] = static_cast<std::uint8_t>(first_byte);
  frame[1] = static_cast<std::uint8_t>(frame[1] | 0x80U);
  const std::vector<std::uint8_t> mask{1, 20, 200, 77};
  frame.insert(frame.end(), mask.begin(), mask.end());
  for (std::size_t i = 0; i < payload.size(); ++i) {
    frame.push_back(payload[i] ^ mask[i % 4]);
  }
  return frame;
}

/// Every form of the length, whole, in pieces and byte by byte.
TEST(WebSocket, PutsMessagesTogether) {
  for (const std::size_t size : {0U, 1U, 125U, 126U, 127U, 65535U, 65536U, 70000U}) {
    std::vector<std::uint8_t> payload(size);
    for (std::size_t i = 0; i < size; ++i) {
      payload[i] = static_cast<std::uint8_t>(i * 31 + i / 256);
    }
    std::vector<std::uint8_t> bytes = frame_of(0x82, payload);
    const std::size_t one = bytes.size();
    const auto ping = frame_of(0x89, {1, 2, 3});
    bytes.insert(bytes.end(), ping.begin(), ping.end());
    const auto second = frame_of(0x81, {'x'});
    bytes.insert(bytes.end(), second.begin(), second.end());
    for (const std::size_t piece : {std::size_t{1}, std::size_t{3}, std::size_t{4096}, one, bytes.size()}) {
      WebSocketAssembler assembler(size > 0 ? size : 1);
      std::vector<Outcome> outcomes;
      for (std::size_t at = 0; at < bytes.size(); at += piece) {
        std::span<const std::uint8_t> part = std::span(bytes).subspan(at, std::min(piece, bytes.size() - at));
        while (!part.empty()) {
          const Outcome outcome = assembler.feed(part);
          if (outcome == Outcome::Incomplete) {
            ASSERT_TRUE(part.empty());
            continue;
          }
          outcomes.push_back(outcome);
          if (outcome == Outcome::Ping) {
            EXPECT_THAT(assembler.control(), ::testing::ElementsAre(1, 2, 3));
          } else if (outcomes.size() == 1) {
            EXPECT_TRUE(std::equal(payload.begin(), payload.end(), assembler.message().begin(),
                                   assembler.message().end()));
            EXPECT_FALSE(assembler.is_text());
            assembler.next();
          }
        }
      }
      EXPECT_THAT(outcomes, ::testing::ElementsAre(Outcome::Message, Outcome::Ping, Outcome::Message))
          << size << " bytes in pieces of " << piece;
      EXPECT_TRUE(assembler.is_text());
    }
  }
}

TEST(WebSocket, TheLimitIsOfAllFragments) {
  WebSocketAssembler assembler(10);
  const auto first = frame_of(0x02, std::vector<std::uint8_t>(6));
  std::span<const std::uint8_t> part = first;
  EXPECT_EQ(assembler.feed(part), Outcome::Incomplete);
  const auto fits = frame_of(0x00, std::vector<std::uint8_t>(4));
  part = fits;
  EXPECT_EQ(assembler.feed(part), Outcome::Incomplete);
  const auto more = frame_of(0x80, std::vector<std::uint8_t>(1));
  part = more;
  EXPECT_EQ(assembler.feed(part), Outcome::TooLong);
}

TEST(WebSocket, WhatTheStandardForbids) {
  const auto outcome_of = [](std::vector<std::uint8_t> bytes) {
    WebSocketAssembler assembler(1000);
    std::span<const std::uint8_t> part = bytes;
    return assembler.feed(part);
  };
  EXPECT_EQ(outcome_of({0x82, 0x00}), Outcome::Violation);                          // not masked
  EXPECT_EQ(outcome_of({0xC2, 0x80, 0, 0, 0, 0}), Outcome::Violation);              // an extension
  EXPECT_EQ(outcome_of({0x83, 0x80, 0, 0, 0, 0}), Outcome::Violation);              // no such opcode
  EXPECT_EQ(outcome_of({0x8B, 0x80, 0, 0, 0, 0}), Outcome::Violation);              // no such control frame
  EXPECT_EQ(outcome_of({0x09, 0x80, 0, 0, 0, 0}), Outcome::Violation);              // a ping in fragments
  EXPECT_EQ(outcome_of({0x89, 0xFE, 0, 126}), Outcome::Violation);                  // a ping too long
  EXPECT_EQ(outcome_of({0x80, 0x80, 0, 0, 0, 0}), Outcome::Violation);              // goes on with nothing
  EXPECT_EQ(outcome_of({0x02, 0x80, 0, 0, 0, 0, 0x82, 0x80}), Outcome::Violation);  // begins in the middle
  EXPECT_EQ(outcome_of({0x82, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0, 0, 0, 0}),
            Outcome::TooLong);
  EXPECT_EQ(outcome_of({0x88, 0x80, 0, 0, 0, 0}), Outcome::Close);
}

TEST(WebSocket, ControlFramesAreCutToTheirLimit) {
  EXPECT_EQ(web_socket_close(WebSocketClose::Refused, std::string(500, 'x')).size(), 2U + 125U);
  EXPECT_THAT(web_socket_close(WebSocketClose::TooLong, "a"),
              ::testing::ElementsAre(0x88, 3, 0x03, 0xF1, 'a'));
  EXPECT_EQ(web_socket_pong({}).size(), 2U);
}

/// The answer of RFC 6455, section 1.3.
TEST(WebSocketClient, TakesTheAnswerToItsOwnRequestAlone) {
  const std::string key = "dGhlIHNhbXBsZSBub25jZQ==";
  const auto head = [](const std::string& first, const std::string& accept) {
    return "HTTP/1.1 " + first + "\r\nUpgrade: websocket\r\nsec-websocket-ACCEPT: " + accept + " \r\n\r\n";
  };
  const std::string right = "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=";
  EXPECT_EQ(web_socket_refusal(head("101 Switching Protocols", right), key), "");
  EXPECT_EQ(web_socket_refusal(head("101 Switching Protocols", "other"), key),
            "answers another's WebSocket request");
  EXPECT_EQ(web_socket_refusal(head("403 Forb\x01idden", right), key),
            "refuses a WebSocket: 403 Forb\\x01idden");
  for (const char* other : {"", "\r\n\r\n", "SSH-2.0-OpenSSH\r\n\r\n", "HTTP/1.1 101 Yes\r\n\r\n"}) {
    EXPECT_EQ(web_socket_refusal(other, key), "is no WebSocket's server") << other;
  }
}

TEST(WebSocketAssembler, AServersFramesHaveNoMask) {
  std::vector<std::uint8_t> bytes = {0x01, 2, 'a', 'b', 0x89, 1, 'p', 0x80, 126, 0, 200};
  bytes.resize(bytes.size() + 200, 'c');
  for (std::size_t piece = 1; piece <= bytes.size(); ++piece) {
    WebSocketAssembler assembler(1000, WebSocketPeer::Server);
    std::vector<Outcome> outcomes;
    for (std::size_t at = 0; at < bytes.size(); at += piece) {
      std::span<const std::uint8_t> some = std::span(bytes).subspan(at, std::min(piece, bytes.size() - at));
      while (!some.empty()) {
        if (const Outcome outcome = assembler.feed(some); outcome != Outcome::Incomplete) {
          outcomes.push_back(outcome);
        }
      }
    }
    ASSERT_THAT(outcomes, testing::ElementsAre(Outcome::Ping, Outcome::Message)) << piece;
    EXPECT_EQ(assembler.message().size(), 202U);
    EXPECT_EQ(assembler.control()[0], 'p');
  }
  for (const bool masked : {true, false}) {
    const std::vector<std::uint8_t> frame = {0x81, static_cast<std::uint8_t>(masked ? 0x80 : 0)};
    std::span<const std::uint8_t> some = frame;
    WebSocketAssembler of_server(10, WebSocketPeer::Server);
    EXPECT_EQ(of_server.feed(some), masked ? Outcome::Violation : Outcome::Message);
    some = frame;
    WebSocketAssembler of_client(10);
    EXPECT_EQ(of_client.feed(some), masked ? Outcome::Incomplete : Outcome::Violation);
  }
}

}  // namespace
}  // namespace facet::stream
