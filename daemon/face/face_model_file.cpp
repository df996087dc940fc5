// The model file: docs/face-model-format.md describes every byte.

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <system_error>

#include "face/chunk_file.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"

namespace facet::face {
namespace {

constexpr ChunkFormat kFormat{{'F', 'A', 'C', 'E', 'T', 'M', 'D', 'L'},
                              1,
                              "face model",
                              "build the model again with `facet model build`"};

// Bounds that a damaged or hostile file can't pass.
constexpr std::size_t kMostFileBytes = std::size_t{2} << 30;
constexpr std::uint32_t kMaxVertices = 1'000'000;
constexpr std::uint32_t kMaxModes = 1024;
constexpr std::uint32_t kMaxNameBytes = 255;
constexpr std::uint32_t kMaxExpressionNameBytes = 63;

constexpr float kLargestNumber = 32767.0F;  // of int16_t, the same either side of zero
constexpr float kMinStepMm = 0.001F;        // finer than any camera sees; larger zero runs compress better

struct Counts {
  std::uint32_t vertices;
  std::uint32_t quads;
  std::uint32_t identity_modes;
  std::uint32_t expression_modes;
  std::uint32_t landmarks;
  std::uint32_t name_bytes;
};
static_assert(sizeof(Counts) == 24);

struct StoredAnchor {
  std::array<std::int32_t, 3> vertices;
  std::array<float, 3> weights;
};
static_assert(sizeof(StoredAnchor) == 24 && sizeof(LandmarkAnchor) == 24);

/// Reads `count` names, each a length byte and its characters.
std::vector<std::string> parse_names(const ChunkReader& chunks, std::uint32_t count) {
  std::span<const std::byte> left = chunks.raw("EXPN");
  std::vector<std::string> names;
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::size_t length = left.empty() ? 0 : std::to_integer<std::size_t>(left[0]);
    if (length < 1 || length > kMaxExpressionNameBytes || left.size() < 1 + length) {
      chunks.fail(fmt::format("the name of expression {} is empty, too long or cut off", i));
    }
    std::string name(reinterpret_cast<const char*>(left.data()) + 1, length);
    if (std::any_of(name.begin(), name.end(), [](char c) { return c <= ' ' || c > '~'; })) {
      chunks.fail(fmt::format("the name of expression {} has a character that is not allowed", i));
    }
    names.push_back(std::move(name));
    left = left.subspan(1 + length);
  }
  if (!left.empty()) {
    chunks.fail("there are more expression names than expressions");
  }
  return names;
}

Counts parse_counts(const ChunkReader& chunks, std::string& name) {
  const auto info = chunks.raw("INFO");
  Counts counts{};
  if (info.size() < sizeof counts) {
    chunks.fail("chunk 'INFO' is cut off");
  }
  std::memcpy(&counts, info.data(), sizeof counts);
  const auto outside = [](std::uint32_t value, std::uint32_t low, std::uint32_t high) {
    return value < low || value > high;
  };
  if (outside(counts.vertices, 3, kMaxVertices) || outside(counts.quads, 1, 2 * kMaxVertices) ||
      outside(counts.identity_modes, 1, kMaxModes) || outside(counts.expression_modes, 1, kMaxModes)) {
    chunks.fail(fmt::format("impossible size: {} vertices, {} quads, {} identity modes, {} expression modes",
                            counts.vertices, counts.quads, counts.identity_modes, counts.expression_modes));
  }
  if (counts.landmarks != 0 && counts.landmarks != FaceModel::kLandmarkCount) {
    chunks.fail(
        fmt::format("it has {} landmarks (allowed: 0 or {})", counts.landmarks, FaceModel::kLandmarkCount));
  }
  if (counts.name_bytes > kMaxNameBytes || info.size() != sizeof counts + counts.name_bytes) {
    chunks.fail("its name is too long or cut off");
  }
  name.assign(reinterpret_cast<const char*>(info.data()) + sizeof counts, counts.name_bytes);
  return counts;
}

/// core = step of the row x 16-bit number.
void parse_core(const ChunkReader& chunks, std::uint64_t max_core_values, FaceModel& model) {
  const auto rows =
      static_cast<std::uint64_t>(model.identity_modes) * static_cast<std::uint64_t>(model.expression_modes);
  const auto row_values = 3 * static_cast<std::uint64_t>(model.control.vertex_count);
  if (rows * row_values > max_core_values) {
    chunks.fail(fmt::format("its core has {} numbers (allowed: {})", rows * row_values, max_core_values));
  }
  chunks.expect_plausible("CORE", rows * row_values * sizeof(std::int16_t));
  std::vector<float> step_mm(rows);
  chunks.read("STEP", step_mm.data(), step_mm.size());
  std::vector<std::int16_t> numbers(rows * row_values);
  chunks.read("CORE", numbers.data(), numbers.size());
  model.core_mm.resize(numbers.size());
  for (std::uint64_t row = 0; row < rows; ++row) {
    const std::int16_t* from = numbers.data() + row * row_values;
    std::transform(from, from + row_values, model.core_mm.data() + row * row_values,
                   [step = step_mm[row]](std::int16_t number) { return step * static_cast<float>(number); });
  }
}

void add_core(const FaceModel& model, ChunkWriter& writer) {
  const auto row_values = 3 * static_cast<std::size_t>(model.control.vertex_count);
  const std::size_t rows = model.core_mm.size() / row_values;
  std::vector<float> step_mm(rows);
  std::vector<std::int16_t> numbers(model.core_mm.size());
  for (std::size_t row = 0; row < rows; ++row) {
    const float* from = model.core_mm.data() + row * row_values;
    const float largest = std::abs(*std::max_element(
        from, from + row_values, [](float a, float b) { return std::abs(a) < std::abs(b); }));
    step_mm[row] = std::max(largest / kLargestNumber, kMinStepMm);
    std::transform(from, from + row_values, numbers.data() + row * row_values,
                   [step = step_mm[row]](float value) {
                     return static_cast<std::int16_t>(
                         std::clamp(std::round(value / step), -kLargestNumber, kLargestNumber));
                   });
  }
  writer.add("STEP", bytes_of(step_mm.data(), rows), false);
  writer.add("CORE", bytes_of(numbers.data(), numbers.size()), true);
}

}  // namespace

