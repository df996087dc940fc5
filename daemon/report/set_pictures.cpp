#include "report/set_pictures.hpp"

#include <fmt/format.h>

#include "files/output_file.hpp"
#include "render/renderer.hpp"

namespace facet::report {

std::size_t write_set_pictures(const FrameSet& set, const std::filesystem::path& folder) {
  std::size_t written = 0;
  for (std::size_t i = 0; i < set.frames.size(); ++i) {
    if (!set.frames[i].empty()) {
      files::make_folder(folder);
      const std::string name = fmt::format("frame_{:06}_{}.png", set.slot, set.camera_names->at(i));
      render::write_png(render::to_picture(set.frames[i]), folder / name);
      ++written;
    }
  }
  return written;
}

}  // namespace facet::report
