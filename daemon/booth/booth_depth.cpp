#include "booth/booth_depth.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <limits>
#include <optional>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "stereo/stereo_matcher.hpp"

namespace facet::booth {
namespace {

constexpr double kBefore_mm = 150;
constexpr double kBehind_mm = 250;
/// Least eigenvalue of the mean of (I - a a^T) over the axes a: half of sin^2 of the angle between two.
constexpr double kLeastConvergence = 1e-3;
constexpr std::chrono::seconds kReopenPause{2};

Eigen::Vector3d axis_of(const capture::Lens& lens) {
  return lens.camera_from_rig.linear().row(2).transpose();
}

}  // namespace

stereo::DepthRange depth_range(const capture::Rig& rig) {
  Eigen::Matrix3d across = Eigen::Matrix3d::Zero();
  Eigen::Vector3d at = Eigen::Vector3d::Zero();
  double count = 0;
  for (const capture::StereoPair& pair : rig.pairs) {
    for (const std::size_t camera : {pair.left, pair.right}) {
      const capture::Lens& lens = rig.cameras.at(camera).lens;
      const Eigen::Vector3d axis = axis_of(lens);
      const Eigen::Matrix3d projector = Eigen::Matrix3d::Identity() - axis * axis.transpose();
      across += projector;
      at += projector * lens.centre_mm();
      ++count;
    }
  }
  const bool meet =
      count > 0 &&
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(across / count).eigenvalues()[0] > kLeastConvergence;
  const Eigen::Vector3d point = meet ? Eigen::Vector3d(across.ldlt().solve(at)) : Eigen::Vector3d::Zero();
  double nearest = std::numeric_limits<double>::max();
  double farthest = 0;
  for (const capture::StereoPair& pair : rig.pairs) {
    const double depth = (rig.cameras.at(pair.left).lens.camera_from_rig * point).z();
    nearest = std::min(nearest, depth);
    farthest = std::max(farthest, depth);
  }
  if (!meet || !(nearest > 2 * kBefore_mm)) {
    throw Error(ErrorKind::Usage,
                "the rig's pairs do not look at one point in front of them: say with depth_mm between which "
                "distances the face is");
  }
  return {static_cast<float>(nearest - kBefore_mm), static_cast<float>(farthest + kBehind_mm)};
}

std::string why_no_depth(const capture::SlotProgram& program) {
  using Kind = capture::SlotLight::Kind;
  constexpr auto kReach = static_cast<int>(kDepthReach);
  if (std::none_of(program.begin(), program.end(),
                   [](const capture::SlotLight& light) { return light.kind == Kind::Fringes; })) {
    return {};
  }
  for (std::size_t slot = 0; slot < program.size(); ++slot) {
    if (program[slot].kind != Kind::Blank) {
      continue;
    }
    std::vector<stereo::FringeSlot> around;
    bool has_stripes = false;
    for (int away = -kReach; away <= kReach; ++away) {
      const auto at = static_cast<std::int64_t>(slot + kDepthReach * program.size()) + away;
      const capture::SlotLight& light = capture::light_of_slot(program, static_cast<std::uint64_t>(at));
      has_stripes = has_stripes || light.kind == Kind::Stripes;
      if (light.kind == Kind::Blank || light.kind == Kind::Fringes) {
        around.push_back({away, {light.quarters / 4.0, light.kind == Kind::Blank}});
      }
    }
    if (!has_stripes && stereo::phase_weights(around).of_slots.empty()) {
      return fmt::format(
          "slot {} of the program {} is blank, and the fringes within {} slots of it tell no "
          "depth: give it two slots with fringes on either side, each shifted further, as in {}",
          slot, capture::to_text(program), kReach, capture::to_text(capture::fringe_program()));
    }
  }
  return {};
}

struct BoothDepth::Impl {
  Impl(std::string given_device, std::shared_ptr<const capture::Rig> given_rig,
       const stereo::StereoOptions& given_options, Starts given_starts)
      : gpu_device(std::move(given_device)),
        rig(std::move(given_rig)),
        options(given_options),
        starts(given_starts) {}

  std::string gpu_device;
  std::shared_ptr<const capture::Rig> rig;
  stereo::StereoOptions options;
  Starts starts;
  std::optional<gpu::Context> context;                           ///< nothing while the device is lost
  std::vector<std::unique_ptr<stereo::StereoMatcher>> matchers;  ///< [pair]
  Clock::time_point next_try;
  std::vector<stereo::StereoSlot> slots;
  std::vector<capture::DepthMap> pair_maps;

