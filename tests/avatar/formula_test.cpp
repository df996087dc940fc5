#include "avatar/formula.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <string>

#include "avatar/mapping_file.hpp"
#include "facet/error.hpp"
#include "support/paths.hpp"

namespace facet::avatar {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

/// Of a face with jawOpen 0.5, mouthFunnel 0.25 and nothing else.
float of(const std::string& text) {
  mesh::ArkitValues values{};
  values.at(static_cast<std::size_t>(mesh::arkit_index("jawOpen"))) = 0.5F;
  values.at(static_cast<std::size_t>(mesh::arkit_index("mouthFunnel"))) = 0.25F;
  return Formula(text).of(values);
}

std::string fault_of(const std::string& text) {
  try {
    Formula{text};
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "none";
}

TEST(Formula, IsArithmetic) {
  EXPECT_FLOAT_EQ(of("0.8 * jawOpen + 0.2 * mouthFunnel"), 0.45F);
  EXPECT_FLOAT_EQ(of("JawOpen"), 0.5F) << "as Live Link writes it";
  EXPECT_FLOAT_EQ(of("1 - 2 - 3"), -4) << "from the left";
  EXPECT_FLOAT_EQ(of("8 / 4 / 2"), 1);
  EXPECT_FLOAT_EQ(of("2 + 3 * 4 - 6 / 2"), 11);
  EXPECT_FLOAT_EQ(of("(2 + 3) * (4 - 1)"), 15);
  EXPECT_FLOAT_EQ(of("-jawOpen * -2"), 1);
  EXPECT_FLOAT_EQ(of("- (1 + +jawOpen)"), -1.5F);
  EXPECT_FLOAT_EQ(of(" .5e1\n+\t1E-1"), 5.1F);
  EXPECT_FLOAT_EQ(of("min(3, jawOpen, 2) + max(jawOpen, mouthFunnel)"), 1);
  EXPECT_FLOAT_EQ(of("clamp(jawOpen, 0.6, 1) + clamp(jawOpen, 0, 0.4) + clamp(jawOpen, 0, 1)"), 1.5F);
  EXPECT_FLOAT_EQ(of("dead(jawOpen, 0.2)"), 0.375F) << "(0.5 - 0.2) / 0.8";
  EXPECT_FLOAT_EQ(of("dead(mouthFunnel, 0.25)"), 0);
  EXPECT_FLOAT_EQ(of("1.5 * dead(mouthFunnel, 0.3)"), 0);
}

TEST(Formula, IsAlwaysANumber) {
  EXPECT_EQ(of("jawOpen / tongueOut"), 0);
  EXPECT_EQ(of("1e300 * 1e300"), 0);
  EXPECT_EQ(of("1e200"), 0) << "more than a float holds";
  EXPECT_EQ(of("1e300 * 1e300 - 1e300 * 1e300"), 0);
  EXPECT_EQ(of("dead(2, 1)"), 0);
  EXPECT_EQ(of("clamp(jawOpen, 1, 0)"), 0) << "the greater bound first";
}

TEST(Formula, SaysWhatIsWrongAndWhere) {
  EXPECT_THAT(fault_of(""), HasSubstr("'(' is expected (letter 1)"));
  EXPECT_THAT(fault_of("jawOpen +"), HasSubstr("(letter 10)"));
  EXPECT_THAT(fault_of("0.5 * jawOpn"),
              AllOf(HasSubstr("'jawOpn' is no value of ARKit's"), HasSubstr("(letter 7)")));
  EXPECT_THAT(fault_of("1 2"), HasSubstr("'2' is not expected (letter 3)"));
  EXPECT_THAT(fault_of("(1"), HasSubstr("')' is expected"));
  EXPECT_THAT(fault_of("min(1)"), HasSubstr("',' is expected"));
  EXPECT_THAT(fault_of("clamp(1, 2)"), HasSubstr("',' is expected"));
  EXPECT_THAT(fault_of("clamp(1, 2, 3, 4)"), HasSubstr("')' is expected"));
  EXPECT_THAT(fault_of("min"), HasSubstr("'(' is expected"));
  EXPECT_THAT(fault_of("1e999"), HasSubstr("no number"));
  EXPECT_THAT(fault_of("jawOpen = 1"), HasSubstr("'=' is not expected"));
  EXPECT_THAT(fault_of(std::string("1\0", 2)), HasSubstr("can't be shown"));
  EXPECT_THAT(fault_of(std::string(1001, ' ')), HasSubstr("longer than 1000 letters"));
  EXPECT_THAT(fault_of(std::string(500, '(')), HasSubstr("nested more than 32 deep"));
  EXPECT_THAT(fault_of(std::string(500, '-') + "1"), HasSubstr("nested more than 32 deep"));
}

TEST(Formula, AsDeepAsItMayBeItKeepsAllNumbers) {
  // Two a level: what is added to, and what is multiplied.
  std::string text;
  for (int level = 0; level < 15; ++level) {
    text += "1 + 2 * (";
  }
  text += "1" + std::string(15, ')');
  EXPECT_FLOAT_EQ(of(text), 65535) << "2^16 - 1";
}

TEST(ValueMapping, IsReadByTable) {
  const ValueMapping mapping = parse_mapping(
      "[vmc]\nA = \"0.8 * jawOpen\"\n\"笑い\" = \"mouthSmileLeft\"\n[vrchat]\n\"v2/JawOpen\" = \"1\"\n",
      "avatar.toml");
  ASSERT_EQ(mapping.vmc.size(), 2U);
  EXPECT_EQ(mapping.vmc[0].name, "A");
  EXPECT_EQ(mapping.vmc[1].name, "笑い") << "as clips of avatars are called";
  ASSERT_EQ(mapping.vrchat.size(), 1U);
  EXPECT_EQ(mapping.vrchat[0].formula.of({}), 1);
  EXPECT_TRUE(load_mapping("").vmc.empty());
}

TEST(ValueMapping, SaysWhereItIsWrong) {
  const auto fault = [](const std::string& text) -> std::string {
    try {
      parse_mapping(text, "avatar.toml");
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
      return error.what();
    }
    return "none";
  };
  EXPECT_THAT(fault("[vmc]\n\nA = \"0.8 * jaw\"\n"),
              AllOf(HasSubstr("avatar.toml:3: vmc.A: is no formula: 'jaw' is no value of ARKit's"),
                    HasSubstr("(letter 7)")));
  EXPECT_THAT(fault("[vmc]\nA = 1\n"), HasSubstr("a formula in quotes"));
  EXPECT_THAT(fault("A = \"jawOpen\"\n"), HasSubstr("avatar.toml:1: A"));
  EXPECT_THAT(fault("[vrchat]\n\"v2/a b\" = \"1\"\n"), HasSubstr("no name that can be sent"));
  EXPECT_THAT(fault("[vmc]\n\"\" = \"1\"\n"), HasSubstr("1 to 64 bytes"));
  EXPECT_THAT(fault("[vmc]\n" + std::string(65, 'a') + " = \"1\"\n"), HasSubstr("1 to 64 bytes"));
  EXPECT_EQ(fault("[vmc]\n" + std::string(64, 'a') + " = \"1\"\n"), "none");
  std::string many = "[vmc]\n";
  for (std::size_t i = 0; i <= kMostMappedValues; ++i) {
    many += fmt::format("a{} = \"1\"\n", i);
  }
  EXPECT_THAT(fault(many), HasSubstr("vmc.a256: is one too many: 256 at most"));
}

TEST(ValueMapping, AFileThatIsNotThereIsEmptyAndOneTooLongIsAnError) {
  const test::TemporaryFolder folder;
  EXPECT_EQ(load_mapping(folder.path() / "none.toml"), ValueMapping());
  EXPECT_THROW(load_mapping(folder.path()), Error) << "a folder";
  const std::filesystem::path file = folder.path() / "long.toml";
  std::ofstream(file) << "#" << std::string(kMostMappingBytes, ' ');
  EXPECT_THROW(load_mapping(file), Error);
}

TEST(ValueMapping, AChosenNameTakesThePlaceOfTheGivenOne) {
  constexpr NamedFormula kGiven[] = {{"A", "1"}, {"B", "2"}};
  constexpr NamedFormula kChosen[] = {{"B", "3"}, {"C", "4"}};
  const MappedValues values = replaced(mapped_values(kGiven), mapped_values(kChosen));
  ASSERT_EQ(values.size(), 3U);
  EXPECT_EQ(values[0].name, "A");
  EXPECT_EQ(values[1].name, "B");
  EXPECT_EQ(values[1].formula.of({}), 3);
  EXPECT_EQ(values[2].name, "C");
}

}  // namespace
}  // namespace facet::avatar
