// Frames through shared memory: the time from publish() to a frame in the reader's hands, beside the same
// over the socket; processor time of the sending thread; and reads against a writer that never pauses.

#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <ctime>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "facet-client.h"
#include "facet/error.hpp"
#include "stream/encoder.hpp"
#include "stream/ring.hpp"
#include "stream/server.hpp"
#include "support/mesh_frames.hpp"

namespace {

using namespace facet;
using Clock = std::chrono::steady_clock;  // CLOCK_MONOTONIC, as frames' times

constexpr std::size_t kFrames = 16;  // different ones, published again and again

struct Options {
  int side = 57;
  int levels = 3;
  double rate_hz = 60;
  double seconds = 10;
  std::uint64_t hostile_reads = 0;
  bool build = false;
};

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch()).count();
}

double processor_ms(clockid_t clock) {
  timespec now{};
  ::clock_gettime(clock, &now);
  return static_cast<double>(now.tv_sec) * 1e3 + static_cast<double>(now.tv_nsec) * 1e-6;
}

double quantile_ms(std::vector<std::int64_t>& sorted_ns, double share) {
  if (sorted_ns.empty()) {
    return 0;
  }
  const auto index = static_cast<std::size_t>(share * static_cast<double>(sorted_ns.size() - 1));
  return static_cast<double>(sorted_ns[index]) * 1e-6;
}

/// Processor time of the thread facet-stream so far: what hands frames out.
double sender_ms() {
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/task")) {
    std::FILE* comm = std::fopen((entry.path() / "comm").c_str(), "r");
    char name[32] = {};
    const bool found = comm != nullptr && std::fgets(name, sizeof(name), comm) != nullptr &&
                       std::string(name) == "facet-stream\n";
    if (comm != nullptr) {
      std::fclose(comm);
    }
    if (found) {
      // The clock of a thread by its number, as pthread_getcpuclockid makes it.
      const auto thread = static_cast<unsigned>(std::stoul(entry.path().filename()));
      return processor_ms(static_cast<clockid_t>(~thread << 3U | 6U));
    }
  }
  return 0;
}

void measure(const Options& options, stream::Profile profile, int reader_count, bool by_ring) {
  const auto subject = test::patch_subject(1, options.side, options.levels);
  std::vector<std::shared_ptr<mesh::MeshFrame>> frames;
  for (std::size_t k = 0; k < kFrames; ++k) {
    frames.push_back(std::make_shared<mesh::MeshFrame>(test::patch_frame(k, subject, nullptr)));
  }
  stream::StreamServerConfig config;
  config.socket =
      std::filesystem::temp_directory_path() / fmt::format("facet-ring-bench-{}.sock", ::getpid());
  stream::StreamServer server(config);
  server.start();
  std::atomic<bool> done{false};
  std::atomic<int> ready{0};
  std::atomic<std::uint64_t> dropped{0};
  std::atomic<std::uint64_t> overwritten{0};
  std::vector<std::vector<std::int64_t>> latencies_ns(static_cast<std::size_t>(reader_count));
  std::vector<std::thread> readers;
  readers.reserve(latencies_ns.size());
  for (auto& mine : latencies_ns) {
    readers.emplace_back([&] {
      facet_client* client = facet_client_new(config.socket.c_str(), static_cast<int>(profile),
                                              by_ring ? FACET_WANT_RING : 0, "bench");
      bool first = true;
      while (!done.load()) {
        if (facet_client_next(client, 200) != FACET_OK) {
          continue;
        }
        const std::int64_t at_ns = now_ns();
        const facet_mesh* mesh = nullptr;
        if (options.build) {
          facet_client_mesh(client, &mesh);
        }
        if (first) {  // came with the topology
          first = false;
          ++ready;
        } else {
          mine.push_back((options.build ? now_ns() : at_ns) - facet_client_frame(client)->timestamp_ns);
        }
      }
      dropped += facet_client_statistics(client)->dropped;
      overwritten += facet_client_statistics(client)->overwritten;
      facet_client_free(client);
    });
  }
  const auto publish = [&](std::size_t count) {
    auto frame = std::make_shared<mesh::MeshFrame>(*frames[count % kFrames]);
    frame->sequence = count;
    frame->timestamp_ns = now_ns();
    server.publish(std::move(frame));
  };
  publish(0);
  while (ready.load() < reader_count) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  const auto interval =
      std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1 / options.rate_hz));
  const double sender_before_ms = sender_ms();
  const auto start = Clock::now();
  std::size_t count = 0;
  while (std::chrono::duration<double>(Clock::now() - start).count() < options.seconds) {
    std::this_thread::sleep_until(start + static_cast<int>(++count) * interval);
    publish(count);
  }
  const double share = (sender_ms() - sender_before_ms) / (options.seconds * 1e3);
  done.store(true);
  for (std::thread& reader : readers) {
    reader.join();
  }
  server.stop();
  std::vector<std::int64_t> all;
  for (const auto& mine : latencies_ns) {
    all.insert(all.end(), mine.begin(), mine.end());
  }
  std::sort(all.begin(), all.end());
  fmt::print("| {}, {} | {} | {} | {:.1f} | {:.3f} | {:.3f} | {:.3f} | {} | {} | {:.1f} % |\n",
             by_ring ? "ring" : "socket", stream::to_string(profile),
             subject->hierarchy->finest().vertex_count, reader_count,
             static_cast<double>(all.size()) / reader_count / options.seconds, quantile_ms(all, 0.5),
             quantile_ms(all, 0.99), quantile_ms(all, 1), dropped.load(), overwritten.load(), 100 * share);
}

