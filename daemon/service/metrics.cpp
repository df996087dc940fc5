#include "service/metrics.hpp"

#include <fmt/format.h>
#include <microhttpd.h>
#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>
#include <sys/socket.h>

#include <algorithm>
#include <exception>
#include <filesystem>
#include <fstream>
#include <limits>
#include <set>
#include <string_view>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "service/http_connections.hpp"
#include "service/listen_address.hpp"

namespace facet::service {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

using Labels = std::vector<ClientMetric::Label>;

/// Families in the order in which they are begun.
class Families {
 public:
  void begin(const char* name, const char* help, MetricType type) {
    MetricFamily& family = families_.emplace_back();
    family.name = std::string("facet_") + name;
    family.help = help;
    family.type = type;
  }

  void add(double value, Labels labels = {}) {
    ClientMetric& metric = next(std::move(labels));
    (families_.back().type == MetricType::Counter ? metric.counter.value : metric.gauge.value) = value;
  }
  void add(std::uint64_t value, Labels labels = {}) { add(static_cast<double>(value), std::move(labels)); }

  void add(const pipeline::Histogram& histogram, Labels labels) {
    ClientMetric::Histogram& out = next(std::move(labels)).histogram;
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

  void gauge(const char* name, const char* help, double value) {
    begin(name, help, MetricType::Gauge);
    add(value);
  }
  void counter(const char* name, const char* help, std::uint64_t value) {
    begin(name, help, MetricType::Counter);
    add(value);
  }

  std::vector<MetricFamily> take() { return std::move(families_); }

 private:
  ClientMetric& next(Labels labels) {
    ClientMetric& metric = families_.back().metric.emplace_back();
    metric.label = std::move(labels);
    return metric;
  }

  std::vector<MetricFamily> families_;
};

/// One series of a state is 1, the others 0.
template <typename Names>
void add_states(Families& out, const Names& names, const std::string& now, const Labels& labels = {}) {
  for (const char* name : names) {
    Labels with_state = labels;
    with_state.push_back({"state", name});
    out.add(now == name ? 1.0 : 0.0, std::move(with_state));
  }
}

void collect_daemon(Families& out, const MetricsSnapshot& now) {
  out.begin("info", "Version and device of the refinement; always 1.", MetricType::Gauge);
  out.add(1.0, {{"version", FACET_VERSION}, {"gpu", now.pipeline.device}});
  out.begin("state", "1 for the daemon's state, else 0.", MetricType::Gauge);
  constexpr std::array kStates = {
      "starting", "waiting for a reader", "preparing", "running", "ended", "stopped", "failed", "idle"};
  add_states(out, kStates, now.state);
  out.gauge("uptime_seconds", "Since the daemon was started.", now.uptime_s);
  out.gauge("resident_bytes", "Memory in use.", static_cast<double>(now.resident_bytes));
  out.gauge("disk_free_bytes", "Free where takes are recorded.", static_cast<double>(now.disk_free_bytes));
}

void collect_frames(Families& out, const pipeline::PipelineStatus& now) {
  out.begin("frames_total", "Frames (mode \"frames\": frame sets) by what became of them.",
            MetricType::Counter);
  const std::pair<const char*, std::uint64_t> counts[] = {
      {"captured", now.captured},       {"dropped", now.dropped},  {"processed", now.processed},
      {"face", now.face_frames},        {"mesh", now.mesh_frames}, {"refined", now.refined_frames},
      {"degraded", now.degraded_frames}};
  for (const auto& [outcome, count] : counts) {
    out.add(count, {{"outcome", outcome}});
  }
  out.gauge("frames_per_second", "Handed out, over the last 128 frames.", now.frames_per_second);
  out.begin("tracking_state", "1 for the tracker's state with the last frame, else 0.", MetricType::Gauge);
  constexpr std::array kTracking = {mesh::TrackingState::Searching, mesh::TrackingState::Acquiring,
                                    mesh::TrackingState::Tracking, mesh::TrackingState::Lost};
  for (const mesh::TrackingState state : kTracking) {
    out.add(now.tracking == state ? 1.0 : 0.0, {{"state", mesh::to_string(state)}});
  }
  out.begin("stage_seconds",
            "Time of a stage per frame; lighting, albedo and displacement are the GPU's. Latency: from the "
            "frame's delivery to the hand-out.",
            MetricType::Histogram);
  for (std::size_t s = 0; s < pipeline::kStages.size(); ++s) {
    out.add(now.histograms[s], {{"stage", pipeline::kStages[s].name}});
  }
  out.begin("queue_frames", "Frames that wait for a stage.", MetricType::Gauge);
  out.add(std::uint64_t{now.queued_captured}, {{"queue", "captured"}});
  out.add(std::uint64_t{now.queued_tracked}, {{"queue", "tracked"}});
  out.gauge("photometric_rms", "Mean over the last refined frames; linear light, 0 to 1.",
            static_cast<double>(now.photometric_rms));
}

struct NamedCamera {
  std::string name;
  const CameraStatus* status;
};

std::vector<NamedCamera> cameras_of(const pipeline::PipelineStatus& now) {
  if (!now.rig) {
    return {{now.source.name, &now.camera}};
  }
  std::vector<NamedCamera> cameras;
  cameras.reserve(now.rig->cameras.size());
  for (const pipeline::RigCameraStatus& camera : now.rig->cameras) {
    cameras.push_back({camera.name, &camera.status});
  }
  return cameras;
}

void collect_cameras(Families& out, const pipeline::PipelineStatus& now) {
  const std::vector<NamedCamera> cameras = cameras_of(now);
  constexpr std::array kStates = {"idle",    "absent",  "opening", "streaming",
                                  "waiting", "stalled", "failing", "ended"};
  out.begin("camera_state", "1 for a camera's state, else 0.", MetricType::Gauge);
  for (const NamedCamera& camera : cameras) {
    add_states(out, kStates, to_string(camera.status->state), {{"camera", camera.name}});
  }
  out.begin("camera_frames_total", "Frames of a camera by what became of them (docs/control-protocol.md).",
            MetricType::Counter);
  for (const NamedCamera& camera : cameras) {
    for (const CameraCount& count : kCameraCounts) {
      out.add(camera.status->counters.*count.value, {{"camera", camera.name}, {"outcome", count.name}});
    }
  }
}

void collect_sets(Families& out, const capture::CaptureStatistics& sets) {
  out.begin("sets_total", "Frame sets by what became of them.", MetricType::Counter);
  out.add(sets.complete, {{"outcome", "complete"}});
  out.add(sets.incomplete, {{"outcome", "incomplete"}});
  out.add(sets.dropped, {{"outcome", "dropped"}});
  out.gauge("sets_worst_skew_seconds", "Largest skew between the pictures of a set.",
            static_cast<double>(sets.worst_skew_ns) * 1e-9);
  out.begin("camera_in_step", "1 while a camera's times and numbers agree with the trigger.",
            MetricType::Gauge);
  for (const capture::CameraMatch& match : sets.cameras) {
    out.add(match.in_step ? 1.0 : 0.0, {{"camera", match.name}});
  }
  out.begin("camera_refused_total", "Frames that came into no set, by cause.", MetricType::Counter);
  for (const capture::CameraMatch& match : sets.cameras) {
    for (std::size_t cause = 0; cause < capture::kRefusals.size(); ++cause) {
      out.add(match.refused.at(cause), {{"camera", match.name}, {"cause", capture::kRefusals.at(cause)}});
    }
  }
  out.begin("camera_offset_seconds", "Mean of the time stamp behind the trigger's edge.", MetricType::Gauge);
  for (const capture::CameraMatch& match : sets.cameras) {
    out.add(match.offset_ns * 1e-9, {{"camera", match.name}});
  }
  out.begin("camera_jitter_seconds", "Standard deviation of the time stamp.", MetricType::Gauge);
  for (const capture::CameraMatch& match : sets.cameras) {
    out.add(match.jitter_ns * 1e-9, {{"camera", match.name}});
  }
  out.begin("camera_skew_seconds", "Mean of the time stamp to the mean of its set.", MetricType::Gauge);
  for (const capture::CameraMatch& match : sets.cameras) {
    out.add(match.skew_ns * 1e-9, {{"camera", match.name}});
  }
}

void collect_trigger(Families& out, const TriggerStatus& trigger) {
  out.gauge("trigger_running", "1 while slots are fired.",
            trigger.state == TriggerState::Running ? 1.0 : 0.0);
  out.gauge("trigger_real_time", "1 where the edges have real-time priority and locked memory.",
            trigger.real_time ? 1.0 : 0.0);
  out.begin("trigger_slots_total", "Slots of the trigger.", MetricType::Counter);
  out.add(trigger.slots_fired, {{"outcome", "fired"}});
  out.add(trigger.slots_dropped, {{"outcome", "dropped"}});
  out.begin("trigger_edges_total", "Edges of the trigger's lines.", MetricType::Counter);
  const std::pair<const char*, std::uint64_t> counts[] = {{"set", trigger.edges},
                                                          {"late", trigger.edges_late},
                                                          {"proven", trigger.edges_proven},
                                                          {"missing", trigger.edges_missing},
                                                          {"stray", trigger.edges_stray}};
  for (const auto& [outcome, count] : counts) {
    out.add(count, {{"outcome", outcome}});
  }
  out.gauge("trigger_worst_late_seconds", "Largest lateness of an edge.",
            static_cast<double>(trigger.worst_late_ns) * 1e-9);
}

void collect_stream(Families& out, const stream::StreamStatistics& stream) {
  out.gauge("stream_readers", "Readers of the stream.", static_cast<double>(stream.readers.size()));
  out.gauge("stream_ring_readers", "Those of them that read through shared memory.",
            static_cast<double>(std::count_if(stream.readers.begin(), stream.readers.end(),
                                              [](const auto& reader) { return reader.ring; })));
  out.gauge("stream_web_readers", "Those of them that read over a WebSocket.",
            static_cast<double>(std::count_if(stream.readers.begin(), stream.readers.end(),
                                              [](const auto& reader) { return reader.web; })));
  out.counter("stream_published_total", "Frames given to the stream.", stream.published);
  out.counter("stream_skipped_total", "Frames that a newer one replaced before any reader could get them.",
              stream.skipped);
  out.counter("stream_refused_total", "Connections that were refused or broken off.", stream.refused);
  out.begin("stream_reader_dropped_total", "Frames that a reader was too slow for.", MetricType::Counter);
  for (const stream::ReaderStatistics& reader : stream.readers) {
    out.add(reader.frames_dropped, {{"reader", std::to_string(reader.id)}, {"client", reader.client}});
  }
}

void collect_take(Families& out, const std::optional<take::RecorderStatus>& take) {
  const bool recording = take && take->state == take::RecorderState::Recording;
  out.gauge("recording", "1 while a take is recorded.", recording ? 1.0 : 0.0);
  if (take) {
    out.gauge("take_frames", "Frames of the current take that are safe on the disk.",
              static_cast<double>(take->frames));
    out.gauge("take_dropped_frames", "Frames that the current take lacks.",
              static_cast<double>(take->dropped));
    out.gauge("take_bytes", "Size of the current take's frames.", static_cast<double>(take->bytes));
    out.gauge("take_queued_frames", "Frames that wait for the disk.", static_cast<double>(take->queued));
  }
}

/// What the kernel's thermal zones say, where they can be read.
void collect_temperatures(Families& out) {
  out.begin("temperature_celsius", "Of the machine's thermal zones.", MetricType::Gauge);
  std::error_code error;
  for (std::filesystem::directory_iterator zone("/sys/class/thermal", error), end; !error && zone != end;
       zone.increment(error)) {
    std::ifstream temperature(zone->path() / "temp");
    std::ifstream type(zone->path() / "type");
    double millidegrees = 0;
    std::string name;
    if (temperature >> millidegrees && std::getline(type, name)) {
      out.add(millidegrees * 1e-3, {{"zone", zone->path().filename().string()}, {"type", name}});
    }
  }
}

std::string metrics_text(const MetricsSnapshot& now) {
  Families out;
  collect_daemon(out, now);
  collect_frames(out, now.pipeline);
  collect_cameras(out, now.pipeline);
  if (now.pipeline.rig) {
    collect_sets(out, now.pipeline.rig->sets);
    if (now.pipeline.rig->trigger) {
      collect_trigger(out, *now.pipeline.rig->trigger);
    }
  }
  collect_stream(out, now.stream);
  if (now.web) {
    out.counter("web_requests_total", "Requests to the page and its WebSockets.", now.web->requests);
    out.counter("web_refused_total", "Of them refused for host, origin, method, path or token.",
                now.web->refused);
    out.counter("web_broken_off_total", "Connections closed for taking too long, or for want of a place.",
                now.web->broken_off);
    out.counter("web_wrong_tokens_total", "Of them for the token.", now.web->wrong_tokens);
  }
  collect_take(out, now.take);
  collect_temperatures(out);
  return prometheus::TextSerializer().Serialize(out.take());
}

}  // namespace

struct MetricsServer::Impl {
  Impl(const MetricsConfig& config, std::function<MetricsSnapshot()> given,
       const std::vector<std::string>& more_hosts)
      : snapshot(std::move(given)),
        hosts(own_hosts(config.listen, more_hosts)),
        connections(config.max_connections) {}

