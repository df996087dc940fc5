#pragma once

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <toml++/toml.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "facet/setting.hpp"

namespace facet::files {

/// What a TOML file may hold; far beyond every file of ours (64 cameras with 468 face points each).
inline constexpr std::size_t kMostTomlBytes = 1U << 20;
inline constexpr std::size_t kMostTomlNames = 16;    ///< a.b.c has three
inline constexpr std::size_t kMostTomlNesting = 32;  ///< lists and tables within a value
inline constexpr std::size_t kMostTomlTables = 10'000;
inline constexpr std::size_t kMostTomlKeys = 50'000;
inline constexpr std::size_t kMostTomlItems = 200'000;  ///< of all lists together

inline constexpr const char* kAnyText = "a text in quotes";

/// A key that was asked for.
struct TomlKey {
  std::string name;                  ///< "section.key"
  double least = 0;                  ///< of a Setting that is a number; else both 0
  double most = 0;                   ///< the same
  std::optional<std::string> value;  ///< what a Setting came to; none: it was read in another way
};

/// A TOML file as a whole: where messages point, and the keys that were asked for.
class TomlDocument {
 public:
  /// Borrows root.
  TomlDocument(const toml::table& root, std::filesystem::path file) : root_(root), file_(std::move(file)) {}

  /// Throws Error(Usage) that names the file, the node's line, the key and what is wrong.
  [[noreturn]] void fail(const toml::node* node, const std::string& key, const std::string& what) const;

  const toml::table& root() const { return root_; }
  std::filesystem::path folder() const { return file_.parent_path(); }
  /// Where a node is, for messages: "FILE:LINE"; null: the file.
  std::string place(const toml::node* node) const;

  std::vector<TomlKey> keys;
  std::vector<std::string> warnings;

 private:
  const toml::table& root_;
  std::filesystem::path file_;
};

/// One table of the file. Every read leaves the value as it is where the key is not there, and throws
/// Error(Usage) that says what is allowed; finish() refuses what nobody asked for.
class TomlSection {
 public:
  TomlSection(TomlDocument& document, const toml::table* table, std::string name)
      : document_(document), table_(table), name_(std::move(name)) {}

  /// A table inside this one; absent where the file does not have it.
  TomlSection section(const std::string& key);
  /// The tables of an array [[key]]. One that is not in the file stands for its keys.
  std::vector<TomlSection> sections(const std::string& key);

  /// A list of texts.
  void read(const std::string& key, std::vector<std::string>& value);
  void read(const std::string& key, std::string& value);
  void read(const std::string& key, bool& value);
  /// A path, from the file's folder where it is relative.
  void read(const std::string& key, std::filesystem::path& value);
  /// File permissions as an octal number.
  void read_mode(const std::string& key, unsigned& value);
  /// A list of as many numbers as `values` has room for, each between the bounds; the node, or null where
  /// there is none.
  const toml::node* read_numbers(const std::string& key, std::span<double> values, double least, double most);

  template <typename Integer>
  void read_integer(const std::string& key, Integer& value, std::int64_t least, std::int64_t most) {
    if (const toml::node* node = find(key)) {
      value = static_cast<Integer>(
          integer(*node, key, least, most, fmt::format("a whole number from {} to {}", least, most)));
    }
  }

  template <typename Number>
  void read_number(const std::string& key, Number& value, double least, double most) {
    if (const toml::node* node = find(key)) {
      value = static_cast<Number>(
          number(*node, key, least, most, fmt::format("a number from {} to {}", least, most)));
    }
  }

  /// A value, or "auto" for none.
  void read_auto(const std::string& key, std::optional<int>& value, std::int64_t least, std::int64_t most);
  void read_auto(const std::string& key, std::optional<double>& value, double least, double most);

  template <typename Struct>
  void read(const Setting<Struct>& setting, Struct& values) {
    std::visit([&](auto place) { read_setting(setting, place(values)); }, setting.place);
  }
  template <typename Struct>
  void read(std::span<const Setting<std::type_identity_t<Struct>>> settings, Struct& values) {
    for (const Setting<Struct>& setting : settings) {
      read(setting, values);
    }
  }

