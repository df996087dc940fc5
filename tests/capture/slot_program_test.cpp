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
