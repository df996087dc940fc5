#include "service/service.hpp"

#include <fmt/format.h>
#include <poll.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstring>
#include <exception>
#include <new>
#include <nlohmann/json.hpp>
#include <optional>
#include <tuple>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "pipeline/bridge_sink.hpp"
#include "pipeline/pipeline.hpp"
#include "pipeline/sets_on_stream.hpp"
#include "pipeline/stream_sink.hpp"
#include "pipeline/take_sink.hpp"
#include "service/control_server.hpp"
#include "service/errands.hpp"
#include "service/memory_reserve.hpp"
#include "service/metrics.hpp"
#include "service/modes.hpp"
#include "service/osc_remote.hpp"
#include "service/person_methods.hpp"
#include "service/pipeline_opener.hpp"
#include "service/recording.hpp"
#include "service/service_manager.hpp"
#include "service/sound_desk.hpp"
#include "service/status_report.hpp"
#include "service/studio_methods.hpp"
#include "service/take_index.hpp"
#include "service/take_methods.hpp"
#include "service/thumbnails.hpp"
#include "service/value_methods.hpp"
#include "service/web_server.hpp"
#include "stream/server.hpp"
#include "studio/studio.hpp"

namespace facet::service {
namespace {

using nlohmann::json;

/// How long the loop sleeps at most: it then looks at the pipeline, the recorder and the stream.
constexpr std::chrono::milliseconds kLoopPeriod{100};
/// The same while a reader is being waited for: until then nothing moves.
constexpr std::chrono::milliseconds kImpatientPeriod{10};
/// How often the service manager is told how the daemon does, where that changes.
constexpr std::chrono::seconds kStatusPeriod{2};
/// How often a page that could not be opened is tried again: its port may be in use, descriptors short.
constexpr std::chrono::seconds kWebPeriod{10};
/// How long a stop waits for threads that a driver or a disk holds; with the stream's farewells it stays
/// below a second.
constexpr std::chrono::milliseconds kStopPatience{600};
/// A stop as a whole, with a take that grows all the time: the service manager's patience is 10 s.
constexpr std::chrono::seconds kLongestStop{8};
/// How long the end of a source waits for a disk that takes nothing of the take: nobody is in a hurry.
constexpr std::chrono::seconds kEndPatience{30};
/// A round of the loop that works for longer is said: it does nothing that should take so long.
constexpr std::chrono::milliseconds kLongRound{100};
constexpr std::chrono::seconds kLongRoundPeriod{10};
/// How often the takes are looked at for whoever asks for the status, and for how long after that.
constexpr std::chrono::seconds kIndexPeriod{2};
constexpr std::chrono::seconds kIndexInterest{5};

sigset_t watched_signals() {
  sigset_t set;
  sigemptyset(&set);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP}) {
    sigaddset(&set, signal);
  }
  return set;
}

stream::FileDescriptor open_signals() {
  const sigset_t set = watched_signals();
  stream::FileDescriptor fd(::signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK));
  if (!fd) {
    throw Error(ErrorKind::Internal, fmt::format("cannot watch signals: {}", std::strerror(errno)));
  }
  return fd;
}

void check_takes_folder(const std::filesystem::path& folder) {
  std::error_code ignored;
  if (!std::filesystem::is_directory(folder, ignored)) {
    throw Error(ErrorKind::Storage,
                fmt::format("takes.folder '{}' is not there: create it", folder.string()));
  }
  if (::access(folder.c_str(), W_OK | X_OK) != 0) {
    throw Error(ErrorKind::Storage,
                fmt::format("takes.folder '{}' can't be written: {}", folder.string(), std::strerror(errno)));
  }
}

/// Of takes.record_at_start: the pipeline starts once it is known.
struct FirstTake {
  Mutex mutex;
  bool begun FACET_GUARDED_BY(mutex) = false;
  std::exception_ptr fault FACET_GUARDED_BY(mutex);
};

stream::StreamServerConfig named(stream::StreamServerConfig config) {
  config.server_name = software_name();
  return config;
}

}  // namespace

void hold_signals() {
  const sigset_t set = watched_signals();
  // A reader that goes away is an error of its write, not of the process.
  std::signal(SIGPIPE, SIG_IGN);
  ::pthread_sigmask(SIG_BLOCK, &set, nullptr);
}

