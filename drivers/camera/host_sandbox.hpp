#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace facet::camera {

/// What of the file system a camera's process may reach besides system libraries (/usr) and what the kernel
/// tells of devices (/sys, /run/udev), which it may read. Paths that are not there are left out.
struct HostReach {
  std::vector<std::filesystem::path> readable;  ///< files, and folders with all that is below
  std::vector<std::filesystem::path> devices;   ///< the same; opened for reading and writing
};

/// Why this kernel can't keep a process from files (Landlock, Linux 5.13); empty where it can. Not for a
/// process that is confined, which can't ask.
std::string files_unguarded();

/// Takes from this process, for good, all that a camera's driver does not need:
///
/// files      it opens `reach` and nothing else, by Landlock. Where files_unguarded() says why not, it still
///            makes, empties, renames and removes nothing, but reads and writes what its user may.
/// processes  it starts none, signals none, limits, slows and looks into none but itself
/// network    it makes no socket but one that hears of devices that come and go (udev), so that it can't
///            reach the daemon's own sockets either
/// the rest   no privileges by files that it might run, no new session, no namespaces, mounts, keys, BPF
///
/// What is open stays usable. For the calling thread and those that it starts later: to be called before
/// there are others. Throws std::runtime_error where the kernel can't filter system calls (seccomp).
void confine_host(const HostReach& reach);

}  // namespace facet::camera
