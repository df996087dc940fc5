#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>

namespace facet::maths {

/// The value that stands at place k (from 0) once `values`, a range of random access with more than k of
/// them, is sorted. Reorders it.
template <typename Values>
auto nth_of(Values&& values, std::size_t k) {
  const auto at = std::begin(values) + static_cast<std::ptrdiff_t>(k);
  std::nth_element(std::begin(values), at, std::end(values));
  return *at;
}

/// The median; of an even number the upper of the two in the middle. Not of an empty range; reorders it.
template <typename Values>
auto median_of(Values&& values) {
  return nth_of(values, std::size(values) / 2);
}

/// The quantile at `share`, 0 to 1: the nearest of the values. Not of an empty range; reorders it.
template <typename Values>
auto quantile_of(Values&& values, double share) {
  return nth_of(values,
                static_cast<std::size_t>(std::lround(share * static_cast<double>(std::size(values) - 1))));
}

}  // namespace facet::maths
