#include "service/control_server.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include <atomic>
#include <chrono>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>

#include "facet/error.hpp"
#include "service/control_client.hpp"
#include "service/errands.hpp"
#include "support/full_queue.hpp"
#include "support/paths.hpp"

namespace facet::service {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using namespace std::chrono_literals;
using ::testing::HasSubstr;

/// A control server with its own loop on a thread.
class Served {
 public:
  explicit Served(const ControlConfig& config) : server_(config, methods()), thread_([this] { loop(); }) {}
  ~Served() {
    stop_ = true;
    thread_.join();
  }
  std::size_t clients() const { return clients_; }

 private:
  static ControlMethods methods() {
    return {{"look",
             {false,
              {},
              [](const json&) {
                return json{{"seen", true}};
              }}},
            {"big", {false, {}, [](const json&) { return json(std::string(1 << 20, 'x')); }}},
            {"change", {true, {{"name"}}, [](const json& params) { return params; }}},
            {"full", {true, {}, [](const json&) -> json { throw Error(ErrorKind::Storage, "disk full"); }}}};
  }
  void loop() {
    while (!stop_) {
      pollfd event{server_.fd(), POLLIN, 0};
      ::poll(&event, 1, 10);
      server_.serve();
      clients_ = server_.client_count();
    }
  }

  ControlServer server_;
  std::atomic<bool> stop_{false};
  std::atomic<std::size_t> clients_{0};
  std::thread thread_;
};

class ControlServerTest : public ::testing::Test {
 protected:
  ControlConfig config() const {
    ControlConfig config;
    config.socket = folder_.path() / "control.sock";
    return config;
  }
  void expect_clients(const Served& served, std::size_t count) const {
    for (int i = 0; i < 500 && served.clients() != count; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    EXPECT_EQ(served.clients(), count);
  }
  /// One line without its end; "" once the server has closed the connection.
  static std::string receive_line(const stream::FileDescriptor& fd) {
    std::string line;
    std::array<char, 65536> piece{};
    while (line.empty() || line.back() != '\n') {
      const ssize_t count = ::recv(fd.get(), piece.data(), piece.size(), 0);
      if (count <= 0) {
        return line;
      }
      line.append(piece.data(), static_cast<std::size_t>(count));
    }
    line.pop_back();
    return line;
  }
  test::TemporaryFolder folder_;
};

TEST_F(ControlServerTest, AnswersManyClients) {
  const Served served(config());
  std::vector<std::unique_ptr<ControlClient>> clients;
  for (int i = 0; i < 20; ++i) {
    clients.push_back(std::make_unique<ControlClient>(config().socket));
  }
  for (int round = 0; round < 3; ++round) {
    for (const auto& client : clients) {
      EXPECT_EQ(client->call("look", json::object()), json({{"seen", true}}));
    }
  }
  EXPECT_EQ(clients[0]->call("change", {{"name", "x"}}), json({{"name", "x"}}));
  EXPECT_EQ(clients[0]->call("big", json::object()).get<std::string>().size(), 1U << 20);
  clients.clear();
  expect_clients(served, 0);
}

TEST_F(ControlServerTest, ErrorsReachTheClientWithTheirKind) {
  const Served served(config());
  ControlClient client(config().socket);
  try {
    client.call("full", json::object());
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    EXPECT_STREQ(error.what(), "disk full");
  }
  try {
    client.call("change", {{"nam", "x"}});
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
  }
}

TEST_F(ControlServerTest, RequestsMayComeInPiecesOrSeveralAtOnce) {
  const Served served(config());
  const stream::FileDescriptor fd = stream::connect_unix(config().socket);
  const std::string two = R"({"jsonrpc":"2.0","method":"look","id":1})"
                          "\r\n\n"
                          R"({"jsonrpc":"2.0","method":"look","id":2})"
                          "\n";
  for (const char character : two) {
    ASSERT_EQ(::send(fd.get(), &character, 1, 0), 1);
  }
  std::string answers;
  while (std::count(answers.begin(), answers.end(), '\n') < 2) {
    std::array<char, 256> piece{};
    const ssize_t count = ::recv(fd.get(), piece.data(), piece.size(), 0);
    ASSERT_GT(count, 0);
    answers.append(piece.data(), static_cast<std::size_t>(count));
  }
  EXPECT_THAT(answers, HasSubstr("\"id\":1"));
  EXPECT_THAT(answers, HasSubstr("\"id\":2"));
}

/// A request that echoes text, with as much of it as makes the line this long.
std::string line_of(std::size_t bytes) {
  const std::string start = R"({"jsonrpc":"2.0","id":7,"method":"change","params":{"name":")";
  const std::string end = R"("}})";
  std::string text(bytes - start.size() - end.size(), 'x');
  text.back() = '!';
  return start + text + end + "\n";
}

