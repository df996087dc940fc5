#pragma once

#include <memory>

#include "capture/rig.hpp"
#include "facet/frame.hpp"

namespace facet::capture {

/// Takes a lens's distortion out of its pictures: bilinear between the coded values, black where the lens did
/// not see. Any thread, one at a time.
class Undistortion {
 public:
  explicit Undistortion(const Lens& lens);
  ~Undistortion();
  Undistortion(Undistortion&&) noexcept;

  /// The same lens without distortion.
  const Lens& lens() const;

  /// frame: of the lens's size, else the result is empty. Number and times are kept.
  Frame apply(const Frame& frame) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::capture
