#include "maths/threads.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "support/eventually.hpp"
#include "support/refused_threads.hpp"

namespace facet::maths {
namespace {

TEST(Threads, EachPieceIsDoneOnceByAThreadThatIsThere) {
  for (const std::size_t count : {0U, 1U, 2U, 13U, 127U}) {
    for (const std::size_t threads : {0U, 1U, 2U, 5U, 200U}) {
      std::vector<std::atomic<int>> done(count);
      for_each_piece(count, threads, [&](std::size_t thread, std::size_t piece) {
        EXPECT_LT(thread, std::max<std::size_t>(threads, 1));
        ++done.at(piece);
      });
      for (const auto& times : done) {
        EXPECT_EQ(times, 1);
      }
    }
  }
}

TEST(Threads, AThreadsNumberIsItsOwn) {
  std::vector<std::atomic<int>> inside(3);
  for_each_piece(60, inside.size(), [&](std::size_t thread, std::size_t) {
    EXPECT_EQ(++inside[thread], 1);
    std::this_thread::sleep_for(std::chrono::microseconds(200));
    --inside[thread];
  });
}

TEST(Threads, TheCallersThreadIsNumberNought) {
  const std::thread::id caller = std::this_thread::get_id();
  for_each_piece(20, 3, [&](std::size_t thread, std::size_t) {
    EXPECT_EQ(thread == 0, std::this_thread::get_id() == caller);
  });
}

TEST(Threads, WhatAnyThreadThrowsReachesTheCallerOnceAllHaveEnded) {
  for (const std::size_t thrower : {0U, 1U, 2U}) {
    std::atomic<int> at_work = 0;
    std::atomic<bool> thrown = false;
    std::atomic<int> begun_after = 0;
    try {
      for_each_piece(1'000'000, 3, [&](std::size_t thread, std::size_t) {
        begun_after += thrown ? 1 : 0;
        ++at_work;
        if (thread == thrower) {
          thrown = true;
          --at_work;
          throw std::runtime_error("piece of thread " + std::to_string(thread));
        }
        // The others are at work then, and go on for a while.
        EXPECT_TRUE(facet::test::eventually([&] { return thrown.load(); }));
        std::this_thread::sleep_for(std::chrono::milliseconds(5));
        --at_work;
      });
      ADD_FAILURE() << "nothing was thrown";
    } catch (const std::runtime_error& error) {
      EXPECT_EQ(error.what(), "piece of thread " + std::to_string(thrower));
    }
    EXPECT_EQ(at_work, 0);
    EXPECT_LT(begun_after, 10) << "the rest is left out";
  }
}

TEST(Threads, OfSeveralFaultsOneReachesTheCaller) {
  EXPECT_THROW(for_each_piece(8, 4, [](std::size_t, std::size_t) { throw std::bad_alloc(); }),
               std::bad_alloc);
}

#ifndef FACET_SANITIZED
TEST(Threads, WhereNoThreadIsToBeHadThoseThereDoTheWork) {
  for (int n = 1; n <= 4; ++n) {
    std::vector<std::atomic<int>> done(50);
    facet::test::refuse_thread(n);
    for_each_piece(done.size(), 4, [&](std::size_t thread, std::size_t piece) {
      EXPECT_LT(thread, static_cast<std::size_t>(n)) << "those made before the one that was refused";
      ++done[piece];
    });
    facet::test::refuse_thread(0);
    for (const auto& times : done) {
      EXPECT_EQ(times, 1);
    }
  }
}
#endif

}  // namespace
}  // namespace facet::maths