const char* software_name() {
  return "facetd " FACET_VERSION;
}

struct Service::Impl {
  Impl(const Config& given, Log& given_log);

  Config config;
  Log& log;
  ServiceManager manager;
  PassedSockets passed = take_passed_sockets();
  Clock::time_point started = Clock::now();
  Clock::time_point told;  ///< the service manager, how the daemon does
  stream::FileDescriptor signals;
  std::optional<stream::StreamServer> stream;
  std::optional<ControlServer> control;
  avatar::Bridge bridge;
  pipeline::StreamSink stream_sink;
  studio::Studio studio;
  Thumbnails thumbnails;
  pipeline::BridgeSink bridge_sink;
  pipeline::TakeSink takes;
  pipeline::SetsOnStream sets_shown{{&stream_sink, &takes}};
  pipeline::SetsOnStream sets_recorded{{&takes}};
  TakeIndex index;
  SoundDesk sound;
  Recording recording;
  OscRemote osc;
  TakeDesk desk;
  std::atomic<bool> looking_ends{false};  ///< tells an errand of `looking` that takes long
  Errands looking{"facet-look"};          ///< what looking methods leave: files, and what is much to compute
  std::optional<PipelineOpener> opener;
  std::unique_ptr<pipeline::Pipeline> pipeline;
  std::string source_name;
  bool live = false;                     ///< the source goes on while nobody reads
  std::optional<MetricsServer> metrics;  ///< once there is a pipeline; closed before it is freed
  mutable Mutex web_mutex;               ///< held for a pointer's copy
  std::shared_ptr<WebServer> web FACET_GUARDED_BY(web_mutex);  ///< where it could be opened
  std::atomic<bool> web_opens{false};                          ///< `looking` tries
  std::string web_fault;                                       ///< why it could not, as told
  Clock::time_point web_tried;
  std::string metrics_fault;      ///< why there are none, as told
  Clock::time_point metrics_due;  ///< next attempt
  std::uint64_t wrong_tokens_told = 0;
  Clock::time_point status_asked;        ///< last
  Clock::time_point index_looked;        ///< that `looking` was asked to look at the takes
  std::atomic<bool> index_looks{false};  ///< `looking` has been asked, and is not through
  std::chrono::nanoseconds longest_round{0};
  std::uint64_t long_rounds = 0;
  Clock::time_point long_round_told;
  std::optional<FirstTake> first_take;
  std::atomic<bool> running{false};  ///< the pipeline was started
  bool stopping = false;             ///< somebody asked for the end
  std::string end_reason;            ///< of the daemon, for the take that it cuts short
  bool end_seen = false;             ///< the pipeline's end was logged
  std::optional<int> exit_status;    ///< set: leave the loop
  std::atomic<bool> servers_closed{false};
  std::jthread closing;  ///< of the page's and the metrics' server

  ControlMethods methods();
  json status();
  std::string state(const pipeline::PipelineStatus& now) const;
  void look_after_metrics();
  void open_web();
  std::shared_ptr<WebServer> opened_web() const;
  void look_after_web();
  MetricsSnapshot metrics_snapshot();
  ControlAnswer record_start(const json& params);
  void show(std::shared_ptr<const mesh::MeshFrame> frame);
  /// Says where a target gets nothing because of the mode.
  void warn_of_silence(const avatar::BridgeTarget& target);

  void wait_for_events();
  void read_signals();
  void begin_pipeline();
  void start_when_awaited();
  take::TakeRecorderConfig take_config() const;
  void begin_first_take();
  bool first_take_begun();
  void tell_manager();
  void look_after();
  void look_after_index();
  void time_round(Clock::time_point began);
  void look_after_pipeline();
  void finish();
  void close_servers();
  bool wait_for_threads();
};

