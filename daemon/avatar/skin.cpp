#include "avatar/skin.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>
#include <stdexcept>

#include "facet/error.hpp"
#include "maths/statistics.hpp"
#include "render/renderer.hpp"

namespace facet::avatar {
namespace {

using Json = nlohmann::ordered_json;

// Component types of glTF 2.0.
constexpr int kUnsignedByte = 5121;
constexpr int kUnsignedShort = 5123;
constexpr int kUnsignedInt = 5125;
constexpr int kFloat = 5126;
constexpr int kTrianglesMode = 4;

std::size_t bytes_of(int component) {
  switch (component) {
    case kUnsignedByte:
      return 1;
    case kUnsignedShort:
      return 2;
    case kUnsignedInt:
    case kFloat:
      return 4;
    default:
      throw std::runtime_error(fmt::format("numbers of type {} are not understood", component));
  }
}

/// Elements in the first buffer, every byte of them inside.
struct Elements {
  const std::byte* first = nullptr;
  std::size_t step = 0;
  int component = kFloat;

  double number(std::size_t element, std::size_t axis) const {
    const std::byte* at = first + element * step + axis * bytes_of(component);
    const auto as = [at](auto value) {
      std::memcpy(&value, at, sizeof(value));
      return static_cast<double>(value);
    };
    switch (component) {
      case kUnsignedByte:
        return as(std::uint8_t{});
      case kUnsignedShort:
        return as(std::uint16_t{});
      case kUnsignedInt:
        return as(std::uint32_t{});
      default:
        return as(float{});
    }
  }
};

/// count > 0.
Elements elements(const GlbDocument& glb, const Json& where, int component, std::size_t width,
                  std::size_t count) {
  const Json& view = glb.json.at("bufferViews").at(where.at("bufferView").get<std::size_t>());
  if (view.contains("extensions") && view.at("extensions").contains("EXT_meshopt_compression")) {
    throw std::runtime_error("it is compressed (EXT_meshopt_compression): export it without");
  }
  if (view.value("buffer", std::uint64_t{0}) != 0) {
    throw std::runtime_error("its data are in another buffer");
  }
  const auto begin = view.value("byteOffset", std::uint64_t{0});
  const auto length = view.at("byteLength").get<std::uint64_t>();
  const auto offset = where.value("byteOffset", std::uint64_t{0});
  const std::size_t size = width * bytes_of(component);
  const auto step = view.value("byteStride", std::uint64_t{size});
  constexpr std::uint64_t kMostStep = 252;  // of glTF 2.0
  if (begin > glb.binary.size() || length > glb.binary.size() - begin || step < size || step > kMostStep ||
      offset > length || count > kMostGlbBytes || (count - 1) * step + size > length - offset) {
    throw std::runtime_error("an accessor reaches beyond its data");
  }
  return {glb.binary.data() + begin + offset, step, component};
}

std::size_t count_of(const GlbDocument& glb, std::size_t accessor) {
  return glb.json.at("accessors").at(accessor).at("count").get<std::size_t>();
}

/// An accessor's numbers, [width][count]; what is sparse is put in. Integers are of 0 to 1 where they are
/// normalized.
Eigen::MatrixXf numbers(const GlbDocument& glb, std::size_t index, std::size_t width, const char* type,
                        std::size_t count) {
  const Json& accessor = glb.json.at("accessors").at(index);
  const int component = accessor.at("componentType").get<int>();
  const bool normalized = accessor.value("normalized", false);
  if (accessor.at("type") != type || accessor.at("count").get<std::size_t>() != count ||
      (component != kFloat && !normalized)) {
    throw std::runtime_error(fmt::format(
        "accessor {} is not what its place wants ({} floats of {}; quantized positions are not read)", index,
        count, type));
  }
  const double unit = component == kUnsignedByte    ? 1.0 / 255
                      : component == kUnsignedShort ? 1.0 / 65535
                                                    : 1.0;
  Eigen::MatrixXf out =
      Eigen::MatrixXf::Zero(static_cast<Eigen::Index>(width), static_cast<Eigen::Index>(count));
  const auto put = [&](std::size_t column, const Elements& from, std::size_t element) {
    for (std::size_t axis = 0; axis < width; ++axis) {
      out(static_cast<Eigen::Index>(axis), static_cast<Eigen::Index>(column)) =
          static_cast<float>(unit * from.number(element, axis));
    }
  };
  if (accessor.contains("bufferView")) {
    const Elements from = elements(glb, accessor, component, width, count);
    for (std::size_t i = 0; i < count; ++i) {
      put(i, from, i);
    }
  }
  if (accessor.contains("sparse")) {
    const Json& sparse = accessor.at("sparse");
    const auto sparse_count = sparse.at("count").get<std::size_t>();
    if (sparse_count < 1 || sparse_count > count) {
      throw std::runtime_error("a sparse accessor is longer than what it is of");
    }
    const Json& places = sparse.at("indices");
    const Elements at = elements(glb, places, places.at("componentType").get<int>(), 1, sparse_count);
    const Elements values = elements(glb, sparse.at("values"), component, width, sparse_count);
    for (std::size_t i = 0; i < sparse_count; ++i) {
      const double column = at.number(i, 0);
      if (!(column >= 0 && column < static_cast<double>(count))) {
        throw std::runtime_error("a sparse accessor reaches beyond what it is of");
      }
      put(static_cast<std::size_t>(column), values, i);
    }
  }
  if (!out.allFinite()) {
    throw std::runtime_error("a number is not finite");
  }
  return out;
}

mesh::Triangles triangles_of(const GlbDocument& glb, const Json& primitive, std::size_t vertex_count) {
  std::vector<std::int32_t> corners;
  if (primitive.contains("indices")) {
    const Json& accessor = glb.json.at("accessors").at(primitive.at("indices").get<std::size_t>());
    const auto count = accessor.at("count").get<std::size_t>();
    if (count == 0) {
      return {};
    }
    const Elements from = elements(glb, accessor, accessor.at("componentType").get<int>(), 1, count);
    corners.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
      const double vertex = from.number(i, 0);
      if (!(vertex >= 0 && vertex < static_cast<double>(vertex_count))) {
        throw std::runtime_error("a triangle names a vertex that is not there");
      }
      corners.push_back(static_cast<std::int32_t>(vertex));
    }
  } else {
    for (std::size_t vertex = 0; vertex < vertex_count; ++vertex) {
      corners.push_back(static_cast<std::int32_t>(vertex));
    }
  }
  const auto count = static_cast<Eigen::Index>(corners.size() / 3);
  return Eigen::Map<const mesh::Triangles>(corners.data(), 3, count);
}

/// What a skin's primitive takes of kMostSkinValues.
void spend(std::size_t& budget, std::size_t values) {
  if (values > budget) {
    throw std::runtime_error("its meshes are too large");
  }
  budget -= values;
}

std::optional<Skin> read_skin(const GlbDocument& glb, const Json& mesh, const Json& primitive,
                              const AvatarMesh& entry, std::size_t& budget) {
  if (primitive.value("mode", kTrianglesMode) != kTrianglesMode) {
    return std::nullopt;
  }
  if (primitive.contains("extensions") && primitive.at("extensions").contains("KHR_draco_mesh_compression")) {
    throw std::runtime_error("it is compressed (KHR_draco_mesh_compression): export it without");
  }
  const Json& attributes = primitive.at("attributes");
  const auto position = attributes.at("POSITION").get<std::size_t>();
  const std::size_t count = count_of(glb, position);
  if (count == 0 || !glb.json.at("accessors").at(position).contains("bufferView")) {
    return std::nullopt;
  }
  Skin skin;
  skin.name = mesh.value("name", "");
  if (primitive.contains("material")) {
    const Json& material = glb.json.at("materials").at(primitive.at("material").get<std::size_t>());
    skin.name += fmt::format("{}{}", skin.name.empty() ? "" : ", ", material.value("name", ""));
  }
  spend(budget, 12 * count);
  skin.vertices = numbers(glb, position, 3, "VEC3", count);
  skin.triangles = triangles_of(glb, primitive, count);
  spend(budget, static_cast<std::size_t>(skin.triangles.size()));
  if (attributes.contains("TEXCOORD_0")) {
    skin.texture_coordinates = numbers(glb, attributes.at("TEXCOORD_0").get<std::size_t>(), 2, "VEC2", count);
    skin.texture_coordinates.row(1) = 1.0F - skin.texture_coordinates.row(1).array();
  }
  if (attributes.contains("NORMAL")) {
    skin.normals = numbers(glb, attributes.at("NORMAL").get<std::size_t>(), 3, "VEC3", count);
    skin.normals.colwise().normalize();
  } else {
    mesh::vertex_normals(skin.vertices, skin.triangles, skin.normals);
  }
  static const Json kNone = Json::array();
  const Json& targets = primitive.contains("targets") ? primitive.at("targets") : kNone;
  for (std::size_t target = 0; target < std::min(targets.size(), entry.shapes.size()); ++target) {
    const int shape = entry.shapes[target];
    const bool known = std::any_of(skin.shapes.begin(), skin.shapes.end(),
                                   [shape](const auto& one) { return one.first == shape; });
    if (shape < 0 || known || !targets.at(target).contains("POSITION")) {
      continue;
    }
    spend(budget, 3 * count);
    skin.shapes.emplace_back(
        shape, numbers(glb, targets.at(target).at("POSITION").get<std::size_t>(), 3, "VEC3", count));
  }
  if (skin.shapes.empty() || skin.triangles.cols() == 0) {
    return std::nullopt;
  }
  return skin;
}

/// Where a shape moves a surface; empty where it does not.
std::optional<Eigen::Vector3f> centre_of(const mesh::Vertices& vertices, const mesh::Triangles& triangles,
                                         const mesh::Vertices& movement) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double weight = 0;
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const Eigen::Vector3i corner = triangles.col(t);
    const Eigen::Vector3f a = vertices.col(corner[0]);
    const Eigen::Vector3f b = vertices.col(corner[1]);
    const Eigen::Vector3f c = vertices.col(corner[2]);
    const Eigen::Vector3f moved =
        (movement.col(corner[0]) + movement.col(corner[1]) + movement.col(corner[2])) / 3;
    const double share = static_cast<double>((b - a).cross(c - a).norm() * moved.squaredNorm());
    sum += share * ((a + b + c) / 3).cast<double>();
    weight += share;
  }
  // A shape whose movement nobody sees has no place.
  const float size = (vertices.rowwise().maxCoeff() - vertices.rowwise().minCoeff()).norm();
  if (!(movement.colwise().norm().maxCoeff() > 1e-3F * size) || !(weight > 0)) {
    return std::nullopt;
  }
  return (sum / weight).cast<float>();
}

