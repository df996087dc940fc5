#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "face/face_model.hpp"
#include "mesh/mesh.hpp"

namespace facet::model {

/// Vertices and quads of a Wavefront OBJ file; faces of other sizes are counted and left out.
struct ObjMesh {
  Eigen::Matrix3Xd vertices;  ///< [3][vertex_count], the file's unit
  mesh::Quads quads;          ///< [4][quad_count]
  std::size_t other_faces = 0;
};

/// The mesh in an OBJ file's text; `file` names it in messages. Throws Error(UnreadableInput) that says what
/// is wrong: no vertex, a number that is not finite, a quad that names a vertex that is not there.
ObjMesh parse_obj(std::string_view text, const std::filesystem::path& file);

struct IctOptions {
  std::filesystem::path folder;  ///< FaceXModel of ICT-FaceKit, or the folder that it lies in
  int identity_modes = 40;       ///< the first so many; the core takes about 8 MB of memory for each
};

struct IctReport {
  int identity_modes = 0;                ///< read, the mean not counted
  std::vector<std::string> expressions;  ///< ARKit names that were found
  std::vector<std::string> missing;      ///< ARKit names that the folder has no shape for
};

/// Makes a model of ICT-FaceKit's files ([LBZ20], light): generic_neutral_mesh.obj, identityNNN.obj
/// and one file an expression, all of one topology in centimetres. The head is cut to face, inner mouth,
/// sockets and the eyeballs' outer layer; shapes are the files' differences to the neutral mesh, identity
/// modes count in standard deviations, and identity does not change expressions (zero rows, as ICT's own
/// model). Expressions get their ARKit names: NAME_L and NAME_R become NAMELeft and NAMERight, or are added
/// up where ARKit knows one for both sides. Without landmarks; the albedo is plain skin. Deterministic.
/// progress(done, total) after every file. Throws Error(UnreadableInput) where a file is missing or not of
/// the known topology.
face::FaceModel import_ict(const IctOptions& options,
                           const std::function<void(int done, int total)>& progress, IctReport& report);

/// Gives a model's skin the mean albedo of another one: aligned by a similarity of their landmarks, each
/// vertex takes the donor's nearest point. Both must have landmarks, else Error(Usage).
void borrow_albedo(const face::FaceModel& donor, face::FaceModel& model);

}  // namespace facet::model
