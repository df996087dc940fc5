#include "avatar/value_mapping.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "facet/error.hpp"
#include "files/text_file.hpp"
#include "files/toml_section.hpp"

namespace facet::avatar {
namespace {

/// What an OSC address can hold in one of its parts, and "/" between them.
bool fits_address(const std::string& name) {
  constexpr std::string_view kPatterns = " #*,?[]{}";
  return std::all_of(name.begin(), name.end(), [&](char c) {
    return c > ' ' && c < '\x7f' && kPatterns.find(c) == std::string_view::npos;
  });
}

bool fits_text(const std::string& name) {
  return std::all_of(name.begin(), name.end(),
                     [](char c) { return static_cast<unsigned char>(c) >= 0x20 && c != '\x7f'; });
}

MappedValues read_table(files::TomlSection section, bool is_address) {
  MappedValues values;
  if (!section.given()) {
    return values;
  }
  for (const auto& [name, node] : section.entries()) {
    const std::string text = section.text(*node, name, "a formula in quotes");
    if (name.empty() || name.size() > kMostMappedNameBytes || !fits_text(name) ||
        (is_address && !fits_address(name))) {
      section.fail(node, name,
                   fmt::format("is no name that can be sent: 1 to {} bytes{}", kMostMappedNameBytes,
                               is_address ? ", without spaces and #*,?[]{}" : ""));
    }
    if (values.size() == kMostMappedValues) {
      section.fail(node, name, fmt::format("is one too many: {} at most", kMostMappedValues));
    }
    try {
      values.push_back({name, Formula(text)});
    } catch (const Error& error) {
      section.fail(node, name, fmt::format("is no formula: {}", error.what()));
    }
  }
  return values;
}

}  // namespace

ValueMapping parse_mapping(std::string_view text, const std::filesystem::path& file) {
  ValueMapping mapping;
  files::read_toml(text, file, [&](files::TomlDocument& document) {
    files::TomlSection root(document, &document.root(), "");
    mapping.vmc = read_table(root.section("vmc"), false);
    mapping.vrchat = read_table(root.section("vrchat"), true);
    root.finish();
  });
  return mapping;
}

ValueMapping load_mapping(const std::filesystem::path& file) {
  return file.empty() ? ValueMapping()
                      : parse_mapping(files::read_text(file, kMostMappingBytes, "mapping file"), file);
}

MappedValues mapped_values(std::span<const NamedFormula> named) {
  MappedValues values;
  values.reserve(named.size());
  for (const NamedFormula& one : named) {
    values.push_back({one.name, Formula(one.formula)});
  }
  return values;
}

MappedValues replaced(MappedValues all, const MappedValues& chosen) {
  std::erase_if(all, [&](const MappedValue& one) {
    return std::any_of(chosen.begin(), chosen.end(),
                       [&](const MappedValue& other) { return other.name == one.name; });
  });
  all.insert(all.end(), chosen.begin(), chosen.end());
  return all;
}

}  // namespace facet::avatar
