#include "track/landmark_model.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

#include "facet/error.hpp"

namespace facet::track {
namespace {

/// Fewer anchored landmarks than this can't tell pose, focal length and expression apart.
constexpr std::size_t kFewestLandmarks = 40;

std::vector<int> anchored_landmarks(const face::FaceModel& model) {
  std::vector<int> anchored;
  for (std::size_t index = 0;
       index < model.landmarks.size() && static_cast<int>(index) < landmark::landmark_count; ++index) {
    const auto& weights = model.landmarks[index].weights;
    if (weights[0] != 0.0F || weights[1] != 0.0F || weights[2] != 0.0F) {
      anchored.push_back(static_cast<int>(index));
    }
  }
  return anchored;
}

/// Where the gaze of the mean face leaves an eyeball, straight ahead of its centre: a point of one of its
/// triangles. All weights 0 where the model has no eyeball that the shape `aside` turns.
face::LandmarkAnchor pupil(const face::FaceModel& model, const std::string& aside) {
  face::LandmarkAnchor anchor;
  const int expression = model.expression_index(aside);
  if (expression < 0) {
    return anchor;
  }
  constexpr float kTurnedMm = 0.5F;
  const auto turned = model.core_row(0, 1 + expression);
  const auto neutral = model.core_row(0, 0);
  const auto of_eyeball = [&](std::int32_t v) {
    return face::has_region(model.regions[static_cast<std::size_t>(v)], face::Region::Eye) &&
           turned.col(v).norm() > kTurnedMm;
  };
  // The poles of the turn stand still, so the centre is that of the box and not of the vertices.
  Eigen::Array3f low = Eigen::Array3f::Constant(std::numeric_limits<float>::max());
  Eigen::Array3f high = -low;
  for (std::int32_t v = 0; v < model.vertex_count(); ++v) {
    if (of_eyeball(v)) {
      low = low.min(neutral.col(v).array());
      high = high.max(neutral.col(v).array());
    }
  }
  const Eigen::Vector3f centre = 0.5F * (low + high);
  for (Eigen::Index q = 0; q < model.control.quads.cols(); ++q) {
    for (const auto& corners : {std::array{0, 1, 2}, std::array{0, 2, 3}}) {
      Eigen::Matrix3f from_centre;
      bool inside = true;
      for (int c = 0; c < 3; ++c) {
        const std::int32_t v = model.control.quads(corners[static_cast<std::size_t>(c)], q);
        anchor.vertices[static_cast<std::size_t>(c)] = v;
        inside = inside && of_eyeball(v);
        from_centre.col(c) = neutral.col(v) - centre;
      }
      if (!inside || std::abs(from_centre.determinant()) < 1e-6F) {
        continue;
      }
      const Eigen::Vector3f weights = from_centre.inverse() * Eigen::Vector3f::UnitZ();
      if (weights.minCoeff() >= 0) {
        const Eigen::Vector3f shares = weights / weights.sum();
        std::copy(shares.begin(), shares.end(), anchor.weights.begin());
        return anchor;
      }
    }
  }
  return anchor;
}

}  // namespace

LandmarkModel::LandmarkModel(const face::FaceModel& model)
    : landmarks_(anchored_landmarks(model)),
      position_of_(std::size_t{landmark::kLeftIris} + 1, -1),
      identity_count_(model.identity_count()),
      expression_count_(model.expression_count()) {
  if (landmarks_.size() < kFewestLandmarks) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("the face model '{}' has {} landmarks with a place on it, the tracker needs {}: build it "
                    "again with `facet model build`",
                    model.name, landmarks_.size(), kFewestLandmarks));
  }
  const std::vector<Eigen::MatrixXf> core_rows = model.core_at(landmarks_);
  const auto block =
      static_cast<std::size_t>(identity_count_ + 1) * 3 * static_cast<std::size_t>(expression_count_ + 1);
  core_mm_.resize(landmarks_.size() * block);
  for (std::size_t l = 0; l < landmarks_.size(); ++l) {
    position_of_[static_cast<std::size_t>(landmarks_[l])] = static_cast<int>(l);
    Eigen::Map<Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(
        core_mm_.data() + l * block, Eigen::Index{3} * (identity_count_ + 1), expression_count_ + 1) =
        core_rows[l];
  }
  const face::LandmarkAnchor pupils[] = {pupil(model, "eyeLookOutRight"), pupil(model, "eyeLookOutLeft")};
  if (pupils[0].weights[0] + pupils[0].weights[1] > 0 && pupils[1].weights[0] + pupils[1].weights[1] > 0) {
    for (int side = 0; side < 2; ++side) {
      position_of_[static_cast<std::size_t>(landmark::kRightIris + side)] = count();
      landmarks_.push_back(landmark::kRightIris + side);
      for (int i = 0; i <= identity_count_; ++i) {
        for (int axis = 0; axis < 3; ++axis) {
          for (int e = 0; e <= expression_count_; ++e) {
            float mm = 0;
            for (std::size_t c = 0; c < 3; ++c) {
              mm += pupils[side].weights[c] * model.core_row(i, e)(axis, pupils[side].vertices[c]);
            }
            core_mm_.push_back(mm);
          }
        }
      }
    }
  }
  const int right = position_of(landmark::kRightEyeOuterCorner);
  const int left = position_of(landmark::kLeftEyeOuterCorner);
  if (right < 0 || left < 0) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("the face model '{}' has no place for the outer eye corners (landmarks {} and {}): build "
                    "it again with `facet model build`",
                    model.name, landmark::kRightEyeOuterCorner, landmark::kLeftEyeOuterCorner));
  }
  const auto neutral = [&](int l) {
    return Eigen::Vector3f(core_rows[static_cast<std::size_t>(l)].block<3, 1>(0, 0));
  };
  interocular_mm_ = static_cast<double>((neutral(right) - neutral(left)).norm());
}

