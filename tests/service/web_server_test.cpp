// The page's server as browsers, other programs and strangers meet it: over TCP, byte by byte.

#include "service/web_server.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <atomic>
#include <chrono>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "service/http_connections.hpp"
#include "service/web_tokens.hpp"
#include "stream/client.hpp"
#include "stream/decoder.hpp"
#include "stream/encoder.hpp"
#include "stream/web_socket.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/closing.hpp"
#include "take/database.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::service {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;
using stream::WebSocketOpcode;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

constexpr auto kPatience = 60s;

bool eventually(const std::function<bool()>& holds) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (!holds()) {
    if (std::chrono::steady_clock::now() > end) {
      return false;
    }
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

/// A frame that a WebSocket's server sent.
struct WebFrame {
  WebSocketOpcode opcode = WebSocketOpcode::Continuation;
  std::vector<std::uint8_t> payload;
  int close_code() const {
    return opcode == WebSocketOpcode::Close && payload.size() >= 2 ? payload[0] << 8 | payload[1] : 0;
  }
  std::string text() const { return {payload.begin(), payload.end()}; }
};

/// A connection by hand, so that it can say what no browser would.
class Peer {
 public:
  explicit Peer(int port) : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = ::htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = ::htonl(INADDR_LOOPBACK);
    const timeval patience{std::chrono::seconds(kPatience).count(), 0};
    ::setsockopt(fd_.get(), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof(patience));
    EXPECT_EQ(::connect(fd_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  }

  void send(std::string_view bytes) {
    while (!bytes.empty()) {
      const ssize_t count = ::send(fd_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (count <= 0) {
        return;  // the server hung up, which the test looks for elsewhere
      }
      bytes.remove_prefix(static_cast<std::size_t>(count));
    }
  }
  /// One frame of a client, masked.
  void send_frame(WebSocketOpcode opcode, std::string_view payload, bool last = true, bool masked = true) {
    std::string frame(1, static_cast<char>((last ? 0x80 : 0) | static_cast<int>(opcode)));
    const char mask_bit = static_cast<char>(masked ? 0x80 : 0);
    if (payload.size() < 126) {
      frame += static_cast<char>(mask_bit | static_cast<char>(payload.size()));
    } else {
      frame += static_cast<char>(mask_bit | 127);
      for (int shift = 56; shift >= 0; shift -= 8) {
        frame += static_cast<char>(payload.size() >> shift & 0xFF);
      }
    }
    const std::string mask = masked ? "\x11\x22\x33\x44" : std::string(4, '\0');
    frame += masked ? mask : "";
    for (std::size_t i = 0; i < payload.size(); ++i) {
      frame += static_cast<char>(payload[i] ^ mask[i % 4]);
    }
    send(frame);
  }
  void send_frame(WebSocketOpcode opcode, std::span<const std::uint8_t> payload) {
    send_frame(opcode, std::string(payload.begin(), payload.end()));
  }

  /// Reads until the connection holds this much more, or ends; then what there is.
  std::string take(std::size_t count) {
    fill([&] { return unread_.size() >= count; });
    std::string taken = unread_.substr(0, count);
    unread_.erase(0, taken.size());
    return taken;
  }
  /// Status line and headers of an answer.
  std::string take_head() {
    fill([&] { return unread_.find("\r\n\r\n") != std::string::npos; });
    return take(std::min(unread_.find("\r\n\r\n") + 4, unread_.size()));
  }
  std::string take_all() {
    fill([] { return false; });
    return std::exchange(unread_, {});
  }
  /// The next frame; none where the connection ended.
  std::optional<WebFrame> frame() {
    const std::string start = take(2);
    if (start.size() < 2) {
      return std::nullopt;
    }
    const auto byte = [](char c) { return static_cast<std::size_t>(static_cast<unsigned char>(c)); };
    WebFrame frame;
    frame.opcode = static_cast<WebSocketOpcode>(byte(start[0]) & 0x0F);
    EXPECT_EQ(byte(start[0]) & 0xF0, 0x80U);
    std::size_t length = byte(start[1]);
    EXPECT_LT(length, 128U) << "a server's frames are not masked";
    if (length >= 126) {
      const std::string more = take(length == 126 ? 2 : 8);
      length = 0;
      for (const char c : more) {
        length = length << 8 | byte(c);
      }
    }
    const std::string payload = take(length);
    if (payload.size() < length) {
      return std::nullopt;
    }
    frame.payload.assign(payload.begin(), payload.end());
    return frame;
  }
  /// Sends a request of HTTP and takes all of the answer.
  std::string get(const std::string& path, const std::string& headers = "Host: localhost\r\n") {
    send(fmt::format("GET {} HTTP/1.1\r\n{}Connection: close\r\n\r\n", path, headers));
    return take_all();
  }
  /// Sends a handshake; the head of the answer.
  std::string shake_hands(const std::string& path, const std::string& headers = "Host: localhost\r\n",
                          const std::string& protocols = "facet", std::string_view early = {}) {
    send(
        fmt::format("GET {} HTTP/1.1\r\n{}Upgrade: websocket\r\nConnection: keep-alive, Upgrade\r\n"
                    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
                    "Sec-WebSocket-Protocol: {}\r\n\r\n{}",
                    path, headers, protocols, early));
    return take_head();
  }
  void hang_up() { fd_.reset(); }
  int fd() const { return fd_.get(); }

 private:
  void fill(const std::function<bool()>& enough) {
    std::array<char, 65536> piece{};
    while (!enough()) {
      const ssize_t count = ::recv(fd_.get(), piece.data(), piece.size(), 0);
      if (count <= 0) {
        return;
      }
      unread_.append(piece.data(), static_cast<std::size_t>(count));
    }
  }

  stream::FileDescriptor fd_;
  std::string unread_;
};

class Web : public ::testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::create_directory(folder_.path() / "page");
    std::filesystem::create_directory(folder_.path() / "takes");
    std::ofstream(folder_.path() / "page" / "index.html") << "<!doctype html><title>face</title>";
    std::ofstream(folder_.path() / "page" / "kiosk.js") << "let face;";
    std::ofstream(folder_.path() / "page" / "secret.key") << "not of the page";
    std::ofstream(folder_.path() / "secret.txt") << "outside of the page";
    config_.listen = "127.0.0.1:0";
    config_.page = folder_.path() / "page";
    config_.token_file = folder_.path() / "token";
  }
  void TearDown() override {
    web_.reset();
    stop_ = true;
    if (loop_.joinable()) {
      loop_.join();
    }
  }

  void start(int max_web_readers = 16, const FindTake& find = {}) {
    stream::StreamServerConfig stream;
    stream.socket = folder_.path() / "stream.sock";
    stream.server_name = "test server";
    stream.max_web_readers = max_web_readers;
    stream_ = std::make_unique<stream::StreamServer>(stream);
    stream_->start();
    ControlConfig control;
    control.socket = folder_.path() / "control.sock";
    control_ = std::make_unique<ControlServer>(control, methods());
    loop_ = std::thread([this] {
      while (!stop_) {
        pollfd event{control_->fd(), POLLIN, 0};
        ::poll(&event, 1, 10);
        control_->serve();
      }
    });
    web_ = std::make_unique<WebServer>(config_, folder_.path() / "takes", find ? find : in_folder(), *stream_,
                                       *control_);
  }
  FindTake in_folder() const {
    return [this](const std::string& name) { return find_take(folder_.path() / "takes", name); };
  }
  static ControlMethods methods() {
    return {{"look",
             {false,
              {},
              [](const json&) {
                return json{{"seen", true}};
              }}},
            {"big", {false, {}, [](const json&) { return json(std::string(1 << 20, 'x')); }}},
            {"echo", {false, {{"text"}}, [](const json& params) { return params; }}},
            {"change", {true, {}, [](const json&) {
                          return json{{"changed", true}};
                        }}}};
  }
  static std::string request(const std::string& method) {
    return fmt::format(R"({{"jsonrpc":"2.0","id":1,"method":"{}"}})", method);
  }

  Peer peer() const { return Peer(web_->port()); }
  std::string get(const std::string& path) const { return peer().get(path); }
  std::string token() const {
    std::string token;
    std::ifstream(folder_.path() / "token") >> token;
    return token;
  }
  /// The answer to one request over /control, with a token or without.
  json ask(const std::string& method, const std::string& shown_token = "") const {
    Peer client = peer();
    EXPECT_THAT(client.shake_hands("/control", "Host: localhost\r\n",
                                   shown_token.empty() ? "facet" : "facet, facet.token." + shown_token),
                StartsWith("HTTP/1.1 101"));
    client.send_frame(WebSocketOpcode::Text, request(method));
    const auto answer = client.frame();
    if (!answer || answer->opcode != WebSocketOpcode::Text) {
      return answer ? json(answer->close_code()) : json();
    }
    return json::parse(answer->text());
  }
  Peer reader(stream::Profile profile, const std::string& name = "page") const {
    Peer client = peer();
    EXPECT_THAT(client.shake_hands("/stream"), StartsWith("HTTP/1.1 101"));
    client.send_frame(WebSocketOpcode::Binary,
                      encoder_.subscription({stream::kProtocolVersion, profile, true, name}));
    return client;
  }
  /// The reason of the goodbye, and the code of the close.
  static std::pair<std::string, int> farewell(Peer& client) {
    std::pair<std::string, int> said;
    while (const auto frame = client.frame()) {
      if (frame->opcode == WebSocketOpcode::Binary &&
          stream::message_type(frame->payload) == stream::MessageType::Goodbye) {
        said.first = stream::decode_goodbye(frame->payload);
      }
      said.second = frame->opcode == WebSocketOpcode::Close ? frame->close_code() : said.second;
    }
    return said;
  }
  void publish(std::uint64_t sequence) {
    stream_->publish(std::make_shared<mesh::MeshFrame>(test::patch_frame(sequence, subject_, albedo_)));
  }
  void await_subscribers(std::size_t count) const {
    ASSERT_TRUE(eventually([&] {
      const auto readers = stream_->statistics().readers;
      return static_cast<std::size_t>(std::count_if(readers.begin(), readers.end(), [](const auto& entry) {
               return entry.subscribed;
             })) == count;
    }));
  }
  void write_take(const std::string& name) const {
    take::TakeRecorderConfig config;
    config.file = folder_.path() / "takes" / (name + ".take");
    config.disk_reserve_bytes = 0;
    take::TakeRecorder recorder(config);
    recorder.start();
    recorder.record(std::make_shared<mesh::MeshFrame>(test::patch_frame(1, subject_, albedo_)));
    recorder.stop();
  }

  test::TemporaryFolder folder_;
  WebConfig config_;
  std::shared_ptr<const mesh::Subject> subject_ = test::patch_subject();
  std::shared_ptr<const mesh::Albedo> albedo_ = test::patch_albedo(*subject_, 1);
  mutable stream::Encoder encoder_;
  std::unique_ptr<stream::StreamServer> stream_;
  std::unique_ptr<ControlServer> control_;
  std::thread loop_;
  std::atomic<bool> stop_{false};
  std::unique_ptr<WebServer> web_;
};

TEST_F(Web, ServesThePageAndNothingElse) {
  start();
  const std::string page = get("/");
  EXPECT_THAT(page, AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("<title>face"), HasSubstr("text/html")));
  EXPECT_THAT(page, AllOf(HasSubstr("Content-Security-Policy: default-src 'none'"), HasSubstr("nosniff"),
                          HasSubstr("X-Frame-Options: DENY")));
  EXPECT_THAT(get("/kiosk.js"), AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("text/javascript")));
  for (const char* path :
       {"/secret.key", "/../secret.txt", "/%2e%2e/secret.txt", "/..%2fsecret.txt", "//etc/passwd",
        "/page/index.html", "/kiosk.js/..", "/takes/", "/takes/..%2f..%2fsecret", "/takes/../../secret",
        "/takes/%2e%2e%2fsecret", "/takes/nobody", "/takes/a%00b", "/takes/.hidden", "http://elsewhere/x",
        "/none"}) {
    EXPECT_THAT(get(path),
                AllOf(StartsWith("HTTP/1.1 404"), Not(HasSubstr("outside")), Not(HasSubstr("not of the"))))
        << path;
  }
  for (const char* method : {"POST", "PUT", "DELETE", "OPTIONS", "TRACE"}) {
    Peer client = peer();
    client.send(fmt::format("{} / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n", method));
    EXPECT_THAT(client.take_all(), StartsWith("HTTP/1.1 405")) << method;
  }
}

