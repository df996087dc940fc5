#include "service/metrics.hpp"

#include <fmt/format.h>
#include <microhttpd.h>
#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <limits>
#include <set>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "service/http_connections.hpp"

namespace facet::service {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

/// One family while it is filled.
class Series {
 public:
  Series(const Metric& metric, MetricFamily& family) : metric_(metric), family_(family) {}

  /// label_values  as many as the metric has labels, in their order
  template <typename Number>
  requires std::is_arithmetic_v<Number>
  void add(Number value, std::initializer_list<std::string> label_values = {}) {
    ClientMetric& one = next(label_values);
    (family_.type == MetricType::Counter ? one.counter.value : one.gauge.value) = static_cast<double>(value);
  }

  void add(const pipeline::Histogram& histogram, std::initializer_list<std::string> label_values) {
    ClientMetric::Histogram& out = next(label_values).histogram;
    out.sample_sum = histogram.sum_ms * 1e-3;
    std::uint64_t below = 0;
    for (std::size_t i = 0; i < histogram.counts.size(); ++i) {
      below += histogram.counts[i];
      const bool last = i == pipeline::Histogram::kBounds_ms.size();
      out.bucket.push_back({below, last ? std::numeric_limits<double>::infinity()
                                        : static_cast<double>(pipeline::Histogram::kBounds_ms[i]) * 1e-3});
    }
    out.sample_count = below;
  }

 private:
  ClientMetric& next(std::initializer_list<std::string> label_values) {
    ClientMetric& one = family_.metric.emplace_back();
    const char* const* label = metric_.labels.data();
    for (const std::string& value : label_values) {
      one.label.push_back({*label++, value});
    }
    return one;
  }

