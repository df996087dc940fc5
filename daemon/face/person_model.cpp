#include "face/person_model.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <string>
#include <string_view>

#include "face/deformation_transfer.hpp"
#include "mesh/quads.hpp"

namespace facet::face {
namespace {

/// A vertex that an expression moves by less of its largest movement stays.
constexpr double kStill = 0.02;
/// Skin that a loose piece goes with: so many of the nearest vertices.
constexpr std::size_t kNeighbours = 24;

/// [vertex_count] a number for each piece of the mesh.
std::vector<std::int32_t> pieces_of(const FaceModel& model) {
  std::vector<std::int32_t> parent(static_cast<std::size_t>(model.vertex_count()));
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&parent](std::int32_t v) {
    while (parent[static_cast<std::size_t>(v)] != v) {
      std::int32_t& up = parent[static_cast<std::size_t>(v)];
      up = parent[static_cast<std::size_t>(up)];
      v = up;
    }
    return v;
  };
  for (Eigen::Index q = 0; q < model.control.quads.cols(); ++q) {
    for (Eigen::Index corner = 1; corner < 4; ++corner) {
      parent[static_cast<std::size_t>(root(model.control.quads(corner, q)))] =
          root(model.control.quads(0, q));
    }
  }
  std::vector<std::int32_t> out(parent.size());
  for (std::size_t v = 0; v < parent.size(); ++v) {
    out[v] = root(static_cast<std::int32_t>(v));
  }
  return out;
}

/// [vertex_count] 1 where the vertex is of a piece that has skin.
std::vector<std::uint8_t> of_skin(const FaceModel& model, const std::vector<std::int32_t>& piece) {
  std::vector<std::uint8_t> has_skin(piece.size(), 0);
  for (std::size_t v = 0; v < piece.size(); ++v) {
    if (model.control.refinable[v] != 0) {
      has_skin[static_cast<std::size_t>(piece[v])] = 1;
    }
  }
  std::vector<std::uint8_t> out(piece.size());
  std::transform(piece.begin(), piece.end(), out.begin(),
                 [&](std::int32_t p) { return has_skin[static_cast<std::size_t>(p)]; });
  return out;
}

bool moves_upper_face(std::string_view expression) {
  return expression.substr(0, 4) == "brow" || expression.substr(0, 3) == "eye";
}

}  // namespace

void bring_loose_pieces(const FaceModel& model, const Eigen::Matrix3Xd& from_mm,
                        Eigen::Matrix3Xd& neutral_mm) {
  const std::vector<std::int32_t> piece = pieces_of(model);
  const std::vector<std::uint8_t> skin = of_skin(model, piece);
  std::vector<std::int32_t> skin_vertices;
  for (std::size_t v = 0; v < skin.size(); ++v) {
    if (skin[v] != 0) {
      skin_vertices.push_back(static_cast<std::int32_t>(v));
    }
  }
  for (std::size_t first = 0; first < piece.size(); ++first) {
    if (piece[first] != static_cast<std::int32_t>(first) || skin[first] != 0 ||
        skin_vertices.size() < kNeighbours) {
      continue;
    }
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    int count = 0;
    for (std::size_t v = 0; v < piece.size(); ++v) {
      if (piece[v] == piece[first]) {
        centre += from_mm.col(static_cast<Eigen::Index>(v));
        ++count;
      }
    }
    centre /= count;
    std::partial_sort(skin_vertices.begin(), skin_vertices.begin() + kNeighbours, skin_vertices.end(),
                      [&](std::int32_t a, std::int32_t b) {
                        return (from_mm.col(a) - centre).squaredNorm() <
                               (from_mm.col(b) - centre).squaredNorm();
                      });
    Eigen::Vector3d moved = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < kNeighbours; ++i) {
      moved += (neutral_mm.col(skin_vertices[i]) - from_mm.col(skin_vertices[i])) /
               static_cast<double>(kNeighbours);
    }
    for (std::size_t v = 0; v < piece.size(); ++v) {
      if (piece[v] == piece[first]) {
        neutral_mm.col(static_cast<Eigen::Index>(v)) = from_mm.col(static_cast<Eigen::Index>(v)) + moved;
      }
    }
  }
}

FaceModel person_model(const FaceModel& model, const std::vector<float>& identity,
                       const Eigen::Matrix3Xd& neutral_mm, const std::string& name) {
  const ExpressionBasis basis = model.contract_identity(identity);
  const Eigen::Matrix3Xd source = basis.neutral_mm.cast<double>();
  const mesh::Triangles triangles = mesh::split_quads(model.control.quads);
  const std::vector<std::uint8_t> skin = of_skin(model, pieces_of(model));

  FaceModel out;
  out.name = name;
  out.carried_from = identity;
  out.control = model.control;
  out.regions = model.regions;
  out.expression_names = model.expression_names;
  out.expression_sigma = model.expression_sigma;
  out.landmarks = model.landmarks;
  out.mean_albedo = model.mean_albedo;
  out.identity_modes = 1;
  out.expression_modes = model.expression_modes;
  out.core_mm.resize(static_cast<std::size_t>(model.expression_modes) *
                     static_cast<std::size_t>(model.vertex_count()) * 3);
  out.core_row(0, 0) = neutral_mm.cast<float>();
  // Upper and lower face apart: what one half's expressions leave alone holds the other half in place.
  for (const bool upper : {true, false}) {
    std::vector<std::uint8_t> fixed(skin.size(), 1);
    for (std::size_t e = 0; e < basis.deltas_mm.size(); ++e) {
      if (moves_upper_face(model.expression_names[e]) != upper) {
        continue;
      }
      const Eigen::VectorXf moved = basis.deltas_mm[e].colwise().norm().transpose();
      const float still = static_cast<float>(kStill) * std::max(moved.maxCoeff(), 1e-6F);
      for (std::size_t v = 0; v < fixed.size(); ++v) {
        fixed[v] = skin[v] != 0 && moved[static_cast<Eigen::Index>(v)] > still ? 0 : fixed[v];
      }
    }
    const DeformationTransfer transfer(source, neutral_mm, triangles, fixed);
    for (std::size_t e = 0; e < basis.deltas_mm.size(); ++e) {
      if (moves_upper_face(model.expression_names[e]) != upper) {
        continue;
      }
      const Eigen::Matrix3Xd own = basis.deltas_mm[e].cast<double>();
      const Eigen::Matrix3Xd carried = transfer.transfer(own);
      auto row = out.core_row(0, static_cast<int>(e) + 1);
      for (Eigen::Index v = 0; v < own.cols(); ++v) {
        const bool as_the_model = skin[static_cast<std::size_t>(v)] == 0 || !carried.col(v).allFinite();
        row.col(v) = (as_the_model ? own.col(v) : carried.col(v)).cast<float>();
      }
    }
  }
  return out;
}

ExpressionBasis expressions_of(const FaceModel& model, const mesh::Subject& subject) {
  if (subject.neutral_mm.cols() == 0 || model.identity_count() == 0) {
    return model.contract_identity(subject.identity);
  }
  if (subject.neutral_mm.cols() != model.vertex_count() ||
      subject.identity.size() != static_cast<std::size_t>(model.identity_count())) {
    return {subject.neutral_mm, {}};
  }
  return person_model(model, subject.identity, subject.neutral_mm.cast<double>(), "").contract_identity({});
}

}  // namespace facet::face
