#include "scan/phase_decoder.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>
#include <optional>

#include "facet/error.hpp"
#include "maths/srgb.hpp"
#include "maths/statistics.hpp"

namespace facet::scan {
namespace {

using capture::AxisCode;
using capture::CodeAxis;
using capture::CodedPicture;
using Kind = capture::CodedPicture::Kind;

constexpr float kPi = std::numbers::pi_v<float>;
constexpr double kTurn = 2 * std::numbers::pi;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kGreyScale = 32767;  // of a stored Gray bit

/// To -pi ... pi.
double wrapped(double angle) {
  return angle - kTurn * std::round(angle / kTurn);
}
/// To 0 ... 2 pi.
double in_turn(double angle) {
  return angle - kTurn * std::floor(angle / kTurn);
}

float linear_of(float coded, Response response) {
  if (response == Response::Linear) {
    return coded;
  }
  return maths::decode_srgb(coded);
}

/// Sums over the shifts of a fringe set, from which its sine follows.
struct SetSums {
  std::vector<float> sum, square, sine, cosine;  ///< [pixels]

  explicit SetSums(std::size_t pixels) : sum(pixels), square(pixels), sine(pixels), cosine(pixels) {}
};

/// Of one pixel: I_k = mean + modulation cos(phase - 2 pi k / N).
struct Sine {
  float mean = 0;
  float modulation = 0;
  float phase = 0;  ///< -pi to pi
  float rest = 0;   ///< sum of the squares of what is no sine; 0 for three shifts
};

Sine sine_of(const SetSums& sums, int shifts, std::size_t at) {
  const auto n = static_cast<float>(shifts);
  Sine out;
  out.mean = sums.sum[at] / n;
  out.modulation = 2 / n * std::hypot(sums.sine[at], sums.cosine[at]);
  out.phase = std::atan2(sums.sine[at], sums.cosine[at]);
  if (shifts > 3) {
    out.rest =
        std::max(sums.square[at] - n * out.mean * out.mean - n / 2 * out.modulation * out.modulation, 0.0F);
  }
  return out;
}

/// What is no sine (rms), parts of the modulation.
float residual_of(const Sine& sine, int shifts) {
  return std::sqrt(sine.rest / static_cast<float>(shifts)) / sine.modulation;
}

struct AxisSums {
  std::vector<SetSums> sets;
  std::vector<std::vector<std::int16_t>> gray;  ///< [bits][pixels] bit, or bit - inverse
};

/// The Gray code's number at a pixel, and how clear the bits are that change at its two ends.
struct GrayNumber {
  int cell = 0;
  float below = 0;   ///< of the bit that changes between cell - 1 and cell, parts of the modulation
  float above = 0;   ///< between cell and cell + 1
  float second = 0;  ///< of the second least clear bit
};

/// How fringes and code lie to each other.
struct CodeFit {
  int sign = 1;
  int cells = 1;  ///< a period
  double start = 0;
  double agreement = 0;
  std::string failure;
};

}  // namespace

const char* to_string(PhaseFault fault) {
  switch (fault) {
    case PhaseFault::None:
      return "decoded";
    case PhaseFault::Unlit:
      return "not lit";
    case PhaseFault::Saturated:
      return "saturated";
    case PhaseFault::Gray:
      return "Gray code unclear";
    case PhaseFault::Residual:
      return "no sine";
    case PhaseFault::Order:
      return "period unclear";
  }
  return "";
}

struct PhaseDecoder::Impl {
  capture::CodeSequence sequence;
  int width;
  int height;
  std::size_t pixels;
  DecodeOptions options;
  std::array<AxisSums, 2> axes;
  std::vector<float> white, black;
  std::vector<std::uint8_t> saturated;  ///< [pixels]
  std::vector<bool> given;              ///< [pictures]

  const AxisCode& code(std::size_t axis) const { return sequence.axis(static_cast<CodeAxis>(axis)); }
  std::size_t finest(std::size_t axis) const {
    const auto& sets = code(axis).fringes;
    return static_cast<std::size_t>(
        std::max_element(sets.begin(), sets.end(),
                         [](const auto& a, const auto& b) { return a.periods < b.periods; }) -
        sets.begin());
  }