  const Metric& metric_;
  MetricFamily& family_;
};

namespace {

/// The names of an enum's values up to the last one.
template <auto Last>
std::vector<std::string> names() {
  std::vector<std::string> all;
  for (std::size_t i = 0; i <= static_cast<std::size_t>(Last); ++i) {
    all.emplace_back(to_string(static_cast<decltype(Last)>(i)));
  }
  return all;
}

std::vector<std::string> daemon_states() {
  std::vector<std::string> all = names<pipeline::PipelineState::Failed>();
  std::rotate(all.begin(), all.begin() + 1, all.end());  // idle comes last
  all.insert(all.begin(), kStatesBeforeThePipeline.begin(), kStatesBeforeThePipeline.end());
  return all;
}

struct NamedCamera {
  std::string name;
  const CameraStatus* status;
};

std::vector<NamedCamera> cameras_of(const MetricsSnapshot& now) {
  const pipeline::PipelineStatus& status = now.pipeline;
  if (!status.rig) {
    return {{status.source.name, &status.camera}};
  }
  std::vector<NamedCamera> cameras;
  cameras.reserve(status.rig->cameras.size());
  for (const pipeline::DeviceCameraStatus& camera : status.rig->cameras) {
    cameras.push_back({camera.name, &camera.status});
  }
  return cameras;
}

using Now = const MetricsSnapshot&;

/// get  gives the value, or adds the series
template <typename Get>
Metric metric(MetricType type, const char* name, const char* help, Metric::Labels labels, Get get) {
  if constexpr (std::is_invocable_v<Get, Now>) {
    return {name, help, type, labels, [get](Now now, Series& out) { out.add(get(now)); }};
  } else {
    return {name, help, type, labels, get};
  }
}
template <typename Get>
Metric gauge(const char* name, const char* help, Get get) {
  return metric(MetricType::Gauge, name, help, {}, get);
}
template <typename Get>
Metric gauge(const char* name, const char* help, Metric::Labels labels, Get get) {
  return metric(MetricType::Gauge, name, help, labels, get);
}
template <typename Get>
Metric counter(const char* name, const char* help, Get get) {
  return metric(MetricType::Counter, name, help, {}, get);
}
template <typename Get>
Metric counter(const char* name, const char* help, Metric::Labels labels, Get get) {
  return metric(MetricType::Counter, name, help, labels, get);
}

/// Adds one series for each camera of the sets.
template <typename Get>
auto each_match(Get get) {
  return [get](Now now, Series& out) {
    for (const capture::CameraMatch& match : now.pipeline.rig->sets.cameras) {
      out.add(get(match), {match.name});
    }
  };
}

std::vector<Metric> of_daemon() {
  return {
      gauge("info", "Version and device of the refinement; always 1.", {"version", "gpu"},
            [](Now now, Series& out) {
              out.add(1.0, {FACET_VERSION, now.pipeline.device});
            }),
      gauge("state", "1 for the daemon's state, else 0.", {"state"},
            [](Now now, Series& out) {
              for (const std::string& state : daemon_states()) {
                out.add(now.state == state, {state});
              }
            }),
      gauge("uptime_seconds", "Since the daemon was started.", [](Now now) { return now.uptime_s; }),
      gauge("resident_bytes", "Memory in use.", [](Now now) { return now.resident_bytes; }),
      gauge("disk_free_bytes", "Free where takes are recorded.", [](Now now) { return now.disk_free_bytes; }),
  };
}

std::vector<Metric> of_frames() {
  return {
      counter("frames_total", "Frames (mode \"frames\": frame sets) by what became of them.", {"outcome"},
              [](Now now, Series& out) {
                out.add(now.pipeline.captured, {"captured"});
                out.add(now.pipeline.dropped, {"dropped"});
                out.add(now.pipeline.processed, {"processed"});
                out.add(now.pipeline.face_frames, {"face"});
                out.add(now.pipeline.mesh_frames, {"mesh"});
                out.add(now.pipeline.refined_frames, {"refined"});
                out.add(now.pipeline.degraded_frames, {"degraded"});
              }),
      gauge("frames_per_second", "Handed out, over the last 128 frames.",
            [](Now now) { return now.pipeline.frames_per_second; }),
      gauge("tracking_state", "1 for the tracker's state with the last frame, else 0.", {"state"},
            [](Now now, Series& out) {
              for (const std::string& state : names<mesh::TrackingState::Lost>()) {
                out.add(to_string(now.pipeline.tracking) == state, {state});
              }
            }),
      metric(MetricType::Histogram, "stage_seconds",
             "Time of a stage per frame; lighting, albedo and displacement are the GPU's. Latency: from the "
             "frame's delivery to the hand-out.",
             {"stage"},
             [](Now now, Series& out) {
               for (std::size_t s = 0; s < pipeline::kStages.size(); ++s) {
                 out.add(now.pipeline.histograms[s], {pipeline::kStages[s].name});
               }
             }),
      gauge("queue_frames", "Frames that wait for a stage.", {"queue"},
            [](Now now, Series& out) {
              out.add(now.pipeline.queued_captured, {"captured"});
              out.add(now.pipeline.queued_tracked, {"tracked"});
            }),
      gauge("photometric_rms", "Mean over the last refined frames; linear light, 0 to 1.",
            [](Now now) { return static_cast<double>(now.pipeline.photometric_rms); }),
  };
}

std::vector<Metric> of_cameras() {
  return {
      gauge("camera_state", "1 for a camera's state, else 0.", {"camera", "state"},
            [](Now now, Series& out) {
              for (const NamedCamera& camera : cameras_of(now)) {
                for (const std::string& state : names<CameraState::Ended>()) {
                  out.add(to_string(camera.status->state) == state, {camera.name, state});
                }
              }
            }),
      counter("camera_frames_total", "Frames of a camera by what became of them (docs/control-protocol.md).",
              {"camera", "outcome"},
              [](Now now, Series& out) {
                for (const NamedCamera& camera : cameras_of(now)) {
                  for (const CameraCount& count : kCameraCounts) {
                    out.add(camera.status->counters.*count.value, {camera.name, count.name});
                  }
                }
              }),
  };
}

std::vector<Metric> of_sets() {
  using Match = const capture::CameraMatch&;
  return {
      counter("sets_total", "Frame sets by what became of them.", {"outcome"},
              [](Now now, Series& out) {
                const capture::CaptureStatistics& sets = now.pipeline.rig->sets;
                out.add(sets.complete, {"complete"});
                out.add(sets.incomplete, {"incomplete"});
                out.add(sets.dropped, {"dropped"});
              }),
      gauge("sets_worst_skew_seconds", "Largest skew between the pictures of a set.",
            [](Now now) { return static_cast<double>(now.pipeline.rig->sets.worst_skew_ns) * 1e-9; }),
      gauge("camera_in_step", "1 while a camera's times and numbers agree with the trigger.", {"camera"},
            each_match([](Match match) { return match.in_step; })),
      counter("camera_refused_total", "Frames that came into no set, by cause.", {"camera", "cause"},
              [](Now now, Series& out) {
                for (Match match : now.pipeline.rig->sets.cameras) {
                  for (std::size_t cause = 0; cause < capture::kRefusals.size(); ++cause) {
                    out.add(match.refused.at(cause), {match.name, capture::kRefusals.at(cause)});
                  }
                }
              }),
      gauge("camera_offset_seconds", "Mean of the time stamp behind the trigger's edge.", {"camera"},
            each_match([](Match match) { return match.offset_ns * 1e-9; })),
      gauge("camera_jitter_seconds", "Standard deviation of the time stamp.", {"camera"},
            each_match([](Match match) { return match.jitter_ns * 1e-9; })),
      gauge("camera_skew_seconds", "Mean of the time stamp to the mean of its set.", {"camera"},
            each_match([](Match match) { return match.skew_ns * 1e-9; })),
  };
}

std::vector<Metric> of_trigger() {
  constexpr auto of = [](Now now) -> const TriggerStatus& { return *now.pipeline.rig->trigger; };
  return {
      gauge("trigger_running", "1 while slots are fired.",
            [=](Now now) { return of(now).state == TriggerState::Running; }),
      gauge("trigger_real_time", "1 where the edges have real-time priority and locked memory.",
            [=](Now now) { return of(now).real_time; }),
      counter("trigger_slots_total", "Slots of the trigger.", {"outcome"},
              [=](Now now, Series& out) {
                out.add(of(now).slots_fired, {"fired"});
                out.add(of(now).slots_dropped, {"dropped"});
              }),
      counter("trigger_edges_total", "Edges of the trigger's lines.", {"outcome"},
              [=](Now now, Series& out) {
                out.add(of(now).edges, {"set"});
                out.add(of(now).edges_late, {"late"});
                out.add(of(now).edges_proven, {"proven"});
                out.add(of(now).edges_missing, {"missing"});
                out.add(of(now).edges_stray, {"stray"});
              }),
      gauge("trigger_worst_late_seconds", "Largest lateness of an edge.",
            [=](Now now) { return static_cast<double>(of(now).worst_late_ns) * 1e-9; }),
  };
}

std::vector<Metric> of_stream() {
  constexpr auto count = [](Now now, bool stream::ReaderStatistics::*by) {
    const auto& readers = now.stream.readers;
    return static_cast<std::uint64_t>(
        std::count_if(readers.begin(), readers.end(), [&](const auto& reader) { return reader.*by; }));
  };
  return {
      gauge("stream_readers", "Readers of the stream.", [](Now now) { return now.stream.readers.size(); }),
      gauge("stream_ring_readers", "Those of them that read through shared memory.",
            [=](Now now) { return count(now, &stream::ReaderStatistics::ring); }),
      gauge("stream_web_readers", "Those of them that read over a WebSocket.",
            [=](Now now) { return count(now, &stream::ReaderStatistics::web); }),
      counter("stream_published_total", "Frames given to the stream.",
              [](Now now) { return now.stream.published; }),
      counter("stream_skipped_total", "Frames that a newer one replaced before any reader could get them.",
              [](Now now) { return now.stream.skipped; }),
      counter("stream_refused_total", "Connections that were refused or broken off.",
              [](Now now) { return now.stream.refused; }),
      counter("stream_reader_dropped_total", "Frames that a reader was too slow for.", {"reader", "client"},
              [](Now now, Series& out) {
                for (const stream::ReaderStatistics& reader : now.stream.readers) {
                  out.add(reader.frames_dropped, {std::to_string(reader.id), reader.client});
                }
              }),
  };
}

std::vector<Metric> of_page() {
  return {
      counter("web_requests_total", "Requests to the page and its WebSockets.",
              [](Now now) { return now.web->requests; }),
      counter("web_refused_total", "Of them refused for host, origin, method, path or token.",
              [](Now now) { return now.web->refused; }),
      counter("web_broken_off_total", "Connections closed for taking too long, or for want of a place.",
              [](Now now) { return now.web->broken_off; }),
      counter("web_wrong_tokens_total", "Of them for the token.",
              [](Now now) { return now.web->wrong_tokens; }),
  };
}

Metric of_recording() {
  return gauge("recording", "1 while a take is recorded.",
               [](Now now) { return now.take && now.take->state == take::RecorderState::Recording; });
}

std::vector<Metric> of_take() {
  return {
      gauge("take_frames", "Frames of the current take that are safe on the disk.",
            [](Now now) { return now.take->frames; }),
      gauge("take_dropped_frames", "Frames that the current take lacks.",
            [](Now now) { return now.take->dropped; }),
      gauge("take_bytes", "Size of the current take's frames.", [](Now now) { return now.take->bytes; }),
      gauge("take_queued_frames", "Frames that wait for the disk.", [](Now now) { return now.take->queued; }),
  };
}

/// What the kernel's thermal zones say, where they can be read.
Metric of_machine() {
  return gauge("temperature_celsius", "Of the machine's thermal zones.", {"zone", "type"},
               [](Now, Series& out) {
                 std::error_code error;
                 for (std::filesystem::directory_iterator zone("/sys/class/thermal", error), end;
                      !error && zone != end; zone.increment(error)) {
                   std::ifstream temperature(zone->path() / "temp");
                   std::ifstream type(zone->path() / "type");
                   double millidegrees = 0;
                   std::string name;
                   if (temperature >> millidegrees && std::getline(type, name)) {
                     out.add(millidegrees * 1e-3, {zone->path().filename().string(), name});
                   }
                 }
               });
}

std::vector<Metric> all_metrics() {
  std::vector<Metric> all;
  const auto add = [&](std::vector<Metric> some, bool (*is_there)(Now) = nullptr) {
    for (Metric& one : some) {
      one.is_there = is_there;
      all.push_back(std::move(one));
    }
  };
  add(of_daemon());
  add(of_frames());
  add(of_cameras());
  add(of_sets(), [](Now now) { return now.pipeline.rig.has_value(); });
  add(of_trigger(), [](Now now) { return now.pipeline.rig && now.pipeline.rig->trigger; });
  add(of_stream());
  add(of_page(), [](Now now) { return now.web.has_value(); });
  add({of_recording()});
  add(of_take(), [](Now now) { return now.take.has_value(); });
  add({of_machine()});
  return all;
}

}  // namespace

const std::vector<Metric>& metrics() {
  static const std::vector<Metric> kAll = all_metrics();
  return kAll;
}

std::string metrics_text(const MetricsSnapshot& now) {
  std::vector<MetricFamily> families;
  for (const Metric& one : metrics()) {
    if (one.is_there == nullptr || one.is_there(now)) {
      MetricFamily& family = families.emplace_back();
      family.name = std::string("facet_") + one.name;
      family.help = one.help;
      family.type = one.type;
      Series series(one, family);
      one.get(now, series);
    }
  }
  return prometheus::TextSerializer().Serialize(families);
}

struct MetricsServer::Impl {
  Impl(const MetricsConfig& config, std::function<MetricsSnapshot()> given,
       const std::vector<std::string>& more_hosts)
      : snapshot(std::move(given)),
        hosts(own_hosts(config.listen, more_hosts)),
        connections(config.max_connections) {}

