#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "gpu/context.hpp"
#include "gpu/shader.hpp"

namespace facet::gpu {

/// A value for a specialization constant, by the name it has in the shader. The workgroup size, where the
/// shader sets it with `local_size_x_id`, is called "local_size_x" (y, z).
struct Constant {
  Constant(std::string_view constant_name, std::uint32_t value)
      : name(constant_name), bits(value), type(ConstantType::Uint) {}
  Constant(std::string_view constant_name, std::int32_t value)
      : name(constant_name), bits(std::bit_cast<std::uint32_t>(value)), type(ConstantType::Int) {}
  Constant(std::string_view constant_name, float value)
      : name(constant_name), bits(std::bit_cast<std::uint32_t>(value)), type(ConstantType::Float) {}
  Constant(std::string_view constant_name, bool value)
      : name(constant_name), bits(value ? 1U : 0U), type(ConstantType::Bool) {}

  std::string_view name;
  std::uint32_t bits;
  ConstantType type;
};

/// A compute pipeline. Bindings, push constants and specialization constants are known by the names the
/// shader gives them; see Batch::dispatch. Immutable: any thread.
class Kernel {
 public:
  /// Compiles set[name]. Throws Error(Internal) where the set has no such kernel, a constant is unknown or of
  /// another type, or the kernel asks for more than the device has; the message lists the names there are.
  Kernel(Context& context, ShaderSet set, std::string_view name,
         std::initializer_list<Constant> constants = {});
  Kernel(Context& context, ShaderSet set, std::string_view name, std::span<const Constant> constants);
  ~Kernel();
  Kernel(Kernel&&) noexcept;
  Kernel& operator=(Kernel&&) noexcept;

  const std::string& name() const;
  /// With the constants given.
  std::array<std::uint32_t, 3> workgroup_size() const;
  /// What the shader declares.
  const ShaderInterface& interface() const;

  struct Impl;
  const Impl& impl() const { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::gpu
