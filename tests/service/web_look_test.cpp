// Who may look at a page that others than this machine are meant to reach: web.public, over TCP.

#include <arpa/inet.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <thread>

#include "facet/error.hpp"
#include "service/config.hpp"
#include "service/web_server.hpp"
#include "service/web_tokens.hpp"
#include "support/paths.hpp"

namespace facet::service {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

class PublicPage : public ::testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::create_directory(folder_.path() / "page");
    std::filesystem::create_directory(folder_.path() / "takes");
    std::ofstream(folder_.path() / "page" / "index.html") << "<!doctype html><title>face</title>";
    std::ofstream(folder_.path() / "takes" / ".thumbnail") << "";
    config_.listen = "127.0.0.1:0";
    config_.is_public = true;
    config_.page = folder_.path() / "page";
    config_.token_file = folder_.path() / "token";
    stream::StreamServerConfig stream;
    stream.socket = folder_.path() / "stream.sock";
    stream.max_web_readers = 4;
    stream_ = std::make_unique<stream::StreamServer>(stream);
    stream_->start();
    ControlConfig control;
    control.socket = folder_.path() / "control.sock";
    control_ = std::make_unique<ControlServer>(
        control, ControlMethods{{"change", {true, {}, [](const nlohmann::json&) {
                                              return nlohmann::json{{"changed", true}};
                                            }}}});
  }
  void TearDown() override {
    stop_ = true;
    if (loop_.joinable()) {
      loop_.join();
    }
  }
  void start() {
    web_ = std::make_unique<WebServer>(
        config_, folder_.path() / "takes", [](const std::string&) { return std::optional<TakeFiles>(); },
        *stream_, *control_);
    loop_ = std::thread([this] {
      while (!stop_) {
        pollfd event{control_->fd(), POLLIN, 0};
        ::poll(&event, 1, 10);
        control_->serve();
      }
    });
  }
  std::string token(const std::string& name) const {
    std::string token;
    std::ifstream(folder_.path() / name) >> token;
    return token;
  }
  /// The answer to one request, or the head of it where the connection goes on as a WebSocket.
  /// asked: sent over a WebSocket once it is open; its answer comes behind the head.
  std::string get(const std::string& path, const std::string& headers = "",
                  const std::string& asked = "") const {
    const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = ::htons(static_cast<std::uint16_t>(web_->port()));
    address.sin_addr.s_addr = ::htonl(INADDR_LOOPBACK);
    const timeval patience{60, 0};
    ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof(patience));
    EXPECT_EQ(::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
    const std::string request = fmt::format("GET {} HTTP/1.1\r\nHost: localhost\r\n{}\r\n", path, headers);
    EXPECT_EQ(::send(fd, request.data(), request.size(), MSG_NOSIGNAL), static_cast<ssize_t>(request.size()));
    std::string answer;
    char byte = 0;
    while (answer.find("\r\n\r\n") == std::string::npos && ::recv(fd, &byte, 1, 0) == 1) {
      answer += byte;
    }
    if (!asked.empty() && answer.starts_with("HTTP/1.1 101")) {
      std::string frame = {'\x81', static_cast<char>(0x80 | asked.size()), 0, 0, 0, 0};  // masked with zeros
      frame += asked;
      EXPECT_EQ(::send(fd, frame.data(), frame.size(), MSG_NOSIGNAL), static_cast<ssize_t>(frame.size()));
      while (answer.back() != '}' && ::recv(fd, &byte, 1, 0) == 1) {
        answer += byte;
      }
    }
    for (int more = 0; path == "/look" && more < 5 && ::recv(fd, &byte, 1, 0) == 1; ++more) {
      answer += byte;  // of its one word
    }
    ::close(fd);
    return answer;
  }
  static std::string bearer(const std::string& token) { return "Authorization: Bearer " + token + "\r\n"; }
  static std::string handshake(const std::string& protocols) {
    return fmt::format(
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
        "dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: {}\r\n",
        protocols);
  }

  test::TemporaryFolder folder_;
  WebConfig config_;
  std::unique_ptr<stream::StreamServer> stream_;
  std::unique_ptr<ControlServer> control_;
  std::unique_ptr<WebServer> web_;
  std::atomic<bool> stop_{false};
  std::thread loop_;
};

TEST_F(PublicPage, WithoutATokenThePageAloneIsHandedOut) {
  start();
  EXPECT_THAT(get("/"), StartsWith("HTTP/1.1 200"));
  for (const char* path : {"/look", "/takes/a", "/frames/a", "/thumbnails/a", "/nothing"}) {
    EXPECT_THAT(get(path), StartsWith("HTTP/1.1 401")) << path;
  }
  for (const char* path : {"/stream", "/control"}) {
    EXPECT_THAT(get(path, handshake("facet")), StartsWith("HTTP/1.1 401")) << path;
  }
  EXPECT_EQ(web_->statistics().wrong_tokens, 0U) << "nobody guessed";
}

