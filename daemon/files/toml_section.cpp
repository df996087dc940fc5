#include "files/toml_section.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <utility>

#include "facet/error.hpp"

namespace facet::files {
namespace {

/// Edits (insert, delete, replace one character) that lead from one word to the other.
std::size_t edit_distance(std::string_view from, std::string_view to) {
  std::vector<std::size_t> row(to.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 0; i < from.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i + 1);
    for (std::size_t j = 0; j < to.size(); ++j) {
      const std::size_t replaced = diagonal + (from[i] == to[j] ? 0 : 1);
      diagonal = std::exchange(row[j + 1], std::min({replaced, row[j] + 1, row[j + 1] + 1}));
    }
  }
  return row.back();
}

/// What to tell about a word that is not among the known ones.
std::string suggestion(std::string_view word, const std::vector<std::string>& known) {
  // A key that long is no misspelling; the distance costs its square.
  constexpr std::size_t kLongestWord = 64;
  if (word.size() <= kLongestWord) {
    const auto nearest = std::min_element(known.begin(), known.end(), [&](const auto& a, const auto& b) {
      return edit_distance(word, a) < edit_distance(word, b);
    });
    if (edit_distance(word, *nearest) <= std::max<std::size_t>(2, nearest->size() / 3)) {
      return fmt::format("did you mean '{}'?", *nearest);
    }
  }
  return fmt::format("known are: {}", fmt::join(known, ", "));
}

/// The place behind the string that begins at `at`, or behind the line that cuts it off.
std::size_t end_of_string(std::string_view text, std::size_t at) {
  const char quote = text[at];
  const std::string_view rest = text.substr(at);
  const bool long_form = rest.size() > 2 && rest[1] == quote && rest[2] == quote;
  for (at += long_form ? 3 : 1; at < text.size(); ++at) {
    if (text[at] == '\\' && quote == '"') {
      ++at;
    } else if (!long_form && text[at] == '\n') {
      return at;
    } else if (text[at] == quote && !long_form) {
      return at + 1;
    } else if (text[at] == quote && text.substr(at, 3) == std::string(3, quote)) {
      // Up to two quotes that belong to the string may stand before the three that end it.
      at += 3;
      for (int more = 0; more < 2 && at < text.size() && text[at] == quote; ++more) {
        ++at;
      }
      return at;
    }
  }
  return text.size();
}

/// Counts what a text would make before anything is made of it: the parser and the destructors behind it
/// recurse over names with dots, and its search for tables costs the square of their number. Reads as the
/// parser does up to the first error, where the parser stops.
class TomlMeasure {
 public:
  TomlMeasure(std::string_view text, const std::filesystem::path& file) : text_(text), file_(file) {}

  void check() {
    if (text_.size() > kMostTomlBytes) {
      fail(fmt::format("it has more than {} bytes", kMostTomlBytes));
    }
    for (std::size_t at = 0; at < text_.size();) {
      const char letter = text_[at];
      if (letter == '"' || letter == '\'') {
        const std::size_t end = end_of_string(text_, at);
        line_ += static_cast<std::size_t>(std::count(text_.data() + at, text_.data() + end, '\n'));
        at = end;
        line_is_fresh_ = false;
      } else if (letter == '#') {
        at = std::min(text_.find('\n', at), text_.size());
      } else {
        count(letter);
        ++at;
      }
    }
  }

 private:
  void count(char letter) {
    const bool begins_line = std::exchange(
        line_is_fresh_, letter == '\n' || (line_is_fresh_ && (letter == ' ' || letter == '\t')));
    switch (letter) {
      case '.':
        limit(++dots_ + 1, kMostTomlNames, "names in one key");
        return;  // all others begin a key or a value anew
      case '\n':
        ++line_;
        in_header_ = false;
        break;
      case '=':
        limit(++keys_, kMostTomlKeys, "keys");
        limit(tables_ += dots_, kMostTomlTables, "tables");
        break;
      case '[':
        in_header_ = in_header_ || (begins_line && nested_ == 0);
        limit(++nested_, kMostTomlNesting, "lists and tables in one another");
        break;
      case '{':
        limit(++tables_, kMostTomlTables, "tables");
        limit(++nested_, kMostTomlNesting, "lists and tables in one another");
        break;
      case ']':
      case '}':
        if (in_header_) {
          limit(tables_ += dots_ + 1, kMostTomlTables, "tables");
        }
        nested_ -= nested_ > 0 ? 1 : 0;
        break;
      case ',':
        limit(++items_, kMostTomlItems, "values in lists");
        break;
      default:
        return;
    }
    dots_ = 0;
  }