  std::function<MetricsSnapshot()> snapshot;
  const std::set<std::string> hosts;
  HttpConnections connections;

  /// On the server's one thread.
  MHD_Result answer(MHD_Connection* connection, std::string_view path, std::string_view method) {
    connections.asked(connection);
    if (const std::string why = foreign_host(connection, hosts); !why.empty()) {
      return say(connection, MHD_HTTP_FORBIDDEN, why + "\n");
    }
    if (path != "/metrics") {
      return say(connection, MHD_HTTP_NOT_FOUND, "not here; metrics are at /metrics\n");
    }
    if (method != MHD_HTTP_METHOD_GET && method != MHD_HTTP_METHOD_HEAD) {
      return say(connection, MHD_HTTP_METHOD_NOT_ALLOWED, "metrics can only be read\n");
    }
    return say(connection, MHD_HTTP_OK, metrics_text(snapshot()));
  }

  static MHD_Result say(MHD_Connection* connection, unsigned status, const std::string& body) {
    MHD_Response* response =
        MHD_create_response_from_buffer(body.size(), const_cast<char*>(body.data()),
                                        MHD_RESPMEM_MUST_COPY);  // the library does not write to it
    MHD_add_response_header(response, MHD_HTTP_HEADER_CONTENT_TYPE,
                            "text/plain; version=0.0.4; charset=utf-8");
    const MHD_Result result = MHD_queue_response(connection, status, response);
    MHD_destroy_response(response);
    return result;
  }

  const HttpAnswer on_request = [this](MHD_Connection* connection, const char* path,
                                       std::string_view method) { return answer(connection, path, method); };
  HttpServer server;  ///< ends before what it uses
};

MetricsServer::MetricsServer(const MetricsConfig& config, std::function<MetricsSnapshot()> snapshot,
                             const std::vector<std::string>& hosts)
    : impl_(std::make_unique<Impl>(config, std::move(snapshot), hosts)) {
  impl_->server =
      start_http(config.listen, impl_->connections, impl_->on_request, "metrics.listen", "metrics");
}

MetricsServer::~MetricsServer() = default;

int MetricsServer::port() const {
  return port_of(impl_->server);
}

}  // namespace facet::service
