#pragma once

// Private to this room: a slot's mesh, its lamps and what the cameras see of it, for PhotometricStereo.

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "capture/rig.hpp"
#include "facet/frame_set.hpp"
#include "maths/threads.hpp"
#include "mesh/hierarchy.hpp"

namespace facet::booth {

/// A projector or lamp as skin sees it.
struct Lamp {
  std::string name;
  Eigen::Vector3f at_mm{0, 0, 0};
  Eigen::Vector3f axis{0, 0, 0};  ///< of a projector, whose field is flat across it; 0: a lamp
  float reference_mm = 1000;      ///< where it gives its strength
  float strength = 1;

  /// Light at a place that faces it, times the direction to it.
  Eigen::Vector3f towards(const Eigen::Vector3f& from_mm) const;
};

/// The rig's projectors, then its lights.
std::vector<Lamp> lamps_of(const capture::Rig& rig);

/// A lamp that shines in a slot, by a strength of that slot: projectors are not as bright in every picture.
struct Shining {
  std::size_t lamp;
  std::size_t strength;  ///< index into the strengths
};

/// Calls work(vertex) for each of `count` vertices, on two threads.
template <typename Work>
void for_each_vertex(Eigen::Index count, const Work& work) {
  constexpr Eigen::Index kPiece = 4096;
  maths::for_each_piece(static_cast<std::size_t>((count + kPiece - 1) / kPiece), 2,
                        [&](std::size_t, std::size_t piece) {
                          const Eigen::Index begin = static_cast<Eigen::Index>(piece) * kPiece;
                          for (Eigen::Index v = begin; v < std::min(count, begin + kPiece); ++v) {
                            work(v);
                          }
                        });
}

/// One slot's pictures, light and mesh.
struct LitMesh {
  const FrameSet* set = nullptr;
  std::string light;           ///< what it is lit by, of all slots like it
  std::vector<Shining> lamps;  ///< that shine
  mesh::Vertices template_mm;
  mesh::Vertices vertices_mm;  ///< [3][finest]
  /// [3][finest]; the axes of each vertex's tangent plane go with the skin.
  Eigen::Matrix3Xf normals, first_axes, second_axes;
  std::vector<Eigen::Matrix3Xf> towards;  ///< [lamps] Lamp::towards [3][finest], 0 in shadow
  Eigen::VectorXf shadowless;             ///< [finest] 1; 0 at the rim of a shadow
  Eigen::MatrixXf brightness;             ///< [cameras][finest]
  Eigen::MatrixXf weight;                 ///< [cameras][finest] 0 to 1

  /// Positions, normals and axes of the template with displacements.
  void stand_on(const mesh::Hierarchy& hierarchy, const std::vector<float>& displacements_mm);
  /// What each of its lamps gives each vertex of the skin, and where a shadow's rim makes that uncertain.
  void cast_shadows(const mesh::Level& fine, const std::vector<Lamp>& all,
                    const std::vector<std::uint8_t>& is_skin);
  /// 0 where a lamp's light is mirrored towards a camera (to_camera: unit), 1 well away from there; after
  /// cast_shadows.
  float unmirrored(Eigen::Index v, const Eigen::Vector3f& to_camera) const;
  /// What the cameras see of each vertex of the skin.
  void look(const mesh::Level& fine, const capture::Rig& rig, const std::vector<std::uint8_t>& is_skin);
};

}  // namespace facet::booth