/// A name that a stranger points at this machine (DNS rebinding) is none of ours.
TEST_F(Web, RefusesForeignHosts) {
  config_.hosts = {"booth.example.org"};
  start();
  for (const char* host : {"localhost", "LocalHost:8420", "127.0.0.1", "[::1]:80", "booth.example.org:1"}) {
    EXPECT_THAT(peer().get("/", fmt::format("Host: {}\r\n", host)), StartsWith("HTTP/1.1 200")) << host;
  }
  for (const char* host : {"evil.example", "localhost.evil.example", "evil.example:8420",
                           "127.0.0.1.evil.example", "0.0.0.0", "", "localhost:80:80", "localhost."}) {
    const std::string headers = fmt::format("Host: {}\r\n", host);
    EXPECT_THAT(peer().get("/", headers), StartsWith("HTTP/1.1 403")) << host;
    EXPECT_THAT(peer().shake_hands("/stream", headers), StartsWith("HTTP/1.1 403")) << host;
    EXPECT_THAT(peer().shake_hands("/control", headers), StartsWith("HTTP/1.1 403")) << host;
  }
  EXPECT_THAT(peer().get("/", ""), StartsWith("HTTP/1.1 40"));
  EXPECT_THAT(peer().get("/", "Host: evil.example\r\nHost: localhost\r\n"), StartsWith("HTTP/1.1 40"));
  EXPECT_THAT(peer().get("/", "Host: localhost\r\nHost: evil.example\r\n"), StartsWith("HTTP/1.1 40"));
  EXPECT_GE(web_->statistics().refused, 26U);
}