TEST_F(PublicPage, EitherTokenOpensLookingAndOneOfThemOnlyThat) {
  start();
  const std::string command = token("token");
  const std::string look = token("token.look");
  ASSERT_EQ(command.size(), 32U);
  ASSERT_EQ(look.size(), 32U);
  ASSERT_NE(command, look);
  EXPECT_EQ(std::filesystem::status(folder_.path() / "token.look").permissions() &
                std::filesystem::perms::others_all,
            std::filesystem::perms::none);
  for (const std::string& shown : {command, look}) {
    EXPECT_THAT(get("/takes/a", bearer(shown)), StartsWith("HTTP/1.1 404")) << "there is no such take";
    const std::string answer = get("/look", bearer(shown));
    EXPECT_THAT(answer, AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("Set-Cookie: facet-look-0=" + look),
                              HasSubstr("HttpOnly"), HasSubstr("SameSite=Strict"),
                              HasSubstr(shown == look ? "\r\n\r\nlook\n" : "\r\n\r\ncomma")));
    EXPECT_THAT(get("/takes/a", "Cookie: other=1; facet-look-0=" + shown + "\r\n"),
                StartsWith("HTTP/1.1 404"));
    EXPECT_THAT(get("/stream", handshake("facet") + "Cookie: facet-look-0=" + shown + "\r\n"),
                StartsWith("HTTP/1.1 101"));
    EXPECT_THAT(get("/stream", handshake("facet, facet.token." + shown)), StartsWith("HTTP/1.1 101"));
    const std::string asked = R"({"jsonrpc":"2.0","id":1,"method":"change"})";
    const std::string change = get("/control", handshake("facet, facet.token." + shown), asked);
    EXPECT_THAT(change,
                AllOf(StartsWith("HTTP/1.1 101"), HasSubstr(shown == command ? "\"changed\"" : "\"error\"")));
    EXPECT_THAT(get("/control", handshake("facet") + "Cookie: facet-look-0=" + shown + "\r\n", asked),
                HasSubstr("\"error\""))
        << "a cookie opens no commands";
  }
}

TEST_F(PublicPage, GuessesAreFewWhicheverWayTheyCome) {
  const std::string right = "put-there-by-hand";
  std::ofstream(folder_.path() / "token.look") << right << "\n";
  start();
  for (int i = 0; i < WebTokens::kGuesses; ++i) {
    const std::string wrong = right.substr(0, 16) + "-";
    EXPECT_THAT(get("/takes/a", i % 2 == 0 ? bearer(wrong) : "Cookie: facet-look-0=" + wrong + "\r\n"),
                StartsWith("HTTP/1.1 401"));
  }
  EXPECT_THAT(get("/look", bearer(right)), StartsWith("HTTP/1.1 429")) << "from the same address";
  EXPECT_THAT(get("/"), StartsWith("HTTP/1.1 200"));
  EXPECT_EQ(web_->statistics().wrong_tokens, static_cast<std::uint64_t>(WebTokens::kGuesses) + 1);
}

TEST_F(PublicPage, AWrongTokenTakesNoCookieAwayThatWasNotShown) {
  start();
  const std::string right = token("token.look");
  const std::string wrong = right.substr(0, 31) + "-";
  const std::string cookie = "Cookie: facet-look-0=" + right + "\r\n";
  EXPECT_THAT(get("/look", bearer(wrong) + cookie),
              AllOf(StartsWith("HTTP/1.1 401"), Not(HasSubstr("Max-Age=0"))));
  EXPECT_THAT(get("/look", "Cookie: facet-look-0=" + wrong + "\r\n"),
              AllOf(StartsWith("HTTP/1.1 401"), HasSubstr("Max-Age=0")));
}

TEST_F(PublicPage, OpenLookLetsEverybodyLook) {
  config_.open_look = true;
  start();
  EXPECT_THAT(get("/look"),
              AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("\r\n\r\nopen\n"), Not(HasSubstr("Set-Cookie"))));
  EXPECT_THAT(get("/takes/a"), StartsWith("HTTP/1.1 404"));
  EXPECT_THAT(get("/stream", handshake("facet")), StartsWith("HTTP/1.1 101"));
  EXPECT_FALSE(std::filesystem::exists(folder_.path() / "token.look"));
}

TEST(WebTokens, LookersAreToldFromThoseWhoCommand) {
  const test::TemporaryFolder folder;
  std::ofstream(folder.path() / "token") << "put-there-by-hand\n";
  WebTokens tokens(folder.path() / "token", true);
  const auto read = [&](const char* name) {
    std::string token;
    std::ifstream(folder.path() / name) >> token;
    return token;
  };
  using Opens = WebTokens::Opens;
  const Clock::time_point now = Clock::now();
  EXPECT_EQ(tokens.opened_by(read("token"), "a", now), Opens::Commands);
  EXPECT_EQ(tokens.opened_by(read("token.look"), "a", now), Opens::Look);
  EXPECT_EQ(tokens.opened_by("", "a", now), Opens::Nothing);
  for (int i = 1; i < WebTokens::kGuesses; ++i) {
    EXPECT_EQ(tokens.opened_by("x", "a", now), Opens::Nothing);
  }
  EXPECT_EQ(tokens.opened_by(read("token"), "a", now), Opens::NothingNow);
  EXPECT_EQ(tokens.opened_by(read("token.look"), "a", now), Opens::Look)
      << "what can't be guessed is let in: behind a proxy all have one address";
  EXPECT_EQ(tokens.opened_by(read("token"), "b", now), Opens::Commands)
      << "who guesses shuts nobody else out";
  for (std::size_t other = 0; other < 2 * WebTokens::kMostGuessers; ++other) {
    EXPECT_EQ(tokens.opened_by("x", std::to_string(other), now), Opens::Nothing);
  }
  EXPECT_EQ(tokens.opened_by(read("token"), "a", now), Opens::NothingNow)
      << "and is not forgotten for many others";
  EXPECT_EQ(tokens.opened_by(read("token"), "a", now + WebTokens::kGuessPeriod), Opens::Commands);
}

TEST(WebConfig, APublicPageNeedsATokenOrToSayThatItNeedsNone) {
  const std::string page = "[web]\nlisten = \"0.0.0.0:8420\"\npublic = true\ntoken_file = \"\"\n";
  try {
    parse_config(page, "facet.toml");
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("facet.toml:3: web.public"), HasSubstr("open_look = true")));
  }
  EXPECT_TRUE(parse_config(page + "open_look = true\n", "facet.toml").web.open_look);
}

}  // namespace
}  // namespace facet::service
