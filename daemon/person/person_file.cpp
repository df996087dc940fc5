// The person file: docs/person.md describes every chunk.

#include "person/person_file.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string_view>

#include "face/chunk_file.hpp"
#include "face/person_model.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"

namespace facet::person {
namespace {

constexpr face::ChunkFormat kFormat{
    {'F', 'A', 'C', 'E', 'T', 'P', 'R', 'S'}, 1, "person", "enrol the person again with `facet enrol`"};

constexpr std::size_t kMostFileBytes = std::size_t{64} << 20;
constexpr files::JsonLimits kInfoLimits{.most_bytes = 65536, .most_values = 1000, .most_depth = 6};
constexpr std::int64_t kMostVertices = 1'000'000;
constexpr std::int64_t kMostModes = 1024;
/// A head's coordinates, mm: beyond them is no head.
constexpr float kFarthestMm = 1000;
constexpr mode_t kOwnerAlone = 0600;

/// The entries of the document; what is missing or of another kind is named.
class Info {
 public:
  Info(const nlohmann::json& document, const face::ChunkReader& chunks)
      : document_(document), chunks_(chunks) {}

  double number(const char* key, double low, double high) const {
    const nlohmann::json& value = at(key);
    if (!value.is_number() || !(value.get<double>() >= low && value.get<double>() <= high)) {
      chunks_.fail(fmt::format("'{}' is no number from {} to {}", key, low, high));
    }
    return value.get<double>();
  }
  std::int64_t whole(const char* key, std::int64_t low, std::int64_t high) const {
    return std::llround(number(key, static_cast<double>(low), static_cast<double>(high)));
  }
  std::string text(const char* key) const {
    const nlohmann::json& value = at(key);
    if (!value.is_string()) {
      chunks_.fail(fmt::format("'{}' is no text", key));
    }
    return value.get<std::string>();
  }
  std::vector<nlohmann::json> list(const char* key) const {
    const nlohmann::json& value = at(key);
    if (!value.is_array()) {
      chunks_.fail(fmt::format("'{}' is no list", key));
    }
    return value.get<std::vector<nlohmann::json>>();
  }

 private:
  const nlohmann::json& at(const char* key) const {
    if (!document_.is_object() || !document_.contains(key)) {
      chunks_.fail(fmt::format("chunk 'INFO' lacks '{}'", key));
    }
    return document_.at(key);
  }

