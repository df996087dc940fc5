#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace facet::gpu {

enum class BindingType { StorageBuffer, UniformBuffer, TexelBuffer, SampledImage, StorageImage };

/// One resource that a kernel reads or writes.
struct BindingInfo {
  /// The name that the shader's code uses: the variable's; for a block without an instance name its only
  /// member's, or the block's where it has several members.
  std::string name;
  BindingType type = BindingType::StorageBuffer;
  std::uint32_t binding = 0;
  bool read = true;      ///< false where declared writeonly
  bool written = false;  ///< false where declared readonly, and for what cannot be written
};

enum class ConstantType { Bool, Int, Uint, Float };

/// One specialization constant.
struct ConstantInfo {
  std::string name;
  ConstantType type = ConstantType::Uint;
  std::uint32_t id = 0;
  std::uint32_t default_bits = 0;
};

/// What a compute shader declares.
struct ShaderInterface {
  std::string entry_point;
  std::vector<BindingInfo> bindings;                     ///< all in descriptor set 0, by binding number
  std::vector<ConstantInfo> constants;                   ///< 32-bit scalars and bool
  std::size_t push_constant_bytes = 0;                   ///< end of the last member, 0 where there are none
  std::array<std::uint32_t, 3> workgroup_size{1, 1, 1};  ///< by default
  /// Which constant sets each extent of the workgroup: index into constants, or -1 where it is fixed.
  std::array<int, 3> workgroup_size_constant{-1, -1, -1};
};

/// Reads the interface out of a SPIR-V module with one compute entry point. Bounded: any words are safe to
/// pass. Throws Error(UnreadableInput) for what is not such a module or uses what Facet's shaders do not
/// (several descriptor sets, arrays of resources, 64-bit specialization constants).
ShaderInterface reflect(std::span<const std::uint32_t> words);

}  // namespace facet::gpu
