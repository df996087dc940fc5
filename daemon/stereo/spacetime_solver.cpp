#include "stereo/spacetime_solver.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstring>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "gpu/device_array.hpp"
#include "shaders/stereo/layout.h"
#include "stereo_shaders.hpp"

namespace facet::stereo {
namespace {

constexpr int kSolvePatience = 10;  // times what a frame may take
constexpr std::chrono::milliseconds kAlivePeriod{250};

using shaders::ivec4;
using shaders::stereo::BlockPush;

struct Block {
  std::array<int, 3> origin;
  std::array<int, 3> extent;
};

/// The blocks in the order in which they are solved: those with odd t first [SF04 sec. 2.3.1].
std::vector<Block> blocks_of(const VolumeSize& size, const SpacetimeOptions& options) {
  const std::array<int, 3> whole{size.width_px, size.height_px, size.slots};
  const std::array<int, 3> step{options.block_x, options.block_y, options.block_t};
  std::vector<Block> blocks;
  for (const int parity : {1, 0}) {
    for (int t = parity * step[2]; t < whole[2]; t += 2 * step[2]) {
      for (int y = 0; y < whole[1]; y += step[1]) {
        for (int x = 0; x < whole[0]; x += step[0]) {
          blocks.push_back({{x, y, t},
                            {std::min(step[0], whole[0] - x), std::min(step[1], whole[1] - y),
                             std::min(step[2], whole[2] - t)}});
        }
      }
    }
  }
  return blocks;
}

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
  if (options.block_x < 1 || options.block_y < 1 || options.block_t < 1 || options.steps < 1 ||
      options.cg_iterations < 1) {
    throw Error(ErrorKind::Usage, "stereo blocks, steps and iterations are at least 1");
  }
  if (!(options.damping > 0 && options.noise > 0 && options.straddle_px > 0 && options.most_move_px > 0)) {
    throw Error(ErrorKind::Usage, "stereo's damping, noise, straddle and bound of a move are above 0");
  }
}

/// The least box around a block's unknowns, extent 0 where it has none. What is around it takes no part in a
/// step: no window without a start value, and no boundary value that is not next to an unknown.
Block box_of(const Block& block, const VolumeSize& size, std::span<const float> start_px) {
  std::array<int, 3> least = block.extent;
  std::array<int, 3> past{0, 0, 0};
  for (int t = 0; t < block.extent[2]; ++t) {
    for (int y = 0; y < block.extent[1]; ++y) {
      const float* row =
          start_px.data() + size.voxel(block.origin[0], block.origin[1] + y, block.origin[2] + t);
      const float* end = row + block.extent[0];
      const auto known = [](float px) { return !std::isnan(px); };
      const float* first = std::find_if(row, end, known);
      if (first == end) {
        continue;
      }
      const auto last = std::find_if(std::reverse_iterator(end), std::reverse_iterator(row), known);
      least = {std::min(least[0], static_cast<int>(first - row)), std::min(least[1], y),
               std::min(least[2], t)};
      past = {std::max(past[0], static_cast<int>(last.base() - row)), std::max(past[1], y + 1), t + 1};
    }
  }
  Block box{block.origin, {0, 0, 0}};
  for (std::size_t axis = 0; axis < 3 && past[2] > 0; ++axis) {
    box.origin[axis] += least[axis];
    box.extent[axis] = past[axis] - least[axis];
  }
  return box;
}

std::size_t product(std::array<int, 3> extent, int margin_x, int margin_y, int margin_t) {
  return static_cast<std::size_t>(extent[0] + margin_x) * static_cast<std::size_t>(extent[1] + margin_y) *
         static_cast<std::size_t>(extent[2] + margin_t);
}

}  // namespace

