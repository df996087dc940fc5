#pragma once

#include <string>
#include <vector>

namespace facet::simulation {

/// How a virtual actor's skin and hair are made. As it stands: painted, as ever. With a skin type the actor
/// is made after published models of skin, hair and light, and each of the effects below can be left out to
/// see what it costs in accuracy; a painted actor knows none of them.
struct Look {
  static constexpr int kPainted = 0;
  static constexpr int kAnyType = 7;  ///< drawn by the seed

  int skin_type = kPainted;  ///< kPainted, Fitzpatrick's 1 to 6, kAnyType
  bool blood = true;         ///< stretched skin pales, compressed skin reddens
  bool marks = true;         ///< freckles, moles, blotches
  bool makeup = true;        ///< on some faces: lips, cheeks, lids
  bool strands = true;       ///< brows, lashes, beard, hairline as strands; without: painted
  bool scattering = true;    ///< light diffuses below the skin
  bool gloss = true;         ///< two lobes, stronger on forehead and nose
  bool occlusion = true;     ///< the surroundings are hidden in folds and below the chin
  bool bounce = true;        ///< one reflection of light between nose, cheeks, lips and clothes

  bool painted() const { return skin_type == kPainted; }
};

/// The names of the effects, in the order above: what `without` knows.
std::vector<std::string> look_effects();

/// Those of them that a look has.
std::vector<std::string> effects_of(const Look& look);

/// Reads "painted", "1" to "6" or "any". Throws Error(Usage).
int parse_skin_type(const std::string& text);
/// The other way round.
std::string skin_type_name(int skin_type);

/// The look without the named effects, "scattering,bounce"; empty: as it is. Throws Error(Usage) that names
/// what is unknown and lists what there is.
Look without(Look look, const std::string& effects);

}  // namespace facet::simulation
