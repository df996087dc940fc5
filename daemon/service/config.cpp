#include "service/config.hpp"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <fstream>
#include <iterator>
#include <limits>
#include <numeric>
#include <optional>

#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "stream/protocol.hpp"

namespace facet::service {
namespace {

constexpr const char* kAnyText = "a text in quotes";

/// Edits (insert, delete, replace one character) that lead from one word to the other.
std::size_t edit_distance(std::string_view from, std::string_view to) {
  std::vector<std::size_t> row(to.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 0; i < from.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i + 1);
    for (std::size_t j = 0; j < to.size(); ++j) {
      const std::size_t replaced = diagonal + (from[i] == to[j] ? 0 : 1);
      diagonal = std::exchange(row[j + 1], std::min({replaced, row[j] + 1, row[j + 1] + 1}));
    }
  }
  return row.back();
}

/// What to tell about a word that is not among the known ones.
std::string suggestion(std::string_view word, const std::vector<std::string>& known) {
  // A key that long is no misspelling; the distance costs its square.
  constexpr std::size_t kLongestWord = 64;
  if (word.size() <= kLongestWord) {
    const auto nearest = std::min_element(known.begin(), known.end(), [&](const auto& a, const auto& b) {
      return edit_distance(word, a) < edit_distance(word, b);
    });
    if (edit_distance(word, *nearest) <= std::max<std::size_t>(2, nearest->size() / 3)) {
      return fmt::format("did you mean '{}'?", *nearest);
    }
  }
  return fmt::format("known are: {}", fmt::join(known, ", "));
}

/// The file as a whole: where messages point, and the keys that were asked for.
class Document {
 public:
  Document(const toml::table& root, std::filesystem::path file) : root_(root), file_(std::move(file)) {}

  [[noreturn]] void fail(const toml::node* node, const std::string& key, const std::string& what) const {
    const std::string where =
        node != nullptr ? fmt::format("{}:{}", file_.string(), node->source().begin.line) : file_.string();
    throw Error(ErrorKind::Usage, fmt::format("{}: {}: {}", where, key, what));
  }

  const toml::table& root() const { return root_; }
  std::filesystem::path folder() const { return file_.parent_path(); }
  std::vector<std::string> keys;

 private:
  const toml::table& root_;
  std::filesystem::path file_;
};

/// One table of the file. Every read says what it allows; finish() refuses what nobody asked for.
class Section {
 public:
  Section(Document& document, const toml::table* table, std::string name)
      : document_(document), table_(table), name_(std::move(name)) {}

  /// A table inside this one; absent where the file does not have it.
  Section section(const std::string& key) {
    const toml::node* node = find(key, false);
    if (node != nullptr && !node->is_table()) {
      fail(node, key, "must be a section in square brackets");
    }
    return {document_, node != nullptr ? node->as_table() : nullptr, full(key)};
  }

  void read(const std::string& key, std::string& value) {
    if (const toml::node* node = find(key)) {
      value = text(*node, key, kAnyText);
    }
  }

  void read(const std::string& key, bool& value) {
    if (const toml::node* node = find(key)) {
      const std::optional<bool> found = node->value_exact<bool>();
      if (!found) {
        fail(node, key, "must be true or false");
      }
      value = *found;
    }
  }

  void read(const std::string& key, std::filesystem::path& value) {
    if (const toml::node* node = find(key)) {
      const std::string found = text(*node, key, "a path in quotes");
      if (found.empty() || found.find('\0') != std::string::npos) {
        fail(node, key, "must be a path in quotes, not empty");
      }
      value = document_.folder() / found;
    }
  }

  template <typename Integer>
  void read_integer(const std::string& key, Integer& value, std::int64_t least, std::int64_t most) {
    if (const toml::node* node = find(key)) {
      value = static_cast<Integer>(
          integer(*node, key, least, most, fmt::format("a whole number from {} to {}", least, most)));
    }
  }

  template <typename Number>
  void read_number(const std::string& key, Number& value, double least, double most) {
    if (const toml::node* node = find(key)) {
      const std::optional<double> found = node->is_number() ? node->value<double>() : std::nullopt;
      if (!found || !(*found >= least && *found <= most)) {
        fail(node, key, fmt::format("must be a number from {} to {}", least, most));
      }
      value = static_cast<Number>(*found);
    }
  }

  void read_mode(const std::string& key, unsigned& value) {
    if (const toml::node* node = find(key)) {
      value = static_cast<unsigned>(integer(
          *node, key, 0, 0777, "file permissions as an octal number from 0o000 to 0o777, such as 0o660"));
    }
  }

