#include "service/person_methods.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>

#include "facet/error.hpp"
#include "person/person_folder.hpp"
#include "service/service.hpp"
#include "service/status_report.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::service {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

class PersonMethods : public ::testing::Test {
 protected:
  json ask(const json& params, bool member = true) {
    const auto methods =
        person_methods([this] { return now_; }, [this] { ++fired_; }, folder_, errands_, log_);
    const json request = {{"jsonrpc", "2.0"}, {"id", 1}, {"method", method_}, {"params", params}};
    return json::parse(answer_request(methods, request.dump(), {1, 1000, member}));
  }
  std::string refusal(const json& params) {
    const json answer = ask(params);
    return answer.contains("error") ? answer["error"]["message"].get<std::string>() : "";
  }
  /// The head was learned.
  void learn() {
    const face::FaceModel model = test::synthetic_model(21);
    person::LearnedShape shape;
    shape.focal_px = 1000;
    shape.identity.assign(static_cast<std::size_t>(model.identity_count()), 0);
    shape.neutral_mm = model.contract_identity(shape.identity).neutral_mm.cast<double>();
    shape.keyframes = {3, 5, 8};
    person::Observed observed;
    observed.camera.width_px = 640;
    observed.camera.height_px = 360;
    observed.span = {-20, 22, -5, 6};
    auto learned = std::make_shared<pipeline::LearningStatus>();
    learned->state = pipeline::LearningStatus::State::Learned;
    learned->subject = 2;
    learned->person = std::make_shared<const person::PersonFile>(person::person_of(model, observed, shape));
    now_.learning = learned;
    now_.tracking = mesh::TrackingState::Tracking;
  }

  test::TemporaryFolder temporary_;
  std::filesystem::path folder_ = temporary_.path();
  pipeline::PipelineStatus now_;
  std::string method_ = "person.keep";
  int fired_ = 0;
  Log log_{LogLevel::Error};
  Errands errands_{"not-started"};  // answer_request does the work itself
};

TEST_F(PersonMethods, KeepsWhoWasLearnedUnderTheirName) {
  learn();
  const json answer = ask({{"name", "ada"}});
  ASSERT_TRUE(answer.contains("result")) << answer;
  const std::filesystem::path file = answer["result"]["file"].get<std::string>();
  EXPECT_EQ(file, folder_ / "ada.person");
  const person::PersonFile kept = person::read_person(file);
  EXPECT_EQ(kept.name, "ada");
  EXPECT_EQ(kept.software, software_name());
  EXPECT_EQ(kept.keyframes, 3);
  EXPECT_EQ(kept.span.largest_yaw, 22);
  EXPECT_EQ(kept.width_px, 640);
  EXPECT_EQ(kept.neutral_mm, now_.learning->person->neutral_mm);
  EXPECT_THAT(refusal({{"name", "ada"}}), HasSubstr("somebody is called 'ada' already"));
}

TEST_F(PersonMethods, RefusesWhatCanNotBeKeptAndSaysWhatIsMissing) {
  EXPECT_THAT(refusal({{"name", "ada"}}), AllOf(HasSubstr("one live camera"), HasSubstr("learn = true")));
  auto looking = std::make_shared<pipeline::LearningStatus>();
  looking->needed_deg = 12;
  looking->note = "the shape found folds";
  now_.learning = looking;
  EXPECT_THAT(refusal({{"name", "ada"}}),
              AllOf(HasSubstr("both sides by 12 degrees"), HasSubstr("the shape found folds")));
  learn();
  EXPECT_THAT(refusal({{"name", "a/b"}}), HasSubstr("no name for a person"));
  EXPECT_THAT(refusal(json::object()), HasSubstr("name"));
  EXPECT_EQ(ask({{"name", "ada"}}, false)["error"]["code"], kPermissionDenied);
  folder_.clear();
  EXPECT_THAT(refusal({{"name", "ada"}}), HasSubstr("[persons] folder"));
  folder_ = temporary_.path() / "nowhere";
  EXPECT_THAT(refusal({{"name", "ada"}}), HasSubstr("is not there"));
}

TEST_F(PersonMethods, NobodyIsKeptWhoIsNotThere) {
  learn();
  EXPECT_THAT(refusal({{"name", "ada"}, {"subject", 3}}), HasSubstr("not before the camera"));
  now_.tracking = mesh::TrackingState::Searching;
  EXPECT_THAT(refusal({{"name", "ada"}}), HasSubstr("not before the camera"));
  now_.tracking = mesh::TrackingState::Tracking;
  EXPECT_TRUE(std::filesystem::is_empty(folder_));
  EXPECT_EQ(refusal({{"name", "ada"}, {"subject", 2}}), "");
  EXPECT_TRUE(std::filesystem::exists(folder_ / "ada.person"));
}

TEST_F(PersonMethods, LampsFireForWhoIsThereAndNotKnownYet) {
  method_ = "person.burst";
  const json nothing = json::object();
  EXPECT_THAT(refusal(nothing), HasSubstr("one live camera"));
  learn();
  auto learning = std::make_shared<pipeline::LearningStatus>(*now_.learning);
  now_.learning = learning;
  EXPECT_THAT(refusal(nothing), HasSubstr("no lamps are configured: name their lines in [lamps]"));
  learning->lamps = 4;
  learning->burst_s = 2;
  EXPECT_THAT(refusal(nothing), HasSubstr("learned already"));
  learning->state = pipeline::LearningStatus::State::Looking;
  now_.tracking = mesh::TrackingState::Searching;
  EXPECT_THAT(refusal(nothing), HasSubstr("the lamps stay off"));
  now_.tracking = mesh::TrackingState::Tracking;
  EXPECT_EQ(ask(nothing, false)["error"]["code"], kPermissionDenied);
  EXPECT_EQ(fired_, 0);
  EXPECT_EQ(ask(nothing)["result"], (json{{"lamps", 4}, {"seconds", 2}}));
  EXPECT_EQ(fired_, 1);
}

/// Before somebody turns the head for it.
TEST_F(PersonMethods, WhetherANameCanBeKeptIsKnownBefore) {
  method_ = "person.check";
  EXPECT_EQ(ask({{"name", "ada"}})["result"]["file"], (folder_ / "ada.person").string());
  EXPECT_TRUE(std::filesystem::is_empty(folder_));
  EXPECT_THAT(refusal({{"name", "a/b"}}), HasSubstr("no name for a person"));
  EXPECT_EQ(ask({{"name", "ada"}}, false)["error"]["code"], kPermissionDenied);
  folder_.clear();
  EXPECT_THAT(refusal({{"name", "ada"}}), HasSubstr("[persons] folder"));
}

TEST_F(PersonMethods, TheStatusShowsWhatTheHeadHasShown) {
  pipeline::PipelineStatus status;
  EXPECT_TRUE(to_json(status)["learning"].is_null());
  auto looking = std::make_shared<pipeline::LearningStatus>();
  looking->seen_deg = {{-8, 0}, {4, 5}};
  looking->turned_left_deg = 8;
  looking->turned_right_deg = 4;
  looking->needed_deg = 12;
  status.learning = looking;
  EXPECT_EQ(to_json(status)["learning"], json::parse(R"({"state": "looking", "subject": 0, "note": "",
      "seen_deg": [[-8, 0], [4, 5]], "turned_left_deg": 8, "turned_right_deg": 4, "needed_deg": 12, "lamps": 0, "burst_s": 0,
      "bursts": 0, "lights": 0})"));
}

}  // namespace
}  // namespace facet::service
