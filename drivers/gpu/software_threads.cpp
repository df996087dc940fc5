#include "gpu/software_threads.hpp"

#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

namespace facet::gpu {

namespace {

constexpr std::string_view worker_prefix = "llvmpipe-";
constexpr int most_attempts = 100;
constexpr std::chrono::milliseconds attempt_pause{2};

/// Cores that this process may use, ascending: the mask of its main thread, since a caller may have narrowed
/// its own.
std::vector<int> allowed_cores() {
  cpu_set_t mask;
  CPU_ZERO(&mask);
  std::vector<int> cores;
  if (sched_getaffinity(getpid(), sizeof(mask), &mask) == 0) {
    for (int core = 0; core < CPU_SETSIZE; ++core) {
      if (CPU_ISSET(core, &mask)) {
        cores.push_back(core);
      }
    }
  }
  return cores;
}

template <typename Number>
bool parse(std::string_view text, Number& out) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), out);
  return error == std::errc() && end == text.data() + text.size();
}

/// Puts every worker that bears its name by now onto its core, where there is more than one core; returns how
/// many there are.
std::size_t pin_named_workers(const std::vector<int>& cores) {
  std::size_t found = 0;
  std::error_code error;
  for (std::filesystem::directory_iterator task("/proc/self/task", error), end; !error && task != end;
       task.increment(error)) {
    std::ifstream file(task->path() / "comm");
    std::string comm;
    std::getline(file, comm);
    std::size_t worker = 0;
    pid_t thread = 0;
    if (!comm.starts_with(worker_prefix) || !parse(comm.substr(worker_prefix.size()), worker) ||
        !parse(task->path().filename().string(), thread)) {
      continue;
    }
    ++found;
    if (cores.size() > 1) {
      cpu_set_t mask;
      CPU_ZERO(&mask);
      CPU_SET(static_cast<std::size_t>(cores[worker % cores.size()]), &mask);
      sched_setaffinity(thread, sizeof(mask), &mask);
    }
  }
  return found;
}

}  // namespace

int allowed_core_count() {
  return std::max(1, static_cast<int>(allowed_cores().size()));
}

void choose_software_thread_count() {
  constexpr int keep_what_is_set = 0;
  ::setenv("LP_NUM_THREADS", std::to_string(allowed_core_count()).c_str(), keep_what_is_set);
}

void pin_software_threads() {
  const std::vector<int> cores = allowed_cores();
  const char* set = std::getenv("LP_NUM_THREADS");
  std::size_t expected = 0;
  if (set == nullptr || !parse(std::string_view(set), expected)) {
    expected = cores.size();
  }
  // A worker names itself as its first act, so on a busy machine it may not have done so yet.
  for (int attempt = 0; pin_named_workers(cores) < expected && attempt < most_attempts; ++attempt) {
    std::this_thread::sleep_for(attempt_pause);
  }
}

}  // namespace facet::gpu