FaceModel FaceModel::load(const std::filesystem::path& file) {
  std::vector<std::byte> bytes;
  try {
    bytes = files::read_bytes(file, kMostFileBytes, "face model");
  } catch (const Error& error) {
    if (error.kind() == ErrorKind::Unavailable) {
      throw;  // it may be there
    }
    throw Error(error.kind(), fmt::format("{}. `facet model build` makes it.", error.what()));
  }
  return parse(bytes, file.string());
}

FaceModel FaceModel::parse(std::span<const std::byte> bytes, const std::string& source,
                           std::uint64_t max_core_values) {
  const ChunkReader chunks(bytes, source, kFormat);
  FaceModel model;
  const Counts counts = parse_counts(chunks, model.name);
  const std::size_t vertices = counts.vertices;
  model.control.vertex_count = static_cast<std::int32_t>(counts.vertices);
  model.identity_modes = static_cast<int>(counts.identity_modes);
  model.expression_modes = static_cast<int>(counts.expression_modes);

  const std::uint32_t expressions = counts.expression_modes - 1;
  model.expression_names = parse_names(chunks, expressions);
  model.expression_sigma.resize(expressions);
  chunks.read("EXPS", model.expression_sigma.data(), expressions);

  // Raw chunks first: a file that claims more than it holds fails here, before memory is taken for the core.
  const auto raw_size = [&](const char* tag, std::size_t expected) {
    if (chunks.raw(tag).size() != expected) {
      chunks.fail(
          fmt::format("chunk '{}' holds {} bytes and should hold {}", tag, chunks.raw(tag).size(), expected));
    }
  };
  raw_size("QUAD", 4 * sizeof(std::int32_t) * counts.quads);
  raw_size("TEXC", vertices * 2 * sizeof(float));
  model.control.quads.resize(4, counts.quads);
  chunks.read("QUAD", model.control.quads.data(), static_cast<std::size_t>(model.control.quads.size()));
  model.control.texture_coordinates.resize(2, static_cast<Eigen::Index>(vertices));
  chunks.read("TEXC", model.control.texture_coordinates.data(), 2 * vertices);
  model.control.refinable.resize(vertices);
  chunks.read("REFI", model.control.refinable.data(), vertices);
  model.regions.resize(vertices);
  chunks.read("REGN", model.regions.data(), vertices);
  model.mean_albedo.resize(3, static_cast<Eigen::Index>(vertices));
  chunks.read("ALBE", model.mean_albedo.data(), 3 * vertices);
  model.landmarks.resize(counts.landmarks);
  if (counts.landmarks > 0) {
    chunks.read("LAND", model.landmarks.data(), model.landmarks.size());
  }
  model.skin = read_skin(chunks);
  parse_core(chunks, max_core_values, model);

  const std::string wrong = model.check();
  if (!wrong.empty()) {
    chunks.fail(wrong);
  }
  return model;
}