TEST_F(Web, RefusesPagesOfOtherOrigins) {
  config_.origins = {"http://localhost:3000"};
  start();
  const auto headers = [](const char* origin) {
    return fmt::format("Host: localhost:8420\r\nOrigin: {}\r\n", origin);
  };
  for (const char* origin : {"http://localhost:8420", "https://localhost:8420", "http://localhost:3000"}) {
    EXPECT_THAT(peer().shake_hands("/control", headers(origin)), StartsWith("HTTP/1.1 101")) << origin;
  }
  for (const char* origin : {"http://evil.example", "null", "http://localhost", "http://localhost:8421",
                             "http://127.0.0.1:8420", "file://", "http://localhost:8420.evil.example"}) {
    EXPECT_THAT(peer().shake_hands("/control", headers(origin)), StartsWith("HTTP/1.1 403")) << origin;
    EXPECT_THAT(peer().shake_hands("/stream", headers(origin)), StartsWith("HTTP/1.1 403")) << origin;
    EXPECT_THAT(peer().get("/", headers(origin)), StartsWith("HTTP/1.1 403")) << origin;
  }
  EXPECT_THAT(web_->statistics().last_refusal, HasSubstr("web.origins"));
}

TEST_F(Web, HandshakesFollowTheStandard) {
  start();
  // The example of RFC 6455, section 1.3.
  EXPECT_THAT(peer().shake_hands("/stream"),
              AllOf(HasSubstr("Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo="),
                    HasSubstr("Sec-WebSocket-Protocol: facet\r\n")));
  EXPECT_THAT(peer().shake_hands("/stream", "Host: localhost\r\n", "another"),
              Not(HasSubstr("Sec-WebSocket-Protocol")));
  EXPECT_THAT(get("/stream"), AllOf(StartsWith("HTTP/1.1 426"), HasSubstr("Sec-WebSocket-Version: 13")));
  EXPECT_THAT(peer().shake_hands("/"), StartsWith("HTTP/1.1 200"));
  EXPECT_THAT(peer().shake_hands("/elsewhere"), StartsWith("HTTP/1.1 404"));
}

TEST_F(Web, LookingNeedsNoTokenChangingDoes) {
  start();
  EXPECT_EQ(ask("look")["result"]["seen"], true);
  EXPECT_EQ(ask("change")["error"]["code"], kPermissionDenied);
  ASSERT_EQ(token().size(), 32U);
  EXPECT_EQ(
      std::filesystem::status(folder_.path() / "token").permissions() & std::filesystem::perms::others_all,
      std::filesystem::perms::none);
  EXPECT_EQ(ask("change", token())["result"]["changed"], true);
  // Kept from one start to the next.
  const std::string before = token();
  web_.reset();
  web_ = std::make_unique<WebServer>(config_, folder_.path() / "takes", in_folder(), *stream_, *control_);
  EXPECT_EQ(token(), before);
  EXPECT_EQ(ask("change", before)["result"]["changed"], true);
}

TEST_F(Web, GuessesOfTheTokenAreFew) {
  const std::string right = "put-there-by-hand";
  std::ofstream(folder_.path() / "token") << right << "\n";
  start();
  for (int guess = 0; guess < WebTokens::kGuesses; ++guess) {
    EXPECT_EQ(ask("change", right.substr(0, 16) + "-"), static_cast<int>(stream::WebSocketClose::WrongToken));
  }
  // Now nothing tells a right one from a wrong one.
  EXPECT_EQ(ask("change", right.substr(0, 15)), static_cast<int>(stream::WebSocketClose::TooManyTokens));
  EXPECT_EQ(ask("change", right), static_cast<int>(stream::WebSocketClose::TooManyTokens));
  EXPECT_EQ(web_->statistics().wrong_tokens, static_cast<std::uint64_t>(WebTokens::kGuesses) + 2);
  EXPECT_EQ(ask("look")["result"]["seen"], true);
}

