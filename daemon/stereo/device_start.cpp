#include "stereo/device_start.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <limits>

#include "stereo_shaders.hpp"

namespace facet::stereo {
namespace {

using shaders::stereo::kMost_px;
using shaders::stereo::kNoDisparity;
using shaders::stereo::StartPush;

constexpr int kMostSlots = 32;  // a bit each in a word
constexpr std::uint32_t kGroupSize = 64;
constexpr std::uint32_t kIntel = 0x8086;  // whose subgroups may be smaller than the size it names
constexpr std::size_t kChunkBytes = std::size_t{256} << 20U;

/// Disparities, in whole words of four for every lane.
int padded(int used, std::uint32_t lanes) {
  const int step = 4 * static_cast<int>(lanes);
  return (used + step - 1) / step * step;
}

std::size_t total_bytes(const VolumeSize& size, int count) {
  return size.slot_voxels() * static_cast<std::size_t>(count) * sizeof(std::uint16_t);
}

StartPush push_of(const VolumeSize& size, int least_px, int most_px, const StartOptions& options,
                  std::uint32_t lanes) {
  StartPush push{};
  push.volume = {size.width_px, size.height_px, size.slots, 0};
  push.least_px = least_px;
  push.used = most_px - least_px + 1;
  push.count = padded(push.used, lanes);
  push.reach = options.window_t / 2;
  push.step_cost = options.step_cost;
  push.jump_cost = options.jump_cost;
  push.most_cost = options.most_cost;
  push.uniqueness = options.uniqueness;
  push.least_grey = options.least_grey;
  return push;
}

/// 32-bit words of a slot's grey values of all the slots that its costs are summed over.
std::size_t normalised_words(const VolumeSize& size, const StartPush& push) {
  return static_cast<std::size_t>(2 * push.reach + 1) * 2 * size.slot_voxels();
}

/// Slots at a time: as many as the arrays hold.
int chunk_of(const gpu::DeviceInfo& info, const VolumeSize& size, const StartPush& push) {
  const std::size_t bytes = total_bytes(size, push.count);
  const std::size_t fitting = std::min({std::min(kChunkBytes, info.max_storage_buffer_bytes) / bytes,
                                        info.max_texel_buffer_elements / (bytes / 8),
                                        info.max_texel_buffer_elements / normalised_words(size, push)});
  return static_cast<int>(std::clamp<std::size_t>(fitting, 1, static_cast<std::size_t>(size.slots)));
}

}  // namespace

std::string DeviceStart::why_not(const gpu::Context& context, const VolumeSize& size, int least_px,
                                 int most_px, const StartOptions& options) {
  const gpu::DeviceInfo& info = context.info();
  if (options.method != StartMethod::SemiGlobal || options.path_count != 8) {
    return "on a device start values are semi-global, along eight paths";
  }
  if (info.subgroup_size > kGroupSize || info.subgroup_size < 4 || info.vendor_id == kIntel) {
    return fmt::format("{} does not say how large its subgroups are", info.name);
  }
  const std::size_t bytes = total_bytes(size, padded(most_px - least_px + 1, info.subgroup_size));
  if (size.slots > kMostSlots || size.width_px > static_cast<int>(kMost_px) ||
      bytes > info.max_storage_buffer_bytes || bytes / 8 > info.max_texel_buffer_elements ||
      normalised_words(size, push_of(size, least_px, most_px, options, info.subgroup_size)) >
          info.max_texel_buffer_elements ||
      info.shared_memory_bytes < kMost_px * sizeof(std::uint32_t)) {
    return fmt::format("costs of {} x {} px and {} disparities, {} slots, are more than {} holds",
                       size.width_px, size.height_px, most_px - least_px + 1, size.slots, info.name);
  }
  return {};
}

DeviceStart::DeviceStart(gpu::Context& context, const VolumeSize& size, int least_px, int most_px,
                         const StartOptions& options, const StartPictures& pictures)
    : context_(context),
      size_(size),
      push_(push_of(size, least_px, most_px, options, context.info().subgroup_size)),
      chunk_(chunk_of(context.info(), size, push_)),
      lanes_(context.info().subgroup_size),
      usable_(pictures.usable),
      left_(pictures.left, gpu::TexelFormat::R32f),
      right_(pictures.right, gpu::TexelFormat::R32f),
      lit_kernel_(context, shaders::stereo::kernels(), "stereo/start_lit"),
      normalise_(context, shaders::stereo::kernels(), "stereo/start_normalise"),
      costs_kernel_(context, shaders::stereo::kernels(), "stereo/start_costs"),
      paths_(context, shaders::stereo::kernels(), "stereo/start_paths",
             {{"lane_words", push_.count / 4 / static_cast<int>(lanes_)},
              {"lanes", static_cast<std::int32_t>(lanes_)}}),
      choose_(context, shaders::stereo::kernels(), "stereo/start_choose"),
      lit_(context, 2 * size.slot_voxels(), gpu::TexelFormat::R32u, "lit"),
      normalised_(context, static_cast<std::size_t>(chunk_) * normalised_words(size, push_),
                  gpu::TexelFormat::R32u, "normalised"),
      costs_(context, static_cast<std::size_t>(chunk_) * total_bytes(size, push_.count) / 8,
             gpu::TexelFormat::R32u, "costs"),
      totals_(context, static_cast<std::size_t>(chunk_) * total_bytes(size, push_.count), gpu::Memory::Device,
              "totals"),
      centres_(context, static_cast<std::size_t>(size.slots) * sizeof(std::int32_t), gpu::Memory::Upload,
               "centres"),
      found_(context, size.voxels() * sizeof(float), gpu::Memory::Readback, "start values") {}

void DeviceStart::want(std::span<const std::size_t> slots) {
  const std::span<std::int32_t> centres = centres_.mapped_as<std::int32_t>();
  std::fill(centres.begin(), centres.end(), -1);
  std::ranges::transform(slots, centres.begin(),
                         [](std::size_t slot) { return static_cast<std::int32_t>(slot); });
}

void DeviceStart::record(gpu::Batch& batch) {
  const std::uint32_t groups = context_.info().workgroup_count;
  const auto width = static_cast<std::uint32_t>(size_.width_px);
  const auto height = static_cast<std::uint32_t>(size_.height_px);
  batch.dispatch(lit_kernel_, {{"left", left_}, {"right", right_}, {"lit", lit_.buffer}}, {groups, 2}, push_);
  for (int first = 0; first < size_.slots; first += chunk_) {
    StartPush push = push_;
    push.volume.w = first;
    const auto chunk = static_cast<std::uint32_t>(std::min(chunk_, size_.slots - first));
    const std::uint32_t images = chunk * static_cast<std::uint32_t>(2 * (2 * push.reach + 1));
    batch.dispatch(normalise_,
                   {{"centres", centres_},
                    {"usable", usable_},
                    {"left", left_},
                    {"right", right_},
                    {"lit", lit_.view},
                    {"normalised", normalised_.buffer}},
                   {gpu::groups_for(width, kGroupSize), height, images}, push);
    batch.dispatch(costs_kernel_,
                   {{"centres", centres_},
                    {"usable", usable_},
                    {"normalised", normalised_.view},
                    {"costs", costs_.buffer},
                    {"totals", totals_}},
                   {8 * groups, chunk}, push);
    batch.dispatch(paths_, {{"centres", centres_}, {"costs", costs_.view}, {"totals", totals_}},
                   {gpu::groups_for(width + height, kGroupSize / lanes_), 8, chunk}, push);
    batch.dispatch(choose_,
                   {{"centres", centres_},
                    {"costs", costs_.view},
                    {"totals", totals_},
                    {"lit", lit_.view},
                    {"found", found_}},
                   {height, chunk}, push);
  }
}

void DeviceStart::read(std::size_t slot, std::span<float> start_px) const {
  const std::span<const float> line =
      found_.mapped_as<float>().subspan(slot * size_.slot_voxels(), size_.slot_voxels());
  std::ranges::transform(line, start_px.begin(), [](float d) {
    return d > kNoDisparity ? d : std::numeric_limits<float>::quiet_NaN();
  });
}

}  // namespace facet::stereo
