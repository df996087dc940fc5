#pragma once

#include <span>
#include <vector>

#include "landmark/tflite_model.hpp"

namespace facet::test {

/// Runs a graph operator by operator with plain loops on [batch][rows][columns][channels]: the obvious
/// counterpart of landmark::Network.
///
/// image    the input in the graph's layout
/// returns  the outputs in the graph's order, flat
std::vector<std::vector<float>> run_reference(const landmark::TfliteModel& model,
                                              std::span<const float> image);

}  // namespace facet::test