  GrayNumber gray_number(std::size_t axis, const Sine& sine, std::size_t at) const;
  CodeFit fit_gray(std::size_t axis, const std::vector<Sine>& sines, const std::vector<GrayNumber>& numbers,
                   const std::vector<PhaseFault>& fault) const;
  void unwrap_by_gray(std::size_t axis, const std::vector<Sine>& sines, PhaseField& field,
                      std::vector<PhaseFault>& fault) const;
  void unwrap_by_sets(std::size_t axis, PhaseField& field, std::vector<PhaseFault>& fault) const;
  std::vector<float> grey_noise(const std::vector<Sine>& sines, int shifts,
                                const std::vector<PhaseFault>& fault) const;
  void drop_lonely(PhaseField& field, std::vector<PhaseFault>& fault) const;
  void smooth(PhaseField& field) const;
  void decode_axis(std::size_t axis, PhaseField& field, DecodedView& view) const;
};

PhaseDecoder::PhaseDecoder(const capture::CodeSequence& sequence, int width_px, int height_px,
                           const DecodeOptions& options)
    : impl_(std::make_unique<Impl>()) {
  if (width_px < 1 || height_px < 1) {
    throw Error(ErrorKind::Usage, fmt::format("phase pictures of {}x{} px", width_px, height_px));
  }
  if (!(options.least_modulation > 0 && options.least_bit >= 0 && options.most_residual > 0 &&
        options.noise > 0 && options.smooth_px >= 0 && options.smooth_px <= 8)) {
    throw Error(ErrorKind::Usage, "phase decoding: bounds are above 0, the smoothing radius is 0 to 8 px");
  }
  Impl& impl = *impl_;
  impl.sequence = sequence;
  impl.width = width_px;
  impl.height = height_px;
  impl.pixels = static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  impl.options = options;
  for (std::size_t axis = 0; axis < 2; ++axis) {
    const AxisCode& code = impl.code(axis);
    impl.axes[axis].sets.assign(code.fringes.size(), SetSums(impl.pixels));
    impl.axes[axis].gray.assign(static_cast<std::size_t>(code.gray_bits),
                                std::vector<std::int16_t>(impl.pixels));
  }
  impl.white.resize(sequence.white ? impl.pixels : 0);
  impl.black.resize(sequence.black ? impl.pixels : 0);
  impl.saturated.resize(impl.pixels);
  impl.given.resize(sequence.pictures.size());
}
PhaseDecoder::~PhaseDecoder() = default;
PhaseDecoder::PhaseDecoder(PhaseDecoder&& other) noexcept = default;
PhaseDecoder& PhaseDecoder::operator=(PhaseDecoder&& other) noexcept = default;

void PhaseDecoder::add(std::size_t picture, std::span<const float> grey) {
  Impl& impl = *impl_;
  if (picture >= impl.given.size() || impl.given[picture]) {
    throw Error(ErrorKind::Usage,
                fmt::format("picture {} of a sequence of {}: {}", picture + 1, impl.given.size(),
                            picture < impl.given.size() ? "given before" : "not in it"));
  }
  if (grey.size() != impl.pixels) {
    throw Error(ErrorKind::Usage, fmt::format("picture {}: {} pixels, not {}x{}", picture + 1, grey.size(),
                                              impl.width, impl.height));
  }
  impl.given[picture] = true;
  const CodedPicture& shown = impl.sequence.pictures[picture];
  AxisSums& axis = impl.axes[static_cast<std::size_t>(shown.axis)];
  switch (shown.kind) {
    case Kind::Phase: {
      SetSums& sums = axis.sets[shown.set];
      const double shift =
          kTurn * shown.index / impl.code(static_cast<std::size_t>(shown.axis)).fringes[shown.set].shifts;
      const auto sine = static_cast<float>(std::sin(shift));
      const auto cosine = static_cast<float>(std::cos(shift));
      for (std::size_t at = 0; at < impl.pixels; ++at) {
        const float value = linear_of(grey[at], impl.options.response);
        sums.sum[at] += value;
        sums.square[at] += value * value;
        sums.sine[at] += value * sine;
        sums.cosine[at] += value * cosine;
        impl.saturated[at] = impl.saturated[at] != 0 || grey[at] >= impl.options.saturated ? 1 : 0;
      }
      break;
    }
    case Kind::Gray:
    case Kind::GrayInverse: {
      const float scale = shown.kind == Kind::Gray ? kGreyScale : -kGreyScale;
      std::vector<std::int16_t>& bit = axis.gray[static_cast<std::size_t>(shown.index)];
      for (std::size_t at = 0; at < impl.pixels; ++at) {
        const float value = std::clamp(linear_of(grey[at], impl.options.response), 0.0F, 1.0F);
        bit[at] = static_cast<std::int16_t>(static_cast<float>(bit[at]) + scale * value);
      }
      break;
    }
    case Kind::White:
    case Kind::Black: {
      std::vector<float>& all = shown.kind == Kind::White ? impl.white : impl.black;
      std::transform(grey.begin(), grey.end(), all.begin(),
                     [&](float value) { return linear_of(value, impl.options.response); });
      break;
    }
    case Kind::Skip:
      break;
  }
}

GrayNumber PhaseDecoder::Impl::gray_number(std::size_t axis, const Sine& sine, std::size_t at) const {
  const AxisCode& code_here = code(axis);
  const auto bits = static_cast<std::size_t>(code_here.gray_bits);
  // Grey between black and white: the mean of both, or of the sine, whose modulation is half their
  // difference.
  const float middle = sequence.white && sequence.black ? (white[at] + black[at]) / 2 : sine.mean;
  std::array<float, 16> clear{};
  GrayNumber out;
  unsigned before = 0;
  float least = std::numeric_limits<float>::max();
  out.second = least;
  for (std::size_t bit = 0; bit < bits; ++bit) {
    const float value = static_cast<float>(axes[axis].gray[bit][at]) / kGreyScale;
    const float excess = code_here.gray_inverse ? value / 2 : value - middle;
    before ^= excess > 0 ? 1U : 0U;  // binary from Gray: the exclusive or of all bits so far
    out.cell = 2 * out.cell + static_cast<int>(before);
    clear[bit] = std::abs(excess) / sine.modulation;
    out.second = std::min(out.second, std::max(clear[bit], least));
    least = std::min(least, clear[bit]);
  }
  // Between c - 1 and c changes the bit that c's binary number has its last 1 at.
  const auto changing = [&](int cell) {
    const auto from_last = static_cast<std::size_t>(std::countr_zero(static_cast<unsigned>(cell)));
    return from_last < bits ? clear[bits - 1 - from_last] : std::numeric_limits<float>::max();
  };
  out.below = changing(out.cell);
  out.above = changing(out.cell + 1);
  return out;
}

/// From neighbouring pixels: by how many cells the code rises when the phase makes a turn, in which
/// direction, and at which phase its cells begin. Nothing is known of the order of shifts or of what phase 0
/// is.
CodeFit PhaseDecoder::Impl::fit_gray(std::size_t axis, const std::vector<Sine>& sines,
                                     const std::vector<GrayNumber>& numbers,
                                     const std::vector<PhaseFault>& fault) const {
  constexpr int kMostCells = 64;
  constexpr int kMostJump = 3;
  constexpr double kLeastAgreement = 0.5;
  const auto for_pairs = [&](const auto& work) {
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const std::size_t at =
            static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
        for (const bool below : {false, true}) {
          if (below ? y + 1 >= height : x + 1 >= width) {
            continue;
          }
          const std::size_t next = at + (below ? static_cast<std::size_t>(width) : 1);
          if (fault[at] != PhaseFault::None || fault[next] != PhaseFault::None) {
            continue;
          }
          const double turn = wrapped(static_cast<double>(sines[next].phase - sines[at].phase));
          const int cells = numbers[next].cell - numbers[at].cell;
          if (std::abs(turn) < kTurn / 4 && std::abs(cells) <= kMostJump) {
            work(at, next, turn, cells);
          }
        }
      }
    }
  };
  double products = 0;
  double squares = 0;
  for_pairs([&](std::size_t, std::size_t, double turn, int cells) {
    products += cells * turn;
    squares += turn * turn;
  });
  CodeFit fit;
  const double rise = squares > 0 ? products / squares * kTurn : 0;  // cells a period, with sign
  fit.sign = rise < 0 ? -1 : 1;
  fit.cells = static_cast<int>(std::lround(std::abs(rise)));
  const char* name = static_cast<CodeAxis>(axis) == CodeAxis::Columns ? "columns" : "rows";
  if (!(squares > 0)) {
    fit.failure = fmt::format("{}: no pixel sees fringes and Gray code", name);
    return fit;
  }
  if (fit.cells < 1 || fit.cells > kMostCells || std::abs(std::abs(rise) - fit.cells) > 0.25 * fit.cells) {
    fit.failure = fmt::format(
        "{}: the Gray code rises by {:.2f} where the phase makes a turn, it should by a whole number from 1 "
        "on: are the pictures in the order that the sequence says?",
        name, rise);
    return fit;
  }
  std::complex<double> sum;
  double count = 0;
  for_pairs([&](std::size_t at, std::size_t, double turn, int cells) {
    if (std::abs(cells) == 1 && cells * fit.sign * turn > 0) {
      const int upper = numbers[at].cell + std::max(cells, 0);
      const double phase = fit.sign * (static_cast<double>(sines[at].phase) + turn / 2);
      sum += std::polar(1.0, phase - kTurn * (upper % fit.cells) / fit.cells);
      count += 1;
    }
  });
  fit.agreement = count > 0 ? std::abs(sum) / count : 0;
  // Told to some hundredths of a radian; draw_coded's is 0.
  constexpr double kAsDrawn_rad = 0.03;
  fit.start = std::abs(std::arg(sum)) < kAsDrawn_rad ? 0 : std::arg(sum);
  if (fit.agreement < kLeastAgreement) {
    fit.failure = fmt::format(
        "{}: the Gray code's numbers change at all phases of the fringes (agreement {:.2f}, {} at least): "
        "are "
        "the pictures in the order that the sequence says?",
        name, fit.agreement, kLeastAgreement);
  }
  return fit;
}

