#include "simulation/actor.hpp"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <numeric>

#include "facet/error.hpp"
#include "maths/alignment.hpp"
#include "mesh/quads.hpp"
#include "render/renderer.hpp"
#include "simulation/random.hpp"
#include "simulation/wrinkles.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector3f;
using face::has_region;
using face::Region;

constexpr float kIdentitySigma = 0.8F;  // of the coefficients inside the span, in the model's own sigmas
constexpr float kMaxIdentity = 2.0F;
constexpr float kExpressionSpread = 0.25F;  // how far an actor's expressions differ from the model's
constexpr std::int32_t kMaxVertices = 200'000;
constexpr float kHairVolume_mm = 9;

/// One value per control vertex, pushed through every level's stencils.
Eigen::MatrixXf push_to_finest(const mesh::Hierarchy& hierarchy, const Eigen::MatrixXf& control) {
  Eigen::MatrixXf values = control;
  Eigen::MatrixXf finer;
  for (const mesh::Level& level : hierarchy.levels) {
    mesh::apply(level.from_coarser, values, finer);
    values.swap(finer);
  }
  return values;
}

Eigen::MatrixXf region_weights(const face::FaceModel& model,
                               const std::function<bool(std::uint8_t)>& inside) {
  Eigen::MatrixXf weights(1, model.vertex_count());
  for (std::int32_t v = 0; v < model.vertex_count(); ++v) {
    weights(0, v) = inside(model.regions[static_cast<std::size_t>(v)]) ? 1.0F : 0.0F;
  }
  return weights;
}

}  // namespace

struct VirtualActor::Relief {
  Wrinkles wrinkles;
};

VirtualActor::~VirtualActor() = default;

/// A random identity inside the model's span, and a smooth, asymmetric deformation from which everything that
/// the span could explain is taken away; expressions that move a bit differently from the model's.
void VirtualActor::make_identity(const face::FaceModel& model, const ActorTraits& traits) {
  const std::uint64_t seed = traits.seed;
  Random random(seed, 71);
  identity_.resize(static_cast<std::size_t>(model.identity_count()));
  for (float& coefficient : identity_) {
    coefficient = std::clamp(kIdentitySigma * random.normal(), -kMaxIdentity, kMaxIdentity);
  }
  basis_ = model.contract_identity(identity_);
  const Anatomy face = find_anatomy(model, basis_.neutral_mm);

  const Eigen::Index count = model.vertex_count();
  mesh::Vertices field(3, count);
  const std::array<Noise, 3> broad{Noise(seed, 72), Noise(seed, 73), Noise(seed, 74)};
  const std::array<Noise, 3> narrow{Noise(seed, 75), Noise(seed, 76), Noise(seed, 77)};
  for (Eigen::Index v = 0; v < count; ++v) {
    const Vector3f at = basis_.neutral_mm.col(v);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      field(static_cast<Eigen::Index>(axis), v) =
          broad[axis].at(at / 62.0F) + 0.55F * narrow[axis].at(at / 27.0F);
    }
    // Lids keep close to their eyeballs.
    for (std::size_t side = 0; side < 2; ++side) {
      const Vector3f eye = 0.5F * (face.eye_outer[side] + face.eye_inner[side]);
      field.col(v) *= 0.3F + 0.7F * smooth_step(13, 30, (at - eye).norm());
    }
  }

  // Least squares over the face skin: field = identity modes * x + rest; only the rest is kept.
  std::vector<Eigen::Index> skin;
  for (Eigen::Index v = 0; v < count; ++v) {
    if (has_region(model.regions[static_cast<std::size_t>(v)], Region::Refinable)) {
      skin.push_back(v);
    }
  }
  const auto on_skin = [&](const auto& values) {
    Eigen::VectorXf column(3 * static_cast<Eigen::Index>(skin.size()));
    for (std::size_t k = 0; k < skin.size(); ++k) {
      column.segment<3>(3 * static_cast<Eigen::Index>(k)) = values.col(skin[k]);
    }
    return column;
  };
  Eigen::MatrixXf modes(3 * static_cast<Eigen::Index>(skin.size()), model.identity_count());
  for (int mode = 0; mode < model.identity_count(); ++mode) {
    modes.col(mode) = on_skin(model.core_row(mode + 1, 0));
  }
  const Eigen::VectorXf target = on_skin(field);
  // A touch of damping: tiny modes must not be blown up to follow the field.
  Eigen::MatrixXf normal_matrix = modes.transpose() * modes;
  normal_matrix.diagonal().array() += 1e-4F * std::max(1.0F, normal_matrix.diagonal().maxCoeff());
  const Eigen::VectorXf explained = normal_matrix.ldlt().solve(modes.transpose() * target);
  for (int mode = 0; mode < model.identity_count(); ++mode) {
    field -= explained[mode] * model.core_row(mode + 1, 0);
  }
  const auto rms = [&] {
    return std::sqrt(on_skin(field).squaredNorm() /
                     static_cast<float>(std::max<std::size_t>(1, skin.size())));
  };
  field *= static_cast<float>(traits.outside_span_mm) * random.uniform(0.8F, 1.2F) / std::max(rms(), 1e-6F);
  outside_span_rms_mm_ = rms();
  basis_.neutral_mm += field;

  for (std::size_t e = 0; e < basis_.deltas_mm.size(); ++e) {
    const Noise spread(seed, 200 + e);
    const float strength = random.uniform(0.88F, 1.12F);
    for (Eigen::Index v = 0; v < count; ++v) {
      const float local = kExpressionSpread * spread.at(basis_.neutral_mm.col(v) / 45.0F);
      // Lids must still meet: eye shapes keep their own form.
      const bool lid = expression_names_[e].starts_with("eye");
      basis_.deltas_mm[e].col(v) *= lid ? 1.0F : strength * (1 + local);
    }
  }
}

