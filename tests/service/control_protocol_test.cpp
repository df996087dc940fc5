#include "service/control_protocol.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "facet/error.hpp"

namespace facet::service {
namespace {

using nlohmann::json;

const Caller kMember{1, 1000, true};
const Caller kStranger{1, 1001, false};

class ControlProtocol : public ::testing::Test {
 protected:
  json ask(const std::string& line, const Caller& caller = kMember) const {
    const std::string answer = answer_request(methods_, line, caller);
    return answer.empty() ? json() : json::parse(answer);
  }
  int error_code(const std::string& line, const Caller& caller = kMember) const {
    const json answer = ask(line, caller);
    return answer.contains("error") ? answer["error"]["code"].get<int>() : 0;
  }

  int calls_ = 0;
  ControlMethods methods_ = {
      {"look",
       {false,
        {},
        [](const json&) {
          return json{{"seen", 1}};
        }}},
      {"change",
       {true,
        {{"name", ControlParam::Type::Text, true},
         {"rate", ControlParam::Type::Number},
         {"loop", ControlParam::Type::Flag},
         {"any"}},
        [this](const json& params) {
          ++calls_;
          return json(params.at("name").get<std::string>());
        }}},
      {"full", {true, {}, [](const json&) -> json { throw Error(ErrorKind::Storage, "disk full"); }}},
      {"odd", {false, {}, [](const json&) { return json("\xff path"); }}},
  };
};

TEST_F(ControlProtocol, AnswersWithTheIdOfTheRequest) {
  const json answer = ask(R"({"jsonrpc":"2.0","method":"look","id":7})");
  EXPECT_EQ(answer, json::parse(R"({"jsonrpc":"2.0","result":{"seen":1},"id":7})"));
  EXPECT_EQ(ask(R"({"jsonrpc":"2.0","method":"look","id":"a"})")["id"], "a");
  EXPECT_EQ(ask(R"({"jsonrpc":"2.0","method":"change","params":{"name":"x"},"id":1})")["result"], "x");
}

TEST_F(ControlProtocol, NotificationsGetNoAnswer) {
  EXPECT_TRUE(ask(R"({"jsonrpc":"2.0","method":"change","params":{"name":"x"}})").is_null());
  EXPECT_EQ(calls_, 1);
  EXPECT_TRUE(ask(R"({"jsonrpc":"2.0","method":"full"})").is_null());
}

TEST_F(ControlProtocol, ErrorsHaveTheCodesOfTheStandard) {
  EXPECT_EQ(error_code("{"), kParseError);
  EXPECT_EQ(error_code("\xff"), kParseError);
  EXPECT_EQ(error_code("3"), kInvalidRequest);
  EXPECT_EQ(error_code(R"({"method":"look","id":1})"), kInvalidRequest);
  EXPECT_EQ(error_code(R"({"jsonrpc":"1.0","method":"look","id":1})"), kInvalidRequest);
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":3,"id":1})"), kInvalidRequest);
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"look","id":[1]})"), kInvalidRequest);
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"look","extra":1,"id":1})"), kInvalidRequest);
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"none","id":1})"), kMethodNotFound);
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"look","params":[1],"id":1})"), kInvalidParams);
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"look","params":{"a":1},"id":1})"), kInvalidParams);
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"change","id":1})"), kInvalidParams);
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"change","params":{"name":3},"id":1})"), kInvalidParams);
}

