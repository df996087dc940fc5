#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "facet/frame.hpp"
#include "light/head_visibility.hpp"
#include "mesh/hierarchy.hpp"
#include "shaders/common/layout.h"

namespace facet::refine {

/// The light of the room in which the camera stands: in every direction of light::room_directions() a lamp
/// far away and one half a metre away, none of which takes light away, each hidden from what the head itself
/// covers. Spherical harmonics [MD19 eq. 1] know neither shadows of the nose and the brow nor that a lamp
/// cannot shine from behind; here
///   E_i(n) = sum over lamps of c_d V_id max(0, n . w_d),   c_d >= 0    [SKS02], without bounces,
/// with the visibility V of light::HeadVisibility (a near lamp's fades with the square of its distance). The
/// strengths c stand still in the camera's frame while the head turns under them; they follow from what
/// frames show of M0's skin, by robust non-negative least squares over the last seconds. What the refiner
/// needs of it is E as a linear function of the normal about the coarse one: a_i + b_i . n, four numbers a
/// vertex of M0. On the CPU; one thread.
class RoomLight {
 public:
  /// What belongs to one subject.
  ///
  /// counts       [M0's vertex count] 0 to 1: what the skin there says of the light
  /// albedo       [3][M0's vertex count] linear RGB: the model's mean, or the skin's where it is known
  RoomLight(std::shared_ptr<const mesh::Hierarchy> hierarchy, std::vector<float> counts,
            mesh::Vertices albedo);

  /// Looks at a frame and sets irradiance() for it. Of the first frame that shows enough of the face the
  /// strengths are solved at once (0.1 s), then followed at every eighth (where no lamps explain it, tried
  /// anew there); where six in a row are not what the lamps predict, they are found anew, and kept where
  /// nothing better is found (a hand before the face). Without a picture the light stays and follows the head
  /// alone; of a broken mesh nothing is said. Allocates half a megabyte, and several where strengths are
  /// solved.
  ///
  /// control_mm         [control_vertex_count] shading frame, as the refiner uploads it
  /// shading_from_head  rotation
  void look(const Frame& image, const CameraIntrinsics& camera, std::span<const shaders::vec4> control_mm,
            const Eigen::Matrix3f& shading_from_head);

  /// Forgets the lamps, not the head: another room, or a cut.
  void forget();

  /// [M0's vertex count] in the hierarchy's order: a, b of the frame looked at last. All 0 before.
  const std::vector<shaders::vec4>& irradiance() const { return irradiance_; }

  /// The nine coefficients of [MD19 eq. 1] that come nearest to irradiance() on the skin that faces the
  /// camera.
  std::array<float, 9> harmonics() const;

  /// Of the last frame looked at: weight that the robust fit believes, 0 to 1.
  double believed() const { return believed_; }

 private:
  struct Rows;
  Eigen::Vector3f middle() const;
  bool place(std::span<const shaders::vec4> control_mm, const Eigen::Matrix3f& shading_from_head);
  void sample(const Frame& image, const CameraIntrinsics& camera, const Eigen::Matrix3f& shading_from_head,
              Rows& rows) const;
  Eigen::MatrixXf lamps_of(const Rows& rows) const;
  void learn(const Rows& rows, const Eigen::MatrixXd& head_from_room);
  void compare(const Rows& rows);
  void solve(const Rows& rows, const Eigen::MatrixXd& head_from_room);
  void find_anew(const Rows& rows, const Eigen::MatrixXd& head_from_room);
  void spread(const Eigen::VectorXd& head_strengths, const Eigen::Matrix3f& shading_from_head);

  /// What frames have said of the lamps, far and then near ones in light::room_directions() of the shading
  /// frame, in units of the picture in which they were found.
  struct Known {
    Eigen::MatrixXd matrix;  ///< normal equations
    Eigen::VectorXd right;
    Eigen::VectorXd strengths;
    double usually_believed = 0;
  };

  std::shared_ptr<const mesh::Hierarchy> hierarchy_;
  std::vector<float> counts_;
  mesh::Vertices albedo_;
  std::vector<std::int32_t> looked_at_;  ///< vertices that rows are made of

  light::HeadVisibility visibility_;
  mesh::Vertices control_mm_;   ///< shading frame
  mesh::Vertices vertices_mm_;  ///< of M0, shading frame
  Eigen::Matrix3Xf normals_;    ///< shading frame
  Eigen::Matrix3Xf head_normals_;
  Eigen::Matrix3Xf head_mm_;  ///< of M0, turned as the head is, from its middle on

  Known known_;
  double believed_ = 0;
  double gain_ = 1;
  std::uint64_t frames_ = 0;  ///< since the lamps were found
  int doubtful_ = 0;          ///< frames in a row
  std::vector<shaders::vec4> irradiance_;
};

}  // namespace facet::refine
