#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "facet/camera.hpp"

namespace facet::capture {

/// Radial and tangential distortion of a lens [Bro71], in OpenCV's order and on normalised coordinates.
struct LensDistortion {
  double k1 = 0;
  double k2 = 0;
  double p1 = 0;
  double p2 = 0;
  double k3 = 0;
};

/// Something that maps points of space to pixels: a camera, or a projector looked at as one. Pixel centres
/// are at whole numbers.
struct Lens {
  int width_px = 0;
  int height_px = 0;
  double fx_px = 0;
  double fy_px = 0;
  double cx_px = 0;
  double cy_px = 0;
  LensDistortion distortion;
  /// Of the camera frame: x right, y down, z forward, mm.
  Eigen::Isometry3d camera_from_rig = Eigen::Isometry3d::Identity();

  /// Where a point of the rig's frame is seen, distortion included; nothing where it is not in front.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& point_mm) const;
  /// The direction in the camera frame, z = 1, that is seen at a pixel: distortion undone to 1e-9 px by
  /// Newton's method; nothing where it can't be undone there.
  std::optional<Eigen::Vector3d> direction(const Eigen::Vector2d& pixel) const;
  /// The middle of the lens in the rig's frame.
  Eigen::Vector3d centre_mm() const { return camera_from_rig.inverse().translation(); }
};

struct RigCamera {
  std::string name;  ///< unique; as in the configuration's [[camera]]
  Lens lens;
  bool colour = false;  ///< sees texture and flow; monochrome ones see depth
};

struct RigProjector {
  std::string name;  ///< unique; the trigger's line that shows its pattern
  Lens lens;
};

/// A lamp that is small beside its distance from the face, bare or behind a diffuser.
struct RigLight {
  std::string name;  ///< unique among lights and projectors; as in a trigger program's slots
  Eigen::Vector3d position_mm{0, 0, 0};  ///< rig frame
  /// Light that it gives skin 1 m away which faces it, of a projector's white where the projectors' axes
  /// meet. What is nearly right will do: strengths are found again on the face.
  double strength = 1;
};

/// Two cameras whose pictures make one depth map, in the left one's frame. Indices into Rig::cameras.
struct StereoPair {
  std::size_t left = 0;
  std::size_t right = 0;
};

/// The calibrated devices of a booth, in one frame: right-handed, mm.
struct Rig {
  std::vector<RigCamera> cameras;
  std::vector<StereoPair> pairs;
  std::vector<RigProjector> projectors;
  std::vector<RigLight> lights;
};

/// The pinhole of a lens, its distortion left out.
CameraIntrinsics pinhole_of(const Lens& lens);

/// The index of the camera of that name; none where there is none.
std::optional<std::size_t> find_camera(const Rig& rig, std::string_view name);

/// Whether a projector or light has that name.
bool has_light(const Rig& rig, std::string_view name);

/// The same camera. Throws Error(Usage), which names the file, the cameras that there are and what to
/// do (`advice`), where there is none.
const RigCamera& camera_named(const Rig& rig, const std::filesystem::path& rig_file, const std::string& name,
                              const std::string& advice);

/// Throws Error(Usage) where a camera's pictures have another size than was calibrated. rig_file: for the
/// message.
void check_size(const CameraInfo& camera, const RigCamera& known, const std::filesystem::path& rig_file);

}  // namespace facet::capture
