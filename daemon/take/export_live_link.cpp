#include <fmt/format.h>

#include <array>
#include <cmath>
#include <iterator>
#include <string>
#include <utility>

#include "mesh/arkit.hpp"
#include "take/export.hpp"

namespace facet::take {
namespace {

constexpr std::array<std::string_view, 9> kAngles = {"HeadYaw",     "HeadPitch",     "HeadRoll",
                                                     "LeftEyeYaw",  "LeftEyePitch",  "LeftEyeRoll",
                                                     "RightEyeYaw", "RightEyePitch", "RightEyeRoll"};

/// The recordings' columns are in the packets' order, but for right before left of jaw and mouth.
constexpr std::array<std::size_t, mesh::kArkitNames.size()> column_order() {
  std::array<std::size_t, mesh::kArkitNames.size()> order{};
  for (std::size_t i = 0; i < order.size(); ++i) {
    order[i] = i;
    if (mesh::kArkitNames[i] == "JawRight" || mesh::kArkitNames[i] == "MouthRight") {
      order[i] = i - 1;
      order[i - 1] = i;
    }
  }
  return order;
}
constexpr auto kColumns = column_order();

/// "HH:MM:SS:FF.mmm": a frame's thousandths are 0, since every line is a frame.
std::string timecode(std::uint64_t frame, std::uint64_t frames_per_second) {
  const std::uint64_t seconds = frame / frames_per_second;
  return fmt::format("{:02}:{:02}:{:02}:{:02}.000", seconds / 3600 % 24, seconds / 60 % 60, seconds % 60,
                     frame % frames_per_second);
}

}  // namespace

std::string live_link_header() {
  std::string line = "Timecode,BlendShapeCount";
  for (const std::size_t column : kColumns) {
    line += fmt::format(",{}", mesh::kArkitNames[column]);
  }
  for (const std::string_view angle : kAngles) {
    line += fmt::format(",{}", angle);
  }
  return line + "\n";
}

std::string live_link_line(const mesh::MeshFrame& frame, const Timeline& timeline) {
  mesh::ArkitValues values{};
  std::array<float, 9> angles{};
  if (frame.subject != nullptr) {
    values = mesh::arkit_values(frame.subject->expression_names, frame.expression);
    angles =
        mesh::live_link_rotations(values, (mesh::upright_from_camera() * frame.camera_from_head).linear());
  }
  const auto frames_per_second = static_cast<std::uint64_t>(std::max(1L, std::lround(timeline.rate_hz)));
  std::string line =
      fmt::format("{},{}", timecode(frame.sequence - timeline.sequences.front(), frames_per_second),
                  values.size() + angles.size());
  for (const std::size_t column : kColumns) {
    fmt::format_to(std::back_inserter(line), ",{:.10f}", values[column]);
  }
  for (const float angle : angles) {
    fmt::format_to(std::back_inserter(line), ",{:.10f}", angle);
  }
  return line + "\n";
}

}  // namespace facet::take