void PhaseDecoder::Impl::unwrap_by_gray(std::size_t axis, const std::vector<Sine>& sines, PhaseField& field,
                                        std::vector<PhaseFault>& fault) const {
  std::vector<GrayNumber> numbers(pixels);
  for (std::size_t at = 0; at < pixels; ++at) {
    if (fault[at] == PhaseFault::None) {
      numbers[at] = gray_number(axis, sines[at], at);
      fault[at] = numbers[at].second >= options.least_bit ? PhaseFault::None : PhaseFault::Gray;
    }
  }
  const CodeFit fit = fit_gray(axis, sines, numbers, fault);
  field.reversed = fit.sign < 0;
  field.cells_per_period = fit.cells;
  field.agreement = fit.agreement;
  field.start_rad = fit.start;
  field.why_no_phases = fit.failure;
  if (!fit.failure.empty()) {
    for (PhaseFault& here : fault) {
      here = here == PhaseFault::None ? PhaseFault::Order : here;
    }
    return;
  }
  const double most_turn = field.periods > 0 ? std::ceil(field.periods) : 1e9;
  for (std::size_t at = 0; at < pixels; ++at) {
    if (fault[at] != PhaseFault::None) {
      continue;
    }
    const GrayNumber& number = numbers[at];
    const double part = in_turn(fit.sign * static_cast<double>(sines[at].phase) - fit.start);
    double turn = 0;
    if (fit.cells > 1) {
      turn = std::round((number.cell + 0.5) / fit.cells - part / kTurn);
    } else {
      // The one bit that is near its change says which of the two ends is near, the phase on which side of
      // it.
      constexpr float kUnclear = 0.5F;  // of the clear one's distance from grey: noise does not halve it
      turn = number.cell;
      turn += part < kTurn / 4 && number.above < kUnclear * number.below ? 1 : 0;
      turn -= part > 3 * kTurn / 4 && number.below < kUnclear * number.above ? 1 : 0;
    }
    if (turn < 0 || turn >= most_turn) {
      fault[at] = PhaseFault::Gray;
      continue;
    }
    field.phase_rad[at] = static_cast<float>(fit.start + part + kTurn * turn);
  }
}