TEST_F(Web, WithoutATokenNobodyCommands) {
  config_.token_file.clear();
  start();
  EXPECT_EQ(ask("change")["error"]["code"], kPermissionDenied);
  EXPECT_EQ(ask("change", "x"), static_cast<int>(stream::WebSocketClose::WrongToken));
}

TEST_F(Web, WhatIsNoTokenIsSetAsideAndNamed) {
  for (const std::string content : {"short\n", ""}) {  // a power cut leaves it empty
    std::ofstream(folder_.path() / "token") << content;
    const WebServer web(config_, folder_.path() / "takes", in_folder(), *stream_, *control_);
    EXPECT_THAT(web.token_fault(), AllOf(HasSubstr("token"), HasSubstr(".broken-")));
    EXPECT_EQ(token().size(), 32U);
    std::filesystem::remove(folder_.path() / "token");
  }
  config_.token_file = folder_.path() / "none" / "token";
  EXPECT_THROW(WebServer(config_, folder_.path() / "takes", in_folder(), *stream_, *control_), Error);
}

TEST_F(Web, StreamsTheSameMessagesAsTheSocket) {
  start();
  publish(1);
  Peer client = reader(stream::Profile::Vertices);
  std::vector<stream::MessageType> types;
  std::optional<WebFrame> frame;
  while (types.empty() || types.back() != stream::MessageType::Frame) {
    frame = client.frame();
    ASSERT_TRUE(frame.has_value());
    ASSERT_EQ(frame->opcode, WebSocketOpcode::Binary);
    types.push_back(stream::message_type(frame->payload));
    if (types.back() == stream::MessageType::Subject) {
      encoder_.number_subject(stream::decode_subject(frame->payload)->id);
    }
  }
  EXPECT_EQ(types, (std::vector{stream::MessageType::Hello, stream::MessageType::Subject,
                                stream::MessageType::Albedo, stream::MessageType::Frame}));
  const auto expected = encoder_.frame(test::patch_frame(1, subject_, albedo_), stream::Profile::Vertices);
  EXPECT_TRUE(std::equal(frame->payload.begin(), frame->payload.end(), expected.begin(), expected.end()));

  client.send_frame(WebSocketOpcode::Ping, "are you there");
  frame = client.frame();
  ASSERT_TRUE(frame.has_value());
  EXPECT_EQ(frame->opcode, WebSocketOpcode::Pong);
  EXPECT_EQ(frame->text(), "are you there");
  const auto statistics = stream_->statistics();
  ASSERT_EQ(statistics.readers.size(), 1U);
  EXPECT_TRUE(statistics.readers[0].web);
  EXPECT_EQ(statistics.readers[0].client, "page");
  EXPECT_EQ(statistics.readers[0].frames_sent, 1U);

  client.send_frame(WebSocketOpcode::Close, std::string("\x03\xe8", 2));
  EXPECT_TRUE(eventually([&] { return stream_->statistics().readers.empty(); }));
}

/// A request may come in the same breath as the handshake, in pieces and in fragments; no ring for such
/// readers.
TEST_F(Web, RequestsInPieces) {
  start();
  publish(1);
  Peer client = peer();
  stream::Subscription wanted{stream::kProtocolVersion, stream::Profile::Signals, true, "pieces"};
  wanted.ring_version = 1;
  const auto bytes = encoder_.subscription(wanted);
  const std::string message(bytes.begin(), bytes.end());
  // Unmasked bytes are those masked with zeros.
  const std::string first = std::string("\x02\x85\0\0\0\0", 6) + message.substr(0, 5);
  EXPECT_THAT(client.shake_hands("/stream", "Host: localhost\r\n", "facet", first),
              StartsWith("HTTP/1.1 101"));
  client.send_frame(WebSocketOpcode::Ping, "between");
  client.send_frame(WebSocketOpcode::Pong, "unasked");
  client.send_frame(WebSocketOpcode::Continuation, "", false);
  for (std::size_t i = 5; i < message.size(); ++i) {
    client.send_frame(WebSocketOpcode::Continuation, message.substr(i, 1), i + 1 == message.size());
  }
  bool framed = false;
  while (!framed) {
    const auto frame = client.frame();
    ASSERT_TRUE(frame.has_value());
    framed = frame->opcode == WebSocketOpcode::Binary &&
             stream::message_type(frame->payload) == stream::MessageType::Frame;
  }
  EXPECT_FALSE(stream_->statistics().readers.at(0).ring);
}