Service::Impl::Impl(const Config& given, Log& given_log)
    : config(given),
      log(given_log),
      manager(given_log),
      signals(open_signals()),
      stream(std::in_place, named(given.stream), std::move(passed.stream)),
      bridge(given.bridges),
      stream_sink(*stream),
      studio(
          given.takes.folder, [this](const std::shared_ptr<const mesh::MeshFrame>& frame) { show(frame); },
          [this](bool held) {
            stream_sink.hold(held);
            bridge_sink.hold(held);
          },
          software_name()),
      thumbnails(given.takes.folder),
      bridge_sink(bridge),
      index(given.takes.folder, thumbnails),
      sound(given.sound, given_log),
      recording(takes, sound, index, given_log),
      osc(given.osc,
          {recording, given.takes.folder,
           [this] { return pipeline ? std::optional(take_config()) : std::nullopt; },
           [this] { return sound.timecode_now(); }},
          given_log),
      desk({given.takes.folder, given.takes.disk_reserve_bytes, software_name(),
            [this] {
              const auto take = takes.status();
              return take ? take->file.stem().string() : std::string();
            },
            [this] {
              const studio::StudioStatus now = studio.status();
              return now.state == studio::StudioState::Closed ? std::string() : now.take;
            }},
           index, given_log) {
  check_takes_folder(config.takes.folder);
  control.emplace(config.control, methods(), std::move(passed.control));
}

ControlMethods Service::Impl::methods() {
  ControlMethods all = {
      {"status", {false, {}, [this](const json&) { return status(); }}},
      {"record.start",
       {true,
        {{"name", ControlParam::Type::Text}},
        [this](const json& params) { return record_start(params); }}},
      {"record.stop",
       {true,
        {},
        [this](const json&) {
          return ControlAnswer(recording.errands(), [this] { return to_text(to_json(recording.stop())); });
        }}},
      {"takes.list",
       {false, {}, [this](const json&) { return ControlAnswer(looking, [this] { return index.list(); }); }}},
      {"neutral.record",
       {true,
        {{"seconds", ControlParam::Type::Number}},
        [this](const json& params) {
          const double seconds = params.value("seconds", 1.0);
          if (!(seconds >= 0.1 && seconds <= 60)) {
            throw Error(ErrorKind::Usage, "seconds must be from 0.1 to 60");
          }
          if (studio.status().state != studio::StudioState::Closed) {
            throw Error(ErrorKind::Usage,
                        "the studio shows a take: the neutral pose is the live face's (studio.close)");
          }
          bridge.record_neutral(std::chrono::milliseconds(std::lround(1000 * seconds)));
          return json::object();
        }}},
      {"neutral.clear",
       {true,
        {},
        [this](const json&) {
          bridge.clear_neutral();
          log.info("the neutral pose is forgotten");
          return json::object();
        }}},
      {"identity.reset",
       {true,
        {},
        [this](const json&) {
          if (!pipeline) {
            throw Error(ErrorKind::Unavailable, "facetd is still starting; try again");
          }
          pipeline->reset_identity();
          log.info("identity is estimated anew, as asked over the control socket");
          return json::object();
        }}},
      {"shutdown",
       {true,
        {},
        [this](const json&) {
          log.info("shutdown asked over the control socket");
          stopping = true;
          end_reason = "facetd was shut down over the control socket";
          return json::object();
        }}},
  };
  all.merge(studio_methods(studio, looking));
  all.merge(desk.methods());
  all.merge(value_methods(bridge, config.bridges, recording.errands()));
  all.merge(person_methods([this] { return pipeline ? pipeline->status() : pipeline::PipelineStatus(); },
                           [this] {
                             if (pipeline) {
                               pipeline->burst();
                             }
                           },
                           config.pipeline.persons_folder, recording.errands(), log));
  return all;
}

json Service::Impl::status() {
  const pipeline::PipelineStatus now = pipeline ? pipeline->status() : pipeline::PipelineStatus();
  json answer = to_json(now);
  answer["version"] = FACET_VERSION;
  answer["mode"] = kModes.at(static_cast<std::size_t>(config.mode));
  answer["pid"] = ::getpid();
  answer["uptime_s"] = std::chrono::duration<double>(Clock::now() - started).count();
  answer["resident_bytes"] = resident_bytes();
  answer["state"] = state(now);
  answer["stream"] = to_json(stream->statistics());
  answer["stream"]["socket"] = config.stream.socket.string();
  const auto page = opened_web();
  answer["web"] = page ? to_json(page->statistics()) : json(nullptr);
  if (page) {
    answer["web"]["url"] = page->url();
  }
  answer["bridges"] = to_json(bridge.status());
  const studio::StudioStatus on_show = studio.status();
  answer["studio"] = on_show.state == studio::StudioState::Closed && on_show.reason.empty()
                         ? json(nullptr)
                         : to_json(on_show);
  const auto take = recording.status();
  answer["recording"] = take ? to_json(*take) : json(nullptr);
  answer["sound"] = sound.status();
  answer["takes"] = {
      {"folder", config.takes.folder.string()}, {"list", index.number()}, {"trim", desk.trim_status()}};
  answer["loop"] = {{"longest_ms", std::chrono::duration<double, std::milli>(longest_round).count()},
                    {"long_rounds", long_rounds}};
  status_asked = Clock::now();
  return answer;
}

