#include "maths/alignment.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>

namespace facet::maths {

Similarity best_similarity(const Eigen::Matrix3Xf& from_mm, const Eigen::Matrix3Xf& to_mm, bool with_scale) {
  Similarity best;
  if (from_mm.cols() < 3) {
    return best;
  }
  // Sums over 100,000 points want double.
  const Eigen::Matrix3Xd from = from_mm.cast<double>();
  const Eigen::Matrix3Xd to = to_mm.cast<double>();
  const Eigen::Vector3d from_mean = from.rowwise().mean();
  const Eigen::Vector3d to_mean = to.rowwise().mean();
  const Eigen::Matrix3Xd from_centred = from.colwise() - from_mean;
  const Eigen::Matrix3d covariance = (to.colwise() - to_mean) * from_centred.transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d sign = Eigen::Vector3d::Ones();
  if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0) {
    sign.z() = -1;  // a mirror image would fit better, but it is not a motion
  }
  const Eigen::Matrix3d rotation = svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
  const double spread = from_centred.squaredNorm();
  const double scale = with_scale && spread > 0 ? svd.singularValues().dot(sign) / spread : 1.0;
  best.scale = static_cast<float>(scale);
  best.rotation = rotation.cast<float>();
  best.translation_mm = (to_mean - scale * rotation * from_mean).cast<float>();
  return best;
}

}  // namespace facet::maths
