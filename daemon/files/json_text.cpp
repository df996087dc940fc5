#include "files/json_text.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <set>
#include <type_traits>
#include <utility>
#include <vector>

#include "facet/error.hpp"

namespace facet::files {
namespace {

/// Builds a value from the parser's events and ends the parser where a limit is passed. The library's own
/// builders do neither, and the one with a callback takes the square of a list's length.
template <typename Json>
class Builder : public nlohmann::json_sax<Json> {
 public:
  explicit Builder(const JsonLimits& limits) : limits_(limits) {}

  using Float = typename Json::number_float_t;
  using Integer = typename Json::number_integer_t;
  using Unsigned = typename Json::number_unsigned_t;
  using Text = typename Json::string_t;
  using Binary = typename Json::binary_t;

  bool null() override { return add(nullptr) != nullptr; }
  bool boolean(bool value) override { return add(value) != nullptr; }
  bool number_integer(Integer value) override { return add(value) != nullptr; }
  bool number_unsigned(Unsigned value) override { return add(value) != nullptr; }
  bool number_float(Float value, const Text& /*digits*/) override { return add(value) != nullptr; }
  bool string(Text& value) override { return add(std::move(value)) != nullptr; }
  bool binary(Binary& /*value*/) override { return refuse("it is not JSON"); }
  bool start_object(std::size_t /*count*/) override { return open(Json::object()); }
  bool start_array(std::size_t /*count*/) override { return open(Json::array()); }
  bool end_object() override { return close(); }
  bool end_array() override { return close(); }

  bool key(Text& name) override {
    if (has(open_.back(), name)) {
      return refuse(fmt::format("it has '{}' twice in one object", name.substr(0, kLongestQuote)));
    }
    name_ = std::move(name);
    return true;
  }

  bool parse_error(std::size_t /*at*/, const std::string& /*token*/,
                   const typename nlohmann::json::exception& error) override {
    const std::string_view what = error.what();
    // The message quotes what was read last, which may be the whole text.
    return refuse(fmt::format("it is not JSON: {}{}", what.substr(0, kLongestQuote),
                              what.size() > kLongestQuote ? " ..." : ""));
  }

  bool refuse(std::string why) {
    fault_ = std::move(why);
    return false;
  }

  const std::string& fault() const { return fault_; }
  Json take() { return std::move(root_); }

 private:
  static constexpr std::size_t kLongestQuote = 200;
  static constexpr bool kInOrder = std::is_same_v<Json, nlohmann::ordered_json>;

  struct Open {
    Json* value;
    std::set<Text> names;  ///< of an object in the text's order, which can't tell soon what it has
  };

  bool has(Open& object, const Text& name) {
    if constexpr (kInOrder) {
      return !object.names.insert(name).second;
    }
    return object.value->contains(name);
  }

  /// Puts a value where it belongs; null where there are too many.
  Json* add(Json value) {
    if (++count_ > limits_.most_values) {
      refuse(fmt::format("it has more than {} values", limits_.most_values));
      return nullptr;
    }
    if (open_.empty()) {
      root_ = std::move(value);
      return &root_;
    }
    Json& parent = *open_.back().value;
    if (parent.is_array()) {
      auto& list = parent.template get_ref<typename Json::array_t&>();
      return &list.emplace_back(std::move(value));
    }
    auto& object = parent.template get_ref<typename Json::object_t&>();
    if constexpr (kInOrder) {
      // Its own insertion looks through all names; key() has done so already.
      object.push_back({std::move(name_), std::move(value)});
      return &object.back().second;
    } else {
      return &object.emplace(std::move(name_), std::move(value)).first->second;
    }
  }

  bool open(Json value) {
    if (open_.size() >= static_cast<std::size_t>(limits_.most_depth)) {
      return refuse(fmt::format("it nests deeper than {} levels", limits_.most_depth));
    }
    Json* added = add(std::move(value));
    if (added == nullptr) {
      return false;
    }
    open_.push_back({added, {}});
    return true;
  }

  bool close() {
    open_.pop_back();
    return true;
  }

  JsonLimits limits_;
  Json root_;
  std::vector<Open> open_;  ///< from the root to the innermost; parents do not move while a child is open
  Text name_;
  std::size_t count_ = 0;
  std::string fault_;
};

template <typename Json>
Json parse(std::string_view text, const JsonLimits& limits, const std::string& source) {
  Builder<Json> builder(limits);
  const bool good = text.size() <= limits.most_bytes
                        ? Json::sax_parse(text.begin(), text.end(), &builder)
                        : builder.refuse(fmt::format("it has more than {} bytes", limits.most_bytes));
  if (!good) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", source, builder.fault()));
  }
  return builder.take();
}

}  // namespace

nlohmann::json parse_json(std::string_view text, const JsonLimits& limits, const std::string& source) {
  return parse<nlohmann::json>(text, limits, source);
}

nlohmann::ordered_json parse_ordered_json(std::string_view text, const JsonLimits& limits,
                                          const std::string& source) {
  return parse<nlohmann::ordered_json>(text, limits, source);
}

}  // namespace facet::files
