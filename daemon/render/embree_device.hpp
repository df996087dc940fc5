#pragma once

#include <embree3/rtcore.h>

#include <Eigen/Core>
#include <memory>

namespace facet::render {

/// Embree's device: one for the process, made at first use, freed with the last caster. Throws
/// Error(Internal) where Embree cannot start, Error(Unavailable) where it is not installed.
std::shared_ptr<RTCDeviceTy> shared_device();

/// Debian's Embree checks its rays with assertions: what it would stop the program for must not reach it.
bool usable(const Eigen::Vector3f& vector);

}  // namespace facet::render
