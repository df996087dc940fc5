#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "capture/depth_map.hpp"
#include "facet/frame.hpp"
#include "gpu/context.hpp"
#include "simulation/virtual_booth.hpp"
#include "stereo/stereo_matcher.hpp"

namespace facet::bench {

/// The truth as a perfect pair would give it, plus white noise.
capture::DepthMap depth_of(const simulation::TruthMesh& truth, capture::Lens lens, double noise_mm,
                           std::mt19937_64& random);

/// What a sensor adds anew to each picture of the same thing.
void add_noise(Frame& frame, std::mt19937_64& random);

/// What stereo makes of a blank slot with two slots on either side.
class StereoDepth {
 public:
  StereoDepth(gpu::Context& context, const simulation::VirtualBooth& booth);

  /// [pair_count]
  std::vector<capture::DepthMap> at(std::uint64_t blank);

 private:
  static constexpr int kSlots = 5;
  const simulation::VirtualBooth& booth_;
  std::vector<std::unique_ptr<stereo::StereoMatcher>> matchers_;
  std::vector<capture::DepthMap> maps_;
};

/// The booth's slots, kept in a folder where one is given: rendering takes longer than all that is measured.
class Footage {
 public:
  Footage(const simulation::VirtualBooth& booth, std::filesystem::path folder);

  simulation::TruthMesh truth(std::uint64_t slot) const;
  Frame picture(std::uint64_t slot, std::size_t camera) const;
  /// Of both pairs; matchers is asked where the folder does not hold it.
  std::vector<capture::DepthMap> stereo(std::uint64_t slot, StereoDepth& matchers) const;

 private:
  std::vector<char> kept(const std::string& name, const std::function<std::vector<char>()>& make) const;

  const simulation::VirtualBooth& booth_;
  std::filesystem::path folder_;
  mesh::Triangles triangles_;
  mutable std::vector<capture::DepthMap> maps_;
  mutable std::uint64_t maps_slot_ = 0;
};

}  // namespace facet::bench
