#include "service/control_protocol.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <exception>
#include <nlohmann/json.hpp>

#include "facet/error.hpp"
#include "files/json_text.hpp"

namespace facet::service {
namespace {

using nlohmann::json;

/// As many values as a line of the densest keys has.
constexpr files::JsonLimits kRequestLimits{kMaxRequestBytes, 250'000};

/// What a request got instead of a result.
struct Refusal {
  int code;
  std::string message;
};

json refusal_json(const Refusal& refusal, const json& id) {
  return {{"jsonrpc", "2.0"}, {"error", {{"code", refusal.code}, {"message", refusal.message}}}, {"id", id}};
}

std::vector<std::string> names_of(const ControlMethods& methods) {
  std::vector<std::string> names;
  for (const auto& [name, method] : methods) {
    names.push_back(name);
  }
  return names;
}

std::vector<std::string> names_of(const std::vector<ControlParam>& params) {
  std::vector<std::string> names;
  names.reserve(params.size());
  for (const ControlParam& param : params) {
    names.push_back(param.name);
  }
  return names;
}

void check_type(const ControlParam& param, const json& value) {
  const auto want = [&](bool good, const char* type) {
    if (!good) {
      throw Refusal{kInvalidParams, fmt::format("{} must be {}", param.name, type)};
    }
  };
  switch (param.type) {
    case ControlParam::Type::Any:
      return;
    case ControlParam::Type::Text:
      return want(value.is_string(), "a string");
    case ControlParam::Type::Number:
      return want(value.is_number(), "a number");
    case ControlParam::Type::Flag:
      return want(value.is_boolean(), "true or false");
  }
}

const ControlMethod& find_method(const ControlMethods& methods, const json& request, const Caller& caller) {
  const auto& name = request.at("method").get_ref<const std::string&>();
  const auto found = methods.find(name);
  if (found == methods.end()) {
    throw Refusal{kMethodNotFound,
                  fmt::format("no such method; there are: {}", fmt::join(names_of(methods), ", "))};
  }
  if (found->second.changes_something && !caller.may_command) {
    throw Refusal{
        kPermissionDenied,
        caller.over_web
            ? fmt::format(
                  "{} needs the token: show it as a second WebSocket protocol, facet.token.TOKEN, beside "
                  "facet (the page's Unlock); it stands in the daemon's file web.token_file",
                  name)
            : fmt::format("user {} may not call {}: only root, the daemon's user and members of the "
                          "control socket's group may",
                          caller.uid, name)};
  }
  return found->second;
}

json params_of(const json& request, const ControlMethod& method) {
  const auto given = request.find("params");
  json params = given != request.end() ? *given : json::object();
  if (!params.is_object()) {
    throw Refusal{kInvalidParams, "params must be an object"};
  }
  for (const auto& item : params.items()) {
    const auto known = std::find_if(method.params.begin(), method.params.end(),
                                    [&](const ControlParam& param) { return param.name == item.key(); });
    if (known == method.params.end()) {
      throw Refusal{kInvalidParams, method.params.empty()
                                        ? std::string("this method takes no params")
                                        : fmt::format("unknown param; there are: {}",
                                                      fmt::join(names_of(method.params), ", "))};
    }
    check_type(*known, item.value());
  }
  for (const ControlParam& param : method.params) {
    if (param.required && !params.contains(param.name)) {
      throw Refusal{kInvalidParams, fmt::format("{} is missing", param.name)};
    }
  }
  return params;
}

/// Calls, and turns what is thrown into what a client is told.
template <typename Call>
auto refusing(const Call& call) {
  try {
    return call();
  } catch (const Error& error) {
    throw Refusal{kServerErrorBase - static_cast<int>(error.kind()), error.what()};
  } catch (const std::exception& error) {
    throw Refusal{kServerErrorBase - static_cast<int>(ErrorKind::Internal), error.what()};
  }
}

/// Throws Refusal where a message is no request of JSON-RPC 2.0.
void check_request(const json& request) {
  if (!request.is_object()) {
    throw Refusal{kInvalidRequest, "a request must be an object"};
  }
  for (const auto& item : request.items()) {
    if (item.key() != "jsonrpc" && item.key() != "method" && item.key() != "params" && item.key() != "id") {
      throw Refusal{kInvalidRequest, "a request has jsonrpc, method, params and id, nothing else"};
    }
  }
  const auto version = request.find("jsonrpc");
  if (version == request.end() || *version != "2.0") {
    throw Refusal{kInvalidRequest, "jsonrpc must be \"2.0\""};
  }
  const auto method = request.find("method");
  if (method == request.end() || !method->is_string()) {
    throw Refusal{kInvalidRequest, "method must be a string"};
  }
  const auto id = request.find("id");
  if (id != request.end() && !id->is_string() && !id->is_number() && !id->is_null()) {
    throw Refusal{kInvalidRequest, "id must be a string, a number or null"};
  }
}

/// result: JSON text.
std::string result_text(const std::string& result, const json& id) {
  std::string text = R"({"id":)" + to_text(id) + R"(,"jsonrpc":"2.0","result":)" + result + "}";
  if (text.size() > kMaxAnswerBytes) {
    return to_text(
        refusal_json({kServerErrorBase - static_cast<int>(ErrorKind::Internal),
                      fmt::format("the answer has {} bytes; {} are allowed", text.size(), kMaxAnswerBytes)},
                     id));
  }
  return text;
}

}  // namespace

std::string to_text(const json& message) {
  return message.dump(-1, ' ', false, json::error_handler_t::replace);
}

ControlExchange::ControlExchange(std::string_view line, const Caller& caller) : caller_(caller) {
  json message;
  try {
    message = files::parse_json(line, kRequestLimits, "the line");
  } catch (const Error& error) {
    text_ = error_response(kParseError, fmt::format("{}; a request is one line", error.what()));
    return;
  }
  if (!message.is_array()) {
    requests_.push_back(std::move(message));
  } else if (message.empty() || message.size() > kMaxBatch) {
    text_ = error_response(kInvalidRequest, fmt::format("a batch has 1 to {} requests", kMaxBatch));
  } else {
    batch_ = true;
    for (json& request : message) {
      requests_.push_back(std::move(request));
    }
  }
}

std::optional<ControlJob> ControlExchange::step(const ControlMethods& methods) {
  const json request = std::move(requests_[next_++]);
  json id = nullptr;
  bool notification = false;
  try {
    check_request(request);
    notification = !request.contains("id");
    id = notification ? json(nullptr) : request.at("id");
    const ControlMethod& method = find_method(methods, request, caller_);
    const json params = params_of(request, method);
    if (notification && !method.changes_something) {
      return std::nullopt;  // nobody would hear what was seen
    }
    ControlAnswer found = refusing([&] { return method.call(params); });
    if (found.errands == nullptr) {
      answer(notification ? std::string() : result_text(to_text(found.result), id));
      return std::nullopt;
    }
    return ControlJob{found.errands, notification, [work = std::move(found.work), id, notification] {
                        try {
                          const std::string result = refusing(work);
                          return notification ? std::string() : result_text(result, id);
                        } catch (const Refusal& refusal) {
                          return notification ? std::string() : to_text(refusal_json(refusal, id));
                        }
                      }};
  } catch (const Refusal& refusal) {
    answer(notification ? std::string() : to_text(refusal_json(refusal, id)));
    return std::nullopt;
  }
}

void ControlExchange::answer(std::string response) {
  if (response.empty()) {
    return;
  }
  if (text_.size() + response.size() > kMaxAnswerBytes) {
    response = error_response(kInvalidRequest,
                              fmt::format("the answers to a batch have {} bytes at most", kMaxAnswerBytes));
    // What is left would only be more of it.
    next_ = requests_.size();
  }
  if (text_.empty() && !batch_) {
    text_ = std::move(response);
    return;
  }
  text_ += text_.empty() ? "[" : ",";
  text_ += response;
}

std::string ControlExchange::response() && {
  if (batch_ && !text_.empty()) {
    text_ += ']';
  }
  return std::move(text_);
}

std::string error_response(int code, const std::string& message) {
  return to_text(refusal_json({code, message}, nullptr));
}

std::string answer_request(const ControlMethods& methods, std::string_view line, const Caller& caller) {
  ControlExchange exchange(line, caller);
  while (!exchange.done()) {
    if (const auto job = exchange.step(methods)) {
      exchange.answer(job->run());
    }
  }
  return std::move(exchange).response();
}

}  // namespace facet::service
