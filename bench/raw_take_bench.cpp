// What it costs to record the frame sets of a booth (six cameras of 640x480, pictures losslessly), beside a
// plain sequential write of the same bytes to the same disk in the same run: as fast as possible, at the
// cameras' rate and at multiples of it, and reading back.

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "camera/pixel_buffers.hpp"
#include "face/face_model.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "picture_codecs.hpp"
#include "simulation/virtual_booth.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace {

using namespace facet;
using Clock = std::chrono::steady_clock;

struct Options {
  std::string footage;
  std::uint64_t seed = 1;
  std::uint64_t slots = 12;
  std::string content = "mixed";
  std::string folder = ".";
  std::vector<double> rates_hz = {60, 120};
  double seconds = 10;
  int rounds = 3;
  bool codecs = false;
};

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// Processor time of the process, s: user and system.
struct Processor {
  double user_s = 0;
  double system_s = 0;

  static Processor now() {
    rusage usage{};
    ::getrusage(RUSAGE_SELF, &usage);
    const auto seconds = [](const timeval& time) {
      return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_usec) * 1e-6;
    };
    return {seconds(usage.ru_utime), seconds(usage.ru_stime)};
  }
  Processor since(const Processor& start) const { return {user_s - start.user_s, system_s - start.system_s}; }
};

/// A number in a file of /proc behind a name; 0 where there is none.
double proc_number(const char* file, const std::string& name) {
  std::ifstream lines(file);
  for (std::string word; lines >> word;) {
    if (double value = 0; word == name && lines >> value) {
      return value;
    }
  }
  return 0;
}

double resident_peak_mb() {
  return proc_number("/proc/self/status", "VmHWM:") / 1024;
}

void forget_resident_peak() {
  std::ofstream("/proc/self/clear_refs") << "5";
}

/// Processor time of this process's threads by name, s.
std::map<std::string, double> thread_times() {
  std::map<std::string, double> times;
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string name;
    std::getline(std::ifstream(task.path() / "comm"), name);
    double run_ns = 0;
    std::ifstream(task.path() / "schedstat") >> run_ns;
    times[name] += run_ns * 1e-9;
  }
  return times;
}

/// The pictures that the cameras deliver again and again.
struct Footage {
  std::vector<FrameSet> sets;
  std::size_t raw_bytes = 0;  ///< of one set on average, without alpha, grey in one channel
};

bool is_grey(const Frame& frame) {
  for (int y = 0; y < frame.height_px; ++y) {
    for (int x = 0; x < frame.width_px; ++x) {
      const std::uint8_t* pixel = frame.row(y) + 4 * static_cast<std::size_t>(x);
      if (pixel[0] != pixel[1] || pixel[1] != pixel[2]) {
        return false;
      }
    }
  }
  return true;
}

/// As a monochrome sensor sees it: the green alone.
void make_grey(Frame& frame) {
  const std::size_t bytes = frame.stride_bytes * static_cast<std::size_t>(frame.height_px);
  auto pixels = std::make_shared<std::uint8_t[]>(bytes);
  std::memcpy(pixels.get(), frame.pixels.get(), bytes);
  for (std::size_t i = 0; i + 3 < bytes; i += 4) {
    pixels.get()[i] = pixels.get()[i + 2] = pixels.get()[i + 1];
  }
  frame.pixels = std::move(pixels);
}

Footage load_footage(const Options& options) {
  Footage footage;
  if (options.footage.empty()) {
    const face::FaceModel model = face::FaceModel::load(default_model_file());
    simulation::VirtualBoothConfig config;
    config.seed = options.seed;
    const simulation::VirtualBooth booth(&model, config);
    constexpr std::uint64_t kFirstSlot = 150;  // the head moves as it does later
    for (std::uint64_t k = 0; k < options.slots; ++k) {
      footage.sets.push_back(booth.slot(kFirstSlot + k).frame_set());
    }
  } else {
    take::TakeReader reader(options.footage);
    for (std::int64_t i = 0; i < reader.frame_count() && footage.sets.size() < options.slots; ++i) {
      if (const auto images = reader.frame(i)->images; images != nullptr && images->complete()) {
        footage.sets.push_back(*images);
      }
    }
  }
  if (footage.sets.empty()) {
    throw Error(ErrorKind::UnreadableInput, options.footage + ": no complete frame set");
  }
  for (FrameSet& set : footage.sets) {
    for (Frame& frame : set.frames) {
      if (options.content == "grey" && !is_grey(frame)) {
        make_grey(frame);
      }
      footage.raw_bytes += static_cast<std::size_t>(frame.width_px) *
                           static_cast<std::size_t>(frame.height_px) * (is_grey(frame) ? 1 : 3);
    }
  }
  footage.raw_bytes /= footage.sets.size();
  return footage;
}

