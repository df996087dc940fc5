#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace facet::test {

/// A folder as a daemon has one, its sockets and itself: what a camera's process must not reach.
struct Surroundings {
  std::filesystem::path folder;  ///< with make_treasures() in it
  int port = 0;                  ///< of 127.0.0.1, where something listens
};

/// "a.take", "token" and "configuration", with something in them.
void make_treasures(const std::filesystem::path& folder);

/// Something that a camera's process tries.
struct Escape {
  enum class Guard {
    Calls,     ///< refused by the filter of system calls
    Files,     ///< refused by Landlock, where the kernel has it
    CallsOnly  ///< the same as Calls, and forbidden to many processes anyway (Yama, capabilities)
  };
  std::string name;
  Guard guard;
  std::function<bool()> attempt;  ///< whether it worked
};

std::vector<Escape> escapes(const Surroundings& around);

}  // namespace facet::test
