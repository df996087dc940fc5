#include "gpu/spirv.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>
#include <map>
#include <optional>
#include <string_view>
#include <unordered_map>
#include <utility>

#include "facet/error.hpp"

namespace facet::gpu {

namespace {

// The part of the SPIR-V 1.5 specification that an interface needs: operation codes, decorations, storage
// classes and execution modes.
constexpr std::uint32_t magic_number = 0x07230203;
constexpr std::size_t header_words = 5;

enum Operation : std::uint32_t {
  OpName = 5,
  OpMemberName = 6,
  OpEntryPoint = 15,
  OpExecutionMode = 16,
  OpTypeBool = 20,
  OpTypeInt = 21,
  OpTypeFloat = 22,
  OpTypeVector = 23,
  OpTypeMatrix = 24,
  OpTypeImage = 25,
  OpTypeSampledImage = 27,
  OpTypeArray = 28,
  OpTypeStruct = 30,
  OpTypePointer = 32,
  OpConstant = 43,
  OpConstantComposite = 44,
  OpSpecConstantTrue = 48,
  OpSpecConstantFalse = 49,
  OpSpecConstant = 50,
  OpSpecConstantComposite = 51,
  OpFunction = 54,
  OpVariable = 59,
  OpDecorate = 71,
  OpMemberDecorate = 72,
};

enum Decoration : std::uint32_t {
  DecorationSpecId = 1,
  DecorationArrayStride = 6,
  DecorationMatrixStride = 7,
  DecorationBuiltIn = 11,
  DecorationNonWritable = 24,
  DecorationNonReadable = 25,
  DecorationBinding = 33,
  DecorationDescriptorSet = 34,
  DecorationOffset = 35,
};

constexpr std::uint32_t execution_model_compute = 5;
constexpr std::uint32_t execution_mode_local_size = 17;
constexpr std::uint32_t builtin_workgroup_size = 25;
constexpr std::uint32_t storage_uniform_constant = 0;
constexpr std::uint32_t storage_uniform = 2;
constexpr std::uint32_t storage_push_constant = 9;
constexpr std::uint32_t storage_storage_buffer = 12;
constexpr std::uint32_t dimension_2d = 1;
constexpr std::uint32_t dimension_buffer = 5;
constexpr std::uint32_t image_is_sampled = 1;
constexpr std::uint32_t image_is_storage = 2;

// Deeper types than any layout needs are refused, so that a type that contains itself ends too.
constexpr int max_type_depth = 16;
constexpr std::size_t max_members = 1024;
// The same for types that name each other many times over.
constexpr std::size_t max_size_steps = 4096;

[[noreturn]] void refuse(const std::string& what) {
  throw Error(ErrorKind::UnreadableInput, "SPIR-V module: " + what);
}

struct Member {
  std::string name;
  std::map<std::uint32_t, std::uint32_t> decorations;
};

/// What is known of one result id.
struct Id {
  std::uint32_t operation = 0;
  std::vector<std::uint32_t> operands;  ///< without the result id
  std::string name;
  std::map<std::uint32_t, std::uint32_t> decorations;  ///< with the first literal, 0 where there is none
  std::map<std::uint32_t, Member> members;
};

class Module {
 public:
  explicit Module(std::span<const std::uint32_t> words);

  ShaderInterface interface() const;

 private:
  void instruction(std::uint32_t operation, std::span<const std::uint32_t> operands);
  Member& member(std::uint32_t id, std::uint32_t index);
  const Id& get(std::uint32_t id) const;
  std::uint32_t operand(const Id& id, std::size_t index) const;
  std::optional<std::uint32_t> decoration(const Id& id, std::uint32_t decoration) const;
  bool has_everywhere(const Id& variable, const Id& type, std::uint32_t decoration) const;
  std::size_t size_bytes(std::uint32_t type, const Member* as_member, int depth) const;
  std::size_t struct_end_bytes(const Id& type, int depth) const;

  void add_variable(const Id& variable, ShaderInterface& out) const;
  void add_constant(const Id& constant, ShaderInterface& out) const;
  void add_workgroup_size(ShaderInterface& out) const;
  std::string resource_name(const Id& variable, const Id& type) const;