TEST_F(ControlProtocol, ParamsOfTheWrongTypeAreNamed) {
  const auto message = [&](const json& params) {
    const json answer =
        ask(json{{"jsonrpc", "2.0"}, {"method", "change"}, {"params", params}, {"id", 1}}.dump());
    return answer.contains("error") ? answer["error"]["message"] : answer["result"];
  };
  EXPECT_EQ(message({{"name", 5}}), "name must be a string");
  EXPECT_EQ(message({{"name", nullptr}}), "name must be a string");
  EXPECT_EQ(message({{"name", "x"}, {"rate", "fast"}}), "rate must be a number");
  EXPECT_EQ(message({{"name", "x"}, {"loop", 1}}), "loop must be true or false");
  EXPECT_EQ(message({{"rate", 1}}), "name is missing");
  EXPECT_EQ(message({{"name", "x"}, {"speed", 1}}), "unknown param; there are: name, rate, loop, any");
  EXPECT_EQ(calls_, 0);
  EXPECT_EQ(message({{"name", "x"}, {"rate", 1.5}, {"loop", true}, {"any", json::array()}}), "x");
}

TEST_F(ControlProtocol, OurErrorsKeepTheirKind) {
  const json answer = ask(R"({"jsonrpc":"2.0","method":"full","id":1})");
  EXPECT_EQ(answer["error"]["code"], -32006);
  EXPECT_EQ(answer["error"]["message"], "disk full");
}

TEST_F(ControlProtocol, StrangersMayLookButNotChange) {
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"look","id":1})", kStranger), 0);
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"change","params":{"name":"x"},"id":1})", kStranger),
            kPermissionDenied);
  EXPECT_EQ(calls_, 0);
}

TEST_F(ControlProtocol, Batches) {
  const json answer = ask(
      R"([{"jsonrpc":"2.0","method":"look","id":1},{"jsonrpc":"2.0","method":"look"},{"jsonrpc":"2.0","method":"none","id":2},7])");
  ASSERT_EQ(answer.size(), 3U);
  EXPECT_EQ(answer[0]["id"], 1);
  EXPECT_EQ(answer[1]["error"]["code"], kMethodNotFound);
  EXPECT_EQ(answer[2]["error"]["code"], kInvalidRequest);
  EXPECT_EQ(error_code("[]"), kInvalidRequest);
  json many = json::array();
  for (std::size_t i = 0; i <= kMaxBatch; ++i) {
    many.push_back({{"jsonrpc", "2.0"}, {"method", "look"}, {"id", i}});
  }
  EXPECT_EQ(error_code(many.dump()), kInvalidRequest);
}

TEST_F(ControlProtocol, AnswersAreValidJsonWhateverTheNames) {
  const json answer = ask(R"({"jsonrpc":"2.0","method":"odd","id":1})");
  EXPECT_EQ(answer["result"], "\xEF\xBF\xBD path");
}

TEST_F(ControlProtocol, ALineMayHoldSoManyValues) {
  std::string list = "0";
  for (int i = 0; i < 300'000; ++i) {
    list += ",[]";
  }
  EXPECT_EQ(error_code(R"({"jsonrpc":"2.0","method":"change","params":{"name":"x","any":[)" + list + "]}}"),
            kParseError);
  EXPECT_EQ(calls_, 0);
}

TEST_F(ControlProtocol, DeepNestingIsHarmless) {
  EXPECT_EQ(error_code(std::string(kMaxRequestBytes, '[')), kParseError);
  const std::string deep = std::string(300'000, '[') + std::string(300'000, ']');
  EXPECT_EQ(error_code(deep), kParseError);
  for (const auto& [name, method] : methods_) {
    for (const char* place : {"params", "id", "method", "jsonrpc", "other"}) {
      const std::string request =
          fmt::format(R"({{"jsonrpc":"2.0","method":"{}","{}":{},"id":1}})", name, place, deep);
      EXPECT_EQ(error_code(request, kStranger), kParseError) << name << ", " << place;
      EXPECT_EQ(error_code("[" + request + "]"), kParseError) << name << ", " << place;
    }
    EXPECT_EQ(
        error_code(fmt::format(R"({{"jsonrpc":"2.0","method":"{}","params":{{"any":{}}}}})", name, deep)),
        kParseError);
  }
  EXPECT_EQ(calls_, 0);
}

}  // namespace
}  // namespace facet::service
