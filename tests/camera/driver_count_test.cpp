#include "camera/driver_count.hpp"

#include <gtest/gtest.h>

#include <cstdint>
#include <optional>

namespace facet::test {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr std::int64_t kNow_ns = 500 * kSecond_ns;
constexpr std::int64_t kStarted_ns = 400 * kSecond_ns;

TEST(MonotonicStamp, IsTakenAsItIsWhereItFits) {
  const std::int64_t stamp_ns = 450 * kSecond_ns;
  EXPECT_EQ(camera::monotonic_stamp_ns(stamp_ns, kStarted_ns, kNow_ns, std::nullopt), stamp_ns);
  EXPECT_EQ(camera::monotonic_stamp_ns(stamp_ns, kStarted_ns, kNow_ns, 520 * kSecond_ns), stamp_ns);
  EXPECT_EQ(camera::monotonic_stamp_ns(kNow_ns + 1000, kStarted_ns, kNow_ns, std::nullopt), kNow_ns);
}

/// A machine that was suspended for an hour: CLOCK_BOOTTIME is ahead by that.
TEST(MonotonicStamp, IsConvertedFromAnotherClock) {
  const std::int64_t suspended_ns = 3600 * kSecond_ns;
  EXPECT_EQ(camera::monotonic_stamp_ns(450 * kSecond_ns + suspended_ns, kStarted_ns, kNow_ns,
                                       kNow_ns + suspended_ns),
            450 * kSecond_ns);
}

TEST(MonotonicStamp, IsNoneWhereItFitsNoClock) {
  EXPECT_EQ(camera::monotonic_stamp_ns(0, kStarted_ns, kNow_ns, std::nullopt), std::nullopt);
  EXPECT_EQ(camera::monotonic_stamp_ns(0, kStarted_ns, kNow_ns, 4100 * kSecond_ns), std::nullopt);
  EXPECT_EQ(camera::monotonic_stamp_ns(900 * kSecond_ns, kStarted_ns, kNow_ns, std::nullopt), std::nullopt);
}

TEST(DriverCount, WhatLiesInAPauseIsNoOmission) {
  for (const bool told : {false, true}) {
    camera::DriverCount count(kSecond_ns / 10);
    std::uint64_t omitted = 0;
    for (std::uint32_t i = 0; i < 20; ++i) {
      const std::int64_t pause_ns = i < 10 ? 0 : 60 * kSecond_ns;
      if (told && i == 10) {
        count.resume();
      }
      omitted += count.next(i, i * kSecond_ns / 10 + pause_ns).omitted;
    }
    EXPECT_EQ(omitted, told ? 0U : 600U);
  }
}

TEST(DriverCount, GoesOnOverWrapsStreamsAndNonsense) {
  camera::DriverCount count(kSecond_ns / 10);
  EXPECT_EQ(count.next(0xFFFFFFFE, std::nullopt).sequence, 0U);
  EXPECT_EQ(count.next(0xFFFFFFFF, std::nullopt).sequence, 1U);
  const auto wrapped = count.next(2, std::nullopt);
  EXPECT_EQ(wrapped.sequence, 4U);
  EXPECT_EQ(wrapped.lost, 2U);
  EXPECT_EQ(count.next(2, std::nullopt).sequence, 5U) << "a driver that does not count";
  EXPECT_EQ(count.next(1'000'000, std::nullopt).sequence, 6U) << "another count";
  count.begin_stream();
  const auto anew = count.next(0, std::nullopt);
  EXPECT_EQ(anew.sequence, 8U);
  EXPECT_EQ(anew.lost, 0U);
}

}  // namespace
}  // namespace facet::test
