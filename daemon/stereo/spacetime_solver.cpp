#include "stereo/spacetime_solver.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "gpu/device_array.hpp"
#include "shaders/stereo/layout.h"
#include "stereo/unknowns.hpp"
#include "stereo_shaders.hpp"

namespace facet::stereo {
namespace {

constexpr int kSolvePatience = 10;  // times what a frame may take
constexpr std::chrono::milliseconds kAlivePeriod{250};

using shaders::ivec4;
using shaders::stereo::Band;
using shaders::stereo::kNoDisparity;
using shaders::stereo::SolvePush;

constexpr int kBandRows = 32;
constexpr std::size_t kVec4Bytes = 4 * sizeof(float);
constexpr std::size_t kSumsX = 5;   // vec4 a voxel
constexpr std::size_t kSumsXY = 7;  // the same
// What the sums along x and y of one part may take.
constexpr std::size_t kPartBytes = std::size_t{256} << 20U;

void check(const VolumeSize& size, const SpacetimeOptions& options) {
  if (size.width_px < 1 || size.height_px < 1 || size.slots < 1) {
    throw Error(ErrorKind::Usage, fmt::format("a stereo volume of {} x {} x {} has no voxels", size.width_px,
                                              size.height_px, size.slots));
  }
  for (const int window : {options.window_x, options.window_y, options.window_t}) {
    if (window < 1 || window % 2 == 0) {
      throw Error(ErrorKind::Usage, fmt::format("stereo windows have odd sizes, not {} x {} x {}",
                                                options.window_x, options.window_y, options.window_t));
    }
  }
  if (options.steps < 1 || options.cg_iterations < 1) {
    throw Error(ErrorKind::Usage, "stereo's steps and iterations are at least 1");
  }
  if (!(options.damping > 0 && options.noise > 0 && options.straddle_px > 0 && options.most_move_px > 0)) {
    throw Error(ErrorKind::Usage, "stereo's damping, noise, straddle and bound of a move are above 0");
  }
}

/// Rows of a band: as few as its sums' array can hold, should all of it be unknown.
int band_rows(const VolumeSize& size, std::size_t most_bytes) {
  const std::size_t row_bytes =
      kSumsXY * kVec4Bytes * static_cast<std::size_t>(size.width_px) * static_cast<std::size_t>(size.slots);
  return static_cast<int>(std::clamp<std::size_t>(most_bytes / row_bytes, 1, kBandRows));
}

/// Everything over unknowns, and the sums of a part's windows.
struct Arrays {
  Arrays(gpu::Context& context, std::size_t unknown_count, std::size_t sample_count, std::size_t sums_x_count,
         std::size_t sums_xy_count)
      : start_list(context, unknown_count * sizeof(ivec4), gpu::Memory::Upload, "start_list"),
        found(context, unknown_count * kVec4Bytes, gpu::Memory::Readback, "found"),
        list(context, unknown_count, gpu::TexelFormat::Rgba32i, "unknowns"),
        first_rows(context, unknown_count, gpu::TexelFormat::Rgba32f, "first_rows"),
        second_rows(context, unknown_count, gpu::TexelFormat::Rgba32f, "second_rows"),
        third_rows(context, unknown_count, gpu::TexelFormat::Rg32f, "third_rows"),
        gradients(context, unknown_count, gpu::TexelFormat::Rgba32f, "gradients"),
        inverses(context, unknown_count, gpu::TexelFormat::R32f, "inverses"),
        products(context, unknown_count, gpu::TexelFormat::Rgba32f, "products"),
        solver_states{{{context, unknown_count, gpu::TexelFormat::Rg32f, "solver_states"},
                       {context, unknown_count, gpu::TexelFormat::Rg32f, "solver_states"}}},
        searches{{{context, unknown_count, gpu::TexelFormat::Rg32f, "searches"},
                  {context, unknown_count, gpu::TexelFormat::Rg32f, "searches"}}},
        samples(context, sample_count, gpu::TexelFormat::Rgba32f, "samples"),
        sums_x(context, kSumsX * sums_x_count, gpu::TexelFormat::Rgba32f, "sums_x"),
        sums_xy(context, kSumsXY * sums_xy_count, gpu::TexelFormat::Rgba32f, "sums_xy") {}