TEST_F(ControlServerTest, RequestLinesUpToTheLimitAreAnswered) {
  const Served served(config());
  const stream::FileDescriptor fd = stream::connect_unix(config().socket);
  for (const std::size_t bytes :
       {std::size_t{65'535}, std::size_t{65'537}, kMaxRequestBytes - 1, kMaxRequestBytes}) {
    const std::string request = line_of(bytes);
    ASSERT_EQ(request.size(), bytes + 1);
    ASSERT_EQ(::send(fd.get(), request.data(), request.size(), MSG_NOSIGNAL),
              static_cast<ssize_t>(request.size()));
    const std::string answer = receive_line(fd);
    const json echoed = json::parse(answer, nullptr, false);
    ASSERT_TRUE(echoed.contains("result")) << answer.substr(0, 200);
    EXPECT_EQ(echoed["id"], 7);
    EXPECT_EQ(echoed["result"], json::parse(request)["params"]) << bytes;
  }
}

TEST_F(ControlServerTest, ALineTooLongIsRefusedAndItsClientDropped) {
  const Served served(config());
  for (const std::size_t bytes : {kMaxRequestBytes + 1, kMaxRequestBytes + 10'000, 2 * kMaxRequestBytes}) {
    const stream::FileDescriptor fd = stream::connect_unix(config().socket);
    const std::string request = line_of(bytes);
    // The server may hang up in the middle.
    [[maybe_unused]] const ssize_t sent = ::send(fd.get(), request.data(), request.size(), MSG_NOSIGNAL);
    const json told = json::parse(receive_line(fd), nullptr, false);
    ASSERT_TRUE(told.contains("error")) << bytes;
    EXPECT_EQ(told["error"]["code"], kInvalidRequest);
    EXPECT_EQ(told["error"]["message"], "a request line has 1048576 bytes at most");
    EXPECT_TRUE(told["id"].is_null());
    EXPECT_EQ(receive_line(fd), "") << "nothing follows";
    expect_clients(served, 0);
  }
  // Programs that use the client are told the same.
  ControlClient client(config().socket);
  try {
    client.call("change", {{"name", std::string(3 * kMaxRequestBytes, 'x')}});
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("1048576 bytes at most"));
  }
  EXPECT_EQ(ControlClient(config().socket).call("look", json::object()), json({{"seen", true}}));
}

TEST_F(ControlServerTest, AClientThatNeverReadsHoldsUpNobody) {
  const Served served(config());
  const stream::FileDescriptor greedy = stream::connect_unix(config().socket);
  std::string requests;
  for (int i = 0; i < 100; ++i) {
    requests += R"({"jsonrpc":"2.0","method":"big","id":1})"
                "\n";
  }
  ASSERT_EQ(::send(greedy.get(), requests.data(), requests.size(), MSG_NOSIGNAL),
            static_cast<ssize_t>(requests.size()));
  ControlClient other(config().socket);
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(other.call("look", json::object()), json({{"seen", true}}));
  }
}

TEST_F(ControlServerTest, WhoIsSilentGivesWay) {
  const Served served(config());
  std::vector<stream::FileDescriptor> silent;
  for (std::size_t i = 0; i < config().max_clients; ++i) {
    silent.push_back(stream::connect_unix(config().socket));
  }
  expect_clients(served, config().max_clients);
  ControlClient operator_(config().socket);
  EXPECT_EQ(operator_.call("change", {{"name", "x"}}), json({{"name", "x"}}));
  expect_clients(served, config().max_clients);
  EXPECT_EQ(receive_line(silent.front()), "") << "the first of them";
  // Not who is at work: it keeps its place however many come.
  silent.clear();
  for (std::size_t i = 0; i < config().max_clients + 10; ++i) {
    silent.push_back(stream::connect_unix(config().socket));
    EXPECT_EQ(operator_.call("look", json::object()), json({{"seen", true}}));
  }
}

/// A server whose rounds the test itself makes, with clients that may only look or command as the test wants.
class ControlRounds : public ControlServerTest {
 protected:
  struct Peer {
    stream::FileDescriptor fd;
    std::string received;

