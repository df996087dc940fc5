// What one refined frame costs on a device, kernel by kernel, and whether the device computes what it should:
// a synthetic face of which everything is known, so that nothing is needed but the device. Times of whole
// frames and of each kernel on each level; the same frames three times, bit for bit; against displacements
// that another device left in a file; how long a lost device takes to come back.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <bit>
#include <cctype>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <ctime>
#include <fstream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "gpu/context.hpp"
#include "refine/refiner.hpp"
#include "support/synthetic_face.hpp"

namespace {

using facet::Error;
using facet::ErrorKind;
using facet::gpu::Context;
using facet::refine::RefineOutput;
using facet::refine::Refiner;
using facet::refine::RefinerConfig;
using nlohmann::json;
namespace synthetic = facet::refine::synthetic;
using Clock = std::chrono::steady_clock;

struct Options {
  std::string device = "auto";
  std::string budget = "auto";
  std::string json_file;
  std::string reference;
  std::string write_reference;
  int width_px = 1280;
  int height_px = 720;
  float min_edge_px = 2;
  int frames = 30;
  int views = 0;                              ///< further cameras
  int learn = RefinerConfig().albedo_frames;  ///< frames before them, in which the albedo is learned
  double most_rms_mm = 0.005;
  std::string kernel_cache = "auto";
  std::string uploads = "auto";
  bool kernels = false;
  bool learning = false;
  bool room_lamps = false;
  bool determinism = false;
  bool loss = false;
};

double ms_since(Clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
}

/// Of all threads of this process, ms.
double processor_ms() {
  timespec now{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

double quantile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0
                        : values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

facet::gpu::ContextOptions context_options(const Options& options) {
  facet::gpu::ContextOptions out;
  out.device = options.device;
  out.kernel_cache = options.kernel_cache;
  out.upload_memory = options.uploads == "host"     ? facet::gpu::UploadMemory::Host
                      : options.uploads == "device" ? facet::gpu::UploadMemory::Device
                                                    : facet::gpu::UploadMemory::Auto;
  return out;
}

RefinerConfig config_of(const std::string& budget, const Options& options) {
  RefinerConfig config;
  config.albedo_frames = options.learn + (options.learning ? options.frames : 0);
  if (options.room_lamps) {
    config.room_lamps = facet::refine::RoomLamps::Always;
  }
  if (budget == "auto") {
    config.budget = facet::refine::Budget::Auto;
  } else if (budget == "paper") {
    config.budget = facet::refine::Budget::Paper;
  } else {
    config.budget = facet::refine::Budget::Fixed;
    config.gauss_newton_steps = std::stoi(budget);
  }
  return config;
}

/// The face, which fills six sevenths of the picture's height, its mesh and its pictures: the head turns to
/// and fro, each picture with noise of its own.
struct Footage {
  explicit Footage(const Options& options) {
    constexpr int kPictures = 4;
    scene.image_width_px = options.width_px;
    scene.image_height_px = options.height_px;
    scene.noise = 1.5F;
    cap = synthetic::make_cap(scene);
    facet::mesh::HierarchyOptions hierarchy_options;
    hierarchy_options.min_edge_px = options.min_edge_px;
    subject = {synthetic::hierarchy(scene, cap, hierarchy_options), cap.mean_albedo, cap.control.refinable};
    for (int k = 0; k < kPictures; ++k) {
      scene.seed = static_cast<unsigned>(k) + 1;
      scene.yaw_rad = 0.1F * std::sin(0.7F * static_cast<float>(k));
      facet::refine::RefineInput& input = inputs.emplace_back();
      input.image = synthetic::render(scene);
      input.camera = synthetic::camera(scene);
      input.camera_from_head = synthetic::camera_from_head(scene);
      input.control_vertices_mm = &cap.vertices_mm;
      views.push_back(std::vector<facet::refine::FurtherCamera>(
          static_cast<std::size_t>(options.views),
          {input.image, input.camera, Eigen::Isometry3f::Identity()}));
      input.further_views = views.back();
    }
  }
  Footage(const Footage&) = delete;
  Footage& operator=(const Footage&) = delete;

  const facet::refine::RefineInput& input(int frame) const {
    return inputs[static_cast<std::size_t>(frame) % inputs.size()];
  }
  std::size_t vertices() const { return static_cast<std::size_t>(subject.hierarchy->finest().vertex_count); }

  synthetic::Scene scene;
  synthetic::Cap cap;
  facet::refine::SubjectSetup subject;
  std::vector<facet::refine::RefineInput> inputs;
  std::vector<std::vector<facet::refine::FurtherCamera>>
      views;  ///< [picture] where the first camera stands, too
};

void refine(Refiner& refiner, const Footage& footage, int frame, RefineOutput& output) {
  refiner.submit(footage.input(frame));
  switch (refiner.collect(output)) {
    case facet::refine::RefineOutcome::Refined:
      return;
    case facet::refine::RefineOutcome::DeviceLost:
      throw facet::gpu::DeviceLostError(output.failure);
    case facet::refine::RefineOutcome::NumericalFailure:
      throw Error(ErrorKind::Internal, output.failure);
  }
}

/// What stands before the second frame, ms: the device as it was opened, kernels, a subject, the first frame.
json measure_opening(Context& context, double device_ms, const Footage& footage, const Options& options) {
  json out{{"open_device_ms", device_ms}};
  const auto timed = [&](const char* name, const auto& what) {
    const Clock::time_point begin = Clock::now();
    what();
    out[name] = ms_since(begin);
  };
  std::optional<Refiner> refiner;
  RefineOutput output;
  timed("open_kernels_ms", [&] { refiner.emplace(context, config_of(options.budget, options)); });
  timed("open_subject_ms", [&] { refiner->set_subject(footage.subject); });
  timed("open_first_frame_ms", [&] { refine(*refiner, footage, 0, output); });
  out["recording_ms"] = output.recording_ms;
  const facet::gpu::KernelCacheState cache = context.kernel_cache();
  out["kernel_cache_read_bytes"] = cache.read_bytes;
  out["kernel_cache_written_bytes"] = cache.written_bytes;
  fmt::print(
      "opening: device {:.0f} ms, kernels {:.0f} ms, subject {:.0f} ms, first frame {:.0f} ms (of it "
      "recording {:.2f} ms); kernel cache: "
      "read {} bytes, wrote {}{}{}\n",
      device_ms, out["open_kernels_ms"].get<double>(), out["open_subject_ms"].get<double>(),
      out["open_first_frame_ms"].get<double>(), static_cast<double>(output.recording_ms), cache.read_bytes,
      cache.written_bytes, cache.why.empty() ? "" : "; ", cache.why);
  return out;
}

json measure_frames(Context& context, const Footage& footage, const Options& options) {
  Refiner refiner(context, config_of(options.budget, options));
  refiner.set_subject(footage.subject);
  RefineOutput output;
  const int learned = options.learn;
  for (int k = 0; k < learned; ++k) {
    refine(refiner, footage, k, output);
  }
  std::vector<double> whole_ms;
  std::vector<double> waited_ms;  // for plans to be recorded
  std::map<std::string, double> stages;
  const double processor_before_ms = processor_ms();
  for (int k = 0; k < options.frames; ++k) {
    const Clock::time_point begin = Clock::now();
    refine(refiner, footage, learned + k, output);
    whole_ms.push_back(ms_since(begin));
    if (output.recording_ms > 0) {
      waited_ms.push_back(static_cast<double>(output.recording_ms));
    }
    stages["upload_ms"] += static_cast<double>(output.upload_ms);
    stages["lighting_ms"] += static_cast<double>(output.lighting_ms);
    stages["albedo_ms"] += static_cast<double>(output.albedo_ms);
    stages["displacement_ms"] += static_cast<double>(output.displacement_ms);
    stages["readback_ms"] += static_cast<double>(output.readback_ms);
  }
  const double processor = (processor_ms() - processor_before_ms) / options.frames;
  json out{{"processor_ms", processor},          {"median_ms", quantile(whole_ms, 0.5)},
           {"p99_ms", quantile(whole_ms, 0.99)}, {"longest_ms", quantile(whole_ms, 1)},
           {"recordings", waited_ms.size()},     {"longest_recording_ms", quantile(waited_ms, 1)}};
  double device_ms = 0;
  for (const auto& [stage, sum] : stages) {
    out[stage] = sum / options.frames;
    device_ms += sum / options.frames;
  }
  out["device_ms"] = device_ms;
  fmt::print(
      "{} frames, budget {}: median {:.3f} ms, 99 % {:.3f} ms; on the device {:.3f} ms: upload {:.3f}, "
      "lighting "
      "{:.3f}, albedo {:.3f}, displacement {:.3f}, readback {:.3f}\n",
      options.frames, options.budget, out["median_ms"].get<double>(), out["p99_ms"].get<double>(), device_ms,
      out["upload_ms"].get<double>(), out["lighting_ms"].get<double>(), out["albedo_ms"].get<double>(),
      out["displacement_ms"].get<double>(), out["readback_ms"].get<double>());
  fmt::print("processor (all threads, a software device's too): {:.2f} ms a frame\n", processor);
  fmt::print(
      "hitches: longest frame {:.3f} ms; {} frames waited for a plan to be recorded, at most {:.3f} ms\n",
      out["longest_ms"].get<double>(), waited_ms.size(), out["longest_recording_ms"].get<double>());
  return out;
}

/// Mean microseconds of every kernel on every level, and how often it runs in a frame.
json measure_kernels(Context& context, const Footage& footage, const Options& options) {
  struct Sum {
    int calls = 0;
    double us = 0;
  };
  RefinerConfig config = config_of(options.budget, options);
  config.time_kernels = true;
  Refiner refiner(context, config);
  refiner.set_subject(footage.subject);
  RefineOutput output;
  const int learned = options.learn;
  for (int k = 0; k < learned; ++k) {
    refine(refiner, footage, k, output);
  }
  std::vector<std::string> order;
  std::map<std::string, Sum> sums;
  for (int k = 0; k < options.frames; ++k) {
    refine(refiner, footage, learned + k, output);
    for (const facet::gpu::StageTime& step : output.kernels) {
      if (step.name.find('/') == std::string::npos ||
          std::isdigit(static_cast<unsigned char>(step.name.back())) != 0) {
        continue;  // the stage or its level itself, up to the first step
      }
      if (!sums.contains(step.name)) {
        order.push_back(step.name);
      }
      Sum& sum = sums[step.name];
      ++sum.calls;
      sum.us += 1e3 * static_cast<double>(step.ms);
    }
  }
  double all_us = 0;
  for (const auto& [name, sum] : sums) {
    all_us += sum.us / options.frames;
  }
  fmt::print("\n| step | a frame | us each | us a frame | share |\n|---|---|---|---|---|\n");
  json out = json::array();
  for (const std::string& name : order) {
    const Sum& sum = sums[name];
    const double a_frame = static_cast<double>(sum.calls) / options.frames;
    const double us = sum.us / options.frames;
    fmt::print("| {} | {:.1f} | {:.1f} | {:.0f} | {:.1f} % |\n", name, a_frame, sum.us / sum.calls, us,
               100 * us / all_us);
    out.push_back(
        {{"step", name}, {"a_frame", a_frame}, {"us_each", sum.us / sum.calls}, {"us_a_frame", us}});
  }
  fmt::print("| all | | | {:.0f} | |\n\n", all_us);
  return out;
}

/// Displacements of some frames with a fixed number of steps, which no time and no energy decides.
std::vector<std::vector<float>> displacements(Context& context, const Footage& footage,
                                              const Options& options) {
  Refiner refiner(context, config_of("2", options));
  refiner.set_subject(footage.subject);
  std::vector<std::vector<float>> kept;
  RefineOutput output;
  for (int k = 0; k < options.frames; ++k) {
    refine(refiner, footage, k, output);
    kept.push_back(output.displacements_mm);
  }
  return kept;
}

bool same_bits(const std::vector<std::vector<float>>& one, const std::vector<std::vector<float>>& other) {
  const auto bits = [](float value) { return std::bit_cast<std::uint32_t>(value); };
  return std::equal(one.begin(), one.end(), other.begin(), other.end(), [&](const auto& a, const auto& b) {
    return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                      [&](float x, float y) { return bits(x) == bits(y); });
  });
}

// A reference: one line of text, then 16-bit multiples of kStepMm, little-endian, of the first, middle and
// last frame.
constexpr double kStepMm = 1.0 / 4096;
constexpr std::array kKept = {0.0, 0.5, 1.0};

std::string reference_head(const Footage& footage, const Options& options) {
  return fmt::format("facet frame_bench reference 1: {}x{} px, {} vertices, {} frames of which {} learn",
                     options.width_px, options.height_px, footage.vertices(), options.frames, options.learn);
}

std::vector<std::size_t> kept_frames(const Options& options) {
  std::vector<std::size_t> frames;
  for (const double share : kKept) {
    frames.push_back(static_cast<std::size_t>(share * static_cast<double>(options.frames - 1)));
  }
  return frames;
}

void write_reference(const std::vector<std::vector<float>>& found, const Footage& footage,
                     const Options& options) {
  std::ofstream file(options.write_reference, std::ios::binary);
  file << reference_head(footage, options) << '\n';
  for (const std::size_t frame : kept_frames(options)) {
    for (const float value_mm : found[frame]) {
      const auto step = static_cast<std::uint16_t>(static_cast<std::int16_t>(
          std::clamp(std::lround(static_cast<double>(value_mm) / kStepMm), -32'768L, 32'767L)));
      file.put(static_cast<char>(step & 0xffU)).put(static_cast<char>(step >> 8U));
    }
  }
  if (!file.flush()) {
    throw Error(ErrorKind::Storage, fmt::format("cannot write {}", options.write_reference));
  }
}

json compare(const std::vector<std::vector<float>>& found, const Footage& footage, const Options& options) {
  std::ifstream file(options.reference, std::ios::binary);
  std::ostringstream read;
  read << file.rdbuf();
  const std::string bytes = read.str();
  const std::string head = reference_head(footage, options) + '\n';
  if (!file || bytes.compare(0, head.size(), head) != 0 ||
      bytes.size() != head.size() + kKept.size() * 2 * footage.vertices()) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format(
            "{} is no reference of these frames ({}); make one on another device with --write-reference",
            options.reference, reference_head(footage, options)));
  }
  const auto byte = [&](std::size_t at) {
    return static_cast<std::uint16_t>(static_cast<unsigned char>(bytes[at]));
  };
  std::size_t at = head.size();
  double squares = 0;
  double worst = 0;
  for (const std::size_t frame : kept_frames(options)) {
    for (const float value_mm : found[frame]) {
      const auto step = static_cast<std::int16_t>(byte(at) | byte(at + 1) << 8U);
      at += 2;
      const double difference = std::abs(static_cast<double>(value_mm) - kStepMm * step);
      squares += difference * difference;
      worst = std::max(worst, difference);
    }
  }
  const double rms = std::sqrt(squares / static_cast<double>(kKept.size() * footage.vertices()));
  fmt::print("against {}: rms {:.5f} mm, worst {:.4f} mm (may be {:.3f} mm rms)\n", options.reference, rms,
             worst, options.most_rms_mm);
  return {{"rms_mm", rms}, {"worst_mm", worst}, {"met", rms <= options.most_rms_mm}};
}