/// Pairs of points, the skin's and the face's, with weights.
struct Pairs {
  std::vector<Eigen::Vector3f> from;
  std::vector<Eigen::Vector3f> to_mm;
  std::vector<float> weights;

  void add(const Eigen::Vector3f& skin, const Eigen::Vector3f& face_mm, float weight) {
    from.push_back(skin);
    to_mm.push_back(face_mm);
    weights.push_back(weight);
  }
};

/// The similarity with the least weighted square distance [Ume91].
void fit(const Pairs& pairs, Placement& out) {
  Eigen::Vector3d from_mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d to_mean = Eigen::Vector3d::Zero();
  double sum = 0;
  for (std::size_t i = 0; i < pairs.from.size(); ++i) {
    const auto weight = static_cast<double>(pairs.weights[i]);
    from_mean += weight * pairs.from[i].cast<double>();
    to_mean += weight * pairs.to_mm[i].cast<double>();
    sum += weight;
  }
  from_mean /= sum;
  to_mean /= sum;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  double variance = 0;
  for (std::size_t i = 0; i < pairs.from.size(); ++i) {
    const auto weight = static_cast<double>(pairs.weights[i]);
    const Eigen::Vector3d from = pairs.from[i].cast<double>() - from_mean;
    covariance += weight * (pairs.to_mm[i].cast<double>() - to_mean) * from.transpose();
    variance += weight * from.squaredNorm();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d signs(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1);
  const Eigen::Matrix3d turn = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  const double scale = svd.singularValues().dot(signs) / variance;
  out.mm_per_unit = static_cast<float>(scale);
  out.head_from_skin = turn.cast<float>();
  out.translation_mm = (to_mean - scale * (turn * from_mean)).cast<float>();
}

/// By the similarity alone.
Eigen::Vector3f moved_mm(const Placement& placement, const Eigen::Vector3f& point) {
  return placement.mm_per_unit * (placement.head_from_skin * point) + placement.translation_mm;
}

std::vector<float> distances_mm(const Pairs& pairs, const Placement& placement) {
  std::vector<float> out;
  for (std::size_t i = 0; i < pairs.from.size(); ++i) {
    out.push_back((moved_mm(placement, pairs.from[i]) - pairs.to_mm[i]).norm());
  }
  return out;
}

/// Weights of Cauchy's loss.
void reweigh(Pairs& pairs, const Placement& placement) {
  const std::vector<float> distances = distances_mm(pairs, placement);
  const float scale = std::max(1.0F, maths::median_of(std::vector(distances)));
  for (std::size_t i = 0; i < distances.size(); ++i) {
    pairs.weights[i] = 1.0F / (1.0F + (distances[i] / scale) * (distances[i] / scale));
  }
}

/// Every so many vertices of a skin are enough to place it.
constexpr Eigen::Index kProbes = 4000;

/// The pairs of skin and face that belong together in a placement.
Pairs nearest_pairs(const Skin& skin, const Placement& placement, const render::Raycaster& face,
                    const mesh::Triangles& triangles, const Eigen::Matrix3Xf& normals) {
  Pairs pairs;
  const Eigen::Index step = std::max<Eigen::Index>(1, skin.vertices.cols() / kProbes);
  for (Eigen::Index v = 0; v < skin.vertices.cols(); v += step) {
    const auto closest = face.closest_point(moved_mm(placement, skin.vertices.col(v)), kMostSkinDistance_mm);
    if (closest.triangle < 0) {
      continue;
    }
    const Eigen::Vector3f normal =
        render::interpolate(triangles, closest.triangle, closest.barycentric, normals).normalized();
    if (normal.dot(placement.head_from_skin * skin.normals.col(v)) > kLeastNormalCosine) {
      pairs.add(skin.vertices.col(v), closest.point_mm, 1);
    }
  }
  return pairs;
}

/// Smoothing of the warp: a centre is unsure by about so much, mm.
constexpr double kCentreDoubt_mm = 3;

/// The warp's shifts from the centres' distances that the similarity leaves: a polyharmonic spline, smoothed
/// [Wah90].
void find_warp(const Pairs& shapes, Placement& out) {
  const auto count = static_cast<Eigen::Index>(shapes.from.size());
  out.centres_mm.resize(3, count);
  Eigen::MatrixXd left = Eigen::MatrixXd::Zero(count + 4, count + 4);
  Eigen::MatrixXd right = Eigen::MatrixXd::Zero(count + 4, 3);
  for (Eigen::Index i = 0; i < count; ++i) {
    const auto index = static_cast<std::size_t>(i);
    out.centres_mm.col(i) = moved_mm(out, shapes.from[index]);
    right.row(i) = (shapes.to_mm[index] - out.centres_mm.col(i)).cast<double>().transpose();
    left(i, i) = -kCentreDoubt_mm / std::max(1e-3, static_cast<double>(shapes.weights[index]));
    left(i, count) = left(count, i) = 1;
    left.block<1, 3>(i, count + 1) = out.centres_mm.col(i).cast<double>().transpose();
    left.block<3, 1>(count + 1, i) = out.centres_mm.col(i).cast<double>();
    for (Eigen::Index j = 0; j < i; ++j) {
      left(i, j) = left(j, i) = static_cast<double>((out.centres_mm.col(i) - out.centres_mm.col(j)).norm());
    }
  }
  const Eigen::MatrixXd solved = left.fullPivLu().solve(right);
  if (solved.allFinite()) {
    out.shifts = solved.transpose().cast<float>();
  }
}

float covered_share(const Skin& skin, const Placement& placement, const mesh::Vertices& points_mm) {
  const render::Raycaster surface(placement.to_head_mm(skin.vertices), skin.triangles,
                                  render::Raycaster::Build::Quick);
  Eigen::Index covered = 0;
  for (Eigen::Index i = 0; i < points_mm.cols(); ++i) {
    covered += surface.closest_point(points_mm.col(i), kMostSkinDistance_mm).triangle >= 0 ? 1 : 0;
  }
  return static_cast<float>(covered) / static_cast<float>(std::max<Eigen::Index>(1, points_mm.cols()));
}

void check(const Placement& placement) {
  const auto refuse = [](const std::string& why) { throw Error(ErrorKind::Usage, why); };
  if (!(placement.shape_distance_mm <= kMostShapeDistance_mm)) {
    refuse(fmt::format("its shapes lie {:.1f} mm from the person's (median; {} at most)",
                       placement.shape_distance_mm, kMostShapeDistance_mm));
  }
  if (!(placement.surface_distance_mm <= kMostSurfaceDistance_mm)) {
    refuse(fmt::format("its surface lies {:.1f} mm from the person's (rms; {} at most)",
                       placement.surface_distance_mm, kMostSurfaceDistance_mm));
  }
  if (!(placement.covered >= kLeastCovered)) {
    refuse(fmt::format("it covers {:.0f} % of the face ({:.0f} at least)", 100 * placement.covered,
                       100 * kLeastCovered));
  }
}

}  // namespace

