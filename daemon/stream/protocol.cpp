#include "stream/protocol.hpp"

namespace facet::stream {

const char* to_string(Profile profile) {
  switch (profile) {
    case Profile::Signals:
      return "signals";
    case Profile::Displacements:
      return "displacements";
    case Profile::Vertices:
      return "vertices";
  }
  return "unknown";
}

}  // namespace facet::stream
