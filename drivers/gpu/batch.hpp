#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>

#include "gpu/buffer.hpp"
#include "gpu/context.hpp"
#include "gpu/image.hpp"
#include "gpu/kernel.hpp"

namespace facet::gpu {

/// A resource for the binding of that name. The resource must stay where it is and live as long as the batch.
struct Binding {
  /// A storage or uniform buffer, or a part of it (offset a multiple of DeviceInfo::buffer_alignment_bytes;
  /// size_bytes 0: to the end).
  Binding(std::string_view binding_name, const Buffer& bound, std::size_t offset = 0, std::size_t size = 0)
      : name(binding_name), buffer(&bound), offset_bytes(offset), size_bytes(size) {}
  /// A texel buffer.
  Binding(std::string_view binding_name, const TexelView& bound) : name(binding_name), view(&bound) {}
  /// A sampled image with all its levels.
  Binding(std::string_view binding_name, const Image& bound, const Sampler& how)
      : name(binding_name), image(&bound), sampler(&how) {}
  /// A sampled image of which the kernel sees one level, as its level 0.
  Binding(std::string_view binding_name, const Image& bound, const Sampler& how, std::uint32_t only_level)
      : name(binding_name), image(&bound), sampler(&how), level(only_level), one_level(true) {}
  /// A storage image: one level.
  Binding(std::string_view binding_name, const Image& bound, std::uint32_t only_level)
      : name(binding_name), image(&bound), level(only_level), one_level(true) {}

  std::string_view name;
  const Buffer* buffer = nullptr;
  const TexelView* view = nullptr;
  const Image* image = nullptr;
  const Sampler* sampler = nullptr;
  std::uint32_t level = 0;
  bool one_level = false;
  std::size_t offset_bytes = 0;
  std::size_t size_bytes = 0;
};

/// How many workgroups.
struct Groups {
  std::uint32_t x = 1;
  std::uint32_t y = 1;
  std::uint32_t z = 1;
};

/// Workgroups of `group_size` that cover `count` items.
constexpr std::uint32_t groups_for(std::size_t count, std::uint32_t group_size) {
  return static_cast<std::uint32_t>((count + group_size - 1) / group_size);
}

struct StageTime {
  std::string name;
  float ms = 0;  ///< on the device's clock
};

/// Work recorded once and submitted any number of times, each time as one submission: nothing is recorded,
/// allocated or locked for long per frame. What changes from frame to frame goes through Memory::Upload
/// buffers; how much is done may be decided on the device through dispatch_indirect.
///
/// Order and visibility are the batch's business: it knows from the shaders which resource each step reads
/// and writes and puts a barrier between two steps exactly where one needs the other's result (by byte range
/// of buffers, by level of images). Batches submitted one after the other run one after the other.
///
/// Life: record (dispatch, copy, fill, stage), finish, then submit and wait in turn. One thread at a time.
/// Functions throw Error(Internal) for misuse only: an unknown, missing, doubled or mistyped binding, a range
/// outside its resource, push constants of the wrong size, submit before finish or while in flight.
class Batch {
 public:
  /// most_stages: room for the times of so many
  Batch(Context& context, std::string_view name, std::size_t most_stages = max_stages);
  ~Batch();
  Batch(Batch&&) noexcept;
  Batch& operator=(Batch&&) noexcept;

  /// Starts a named stage: what is recorded from here to the next stage, or to finish, is timed under this
  /// name. The same name may come again (once per level), or with "/" and a part behind it: stage_ms adds
  /// them up. At most as many as the constructor was told.
  static constexpr std::size_t max_stages = 256;
  void stage(std::string_view name);
  /// From here on every dispatch, copy and fill is a stage of its own, "STAGE/KERNEL", "STAGE/copy" or
  /// "STAGE/fill". For benchmarks: each stage costs a write of the device's clock.
  void time_dispatches();

  /// Runs a kernel without push constants. Every binding of the kernel must be given, by name, once.
  void dispatch(const Kernel& kernel, std::span<const Binding> bindings, Groups groups) {
    dispatch_bytes(kernel, bindings, groups, {}, 1);
  }
  void dispatch(const Kernel& kernel, std::initializer_list<Binding> bindings, Groups groups) {
    dispatch(kernel, std::span<const Binding>(bindings.begin(), bindings.size()), groups);
  }
  /// Runs a kernel with push constants: a struct of the shader's layout (see shaders/common/layout.h), whose
  /// size must be the shader's.
  template <typename Push>
  void dispatch(const Kernel& kernel, std::span<const Binding> bindings, Groups groups, const Push& push) {
    static_assert(std::is_trivially_copyable_v<Push>);
    dispatch_bytes(kernel, bindings, groups, std::as_bytes(std::span<const Push, 1>(&push, 1)),
                   alignof(Push));
  }
  template <typename Push>
  void dispatch(const Kernel& kernel, std::initializer_list<Binding> bindings, Groups groups,
                const Push& push) {
    dispatch(kernel, std::span<const Binding>(bindings.begin(), bindings.size()), groups, push);
  }

