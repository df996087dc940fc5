#include "model/ict_model.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <map>
#include <numbers>
#include <optional>
#include <utility>

#include "facet/error.hpp"
#include "files/text_file.hpp"
#include "model/appearance.hpp"
#include "model/expression_shapes.hpp"
#include "model/head_mesh.hpp"
#include "model/portrait.hpp"
#include "render/renderer.hpp"

namespace facet::model {
namespace {

using face::FaceModel;
using face::Region;

constexpr Eigen::Index kIctVertices = 26'719;
constexpr double kMmPerCm = 10;
constexpr long kMostObjVertices = 10'000'000;

/// Runs of vertices in ICT's order; what lies between is left out.
struct Run {
  int first;
  int end;
  Part part;
};
constexpr int kNarrowFaceEnd = 6706;
constexpr std::array<Run, 6> kRuns{{{0, 9409, Part::Skin},
                                    {11248, 13294, Part::MouthInterior},
                                    {13294, 13678, Part::Socket},
                                    {13678, 14062, Part::Socket},
                                    {21451, 22221, Part::LeftEyeball},
                                    {23021, 23791, Part::RightEyeball}}};

[[noreturn]] void fail(const std::filesystem::path& file, const std::string& what) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", file.string(), what));
}

/// The line's next word, taken off it; empty at its end.
std::string_view next_word(std::string_view& line) {
  constexpr std::string_view kBlanks = " \t\r";
  line.remove_prefix(std::min(line.find_first_not_of(kBlanks), line.size()));
  const std::string_view word = line.substr(0, line.find_first_of(kBlanks));
  line.remove_prefix(word.size());
  return word;
}

/// A word that is a number from its first to its last character.
template <typename Number>
std::optional<Number> number(std::string_view word) {
  Number value{};
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  return error == std::errc() && end == word.data() + word.size() ? std::optional<Number>(value)
                                                                  : std::nullopt;
}

ObjMesh read_obj(const std::filesystem::path& file) {
  constexpr std::size_t kMostBytes = 64U << 20;  // ICT-FaceKit's have 5 MB
  ObjMesh mesh = parse_obj(files::read_text(file, kMostBytes, "mesh"), file);
  if (mesh.vertices.cols() != kIctVertices) {
    fail(file, fmt::format("{} vertices; ICT-FaceKit's meshes have {}", mesh.vertices.cols(), kIctVertices));
  }
  return mesh;
}

/// What is kept of ICT's mesh: the runs' quads and their vertices (an eyeball's poles have triangles alone).
HeadMesh cut_ict_head(const ObjMesh& neutral, const std::filesystem::path& file) {
  std::vector<std::optional<Part>> part_of(static_cast<std::size_t>(kIctVertices));
  for (const Run& run : kRuns) {
    std::fill(part_of.begin() + run.first, part_of.begin() + run.end, run.part);
  }
  std::vector<Eigen::Index> quads;
  std::vector<int> kept(part_of.size(), -1);
  for (Eigen::Index q = 0; q < neutral.quads.cols(); ++q) {
    const auto quad = neutral.quads.col(q);
    if (std::all_of(quad.begin(), quad.end(), [&](int v) { return part_of[static_cast<std::size_t>(v)]; })) {
      quads.push_back(q);
      std::for_each(quad.begin(), quad.end(), [&](int v) { kept[static_cast<std::size_t>(v)] = 0; });
    }
  }
  HeadMesh head;
  for (std::size_t v = 0; v < kept.size(); ++v) {
    if (kept[v] == 0) {
      kept[v] = head.vertex_count();
      head.base_vertex.push_back(static_cast<int>(v));
      head.part.push_back(*part_of[v]);
    }
  }
  for (const Run& run : kRuns) {
    if (std::count(head.part.begin(), head.part.end(), run.part) < (run.end - run.first) / 2) {
      fail(file, "its faces are not those of ICT-FaceKit's mesh: a part of the head has none");
    }
  }
  head.quads =
      neutral.quads(Eigen::all, quads).unaryExpr([&](int v) { return kept[static_cast<std::size_t>(v)]; });
  std::map<std::pair<int, int>, int> edges;
  for (Eigen::Index q = 0; q < head.quads.cols(); ++q) {
    for (int corner = 0; corner < 4; ++corner) {
      ++edges[std::minmax(head.quads(corner, q), head.quads((corner + 1) % 4, q))];
    }
  }
  head.on_boundary.assign(head.part.size(), 0);
  for (const auto& [edge, count] : edges) {
    if (count > 2) {
      fail(file, "its faces are not those of ICT-FaceKit's mesh: an edge has more than two");
    }
    if (count == 1) {
      head.on_boundary[static_cast<std::size_t>(edge.first)] = 1;
      head.on_boundary[static_cast<std::size_t>(edge.second)] = 1;
    }
  }
  return head;
}

/// Skin vertices that share a quad with another part: the lips' and lids' seams.
void find_seams(const Eigen::Matrix3Xd& mean_mm, HeadMesh& head) {
  std::vector<std::uint8_t> beside(head.part.size(), 0);  // 1: the inner mouth, 2: a socket
  for (Eigen::Index q = 0; q < head.quads.cols(); ++q) {
    for (const int v : head.quads.col(q)) {
      const Part part = head.part[static_cast<std::size_t>(v)];
      const std::uint8_t mark = part == Part::MouthInterior ? 1 : part == Part::Socket ? 2 : 0;
      for (const int other : head.quads.col(q)) {
        beside[static_cast<std::size_t>(other)] =
            static_cast<std::uint8_t>(beside[static_cast<std::size_t>(other)] | mark);
      }
    }
  }
  for (int v = 0; v < head.vertex_count(); ++v) {
    const auto at = static_cast<std::size_t>(v);
    if (head.part[at] != Part::Skin || beside[at] == 0) {
      continue;
    }
    (beside[at] == 1     ? head.lip_seam
     : mean_mm(0, v) > 0 ? head.left_lid_seam
                         : head.right_lid_seam)
        .push_back(v);
  }
}

/// The skin unrolled from a cylinder about the head's axis; the parts behind it in a strip below, side by
/// side.
mesh::TextureCoordinates unroll(const HeadMesh& head, const Eigen::Matrix3Xd& mean_mm) {
  constexpr double kAxisBehindEyes_mm = 60;
  constexpr double kStrip = 0.12;
  mesh::TextureCoordinates out(2, mean_mm.cols());
  for (std::size_t r = 0; r < kRuns.size(); ++r) {
    std::vector<Eigen::Index> vertices;
    for (Eigen::Index v = 0; v < mean_mm.cols(); ++v) {
      const int base = head.base_vertex[static_cast<std::size_t>(v)];
      if (base >= kRuns.at(r).first && base < kRuns.at(r).end) {
        vertices.push_back(v);
      }
    }
    Eigen::Matrix2Xd flat(2, static_cast<Eigen::Index>(vertices.size()));
    for (Eigen::Index k = 0; k < flat.cols(); ++k) {
      const Eigen::Vector3d p = mean_mm.col(vertices[static_cast<std::size_t>(k)]);
      flat.col(k) << std::atan2(p.x(), p.z() + kAxisBehindEyes_mm), p.y();
    }
    const Eigen::Vector2d low = flat.rowwise().minCoeff();
    const Eigen::Vector2d size = flat.rowwise().maxCoeff() - low;
    const double slots = static_cast<double>(kRuns.size()) - 1;
    const Eigen::Vector2d corner =
        r == 0 ? Eigen::Vector2d(0, kStrip) : Eigen::Vector2d((static_cast<double>(r) - 1) / slots, 0);
    const Eigen::Vector2d box =
        r == 0 ? Eigen::Vector2d(1, 1 - kStrip) : Eigen::Vector2d(0.95 / slots, 0.95 * kStrip);
    for (std::size_t k = 0; k < vertices.size(); ++k) {
      const Eigen::Vector2d part = (flat.col(static_cast<Eigen::Index>(k)) - low).cwiseQuotient(size);
      out.col(vertices[k]) = (corner + box.cwiseProduct(part)).cast<float>();
    }
  }
  return out;
}

/// The files of an expression that ARKit names; empty where one is missing.
std::vector<std::filesystem::path> files_of(const std::filesystem::path& folder, const std::string& arkit) {
  const auto file = [&](const std::string& stem) { return folder / (stem + ".obj"); };
  std::vector<std::string> stems{arkit};
  if (arkit.ends_with("Left")) {
    stems.push_back(arkit.substr(0, arkit.size() - 4) + "_L");
  } else if (arkit.ends_with("Right")) {
    stems.push_back(arkit.substr(0, arkit.size() - 5) + "_R");
  }
  for (const std::string& stem : stems) {
    if (std::filesystem::exists(file(stem))) {
      return {file(stem)};
    }
  }
  if (std::filesystem::exists(file(arkit + "_L")) && std::filesystem::exists(file(arkit + "_R"))) {
    return {file(arkit + "_L"), file(arkit + "_R")};
  }
  return {};
}

Eigen::Vector3d middle_of_eyes(const HeadMesh& head, const Eigen::Matrix3Xd& points) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Part part : {Part::LeftEyeball, Part::RightEyeball}) {
    const std::vector<int> eyeball = head.vertices_of(part);
    for (const int v : eyeball) {
      sum += points.col(v) / (2.0 * static_cast<double>(eyeball.size()));
    }
  }
  return sum;
}