/// Among all periods of the finest set the one that the other sets' phases fit best.
void PhaseDecoder::Impl::unwrap_by_sets(std::size_t axis, PhaseField& field,
                                        std::vector<PhaseFault>& fault) const {
  const std::vector<capture::FringeSet>& sets = code(axis).fringes;
  const std::size_t best_set = finest(axis);
  const double periods = sets[best_set].periods;
  const int candidates = static_cast<int>(std::ceil(periods - 1e-9));
  std::vector<std::size_t> others;
  for (std::size_t set = 0; set < sets.size(); ++set) {
    if (set != best_set) {
      others.push_back(set);
    }
  }
  // What a wrong period costs at least.
  double separation = std::numeric_limits<double>::max();
  for (int wrong = 1; wrong < candidates; ++wrong) {
    double cost = 0;
    for (const std::size_t set : others) {
      const double off = wrapped(kTurn * sets[set].periods * wrong / periods);
      cost += off * off;
    }
    separation = std::min(separation, cost);
  }
  constexpr double kLeastSeparation = 0.01;  // rad^2
  const char* name = static_cast<CodeAxis>(axis) == CodeAxis::Columns ? "columns" : "rows";
  if (separation < kLeastSeparation) {
    field.why_no_phases =
        fmt::format("{}: these numbers of periods do not tell {:g} periods apart", name, periods);
  }
  struct Choice {
    int turn = 0;
    double cost = std::numeric_limits<double>::max();
    double second = std::numeric_limits<double>::max();
    double part = 0;
  };
  std::vector<double> seen(others.size());
  const auto choose = [&](std::size_t at, int sign, double start) {
    Choice choice;
    const auto phase_of = [&](std::size_t set) {
      const SetSums& sums = axes[axis].sets[set];
      return sign * static_cast<double>(std::atan2(sums.sine[at], sums.cosine[at])) - start;
    };
    choice.part = in_turn(phase_of(best_set));
    for (std::size_t k = 0; k < others.size(); ++k) {
      seen[k] = phase_of(others[k]) / kTurn;
    }
    for (int turn = 0; turn < candidates; ++turn) {
      const double position = (turn + choice.part / kTurn) / periods;
      double cost = 0;
      for (std::size_t k = 0; k < others.size(); ++k) {
        const double off = sets[others[k]].periods * position - seen[k];
        const double rest = off - std::floor(off + 0.5);
        cost += rest * rest;
      }
      cost *= kTurn * kTurn;
      if (cost < choice.cost) {
        choice.second = choice.cost;
        choice.cost = cost;
        choice.turn = turn;
      } else {
        choice.second = std::min(choice.second, cost);
      }
    }
    return choice;
  };
  const double most_cost = static_cast<double>(options.most_disagreement_rad) *
                           static_cast<double>(options.most_disagreement_rad) *
                           static_cast<double>(others.size());
  const auto is_clear = [&](const Choice& choice) {
    return choice.cost <= most_cost && choice.second - choice.cost >= 0.3 * separation;
  };
  // Which way the shifts go and what phase 0 is: as they are drawn, unless the sets agree far better else.
  // (Whole numbers of periods fit each other as well in the mirror: nothing in the pictures tells.)
  int sign = 1;
  double start = 0;
  if (!others.empty()) {
    constexpr std::size_t kSamples = 4000;
    std::vector<std::size_t> lit;
    for (std::size_t at = 0; at < pixels; ++at) {
      if (fault[at] == PhaseFault::None) {
        lit.push_back(at);
      }
    }
    const std::size_t step = std::max<std::size_t>(1, lit.size() / kSamples);
    double least = std::numeric_limits<double>::max();
    double most = 0;
    for (const int tried_sign : {1, -1}) {
      for (int quarter = 0; quarter < 4 && !lit.empty(); ++quarter) {
        std::vector<double> costs;
        for (std::size_t k = 0; k < lit.size(); k += step) {
          costs.push_back(choose(lit[k], tried_sign, quarter * kTurn / 4).cost);
        }
        const double middle = maths::median_of(costs);
        most = std::max(most, middle);
        constexpr double kFarBetter = 0.25;
        if (middle < kFarBetter * least) {
          least = middle;
          sign = tried_sign;
          start = wrapped(quarter * kTurn / 4);
        }
      }
    }
    // Where the sets have nothing to do with each other, no way of reading them is better than another.
    field.agreement = most > 0 ? 1 - least / most : 0;
    // One other set leaves little to disagree about.
    const double least_agreement = others.size() > 1 ? 0.8 : 0.5;
    if (field.why_no_phases.empty() && !lit.empty() && field.agreement < least_agreement) {
      field.why_no_phases = fmt::format(
          "{}: the fringe sets' phases do not fit each other (agreement {:.2f}, {} at least): are the "
          "pictures "
          "in the order, and the numbers of periods those, that the sequence says?",
          name, field.agreement, least_agreement);
    }
  } else {
    field.agreement = 1;
  }
  field.reversed = sign < 0;
  field.start_rad = start;
  for (std::size_t at = 0; at < pixels; ++at) {
    if (fault[at] != PhaseFault::None) {
      continue;
    }
    const Choice choice = choose(at, sign, start);
    if (!field.why_no_phases.empty() || !(is_clear(choice) || others.empty())) {
      fault[at] = PhaseFault::Order;
    } else {
      field.phase_rad[at] = static_cast<float>(start + choice.part + kTurn * choice.turn);
    }
  }
}

