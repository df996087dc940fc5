#include "service/value_methods.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "avatar/mapping_file.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "mesh/arkit.hpp"
#include "service/errands.hpp"
#include "service/status_report.hpp"

namespace facet::service {

using nlohmann::json;

namespace {

/// Takes over what params has of a tuning.
void change(avatar::ValueTuning& tuning, const json& params) {
  bool changes = false;
  for (const Setting<avatar::ValueTuning>& setting : avatar::kValueTuningSettings) {
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

json tune(avatar::Bridge& bridge, const json& params) {
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

/// What values.reset and mapping.reset go back to.
struct Kept {
  Mutex mutex;
  avatar::ValueMapping mapping FACET_GUARDED_BY(mutex);  ///< as it was read or saved last, with its values
};

avatar::ValueMapping kept_now(Kept& kept) {
  const Lock lock(kept.mutex);
  return kept.mapping;
}

const avatar::MappingTable& table_of(const json& params) {
  const std::string name = params.at("table");
  const auto* found = std::find_if(avatar::kMappingTables.begin(), avatar::kMappingTables.end(),
                                   [&](const avatar::MappingTable& table) { return table.name == name; });
  if (found == avatar::kMappingTables.end()) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' is no table of a mapping: vmc, vrchat or vtube_studio", name));
  }
  return *found;
}

avatar::MappedValues::iterator find(avatar::MappedValues& values, const std::string& name) {
  return std::find_if(values.begin(), values.end(),
                      [&](const avatar::MappedValue& value) { return value.name == name; });
}

json map(avatar::Bridge& bridge, const json& params) {
  const avatar::MappingTable& table = table_of(params);
  const std::string name = params.at("name");
  if (const std::string fault = avatar::name_fault(table, name); !fault.empty()) {
    throw Error(ErrorKind::Usage, fmt::format("'{}' {}", name, fault));
  }
  const std::string text = params.at("formula");
  avatar::ValueMapping mapping = bridge.mapping();
  avatar::MappedValues& values = mapping.*table.values;
  const auto place = find(values, name);
  if (place != values.end()) {
    place->formula = avatar::Formula(text);
  } else if (values.size() == avatar::kMostMappedValues) {
    throw Error(ErrorKind::Usage, fmt::format("there are {} names already, the most", values.size()));
  } else {
    values.push_back({name, avatar::Formula(text)});
  }
  bridge.map(mapping);
  return {{"table", table.name}, {"name", name}, {"formula", text}};
}

json unmap(avatar::Bridge& bridge, const json& params) {
  const avatar::MappingTable& table = table_of(params);
  const std::string name = params.at("name");
  avatar::ValueMapping mapping = bridge.mapping();
  avatar::MappedValues& values = mapping.*table.values;
  const auto place = find(values, name);
  if (place == values.end()) {
    throw Error(ErrorKind::Usage, fmt::format("{} has no formula for '{}'", table.name, name));
  }
  values.erase(place);
  bridge.map(mapping);
  return json::object();
}

json mapping_now(const avatar::Bridge& bridge, Kept& kept, const std::filesystem::path& file) {
  const avatar::ValueMapping mapping = bridge.mapping();
  json answer = {{"file", file.empty() ? json(nullptr) : json(file.string())},
                 {"saved", mapping == kept_now(kept)}};
  for (const avatar::MappingTable& table : avatar::kMappingTables) {
    json& rows = answer[table.name] = json::array();
    for (const avatar::MappedValue& value : mapping.*table.values) {
      rows.push_back({{"name", value.name}, {"formula", value.formula.text()}});
    }
  }
  return answer;
}

json mapped_values_now(const avatar::Bridge& bridge) {
  const avatar::ValueMapping mapping = bridge.mapping();
  const mesh::ArkitValues values = bridge.sent_values();
  json answer;
  for (const avatar::MappingTable& table : avatar::kMappingTables) {
    json& numbers = answer[table.name] = json::object();
    for (const avatar::MappedValue& value : mapping.*table.values) {
      numbers[value.name] = std::clamp(value.formula.of(values), table.least, table.most);
    }
  }
  return answer;
}

ControlAnswer save(const avatar::Bridge& bridge, const std::shared_ptr<Kept>& kept,
                   const std::filesystem::path& file, Errands& writer) {
  if (file.empty()) {
    throw Error(ErrorKind::Usage,
                "no mapping file is configured: name one that facetd may write, [bridges] mapping = "
                "\"/var/lib/facet/avatar.toml\", and start facetd anew");
  }
  return {writer, [mapping = bridge.mapping(), kept, file] {
            avatar::save_mapping(mapping, file);
            const Lock lock(kept->mutex);
            kept->mapping = mapping;
            return to_text({{"file", file.string()}});
          }};
}

}  // namespace

ControlMethods value_methods(avatar::Bridge& bridge, const avatar::BridgeConfig& config, Errands& writer) {
  const auto kept = std::make_shared<Kept>();
  {
    const Lock lock(kept->mutex);
    kept->mapping = bridge.mapping();
  }
  std::vector<ControlParam> tuning = {{"name", ControlParam::Type::Text, true}};
  for (const Setting<avatar::ValueTuning>& setting : avatar::kValueTuningSettings) {
    tuning.push_back({setting.key, ControlParam::Type::Number});
  }
  const std::vector<ControlParam> place = {{"table", ControlParam::Type::Text, true},
                                           {"name", ControlParam::Type::Text, true}};
  std::vector<ControlParam> formula = place;
  formula.push_back({"formula", ControlParam::Type::Text, true});
  return {
      {"values.set", {true, std::move(tuning), [&bridge](const json& given) { return tune(bridge, given); }}},
      {"values.reset",
       {true,
        {},
        [&bridge, kept](const json&) {
          bridge.tune(*kept_now(*kept).values);
          return json::object();
        }}},
      {"mapping.get",
       {false,
        {},
        [&bridge, kept, file = config.mapping_file](const json&) {
          return mapping_now(bridge, *kept, file);
        }}},
      {"mapping.values", {false, {}, [&bridge](const json&) { return mapped_values_now(bridge); }}},
      {"mapping.set",
       {true, std::move(formula), [&bridge](const json& given) { return map(bridge, given); }}},
      {"mapping.unset", {true, place, [&bridge](const json& given) { return unmap(bridge, given); }}},
      {"mapping.save",
       {true,
        {},
        [&bridge, kept, file = config.mapping_file, &writer](const json&) {
          return save(bridge, kept, file, writer);
        }}},
      {"mapping.reset", {true, {}, [&bridge, kept](const json&) {
                           bridge.map(kept_now(*kept));
                           return json::object();
                         }}}};
}

}  // namespace facet::service
