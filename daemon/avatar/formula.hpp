#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "mesh/arkit.hpp"

namespace facet::avatar {

/// A number made of ARKit's values, such as "max(0, jawOpen - mouthClose) * 0.8". Of numbers, ARKit's names
/// (the first letter small or not), + - * / and brackets, and
///
///   min(a, b, ...)   max(a, b, ...)   clamp(x, least, most)
///   dead(x, zone)    0 below the zone, above it stretched: (x - zone) / (1 - zone)
///
/// Immutable; any thread.
class Formula {
 public:
  static constexpr std::size_t kMostLetters = 1000;
  static constexpr std::size_t kMostNesting = 32;  ///< of brackets, functions and signs

  /// Throws Error(Usage) that says what is wrong and where in the text.
  explicit Formula(std::string_view text);

  /// As it was given.
  const std::string& text() const { return text_; }
  bool operator==(const Formula& other) const { return text_ == other.text_; }

  /// Always finite: a division by 0 is 0, and so is what is too large for a number. Allocates nothing.
  float of(const mesh::ArkitValues& values) const;

 private:
  friend class FormulaReader;
  static constexpr std::size_t kMostKept = 64;

  enum class Kind { Number, Value, Add, Subtract, Multiply, Divide, Negate, Min, Max, Dead };
  /// A number is put on top of the others; all else takes what it works on from there.
  struct Step {
    Kind kind;
    double number = 0;      ///< of Number
    std::size_t index = 0;  ///< of Value, into mesh::kArkitNames
  };
  std::string text_;
  std::vector<Step> steps_;
};

}  // namespace facet::avatar