std::string Service::Impl::state(const pipeline::PipelineStatus& now) const {
  const auto& [starting, waiting] = kStatesBeforeThePipeline;
  return !pipeline ? starting : !running ? waiting : pipeline::to_string(now.state);
}

/// On a thread of the metrics server, which lives no longer than the pipeline.
MetricsSnapshot Service::Impl::metrics_snapshot() {
  MetricsSnapshot now;
  now.pipeline = pipeline->status();
  now.state = state(now.pipeline);
  now.uptime_s = std::chrono::duration<double>(Clock::now() - started).count();
  now.resident_bytes = resident_bytes();
  std::error_code ignored;
  now.disk_free_bytes = std::filesystem::space(config.takes.folder, ignored).available;
  now.stream = stream->statistics();
  now.take = takes.status();
  if (const auto page = opened_web()) {
    now.web = page->statistics();
  }
  return now;
}

void Service::Impl::open_web() {
  if (config.web.listen.empty()) {
    return;
  }
  try {
    const auto find = [this](const std::string& name) -> std::optional<TakeFiles> {
      const auto take = takes.status();
      if (take && take->file.stem() == name) {
        return TakeFiles{take->file, {}, "it is being recorded"};
      }
      return find_take(config.takes.folder, name);
    };
    const auto opened = std::make_shared<WebServer>(config.web, config.takes.folder, find, *stream, *control);
    log.info(fmt::format("page on {}{}", opened->url(),
                         opened->has_page() ? "" : ": its files are not there, only its WebSockets"));
    if (config.web.is_public) {
      log.warning("web.public: whoever reaches the page's address sees the faces and can load the takes");
    }
    if (!opened->token_fault().empty()) {
      log.warning(opened->token_fault());
    }
    const Lock lock(web_mutex);
    if (!looking_ends) {
      web = opened;
    }
  } catch (const Error& error) {
    if (web_fault != error.what()) {
      log.warning(error.what());
    }
    web_fault = error.what();
  }
}

std::shared_ptr<WebServer> Service::Impl::opened_web() const {
  const Lock lock(web_mutex);
  return web;
}

void Service::Impl::look_after_web() {
  const auto page = opened_web();
  if (page) {
    page->look_after();
  } else if (!config.web.listen.empty() && Clock::now() - web_tried >= kWebPeriod &&
             !web_opens.exchange(true)) {
    web_tried = Clock::now();
    looking.ask([this] {
      open_web();
      web_opens = false;
    });
  }
  const std::uint64_t wrong = page ? page->statistics().wrong_tokens : 0;
  if (wrong != wrong_tokens_told && Clock::now() - told >= kStatusPeriod) {
    log.warning(fmt::format("{} wrong tokens were shown to {}", wrong - wrong_tokens_told, page->url()),
                {{"FACET_EVENT", "wrong-token"}});
    wrong_tokens_told = wrong;
  }
}

/// Tried again while another has the port.
void Service::Impl::look_after_metrics() {
  const auto now = Clock::now();
  if (config.metrics.listen.empty() || !pipeline || metrics || now < metrics_due) {
    return;
  }
  metrics_due = now + kWebPeriod;
  try {
    metrics.emplace(
        config.metrics, [this] { return metrics_snapshot(); }, config.web.hosts);
    log.info(fmt::format("metrics on http://{}:{}/metrics",
                         config.metrics.listen.substr(0, config.metrics.listen.rfind(':')), metrics->port()));
  } catch (const Error& error) {
    if (metrics_fault != error.what()) {
      log.warning(error.what());
    }
    metrics_fault = error.what();
  }
}

