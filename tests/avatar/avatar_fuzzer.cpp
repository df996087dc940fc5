// Whatever the bytes of an avatar: an animation is added, or facet::Error says why not.

#include <cstddef>
#include <cstdint>
#include <span>

#include "avatar/retarget.hpp"
#include "avatar/skin.hpp"
#include "facet/error.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet;
  try {
    avatar::GlbDocument glb = avatar::parse_glb(std::as_bytes(std::span(data, size)), "avatar");
    const avatar::Avatar found = avatar::inspect_avatar(glb, std::nullopt);
    for (const avatar::Skin& skin : avatar::read_skins(glb, found)) {
      if (skin.vertices.cols() < 1000) {
        avatar::PersonShapes person;
        person.neutral_mm = skin.vertices;
        person.triangles = skin.triangles;
        person.shapes = skin.shapes;
        person.skin_mm = skin.vertices;
        try {
          avatar::place_skin(skin, person);
        } catch (const Error&) {  // it can't be placed; the rest goes on
        }
      }
    }
    avatar::missing_shapes(found, {0, 17, 51});
    std::vector<avatar::FaceState> states(2);
    states[1].values.fill(1);
    avatar::add_animation(glb, found, states, {0, 1}, true);
  } catch (const Error&) {
    return 0;
  }
  return 0;
}
