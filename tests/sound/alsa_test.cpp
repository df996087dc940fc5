// ALSA without hardware: its own plugins "file" and "null", by a configuration of the test's own.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include <cstdint>
#include <fstream>
#include <vector>

#include "facet/error.hpp"
#include "sound/alsa_source.hpp"
#include "support/paths.hpp"

namespace facet::sound {
namespace {

using testing::HasSubstr;

class Alsa : public testing::Test {
 protected:
  void SetUp() override {
    const auto raw = folder_.path() / "in.raw";
    {
      std::ofstream out(raw, std::ios::binary);
      for (std::int32_t i = 0; i < 96'000; ++i) {
        const std::int32_t values[] = {i * 4096, i * -4096};
        out.write(reinterpret_cast<const char*>(values), sizeof(values));
      }
    }
    const auto config = folder_.path() / "asound.conf";
    std::ofstream(config) << fmt::format(
        "pcm.nothing {{ type null }}\n"
        "pcm.tape {{ type file\n slave.pcm {{ type null }}\n file /dev/null\n infile \"{}\"\n format raw }}\n"
        "ctl.nothing {{ type null }}\n",
        raw.string());
    ::setenv("ALSA_CONFIG_PATH", config.c_str(), 1);
  }
  void TearDown() override { ::unsetenv("ALSA_CONFIG_PATH"); }

  test::TemporaryFolder folder_;
};

TEST_F(Alsa, ADeviceThatIsNotThereIsAnErrorThatNamesIt) {
  AlsaSource source("hw:CARD=Nobody", 48000, 1);
  for (int attempt = 0; attempt < 2; ++attempt) {
    try {
      source.open();
      FAIL();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
      EXPECT_THAT(error.what(), HasSubstr("sound input \"hw:CARD=Nobody\" can't be opened"));
    }
  }
}

TEST_F(Alsa, SamplesComeThroughItsLibrary) {
  AlsaSource source("nothing", 48000, 2);
  const SoundFormat format = source.open();
  EXPECT_EQ(format, (SoundFormat{48000, 2, 24}));
  SoundBlock block;
  std::int64_t last_ns = 0;
  for (int i = 0; i < 5; ++i) {
    ASSERT_EQ(source.read(block), SoundEvent::Samples);
    EXPECT_GT(block.samples.size(), 0U);
    EXPECT_EQ(block.samples.size() % 2, 0U);
    EXPECT_GE(block.taken, static_cast<std::int64_t>(block.samples.size() / 2));
    EXPECT_GE(block.time_ns, last_ns);
    EXPECT_FALSE(block.lost_before);
    last_ns = block.time_ns;
  }
  source.close();
  EXPECT_EQ(source.open(), format);
}

TEST_F(Alsa, SamplesAreThoseOfTheDevice) {
  AlsaSource source("tape", 48000, 2);
  ASSERT_EQ(source.open().bits, 24);
  SoundBlock block;
  ASSERT_EQ(source.read(block), SoundEvent::Samples);
  ASSERT_GT(block.samples.size(), 200U);
  // Where it begins is the plugin's own affair.
  const std::int32_t first = block.samples[0];
  EXPECT_EQ(first % 16, 0);
  for (std::size_t i = 0; i < 100; ++i) {
    EXPECT_EQ(block.samples[2 * i], first + static_cast<std::int32_t>(i) * 16) << i;
    EXPECT_EQ(block.samples[2 * i + 1], -block.samples[2 * i]) << i;
  }
}

}  // namespace
}  // namespace facet::sound