/// Eyeballs are pieces of the control mesh of their own, wholly inside the eye region.
void VirtualActor::find_eyeballs(const face::FaceModel& model) {
  const auto count = static_cast<std::size_t>(model.vertex_count());
  std::vector<std::int32_t> piece(count);
  std::iota(piece.begin(), piece.end(), 0);
  const auto root = [&](std::int32_t v) {
    while (piece[static_cast<std::size_t>(v)] != v) {
      v = piece[static_cast<std::size_t>(v)] =
          piece[static_cast<std::size_t>(piece[static_cast<std::size_t>(v)])];
    }
    return v;
  };
  for (Eigen::Index q = 0; q < model.control.quads.cols(); ++q) {
    for (Eigen::Index corner = 1; corner < 4; ++corner) {
      piece[static_cast<std::size_t>(root(model.control.quads(corner, q)))] = root(model.control.quads(0, q));
    }
  }
  std::vector<std::uint8_t> only_eye(count, 1);
  for (std::size_t v = 0; v < count; ++v) {
    if (!has_region(model.regions[v], Region::Eye)) {
      only_eye[static_cast<std::size_t>(root(static_cast<std::int32_t>(v)))] = 0;
    }
  }
  is_eyeball_.assign(count, 0);
  for (std::size_t side = 0; side < 2; ++side) {
    // Least squares of a sphere: |p|^2 = 2 c . p + (r^2 - |c|^2).
    Eigen::Matrix4f normal_matrix = Eigen::Matrix4f::Zero();
    Eigen::Vector4f right_side = Eigen::Vector4f::Zero();
    int points = 0;
    const Vector3f eye = 0.5F * (anatomy_.eye_outer[side] + anatomy_.eye_inner[side]);
    for (std::size_t v = 0; v < count; ++v) {
      const Vector3f at = basis_.neutral_mm.col(static_cast<Eigen::Index>(v)) - eye;
      const bool own =
          only_eye[static_cast<std::size_t>(root(static_cast<std::int32_t>(v)))] != 0 && at.norm() < 30;
      if (own) {
        const Eigen::Vector4f row(2 * at.x(), 2 * at.y(), 2 * at.z(), 1);
        normal_matrix += row * row.transpose();
        right_side += row * at.squaredNorm();
        is_eyeball_[v] = 1;
        ++points;
      }
    }
    if (points >= 12) {
      const Eigen::Vector4f solved = normal_matrix.ldlt().solve(right_side);
      eyeballs_[side].centre_mm = eye + solved.head<3>();
      eyeballs_[side].radius_mm = std::sqrt(solved[3] + solved.head<3>().squaredNorm());
    } else {
      constexpr float kEyeball_mm = 12;
      eyeballs_[side].radius_mm = kEyeball_mm;
      eyeballs_[side].centre_mm =
          0.5F * (anatomy_.lid_upper[side] + anatomy_.lid_lower[side]) - Vector3f(0, 0, kEyeball_mm + 1);
    }
  }
}