  const nlohmann::json& document_;
  const face::ChunkReader& chunks_;
};

nlohmann::ordered_json document_of(const PersonFile& person) {
  nlohmann::ordered_json gates = nlohmann::ordered_json::array();
  for (const Gate& gate : person.gates) {
    gates.push_back(
        {{"name", gate.name}, {"value", gate.value}, {"limit", gate.limit}, {"passed", gate.passed}});
  }
  return {{"name", person.name},
          {"created_utc", person.created_utc},
          {"software", person.software},
          {"model", person.model_name},
          {"vertices", person.neutral_mm.cols()},
          {"identities", person.identity.size()},
          {"keyframes", person.keyframes},
          {"least_yaw_deg", person.span.least_yaw},
          {"largest_yaw_deg", person.span.largest_yaw},
          {"least_pitch_deg", person.span.least_pitch},
          {"largest_pitch_deg", person.span.largest_pitch},
          {"focal_px", person.focal_px},
          {"width_px", person.width_px},
          {"height_px", person.height_px},
          {"gates", gates}};
}

void fill(PersonFile& person, const Info& info, const face::ChunkReader& chunks) {
  person.name = info.text("name");
  person.created_utc = info.text("created_utc");
  person.software = info.text("software");
  person.model_name = info.text("model");
  person.keyframes = static_cast<int>(info.whole("keyframes", 0, 100'000));
  person.span = {info.number("least_yaw_deg", -180, 180), info.number("largest_yaw_deg", -180, 180),
                 info.number("least_pitch_deg", -90, 90), info.number("largest_pitch_deg", -90, 90)};
  person.focal_px = info.number("focal_px", 1, 1e6);
  person.width_px = static_cast<int>(info.whole("width_px", 1, 65536));
  person.height_px = static_cast<int>(info.whole("height_px", 1, 65536));
  for (const nlohmann::json& entry : info.list("gates")) {
    const Info gate(entry, chunks);
    constexpr double kLargest = 1e12;
    person.gates.push_back({gate.text("name"), gate.number("value", -kLargest, kLargest),
                            gate.number("limit", -kLargest, kLargest),
                            entry.contains("passed") && entry.at("passed") == true, ""});
  }
}

std::vector<std::byte> bytes_of_file(const PersonFile& person) {
  const std::string info = document_of(person).dump();
  face::ChunkWriter writer(kFormat);
  writer.add("INFO", face::bytes_of(info.data(), info.size()), false);
  writer.add("MODL", face::bytes_of(&person.model_checksum, 1), false);
  writer.add("NEUT",
             face::bytes_of(person.neutral_mm.data(), static_cast<std::size_t>(person.neutral_mm.size())),
             false);
  writer.add("IDEN", face::bytes_of(person.identity.data(), person.identity.size()), false);
  if (!person.sigma_mm.empty()) {
    writer.add("SIGM", face::bytes_of(person.sigma_mm.data(), person.sigma_mm.size()), false);
  }
  face::add_skin(person.skin, writer);
  return writer.file();
}

}  // namespace

std::uint64_t model_checksum(const face::FaceModel& model) {
  const auto quads =
      face::bytes_of(model.control.quads.data(), static_cast<std::size_t>(model.control.quads.size()));
  std::string names;
  for (const std::string& name : model.expression_names) {
    names += name + "\n";
  }
  const std::array<std::uint64_t, 3> parts{
      face::chunk_checksum(quads), face::chunk_checksum(face::bytes_of(names.data(), names.size())),
      face::chunk_checksum(face::bytes_of(model.core_mm.data(), model.core_mm.size()))};
  return face::chunk_checksum(face::bytes_of(parts.data(), parts.size()));
}

PersonFile parse_person(std::span<const std::byte> bytes, const std::string& source) {
  const face::ChunkReader chunks(bytes, source, kFormat);
  const auto text = chunks.raw("INFO");
  const nlohmann::json document =
      files::parse_json({reinterpret_cast<const char*>(text.data()), text.size()}, kInfoLimits, source);
  const Info info(document, chunks);
  PersonFile person;
  fill(person, info, chunks);
  chunks.read("MODL", &person.model_checksum, 1);
  // Sizes are held against the file's own bytes before memory is taken for them.
  const auto vertices = static_cast<std::size_t>(info.whole("vertices", 3, kMostVertices));
  const auto identities = static_cast<std::size_t>(info.whole("identities", 0, kMostModes));
  const auto sized = [&](const char* tag, std::size_t bytes_wanted) {
    if (chunks.raw(tag).size() != bytes_wanted) {
      chunks.fail(fmt::format("chunk '{}' holds {} bytes and should hold {}", tag, chunks.raw(tag).size(),
                              bytes_wanted));
    }
  };
  sized("NEUT", 3 * vertices * sizeof(float));
  sized("IDEN", identities * sizeof(float));
  person.neutral_mm.resize(3, static_cast<Eigen::Index>(vertices));
  chunks.read("NEUT", person.neutral_mm.data(), 3 * vertices);
  person.identity.resize(identities);
  chunks.read("IDEN", person.identity.data(), identities);
  if (chunks.has("SIGM")) {
    sized("SIGM", vertices * sizeof(float));
    person.sigma_mm.resize(vertices);
    chunks.read("SIGM", person.sigma_mm.data(), vertices);
  }
  if (!person.neutral_mm.allFinite() || person.neutral_mm.cwiseAbs().maxCoeff() > kFarthestMm ||
      std::any_of(person.identity.begin(), person.identity.end(),
                  [](float y) { return !(std::abs(y) <= 100); })) {
    chunks.fail("its face is no face: a coordinate is not finite or far off");
  }
  if (std::any_of(person.sigma_mm.begin(), person.sigma_mm.end(),
                  [](float sigma) { return !std::isnan(sigma) && !(sigma >= 0 && sigma <= kFarthestMm); })) {
    chunks.fail("a standard deviation is negative or far off");
  }
  person.skin = face::read_skin(chunks);
  return person;
}

PersonFile person_of(const face::FaceModel& model, const Observed& observed, const LearnedShape& learned) {
  PersonFile person;
  person.created_utc = fmt::format(
      "{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(std::chrono::time_point_cast<std::chrono::seconds>(Clock::utc())));
  person.model_name = model.name;
  person.model_checksum = model_checksum(model);
  person.keyframes = static_cast<int>(learned.keyframes.size());
  person.span = observed.span;
  person.focal_px = learned.focal_px;
  person.width_px = observed.camera.width_px;
  person.height_px = observed.camera.height_px;
  person.gates = learned.gates;
  person.identity = learned.identity;
  person.neutral_mm = learned.neutral_mm.cast<float>();
  const Eigen::VectorXf sigma = learned.sigma_mm.cast<float>();
  person.sigma_mm.assign(sigma.begin(), sigma.end());
  if (learned.skin.believed) {
    person.skin = learned.skin.chart;
  }
  return person;
}

bool begins_as_person(const std::filesystem::path& file) {
  const files::InputFile in(file, "person");
  std::array<char, kFormat.magic.size()> magic{};
  if (in.size() < magic.size()) {
    return false;
  }
  in.read(0, std::as_writable_bytes(std::span(magic)));
  return magic == kFormat.magic;
}

PersonFile read_person(const std::filesystem::path& file) {
  return parse_person(files::read_bytes(file, kMostFileBytes, "person"), file.string());
}

void write_person(const PersonFile& person, const std::filesystem::path& file) {
  files::OutputFile out(file, kOwnerAlone);
  out.write(bytes_of_file(person));
  out.commit_new();
}

void replace_person(const PersonFile& person, const PersonFile& before, const std::filesystem::path& file) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(std::filesystem::symlink_status(file, error)) ||
      bytes_of_file(read_person(file)) != bytes_of_file(before)) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' was deleted or changed meanwhile: it stays as it is now", file.string()));
  }
  files::OutputFile out(file, kOwnerAlone);
  out.write(bytes_of_file(person));
  out.commit();
}

void check_model(const PersonFile& person, const face::FaceModel& model, const std::string& source) {
  if (person.model_checksum != model_checksum(model) || person.neutral_mm.cols() != model.vertex_count() ||
      person.identity.size() != static_cast<std::size_t>(model.identity_count())) {
    throw Error(ErrorKind::Usage, fmt::format("{}: this person was enrolled with the face model '{}', not "
                                              "with '{}': give that one, or enrol again",
                                              source, person.model_name, model.name));
  }
}

face::FaceModel model_of(const PersonFile& person, const face::FaceModel& model, const std::string& source) {
  check_model(person, model, source);
  face::FaceModel own =
      face::person_model(model, person.identity, person.neutral_mm.cast<double>(), person.name);
  own.skin = person.skin;
  return own;
}

}  // namespace facet::person