    void ask(const std::string& text) const {
      ASSERT_EQ(::send(fd.get(), text.data(), text.size(), MSG_NOSIGNAL), static_cast<ssize_t>(text.size()));
    }
    /// What was sent by now.
    const std::string& read() {
      std::array<char, 65536> piece{};
      for (ssize_t count = 1; count > 0;) {
        count = ::recv(fd.get(), piece.data(), piece.size(), MSG_DONTWAIT);
        received.append(piece.data(), count > 0 ? static_cast<std::size_t>(count) : 0);
        closed = closed || count == 0 || (count < 0 && errno != EAGAIN);
      }
      return received;
    }
    std::ptrdiff_t answers() { return std::count(read().begin(), read().end(), '\n'); }
    bool closed = false;
  };

  ControlRounds() { errands_.start(); }
  ~ControlRounds() override {
    held_.unlock();
    errands_.stop();
  }

  Peer connect() const { return {stream::connect_unix(config().socket), "", false}; }
  /// Over a WebSocket whose handshake is done.
  Peer adopt(bool may_command, const std::string& peer = "10.0.0.1") {
    std::array<int, 2> ends{};
    EXPECT_EQ(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()), 0);
    server_.adopt(stream::FileDescriptor(ends[0]), {0, 0, may_command}, peer, {});
    return {stream::FileDescriptor(ends[1]), "", false};
  }
  /// A client's text message; masked with zeros, which is a mask.
  static std::string message(const std::string& text) {
    std::string frame = "\x81";
    frame += text.size() < 126 ? static_cast<char>(0x80U | text.size()) : static_cast<char>(0x80U | 126U);
    if (text.size() >= 126) {
      frame += static_cast<char>(text.size() >> 8U);
      frame += static_cast<char>(text.size() & 0xFFU);
    }
    return frame + std::string(4, '\0') + text;
  }
  static std::string request(const std::string& method, int id = 1) {
    return json{{"jsonrpc", "2.0"}, {"method", method}, {"id", id}}.dump() + "\n";
  }
  void rounds(int count) {
    for (int i = 0; i < count; ++i) {
      server_.serve();
    }
  }
  /// Rounds until it holds; there is work on another thread.
  template <typename Condition>
  void await(Condition holds) {
    while (!holds()) {
      server_.serve();
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }

  int looks_ = 0;
  int changes_ = 0;
  std::mutex slow_;  ///< "slow" ends once it is free
  std::unique_lock<std::mutex> held_{slow_};
  Errands errands_{"test-errands"};
  ControlServer server_{config(),
                        {{"look",
                          {false,
                           {},
                           [this](const json&) {
                             ++looks_;
                             return json{{"seen", true}};
                           }}},
                         {"big", {false, {}, [](const json&) { return json(std::string(3 << 20, 'x')); }}},
                         {"huge", {false, {}, [](const json&) { return json(std::string(5 << 20, 'x')); }}},
                         {"change",
                          {true,
                           {},
                           [this](const json&) {
                             ++changes_;
                             return json::object();
                           }}},
                         {"slow", {false, {}, [this](const json&) {
                                     return ControlAnswer(errands_, [this] {
                                       const std::lock_guard lock(slow_);
                                       return std::string(R"({"slow":true})");
                                     });
                                   }}}}};
};

TEST_F(ControlRounds, ARoundAnswersOneRequestOfEachClient) {
  Peer greedy = connect();
  Peer other = connect();
  rounds(2);
  std::string many;
  for (int i = 0; i < 10; ++i) {
    many += request("look");
  }
  greedy.ask(many);
  other.ask(request("look"));
  for (int round = 1; round <= 10; ++round) {
    looks_ = 0;
    rounds(1);
    EXPECT_EQ(looks_, round == 1 ? 2 : 1) << round;
    EXPECT_TRUE(server_.due().has_value()) << "there may be more";
  }
  rounds(1);
  EXPECT_FALSE(server_.due().has_value());
  EXPECT_EQ(other.answers(), 1);
  EXPECT_EQ(greedy.answers(), 10);
}

