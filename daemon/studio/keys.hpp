#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "animate/face_ik.hpp"

namespace facet::studio {

/// Where a take's keys are stored: beside it.
std::filesystem::path keys_file(const std::filesystem::path& take);

/// Puts keys there, or takes them away (empty).
void store_keys(const std::filesystem::path& take, const std::string& keys);

/// The keys (as docs/animation.md has them; empty: none) with one more, or another in the place of one at
/// that time: these control points.
std::string with_key(const std::string& keys, double time_s,
                     const std::vector<animate::ControlTarget>& wanted, const animate::IkOptions& options);

}  // namespace facet::studio
