// check_take TAKE: reads a take of mode "frames" whose cameras paint the pattern that they saw
// (painted_number.hpp; the pattern of slot n is n modulo 256) and tells as one line of JSON how many pictures
// stand in the right set. Exit status 0 where none stands in a wrong one.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "facet/error.hpp"
#include "painted_number.hpp"
#include "take/reader.hpp"

namespace {

using namespace facet;

int check(const std::string& file) {
  take::TakeReader reader(file);
  nlohmann::json wrong = nlohmann::json::array();
  std::uint64_t right = 0;
  std::uint64_t unreadable = 0;
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
                                     {"last_trigger_ns", last_trigger_ns},
                                     {"closed", reader.info().closed}})
                         .dump());
  return wrong.empty() ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Checks that every picture of a take stands in the set of its slot."};
  std::string file;
  app.add_option("TAKE", file)->required();
  CLI11_PARSE(app, argc, argv);
  try {
    return check(file);
  } catch (const Error& error) {
    fmt::print(stderr, "check_take: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
}
