#include "capture/slot_program.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "facet/error.hpp"

namespace facet::capture {
namespace {

constexpr std::string_view kLight = "light:";
constexpr std::string_view kFringes = "fringes:";

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
  return {{Kind::Stripes}, {Kind::Stripes}, {Kind::Blank}};
}

SlotProgram fringe_program() {
  using Kind = SlotLight::Kind;
  return {{Kind::Fringes, {}, 0}, {Kind::Fringes, {}, 1}, {Kind::Blank},
          {Kind::Fringes, {}, 2}, {Kind::Fringes, {}, 3}, {Kind::Blank}};
}

Shown shown_in_slot(const SlotProgram& program, std::uint64_t slot) {
  const auto stripes_before = [&](std::uint64_t end) {
    return static_cast<std::uint64_t>(
        std::count_if(program.begin(), program.begin() + static_cast<std::ptrdiff_t>(end),
                      [](const SlotLight& one) { return one.kind == SlotLight::Kind::Stripes; }));
  };
  const SlotLight& light = light_of_slot(program, slot);
  switch (light.kind) {
    case SlotLight::Kind::Blank:
      return {Shown::Kind::Blank, 0};
    case SlotLight::Kind::Fringes:
      return {Shown::Kind::Fringes, static_cast<std::uint64_t>(light.quarters)};
    case SlotLight::Kind::Stripes:
      return {Shown::Kind::Stripes,
              slot / program.size() * stripes_before(program.size()) + stripes_before(slot % program.size())};
    case SlotLight::Kind::Lit:
      break;
  }
  return {};
}

std::string to_word(const SlotLight& light) {
  switch (light.kind) {
    case SlotLight::Kind::Blank:
      return "blank";
    case SlotLight::Kind::Stripes:
      return "stripes";
    case SlotLight::Kind::Fringes:
      return fmt::format("{}{}", kFringes, light.quarters);
    case SlotLight::Kind::Lit:
      return light.lights.empty() ? "dark" : fmt::format("{}{}", kLight, fmt::join(light.lights, "+"));
  }
  return {};
}

SlotLight parse_slot_light(std::string_view word) {
  word = trimmed(word);
  if (word == "blank") {
    return {SlotLight::Kind::Blank};
  }
  if (word == "dark") {
    return {SlotLight::Kind::Lit};
  }
  if (word == "fringes" || word.starts_with(kFringes)) {
    const std::string_view shift = word.substr(std::min(word.size(), kFringes.size()));
    if (shift.size() != 1 || shift[0] < '0' || shift[0] > '3') {
      throw Error(
          ErrorKind::Usage,
          fmt::format("'{}': fringes are shifted by 0 to 3 quarters of a period, such as fringes:1", word));
    }
    return {SlotLight::Kind::Fringes, {}, shift[0] - '0'};
  }
  if (!word.starts_with(kLight)) {
    return {SlotLight::Kind::Stripes};
  }
  SlotLight light{SlotLight::Kind::Lit};
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
  if (trimmed(text) == "stripes" || trimmed(text) == "fringes") {
    return trimmed(text) == "stripes" ? standard_program() : fringe_program();
  }
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
        fmt::format(
            "the slots' program '{}': name what each slot shows, such as "
            "stripes,stripes,blank, with one slot with stripes or fringes and one that is blank at least; or "
            "stripes or fringes alone for the usual ones",
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
  return std::any_of(program.begin(), program.end(),
                     [](const SlotLight& light) { return light.has_pattern(); }) &&
         std::any_of(program.begin(), program.end(),
                     [](const SlotLight& light) { return light.kind == SlotLight::Kind::Blank; });
}

}  // namespace facet::capture
