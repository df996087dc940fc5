#include "stereo/stereo_matcher.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <limits>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "gpu/device_array.hpp"
#include "shaders/stereo/layout.h"
#include "stereo/islands.hpp"
#include "stereo_shaders.hpp"

namespace facet::stereo {
namespace {

using shaders::stereo::RectifyPush;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Two left pixels that land on one right pixel: the farther one is hidden there if it is farther by more than
// this.
constexpr float kHidden_px = 1.5F;

/// One camera's pictures on their way into a volume.
struct View {
  View(gpu::Context& context, const capture::Lens& camera, const std::vector<Eigen::Vector2f>& from,
       const gpu::Buffer& volume, int slots, std::string_view name)
      : width_px(camera.width_px),
        height_px(camera.height_px),
        sources(context, from.size(), gpu::TexelFormat::Rg32f, name),
        readback(context, volume.size_bytes(), gpu::Memory::Readback, name) {
    gpu::upload(context, sources.buffer, std::as_bytes(std::span(from)));
    for (int slot = 0; slot < slots; ++slot) {
      pictures.emplace_back(context, static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px),
                            gpu::TexelFormat::Rgba8, name, gpu::Memory::Upload);
    }
  }

  /// False for what cannot be used.
  bool load(const Frame& frame, std::size_t slot) {
    const std::span<std::byte> to = pictures[slot].buffer.mapped();
    if (frame.empty() || frame.corrupt || frame.width_px != width_px || frame.height_px != height_px) {
      return false;
    }
    const std::size_t row_bytes = 4 * static_cast<std::size_t>(width_px);
    for (int y = 0; y < height_px; ++y) {
      std::memcpy(to.data() + static_cast<std::size_t>(y) * row_bytes, frame.row(y), row_bytes);
    }
    return true;
  }

  int width_px;
  int height_px;
  gpu::DeviceArray sources;
  gpu::Buffer readback;
  std::vector<gpu::DeviceArray> pictures;  ///< [slots]
};

StereoOptions completed(StereoOptions options, const capture::Rig& rig, const capture::StereoPair& pair) {
  if (pair.left < rig.cameras.size()) {
    const capture::Lens& lens = rig.cameras[pair.left].lens;
    options.width_px = options.width_px > 0 ? options.width_px : lens.width_px;
    options.height_px = options.height_px > 0 ? options.height_px : lens.height_px;
  }
  return options;
}

}  // namespace

struct StereoMatcher::Impl {
  Impl(gpu::Context& context, const capture::Rig& rig, const capture::StereoPair& pair,
       const StereoOptions& chosen);

  gpu::Outcome rectify(std::span<const StereoSlot> slots);
  void find_start(std::span<const StereoSlot> slots, const Alive& alive);
  void finish(std::size_t slot, capture::DepthMap& map);
  void drop_hidden(std::span<const float> disparity_px, std::span<float> depth_mm);

  StereoOptions options;
  Rectification rectification;
  SpacetimeSolver solver;
  StartValue start_value;
  gpu::Kernel rectify_kernel;
  View left, right;
  gpu::Buffer usable;  ///< [slots] 1 where both pictures are there and show a pattern
  gpu::Batch batch;

  std::vector<float> left_grey, right_grey, start_px;
  DisparityField field;
  std::vector<float> nearest;  ///< [width] of a row of the right picture
  Islands islands;
  std::string failure;
  StereoTimes times;
};

StereoMatcher::Impl::Impl(gpu::Context& context, const capture::Rig& rig, const capture::StereoPair& pair,
                          const StereoOptions& chosen)
    : options(completed(chosen, rig, pair)),
      rectification(rig, pair, options.depths, options.width_px, options.height_px),
      solver(context, {options.width_px, options.height_px, options.most_slots}, options.spacetime),
      start_value(options.width_px, options.height_px, rectification.least_disparity_px(),
                  rectification.most_disparity_px(), options.start),
      rectify_kernel(context, shaders::stereo::kernels(), "stereo/rectify"),
      left(context, rig.cameras[pair.left].lens, rectification.left_sources(), solver.left(),
           options.most_slots, "left pictures"),
      right(context, rig.cameras[pair.right].lens, rectification.right_sources(), solver.right(),
            options.most_slots, "right pictures"),
      usable(context, static_cast<std::size_t>(options.most_slots) * sizeof(float), gpu::Memory::Upload,
             "usable"),
      batch(context, "rectification"),
      islands(options.width_px, options.height_px) {
  const VolumeSize& size = solver.size();
  left_grey.resize(size.voxels());
  right_grey.resize(size.voxels());
  start_px.resize(size.voxels());
  nearest.resize(static_cast<std::size_t>(size.width_px));
  batch.stage("rectify");
  const auto record = [&](const View& view, const gpu::Buffer& volume) {
    for (int slot = 0; slot < size.slots; ++slot) {
      RectifyPush push{};
      push.size = {view.width_px, view.height_px, size.width_px, size.height_px};
      push.slot = slot;
      push.saturated = options.saturated;
      batch.dispatch(rectify_kernel,
                     {{"picture", view.pictures[static_cast<std::size_t>(slot)].view},
                      {"sources", view.sources.view},
                      {"usable", usable},
                      {"grey", volume}},
                     {context.info().workgroup_count}, push);
    }
    batch.copy(volume, view.readback);
  };
  record(left, solver.left());
  record(right, solver.right());
  batch.finish();
}