/// Plain skin, until borrow_albedo gives it another one's.
mesh::Vertices plain_albedo(const HeadMesh& head, const Eigen::Matrix3Xd& mean_mm,
                            const std::vector<std::uint8_t>& regions) {
  const Eigen::Vector3f skin(0.42F, 0.25F, 0.19F);
  const Eigen::Vector3f lips(0.33F, 0.13F, 0.12F);
  const Eigen::Vector3f mouth(0.2F, 0.07F, 0.06F);
  mesh::Vertices albedo(3, head.vertex_count());
  for (Eigen::Index v = 0; v < albedo.cols(); ++v) {
    const std::uint8_t bits = regions[static_cast<std::size_t>(v)];
    albedo.col(v) = face::has_region(bits, Region::Lips)            ? lips
                    : face::has_region(bits, Region::MouthInterior) ? mouth
                                                                    : skin;
  }
  paint_eyeballs(head, mean_mm, albedo);
  return albedo;
}

}  // namespace

ObjMesh parse_obj(std::string_view text, const std::filesystem::path& file) {
  std::vector<double> coordinates;
  std::vector<int> corners;
  ObjMesh mesh;
  std::size_t line_number = 0;
  while (!text.empty()) {
    ++line_number;
    const std::size_t end = std::min(text.find('\n'), text.size());
    std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    const auto refuse = [&](const std::string& what) {
      fail(file, fmt::format("line {}: {}", line_number, what));
    };
    const std::string_view keyword = next_word(line);
    if (keyword == "v") {
      for (int axis = 0; axis < 3; ++axis) {
        const auto coordinate = number<double>(next_word(line));
        if (!coordinate || !std::isfinite(*coordinate)) {
          refuse("a vertex needs three numbers");
        }
        coordinates.push_back(*coordinate);
      }
    } else if (keyword == "f") {
      // Corners are vertex/texture/normal; numbers count from 1, or backwards from the last vertex before.
      const auto count = static_cast<long>(coordinates.size() / 3);
      std::array<int, 4> quad{};
      std::size_t size = 0;
      for (std::string_view word = next_word(line); !word.empty(); word = next_word(line), ++size) {
        const auto index = number<long>(word.substr(0, word.find('/')));
        const long vertex = !index                           ? -1
                            : *index > 0                     ? *index - 1
                            : *index < 0 && *index >= -count ? count + *index
                                                             : -1;
        if (vertex < 0 || vertex >= kMostObjVertices) {
          refuse(fmt::format("'{}' is no corner of a face", word.substr(0, 40)));
        }
        if (size < quad.size()) {
          quad.at(size) = static_cast<int>(vertex);
        }
      }
      if (size == quad.size()) {
        corners.insert(corners.end(), quad.begin(), quad.end());
      } else {
        ++mesh.other_faces;
      }
    }
  }
  const auto count = static_cast<Eigen::Index>(coordinates.size() / 3);
  if (count == 0 || count > kMostObjVertices) {
    fail(file, count == 0 ? "no vertex in it" : "too many vertices");
  }
  for (const int vertex : corners) {
    if (vertex >= count) {
      fail(file, fmt::format("a face names vertex {} of {}", vertex + 1, count));
    }
  }
  mesh.vertices = Eigen::Map<const Eigen::Matrix3Xd>(coordinates.data(), 3, count);
  mesh.quads =
      Eigen::Map<const mesh::Quads>(corners.data(), 4, static_cast<Eigen::Index>(corners.size() / 4));
  return mesh;
}

