#include "stereo/fringe_matcher.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "facet/error.hpp"
#include "maths/srgb.hpp"

namespace facet::stereo {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
/// Slots further away tell more of motion than of the phase.
constexpr int kReach = 3;
/// An edge bends phases more than skin, radians.
constexpr float kMostBend_rad = 0.6F;
/// Neighbours that start further apart are of different pieces, px.
constexpr float kBreak_px = 1;
/// A piece that was reached by more than this part of it is known.
constexpr double kMostReached = 0.3;

// What drifts how fast, standard deviations a slot, of fringes whose amplitude is 1.
constexpr double kLight = 10;  // at the slot itself: any
constexpr double kLightDrift = 0.005;
constexpr double kAmplitudeDrift = 0.005;
constexpr double kPhaseDrift_rad = 0.1;
constexpr double kNoise = 0.02;
constexpr double kBlankOff = 0.05;  // a blank slot's light, from the fringes' mean
/// Of e^(i phase), what must come through the weights.
constexpr double kLeastTold = 0.9;

/// To -pi to pi.
float wrapped(float radians) {
  constexpr auto kTurn_rad = static_cast<float>(kTurn);
  return radians - kTurn_rad * std::nearbyint(radians / kTurn_rad);
}

}  // namespace

PhaseWeights phase_weights(std::span<const FringeSlot> slots) {
  constexpr std::size_t kLeastSlots = 3;
  if (slots.size() < kLeastSlots) {
    return {};
  }
  const auto count = static_cast<Eigen::Index>(slots.size());
  Eigen::MatrixXd grey(count, count);  // covariance of the grey values over all phases and drifts
  Eigen::VectorXcd shared(count);      // of each with e^(i phase)
  const auto kept = [](int slots_between) {
    return std::exp(-kPhaseDrift_rad * kPhaseDrift_rad * slots_between * slots_between / 2);
  };
  for (Eigen::Index i = 0; i < count; ++i) {
    const auto& [t, one] = slots[static_cast<std::size_t>(i)];
    for (Eigen::Index k = 0; k < count; ++k) {
      const auto& [s, other] = slots[static_cast<std::size_t>(k)];
      grey(i, k) = kLight * kLight + kLightDrift * kLightDrift * t * s + (i == k ? kNoise * kNoise : 0);
      if (one.blank && other.blank) {
        grey(i, k) += kBlankOff * kBlankOff;
      } else if (!one.blank && !other.blank) {
        grey(i, k) += std::cos(kTurn * (one.shift_turns - other.shift_turns)) * kept(t - s) *
                      (1 + kAmplitudeDrift * kAmplitudeDrift * t * s) / 2;
      }
    }
    shared[i] = one.blank ? 0 : std::polar(kept(t) / 2, kTurn * one.shift_turns);
  }
  const Eigen::VectorXcd weights = grey.cast<std::complex<double>>().ldlt().solve(shared).conjugate();
  const double told = (weights.array() * shared.array()).sum().real();
  if (!(told >= kLeastTold)) {
    return {};
  }
  PhaseWeights out;
  out.error_rad = std::sqrt(std::max(1 - told, 0.0));
  for (Eigen::Index i = 0; i < count; ++i) {
    out.of_slots.push_back(weights[i] / told);
  }
  return out;
}

FringeMatcher::FringeMatcher(std::span<const Eigen::Vector2f> left_sources,
                             std::span<const Eigen::Vector2f> right_sources, int width_px,
                             const FringeOptions& options)
    : width_(static_cast<std::size_t>(width_px)),
      height_(left_sources.size() / static_cast<std::size_t>(width_px)),
      options_(options) {
  constexpr int kMostSmooth_px = 4;
  if (!(options.noise > 0 && options.least_amplitude > 0 && options.least_slope_rad > 0 &&
        options.most_move_px > 0 && options.smooth_px >= 0 && options.smooth_px <= kMostSmooth_px &&
        options.most_carried_px >= 0 && options.most_carried_px < 256)) {
    throw Error(ErrorKind::Usage,
                "fringes: bounds are above 0, phases are averaged over 4 px around at most");
  }
  left_.sources = left_sources;
  right_.sources = right_sources;
}

