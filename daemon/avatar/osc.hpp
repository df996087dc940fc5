#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace facet::avatar {

/// One argument of an Open Sound Control message. A bool is a tag alone (T, F), which OSC 1.0 counts among
/// the types that not every receiver knows.
using OscArgument = std::variant<std::int32_t, float, std::string_view, bool>;

/// Open Sound Control 1.0 messages, gathered into bundles ("immediately") that a network carries in one
/// piece.
class OscBundles {
 public:
  /// most_bytes of one bundle, above which the next one begins.
  explicit OscBundles(std::size_t most_bytes) : most_bytes_(most_bytes) {}

  /// A message is in one bundle; one longer than most_bytes has a bundle of its own.
  void add(std::string_view address, std::initializer_list<OscArgument> arguments);
  /// The bundles since the last clear.
  const std::vector<std::vector<std::byte>>& bundles() const { return bundles_; }
  void clear() { bundles_.clear(); }

 private:
  std::size_t most_bytes_;
  std::vector<std::vector<std::byte>> bundles_;
  std::vector<std::byte> message_;
};

}  // namespace facet::avatar