/// The surface: the control mesh subdivided as far as kMaxVertices allows, without eyeballs, which are drawn
/// finer than the model has them.
void VirtualActor::make_surface(const face::FaceModel& model) {
  mesh::ControlMesh control = model.control;
  std::vector<std::uint8_t> everywhere(static_cast<std::size_t>(model.vertex_count()), 1);
  for (std::size_t v = 0; v < everywhere.size(); ++v) {
    const Vector3f at = basis_.neutral_mm.col(static_cast<Eigen::Index>(v));
    const bool behind = at.z() < anatomy_.eye_outer[0].z() - 60;
    control.refinable[v] =
        is_eyeball_[v] != 0 || behind || has_region(model.regions[v], Region::MouthInterior) ? 0 : 1;
  }
  // Pixels so small that only the number of vertices ends the subdivision.
  constexpr float kPixelsPerUnit = 1e6F;
  mesh::HierarchyOptions options;
  options.max_levels = 6;
  options.max_vertices = kMaxVertices;
  hierarchy_ =
      mesh::build_hierarchy(control, kPixelsPerUnit * control.texture_coordinates, everywhere, options);

  Eigen::MatrixXf eyeball(1, model.vertex_count());
  for (std::int32_t v = 0; v < model.vertex_count(); ++v) {
    eyeball(0, v) = is_eyeball_[static_cast<std::size_t>(v)];
  }
  const Eigen::MatrixXf fine_eyeball = push_to_finest(*hierarchy_, eyeball);
  const mesh::Triangles& all = hierarchy_->finest().triangles;
  head_triangles_.resize(3, all.cols());
  Eigen::Index kept = 0;
  for (Eigen::Index t = 0; t < all.cols(); ++t) {
    if (fine_eyeball(0, all(0, t)) < 0.5F) {
      head_triangles_.col(kept++) = all.col(t);
    }
  }
  head_triangles_ = mesh::Triangles(head_triangles_.leftCols(kept));
}

SkinZones VirtualActor::skin_zones(const face::FaceModel& model) const {
  const auto pushed = [&](const std::function<bool(std::uint8_t)>& inside) -> Eigen::VectorXf {
    return push_to_finest(*hierarchy_, region_weights(model, inside)).row(0).transpose();
  };
  SkinZones zones;
  zones.skin = pushed([](std::uint8_t bits) {
    return has_region(bits, Region::Refinable) && !has_region(bits, Region::Boundary);
  });
  zones.lips = pushed([](std::uint8_t bits) { return has_region(bits, Region::Lips); });
  zones.eye = pushed([](std::uint8_t bits) { return has_region(bits, Region::Eye); });
  zones.mouth = pushed([](std::uint8_t bits) { return has_region(bits, Region::MouthInterior); });
  mesh::Quads without_eyeballs(4, model.control.quads.cols());
  Eigen::Index kept = 0;
  for (Eigen::Index q = 0; q < model.control.quads.cols(); ++q) {
    if (is_eyeball_[static_cast<std::size_t>(model.control.quads(0, q))] == 0) {
      without_eyeballs.col(kept++) = model.control.quads.col(q);
    }
  }
  without_eyeballs = mesh::Quads(without_eyeballs.leftCols(kept));
  zones.openness =
      push_to_finest(*hierarchy_, render::openness(basis_.neutral_mm, mesh::split_quads(without_eyeballs)))
          .row(0)
          .transpose();
  return zones;
}

/// skin: [head vertex_count] as in SkinZones. Takes the hair out of face_skin_.
void VirtualActor::grow_hair(const mesh::Vertices& resting_mm, const Eigen::VectorXf& skin,
                             std::uint64_t seed) {
  constexpr float kBehindEyes_mm = 75;
  head_middle_mm_ = anatomy_.nasion - Vector3f(0, 0, kBehindEyes_mm);
  hair_volume_mm_.resize(resting_mm.cols());
  head_materials_.assign(static_cast<std::size_t>(resting_mm.cols()), Material::Skin);
  const Noise locks(seed, 78);
  for (Eigen::Index v = 0; v < resting_mm.cols(); ++v) {
    const Vector3f at = resting_mm.col(v);
    const float cover = smooth_step(0, 16, above_hairline_mm(anatomy_, at, skin[v]));
    const float lock = locks.fractal({at.x() / 6.0F, at.y() / 40.0F, at.z() / 25.0F}, 2);
    hair_volume_mm_[v] = cover * (kHairVolume_mm + 1.2F * lock);
    if (cover > 0) {
      head_materials_[static_cast<std::size_t>(v)] = Material::Hair;
      face_skin_[v] = 0;
    }
  }
}