  /// One of a few words; returns its place among them.
  template <std::size_t Count>
  std::optional<std::size_t> read_choice(const std::string& key,
                                         const std::array<const char*, Count>& allowed) {
    const toml::node* node = find(key);
    if (node == nullptr) {
      return std::nullopt;
    }
    const std::string wanted = fmt::format("must be one of: \"{}\"", fmt::join(allowed, "\", \""));
    const std::optional<std::string> found = node->value_exact<std::string>();
    const auto at =
        std::find_if(allowed.begin(), allowed.end(), [&](const char* word) { return found == word; });
    if (!found || at == allowed.end()) {
      fail(node, key, wanted);
    }
    return static_cast<std::size_t>(at - allowed.begin());
  }

  /// Refuses the keys that are there, with the reason.
  template <std::size_t Count>
  void refuse(const std::array<const char*, Count>& keys, const std::string& why) const {
    for (const char* key : keys) {
      if (const toml::node* node = table_ != nullptr ? table_->get(key) : nullptr) {
        fail(node, key, why);
      }
    }
  }

  /// The raw value, for keys whose type is not one of the above.
  const toml::node* find(const std::string& key, bool is_value = true) {
    known_.push_back(key);
    if (is_value) {
      document_.keys.push_back(full(key));
    }
    return table_ != nullptr ? table_->get(key) : nullptr;
  }

  [[noreturn]] void fail(const toml::node* node, const std::string& key, const std::string& what) const {
    document_.fail(node, full(key), what);
  }

  std::string text(const toml::node& node, const std::string& key, const std::string& allowed) const {
    const std::optional<std::string> found = node.value_exact<std::string>();
    if (!found) {
      fail(&node, key, "must be " + allowed);
    }
    return *found;
  }

  bool given() const { return table_ != nullptr; }
  const toml::node* node() const { return table_; }

  void finish() const {
    if (table_ == nullptr) {
      return;
    }
    for (const auto& [key, value] : *table_) {
      if (std::find(known_.begin(), known_.end(), key.str()) == known_.end()) {
        document_.fail(&value, full(std::string(key.str())), "unknown key; " + suggestion(key.str(), known_));
      }
    }
  }

 private:
  std::string full(const std::string& key) const { return name_.empty() ? key : name_ + "." + key; }

  std::int64_t integer(const toml::node& node, const std::string& key, std::int64_t least, std::int64_t most,
                       const std::string& allowed) const {
    const std::optional<std::int64_t> found = node.value_exact<std::int64_t>();
    if (!found || *found < least || *found > most) {
      fail(&node, key, "must be " + allowed);
    }
    return *found;
  }