TEST_F(ControlRounds, ABatchIsAnsweredOverSeveralRoundsInOneLine) {
  Peer peer = connect();
  rounds(2);
  json batch = json::array();
  for (int i = 0; i < 5; ++i) {
    batch.push_back(json::parse(request(i == 2 ? "slow" : "look", i)));
  }
  peer.ask(batch.dump() + "\n");
  rounds(1);
  EXPECT_EQ(looks_, 1);
  rounds(10);
  EXPECT_EQ(looks_, 2) << "the third one is at work elsewhere";
  EXPECT_EQ(peer.answers(), 0);
  held_.unlock();
  await([&] { return peer.answers() == 1; });
  held_.lock();
  const json answers = json::parse(peer.received);
  ASSERT_EQ(answers.size(), 5U);
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(answers[static_cast<std::size_t>(i)]["id"], i);
  }
  EXPECT_EQ(answers[2]["result"], json({{"slow", true}}));
}

TEST_F(ControlRounds, WorkElsewhereHoldsUpNobodyElse) {
  Peer waiting = connect();
  Peer other = connect();
  rounds(2);
  waiting.ask(request("slow", 1) + request("look", 2));
  other.ask(request("look"));
  rounds(5);
  EXPECT_EQ(other.answers(), 1);
  EXPECT_EQ(waiting.answers(), 0) << "not before its turn";
  held_.unlock();
  await([&] { return waiting.answers() == 2; });
  held_.lock();
  EXPECT_LT(waiting.received.find("slow"), waiting.received.find("seen"));
}

TEST_F(ControlRounds, WhoHangsUpIsStillObeyedAndOnlyHalfwayIsAnswered) {
  {
    const Peer hasty = connect();
    rounds(2);
    hasty.ask(request("change") + request("change"));
  }
  rounds(6);
  EXPECT_EQ(changes_, 2);
  EXPECT_EQ(server_.client_count(), 0U);
  Peer half = connect();
  rounds(2);
  half.ask(request("slow") + request("change"));
  ::shutdown(half.fd.get(), SHUT_WR);
  rounds(5);
  EXPECT_FALSE(half.closed);
  held_.unlock();
  await([&] { return half.answers() == 2; });
  held_.lock();
  await([&] { return server_.client_count() == 0; });
}

TEST_F(ControlRounds, WhatWasAskedBeforeTheEndIsDoneThoughItComesWhileAnotherAnswerIsMade) {
  {
    const Peer hasty = connect();
    rounds(2);
    hasty.ask(request("slow"));
    rounds(3);
    hasty.ask(request("change") + request("change"));
  }
  rounds(3);
  EXPECT_EQ(changes_, 0);
  held_.unlock();
  await([&] { return server_.client_count() == 0; });
  held_.lock();
  EXPECT_EQ(changes_, 2);
}

TEST_F(ControlRounds, ManyRequestsOfOneWhoHungUpAreAllDone) {
  constexpr int kRequests = 1000;
  {
    const Peer hasty = connect();
    rounds(2);
    std::string all;
    for (int i = 0; i < kRequests; ++i) {
      all += request("change");
    }
    hasty.ask(all);
  }
  await([&] { return server_.client_count() == 0; });
  EXPECT_EQ(changes_, kRequests);
}

TEST_F(ControlRounds, NobodyIsAskedWhatNobodyHears) {
  Peer peer = connect();
  rounds(2);
  peer.ask(R"({"jsonrpc":"2.0","method":"look"})"
           "\n"
           R"({"jsonrpc":"2.0","method":"change"})"
           "\n");
  rounds(5);
  EXPECT_EQ(looks_, 0);
  EXPECT_EQ(changes_, 1);
  EXPECT_EQ(peer.answers(), 0);
}

TEST_F(ControlRounds, WhoMayOnlyLookHasItsShare) {
  Peer looker = adopt(false);
  Peer commander = adopt(true);
  rounds(2);
  std::string looks;
  for (int i = 0; i < 3 * ControlServer::kLooksAtOnce; ++i) {
    looks += message(request("look"));
  }
  looker.ask(looks);
  const auto began = std::chrono::steady_clock::now();
  rounds(3 * ControlServer::kLooksAtOnce);
  const std::chrono::duration<double> took = std::chrono::steady_clock::now() - began;
  EXPECT_GE(looks_, ControlServer::kLooksAtOnce);
  EXPECT_LE(looks_, ControlServer::kLooksAtOnce + 1 + ControlServer::kLooksPerSecond * took.count());
  looks_ = 0;
  commander.ask(looks);
  rounds(3 * ControlServer::kLooksAtOnce);
  EXPECT_GE(looks_, 3 * ControlServer::kLooksAtOnce);
}