namespace {

/// A quarter of the area of each quad that a vertex belongs to. [vertex_count] mm^2
Eigen::VectorXf vertex_areas(const mesh::Quads& quads, const mesh::Vertices& vertices_mm) {
  Eigen::VectorXf areas = Eigen::VectorXf::Zero(vertices_mm.cols());
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    const Vector3f one = vertices_mm.col(quads(2, q)) - vertices_mm.col(quads(0, q));
    const Vector3f other = vertices_mm.col(quads(3, q)) - vertices_mm.col(quads(1, q));
    for (Eigen::Index corner = 0; corner < 4; ++corner) {
      areas[quads(corner, q)] += one.cross(other).norm() / 8;
    }
  }
  return areas;
}

}  // namespace

/// Blood stays where it is below a piece of skin: its density goes with the inverse of the piece's area, so
/// that stretched skin pales and compressed skin reddens.
Eigen::VectorXf VirtualActor::blood_flow(const mesh::Vertices& control_mm) const {
  constexpr float kPalest = 0.5F;
  constexpr float kReddest = 1.8F;
  constexpr int kSmoothing = 3;
  const Eigen::VectorXf before = vertex_areas(quads_, basis_.neutral_mm);
  const Eigen::VectorXf after = vertex_areas(quads_, control_mm);
  Eigen::VectorXf density = (before.array() / after.array().max(1e-3F)).min(kReddest).max(kPalest).matrix();
  for (int round = 0; round < kSmoothing; ++round) {
    Eigen::VectorXf sum = density;
    Eigen::VectorXf weight = Eigen::VectorXf::Ones(density.size());
    for (Eigen::Index q = 0; q < quads_.cols(); ++q) {
      for (Eigen::Index corner = 0; corner < 4; ++corner) {
        sum[quads_(corner, q)] += density[quads_((corner + 1) % 4, q)] + density[quads_((corner + 3) % 4, q)];
        weight[quads_(corner, q)] += 2;
      }
    }
    density = sum.cwiseQuotient(weight);
  }
  return push_to_finest(*hierarchy_, density.transpose()).row(0).transpose();
}

namespace {

/// The neck of a head that has one of its own lies inside the torso's, and both have one skin.
void fit_neck(Torso& torso) {
  constexpr float kWider = 0.09F;
  constexpr float kSkin = 1 / 0.85F;  // what make_torso darkens it by
  Surface& surface = torso.surface;
  for (std::size_t v = 0; v < torso.hold.size(); ++v) {
    const auto at = static_cast<Eigen::Index>(v);
    surface.vertices_mm(0, at) *= 1 + kWider * torso.hold[v];
    surface.albedo.col(at) *= 1 + (kSkin - 1) * torso.hold[v];
  }
}

}  // namespace

