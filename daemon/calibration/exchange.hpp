#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

#include "capture/rig.hpp"

namespace facet::calibration {

inline constexpr std::size_t kMaxYamlBytes = 1U << 20;

/// What OpenCV's files do not say.
struct OpenCvImport {
  int width_px = 0;  ///< of the pictures; 0: the file has image_width and image_height
  int height_px = 0;
  double unit_mm = 1;  ///< of T, in mm: 1000 where the board was given in metres
  std::string left = "left";
  std::string right = "right";
};

/// A stereo pair from the texts that OpenCV's stereo_calib sample writes: M1 D1 M2 D2 in the intrinsics, R T
/// in the extrinsics (or all in one: two equal texts). The rig's frame is the left camera. The paths stand in
/// messages alone. Throws Error(UnreadableInput) naming file, line and key: what is missing, no matrix of
/// the size, a lens model with more than five coefficients.
capture::Rig parse_opencv(std::string_view intrinsics, const std::filesystem::path& intrinsics_file,
                          std::string_view extrinsics, const std::filesystem::path& extrinsics_file,
                          const OpenCvImport& import);

struct OpenCvTexts {
  std::string intrinsics;
  std::string extrinsics;
};
/// The same texts from a pair of a rig; cv::FileStorage reads them. T is in mm.
OpenCvTexts format_opencv(const capture::Rig& rig, const capture::StereoPair& pair);

/// A rig from a Kalibr camchain: cam0, cam1 ... with pinhole intrinsics and radtan (or no) distortion. The
/// rig's frame is cam0; pairs are chosen as pairs_of_neighbours does. Throws as parse_opencv.
capture::Rig parse_kalibr(std::string_view text, const std::filesystem::path& file);

/// A camchain of all cameras; metres. Throws Error(Usage) where a lens has a k3, which radtan has not.
std::string format_kalibr(const capture::Rig& rig);

/// Reads a rig from a rig file or one of the YAML files above, whichever it is; for OpenCV's the extrinsics'
/// file is the second one, or empty where all is in one.
capture::Rig read_any_rig(const std::filesystem::path& file, const std::filesystem::path& extrinsics,
                          const OpenCvImport& import);

}  // namespace facet::calibration
