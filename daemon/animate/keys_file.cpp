#include "animate/keys_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>
#include <nlohmann/json.hpp>

#include "animate/influence.hpp"
#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "files/text_file.hpp"

namespace facet::animate {
namespace {

using nlohmann::json;

constexpr double kFarthest = 1e6;  // of any coordinate; FaceIk's own bounds are narrower
constexpr double kFastest_hz = 1000;
constexpr std::size_t kLongestName = 64;

/// The texts and numbers of one file, with messages that say where they stand.
class Reader {
 public:
  explicit Reader(std::string source) : source_(std::move(source)) {}

  [[noreturn]] void fail(const std::string& where, const std::string& what) const {
    throw Error(ErrorKind::Usage, fmt::format("{}: {} {}", source_, where, what));
  }

  /// Refuses names that nobody asks for: a misspelt one would be passed over in silence.
  void check_names(const json& object, const std::string& where,
                   std::initializer_list<const char*> names) const {
    if (!object.is_object()) {
      fail(where, "must be an object {...}");
    }
    for (const auto& [name, value] : object.items()) {
      if (std::none_of(names.begin(), names.end(),
                       [&, &key = name](const char* known) { return key == known; })) {
        fail(where, fmt::format("has '{}', which is not known", name.substr(0, kLongestName)));
      }
    }
  }

  double number(const json& value, const std::string& where, double least, double most) const {
    if (!value.is_number()) {
      fail(where, "must be a number");
    }
    const auto number = value.get<double>();
    if (!(number >= least && number <= most)) {
      fail(where, fmt::format("is {}; it must be from {} to {}", number, least, most));
    }
    return number;
  }

  bool flag(const json& object, const char* name) const {
    if (!object.contains(name)) {
      return false;
    }
    if (!object[name].is_boolean()) {
      fail(name, "must be true or false");
    }
    return object[name].get<bool>();
  }

  /// The number or name of a vertex.
  std::string vertex(const json& value, const std::string& where) const {
    if (value.is_number_unsigned() || value.is_number_integer()) {
      return value.dump();
    }
    if (!value.is_string() || value.get_ref<const std::string&>().size() > kLongestName) {
      fail(where, "must be the number of a vertex or the name of a place");
    }
    return value.get<std::string>();
  }

  const json& list(const json& value, const std::string& where, std::size_t most) const {
    if (!value.is_array() || value.size() > most) {
      fail(where, fmt::format("must be a list of {} at most", most));
    }
    return value;
  }

  KeyControl control(const json& value, const std::string& where) const {
    check_names(value, where, {"vertex", "at_mm", "move_mm", "at_px"});
    if (!value.contains("vertex")) {
      fail(where, "has no 'vertex'");
    }
    KeyControl control;
    control.vertex = vertex(value["vertex"], where + ", 'vertex',");
    constexpr std::array<std::pair<const char*, KeyControl::How>, 3> kHow{
        {{"at_mm", KeyControl::How::At},
         {"move_mm", KeyControl::How::Move},
         {"at_px", KeyControl::How::Screen}}};
    int given = 0;
    for (const auto& [name, how] : kHow) {
      if (!value.contains(name)) {
        continue;
      }
      ++given;
      control.how = how;
      const std::string at = fmt::format("{}, '{}',", where, name);
      const std::size_t size = how == KeyControl::How::Screen ? 2 : 3;
      const json& numbers = list(value[name], at, size);
      if (numbers.size() != size) {
        fail(at, fmt::format("must be a list of {} numbers", size));
      }
      for (std::size_t axis = 0; axis < size; ++axis) {
        control.value[static_cast<Eigen::Index>(axis)] =
            static_cast<float>(number(numbers[axis], at, -kFarthest, kFarthest));
      }
    }
    if (given != 1) {
      fail(where, "needs one of 'at_mm', 'move_mm' and 'at_px'");
    }
    return control;
  }

  Key key(const json& value, const std::string& where) const {
    check_names(value, where, {"time_s", "frame", "controls"});
    Key key;
    if (!value.contains("time_s")) {
      fail(where, "has no 'time_s'");
    }
    key.time_s = number(value["time_s"], where + ", 'time_s',", 0, kLongest_s);
    if (value.contains("frame")) {
      if (!value["frame"].is_number_unsigned()) {
        fail(where + ", 'frame',", "must be the number of a frame");
      }
      key.frame = value["frame"].get<std::uint64_t>();
    }
    if (value.contains("controls")) {
      for (const json& each : list(value["controls"], where + ", 'controls',", kMostControls)) {
        key.controls.push_back(control(each, fmt::format("{}, control {}", where, key.controls.size() + 1)));
      }
    }
    if (key.frame && !key.controls.empty()) {
      fail(where, "has both 'frame' and 'controls': a key is either a captured frame or a pose");
    }
    return key;
  }

 private:
  std::string source_;
};

}  // namespace

KeyList parse_keys(std::string_view text, const std::string& source) {
  try {
    return keys_of(files::parse_json(text, kKeysLimits, source), source);
  } catch (const Error& error) {
    throw Error(ErrorKind::Usage, error.what());
  }
}

KeyList keys_of(const json& root, const std::string& source) {
  const Reader reader(source);
  reader.check_names(root, "the file", {"rate_hz", "whole", "beyond", "clamp", "pace", "regions", "keys"});
  KeyList out;
  if (root.contains("rate_hz")) {
    out.rate_hz = reader.number(root["rate_hz"], "'rate_hz'", 1, kFastest_hz);
  }
  out.whole = reader.flag(root, "whole");
  // "clamp" is the old spelling, the other way round: the studio wrote it into every file of keys.
  out.beyond = root.contains("clamp") ? !reader.flag(root, "clamp") : reader.flag(root, "beyond");
  if (root.contains("pace")) {
    if (root["pace"] != "captured" && root["pace"] != "shortest") {
      reader.fail("'pace'", "must be \"captured\" or \"shortest\"");
    }
    out.pace = root["pace"] == "captured" ? Pace::Captured : Pace::Shortest;
  }
  if (root.contains("regions")) {
    for (const json& each : reader.list(root["regions"], "'regions'", kMostControls)) {
      out.regions.push_back(reader.vertex(each, "'regions'"));
    }
  }
  if (!root.contains("keys")) {
    reader.fail("the file", "has no 'keys'");
  }
  for (const json& each : reader.list(root["keys"], "'keys'", kMostKeys)) {
    const std::string where = fmt::format("key {}", out.keys.size() + 1);
    out.keys.push_back(reader.key(each, where));
    if (out.keys.size() > 1 && !(out.keys.back().time_s > out.keys[out.keys.size() - 2].time_s)) {
      reader.fail(where, fmt::format("is at {} s, the one before it at {} s: time must go forward",
                                     out.keys.back().time_s, out.keys[out.keys.size() - 2].time_s));
    }
  }
  if (out.keys.empty()) {
    reader.fail("'keys'", "is empty: an animation needs a key");
  }
  return out;
}

KeyList read_keys(const std::filesystem::path& file) {
  return parse_keys(files::read_text(file, kKeysLimits.most_bytes, "keys file"), file.string());
}

}  // namespace facet::animate
