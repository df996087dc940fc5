// Who may have a place, with a clock that the tests set.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "facet/clock.hpp"
#include "stream/places.hpp"

namespace facet::stream {
namespace {

using namespace std::chrono_literals;
using Answer = Places::Answer;

const Visitor kOperator{"uid 0", true};

Visitor looker(int uid) {
  return {"uid " + std::to_string(uid), false};
}

PlacesConfig small() {
  PlacesConfig config;
  config.total = 8;
  config.reserved = 2;
  config.per_peer = 4;
  return config;
}

class PlacesTest : public ::testing::Test {
 protected:
  Places::Outcome enter(const Visitor& visitor) { return places_.enter(next_++, visitor, now_); }
  void fill(const Visitor& visitor, int count) {
    for (int i = 0; i < count; ++i) {
      ASSERT_EQ(enter(visitor).answer, Answer::Admitted);
    }
  }
  void use_all() {
    for (Places::Id id = 1; id < next_; ++id) {
      places_.used(id, now_);
    }
  }

  Places places_{small()};
  Clock::time_point now_ = Clock::time_point() + 1h;
  Places::Id next_ = 1;
};

TEST_F(PlacesTest, SomeAreForThoseWhoMayCommand) {
  fill(looker(1), 4);
  fill(looker(2), 2);
  EXPECT_EQ(enter(looker(3)).answer, Answer::NoPlace) << "lookers have 6 of 8";
  fill(kOperator, 2);
  EXPECT_EQ(places_.size(), 8U);
}

TEST_F(PlacesTest, APeerHasSoMany) {
  fill(looker(1), 4);
  use_all();
  EXPECT_EQ(enter(looker(1)).answer, Answer::TooManyOfPeer);
  EXPECT_EQ(enter(looker(2)).answer, Answer::Admitted);
  // Once one of its own is idle, that gives way, and none of another peer's.
  now_ += 10s;
  places_.used(1, now_);
  const Places::Outcome outcome = enter(looker(1));
  EXPECT_EQ(outcome.answer, Answer::Admitted);
  EXPECT_EQ(outcome.gives_way, 2U);
}

TEST_F(PlacesTest, WhoMayCommandTakesTheLongestIdleOfThoseWhoLook) {
  fill(kOperator, 3);
  fill(looker(1), 4);
  fill(looker(2), 1);
  use_all();
  now_ += 1ms;
  places_.used(4, now_);
  EXPECT_EQ(enter(kOperator).gives_way, 5U) << "at once, although it is in use";
}

TEST_F(PlacesTest, SilentOnesOfWhoMayCommandGiveWayAtOnce) {
  fill(kOperator, 8);
  places_.used(1, now_);
  const Places::Outcome outcome = enter(kOperator);
  EXPECT_EQ(outcome.answer, Answer::Admitted);
  EXPECT_EQ(outcome.gives_way, 2U) << "the first was used";
  EXPECT_EQ(places_.size(), 8U);
}

TEST_F(PlacesTest, PlacesInUseStayAmongEquals) {
  fill(kOperator, 8);
  use_all();
  EXPECT_EQ(enter(kOperator).answer, Answer::NoPlace);
  now_ += 5s;
  places_.used(1, now_);
  EXPECT_EQ(enter(kOperator).gives_way, 2U);
}

TEST_F(PlacesTest, WhoLooksTakesNothingFromThoseWhoMayCommand) {
  fill(kOperator, 8);
  now_ += 1h;
  EXPECT_EQ(enter(looker(1)).answer, Answer::NoPlace);
}

TEST_F(PlacesTest, WhoLooksWaitsUntilAnotherIsIdle) {
  fill(looker(1), 4);
  fill(looker(2), 2);
  EXPECT_EQ(enter(looker(3)).answer, Answer::NoPlace);
  now_ += 1s;
  places_.used(1, now_);
  EXPECT_EQ(enter(looker(3)).gives_way, 2U) << "never used for a second";
  now_ += 4999ms;
  for (Places::Id id = 3; id < next_; ++id) {
    places_.used(id, now_);
  }
  EXPECT_EQ(enter(looker(3)).answer, Answer::NoPlace) << "the first is idle, but not for 5 s";
  now_ += 1ms;
  EXPECT_EQ(enter(looker(3)).gives_way, 1U);
}

TEST_F(PlacesTest, WhoLeavesMakesRoom) {
  fill(looker(1), 4);
  use_all();
  places_.leave(2);
  places_.leave(2);
  places_.leave(77);
  places_.used(77, now_);
  EXPECT_EQ(places_.size(), 3U);
  EXPECT_EQ(enter(looker(1)).gives_way, std::nullopt);
}

TEST_F(PlacesTest, APeerConnectsSoOften) {
  PlacesConfig config;
  config.connects_at_once = 3;
  config.connects_per_s = 2;
  Places places(config);
  int admitted = 0;
  for (Places::Id id = 1; id <= 100; ++id) {
    admitted += places.enter(id, looker(1), now_).answer == Answer::Admitted ? 1 : 0;
    places.leave(id);
  }
  EXPECT_EQ(admitted, 3);
  EXPECT_EQ(places.enter(101, looker(1), now_).answer, Answer::TooManyConnects);
  EXPECT_EQ(places.enter(102, looker(2), now_).answer, Answer::Admitted) << "another peer's is another's";
  EXPECT_EQ(places.enter(103, looker(1), now_ + 500ms).answer, Answer::Admitted);
  EXPECT_EQ(places.enter(104, looker(1), now_ + 500ms).answer, Answer::TooManyConnects);
  for (Places::Id id = 200; id < 250; ++id) {
    ASSERT_EQ(places.enter(id, kOperator, now_).answer, Answer::Admitted) << "who may command has no limit";
  }
}

}  // namespace
}  // namespace facet::stream
