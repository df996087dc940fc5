#pragma once

// The sample format of docs/adding-an-exporter.md.

#include "exports/formats.hpp"

namespace facet::sample {

/// All frames as one text: "frame N T" (number in the source, seconds), then "x y z" of every vertex in the
/// head frame, mm.
std::unique_ptr<exports::SequenceWriter> open_points(const exports::SequenceOptions& options,
                                                     const exports::SequenceFrame& first);

/// The row that export_formats() would have.
inline constexpr exports::ExportFormat kPoints = {"points",
                                                  "one text: every frame's vertices, head frame, mm", "txt",
                                                  exports::Animation{.open = open_points}};

}  // namespace facet::sample
