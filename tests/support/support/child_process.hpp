#pragma once

#include <fcntl.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

namespace facet::test {

/// How a child begins, beside its program and arguments.
struct Birth {
  std::vector<std::string> environment;  ///< "NAME=VALUE", beside the parent's
  int pending_signal = 0;       ///< blocked and pending when the program begins: it comes at the first look
  rlim_t most_descriptors = 0;  ///< soft and hard limit; 0: the parent's
};

/// Listening sockets that a child gets as a service manager passes them.
struct Passed {
  std::vector<int> sockets{};
  std::string names{};  ///< "a:b" (LISTEN_FDNAMES)
};

/// A program run as a child, its output in a file; killed at the end of the scope where it still runs.
class ChildProcess {
 public:
  ChildProcess(const std::string& program, const std::vector<std::string>& arguments,
               const std::filesystem::path& output, Birth birth = {}, const Passed& passed = {})
      : output_(output) {
    std::vector<std::string> words = arguments;
    words.insert(words.begin(), program);
    std::vector<char*> argv;
    argv.reserve(words.size() + 1);
    for (std::string& word : words) {
      argv.push_back(word.data());
    }
    argv.push_back(nullptr);
    pid_ = ::fork();
    if (pid_ == 0) {
      for (std::string& variable : birth.environment) {
        ::putenv(variable.data());
      }
      if (birth.pending_signal != 0) {
        sigset_t set;
        sigemptyset(&set);
        sigaddset(&set, birth.pending_signal);
        ::sigprocmask(SIG_BLOCK, &set, nullptr);
        ::raise(birth.pending_signal);
      }
      if (birth.most_descriptors != 0) {
        const rlimit limit{birth.most_descriptors, birth.most_descriptors};
        ::setrlimit(RLIMIT_NOFILE, &limit);
      }
      if (!passed.sockets.empty()) {
        pass(passed);
      }
      const int file = ::open(output.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
      ::dup2(file, STDOUT_FILENO);
      ::dup2(file, STDERR_FILENO);
      ::execv(program.c_str(), argv.data());
      ::_exit(127);
    }
  }
  ~ChildProcess() {
    if (running()) {
      ::kill(pid_, SIGKILL);
      wait();
    }
  }
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  void send(int signal) const { ::kill(pid_, signal); }
  pid_t pid() const { return pid_; }

  bool running() {
    if (ended_) {
      return false;
    }
    ended_ = ::waitpid(pid_, &status_, WNOHANG) == pid_;
    return !ended_;
  }

  /// Exit status, or 128 + signal.
  int wait() {
    if (!ended_) {
      ::waitpid(pid_, &status_, 0);
      ended_ = true;
    }
    return WIFEXITED(status_) ? WEXITSTATUS(status_) : 128 + WTERMSIG(status_);
  }

  std::string output() const {
    std::ifstream file(output_);
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  }

 private:
  static void pass(const Passed& passed) {
    constexpr int kFirst = 3;    // SD_LISTEN_FDS_START
    constexpr int kAside = 100;  // where none of them is in another's way
    const int count = static_cast<int>(passed.sockets.size());
    for (int s = 0; s < count; ++s) {
      ::dup2(passed.sockets[static_cast<std::size_t>(s)], kAside + s);
    }
    for (int s = 0; s < count; ++s) {
      ::dup2(kAside + s, kFirst + s);
      ::close(kAside + s);
    }
    ::setenv("LISTEN_PID", std::to_string(::getpid()).c_str(), 1);
    ::setenv("LISTEN_FDS", std::to_string(count).c_str(), 1);
    ::setenv("LISTEN_FDNAMES", passed.names.c_str(), 1);
  }

  std::filesystem::path output_;
  pid_t pid_ = -1;
  int status_ = 0;
  bool ended_ = false;
};

}  // namespace facet::test