TEST_F(Web, BadRequestsAreRefused) {
  start();
  const auto refused = [&](const std::function<void(Peer&)>& speak) {
    Peer client = peer();
    EXPECT_THAT(client.shake_hands("/stream"), StartsWith("HTTP/1.1 101"));
    EXPECT_EQ(stream::message_type(client.frame()->payload), stream::MessageType::Hello);
    speak(client);
    return farewell(client);
  };
  using ::testing::Pair;
  EXPECT_THAT(refused([&](Peer& client) {
                client.send_frame(WebSocketOpcode::Binary,
                                  encoder_.subscription({99, stream::Profile::Vertices, true, "later"}));
              }),
              Pair(HasSubstr("client speaks protocol version 99"), 1008));
  EXPECT_THAT(refused([](Peer& client) { client.send_frame(WebSocketOpcode::Binary, "no FlatBuffer"); }),
              Pair(Not(""), 1008));
  EXPECT_THAT(refused([](Peer& client) { client.send_frame(WebSocketOpcode::Text, "hello"); }),
              Pair(HasSubstr("binary"), 1008));
  EXPECT_THAT(
      refused([](Peer& client) { client.send_frame(WebSocketOpcode::Binary, std::string(5000, 'x')); }),
      Pair(HasSubstr("longer than 4096"), 1009));
  EXPECT_THAT(refused([](Peer& client) {
                client.send_frame(WebSocketOpcode::Binary, std::string(3000, 'x'), false);
                client.send_frame(WebSocketOpcode::Continuation, std::string(3000, 'x'));
              }),
              Pair(HasSubstr("longer than 4096"), 1009));
  // An announced length beyond all bounds.
  EXPECT_THAT(refused([](Peer& client) { client.send("\x82\xff\xff\xff\xff\xff\xff\xff\xff\xff....x"); }),
              Pair(HasSubstr("longer than 4096"), 1009));
  EXPECT_THAT(refused([](Peer& client) { client.send_frame(WebSocketOpcode::Binary, "x", true, false); }),
              Pair(HasSubstr("WebSocket"), 1002));
  EXPECT_THAT(refused([](Peer& client) { client.send_frame(WebSocketOpcode::Continuation, "x"); }),
              Pair(HasSubstr("WebSocket"), 1002));
  EXPECT_THAT(refused([](Peer& client) { client.send_frame(static_cast<WebSocketOpcode>(3), "x"); }),
              Pair(HasSubstr("WebSocket"), 1002));
  EXPECT_THAT(refused([](Peer& client) { client.send_frame(WebSocketOpcode::Ping, std::string(126, 'x')); }),
              Pair(HasSubstr("WebSocket"), 1002));
  EXPECT_THAT(refused([](Peer& client) { client.send_frame(static_cast<WebSocketOpcode>(0x42), "x"); }),
              Pair(HasSubstr("WebSocket"), 1002));
  // Half a message, then the end.
  Peer client = peer();
  client.shake_hands("/stream");
  client.send("\x82\xfe\x01");
  client.hang_up();
  EXPECT_TRUE(eventually([&] { return stream_->statistics().readers.empty(); }));
  EXPECT_EQ(stream_->statistics().refused, 11U);
}

TEST_F(Web, FloodsAreBrokenOff) {
  start();
  publish(1);
  Peer good = reader(stream::Profile::Signals, "good");
  await_subscribers(1);
  Peer client = peer();
  client.shake_hands("/stream");
  for (int i = 0; i < 2000; ++i) {
    client.send_frame(WebSocketOpcode::Ping, "flood");
  }
  EXPECT_TRUE(eventually(
      [&] { return stream_->statistics().last_refusal.find("requests in a second") != std::string::npos; }));
  EXPECT_TRUE(eventually([&] { return stream_->statistics().readers.size() == 1; }));

  // Of the control socket: requests without end, and nobody reads the answers.
  Peer asker = peer();
  asker.shake_hands("/control");
  for (int i = 0; i < 100; ++i) {
    asker.send_frame(WebSocketOpcode::Text, request("big"));
  }
  EXPECT_EQ(ask("look")["result"]["seen"], true);
  publish(2);
  int frames = 0;
  while (frames < 2) {
    const auto frame = good.frame();
    ASSERT_TRUE(frame.has_value());
    frames += stream::message_type(frame->payload) == stream::MessageType::Frame ? 1 : 0;
  }
}

/// A reader that stands still loses frames, which are counted; others, the publisher and the end do not wait.
TEST_F(Web, ASlowReaderDisturbsNobody) {
  subject_ = test::patch_subject(1, 65, 5);
  albedo_ = test::patch_albedo(*subject_, 1);
  start();
  publish(1);
  const Peer slow = reader(stream::Profile::Vertices, "slow");
  await_subscribers(1);
  stream::Subscription wanted;
  wanted.profile = stream::Profile::Vertices;
  stream::StreamClient fast(folder_.path() / "stream.sock", wanted);
  stream::DecodedFrame got;
  await_subscribers(2);
  EXPECT_EQ(fast.next(got, kPatience), stream::ReceiveOutcome::Received);
  const auto of = [&](bool web) {
    for (const auto& entry : stream_->statistics().readers) {
      if (entry.web == web) {
        return entry;
      }
    }
    return stream::ReaderStatistics();
  };
  std::uint64_t sequence = 1;
  ASSERT_TRUE(eventually([&] {
    publish(++sequence);
    EXPECT_EQ(fast.next(got, kPatience), stream::ReceiveOutcome::Received);
    return of(true).frames_dropped > 0 || stream_->statistics().published - of(true).frames_sent > 100;
  }));
  EXPECT_EQ(of(false).frames_dropped, 0U);
  EXPECT_LT(of(true).frames_sent, stream_->statistics().published - 20);
  const auto before = std::chrono::steady_clock::now();
  stream_->stop();
  EXPECT_LT(std::chrono::steady_clock::now() - before, 5s);
}

TEST_F(Web, ReadersTooManyAreToldSo) {
  start(2);
  publish(1);
  const Peer one = reader(stream::Profile::Signals);
  const Peer two = reader(stream::Profile::Signals);
  await_subscribers(2);
  Peer three = reader(stream::Profile::Signals);
  EXPECT_THAT(farewell(three), ::testing::Pair(HasSubstr("2 readers"), 1008));
  // Those of the socket are counted for themselves.
  stream::StreamClient local(folder_.path() / "stream.sock", {});
  stream::DecodedFrame got;
  EXPECT_EQ(local.next(got, kPatience), stream::ReceiveOutcome::Received);
}

