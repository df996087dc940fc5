#include "files/toml_section.hpp"

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

}  // namespace

void TomlDocument::fail(const toml::node* node, const std::string& key, const std::string& what) const {
  const std::string where =
      node != nullptr ? fmt::format("{}:{}", file_.string(), node->source().begin.line) : file_.string();
  throw Error(ErrorKind::Usage, fmt::format("{}: {}: {}", where, key, what));
}

TomlSection TomlSection::section(const std::string& key) {
  const toml::node* node = find(key, false);
  if (node != nullptr && !node->is_table()) {
    fail(node, key, "must be a section in square brackets");
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
    document_.keys.push_back(full(key));
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
  for (const auto& [key, value] : *table_) {
    if (std::find(known_.begin(), known_.end(), key.str()) == known_.end()) {
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
