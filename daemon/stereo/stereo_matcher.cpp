#include "stereo/stereo_matcher.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <thread>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "gpu/device_array.hpp"
#include "maths/threads.hpp"
#include "shaders/stereo/layout.h"
#include "stereo/device_start.hpp"
#include "stereo/islands.hpp"
#include "stereo_shaders.hpp"

namespace facet::stereo {
namespace {

using shaders::stereo::RectifyPush;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Two left pixels that land on one right pixel: the farther one is hidden there if it is farther by more than
// this.
constexpr float kHidden_px = 1.5F;
constexpr std::size_t kMostThreads = 16;
// For start values, of one matcher: eight threads of the usual size (640 x 480 px, 128 disparities: 0.12
// GiB), so that a booth of two pairs leaves a machine of 8 GB room for pictures, fit and shading.
constexpr std::size_t kStartMemory_bytes = std::size_t{1} << 30U;

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

/// What a thread needs to work on a slot.
struct Hand {
  std::optional<StartValue> start;  ///< nothing where the device finds start values
  Islands islands;
  FringeMatcher fringes;
  std::vector<FringePictures> fringe_pictures;
  std::vector<float> nearest;  ///< [width] of a row of the right picture
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

  bool on_device(const gpu::Context& context) const;
  std::vector<std::optional<std::uint64_t>> keep_starts(std::span<const StereoSlot> slots);
  gpu::Outcome rectify(std::span<const StereoSlot> slots);
  void find_start(std::span<const StereoSlot> slots, const Alive& alive);
  std::span<float> line_of(std::vector<float>& whole, std::size_t slot) const {
    return std::span(whole).subspan(slot * solver.size().slot_voxels(), solver.size().slot_voxels());
  }
  void for_each(std::span<const std::size_t> chosen, const Alive& alive,
                const std::function<void(Hand&, std::size_t)>& work);
  bool look_at_fringes(Hand& hand, std::span<const StereoSlot> slots, std::size_t slot);
  void spread(Hand& hand, std::span<const StereoSlot> slots, std::size_t slot, std::span<float> line);
  void finish(Hand& hand, std::size_t slot, capture::DepthMap& map) const;
  void drop_hidden(std::vector<float>& nearest, std::span<const float> disparity_px,
                   std::span<float> depth_mm) const;

  StereoOptions options;
  Rectification rectification;
  std::vector<Eigen::Vector2f> left_sources, right_sources;  ///< of the rectified pictures
  SpacetimeSolver solver;
  std::vector<Hand> hands;
  gpu::Kernel rectify_kernel;
  View left, right;
  std::unique_ptr<DeviceStart> device_start;  ///< null: the host finds start values
  gpu::Buffer usable;                         ///< [slots] 1 where both pictures are there and show a pattern
  gpu::Batch batch;
  std::vector<bool> has_both;      ///< [slots] of pictures
  std::vector<std::uint8_t> lit;   ///< [height][width] 1 where a slot is as bright as a start value needs
  std::vector<std::uint8_t> told;  ///< [slots] 0: by too few fringes, of which the next run may have more

