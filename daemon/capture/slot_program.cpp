#include "capture/slot_program.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "facet/error.hpp"

namespace facet::capture {
namespace {

constexpr std::string_view kLight = "light:";

std::string_view trimmed(std::string_view text) {
  const auto first = text.find_first_not_of(" \t\n");
  return first == std::string_view::npos ? std::string_view()
                                         : text.substr(first, text.find_last_not_of(" \t\n") + 1 - first);
}

/// Pieces between separators, without the blanks around them; empty ones are pieces, too.
std::vector<std::string_view> pieces(std::string_view text, char separator) {
  std::vector<std::string_view> out;
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t end = std::min(text.find(separator, at), text.size());
    out.push_back(trimmed(text.substr(at, end - at)));
    at = end + 1;
  }
  return out;
}

}  // namespace

SlotProgram standard_program() {
  using Kind = SlotLight::Kind;
  return {{Kind::Stripes, {}}, {Kind::Stripes, {}}, {Kind::Blank, {}}};
}

std::string to_word(const SlotLight& light) {
  switch (light.kind) {
    case SlotLight::Kind::Blank:
      return "blank";
    case SlotLight::Kind::Stripes:
      return "stripes";
    case SlotLight::Kind::Lit:
      return light.lights.empty() ? "dark" : fmt::format("{}{}", kLight, fmt::join(light.lights, "+"));
  }
  return {};
}

SlotLight parse_slot_light(std::string_view word) {
  word = trimmed(word);
  if (word == "blank") {
    return {SlotLight::Kind::Blank, {}};
  }
  if (word == "dark") {
    return {SlotLight::Kind::Lit, {}};
  }
  if (!word.starts_with(kLight)) {
    return {SlotLight::Kind::Stripes, {}};
  }
  SlotLight light{SlotLight::Kind::Lit, {}};
  for (const std::string_view name : pieces(word.substr(kLight.size()), '+')) {
    if (name.empty()) {
      throw Error(ErrorKind::Usage,
                  fmt::format("'{}': name the rig's projectors and lights that shine, such as "
                              "light:projector-l+led.top",
                              word));
    }
    light.lights.emplace_back(name);
  }
  std::sort(light.lights.begin(), light.lights.end());
  light.lights.erase(std::unique(light.lights.begin(), light.lights.end()), light.lights.end());
  return light;
}

std::optional<SlotLight> read_slot_light(std::string_view word) {
  try {
    return trimmed(word).empty() ? std::nullopt : std::optional(parse_slot_light(word));
  } catch (const Error&) {
    return std::nullopt;
  }
}

SlotProgram parse_slot_program(std::string_view text) {
  SlotProgram program;
  for (const std::string_view word : pieces(text, ',')) {
    if (word.empty()) {
      program.clear();
      break;
    }
    program.push_back(parse_slot_light(word));
  }
  if (!makes_meshes(program)) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("the slots' program '{}': name what each slot shows, such as "
                    "stripes,stripes,blank, with one slot with stripes and one that is blank at least",
                    text));
  }
  return program;
}

std::string to_text(const SlotProgram& program) {
  std::vector<std::string> words;
  std::transform(program.begin(), program.end(), std::back_inserter(words), to_word);
  return fmt::format("{}", fmt::join(words, ","));
}

bool makes_meshes(const SlotProgram& program) {
  const auto has = [&](SlotLight::Kind kind) {
    return std::any_of(program.begin(), program.end(),
                       [kind](const SlotLight& light) { return light.kind == kind; });
  };
  return has(SlotLight::Kind::Stripes) && has(SlotLight::Kind::Blank);
}

}  // namespace facet::capture
