#include "service/service_manager.hpp"

#include <fmt/format.h>
#include <systemd/sd-daemon.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"

namespace facet::service {
namespace {

/// What comes of it is ignored: a service manager that is gone is no reason to stop. One that is there and
/// does not read holds the caller up once its queue (512 messages under systemd) is full.
void notify(const std::string& state) {
  ::sd_notify(0, state.c_str());
}

}  // namespace

PassedSockets take_passed_sockets() {
  char** names = nullptr;
  const int count = ::sd_listen_fds_with_names(1, &names);
  if (count < 0) {
    throw Error(ErrorKind::Internal,
                fmt::format("sockets passed by the service manager: {}", std::strerror(-count)));
  }
  PassedSockets sockets;
  std::string unknown;
  for (int s = 0; s < count; ++s) {
    stream::FileDescriptor fd(SD_LISTEN_FDS_START + s);
    const std::string name = names[s];
    if (name == "stream") {
      sockets.stream = std::move(fd);
    } else if (name == "control") {
      sockets.control = std::move(fd);
    } else {
      unknown = name;
    }
    std::free(names[s]);  // NOLINT(cppcoreguidelines-no-malloc): sd_listen_fds(3) says so
  }
  std::free(names);  // NOLINT(cppcoreguidelines-no-malloc)
  if (!unknown.empty()) {
    throw Error(ErrorKind::Usage,
                fmt::format("the service manager passes a socket named '{}': FileDescriptorName= of a socket "
                            "unit for facetd must be \"stream\" or \"control\"",
                            unknown));
  }
  return sockets;
}

ServiceManager::ServiceManager(const Log& log) : log_(log) {
  std::uint64_t watchdog_us = 0;
  if (::sd_watchdog_enabled(0, &watchdog_us) > 0) {
    watchdog_ = std::chrono::microseconds(watchdog_us);
  }
}

void ServiceManager::ready() {
  notify("READY=1");
}

void ServiceManager::status(const std::string& text) {
  if (std::exchange(status_, text) == text) {
    return;
  }
  std::string line = "STATUS=" + text;
  std::replace(line.begin(), line.end(), '\n', ' ');
  notify(line);
}

void ServiceManager::stopping() {
  notify("STOPPING=1");
}

std::chrono::microseconds ServiceManager::patience() const {
  return watchdog_ ? *watchdog_ / 2 : std::chrono::seconds(10);
}

void ServiceManager::look_after(const std::optional<pipeline::Progress::Silence>& silence) {
  const bool hung = silence && silence->length > patience();
  if (hung && !hung_) {
    const std::string& thread = silence->worker;
    log_.error(fmt::format("{} hangs: nothing from it for {:.1f} s{}", thread,
                           std::chrono::duration<double>(silence->length).count(),
                           watchdog_ ? "; the watchdog is not fed until it gets on" : ""),
               {{"FACET_EVENT", "hang"}, {"FACET_THREAD", thread}});
  } else if (hung_ && !hung) {
    log_.info("the thread that hung gets on again", {{"FACET_EVENT", "hang-over"}});
  }
  hung_ = hung;
  if (!silence || !watchdog_ || silence->length < *watchdog_) {
    triggered_ = false;
  } else if (!std::exchange(triggered_, true)) {
    // It would bite anyway, as long after the last food.
    notify("WATCHDOG=trigger");
  }
  const Clock::time_point now = Clock::now();
  // Often enough that one late round of the loop does no harm.
  if (watchdog_ && !hung && now - fed_ >= *watchdog_ / 4) {
    notify("WATCHDOG=1");
    fed_ = now;
  }
}

}  // namespace facet::service
