#include "person/skin_light.hpp"

#include <algorithm>
#include <numeric>

namespace facet::person {
namespace {

constexpr Eigen::Index kBlock = 2048;  ///< texels at a time: their lamps' rows stay in the cache
/// Of the strongest lamp, below which a lamp is left out.
constexpr float kNoLamp = 1e-3F;
constexpr int kDirections = light::kRoomDirections;

}  // namespace

/// far, near  [texels] what a lamp of strength 1 gives, or its derivative by the cosine
void SkinLight::lit(std::span<const std::int32_t> texels, int direction, Of of, float* far,
                    float* near) const {
  const Eigen::Vector3f towards = light::room_directions().col(direction);
  const std::uint8_t* const seen = visibility_.of_direction(direction);
  for (std::size_t t = 0; t < texels.size(); ++t) {
    const std::int32_t i = texels[t];
    const light::Clamped clamped = light::clamped(texels_.normals.col(i).dot(towards));
    far[t] = of == Of::Value ? clamped.value : clamped.slope;
    near[t] = 0;
    if (far[t] > 0) {
      const Eigen::Vector3i corners = texels_.corners.col(i);
      const Eigen::Vector3f open(seen[corners[0]], seen[corners[1]], seen[corners[2]]);
      const auto at = texels_.positions_mm.col(i);
      far[t] *= texels_.shares.col(i).dot(open) / 255;
      near[t] = far[t] * light::falloff(at.dot(towards), at.squaredNorm());
    }
  }
}

Eigen::MatrixXf SkinLight::rows(std::span<const std::int32_t> texels) const {
  Eigen::MatrixXf lamps(static_cast<Eigen::Index>(texels.size()), light::kLamps);
  for (int d = 0; d < kDirections; ++d) {
    lit(texels, d, Of::Value, lamps.col(d).data(), lamps.col(kDirections + d).data());
  }
  return lamps.transpose();
}

Eigen::MatrixXf SkinLight::in_head(const Eigen::MatrixXd& lamps) const {
  Eigen::MatrixXf out(light::kLamps, static_cast<Eigen::Index>(head_from_camera_.size()));
  for (std::size_t k = 0; k < head_from_camera_.size(); ++k) {
    out.col(static_cast<Eigen::Index>(k)) =
        light::turned(head_from_camera_[k], lamps.col(rooms_[k])).cast<float>();
  }
  return out;
}

/// strengths  [kLamps][columns]
/// call       with a first texel, a count and [count][columns] what these lamps give
template <typename Call>
void SkinLight::each_block(const Eigen::MatrixXf& strengths, Of of, Call&& call) const {
  const float least = kNoLamp * strengths.cwiseAbs().maxCoeff();
  std::vector<int> directions;
  for (int d = 0; d < kDirections; ++d) {
    if (strengths.row(d).cwiseAbs().maxCoeff() > least ||
        strengths.row(kDirections + d).cwiseAbs().maxCoeff() > least) {
      directions.push_back(d);
    }
  }
  const auto count = static_cast<Eigen::Index>(directions.size());
  Eigen::MatrixXf chosen(2 * count, strengths.cols());
  for (Eigen::Index j = 0; j < count; ++j) {
    chosen.row(2 * j) = strengths.row(directions[static_cast<std::size_t>(j)]);
    chosen.row(2 * j + 1) = strengths.row(kDirections + directions[static_cast<std::size_t>(j)]);
  }
  std::vector<std::int32_t> texels(kBlock);
  Eigen::MatrixXf lamps;
  for (Eigen::Index first = 0; first < texels_.count(); first += kBlock) {
    texels.resize(static_cast<std::size_t>(std::min(kBlock, texels_.count() - first)));
    std::iota(texels.begin(), texels.end(), static_cast<std::int32_t>(first));
    lamps.resize(static_cast<Eigen::Index>(texels.size()), 2 * count);
    for (Eigen::Index j = 0; j < count; ++j) {
      lit(texels, directions[static_cast<std::size_t>(j)], of, lamps.col(2 * j).data(),
          lamps.col(2 * j + 1).data());
    }
    call(first, lamps.rows(), (lamps * chosen).eval());
  }
}

Eigen::MatrixXf SkinLight::shading(const Eigen::MatrixXd& lamps) const {
  const Eigen::MatrixXf strengths = in_head(lamps);
  Eigen::MatrixXf out(strengths.cols(), texels_.count());
  each_block(strengths, Of::Value, [&](Eigen::Index first, Eigen::Index count, const Eigen::MatrixXf& given) {
    out.middleCols(first, count) = given.transpose();
  });
  return out;
}

void SkinLight::slopes(const Eigen::MatrixXd& lamps, Eigen::MatrixXf& slope_u,
                       Eigen::MatrixXf& slope_v) const {
  const Eigen::MatrixXf strengths = in_head(lamps);
  const Eigen::Index keyframes = strengths.cols();
  // Three columns of each keyframe: the derivative by the normal.
  Eigen::MatrixXf gradients(light::kLamps, 3 * keyframes);
  for (int lamp = 0; lamp < light::kLamps; ++lamp) {
    for (Eigen::Index k = 0; k < keyframes; ++k) {
      gradients.block<1, 3>(lamp, 3 * k) =
          strengths(lamp, k) * light::room_directions().col(lamp % kDirections).transpose();
    }
  }
  slope_u.resize(keyframes, texels_.count());
  slope_v.resize(keyframes, texels_.count());
  each_block(gradients, Of::Slope, [&](Eigen::Index first, Eigen::Index count, const Eigen::MatrixXf& given) {
    for (Eigen::Index i = 0; i < count; ++i) {
      for (Eigen::Index k = 0; k < keyframes; ++k) {
        const Eigen::Vector3f by_normal = given.block<1, 3>(i, 3 * k).transpose();
        slope_u(k, first + i) = -by_normal.dot(texels_.along_u.col(first + i));
        slope_v(k, first + i) = -by_normal.dot(texels_.along_v.col(first + i));
      }
    }
  });
}

}  // namespace facet::person
