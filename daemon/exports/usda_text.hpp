#pragma once

#include <fmt/format.h>

#include <iterator>
#include <string_view>

#include "exports/export_sequence.hpp"

namespace facet::exports {

/// A piece of Universal Scene Description as text.
using UsdaText = fmt::memory_buffer;

inline std::string_view view(const UsdaText& text) {
  return {text.data(), text.size()};
}

/// "[(x, y, z), ...]" of a matrix's columns, or "[x, y, ...]" of a row; each number as the shortest text that
/// gives the same one.
template <typename Matrix>
void append_tuples(UsdaText& text, const Matrix& columns) {
  const bool tuples = columns.rows() > 1;
  text.push_back('[');
  for (Eigen::Index i = 0; i < columns.cols(); ++i) {
    fmt::format_to(std::back_inserter(text), "{}{}{}", i == 0 ? "" : ", ", tuples ? "(" : "", columns(0, i));
    for (Eigen::Index row = 1; row < columns.rows(); ++row) {
      fmt::format_to(std::back_inserter(text), ", {}", columns(row, i));
    }
    if (tuples) {
      text.push_back(')');
    }
  }
  text.push_back(']');
}

/// A matrix for row vectors, as USD's are: each tuple is a column of ours.
void append_matrix(UsdaText& text, const Eigen::Matrix4f& matrix);

/// The layer's head: metres, y up, its time codes. prim: the default one.
void append_layer_head(UsdaText& text, const Timeline& timeline, std::string_view prim);

/// What a mesh has whatever becomes of its points: topology, texture coordinates, colours.
void append_mesh_constants(UsdaText& text, const ExportMesh& mesh, std::string_view indent);

/// The frame's number in the source; at a varying rate, the first frame's number and then the time in units
/// of the average rate.
double usda_time_code(const Timeline& timeline, std::uint64_t sequence);

}  // namespace facet::exports
