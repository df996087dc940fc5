// [sound] and [osc] of a configuration.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "facet/error.hpp"
#include "service/config.hpp"

namespace facet::service {
namespace {

using testing::HasSubstr;

std::string refusal(const std::string& text) {
  try {
    parse_config(text, "a.toml");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "";
}

TEST(SoundConfig, IsOffUnlessADeviceIsNamed) {
  const Config config = parse_config("", "a.toml");
  EXPECT_EQ(config.sound.device, "");
  EXPECT_TRUE(config.sound.record);
  EXPECT_EQ(config.osc.listen, "");
  const Config named = parse_config(
      "[sound]\ndevice = \"hw:1\"\nrate_hz = 44100\nchannels = 2\ntimecode_channel = 2\nrecord = false\n",
      "a.toml");
  EXPECT_EQ(named.sound.device, "hw:1");
  EXPECT_EQ(named.sound.rate_hz, 44100);
  EXPECT_EQ(named.sound.timecode_channel, 2);
  EXPECT_FALSE(named.sound.record);
}

TEST(SoundConfig, TheTimecodesChannelIsOneThatIsTaken) {
  EXPECT_THAT(refusal("[sound]\ndevice = \"hw:1\"\ntimecode_channel = 2\n"),
              HasSubstr("is 2, but only 1 channel is taken (channels)"));
  EXPECT_THAT(refusal("[sound]\nchannels = 0\n"), HasSubstr("channels"));
  EXPECT_THAT(refusal("[sound]\nchannel = 1\n"), HasSubstr("channels"));
}

TEST(OscConfig, OthersAreLetInOnlyWhereThatIsMeant) {
  EXPECT_THAT(refusal("[osc]\nlisten = \"0.0.0.0:8000\"\n"), HasSubstr("add public = true"));
  EXPECT_THAT(refusal("[osc]\nlisten = \"8000\"\n"), HasSubstr("ADDRESS:PORT"));
  EXPECT_EQ(parse_config("[osc]\nlisten = \"0.0.0.0:8000\"\npublic = true\n", "a.toml").osc.listen,
            "0.0.0.0:8000");
  EXPECT_EQ(parse_config("[osc]\nlisten = \"[::1]:8000\"\n", "a.toml").osc.listen, "[::1]:8000");
}

}  // namespace
}  // namespace facet::service
