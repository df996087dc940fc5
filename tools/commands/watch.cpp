// `facet watch`: connects to a running facetd as any consumer does and shows what comes.

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>

#include "daemon_options.hpp"
#include "exports/formats.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "options.hpp"
#include "report/set_pictures.hpp"
#include "stream/client.hpp"
#include "stream/ring_layout.h"
#include "tell.hpp"

namespace facet::tools {
namespace {

using namespace std::chrono_literals;

struct WatchOptions {
  std::shared_ptr<StreamOptions> stream;
  std::uint64_t frames = 0;
  bool json = false;
  std::string save_last;
  std::string save_images;
  double wait_s = 0;
  bool ring = false;
};

/// What the line shows: the last second of frames.
class Window {
 public:
  void add(const mesh::MeshFrame& frame) {
    const auto now = Clock::now();
    entries_.push_back({now, frame.stage_ms});
    while (entries_.front().arrival < now - 1s || entries_.size() > kMaxEntries) {
      entries_.pop_front();
    }
  }

  double rate_hz() const {
    if (entries_.size() < 2) {
      return 0;
    }
    const double span_s =
        std::chrono::duration<double>(entries_.back().arrival - entries_.front().arrival).count();
    return span_s > 0 ? static_cast<double>(entries_.size() - 1) / span_s : 0;
  }

  float mean(float mesh::StageTimes::*stage) const {
    float sum = 0;
    for (const Entry& entry : entries_) {
      sum += entry.stage_ms.*stage;
    }
    return entries_.empty() ? 0 : sum / static_cast<float>(entries_.size());
  }

 private:
  struct Entry {
    Clock::time_point arrival;
    mesh::StageTimes stage_ms;
  };
  static constexpr std::size_t kMaxEntries = 1000;
  std::deque<Entry> entries_;
};

std::string line_text(const mesh::MeshFrame& frame, const Window& window, std::uint64_t dropped) {
  using Times = mesh::StageTimes;
  std::string text =
      fmt::format("frame {}  {:<9}  {:5.1f} fps  latency {:.0f} ms  |", frame.sequence,
                  mesh::to_string(frame.state), window.rate_hz(), window.mean(&Times::latency_ms));
  const std::pair<const char*, float Times::*> stages[] = {
      {"capture", &Times::capture_ms},     {"detect", &Times::detect_ms},
      {"landmarks", &Times::landmarks_ms}, {"fit", &Times::fit_ms},
      {"upload", &Times::upload_ms},       {"lighting", &Times::lighting_ms},
      {"albedo", &Times::albedo_ms},       {"displ", &Times::displacement_ms},
      {"readback", &Times::readback_ms},   {"depth", &Times::depth_ms}};
  for (const auto& [name, stage] : stages) {
    if (const float mean_ms = window.mean(stage); mean_ms > 0) {
      text += fmt::format(" {} {:.1f}", name, mean_ms);
    }
  }
  text += fmt::format(" ms  |  rms {:.3f}  dropped {}", frame.photometric_rms, dropped);
  if (frame.origin != mesh::Origin::Live) {
    text += fmt::format("  not live: a {}", mesh::to_string(frame.origin));
  }
  if (frame.degraded) {
    text += "  degraded: " + frame.degraded_reason;
  }
  return text;
}

/// One line on standard output: redrawn ten times a second on a terminal, printed once a second elsewhere.
class LiveLine {
 public:
  void show(const std::string& text) {
    const auto now = Clock::now();
    if (now < next_) {
      return;
    }
    next_ = now + (terminal_ ? Clock::duration(100ms) : Clock::duration(1s));
    if (terminal_) {
      tell("\r{}\x1b[K", text);
    } else {
      tell("{}\n", text);
    }
    std::fflush(stdout);
    drawn_ = terminal_;
  }
  void finish() {
    if (drawn_) {
      tell("\n");
      drawn_ = false;
    }
  }

