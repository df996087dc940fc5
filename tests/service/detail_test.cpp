// [refiner] detail: weights by a name.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "facet/error.hpp"
#include "service/config.hpp"

namespace facet::service {
namespace {

refine::RefinerConfig refiner_of(const std::string& text) {
  return parse_config(text, "detail.toml").pipeline.refiner;
}

TEST(Detail, NamesWeightsAndAnExpertsOwnCountFirst) {
  const refine::Weights defaults;
  const refine::RefinerConfig expressive = refiner_of(
      "[refiner]\ndetail = \"expressive\"\n[expert.refiner.weights]\ndisplacement_hierarchy = 0.7\n");
  EXPECT_LT(expressive.weights.displacement_smooth, defaults.displacement_smooth);
  EXPECT_EQ(expressive.weights.displacement_hierarchy, 0.7F);
  EXPECT_LT(expressive.weights.displacement_smooth_known, defaults.displacement_smooth_known);
  const refine::RefinerConfig faithful = refiner_of("[refiner]\ndetail = \"faithful\"");
  EXPECT_EQ(faithful.weights.displacement_smooth, defaults.displacement_smooth);
  EXPECT_EQ(faithful.weights.displacement_hierarchy, defaults.displacement_hierarchy);
}

TEST(Detail, AnotherNameIsRefusedWithTheTwo) {
  try {
    refiner_of("[refiner]\ndetail = \"all\"");
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(),
                testing::AllOf(testing::HasSubstr("\"faithful\""), testing::HasSubstr("\"expressive\"")));
  }
}

}  // namespace
}  // namespace facet::service
