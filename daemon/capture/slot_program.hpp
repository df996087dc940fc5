#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "capture/patterns.hpp"

namespace facet::capture {

/// What lights the face in one slot of a booth's trigger program.
struct SlotLight {
  enum class Kind : std::uint8_t {
    Blank,    ///< even light of all projectors: texture, flow, a mesh
    Stripes,  ///< projectors with random stripes: depth
    Fringes,  ///< projectors with fringes: depth
    Lit,      ///< known lights alone: slopes of the skin
  };
  Kind kind = Kind::Blank;
  /// Lit: names of the rig's projectors and lights, in order, none twice; none: all are dark. Else empty.
  std::vector<std::string> lights = {};
  int quarters = 0;  ///< Fringes: by how many quarters of a period they are shifted, 0 to 3

  /// Whether depth can be seen by it.
  bool has_pattern() const { return kind == Kind::Stripes || kind == Kind::Fringes; }

  bool operator==(const SlotLight&) const = default;
};

/// What slot n shows: program[n % program.size()].
using SlotProgram = std::vector<SlotLight>;

inline const SlotLight& light_of_slot(const SlotProgram& program, std::uint64_t slot) {
  return program[slot % program.size()];
}

/// The program of Zhang et al.: two slots with stripes, a blank one.
SlotProgram standard_program();

/// Two slots with fringes, a blank one; each slot with fringes shifts them by a quarter of a period, so that
/// it begins again after six.
SlotProgram fringe_program();

/// What the projectors show in a slot: the number of its stripes, or the shift of its fringes; in lit slots
/// Dark.
Shown shown_in_slot(const SlotProgram& program, std::uint64_t slot);

/// A slot's light as a word: "stripes", "fringes:0" to "fringes:3", "blank", "dark",
/// "light:projector-l+led.top".
std::string to_word(const SlotLight& light);

/// The other way round; any word but those above is light with stripes. Throws Error(Usage) for a light
/// without a name and fringes without a shift.
SlotLight parse_slot_light(std::string_view word);

/// The same of a word that was recorded; nothing where it is empty or says nothing that can be.
std::optional<SlotLight> read_slot_light(std::string_view word);

/// Words with commas between: "stripes,stripes,blank"; or "stripes" or "fringes" alone for the programs
/// above. Throws Error(Usage) unless there is a slot with a pattern and a blank one.
SlotProgram parse_slot_program(std::string_view text);

/// As parse_slot_program reads it.
std::string to_text(const SlotProgram& program);

/// Whether depth and texture can be had: a slot with a pattern and a blank one.
bool makes_meshes(const SlotProgram& program);

}  // namespace facet::capture