void link_voxels(const VolumeSize& size, std::span<const float> start_px, float break_px,
                 std::span<std::uint32_t> links) {
  const std::array<int, 3> whole{size.width_px, size.height_px, size.slots};
  const std::array<std::size_t, 3> stride{1, static_cast<std::size_t>(size.width_px), size.slot_voxels()};
  // NaN compares false, so that it is linked to nothing.
  const auto linked = [&](std::size_t a, std::size_t b) {
    return std::abs(start_px[a] - start_px[b]) <= break_px;
  };
  std::array<int, 3> at{};
  std::size_t voxel = 0;
  for (at[2] = 0; at[2] < whole[2]; ++at[2]) {
    for (at[1] = 0; at[1] < whole[1]; ++at[1]) {
      for (at[0] = 0; at[0] < whole[0]; ++at[0], ++voxel) {
        std::uint32_t word = 0;
        if (!std::isnan(start_px[voxel])) {
          word = shaders::stereo::kSolved;
          for (std::size_t axis = 0; axis < 3; ++axis) {
            std::uint32_t bits = 0;
            const std::size_t step = stride[axis];
            if (at[axis] > 0 && linked(voxel, voxel - step)) {
              bits |= shaders::stereo::kLinkBefore;
              if (at[axis] > 1 && linked(voxel - step, voxel - 2 * step)) {
                bits |= shaders::stereo::kBeforeHasBefore;
              }
            }
            if (at[axis] + 1 < whole[axis] && linked(voxel, voxel + step)) {
              bits |= shaders::stereo::kLinkAfter;
              if (at[axis] + 2 < whole[axis] && linked(voxel + step, voxel + 2 * step)) {
                bits |= shaders::stereo::kAfterHasAfter;
              }
            }
            word |= bits << (1 + 4 * axis);
          }
        }
        links[voxel] = word;
      }
    }
  }
}

struct SpacetimeSolver::Impl {
  Impl(gpu::Context& context, const VolumeSize& whole, const SpacetimeOptions& chosen);

  void record_block(std::size_t block, std::uint32_t energy_slot);
  void record_windows(const BlockPush& push);
  BlockPush push_of(std::size_t block) const;

  VolumeSize size;
  SpacetimeOptions options;
  std::vector<Block> blocks;
  std::array<int, 3> largest;  ///< block
  gpu::Groups groups;
  int rx, ry, rt;
  std::chrono::milliseconds patience;

  std::vector<gpu::Constant> windows;
  gpu::Kernel warp, sums_x_kernel, sums_y_kernel, normal_equations, gradient, direction, update, local_step,
      quality;

  gpu::DeviceArray left, right, disparities, links;
  gpu::DeviceArray samples, sums_x, sums_xy, hessians, gradients, solver_states, searches, products, sums;
  gpu::Buffer boxes;
  gpu::Buffer start, start_links, start_boxes, found, qualities, energies;
  gpu::Batch batch;
};

