#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "files/json_text.hpp"

namespace facet::animate {

/// A control point of a key pose.
struct KeyControl {
  enum class How : std::uint8_t {
    At,      ///< value: x y z in the head frame, mm
    Move,    ///< value: mm from where the vertex is in the mean face
    Screen,  ///< value: x y in the picture of the take's camera, px; z unused
  };
  std::string vertex;  ///< number or place, see find_vertex
  How how = How::At;
  Eigen::Vector3f value{0, 0, 0};
};

/// A pose at a time: either a captured frame or control points (none: the mean face).
struct Key {
  double time_s = 0;
  std::optional<std::uint64_t> frame;  ///< of the source, MeshFrame::sequence
  std::vector<KeyControl> controls;
};

/// How the time between two keys is filled.
enum class Pace : std::uint8_t {
  Captured,  ///< a path at the captured speed that takes as long as there is time
  Shortest,  ///< the cheapest path, stretched or squeezed to the time (the paper's way)
};

/// What a keys file says; docs/animation.md is its page.
struct KeyList {
  double rate_hz = 0;   ///< of the animation; 0: the take's
  bool whole = false;   ///< IkOptions::whole
  bool beyond = false;  ///< IkOptions::beyond
  Pace pace = Pace::Captured;
  std::vector<std::string> regions;  ///< vertices that have a region though no key drags them
  std::vector<Key> keys;             ///< at least one; times rise
};

inline constexpr files::JsonLimits kKeysLimits{16U << 20, 4'000'000};
inline constexpr std::size_t kMostKeys = 10'000;
inline constexpr double kLongest_s = 24 * 3600;

/// Reads a keys file (JSON) from its text; source names it in messages. Throws Error(Usage) naming the key
/// and what is wrong: no JSON, an unknown or missing name, a wrong type, numbers out of bounds, no keys,
/// time that does not rise.
KeyList parse_keys(std::string_view text, const std::string& source);
/// The same of a text that is parsed already.
KeyList keys_of(const nlohmann::json& root, const std::string& source);
KeyList read_keys(const std::filesystem::path& file);

}  // namespace facet::animate
