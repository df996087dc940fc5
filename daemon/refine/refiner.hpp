#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "facet/frame.hpp"
#include "gpu/context.hpp"
#include "mesh/hierarchy.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::refine {

/// Weights of the energies, chosen by bench/weights (see bench/README.md). All colours linear 0 to 1,
/// displacements mm.
struct Weights {
  float lighting_temporal = 0.0F;       ///< w1, eq. 3
  float albedo_smooth = 0.0F;           ///< w2, eq. 4
  float displacement_smooth = 0.0F;     ///< w3, eq. 6
  float displacement_hierarchy = 0.0F;  ///< w4, eq. 6
  float displacement_coarse = 0.0F;     ///< w5, eq. 6
};

struct RefinerConfig {
  Weights weights;
  bool paper_budget = false;   ///< 10 Gauss-Newton steps of 7 PCG iterations on every level
  int gauss_newton_steps = 2;  ///< on every level where not paper_budget
  int pcg_iterations = 7;
  int albedo_frames = 20;    ///< good frames over which the albedo is learned
  bool hierarchical = true;  ///< false: the finest level only (the paper's figure 6, for comparison)
};

/// What is fixed for one subject.
struct SubjectSetup {
  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  mesh::Vertices mean_albedo;           ///< [3][control_vertex_count] linear RGB
  std::vector<std::uint8_t> refinable;  ///< [control_vertex_count]
};

struct RefineInput {
  Frame image;
  CameraIntrinsics camera;
  Eigen::Isometry3f camera_from_head;
  const mesh::Vertices* control_vertices_mm =
      nullptr;  ///< [3][control_vertex_count] head frame; read during submit only
};

enum class RefineOutcome {
  Refined,
  NumericalFailure,  ///< the solve gave non-finite values; the output holds the coarse mesh (displacements 0)
  DeviceLost,        ///< the context must be rebuilt and a new Refiner made; the output is empty
};

struct RefineOutput {
  std::vector<float> displacements_mm;  ///< [finest vertex_count]
  std::vector<float> confidence;        ///< [finest vertex_count] 0 to 1
  std::array<float, 9> lighting{};
  std::shared_ptr<const mesh::Albedo> albedo;  ///< the current one; same object while unchanged
  float photometric_rms = 0;
  float upload_ms = 0;
  float lighting_ms = 0;
  float albedo_ms = 0;
  float displacement_ms = 0;
  float readback_ms = 0;
  std::string failure;  ///< for people, empty where Refined
};

/// Hierarchical shading refinement on the GPU (Ma & Deng 2019, section 4). One thread. submit hands a frame
/// to the GPU and returns; collect waits for it. One frame may be in flight. A whole frame is one submission.
class Refiner {
 public:
  /// Compiles the kernels. Throws Error(NoDevice). The context must outlive the refiner.
  Refiner(gpu::Context& context, const RefinerConfig& config);
  ~Refiner();

  /// Sets or replaces the subject: uploads topology and stencils, forgets albedo, lighting and displacements.
  /// Not while in flight.
  void set_subject(const SubjectSetup& subject);

  void submit(const RefineInput& input);
  RefineOutcome collect(RefineOutput& output);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::refine
