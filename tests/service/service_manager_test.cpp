// facetd and its service manager: what it tells, when it lets itself be killed, which sockets it takes.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/ptrace.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <future>
#include <mutex>
#include <optional>
#include <thread>

#include "daemon_fixture.hpp"
#include "pipeline/progress.hpp"
#include "stream/client.hpp"
#include "stream/unix_socket.hpp"

namespace facet::service {
namespace {

using ::testing::Contains;
using ::testing::Not;
using ::testing::StartsWith;

/// A service manager's socket: keeps what a daemon says. A thread reads all the time, as a service manager
/// does: a daemon that is not listened to would wait.
class NotifySocket {
 public:
  explicit NotifySocket(const std::filesystem::path& path)
      : path_(path), fd_(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
    EXPECT_EQ(::bind(fd_.get(), reinterpret_cast<sockaddr*>(&address), sizeof(address)), 0);
    reader_ = std::thread([this] { read(); });
  }
  ~NotifySocket() {
    ::shutdown(fd_.get(), SHUT_RDWR);  // wakes the reader
    reader_.join();
  }
  NotifySocket(const NotifySocket&) = delete;
  NotifySocket& operator=(const NotifySocket&) = delete;

  std::string variable() const { return "NOTIFY_SOCKET=" + path_.string(); }

  /// Everything said so far, in order.
  std::vector<std::string> said() const {
    const std::lock_guard lock(mutex_);
    return said_;
  }
  long count(const std::string& state) const {
    const std::lock_guard lock(mutex_);
    return std::count(said_.begin(), said_.end(), state);
  }
  /// Waits until a daemon that has ended was heard to the end.
  void await_last_word() const {
    while (count("STOPPING=1") == 0) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  }

 private:
  void read() {
    std::array<char, 4096> text{};
    for (ssize_t size = 0; (size = ::recv(fd_.get(), text.data(), text.size(), 0)) > 0;) {
      const std::lock_guard lock(mutex_);
      said_.emplace_back(text.data(), static_cast<std::size_t>(size));
    }
  }

  std::filesystem::path path_;
  stream::FileDescriptor fd_;
  mutable std::mutex mutex_;
  std::vector<std::string> said_;  ///< guarded by mutex_
  std::thread reader_;
};

/// Holds one thread of a child process where it is, whatever it does or waits for, until the end of the
/// scope.
class HeldThread {
 public:
  HeldThread(pid_t process, const std::string& name) : id_(find(process, name)) {
    held_ = id_ && ::ptrace(PTRACE_SEIZE, *id_, nullptr, nullptr) == 0 &&
            ::ptrace(PTRACE_INTERRUPT, *id_, nullptr, nullptr) == 0 &&
            ::waitpid(*id_, nullptr, __WALL) == *id_;
    error_ = held_ ? 0 : errno;
  }
  ~HeldThread() {
    if (held_) {
      ::ptrace(PTRACE_DETACH, *id_, nullptr, nullptr);
    }
  }
  HeldThread(const HeldThread&) = delete;
  HeldThread& operator=(const HeldThread&) = delete;

  bool held() const { return held_; }
  bool forbidden() const { return error_ == EPERM; }

 private:
  static std::optional<pid_t> find(pid_t process, const std::string& name) {
    for (const auto& task : std::filesystem::directory_iterator(fmt::format("/proc/{}/task", process))) {
      std::string comm;
      std::ifstream(task.path() / "comm") >> comm;
      if (comm == name) {
        return std::stoi(task.path().filename());
      }
    }
    return std::nullopt;
  }