void Service::Impl::warn_of_silence(const avatar::BridgeTarget& target) {
  const char* protocol = avatar::to_string(target.protocol);
  if (config.mode == Mode::Frames) {
    log.warning(
        fmt::format("bridges: mode \"frames\" finds no face, so that {} at {} gets no expression and no "
                    "head; take it out "
                    "or choose another mode",
                    protocol, target.text()));
  } else if (config.mode == Mode::Booth && target.protocol != avatar::BridgeProtocol::Vmc) {
    log.warning(fmt::format(
        "bridges: a booth's meshes have no expressions, so that {} at {} gets nothing; VMC gets the head",
        protocol, target.text()));
  }
}

/// What the studio shows in the live face's place.
void Service::Impl::show(std::shared_ptr<const mesh::MeshFrame> frame) {
  if (bridge.changes_values() || !frame->avatar_values.empty()) {
    const auto completed = std::make_shared<mesh::MeshFrame>(*frame);
    bridge.complete(*completed);
    frame = completed;
  }
  bridge.publish(frame);
  stream->publish(std::move(frame));
}

ControlAnswer Service::Impl::record_start(const json& params) {
  if (!pipeline) {
    throw Error(ErrorKind::Unavailable, "facetd is still starting; try again");
  }
  return {recording.errands(), [this, take = take_config(), name = params.value("name", "")]() mutable {
            const std::filesystem::path& folder = config.takes.folder;
            take.file =
                take::take_path(folder, name.empty() ? take::default_take_name(folder, Clock::utc()) : name);
            recording.begin(take);
            return to_text({{"file", take.file.string()}});
          }};
}

/// Of a take that begins now, but for its file.
take::TakeRecorderConfig Service::Impl::take_config() const {
  take::TakeRecorderConfig take;
  take.source = source_name;
  take.software = software_name();
  take.when_full = live ? take::WhenFull::Drop : take::WhenFull::Wait;
  // A recorded source is its own picture: the take names it.
  const bool of_one_camera = config.mode == Mode::Monocular && live && config.takes.pictures;
  take.with_images = of_one_camera || config.mode == Mode::Frames ||
                     (config.mode == Mode::Booth && config.booth_record == BoothRecord::Pictures);
  take.picture_coding = of_one_camera ? take::PictureCoding::Jpeg : take::PictureCoding::Lossless;
  take.disk_reserve_bytes = config.takes.disk_reserve_bytes;
  take.compression_level = config.takes.compression_level;
  return take;
}

void Service::Impl::begin_first_take() {
  first_take.emplace();
  recording.errands().ask([this, take = take_config()]() mutable {
    std::exception_ptr fault;
    try {
      // A daemon that is started again must not stumble over its own earlier take.
      const std::filesystem::path& folder = config.takes.folder;
      take.file = take::take_path(folder, take::free_take_name(folder, config.takes.record_at_start));
      recording.begin(take);
    } catch (const std::exception&) {
      fault = std::current_exception();
    }
    const Lock lock(first_take->mutex);
    first_take->begun = true;
    first_take->fault = fault;
  });
}

/// Throws what kept it from beginning. True where none is to begin.
bool Service::Impl::first_take_begun() {
  if (!first_take) {
    return true;
  }
  const Lock lock(first_take->mutex);
  if (first_take->fault != nullptr) {
    std::rethrow_exception(std::exchange(first_take->fault, nullptr));
  }
  return first_take->begun;
}

void Service::Impl::wait_for_events() {
  std::array<pollfd, 4> fds{{{signals.get(), POLLIN, 0},
                             {control->fd(), POLLIN, 0},
                             {opener ? opener->fd() : -1, POLLIN, 0},
                             {osc.fd(), POLLIN, 0}}};
  auto period = pipeline && !running ? kImpatientPeriod : kLoopPeriod;
  if (const auto due = control->due()) {
    period = std::clamp(std::chrono::ceil<std::chrono::milliseconds>(*due - Clock::now()),
                        std::chrono::milliseconds(0), period);
  }
  if (::poll(fds.data(), fds.size(), static_cast<int>(period.count())) < 0 && errno != EINTR) {
    throw Error(ErrorKind::Internal, fmt::format("poll: {}", std::strerror(errno)));
  }
}