/// How long everything takes that stands between a loss and the next refined frame, ms.
json measure_loss(const Footage& footage, const Options& options) {
  json out;
  double all = 0;
  const auto timed = [&](const char* name, const auto& what) {
    const Clock::time_point begin = Clock::now();
    what();
    const double ms = ms_since(begin);
    out[name] = ms;
    all += ms;
  };
  auto context = std::make_unique<Context>(context_options(options));
  auto refiner = std::make_unique<Refiner>(*context, RefinerConfig());
  refiner->set_subject(footage.subject);
  RefineOutput output;
  refine(*refiner, footage, 0, output);
  context->simulate_loss();
  refiner->submit(footage.input(1));
  out["seen"] = refiner->collect(output) == facet::refine::RefineOutcome::DeviceLost;
  timed("destroy_ms", [&] {
    refiner.reset();
    context.reset();
  });
  timed("open_ms", [&] { context = std::make_unique<Context>(context_options(options)); });
  timed("kernels_ms", [&] { refiner = std::make_unique<Refiner>(*context, RefinerConfig()); });
  timed("subject_ms", [&] { refiner->set_subject(footage.subject); });
  timed("first_frame_ms", [&] { refine(*refiner, footage, 2, output); });
  out["all_ms"] = all;
  fmt::print(
      "a lost device {}; back after {:.0f} ms: destroy {:.0f}, open {:.0f}, kernels {:.0f}, subject {:.0f}, "
      "first "
      "frame {:.0f}\n",
      out["seen"].get<bool>() ? "was seen" : "WAS NOT SEEN", all, out["destroy_ms"].get<double>(),
      out["open_ms"].get<double>(), out["kernels_ms"].get<double>(), out["subject_ms"].get<double>(),
      out["first_frame_ms"].get<double>());
  return out;
}

