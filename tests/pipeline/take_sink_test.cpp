#include "pipeline/take_sink.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <string>
#include <thread>

#include "facet/error.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/reader.hpp"

namespace facet::pipeline {
namespace {

TEST(TakeSink, RecordsOneTakeAtATime) {
  const test::TemporaryFolder folder;
  TakeSink sink;
  const auto deliver = [&](std::uint64_t sequence) {
    auto frame = std::make_shared<mesh::MeshFrame>();
    frame->sequence = sequence;
    frame->timestamp_ns = static_cast<std::int64_t>(sequence);
    sink.deliver(std::move(frame));
  };
  deliver(0);
  EXPECT_FALSE(sink.status().has_value());
  EXPECT_FALSE(sink.wants_one_mesh());
  EXPECT_FALSE(sink.end({}).has_value());

  take::TakeRecorderConfig config;
  config.when_full = take::WhenFull::Wait;
  config.file = folder.path() / "a.take";
  sink.begin(config);
  take::TakeRecorderConfig other = config;
  other.file = folder.path() / "b.take";
  EXPECT_THROW(sink.begin(other), Error);
  EXPECT_FALSE(std::filesystem::exists(other.file));
  for (std::uint64_t sequence = 1; sequence <= 5; ++sequence) {
    deliver(sequence);
  }
  EXPECT_EQ(sink.status()->file, config.file);
  EXPECT_TRUE(sink.wants_one_mesh());
  const auto ended = sink.end({});
  ASSERT_TRUE(ended.has_value());
  EXPECT_EQ(ended->frames, 5U);
  EXPECT_FALSE(sink.wants_one_mesh());
  EXPECT_EQ(ended->file, config.file);
  deliver(6);
  EXPECT_THROW(sink.begin(config), Error) << "a take is never overwritten";
  sink.begin(other);
  deliver(7);
  sink.request_end({});
  deliver(8);
  EXPECT_EQ(sink.end({})->frames, 1U);
  EXPECT_EQ(take::TakeReader(config.file).frame_count(), 5);
  EXPECT_EQ(take::TakeReader(other.file).entry(0).sequence, 7U);
}

TEST(TakeSink, LeavesProvisionalMeshesOut) {
  const test::TemporaryFolder folder;
  TakeSink sink;
  take::TakeRecorderConfig config;
  config.when_full = take::WhenFull::Wait;
  config.file = folder.path() / "a.take";
  sink.begin(config);
  const auto subject = test::patch_subject();
  const auto albedo = test::patch_albedo(*subject, 1);
  const auto shown = std::make_shared<mesh::MeshFrame>(test::patch_frame(1, subject, albedo));
  shown->state = mesh::TrackingState::Acquiring;
  shown->expression_confidence.assign(shown->expression.size(), 1);
  shown->avatar_values.assign(shown->expression.size(), 1);
  sink.deliver(shown);
  sink.deliver(std::make_shared<mesh::MeshFrame>(test::patch_frame(2, subject, albedo)));
  EXPECT_NE(shown->subject, nullptr) << "other sinks show it";
  ASSERT_EQ(sink.end({})->frames, 2U);
  take::TakeReader take(config.file);
  EXPECT_EQ(take.entry(0).state, mesh::TrackingState::Acquiring);
  EXPECT_FALSE(take.entry(0).has_mesh);
  EXPECT_TRUE(take.frame(0)->expression_confidence.empty());
  EXPECT_TRUE(take.frame(0)->avatar_values.empty());
  EXPECT_TRUE(take.entry(1).has_mesh);
}

/// Whoever stops the daemon must neither wait for a slow disk nor lose a take that is just being begun.
TEST(TakeSink, AnEndThatIsWantedMeanwhileHoldsForWhatIsBeingBegun) {
  const test::TemporaryFolder folder;
  TakeSink sink;
  take::TakeRecorderConfig config;
  config.when_full = take::WhenFull::Wait;
  for (int round = 0; round < 20; ++round) {
    config.file = folder.path() / (std::to_string(round) + ".take");
    std::atomic<bool> asked{false};
    std::jthread stopping([&] {
      while (sink.ended()) {
        std::this_thread::yield();
      }
      sink.request_end("facetd was stopped");
      sink.status();
      asked = true;
    });
    sink.begin(config);
    while (!asked) {
      std::this_thread::yield();
    }
    while (!sink.ended()) {  // it is closed without end()
      std::this_thread::yield();
    }
    ASSERT_TRUE(take::TakeReader(config.file).info().closed);
    const auto status = sink.end("asked for later");
    ASSERT_TRUE(status.has_value());
    EXPECT_EQ(status->reason, "facetd was stopped");
    EXPECT_EQ(take::TakeReader(config.file).info().end_reason, status->reason);
    EXPECT_TRUE(sink.ended());
  }
}

}  // namespace
}  // namespace facet::pipeline