void Service::Impl::read_signals() {
  signalfd_siginfo info{};
  while (::read(signals.get(), &info, sizeof(info)) == sizeof(info)) {
    if (info.ssi_signo == SIGHUP) {
      log.warning(
          "SIGHUP is ignored: the configuration is read at the start alone (systemctl restart facetd)");
      continue;
    }
    log.info(fmt::format("stopping on signal {}", info.ssi_signo));
    stopping = true;
    end_reason = fmt::format("facetd was stopped by signal {}", info.ssi_signo);
  }
}

void Service::Impl::begin_pipeline() {
  const OpenedPipeline opened = opener->take();
  source_name = opened.source_name;
  live = opened.live;
  for (const Messages::Message& line : opened.lines) {
    line.warning ? log.warning(line.text) : log.info(line.text);
  }
  pipeline = opened.make({stream_sink, bridge_sink, takes, sets_shown, sets_recorded});
  opener.reset();
  if (!config.takes.record_at_start.empty()) {
    begin_first_take();
  }
  if (config.wait_for_reader) {
    log.info("waiting for a reader of the stream");
  }
  manager.ready();
  looking.ask([this] { index.close_broken_off(log, [this] { return !looking_ends; }); });
}

void Service::Impl::start_when_awaited() {
  if (!first_take_begun()) {
    return;
  }
  if (config.wait_for_reader) {
    const auto readers = stream->statistics().readers;
    if (std::none_of(readers.begin(), readers.end(), [](const auto& reader) { return reader.subscribed; })) {
      return;
    }
  }
  pipeline->start();
  running = true;
  log.info("running", {{"FACET_EVENT", "running"}, {"FACET_SOURCE", source_name}});
}

/// Whoever watches the status hears of takes that come and go by other hands.
void Service::Impl::look_after_index() {
  const auto now = Clock::now();
  if (now - status_asked < kIndexInterest &&
      now - index_looked >= (index.stale() ? kLoopPeriod : kIndexPeriod)) {
    if (index_looks.exchange(true)) {
      return;
    }
    index_looked = now;
    looking.ask([this] {
      try {
        index.look();
      } catch (const Error&) {
        // Whoever asks for the list is told.
      }
      index_looks = false;
    });
  }
}

void Service::Impl::time_round(Clock::time_point began) {
  const auto now = Clock::now();
  longest_round = std::max<std::chrono::nanoseconds>(longest_round, now - began);
  if (now - began < kLongRound) {
    return;
  }
  ++long_rounds;
  if (now - long_round_told >= kLongRoundPeriod) {
    long_round_told = now;
    log.warning(fmt::format("a round of the daemon's loop took {} ms ({} took over {} ms so far)",
                            std::chrono::duration_cast<std::chrono::milliseconds>(now - began).count(),
                            long_rounds, kLongRound.count()),
                {{"FACET_EVENT", "long-round"}});
  }
}

void Service::Impl::look_after_pipeline() {
  for (const Messages::Message& message : pipeline->take_messages()) {
    const Log::Fields fields = {{"FACET_EVENT", "pipeline"}, {"FACET_SOURCE", source_name}};
    if (message.warning) {
      log.warning(message.text, fields);
    } else {
      log.info(message.text, fields);
    }
  }
  const pipeline::PipelineStatus now = pipeline->status();
  const bool failed = now.state == pipeline::PipelineState::Failed;
  if (end_seen || (!failed && now.state != pipeline::PipelineState::Ended)) {
    return;
  }
  end_seen = true;
  if (failed) {
    log.error(now.reason, {{"FACET_EVENT", "failed"}, {"FACET_SOURCE", source_name}});
  }
  const bool cut_short = !failed && !now.reason.empty();
  recording.end(failed      ? now.reason
                : cut_short ? "the source ended early: " + now.reason
                            : "the source is at its end");
  log.info(fmt::format("{}: {} frames, {} with a mesh, {} refined, {} dropped",
                       failed      ? "until then"
                       : cut_short ? "the source ended early"
                                   : "the source is at its end",
                       now.processed, now.mesh_frames, now.refined_frames, now.dropped));
  // A source that is gone leaves takes and status to be asked for; a fault of ours is for whoever supervises
  // the process.
  const bool source_failed = failed && now.failure_kind == ErrorKind::UnreadableInput;
  if (config.exit_at_end || (failed && !source_failed)) {
    exit_status = failed      ? static_cast<int>(now.failure_kind)
                  : cut_short ? static_cast<int>(ErrorKind::UnreadableInput)
                              : 0;
  }
}

