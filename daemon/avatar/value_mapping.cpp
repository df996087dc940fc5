#include "avatar/value_mapping.hpp"

#include <algorithm>

namespace facet::avatar {

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