std::size_t FringeMatcher::bytes(const capture::Lens& camera, std::size_t rectified_pixels) {
  const auto seen = static_cast<std::size_t>(camera.width_px) * static_cast<std::size_t>(camera.height_px);
  constexpr std::size_t kSeen = std::size_t{2} * 4 * sizeof(float);
  constexpr std::size_t kRectified =
      std::size_t{2} * 2 * sizeof(float) + sizeof(float) + 2 + 3 * sizeof(std::size_t);
  return kSeen * seen + kRectified * rectified_pixels;
}

/// Sums of the slots' linear grey, and from them phases with their variances (S12).
void FringeMatcher::sum_up(std::span<const Frame* const> frames,
                           std::span<const std::complex<double>> weights, View& view) const {
  const auto width = static_cast<std::size_t>(frames.front()->width_px);
  const int height = frames.front()->height_px;
  const std::size_t pixels = width * static_cast<std::size_t>(height);
  std::array<float, 256> linear = maths::decoded_srgb8();  // a third of it: three channels are summed
  for (std::size_t value = 0; value < linear.size(); ++value) {
    linear[value] = static_cast<float>(value) / 255 < options_.saturated ? linear[value] / 3 : kNan;
  }
  // Sums of sine and cosine first, then phase and variance.
  view.seen_rad.assign(pixels, 0);
  view.seen_variance.assign(pixels, 0);
  double square = 0;
  for (std::size_t k = 0; k < frames.size(); ++k) {
    square += std::norm(weights[k]);
    const auto cosine = static_cast<float>(weights[k].real());
    const auto sine = static_cast<float>(weights[k].imag());
    for (int y = 0; y < height; ++y) {
      const std::uint8_t* rgba = frames[k]->row(y);
      float* cosines = view.seen_variance.data() + static_cast<std::size_t>(y) * width;
      float* sines = view.seen_rad.data() + static_cast<std::size_t>(y) * width;
      for (std::size_t x = 0; x < width; ++x) {
        const float grey = linear[rgba[4 * x]] + linear[rgba[4 * x + 1]] + linear[rgba[4 * x + 2]];
        cosines[x] += cosine * grey;
        sines[x] += sine * grey;
      }
    }
  }
  const float noise = options_.noise * options_.noise * static_cast<float>(square / 2);
  const float least = options_.least_amplitude * options_.least_amplitude;
  for (std::size_t at = 0; at < pixels; ++at) {
    float& phase = view.seen_rad[at];
    float& variance = view.seen_variance[at];
    const float power = phase * phase + variance * variance;
    const bool known = power >= least;  // not where one is saturated
    phase = known ? std::atan2(phase, variance) : kNan;
    variance = known ? noise / power : 0;
  }
}

/// Averages in pairs opposite of each other, so that slopes do not count.
void FringeMatcher::smooth(int width, int height, View& view) const {
  view.smooth_rad = view.seen_rad;
  view.smooth_variance = view.seen_variance;
  const int reach = options_.smooth_px;
  std::vector<std::ptrdiff_t> steps;
  for (int y = 0; y <= reach; ++y) {
    for (int x = y == 0 ? 1 : -reach; x <= reach; ++x) {
      steps.push_back(static_cast<std::ptrdiff_t>(y) * width + x);
    }
  }
  for (int y = reach; y < height - reach; ++y) {
    for (int x = reach; x < width - reach; ++x) {
      const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(y) * width + x;
      const float* phase = view.seen_rad.data() + at;
      const float* variance = view.seen_variance.data() + at;
      if (std::isnan(*phase)) {
        continue;
      }
      float weight = 1 / *variance;
      float sum = 0;
      for (const std::ptrdiff_t step : steps) {
        const float bend = wrapped(phase[step] - *phase) + wrapped(phase[-step] - *phase);
        if (std::abs(bend) < kMostBend_rad) {  // not where one has none
          const float pair = 4 / (variance[step] + variance[-step]);
          weight += pair;
          sum += pair * bend / 2;
        }
      }
      view.smooth_rad[static_cast<std::size_t>(at)] = *phase + sum / weight;
      view.smooth_variance[static_cast<std::size_t>(at)] = 1 / weight;
    }
  }
}

