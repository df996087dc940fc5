#include "avatar/mapping_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <system_error>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"
#include "files/toml_section.hpp"

namespace facet::avatar {
namespace {

/// What an OSC address can hold in one of its parts, and "/" between them.
bool fits_address(std::string_view name) {
  constexpr std::string_view kPatterns = " #*,?[]{}";
  return std::all_of(name.begin(), name.end(), [&](char c) {
    return c > ' ' && c < '\x7f' && kPatterns.find(c) == std::string_view::npos;
  });
}

bool fits_text(std::string_view name) {
  return std::all_of(name.begin(), name.end(),
                     [](char c) { return static_cast<unsigned char>(c) >= 0x20 && c != '\x7f'; });
}

bool is_letter_or_digit(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
}

MappedValues read_table(files::TomlSection section, const MappingTable& table) {
  MappedValues values;
  if (!section.given()) {
    return values;
  }
  for (const auto& [name, node] : section.entries()) {
    const std::string text = section.text(*node, name, "a formula in quotes");
    if (const std::string fault = name_fault(table, name); !fault.empty()) {
      section.fail(node, name, fault);
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

/// A text of TOML in double quotes.
std::string in_quotes(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (static_cast<unsigned char>(c) < 0x20 || c == '\x7f') {
      out += fmt::format("\\u{:04x}", static_cast<unsigned>(c));
    } else {
      out += c;
    }
  }
  return out + '"';
}

std::string key_text(const std::string& name) {
  const bool bare = std::all_of(name.begin(), name.end(),
                                [](char c) { return is_letter_or_digit(c) || c == '_' || c == '-'; });
  return bare ? name : in_quotes(name);
}

std::string tuning_text(const std::string& name, const ValueTuning& tuning) {
  return fmt::format("{} = {{ gain = {}, dead_zone = {}, smoothing_ms = {} }}\n", name, tuning.gain,
                     tuning.dead_zone, tuning.smoothing_ms);
}

}  // namespace

std::string name_fault(const MappingTable& table, std::string_view name) {
  constexpr std::size_t kFewestOfWord = 4;
  constexpr std::size_t kMostOfWord = 32;
  std::string rule = fmt::format("1 to {} bytes", kMostMappedNameBytes);
  bool fits = !name.empty() && name.size() <= kMostMappedNameBytes && fits_text(name);
  if (table.names == MappedNames::Address) {
    rule += ", without spaces and #*,?[]{}";
    fits = fits && fits_address(name);
  } else if (table.names == MappedNames::Word) {
    rule = fmt::format("{} to {} letters and digits", kFewestOfWord, kMostOfWord);
    fits = name.size() >= kFewestOfWord && name.size() <= kMostOfWord &&
           std::all_of(name.begin(), name.end(), is_letter_or_digit);
  }
  return fits ? "" : "is no name that can be sent: " + rule;
}

ValueMapping parse_mapping(std::string_view text, const std::filesystem::path& file) {
  ValueMapping mapping;
  files::read_toml(text, file, [&](files::TomlDocument& document) {
    files::TomlSection root(document, &document.root(), "");
    for (const MappingTable& table : kMappingTables) {
      mapping.*table.values = read_table(root.section(table.name), table);
    }
    if (const files::TomlSection values = root.section("values"); values.given()) {
      mapping.values = read_tunings(values);
    }
    root.finish();
  });
  return mapping;
}

ValueMapping load_mapping(const std::filesystem::path& file) {
  std::error_code ignored;
  const bool is_there =
      std::filesystem::status(file, ignored).type() != std::filesystem::file_type::not_found;
  return file.empty() || !is_there
             ? ValueMapping()
             : parse_mapping(files::read_text(file, kMostMappingBytes, "mapping file"), file);
}

std::string mapping_text(const ValueMapping& mapping) {
  std::string text = "# Formulas and tunings of facetd's bridges, as they were saved (docs/bridges.md).\n";
  for (const MappingTable& table : kMappingTables) {
    const MappedValues& values = mapping.*table.values;
    text += values.empty() ? "" : fmt::format("\n[{}]\n", table.name);
    for (const MappedValue& value : values) {
      text += fmt::format("{} = {}\n", key_text(value.name), in_quotes(value.formula.text()));
    }
  }
  if (mapping.values) {
    text += "\n[values]\n" + tuning_text(kAllValues, mapping.values->all);
    for (const auto& [index, tuning] : mapping.values->named) {
      text += tuning_text(mesh::arkit_name(index), tuning);
    }
  }
  return text;
}

void save_mapping(const ValueMapping& mapping, const std::filesystem::path& file) {
  const std::string text = mapping_text(mapping);
  if (text.size() > kMostMappingBytes) {
    throw Error(ErrorKind::Usage, fmt::format("the mapping file would have {} bytes, {} are the most",
                                              text.size(), kMostMappingBytes));
  }
  files::OutputFile out(file);
  out.write(text);
  out.commit();
}

ValueTunings read_tunings(files::TomlSection section) {
  ValueTunings values;
  const auto read = [&](const std::string& name, ValueTuning& tuning) {
    files::TomlSection given = section.section(name);
    if (given.given()) {
      given.read(kValueTuningSettings, tuning);
      given.finish();
    }
    return given.given();
  };
  read(kAllValues, values.all);
  for (std::size_t i = 0; i < mesh::kArkitNames.size(); ++i) {
    ValueTuning tuning;
    if (read(mesh::arkit_name(i), tuning)) {
      values.named[i] = tuning;
    }
  }
  section.finish();
  return values;
}

}  // namespace facet::avatar