/// Delivers as cameras do: each picture is copied into a buffer of its camera's pool, as a driver converts
/// what the sensor sent.
class Cameras {
 public:
  explicit Cameras(const Footage& footage) : footage_(footage) {
    for (std::size_t i = 0; i < footage.sets.front().frames.size(); ++i) {
      pools_.push_back(std::make_shared<camera::PixelBuffers>());
    }
  }

  std::shared_ptr<const mesh::MeshFrame> slot(std::uint64_t number) {
    auto set = std::make_shared<FrameSet>(footage_.sets[number % footage_.sets.size()]);
    set->slot = number;
    set->trigger_ns = static_cast<std::int64_t>(number) * 16'666'667;
    for (std::size_t i = 0; i < set->frames.size(); ++i) {
      Frame& frame = set->frames[i];
      const std::size_t bytes = frame.stride_bytes * static_cast<std::size_t>(frame.height_px);
      auto pixels = pools_[i]->take(bytes);
      std::memcpy(pixels.get(), frame.pixels.get(), bytes);
      frame.pixels = std::move(pixels);
      frame.sequence = number;
      frame.timestamp_ns = set->trigger_ns;
    }
    auto frame = std::make_shared<mesh::MeshFrame>();
    frame->sequence = number;
    frame->timestamp_ns = set->trigger_ns;
    frame->control_vertices_mm.resize(3, 0);
    frame->images = std::move(set);
    return frame;
  }

 private:
  const Footage& footage_;
  std::vector<std::shared_ptr<camera::PixelBuffers>> pools_;
};

std::uintmax_t bytes_in(const std::filesystem::path& folder) {
  std::uintmax_t bytes = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    bytes += entry.is_regular_file() ? entry.file_size() : 0;
  }
  return bytes;
}

/// Sets per second of a plain write of their raw bytes, synced at the end.
double plain_write(const Footage& footage, const std::filesystem::path& file, std::uint64_t sets) {
  std::vector<std::uint8_t> bytes(footage.raw_bytes);
  const Frame& frame = footage.sets.front().frames.front();
  const std::size_t picture = frame.stride_bytes * static_cast<std::size_t>(frame.height_px);
  for (std::size_t at = 0; at < bytes.size(); at += picture) {
    std::memcpy(bytes.data() + at, frame.pixels.get(), std::min(picture, bytes.size() - at));
  }
  const int fd = ::open(file.c_str(), O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0644);
  if (fd < 0) {
    throw Error(ErrorKind::Storage, fmt::format("{}: {}", file.string(), std::strerror(errno)));
  }
  const auto start = Clock::now();
  for (std::uint64_t i = 0; i < sets; ++i) {
    for (std::size_t at = 0; at < bytes.size();) {
      const ssize_t written = ::write(fd, bytes.data() + at, bytes.size() - at);
      if (written < 0) {
        throw Error(ErrorKind::Storage, fmt::format("{}: {}", file.string(), std::strerror(errno)));
      }
      at += static_cast<std::size_t>(written);
    }
  }
  ::fdatasync(fd);
  const double seconds = seconds_since(start);
  ::close(fd);
  std::filesystem::remove(file);
  return static_cast<double>(sets) / seconds;
}

struct Run {
  double sets_per_s = 0;
  double user_ms = 0;     ///< of the recorder a set: without the copies of `Cameras`
  double system_ms = 0;   ///< the same
  double bytes = 0;       ///< in the take a set
  double disk_bytes = 0;  ///< sent to the disk a set
  double peak_mb = 0;     ///< more memory than before
  double slowest_record_ms = 0;
  std::uint64_t dropped = 0;
  std::map<std::string, double> thread_ms;  ///< processor time a set by thread
};

