#include "facet/aside.hpp"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <atomic>
#include <stdexcept>
#include <thread>

namespace facet::landmark {
namespace {

/// Until the helper has come to the work; ends the test where it never does.
void until(const std::atomic<bool>& flag) {
  flag.wait(false);
}

TEST(Aside, TheHelperWorksWhileItsAskerGoesOn) {
  std::atomic<bool> at_work{false};
  std::atomic<bool> go_on{false};
  std::thread::id who;
  Aside aside("aside-test", [&] {
    who = std::this_thread::get_id();
    at_work = true;
    at_work.notify_all();
    until(go_on);
  });
  EXPECT_FALSE(aside.begun());
  aside.begin();
  until(at_work);  // so it works while this thread is here
  EXPECT_TRUE(aside.begun());
  EXPECT_FALSE(aside.ready());
  go_on = true;
  go_on.notify_all();
  aside.wait();
  EXPECT_FALSE(aside.begun());
  EXPECT_NE(who, std::this_thread::get_id());
}

TEST(Aside, WorkIsDoneOnceForEveryQuestion) {
  int done = 0;
  Aside aside("aside-test", [&] { ++done; });
  for (int i = 1; i <= 2000; ++i) {
    aside.begin();
    if (i % 3 == 0) {
      while (!aside.ready()) {
        std::this_thread::yield();
      }
    }
    aside.wait();
    ASSERT_EQ(done, i);
  }
}

TEST(Aside, ItsHelperGivesWay) {
  std::atomic<bool> at_work{false};
  int nice = 0;
  Aside aside("aside-test", [&] {
    nice = ::getpriority(PRIO_PROCESS, 0);
    at_work = true;
    at_work.notify_all();
  });
  const int own = ::getpriority(PRIO_PROCESS, 0);
  aside.begin();
  until(at_work);
  aside.wait();
  EXPECT_GE(nice, std::min(own + 10, 19));
  EXPECT_EQ(::getpriority(PRIO_PROCESS, 0), own) << "only the helper's priority";
}

TEST(Aside, WhatIsThrownReachesWhoWaits) {
  bool fails = true;
  Aside aside("aside-test", [&] {
    if (fails) {
      throw std::runtime_error("no memory");
    }
  });
  aside.begin();
  EXPECT_THROW(aside.wait(), std::runtime_error);
  fails = false;
  aside.begin();
  EXPECT_NO_THROW(aside.wait());
}

TEST(Aside, EndsWithAQuestionThatNobodyWaitsFor) {
  std::atomic<int> done{0};
  {
    Aside aside("aside-test", [&] { ++done; });
    aside.begin();
  }
  EXPECT_LE(done, 1);
}

}  // namespace
}  // namespace facet::landmark