 private:
  bool terminal_ = ::isatty(STDOUT_FILENO) != 0;
  bool drawn_ = false;
  Clock::time_point next_;
};

/// Tries again while the daemon is starting.
std::unique_ptr<stream::StreamClient> connect(const WatchOptions& options,
                                              const stream::Subscription& subscription) {
  const std::filesystem::path socket = options.stream->path();
  const auto end = Clock::now() +
                   std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(options.wait_s));
  for (;;) {
    try {
      return std::make_unique<stream::StreamClient>(socket, subscription);
    } catch (const Error& error) {
      if (error.kind() != ErrorKind::Unavailable || Clock::now() >= end) {
        throw;
      }
    }
    std::this_thread::sleep_for(100ms);
  }
}

void save_images(const FrameSet* set, const std::filesystem::path& folder) {
  if (set == nullptr) {
    throw Error(ErrorKind::Unavailable,
                "no frame with pictures came: facetd passes them on in mode \"frames\"");
  }
  const std::size_t written = report::write_set_pictures(*set, folder);
  tell(stderr, "{}: {} pictures of slot {}\n", folder.string(), written, set->slot);
}

void save_mesh(const std::shared_ptr<const mesh::MeshFrame>& frame, const std::filesystem::path& file) {
  if (frame == nullptr) {
    throw Error(ErrorKind::NoFace,
                fmt::format("no frame with a mesh came: '{}' was not written", file.string()));
  }
  exports::ExportMesh mesh;
  exports::build_export_mesh(*frame, exports::MeshLevel::Finest, exports::MeshSpace::Camera, mesh);
  exports::mesh_writer_for(file)(mesh, file, exports::MeshAxes::Upright);
  tell(stderr, "{}: frame {}, {} vertices\n", file.string(), frame->sequence, mesh.vertices_mm.cols());
}

void run_watch(const WatchOptions& options) {
  if (!options.save_last.empty() && exports::mesh_writer_for(options.save_last) == nullptr) {
    throw Error(ErrorKind::Usage,
                fmt::format("--save-last {}: the name must end in .ply, .obj or .glb", options.save_last));
  }
  stream::Subscription subscription;
  subscription.profile =
      options.save_last.empty() ? stream::Profile::Signals : stream::Profile::Displacements;
  subscription.client = "facet watch";
  subscription.want_images = !options.save_images.empty();
  if (options.ring && subscription.want_images) {
    throw Error(ErrorKind::Usage, "--ring and --save-images: pictures come over the socket alone");
  }
  subscription.ring_version = options.ring ? FACET_RING_VERSION : 0;
  const auto client = connect(options, subscription);

  LiveLine line;
  Window window;
  std::shared_ptr<mesh::MeshFrame> last_with_mesh;
  std::shared_ptr<const FrameSet> last_images;
  std::uint64_t received = 0;
  auto last_arrival = Clock::now();
  stream::DecodedFrame got;
  while (options.frames == 0 || received < options.frames) {
    const stream::ReceiveOutcome outcome = client->next(got, 1s);
    if (outcome == stream::ReceiveOutcome::Closed) {
      break;
    }
    if (outcome == stream::ReceiveOutcome::Timeout) {
      if (!options.json) {
        const auto silence = std::chrono::duration_cast<std::chrono::seconds>(Clock::now() - last_arrival);
        line.show(fmt::format("no frame for {} s", silence.count()));
      }
      continue;
    }
    last_arrival = Clock::now();
    if (options.json) {
      std::puts(exports::frame_json(got.frame, static_cast<std::int64_t>(received)).c_str());
      std::fflush(stdout);
    } else {
      window.add(got.frame);
      line.show(line_text(got.frame, window, client->dropped()));
    }
    ++received;
    last_images = got.frame.images != nullptr ? got.frame.images : last_images;
    if (!options.save_last.empty() && mesh::has_mesh(got.frame)) {
      last_with_mesh = std::make_shared<mesh::MeshFrame>(std::move(got.frame));
    }
  }
  line.finish();
  tell(stderr, "{} frames received{}, {} dropped, {:.1f} MB over the socket\n", received,
       client->by_ring() ? " by ring" : "", client->dropped(),
       static_cast<double>(client->bytes_received()) * 1e-6);
  if (!options.save_last.empty()) {
    save_mesh(last_with_mesh, options.save_last);
  }
  if (!options.save_images.empty()) {
    save_images(last_images.get(), options.save_images);
  }
  if (received < options.frames) {
    throw Error(ErrorKind::Unavailable, fmt::format("the stream ended after {} of {} frames: {}", received,
                                                    options.frames, client->closed_reason()));
  }
  if (!client->closed_reason().empty()) {
    tell(stderr, "{}\n", client->closed_reason());
  }
}

}  // namespace

void add_watch_command(Command app) {
  auto options = std::make_shared<WatchOptions>();
  const Command command = app.subcommand("watch", "Show the live stream of a running facetd");
  options->stream = add_stream_options(command, "Stream socket");
  command.option("--frames", options->frames, "Stop after that many frames; 0: when the stream ends")
      .shows_default();
  command.flag("--json", options->json, "One JSON object per frame, as `facet export --format jsonl`");
  command.option("--save-last", options->save_last,
                 "At the end write the newest frame with a mesh to this .ply, .obj or .glb file");
  command.option("--save-images", options->save_images,
                 "At the end write the newest pictures of the cameras into this folder");
  command.flag("--ring", options->ring,
               "Read the frames out of shared memory; over the socket where facetd offers none");
  command.option("--wait", options->wait_s, "Seconds to go on trying while facetd is not there yet")
      .shows_default()
      .range(0.0, 86400.0);
  command.callback([options] { run_watch(*options); });
}

}  // namespace facet::tools
