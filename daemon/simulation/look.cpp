#include "simulation/look.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <sstream>

#include "facet/error.hpp"

namespace facet::simulation {
namespace {

struct Effect {
  const char* name;
  bool Look::*on;
};
constexpr std::array<Effect, 8> kEffects{{{"blood", &Look::blood},
                                          {"marks", &Look::marks},
                                          {"makeup", &Look::makeup},
                                          {"strands", &Look::strands},
                                          {"scattering", &Look::scattering},
                                          {"gloss", &Look::gloss},
                                          {"occlusion", &Look::occlusion},
                                          {"bounce", &Look::bounce}}};

}  // namespace

std::vector<std::string> look_effects() {
  std::vector<std::string> names;
  for (const Effect& effect : kEffects) {
    names.emplace_back(effect.name);
  }
  return names;
}

std::vector<std::string> effects_of(const Look& look) {
  std::vector<std::string> names;
  for (const Effect& effect : kEffects) {
    if (look.*effect.on) {
      names.emplace_back(effect.name);
    }
  }
  return names;
}

std::string skin_type_name(int skin_type) {
  return skin_type == Look::kPainted   ? "painted"
         : skin_type == Look::kAnyType ? "any"
                                       : std::to_string(skin_type);
}

int parse_skin_type(const std::string& text) {
  if (text == "painted") {
    return Look::kPainted;
  }
  if (text == "any") {
    return Look::kAnyType;
  }
  if (text.size() == 1 && text[0] >= '1' && text[0] <= '6') {
    return text[0] - '0';
  }
  throw Error(ErrorKind::Usage,
              fmt::format("--skin '{}': it is painted, a Fitzpatrick type from 1 to 6, or any", text));
}

Look without(Look look, const std::string& effects) {
  std::istringstream names(effects);
  for (std::string name; std::getline(names, name, ',');) {
    const auto found = std::find_if(kEffects.begin(), kEffects.end(),
                                    [&](const Effect& effect) { return effect.name == name; });
    if (found == kEffects.end()) {
      throw Error(ErrorKind::Usage,
                  fmt::format("--without '{}': the effects are {}", name, fmt::join(look_effects(), ", ")));
    }
    look.*found->on = false;
  }
  return look;
}

}  // namespace facet::simulation
