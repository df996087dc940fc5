#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include "face/face_model.hpp"
#include "model/bilinear_core.hpp"

namespace facet::model {

struct BuildOptions {
  std::filesystem::path makehuman;  ///< the unpacked npm package
  std::uint64_t seed = 20190521;    ///< of the sampled identities
  int identities = 340;             ///< sampled; each counts with its mirror image
  int check_identities = 12;        ///< sampled besides, to measure what the truncation loses
  CoreOptions core;
};

/// What the build measured.
struct BuildReport {
  double explained_variance = 0;   ///< by the kept identity modes
  double identity_rms_mm = 0;      ///< spread of the sampled faces about their mean
  double neutral_error_mm = 0;     ///< rms that the truncation loses on unseen neutral faces
  double expression_error_mm = 0;  ///< the same for expression displacements, mean over expressions
  double eye_distance_mm = 0;      ///< of the mean face, between the eyeballs' centres
};

/// done, total and what is being done; for a progress bar.
using BuildProgress = std::function<void(std::uint64_t done, std::uint64_t total, const std::string& what)>;

/// Builds the bilinear model from MakeHuman's data, without landmarks: cuts the head, samples adults, carries
/// the expressions to them by deformation transfer and truncates the tensor. Deterministic. Throws
/// Error(UnreadableInput) where the data is missing or not the expected one.
face::FaceModel build_model(const BuildOptions& options, const BuildProgress& progress, BuildReport& report);

}  // namespace facet::model
