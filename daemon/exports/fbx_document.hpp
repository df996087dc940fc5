#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace facet::exports {

/// A record of a binary FBX file: a name, properties, and records below it.
struct FbxRecord {
  std::string name;
  std::uint64_t property_count = 0;
  std::vector<std::byte> properties;  ///< as they are in the file
  std::vector<FbxRecord> children;
  bool has_list = false;  ///< the list of children is there, though it may be empty

  FbxRecord() = default;
  explicit FbxRecord(std::string_view called) : name(called) {}

  /// Appends a property.
  FbxRecord& add(std::int32_t value);
  FbxRecord& add(std::int64_t value);
  FbxRecord& add(double value);
  FbxRecord& add(std::string_view text);
  FbxRecord& add(std::span<const std::int32_t> values);
  FbxRecord& add(std::span<const std::int64_t> values);
  FbxRecord& add(std::span<const float> values);
  /// Appends a child and returns it; the reference is good until the next one.
  FbxRecord& child(std::string_view called);

  /// The first child of a name. Throws Error(Internal) where there is none.
  FbxRecord& find(std::string_view called);
  /// Its properties, each with its type's letter. Throws Error(Internal) where they can't be read.
  std::vector<std::span<const std::byte>> split_properties() const;
};

/// A property of split_properties() as a whole number or as text. Throw Error(Internal) where it is none.
std::int64_t fbx_integer(std::span<const std::byte> property);
std::string_view fbx_text(std::span<const std::byte> property);

/// A binary FBX file of version 7500 or later, as Assimp writes it, to which records are added. Not for files
/// from outside: what it does not understand is Error(Internal).
class FbxDocument {
 public:
  explicit FbxDocument(std::span<const std::byte> bytes);
  std::vector<std::byte> bytes() const;

  FbxRecord root;  ///< holds the file's top records

 private:
  std::vector<std::byte> head_;  ///< magic and version
  std::vector<std::byte> tail_;  ///< what follows the records, less the padding
};

}  // namespace facet::exports
