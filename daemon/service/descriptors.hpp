#pragma once

#include <cstddef>
#include <string>

#include "service/config.hpp"

namespace facet::service {

/// What the places of all servers, the cameras and the recorder may take of file descriptors, together.
std::size_t descriptors_needed(const Config& config);

/// Lowers the places of all servers until they leave room for cameras and recorder: what strangers use must
/// never be missing where a recording opens its next file. Empty where nothing had to be lowered; else
/// what was, for people.
std::string fit_descriptors(Config& config, std::size_t limit);

/// Lets this process have as many file descriptors as it may (the soft limit becomes the hard one), and says
/// how many that are.
std::size_t raise_descriptor_limit();

}  // namespace facet::service
