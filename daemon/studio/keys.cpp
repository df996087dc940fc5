#include "studio/keys.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

#include "animate/animation.hpp"
#include "files/json_text.hpp"
#include "files/output_file.hpp"

namespace facet::studio {
namespace {

using nlohmann::json;

/// Keys closer than this are one, s.
constexpr double kSameTime_s = 1e-3;

}  // namespace

std::filesystem::path keys_file(const std::filesystem::path& take) {
  return take.parent_path() / (take.stem().string() + ".keys.json");
}

void store_keys(const std::filesystem::path& take, const std::string& keys) {
  const std::filesystem::path stored = keys_file(take);
  if (keys.empty()) {
    std::error_code ignored;
    std::filesystem::remove(stored, ignored);
  } else {
    files::OutputFile file(stored);
    file.write(keys);
    file.commit();
  }
}

std::string with_key(const std::string& keys, double time_s,
                     const std::vector<animate::ControlTarget>& wanted, const animate::IkOptions& options) {
  json root = keys.empty() ? json::object() : files::parse_json(keys, animate::kKeysLimits, "keys");
  json controls = json::array();
  for (const animate::ControlTarget& target : wanted) {
    const bool on_screen = target.space == animate::ControlTarget::Space::Screen;
    json at = json::array();
    for (Eigen::Index axis = 0; axis < (on_screen ? 2 : 3); ++axis) {
      at.push_back(std::round(1e4 * static_cast<double>(target.target[axis])) / 1e4);
    }
    controls.push_back({{"vertex", target.vertex}, {on_screen ? "at_px" : "at_mm", std::move(at)}});
  }
  json kept = json::array();
  for (const json& key : root.value("keys", json::array())) {
    if (std::abs(key.at("time_s").get<double>() - time_s) > kSameTime_s) {
      kept.push_back(key);
    }
  }
  const auto later = std::find_if(kept.begin(), kept.end(),
                                  [&](const json& key) { return key.at("time_s").get<double>() > time_s; });
  // Not a braced list: that would insert its two members.
  kept.insert(later, json({{"time_s", time_s}, {"controls", std::move(controls)}}));
  root["keys"] = std::move(kept);
  root["whole"] = options.whole;
  root["beyond"] = options.beyond;
  root.erase("clamp");  // the old spelling
  return root.dump(1);
}

}  // namespace facet::studio
