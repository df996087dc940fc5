// A disk that takes and gives nothing for a while: the daemon goes on, and ends when it is told to.

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <future>
#include <string>

#include "daemon_fixture.hpp"
#include "support/source_folder.hpp"
#include "take/reader.hpp"

namespace facet::service {
namespace {

using ::testing::AnyOf;

/// As long as the gate stands, the disk stands still.
class SlowDisk : public Daemon {
 protected:
  void SetUp() override {
#ifdef FACET_SANITIZED
    GTEST_SKIP() << "a sanitizer's library wants to be the first that is loaded";
#endif
    Daemon::SetUp();
    std::filesystem::copy_file(std::filesystem::path(FACET_SOURCE_DIR) / "config" / "devices.toml", config_);
    std::ofstream(config_, std::ios::app)
        << "[stream]\nsocket = \"stream.sock\"\n[control]\nsocket = \"control.sock\"\n"
           "[takes]\nfolder = \"takes\"\ndisk_reserve_mb = 1\n[metrics]\nlisten = \"\"\n"
           "[web]\nlisten = \"127.0.0.1:0\"\ntoken_file = \"token\"\n";
  }

  std::unique_ptr<ChildProcess> start_stalled(const std::string& call, const std::string& part) {
    return start(config_.string(),
                 {.environment = {std::string("LD_PRELOAD=") + START_FAULT,
                                  fmt::format("FACET_STALL={} {} {}", call, gate_.string(), part)},
                  .pending_signal = 0});
  }
  /// The disk stands still from now on until open_gate.
  void close_gate(const ChildProcess& daemon) {
    waited_ = waits(daemon);
    std::ofstream(gate_) << "closed";
  }
  void open_gate() const {
    std::filesystem::remove(gate_);
  }
  /// Opens the gate before what is declared earlier waits for its end.
  struct OpensAtEnd {
    const SlowDisk& disk;
    ~OpensAtEnd() { disk.open_gate(); }
  };

  static int waits(const ChildProcess& daemon) {
    const std::string said = daemon.output();
    int found = 0;
    for (std::size_t at = said.find(kWaits); at != std::string::npos; at = said.find(kWaits, at + 1)) {
      ++found;
    }
    return found;
  }
  /// Until a call waits that began after the gate was closed.
  void await_wait(ChildProcess& daemon) const {
    await(daemon, [&](const json&) { return waits(daemon) > waited_; });
  }

  static constexpr const char* kWaits = "start_fault: waits";
  const std::filesystem::path config_ = folder_.path() / "facet.toml";
  const std::filesystem::path gate_ = folder_.path() / "gate";
  int waited_ = 0;  ///< calls when the gate was closed
};

TEST_F(SlowDisk, TheLoopAnswersWhileARecordingBeginsAndEnds) {
  const auto daemon = start_stalled("sync", "slow.take");
  await(*daemon, [](const json& now) { return now["state"] == "running"; });
  close_gate(*daemon);
  auto begun = std::async(std::launch::async, [&] { return ask("record.start", {{"name", "slow"}}); });
  const OpensAtEnd opens_for_begun{*this};
  await_wait(*daemon);
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(ask("status")["state"], "running");
  }
  EXPECT_EQ(begun.wait_for(std::chrono::seconds(0)), std::future_status::timeout)
      << "the disk has not taken its beginning yet";
  open_gate();
  EXPECT_EQ(begun.get()["file"], (folder_.path() / "takes/slow.take").string());
  await(*daemon, [](const json& now) { return now["recording"]["frames"] > 5; });
  close_gate(*daemon);
  auto ended = std::async(std::launch::async, [&] { return ask("record.stop"); });
  const OpensAtEnd opens_for_ended{*this};
  await_wait(*daemon);
  EXPECT_EQ(ask("status")["state"], "running");
  EXPECT_EQ(ended.wait_for(std::chrono::seconds(0)), std::future_status::timeout);
  open_gate();
  EXPECT_EQ(ended.get()["state"], "finished");
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
  EXPECT_TRUE(take::TakeReader(folder_.path() / "takes/slow.take").info().closed);
}

TEST_F(SlowDisk, AStopDoesNotWaitForItAndTheTakeIsClosedAtTheNextStart) {
  auto daemon = start_stalled("sync", "slow.take");
  await(*daemon, [](const json& now) { return now["state"] == "running"; });
  ask("record.start", {{"name", "slow"}});
  await(*daemon, [](const json& now) { return now["recording"]["frames"] > 20; });
  close_gate(*daemon);
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0) << "the gate is still closed: " << daemon->output();
  EXPECT_THAT(daemon->output(), AllOf(HasSubstr(kWaits), AnyOf(HasSubstr("a slow disk leaves a part of it"),
                                                               HasSubstr("it is closed at the next start"))));
  open_gate();
  daemon = start(config_.string());
  await(*daemon, [&](const json&) {
    const json takes = ask("takes.list")["takes"];
    return takes.size() == 1 && takes[0]["closed"] == true;
  });
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
  const take::TakeReader reader(folder_.path() / "takes/slow.take");
  EXPECT_TRUE(reader.info().closed);
  EXPECT_GT(reader.frame_count(), 0) << "what was written is kept";
}

TEST_F(SlowDisk, AStopDoesNotWaitForThePagesDownloads) {
  std::filesystem::create_directory(folder_.path() / "takes" / ".thumbnails");
  std::ofstream(folder_.path() / "takes" / ".thumbnails" / "slow.png") << "a picture";
  const auto daemon = start_stalled("read", "slow.png");
  const json status = await(*daemon, [](const json& now) { return now["web"].is_object(); });
  close_gate(*daemon);
  const std::string url = status["web"]["url"];
  const stream::FileDescriptor connection(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(url.substr(url.rfind(':') + 1))));
  ASSERT_EQ(::connect(connection.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  const std::string request = "GET /thumbnails/slow HTTP/1.1\r\nHost: localhost\r\n\r\n";
  ASSERT_EQ(::send(connection.get(), request.data(), request.size(), 0),
            static_cast<ssize_t>(request.size()));
  await_wait(*daemon);
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0) << "the gate is still closed: " << daemon->output();
  EXPECT_FALSE(std::filesystem::exists(control()));
}

}  // namespace
}  // namespace facet::service
