#pragma once

#include <optional>
#include <vector>

#include "facet/frame.hpp"
#include "mesh/mesh_frame.hpp"
#include "render/renderer.hpp"
#include "report/evaluation.hpp"

namespace facet::report {

/// The picture of an evaluation: one row per frame with the input, distances of the coarse and of the refined
/// mesh, and their normal errors.
class HeatMap {
 public:
  void add_row(const mesh::MeshFrame& frame, const std::optional<Frame>& image, const Reconstruction& coarse,
               const Comparison& coarse_errors, const Reconstruction& refined,
               const Comparison& refined_errors);
  render::Picture picture() const;

 private:
  std::vector<render::Picture> cells_;  ///< [rows][5]
};

}  // namespace facet::report
