// The FLAC file beside a take, what becomes of it where the disk is full, and what is cut out of it.

#include "sound/sound_file.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <numbers>
#include <random>

#include "facet/error.hpp"
#include "files/disk.hpp"
#include "sound/flac_file.hpp"
#include "sound/sound_export.hpp"
#include "support/eventually.hpp"
#include "support/failing_disk.hpp"
#include "support/paths.hpp"

namespace facet::sound {
namespace {

using testing::HasSubstr;

std::vector<std::int32_t> noise(std::size_t values, int bits, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<std::int32_t> out(values);
  std::generate(out.begin(), out.end(), [&] {
    const auto value = static_cast<std::int32_t>(random() % (1U << 20U)) - (1 << 19);
    return value & ~((1 << (kSampleBits - bits)) - 1);
  });
  return out;
}

std::vector<std::int32_t> all_of(const std::filesystem::path& file) {
  FlacReader reader(file);
  FlacReader::Block block;
  std::vector<std::int32_t> all;
  while (reader.next(block)) {
    EXPECT_EQ(block.first * reader.format().channels, static_cast<std::int64_t>(all.size()));
    all.insert(all.end(), block.samples.begin(), block.samples.end());
  }
  return all;
}

class SoundFiles : public testing::Test {
 protected:
  SoundFileConfig config(const SoundFormat& format) const { return {folder.path() / "a.flac", format, 0}; }
  std::vector<char> bytes_of(const std::filesystem::path& file) const {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  }
  test::TemporaryFolder folder;
};

TEST_F(SoundFiles, HoldWhatWasPutIn) {
  for (const SoundFormat& format : {SoundFormat{48000, 2, 24}, SoundFormat{44100, 1, 16}}) {
    const auto samples = noise(60'001U * static_cast<std::size_t>(format.channels), format.bits, 5);
    SoundFile file(config(format));
    file.start();
    const auto middle = samples.begin() + 20'000 * format.channels;
    file.add({samples.begin(), middle});
    file.add_silence(10'000);
    file.add({middle, samples.end()});
    const SoundFileStatus status = file.stop();
    EXPECT_EQ(status.samples, 70'001);
    EXPECT_EQ(status.reason, "");
    auto expected = samples;
    expected.insert(expected.begin() + 20'000 * format.channels,
                    static_cast<std::size_t>(10'000 * format.channels), 0);
    EXPECT_EQ(all_of(folder.path() / "a.flac"), expected);
    EXPECT_EQ(FlacReader(folder.path() / "a.flac").format(), format);
    std::filesystem::remove(folder.path() / "a.flac");
  }
}

TEST_F(SoundFiles, WhatIsCutOffCanBeReadAsFarAsItGoes) {
  const auto samples = noise(200'000, 24, 6);
  SoundFile file(config({48000, 1, 24}));
  file.start();
  file.add(samples);
  file.stop();
  const auto path = folder.path() / "a.flac";
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  const auto read = all_of(path);
  ASSERT_GT(read.size(), 80'000U);
  ASSERT_LT(read.size(), 110'000U);
  EXPECT_TRUE(std::equal(read.begin(), read.end(), samples.begin()));
}

TEST_F(SoundFiles, AFullDiskEndsTheSoundWithAReason) {
  const auto path = folder.path() / "a.flac";
  // The seventh closes the folder: nothing is lost by that.
  for (const int call : {3, 4, 5, 6, 8, 9, 12}) {
    test::FailingDisk disk(call);
    SoundFile file(config({48000, 1, 24}));
    file.start();
    for (int second = 0; second < 20; ++second) {
      file.add(noise(48'000, 24, static_cast<std::uint32_t>(second)));
    }
    const SoundFileStatus status = file.stop();
    ASSERT_TRUE(disk.has_failed());
    EXPECT_THAT(status.reason, testing::AnyOf(HasSubstr("a.flac' can't be written: "), HasSubstr("folder")))
        << call;
    std::filesystem::remove(path);
  }
  EXPECT_THROW(SoundFile(SoundFileConfig{folder.path() / "none" / "a.flac", {48000, 1, 24}, 0}), Error);
}

TEST_F(SoundFiles, TheDisksReserveIsKept) {
  SoundFileConfig wanted = config({48000, 1, 24});
  wanted.disk_reserve_bytes = 1ULL << 62U;
  SoundFile file(wanted);
  file.start();
  // It is looked at once a second.
  ASSERT_TRUE(test::eventually([&] {
    file.add(noise(480, 24, 1));
    return file.status().reason != "";
  }));
  EXPECT_THAT(file.stop().reason, HasSubstr("disk nearly full"));
}

TEST_F(SoundFiles, OutsideBytesAreNoSound) {
  const auto path = folder.path() / "bad.flac";
  for (const std::string& text : {std::string(), std::string("fLaC"), std::string(5000, 'x')}) {
    std::ofstream(path, std::ios::binary) << text;
    EXPECT_THROW(FlacReader{path}, Error);
  }
  EXPECT_THROW(FlacReader{folder.path() / "missing.flac"}, Error);
  EXPECT_THROW(FlacReader{folder.path()}, Error);
}

double number_at(const std::vector<char>& bytes, std::size_t at, std::size_t count) {
  double value = 0;
  for (std::size_t i = count; i-- > 0;) {
    value = value * 256 + static_cast<unsigned char>(bytes.at(at + i));
  }
  return value;
}

TEST_F(SoundFiles, AWavSaysWhatItHoldsAndWhen) {
  SoundFile file(config({48000, 1, 16}));
  file.start();
  file.add(noise(96'000, 16, 2));
  file.stop();
  SoundCut cut{folder.path() / "a.flac",
               {1'000'000'000, 48000, 48000, 96'000, 0, ""},
               1'500'000'000,
               2'000'000'000,
               36000.5};
  EXPECT_EQ(write_sound(cut, SoundEncoding::Wav, folder.path() / "a.wav"), 24'000);
  const auto wav = bytes_of(folder.path() / "a.wav");
  EXPECT_EQ(std::string(wav.begin(), wav.begin() + 4), "RIFF");
  EXPECT_EQ(number_at(wav, 4, 4), static_cast<double>(wav.size() - 8));
  EXPECT_EQ(std::string(wav.begin() + 12, wav.begin() + 16), "bext");
  EXPECT_EQ(number_at(wav, 20 + 256 + 32 + 32 + 10 + 8, 8), 36000.5 * 48000);
  const std::size_t format = 20 + 602;
  EXPECT_EQ(std::string(&wav[format], 4), "fmt ");
  EXPECT_EQ(number_at(wav, format + 12, 4), 48000);
  EXPECT_EQ(number_at(wav, format + 22, 2), 16);
  EXPECT_EQ(number_at(wav, format + 28, 4), 48'000);
  EXPECT_EQ(wav.size(), format + 32 + 48'000);
  // At the device's own rate and a whole place the samples are what they were.
  const auto samples = noise(96'000, 16, 2);
  for (std::size_t i = 0; i < 24'000; i += 997) {
    const auto value = static_cast<std::int16_t>(static_cast<int>(number_at(wav, format + 32 + 2 * i, 2)));
    EXPECT_EQ(value, samples[24'000 + i] >> 8) << i;
  }
  cut.sound = {};
  EXPECT_THROW(write_sound(cut, SoundEncoding::Wav, folder.path() / "b.wav"), Error);
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "b.wav"));
}

TEST_F(SoundFiles, TheDevicesClockIsTakenOut) {
  // 200 ppm fast: what it took for 1000 Hz is 1000 Hz again, to a few millionths of full scale.
  constexpr double kRate = 48000 * (1 + 200e-6);
  constexpr double kTone_hz = 1000;
  std::vector<std::int32_t> samples;
  for (int i = 0; i < 48'000 * 20; ++i) {
    samples.push_back(static_cast<std::int32_t>(
        std::lround(0.5 * kFullScale * std::sin(2 * std::numbers::pi * kTone_hz * i / kRate))));
  }
  SoundFile file(config({48000, 1, 24}));
  file.start();
  file.add(samples);
  file.stop();
  const take::TakeSound sound{1'000'000'000, kRate, 48000, 48'000 * 20, 0, ""};
  const SoundCut cut{folder.path() / "a.flac", sound, 900'000'000, 20'000'000'000, std::nullopt};
  EXPECT_EQ(write_sound(cut, SoundEncoding::Flac, folder.path() / "b.flac"), 48'000 * 19 + 4'800);
  const auto out = all_of(folder.path() / "b.flac");
  double worst = 0;
  for (std::size_t k = 5'000; k < out.size(); ++k) {
    const double time_s = static_cast<double>(k) / 48000 - 0.1;
    const double expected = 0.5 * std::sin(2 * std::numbers::pi * kTone_hz * time_s);
    worst = std::max(worst, std::abs(out[k] / kFullScale - expected));
  }
  EXPECT_LT(worst, 1e-4);
  // Before the sound there is silence.
  EXPECT_TRUE(std::all_of(out.begin(), out.begin() + 4'700, [](std::int32_t value) { return value == 0; }));
}

TEST_F(SoundFiles, APartIsCopiedAsItIs) {
  SoundFile file(config({48000, 2, 24}));
  file.start();
  const auto samples = noise(2 * 96'000, 24, 9);
  file.add(samples);
  file.stop();
  const take::TakeSound sound{5'000'000'000, 48004.8, 48000, 96'000, 0, ""};
  const SoundCut cut{folder.path() / "a.flac", sound, 5'500'000'000, 6'000'000'000, std::nullopt};
  const take::TakeSound part = copy_sound(cut, folder.path() / "b.flac");
  const auto copied = all_of(folder.path() / "b.flac");
  EXPECT_EQ(part.samples, 24'003);
  EXPECT_NEAR(static_cast<double>(part.first_ns), 5.5e9, 2e4);
  EXPECT_TRUE(std::equal(copied.begin(), copied.end(), samples.begin() + 2 * 24'002));
}

}  // namespace
}  // namespace facet::sound
