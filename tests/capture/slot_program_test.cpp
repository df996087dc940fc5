#include "capture/slot_program.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "facet/error.hpp"

namespace facet::capture {
namespace {

using testing::ElementsAre;
using Kind = SlotLight::Kind;

TEST(SlotProgram, BlankDarkAndLightAreTheWordsThatCount) {
  const SlotProgram program = parse_slot_program("a, b,blank,light:projector-l+ led.top ,dark");
  ASSERT_EQ(program.size(), 5U);
  EXPECT_EQ(program[0], (SlotLight{Kind::Stripes, {}}));
  EXPECT_EQ(program[2], (SlotLight{Kind::Blank, {}}));
  EXPECT_EQ(program[3].kind, Kind::Lit);
  EXPECT_THAT(program[3].lights, ElementsAre("led.top", "projector-l"));
  EXPECT_EQ(program[4].kind, Kind::Lit);
  EXPECT_TRUE(program[4].lights.empty());
  EXPECT_EQ(light_of_slot(program, 13).lights.size(), 2U);
  EXPECT_EQ(to_text(program), "stripes,stripes,blank,light:led.top+projector-l,dark");
  EXPECT_EQ(parse_slot_program(to_text(program)), program);
  EXPECT_EQ(to_text(standard_program()), "stripes,stripes,blank");
}

TEST(SlotProgram, FringesGoThroughTheirFourShifts) {
  const SlotProgram program = parse_slot_program("fringes");
  EXPECT_EQ(to_text(program), "fringes:0,fringes:1,blank,fringes:2,fringes:3,blank");
  EXPECT_EQ(parse_slot_program(to_text(program)), program);
  EXPECT_EQ(parse_slot_program("stripes"), standard_program());
  EXPECT_EQ(shown_in_slot(program, 10), (Shown{Shown::Kind::Fringes, 3}));
  EXPECT_EQ(shown_in_slot(program, 11).kind, Shown::Kind::Blank);
  EXPECT_TRUE(program[4].has_pattern());
  EXPECT_FALSE(program[5].has_pattern());
  for (const char* wrong : {"fringes:", "fringes:4", "fringes:01", "fringes:-1", "fringes"}) {
    EXPECT_THROW(parse_slot_light(wrong), Error) << wrong;
  }
}

// Stripes are never the same again, whatever lies between them.
TEST(SlotProgram, StripesAreNumberedThroughout) {
  const SlotProgram program = parse_slot_program("stripes,fringes:2,blank,stripes,dark");
  EXPECT_EQ(shown_in_slot(program, 0), (Shown{Shown::Kind::Stripes, 0}));
  EXPECT_EQ(shown_in_slot(program, 3), (Shown{Shown::Kind::Stripes, 1}));
  EXPECT_EQ(shown_in_slot(program, 4).kind, Shown::Kind::Dark);
  EXPECT_EQ(shown_in_slot(program, 13), (Shown{Shown::Kind::Stripes, 5}));
  EXPECT_EQ(shown_in_slot(standard_program(), 2).kind, Shown::Kind::Blank);
  EXPECT_EQ(shown_in_slot(standard_program(), 3), (Shown{Shown::Kind::Stripes, 2}));
  EXPECT_EQ(shown_in_slot(standard_program(), 301), (Shown{Shown::Kind::Stripes, 201}));
}

TEST(SlotProgram, WithoutDepthOrTextureThereIsNoMesh) {
  for (const char* wrong : {"", "blank", "a,b", "a,,blank", ",", "a,light:x", "blank,dark"}) {
    EXPECT_THROW(parse_slot_program(wrong), Error) << wrong;
  }
  EXPECT_TRUE(makes_meshes(standard_program()));
  EXPECT_FALSE(makes_meshes({}));
}

TEST(SlotProgram, ALightHasAName) {
  for (const char* wrong : {"light:", "light:a+", "light:+a", "light: "}) {
    EXPECT_THROW(parse_slot_light(wrong), Error) << wrong;
    EXPECT_EQ(read_slot_light(wrong), std::nullopt) << "of a damaged take";
  }
  EXPECT_EQ(read_slot_light(""), std::nullopt);
  EXPECT_EQ(read_slot_light("light:b+a+b")->lights.size(), 2U);
}

}  // namespace
}  // namespace facet::capture
