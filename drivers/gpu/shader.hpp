#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

namespace facet::gpu {

enum class BindingType {
  StorageBuffer,
  UniformBuffer,
  TexelBuffer,
  SampledImage,
  StorageImage,
  StorageTexels
};

/// One resource that a kernel reads or writes.
struct BindingInfo {
  std::string_view name;  ///< that the shader's code uses: the variable's, of a block its one member's
  BindingType type = BindingType::StorageBuffer;
  std::uint32_t binding = 0;
  bool read = true;      ///< false where declared writeonly
  bool written = false;  ///< false where declared readonly, and for what cannot be written
};

enum class ConstantType { Bool, Int, Uint, Float };

/// One specialization constant.
struct ConstantInfo {
  std::string_view name;
  ConstantType type = ConstantType::Uint;
  std::uint32_t id = 0;
};

/// What a compute shader declares; read out of it when it is built.
struct ShaderInterface {
  std::span<const BindingInfo> bindings;                 ///< all in descriptor set 0, by binding number
  std::span<const ConstantInfo> constants;               ///< 32-bit scalars and bool
  std::size_t push_constant_bytes = 0;                   ///< end of the last member, 0 where there are none
  std::array<std::uint32_t, 3> workgroup_size{1, 1, 1};  ///< by default
  /// Which constant sets each extent of the workgroup: index into constants, or -1 where it is fixed.
  std::array<int, 3> workgroup_size_constant{-1, -1, -1};
};

/// One embedded kernel as facet_shaders() (cmake/FacetShaders.cmake) builds it. Its entry point is "main".
struct Shader {
  std::string_view name;  ///< path below shaders/ without its ending: "refine/linearise"
  std::span<const std::uint32_t> words;
  ShaderInterface interface;
};

/// All kernels of one room: `facet::shaders::refine::kernels()` from the generated "refine_shaders.hpp".
using ShaderSet = std::span<const Shader>;

}  // namespace facet::gpu