VirtualActor::VirtualActor(const face::FaceModel& model, const ActorTraits& traits)
    : look_(traits.look), quads_(model.control.quads), expression_names_(model.expression_names) {
  const std::uint64_t seed = traits.seed;
  const Look& look = traits.look;
  make_identity(model, traits);
  anatomy_ = find_anatomy(model, basis_.neutral_mm);
  find_eyeballs(model);
  make_surface(model);

  std::vector<mesh::Vertices> levels;
  mesh::push_positions(*hierarchy_, basis_.neutral_mm, levels);
  resting_mm_ = levels.back();
  const mesh::Vertices& resting_mm = resting_mm_;
  Eigen::Matrix3Xf resting_normals;
  mesh::vertex_normals(resting_mm, head_triangles_, resting_normals);

  const SkinZones zones = skin_zones(model);
  Complexion complexion;
  if (look.painted()) {
    complexion = make_complexion(seed);
    head_albedo_ = paint_albedo(anatomy_, complexion, zones, resting_mm,
                                push_to_finest(*hierarchy_, model.mean_albedo), seed);
  } else {
    const Person person = make_person(look, seed);
    complexion = person.complexion;
    const FaceLines lines = find_face_lines(model, basis_.neutral_mm);
    SkinZones worn = zones;
    worn.lips = zones.lips.cwiseMax(lip_cover(lines.lips, resting_mm));
    skin_maps_ = map_skin(anatomy_, person, look, worn, resting_mm, seed);
    head_albedo_ = skin_albedo(skin_maps_, {});
    if (look.strands) {
      Eigen::VectorXf scalp_hair(resting_mm.cols());
      for (Eigen::Index v = 0; v < resting_mm.cols(); ++v) {
        scalp_hair[v] = smooth_step(-5, 14, above_hairline_mm(anatomy_, resting_mm.col(v), zones.skin[v]));
      }
      hair_ = grow_strands({resting_mm, resting_normals, head_triangles_, worn, scalp_hair}, anatomy_, lines,
                           person, seed);
    }
  }
  skin_ = complexion.skin;
  openness_ = zones.openness;
  face_skin_ = zones.skin;
  grow_hair(resting_mm, zones.skin, seed);
  if (!look.painted() && look.scattering) {
    scattering_ = std::make_unique<const Scattering>(resting_mm, head_triangles_);
  }
  relief_ = std::make_unique<const Relief>(
      Relief{Wrinkles(anatomy_, {resting_mm, resting_normals, head_triangles_, face_skin_, zones.lips}, seed,
                      expression_names_)});

  const Vector3f chin = anatomy_.chin;
  for (std::int32_t v = 0; v < model.vertex_count(); ++v) {
    if ((basis_.neutral_mm.col(v) - chin).norm() < 22 && is_eyeball_[static_cast<std::size_t>(v)] == 0) {
      jaw_.push_back(v);
    }
  }

  eyeball_surface_ =
      make_eyeball(0.5F * (eyeballs_[0].radius_mm + eyeballs_[1].radius_mm), complexion.iris, seed);
  upper_teeth_ = make_teeth(anatomy_, true);
  lower_teeth_ = make_teeth(anatomy_, false);
  torso_ = make_torso(anatomy_, complexion, seed);
  if (!look.painted()) {
    fit_neck(torso_);
  }
  if (traits.glasses) {
    glasses_ = make_glasses(anatomy_, seed);
  }
}

void VirtualActor::shape(std::span<const float> expression, const Gaze& gaze, ActorShape& shape) const {
  mesh::Vertices control_mm;
  basis_.evaluate(expression, control_mm);
  std::vector<mesh::Vertices> levels;
  mesh::push_positions(*hierarchy_, control_mm, levels);
  const mesh::Vertices& smooth_mm = levels.back();
  mesh::vertex_normals(smooth_mm, head_triangles_, shape.head_normals);
  Eigen::VectorXf relief_mm;
  relief_->wrinkles.relief_mm(expression, relief_mm);
  // Hair grows away from the middle of the head, not along the normals: the two sides of the slit at the back
  // of the skull lie in one place and have to stay together.
  shape.head_mm = smooth_mm + shape.head_normals * relief_mm.asDiagonal();
  for (Eigen::Index v = 0; v < hair_volume_mm_.size(); ++v) {
    if (hair_volume_mm_[v] > 0) {
      shape.head_mm.col(v) += hair_volume_mm_[v] * (smooth_mm.col(v) - head_middle_mm_).normalized();
    }
  }
  mesh::vertex_normals(shape.head_mm, head_triangles_, shape.head_normals);

  // The jaw's motion is the best rigid one of the chin.
  const auto count = static_cast<Eigen::Index>(jaw_.size());
  Eigen::Matrix3Xf before(3, count);
  Eigen::Matrix3Xf after(3, count);
  for (Eigen::Index k = 0; k < count; ++k) {
    before.col(k) = basis_.neutral_mm.col(jaw_[static_cast<std::size_t>(k)]);
    after.col(k) = control_mm.col(jaw_[static_cast<std::size_t>(k)]);
  }
  shape.lower_teeth_mm = maths::best_similarity(before, after, false).apply(lower_teeth_.vertices_mm);
  shape.gaze = gaze;
  shape.albedo =
      look_.painted() || !look_.blood ? head_albedo_ : skin_albedo(skin_maps_, blood_flow(control_mm));
}

}  // namespace facet::simulation