std::vector<Skin> read_skins(const GlbDocument& glb, const Avatar& avatar) {
  try {
    std::vector<Skin> skins;
    std::size_t budget = kMostSkinValues;
    for (const AvatarMesh& entry : avatar.meshes) {
      const Json& mesh = glb.json.at("meshes").at(entry.mesh);
      for (const Json& primitive : mesh.at("primitives")) {
        if (std::optional<Skin> skin = read_skin(glb, mesh, primitive, entry, budget)) {
          skins.push_back(std::move(*skin));
        }
      }
    }
    return skins;
  } catch (const std::exception& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("the avatar: {}", error.what()));
  }
}

mesh::Vertices Placement::to_head_mm(const mesh::Vertices& points) const {
  mesh::Vertices out = (mm_per_unit * (head_from_skin * points)).colwise() + translation_mm;
  if (shifts.cols() == 0) {
    return out;
  }
  Eigen::VectorXf kernel(shifts.cols());
  const Eigen::Index count = centres_mm.cols();
  for (Eigen::Index v = 0; v < out.cols(); ++v) {
    kernel.head(count) = (centres_mm.colwise() - out.col(v)).colwise().norm().transpose();
    kernel[count] = 1;
    kernel.tail<3>() = out.col(v);
    out.col(v) += shifts * kernel;
  }
  return out;
}

