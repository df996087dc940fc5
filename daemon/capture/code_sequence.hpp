#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "capture/patterns.hpp"

namespace facet::capture {

/// Along which axis of the projector's picture a structured-light picture changes.
enum class CodeAxis : std::uint8_t {
  Columns,  ///< along x: upright fringes
  Rows,     ///< along y
};

/// One picture of a structured-light sequence.
struct CodedPicture {
  enum class Kind : std::uint8_t {
    Phase,        ///< a sine, shifted by index / shifts of a period
    Gray,         ///< bit `index` of the Gray code, 0 the most significant
    GrayInverse,  ///< the same with black and white exchanged
    White,
    Black,
    Skip,  ///< not a part of the code
  };
  Kind kind = Kind::Skip;
  CodeAxis axis = CodeAxis::Columns;
  std::size_t set = 0;  ///< Phase: index into AxisCode::fringes
  int index = 0;
};

/// A sine in several shifts.
struct FringeSet {
  int shifts = 4;      ///< 3 to 64 pictures, shifted by 1 / shifts of a period each
  double periods = 0;  ///< over the width or height of the projector's picture; 0: not given
};

/// How one axis is coded.
struct AxisCode {
  std::vector<FringeSet> fringes;  ///< empty: this axis is not coded
  int gray_bits = 0;               ///< 0: several fringe sets tell the periods apart
  bool gray_inverse = false;
};

/// What a projector shows, one picture after the other.
struct CodeSequence {
  std::vector<CodedPicture> pictures;  ///< in their order, 4 to 1024
  AxisCode columns;
  AxisCode rows;
  bool white = false;
  bool black = false;

  const AxisCode& axis(CodeAxis which) const { return which == CodeAxis::Columns ? columns : rows; }
};

/// Reads a sequence from its text: groups of pictures in the order in which they are shown, with commas
/// between.
///   phase:N or phase:NxF     N shifts of a sine of F periods over the picture (F may have a fraction); with
///                            :backwards the shifts go the other way
///   gray:M                   M bits of a Gray code, the most significant first; with :fine-first the other
///                            way round
///   gray-inverse:M           their inverses in the same order
///   gray-pairs:M             bit, inverse, bit, inverse ...
///   white, black             all of it
///   rows, columns            what follows changes along this axis; columns until then
///   skip:N                   N pictures that mean nothing
/// Each coded axis needs phases, and either Gray bits and one set of fringes or two sets or more whose
/// numbers of periods are given. Throws Error(Usage) that names the group and says what is allowed.
CodeSequence parse_sequence(std::string_view text);

/// What a picture of a sequence is, for people and file names: "columns-phase-64-shift-3".
std::string name_of(const CodeSequence& sequence, std::size_t picture);

/// A picture of a sequence for a projector. Over x px of a width of W with F periods,
///   light = 1/2 + 1/2 cos(2 pi F (x + 1/2) / W - 2 pi shift / shifts),
/// so that periods begin on the edge of a pixel; a Gray code's cell is a period, or half of one where there
/// are bits enough for half periods (complementary Gray code [ZSXS12]). Encoded for the projector's
/// gamma as stripes are. config: width, height and gamma are used. Throws Error(Usage) where the
/// configuration is out of range, periods are not given, the bits can't count them or are more than
/// half periods need, or a period is shorter than 3 px.
GreyImage draw_coded(const PatternConfig& config, const CodeSequence& sequence, std::size_t picture);

}  // namespace facet::capture
