#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "person/enrolment.hpp"

namespace facet::person {

/// What is kept of a person who was enrolled: NAME.person, docs/person.md. It is biometric data. Immutable
/// once read; any thread.
struct PersonFile {
  std::string name;         ///< for people
  std::string created_utc;  ///< "2026-11-25T15:04:05Z"
  std::string software;
  std::string model_name;            ///< of the face model that it was found with
  std::uint64_t model_checksum = 0;  ///< of that model's topology, names and core
  int keyframes = 0;
  OrientationSpan span;  ///< degrees
  double focal_px = 0;   ///< of the camera it was seen by, for pictures of
  int width_px = 0;      ///< this size
  int height_px = 0;
  std::vector<Gate> gates;      ///< what they measured
  std::vector<float> identity;  ///< [identity_count] of the model's face that the solve began with
  mesh::Vertices neutral_mm;    ///< [3][vertex_count]
  std::vector<float> sigma_mm;  ///< [vertex_count] standard deviation along the normal; NaN: not known
  face::SkinChart skin;         ///< empty where nothing was found of it
};

/// What was learned of a head, as of now. Whoever keeps it gives it a name and says what software does.
PersonFile person_of(const face::FaceModel& model, const Observed& observed, const LearnedShape& learned);

/// What tells one face model from another, as a person is concerned.
std::uint64_t model_checksum(const face::FaceModel& model);

/// Nobody can be called so: kept for whoever of those stored is seen, should that once be recognised.
inline constexpr const char* kRecognised = "auto";

/// Whether a file begins as a person's, be the rest damaged or not. Throws Error(UnreadableInput) where it
/// can't be read.
bool begins_as_person(const std::filesystem::path& file);

/// Throws Error(UnreadableInput) naming the file and what is wrong.
PersonFile read_person(const std::filesystem::path& file);
PersonFile parse_person(std::span<const std::byte> bytes, const std::string& source);

/// Written whole or not at all, readable by its owner alone. Throws Error(Storage), and Error(Usage) where
/// the file is there already: nobody is replaced.
void write_person(const PersonFile& person, const std::filesystem::path& file);
/// The same in place of the file that `before` was read from, for who was enrolled once more. Throws
/// Error(Usage) where that is not what is there any more: who was deleted meanwhile stays so.
void replace_person(const PersonFile& person, const PersonFile& before, const std::filesystem::path& file);

/// Throws Error(Usage) naming both models where a person was found with another one. source: the person's
/// file, for messages.
void check_model(const PersonFile& person, const face::FaceModel& model, const std::string& source);

/// The person as a face model (face::person_model). Throws Error(Usage) naming both models where it was found
/// with another one. source: the person's file, for messages.
face::FaceModel model_of(const PersonFile& person, const face::FaceModel& model, const std::string& source);

}  // namespace facet::person