  Document& document_;
  const toml::table* table_;
  std::string name_;
  std::vector<std::string> known_;
};

void read_intrinsics(Section section, std::optional<CameraIntrinsics>& intrinsics) {
  // A focal length or picture beyond these bounds is a slip of the pen, not a camera.
  constexpr double kMost = 1e6;
  CameraIntrinsics given;
  section.read_number("fx", given.fx, 1, kMost);
  section.read_number("fy", given.fy, 1, kMost);
  section.read_number("cx", given.cx, -kMost, kMost);
  section.read_number("cy", given.cy, -kMost, kMost);
  section.read_integer("width_px", given.width_px, 16, 65536);
  section.read_integer("height_px", given.height_px, 16, 65536);
  section.finish();
  if (!section.given()) {
    return;
  }
  if (given.fx == 0 || given.fy == 0 || given.width_px == 0 || given.height_px == 0) {
    section.fail(section.node(), "fx", "a known camera needs fx, fy, cx, cy, width_px and height_px");
  }
  intrinsics = given;
}

/// A control that the device regulates by itself, or a value for it.
void read_regulated(Section& section, const std::string& key, std::optional<int>& value, int least,
                    int most) {
  if (const toml::node* node = section.find(key)) {
    const std::optional<std::int64_t> found = node->value_exact<std::int64_t>();
    if (node->value_exact<std::string>() == "auto") {
      value.reset();
    } else if (found && *found >= least && *found <= most) {
      value = static_cast<int>(*found);
    } else {
      section.fail(node, key, fmt::format("must be \"auto\" or a whole number from {} to {}", least, most));
    }
  }
}

/// What a camera can do is checked when it is opened; here, what no camera can.
void read_v4l2(Section& section, camera::V4l2Config& v4l2) {
  section.read("device", v4l2.device);
  if (const auto format = section.read_choice("format", camera::kV4l2Formats)) {
    v4l2.format = camera::kV4l2Formats.at(*format);
  }
  section.read_integer("width_px", v4l2.width_px, 16, 16384);
  section.read_integer("height_px", v4l2.height_px, 16, 16384);
  section.read_number("rate_hz", v4l2.rate_hz, 1, 1000);
  read_regulated(section, "exposure_us", v4l2.exposure_us, 1, 10'000'000);
  read_regulated(section, "gain", v4l2.gain, -1'000'000, 1'000'000);
  read_regulated(section, "white_balance_k", v4l2.white_balance_k, 1000, 20'000);
  section.read_integer("buffers", v4l2.buffers, 2, 32);
  std::int64_t stall_after_ms = v4l2.stall_after.count();
  section.read_integer("stall_after_ms", stall_after_ms, 100, 3'600'000);
  v4l2.stall_after = std::chrono::milliseconds(stall_after_ms);
}

void read_source(Section section, Config& config) {
  constexpr std::array kKinds = {"file", "v4l2"};
  constexpr std::array kFileKeys = {"path", "paced", "loop"};
  constexpr std::array kV4l2Keys = {"device",  "format",        "width_px", "height_px",
                                    "rate_hz", "exposure_us",   "gain",     "white_balance_k",
                                    "buffers", "stall_after_ms"};
  pipeline::MonocularConfig& pipeline = config.pipeline;
  if (const auto kind = section.read_choice("kind", kKinds)) {
    pipeline.source.kind = kKinds.at(*kind);
  }
  if (pipeline.source.kind == "file") {
    section.refuse(kV4l2Keys, "is for source.kind = \"v4l2\"; the kind of this source is \"file\"");
  } else {
    section.refuse(kFileKeys, "is for source.kind = \"file\"; the kind of this source is \"v4l2\"");
  }
  section.read("path", pipeline.source.path);
  section.read("paced", pipeline.source.paced);
  section.read("loop", pipeline.source.loop);
  read_v4l2(section, pipeline.source.v4l2);
  if (const toml::node* node = section.find("frames")) {
    try {
      pipeline.frames = pipeline::parse_frame_range(section.text(*node, "frames", kAnyText));
    } catch (const Error& error) {
      section.fail(node, "frames", error.what());
    }
  }
  section.read("exit_at_end", config.exit_at_end);
  section.read("wait_for_reader", config.wait_for_reader);
  read_intrinsics(section.section("intrinsics"), pipeline.tracker.intrinsics);
  section.finish();
}

void read_tracker(Section section, track::TrackerConfig& tracker) {
  section.read_integer("acquisition_frames", tracker.acquisition_frames, 1, 1000);
  section.read_number("expression_prior", tracker.expression_prior, 0, 1000);
  section.read_number("temporal_prior", tracker.temporal_prior, 0, 1000);
  section.finish();
}

void read_hierarchy(Section section, mesh::HierarchyOptions& hierarchy) {
  section.read_number("min_edge_px", hierarchy.min_edge_px, 0.1, 1000);
  section.read_integer("max_levels", hierarchy.max_levels, 1, 12);
  section.read_integer("max_vertices", hierarchy.max_vertices, 1000, static_cast<int>(stream::kMaxVertices));
  section.finish();
}

void read_refiner(Section section, refine::RefinerConfig& refiner) {
  if (const toml::node* node = section.find("budget")) {
    const std::optional<std::int64_t> steps = node->value_exact<std::int64_t>();
    refiner.paper_budget = node->value_exact<std::string>() == "paper";
    if (!refiner.paper_budget) {
      if (!steps || *steps < 1 || *steps > 100) {
        section.fail(node, "budget",
                     "must be \"paper\" or a whole number of Gauss-Newton steps from 1 to 100");
      }
      refiner.gauss_newton_steps = static_cast<int>(*steps);
    }
  }
  section.read_integer("pcg_iterations", refiner.pcg_iterations, 1, 1000);
  section.read_integer("albedo_frames", refiner.albedo_frames, 1, 10'000);
  section.read_number("robust_scale", refiner.robust_scale, 0, 1000);
  section.read_number("fold_slope", refiner.fold_slope, 0, 1000);
  section.read_number("displacement_bound_mm", refiner.displacement_bound_mm, 0.01, 1000);
  Section weights = section.section("weights");
  constexpr double kMostWeight = 1e9;
  weights.read_number("lighting_temporal", refiner.weights.lighting_temporal, 0, kMostWeight);
  weights.read_number("albedo_smooth", refiner.weights.albedo_smooth, 0, kMostWeight);
  weights.read_number("displacement_smooth", refiner.weights.displacement_smooth, 0, kMostWeight);
  weights.read_number("displacement_hierarchy", refiner.weights.displacement_hierarchy, 0, kMostWeight);
  weights.read_number("displacement_coarse", refiner.weights.displacement_coarse, 0, kMostWeight);
  weights.finish();
  section.finish();
}

void read_stream(Section section, stream::StreamServerConfig& stream) {
  section.read("socket", stream.socket);
  section.read("group", stream.access.group);
  section.read_mode("mode", stream.access.mode);
  section.read_integer("max_readers", stream.max_readers, 1, 1000);
  section.finish();
}

void read_control(Section section, ControlConfig& control) {
  section.read("socket", control.socket);
  section.read("group", control.access.group);
  section.read_mode("mode", control.access.mode);
  section.finish();
}

void read_takes(Section section, TakesConfig& takes) {
  section.read("folder", takes.folder);
  std::uint64_t reserve_mb = takes.disk_reserve_bytes >> 20;
  section.read_integer("disk_reserve_mb", reserve_mb, 0, 1 << 30);
  takes.disk_reserve_bytes = reserve_mb << 20;
  section.read_integer("compression_level", takes.compression_level, 1, 19);
  section.read("record_at_start", takes.record_at_start);
  section.finish();
}

void read_all(Document& document, Config& config) {
  Section root(document, &document.root(), "");
  read_source(root.section("source"), config);
  Section model = root.section("model");
  model.read("path", config.pipeline.model_file);
  model.read("landmark_assets", config.pipeline.tracker.landmark_assets);
  model.finish();
  read_tracker(root.section("tracker"), config.pipeline.tracker);
  read_hierarchy(root.section("hierarchy"), config.pipeline.hierarchy);
  read_refiner(root.section("refiner"), config.pipeline.refiner);
  Section gpu = root.section("gpu");
  gpu.read("device", config.pipeline.gpu_device);
  gpu.finish();
  read_stream(root.section("stream"), config.stream);
  read_control(root.section("control"), config.control);
  read_takes(root.section("takes"), config.takes);
  Section log = root.section("log");
  constexpr std::array kLevels = {"error", "warning", "info", "debug"};
  if (const auto level = log.read_choice("level", kLevels)) {
    config.log_level = static_cast<LogLevel>(*level);
  }
  log.finish();
  root.finish();
}

}  // namespace

Config default_config() {
  Config config;
  config.pipeline.model_file = default_model_file();
  config.pipeline.tracker.landmark_assets = default_landmark_assets();
  config.stream.socket = "/run/facet/stream.sock";
  return config;
}

Config parse_config(std::string_view text, const std::filesystem::path& file) {
  Config config = default_config();
  try {
    const toml::table root = toml::parse(text, file.string());
    Document document(root, file);
    read_all(document, config);
  } catch (const toml::parse_error& error) {
    throw Error(ErrorKind::Usage, fmt::format("{}:{}: not valid TOML: {}", file.string(),
                                              error.source().begin.line, error.description()));
  }
  return config;
}

Config load_config(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::string text;
  if (stream) {
    text.resize(kMaxConfigBytes + 1);
    stream.read(text.data(), static_cast<std::streamsize>(text.size()));
    text.resize(static_cast<std::size_t>(stream.gcount()));
  }
  if (stream.bad() || !stream.is_open() || std::filesystem::is_directory(file)) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: cannot read this configuration file: check that it exists and may be read",
                            file.string()));
  }
  if (text.size() > kMaxConfigBytes) {
    throw Error(ErrorKind::Usage, fmt::format("{}: larger than {} bytes: this is no configuration file",
                                              file.string(), kMaxConfigBytes));
  }
  return parse_config(text, file);
}

void require_source(const Config& config, const std::filesystem::path& file) {
  const camera::CameraConfig& source = config.pipeline.source;
  if (source.kind == "v4l2" && source.v4l2.device.empty()) {
    throw Error(ErrorKind::Usage,
                fmt::format("{}: source.device is missing: name the camera that faces come from, such as "
                            "/dev/v4l/by-path/...; `facet doctor` lists them",
                            file.string()));
  }
  if (source.kind == "file" && source.path.empty()) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("{}: source.path is missing: name the video file that faces come from", file.string()));
  }
}

std::vector<std::string> config_keys() {
  const toml::table empty;
  Document document(empty, {});
  Config config;
  read_all(document, config);
  return document.keys;
}

}  // namespace facet::service
