#pragma once

#include <prometheus/metric_type.h>

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

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

/// MetricsSnapshot::state before there is a pipeline::PipelineState.
inline constexpr std::array kStatesBeforeThePipeline = {"starting", "waiting for a reader"};

class Series;

/// One metric; /metrics and the test of docs/metrics.md walk them.
struct Metric {
  using Labels = std::array<const char*, 2>;  ///< null: none

  const char* name;  ///< behind "facet_"
  const char* help;
  prometheus::MetricType type;
  Labels labels;
  std::function<void(const MetricsSnapshot& now, Series& out)> get;
  bool (*is_there)(const MetricsSnapshot& now) = nullptr;  ///< null: always
};

/// In the order in which they are served.
const std::vector<Metric>& metrics();

/// Prometheus' text format.
std::string metrics_text(const MetricsSnapshot& now);

/// Serves metrics in Prometheus' text format over HTTP, path /metrics (docs/metrics.md lists them). Its one
/// thread asks for a snapshot with every scrape. Destroying it ends the thread.
class MetricsServer {
 public:
  /// `snapshot` is called on the server's thread. hosts: further names under which the metrics may be asked
  /// for, as those of the page. Throws Error(Unavailable) where it can't listen.
  MetricsServer(const MetricsConfig& config, std::function<MetricsSnapshot()> snapshot,
                const std::vector<std::string>& hosts = {});
  ~MetricsServer();
  MetricsServer(const MetricsServer&) = delete;
  MetricsServer& operator=(const MetricsServer&) = delete;

  int port() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::service
