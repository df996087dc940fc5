#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "pipeline/status.hpp"
#include "service/web_server.hpp"
#include "stream/server.hpp"
#include "take/recorder.hpp"

namespace facet::service {

/// What the metrics are made of, at one moment.
struct MetricsSnapshot {
  std::string state;  ///< as in `facet status`
  double uptime_s = 0;
  std::uint64_t resident_bytes = 0;
  std::uint64_t disk_free_bytes = 0;  ///< where takes are recorded
  pipeline::PipelineStatus pipeline;
  stream::StreamStatistics stream;
  std::optional<take::RecorderStatus> take;
  std::optional<WebStatistics> web;  ///< none: the page is off
};

/// Serves metrics in Prometheus' text format over HTTP, path /metrics (docs/metrics.md lists them). Its one
/// thread asks for a snapshot with every scrape. Destroying it ends the thread.
class MetricsServer {
 public:
  /// listen: "ADDRESS:PORT". `snapshot` is called on the server's thread. Throws
  /// Error(Unavailable) where it can't listen there.
  MetricsServer(const std::string& listen, std::function<MetricsSnapshot()> snapshot);
  ~MetricsServer();
  MetricsServer(const MetricsServer&) = delete;
  MetricsServer& operator=(const MetricsServer&) = delete;

  int port() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::service
