#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "facet/assets.hpp"
#include "facet/frame.hpp"
#include "gpu/context.hpp"
#include "maths/alignment.hpp"
#include "mesh/mesh_frame.hpp"
#include "refine/refiner.hpp"
#include "report/bands.hpp"
#include "report/evaluation.hpp"

namespace facet::bench {

/// How a sequence with known geometry is read.
struct SequenceOptions {
  std::filesystem::path model = default_model_file();
  std::filesystem::path landmark_nets = default_landmark_nets();
  int measure_every = 4;           ///< frames from one measured frame to the next
  float min_edge_px = 3;           ///< of the hierarchy
  std::string coarse = "tracker";  ///< or "truth": the true shape inside the model's span, at the true pose
  std::string albedo = "learned";  ///< or "truth"
  bool follow_skin = true;         ///< where the model knows the skin
};

/// A frame of which the truth is known.
struct MeasuredFrame {
  std::unique_ptr<report::Truth> truth;
  std::vector<std::int32_t> vertices;
  std::vector<float> true_displacements_mm;  ///< report::true_displacements_mm of the coarse mesh
  maths::Similarity truth_from_camera;       ///< that fits the coarse mesh best
};

struct TrackedFrame {
  Frame image;
  CameraIntrinsics camera;
  Eigen::Isometry3f camera_from_head;
  mesh::Vertices control_vertices_mm;
};

/// A sequence, tracked once; every setting is tried on the same coarse meshes.
struct Sequence {
  std::string name;
  std::shared_ptr<const mesh::Albedo> true_albedo;  ///< where asked for
  std::shared_ptr<const mesh::Subject> subject;
  std::vector<TrackedFrame> frames;
  std::map<std::size_t, MeasuredFrame> measured;
  report::AccuracyFigures coarse;
};

/// Reads and tracks a folder that facet synth wrote. Throws Error(UnreadableInput), Error(NoFace).
Sequence load_sequence(const face::FaceModel& model, const SequenceOptions& options,
                       const std::filesystem::path& folder);

/// The finest mesh in the camera frame.
report::Reconstruction reconstruct(const Sequence& sequence, const TrackedFrame& frame,
                                   const std::vector<float>& displacements_mm);

/// Compares with the truth under the coarse mesh's alignment, so that a setting can't gain by a better one.
report::Comparison compare_aligned(report::Reconstruction mesh, const MeasuredFrame& measured);

struct Score {
  double mean_mm = 0;
  double normal_deg = 0;
  double photometric_rms = 0;
  double wrinkle_correlation = 0;  ///< report::WrinkleSum
  double wrinkle_depth = 0;
  double trembling_mm = 0;  ///< rms change of the displacements from frame to frame
  double device_ms = 0;
};

/// Refines the whole sequence. at_measured, where given, sees the refiner's output at every measured frame.
/// Throws Error(Internal) where a frame is not refined.
Score refine_sequence(gpu::Context& context, const face::FaceModel& model, const Sequence& sequence,
                      const refine::RefinerConfig& config,
                      const std::function<void(std::size_t, const refine::RefineOutput&)>& at_measured = {});

}  // namespace facet::bench
