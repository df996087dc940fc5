#include "facet/clock.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <thread>
#include <vector>

#include "support/set_clock.hpp"

namespace facet {
namespace {

using namespace std::chrono_literals;
using Kernel = std::chrono::steady_clock;

TEST(Clock, IsTheKernelsWhereNoneIsInstalled) {
  const auto before = Kernel::now();
  const auto read = Clock::now();
  EXPECT_GE(read, before);
  const auto read_again = Clock::at(Clock::now_ns());
  EXPECT_LE(read_again, Kernel::now());
  EXPECT_GE(Clock::boot_ns(), read.time_since_epoch().count());
  EXPECT_LT(std::chrono::system_clock::now() - Clock::utc(), 10s);
  EXPECT_EQ(Clock::wake(read + 100h), read + 100h);
}

TEST(Clock, IsWhatIsInstalledUntilThatEnds) {
  const auto midnight = std::chrono::sys_days(std::chrono::year(2000) / 1 / 1);
  {
    test::SetClock outer(1'000'000'000, midnight);
    const Clock::time_point start = Clock::now();
    EXPECT_EQ(Clock::now_ns(), 1'000'000'000);
    EXPECT_EQ(Clock::boot_ns(), 1'000'000'000);
    EXPECT_EQ(Clock::utc(), midnight);
    {
      const test::SetClock inner(5);
      EXPECT_EQ(Clock::now_ns(), 5);
    }
    outer.set(1'002'500'000);
    EXPECT_EQ(ms_since(start), 2.5F);
  }
  EXPECT_GE(Clock::utc(), midnight + std::chrono::days(1));
}

TEST(Clock, WaitsLastAsLongAsTheInstalledClockSays) {
  for (const std::int64_t now_ns : {std::int64_t{0}, Kernel::now().time_since_epoch().count() * 2}) {
    const test::SetClock clock(now_ns);
    const auto before = Kernel::now();
    const auto in_a_second = Clock::wake(Clock::now() + 1s);
    const auto much_later = Clock::wake(Clock::time_point::max());
    EXPECT_GE(in_a_second, before + 1s);
    EXPECT_LE(in_a_second, Kernel::now() + 1s);
    EXPECT_LE(much_later, Kernel::now() + 1h);
    Clock::sleep_until(Clock::now() + 2ms);
    EXPECT_GE(Kernel::now(), before + 2ms);
    Clock::sleep_until(Clock::now() - 100h);  // at once
  }
}

/// The threads of before see the new clock, and its state.
TEST(Clock, IsInstalledUnderThreadsThatReadIt) {
  std::vector<std::jthread> readers;
  for (int i = 0; i < 3; ++i) {
    readers.emplace_back([] {
      while (Clock::now_ns() != 77) {
      }
    });
  }
  const test::SetClock clock(77);
  readers.clear();
}

}  // namespace
}  // namespace facet
