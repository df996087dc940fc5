#pragma once

#include <cstddef>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

namespace facet::files {

/// What a JSON text from outside may cost. A value takes up to 100 times its own bytes in memory ("[],").
struct JsonLimits {
  std::size_t most_bytes = 0;
  std::size_t most_values = 0;  ///< lists and objects count as one each
  int most_depth = 32;          ///< copying, writing and freeing a value recurse as deep as it nests
};

/// Parses a text that is not trusted: the limits hold while it is read, and in time and memory it costs no
/// more than in proportion to its length. Refuses a name that stands twice in one object: which one counts is
/// a matter of the reader. The tree's only JSON parser; any thread. Throws Error(UnreadableInput) that names
/// `source` and what is wrong.
nlohmann::json parse_json(std::string_view text, const JsonLimits& limits, const std::string& source);
/// The same with names in the text's order, for documents that are written again. Finding a name takes as
/// long as the object has names.
nlohmann::ordered_json parse_ordered_json(std::string_view text, const JsonLimits& limits,
                                          const std::string& source);

}  // namespace facet::files