  std::optional<pid_t> id_;
  bool held_ = false;
  int error_ = 0;
};

class Managed : public DaemonWithAssets {
 protected:
  void SetUp() override {
    DaemonWithAssets::SetUp();
    manager_.emplace(folder_.path() / "notify.sock");
  }
  Birth birth(int watchdog_us = 0) const {
    Birth birth;
    birth.environment = {manager_->variable()};
    if (watchdog_us != 0) {
      birth.environment.push_back(fmt::format("WATCHDOG_USEC={}", watchdog_us));
    }
    return birth;
  }
  /// Waits until a daemon that runs has done something; what it said shows where it ends instead.
  void await_that(ChildProcess& daemon, const std::function<bool()>& passes) {
    while (!passes()) {
      ASSERT_TRUE(daemon.running()) << daemon.output();
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  }
  void await_food(ChildProcess& daemon, long portions) {
    const long before = manager_->count("WATCHDOG=1");
    await_that(daemon, [&] { return manager_->count("WATCHDOG=1") >= before + portions; });
  }

  std::optional<NotifySocket> manager_;
};

TEST_F(Managed, TellsThatItIsReadyHowItDoesAndThatItStops) {
  const auto daemon = start(configure(looped()), birth());
  await_that(*daemon, [&] {
    const auto said = manager_->said();
    return std::any_of(said.begin(), said.end(),
                       [](const auto& state) { return state.find("STATUS=running") == 0; });
  });
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
  manager_->await_last_word();
  const std::vector<std::string> said = manager_->said();
  EXPECT_EQ(manager_->count("READY=1"), 1);
  EXPECT_THAT(said, Contains(AllOf(StartsWith("STATUS=running: source streaming, "), HasSubstr("frames/s"))));
  EXPECT_EQ(said.back(), "STOPPING=1");
  EXPECT_EQ(manager_->count("WATCHDOG=1"), 0) << "there is no watchdog";
}

TEST_F(Managed, IsNotReadyWhereItCannotStart) {
  std::string output;
  EXPECT_EQ(run({"--config", configure("path = \"none.mp4\"")}, output, birth()), 3);
  manager_->await_last_word();
  EXPECT_EQ(manager_->count("READY=1"), 0);
  EXPECT_THAT(manager_->said(), Contains(AllOf(StartsWith("STATUS="), HasSubstr("none.mp4"))));
}

TEST_F(Managed, ACameraThatIsNotThereIsNoHang) {
  const auto daemon =
      start(configure("kind = \"v4l2\"\ndevice = \"/dev/there-is-no-such-video-device\""), birth(3'000'000));
  await_that(*daemon, [&] { return manager_->count("READY=1") == 1; });
  await_food(*daemon, 8);  // twice the watchdog's time
  EXPECT_THAT(daemon->output(), Not(HasSubstr("hangs")));
  EXPECT_THAT(manager_->said(), Contains(AllOf(StartsWith("STATUS=running"), HasSubstr("source absent"))));
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
}

TEST_F(Managed, ASourceAtItsEndIsNoHang) {
  const auto daemon =
      start(configure(fmt::format("path = \"{}\"\nframes = \":4\"", clip().string())), birth(3'000'000));
  await(*daemon, [](const json& now) { return now["state"] == "ended"; });
  await_food(*daemon, 8);
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
}

class ManagedWorker : public Managed, public ::testing::WithParamInterface<const char*> {};

TEST_P(ManagedWorker, ItsHangIsNotFed) {
  const std::string thread = GetParam();
#ifdef FACET_SANITIZED
  constexpr std::chrono::milliseconds kWatchdog{8000};
#else
  constexpr std::chrono::milliseconds kWatchdog{2000};
#endif
  const auto daemon = start(configure(looped()), birth(kWatchdog.count() * 1000));
  await(*daemon, is_running);
  await_food(*daemon, 2);
  {
    const HeldThread hung(daemon->pid(), thread);
    if (hung.forbidden()) {
      GTEST_SKIP() << "this test may not trace its children, so it can't make a thread hang";
    }
    ASSERT_TRUE(hung.held());
    // A busy machine may have been late before.
    const std::size_t told = daemon->output().size();
    const long triggered = manager_->count("WATCHDOG=trigger");
    await_that(*daemon, [&] { return daemon->output().find(thread + " hangs", told) != std::string::npos; });
    const long fed = manager_->count("WATCHDOG=1");
    await_that(*daemon, [&] { return manager_->count("WATCHDOG=trigger") > triggered; });
    EXPECT_EQ(manager_->count("WATCHDOG=1"), fed);
    EXPECT_EQ(ask("status")["state"], "running") << "the loop itself is well";
  }
  await_food(*daemon, 2);
  EXPECT_THAT(daemon->output(), HasSubstr("gets on again"));
  daemon->send(SIGTERM);
  expect_clean_end(*daemon);
}

INSTANTIATE_TEST_SUITE_P(Each, ManagedWorker,
                         ::testing::Values("facet-capture", "facet-track", "facet-refine"),
                         [](const auto& tested) {
                           std::string name = tested.param;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

TEST_F(Managed, PassedSocketsServeThoseWhoCameBeforeIt) {
  const auto stream_path = folder_.path() / "stream.sock";
  stream::ListeningSocket stream_socket(stream_path, {});
  stream::ListeningSocket control_socket(control(), {});
  auto early_reader = std::async(std::launch::async, [&] {
    return std::make_unique<stream::StreamClient>(stream_path, stream::Subscription(),
                                                  std::chrono::minutes(5));
  });
  auto early_answer = std::async(std::launch::async, [&] {
    return ControlClient(control(), std::chrono::minutes(5)).call("status", json::object());
  });
  const auto daemon =
      start(configure(looped()), birth(),
            {.sockets = {control_socket.fd(), stream_socket.fd()}, .names = "control:stream"});
  EXPECT_EQ(early_answer.get()["pid"], daemon->pid());
  EXPECT_THAT(early_reader.get()->hello().server, HasSubstr("facetd"));
  await(*daemon, is_running);
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0) << daemon->output();
  EXPECT_TRUE(stream::connect_unix(stream_path)) << "the sockets are the manager's and stay";
  EXPECT_TRUE(stream::connect_unix(control()));
}

TEST_F(Managed, WrongPassedSocketsAreNamed) {
  const stream::ListeningSocket other(folder_.path() / "other.sock", {});
  test::Passed passed{.sockets = {other.fd()}, .names = "stream"};
  std::string output;
  EXPECT_EQ(run({"--config", configure(looped())}, output, birth(), passed), 2);
  EXPECT_THAT(output, AllOf(HasSubstr("other.sock"), HasSubstr("stream.sock")));
  passed.names = "facetd.socket";
  EXPECT_EQ(run({"--config", configure(looped())}, output, birth(), passed), 2);
  EXPECT_THAT(output, AllOf(HasSubstr("'facetd.socket'"), HasSubstr("FileDescriptorName=")));
}

}  // namespace
}  // namespace facet::service
