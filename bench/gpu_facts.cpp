// What a Vulkan device is and what its parts cost: memory types, limits, queues; a dispatch with its barrier,
// bandwidths, transfers, a submission. The constants that any estimate of a frame's time is made of.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cstring>
#include <fstream>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <numeric>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "gpu/batch.hpp"
#include "gpu/buffer.hpp"
#include "gpu/context.hpp"
#include "gpu/driver_files.hpp"
#include "gpu/facts.hpp"
#include "gpu/kernel.hpp"
#include "gpu_facts_shaders.hpp"
#include "shaders/layout.h"

namespace {

using facet::gpu::Batch;
using facet::gpu::Buffer;
using facet::gpu::Context;
using facet::gpu::Kernel;
using facet::gpu::Memory;
using facet::gpu::TexelFormat;
using facet::gpu::TexelView;
using facet::shaders::gpu_facts::CountPush;
using nlohmann::json;
using Clock = std::chrono::steady_clock;

constexpr double kMega = 1024.0 * 1024.0;
constexpr std::size_t kElementBytes = 16;  // vec4
// Three arrays of it: far beyond a GPU's caches, and within a software device's patience.
constexpr std::size_t kDramBytes = std::size_t{128} << 20U;
constexpr std::size_t kSmallDramBytes = std::size_t{16} << 20U;
constexpr std::size_t kCachedBytes = std::size_t{1} << 20U;

struct Options {
  std::string device = "auto";
  std::string json_file;
  bool small = false;
  bool find = false;
};

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

void run(Context& context, Batch& batch) {
  if (batch.submit() != facet::gpu::Outcome::Done || batch.wait() != facet::gpu::Outcome::Done) {
    throw facet::gpu::DeviceLostError(fmt::format("the device '{}' was lost", context.info().name));
  }
}

/// The shortest of some runs, seconds: on the device's clock where it has one, else on the host's. Short ones
/// are repeated more often, since another program's turn is longer than they are.
double best_seconds(Context& context, Batch& batch) {
  constexpr int kLeast = 3;
  constexpr int kMost = 50;
  constexpr double kEnoughSeconds = 0.05;
  double best = std::numeric_limits<double>::max();
  double all = 0;
  run(context, batch);  // warm
  for (int repeat = 0; repeat < kLeast || (repeat < kMost && all < kEnoughSeconds); ++repeat) {
    const Clock::time_point begin = Clock::now();
    run(context, batch);
    const double host = seconds_since(begin);
    const double device = 1e-3 * static_cast<double>(batch.stage_ms("measured"));
    best = std::min(best, device > 0 ? device : host);
    all += host;
  }
  return best;
}

Kernel kernel(Context& context, const char* name) {
  return {context, facet::shaders::gpu_facts::kernels(), name};
}

Kernel kernel(Context& context, const char* name, std::uint32_t group_size) {
  return {context, facet::shaders::gpu_facts::kernels(), name, {{"local_size_x", group_size}}};
}

/// Microseconds of a dispatch that does nothing: with a barrier before it, and without one.
json launches(Context& context, bool small) {
  const int count = small ? 200 : 1000;
  const Kernel nothing = kernel(context, "nothing");
  std::vector<Buffer> buffers;
  for (int index = 0; index < count; ++index) {
    buffers.emplace_back(context, 256, Memory::Device, "launches");
  }
  json out;
  for (const bool dependent : {true, false}) {
    Batch batch(context, "launches");
    batch.stage("measured");
    for (int index = 0; index < count; ++index) {
      batch.dispatch(nothing, {{"values", buffers[dependent ? 0 : static_cast<std::size_t>(index)]}}, {1},
                     CountPush{0});
    }
    batch.finish();
    out[dependent ? "dispatch_and_barrier_us" : "dispatch_us"] = 1e6 * best_seconds(context, batch) / count;
  }
  return out;
}

/// Arrays for the bandwidths, each `bytes` long.
struct Arrays {
  Arrays(Context& context, std::size_t bytes)
      : count(static_cast<std::uint32_t>(bytes / kElementBytes)),
        a(context, bytes, Memory::Device, "a"),
        b(context, bytes, Memory::Device, "b"),
        sums(context, bytes, Memory::Device, "sums"),
        a_texels(a, TexelFormat::Rgba32f),
        b_texels(b, TexelFormat::Rgba32f) {
    facet::gpu::run_now(context, "zero", [&](Batch& batch) {
      batch.fill(a);
      batch.fill(b);
    });
  }

