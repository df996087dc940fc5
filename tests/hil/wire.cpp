// A wire between two lines of a simulated GPIO chip: what one is set to is what the other reads.
//   wire FOLDER FROM TO [FROM TO]...    FOLDER: such as /sys/devices/platform/gpio-sim.0/gpiochip0; offsets
//   of lines
// Looks every millisecond until it is killed; an output line of gpio-sim shows its level, and nothing tells
// of a change.

#include <fcntl.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <string>
#include <thread>
#include <vector>

namespace {

struct Wire {
  int from;
  int to;
  char level;
};

int open_attribute(const std::string& folder, const std::string& line, const char* attribute, int flags) {
  const std::string path = folder + "/sim_gpio" + line + "/" + attribute;
  const int fd = ::open(path.c_str(), flags | O_CLOEXEC);
  if (fd < 0) {
    std::perror(path.c_str());
  }
  return fd;
}

bool carry(Wire& wire) {
  char level = 0;
  if (::pread(wire.from, &level, 1, 0) != 1) {
    std::perror("wire: its end is gone");
    return false;
  }
  if (level == wire.level) {
    return true;
  }
  wire.level = level;
  const std::string pull = level == '1' ? "pull-up" : "pull-down";
  return ::pwrite(wire.to, pull.data(), pull.size(), 0) == static_cast<ssize_t>(pull.size());
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4 || argc % 2 != 0) {
    std::fprintf(stderr, "usage: wire FOLDER FROM TO [FROM TO]...\n");
    return 2;
  }
  std::vector<Wire> wires;
  for (int i = 2; i + 1 < argc; i += 2) {
    wires.push_back({open_attribute(argv[1], argv[i], "value", O_RDONLY),
                     open_attribute(argv[1], argv[i + 1], "pull", O_WRONLY), 0});
    if (wires.back().from < 0 || wires.back().to < 0) {
      return 1;
    }
  }
  for (;;) {
    for (Wire& wire : wires) {
      if (!carry(wire)) {
        return 1;
      }
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}