/// Records `sets` sets; rate_hz 0: as fast as possible, waiting for the disk.
Run record(const Footage& footage, const std::filesystem::path& folder, std::uint64_t sets, double rate_hz) {
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  take::TakeRecorderConfig config;
  config.file = folder / "bench.take";
  config.when_full = rate_hz > 0 ? take::WhenFull::Drop : take::WhenFull::Wait;
  config.with_images = true;
  Cameras cameras(footage);
  double slowest_ms = 0;
  Run run;
  forget_resident_peak();
  const double before_mb = resident_peak_mb();
  const double written_before = proc_number("/proc/self/io", "write_bytes:");
  take::TakeRecorder recorder(config);
  recorder.start();
  const Processor processor = Processor::now();
  const auto before = thread_times();
  const auto start = Clock::now();
  Processor cameras_s;
  for (std::uint64_t slot = 0; slot < sets; ++slot) {
    if (rate_hz > 0) {
      std::this_thread::sleep_until(start +
                                    std::chrono::duration_cast<Clock::duration>(
                                        std::chrono::duration<double>(static_cast<double>(slot) / rate_hz)));
    }
    rusage begun{};
    ::getrusage(RUSAGE_THREAD, &begun);
    auto frame = cameras.slot(slot);
    rusage ended{};
    ::getrusage(RUSAGE_THREAD, &ended);
    const auto spent = [](const timeval& from, const timeval& to) {
      return static_cast<double>(to.tv_sec - from.tv_sec) +
             static_cast<double>(to.tv_usec - from.tv_usec) * 1e-6;
    };
    cameras_s.user_s += spent(begun.ru_utime, ended.ru_utime);
    cameras_s.system_s += spent(begun.ru_stime, ended.ru_stime);
    const auto asked = Clock::now();
    recorder.record(std::move(frame));
    slowest_ms = std::max(slowest_ms, 1e3 * seconds_since(asked));
  }
  while (recorder.status().queued > 0) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  for (const auto& [name, time_s] : thread_times()) {
    const auto earlier = before.find(name);
    run.thread_ms[name] =
        1e3 * (time_s - (earlier == before.end() ? 0 : earlier->second)) / static_cast<double>(sets);
  }
  const take::RecorderStatus status = recorder.stop();
  const double seconds = seconds_since(start);
  const Processor spent = Processor::now().since(processor);
  if (status.state != take::RecorderState::Finished) {
    throw Error(ErrorKind::Storage, status.reason);
  }
  const auto count = static_cast<double>(sets);
  run.sets_per_s = static_cast<double>(status.frames) / seconds;
  run.user_ms = 1e3 * (spent.user_s - cameras_s.user_s) / count;
  run.system_ms = 1e3 * (spent.system_s - cameras_s.system_s) / count;
  run.bytes = static_cast<double>(bytes_in(folder)) / count;
  run.disk_bytes = (proc_number("/proc/self/io", "write_bytes:") - written_before) / count;
  run.peak_mb = resident_peak_mb() - before_mb;
  run.slowest_record_ms = slowest_ms;
  run.dropped = status.dropped;
  return run;
}

/// Sends what a folder holds out of the page cache.
void forget_files(const std::filesystem::path& folder) {
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (const int fd = ::open(entry.path().c_str(), O_RDONLY | O_CLOEXEC); fd >= 0) {
      ::posix_fadvise(fd, 0, 0, POSIX_FADV_DONTNEED);
      ::close(fd);
    }
  }
}

/// Reads the take from its beginning to its end; every picture must be what was recorded, bit by bit.
void read_back(const Footage& footage, const std::filesystem::path& folder, bool cold) {
  if (cold) {
    forget_files(folder);
  }
  take::TakeReader reader(folder / "bench.take");
  const Processor processor = Processor::now();
  const auto start = Clock::now();
  double comparing_s = 0;
  for (std::int64_t i = 0; i < reader.frame_count(); ++i) {
    const auto images = reader.frame(i)->images;
    const auto begun = Clock::now();
    const FrameSet& sent = footage.sets[images->slot % footage.sets.size()];
    for (std::size_t camera = 0; camera < sent.frames.size(); ++camera) {
      const Frame& expected = sent.frames[camera];
      const Frame& got = images->frames.at(camera);
      for (int y = 0; y < expected.height_px; ++y) {
        if (got.empty() ||
            std::memcmp(got.row(y), expected.row(y), 4 * static_cast<std::size_t>(expected.width_px)) != 0) {
          throw Error(ErrorKind::Internal,
                      fmt::format("set {}: camera {} is not what was recorded", i, camera));
        }
      }
    }
    comparing_s += seconds_since(begun);
  }
  const double seconds = seconds_since(start) - comparing_s;
  const Processor spent = Processor::now().since(processor);
  const auto count = static_cast<double>(reader.frame_count());
  fmt::print(
      "read back {}: {:.0f} sets/s, {:.0f} MB/s of pixels; {:.2f} ms of a processor a set; all {} "
      "bit-exact\n",
      cold ? "from the disk" : "from memory", count / seconds,
      count / seconds * static_cast<double>(footage.raw_bytes) / 1e6,
      1e3 * (spent.user_s + spent.system_s - comparing_s) / count, reader.frame_count());
}

