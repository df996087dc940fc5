#include "simulation/recorded_curves.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "facet/error.hpp"
#include "files/text_file.hpp"

namespace facet::simulation {
namespace {

constexpr std::size_t kMostBytes = 256U << 20U;  // ten hours at 60 rows a second
constexpr std::size_t kMostColumns = 256;
constexpr std::array<std::string_view, 3> kHeadColumns = {"HeadYaw", "HeadPitch", "HeadRoll"};
constexpr std::array<std::string_view, 6> kUnusedColumns = {"LeftEyeYaw",  "LeftEyePitch",  "LeftEyeRoll",
                                                            "RightEyeYaw", "RightEyePitch", "RightEyeRoll"};

/// Where the columns of a recording go.
struct Columns {
  std::size_t count = 0;
  std::vector<int> arkit;             ///< [count] index into mesh::kArkitNames, -1: none of them
  std::array<std::size_t, 3> head{};  ///< of HeadYaw, HeadPitch, HeadRoll; 0: not there
};

[[noreturn]] void refuse(const std::string& source, std::size_t line, const std::string& why) {
  throw Error(ErrorKind::UnreadableInput,
              fmt::format("{}, line {}: {}; wanted are curves as Live Link Face records them (CSV)", source,
                          line, why));
}

std::vector<std::string_view> cells_of(std::string_view line) {
  std::vector<std::string_view> cells;
  for (;;) {
    const std::size_t comma = line.find(',');
    cells.push_back(line.substr(0, comma));
    if (comma == std::string_view::npos || cells.size() > kMostColumns) {
      return cells;
    }
    line.remove_prefix(comma + 1);
  }
}

Columns read_header(std::string_view line, const std::string& source) {
  const auto cells = cells_of(line);
  if (cells.size() < 3 || cells.size() > kMostColumns || cells[0] != "Timecode" ||
      cells[1] != "BlendShapeCount") {
    refuse(source, 1, "it does not begin with the columns Timecode and BlendShapeCount");
  }
  Columns columns{cells.size(), std::vector<int>(cells.size(), -1), {}};
  std::vector<bool> there(mesh::kArkitNames.size(), false);
  for (std::size_t k = 2; k < cells.size(); ++k) {
    const int index = mesh::arkit_index(cells[k]);
    const auto* const head = std::find(kHeadColumns.begin(), kHeadColumns.end(), cells[k]);
    if (index >= 0) {
      if (there[static_cast<std::size_t>(index)]) {
        refuse(source, 1, fmt::format("column {} is there twice", cells[k]));
      }
      there[static_cast<std::size_t>(index)] = true;
      columns.arkit[k] = index;
    } else if (head != kHeadColumns.end()) {
      columns.head[static_cast<std::size_t>(head - kHeadColumns.begin())] = k;
    } else if (std::find(kUnusedColumns.begin(), kUnusedColumns.end(), cells[k]) == kUnusedColumns.end()) {
      refuse(source, 1, fmt::format("column '{:.40}' is none of ARKit's names", cells[k]));
    }
  }
  std::vector<std::string_view> missing;
  for (std::size_t k = 0; k < there.size(); ++k) {
    if (!there[k]) {
      missing.push_back(mesh::kArkitNames[k]);
    }
  }
  if (!missing.empty()) {
    refuse(source, 1, fmt::format("columns are missing: {}", fmt::join(missing, ", ")));
  }
  return columns;
}

float number_of(std::string_view cell, const std::string& source, std::size_t line) {
  float value = 0;
  const auto [end, error] = std::from_chars(cell.data(), cell.data() + cell.size(), value);
  if (error != std::errc() || end != cell.data() + cell.size() || !std::isfinite(value)) {
    refuse(source, line, fmt::format("'{:.40}' is not a number", cell));
  }
  return value;
}

/// "HH:MM:SS:FF.fff": whole seconds of the day, and frames of the timecode.
struct Timecode {
  double seconds = 0;
  double frames = 0;
};

Timecode timecode_of(std::string_view cell, const std::string& source, std::size_t line) {
  std::array<double, 4> parts{};
  std::string_view rest = cell;
  for (std::size_t k = 0; k < parts.size(); ++k) {
    const std::size_t end = k + 1 < parts.size() ? rest.find(':') : rest.size();
    const auto [stop, error] =
        std::from_chars(rest.data(), rest.data() + std::min(end, rest.size()), parts[k]);
    if (end == std::string_view::npos || error != std::errc() || stop != rest.data() + end ||
        !(parts[k] >= 0 && parts[k] < 1000)) {
      refuse(source, line, fmt::format("'{:.40}' is not a timecode HH:MM:SS:FF.fff", cell));
    }
    rest.remove_prefix(std::min(end + 1, rest.size()));
  }
  return {3600 * parts[0] + 60 * parts[1] + parts[2], parts[3]};
}

/// Frames of timecode in a second: the least usual rate above every row's count. The app counts 60 whatever
/// its recording's rate is.
double timecode_rate(double most_frames) {
  for (const double rate : {24.0, 25.0, 30.0, 60.0, 120.0}) {
    if (most_frames < rate) {
      return rate;
    }
  }
  return 1000;
}

float between(float from, float to, float part) {
  return from + part * (to - from);
}

}  // namespace

RecordedCurves RecordedCurves::read(const std::filesystem::path& file) {
  return parse(files::read_text(file, kMostBytes, "recording of curves"), file.string());
}

RecordedCurves RecordedCurves::parse(std::string_view text, const std::string& source) {
  constexpr double kDay_s = 86'400;
  RecordedCurves curves;
  curves.source_ = source;
  Columns columns;
  std::vector<Timecode> times;
  std::vector<std::size_t> lines;
  double most_frames = 0;
  for (std::size_t line = 1; !text.empty(); ++line) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    std::string_view row = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    row = row.substr(0, row.find_last_not_of("\r ") + 1);
    if (line == 1) {
      columns = read_header(row, source);
      continue;
    }
    const auto cells = cells_of(row);
    if (row.empty() || (cells.size() == 2 && cells[1] == "0")) {
      continue;  // no face was seen
    }
    if (cells.size() != columns.count) {
      refuse(source, line,
             fmt::format("{} columns where the first line names {}", cells.size(), columns.count));
    }
    Row values;
    times.push_back(timecode_of(cells[0], source, line));
    lines.push_back(line);
    most_frames = std::max(most_frames, times.back().frames);
    for (std::size_t k = 2; k < cells.size(); ++k) {
      const float value = number_of(cells[k], source, line);
      if (columns.arkit[k] >= 0) {
        values.values[static_cast<std::size_t>(columns.arkit[k])] = std::clamp(value, 0.0F, 1.0F);
      }
      for (std::size_t axis = 0; axis < columns.head.size(); ++axis) {
        if (columns.head[axis] == k) {
          values.head_rad[axis] = value;
        }
      }
    }
    curves.rows_.push_back(values);
  }
  if (curves.rows_.size() < 2) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: fewer than two rows with values", source));
  }
  const double rate = timecode_rate(most_frames);
  double midnights_s = 0;
  for (std::size_t k = 0; k < times.size(); ++k) {
    if (k > 0 && times[k].seconds < times[k - 1].seconds - kDay_s / 2) {
      midnights_s += kDay_s;
    }
    curves.rows_[k].time_s =
        midnights_s + times[k].seconds - times[0].seconds + (times[k].frames - times[0].frames) / rate;
    if (k > 0 && curves.rows_[k].time_s <= curves.rows_[k - 1].time_s) {
      refuse(source, lines[k], "its time is not after the row's before");
    }
    constexpr float kTurn_rad = 0.01F;
    for (const float angle : curves.rows_[k].head_rad) {
      curves.turns_head_ = curves.turns_head_ || std::abs(angle) > kTurn_rad;
    }
    for (std::size_t value = 0; value < curves.largest_.size(); ++value) {
      curves.largest_[value] = std::max(curves.largest_[value], curves.rows_[k].values[value]);
    }
  }
  return curves;
}