  std::map<std::uint32_t, Id> ids_;  // ordered, so that the interface does not depend on hashing
  std::uint32_t bound_ = 0;
  std::string entry_point_;
  int entry_points_ = 0;
  std::array<std::uint32_t, 3> local_size_{1, 1, 1};
  mutable std::size_t size_steps_ = 0;
};

std::string literal_string(std::span<const std::uint32_t> words) {
  std::string text(words.size() * sizeof(std::uint32_t), '\0');
  std::memcpy(text.data(), words.data(), text.size());
  const std::size_t end = text.find('\0');
  if (end == std::string::npos) {
    refuse("a string without an end");
  }
  text.resize(end);
  return text;
}

Module::Module(std::span<const std::uint32_t> words) {
  if (words.size() < header_words || words[0] != magic_number) {
    refuse("not a module of this machine's byte order");
  }
  bound_ = words[3];
  std::size_t at = header_words;
  while (at < words.size()) {
    const std::size_t length = words[at] >> 16U;
    const std::uint32_t operation = words[at] & 0xFFFFU;
    if (length == 0 || length > words.size() - at) {
      refuse(fmt::format("an instruction at word {} reaches past the end", at));
    }
    if (operation == OpFunction) {
      break;  // names, decorations, types, constants and variables all come before the first function
    }
    instruction(operation, words.subspan(at + 1, length - 1));
    at += length;
  }
}

Member& Module::member(std::uint32_t id, std::uint32_t index) {
  if (index >= max_members) {
    refuse(fmt::format("member {} of a structure", index));
  }
  return ids_[id].members[index];
}

void Module::instruction(std::uint32_t operation, std::span<const std::uint32_t> operands) {
  const auto need = [&](std::size_t count) {
    if (operands.size() < count) {
      refuse(fmt::format("instruction {} is too short", operation));
    }
  };
  const auto result = [&](std::size_t index) -> Id& {
    need(index + 1);
    const std::uint32_t id = operands[index];
    if (id == 0 || id >= bound_) {
      refuse(fmt::format("id {} is out of bounds", id));
    }
    return ids_[id];
  };
  switch (operation) {
    case OpName:
      need(2);
      result(0).name = literal_string(operands.subspan(1));
      break;
    case OpMemberName:
      need(3);
      result(0);
      member(operands[0], operands[1]).name = literal_string(operands.subspan(2));
      break;
    case OpDecorate:
      need(2);
      result(0).decorations[operands[1]] = operands.size() > 2 ? operands[2] : 0;
      break;
    case OpMemberDecorate:
      need(3);
      result(0);
      member(operands[0], operands[1]).decorations[operands[2]] = operands.size() > 3 ? operands[3] : 0;
      break;
    case OpEntryPoint:
      need(3);
      if (operands[0] != execution_model_compute) {
        refuse("not a compute shader");
      }
      ++entry_points_;
      entry_point_ = literal_string(operands.subspan(2));
      break;
    case OpExecutionMode:
      need(2);
      if (operands[1] == execution_mode_local_size) {
        need(5);
        std::copy_n(operands.begin() + 2, 3, local_size_.begin());
      }
      break;
    case OpTypeBool:
    case OpTypeInt:
    case OpTypeFloat:
    case OpTypeVector:
    case OpTypeMatrix:
    case OpTypeImage:
    case OpTypeSampledImage:
    case OpTypeArray:
    case OpTypeStruct:
    case OpTypePointer: {
      Id& id = result(0);
      id.operation = operation;
      id.operands.assign(operands.begin() + 1, operands.end());
      break;
    }
    case OpConstant:
    case OpConstantComposite:
    case OpSpecConstantTrue:
    case OpSpecConstantFalse:
    case OpSpecConstant:
    case OpSpecConstantComposite:
    case OpVariable: {
      Id& id = result(1);
      id.operation = operation;
      id.operands.assign(operands.begin() + 2, operands.end());
      id.operands.insert(id.operands.begin(), operands[0]);  // the type
      break;
    }
    default:
      break;
  }
}

const Id& Module::get(std::uint32_t id) const {
  const auto found = ids_.find(id);
  if (found == ids_.end()) {
    refuse(fmt::format("id {} is used but not declared", id));
  }
  return found->second;
}

std::uint32_t Module::operand(const Id& id, std::size_t index) const {
  if (index >= id.operands.size()) {
    refuse(fmt::format("instruction {} is too short", id.operation));
  }
  return id.operands[index];
}

std::optional<std::uint32_t> Module::decoration(const Id& id, std::uint32_t which) const {
  const auto found = id.decorations.find(which);
  return found == id.decorations.end() ? std::nullopt : std::optional(found->second);
}

/// True where the variable, or every member of its block, has the decoration.
bool Module::has_everywhere(const Id& variable, const Id& type, std::uint32_t which) const {
  if (decoration(variable, which)) {
    return true;
  }
  if (type.operation != OpTypeStruct || type.operands.empty()) {
    return false;
  }
  for (std::uint32_t index = 0; index < type.operands.size(); ++index) {
    const auto found = type.members.find(index);
    if (found == type.members.end() || !found->second.decorations.contains(which)) {
      return false;
    }
  }
  return true;
}

std::size_t Module::size_bytes(std::uint32_t type_id, const Member* as_member, int depth) const {
  if (depth > max_type_depth || ++size_steps_ > max_size_steps) {
    refuse("types nested too deep");
  }
  const Id& type = get(type_id);
  switch (type.operation) {
    case OpTypeInt:
    case OpTypeFloat:
      return operand(type, 0) / 8;
    case OpTypeVector:
      return operand(type, 1) * size_bytes(operand(type, 0), nullptr, depth + 1);
    case OpTypeMatrix: {
      if (as_member == nullptr || !as_member->decorations.contains(DecorationMatrixStride)) {
        refuse("a matrix without a stride");
      }
      return std::size_t{operand(type, 1)} * as_member->decorations.at(DecorationMatrixStride);
    }
    case OpTypeArray: {
      const std::optional<std::uint32_t> stride = decoration(type, DecorationArrayStride);
      const Id& length = get(operand(type, 1));
      if (!stride || length.operation != OpConstant) {
        refuse("an array without stride or constant length");
      }
      return std::size_t{operand(length, 1)} * *stride;
    }
    case OpTypeStruct:
      return struct_end_bytes(type, depth + 1);
    default:
      refuse("push constants of a type without a size");
  }
}

std::size_t Module::struct_end_bytes(const Id& type, int depth) const {
  std::size_t end = 0;
  for (std::uint32_t index = 0; index < type.operands.size(); ++index) {
    const auto found = type.members.find(index);
    if (found == type.members.end() || !found->second.decorations.contains(DecorationOffset)) {
      refuse("a structure's member without an offset");
    }
    end = std::max(end, found->second.decorations.at(DecorationOffset) +
                            size_bytes(type.operands[index], &found->second, depth + 1));
  }
  return end;
}

std::string Module::resource_name(const Id& variable, const Id& type) const {
  if (!variable.name.empty()) {
    return variable.name;
  }
  if (type.operation == OpTypeStruct && type.operands.size() == 1 && type.members.contains(0) &&
      !type.members.at(0).name.empty()) {
    return type.members.at(0).name;
  }
  if (type.name.empty()) {
    refuse("a resource without a name");
  }
  return type.name;
}

void Module::add_variable(const Id& variable, ShaderInterface& out) const {
  const std::uint32_t storage = operand(variable, 1);
  const Id& pointer = get(operand(variable, 0));
  if (pointer.operation != OpTypePointer) {
    refuse("a variable that is no pointer");
  }
  const Id& type = get(operand(pointer, 1));
  if (storage == storage_push_constant) {
    if (type.operation != OpTypeStruct) {
      refuse("push constants that are no structure");
    }
    out.push_constant_bytes = struct_end_bytes(type, 0);
    return;
  }
  if (storage != storage_uniform_constant && storage != storage_uniform &&
      storage != storage_storage_buffer) {
    return;  // built-in inputs, shared and private memory
  }
  BindingInfo info;
  info.name = resource_name(variable, type);
  const std::optional<std::uint32_t> binding = decoration(variable, DecorationBinding);
  if (!binding || decoration(variable, DecorationDescriptorSet).value_or(0) != 0) {
    refuse(fmt::format("'{}' has no binding, or is not in descriptor set 0", info.name));
  }
  info.binding = *binding;
  if (storage == storage_storage_buffer && type.operation == OpTypeStruct) {
    info.type = BindingType::StorageBuffer;
    info.written = !has_everywhere(variable, type, DecorationNonWritable);
    info.read = !has_everywhere(variable, type, DecorationNonReadable);
  } else if (storage == storage_uniform && type.operation == OpTypeStruct) {
    info.type = BindingType::UniformBuffer;
  } else if (type.operation == OpTypeSampledImage || type.operation == OpTypeImage) {
    const Id& image = type.operation == OpTypeImage ? type : get(operand(type, 0));
    if (image.operation != OpTypeImage) {
      refuse(fmt::format("'{}' samples no image", info.name));
    }
    const std::uint32_t dimension = operand(image, 1);
    const std::uint32_t usage = operand(image, 5);
    const bool plain = operand(image, 3) == 0 && operand(image, 4) == 0;  // no array, no multisampling
    if (dimension == dimension_buffer && usage == image_is_sampled) {
      info.type = BindingType::TexelBuffer;
    } else if (dimension == dimension_2d && plain && type.operation == OpTypeSampledImage) {
      info.type = BindingType::SampledImage;
    } else if (dimension == dimension_2d && plain && usage == image_is_storage) {
      info.type = BindingType::StorageImage;
      info.written = !decoration(variable, DecorationNonWritable);
      info.read = !decoration(variable, DecorationNonReadable);
    } else {
      refuse(fmt::format("'{}' is a kind of image that is not used here", info.name));
    }
  } else {
    refuse(fmt::format("'{}' is a kind of resource that is not used here", info.name));
  }
  out.bindings.push_back(std::move(info));
}

void Module::add_constant(const Id& constant, ShaderInterface& out) const {
  const std::optional<std::uint32_t> id = decoration(constant, DecorationSpecId);
  if (!id) {
    return;
  }
  ConstantInfo info;
  info.name = constant.name;
  info.id = *id;
  if (constant.operation == OpSpecConstant) {
    const Id& type = get(operand(constant, 0));
    const bool known = type.operation == OpTypeInt || type.operation == OpTypeFloat;
    if (!known || operand(type, 0) != 32) {
      refuse(fmt::format("specialization constant '{}' is no 32-bit number", info.name));
    }
    info.default_bits = operand(constant, 1);
    if (type.operation == OpTypeFloat) {
      info.type = ConstantType::Float;
    } else {
      info.type = operand(type, 1) != 0 ? ConstantType::Int : ConstantType::Uint;
    }
  } else {
    info.type = ConstantType::Bool;
    info.default_bits = constant.operation == OpSpecConstantTrue ? 1 : 0;
  }
  out.constants.push_back(std::move(info));
}

void Module::add_workgroup_size(ShaderInterface& out) const {
  out.workgroup_size = local_size_;
  for (const auto& [number, id] : ids_) {
    const bool composite = id.operation == OpSpecConstantComposite || id.operation == OpConstantComposite;
    if (!composite || decoration(id, DecorationBuiltIn) != builtin_workgroup_size) {
      continue;
    }
    constexpr std::array<const char*, 3> extent_names{"local_size_x", "local_size_y", "local_size_z"};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const Id& extent = get(operand(id, axis + 1));
      if (extent.operation != OpConstant && extent.operation != OpSpecConstant) {
        refuse("a workgroup size that is no constant");
      }
      out.workgroup_size[axis] = operand(extent, 1);
      const std::optional<std::uint32_t> spec_id = decoration(extent, DecorationSpecId);
      if (!spec_id) {
        continue;
      }
      for (std::size_t index = 0; index < out.constants.size(); ++index) {
        if (out.constants[index].id == *spec_id) {
          if (out.constants[index].name.empty()) {
            out.constants[index].name = extent_names[axis];
          }
          out.workgroup_size_constant[axis] = static_cast<int>(index);
        }
      }
    }
  }
}

ShaderInterface Module::interface() const {
  if (entry_points_ != 1) {
    refuse(fmt::format("{} entry points instead of one", entry_points_));
  }
  ShaderInterface out;
  out.entry_point = entry_point_;
  for (const auto& [number, id] : ids_) {
    switch (id.operation) {
      case OpVariable:
        add_variable(id, out);
        break;
      case OpSpecConstant:
      case OpSpecConstantTrue:
      case OpSpecConstantFalse:
        add_constant(id, out);
        break;
      default:
        break;
    }
  }
  std::ranges::sort(out.bindings, {}, &BindingInfo::binding);
  for (std::size_t index = 1; index < out.bindings.size(); ++index) {
    if (out.bindings[index].binding == out.bindings[index - 1].binding) {
      refuse(fmt::format("'{}' and '{}' share binding {}", out.bindings[index - 1].name,
                         out.bindings[index].name, out.bindings[index].binding));
    }
  }
  const auto named = [](const std::vector<BindingInfo>& bindings, const std::string& name) {
    return std::ranges::count(bindings, name, &BindingInfo::name);
  };
  for (const BindingInfo& binding : out.bindings) {
    if (named(out.bindings, binding.name) > 1) {
      refuse(fmt::format("two resources are called '{}'", binding.name));
    }
  }
  add_workgroup_size(out);
  return out;
}

}  // namespace

ShaderInterface reflect(std::span<const std::uint32_t> words) {
  return Module(words).interface();
}

}  // namespace facet::gpu
