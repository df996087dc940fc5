#include "service/descriptors.hpp"

#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <type_traits>

#include "service/http_connections.hpp"
#include "stream/places.hpp"
#include "stream/server.hpp"

namespace facet::service {
namespace {

/// Standard streams, log, service manager, signals, the sockets that listen, epolls and eventfds, GPU,
/// source, bridges; the recorder's take, log, shared memory, segment and folders; the studio's take and
/// basis; the takes that are listed and drawn; what libraries open for a moment.
constexpr std::size_t kOwn = 96;
/// Device or socket, memory, wake-ups, trigger line and the buffers of one camera.
constexpr std::size_t kPerCamera = 8;
/// Of who finds VRChats: those that are asked and those that are sent to, questions, wake-up.
constexpr std::size_t kOfVrChats = 14;
constexpr std::size_t kLeastPlaces = 2;  ///< of each kind

/// Of all servers, with those that a round accepts only to close them.
std::size_t of_places(const Config& config) {
  const std::size_t accepted = stream::kAcceptsPerRound;
  const auto readers = static_cast<std::size_t>(config.stream.max_readers);
  std::size_t sum = (readers * stream::StreamServer::kDescriptorsPerReader) + accepted;
  sum += config.control.max_clients + accepted;
  if (!config.web.listen.empty()) {
    sum += static_cast<std::size_t>(config.stream.max_web_readers) + config.control.max_clients;
    sum += config.web.max_connections + HttpConnections::kEnding + config.web.max_downloads;
  }
  if (!config.metrics.listen.empty()) {
    sum += config.metrics.max_connections + HttpConnections::kEnding;
  }
  return sum;
}

std::size_t of_our_own(const Config& config) {
  const bool finds = config.bridges.find.where != avatar::VrChatFind::Off;
  return kOwn + (finds ? kOfVrChats : 0) +
         (kPerCamera * std::max<std::size_t>(1, config.devices.cameras.size()));
}

}  // namespace

std::size_t descriptors_needed(const Config& config) {
  return of_our_own(config) + of_places(config);
}

std::string fit_descriptors(Config& config, std::size_t limit) {
  const std::size_t needed = descriptors_needed(config);
  if (needed <= limit) {
    return {};
  }
  // What has many places is lowered first, until all have as many.
  constexpr std::size_t kMostPlaces = 1000;
  for (std::size_t most = kMostPlaces; most >= kLeastPlaces && descriptors_needed(config) > limit; --most) {
    const auto lower = [&](auto& places) {
      places = std::min(places, static_cast<std::remove_reference_t<decltype(places)>>(most));
    };
    lower(config.stream.max_readers);
    lower(config.stream.max_web_readers);
    lower(config.control.max_clients);
    lower(config.web.max_connections);
    lower(config.web.max_downloads);
    lower(config.metrics.max_connections);
  }
  return fmt::format(
      "{} file descriptors are too few for all places ({} are needed; LimitNOFILE= of the unit): {} readers "
      "of the stream, {} over the page, {} control clients, {} requests to the page, {} downloads{}",
      limit, needed, config.stream.max_readers, config.stream.max_web_readers, config.control.max_clients,
      config.web.max_connections, config.web.max_downloads,
      descriptors_needed(config) <= limit ? "" : "; even so a recording may find none left");
}

std::size_t raise_descriptor_limit() {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) {
    return 0;
  }
  const rlimit raised{limit.rlim_max, limit.rlim_max};
  return ::setrlimit(RLIMIT_NOFILE, &raised) == 0 ? raised.rlim_cur : limit.rlim_cur;
}

}  // namespace facet::service