void FaceModel::save(const std::filesystem::path& file) const {
  std::string wrong = check();
  if (wrong.empty() && name.size() > kMaxNameBytes) {
    wrong = fmt::format("its name has {} bytes (allowed: {})", name.size(), kMaxNameBytes);
  }
  std::vector<std::byte> names;
  for (const std::string& expression : expression_names) {
    if (expression.size() > kMaxExpressionNameBytes) {
      wrong =
          fmt::format("the expression name '{}' has more than {} bytes", expression, kMaxExpressionNameBytes);
    }
    names.push_back(static_cast<std::byte>(expression.size()));
    const auto characters = bytes_of(expression.data(), expression.size());
    names.insert(names.end(), characters.begin(), characters.end());
  }
  if (!wrong.empty()) {
    throw Error(ErrorKind::Internal,
                fmt::format("{}: the face model can't be saved: {}", file.string(), wrong));
  }

  const Counts counts{
      static_cast<std::uint32_t>(control.vertex_count), static_cast<std::uint32_t>(control.quads.cols()),
      static_cast<std::uint32_t>(identity_modes),       static_cast<std::uint32_t>(expression_modes),
      static_cast<std::uint32_t>(landmarks.size()),     static_cast<std::uint32_t>(name.size())};
  const auto counts_bytes = bytes_of(&counts, 1);
  const auto name_bytes = bytes_of(name.data(), name.size());
  std::vector<std::byte> info(counts_bytes.begin(), counts_bytes.end());
  info.insert(info.end(), name_bytes.begin(), name_bytes.end());

  ChunkWriter writer(kFormat);
  const auto vertices = static_cast<std::size_t>(control.vertex_count);
  writer.add("INFO", info, false);
  writer.add("EXPN", names, false);
  writer.add("EXPS", bytes_of(expression_sigma.data(), expression_sigma.size()), false);
  writer.add("QUAD", bytes_of(control.quads.data(), static_cast<std::size_t>(control.quads.size())), false);
  writer.add("TEXC", bytes_of(control.texture_coordinates.data(), 2 * vertices), false);
  writer.add("REFI", bytes_of(control.refinable.data(), vertices), false);
  writer.add("REGN", bytes_of(regions.data(), vertices), false);
  writer.add("ALBE", bytes_of(mean_albedo.data(), 3 * vertices), false);
  if (!landmarks.empty()) {
    writer.add("LAND", bytes_of(landmarks.data(), landmarks.size()), false);
  }
  add_skin(skin, writer);
  add_core(*this, writer);
  files::OutputFile output(file);
  output.write(writer.file());
  output.commit();
}

}  // namespace facet::face
