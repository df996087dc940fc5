// A take in the live face's place: what a controller asks for is on the stream, and nothing it can ask for
// harms the stream.

#include "studio/studio.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <random>
#include <thread>

#include "facet/error.hpp"
#include "render/renderer.hpp"
#include "service/errands.hpp"
#include "service/studio_methods.hpp"
#include "service/thumbnails.hpp"
#include "stream/client.hpp"
#include "stream/server.hpp"
#include "support/take_actor.hpp"

namespace facet::service {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

constexpr std::chrono::seconds kPatience{60};  // for what must come; passing never takes it

class StudioTest : public ::testing::Test {
 protected:
  void SetUp() override {
    take_ = test::record_actor(folder_.path(), 1, 60);
    stream::StreamServerConfig config;
    config.socket = folder_.path() / "stream.sock";
    server_.emplace(config);
    server_->start();
    studio_.emplace(
        folder_.path(),
        [this](std::shared_ptr<const mesh::MeshFrame> frame) { server_->publish(std::move(frame)); },
        [this](bool held) { held_ = held; }, "test");
    studio_->start();
    methods_ = studio_methods(*studio_, errands_);
    stream::Subscription subscription;
    subscription.profile = stream::Profile::Displacements;
    reader_.emplace(folder_.path() / "stream.sock", subscription);
  }

  /// One request as a client sends it: the result, or the error.
  json ask(const std::string& method, const json& params = json::object(), bool member = true) {
    const json request = {{"jsonrpc", "2.0"}, {"id", 1}, {"method", method}, {"params", params}};
    json answer = json::parse(answer_request(methods_, request.dump(), {1, 1000, member}));
    return answer.contains("result") ? answer["result"] : answer["error"];
  }
  std::string refusal(const std::string& method, const json& params) {
    const json answer = ask(method, params);
    return answer.is_object() && answer.contains("message") ? answer["message"].get<std::string>()
                                                            : "no error: " + answer.dump();
  }

