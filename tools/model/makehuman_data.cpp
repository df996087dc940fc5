#include "model/makehuman_data.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <climits>
#include <nlohmann/json.hpp>
#include <numeric>

#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "files/text_file.hpp"

namespace facet::model {
namespace {

using nlohmann::json;

constexpr std::size_t kVertices = 19158;  // of the base mesh; the width of a row of targets.bin
constexpr std::size_t kTargets = 1258;
constexpr std::size_t kRowBytes = kVertices * 3 * sizeof(std::int16_t);
constexpr double kTargetUnitDm = 1e-3;

// The file has no header: the sum of one row's x coordinates and the rest shows that rows and names still
// agree.
constexpr std::size_t kCheckedRow = 3;
constexpr long kCheckedRowSum = 2952;

constexpr const char* kHint = "Run packaging/fetch-assets again.";

[[noreturn]] void fail(const std::filesystem::path& file, const std::string& what) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}. {}", file.string(), what, kHint));
}

/// Of a mesh or a list of targets; the largest has 8 MB.
constexpr files::JsonLimits kJsonLimits{64U << 20, 8'000'000};

std::string read_text(const std::filesystem::path& file) {
  try {
    return files::read_text(file, kJsonLimits.most_bytes, "file of MakeHuman's");
  } catch (const Error& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}. {}", error.what(), kHint));
  }
}

/// A face's numbers are indices: whole, and none of them beyond an int.
std::vector<int> indices(const json& list, const std::filesystem::path& file) {
  std::vector<int> found;
  found.reserve(list.size());
  for (const json& number : list) {
    const bool whole = number.is_number_unsigned() && number.get<std::uint64_t>() <= INT_MAX;
    if (!whole) {
      fail(file, fmt::format("face number {} is not an index", found.size()));
    }
    found.push_back(number.get<int>());
  }
  return found;
}

}  // namespace

MakeHumanMesh parse_makehuman_mesh(std::string_view text, const std::filesystem::path& file,
                                   std::size_t vertex_count) {
  constexpr int kQuadMaterialUv = 11;  // face type bits: quad, material, one texture coordinate per corner
  constexpr std::size_t kFaceNumbers = 10;
  MakeHumanMesh mesh;
  try {
    const json document = files::parse_json(text, kJsonLimits, file.string());
    const auto vertices = document.at("vertices").get<std::vector<double>>();
    const auto faces = indices(document.at("faces"), file);
    const auto uvs = document.at("uvs").at(0).get<std::vector<float>>();
    if (vertices.size() != 3 * vertex_count || faces.size() % kFaceNumbers != 0 || uvs.size() % 2 != 0) {
      fail(file, fmt::format("{} vertex and {} face numbers are not those of the base mesh", vertices.size(),
                             faces.size()));
    }
    mesh.vertices_dm =
        Eigen::Map<const Eigen::Matrix3Xd>(vertices.data(), 3, static_cast<Eigen::Index>(vertex_count));
    mesh.texture_coordinates =
        Eigen::Map<const Eigen::Matrix2Xf>(uvs.data(), 2, static_cast<Eigen::Index>(uvs.size() / 2));
    for (const json& material : document.at("materials")) {
      mesh.group_names.push_back(material.at("DbgName").get<std::string>());
    }
    const auto quad_count = static_cast<Eigen::Index>(faces.size() / kFaceNumbers);
    mesh.quads.resize(4, quad_count);
    mesh.corner_uv.resize(4, quad_count);
    for (Eigen::Index q = 0; q < quad_count; ++q) {
      const int* face = faces.data() + static_cast<std::size_t>(q) * kFaceNumbers;
      if (face[0] != kQuadMaterialUv || face[5] >= static_cast<int>(mesh.group_names.size())) {
        fail(file, fmt::format("face {} is not a quad of a known group", q));
      }
      mesh.group.push_back(face[5]);
      for (int corner = 0; corner < 4; ++corner) {
        const int vertex = face[1 + corner];
        const int uv = face[6 + corner];
        if (vertex >= static_cast<int>(vertex_count) || uv >= mesh.texture_coordinates.cols()) {
          fail(file, fmt::format("face {} names a vertex that is not there", q));
        }
        mesh.quads(corner, q) = vertex;
        mesh.corner_uv(corner, q) = uv;
      }
    }
  } catch (const json::exception& error) {
    fail(file, fmt::format("unexpected contents: {}", error.what()));
  }
  return mesh;
}

