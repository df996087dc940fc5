#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "facet/error.hpp"
#include "service/config.hpp"

namespace facet::service {
namespace {

using ::testing::HasSubstr;

std::string error_of(const std::string& text) {
  try {
    parse_config(text, "facet.toml");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "";
}

TEST(BridgesConfig, BridgesSayWhatIsSent) {
  const Config config = parse_config(
      "[bridges]\nifacialmocap = [\"localhost:49983\"]\nvrchat = [\"127.0.0.1:9000\"]\n"
      "vtube_studio = [\"127.0.0.1:11125\"]\nvmc_shapes = \"presets\"\nvmc_eye_bones = false\n"
      "vrchat_find = \"network\"\n"
      "mapping = \"avatar.toml\"\nanswer = \"0.0.0.0\"\n",
      "/etc/facet/facet.toml");
  ASSERT_EQ(config.bridges.targets.size(), 3U);
  EXPECT_EQ(config.bridges.targets[0].protocol, avatar::BridgeProtocol::IFacialMocap);
  EXPECT_EQ(config.bridges.targets[1].protocol, avatar::BridgeProtocol::VrChat);
  EXPECT_EQ(config.bridges.targets[2].protocol, avatar::BridgeProtocol::VTubeStudio);
  EXPECT_EQ(config.bridges.vmc_shapes, avatar::VmcShapes::Presets);
  EXPECT_FALSE(config.bridges.vmc_eye_bones);
  EXPECT_EQ(config.bridges.find.where, avatar::VrChatFind::Network);
  EXPECT_EQ(config.bridges.mapping_file, "/etc/facet/avatar.toml");
  EXPECT_EQ(config.bridges.answer, "0.0.0.0");
  const avatar::BridgeConfig plain = parse_config("", "facet.toml").bridges;
  EXPECT_EQ(plain.vmc_shapes, avatar::VmcShapes::PerfectSync);
  EXPECT_TRUE(plain.vmc_eye_bones);
  EXPECT_EQ(plain.find.where, avatar::VrChatFind::Off) << "nobody is looked for unless that is said";
  EXPECT_TRUE(plain.mapping_file.empty());
  EXPECT_TRUE(plain.answer.empty()) << "nobody is heard unless that is said";
  EXPECT_THAT(error_of("[bridges]\nvmc_shapes = \"vrm\"\n"), HasSubstr("perfect_sync"));
  EXPECT_THAT(error_of("[bridges]\nvrchat_find = true\n"), HasSubstr("machine"));
  EXPECT_THAT(error_of("[bridges]\nanswer = \"everywhere\"\n"), HasSubstr("in digits"));
  EXPECT_THAT(error_of("[bridges]\nvrchat = [\"nowhere\"]\n"), HasSubstr("such as [\"127.0.0.1:9000\"]"));
}

}  // namespace
}  // namespace facet::service
