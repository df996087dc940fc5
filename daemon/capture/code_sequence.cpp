#include "capture/code_sequence.hpp"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <numbers>
#include <optional>

#include "facet/error.hpp"

namespace facet::capture {
namespace {

using Kind = CodedPicture::Kind;

constexpr int kLeastShifts = 3;
constexpr int kMostShifts = 64;
constexpr int kMostBits = 15;
constexpr int kMostSkipped = 256;
constexpr std::size_t kMostPictures = 1024;
constexpr double kMostPeriods = 4096;

[[noreturn]] void refuse(std::string_view group, const std::string& why) {
  throw Error(ErrorKind::Usage, fmt::format("sequence: '{}' {}", group, why));
}

template <typename Number>
std::optional<Number> number_of(std::string_view text) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() ? std::optional(value) : std::nullopt;
}

int count_of(std::string_view group, std::string_view text, int least, int most) {
  const auto value = number_of<int>(text);
  if (!value || *value < least || *value > most) {
    refuse(group, fmt::format("must give a number of pictures from {} to {} behind its colon", least, most));
  }
  return *value;
}

/// One group of a sequence's text, put behind what was read before.
class Reader {
 public:
  void read(std::string_view group) {
    const std::size_t colon = group.find(':');
    const std::string_view word = group.substr(0, colon);
    const std::string_view rest = colon == std::string_view::npos ? "" : group.substr(colon + 1);
    if (word == "phase") {
      phase(group, rest);
    } else if (word == "gray" || word == "gray-inverse" || word == "gray-pairs") {
      gray(group, word, rest);
    } else if (word == "skip") {
      add(Kind::Skip, count_of(group, rest, 1, kMostSkipped));
    } else if (colon != std::string_view::npos) {
      refuse(group, "is none of phase:N, phase:NxF, gray:M, gray-inverse:M, gray-pairs:M, skip:N");
    } else if (word == "white" || word == "black") {
      bool& there = word == "white" ? sequence_.white : sequence_.black;
      if (there) {
        refuse(group, "is there twice");
      }
      there = true;
      add(word == "white" ? Kind::White : Kind::Black, 1);
    } else if (word == "rows" || word == "columns") {
      axis_ = word == "rows" ? CodeAxis::Rows : CodeAxis::Columns;
    } else {
      refuse(group, "is none of phase, gray, gray-inverse, gray-pairs, white, black, rows, columns, skip");
    }
    if (sequence_.pictures.size() > kMostPictures) {
      refuse(group, fmt::format("makes more than {} pictures", kMostPictures));
    }
  }

  CodeSequence finish() {
    check(CodeAxis::Columns);
    check(CodeAxis::Rows);
    if (sequence_.columns.fringes.empty() && sequence_.rows.fringes.empty()) {
      throw Error(ErrorKind::Usage, "sequence: it has no phase:N pictures");
    }
    return std::move(sequence_);
  }

 private:
  AxisCode& code() { return axis_ == CodeAxis::Columns ? sequence_.columns : sequence_.rows; }

  void add(Kind kind, int count) {
    for (int k = 0; k < count; ++k) {
      sequence_.pictures.push_back({kind, axis_, 0, k});
    }
  }

  void phase(std::string_view group, std::string_view rest) {
    constexpr std::string_view kBackwards = ":backwards";
    const bool backwards = rest.ends_with(kBackwards);
    if (backwards) {
      rest.remove_suffix(kBackwards.size());
    }
    const std::size_t cross = rest.find('x');
    FringeSet set;
    set.shifts = count_of(group, rest.substr(0, cross), kLeastShifts, kMostShifts);
    if (cross != std::string_view::npos) {
      const auto periods = number_of<double>(rest.substr(cross + 1));
      if (!periods || !(*periods >= 0.5 && *periods <= kMostPeriods)) {
        refuse(group, fmt::format("must give 0.5 to {} periods behind its x", kMostPeriods));
      }
      set.periods = *periods;
    }
    for (int k = 0; k < set.shifts; ++k) {
      const int shift = backwards ? (set.shifts - k) % set.shifts : k;
      sequence_.pictures.push_back({Kind::Phase, axis_, code().fringes.size(), shift});
    }
    code().fringes.push_back(set);
  }

  void gray(std::string_view group, std::string_view word, std::string_view rest) {
    constexpr std::string_view kFineFirst = ":fine-first";
    const bool fine_first = rest.ends_with(kFineFirst);
    if (fine_first) {
      rest.remove_suffix(kFineFirst.size());
    }
    const int bits = count_of(group, rest, 1, kMostBits);
    const bool inverse = word == "gray-inverse";
    const bool pairs = word == "gray-pairs";
    if (inverse ? code().gray_bits != bits : code().gray_bits != 0) {
      refuse(group, inverse ? "must come behind as many bits" : "is there twice on this axis");
    }
    if (inverse && code().gray_inverse) {
      refuse(group, "is there twice on this axis");
    }
    code().gray_bits = bits;
    code().gray_inverse = inverse || pairs;
    for (int k = 0; k < bits; ++k) {
      const int bit = fine_first ? bits - 1 - k : k;
      sequence_.pictures.push_back({inverse ? Kind::GrayInverse : Kind::Gray, axis_, 0, bit});
      if (pairs) {
        sequence_.pictures.push_back({Kind::GrayInverse, axis_, 0, bit});
      }
    }
  }

