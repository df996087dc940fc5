#pragma once

// Private to this room: what the lamps of a room give the texels of a head's skin.

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "light/head_visibility.hpp"
#include "light/lamps.hpp"
#include "person/skin_texels.hpp"

namespace facet::person {

/// A head that turns under lamps that stay, and is still while others fire in turn: shading of its texels in
/// every keyframe, before the skin's albedo and the camera's exposure,
///   E_k = sum_d V_d clamped(n . w_d) ((T_k a)_d + (T_k b)_d falloff_d)
/// with the strengths a of far and b of near lamps in the camera's frame, those of the keyframe's room, and
/// how it changes with the normal. Borrows texels and visibility.
class SkinLight {
 public:
  /// head_from_camera  [keyframe] light::turned_lamps() of the rotations
  /// rooms             [keyframe] whose lamps it was lit by, from 0 on without a gap
  SkinLight(const SkinTexels& texels, const light::HeadVisibility& visibility,
            std::vector<Eigen::MatrixXd> head_from_camera, std::vector<Eigen::Index> rooms)
      : texels_(texels),
        visibility_(visibility),
        head_from_camera_(std::move(head_from_camera)),
        rooms_(std::move(rooms)) {}

  const Eigen::MatrixXd& head_from_camera(std::size_t keyframe) const { return head_from_camera_[keyframe]; }
  Eigen::Index room(std::size_t keyframe) const { return rooms_[keyframe]; }
  Eigen::Index room_count() const {
    return rooms_.empty() ? 0 : *std::max_element(rooms_.begin(), rooms_.end()) + 1;
  }

  /// [kLamps][texels] what lamps of the head's frame give some texels.
  Eigen::MatrixXf rows(std::span<const std::int32_t> texels) const;

  /// [kLamps][keyframes] strengths in the head's frame.
  Eigen::MatrixXf in_head(const Eigen::MatrixXd& lamps) const;

  /// E [keyframes][texel_count]. lamps  [kLamps][rooms] camera frame
  Eigen::MatrixXf shading(const Eigen::MatrixXd& lamps) const;

  /// What of E changes with a displacement that rises by 1 mm to the right and below,
  /// [keyframes][texel_count].
  void slopes(const Eigen::MatrixXd& lamps, Eigen::MatrixXf& slope_u, Eigen::MatrixXf& slope_v) const;

 private:
  enum class Of { Value, Slope };
  void lit(std::span<const std::int32_t> texels, int direction, Of of, float* far, float* near) const;
  template <typename Call>
  void each_block(const Eigen::MatrixXf& strengths, Of of, Call&& call) const;

  const SkinTexels& texels_;
  const light::HeadVisibility& visibility_;
  std::vector<Eigen::MatrixXd> head_from_camera_;
  std::vector<Eigen::Index> rooms_;
};

}  // namespace facet::person