/// Standard deviation of grey over grey (0 to 1, [kBins]), from what is no sine: the median of its variance,
/// by which n - 3 degrees of freedom are (1 - 2 / (9 dof))^3 of the mean [WH31].
std::vector<float> PhaseDecoder::Impl::grey_noise(const std::vector<Sine>& sines, int shifts,
                                                  const std::vector<PhaseFault>& fault) const {
  constexpr std::size_t kBins = 16;
  constexpr std::size_t kEnough = 200;
  std::vector<float> noise(kBins, options.noise);
  if (shifts == 3) {
    return noise;
  }
  std::array<std::vector<float>, kBins> values;
  std::vector<float> all;
  for (std::size_t at = 0; at < pixels; ++at) {
    if (fault[at] == PhaseFault::None) {
      const auto bin = static_cast<std::size_t>(
          std::clamp(sines[at].mean * static_cast<float>(kBins), 0.0F, static_cast<float>(kBins - 1)));
      const float variance = sines[at].rest / static_cast<float>(shifts - 3);
      values[bin].push_back(variance);
      all.push_back(variance);
    }
  }
  const auto dof = static_cast<double>(shifts - 3);
  const double share = std::pow(1 - 2 / (9 * dof), 3);
  const auto deviation = [&](std::vector<float>& variances) {
    const auto middle = static_cast<double>(maths::median_of(variances));
    // 8 bits round by 1/12 of a level's square: no camera is better.
    constexpr double kRounding = 1.0 / 12 / 255 / 255;
    return static_cast<float>(std::sqrt(std::max(middle / share, kRounding)));
  };
  if (all.size() < kEnough) {
    return noise;
  }
  const float overall = deviation(all);
  for (std::size_t bin = 0; bin < kBins; ++bin) {
    noise[bin] = values[bin].size() < kEnough ? overall : deviation(values[bin]);
  }
  return noise;
}