  gpu::Buffer start_list, found;
  gpu::DeviceArray list;
  gpu::DeviceArray first_rows, second_rows, third_rows, gradients, inverses, products;
  std::array<gpu::DeviceArray, 2> solver_states, searches;  ///< an iteration reads one and writes the other
  gpu::DeviceArray samples, sums_x, sums_xy;
};

}  // namespace

struct SpacetimeSolver::Impl {
  Impl(gpu::Context& context, const VolumeSize& whole, const SpacetimeOptions& chosen);

  std::string prepare();
  void record();
  void record_windows(const SolvePush& push);
  void record_step(SolvePush push);

  gpu::Context& context;
  VolumeSize size;
  SpacetimeOptions options;
  gpu::Groups groups;
  std::size_t most_bytes;  ///< of an array
  int rx, ry, rt;
  Unknowns unknowns;
  std::size_t most_cells;  ///< of a part's boxes
  gpu::Groups band_groups;
  std::chrono::milliseconds patience;

  std::vector<gpu::Constant> windows;
  gpu::Kernel warp, sums_x_kernel, sums_y_kernel, normal_equations, gradient, direction, update, local_step,
      quality;

  gpu::DeviceArray left, right, disparities, sums;
  gpu::Buffer bands, count, start, start_bands, start_count, energies;
  std::optional<Arrays> arrays;
  std::size_t unknown_room = 0, sample_room = 0, sums_x_room = 0, sums_xy_room = 0;
  int recorded_parts = 0;
  gpu::Batch batch;
};

SpacetimeSolver::Impl::Impl(gpu::Context& device, const VolumeSize& whole, const SpacetimeOptions& chosen)
    : context(device),
      size(whole),
      options((check(whole, chosen), chosen)),
      groups{context.info().workgroup_count},
      most_bytes(std::min(context.info().max_storage_buffer_bytes,
                          kVec4Bytes * context.info().max_texel_buffer_elements)),
      rx(chosen.window_x / 2),
      ry(chosen.window_y / 2),
      rt(chosen.window_t / 2),
      unknowns(whole, rx, ry, rt, band_rows(whole, most_bytes)),
      most_cells(std::min(most_bytes, chosen.part_bytes > 0 ? chosen.part_bytes : kPartBytes) /
                 (kSumsXY * kVec4Bytes)),
      band_groups{std::max(4U, groups.x / 4), static_cast<std::uint32_t>(unknowns.bands().size())},
      patience(kSolvePatience * context.info().patience),
      windows{{"radius_x", rx}, {"radius_y", ry}, {"radius_t", rt}},
      warp(context, shaders::stereo::kernels(), "stereo/warp", std::span(windows).first(2)),
      sums_x_kernel(context, shaders::stereo::kernels(), "stereo/sums_x", std::span(windows).first(2)),
      sums_y_kernel(context, shaders::stereo::kernels(), "stereo/sums_y", std::span(windows).subspan(1, 1)),
      normal_equations(context, shaders::stereo::kernels(), "stereo/normal_equations", windows),
      gradient(context, shaders::stereo::kernels(), "stereo/gradient"),
      direction(context, shaders::stereo::kernels(), "stereo/direction"),
      update(context, shaders::stereo::kernels(), "stereo/update"),
      local_step(context, shaders::stereo::kernels(), "stereo/local_step"),
      quality(context, shaders::stereo::kernels(), "stereo/quality", windows),
      left(context, whole.voxels(), gpu::TexelFormat::R32f, "left"),
      right(context, whole.voxels(), gpu::TexelFormat::R32f, "right"),
      disparities(context, whole.voxels(), gpu::TexelFormat::R32f, "disparities"),
      sums(context, static_cast<std::size_t>(2 * chosen.cg_iterations + 1) * groups.x, gpu::TexelFormat::R32f,
           "sums"),
      bands(context, unknowns.bands().size_bytes(), gpu::Memory::Device, "bands"),
      count(context, sizeof(std::int32_t), gpu::Memory::Device, "count"),
      start(context, whole.voxels() * sizeof(float), gpu::Memory::Upload, "start"),
      start_bands(context, unknowns.bands().size_bytes(), gpu::Memory::Upload, "start_bands"),
      start_count(context, sizeof(std::int32_t), gpu::Memory::Upload, "start_count"),
      energies(context,
               static_cast<std::size_t>(chosen.steps) * band_groups.x * band_groups.y * sizeof(float),
               gpu::Memory::Readback, "energies"),
      batch(context, "spacetime stereo") {}

/// Room for what was found in the start values, and the work recorded. What is wrong, for people; empty where
/// all is well.
std::string SpacetimeSolver::Impl::prepare() {
  const auto grow = [](std::size_t& room, std::size_t needed) {
    const bool grows = needed > room;
    room = grows ? needed + needed / 4 : room;
    return grows;
  };
  const std::size_t most = most_bytes / kVec4Bytes;
  if (unknowns.count() > most) {
    return fmt::format("{} unknown disparities, and the device's arrays hold {}", unknowns.count(), most);
  }
  const std::size_t places =
      std::max({unknowns.most_samples(), unknowns.most_sums_x() * kSumsX, unknowns.most_sums_xy() * kSumsXY});
  if (places > most) {
    return fmt::format("a band of the volume needs {} places, and the device's arrays hold {}", places, most);
  }
  bool grows = grow(unknown_room, std::max<std::size_t>(unknowns.count(), 1));
  grows = grow(sample_room, std::max<std::size_t>(unknowns.most_samples(), 1)) || grows;
  grows = grow(sums_x_room, std::max<std::size_t>(unknowns.most_sums_x(), 1)) || grows;
  grows = grow(sums_xy_room, std::max<std::size_t>(unknowns.most_sums_xy(), 1)) || grows;
  if (grows || !arrays) {
    batch.reset();
    recorded_parts = 0;
    arrays.reset();
    unknown_room = std::min(unknown_room, most);
    sample_room = std::min(sample_room, most);
    sums_x_room = std::min(sums_x_room, most / kSumsX);
    sums_xy_room = std::min(sums_xy_room, most / kSumsXY);
    arrays.emplace(context, unknown_room, sample_room, sums_x_room, sums_xy_room);
  }
  if (recorded_parts != unknowns.part_count()) {
    batch.reset();
    recorded_parts = 0;
    record();
    recorded_parts = unknowns.part_count();
  }
  return {};
}

void SpacetimeSolver::Impl::record() {
  batch.stage("start");
  batch.copy(start, disparities.buffer);
  batch.copy(arrays->start_list, arrays->list.buffer);
  batch.copy(start_bands, bands);
  batch.copy(start_count, count);
  SolvePush push{};
  push.volume = ivec4{size.width_px, size.height_px, size.slots, 0};
  push.damping = options.damping;
  push.most_move_px = options.most_move_px;
  push.noise = options.noise;
  push.straddle_px = options.straddle_px;
  push.least_texture = options.least_texture;
  batch.stage("solve");
  for (int step = 0; step < options.steps; ++step) {
    push.step = static_cast<std::uint32_t>(step);
    record_step(push);
  }
  batch.stage("quality");
  for (int part = 0; part < unknowns.part_count(); ++part) {
    push.part = static_cast<std::uint32_t>(part);
    record_windows(push);
    batch.dispatch(quality,
                   {{"bands", bands},
                    {"unknowns", arrays->list.view},
                    {"sums_xy", arrays->sums_xy.view},
                    {"disparities", disparities.view},
                    {"found", arrays->found}},
                   band_groups, push);
  }
  batch.finish();
}

void SpacetimeSolver::Impl::record_windows(const SolvePush& push) {
  batch.dispatch(warp,
                 {{"bands", bands},
                  {"left", left.view},
                  {"right", right.view},
                  {"disparities", disparities.view},
                  {"samples", arrays->samples.buffer}},
                 band_groups, push);
  batch.dispatch(sums_x_kernel,
                 {{"bands", bands}, {"samples", arrays->samples.view}, {"sums_x", arrays->sums_x.buffer}},
                 band_groups, push);
  batch.dispatch(sums_y_kernel,
                 {{"bands", bands}, {"sums_x", arrays->sums_x.view}, {"sums_xy", arrays->sums_xy.buffer}},
                 band_groups, push);
}

void SpacetimeSolver::Impl::record_step(SolvePush push) {
  for (int part = 0; part < unknowns.part_count(); ++part) {
    push.part = static_cast<std::uint32_t>(part);
    record_windows(push);
    batch.dispatch(normal_equations,
                   {{"bands", bands},
                    {"unknowns", arrays->list.view},
                    {"sums_xy", arrays->sums_xy.view},
                    {"disparities", disparities.view},
                    {"first_rows", arrays->first_rows.buffer},
                    {"second_rows", arrays->second_rows.buffer},
                    {"third_rows", arrays->third_rows.buffer},
                    {"gradients", arrays->gradients.buffer},
                    {"energies", energies}},
                   band_groups, push);
  }
  if (options.method == SpacetimeMethod::Local) {
    batch.dispatch(local_step,
                   {{"unknown_count", count},
                    {"unknowns", arrays->list.view},
                    {"first_rows", arrays->first_rows.view},
                    {"second_rows", arrays->second_rows.view},
                    {"third_rows", arrays->third_rows.view},
                    {"gradients", arrays->gradients.view},
                    {"disparities", disparities.buffer}},
                   groups, push);
    return;
  }
  batch.dispatch(gradient,
                 {{"unknown_count", count},
                  {"unknowns", arrays->list.view},
                  {"first_rows", arrays->first_rows.view},
                  {"second_rows", arrays->second_rows.view},
                  {"third_rows", arrays->third_rows.view},
                  {"gradients", arrays->gradients.view},
                  {"inverses", arrays->inverses.buffer},
                  {"solver_states", arrays->solver_states[0].buffer},
                  {"searches", arrays->searches[0].buffer},
                  {"sums", sums.buffer}},
                 groups, push);
  for (int iteration = 0; iteration < options.cg_iterations; ++iteration) {
    push.iteration = static_cast<std::uint32_t>(iteration);
    const auto now = static_cast<std::size_t>(iteration % 2);
    push.last = iteration + 1 == options.cg_iterations ? 1 : 0;
    batch.dispatch(direction,
                   {{"unknown_count", count},
                    {"unknowns", arrays->list.view},
                    {"first_rows", arrays->first_rows.view},
                    {"second_rows", arrays->second_rows.view},
                    {"third_rows", arrays->third_rows.view},
                    {"searches", arrays->searches[now].view},
                    {"products", arrays->products.buffer},
                    {"sums", sums.buffer}},
                   groups, push);
    batch.dispatch(update,
                   {{"unknown_count", count},
                    {"unknowns", arrays->list.view},
                    {"products", arrays->products.view},
                    {"inverses", arrays->inverses.view},
                    {"solver_states", arrays->solver_states[now].view},
                    {"searches", arrays->searches[now].view},
                    {"next_states", arrays->solver_states[1 - now].buffer},
                    {"next_searches", arrays->searches[1 - now].buffer},
                    {"disparities", disparities.buffer},
                    {"sums", sums.buffer}},
                   groups, push);
  }
}

SpacetimeSolver::SpacetimeSolver(gpu::Context& context, const VolumeSize& size,
                                 const SpacetimeOptions& options)
    : impl_(std::make_unique<Impl>(context, size, options)) {}
SpacetimeSolver::~SpacetimeSolver() = default;

const VolumeSize& SpacetimeSolver::size() const {
  return impl_->size;
}
const gpu::Buffer& SpacetimeSolver::left() const {
  return impl_->left.buffer;
}
const gpu::Buffer& SpacetimeSolver::right() const {
  return impl_->right.buffer;
}

void SpacetimeSolver::solve(std::span<const float> start_px, DisparityField& out, const Alive& alive) {
  Impl& impl = *impl_;
  const std::size_t count = impl.size.voxels();
  if (start_px.size() != count) {
    throw Error(ErrorKind::Usage,
                fmt::format("{} start values for a stereo volume of {} voxels", start_px.size(), count));
  }
  out.failure.clear();
  out.outcome = StereoOutcome::Done;
  out.disparity_px.assign(count, 0);
  out.sigma_px.assign(count, 0);
  out.correlation.assign(count, 0);
  out.energies.assign(static_cast<std::size_t>(impl.options.steps), 0);
  impl.unknowns.find(start_px, impl.options.break_px, impl.most_cells);
  StereoOutcome unprepared = StereoOutcome::NumericalFailure;
  try {
    out.failure = impl.prepare();
  } catch (const Error& error) {
    if (error.kind() != ErrorKind::NoDevice) {
      throw;
    }
    out.failure = error.what();
    unprepared = StereoOutcome::DeviceLost;
  }
  if (!out.failure.empty()) {
    out.outcome = unprepared;
    return;
  }
  std::transform(start_px.begin(), start_px.end(), impl.start.mapped_as<float>().begin(),
                 [](float d) { return std::isnan(d) ? kNoDisparity : d; });
  std::ranges::copy(impl.unknowns.list(), impl.arrays->start_list.mapped_as<ivec4>().begin());
  std::ranges::copy(impl.unknowns.bands(), impl.start_bands.mapped_as<Band>().begin());
  impl.start_count.mapped_as<std::int32_t>()[0] = static_cast<std::int32_t>(impl.unknowns.count());
  gpu::Outcome outcome = impl.batch.submit();
  if (outcome == gpu::Outcome::Done) {
    const auto end = Clock::now() + impl.patience;
    do {
      alive();
      outcome = impl.batch.wait(kAlivePeriod);
    } while (outcome == gpu::Outcome::TimedOut && Clock::now() < end);
    if (outcome == gpu::Outcome::TimedOut) {
      impl.batch.give_up();
    }
  }
  if (outcome != gpu::Outcome::Done) {
    out.outcome = StereoOutcome::DeviceLost;
    out.failure = "the GPU was lost during the stereo solve";
    return;
  }
  const auto found = impl.arrays->found.mapped_as<shaders::vec4>();
  const std::span<const std::uint32_t> voxels = impl.unknowns.voxels();
  bool finite = true;
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    out.disparity_px[voxels[i]] = found[i].x;
    out.sigma_px[voxels[i]] = found[i].y;
    out.correlation[voxels[i]] = found[i].z;
    finite = finite && std::isfinite(found[i].x) && std::isfinite(found[i].y);
  }
  const auto parts = impl.energies.mapped_as<float>();
  const std::size_t per_step = parts.size() / out.energies.size();
  for (std::size_t step = 0; step < out.energies.size(); ++step) {
    for (std::size_t part = 0; part < per_step; ++part) {
      out.energies[step] += static_cast<double>(parts[step * per_step + part]);
    }
    finite = finite && std::isfinite(out.energies[step]);
  }
  if (!finite) {
    out.outcome = StereoOutcome::NumericalFailure;
    out.failure =
        fmt::format("the stereo solve left finite numbers; energy {} at its start, {} before its last step",
                    out.energies.front(), out.energies.back());
  }
}

std::size_t SpacetimeSolver::dispatch_count() const {
  return impl_->batch.counts().dispatches;
}

std::span<const gpu::StageTime> SpacetimeSolver::stage_times() const {
  return impl_->batch.stage_times();
}

}  // namespace facet::stereo
