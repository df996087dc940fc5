// Cost of handing out meshes, on the frames of a take: encoding and size per profile, compression, and how
// many frames a second reach N readers while the publisher never waits.

#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <ctime>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "facet/error.hpp"
#include "stream/client.hpp"
#include "stream/encoder.hpp"
#include "stream/server.hpp"
#include "take/reader.hpp"
#include "take/take_file.hpp"

namespace {

using namespace facet;
using Clock = std::chrono::steady_clock;
using Frames = std::vector<std::shared_ptr<const mesh::MeshFrame>>;

/// Processor time of this thread, ms: the same on a busy machine.
double processor_ms() {
  timespec now{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) * 1e3 + static_cast<double>(now.tv_nsec) * 1e-6;
}

double ms_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

Frames read_meshes(const std::string& file, std::size_t limit) {
  take::TakeReader reader(file);
  Frames frames;
  for (std::int64_t index = 0; index < reader.frame_count() && frames.size() < limit; ++index) {
    if (reader.entry(index).has_mesh) {
      frames.push_back(reader.frame(index));
    }
  }
  if (frames.empty()) {
    throw Error(ErrorKind::NoFace, fmt::format("take '{}' has no frame with a mesh", file));
  }
  return frames;
}

void measure_encoding(const Frames& frames) {
  stream::Encoder encoder;
  fmt::print(
      "| profile | encode ms | bytes | zstd 1 ms | zstd 1 bytes | zstd 3 ms | zstd 3 bytes "
      "|\n|---|---|---|---|---|---|---|\n");
  for (int profile = 0; profile < stream::kProfileCount; ++profile) {
    const auto wanted = static_cast<stream::Profile>(profile);
    encoder.frame(*frames.front(), wanted);
    double encode_ms = 0;
    double compress_ms[2] = {};
    std::size_t bytes = 0;
    std::size_t compressed[2] = {};
    take::BlobCompressor compressors[2]{take::BlobCompressor(1), take::BlobCompressor(3)};
    for (const auto& frame : frames) {
      double start = processor_ms();
      const auto message = encoder.frame(*frame, wanted);
      encode_ms += processor_ms() - start;
      bytes += message.size();
      for (std::size_t level = 0; level < 2; ++level) {
        start = processor_ms();
        compressed[level] += compressors[level].compress(message).size();
        compress_ms[level] += processor_ms() - start;
      }
    }
    const auto count = static_cast<double>(frames.size());
    fmt::print("| {} | {:.2f} | {} | {:.2f} | {} | {:.2f} | {} |\n", stream::to_string(wanted),
               encode_ms / count, bytes / frames.size(), compress_ms[0] / count,
               compressed[0] / frames.size(), compress_ms[1] / count, compressed[1] / frames.size());
  }
  const auto& subject = *frames.front()->subject;
  const double start = processor_ms();
  const std::size_t bytes = encoder.subject(subject, stream::Profile::Displacements).size();
  fmt::print("topology, {} vertices: {} bytes, {:.1f} ms\n\n", subject.hierarchy->finest().vertex_count,
             bytes, processor_ms() - start);
}

void measure_readers(const Frames& frames, int reader_count, double rate_hz, double seconds) {
  const std::filesystem::path socket =
      std::filesystem::temp_directory_path() / fmt::format("facet-stream-bench-{}.sock", ::getpid());
  stream::StreamServerConfig config;
  config.socket = socket;
  config.max_readers = reader_count;
  stream::StreamServer server(config);
  server.start();
  std::atomic<bool> done{false};
  std::atomic<std::uint64_t> received{0};
  std::vector<std::thread> readers;
  readers.reserve(static_cast<std::size_t>(reader_count));
  for (int i = 0; i < reader_count; ++i) {
    readers.emplace_back([&] {
      stream::StreamClient client(socket, {});
      stream::DecodedFrame frame;
      while (!done.load() &&
             client.next(frame, std::chrono::milliseconds(200)) != stream::ReceiveOutcome::Closed) {
        ++received;
      }
    });
  }
  const auto interval =
      std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1 / rate_hz));
  double slowest_publish_ms = 0;
  std::uint64_t published = 0;
  const auto start = Clock::now();
  while (ms_since(start) < seconds * 1000) {
    const auto before = Clock::now();
    server.publish(frames[published % frames.size()]);
    slowest_publish_ms = std::max(slowest_publish_ms, ms_since(before));
    ++published;
    std::this_thread::sleep_until(start + static_cast<int>(published) * interval);
  }
  done.store(true);
  for (std::thread& reader : readers) {
    reader.join();
  }
  server.stop();
  fmt::print("| {} | {:.0f} | {:.1f} | {:.3f} |\n", reader_count, rate_hz,
             static_cast<double>(received.load()) / reader_count / seconds, slowest_publish_ms);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Cost of streaming and storing the frames of a take"};
  std::string take;
  double rate_hz = 30;
  double seconds = 10;
  app.add_option("TAKE", take)->required();
  app.add_option("--rate", rate_hz, "Frames published a second")->capture_default_str();
  app.add_option("--seconds", seconds, "Per number of readers")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    const Frames frames = read_meshes(take, 100);
    measure_encoding(frames);
    fmt::print("| readers | published /s | received /s each | slowest publish ms |\n|---|---|---|---|\n");
    for (const int readers : {1, 10, 50}) {
      measure_readers(frames, readers, rate_hz, seconds);
    }
  } catch (const Error& error) {
    fmt::print(stderr, "stream_bench: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
  return 0;
}