void print(const std::string& what, const Run& run, const Footage& footage, double plain_sets_per_s) {
  fmt::print("| {} | {:.1f} | {:.0f} | {:.0f} | {:.2f} | {} | {:.2f} + {:.2f} | {} | {:.2f} | {:.0f} |\n",
             what, run.sets_per_s, run.sets_per_s * static_cast<double>(footage.raw_bytes) / 1e6,
             run.sets_per_s * run.bytes / 1e6, run.disk_bytes / run.bytes,
             plain_sets_per_s > 0 ? fmt::format("{:.2f}", run.sets_per_s / plain_sets_per_s) : "-",
             run.user_ms, run.system_ms, run.dropped, run.slowest_record_ms, run.peak_mb);
}

void measure(const Options& options) {
  const Footage footage = load_footage(options);
  const std::filesystem::path folder = std::filesystem::path(options.folder) / "raw_take_bench";
  const auto sets = static_cast<std::uint64_t>(options.seconds * options.rates_hz.front());
  fmt::print("{} sets of {} cameras, {}: {:.2f} MB of pixels a set\n\n", footage.sets.size(),
             footage.sets.front().frames.size(), options.content,
             static_cast<double>(footage.raw_bytes) / 1e6);
  if (options.codecs) {
    bench::measure_codecs(footage.sets);
    bench::measure_steps(footage.sets);
    return;
  }
  fmt::print(
      "| run | sets/s | MB/s pixels | MB/s take | disk / take | of plain write | processor ms a set | "
      "dropped | "
      "slowest record() ms | memory MB |\n|---|---|---|---|---|---|---|---|---|---|\n");
  std::map<std::string, double> thread_ms;
  for (int round = 0; round < options.rounds; ++round) {
    std::filesystem::create_directories(folder);
    const double plain = plain_write(footage, folder / "plain", sets);
    fmt::print("| plain write | {:.1f} | {:.0f} | - | - | 1 | - | - | - | - |\n", plain,
               plain * static_cast<double>(footage.raw_bytes) / 1e6);
    const Run run = record(footage, folder, sets, 0);
    print("as fast as possible", run, footage, plain);
    thread_ms = run.thread_ms;
  }
  for (const double rate_hz : options.rates_hz) {
    const auto count = static_cast<std::uint64_t>(options.seconds * rate_hz);
    print(fmt::format("{:.0f} sets/s", rate_hz), record(footage, folder, count, rate_hz), footage, 0);
  }
  fmt::print(
      "\nprocessor time of the threads as fast as possible, ms a set (the main thread copies the pictures):");
  for (const auto& [name, time_ms] : thread_ms) {
    fmt::print(" {} {:.2f}", name, time_ms);
  }
  fmt::print("\n");
  read_back(footage, folder, true);
  read_back(footage, folder, false);
  std::filesystem::remove_all(folder);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Cost of recording the frame sets of six cameras"};
  Options options;
  app.add_option("--footage", options.footage,
                 "Take whose pictures are recorded (default: the virtual booth renders them)");
  app.add_option("--seed", options.seed, "Of the virtual booth")->capture_default_str();
  app.add_option("--slots", options.slots, "Different sets, recorded again and again")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  app.add_option("--content", options.content, "mixed: four cameras grey, two in colour; grey: all six")
      ->capture_default_str()
      ->check(CLI::IsMember({"mixed", "grey"}));
  app.add_option("--folder", options.folder, "On the disk to measure; 1 to 4 GB are written and removed")
      ->capture_default_str();
  app.add_option("--rates", options.rates_hz, "Sets a second; the first is the cameras'")
      ->delimiter(',')
      ->capture_default_str();
  app.add_option("--seconds", options.seconds, "Of each run at a rate")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  app.add_option("--rounds", options.rounds, "Of plain write and recording as fast as possible")
      ->capture_default_str();
  app.add_flag("--codecs", options.codecs, "Compare lossless codecs on the pictures and end");
  CLI11_PARSE(app, argc, argv);
  try {
    measure(options);
  } catch (const Error& error) {
    fmt::print(stderr, "raw_take_bench: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
  return 0;
}