TEST_F(Web, ControlRequestsUpToTheLimitAreAnswered) {
  start();
  Peer client = peer();
  client.shake_hands("/control", "Host: localhost\r\n", "facet, facet.token." + token());
  for (const std::size_t bytes :
       {std::size_t{65'535}, std::size_t{65'537}, kMaxRequestBytes - 1, kMaxRequestBytes}) {
    const std::string begin = R"({"jsonrpc":"2.0","id":7,"method":"echo","params":{"text":")";
    std::string text(bytes - begin.size() - 3, 'x');
    text.back() = '!';
    const std::string request = begin + text + R"("}})";
    ASSERT_EQ(request.size(), bytes);
    // In one frame, then in three fragments.
    client.send_frame(WebSocketOpcode::Text, request);
    client.send_frame(WebSocketOpcode::Text, request.substr(0, 10), false);
    client.send_frame(WebSocketOpcode::Continuation, request.substr(10, 60'000), false);
    client.send_frame(WebSocketOpcode::Continuation, request.substr(60'010));
    for (int i = 0; i < 2; ++i) {
      const auto answer = client.frame();
      ASSERT_TRUE(answer.has_value()) << bytes;
      ASSERT_EQ(answer->opcode, WebSocketOpcode::Text) << bytes;
      EXPECT_EQ(json::parse(answer->text())["result"]["text"], text) << bytes;
    }
  }
}

TEST_F(Web, ControlRequestsTooLongAreRefused) {
  start();
  // The sum of fragments counts.
  Peer pieces = peer();
  pieces.shake_hands("/control", "Host: localhost\r\n", "facet, facet.token." + token());
  pieces.send_frame(WebSocketOpcode::Text, std::string(kMaxRequestBytes - 10, ' '), false);
  pieces.send_frame(WebSocketOpcode::Continuation, std::string(11, ' '));
  const auto refused = pieces.frame();
  ASSERT_TRUE(refused.has_value());
  EXPECT_EQ(json::parse(refused->text())["error"]["code"], kInvalidRequest);
  EXPECT_EQ(json::parse(refused->text())["error"]["message"], "a request has 1048576 bytes at most");
  EXPECT_EQ(pieces.frame()->close_code(), 1009);
  Peer client = peer();
  client.shake_hands("/control", "Host: localhost\r\n", "facet, facet.token." + token());
  client.send_frame(WebSocketOpcode::Text, std::string(kMaxRequestBytes + 1, ' '));
  const auto told = client.frame();
  ASSERT_TRUE(told.has_value());
  EXPECT_EQ(json::parse(told->text())["error"]["code"], kInvalidRequest);
  EXPECT_EQ(client.frame()->close_code(), 1009);
  Peer binary = peer();
  binary.shake_hands("/control", "Host: localhost\r\n", "facet, facet.token." + token());
  binary.send_frame(WebSocketOpcode::Binary, request("look"));
  EXPECT_EQ(binary.frame()->close_code(), 1002);
}

TEST_F(Web, TakesAreDownloaded) {
  start();
  write_take("monday one");
  const auto file = folder_.path() / "takes" / "monday one.take";
  std::ifstream stored(file, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(stored), std::istreambuf_iterator<char>()};
  const std::string whole = get("/takes/monday%20one");
  EXPECT_THAT(whole, AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("filename*=UTF-8''monday%20one.take")));
  EXPECT_EQ(whole.substr(whole.find("\r\n\r\n") + 4), bytes);
  const auto part = [&](const std::string& range) {
    return peer().get("/takes/monday%20one", fmt::format("Host: localhost\r\nRange: {}\r\n", range));
  };
  const std::string middle = part("bytes=100-299");
  EXPECT_THAT(middle, AllOf(StartsWith("HTTP/1.1 206"),
                            HasSubstr(fmt::format("Content-Range: bytes 100-299/{}", bytes.size()))));
  EXPECT_EQ(middle.substr(middle.find("\r\n\r\n") + 4), bytes.substr(100, 200));
  const std::string tail = part("bytes=-50");
  EXPECT_EQ(tail.substr(tail.find("\r\n\r\n") + 4), bytes.substr(bytes.size() - 50));
  EXPECT_THAT(part(fmt::format("bytes={}-", bytes.size())), StartsWith("HTTP/1.1 416"));
  EXPECT_THAT(part("bytes=1-2,5-6"), StartsWith("HTTP/1.1 200"));
  EXPECT_THAT(part("bytes=99999999999999999999-"), StartsWith("HTTP/1.1 200"));

  take::TakeRecorderConfig config;
  config.file = folder_.path() / "takes" / "open.take";
  config.disk_reserve_bytes = 0;
  take::TakeRecorder recorder(config);
  recorder.start();
  EXPECT_THAT(get("/takes/open"), StartsWith("HTTP/1.1 409"));
  std::ofstream(folder_.path() / "takes" / "broken.take") << "no take";
  EXPECT_THAT(get("/takes/broken"), AllOf(StartsWith("HTTP/1.1 409"), Not(HasSubstr("no take"))));
  std::filesystem::create_symlink(folder_.path() / "secret.txt", folder_.path() / "takes" / "link.take");
  EXPECT_THAT(get("/takes/link"), Not(HasSubstr("outside")));
}

/// The server's one thread waits for nobody: what may be downloaded is known without a look into the take.
TEST_F(Web, ATakeThatIsLockedIsNotWaitedFor) {
  write_take("locked");
  take::Database other(folder_.path() / "takes" / "locked.take", take::Database::Mode::ReadWrite);
  other.execute("BEGIN EXCLUSIVE");
  int asked = 0;
  start(16, [&](const std::string& name) -> std::optional<TakeFiles> {
    ++asked;
    return name == "locked" ? TakeFiles{folder_.path() / "takes" / "locked.take", {}, ""}
                            : TakeFiles{"", {}, "it is being recorded"};
  });
  EXPECT_THAT(get("/takes/locked"), StartsWith("HTTP/1.1 200"));
  EXPECT_THAT(get("/takes/open"), AllOf(StartsWith("HTTP/1.1 409"), HasSubstr("being recorded")));
  EXPECT_EQ(asked, 2);
  EXPECT_THAT(find_take(folder_.path() / "takes", "locked")->obstacle, HasSubstr("another program"));
  EXPECT_FALSE(find_take(folder_.path() / "takes", "nobody").has_value());
  EXPECT_FALSE(find_take(folder_.path() / "takes", "../locked").has_value());
}

/// What is still in the log is no part of the file that would be sent.
TEST_F(Web, TakeWhoseLogAReaderKeepsIsSentWholeOrNotAtAll) {
  start();
  take::TakeRecorderConfig config;
  config.file = folder_.path() / "takes" / "read.take";
  config.disk_reserve_bytes = 0;
  take::TakeRecorder recorder(config);
  std::optional<take::Database> reader(std::in_place, config.file, take::Database::Mode::ReadOnly);
  reader->execute("BEGIN");
  reader->query_int64("SELECT count(*) FROM frame");
  recorder.start();
  recorder.record(std::make_shared<mesh::MeshFrame>(test::patch_frame(1, subject_, albedo_)));
  ASSERT_EQ(recorder.stop().state, take::RecorderState::Finished);
  ASSERT_TRUE(take::TakeReader(config.file).info().closed) << "read with its log";
  EXPECT_THAT(get("/takes/read"),
              AllOf(StartsWith("HTTP/1.1 409"), HasSubstr("-wal file"), HasSubstr("another program"),
                    Not(HasSubstr(folder_.path().string()))));
  reader.reset();
  ASSERT_EQ(take::close_take(config.file).left, "");
  const std::string answer = get("/takes/read");
  EXPECT_THAT(answer, StartsWith("HTTP/1.1 200"));
  const auto got = folder_.path() / "got.take";
  std::ofstream(got, std::ios::binary) << answer.substr(answer.find("\r\n\r\n") + 4);
  EXPECT_EQ(take::TakeReader(got).frame(0)->sequence, 1U);
}

TEST_F(Web, PicturesOfTakesAreServedAndNothingBesideThem) {
  start();
  EXPECT_THAT(get("/thumbnails/monday"), StartsWith("HTTP/1.1 404"));
  const auto folder = folder_.path() / "takes" / ".thumbnails";
  std::filesystem::create_directories(folder);
  std::ofstream(folder / "monday.png") << "a picture";
  EXPECT_THAT(get("/thumbnails/monday"), AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("image/png"),
                                               ::testing::EndsWith("\r\n\r\na picture")));
  std::filesystem::create_symlink(folder_.path() / "secret.txt", folder / "link.png");
  for (const char* path :
       {"/thumbnails/link", "/thumbnails/", "/thumbnails/..%2Fmonday", "/thumbnails/.half"}) {
    EXPECT_THAT(get(path), StartsWith("HTTP/1.1 404")) << path;
  }
}