Placement place_skin(const Skin& skin, const PersonShapes& person) {
  Placement placement;
  Pairs shapes;
  for (const auto& [shape, movement] : skin.shapes) {
    const auto same = std::find_if(person.shapes.begin(), person.shapes.end(),
                                   [wanted = shape](const auto& one) { return one.first == wanted; });
    if (same == person.shapes.end()) {
      continue;
    }
    const auto on_skin = centre_of(skin.vertices, skin.triangles, movement);
    const auto on_face_mm = centre_of(person.neutral_mm, person.triangles, same->second);
    if (on_skin && on_face_mm) {
      shapes.add(*on_skin, *on_face_mm, 1);
    }
  }
  placement.shape_count = static_cast<int>(shapes.from.size());
  if (placement.shape_count < kFewestShapes) {
    throw Error(ErrorKind::Usage, fmt::format("it has {} of the take's shapes, {} at least are wanted",
                                              placement.shape_count, kFewestShapes));
  }
  constexpr int kRounds = 20;
  for (int round = 0; round < kRounds; ++round) {
    fit(shapes, placement);
    reweigh(shapes, placement);
  }
  const auto sound = [](const Placement& one) {
    return one.mm_per_unit > 0 && std::isfinite(one.mm_per_unit) && one.head_from_skin.allFinite() &&
           one.translation_mm.allFinite();
  };
  if (!sound(placement)) {
    throw Error(ErrorKind::Usage, "its shapes are all at one place");
  }
  const render::Raycaster face(person.neutral_mm, person.triangles);
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(person.neutral_mm, person.triangles, normals);
  for (int round = 0; round < kRounds; ++round) {
    Pairs all = nearest_pairs(skin, placement, face, person.triangles, normals);
    if (all.from.empty()) {
      break;
    }
    reweigh(all, placement);
    // Shapes and surface have the same say.
    float shape_sum = 0;
    float surface_sum = 0;
    for (const float weight : shapes.weights) {
      shape_sum += weight;
    }
    for (const float weight : all.weights) {
      surface_sum += weight;
    }
    for (std::size_t i = 0; i < shapes.from.size(); ++i) {
      all.add(shapes.from[i], shapes.to_mm[i], shapes.weights[i] * surface_sum / shape_sum);
    }
    fit(all, placement);
    reweigh(shapes, placement);
  }
  if (!sound(placement)) {
    throw Error(ErrorKind::Usage, "it can't be placed");
  }
  placement.shape_distance_mm = maths::median_of(distances_mm(shapes, placement));
  const std::vector<float> surface =
      distances_mm(nearest_pairs(skin, placement, face, person.triangles, normals), placement);
  float squares = 0;
  for (const float distance : surface) {
    squares += distance * distance;
  }
  placement.surface_distance_mm =
      std::sqrt(squares / static_cast<float>(std::max<std::size_t>(1, surface.size())));
  placement.covered = covered_share(skin, placement, person.skin_mm);
  check(placement);
  find_warp(shapes, placement);
  return placement;
}

