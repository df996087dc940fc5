#pragma once

#include <numbers>

namespace facet::landmark {

/// The share of the new value in a first-order low-pass [CRV12 eq. 3, 4].
template <typename Scalar>
Scalar new_share(Scalar cutoff_hz, Scalar seconds) {
  const Scalar period = 1 / (2 * std::numbers::pi_v<Scalar> * cutoff_hz);
  return 1 / (1 + period / seconds);
}

}  // namespace facet::landmark