TEST_F(Web, TheSoundBesideATakeCanBeDownloaded) {
  start();
  write_take("monday");
  EXPECT_THAT(get("/sounds/monday"), AllOf(StartsWith("HTTP/1.1 404"), HasSubstr("no sound")));
  const auto sound = folder_.path() / "takes" / "monday.flac";
  std::ofstream(sound) << "a sound";
  EXPECT_THAT(get("/sounds/monday"),
              AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("audio/flac"),
                    HasSubstr("filename*=UTF-8''monday.flac"), ::testing::EndsWith("\r\n\r\na sound")));
  std::filesystem::remove(sound);
  std::filesystem::create_symlink(folder_.path() / "secret.txt", sound);
  for (const char* path : {"/sounds/monday", "/sounds/nobody", "/sounds/", "/sounds/..%2Fmonday"}) {
    EXPECT_THAT(get(path), StartsWith("HTTP/1.1 404")) << path;
  }
}

TEST_F(Web, RecordedPicturesCanBeDownloaded) {
  start();
  write_take("bare");
  EXPECT_THAT(get("/frames/bare"), StartsWith("HTTP/1.1 404"));
  EXPECT_THAT(get("/frames/nobody"), StartsWith("HTTP/1.1 404"));
  EXPECT_THAT(get("/frames/..%2Fbare"), StartsWith("HTTP/1.1 404"));
  const auto file = folder_.path() / "takes" / "with pictures.take";
  take::TakeRecorderConfig config;
  config.file = file;
  config.disk_reserve_bytes = 0;
  config.with_images = true;
  config.segment_bytes = 1;  // every frame has a segment of its own
  config.when_full = take::WhenFull::Wait;
  take::TakeRecorder recorder(config);
  recorder.start();
  for (std::uint64_t number = 1; number <= 3; ++number) {
    auto set = std::make_shared<FrameSet>();
    set->slot = number;
    set->camera_names = std::make_shared<const std::vector<std::string>>(1, "left");
    Frame& picture = set->frames.emplace_back();
    picture.width_px = 16;
    picture.height_px = 2;
    picture.stride_bytes = 64;
    const auto pixels = std::make_shared<std::uint8_t[]>(128);
    std::fill_n(pixels.get(), 128, static_cast<std::uint8_t>(40 * number));
    picture.pixels = pixels;
    mesh::MeshFrame frame = test::patch_frame(number, subject_, albedo_);
    frame.images = std::move(set);
    recorder.record(std::make_shared<mesh::MeshFrame>(std::move(frame)));
  }
  ASSERT_EQ(recorder.stop().state, take::RecorderState::Finished);
  const auto segments = take::TakeReader(file).info().segments;
  ASSERT_EQ(segments.size(), 3U);

  const std::string answer = get("/frames/with%20pictures");
  EXPECT_THAT(answer,
              AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("filename*=UTF-8''with%20pictures.frames.tar")));
  const std::string archive = answer.substr(answer.find("\r\n\r\n") + 4);
  EXPECT_THAT(answer, HasSubstr(fmt::format("Content-Length: {}", archive.size())));
  // The system's own tar unpacks it beside the take.
  const auto elsewhere = folder_.path() / "elsewhere";
  std::filesystem::create_directories(elsewhere);
  std::ofstream(elsewhere / "a.tar", std::ios::binary) << archive;
  ASSERT_EQ(
      std::system(
          fmt::format("tar -C '{}' -xf '{}'", elsewhere.string(), (elsewhere / "a.tar").string()).c_str()),
      0);
  std::filesystem::copy(file, elsewhere / "with pictures.take");
  take::TakeReader unpacked(elsewhere / "with pictures.take");
  for (std::int64_t index = 0; index < 3; ++index) {
    const auto frame = unpacked.frame(index);
    ASSERT_NE(frame->images, nullptr) << index;
    EXPECT_EQ(frame->images->frames.front().pixels[0], static_cast<std::uint8_t>(40 * (index + 1)));
  }
  std::filesystem::remove(segments[1].file);
  EXPECT_THAT(get("/frames/with%20pictures"), StartsWith("HTTP/1.1 409"));
}