  std::vector<float> left_grey, right_grey, start_px, start_px_before;
  std::vector<std::optional<std::uint64_t>> numbers;  ///< [slots] whose start values are in start_px
  std::vector<std::size_t> missing;                   ///< slots whose start values are to be found
  DisparityField field;
  std::string failure;
  StereoTimes times;
};

StereoMatcher::Impl::Impl(gpu::Context& context, const capture::Rig& rig, const capture::StereoPair& pair,
                          const StereoOptions& chosen)
    : options(completed(chosen, rig, pair)),
      rectification(rig, pair, options.depths, options.width_px, options.height_px),
      left_sources(rectification.left_sources()),
      right_sources(rectification.right_sources()),
      solver(context, {options.width_px, options.height_px, options.most_slots}, options.spacetime),
      rectify_kernel(context, shaders::stereo::kernels(), "stereo/rectify"),
      left(context, rig.cameras[pair.left].lens, left_sources, solver.left(), options.most_slots,
           "left pictures"),
      right(context, rig.cameras[pair.right].lens, right_sources, solver.right(), options.most_slots,
            "right pictures"),
      usable(context, static_cast<std::size_t>(options.most_slots) * sizeof(float), gpu::Memory::Upload,
             "usable"),
      batch(context, "rectification") {
  const VolumeSize& size = solver.size();
  left_grey.resize(size.voxels());
  right_grey.resize(size.voxels());
  start_px.resize(size.voxels());
  start_px_before.resize(size.voxels());
  if (on_device(context)) {
    device_start = std::make_unique<DeviceStart>(context, size, rectification.least_disparity_px(),
                                                 rectification.most_disparity_px(), options.start,
                                                 StartPictures{solver.left(), solver.right(), usable});
  }
  int threads = 0;
  do {
    Hand& hand =
        hands.emplace_back(Hand{std::nullopt,
                                Islands(options.width_px, options.height_px),
                                FringeMatcher(left_sources, right_sources, options.width_px, options.fringes),
                                {},
                                std::vector<float>(static_cast<std::size_t>(options.width_px))});
    if (!device_start) {
      hand.start.emplace(options.width_px, options.height_px, rectification.least_disparity_px(),
                         rectification.most_disparity_px(), options.start);
    }
    threads = thread_count(std::thread::hardware_concurrency(), options.most_slots,
                           (hand.start ? hand.start->bytes() : 0) +
                               FringeMatcher::bytes(rig.cameras[pair.left].lens, size.slot_voxels()));
  } while (std::ssize(hands) < threads);
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
  if (device_start) {
    batch.stage("start");
    device_start->record(batch);
  }
  batch.finish();
}

/// Whether start values are found on the device.
bool StereoMatcher::Impl::on_device(const gpu::Context& context) const {
  const std::string why_not = DeviceStart::why_not(context, solver.size(), rectification.least_disparity_px(),
                                                   rectification.most_disparity_px(), options.start);
  if (options.start.place == StartPlace::Device && !why_not.empty()) {
    throw Error(ErrorKind::Usage, why_not);
  }
  return options.start.place == StartPlace::Device ||
         (options.start.place == StartPlace::Best && why_not.empty() && !context.info().is_software);
}

gpu::Outcome StereoMatcher::Impl::rectify(std::span<const StereoSlot> slots) {
  const std::span<float> flags = usable.mapped_as<float>();
  std::fill(flags.begin(), flags.end(), 0.0F);
  has_both.assign(slots.size(), false);
  for (std::size_t slot = 0; slot < slots.size(); ++slot) {
    const bool has_left = left.load(slots[slot].left, slot);
    const bool has_right = right.load(slots[slot].right, slot);
    has_both[slot] = has_left && has_right;
    flags[slot] = has_both[slot] && slots[slot].has_pattern ? 1 : 0;
  }
  if (device_start) {
    device_start->want(missing);
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

/// Work on some slots, on as many threads as there are hands.
void StereoMatcher::Impl::for_each(std::span<const std::size_t> chosen, const Alive& alive,
                                   const std::function<void(Hand&, std::size_t)>& work) {
  maths::for_each_piece(chosen.size(), hands.size(), [&](std::size_t thread, std::size_t piece) {
    if (thread == 0) {
      alive();
    }
    work(hands[thread], chosen[piece]);
  });
}

/// Takes over the start values of slots that were in the run before, and says which are missing. Returns the
/// numbers that the next run may ask for once these are found.
std::vector<std::optional<std::uint64_t>> StereoMatcher::Impl::keep_starts(
    std::span<const StereoSlot> slots) {
  std::swap(start_px, start_px_before);
  std::fill(start_px.begin(), start_px.end(), kNan);
  std::vector<std::optional<std::uint64_t>> now(slots.size());
  missing.clear();
  for (std::size_t slot = 0; slot < slots.size(); ++slot) {
    now[slot] = slots[slot].mask.empty() ? slots[slot].number : std::nullopt;
    const auto before = now[slot] ? std::find(numbers.begin(), numbers.end(), now[slot]) : numbers.end();
    if (before != numbers.end()) {
      std::ranges::copy(line_of(start_px_before, static_cast<std::size_t>(before - numbers.begin())),
                        line_of(start_px, slot).begin());
    } else {
      missing.push_back(slot);
    }
  }
  numbers.clear();
  return now;
}

/// Whether fringes in a slot, or around it, tell its phases.
bool StereoMatcher::Impl::look_at_fringes(Hand& hand, std::span<const StereoSlot> slots, std::size_t slot) {
  hand.fringe_pictures.clear();
  for (std::size_t near = 0; near < slots.size(); ++near) {
    if (slots[near].fringes && has_both[near]) {
      hand.fringe_pictures.push_back(
          {&slots[near].left,
           &slots[near].right,
           {static_cast<int>(near) - static_cast<int>(slot), *slots[near].fringes}});
    }
  }
  return hand.fringes.look(hand.fringe_pictures);
}

/// Start values that are whole periods off are none. Without phases nothing tells which these are.
void StereoMatcher::Impl::spread(Hand& hand, std::span<const StereoSlot> slots, std::size_t slot,
                                 std::span<float> line) {
  const auto repeats = [](const StereoSlot& one) { return !one.has_pattern || one.fringes; };
  if (look_at_fringes(hand, slots, slot)) {
    hand.fringes.spread(line, lit);
  } else if (std::ranges::all_of(slots, repeats)) {
    std::fill(line.begin(), line.end(), kNan);
    told[slot] = 0;
  }
}

void StereoMatcher::Impl::find_start(std::span<const StereoSlot> slots, const Alive& alive) {
  told.assign(slots.size(), 1);
  if (std::ranges::any_of(slots, [](const StereoSlot& slot) { return slot.has_pattern && slot.fringes; })) {
    lit.assign(solver.size().slot_voxels(), 0);
    for (std::size_t slot = 0; slot < slots.size(); ++slot) {
      const std::span<const float> grey = line_of(left_grey, slot);
      for (std::size_t at = 0; at < lit.size(); ++at) {
        lit[at] = lit[at] != 0 || grey[at] >= options.start.least_grey ? 1 : 0;
      }
    }
  }
  for_each(missing, alive, [&](Hand& hand, std::size_t slot) {
    const std::span<float> line = line_of(start_px, slot);
    if (device_start) {
      device_start->read(slot, line);
    } else {
      hand.start->find(solver.size(), left_grey, right_grey, static_cast<int>(slot), line);
    }
    spread(hand, slots, slot, line);
    const std::span<const std::uint8_t> mask = slots[slot].mask;
    for (std::size_t at = 0; at < mask.size(); ++at) {
      line[at] = mask[at] != 0 ? line[at] : kNan;
    }
  });
}

/// What another surface hides from the right camera can have no match there.
void StereoMatcher::Impl::drop_hidden(std::vector<float>& nearest, std::span<const float> disparity_px,
                                      std::span<float> depth_mm) const {
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

void StereoMatcher::Impl::finish(Hand& hand, std::size_t slot, capture::DepthMap& map) const {
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
  drop_hidden(hand.nearest, disparity, map.depth_mm);
  hand.islands.drop(disparity, options.spacetime.break_px, options.least_island_px, map.depth_mm);
  for (std::size_t at = 0; at < count; ++at) {
    if (map.depth_mm[at] > 0) {
      map.sigma_mm[at] = sigma_mm(at);
      map.confidence[at] = capture::depth_confidence(map.sigma_mm[at]);
    }
  }
}

int thread_count(unsigned processors, int slots, std::size_t start_bytes) {
  const std::size_t fitting = kStartMemory_bytes / std::max<std::size_t>(start_bytes, 1);
  const auto most =
      std::min<std::size_t>({processors, static_cast<std::size_t>(slots), kMostThreads, fitting});
  return static_cast<int>(std::max<std::size_t>(most, 1));
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
std::size_t StereoMatcher::dispatch_count() const {
  return impl_->batch.counts().dispatches + impl_->solver.dispatch_count();
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
  std::vector<std::optional<std::uint64_t>> numbers = impl.keep_starts(slots);
  if (impl.rectify(slots) != gpu::Outcome::Done) {
    impl.failure = "the GPU was lost during rectification";
    return StereoOutcome::DeviceLost;
  }
  const float start_ms = impl.batch.stage_ms("start");  // 0 where the host finds start values
  impl.times.rectify_ms = ms_since(clock) - start_ms;
  clock = Clock::now();
  impl.find_start(slots, alive);
  for (std::size_t slot = 0; slot < numbers.size(); ++slot) {
    numbers[slot] = impl.told[slot] != 0 ? numbers[slot] : std::nullopt;
  }
  impl.numbers = std::move(numbers);
  impl.times.start_ms = ms_since(clock) + start_ms;
  clock = Clock::now();
  impl.solver.solve(impl.start_px, impl.field, alive);
  impl.times.solve_ms = ms_since(clock);
  if (impl.field.outcome != StereoOutcome::Done) {
    impl.failure = impl.field.failure;
    return impl.field.outcome;
  }
  clock = Clock::now();
  std::vector<std::size_t> wanted;
  for (std::size_t slot = 0; slot < slots.size(); ++slot) {
    if (slots[slot].wanted) {
      wanted.push_back(slot);
    }
  }
  impl.for_each(wanted, alive, [&](Hand& hand, std::size_t slot) {
    if (impl.look_at_fringes(hand, slots, slot)) {
      hand.fringes.refine(impl.line_of(impl.field.disparity_px, slot),
                          impl.line_of(impl.field.sigma_px, slot));
    }
    impl.finish(hand, slot, maps[slot]);
  });
  impl.times.finish_ms = ms_since(clock);
  return StereoOutcome::Done;
}

}  // namespace facet::stereo