  json await(const std::function<bool(const json&)>& passes) {
    const auto end = std::chrono::steady_clock::now() + kPatience;
    json status;
    while (std::chrono::steady_clock::now() < end) {
      status = ask("studio.status");
      if (passes(status)) {
        return status;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    ADD_FAILURE() << "not within a minute: " << status.dump(1);
    return status;
  }
  static bool is_ready(const json& status) {
    return status["state"] == "ready" &&
           status["events"] == status["solved"].get<int>() + status["superseded"].get<int>();
  }
  void open(bool pose) {
    ASSERT_TRUE(ask("studio.open", {{"take", "actor1"}, {"pose", pose}}).empty());
    const json status = await([&](const json& now) { return is_ready(now) && now["posing"] == pose; });
    ASSERT_EQ(status["reason"], "");
  }

  /// The next frame of the stream; checks that every number is finite.
  std::shared_ptr<const mesh::MeshFrame> next() {
    stream::DecodedFrame got;
    if (reader_->next(got, kPatience) != stream::ReceiveOutcome::Received) {
      ADD_FAILURE() << "no frame";
      return nullptr;
    }
    EXPECT_TRUE(got.frame.control_vertices_mm.allFinite());
    for (const float displacement : got.frame.displacements_mm) {
      EXPECT_TRUE(std::isfinite(displacement));
    }
    return std::make_shared<const mesh::MeshFrame>(std::move(got.frame));
  }
  /// Frames until one passes.
  bool seen(const std::function<bool(const mesh::Vertices&)>& passes) {
    const auto end = std::chrono::steady_clock::now() + kPatience;
    while (std::chrono::steady_clock::now() < end) {
      const auto frame = next();
      if (frame == nullptr) {
        return false;
      }
      if (frame->subject != nullptr && passes(test::finest_of(*frame))) {
        return true;
      }
    }
    return false;
  }

  int place(const std::string& name) { return ask("studio.status")["places"].at(name).get<int>(); }

  test::TemporaryFolder folder_;
  std::filesystem::path take_;
  std::optional<stream::StreamServer> server_;
  std::atomic<bool> held_{false};
  std::optional<studio::Studio> studio_;
  Errands errands_{"not-started"};  // answer_request does the work itself
  ControlMethods methods_;
  std::optional<stream::StreamClient> reader_;
};

TEST_F(StudioTest, DraggedPointsAreOnTheStreamWhereTheyWereAsked) {
  open(true);
  EXPECT_TRUE(held_);
  const auto basis = animate::TakeBasis::open(take_);
  std::mt19937 random(5);
  const auto vertices = test::scattered_vertices(*basis, 2, random);
  const mesh::Vertices shape = test::captured(*basis, 30);
  const auto at = [&](std::int32_t vertex) {
    return json{shape(0, vertex), shape(1, vertex), shape(2, vertex)};
  };
  ask("pose.set", {{"controls", {{{"vertex", vertices[0]}, {"at_mm", at(vertices[0])}}}}});
  ask("pose.move", {{"vertex", vertices[1]}, {"at_mm", at(vertices[1])}});
  const json status = await([](const json& now) { return is_ready(now) && now["controls"].size() == 2; });
  EXPECT_TRUE(status["controls"][0]["met"]) << status.dump(1);
  EXPECT_EQ(status["controls"][0]["problem"], "");
  EXPECT_GT(status["latency_ms"]["mean"].get<double>(), 0);
  EXPECT_TRUE(seen([&](const mesh::Vertices& made) {
    return (made.col(vertices[0]) - shape.col(vertices[0])).norm() < 0.06F &&
           (made.col(vertices[1]) - shape.col(vertices[1])).norm() < 0.06F;
  }));
  const json regions = ask("pose.regions");
  EXPECT_EQ(regions["vertices"].size(), 2U);
  EXPECT_EQ(regions["rgb"].get<std::string>().size(),
            4 * ((3 * static_cast<std::size_t>(basis->finest_count()) + 2) / 3));
  ask("pose.remove", {{"vertex", vertices[0]}});
  await([](const json& now) { return is_ready(now) && now["controls"].size() == 1; });
  EXPECT_THAT(refusal("pose.remove", {{"vertex", vertices[0]}}), HasSubstr("is no control point"));

  ask("studio.close");
  await([](const json& now) { return now["state"] == "closed"; });
  EXPECT_FALSE(held_);
}

TEST_F(StudioTest, AFloodOfCommandsKeepsTheNewest) {
  open(true);
  const int lip = place("lip-lower");
  const auto basis = animate::TakeBasis::open(take_);
  const Eigen::Vector3f from = animate::resting_vertices(*basis).col(lip);
  const Eigen::Vector3f to = test::captured(*basis, 30).col(lip);
  constexpr int kEvents = 3000;
  for (int event = 1; event <= kEvents; ++event) {
    const Eigen::Vector3f at = from + static_cast<float>(event) / kEvents * (to - from);
    ask("pose.set", {{"controls", {{{"vertex", lip}, {"at_mm", {at.x(), at.y(), at.z()}}}}}});
  }
  const json status = await([](const json& now) { return is_ready(now) && now["events"] == kEvents + 1; });
  EXPECT_GT(status["superseded"].get<int>(), 0);
  EXPECT_LT(status["controls"][0]["miss"].get<double>(), 0.05);
  EXPECT_TRUE(seen([&](const mesh::Vertices& made) { return (made.col(lip) - to).norm() < 0.06F; }));
}

TEST_F(StudioTest, RefusesWhatMakesNoSense) {
  EXPECT_THAT(refusal("pose.set", {{"controls", json::array()}}), HasSubstr("no take is open"));
  EXPECT_THAT(refusal("studio.play", {{"what", "take"}}), HasSubstr("no take is open"));
  EXPECT_THAT(refusal("studio.open", {{"take", "nothing"}}), HasSubstr("there is no take nothing"));
  EXPECT_NE(refusal("studio.open", {{"take", "../actor1"}}).find("name"), std::string::npos);
  EXPECT_EQ(ask("studio.open", {{"take", "actor1"}}, false)["code"], kPermissionDenied);
  open(false);
  EXPECT_THAT(refusal("pose.set", {{"controls", json::array()}}), HasSubstr("open for replay alone"));
  open(true);
  const auto control = [](const json& vertex, const json& at) {
    return json{{"controls", {{{"vertex", vertex}, {"at_mm", at}}}}};
  };
  EXPECT_THAT(refusal("pose.set", control(99'999'999, {0, 0, 0})), HasSubstr("99999999"));
  EXPECT_THAT(refusal("pose.set", control("elbow", {0, 0, 0})), HasSubstr("lip-lower"));
  EXPECT_THAT(refusal("pose.set", control(0, {1e9, 0, 0})), HasSubstr("from"));
  EXPECT_THAT(refusal("pose.set", control(0, {5000, 0, 0})), HasSubstr("mm"));
  EXPECT_THAT(refusal("pose.set", control(0, {nullptr, 0, 0})), HasSubstr("number"));
  EXPECT_THAT(refusal("pose.set", control(0, {0, 0})), HasSubstr("3 numbers"));
  EXPECT_THAT(refusal("pose.move", {{"vertex", 0}}), HasSubstr("at_mm"));
  const json twice = {{{"vertex", 7}, {"move_mm", {1, 0, 0}}}, {{"vertex", 7}, {"move_mm", {-1, 0, 0}}}};
  EXPECT_THAT(refusal("pose.set", {{"controls", twice}}), HasSubstr("7"));
  EXPECT_THAT(refusal("studio.play", {{"what", "pose"}}), HasSubstr("what must be"));
  EXPECT_THAT(refusal("studio.seek", {{"time_s", -1}}), HasSubstr("time_s"));
  EXPECT_EQ(refusal("studio.seek", {{"time_s", "soon"}}), "time_s must be a number");
  EXPECT_EQ(refusal("pose.remove", {{"vertex", 0.5}}),
            "vertex must be a whole number or the name of a place");
  EXPECT_THAT(refusal("keys.export", {{"name", "x"}}), HasSubstr("no keys"));
  EXPECT_THAT(refusal("keys.set", {{"keys", {{"keys", json::array()}}}}), HasSubstr("empty"));
  EXPECT_THAT(refusal("keys.set", {{"keys", json::array({json::array()})}}), HasSubstr("must be an object"));

  // On the open edge, and two that pull skin apart: not refused, but told; and what is streamed is finite.
  const auto basis = animate::TakeBasis::open(take_);
  const auto& boundary = basis->hierarchy().finest().one_rings.on_boundary;
  const auto edge = static_cast<int>(std::find(boundary.begin(), boundary.end(), 1) - boundary.begin());
  const int lip = place("lip-lower");
  const auto& rings = basis->hierarchy().finest().one_rings;
  const int beside = rings.neighbours[static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(lip)])];
  const json apart = {{{"vertex", edge}, {"move_mm", {20, 0, 0}}},
                      {{"vertex", lip}, {"move_mm", {0, -15, 0}}},
                      {{"vertex", beside}, {"move_mm", {0, 15, 0}}}};
  const auto problem = [&](const json& status, std::size_t which) {
    return status["controls"][which]["problem"].get<std::string>();
  };
  ask("pose.set", {{"controls", apart}, {"beyond", true}});
  const json status = await([](const json& now) { return is_ready(now) && now["controls"].size() == 3; });
  EXPECT_THAT(problem(status, 0), HasSubstr("open edge"));
  EXPECT_THAT(problem(status, 1), HasSubstr("other control points"));
  ASSERT_NE(next(), nullptr);
  // Without "beyond" they stay where a face is.
  ask("pose.set", {{"controls", apart}});
  const json kept =
      await([](const json& now) { return is_ready(now) && now["controls"][1]["clamped"] == true; });
  EXPECT_THAT(problem(kept, 0), testing::AllOf(HasSubstr("pulled back"), HasSubstr("open edge")));
  EXPECT_THAT(problem(kept, 1), HasSubstr("pulled back, it was"));
  EXPECT_THAT(refusal("pose.set", {{"controls", apart}, {"beyond", 1}}), HasSubstr("beyond"));
}

TEST_F(StudioTest, KeysAreKeptPlayedAndExported) {
  open(true);
  const int lip = place("lip-lower");
  const auto basis = animate::TakeBasis::open(take_);
  const Eigen::Vector3f to = test::captured(*basis, 30).col(lip);
  ask("keys.save", {{"time_s", 0.0}});
  ask("pose.set", {{"controls", {{{"vertex", lip}, {"at_mm", {to.x(), to.y(), to.z()}}}}}});
  const json saved = ask("keys.save", {{"time_s", 0.4}});
  ASSERT_EQ(saved["keys"]["keys"].size(), 2U) << saved.dump();
  ask("keys.save", {{"time_s", 0.4}});
  EXPECT_EQ(ask("keys.get"), saved) << "a key takes the place of the one at its time";

  ask("studio.play", {{"what", "keys"}});
  const json played = await([](const json& now) {
    return now["shown"] == "keys" && now["state"] == "ready" && now["time_s"].get<double>() > 0.399;
  });
  EXPECT_EQ(played["reason"], "");
  const auto is_open = [&](const mesh::Vertices& made) { return (made.col(lip) - to).norm() < 0.1F; };
  EXPECT_TRUE(seen(is_open)) << "the last key stands";

  ask("keys.export", {{"name", "film"}});
  await([](const json& now) {
    return now["exported"].get<std::string>().find("film.take") != std::string::npos;
  });
  take::TakeReader film(folder_.path() / "film.take");
  ASSERT_EQ(film.frame_count(), 13) << "0.4 s at 30 frames a second, both ends";
  EXPECT_TRUE(is_open(test::finest_of(*film.frame(12))));
  EXPECT_THAT(refusal("keys.export", {{"name", "film"}}), HasSubstr("film"));

  // They are there again when the take is opened again.
  open(false);
  open(true);
  EXPECT_EQ(ask("keys.get"), saved);
  ask("keys.set", {{"keys", nullptr}});
  EXPECT_TRUE(ask("keys.get")["keys"].is_null());
}

/// Bridges send what the studio shows: the values belong to the face.
TEST_F(StudioTest, ShownFacesHaveTheirExpressions) {
  open(true);
  take::TakeReader reader(take_);
  for (const int number : {12, 30, 47}) {
    ask("keys.set", {{"keys", {{"keys", {{{"time_s", 0}, {"frame", number}}}}}}});
    ask("studio.seek", {{"what", "keys"}, {"time_s", 0}});
    await([](const json& now) { return now["shown"] == "keys" && now["state"] == "ready"; });
    const auto captured = reader.frame(number);
    const auto end = std::chrono::steady_clock::now() + kPatience;
    float worst = 1;
    while (worst > 0.02F && std::chrono::steady_clock::now() < end) {
      const auto shown = next();
      ASSERT_NE(shown, nullptr);
      ASSERT_EQ(shown->expression.size(), captured->expression.size());
      worst = 0;
      for (std::size_t e = 0; e < shown->expression.size(); ++e) {
        worst = std::max(worst, std::abs(shown->expression[e] - captured->expression[e]));
      }
    }
    EXPECT_LE(worst, 0.02F) << number;
  }
}

TEST_F(StudioTest, WhatTakesLongCanBeBrokenOff) {
  open(true);
  EXPECT_THAT(refusal("studio.cancel", json::object()), HasSubstr("nothing is being opened, prepared"));
  // Keys of half an hour: more than 64 KiB of them, and an export that takes long.
  json keys = json::array();
  for (int k = 0; k < 1800; ++k) {
    keys.push_back({{"time_s", k}, {"frame", k % 50}});
  }
  const json list = {{"pace", "shortest"}, {"keys", keys}, {"rate_hz", 120}};
  ASSERT_GT(list.dump(1).size(), 60'000U);
  ask("keys.set", {{"keys", list}});
  EXPECT_EQ(ask("keys.get")["keys"]["keys"].size(), 1800U);
  ask("keys.export", {{"name", "long"}});
  await([](const json& now) { return now["state"] == "exporting" && now["done"] > 3; });
  ask("studio.cancel");
  const json status = await([](const json& now) { return is_ready(now); });
  EXPECT_EQ(status["reason"], "broken off");
  EXPECT_FALSE(std::filesystem::exists(folder_.path() / "long.take"));
  EXPECT_EQ(status["exported"], "");
  // It can be done all the same.
  ask("keys.set", {{"keys", {{"keys", {{{"time_s", 0}, {"frame", 1}}, {{"time_s", 0.1}, {"frame", 4}}}}}}});
  ask("keys.export", {{"name", "short"}});
  await([](const json& now) {
    return now["exported"].get<std::string>().find("short.take") != std::string::npos;
  });
}

TEST_F(StudioTest, ReplaysAndScrubs) {
  open(false);
  ask("studio.seek", {{"what", "take"}, {"time_s", 1.0}});
  json status = await([](const json& now) { return now["frame"] == 30; });
  EXPECT_NEAR(status["time_s"].get<double>(), 1.0, 1e-6);
  take::TakeReader reader(take_);
  const mesh::Vertices wanted = test::finest_of(*reader.frame(30));
  EXPECT_TRUE(
      seen([&](const mesh::Vertices& made) { return (made - wanted).cwiseAbs().maxCoeff() < 0.05F; }));
  ask("studio.play", {{"what", "take"}, {"from_s", 1.8}});
  status = await([](const json& now) { return now["state"] == "ready" && now["frame"] == 59; });
  ask("studio.play", {{"what", "take"}, {"from_s", 1.8}, {"loop", true}});
  await([](const json& now) { return now["time_s"].get<double>() < 1.0; });
  ask("studio.pause");
  await([](const json& now) { return now["state"] == "ready"; });
}

TEST_F(StudioTest, TakesGetPictures) {
  Thumbnails thumbnails(folder_.path());
  thumbnails.start();
  std::ofstream(folder_.path() / "broken.take") << "no take";
  EXPECT_FALSE(thumbnails.ask("broken"));
  const auto drawn = [&] {
    std::optional<std::int64_t> stamp;
    const auto end = std::chrono::steady_clock::now() + kPatience;
    while (!(stamp = thumbnails.ask("actor1")) && std::chrono::steady_clock::now() < end) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return stamp;
  };
  ASSERT_TRUE(drawn());
  const render::Picture picture = render::read_image(Thumbnails::file(folder_.path(), "actor1"));
  ASSERT_EQ(picture.width_px, Thumbnails::kWidth_px);
  ASSERT_EQ(picture.height_px, Thumbnails::kHeight_px);
  const auto red_at = [&](int x, int y) {
    return picture.rgb[3 * static_cast<std::size_t>(y * picture.width_px + x)];
  };
  EXPECT_GT(red_at(75, 90), 60) << "a face in the middle";
  EXPECT_LT(red_at(2, 2), 40) << "none in the corner";
  EXPECT_FALSE(thumbnails.ask("broken"));

  // A younger take of the same name gets a picture of its own.
  const auto file = Thumbnails::file(folder_.path(), "actor1");
  std::filesystem::last_write_time(file, std::filesystem::last_write_time(take_) - std::chrono::hours(1));
  ASSERT_TRUE(drawn());
  EXPECT_GE(std::filesystem::last_write_time(file), std::filesystem::last_write_time(take_));
}

TEST_F(StudioTest, LetsGoWhenNobodyWantsAnythingOfIt) {
  open(false);
  EXPECT_EQ(ask("studio.status")["lease_s"], 300);
  EXPECT_EQ(next()->origin, mesh::Origin::Take);
  constexpr std::chrono::seconds kLease{2};
  ASSERT_TRUE(ask("studio.open", {{"take", "actor1"}, {"pose", true}, {"lease_s", kLease.count()}}).empty());
  await([](const json& now) { return is_ready(now) && now["posing"] == true; });
  const auto begun = std::chrono::steady_clock::now();
  auto last = begun;
  auto longest = std::chrono::steady_clock::duration::zero();
  while (last < begun + 2 * kLease) {
    const json answer = ask("studio.keep");
    const auto now = std::chrono::steady_clock::now();
    longest = std::max(longest, now - last);
    last = now;
    if (!answer.empty() && longest >= kLease / 2) {
      GTEST_SKIP() << "the machine is too busy to ask twice within a second";
    }
    ASSERT_TRUE(answer.empty()) << answer;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  EXPECT_EQ(ask("studio.status")["take"], "actor1");
  EXPECT_TRUE(held_);
  const json left = await([](const json& now) { return now["state"] == "closed"; });
  EXPECT_THAT(left["reason"].get<std::string>(), HasSubstr("the live face is back"));
  EXPECT_FALSE(held_);
  EXPECT_THAT(refusal("studio.keep", json::object()), HasSubstr("no take is open"));
  EXPECT_THAT(refusal("studio.open", {{"take", "actor1"}, {"lease_s", -1}}), HasSubstr("lease_s"));
}

TEST_F(StudioTest, BrokenKeysAreSetAsideAndTheTakeIsOpen) {
  const std::filesystem::path keys = folder_.path() / "actor1.keys.json";
  std::ofstream(keys) << "";  // as a power cut leaves it
  ask("studio.open", {{"take", "actor1"}});
  const json status = await([](const json& now) { return is_ready(now) && now["reason"] != ""; });
  EXPECT_THAT(status["reason"].get<std::string>(), HasSubstr(keys.string() + ".broken-1"));
  EXPECT_FALSE(std::filesystem::exists(keys));
  ask("keys.set", {{"keys", {{"keys", {{{"time_s", 0}, {"frame", 1}}}}}}});
  EXPECT_TRUE(std::filesystem::exists(keys));
}

TEST_F(StudioTest, ATakeThatChangesIsClosed) {
  open(true);
  std::ofstream(take_, std::ios::app | std::ios::binary) << "more";
  const json status = await([](const json& now) { return now["state"] == "closed"; });
  EXPECT_THAT(status["reason"].get<std::string>(), HasSubstr("changed while it was open"));
  EXPECT_FALSE(held_);
  EXPECT_THAT(refusal("pose.set", {{"controls", json::array()}}), HasSubstr("no take is open"));
}

/// The depth is refused before anything is copied or written: its cost would be the depth times the length.
TEST_F(StudioTest, BracketsWithoutEndAreRefusedByEveryMethod) {
  open(false);
  for (const std::size_t bytes : {20'000U, 80'000U, 600'000U, 1'000'000U}) {
    const std::string deep = std::string(bytes / 2, '[') + std::string(bytes / 2, ']');
    for (const auto& [name, method] : methods_) {
      std::vector<std::string> all_params{deep};
      for (const ControlParam& param : method.params) {
        all_params.push_back(fmt::format(R"({{"{}":{}}})", param.name, deep));
        all_params.push_back(fmt::format(R"({{"{}":{{"keys":{}}}}})", param.name, deep));
      }
      for (const std::string& params : all_params) {
        const std::string line =
            fmt::format(R"({{"jsonrpc":"2.0","method":"{}","params":{},"id":1}})", name, params);
        const json answer = json::parse(answer_request(methods_, line, {1, 1000, true}));
        EXPECT_EQ(answer["error"]["code"], kParseError) << name << ", " << bytes << " bytes";
      }
    }
  }
  EXPECT_TRUE(ask("keys.get")["keys"].is_null());
}

}  // namespace
}  // namespace facet::service