  std::function<MetricsSnapshot()> snapshot;
  const std::set<std::string> hosts;
  HttpConnections connections;
  MHD_Daemon* daemon = nullptr;

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

  static MHD_Result on_request(void* impl, MHD_Connection* connection, const char* path, const char* method,
                               const char* /*version*/, const char* /*upload*/, std::size_t* /*upload_size*/,
                               void** /*state*/) {
    try {
      return static_cast<Impl*>(impl)->answer(connection, path, method);
    } catch (const std::exception&) {
      return MHD_NO;  // closes the connection
    }
  }
};

MetricsServer::MetricsServer(const MetricsConfig& config, std::function<MetricsSnapshot()> snapshot,
                             const std::vector<std::string>& hosts)
    : impl_(std::make_unique<Impl>(config, std::move(snapshot), hosts)) {
  if (const auto address = resolve_listen(config.listen)) {
    const unsigned ipv6 = address->ai_family == AF_INET6 ? MHD_USE_IPv6 : 0;
    impl_->daemon = MHD_start_daemon(MHD_USE_AUTO_INTERNAL_THREAD | ipv6, 0, nullptr, nullptr,
                                     &Impl::on_request, impl_.get(), MHD_OPTION_SOCK_ADDR, address->ai_addr,
                                     MHD_OPTION_ARRAY, impl_->connections.options(), MHD_OPTION_END);
  }
  if (impl_->daemon == nullptr) {
    throw Error(ErrorKind::Unavailable,
                fmt::format("metrics.listen = \"{}\": can't listen there: is the port in use, or the address "
                            "not one of this machine? metrics.listen = \"\" turns metrics off",
                            config.listen));
  }
}

MetricsServer::~MetricsServer() {
  if (impl_->daemon != nullptr) {
    MHD_stop_daemon(impl_->daemon);
  }
}

int MetricsServer::port() const {
  const MHD_DaemonInfo* info = MHD_get_daemon_info(impl_->daemon, MHD_DAEMON_INFO_BIND_PORT);
  return info != nullptr ? info->port : 0;
}

}  // namespace facet::service
