#include <gtest/gtest.h>
#include <sched.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <set>
#include <string>

#include "gpu/context.hpp"
#include "gpu/software_threads.hpp"

namespace facet::gpu {
namespace {

/// Core masks of lavapipe's workers by thread name, as sets of cores.
std::multimap<std::string, std::set<int>> workers() {
  std::multimap<std::string, std::set<int>> found;
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::ifstream file(task.path() / "comm");
    std::string comm;
    std::getline(file, comm);
    if (!comm.starts_with("llvmpipe-")) {
      continue;
    }
    cpu_set_t mask;
    CPU_ZERO(&mask);
    EXPECT_EQ(sched_getaffinity(std::stoi(task.path().filename()), sizeof(mask), &mask), 0);
    std::set<int> cores;
    for (int core = 0; core < CPU_SETSIZE; ++core) {
      if (CPU_ISSET(core, &mask)) {
        cores.insert(core);
      }
    }
    found.emplace(comm, cores);
  }
  return found;
}

ContextOptions software() {
  ContextOptions options;
  options.device = "llvmpipe";
  options.validation = Validation::Off;
  return options;
}

bool has_lavapipe() {
  try {
    const Context context(software());
    return true;
  } catch (const Error&) {
    return false;
  }
}

// Each test in a child process, since thread counts and masks belong to the whole process: the exit code is
// the number of the check that failed.
class SoftwareThreadsDeathTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!has_lavapipe()) {
      GTEST_SKIP() << "no lavapipe";
    }
    ::testing::FLAGS_gtest_death_test_style = "threadsafe";
  }
};

/// Removes what an earlier Context of the parent process put into the environment.
void forget_thread_count() {
  ::unsetenv("LP_NUM_THREADS");
}

int check_one_worker_per_core() {
  forget_thread_count();
  const Context context(software());
  const auto found = workers();
  if (static_cast<int>(found.size()) != allowed_core_count()) {
    return 1;
  }
  std::set<int> used;
  for (const auto& [name, cores] : found) {
    if (allowed_core_count() > 1 && cores.size() != 1) {
      return 2;
    }
    used.insert(cores.begin(), cores.end());
  }
  return static_cast<int>(used.size()) == allowed_core_count() ? 0 : 3;
}

TEST_F(SoftwareThreadsDeathTest, OneWorkerOnEachCore) {
  EXPECT_EXIT(std::_Exit(check_one_worker_per_core()), ::testing::ExitedWithCode(0), "");
}

int check_narrow_mask() {
  forget_thread_count();
  cpu_set_t mask;
  CPU_ZERO(&mask);
  CPU_SET(0, &mask);
  if (sched_setaffinity(0, sizeof(mask), &mask) != 0) {
    return 0;  // not on core 0's machine half: nothing to check
  }
  const Context context(software());
  for (const auto& [name, cores] : workers()) {
    if (cores != std::set<int>{0}) {
      return 1;
    }
  }
  return workers().size() <= 1 && context.info().workgroup_count == 8 ? 0 : 2;
}

TEST_F(SoftwareThreadsDeathTest, TheProcessMaskIsHonoured) {
  EXPECT_EXIT(std::_Exit(check_narrow_mask()), ::testing::ExitedWithCode(0), "");
}

int check_environment_wins() {
  ::setenv("LP_NUM_THREADS", "3", 1);
  const Context context(software());
  return workers().size() == 3 ? 0 : 1;
}

TEST_F(SoftwareThreadsDeathTest, TheEnvironmentWins) {
  EXPECT_EXIT(std::_Exit(check_environment_wins()), ::testing::ExitedWithCode(0), "");
}

int check_unpinned() {
  forget_thread_count();
  ContextOptions options = software();
  options.pin_software_threads = false;
  const Context context(options);
  for (const auto& [name, cores] : workers()) {
    if (static_cast<int>(cores.size()) != allowed_core_count()) {
      return 1;
    }
  }
  return 0;
}

TEST_F(SoftwareThreadsDeathTest, PinningCanBeTurnedOff) {
  EXPECT_EXIT(std::_Exit(check_unpinned()), ::testing::ExitedWithCode(0), "");
}

}  // namespace
}  // namespace facet::gpu