std::pair<std::size_t, Placement> choose_skin(const std::vector<Skin>& skins, const PersonShapes& person) {
  std::optional<std::pair<std::size_t, Placement>> best;
  std::string faults;
  for (std::size_t i = 0; i < skins.size(); ++i) {
    try {
      const Placement placement = place_skin(skins[i], person);
      if (!best || placement.covered > best->second.covered) {
        best = {i, placement};
      }
    } catch (const Error& error) {
      faults += fmt::format("{}mesh '{}': {}", faults.empty() ? "" : "; ", skins[i].name, error.what());
    }
  }
  if (!best) {
    throw Error(ErrorKind::Usage,
                fmt::format("the avatar's face can't be placed on the take's: {}",
                            faults.empty() ? "none of its meshes has ARKit's shapes and triangles" : faults));
  }
  if (skins[best->first].texture_coordinates.cols() == 0) {
    throw Error(ErrorKind::Usage,
                fmt::format("the avatar's mesh '{}' has no texture coordinates (TEXCOORD_0): there is no "
                            "place for maps",
                            skins[best->first].name));
  }
  return *best;
}

struct FaceUnderSkin::Impl {
  mesh::Triangles triangles;
  Eigen::Matrix3Xf normals;
  render::Raycaster surface;
};

FaceUnderSkin::FaceUnderSkin(const mesh::Vertices& neutral_mm, const mesh::Triangles& triangles)
    : impl_(new Impl{triangles, {}, render::Raycaster(neutral_mm, triangles)}) {
  mesh::vertex_normals(neutral_mm, triangles, impl_->normals);
}

FaceUnderSkin::~FaceUnderSkin() = default;

FaceUnderSkin::Point FaceUnderSkin::under(const Eigen::Vector3f& point_mm,
                                          const Eigen::Vector3f& normal) const {
  const auto closest = impl_->surface.closest_point(point_mm, kMostSkinDistance_mm);
  if (closest.triangle < 0) {
    return {};
  }
  const float cosine =
      render::interpolate(impl_->triangles, closest.triangle, closest.barycentric, impl_->normals)
          .normalized()
          .dot(normal);
  if (!(cosine > kLeastNormalCosine)) {
    return {};
  }
  const Eigen::Vector2f at = closest.barycentric;
  constexpr float kFadeCosine = 0.2F;
  const float near = 2 * (1 - closest.distance_mm / kMostSkinDistance_mm);
  const float alike = (cosine - kLeastNormalCosine) / kFadeCosine;
  return {
      closest.triangle, {1 - at.x() - at.y(), at.x(), at.y()}, std::clamp(std::min(near, alike), 0.0F, 1.0F)};
}

}  // namespace facet::avatar