FaceModel import_ict(const IctOptions& options, const std::function<void(int done, int total)>& progress,
                     IctReport& report) {
  const std::filesystem::path folder = std::filesystem::is_directory(options.folder / "FaceXModel")
                                           ? options.folder / "FaceXModel"
                                           : options.folder;
  const std::filesystem::path neutral_file = folder / "generic_neutral_mesh.obj";
  const ObjMesh neutral = read_obj(neutral_file);
  HeadMesh head = cut_ict_head(neutral, neutral_file);
  const Eigen::Vector3d origin_cm = middle_of_eyes(head, neutral.vertices(Eigen::all, head.base_vertex));
  const Eigen::Matrix3Xd mean_mm =
      kMmPerCm * (neutral.vertices(Eigen::all, head.base_vertex).colwise() - origin_cm);
  find_seams(mean_mm, head);
  head.texture_coordinates = unroll(head, mean_mm);

  report = {};
  std::vector<std::vector<std::filesystem::path>> shape_files;  // identities, then expressions
  const auto identity_file = [&](int mode) { return folder / fmt::format("identity{:03}.obj", mode); };
  while (report.identity_modes < options.identity_modes &&
         std::filesystem::exists(identity_file(report.identity_modes))) {
    shape_files.push_back({identity_file(report.identity_modes++)});
  }
  FaceModel model;
  for (const ExpressionName& expression : expression_names()) {
    std::vector<std::filesystem::path> files = files_of(folder, expression.name);
    (files.empty() ? report.missing : report.expressions).emplace_back(expression.name);
    if (!files.empty()) {
      model.expression_names.emplace_back(expression.name);
      model.expression_sigma.push_back(expression.sigma);
      shape_files.push_back(std::move(files));
    }
  }
  if (report.expressions.empty()) {
    fail(folder, "no expression in it: NAME.obj, NAME_L.obj and NAME_R.obj are looked for");
  }
  model.name = fmt::format("ICT-FaceKit (MIT), {} identity modes, {} ARKit expressions",
                           report.identity_modes, report.expressions.size());
  model.control.quads = head.quads;
  model.control.vertex_count = head.vertex_count();
  model.control.texture_coordinates = head.texture_coordinates;
  model.regions = find_regions(head, mean_mm, std::vector<std::uint8_t>(head.part.size(), 0));
  for (std::size_t v = 0; v < model.regions.size(); ++v) {
    // Ears, neck and the skull's side are skin that shading is not asked about.
    if (head.part[v] == Part::Skin && head.base_vertex[v] >= kNarrowFaceEnd) {
      model.regions[v] =
          static_cast<std::uint8_t>((model.regions[v] & ~static_cast<unsigned>(Region::Refinable)) |
                                    static_cast<unsigned>(Region::Scalp));
    }
    model.control.refinable.push_back(face::has_region(model.regions[v], Region::Refinable) ? 1 : 0);
  }
  model.mean_albedo = plain_albedo(head, mean_mm, model.regions);
  model.identity_modes = report.identity_modes + 1;
  model.expression_modes = static_cast<int>(report.expressions.size()) + 1;
  const auto values = static_cast<std::uint64_t>(model.identity_modes) *
                      static_cast<std::uint64_t>(model.expression_modes) *
                      static_cast<std::uint64_t>(head.vertex_count()) * 3;
  if (values > FaceModel::kMaxCoreValues) {
    throw Error(ErrorKind::Usage,
                fmt::format("{} identity modes are too many for a model file; take fewer (--modes)",
                            report.identity_modes));
  }
  model.core_mm.assign(values, 0.0F);
  model.core_row(0, 0) = mean_mm.cast<float>();
  const auto total = static_cast<int>(shape_files.size());
  for (int s = 0; s < total; ++s) {
    Eigen::Matrix3Xd shape_mm = Eigen::Matrix3Xd::Zero(3, head.vertex_count());
    for (const std::filesystem::path& file : shape_files[static_cast<std::size_t>(s)]) {
      const ObjMesh deformed = read_obj(file);
      shape_mm += kMmPerCm * (deformed.vertices - neutral.vertices)(Eigen::all, head.base_vertex);
    }
    const bool identity = s < report.identity_modes;
    model.core_row(identity ? s + 1 : 0, identity ? 0 : s - report.identity_modes + 1) =
        shape_mm.cast<float>();
    progress(s + 1, total);
  }
  return model;
}