/// Reads in place against a writer that never pauses: how many were torn, and how many of those were
/// believed.
void measure_hostile(const Options& options) {
  constexpr std::size_t kNumbers = 3000;
  std::vector<std::int16_t> numbers(kNumbers);
  stream::RingFrame frame;
  frame.arrays[FACET_RING_VERTICES] = {reinterpret_cast<const std::uint8_t*>(numbers.data()),
                                       kNumbers * sizeof(std::int16_t)};
  stream::RingWriter writer(stream::Profile::Vertices, 2, stream::ring_slot_bytes(frame));
  std::atomic<bool> done{false};
  std::thread writing([&] {
    for (std::uint64_t number = 1; !done.load(); ++number) {
      std::fill(numbers.begin(), numbers.end(), static_cast<std::int16_t>(number));
      writer.write(number, frame);
    }
  });
  const stream::FileDescriptor fd(::dup(writer.fd()));
  stream::RingReader reader(fd);
  std::uint64_t reads = 0;
  std::uint64_t torn = 0;
  std::uint64_t refused = 0;
  std::uint64_t believed = 0;
  while (reads < options.hostile_reads) {
    if (reader.newest() != stream::RingReader::Outcome::Frame) {
      continue;
    }
    bool same = true;
    const auto expected = static_cast<std::int16_t>(reader.number());
    stream::for_each_number<std::int16_t>(
        reader.array(FACET_RING_VERTICES),
        [&](std::size_t, std::int16_t value) { same = same && value == expected; });
    const bool intact = reader.intact();
    ++reads;
    torn += same ? 0 : 1;
    refused += intact ? 0 : 1;
    believed += intact && !same ? 1 : 0;
  }
  done.store(true);
  writing.join();
  fmt::print("hostile writer: {} reads, {} refused, {} torn, {} torn and believed\n", reads, refused, torn,
             believed);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Frames through shared memory and over the socket"};
  Options options;
  std::string what = "displacements";
  std::vector<int> readers{4};
  bool socket_too = false;
  app.add_option("--side", options.side, "Control vertices along a side of the patch")->capture_default_str();
  app.add_option("--levels", options.levels, "Levels of the hierarchy")->capture_default_str();
  app.add_option("--rate", options.rate_hz, "Frames a second")->capture_default_str();
  app.add_option("--seconds", options.seconds)->capture_default_str();
  app.add_option("--readers", readers)->capture_default_str();
  app.add_option("--profile", what)
      ->check(CLI::IsMember({"signals", "displacements", "vertices"}))
      ->capture_default_str();
  app.add_flag("--build", options.build,
               "Until the mesh is rebuilt, not until the frame is in the reader's hands");
  app.add_flag("--socket-too", socket_too, "The same over the socket");
  app.add_option("--hostile-reads", options.hostile_reads, "Only reads against a writer without pause");
  CLI11_PARSE(app, argc, argv);
  try {
    if (options.hostile_reads > 0) {
      measure_hostile(options);
      return 0;
    }
    const auto profile = what == "signals"         ? stream::Profile::Signals
                         : what == "displacements" ? stream::Profile::Displacements
                                                   : stream::Profile::Vertices;
    fmt::print(
        "| way, profile | vertices | readers | frames/s each | median ms | p99 ms | worst ms | dropped | "
        "overwritten "
        "| sender |\n|---|---|---|---|---|---|---|---|---|---|\n");
    for (const int count : readers) {
      measure(options, profile, count, true);
      if (socket_too) {
        measure(options, profile, count, false);
      }
    }
  } catch (const Error& error) {
    fmt::print(stderr, "ring_bench: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
  return 0;
}