  void limit(std::size_t count, std::size_t most, const char* what) const {
    if (count > most) {
      fail(fmt::format("it has more than {} {}", most, what));
    }
  }

  [[noreturn]] void fail(const std::string& what) const {
    throw Error(ErrorKind::Usage, fmt::format("{}:{}: {}", file_.string(), line_, what));
  }

  std::string_view text_;
  const std::filesystem::path& file_;
  std::size_t line_ = 1;
  std::size_t dots_ = 0;  ///< since a key or a value began; a number has one at most
  std::size_t keys_ = 0;
  std::size_t items_ = 0;
  std::size_t tables_ = 0;
  std::size_t nested_ = 0;
  bool line_is_fresh_ = true;  ///< blanks alone so far
  bool in_header_ = false;
};

}  // namespace

std::string TomlDocument::place(const toml::node* node) const {
  return node != nullptr ? fmt::format("{}:{}", file_.string(), node->source().begin.line) : file_.string();
}

void TomlDocument::fail(const toml::node* node, const std::string& key, const std::string& what) const {
  throw Error(ErrorKind::Usage, fmt::format("{}: {}: {}", place(node), key, what));
}

TomlSection TomlSection::section(const std::string& key) {
  const toml::node* node = find(key, false);
  if (node != nullptr && !node->is_table()) {
    fail(node, key, "must be a section in square brackets, or { KEY = VALUE, ... }");
  }
  return {document_, node != nullptr ? node->as_table() : nullptr, full(key)};
}

std::vector<TomlSection> TomlSection::sections(const std::string& key) {
  const toml::node* node = find(key, false);
  std::vector<TomlSection> found;
  if (node == nullptr) {
    found.emplace_back(document_, nullptr, full(key));
    return found;
  }
  const toml::array* array = node->as_array();
  if (array == nullptr || !array->is_homogeneous<toml::table>()) {
    fail(node, key, "must be sections in double square brackets");
  }
  for (const toml::node& table : *array) {
    found.emplace_back(document_, table.as_table(), full(key));
  }
  return found;
}

void TomlSection::read(const std::string& key, std::vector<std::string>& value) {
  if (const toml::node* node = find(key)) {
    value = texts(*node, key);
  }
}

void TomlSection::read(const std::string& key, std::string& value) {
  if (const toml::node* node = find(key)) {
    value = text(*node, key, kAnyText);
  }
}

void TomlSection::read(const std::string& key, bool& value) {
  if (const toml::node* node = find(key)) {
    const std::optional<bool> found = node->value_exact<bool>();
    if (!found) {
      fail(node, key, "must be true or false");
    }
    value = *found;
  }
}

void TomlSection::read(const std::string& key, std::filesystem::path& value) {
  if (const toml::node* node = find(key)) {
    const std::string found = text(*node, key, "a path in quotes");
    if (found.empty() || found.find('\0') != std::string::npos) {
      fail(node, key, "must be a path in quotes, not empty");
    }
    value = document_.folder() / found;
  }
}

void TomlSection::read_mode(const std::string& key, unsigned& value) {
  if (const toml::node* node = find(key)) {
    value = static_cast<unsigned>(integer(
        *node, key, 0, 0777, "file permissions as an octal number from 0o000 to 0o777, such as 0o660"));
  }
}

const toml::node* TomlSection::read_numbers(const std::string& key, std::span<double> values, double least,
                                            double most) {
  const toml::node* node = find(key);
  if (node == nullptr) {
    return nullptr;
  }
  const std::string allowed = fmt::format("a list of {} numbers from {} to {}", values.size(), least, most);
  const toml::array* array = node->as_array();
  if (array == nullptr || array->size() != values.size()) {
    fail(node, key, "must be " + allowed);
  }
  for (std::size_t i = 0; i < values.size(); ++i) {
    values[i] = number(*array->get(i), key, least, most, allowed);
  }
  return node;
}

void TomlSection::read_auto(const std::string& key, std::optional<int>& value, std::int64_t least,
                            std::int64_t most) {
  if (const toml::node* node = find(key)) {
    if (node->value_exact<std::string>() == "auto") {
      value.reset();
    } else {
      value = static_cast<int>(integer(*node, key, least, most,
                                       fmt::format("\"auto\" or a whole number from {} to {}", least, most)));
    }
  }
}