/// How the daemon does, in a line.
void Service::Impl::tell_manager() {
  if (Clock::now() - told < kStatusPeriod) {
    return;
  }
  told = Clock::now();
  if (!pipeline) {
    manager.status("opening source, model and GPU");
    return;
  }
  if (!running) {
    manager.status("waiting for a reader of the stream");
    return;
  }
  const pipeline::PipelineStatus now = pipeline->status();
  std::string text = pipeline::to_string(now.state);
  if (now.rig) {
    text += fmt::format(": {}{:.1f} sets/s, {} of {} incomplete",
                        config.mode == Mode::Frames ? "" : fmt::format("{}, ", mesh::to_string(now.tracking)),
                        now.frames_per_second, now.rig->sets.incomplete, now.processed);
    for (const pipeline::DeviceCameraStatus& camera : now.rig->cameras) {
      if (!camera.status.reason.empty()) {
        text += fmt::format("; camera {}: {}", camera.name, camera.status.reason);
      }
    }
    if (now.rig->trigger && !now.rig->trigger->reason.empty()) {
      text += fmt::format("; trigger: {}", now.rig->trigger->reason);
    }
  } else if (now.state == pipeline::PipelineState::Running) {
    text += fmt::format(": source {}, {}, {:.1f} frames/s", to_string(now.camera.state),
                        mesh::to_string(now.tracking), now.frames_per_second);
  }
  for (const std::string& reason : {now.reason, now.camera.reason}) {
    text += reason.empty() ? "" : "; " + reason;
  }
  if (const auto take = takes.status()) {
    text += fmt::format("; recording {}", take->file.stem().string());
  }
  manager.status(text);
}

void Service::Impl::look_after() {
  if (MemoryReserve::refill() > 0) {
    log.warning("memory ran out for a moment", {{"FACET_EVENT", "memory"}});
  }
  if (const std::string failure = stream->statistics().failure; !failure.empty()) {
    throw Error(ErrorKind::Internal, failure);
  }
  recording.look_after();
  sound.look_after();
  osc.look_after();
  desk.look_after();
  look_after_index();
  if (opener && opener->done()) {
    begin_pipeline();
  }
  if (pipeline && !running) {
    start_when_awaited();
  }
  if (running) {
    look_after_pipeline();
  }
  look_after_web();
  look_after_metrics();
  tell_manager();
  manager.look_after(running ? pipeline->longest_silence() : std::nullopt);
  if (stopping && !exit_status) {
    exit_status = 0;
  }
}

/// Phase one: everybody is told. Phase two: takes are closed, sockets removed, threads joined.
void Service::Impl::finish() {
  if (stopping) {
    manager.stopping();  // from now on the service manager counts the seconds
  }
  if (pipeline) {
    pipeline->request_stop();
  }
  recording.request_stop(end_reason);
  sound.request_stop();
  looking_ends = true;
  looking.request_stop();
  desk.request_stop();
  studio.request_stop();
  thumbnails.request_stop();
  stream->request_stop();
  bridge.request_stop();
  try {
    closing = std::jthread([this] {
      ::pthread_setname_np(::pthread_self(), "facet-close");
      close_servers();
    });
  } catch (const std::exception&) {
    close_servers();  // there is no thread to be had
  }
  stream->stop();
  bridge.stop();
  const bool all_ended = wait_for_threads();
  manager.stopping();
  try {
    control->serve();  // what was answered meanwhile
  } catch (const std::exception&) {
    // Nobody hears it then.
  }
  if (servers_closed) {
    control.reset();
  } else {
    control->close_door();  // the page's server may still hand it a client
  }
  if (recording.finished()) {
    recording.finish();
  } else if (const auto take = recording.status()) {
    const std::string text = fmt::format("take {}: {} frames", take->file.string(), take->frames);
    if (take->marked) {
      log.info(text + "; a slow disk leaves a part of it in the -wal file beside it until the next start",
               {{"FACET_EVENT", "take-ended"}, {"FACET_TAKE", take->file.string()}});
    } else {
      log.error(
          text + "; the disk does not take what came after them in time; it is closed at the next start",
          {{"FACET_EVENT", "take-failed"}, {"FACET_TAKE", take->file.string()}});
    }
  }
  if (!all_ended) {
    log.warning("a thread is still at work: leaving without it");
    ::_exit(exit_status.value_or(0));
  }
  looking.stop();
  desk.stop();
  studio.stop();
  thumbnails.stop();
  sound.stop();
  log.info("stopped");
}