TEST_F(ControlRounds, WhoMayOnlyLookNeedsFewWords) {
  Peer looker = adopt(false);
  Peer commander = adopt(true);
  rounds(2);
  json long_one = json::parse(request("look"));
  long_one["params"] = {{"x", std::string(kMaxLookBytes, 'x')}};
  looker.ask(message(long_one.dump()));
  commander.ask(message(long_one.dump()));
  rounds(5);
  EXPECT_THAT(looker.read(), HasSubstr("16384 bytes at most"));
  EXPECT_TRUE(looker.closed);
  EXPECT_THAT(commander.read(), HasSubstr("takes no params"));
  EXPECT_FALSE(commander.closed);
}

TEST_F(ControlRounds, UnreadAnswersOfLookersAreBounded) {
  std::vector<Peer> lookers;
  for (int i = 0; i < 12; ++i) {
    lookers.push_back(adopt(false, fmt::format("10.0.0.{}", i)));
  }
  Peer commander = adopt(true);
  rounds(2);
  for (const Peer& looker : lookers) {
    looker.ask(message(request("big")));
  }
  commander.ask(message(request("big")));
  rounds(20);
  // 3 MiB each: five of them are 15.
  EXPECT_EQ(server_.client_count(), 1 + ControlServer::kMaxUnreadBytes / (3U << 20));
  EXPECT_FALSE((commander.read(), commander.closed));
}

TEST_F(ControlRounds, AnAnswerTooLongIsAnError) {
  Peer peer = connect();
  rounds(2);
  peer.ask(request("huge"));
  rounds(3);
  EXPECT_THAT(peer.read(), AllOf(HasSubstr("error"), HasSubstr("4194304 are allowed")));
  peer.received.clear();
  json batch = json::array();
  for (const char* method : {"big", "big", "look"}) {
    batch.push_back(json::parse(request(method)));
  }
  peer.ask(batch.dump() + "\n");
  await([&] { return peer.answers() == 1; });
  const json answers = json::parse(peer.received);
  EXPECT_TRUE(answers[0].contains("result"));
  EXPECT_TRUE(answers[1].contains("error"));
}

TEST_F(ControlServerTest, PathTakenAndStalePath) {
  {
    const Served served(config());
    EXPECT_THROW(ControlServer(config(), {}), Error);
    EXPECT_EQ(ControlClient(config().socket).call("look", json::object()), json({{"seen", true}}));
  }
  EXPECT_FALSE(std::filesystem::exists(config().socket));
  std::ofstream(config().socket) << "not a socket";
  try {
    const ControlServer server(config(), {});
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    EXPECT_THAT(error.what(), HasSubstr(config().socket.string()));
  }
}

TEST_F(ControlServerTest, ModeAndGroup) {
  ControlConfig closed = config();
  closed.access.mode = 0600;
  const ControlServer server(closed, {});
  struct stat status {};
  ASSERT_EQ(::stat(closed.socket.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0600U);
  ControlConfig unknown = config();
  unknown.socket = folder_.path() / "other.sock";
  unknown.access.group = "no-such-group-here";
  EXPECT_THROW(ControlServer(unknown, {}), Error);
}

TEST_F(ControlServerTest, ClientSaysThatNobodyAnswers) {
  try {
    ControlClient(config().socket).call("look", json::object());
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
    EXPECT_THAT(error.what(), HasSubstr(config().socket.string()));
  }
}

TEST_F(ControlServerTest, ClientWaitsForAStoppedDaemonNoLongerThanItIsToldTo) {
  const stream::ListeningSocket stopped(config().socket, {});
  const auto silence = [&] {
    try {
      ControlClient(config().socket, 50ms).call("look", json::object());
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_THAT(silence(), HasSubstr("gave no answer for 50 ms"));
  const auto queued = test::fill_queue(config().socket);
  EXPECT_THAT(silence(), HasSubstr("does not answer"));
}

TEST_F(ControlServerTest, ClientWaitsForAWholeAnswerAndNotForEachPieceOfIt) {
  const stream::ListeningSocket slow(config().socket, {});
  std::thread daemon([&] {
    pollfd entry{slow.fd(), POLLIN, 0};
    ::poll(&entry, 1, -1);
    const stream::FileDescriptor connection(::accept(slow.fd(), nullptr, nullptr));
    while (::send(connection.get(), " ", 1, MSG_NOSIGNAL) == 1) {
      std::this_thread::sleep_for(1ms);
    }
  });
  try {
    ControlClient(config().socket, 100ms).call("look", json::object());
    ADD_FAILURE() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("no whole answer for 100 ms"));
  }
  daemon.join();
}

}  // namespace
}  // namespace facet::service
