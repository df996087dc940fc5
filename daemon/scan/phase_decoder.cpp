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
#include "scan/phase_noise.hpp"

namespace facet::scan {
namespace {

using capture::AxisCode;
using capture::CodeAxis;
using capture::CodedPicture;
using Kind = capture::CodedPicture::Kind;

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

/// How an axis' fringe sets are read together.
struct SetsReading {
  std::size_t axis = 0;
  const std::vector<capture::FringeSet>& fringes;
  std::size_t best = 0;  ///< the set with the most periods
  double periods = 0;    ///< of that
  int candidates = 0;    ///< whole periods of it over the picture
  std::vector<std::size_t> others;
  std::vector<double> seen;  ///< [others] scratch: phases of a pixel, turns
};

/// A pixel's period of the finest set.
struct PeriodChoice {
  int turn = 0;
  double cost = std::numeric_limits<double>::max();    ///< rad^2
  double second = std::numeric_limits<double>::max();  ///< of the next best
  double part = 0;                                     ///< of the period, rad
};

const char* name_of(std::size_t axis) {
  return static_cast<CodeAxis>(axis) == CodeAxis::Columns ? "columns" : "rows";
}

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
  double separation_of(const SetsReading& sets) const;
  PeriodChoice choose(SetsReading& sets, std::size_t at, int sign, double start) const;
  int find_direction(SetsReading& sets, const std::vector<PhaseFault>& fault, PhaseField& field) const;
  void unwrap_by_sets(std::size_t axis, PhaseField& field, std::vector<PhaseFault>& fault) const;
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
  const char* name = name_of(axis);
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

/// What a wrong period of the finest set costs at least, rad^2.
double PhaseDecoder::Impl::separation_of(const SetsReading& sets) const {
  double separation = std::numeric_limits<double>::max();
  for (int wrong = 1; wrong < sets.candidates; ++wrong) {
    double cost = 0;
    for (const std::size_t set : sets.others) {
      const double off = wrapped(kTurn * sets.fringes[set].periods * wrong / sets.periods);
      cost += off * off;
    }
    separation = std::min(separation, cost);
  }
  return separation;
}

/// Among all periods of the finest set the one that the other sets' phases fit best.
PeriodChoice PhaseDecoder::Impl::choose(SetsReading& sets, std::size_t at, int sign, double start) const {
  PeriodChoice choice;
  const auto phase_of = [&](std::size_t set) {
    const SetSums& sums = axes[sets.axis].sets[set];
    return sign * static_cast<double>(std::atan2(sums.sine[at], sums.cosine[at])) - start;
  };
  choice.part = in_turn(phase_of(sets.best));
  for (std::size_t k = 0; k < sets.others.size(); ++k) {
    sets.seen[k] = phase_of(sets.others[k]) / kTurn;
  }
  for (int turn = 0; turn < sets.candidates; ++turn) {
    const double position = (turn + choice.part / kTurn) / sets.periods;
    double cost = 0;
    for (std::size_t k = 0; k < sets.others.size(); ++k) {
      const double off = sets.fringes[sets.others[k]].periods * position - sets.seen[k];
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
}

/// Which way the shifts go and what phase 0 is: as they are drawn, unless the sets agree far better else.
/// (Whole numbers of periods fit each other as well in the mirror: nothing in the pictures tells.) Returns
/// the sign; sets field's start, agreement and, where there is no telling, why.
int PhaseDecoder::Impl::find_direction(SetsReading& sets, const std::vector<PhaseFault>& fault,
                                       PhaseField& field) const {
  if (sets.others.empty()) {
    field.agreement = 1;
    return 1;
  }
  int sign = 1;
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
        costs.push_back(choose(sets, lit[k], tried_sign, quarter * kTurn / 4).cost);
      }
      const double middle = maths::median_of(costs);
      most = std::max(most, middle);
      constexpr double kFarBetter = 0.25;
      if (middle < kFarBetter * least) {
        least = middle;
        sign = tried_sign;
        field.start_rad = wrapped(quarter * kTurn / 4);
      }
    }
  }
  // Where the sets have nothing to do with each other, no way of reading them is better than another.
  field.agreement = most > 0 ? 1 - least / most : 0;
  // One other set leaves little to disagree about.
  const double least_agreement = sets.others.size() > 1 ? 0.8 : 0.5;
  if (field.why_no_phases.empty() && !lit.empty() && field.agreement < least_agreement) {
    field.why_no_phases = fmt::format(
        "{}: the fringe sets' phases do not fit each other (agreement {:.2f}, {} at least): are the "
        "pictures in the order, and the numbers of periods those, that the sequence says?",
        name_of(sets.axis), field.agreement, least_agreement);
  }
  return sign;
}

void PhaseDecoder::Impl::unwrap_by_sets(std::size_t axis, PhaseField& field,
                                        std::vector<PhaseFault>& fault) const {
  SetsReading sets{axis, code(axis).fringes, finest(axis), 0, 0, {}, {}};
  sets.periods = sets.fringes[sets.best].periods;
  sets.candidates = static_cast<int>(std::ceil(sets.periods - 1e-9));
  for (std::size_t set = 0; set < sets.fringes.size(); ++set) {
    if (set != sets.best) {
      sets.others.push_back(set);
    }
  }
  sets.seen.resize(sets.others.size());
  const double separation = separation_of(sets);
  constexpr double kLeastSeparation = 0.01;  // rad^2
  if (separation < kLeastSeparation) {
    field.why_no_phases = fmt::format("{}: these numbers of periods do not tell {:g} periods apart",
                                      name_of(axis), sets.periods);
  }
  const double most_cost = static_cast<double>(options.most_disagreement_rad) *
                           static_cast<double>(options.most_disagreement_rad) *
                           static_cast<double>(sets.others.size());
  const auto is_clear = [&](const PeriodChoice& choice) {
    return choice.cost <= most_cost && choice.second - choice.cost >= 0.3 * separation;
  };
  const int sign = find_direction(sets, fault, field);
  field.reversed = sign < 0;
  for (std::size_t at = 0; at < pixels; ++at) {
    if (fault[at] != PhaseFault::None) {
      continue;
    }
    const PeriodChoice choice = choose(sets, at, sign, field.start_rad);
    if (!field.why_no_phases.empty() || !(is_clear(choice) || sets.others.empty())) {
      fault[at] = PhaseFault::Order;
    } else {
      field.phase_rad[at] = static_cast<float>(field.start_rad + choice.part + kTurn * choice.turn);
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
  const std::vector<float> noise = grey_noise(sines, shifts, fault, options.noise);
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
  smooth(field, options.smooth_px);
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