/// A pixel that agrees with none of its neighbours is in the wrong period or on no surface.
void PhaseDecoder::Impl::drop_lonely(PhaseField& field, std::vector<PhaseFault>& fault) const {
  const std::vector<float> phase = field.phase_rad;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const std::size_t at =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
      if (std::isnan(phase[at])) {
        continue;
      }
      const auto agrees = [&](bool there, std::size_t other) {
        return there && std::abs(phase[other] - phase[at]) < kPi;  // false for NaN
      };
      const int friends = (agrees(x > 0, at - 1) ? 1 : 0) + (agrees(x + 1 < width, at + 1) ? 1 : 0) +
                          (agrees(y > 0, at - static_cast<std::size_t>(width)) ? 1 : 0) +
                          (agrees(y + 1 < height, at + static_cast<std::size_t>(width)) ? 1 : 0);
      if (friends < 2) {
        field.phase_rad[at] = kNan;
        field.sigma_rad[at] = 0;
        fault[at] = fault[at] == PhaseFault::None ? PhaseFault::Order : fault[at];
      }
    }
  }
}

/// Mean over pairs of pixels that lie opposite of each other and whose own mean is the middle's within noise:
/// on one surface, and not bent.
void PhaseDecoder::Impl::smooth(PhaseField& field) const {
  const int reach = options.smooth_px;
  if (reach == 0) {
    return;
  }
  constexpr float kBend_rad = 0.05F;
  const std::vector<float> phase = field.phase_rad;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const auto index = [&](int column, int row) {
        return static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
               static_cast<std::size_t>(column);
      };
      const std::size_t at = index(x, y);
      if (std::isnan(phase[at])) {
        continue;
      }
      const float limit = 5 * field.sigma_rad[at] + kBend_rad;
      float sum = 0;  // of what the others are away from the middle
      int count = 1;
      for (int dy = 0; dy <= reach; ++dy) {
        for (int dx = dy == 0 ? 1 : -reach; dx <= reach; ++dx) {
          if (y - dy < 0 || y + dy >= height || x - std::abs(dx) < 0 || x + std::abs(dx) >= width) {
            continue;
          }
          const float pair =
              (phase[index(x + dx, y + dy)] - phase[at]) + (phase[index(x - dx, y - dy)] - phase[at]);
          if (std::abs(pair) < 2 * limit) {  // false for NaN
            sum += pair;
            count += 2;
          }
        }
      }
      field.phase_rad[at] = phase[at] + sum / static_cast<float>(count);
      field.sigma_rad[at] /= std::sqrt(static_cast<float>(count));
    }
  }
}