gpu::Outcome StereoMatcher::Impl::rectify(std::span<const StereoSlot> slots) {
  const std::span<float> flags = usable.mapped_as<float>();
  std::fill(flags.begin(), flags.end(), 0.0F);
  for (std::size_t slot = 0; slot < slots.size(); ++slot) {
    const bool has_left = left.load(slots[slot].left, slot);
    const bool has_right = right.load(slots[slot].right, slot);
    flags[slot] = has_left && has_right && slots[slot].has_pattern ? 1 : 0;
  }
  gpu::Outcome outcome = batch.submit();
  if (outcome == gpu::Outcome::Done) {
    outcome = batch.wait();
  }
  if (outcome != gpu::Outcome::Done) {
    return outcome;
  }
  std::memcpy(left_grey.data(), left.readback.mapped().data(), left_grey.size() * sizeof(float));
  std::memcpy(right_grey.data(), right.readback.mapped().data(), right_grey.size() * sizeof(float));
  return outcome;
}

void StereoMatcher::Impl::find_start(std::span<const StereoSlot> slots, const Alive& alive) {
  const VolumeSize& size = solver.size();
  std::fill(start_px.begin(), start_px.end(), kNan);
  for (std::size_t slot = 0; slot < slots.size(); ++slot) {
    const std::span<float> line = std::span(start_px).subspan(slot * size.slot_voxels(), size.slot_voxels());
    alive();
    start_value.find(size, left_grey, right_grey, static_cast<int>(slot), line);
    const std::span<const std::uint8_t> mask = slots[slot].mask;
    if (!mask.empty()) {
      for (std::size_t at = 0; at < line.size(); ++at) {
        line[at] = mask[at] != 0 ? line[at] : kNan;
      }
    }
  }
}

/// What another surface hides from the right camera can have no match there.
void StereoMatcher::Impl::drop_hidden(std::span<const float> disparity_px, std::span<float> depth_mm) {
  const int width = options.width_px;
  for (int y = 0; y < options.height_px; ++y) {
    const std::size_t first = static_cast<std::size_t>(y) * static_cast<std::size_t>(width);
    std::fill(nearest.begin(), nearest.end(), std::numeric_limits<float>::lowest());
    const auto landing = [&](int x) {
      return static_cast<int>(
          std::lround(static_cast<float>(x) - disparity_px[first + static_cast<std::size_t>(x)]));
    };
    for (int x = 0; x < width; ++x) {
      if (depth_mm[first + static_cast<std::size_t>(x)] > 0) {
        const int there = landing(x);
        if (there >= 0 && there < width) {
          float& most = nearest[static_cast<std::size_t>(there)];
          most = std::max(most, disparity_px[first + static_cast<std::size_t>(x)]);
        }
      }
    }
    for (int x = 0; x < width; ++x) {
      const std::size_t at = first + static_cast<std::size_t>(x);
      if (depth_mm[at] > 0) {
        const int there = landing(x);
        if (there < 0 || there >= width ||
            nearest[static_cast<std::size_t>(there)] > disparity_px[at] + kHidden_px) {
          depth_mm[at] = 0;
        }
      }
    }
  }
}

