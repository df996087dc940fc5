#include "programs.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include "facet/error.hpp"

namespace facet::tools {

std::filesystem::path program(const std::string& name) {
  std::filesystem::path self = std::filesystem::read_symlink("/proc/self/exe");
  if (name == "facet") {
    return self;
  }
  for (const char* place : {"", "../sbin", "../daemon/service"}) {
    std::filesystem::path candidate = self.parent_path() / place / name;
    if (::access(candidate.c_str(), X_OK) == 0) {
      return candidate;
    }
  }
  throw Error(ErrorKind::Unavailable, fmt::format("'{}' is not beside {}: install it", name, self.string()));
}

}  // namespace facet::tools