  void check(CodeAxis which) const {
    const AxisCode& code = sequence_.axis(which);
    const char* name = which == CodeAxis::Columns ? "columns" : "rows";
    const auto fail = [&](const std::string& why) {
      throw Error(ErrorKind::Usage, fmt::format("sequence: {}: {}", name, why));
    };
    if (code.fringes.empty()) {
      if (code.gray_bits > 0) {
        fail("Gray bits alone are not decoded, they tell the periods of phase:N pictures apart");
      }
      return;
    }
    if (code.gray_bits > 0 && code.fringes.size() > 1) {
      fail("has Gray bits and several sets of fringes; either tells the periods apart");
    }
    if (code.gray_bits == 0) {
      if (code.fringes.size() == 1 && !(code.fringes[0].periods > 0 && code.fringes[0].periods <= 1)) {
        fail("one set of fringes needs Gray bits (gray:M) or a second set to tell its periods apart");
      }
      for (const FringeSet& set : code.fringes) {
        if (!(set.periods > 0)) {
          fail("several sets of fringes need their numbers of periods: phase:NxF");
        }
      }
    }
  }

  CodeSequence sequence_;
  CodeAxis axis_ = CodeAxis::Columns;
};

/// Cells of the Gray code in a period, as draw_coded makes them.
int cells_per_period(const AxisCode& code) {
  const double periods = code.fringes.front().periods;
  const auto can_count = std::ldexp(1.0, code.gray_bits);
  if (can_count < std::ceil(periods)) {
    throw Error(ErrorKind::Usage, fmt::format("sequence: {} Gray bits count {} periods, there are {}",
                                              code.gray_bits, can_count, periods));
  }
  if (can_count >= 4 * std::ceil(periods)) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("sequence: {} Gray bits are more than the half periods of {} fringes need; {} are enough",
                    code.gray_bits, periods, static_cast<int>(std::ceil(std::log2(std::ceil(periods))))));
  }
  return can_count >= std::ceil(2 * periods) ? 2 : 1;
}

}  // namespace

CodeSequence parse_sequence(std::string_view text) {
  Reader reader;
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t comma = std::min(text.find(',', at), text.size());
    reader.read(text.substr(at, comma - at));
    at = comma + 1;
  }
  return reader.finish();
}

std::string name_of(const CodeSequence& sequence, std::size_t picture) {
  const CodedPicture& shown = sequence.pictures.at(picture);
  const char* axis = shown.axis == CodeAxis::Columns ? "columns" : "rows";
  switch (shown.kind) {
    case Kind::Phase:
      return fmt::format("{}-phase-{:g}-shift-{}", axis,
                         sequence.axis(shown.axis).fringes.at(shown.set).periods, shown.index);
    case Kind::Gray:
      return fmt::format("{}-gray-{}", axis, shown.index);
    case Kind::GrayInverse:
      return fmt::format("{}-gray-inverse-{}", axis, shown.index);
    case Kind::White:
      return "white";
    case Kind::Black:
      return "black";
    case Kind::Skip:
      break;
  }
  return "skipped";
}

GreyImage draw_coded(const PatternConfig& config, const CodeSequence& sequence, std::size_t picture) {
  const CodedPicture& shown = sequence.pictures.at(picture);
  const ProjectorEncoder encode(config);
  const auto width = static_cast<std::size_t>(config.width_px);
  const auto height = static_cast<std::size_t>(config.height_px);
  const bool columns = shown.axis == CodeAxis::Columns;
  const std::size_t length = columns ? width : height;
  std::vector<std::uint8_t> profile(length, encode(shown.kind == Kind::White ? 1 : 0));
  const AxisCode& code = sequence.axis(shown.axis);
  if (shown.kind == Kind::Phase || shown.kind == Kind::Gray || shown.kind == Kind::GrayInverse) {
    const FringeSet& set = code.fringes.at(shown.set);
    constexpr double kShortest_px = 3;
    if (!(set.periods > 0)) {
      throw Error(ErrorKind::Usage, "sequence: to be drawn it needs its numbers of periods: phase:NxF");
    }
    if (static_cast<double>(length) / set.periods < kShortest_px) {
      throw Error(ErrorKind::Usage, fmt::format("sequence: {} periods over {} px: one is {} px at least",
                                                set.periods, length, kShortest_px));
    }
    const int cells = shown.kind == Kind::Phase ? 1 : cells_per_period(code);
    for (std::size_t k = 0; k < length; ++k) {
      const double period = set.periods * (static_cast<double>(k) + 0.5) / static_cast<double>(length);
      if (shown.kind == Kind::Phase) {
        const double turn = period - static_cast<double>(shown.index) / set.shifts;
        profile[k] = encode(0.5 + 0.5 * std::cos(2 * std::numbers::pi * turn));
      } else {
        const auto cell = static_cast<unsigned>(period * cells);
        const unsigned gray = cell ^ (cell >> 1U);
        const bool bit = ((gray >> static_cast<unsigned>(code.gray_bits - 1 - shown.index)) & 1U) != 0;
        profile[k] = encode(bit == (shown.kind == Kind::Gray) ? 1 : 0);
      }
    }
  }
  GreyImage image{config.width_px, config.height_px, {}};
  image.values.reserve(width * height);
  for (std::size_t y = 0; y < height; ++y) {
    if (columns) {
      image.values.insert(image.values.end(), profile.begin(), profile.end());
    } else {
      image.values.insert(image.values.end(), width, profile[y]);
    }
  }
  return image;
}

}  // namespace facet::capture