bool run(const Options& options) {
  constexpr int kRepeats = 3;
  const Clock::time_point begin = Clock::now();
  Context context(context_options(options));
  const double device_ms = ms_since(begin);
  const Footage footage(options);
  json out{{"device", context.info().name},  {"budget", options.budget}, {"width_px", options.width_px},
           {"height_px", options.height_px}, {"views", options.views},   {"frames", options.frames}};
  fmt::print("{}: {}x{} px,", context.info().name, options.width_px, options.height_px);
  for (const facet::mesh::Level& level : footage.subject.hierarchy->levels) {
    out["vertices"].push_back(level.vertex_count);
    fmt::print(" {}", level.vertex_count);
  }
  fmt::print(" vertices\n");
  bool met = true;
  out["opening"] = measure_opening(context, device_ms, footage, options);
  out["frame"] = measure_frames(context, footage, options);
  if (options.kernels) {
    out["kernels"] = measure_kernels(context, footage, options);
  }
  if (options.determinism || !options.reference.empty() || !options.write_reference.empty()) {
    const std::vector<std::vector<float>> first = displacements(context, footage, options);
    if (options.determinism) {
      bool same = true;
      for (int repeat = 1; repeat < kRepeats; ++repeat) {
        same = same && same_bits(first, displacements(context, footage, options));
      }
      fmt::print("{} frames {} times: {}\n", options.frames, kRepeats,
                 same ? "the same bits" : "DIFFERENT BITS");
      out["same_bits"] = same;
      met = met && same;
    }
    if (!options.reference.empty()) {
      out["reference"] = compare(first, footage, options);
      met = met && out["reference"]["met"].get<bool>();
    }
    if (!options.write_reference.empty()) {
      write_reference(first, footage, options);
    }
  }
  if (options.loss) {
    out["loss"] = measure_loss(footage, options);
    met = met && out["loss"]["seen"].get<bool>();
  }
  out["met"] = met;
  if (!options.json_file.empty()) {
    std::ofstream file(options.json_file);
    file << out.dump(2) << '\n';
    if (!file.flush()) {
      throw Error(ErrorKind::Storage, fmt::format("cannot write {}", options.json_file));
    }
  }
  return met;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app(
      "What a refined frame costs on a device, kernel by kernel, and whether it computes what it should");
  app.add_option("--device", options.device, "Vulkan device: auto or part of its name")
      ->capture_default_str();
  app.add_option("--budget", options.budget, "auto, paper or Gauss-Newton steps a level")
      ->check(CLI::IsMember({"auto", "paper"}) | CLI::Range(1, 100))
      ->capture_default_str();
  app.add_option("--width", options.width_px)->check(CLI::Range(64, 8192))->capture_default_str();
  app.add_option("--height", options.height_px)->check(CLI::Range(64, 8192))->capture_default_str();
  app.add_option("--min-edge-px", options.min_edge_px, "of the hierarchy")
      ->check(CLI::Range(0.5, 64.0))
      ->capture_default_str();
  app.add_option("--frames", options.frames)->check(CLI::Range(1, 10'000))->capture_default_str();
  app.add_option("--views", options.views, "further cameras, which see what the first one sees")
      ->check(CLI::Range(0, 8))
      ->capture_default_str();
  app.add_option("--learn", options.learn, "frames before those, in which the albedo is learned")
      ->check(CLI::Range(0, 1000))
      ->capture_default_str();
  app.add_option("--kernel-cache", options.kernel_cache,
                 "folder of the kernels compiled before; empty: none. Run twice: the second start is warm")
      ->capture_default_str();
  app.add_option("--uploads", options.uploads, "memory that the host writes for the device")
      ->check(CLI::IsMember({"auto", "host", "device"}))
      ->capture_default_str();
  app.add_flag("--room-lamps", options.room_lamps, "with the room's lamps, as where the shape is known");
  app.add_flag("--learning", options.learning, "the albedo learns in the measured frames, too");
  app.add_flag("--kernels", options.kernels, "time every kernel on every level, too");
  app.add_flag("--determinism", options.determinism,
               "the same frames three times: exit 1 unless the bits are equal");
  app.add_option(
      "--reference", options.reference,
      "compare with the displacements in this file: exit 1 where they differ by more than --most-rms-mm");
  app.add_option("--most-rms-mm", options.most_rms_mm)->capture_default_str();
  app.add_option("--write-reference", options.write_reference,
                 "leave the displacements in this file, for other devices");
  app.add_flag("--loss", options.loss, "lose the device and open it again");
  app.add_option("--json", options.json_file, "the figures as JSON, to this file");
  CLI11_PARSE(app, argc, argv);
  try {
    return run(options) ? 0 : 1;
  } catch (const Error& error) {
    fmt::print(stderr, "frame_bench: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
}
