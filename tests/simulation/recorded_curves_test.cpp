#include "simulation/recorded_curves.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <string>

#include "facet/error.hpp"
#include "simulation/placed_actor.hpp"
#include "support/synthetic_model.hpp"

namespace facet::simulation {
namespace {

std::string header() {
  std::string line = "Timecode,BlendShapeCount";
  for (const std::string_view name : mesh::kArkitNames) {
    line += fmt::format(",{}", name);
  }
  return line + ",HeadYaw,HeadPitch,HeadRoll\n";
}

/// A row whose jaw is open by `jaw` and whose head is turned; all else is 0.
std::string row(std::string_view timecode, float jaw, float yaw_rad = 0) {
  std::string line = fmt::format("{},55", timecode);
  for (const std::string_view name : mesh::kArkitNames) {
    line += name == "JawOpen" ? fmt::format(",{}", jaw) : std::string(",0");
  }
  return line + fmt::format(",{},0,0\n", yaw_rad);
}

float jaw_at(const RecordedCurves& curves, double time_s) {
  return curves.values(time_s)[static_cast<std::size_t>(mesh::arkit_index("jawOpen"))];
}

std::string message_of(const std::string& text) {
  try {
    RecordedCurves::parse(text, "a.csv");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  ADD_FAILURE() << "accepted";
  return {};
}

TEST(RecordedCurves, ValuesComeAtTheTimesOfTheirRows) {
  // Sixty frames of timecode a second; no face is seen in between; midnight passes; values end at 1.
  const auto curves =
      RecordedCurves::parse(header() + row("23:59:59:30.000", 0.2F, 0.3F) + "23:59:59:32.000,0\n" +
                                row("00:00:00:00.000", 0.4F) + row("00:00:01:00.000", 1.3F),
                            "a.csv");
  EXPECT_DOUBLE_EQ(curves.duration_s(), 1.5);
  EXPECT_FLOAT_EQ(jaw_at(curves, -1), 0.2F);
  EXPECT_FLOAT_EQ(jaw_at(curves, 0.25), 0.3F);
  EXPECT_FLOAT_EQ(jaw_at(curves, 0.5), 0.4F);
  EXPECT_FLOAT_EQ(jaw_at(curves, 1.0), 0.7F);
  EXPECT_FLOAT_EQ(jaw_at(curves, 9), 1.0F);
  EXPECT_TRUE(curves.turns_head());
  EXPECT_FLOAT_EQ(curves.head(0).yaw_rad, -0.3F);  // the app counts turns to the subject's right
  EXPECT_FLOAT_EQ(curves.head(1).yaw_rad, 0);
}

TEST(RecordedCurves, LeavesOutWhatIsNamed) {
  auto curves =
      RecordedCurves::parse(header() + row("00:00:00:00.000", 0.2F) + row("00:00:01:00.000", 1), "a.csv");
  EXPECT_THROW(curves.leave_out("jawOpne"), Error);
  curves.leave_out("jawOpen");
  EXPECT_EQ(jaw_at(curves, 1), 0);
}

TEST(RecordedCurves, SaysWhatIsWrongAndWhere) {
  const std::string good = row("00:00:00:00.000", 0.2F) + row("00:00:01:00.000", 1);
  std::string unknown = header();
  unknown.replace(unknown.find("JawOpen"), 7, "JawAjar");
  EXPECT_NE(message_of(unknown + good).find("'JawAjar' is none of ARKit's names"), std::string::npos);
  std::string missing = header();
  missing.erase(missing.find("JawOpen,"), 8);
  EXPECT_NE(message_of(missing + good).find("columns are missing: JawOpen"), std::string::npos);
  std::string twice = header();
  twice.replace(twice.find("JawOpen"), 7, "JawLeft");
  EXPECT_NE(message_of(twice + good).find("JawLeft is there twice"), std::string::npos);
  EXPECT_NE(message_of(header() + good + "00:00:02:00.000,55,1\n").find("line 4"), std::string::npos);
  EXPECT_NE(message_of(header() + good + row("00:00:00:30.000", 0)).find("line 4"), std::string::npos);
  EXPECT_NE(message_of(header() + row("soon", 0) + good).find("line 2: 'soon' is not a timecode"),
            std::string::npos);
  EXPECT_NE(message_of(header() + row("00:00:00:nan", 0) + good).find("line 2: '00:00:00:nan' is not"),
            std::string::npos);
  EXPECT_NE(message_of(header() + row("00:00:00:00.000", 0)).find("fewer than two rows"), std::string::npos);
  EXPECT_NE(message_of("frame,jaw\n1,2\n").find("line 1"), std::string::npos);
  EXPECT_NE(message_of("").find("fewer than two rows"), std::string::npos);
}

TEST(RecordedCurves, DriveAnActorFromAnyMomentOn) {
  const face::FaceModel model = test::synthetic_model();
  const auto curves = std::make_shared<const RecordedCurves>(
      RecordedCurves::parse(header() + row("00:00:00:00.000", 0.2F) + row("00:00:02:00.000", 0.6F), "a.csv"));
  const PlacedActor actor(model, {}, {.duration_s = 1, .start_s = 1, .curves = curves});
  const auto jaw = static_cast<std::size_t>(model.expression_index("jawOpen"));
  EXPECT_FLOAT_EQ(actor.expression(0)[jaw], 0.4F);
  EXPECT_FLOAT_EQ(actor.expression(0.5)[jaw], 0.5F);
  EXPECT_THROW(PlacedActor(model, {}, {.duration_s = 1.5, .start_s = 1, .curves = curves}), Error);
}

TEST(RecordedCurves, AModelWithoutWhatTheyMoveIsAnError) {
  face::FaceModel model = test::synthetic_model();
  const auto curves = std::make_shared<const RecordedCurves>(
      RecordedCurves::parse(header() + row("00:00:00:00.000", 0.2F) + row("00:00:02:00.000", 0.6F), "a.csv"));
  model.expression_names[static_cast<std::size_t>(model.expression_index("jawOpen"))] = "something";
  try {
    const PlacedActor actor(model, {}, {.duration_s = 1, .curves = curves});
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("a.csv moves jawOpen"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace facet::simulation