SpacetimeSolver::Impl::Impl(gpu::Context& context, const VolumeSize& whole, const SpacetimeOptions& chosen)
    : size(whole),
      options((check(whole, chosen), chosen)),
      blocks(blocks_of(whole, chosen)),
      largest{std::min(chosen.block_x, whole.width_px), std::min(chosen.block_y, whole.height_px),
              std::min(chosen.block_t, whole.slots)},
      groups{context.info().workgroup_count},
      rx(chosen.window_x / 2),
      ry(chosen.window_y / 2),
      rt(chosen.window_t / 2),
      patience(kSolvePatience * context.info().patience),
      windows{{"radius_x", rx}, {"radius_y", ry}, {"radius_t", rt}},
      warp(context, shaders::stereo::kernels(), "stereo/warp", windows),
      sums_x_kernel(context, shaders::stereo::kernels(), "stereo/sums_x", windows),
      sums_y_kernel(context, shaders::stereo::kernels(), "stereo/sums_y", std::span(windows).subspan(1)),
      normal_equations(context, shaders::stereo::kernels(), "stereo/normal_equations", windows),
      gradient(context, shaders::stereo::kernels(), "stereo/gradient"),
      direction(context, shaders::stereo::kernels(), "stereo/direction"),
      update(context, shaders::stereo::kernels(), "stereo/update"),
      local_step(context, shaders::stereo::kernels(), "stereo/local_step"),
      quality(context, shaders::stereo::kernels(), "stereo/quality", windows),
      left(context, whole.voxels(), gpu::TexelFormat::R32f, "left"),
      right(context, whole.voxels(), gpu::TexelFormat::R32f, "right"),
      disparities(context, whole.voxels(), gpu::TexelFormat::R32f, "disparities"),
      links(context, whole.voxels(), gpu::TexelFormat::R32u, "links"),
      samples(context, product(largest, 2 + 2 * rx, 2 + 2 * ry, 2 + 2 * rt), gpu::TexelFormat::Rgba32f,
              "samples"),
      sums_x(context, 5 * product(largest, 2, 2 + 2 * ry, 2 + 2 * rt), gpu::TexelFormat::Rgba32f, "sums_x"),
      sums_xy(context, 7 * product(largest, 2, 2, 2 + 2 * rt), gpu::TexelFormat::Rgba32f, "sums_xy"),
      hessians(context, 3 * product(largest, 2, 2, 2), gpu::TexelFormat::Rgba32f, "hessians"),
      gradients(context, product(largest, 2, 2, 2), gpu::TexelFormat::Rgba32f, "gradients"),
      solver_states(context, product(largest, 0, 0, 0), gpu::TexelFormat::Rgba32f, "solver_states"),
      searches(context, product(largest, 4, 4, 4), gpu::TexelFormat::Rg32f, "searches"),
      products(context, product(largest, 2, 2, 2), gpu::TexelFormat::Rgba32f, "products"),
      sums(context, static_cast<std::size_t>(2 * chosen.cg_iterations + 1) * groups.x, gpu::TexelFormat::R32f,
           "sums"),
      boxes(context, blocks.size() * 2 * sizeof(ivec4), gpu::Memory::Device, "boxes"),
      start(context, whole.voxels() * sizeof(float), gpu::Memory::Upload, "start"),
      start_links(context, whole.voxels() * sizeof(std::uint32_t), gpu::Memory::Upload, "start_links"),
      start_boxes(context, blocks.size() * 2 * sizeof(ivec4), gpu::Memory::Upload, "start_boxes"),
      found(context, whole.voxels() * sizeof(float), gpu::Memory::Readback, "found"),
      qualities(context, whole.voxels() * 2 * sizeof(float), gpu::Memory::Readback, "qualities"),
      energies(context, blocks.size() * static_cast<std::size_t>(chosen.steps) * groups.x * sizeof(float),
               gpu::Memory::Readback, "energies"),
      batch(context, "spacetime stereo") {
  // Windows in slots that the volume does not have, and outside a block's box, are read with the weight 0 and
  // not written.
  gpu::clear(context, {&hessians.buffer, &gradients.buffer, &products.buffer});
  batch.stage("start");
  batch.copy(start, disparities.buffer);
  batch.copy(start_links, links.buffer);
  batch.copy(start_boxes, boxes);
  std::uint32_t slot = 0;
  batch.stage("solve");
  for (int step = 0; step < options.steps; ++step) {
    for (std::size_t block = 0; block < blocks.size(); ++block) {
      record_block(block, slot++);
    }
  }
  batch.stage("quality");
  for (std::size_t block = 0; block < blocks.size(); ++block) {
    const BlockPush push = push_of(block);
    record_windows(push);
    batch.dispatch(quality,
                   {{"boxes", boxes},
                    {"sums_xy", sums_xy.view},
                    {"disparities", disparities.view},
                    {"links", links.view},
                    {"qualities", qualities}},
                   groups, push);
  }
  batch.copy(disparities.buffer, found);
  batch.finish();
}

BlockPush SpacetimeSolver::Impl::push_of(std::size_t block) const {
  BlockPush push{};
  push.volume = ivec4{size.width_px, size.height_px, size.slots, 0};
  push.block = static_cast<std::uint32_t>(block);
  push.damping = options.damping;
  push.most_move_px = options.most_move_px;
  push.noise = options.noise;
  push.straddle_px = options.straddle_px;
  push.least_texture = options.least_texture;
  return push;
}

void SpacetimeSolver::Impl::record_windows(const BlockPush& push) {
  batch.dispatch(warp,
                 {{"boxes", boxes},
                  {"left", left.view},
                  {"right", right.view},
                  {"disparities", disparities.view},
                  {"links", links.view},
                  {"samples", samples.buffer}},
                 groups, push);
  batch.dispatch(sums_x_kernel, {{"boxes", boxes}, {"samples", samples.view}, {"sums_x", sums_x.buffer}},
                 groups, push);
  batch.dispatch(sums_y_kernel, {{"boxes", boxes}, {"sums_x", sums_x.view}, {"sums_xy", sums_xy.buffer}},
                 groups, push);
}

