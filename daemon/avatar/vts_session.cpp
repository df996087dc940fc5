#include "avatar/vts_session.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>
#include <utility>

#include "avatar/sent_values.hpp"
#include "facet/error.hpp"
#include "facet/printable.hpp"
#include "files/json_text.hpp"

namespace facet::avatar {
namespace {

using nlohmann::json;

constexpr const char* kPluginName = "Facet";
constexpr const char* kDeveloper = "Facet";
constexpr const char* kTokenId = "token";
constexpr const char* kFrameId = "frame";
constexpr std::string_view kCustomId = "create-";
constexpr float kMostValue = 1e6F;

/// Numbers of VTube Studio's errors (its ErrorID.cs) that mean more than that something went wrong.
enum VtsError : int {
  NeedsAuthentication = 8,
  TokenDenied = 50,
  CustomOfOtherPlugin = 352,
};

/// Those that are its own, with which nothing has to be created.
constexpr std::array kHeadParameters = {"FaceAngleX",    "FaceAngleY",    "FaceAngleZ",
                                        "FacePositionX", "FacePositionY", "FacePositionZ"};

bool is_own(const std::string& id) {
  static const MappedValues own = vts_values();
  return std::find(kHeadParameters.begin(), kHeadParameters.end(), id) != kHeadParameters.end() ||
         std::any_of(own.begin(), own.end(), [&](const MappedValue& value) { return value.name == id; });
}

std::string request(const char* type, const std::string& id, json data) {
  return json{{"apiName", "VTubeStudioPublicAPI"},
              {"apiVersion", "1.0"},
              {"requestID", id},
              {"messageType", type},
              {"data", std::move(data)}}
      .dump();
}

std::string create_request(const std::string& id) {
  const bool is_arkit = mesh::arkit_index(id) >= 0;
  return request(
      "ParameterCreationRequest", std::string(kCustomId) + id,
      {{"parameterName", id},
       {"explanation", is_arkit ? "Facet: ARKit's value of this name" : "Facet: of its mapping file"},
       {"min", 0},
       {"max", 1},
       {"defaultValue", 0}});
}

}  // namespace

VtsParameters vts_parameters(const FaceState& state, const MappedValues& chosen, bool arkit) {
  VtsParameters out;
  if (!state.tracked || !state.has_expression) {
    return out;
  }
  constexpr float kDegreesPerRadian = 57.29578F;
  constexpr float kCentimetres = 100;
  const std::array<float, 9> turns =
      mesh::live_link_rotations(state.values, state.upright_from_head.linear());
  const Eigen::Vector3f place = kCentimetres * state.upright_from_head.translation();
  out = {{"FaceAngleX", -kDegreesPerRadian * turns[0]},
         {"FaceAngleY", -kDegreesPerRadian * turns[1]},
         {"FaceAngleZ", kDegreesPerRadian * turns[2]},
         {"FacePositionX", place.x()},
         {"FacePositionY", place.y()},
         {"FacePositionZ", -place.z()}};
  static const MappedValues own = vts_values();
  for (const MappedValue& value : replaced(own, chosen)) {
    out.push_back({value.name, std::clamp(value.formula.of(state.values), -kMostValue, kMostValue)});
  }
  for (std::size_t i = 0; arkit && i < state.values.size(); ++i) {
    const std::string name(mesh::kArkitNames.at(i));
    if (std::none_of(out.begin(), out.end(), [&](const VtsParameter& other) { return other.id == name; })) {
      out.push_back({name, state.values.at(i)});
    }
  }
  return out;
}

std::string VtsSession::begin() {
  unanswered_ = 0;
  customs_.clear();
  trouble_.clear();
  custom_trouble_.clear();
  return token_.empty() ? ask_for_token() : show_token();
}

std::string VtsSession::ask_for_token() {
  state_ = State::Asking;
  trouble_ = "waits for permission: allow Facet in VTube Studio's window";
  return request("AuthenticationTokenRequest", kTokenId,
                 {{"pluginName", kPluginName}, {"pluginDeveloper", kDeveloper}});
}

std::string VtsSession::show_token() {
  state_ = State::Authenticating;
  trouble_.clear();
  return request(
      "AuthenticationRequest", kTokenId,
      {{"pluginName", kPluginName}, {"pluginDeveloper", kDeveloper}, {"authenticationToken", token_}});
}

void VtsSession::end(std::string why) {
  state_ = State::Over;
  trouble_ = std::move(why);
}

std::vector<std::string> VtsSession::take(std::string_view message) {
  heard_ = true;
  json text;
  std::string type;
  std::string id;
  json data = json::object();
  try {
    text = files::parse_json(message, {kMostMessageBytes, 1000, 16}, "VTube Studio's answer");
    type = text.at("messageType").get<std::string>();
    id = text.value("requestID", "");
    if (text.contains("data") && text["data"].is_object()) {
      data = text["data"];
    }
    if (type == "APIError") {
      take_error(id, data.value("errorID", 0), printable(data.value("message", "")));
    } else if (type == "AuthenticationTokenResponse" && state_ == State::Asking) {
      constexpr std::size_t kMostTokenBytes = 256;
      token_ = data.at("authenticationToken").get<std::string>();
      if (token_.empty() || token_.size() > kMostTokenBytes || printable(token_) != token_) {
        token_.clear();
        end("VTube Studio gave a token that is none");
        return {};
      }
      return {show_token()};
    } else if (type == "AuthenticationResponse" && state_ == State::Authenticating) {
      if (data.value("authenticated", false)) {
        state_ = State::Ready;
        trouble_.clear();
        return {};
      }
      token_.clear();  // permission was taken back, or it is another VTube Studio's
      return {ask_for_token()};
    } else if (type == "InjectParameterDataResponse" && unanswered_ > 0) {
      --unanswered_;
      trouble_.clear();
    } else if (type == "ParameterCreationResponse" && id.starts_with(kCustomId)) {
      if (const auto custom = customs_.find(id.substr(kCustomId.size())); custom != customs_.end()) {
        custom->second = Custom::There;
      }
    }
  } catch (const json::exception&) {
    end("answers what is no message of VTube Studio's API");
  } catch (const Error&) {
    end("answers what is no message of VTube Studio's API");
  }
  return {};
}

void VtsSession::take_error(const std::string& id, int number, const std::string& text) {
  constexpr std::size_t kMostShown = 200;
  const std::string what = fmt::format("VTube Studio: {} (error {})", text.substr(0, kMostShown), number);
  if (id.starts_with(kCustomId)) {
    if (const auto custom = customs_.find(id.substr(kCustomId.size())); custom != customs_.end()) {
      // One that another plug-in has made is there all the same.
      custom->second = number == CustomOfOtherPlugin ? Custom::There : Custom::Refused;
      custom_trouble_ = custom->second == Custom::Refused ? what : custom_trouble_;
    }
  } else if (state_ == State::Asking && number == TokenDenied) {
    state_ = State::Refused;
    trouble_ = "permission was refused in VTube Studio; it is asked again when facetd starts anew";
  } else if (state_ != State::Ready) {
    end(what);
  } else if (number == NeedsAuthentication || number == TokenDenied) {
    token_.clear();
    end(what);
  } else {
    unanswered_ -= unanswered_ > 0 && id == kFrameId ? 1 : 0;
    trouble_ = what;
  }
}

std::vector<std::string> VtsSession::inject(const VtsParameters& parameters) {
  std::vector<std::string> out;
  if (state_ != State::Ready || parameters.empty() || unanswered_ >= kMostUnanswered) {
    return out;
  }
  json values = json::array();
  for (const VtsParameter& parameter : parameters) {
    if (!is_own(parameter.id)) {
      const auto [custom, is_new] = customs_.try_emplace(parameter.id, Custom::Asked);
      if (is_new) {
        out.push_back(create_request(parameter.id));
      }
      if (custom->second != Custom::There) {
        continue;
      }
    }
    values.push_back({{"id", parameter.id}, {"value", parameter.value}});
  }
  out.push_back(request("InjectParameterDataRequest", kFrameId,
                        {{"faceFound", true}, {"mode", "set"}, {"parameterValues", std::move(values)}}));
  ++unanswered_;
  return out;
}

}  // namespace facet::avatar
