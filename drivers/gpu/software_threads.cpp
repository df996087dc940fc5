#include "gpu/software_threads.hpp"

#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

namespace facet::gpu {

namespace {

constexpr std::string_view worker_prefix = "llvmpipe-";

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
  if (cores.size() < 2) {
    return;
  }
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
    cpu_set_t mask;
    CPU_ZERO(&mask);
    CPU_SET(static_cast<std::size_t>(cores[worker % cores.size()]), &mask);
    sched_setaffinity(thread, sizeof(mask), &mask);
  }
}

}  // namespace facet::gpu
