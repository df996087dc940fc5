#include "pipeline/bounded_queue.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <numeric>
#include <thread>

namespace facet::pipeline {
namespace {

TEST(BoundedQueue, KeepsOrderAcrossThreadsAndLosesNothing) {
  constexpr int kCount = 20'000;
  BoundedQueue<int> queue(3);
  std::thread producer([&] {
    for (int i = 1; i <= kCount; ++i) {
      queue.push(int{i});
    }
    queue.close();
  });
  int item = 0;
  int expected = 1;
  while (queue.pop(item)) {
    ASSERT_EQ(item, expected++);
  }
  producer.join();
  EXPECT_EQ(expected, kCount + 1);
}

TEST(BoundedQueue, TheNewestReplacesTheOldest) {
  BoundedQueue<int> queue(2);
  for (int i = 0; i < 5; ++i) {
    EXPECT_TRUE(queue.push_newest(int{i}));
  }
  int item = 0;
  EXPECT_TRUE(queue.pop(item));
  EXPECT_EQ(item, 3);
  EXPECT_TRUE(queue.pop(item));
  EXPECT_EQ(item, 4);
}

TEST(BoundedQueue, WhoeverWaitsForATimeGoesOn) {
  BoundedQueue<int> queue(1);
  int item = 0;
  EXPECT_FALSE(queue.pop_within(item, std::chrono::milliseconds(1)));
  queue.push(3);
  EXPECT_TRUE(queue.pop_within(item, std::chrono::milliseconds(0)));
  EXPECT_EQ(item, 3);
  queue.push(4);
  queue.close();
  EXPECT_TRUE(queue.pop_within(item, std::chrono::hours(1)));
  EXPECT_EQ(item, 4);
  EXPECT_FALSE(queue.pop_within(item, std::chrono::hours(1)));
}

TEST(BoundedQueue, LetsGoOfWhatItHandedOut) {
  BoundedQueue<std::shared_ptr<int>> queue(1);
  auto item = std::make_shared<int>(7);
  queue.push(std::shared_ptr<int>(item));
  std::shared_ptr<int> out;
  queue.pop(out);
  out.reset();
  EXPECT_EQ(item.use_count(), 1) << "a frame's memory must not be held by an empty slot";
}

TEST(BoundedQueue, CloseWakesWhoeverWaits) {
  BoundedQueue<int> full(1);
  full.push(1);
  std::thread producer([&] { EXPECT_FALSE(full.push(2)); });
  std::thread watcher([&] { EXPECT_FALSE(full.wait_until_empty()); });
  BoundedQueue<int> empty(1);
  std::thread consumer([&] {
    int item = 0;
    EXPECT_FALSE(empty.pop(item));
  });
  full.close();
  empty.close();
  producer.join();
  watcher.join();
  consumer.join();
  int item = 0;
  EXPECT_TRUE(full.pop(item)) << "what is inside comes out";
  EXPECT_FALSE(full.pop(item));
  EXPECT_FALSE(full.push_newest(3));
}

}  // namespace
}  // namespace facet::pipeline