void PhaseDecoder::Impl::decode_axis(std::size_t axis, PhaseField& field, DecodedView& view) const {
  const AxisCode& code_here = code(axis);
  const std::size_t best = finest(axis);
  const int shifts = code_here.fringes[best].shifts;
  field.width_px = width;
  field.height_px = height;
  field.periods = code_here.fringes[best].periods;
  field.phase_rad.assign(pixels, kNan);
  field.sigma_rad.assign(pixels, 0);
  std::vector<Sine> sines(pixels);
  std::vector<PhaseFault> fault(pixels, PhaseFault::None);
  for (std::size_t at = 0; at < pixels; ++at) {
    for (std::size_t set = 0; set < code_here.fringes.size(); ++set) {
      const Sine sine = sine_of(axes[axis].sets[set], code_here.fringes[set].shifts, at);
      if (set == best) {
        sines[at] = sine;
      }
      if (fault[at] != PhaseFault::None) {
        continue;
      }
      if (saturated[at] != 0) {
        fault[at] = PhaseFault::Saturated;
      } else if (sine.modulation < options.least_modulation) {
        fault[at] = PhaseFault::Unlit;
      } else if (residual_of(sine, code_here.fringes[set].shifts) > options.most_residual) {
        fault[at] = PhaseFault::Residual;
      }
    }
  }
  const std::vector<float> noise = grey_noise(sines, shifts, fault);
  if (code_here.gray_bits > 0) {
    unwrap_by_gray(axis, sines, field, fault);
  } else {
    unwrap_by_sets(axis, field, fault);
  }
  const float gain = std::sqrt(2.0F / static_cast<float>(shifts));
  std::vector<float> residuals;
  for (std::size_t at = 0; at < pixels; ++at) {
    if (!std::isnan(field.phase_rad[at])) {
      const auto bin = static_cast<std::size_t>(std::clamp(sines[at].mean * static_cast<float>(noise.size()),
                                                           0.0F, static_cast<float>(noise.size() - 1)));
      field.sigma_rad[at] = gain * noise[bin] / sines[at].modulation;
    }
    if (saturated[at] == 0 && sines[at].modulation >= options.least_modulation) {
      residuals.push_back(residual_of(sines[at], shifts));
    }
  }
  drop_lonely(field, fault);
  smooth(field);
  if (!residuals.empty()) {
    view.residual = std::max(view.residual, maths::median_of(residuals));
  }
  const bool first = view.light.empty();
  if (first) {
    view.light.resize(pixels);
    view.modulation.resize(pixels);
  }
  for (std::size_t at = 0; at < pixels; ++at) {
    if (first) {
      view.light[at] = sines[at].mean;
      view.modulation[at] = sines[at].modulation;
    }
    view.fault[at] = view.fault[at] == PhaseFault::None ? fault[at] : view.fault[at];
  }
}

DecodedView PhaseDecoder::decode() const {
  const Impl& impl = *impl_;
  for (std::size_t picture = 0; picture < impl.given.size(); ++picture) {
    if (!impl.given[picture] && impl.sequence.pictures[picture].kind != Kind::Skip) {
      throw Error(ErrorKind::Usage, fmt::format("picture {} of the sequence, {}, is missing", picture + 1,
                                                capture::name_of(impl.sequence, picture)));
    }
  }
  DecodedView view;
  view.width_px = impl.width;
  view.height_px = impl.height;
  view.fault.assign(impl.pixels, PhaseFault::None);
  for (std::size_t axis = 0; axis < 2; ++axis) {
    if (!impl.code(axis).fringes.empty()) {
      impl.decode_axis(axis, axis == 0 ? view.columns : view.rows, view);
    }
  }
  view.faults.assign(kPhaseFaults, 0);
  for (const PhaseFault fault : view.fault) {
    ++view.faults[static_cast<std::size_t>(fault)];
  }
  return view;
}

}  // namespace facet::scan