void borrow_albedo(const FaceModel& donor, FaceModel& model) {
  if (donor.landmarks.empty() || model.landmarks.empty()) {
    throw Error(
        ErrorKind::Usage,
        "albedo is carried from model to model by landmarks: run `facet model landmarks` on both first");
  }
  const mesh::Vertices donor_mm = donor.core_row(0, 0);
  const mesh::Vertices mean_mm = model.core_row(0, 0);
  std::vector<Eigen::Vector3f> from;
  std::vector<Eigen::Vector3f> onto;
  const auto has_place = [](const face::LandmarkAnchor& anchor) {
    return anchor.weights[0] + anchor.weights[1] + anchor.weights[2] > 0;
  };
  for (std::size_t l = 0; l < donor.landmarks.size(); ++l) {
    if (has_place(donor.landmarks[l]) && has_place(model.landmarks[l])) {
      from.push_back(FaceModel::anchor_point(model.landmarks[l], mean_mm));
      onto.push_back(FaceModel::anchor_point(donor.landmarks[l], donor_mm));
    }
  }
  const auto matrix = [](const std::vector<Eigen::Vector3f>& points) {
    return Eigen::MatrixXd(
        Eigen::Map<const Eigen::Matrix3Xf>(points.front().data(), 3, static_cast<Eigen::Index>(points.size()))
            .cast<double>());
  };
  const Eigen::Matrix4f donor_from_model =
      Eigen::Matrix4d(Eigen::umeyama(matrix(from), matrix(onto), true)).cast<float>();
  const mesh::Triangles all = model_triangles(donor);
  std::vector<Eigen::Index> skin;
  const auto is_skin = [](std::uint8_t bits) {
    return !face::has_region(bits, Region::Eye) && !face::has_region(bits, Region::MouthInterior);
  };
  for (Eigen::Index t = 0; t < all.cols(); ++t) {
    if (std::all_of(all.col(t).begin(), all.col(t).end(),
                    [&](int v) { return is_skin(donor.regions[static_cast<std::size_t>(v)]); })) {
      skin.push_back(t);
    }
  }
  const mesh::Triangles triangles = all(Eigen::all, skin);
  const render::Raycaster surface(donor_mm, triangles);
  constexpr float kReach_mm = 60;
  for (Eigen::Index v = 0; v < mean_mm.cols(); ++v) {
    if (!is_skin(model.regions[static_cast<std::size_t>(v)])) {
      continue;
    }
    const Eigen::Vector3f at = (donor_from_model * mean_mm.col(v).homogeneous()).head<3>();
    const auto closest = surface.closest_point(at, kReach_mm);
    if (closest.triangle >= 0) {
      model.mean_albedo.col(v) =
          render::interpolate(triangles, closest.triangle, closest.barycentric, donor.mean_albedo);
    }
  }
}

}  // namespace facet::model