  void open() {
    gpu::ContextOptions wanted;
    wanted.device = gpu_device;
    context.emplace(wanted);
    for (const capture::StereoPair& pair : rig->pairs) {
      matchers.push_back(std::make_unique<stereo::StereoMatcher>(*context, *rig, pair, options));
    }
  }

  void close() {
    matchers.clear();
    context.reset();
    next_try = Clock::now() + kReopenPause;
  }

  /// What keeps it from being open; empty where it is.
  std::string reopen() {
    if (context) {
      return {};
    }
    if (Clock::now() >= next_try) {
      try {
        open();
        return {};
      } catch (const Error& error) {
        close();
        return fmt::format("no depth: {}", error.what());
      }
    }
    return "no depth: the GPU was lost and is opened again in a moment";
  }

  /// What is wrong, for people.
  std::string match(std::size_t pair, const stereo::Alive& alive) {
    const stereo::StereoOutcome outcome = matchers[pair]->match(slots, pair_maps, alive);
    if (outcome == stereo::StereoOutcome::Done) {
      return {};
    }
    const capture::StereoPair& cameras = rig->pairs[pair];
    std::string wrong = fmt::format("no depth from cameras {} and {}: {}", rig->cameras[cameras.left].name,
                                    rig->cameras[cameras.right].name, matchers[pair]->failure());
    if (outcome == stereo::StereoOutcome::DeviceLost) {
      close();
    }
    return wrong;
  }
};

BoothDepth::BoothDepth(const std::string& gpu_device, std::shared_ptr<const capture::Rig> rig,
                       stereo::DepthRange depths, int most_slots, Starts starts) {
  if (rig->pairs.empty()) {
    throw Error(ErrorKind::Usage,
                "the rig has no stereo pair: add a section [[pair]] to its file; without projectors see "
                "docs/cameras.md");
  }
  stereo::StereoOptions options;
  options.depths = depths.farthest_mm > 0 ? depths : depth_range(*rig);
  options.most_slots = most_slots;
  impl_ = std::make_unique<Impl>(gpu_device, std::move(rig), options, starts);
  impl_->open();
}

BoothDepth::~BoothDepth() = default;

const stereo::DepthRange& BoothDepth::depths() const {
  return impl_->options.depths;
}

std::string BoothDepth::device() const {
  return impl_->context ? impl_->context->info().name : "";
}

std::string BoothDepth::kernels_ignored() const {
  return impl_->context ? impl_->context->kernel_cache().ignored : "";
}

std::string BoothDepth::find(std::uint64_t first_slot, std::span<const DepthSlot> slots,
                             std::vector<std::vector<capture::DepthMap>>& maps, const stereo::Alive& alive) {
  Impl& impl = *impl_;
  const auto wanted = static_cast<std::size_t>(
      std::count_if(slots.begin(), slots.end(), [](const DepthSlot& slot) { return slot.wanted; }));
  const std::size_t pair_count = impl.rig->pairs.size();
  maps.assign(wanted, std::vector<capture::DepthMap>(pair_count));
  std::string wrong = impl.reopen();
  for (std::size_t pair = 0; pair < pair_count && impl.context; ++pair) {
    const capture::StereoPair& cameras = impl.rig->pairs[pair];
    impl.slots.clear();
    for (const DepthSlot& slot : slots) {
      stereo::StereoSlot& one = impl.slots.emplace_back();
      one.has_pattern = slot.has_pattern;
      one.fringes = slot.fringes;
      one.wanted = slot.wanted;
      if (impl.starts == Starts::KeptOfTheRunBefore && slot.set != nullptr) {
        one.number = first_slot + impl.slots.size() - 1;
      }
      if (slot.set != nullptr) {
        one.left = slot.set->frames.at(cameras.left);
        one.right = slot.set->frames.at(cameras.right);
      }
    }
    if (const std::string failure = impl.match(pair, alive); !failure.empty()) {
      wrong = failure;
    }
    std::size_t at = 0;
    for (std::size_t i = 0; i < slots.size(); ++i) {
      if (slots[i].wanted) {
        maps[at++][pair] = std::move(impl.pair_maps[i]);
      }
    }
  }
  impl.slots.clear();
  return wrong;
}

}  // namespace facet::booth
