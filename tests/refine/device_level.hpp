#pragma once

#include <algorithm>
#include <cstring>
#include <span>
#include <vector>

#include "gpu/batch.hpp"
#include "problems.hpp"
#include "refine/level_buffers.hpp"
#include "shaders/refine/layout.h"

namespace facet::refine::test {

using shaders::vec4;

/// Values behind the vertices of every array, which no kernel may touch.
constexpr std::uint32_t kTailCount = 67;
constexpr float kTail = -12345.5F;

template <typename T>
std::vector<T> read(gpu::Context& context, const gpu::Buffer& buffer) {
  std::vector<T> values(buffer.size_bytes() / sizeof(T));
  gpu::download(context, buffer, std::span<T>(values));
  return values;
}

/// Writes values to the start of a buffer and the tail's value to all that follows.
template <typename T>
void write(gpu::Context& context, const gpu::Buffer& buffer, const std::vector<T>& values) {
  std::vector<float> all(buffer.size_bytes() / sizeof(float), kTail);
  std::memcpy(all.data(), values.data(), values.size() * sizeof(T));
  gpu::upload(context, buffer, std::span<const float>(all));
}

/// Whether everything from `count` values of T on still is the tail.
template <typename T>
bool tail_intact(gpu::Context& context, const gpu::Buffer& buffer, std::size_t count) {
  const std::vector<float> all = read<float>(context, buffer);
  return std::all_of(all.begin() + static_cast<std::ptrdiff_t>(count * sizeof(T) / sizeof(float)), all.end(),
                     [](float value) { return value == kTail; });
}

inline vec4 join(const Eigen::Vector3d& v, double fourth) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z()),
          static_cast<float>(fourth)};
}
inline Eigen::Vector3d head(const vec4& v) {
  return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
}

/// A small problem's level on the device, its arrays longer than they need be, with tails.
struct DeviceLevel {
  DeviceLevel(gpu::Context& context, const SmallProblem& small)
      : topology(context, *small.problem.rings, small.free(), small.curve(), {}, 20),
        state(context, topology.vertex_count + kTailCount) {
    const reference::Problem& problem = small.problem;
    std::vector<vec4> positions;
    std::vector<vec4> normals;
    std::vector<vec4> colours;
    std::vector<vec4> albedo;
    std::vector<vec4> irradiance;
    std::vector<float> priors;
    for (Eigen::Index i = 0; i < problem.vertex_count(); ++i) {
      positions.push_back(join(problem.vertices_mm.col(i), small.start_mm[i]));
      normals.push_back(join(problem.normals.col(i), problem.spacing_mm[i]));
      colours.push_back(join(problem.colours.col(i), problem.data_weight[i]));
      albedo.push_back(join(problem.albedo.col(i), 1));
      irradiance.push_back(
          {static_cast<float>(problem.irradiance(0, i)), static_cast<float>(problem.irradiance(1, i)),
           static_cast<float>(problem.irradiance(2, i)), static_cast<float>(problem.irradiance(3, i))});
      priors.push_back(static_cast<float>(problem.prolonged_mm[i]));
    }
    write(context, state.positions.buffer, positions);
    write(context, state.normals.buffer, normals);
    write(context, state.colours.buffer, colours);
    write(context, state.albedo.buffer, albedo);
    write(context, state.irradiance.buffer, irradiance);
    write(context, state.priors.buffer, priors);
  }

  bool tails_intact(gpu::Context& context) const {
    const std::size_t count = topology.vertex_count;
    return tail_intact<vec4>(context, state.positions.buffer, count) &&
           tail_intact<vec4>(context, state.normals.buffer, count) &&
           tail_intact<vec4>(context, state.colours.buffer, count) &&
           tail_intact<vec4>(context, state.albedo.buffer, count) &&
           tail_intact<vec4>(context, state.irradiance.buffer, count) &&
           tail_intact<float>(context, state.priors.buffer, count);
  }

  LevelTopology topology;
  LevelState state;
};

}  // namespace facet::refine::test
