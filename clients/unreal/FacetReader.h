// A live face in Unreal's axes and units, over libfacet-client: the part of the sample that knows nothing of
// Unreal, so that it can be compiled and tested without it.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

struct facet_client;

namespace facet_unreal {

/// The newest frame. Unreal's axes on the head: x out of the face, y to the subject's right, z up
/// (left-handed); centimetres.
struct Face {
  std::uint64_t subject_id = 0;            ///< 0: no face yet; another one brings other triangles and names
  std::vector<std::int32_t> triangles;     ///< [triangle count][3] counter-clockwise from outside
  std::vector<float> texture_coordinates;  ///< [vertex count][2] u right, v down as Unreal counts
  std::vector<std::string> expression_names;  ///< ARKit's
  std::uint64_t sequence = 0;
  std::vector<float> vertices_cm;  ///< [vertex count][3]
  std::vector<float> normals;      ///< [vertex count][3] unit length
  std::vector<float> linear_rgb;   ///< [vertex count][3] albedo; empty until it is learned
  /// [expression_names.size()] 0 to 1: expression counted from the neutral pose and tuned, as far as facetd
  /// knows how.
  std::vector<float> avatar_values;
  /// The head's turn before a camera that looks along x (y right, z up): column k is where the head's axis k
  /// points.
  std::array<std::array<float, 3>, 3> turn{};
};

/// One thread at a time: Unreal's game thread. Never waits, throws nothing but std::bad_alloc.
class FacetReader {
 public:
  /// socket: where facetd listens; empty: what FACET_SOCKET names, else where the package's daemon does.
  explicit FacetReader(const std::string& socket);
  ~FacetReader();
  FacetReader(const FacetReader&) = delete;
  FacetReader& operator=(const FacetReader&) = delete;

  /// True where a frame with a mesh came since the last call: face() is it. A daemon that is away is waited
  /// for.
  bool poll();
  const Face& face() const { return face_; }
  /// For people: what went wrong last; "" where nothing did.
  const char* message() const;

 private:
  void take_subject();
  void take_albedo();

  facet_client* client_;
  Face face_;
  std::uint64_t albedo_version_ = 0;
};

}  // namespace facet_unreal
