#include "gpu/batch.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <vector>

#include "gpu/batch_impl.hpp"

namespace facet::gpu {

namespace {

constexpr std::size_t dispatch_counts_bytes = 3 * sizeof(std::uint32_t);

}  // namespace

Batch::Batch(Context& context, std::string_view name, std::size_t most_stages)
    : impl_(std::make_unique<Impl>(context.device(), name, static_cast<std::uint32_t>(most_stages))) {}
Batch::~Batch() = default;
Batch::Batch(Batch&&) noexcept = default;
Batch& Batch::operator=(Batch&&) noexcept = default;

void Batch::stage(std::string_view name) {
  impl_->check_recording();
  impl_->stage_name = name;
  impl_->begin_stage(impl_->stage_name);
}

void Batch::time_dispatches() {
  impl_->times_dispatches = true;
}

void Batch::dispatch_bytes(const Kernel& kernel, std::span<const Binding> bindings, Groups groups,
                           std::span<const std::byte> push, std::size_t push_alignment) {
  const auto& most = impl_->device->limits().maxComputeWorkGroupCount;
  if (groups.x > most[0] || groups.y > most[1] || groups.z > most[2]) {
    impl_->misuse(fmt::format("kernel '{}': {}x{}x{} workgroups are more than {}", kernel.name(), groups.x,
                              groups.y, groups.z, fmt::join(most, "x")));
  }
  std::vector<Access> accesses;
  impl_->bind(kernel.impl(), bindings, push, push_alignment, accesses);
  impl_->step(kernel.name(), accesses);
  impl_->device->api().vkCmdDispatch(impl_->commands, groups.x, groups.y, groups.z);
  ++impl_->counts.dispatches;
}

void Batch::dispatch_indirect_bytes(const Kernel& kernel, std::span<const Binding> bindings,
                                    const Buffer& counts, std::size_t offset_bytes,
                                    std::span<const std::byte> push, std::size_t push_alignment) {
  const Buffer::Impl& buffer = counts.impl();
  impl_->check_device(buffer.device, buffer.name);
  impl_->check_range(buffer.name, buffer.size_bytes, offset_bytes, dispatch_counts_bytes);
  if (offset_bytes % sizeof(std::uint32_t) != 0) {
    impl_->misuse(fmt::format("workgroup counts at byte {} of buffer '{}', no multiple of 4", offset_bytes,
                              buffer.name));
  }
  std::vector<Access> accesses{
      {handle_bits(buffer.buffer), offset_bytes, offset_bytes + dispatch_counts_bytes, false, By::Indirect}};
  impl_->bind(kernel.impl(), bindings, push, push_alignment, accesses);
  impl_->step(kernel.name(), accesses);
  impl_->device->api().vkCmdDispatchIndirect(impl_->commands, buffer.buffer, offset_bytes);
  ++impl_->counts.dispatches;
}

void Batch::copy(const Buffer& source, const Buffer& target, std::size_t size_bytes,
                 std::size_t source_offset_bytes, std::size_t target_offset_bytes) {
  impl_->check_recording();
  const Buffer::Impl& from = source.impl();
  const Buffer::Impl& to = target.impl();
  impl_->check_device(from.device, from.name);
  impl_->check_device(to.device, to.name);
  if (&from == &to) {
    impl_->misuse(fmt::format("copy of buffer '{}' to itself", from.name));
  }
  const std::size_t size =
      size_bytes != 0 ? size_bytes : from.size_bytes - std::min(source_offset_bytes, from.size_bytes);
  impl_->check_range(from.name, from.size_bytes, source_offset_bytes, size);
  impl_->check_range(to.name, to.size_bytes, target_offset_bytes, size);
  const std::array accesses{
      Access{handle_bits(from.buffer), source_offset_bytes, source_offset_bytes + size, false, By::Copy},
      Access{handle_bits(to.buffer), target_offset_bytes, target_offset_bytes + size, true, By::Copy}};
  impl_->step("copy", accesses);
  const VkBufferCopy region{source_offset_bytes, target_offset_bytes, size};
  impl_->device->api().vkCmdCopyBuffer(impl_->commands, from.buffer, to.buffer, 1, &region);
  ++impl_->counts.copies;
}

void Batch::copy(const Buffer& source, const Image& target, std::uint32_t level,
                 std::size_t source_offset_bytes) {
  impl_->copy_image(source, target, level, source_offset_bytes, true);
}

void Batch::copy(const Image& source, std::uint32_t level, const Buffer& target,
                 std::size_t target_offset_bytes) {
  impl_->copy_image(target, source, level, target_offset_bytes, false);
}

void Batch::fill(const Buffer& target, std::uint32_t word, std::size_t offset_bytes, std::size_t size_bytes) {
  impl_->check_recording();
  const Buffer::Impl& buffer = target.impl();
  impl_->check_device(buffer.device, buffer.name);
  const std::size_t rest = buffer.size_bytes - std::min(offset_bytes, buffer.size_bytes);
  const std::size_t size =
      size_bytes != 0 ? size_bytes : rest / sizeof(std::uint32_t) * sizeof(std::uint32_t);
  impl_->check_range(buffer.name, buffer.size_bytes, offset_bytes, size);
  if (offset_bytes % sizeof(std::uint32_t) != 0 || size % sizeof(std::uint32_t) != 0) {
    impl_->misuse(fmt::format("fill of {} bytes at {} of buffer '{}': no multiples of 4", size, offset_bytes,
                              buffer.name));
  }
  const std::array accesses{
      Access{handle_bits(buffer.buffer), offset_bytes, offset_bytes + size, true, By::Copy}};
  impl_->step("fill", accesses);
  impl_->device->api().vkCmdFillBuffer(impl_->commands, buffer.buffer, offset_bytes, size, word);
  ++impl_->counts.copies;
}

void Batch::finish() {
  impl_->check_recording();
  if (!impl_->stages.empty()) {
    impl_->timestamp();
    impl_->ticks.reserve(impl_->timestamps);  // wait allocates nothing
  }
  // What the host reads after wait.
  impl_->barrier(everything(), {VK_PIPELINE_STAGE_HOST_BIT, VK_ACCESS_HOST_READ_BIT});
  impl_->device->check(impl_->device->api().vkEndCommandBuffer(impl_->commands),
                       fmt::format("finish batch '{}'", impl_->name));
  impl_->finished = true;
}

void Batch::reset() {
  if (impl_->in_flight) {
    impl_->misuse("reset while in flight");
  }
  impl_->wait_for_fence();
  impl_->device->check_not_lost(fmt::format("reset batch '{}'", impl_->name));
  const DeviceApi& api = impl_->device->api();
  impl_->device->check(api.vkResetCommandPool(impl_->device->handle(), impl_->command_pool, 0),
                       fmt::format("reset batch '{}'", impl_->name));
  for (const VkDescriptorPool pool : impl_->descriptor_pools) {
    api.vkResetDescriptorPool(impl_->device->handle(), pool, 0);
  }
  impl_->pool_in_use = 0;
  impl_->stages.clear();
  impl_->times_dispatches = false;
  impl_->timestamps = 0;
  impl_->finished = false;
  impl_->begin();
}

Outcome Batch::submit() {
  if (!impl_->finished || impl_->in_flight) {
    impl_->misuse(impl_->finished ? "submit while in flight" : "submit before finish");
  }
  Device& device = *impl_->device;
  if (device.lost()) {
    return Outcome::DeviceLost;
  }
  device.api().vkResetFences(device.handle(), 1, &impl_->fence);
  if (device.submit(impl_->commands, impl_->fence) != VK_SUCCESS) {
    // Out of memory in a submission that was made ready long before leaves the device as useless as a loss.
    device.mark_lost();
    return Outcome::DeviceLost;
  }
  impl_->in_flight = true;
  impl_->fence_pending = true;
  return Outcome::Done;
}

Outcome Batch::wait(std::chrono::nanoseconds timeout) {
  Device& device = *impl_->device;
  if (device.lost()) {
    impl_->in_flight = false;
    return Outcome::DeviceLost;
  }
  if (!impl_->in_flight) {
    return Outcome::Done;
  }
  const VkResult result = device.wait_for(impl_->fence, timeout);
  if (result == VK_TIMEOUT) {
    return Outcome::TimedOut;
  }
  impl_->in_flight = false;
  if (result != VK_SUCCESS) {
    device.mark_lost();
    return Outcome::DeviceLost;
  }
  impl_->fence_pending = false;
  if (device.lost()) {
    return Outcome::DeviceLost;
  }
  impl_->read_stage_times();
  return Outcome::Done;
}

Outcome Batch::wait() {
  const Outcome outcome = wait(impl_->device->info().patience);
  if (outcome != Outcome::TimedOut) {
    return outcome;
  }
  give_up();
  return Outcome::DeviceLost;
}

void Batch::give_up() {
  impl_->device->mark_hung();
  impl_->in_flight = false;
}

bool Batch::in_flight() const {
  return impl_->in_flight;
}

std::span<const StageTime> Batch::stage_times() const {
  return impl_->stages;
}

float Batch::stage_ms(std::string_view name) const {
  float sum = 0.0F;
  for (const StageTime& stage : impl_->stages) {
    const bool part = stage.name.size() > name.size() && stage.name[name.size()] == '/';
    sum += stage.name.starts_with(name) && (part || stage.name.size() == name.size()) ? stage.ms : 0.0F;
  }
  return sum;
}

Batch::Counts Batch::counts() const {
  return impl_->counts;
}

void run_now(Context& context, std::string_view name, const std::function<void(Batch&)>& record) {
  Batch batch(context, name);
  record(batch);
  batch.finish();
  Outcome outcome = batch.submit();
  if (outcome == Outcome::Done) {
    outcome = batch.wait(context.device()->long_patience());
  }
  if (outcome == Outcome::TimedOut) {
    batch.give_up();
  }
  if (outcome != Outcome::Done) {
    throw DeviceLostError(fmt::format("batch '{}': the device '{}' {}; open it again", name,
                                      context.info().name, context.hung() ? "hangs" : "was lost"));
  }
}

}  // namespace facet::gpu