  /// The same with the number of workgroups read on the device when the step runs: three uint32 (x, y, z) at
  /// offset_bytes (a multiple of 4) of `counts`. Zero skips the step.
  void dispatch_indirect(const Kernel& kernel, std::initializer_list<Binding> bindings, const Buffer& counts,
                         std::size_t offset_bytes) {
    dispatch_indirect_bytes(kernel, std::span<const Binding>(bindings.begin(), bindings.size()), counts,
                            offset_bytes, {}, 1);
  }
  void dispatch_indirect(const Kernel& kernel, std::span<const Binding> bindings, const Buffer& counts,
                         std::size_t offset_bytes) {
    dispatch_indirect_bytes(kernel, bindings, counts, offset_bytes, {}, 1);
  }
  template <typename Push>
  void dispatch_indirect(const Kernel& kernel, std::span<const Binding> bindings, const Buffer& counts,
                         std::size_t offset_bytes, const Push& push) {
    static_assert(std::is_trivially_copyable_v<Push>);
    dispatch_indirect_bytes(kernel, bindings, counts, offset_bytes,
                            std::as_bytes(std::span<const Push, 1>(&push, 1)), alignof(Push));
  }
  template <typename Push>
  void dispatch_indirect(const Kernel& kernel, std::initializer_list<Binding> bindings, const Buffer& counts,
                         std::size_t offset_bytes, const Push& push) {
    dispatch_indirect(kernel, std::span<const Binding>(bindings.begin(), bindings.size()), counts,
                      offset_bytes, push);
  }

  /// Copies size_bytes (0: as much as the source has from its offset) between different buffers.
  void copy(const Buffer& source, const Buffer& target, std::size_t size_bytes = 0,
            std::size_t source_offset_bytes = 0, std::size_t target_offset_bytes = 0);
  /// Copies one level from packed rows, respectively to them.
  void copy(const Buffer& source, const Image& target, std::uint32_t level = 0,
            std::size_t source_offset_bytes = 0);
  void copy(const Image& source, std::uint32_t level, const Buffer& target,
            std::size_t target_offset_bytes = 0);
  /// Sets every 32-bit word of a range (multiples of 4; size_bytes 0: to the end) to one value.
  void fill(const Buffer& target, std::uint32_t word = 0, std::size_t offset_bytes = 0,
            std::size_t size_bytes = 0);

  /// Ends the recording. Throws DeviceLostError, Error(NoDevice).
  void finish();
  /// Forgets what was recorded, to record anew. Not while in flight.
  void reset();

  /// Hands the work to the device and returns at once. Real-time safe but for what the driver does. The batch
  /// must be finished and not in flight.
  Outcome submit();
  /// Waits for the work submitted last and reads its stage times. Done at once where nothing is in flight.
  /// Where it takes longer than DeviceInfo::patience, the device counts as lost.
  Outcome wait();
  /// The same, but TimedOut after the time given: wait again, or give up.
  Outcome wait(std::chrono::nanoseconds timeout);
  /// The device hangs: it is lost to everything on its context. What it may still use is kept to the end of
  /// the process.
  void give_up();
  bool in_flight() const;

  /// The stages in recorded order with the times of the last wait that returned Done. Real-time safe.
  std::span<const StageTime> stage_times() const;
  /// Sum over the stages of that name and their parts ("name/part"), 0 where there is none. Real-time safe.
  float stage_ms(std::string_view name) const;

  struct Counts {
    std::size_t dispatches = 0;
    std::size_t barriers = 0;
    std::size_t copies = 0;  ///< and fills
  };
  /// What was recorded.
  Counts counts() const;

  struct Impl;

 private:
  void dispatch_bytes(const Kernel& kernel, std::span<const Binding> bindings, Groups groups,
                      std::span<const std::byte> push, std::size_t push_alignment);
  void dispatch_indirect_bytes(const Kernel& kernel, std::span<const Binding> bindings, const Buffer& counts,
                               std::size_t offset_bytes, std::span<const std::byte> push,
                               std::size_t push_alignment);

  std::unique_ptr<Impl> impl_;
};

/// Records a batch, runs it once and waits for it. For set-up and tests. Throws DeviceLostError.
void run_now(Context& context, std::string_view name, const std::function<void(Batch&)>& record);

}  // namespace facet::gpu