void LandmarkModel::contract_identity(const Eigen::VectorXd& identity, LandmarkBasis& basis) const {
  using Block = Eigen::Map<const Eigen::Matrix<float, 3, Eigen::Dynamic, Eigen::RowMajor>>;
  const int modes = expression_count_ + 1;
  const Eigen::Index rows = Eigen::Index{3} * count();
  basis.neutral_mm.resize(rows);
  basis.bias_mm.setZero(rows);
  basis.deltas_mm.resize(rows, expression_count_);
  const float* core = core_mm_.data();
  for (Eigen::Index l = 0; l < count(); ++l) {
    auto neutral = basis.neutral_mm.segment<3>(3 * l);
    auto deltas = basis.deltas_mm.middleRows<3>(3 * l);
    for (int i = 0; i <= identity_count_; ++i) {
      const Block block(core, 3, modes);
      const double weight = i == 0 ? 1.0 : identity[i - 1];
      if (i == 0) {
        neutral = block.col(0).cast<double>();
        deltas = block.rightCols(expression_count_).cast<double>();
      } else if (weight != 0.0) {
        neutral += weight * block.col(0).cast<double>();
        deltas += weight * block.rightCols(expression_count_).cast<double>();
      }
      core += std::ptrdiff_t{3} * modes;
    }
  }
}

void LandmarkModel::contract_expression(
    const Eigen::VectorXd& expression,
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>& by_identity_mm) const {
  using Row = Eigen::Map<const Eigen::VectorXf>;
  const int modes = expression_count_ + 1;
  by_identity_mm.resize(Eigen::Index{3} * count(), identity_count_);
  const float* core = core_mm_.data();
  for (Eigen::Index l = 0; l < count(); ++l) {
    core += std::ptrdiff_t{3} * modes;  // the mean
    for (int i = 0; i < identity_count_; ++i) {
      for (int axis = 0; axis < 3; ++axis, core += modes) {
        by_identity_mm(3 * l + axis, i) =
            static_cast<double>(*core) + Row(core + 1, expression_count_).cast<double>().dot(expression);
      }
    }
  }
}

}  // namespace facet::track