void TomlSection::read_auto(const std::string& key, std::optional<double>& value, double least, double most) {
  if (const toml::node* node = find(key)) {
    if (node->value_exact<std::string>() == "auto") {
      value.reset();
    } else {
      value = number(*node, key, least, most, fmt::format("\"auto\" or a number from {} to {}", least, most));
    }
  }
}

std::optional<std::size_t> TomlSection::read_choice(const std::string& key,
                                                    std::span<const char* const> allowed) {
  const toml::node* node = find(key);
  if (node == nullptr) {
    return std::nullopt;
  }
  const std::optional<std::string> found = node->value_exact<std::string>();
  const auto at =
      std::find_if(allowed.begin(), allowed.end(), [&](const char* word) { return found == word; });
  if (!found || at == allowed.end()) {
    fail(node, key, fmt::format("must be one of: \"{}\"", fmt::join(allowed, "\", \"")));
  }
  return static_cast<std::size_t>(at - allowed.begin());
}

std::vector<std::pair<std::string, const toml::node*>> TomlSection::entries() {
  std::vector<std::pair<std::string, const toml::node*>> found;
  if (table_ != nullptr) {
    for (const auto& [key, value] : *table_) {
      found.emplace_back(key.str(), &value);
      known_.emplace_back(key.str());
    }
  }
  std::stable_sort(found.begin(), found.end(), [](const auto& a, const auto& b) {
    const toml::source_position& left = a.second->source().begin;
    const toml::source_position& right = b.second->source().begin;
    return std::pair(left.line, left.column) < std::pair(right.line, right.column);
  });
  return found;
}

const toml::node* TomlSection::find(const std::string& key, bool is_value) {
  known_.push_back(key);
  if (is_value) {
    document_.keys.push_back({.name = full(key), .value = std::nullopt});
  }
  return table_ != nullptr ? table_->get(key) : nullptr;
}

std::string TomlSection::text(const toml::node& node, const std::string& key,
                              const std::string& allowed) const {
  const std::optional<std::string> found = node.value_exact<std::string>();
  if (!found) {
    fail(&node, key, "must be " + allowed);
  }
  return *found;
}

std::vector<std::string> TomlSection::texts(const toml::node& node, const std::string& key) const {
  const toml::array* array = node.as_array();
  std::vector<std::string> found;
  for (std::size_t i = 0; array != nullptr && i < array->size(); ++i) {
    found.push_back(text(*array->get(i), key, "a list of texts in quotes"));
  }
  if (array == nullptr) {
    fail(&node, key, "must be a list of texts in quotes");
  }
  return found;
}

void TomlSection::finish() const {
  if (table_ == nullptr) {
    return;
  }
  std::vector<std::string_view> sorted(known_.begin(), known_.end());
  std::sort(sorted.begin(), sorted.end());
  for (const auto& [key, value] : *table_) {
    if (!std::binary_search(sorted.begin(), sorted.end(), key.str())) {
      document_.fail(&value, full(std::string(key.str())), "unknown key; " + suggestion(key.str(), known_));
    }
  }
}

std::int64_t TomlSection::integer(const toml::node& node, const std::string& key, std::int64_t least,
                                  std::int64_t most, const std::string& allowed) const {
  const std::optional<std::int64_t> found = node.value_exact<std::int64_t>();
  if (!found || *found < least || *found > most) {
    fail(&node, key, "must be " + allowed);
  }
  return *found;
}

double TomlSection::number(const toml::node& node, const std::string& key, double least, double most,
                           const std::string& allowed) const {
  const std::optional<double> found = node.is_number() ? node.value<double>() : std::nullopt;
  if (!found || !(*found >= least && *found <= most)) {
    fail(&node, key, "must be " + allowed);
  }
  return *found;
}

void read_toml(std::string_view text, const std::filesystem::path& file,
               const std::function<void(TomlDocument&)>& read) {
  TomlMeasure(text, file).check();
  try {
    const toml::table root = toml::parse(text, file.string());
    TomlDocument document(root, file);
    read(document);
  } catch (const toml::parse_error& error) {
    throw Error(ErrorKind::Usage, fmt::format("{}:{}: not valid TOML: {}", file.string(),
                                              error.source().begin.line, error.description()));
  }
}

}  // namespace facet::files
