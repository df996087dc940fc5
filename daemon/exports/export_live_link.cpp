#include <fmt/format.h>

#include <array>
#include <cmath>
#include <iterator>
#include <string>
#include <utility>

#include "exports/export.hpp"
#include "mesh/arkit.hpp"

namespace facet::exports {
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

/// "HH:MM:SS:FF.mmm" of a frame: the take's timecode, or of the timeline. There, at a constant rate, the
/// thousandths are 0, since every line is a frame.
std::string timecode(const Timeline& timeline, const mesh::MeshFrame& of) {
  if (const auto place = take::timecode_near(timeline.timecode, of.timestamp_ns, timeline.rate_hz)) {
    const take::TimecodeLabel label = take::timecode_label(place->count, place->rate);
    return fmt::format("{:02}:{:02}:{:02}:{:02}.{:03}", label.hours, label.minutes, label.seconds,
                       label.frames, place->thousandths);
  }
  const std::uint64_t sequence = of.sequence;
  constexpr std::uint64_t kThousandths = 1000;
  const auto frames_per_second = static_cast<std::uint64_t>(std::max(1L, std::lround(timeline.rate_hz)));
  const std::uint64_t thousandths =
      timeline.times_s.empty()
          ? (sequence - timeline.sequences.front()) * kThousandths
          : static_cast<std::uint64_t>(std::llround(time_s(timeline, sequence) *
                                                    static_cast<double>(frames_per_second * kThousandths)));
  const std::uint64_t frame = thousandths / kThousandths;
  const std::uint64_t seconds = frame / frames_per_second;
  return fmt::format("{:02}:{:02}:{:02}:{:02}.{:03}", seconds / 3600 % 24, seconds / 60 % 60, seconds % 60,
                     frame % frames_per_second, thousandths % kThousandths);
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
  std::string line = fmt::format("{},{}", timecode(timeline, frame), values.size() + angles.size());
  for (const std::size_t column : kColumns) {
    fmt::format_to(std::back_inserter(line), ",{:.10f}", values[column]);
  }
  for (const float angle : angles) {
    fmt::format_to(std::back_inserter(line), ",{:.10f}", angle);
  }
  return line + "\n";
}

}  // namespace facet::exports
