#pragma once

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include "model/head_mesh.hpp"
#include "model/makehuman_data.hpp"

namespace facet::model {

/// One sampled adult: a neutral head and the mixture of ethnicities that its expressions follow.
struct Identity {
  Eigen::Matrix3Xd neutral_mm;        ///< [3][vertex_count] in the head frame of the base mesh
  std::array<double, 3> ethnicity{};  ///< weights of kEthnicities, sum 1
};

inline constexpr std::array<const char*, 3> kEthnicities = {"african", "asian", "caucasian"};

/// Draws adults from MakeHuman's sliders: ethnicity and gender, the face sliders (left and right tied), their
/// asymmetric targets. The child, baby and old macros and the eye size are left out: the package's differ
/// from the CC0 release. Deterministic for a seed.
class IdentitySampler {
 public:
  /// Reads the sliders from the package's modifier list. Throws Error(UnreadableInput) naming the file.
  IdentitySampler(const std::filesystem::path& folder, const MakeHumanTargets& targets,
                  const MakeHumanMesh& base, const HeadMesh& head, const HeadFrame& frame);

  Identity draw(std::mt19937_64& random) const;
  /// All sliders at rest, the three ethnicities and both genders in their mean proportion.
  Identity average() const;
  int slider_count() const { return static_cast<int>(sliders_.size()); }

 private:
  /// One slider, -1 to 1: below 0 it adds low, above 0 high, times the value. Displacements in mm.
  struct Slider {
    Eigen::Matrix3Xf low_mm;
    Eigen::Matrix3Xf high_mm;
    double sigma = 0;
    bool one_sided = false;
  };

  Identity compose(const std::array<double, 3>& ethnicity, double male) const;

  Eigen::Matrix3Xd base_mm_;
  std::array<std::array<Eigen::Matrix3Xd, 2>, 3> macro_mm_;  // [ethnicity][female, male]
  std::vector<Slider> sliders_;
};

}  // namespace facet::model
