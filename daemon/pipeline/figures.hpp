#pragma once

#include <array>
#include <chrono>
#include <cstddef>

#include "facet/clock.hpp"
#include "pipeline/status.hpp"

namespace facet::pipeline {

/// The last values of one quantity. Fixed memory.
class Window {
 public:
  static constexpr std::size_t kLength = 128;

  void add(float value);
  float mean() const;             ///< 0 where empty
  float quantile(float p) const;  ///< p 0 to 1, nearest value; 0 where empty

 private:
  std::array<float, kLength> values_{};
  std::size_t count_ = 0;
  std::size_t next_ = 0;
};

/// Moving figures over the last frames. Not thread-safe: the owner locks.
class MovingFigures {
 public:
  void add(const mesh::MeshFrame& frame, Clock::time_point handed_out);
  /// Of what has no mesh.
  void add(const mesh::StageTimes& times, Clock::time_point handed_out);
  /// Fills frames_per_second, stages, histograms and photometric_rms.
  void fill(PipelineStatus& status) const;

 private:
  std::array<Window, kStages.size()> stages_;
  std::array<Histogram, kStages.size()> histograms_;
  Window photometric_rms_;
  Window between_s_;
  Clock::time_point last_;
};

}  // namespace facet::pipeline
