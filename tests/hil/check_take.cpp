// check_take TAKE [--lamps NAME,...]: reads a take of mode "frames" whose cameras paint the pattern that they
// saw (painted_number.hpp; the pattern of slot n is n modulo 256) and tells as one line of JSON how many
// pictures stand in the right set. --lamps: which hang on the pattern's lines 0, 1, ...: how many sets say
// the light that their pictures show, too. Exit status 0 where no picture stands in a wrong set and no set
// says another light.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "capture/slot_program.hpp"
#include "facet/error.hpp"
#include "painted_number.hpp"
#include "take/reader.hpp"

namespace {

using namespace facet;

/// The light of a set whose pictures show a pattern, as its word.
std::string light_shown(std::uint32_t pattern, const std::vector<std::string>& lamps) {
  capture::SlotLight light{capture::SlotLight::Kind::Lit};
  for (std::size_t i = 0; i < lamps.size(); ++i) {
    if ((pattern >> i & 1U) != 0) {
      light.lights.push_back(lamps[i]);
    }
  }
  std::sort(light.lights.begin(), light.lights.end());  // as every SlotLight has them
  return capture::to_word(light);
}

int check(const std::string& file, const std::vector<std::string>& lamps) {
  take::TakeReader reader(file);
  nlohmann::json wrong = nlohmann::json::array();
  std::uint64_t right = 0;
  std::uint64_t unreadable = 0;
  std::uint64_t lit = 0;
  nlohmann::json otherwise_lit = nlohmann::json::array();
  std::uint64_t complete = 0;
  std::int64_t last_trigger_ns = 0;
  for (std::int64_t index = 0; index < reader.frame_count(); ++index) {
    const auto set = reader.frame(index)->images;
    if (set == nullptr) {
      continue;
    }
    complete += set->complete() ? 1 : 0;
    last_trigger_ns = set->trigger_ns;
    for (std::size_t camera = 0; camera < set->frames.size(); ++camera) {
      const Frame& picture = set->frames[camera];
      if (picture.empty()) {
        continue;
      }
      const auto number = hil::read_number(picture);
      if (!number) {
        ++unreadable;
      } else if (number->pattern == set->slot % 256) {
        ++right;
        const std::string shown = lamps.empty() ? set->light : light_shown(number->pattern, lamps);
        lit += shown == set->light ? 1 : 0;
        if (shown != set->light) {
          otherwise_lit.push_back({{"slot", set->slot}, {"says", set->light}, {"shows", shown}});
        }
      } else {
        wrong.push_back({{"slot", set->slot}, {"camera", camera}, {"pattern", number->pattern}});
      }
    }
  }
  fmt::print("{}\n", nlohmann::json({{"sets", reader.frame_count()},
                                     {"complete", complete},
                                     {"right", right},
                                     {"unreadable", unreadable},
                                     {"wrong", wrong},
                                     {"lit", lit},
                                     {"otherwise_lit", otherwise_lit},
                                     {"last_trigger_ns", last_trigger_ns},
                                     {"closed", reader.info().closed}})
                         .dump());
  return wrong.empty() && otherwise_lit.empty() ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Checks that every picture of a take stands in the set of its slot."};
  std::string file;
  std::vector<std::string> lamps;
  app.add_option("TAKE", file)->required();
  app.add_option("--lamps", lamps)->delimiter(',');
  CLI11_PARSE(app, argc, argv);
  try {
    return check(file, lamps);
  } catch (const Error& error) {
    fmt::print(stderr, "check_take: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
}
