#include "service/value_methods.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "facet/error.hpp"
#include "mesh/arkit.hpp"
#include "service/settings.hpp"
#include "service/status_report.hpp"

namespace facet::service {

using nlohmann::json;

namespace {

/// Takes over what params has of a tuning.
void change(avatar::ValueTuning& tuning, const json& params) {
  bool changes = false;
  for (const Setting<avatar::ValueTuning>& setting : kValueTuningSettings) {
    const auto given = params.find(setting.key);
    if (given == params.end()) {
      continue;
    }
    const double number = *given;
    if (!(number >= setting.least && number <= setting.most)) {
      throw Error(ErrorKind::Usage,
                  fmt::format("{} must be from {} to {}", setting.key, setting.least, setting.most));
    }
    std::get<Setting<avatar::ValueTuning>::At<double>>(setting.place)(tuning) = number;
    changes = true;
  }
  if (!changes) {
    throw Error(ErrorKind::Usage, "there is nothing to set: give gain, dead_zone or smoothing_ms");
  }
}

json set(avatar::Bridge& bridge, const json& params) {
  const std::string name = params.at("name");
  const bool all = name == avatar::kAllValues;
  const int index = mesh::arkit_index(name);
  if (!all && index < 0) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' is none of ARKit's values (jawOpen, eyeBlinkLeft ...), nor \"{}\"", name,
                            avatar::kAllValues));
  }
  const auto place = static_cast<std::size_t>(index);
  avatar::ValueTunings values = bridge.status().values;
  avatar::ValueTuning tuning = all ? values.all : values.of(place);
  change(tuning, params);
  (all ? values.all : values.named[place]) = tuning;
  bridge.tune(values);
  json answer = to_json(tuning);
  answer["name"] = all ? name : mesh::arkit_name(place);
  return answer;
}

}  // namespace

ControlMethods value_methods(avatar::Bridge& bridge, const avatar::ValueTunings& configured) {
  std::vector<ControlParam> params = {{"name", ControlParam::Type::Text, true}};
  for (const Setting<avatar::ValueTuning>& setting : kValueTuningSettings) {
    params.push_back({setting.key, ControlParam::Type::Number});
  }
  return {
      {"values.set", {true, std::move(params), [&bridge](const json& given) { return set(bridge, given); }}},
      {"values.reset", {true, {}, [&bridge, configured](const json&) {
                          bridge.tune(configured);
                          return json::object();
                        }}}};
}

}  // namespace facet::service
