#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

namespace facet {

/// One value of a configuration: its key, where a struct holds it, and what it may be. Data alone, beside the
/// struct: who has the value need not know how it is written down, who reads files need not know the value.
template <typename Struct>
struct Setting {
  template <typename Value>
  using At = Value& (*)(Struct&);
  /// An optional one may be "auto", and is empty then.
  using Place = std::variant<At<bool>, At<int>, At<unsigned>, At<std::int64_t>, At<std::uint64_t>, At<float>,
                             At<double>, At<std::optional<int>>, At<std::optional<double>>,
                             At<std::chrono::milliseconds>, At<std::string>, At<std::filesystem::path>,
                             At<std::vector<std::string>>>;

  const char* key;
  Place place;
  double least = 0;       ///< of numbers, as the key says them
  double most = 0;        ///< the same; least and most 0: no number
  std::int64_t unit = 1;  ///< of a whole number: the member's units in one of the key's (1000: ns in a us)
  std::span<const char* const> words{};  ///< a text is one of these; none: any

  bool has_range() const { return least != most; }
};

/// The struct that a pointer to a member points into.
template <typename Value, typename Struct>
Struct struct_of(Value Struct::*);

/// A member, or a member of a member: for Setting::place.
template <auto Member, auto... Inner>
constexpr auto& at(decltype(struct_of(Member))& holder) {
  return ((holder.*Member).*....*Inner);
}

}  // namespace facet