void RecordedCurves::leave_out(std::string_view name) {
  const int index = mesh::arkit_index(name);
  if (index < 0) {
    throw Error(ErrorKind::Usage, fmt::format("'{}' is none of ARKit's names", name));
  }
  for (Row& row : rows_) {
    row.values[static_cast<std::size_t>(index)] = 0;
  }
  largest_[static_cast<std::size_t>(index)] = 0;
}

RecordedCurves::Place RecordedCurves::place(double time_s) const {
  const auto next = std::upper_bound(rows_.begin() + 1, rows_.end() - 1, time_s,
                                     [](double time, const Row& row) { return time < row.time_s; });
  const Row& last = *(next - 1);
  const double part = (time_s - last.time_s) / (next->time_s - last.time_s);
  return {static_cast<std::size_t>(next - 1 - rows_.begin()), static_cast<float>(std::clamp(part, 0.0, 1.0))};
}

mesh::ArkitValues RecordedCurves::values(double time_s) const {
  const auto [row, part] = place(time_s);
  mesh::ArkitValues values{};
  for (std::size_t k = 0; k < values.size(); ++k) {
    values[k] = between(rows_[row].values[k], rows_[row + 1].values[k], part);
  }
  return values;
}

HeadMotion RecordedCurves::head(double time_s) const {
  const Place at = place(time_s);
  const auto angle = [&](std::size_t axis) {
    return between(rows_[at.row].head_rad[axis], rows_[at.row + 1].head_rad[axis], at.part);
  };
  // Recorded: yaw to the subject's right, pitch down, roll towards the left shoulder
  // (mesh::live_link_angles).
  return {.pitch_rad = angle(1), .yaw_rad = -angle(0), .roll_rad = -angle(2)};
}

}  // namespace facet::simulation