MakeHumanMesh read_makehuman_mesh(const std::filesystem::path& file) {
  return parse_makehuman_mesh(read_text(file), file, kVertices);
}

MakeHumanRows parse_makehuman_target_list(std::string_view text, const std::filesystem::path& file,
                                          std::size_t target_count) {
  std::vector<std::string> names;
  try {
    const json document = files::parse_json(text, kJsonLimits, file.string());
    for (const auto& [key, value] : document.at("targets").items()) {
      std::string name = key;
      std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::tolower(c); });
      names.push_back(std::move(name));
    }
  } catch (const json::exception& error) {
    fail(file, fmt::format("unexpected contents: {}", error.what()));
  }
  if (names.size() != target_count) {
    fail(file, fmt::format("it lists {} targets and should list {}", names.size(), target_count));
  }
  // The rows of targets.bin follow the lower-cased names in the order of their bytes.
  std::sort(names.begin(), names.end());
  constexpr std::string_view kPrefix = "data/targets/";
  constexpr std::string_view kSuffix = ".target";
  MakeHumanRows rows;
  for (std::size_t row = 0; row < names.size(); ++row) {
    const std::string& name = names[row];
    if (name.size() <= kPrefix.size() + kSuffix.size()) {
      fail(file, fmt::format("'{}' is not a target's name", name));
    }
    rows[name.substr(kPrefix.size(), name.size() - kPrefix.size() - kSuffix.size())] = row;
  }
  return rows;
}

MakeHumanTargets::MakeHumanTargets(const std::filesystem::path& folder)
    : file_(folder / "public/data/targets/targets.bin"), values_(file_, "file of MakeHuman's") {
  const auto list_file = folder / "src/json/targets/target-list.json";
  rows_ = parse_makehuman_target_list(read_text(list_file), list_file, kTargets);
  if (values_.size() != kTargets * kRowBytes) {
    fail(file_, fmt::format("it does not hold {} bytes", kTargets * kRowBytes));
  }
  const std::vector<std::int16_t> checked = row(kCheckedRow);
  if (std::accumulate(checked.begin(), checked.end(), 0L) != kCheckedRowSum) {
    fail(file_, "its rows are not in the expected order");
  }
}

std::vector<std::int16_t> MakeHumanTargets::row(std::size_t index) const {
  std::vector<std::int16_t> values(kVertices * 3);
  values_.read(index * kRowBytes, std::as_writable_bytes(std::span(values)));
  return values;
}

std::vector<std::string> MakeHumanTargets::names(std::string_view prefix) const {
  std::vector<std::string> found;
  for (auto it = rows_.lower_bound(prefix); it != rows_.end() && it->first.starts_with(prefix); ++it) {
    found.push_back(it->first);
  }
  return found;
}

Eigen::Matrix3Xd MakeHumanTargets::displacements_dm(std::string_view name,
                                                    const std::vector<int>& vertices) const {
  const auto found = rows_.find(name);
  if (found == rows_.end()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("MakeHuman's data has no target '{}'. {}", name, kHint));
  }
  const std::vector<std::int16_t> values = row(found->second);
  Eigen::Matrix3Xd displacements(3, static_cast<Eigen::Index>(vertices.size()));
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    const std::int16_t* at = values.data() + 3 * static_cast<std::size_t>(vertices[v]);
    displacements.col(static_cast<Eigen::Index>(v)) = kTargetUnitDm * Eigen::Vector3d(at[0], at[1], at[2]);
  }
  return displacements;
}

std::vector<render::Picture> read_makehuman_skins(const std::filesystem::path& folder) {
  const auto skins = folder / "public/data/skins";
  std::error_code error;
  std::vector<std::filesystem::path> files;
  for (std::filesystem::recursive_directory_iterator it(skins, error), end; !error && it != end;
       it.increment(error)) {
    const std::string name = it->path().filename().string();
    const bool drawn = name.find("toon") != std::string::npos || name.find("suit") != std::string::npos;
    if (it->path().parent_path().filename() == "textures" && it->path().extension() == ".png" && !drawn) {
      files.push_back(it->path());
    }
  }
  if (files.empty()) {
    fail(skins, "no skin pictures are there");
  }
  std::sort(files.begin(), files.end());
  std::vector<render::Picture> pictures;
  pictures.reserve(files.size());
  for (const auto& file : files) {
    pictures.push_back(render::read_image(file));
  }
  return pictures;
}

}  // namespace facet::model
