#include "service/studio_methods.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "stream/base64.hpp"

namespace facet::service {
namespace {

using nlohmann::json;

/// Of a time in a take or an animation.
constexpr double kLatest_s = animate::kLongest_s;

/// Control points as a key of a keys file has them: one grammar, checked in one place.
animate::KeyList as_key(const std::string& method, const json& controls, const json& params) {
  json root = {{"keys", {{{"time_s", 0}, {"controls", controls}}}}};
  for (const char* name : {"whole", "beyond"}) {
    if (params.contains(name)) {
      root[name] = params[name];
    }
  }
  return animate::keys_of(root, method);
}

json number_of_event(std::uint64_t event) {
  return {{"event", event}};
}

double time_of(const json& params, const char* name, double otherwise) {
  const double time_s = params.contains(name) ? params.at(name).get<double>() : otherwise;
  if (!(time_s >= 0 && time_s <= kLatest_s)) {
    throw Error(ErrorKind::Usage, fmt::format("{} must be from 0 to {}", name, kLatest_s));
  }
  return time_s;
}

std::chrono::seconds lease_of(const json& params) {
  constexpr double kLongest_s = 86'400;
  const double seconds =
      params.contains("lease_s") ? params.at("lease_s").get<double>() : studio::Studio::kLease.count();
  if (!(seconds >= 0 && seconds <= kLongest_s)) {
    throw Error(ErrorKind::Usage,
                fmt::format("lease_s must be from 0 (until it is closed) to {}", kLongest_s));
  }
  return std::chrono::seconds(std::llround(std::ceil(seconds)));
}

studio::Shown shown_of(const json& params) {
  const std::string what = params.value("what", "take");
  if (what != "take" && what != "keys") {
    throw Error(ErrorKind::Usage, "what must be \"take\" or \"keys\"");
  }
  return what == "take" ? studio::Shown::Take : studio::Shown::Keys;
}

std::string vertex_of(const json& vertex) {
  if (!vertex.is_number_integer() && !vertex.is_string()) {
    throw Error(ErrorKind::Usage, "vertex must be a whole number or the name of a place");
  }
  return vertex.is_string() ? vertex.get<std::string>() : vertex.dump();
}

/// text: keys that are JSON, on as many lines as whoever wrote them liked; an answer is one line.
std::string keys_text(std::string text) {
  std::replace_if(
      text.begin(), text.end(), [](char c) { return c == '\n' || c == '\r'; }, ' ');
  return R"({"keys":)" + (text.empty() ? "null" : text) + "}";
}

json times_json(const studio::StudioTimes& times) {
  return {{"mean", times.mean}, {"p95", times.p95}, {"most", times.most}};
}

/// Why a control point is not where it shall be, or should not be there; "" where all is well.
std::string problem_of(const animate::ControlTarget& target, const animate::ControlOutcome& outcome,
                       bool on_boundary) {
  const char* unit = target.space == animate::ControlTarget::Space::Screen ? "px" : "mm";
  std::vector<std::string> problems;
  if (!outcome.met) {
    problems.push_back(fmt::format("missed by {:.2f} {}: {}", outcome.miss, unit,
                                   on_boundary
                                       ? "it is on the open edge of the mesh, where the take moves nothing"
                                       : "the take does not move it so, or other control points hold it"));
  } else if (outcome.outside > animate::kOutsideTolerance) {
    problems.push_back(fmt::format("{} {:.1f} {} outside what was captured{}",
                                   outcome.clamped ? "pulled back, it was" : "it is", outcome.outside, unit,
                                   on_boundary ? ": it is on the open edge of the mesh" : ""));
  }
  if (outcome.nearest_mm > animate::kFarFromCaptured_mm) {
    problems.push_back(fmt::format(
        "{:.1f} mm from the nearest captured face: it may be no face of this person", outcome.nearest_mm));
  }
  return fmt::format("{}", fmt::join(problems, "; "));
}

json controls_json(const studio::StudioStatus& status) {
  json controls = json::array();
  for (std::size_t i = 0; i < status.targets.size(); ++i) {
    const animate::ControlTarget& target = status.targets[i];
    const animate::ControlOutcome& outcome = status.outcomes[i];
    const bool on_screen = target.space == animate::ControlTarget::Space::Screen;
    json at = {target.target.x(), target.target.y()};
    if (!on_screen) {
      at.push_back(target.target.z());
    }
    controls.push_back({{"vertex", target.vertex},
                        {on_screen ? "at_px" : "at_mm", std::move(at)},
                        {"met", outcome.met},
                        {"miss", outcome.miss},
                        {"outside", outcome.outside},
                        {"clamped", outcome.clamped},
                        {"boundary", status.on_boundary[i] != 0},
                        {"nearest_mm", outcome.nearest_mm},
                        {"problem", problem_of(target, outcome, status.on_boundary[i] != 0)}});
  }
  return controls;
}

/// studio.*: a take is opened, shown and closed.
ControlMethods take_methods(studio::Studio& studio, Errands& errands) {
  using Type = ControlParam::Type;
  return {
      {"studio.open",
       {true,
        {{"take", Type::Text, true}, {"pose", Type::Flag}, {"lease_s", Type::Number}},
        [&studio, &errands](const json& params) {
          return ControlAnswer(errands, [&studio, take = params.at("take").get<std::string>(),
                                         pose = params.value("pose", true), lease = lease_of(params)] {
            studio.open(take, pose, lease);
            return std::string("{}");
          });
        }}},
      {"studio.close",
       {true,
        {},
        [&studio](const json&) {
          studio.close();
          return json::object();
        }}},
      {"studio.keep",
       {true,
        {},
        [&studio](const json&) {
          studio.keep();
          return json::object();
        }}},
      {"studio.status", {false, {}, [&studio](const json&) { return to_json(studio.status()); }}},
      {"studio.play",
       {true,
        {{"what", Type::Text}, {"from_s", Type::Number}, {"loop", Type::Flag}},
        [&studio](const json& params) {
          studio.play(shown_of(params), time_of(params, "from_s", 0), params.value("loop", false));
          return json::object();
        }}},
      {"studio.seek",
       {true,
        {{"what", Type::Text}, {"time_s", Type::Number}},
        [&studio](const json& params) {
          studio.seek(shown_of(params), time_of(params, "time_s", 0));
          return json::object();
        }}},
      {"studio.pause",
       {true,
        {},
        [&studio](const json&) {
          studio.pause();
          return json::object();
        }}},
      {"studio.cancel",
       {true,
        {},
        [&studio](const json&) {
          studio.cancel();
          return json::object();
        }}},
  };
}

/// pose.*: control points.
ControlMethods pose_methods(studio::Studio& studio, Errands& errands) {
  using Type = ControlParam::Type;
  return {
      {"pose.set",
       {true,
        {{"controls", Type::Any, true}, {"whole"}, {"beyond"}},
        [&studio](const json& params) {
          const animate::KeyList list = as_key("pose.set", params.at("controls"), params);
          return number_of_event(studio.set_controls(list.keys.front().controls, list.whole, list.beyond));
        }}},
      {"pose.move",
       {true,
        {{"vertex"}, {"at_mm"}, {"move_mm"}, {"at_px"}},
        [&studio](const json& params) {
          const animate::KeyList list = as_key("pose.move", json::array({params}), {});
          return number_of_event(studio.move_control(list.keys.front().controls.front()));
        }}},
      {"pose.remove",
       {true,
        {{"vertex", Type::Any, true}},
        [&studio](const json& params) {
          return number_of_event(studio.remove_control(vertex_of(params.at("vertex"))));
        }}},
      {"pose.regions",
       {false,
        {},
        [&studio, &errands](const json&) {
          return ControlAnswer(errands, [&studio] {
            const studio::RegionColours regions = studio.regions();
            return to_text({{"vertices", regions.vertices},
                            {"colours", regions.colours},
                            {"rgb", stream::base64(regions.rgb)}});
          });
        }}},
  };
}

/// keys.*: the animation's key frames.
ControlMethods key_methods(studio::Studio& studio, Errands& errands) {
  using Type = ControlParam::Type;
  return {
      {"keys.get",
       {false,
        {},
        [&studio, &errands](const json&) {
          return ControlAnswer(errands, [&studio] { return keys_text(studio.keys()); });
        }}},
      {"keys.set",
       {true,
        {{"keys", Type::Any, true}},
        [&studio, &errands](const json& params) {
          return ControlAnswer(errands, [&studio, keys = params.at("keys")] {
            if (!keys.is_null()) {
              animate::keys_of(keys, "keys");  // before anything is made of it
            }
            studio.set_keys(keys.is_null() ? "" : to_text(keys));
            return std::string("{}");
          });
        }}},
      {"keys.save",
       {true,
        {{"time_s", Type::Number}},
        [&studio, &errands](const json& params) {
          return ControlAnswer(errands, [&studio, time_s = time_of(params, "time_s", -1)] {
            return keys_text(studio.save_key(time_s));
          });
        }}},
      {"keys.export",
       {true,
        {{"name", Type::Text, true}},
        [&studio, &errands](const json& params) {
          return ControlAnswer(errands, [&studio, name = params.at("name").get<std::string>()] {
            return to_text({{"file", studio.export_keys(name).string()}});
          });
        }}},
  };
}

}  // namespace

json to_json(const studio::StudioStatus& status) {
  json places = json::object();
  for (const auto& [name, vertex] : status.places) {
    places[name] = vertex;
  }
  return {{"state", to_string(status.state)},
          {"take", status.take},
          {"reason", status.reason},
          {"done", status.done},
          {"total", status.total},
          {"posing", status.posing},
          {"shown", to_string(status.shown)},
          {"time_s", status.time_s},
          {"duration_s", status.duration_s},
          {"lease_s", status.lease.count()},
          {"frame", status.frame},
          {"events", status.events},
          {"superseded", status.superseded},
          {"solved", status.solved},
          {"latency_ms", times_json(status.latency)},
          {"work_ms", times_json(status.work)},
          {"controls", controls_json(status)},
          {"places", std::move(places)},
          {"warnings", status.warnings},
          {"exported", status.exported.string()}};
}

ControlMethods studio_methods(studio::Studio& studio, Errands& errands) {
  ControlMethods all = take_methods(studio, errands);
  all.merge(pose_methods(studio, errands));
  all.merge(key_methods(studio, errands));
  return all;
}

}  // namespace facet::service