/// Requests that never end keep nobody else out, however many they are: the newest comes in, and in time all
/// of them are closed, also those that send a byte now and then.
TEST_F(Web, HalfRequestsKeepNobodyOut) {
  start();
  std::vector<Peer> crowd;
  for (std::size_t i = 0; i < 2 * config_.max_connections; ++i) {
    crowd.push_back(peer());
    crowd.back().send("GET / HTTP/1.1\r\nHost: local");
  }
  Peer huge = peer();
  huge.send("GET / HTTP/1.1\r\nHost: localhost\r\nX: " + std::string(100'000, 'x') + "\r\n\r\n");
  EXPECT_THAT(huge.take_all(), Not(StartsWith("HTTP/1.1 200")));
  EXPECT_THAT(get("/"), StartsWith("HTTP/1.1 200"));
  crowd.front().take_all();  // its place went to another
  crowd.back().send("h");
  web_->look_after(Clock::now() + HttpConnections::kRequestTime);
  for (Peer& one : crowd) {
    EXPECT_EQ(one.take_all(), "");
  }
}

/// Answers that nobody takes end, and never take all places.
TEST_F(Web, UnreadDownloadsEnd) {
  start();
  const auto file = folder_.path() / "takes" / "long.take";
  write_take("long");
  std::filesystem::resize_file(file, 64U << 20);
  std::vector<Peer> crowd;
  int begun = 0;
  int refused = 0;
  for (int i = 0; i < 24; ++i) {
    crowd.push_back(peer());
    crowd.back().send("GET /takes/long HTTP/1.1\r\nHost: localhost\r\n\r\n");
    const std::string head = crowd.back().take_head();
    begun += head.rfind("HTTP/1.1 200", 0) == 0 ? 1 : 0;
    refused += head.rfind("HTTP/1.1 503", 0) == 0 ? 1 : 0;
  }
  EXPECT_EQ(begun, static_cast<int>(config_.max_downloads));
  EXPECT_EQ(begun + refused, 24);
  EXPECT_THAT(get("/"), StartsWith("HTTP/1.1 200"));
  const auto later = Clock::now() + HttpConnections::kLeastBytesTime;
  web_->look_after(later);
  // What the kernels hold may have been taken in the first ten seconds, nothing is in the next.
  web_->look_after(later + HttpConnections::kLeastBytesTime);
  EXPECT_TRUE(eventually([&] { return get("/takes/long").rfind("HTTP/1.1 200", 0) == 0; }));
  EXPECT_GE(web_->statistics().broken_off, config_.max_downloads);
}

TEST_F(Web, ADownloadHasOneFileOpenAtATime) {
  start(16, [this](const std::string&) {
    TakeFiles take{"", {}, ""};
    for (int i = 0; i < 40; ++i) {
      take.segments.push_back(folder_.path() / "takes" / fmt::format("{:02}.pictures", i));
      if (!std::filesystem::exists(take.segments.back())) {
        std::ofstream(take.segments.back()) << std::string(1U << 20, static_cast<char>('a' + i % 26));
      }
    }
    return take;
  });
  const auto open_files = [] {
    const std::filesystem::directory_iterator all("/proc/self/fd");
    return std::count_if(begin(all), end(all), [](const auto& entry) {
      std::error_code ignored;
      return std::filesystem::read_symlink(entry.path(), ignored).extension() == ".pictures";
    });
  };
  Peer slow = peer();
  slow.send("GET /frames/x HTTP/1.1\r\nHost: localhost\r\n\r\n");
  EXPECT_THAT(slow.take_head(), StartsWith("HTTP/1.1 200"));
  std::size_t taken = 0;
  std::ptrdiff_t most = 0;
  while (taken < 30U << 20) {
    const std::size_t got = slow.take(1U << 20).size();
    ASSERT_GT(got, 0U);
    taken += got;
    most = std::max(most, open_files());
  }
  EXPECT_EQ(most, 1);

  // A file that changes or goes meanwhile ends the download, and nothing is sent in its place.
  Peer cut = peer();
  cut.send("GET /frames/x HTTP/1.1\r\nHost: localhost\r\n\r\n");
  const std::string head = cut.take_head();
  EXPECT_THAT(head, HasSubstr("Content-Length:"));
  std::filesystem::resize_file(folder_.path() / "takes" / "39.pictures", 1000);
  EXPECT_LT(cut.take_all().size(), std::size_t{39} * ((1U << 20) + 512) + 2048);
}

/// Readers that say nothing or take nothing do not keep the next one out.
TEST_F(Web, ReadersThatStandStillGiveWay) {
  start(4);
  publish(1);
  std::vector<Peer> crowd;
  for (int i = 0; i < 4; ++i) {
    crowd.push_back(peer());
    crowd.back().shake_hands("/stream");
  }
  EXPECT_TRUE(eventually([&] {
    Peer client = reader(stream::Profile::Signals);
    const auto first = client.frame();
    return first && first->opcode == WebSocketOpcode::Binary &&
           stream::message_type(first->payload) == stream::MessageType::Hello;
  }));
}

TEST_F(Web, APortInUseIsNamed) {
  start();
  config_.listen = fmt::format("127.0.0.1:{}", web_->port());
  try {
    const WebServer second(config_, folder_.path() / "takes", in_folder(), *stream_, *control_);
    ADD_FAILURE() << "two servers on one port";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
    EXPECT_THAT(error.what(), HasSubstr("web.listen"));
  }
}

}  // namespace
}  // namespace facet::service