/// Between pixels, phases are as good as straight.
void FringeMatcher::rectify(int width, int height, View& view) {
  view.phase_rad.assign(view.sources.size(), kNan);
  view.variance.assign(view.sources.size(), 0);
  for (std::size_t at = 0; at < view.sources.size(); ++at) {
    const Eigen::Vector2f& from = view.sources[at];
    const auto x = static_cast<int>(std::floor(from.x()));
    const auto y = static_cast<int>(std::floor(from.y()));
    if (x < 0 || y < 0 || x + 1 >= width || y + 1 >= height) {
      continue;
    }
    const auto corner =
        static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
    const std::size_t below = corner + static_cast<std::size_t>(width);
    const float across = from.x() - static_cast<float>(x);
    const float down = from.y() - static_cast<float>(y);
    const std::vector<float>& phase = view.smooth_rad;
    const float upper = across * wrapped(phase[corner + 1] - phase[corner]);
    const float lower =
        wrapped(phase[below] - phase[corner]) + across * wrapped(phase[below + 1] - phase[below]);
    view.phase_rad[at] = wrapped(phase[corner] + (1 - down) * upper + down * lower);
    const std::vector<float>& variance = view.smooth_variance;
    view.variance[at] =
        std::max({variance[corner], variance[corner + 1], variance[below], variance[below + 1]});
  }
}

bool FringeMatcher::look(std::span<const FringePictures> slots) {
  std::vector<FringeSlot> fringes;
  std::vector<const Frame*> left;
  std::vector<const Frame*> right;
  for (const FringePictures& slot : slots) {
    if (std::abs(slot.slot.slots_away) <= kReach) {
      fringes.push_back(slot.slot);
      left.push_back(slot.left);
      right.push_back(slot.right);
    }
  }
  const PhaseWeights weights = phase_weights(fringes);
  if (weights.of_slots.empty()) {
    return false;
  }
  error_rad_ = static_cast<float>(weights.error_rad);
  const auto see = [&](std::span<const Frame* const> frames, View& view) {
    sum_up(frames, weights.of_slots, view);
    smooth(frames.front()->width_px, frames.front()->height_px, view);
    rectify(frames.front()->width_px, frames.front()->height_px, view);
  };
  see(left, left_);
  see(right, right_);
  return true;
}

/// Where the right camera sees the phase of a left pixel, by Newton's method. False where it sees none near
/// start_px.
bool FringeMatcher::match(std::size_t at, float start_px, Match& found) const {
  constexpr int kSteps = 3;
  const auto x = static_cast<float>(at % width_);
  const float* phase = right_.phase_rad.data() + at / width_ * width_;
  const float wanted = left_.phase_rad[at];
  const float begin_px = x - start_px;
  float at_px = begin_px;
  float slope = 0;
  std::ptrdiff_t before = 0;
  for (int step = 0; step < kSteps; ++step) {
    before = static_cast<std::ptrdiff_t>(std::floor(at_px));
    if (before < 1 || before + 2 >= static_cast<std::ptrdiff_t>(width_)) {
      return false;
    }
    const float here = wrapped(phase[before + 1] - phase[before]);
    slope =
        (wrapped(phase[before] - phase[before - 1]) + here + wrapped(phase[before + 2] - phase[before + 1])) /
        3;
    const float off = wrapped(wanted - phase[before] - (at_px - static_cast<float>(before)) * here);
    at_px += off / (2 * here * slope > slope * slope ? here : slope);
    // Not where one of the phases is not known.
    if (!(std::abs(slope) >= options_.least_slope_rad &&
          std::abs(at_px - begin_px) <= options_.most_move_px)) {
      return false;
    }
  }
  const float variance =
      left_.variance[at] + right_.variance[at / width_ * width_ + static_cast<std::size_t>(before)];
  const float drift_rad = options_.own_drift * error_rad_;
  found = {x - at_px, std::sqrt(variance + drift_rad * drift_rad) / std::abs(slope)};
  return true;
}

