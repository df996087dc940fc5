#include "FacetReader.h"

#include <facet-client.h>

namespace facet_unreal {
namespace {

/// From the head's axes (x to the subject's left, y up, z out of the face; mm) to Unreal's, scaled.
void to_unreal(const float* in, std::size_t count, float scale, std::vector<float>& out) {
  out.resize(3 * count);
  for (std::size_t k = 0; k < 3 * count; k += 3) {
    out[k] = scale * in[k + 2];
    out[k + 1] = -scale * in[k];
    out[k + 2] = scale * in[k + 1];
  }
}

}  // namespace

FacetReader::FacetReader(const std::string& socket)
    : client_(facet_client_new(socket.empty() ? nullptr : socket.c_str(), FACET_DISPLACEMENTS,
                               FACET_WANT_ALBEDO | FACET_WANT_RING | FACET_RECONNECT, "unreal")) {}

FacetReader::~FacetReader() {
  facet_client_free(client_);
}

const char* FacetReader::message() const {
  return client_ == nullptr ? "the socket's path is too long" : facet_client_message(client_);
}

bool FacetReader::poll() {
  const facet_mesh* mesh = nullptr;
  if (client_ == nullptr || facet_client_next(client_, 0) != FACET_OK ||
      facet_client_mesh(client_, &mesh) != FACET_OK) {
    return false;
  }
  const facet_frame& frame = *facet_client_frame(client_);
  if (frame.subject_id != face_.subject_id) {
    take_subject();
  }
  take_albedo();
  face_.sequence = frame.sequence;
  to_unreal(mesh->vertices_mm, mesh->vertex_count, 0.1F, face_.vertices_cm);
  to_unreal(mesh->normals, mesh->vertex_count, 1.0F, face_.normals);
  face_.avatar_values.assign(frame.avatar_values, frame.avatar_values + frame.expression_count);
  // The camera's axes (x right, y down, z forward) to Unreal's: x = z, y = x, z = -y. The head's: x = z, y =
  // -x, z = y.
  constexpr int kCamera[3] = {2, 0, 1};
  constexpr float kCameraSign[3] = {1, 1, -1};
  constexpr int kHead[3] = {2, 0, 1};
  constexpr float kHeadSign[3] = {1, -1, 1};
  for (std::size_t row = 0; row < 3; ++row) {
    for (std::size_t column = 0; column < 3; ++column) {
      face_.turn[row][column] =
          kCameraSign[row] * kHeadSign[column] * frame.camera_from_head[kCamera[row]][kHead[column]];
    }
  }
  return true;
}

void FacetReader::take_subject() {
  const facet_subject& subject = *facet_client_subject(client_);
  face_.subject_id = subject.id;
  face_.triangles.assign(subject.triangles, subject.triangles + 3 * std::size_t{subject.triangle_count});
  face_.texture_coordinates.assign(subject.texture_coordinates,
                                   subject.texture_coordinates + 2 * std::size_t{subject.vertex_count});
  for (std::size_t k = 1; k < face_.texture_coordinates.size(); k += 2) {
    face_.texture_coordinates[k] = 1.0F - face_.texture_coordinates[k];
  }
  face_.expression_names.assign(subject.expression_names,
                                subject.expression_names + subject.expression_count);
  face_.linear_rgb.clear();
  albedo_version_ = 0;
}

void FacetReader::take_albedo() {
  const facet_albedo* albedo = facet_client_albedo(client_);
  if (albedo == nullptr || albedo->subject_id != face_.subject_id || albedo->version == albedo_version_) {
    return;
  }
  albedo_version_ = albedo->version;
  face_.linear_rgb.resize(3 * albedo->vertex_count);
  for (std::size_t k = 0; k < face_.linear_rgb.size(); ++k) {
    face_.linear_rgb[k] = albedo->scale / 65535.0F * static_cast<float>(albedo->linear_rgb[k]);
  }
}

}  // namespace facet_unreal