void SpacetimeSolver::Impl::record_block(std::size_t block, std::uint32_t energy_slot) {
  BlockPush push = push_of(block);
  push.energy_slot = energy_slot;
  record_windows(push);
  batch.dispatch(normal_equations,
                 {{"boxes", boxes},
                  {"sums_xy", sums_xy.view},
                  {"disparities", disparities.view},
                  {"links", links.view},
                  {"hessians", hessians.buffer},
                  {"gradients", gradients.buffer},
                  {"energies", energies}},
                 groups, push);
  if (options.method == SpacetimeMethod::Local) {
    batch.dispatch(local_step,
                   {{"boxes", boxes},
                    {"hessians", hessians.view},
                    {"gradients", gradients.view},
                    {"links", links.view},
                    {"disparities", disparities.buffer}},
                   groups, push);
    return;
  }
  batch.dispatch(gradient,
                 {{"boxes", boxes},
                  {"hessians", hessians.view},
                  {"gradients", gradients.view},
                  {"links", links.view},
                  {"solver_states", solver_states.buffer},
                  {"searches", searches.buffer},
                  {"sums", sums.buffer}},
                 groups, push);
  for (int iteration = 0; iteration < options.cg_iterations; ++iteration) {
    push.iteration = static_cast<std::uint32_t>(iteration);
    push.last = iteration + 1 == options.cg_iterations ? 1 : 0;
    batch.dispatch(direction,
                   {{"boxes", boxes},
                    {"hessians", hessians.view},
                    {"links", links.view},
                    {"searches", searches.view},
                    {"products", products.buffer},
                    {"sums", sums.buffer}},
                   groups, push);
    batch.dispatch(update,
                   {{"boxes", boxes},
                    {"products", products.view},
                    {"links", links.view},
                    {"solver_states", solver_states.buffer},
                    {"searches", searches.buffer},
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
  const std::span<float> start = impl.start.mapped_as<float>();
  std::transform(start_px.begin(), start_px.end(), start.begin(),
                 [](float d) { return std::isnan(d) ? 0 : d; });
  link_voxels(impl.size, start_px, impl.options.break_px, impl.start_links.mapped_as<std::uint32_t>());
  const auto boxes = impl.start_boxes.mapped_as<ivec4>();
  for (std::size_t block = 0; block < impl.blocks.size(); ++block) {
    const Block box = box_of(impl.blocks[block], impl.size, start_px);
    boxes[2 * block] = {box.origin[0], box.origin[1], box.origin[2], 0};
    boxes[2 * block + 1] = {box.extent[0], box.extent[1], box.extent[2], 0};
  }
  out.failure.clear();
  out.outcome = StereoOutcome::Done;
  out.disparity_px.resize(count);
  out.sigma_px.resize(count);
  out.correlation.resize(count);
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
  std::memcpy(out.disparity_px.data(), impl.found.mapped().data(), count * sizeof(float));
  const auto qualities = impl.qualities.mapped_as<float>();
  bool finite = true;
  for (std::size_t voxel = 0; voxel < count; ++voxel) {
    const bool solved = !std::isnan(start_px[voxel]);  // the kernel leaves out what lies around a box
    out.sigma_px[voxel] = solved ? qualities[2 * voxel] : 0;
    out.correlation[voxel] = solved ? qualities[2 * voxel + 1] : 0;
    finite = finite && std::isfinite(out.disparity_px[voxel]) && std::isfinite(out.sigma_px[voxel]);
  }
  out.energies.assign(static_cast<std::size_t>(impl.options.steps), 0);
  const auto parts = impl.energies.mapped_as<float>();
  const std::size_t per_step = impl.blocks.size() * impl.groups.x;
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

std::span<const gpu::StageTime> SpacetimeSolver::stage_times() const {
  return impl_->batch.stage_times();
}

}  // namespace facet::stereo