template <typename Work>
void FringeMatcher::for_neighbours(std::size_t at, const Work& work) const {
  const std::size_t x = at % width_;
  if (x > 0) {
    work(at - 1);
  }
  if (x + 1 < width_) {
    work(at + 1);
  }
  if (at >= width_) {
    work(at - width_);
  }
  if (at + width_ < width_ * height_) {
    work(at + width_);
  }
}

void FringeMatcher::find_pieces(std::span<const float> start_px) {
  members_.clear();
  pieces_.clear();
  reached_.assign(start_px.size(), 0);
  std::vector<std::size_t> begins;
  for (std::size_t first = 0; first < start_px.size(); ++first) {
    if (std::isnan(start_px[first]) || reached_[first] != 0) {
      continue;
    }
    begins.push_back(members_.size());
    reached_[first] = 1;
    members_.push_back(first);
    for (std::size_t k = begins.back(); k < members_.size(); ++k) {
      const std::size_t at = members_[k];
      for_neighbours(at, [&](std::size_t next) {
        if (reached_[next] == 0 && std::abs(start_px[next] - start_px[at]) < kBreak_px) {
          reached_[next] = 1;
          members_.push_back(next);
        }
      });
    }
  }
  begins.push_back(members_.size());
  for (std::size_t k = 0; k + 1 < begins.size(); ++k) {
    const std::size_t size = begins[k + 1] - begins[k];
    if (size >= options_.least_piece_px) {
      pieces_.push_back(std::span(members_).subspan(begins[k], size));
    }
  }
  std::stable_sort(pieces_.begin(), pieces_.end(),
                   [](const auto& one, const auto& other) { return one.size() > other.size(); });
}

/// From a piece's pixels to those beside them, as far as phases go on, and a few pixels over where none is
/// known.
void FringeMatcher::follow(std::span<const std::size_t> piece, std::span<const float> start_px,
                           std::span<const std::uint8_t> lit) {
  Match found;
  wave_.clear();
  for (const std::size_t at : piece) {
    if (std::isnan(followed_px_[at]) && match(at, start_px[at], found)) {
      followed_px_[at] = found.disparity_px;
      wave_.push_back(at);
    }
  }
  while (!wave_.empty()) {
    next_wave_.clear();
    for (std::size_t k = 0; k < wave_.size(); ++k) {
      const std::size_t at = wave_[k];
      for_neighbours(at, [&](std::size_t next) {
        const bool fresh = std::isnan(followed_px_[next]);
        if ((fresh || (carried_[next] > 0 && carried_[at] == 0)) && lit[next] != 0 &&
            match(next, followed_px_[at], found)) {
          followed_px_[next] = found.disparity_px;
          carried_[next] = 0;
          wave_.push_back(next);
        } else if (fresh && lit[next] != 0 && carried_[at] < options_.most_carried_px) {
          followed_px_[next] = followed_px_[at];
          carried_[next] = static_cast<std::uint8_t>(carried_[at] + 1);
          next_wave_.push_back(next);
        }
      });
    }
    std::swap(wave_, next_wave_);
  }
}

void FringeMatcher::spread(std::span<float> start_px, std::span<const std::uint8_t> lit) {
  find_pieces(start_px);
  followed_px_.assign(start_px.size(), kNan);
  carried_.assign(start_px.size(), 0);
  for (const std::span<std::size_t>& piece : pieces_) {
    const auto reached = std::count_if(piece.begin(), piece.end(),
                                       [&](std::size_t at) { return !std::isnan(followed_px_[at]); });
    if (static_cast<double>(reached) <= kMostReached * static_cast<double>(piece.size())) {
      follow(piece, start_px, lit);
    }
  }
  std::copy(followed_px_.begin(), followed_px_.end(), start_px.begin());
}

std::size_t FringeMatcher::refine(std::span<float> disparity_px, std::span<float> sigma_px) const {
  std::size_t refined = 0;
  if (!can_refine()) {
    return refined;
  }
  Match found;
  for (std::size_t at = 0; at < disparity_px.size(); ++at) {
    if (sigma_px[at] > 0 && match(at, disparity_px[at], found)) {
      disparity_px[at] = found.disparity_px;
      sigma_px[at] = found.sigma_px;
      ++refined;
    }
  }
  return refined;
}

}  // namespace facet::stereo