/// On `facet-close`, or where there is no such thread: waits for the requests that the servers answer, which
/// may wait for a disk.
void Service::Impl::close_servers() {
  std::shared_ptr<WebServer> page;
  {
    const Lock lock(web_mutex);
    page.swap(web);
  }
  page.reset();
  metrics.reset();
  servers_closed = true;
}

/// False where one does not end. A take that grows is waited for, and a stop that is asked for meanwhile
/// heard.
bool Service::Impl::wait_for_threads() {
  const auto began = Clock::now();
  auto grown = began;
  std::tuple<std::uint64_t, std::size_t, bool> done;
  while (true) {
    const auto now = Clock::now();
    read_signals();
    if (!stopping) {
      manager.look_after(std::nullopt);
    }
    recording.end(end_reason);  // also one that was just about to begin
    const auto take = takes.status();
    const auto so_far = take ? std::tuple(take->frames, take->queued, take->marked) : done;
    if (so_far != done) {
      done = so_far;
      grown = now;
    }
    const bool recorded = recording.finished();
    const bool others = (!opener || opener->done()) && (!pipeline || pipeline->finished()) &&
                        studio.finished() && thumbnails.finished() && looking.finished() && desk.finished() &&
                        bridge.finished() && servers_closed;
    if (recorded && others) {
      return true;
    }
    const bool in_vain =
        now - grown >= (stopping ? Clock::duration(kStopPatience) : Clock::duration(kEndPatience)) ||
        (stopping && now - began >= kLongestStop);
    if ((recorded || in_vain) && (others || now - began >= kStopPatience)) {
      return false;
    }
    ::usleep(2000);
  }
}

Service::Service(const Config& config, Log& log) : impl_(std::make_unique<Impl>(config, log)) {}

Service::~Service() = default;

int Service::run() {
  Impl& impl = *impl_;
  try {
    impl.stream->start();
    impl.log.info(fmt::format("{}: stream on {}, control on {}", software_name(),
                              impl.config.stream.socket.string(), impl.config.control.socket.string()),
                  {{"FACET_EVENT", "started"}, {"FACET_VERSION", FACET_VERSION}});
    impl.recording.start();
    impl.sound.start();
    impl.looking.start();
    impl.desk.start();
    impl.studio.start();
    impl.thumbnails.start();
    impl.open_web();
    impl.bridge.start();
    const avatar::BridgeStatus bridges = impl.bridge.status();
    for (const std::string& fault : {bridges.neutral_reason, bridges.tokens_reason}) {
      if (!fault.empty()) {
        impl.log.warning(fault);
      }
    }
    if (const auto& file = impl.config.bridges.mapping_file;
        !file.empty() && ::access(file.c_str(), F_OK) < 0) {
      impl.log.warning(fmt::format(
          "bridges.mapping: {} is not there; nothing is mapped until something is saved", file.string()));
    }
    for (const avatar::BridgeTarget& target : impl.config.bridges.targets) {
      impl.log.info(fmt::format("bridge: {} to {}", avatar::to_string(target.protocol), target.text()));
      impl.warn_of_silence(target);
    }
    impl.opener.emplace(impl.config);
    while (!impl.exit_status) {
      impl.wait_for_events();
      const auto began = Clock::now();
      impl.read_signals();
      impl.control->serve();
      impl.osc.serve();
      impl.look_after();
      impl.time_round(began);
    }
  } catch (const std::exception& error) {
    // Whatever it was, the take is closed and everybody is told.
    const auto* known = dynamic_cast<const Error*>(&error);
    impl.exit_status = static_cast<int>(known != nullptr ? known->kind() : ErrorKind::Internal);
    try {
      impl.end_reason = error.what();
      impl.log.error(known != nullptr ? error.what() : fmt::format("internal fault: {}", error.what()),
                     {{"FACET_EVENT", "failed"}});
      impl.manager.status(error.what());
    } catch (const std::bad_alloc&) {
      // The exit status tells it.
    }
  }
  impl.finish();
  return *impl.exit_status;
}

}  // namespace facet::service