void StereoMatcher::Impl::finish(std::size_t slot, capture::DepthMap& map) {
  const std::size_t count = solver.size().slot_voxels();
  const auto part = [&](const std::vector<float>& whole) {
    return std::span<const float>(whole).subspan(slot * count, count);
  };
  const std::span<const float> disparity = part(field.disparity_px);
  const std::span<const float> sigma = part(field.sigma_px);
  const std::span<const float> correlation = part(field.correlation);
  const auto depth_mm = [&](float d) {
    return static_cast<float>(rectification.depth_mm(static_cast<double>(d)));
  };
  const auto sigma_mm = [&](std::size_t at) {
    const double depth = rectification.depth_mm(static_cast<double>(disparity[at]));
    return sigma[at] * static_cast<float>(rectification.depth_per_px_mm(depth));
  };
  for (std::size_t at = 0; at < count; ++at) {
    if (sigma[at] > 0 && correlation[at] >= options.least_correlation &&
        sigma_mm(at) <= options.most_sigma_mm) {
      const float depth = depth_mm(disparity[at]);
      if (depth >= options.depths.nearest_mm && depth <= options.depths.farthest_mm) {
        map.depth_mm[at] = depth;
      }
    }
  }
  drop_hidden(disparity, map.depth_mm);
  islands.drop(disparity, options.spacetime.break_px, options.least_island_px, map.depth_mm);
  for (std::size_t at = 0; at < count; ++at) {
    if (map.depth_mm[at] > 0) {
      map.sigma_mm[at] = sigma_mm(at);
      map.confidence[at] = capture::depth_confidence(map.sigma_mm[at]);
    }
  }
}

StereoMatcher::StereoMatcher(gpu::Context& context, const capture::Rig& rig, const capture::StereoPair& pair,
                             const StereoOptions& options)
    : impl_(std::make_unique<Impl>(context, rig, pair, options)) {}
StereoMatcher::~StereoMatcher() = default;

const Rectification& StereoMatcher::rectification() const {
  return impl_->rectification;
}
const std::string& StereoMatcher::failure() const {
  return impl_->failure;
}
const StereoTimes& StereoMatcher::times() const {
  return impl_->times;
}
std::span<const gpu::StageTime> StereoMatcher::stage_times() const {
  return impl_->solver.stage_times();
}
std::span<const float> StereoMatcher::left_grey() const {
  return impl_->left_grey;
}
std::span<const float> StereoMatcher::right_grey() const {
  return impl_->right_grey;
}
std::span<const float> StereoMatcher::start_px() const {
  return impl_->start_px;
}
const DisparityField& StereoMatcher::field() const {
  return impl_->field;
}

StereoOutcome StereoMatcher::match(std::span<const StereoSlot> slots, std::vector<capture::DepthMap>& maps,
                                   const Alive& alive) {
  Impl& impl = *impl_;
  const VolumeSize& size = impl.solver.size();
  if (slots.empty() || slots.size() > static_cast<std::size_t>(size.slots)) {
    throw Error(ErrorKind::Usage,
                fmt::format("{} slots for a stereo matcher of {}", slots.size(), size.slots));
  }
  for (const StereoSlot& slot : slots) {
    if (!slot.mask.empty() && slot.mask.size() != size.slot_voxels()) {
      throw Error(ErrorKind::Usage, fmt::format("a mask of {} pixels for depth maps of {} x {}",
                                                slot.mask.size(), size.width_px, size.height_px));
    }
  }
  maps.resize(slots.size());
  for (capture::DepthMap& map : maps) {
    map.width_px = size.width_px;
    map.height_px = size.height_px;
    map.lens = impl.rectification.left();
    map.depth_mm.assign(size.slot_voxels(), 0);
    map.sigma_mm.assign(size.slot_voxels(), 0);
    map.confidence.assign(size.slot_voxels(), 0);
  }
  impl.failure.clear();
  auto clock = Clock::now();
  if (impl.rectify(slots) != gpu::Outcome::Done) {
    impl.failure = "the GPU was lost during rectification";
    return StereoOutcome::DeviceLost;
  }
  impl.times.rectify_ms = ms_since(clock);
  clock = Clock::now();
  impl.find_start(slots, alive);
  impl.times.start_ms = ms_since(clock);
  clock = Clock::now();
  impl.solver.solve(impl.start_px, impl.field, alive);
  impl.times.solve_ms = ms_since(clock);
  if (impl.field.outcome != StereoOutcome::Done) {
    impl.failure = impl.field.failure;
    return impl.field.outcome;
  }
  clock = Clock::now();
  for (std::size_t slot = 0; slot < slots.size(); ++slot) {
    alive();
    impl.finish(slot, maps[slot]);
  }
  impl.times.finish_ms = ms_since(clock);
  return StereoOutcome::Done;
}

}  // namespace facet::stereo