  std::uint32_t count;
  Buffer a, b, sums;
  TexelView a_texels, b_texels;
};

/// Gigabytes (1e9) a second of what is read and written.
double triad(Context& context, const Arrays& arrays, const char* name, std::uint32_t group_size,
             std::uint32_t groups, int times) {
  const Kernel sum = kernel(context, name, group_size);
  const bool texels = std::strcmp(name, "triad") != 0;
  Batch batch(context, name);
  batch.stage("measured");
  for (int time = 0; time < times; ++time) {
    if (texels) {
      batch.dispatch(sum, {{"a", arrays.a_texels}, {"b", arrays.b_texels}, {"sums", arrays.sums}}, {groups},
                     CountPush{arrays.count});
    } else {
      batch.dispatch(sum, {{"a", arrays.a}, {"b", arrays.b}, {"sums", arrays.sums}}, {groups},
                     CountPush{arrays.count});
    }
  }
  batch.finish();
  const double bytes = 3.0 * static_cast<double>(arrays.count) * kElementBytes * times;
  return 1e-9 * bytes / best_seconds(context, batch);
}

json bandwidths(Context& context, std::size_t bytes, int times, std::uint32_t most_groups) {
  const Arrays arrays(context, bytes);
  json out{{"megabytes_an_array", static_cast<double>(bytes) / kMega}};
  {
    Batch batch(context, "copy");
    batch.stage("measured");
    for (int time = 0; time < times; ++time) {
      batch.copy(arrays.a, arrays.sums);
    }
    batch.finish();
    out["copy_gb_s"] = 2e-9 * static_cast<double>(bytes) * times / best_seconds(context, batch);
  }
  for (const std::uint32_t size : {64U, 128U, 256U}) {
    const std::uint32_t groups = facet::gpu::groups_for(arrays.count, size);
    if (groups > most_groups) {
      continue;
    }
    out[fmt::format("triad_buffers_{}_gb_s", size)] = triad(context, arrays, "triad", size, groups, times);
    out[fmt::format("triad_texels_{}_gb_s", size)] =
        triad(context, arrays, "triad_texels", size, groups, times);
  }
  for (const std::uint32_t groups : {context.info().workgroup_count, 256U, 1024U, 4096U}) {
    out[fmt::format("triad_blocks_of_{}_groups_gb_s", groups)] =
        triad(context, arrays, "triad_blocks", 64, groups, times);
  }
  return out;
}

double host_gb_s(std::size_t bytes, int times, const std::function<void()>& once) {
  double best = std::numeric_limits<double>::max();
  once();
  for (int time = 0; time < times; ++time) {
    const Clock::time_point begin = Clock::now();
    once();
    best = std::min(best, seconds_since(begin));
  }
  return 1e-9 * static_cast<double>(bytes) / best;
}

/// Between host and device: what a picture up and displacements down cost.
json transfers(Context& context, std::size_t bytes) {
  const Buffer up(context, bytes, Memory::Upload, "up");
  const Buffer down(context, bytes, Memory::Readback, "down");
  const Buffer device(context, bytes, Memory::Device, "device");
  std::vector<std::byte> host(bytes);
  json out{{"megabytes", static_cast<double>(bytes) / kMega}};
  out["host_writes_upload_gb_s"] =
      host_gb_s(bytes, 5, [&] { std::memcpy(up.mapped().data(), host.data(), bytes); });
  const auto device_copies = [&](const Buffer& from, const Buffer& to) {
    Batch batch(context, "transfer");
    batch.stage("measured");
    batch.copy(from, to);
    batch.finish();
    return 1e-9 * static_cast<double>(bytes) / best_seconds(context, batch);
  };
  out["up_gb_s"] = device_copies(up, device);
  out["down_gb_s"] = device_copies(device, down);
  out["host_reads_readback_gb_s"] =
      host_gb_s(bytes, 5, [&] { std::memcpy(host.data(), down.mapped().data(), bytes); });
  // A kernel that reads what the host wrote where it lies, as those of the refinement's pictures do.
  const Kernel sum = kernel(context, "triad_texels", 64);
  const TexelView texels(up, TexelFormat::Rgba32f);
  Batch batch(context, "kernel reads upload");
  batch.stage("measured");
  const auto count = static_cast<std::uint32_t>(bytes / kElementBytes);
  batch.dispatch(sum, {{"a", texels}, {"b", texels}, {"sums", device}}, {facet::gpu::groups_for(count, 64)},
                 CountPush{count});
  batch.finish();
  out["kernel_reads_upload_gb_s"] = 1e-9 * static_cast<double>(bytes) / best_seconds(context, batch);
  return out;
}

/// Microseconds on the host from submit to the end of wait, of a batch with one small step.
json submissions(Context& context, bool small) {
  const Buffer word(context, 256, Memory::Device, "word");
  Batch batch(context, "submission");
  batch.fill(word);
  batch.finish();
  run(context, batch);
  std::vector<double> times_us(small ? 50 : 500);
  for (double& time_us : times_us) {
    const Clock::time_point begin = Clock::now();
    run(context, batch);
    time_us = 1e6 * seconds_since(begin);
  }
  std::sort(times_us.begin(), times_us.end());
  return {{"submit_to_fence_us", times_us[times_us.size() / 2]},
          {"submit_to_fence_p99_us", times_us[times_us.size() * 99 / 100]}};
}

json described(Context& context) {
  const facet::gpu::DeviceInfo& info = context.info();
  const facet::gpu::DeviceFacts facts = facet::gpu::device_facts(context);
  json out{{"name", info.name},
           {"driver", info.driver},
           {"kind", facet::gpu::describe(info.type)},
           {"is_software", info.is_software},
           {"vulkan", facts.api_version},
           {"subgroup_size", info.subgroup_size},
           {"subgroup_sizes", {facts.subgroup_size_least, facts.subgroup_size_most}},
           {"workgroup_count", info.workgroup_count},
           {"buffer_alignment_bytes", info.buffer_alignment_bytes},
           {"max_storage_buffer_bytes", info.max_storage_buffer_bytes},
           {"max_texel_buffer_elements", info.max_texel_buffer_elements},
           {"shared_memory_bytes", info.shared_memory_bytes},
           {"max_push_constant_bytes", info.max_push_constant_bytes},
           {"has_float_atomics", info.has_float_atomics},
           {"workgroup_invocations", facts.workgroup_invocations},
           {"workgroups_x", facts.workgroups_x},
           {"storage_buffers_per_stage", facts.storage_buffers_per_stage},
           {"allocations", facts.allocations},
           {"image_px", facts.image_px},
           {"timestamp_ns", facts.timestamp_ns},
           {"heap_bytes", facts.heap_bytes}};
  for (const facet::gpu::DeviceFacts::MemoryType& type : facts.memory_types) {
    out["memory_types"].push_back(
        {{"properties", type.properties}, {"heap", type.heap}, {"used_for", type.used_for}});
  }
  for (const facet::gpu::DeviceFacts::QueueFamily& family : facts.queue_families) {
    out["queue_families"].push_back({{"does", family.does},
                                     {"count", family.count},
                                     {"timestamp_bits", family.timestamp_bits},
                                     {"used", family.used}});
  }
  return out;
}

void print(const json& value, const std::string& name) {
  if (value.is_object()) {
    for (const auto& [key, inner] : value.items()) {
      print(inner, name.empty() ? key : name + "." + key);
    }
  } else if (value.is_array() && !value.empty() && value.front().is_object()) {
    for (std::size_t index = 0; index < value.size(); ++index) {
      fmt::print("{:<44}", fmt::format("{} {}", name, index));
      for (const auto& [key, inner] : value[index].items()) {
        fmt::print(" {}={}", key, inner.is_string() ? inner.get<std::string>() : inner.dump());
      }
      fmt::print("\n");
    }
  } else if (value.is_number_float()) {
    fmt::print("{:<44} {:.4g}\n", name, value.get<double>());
  } else {
    fmt::print("{:<44} {}\n", name, value.is_string() ? value.get<std::string>() : value.dump());
  }
}

/// One line on each device and on each GPU that is none; the status of one who has none.
int find(const Options& options) {
  const std::vector<facet::gpu::DeviceInfo> devices = facet::gpu::list_devices();
  for (const facet::gpu::DeviceInfo& device : devices) {
    fmt::print("{}: {}, {}{}\n", device.name, facet::gpu::describe(device.type), device.driver,
               device.usable ? "" : "; not usable: " + device.why_unusable);
  }
  for (const std::string& lack : facet::gpu::what_gpus_lack(devices)) {
    fmt::print("no Vulkan device: {}\n", lack);
  }
  const Context context({.device = options.device});
  fmt::print("\"{}\" opens {} ({})\n", options.device, context.info().name,
             facet::gpu::describe(context.info().type));
  return 0;
}

int measure(const Options& options) {
  Context context({.device = options.device});
  // A software device's memory is the host's, and slow: what it measures is that the program works.
  const bool small = options.small || context.info().is_software;
  json out;
  out["device"] = described(context);
  const std::uint32_t most_groups = out["device"]["workgroups_x"];
  out["launch"] = launches(context, small);
  out["launch"].update(submissions(context, small));
  out["dram"] = bandwidths(context, small ? kSmallDramBytes : kDramBytes, 1, most_groups);
  out["cache"] = bandwidths(context, kCachedBytes, small ? 4 : 64, most_groups);
  out["transfer"] = transfers(context, small ? std::size_t{4} << 20U : std::size_t{32} << 20U);
  print(out, "");
  if (!options.json_file.empty()) {
    std::ofstream file(options.json_file);
    file << out.dump(2) << '\n';
    if (!file.flush()) {
      throw facet::Error(facet::ErrorKind::Storage, fmt::format("cannot write {}", options.json_file));
    }
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("What a Vulkan device is, and what a dispatch, memory and a submission cost on it");
  app.add_option("--device", options.device, "Vulkan device: auto or part of its name")
      ->capture_default_str();
  app.add_option("--json", options.json_file, "the same as JSON, to this file");
  app.add_flag("--small", options.small, "little memory and few repeats, as on software devices");
  app.add_flag("--find", options.find, "name the devices, and why a GPU is none; measure nothing");
  CLI11_PARSE(app, argc, argv);
  try {
    return options.find ? find(options) : measure(options);
  } catch (const facet::Error& error) {
    fmt::print(stderr, "gpu_facts: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
}
