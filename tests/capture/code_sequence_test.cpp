#include "capture/code_sequence.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <functional>
#include <numbers>

#include "facet/error.hpp"

namespace facet::capture {
namespace {

using ::testing::HasSubstr;
using Kind = CodedPicture::Kind;

std::string refusal(const std::function<void()>& work) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  ADD_FAILURE() << "nothing was thrown";
  return {};
}

std::string refusal(const std::string& text) {
  return refusal([&] { parse_sequence(text); });
}

TEST(CodeSequence, IsReadInItsOrder) {
  const CodeSequence sequence = parse_sequence(
      "white,phase:4x64,gray:2,gray-inverse:2,black,skip:1,rows,gray-pairs:2:fine-first,phase:3x48");
  std::vector<std::string> names;
  for (std::size_t k = 0; k < sequence.pictures.size(); ++k) {
    names.push_back(name_of(sequence, k));
  }
  EXPECT_THAT(names,
              ::testing::ElementsAre("white", "columns-phase-64-shift-0", "columns-phase-64-shift-1",
                                     "columns-phase-64-shift-2", "columns-phase-64-shift-3", "columns-gray-0",
                                     "columns-gray-1", "columns-gray-inverse-0", "columns-gray-inverse-1",
                                     "black", "skipped", "rows-gray-1", "rows-gray-inverse-1", "rows-gray-0",
                                     "rows-gray-inverse-0", "rows-phase-48-shift-0", "rows-phase-48-shift-1",
                                     "rows-phase-48-shift-2"));
  EXPECT_TRUE(sequence.white && sequence.black);
  EXPECT_EQ(sequence.columns.gray_bits, 2);
  EXPECT_TRUE(sequence.columns.gray_inverse && sequence.rows.gray_inverse);
  ASSERT_EQ(sequence.rows.fringes.size(), 1U);
  EXPECT_EQ(sequence.rows.fringes[0].shifts, 3);
  EXPECT_EQ(sequence.rows.fringes[0].periods, 48);
  EXPECT_EQ(parse_sequence("phase:4x1,phase:4x8.5,phase:8x64").columns.fringes.size(), 3U);
  EXPECT_EQ(parse_sequence("phase:4,gray:7").columns.fringes[0].periods, 0);
}

TEST(CodeSequence, RefusesWhatCannotBeDecoded) {
  EXPECT_THAT(refusal(""), HasSubstr("'' is none of phase"));
  EXPECT_THAT(refusal("phase:4x64"), HasSubstr("needs Gray bits"));
  EXPECT_THAT(refusal("gray:6"), HasSubstr("Gray bits alone"));
  EXPECT_THAT(refusal("white,black"), HasSubstr("no phase:N"));
  EXPECT_THAT(refusal("phase:2,gray:4"), HasSubstr("'phase:2' must give a number of pictures from 3 to 64"));
  EXPECT_THAT(refusal("phase:4x0,gray:4"), HasSubstr("periods behind its x"));
  EXPECT_THAT(refusal("phase:4xnan,gray:4"), HasSubstr("periods behind its x"));
  EXPECT_THAT(refusal("phase:4,gray:16"), HasSubstr("from 1 to 15"));
  EXPECT_THAT(refusal("phase:4,gray:6,gray:6"), HasSubstr("twice"));
  EXPECT_THAT(refusal("phase:4,gray-inverse:6"), HasSubstr("must come behind as many bits"));
  EXPECT_THAT(refusal("phase:4,gray:6,gray-inverse:5"), HasSubstr("must come behind as many bits"));
  EXPECT_THAT(refusal("phase:4,gray-pairs:6,gray-inverse:6"), HasSubstr("twice"));
  EXPECT_THAT(refusal("phase:4,phase:4,gray:6"), HasSubstr("either tells"));
  EXPECT_THAT(refusal("phase:4x64,phase:4"), HasSubstr("need their numbers of periods"));
  EXPECT_THAT(refusal("phase:4,gray:6,white,white"), HasSubstr("twice"));
  EXPECT_THAT(refusal("phase:4,grey:6"), HasSubstr("'grey:6' is none of"));
  EXPECT_THAT(refusal("phase:4, gray:6"), HasSubstr("' gray:6' is none of"));
  std::string many = "phase:4,gray:6";
  for (int k = 0; k < 5; ++k) {
    many += ",skip:256";
  }
  EXPECT_THAT(refusal(many), HasSubstr("more than 1024 pictures"));
}

PatternConfig screen(int width_px, int height_px) {
  PatternConfig config;
  config.width_px = width_px;
  config.height_px = height_px;
  return config;
}

double light_of(std::uint8_t value) {
  return std::pow(value / 255.0, 2.2);
}

TEST(CodeSequence, SinesHaveTheirPeriodAndShift) {
  const CodeSequence sequence = parse_sequence("phase:5x20,gray:5,rows,phase:3x8,gray:3");
  const PatternConfig config = screen(320, 200);
  for (const int shift : {0, 3}) {
    const GreyImage image = draw_coded(config, sequence, static_cast<std::size_t>(shift));
    for (int x = 0; x < 320; ++x) {
      const double wanted = 0.5 + 0.5 * std::cos(2 * std::numbers::pi * ((x + 0.5) / 16 - shift / 5.0));
      // Half a level of 255, which is up to 0.005 of the light.
      ASSERT_NEAR(light_of(image.values[static_cast<std::size_t>(7 * 320 + x)]), wanted, 0.005) << x;
    }
  }
  const GreyImage rows = draw_coded(config, sequence, 5 + 5 + 1);
  for (int y = 0; y < 200; ++y) {
    const double wanted = 0.5 + 0.5 * std::cos(2 * std::numbers::pi * ((y + 0.5) / 25 - 1 / 3.0));
    ASSERT_NEAR(light_of(rows.values[static_cast<std::size_t>(y * 320 + 99)]), wanted, 0.005) << y;
  }
}

/// The numbers that Gray pictures of a column give.
std::vector<unsigned> cells_of(const CodeSequence& sequence, int width_px) {
  std::vector<unsigned> cells(static_cast<std::size_t>(width_px), 0);
  std::vector<unsigned> before(cells.size(), 0);
  for (std::size_t picture = 0; picture < sequence.pictures.size(); ++picture) {
    if (sequence.pictures[picture].kind != Kind::Gray) {
      continue;
    }
    const GreyImage image = draw_coded(screen(width_px, 16), sequence, picture);
    for (std::size_t x = 0; x < cells.size(); ++x) {
      before[x] ^= image.values[x] > 127 ? 1U : 0U;
      cells[x] = 2 * cells[x] + before[x];
    }
  }
  return cells;
}

TEST(CodeSequence, GrayBitsCountPeriodsOrTheirHalves) {
  const std::vector<unsigned> whole = cells_of(parse_sequence("phase:4x50,gray:6"), 800);
  const std::vector<unsigned> halves = cells_of(parse_sequence("phase:4x50,gray:7"), 800);
  for (std::size_t x = 0; x < 800; ++x) {
    ASSERT_EQ(whole[x], x / 16) << x;
    ASSERT_EQ(halves[x], x / 8) << x;
  }
  // Neighbouring cells differ in one bit, so that one bit alone is unclear between them.
  for (unsigned cell = 0; cell < 63; ++cell) {
    EXPECT_EQ(std::popcount((cell ^ (cell >> 1U)) ^ ((cell + 1) ^ ((cell + 1) >> 1U))), 1);
  }
  const CodeSequence inverse = parse_sequence("phase:4x50,gray-pairs:6");
  const GreyImage bit = draw_coded(screen(800, 16), inverse, 4 + 6);
  const GreyImage inverted = draw_coded(screen(800, 16), inverse, 4 + 7);
  for (std::size_t x = 0; x < bit.values.size(); ++x) {
    ASSERT_EQ(bit.values[x] + inverted.values[x], 255);
  }
}

TEST(CodeSequence, RefusesWhatCannotBeDrawn) {
  const auto drawn = [](const std::string& text, int width_px) {
    return refusal([&] {
      const CodeSequence sequence = parse_sequence(text);
      for (std::size_t k = 0; k < sequence.pictures.size(); ++k) {
        draw_coded(screen(width_px, 16), sequence, k);
      }
    });
  };
  EXPECT_THAT(drawn("phase:4,gray:6", 800), HasSubstr("needs its numbers of periods"));
  EXPECT_THAT(drawn("phase:4x65,gray:6", 800), HasSubstr("6 Gray bits count 64 periods"));
  EXPECT_THAT(drawn("phase:4x64,gray:8", 800), HasSubstr("6 are enough"));
  EXPECT_THAT(drawn("phase:4x300,gray:9", 800), HasSubstr("one is 3 px at least"));
  EXPECT_THAT(drawn("phase:4x4,gray:2", 8), HasSubstr("a projector's sides"));
}

}  // namespace
}  // namespace facet::capture