  /// The same of keys that have a new place, of which a file that has them is warned.
  template <typename Struct>
  void read_moved(std::span<const Setting<std::type_identity_t<Struct>>> settings, Struct& values,
                  const std::string& new_place) {
    for (const Setting<Struct>& setting : settings) {
      if (const toml::node* node = table_ != nullptr ? table_->get(setting.key) : nullptr) {
        document_.warnings.push_back(
            fmt::format("{}: {}: has moved to {}; here it is read for one release more",
                        document_.place(node), full(setting.key), new_place));
      }
      read(setting, values);
      document_.keys.pop_back();
    }
  }

  /// The keys of a section that names them itself, with their values, in the file's order.
  std::vector<std::pair<std::string, const toml::node*>> entries();

  /// One of a few words; returns its place among them.
  std::optional<std::size_t> read_choice(const std::string& key, std::span<const char* const> allowed);

  /// Refuses a section that lacks one of the keys.
  template <std::size_t Count>
  void require(const std::array<const char*, Count>& keys) const {
    for (const char* key : keys) {
      if (table_ != nullptr && table_->get(key) == nullptr) {
        fail(table_, key, "is missing");
      }
    }
  }

  /// The raw value, for keys whose type is not one of the above.
  const toml::node* find(const std::string& key, bool is_value = true);
  std::string text(const toml::node& node, const std::string& key, const std::string& allowed) const;
  std::vector<std::string> texts(const toml::node& node, const std::string& key) const;
  [[noreturn]] void fail(const toml::node* node, const std::string& key, const std::string& what) const {
    document_.fail(node, full(key), what);
  }

  bool given() const { return table_ != nullptr; }
  const toml::node* node() const { return table_; }
  void finish() const;

 private:
  std::string full(const std::string& key) const { return name_.empty() ? key : name_ + "." + key; }
  std::int64_t integer(const toml::node& node, const std::string& key, std::int64_t least, std::int64_t most,
                       const std::string& allowed) const;
  double number(const toml::node& node, const std::string& key, double least, double most,
                const std::string& allowed) const;

  template <typename Struct, typename Value>
  void read_setting(const Setting<Struct>& setting, Value& value) {
    const std::string key = setting.key;
    const auto least = static_cast<std::int64_t>(setting.least);
    const auto most = static_cast<std::int64_t>(setting.most);
    std::string text;
    if constexpr (std::is_same_v<Value, std::optional<int>>) {
      read_auto(key, value, least, most);
      text = value ? fmt::to_string(*value) : "auto";
    } else if constexpr (std::is_same_v<Value, std::optional<double>>) {
      read_auto(key, value, setting.least, setting.most);
      text = value ? fmt::to_string(*value) : "auto";
    } else if constexpr (std::is_same_v<Value, std::chrono::milliseconds>) {
      std::int64_t count = value.count();
      read_integer(key, count, least, most);
      value = Value(count);
      text = fmt::to_string(count);
    } else if constexpr (std::is_floating_point_v<Value>) {
      read_number(key, value, setting.least, setting.most);
      text = fmt::to_string(value);
    } else if constexpr (std::is_integral_v<Value> && !std::is_same_v<Value, bool>) {
      std::int64_t in_units = static_cast<std::int64_t>(value) / setting.unit;
      read_integer(key, in_units, least, most);
      value = static_cast<Value>(in_units * setting.unit);
      text = fmt::to_string(in_units);
    } else if constexpr (std::is_same_v<Value, std::string>) {
      if (setting.words.empty()) {
        read(key, value);
      } else if (const auto chosen = read_choice(key, setting.words)) {
        value = setting.words[*chosen];
      }
      text = value;
    } else {
      read(key, value);
      if constexpr (std::is_same_v<Value, std::filesystem::path>) {
        text = value.string();
      } else if constexpr (std::is_same_v<Value, bool>) {
        text = fmt::to_string(value);
      } else {
        text = fmt::format("{}", fmt::join(value, " "));
      }
    }
    TomlKey& told = document_.keys.back();
    told = {std::move(told.name), setting.least, setting.most, std::move(text)};
  }

  TomlDocument& document_;
  const toml::table* table_;
  std::string name_;
  std::vector<std::string> known_;
};

/// Parses a text and hands it to `read`. Throws Error(Usage) naming file and line where it is no TOML or
/// holds more than the above, before anything is made of it. The tree's only TOML parser. `file` stands in
/// messages alone.
void read_toml(std::string_view text, const std::filesystem::path& file,
               const std::function<void(TomlDocument&)>& read);

}  // namespace facet::files
