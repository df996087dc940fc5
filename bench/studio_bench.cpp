// Puppeteering: how fast the studio puts poses on the stream, and how long one takes from the command to a
// reader's hands. Commands and results stand in results/animation.md.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "facet/error.hpp"
#include "stream/client.hpp"
#include "stream/server.hpp"
#include "studio/studio.hpp"

namespace {

using namespace facet;

double processor_s() {
  timespec now{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

void await(studio::Studio& studio, studio::StudioState state) {
  while (studio.status().state != state) {
    if (!studio.status().reason.empty()) {
      throw Error(ErrorKind::UnreadableInput, studio.status().reason);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

/// A face moves its lip and brows, as a hand would.
std::vector<animate::KeyControl> controls_at(double time_s) {
  const auto swing = [&](double period_s) {
    return static_cast<float>(0.5 - 0.5 * std::cos(2 * 3.14159265 * time_s / period_s));
  };
  using How = animate::KeyControl::How;
  return {{"lip-lower", How::Move, {0, -6 * swing(1.3), 0}},
          {"mouth-left", How::Move, {2 * swing(2.1), 1.5F * swing(2.1), 0}},
          {"brow-left", How::Move, {0, 3 * swing(1.7), 0}}};
}

/// A reader of the stream, on a thread of its own.
class StreamReader {
 public:
  explicit StreamReader(const std::filesystem::path& socket) : thread_([this, socket] { read(socket); }) {}

  void stop() {
    done_ = true;
    thread_.join();
    std::sort(to_reader_ms_.begin(), to_reader_ms_.end());
  }
  /// From the command to here; once stopped.
  double quantile_ms(double part) const {
    return to_reader_ms_.empty() ? 0.0
                                 : to_reader_ms_[static_cast<std::size_t>(
                                       part * static_cast<double>(to_reader_ms_.size() - 1))];
  }

  std::atomic<int> received{0};        ///< frames
  std::atomic<double> processor_s{0};  ///< once stopped

 private:
  void read(const std::filesystem::path& socket) {
    stream::Subscription subscription;
    subscription.profile = stream::Profile::Displacements;
    stream::StreamClient client(socket, subscription);
    stream::DecodedFrame got;
    while (!done_) {
      if (client.next(got, std::chrono::milliseconds(200)) == stream::ReceiveOutcome::Received) {
        // From the command: the frame carries when it was handed out and how long it took until then.
        const double now_ms =
            std::chrono::duration<double, std::milli>(Clock::now().time_since_epoch()).count();
        if (got.frame.stage_ms.latency_ms > 0) {
          to_reader_ms_.push_back(now_ms - static_cast<double>(got.frame.timestamp_ns) * 1e-6 +
                                  static_cast<double>(got.frame.stage_ms.latency_ms));
        }
        ++received;
      }
    }
    timespec used{};
    ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &used);
    processor_s = static_cast<double>(used.tv_sec) + 1e-9 * static_cast<double>(used.tv_nsec);
  }

  std::atomic<bool> done_{false};
  std::vector<double> to_reader_ms_;
  std::thread thread_;
};

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Poses through the studio onto the stream"};
  std::string take;
  double rate_hz = 60;
  double seconds = 10;
  app.add_option("TAKE", take, "Take file")->required();
  app.add_option("--rate", rate_hz, "Events per second; 0: as fast as the studio takes them")
      ->capture_default_str();
  app.add_option("--seconds", seconds)->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    const std::filesystem::path file = std::filesystem::absolute(take);
    stream::StreamServerConfig config;
    config.socket = std::filesystem::temp_directory_path() / "facet-studio-bench.sock";
    stream::StreamServer server(config);
    server.start();
    studio::Studio studio(
        file.parent_path(),
        [&](std::shared_ptr<const mesh::MeshFrame> frame) { server.publish(std::move(frame)); }, [](bool) {},
        "studio_bench");
    studio.start();
    studio.open(file.stem().string(), true);
    await(studio, studio::StudioState::Opening);
    await(studio, studio::StudioState::Ready);
    studio.set_controls(controls_at(0), false, false);  // influence maps are made once

    StreamReader reader(config.socket);
    while (reader.received == 0 || studio.status().solved < 2) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    const studio::StudioStatus before = studio.status();
    const int received_before = reader.received;
    const double processor_before_s = processor_s();
    const Clock::time_point began = Clock::now();
    double time_s = 0;
    for (std::int64_t event = 0; time_s < seconds; ++event) {
      const std::uint64_t asked = studio.set_controls(controls_at(time_s), false, false);
      if (rate_hz > 0) {
        std::this_thread::sleep_until(
            began + std::chrono::duration_cast<Clock::duration>(
                        std::chrono::duration<double>(static_cast<double>(event + 1) / rate_hz)));
      } else {
        for (studio::StudioStatus now = studio.status(); now.solved + now.superseded < asked;
             now = studio.status()) {
          std::this_thread::sleep_for(std::chrono::microseconds(50));
        }
      }
      time_s = std::chrono::duration<double>(Clock::now() - began).count();
    }
    const double wall_s = std::chrono::duration<double>(Clock::now() - began).count();
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    const studio::StudioStatus after = studio.status();
    const double used_s = processor_s() - processor_before_s;
    const int got = reader.received - received_before;
    reader.stop();
    fmt::print("events/s asked {:.1f}, solved {:.1f}, superseded {}, received {:.1f}\n",
               static_cast<double>(after.events - before.events) / wall_s,
               static_cast<double>(after.solved - before.solved) / wall_s,
               after.superseded - before.superseded, static_cast<double>(got) / wall_s);
    fmt::print(
        "work ms: mean {:.2f}, p95 {:.2f}; to the stream: mean {:.2f}, p95 {:.2f}; to a reader: median "
        "{:.2f}, p95 {:.2f}\n",
        after.work.mean, after.work.p95, after.latency.mean, after.latency.p95, reader.quantile_ms(0.5),
        reader.quantile_ms(0.95));
    fmt::print("processor: {:.0f} % of a core, of it the reader {:.1f} %\n", 100 * used_s / wall_s,
               100 * reader.processor_s / wall_s);
    server.request_stop();
    studio.stop();
    server.stop();
  } catch (const Error& error) {
    fmt::print(stderr, "studio_bench: {}\n", error.what());
    return 1;
  }
  return 0;
}
