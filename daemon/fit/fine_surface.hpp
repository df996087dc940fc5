#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "capture/depth_map.hpp"
#include "fit/template_fitter.hpp"
#include "fit/template_mesh.hpp"
#include "mesh/hierarchy.hpp"

namespace facet::fit {

struct FineOptions {
  int sweeps = 3;       ///< of 4-8 subdivision below the template, on the face's skin; two halve its edges
  double sigma_mm = 3;  ///< Tukey's, of depth: what lies farther off is another surface
  /// Of the squared Laplacian of the displacements, mm^4; its fourth root is a length.
  double smoothness = 0.1;
  int steps = 3;           ///< Gauss-Newton
  int cg_iterations = 80;  ///< per step, at most
};

/// What the template is too coarse for (past the paper, whose template has an eighth of the depth maps'
/// points): the template refined further, each of its vertices displaced along the surface's normal until it
/// lies on the depth maps. One thread at a time.
class FineSurface {
 public:
  /// control  the face model's control mesh, of which `surface` was made; not needed afterwards
  /// Start-up only. Throws Error(Usage) where the template was not made of it or the options make no sense.
  FineSurface(const mesh::ControlMesh& control, std::shared_ptr<const TemplateMesh> surface,
              const FineOptions& options = {});
  ~FineSurface();

  /// Its control vertices and its level 0 are the template's; its finest level is the fine mesh.
  const std::shared_ptr<const mesh::Hierarchy>& hierarchy() const;

  /// Minimises  sum over maps j, vertices i of A_i w_ij rho([p_i + d_i n_i - h_ij]_z, sigma)  [SF04 eq. 10]
  ///            + smoothness sum over i of A_i (Laplacian d)_i^2 + what draws d to 0 where no map sees it
  /// over the displacements d. p and n: the template subdivided, and its unit normals; A: a vertex's area.
  ///
  /// template_mm       [3][template vertex_count] rig frame (what TemplateFitter found)
  /// displacements_mm  [finest vertex_count] in: where to begin (empty: at 0), such as the mesh before;
  ///                   out: along the coarse normals, for mesh::rebuild_finest
  /// confidence        [finest vertex_count] out: 0 where no map sees it, up to 1
  /// returns           as TemplateFitter::fit; `seen` is the share of the fine skin's vertices. After NoData
  /// and
  ///                   NumericalFailure displacements and confidence are all 0.
  TemplateFitReport fit(std::span<const capture::DepthMap> maps, const mesh::Vertices& template_mm,
                        std::vector<float>& displacements_mm, std::vector<float>& confidence);

  /// What something else (shading) adds to displacements that `fit` found: where it would turn a triangle
  /// over it is taken back by halves, as `fit` does with its own.
  ///
  /// template_mm       [3][template vertex_count] rig frame
  /// displacements_mm  [finest vertex_count] along the coarse normals
  /// added_mm          [finest vertex_count] along the same
  /// sum_mm            out: [finest vertex_count] displacements with what is left of it
  /// returns           how many triangles would have been turned over. Throws Error(Usage) for other sizes.
  int add(const mesh::Vertices& template_mm, std::span<const float> displacements_mm,
          std::span<const float> added_mm, std::vector<float>& sum_mm);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::fit
