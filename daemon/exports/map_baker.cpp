#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "exports/export.hpp"
#include "facet/error.hpp"
#include "mesh/hierarchy.hpp"

namespace facet::exports {
namespace {

/// So far pictures go on beyond the edges of the triangles, so that filtering meets no black.
constexpr int kPadding_px = 8;

/// A pixel whose centre lies in a triangle.
struct Texel {
  std::int32_t pixel = 0;
  std::int32_t triangle = -1;
  std::array<float, 3> weights{};  ///< of the triangle's vertices
  float strength = 1;              ///< MapLayout::Place::strength
  std::int32_t frame = -1;         ///< of Impl::frames
};

/// The pixels that triangles cover in texture coordinates. Of triangles that overlap there the first has the
/// pixel.
std::vector<Texel> covered_texels(const mesh::Triangles& triangles,
                                  const mesh::TextureCoordinates& coordinates, int size_px) {
  std::vector<std::uint8_t> taken(static_cast<std::size_t>(size_px) * static_cast<std::size_t>(size_px), 0);
  std::vector<Texel> texels;
  const auto size = static_cast<float>(size_px);
  const auto bound = [size_px](float value) {
    return static_cast<int>(std::clamp(value, 0.0F, static_cast<float>(size_px - 1)));
  };
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    Eigen::Matrix<float, 2, 3> corners;  // px, y down, pixel centres at integers
    for (int corner = 0; corner < 3; ++corner) {
      const Eigen::Vector2f uv = coordinates.col(triangles(corner, t));
      corners.col(corner) << uv.x() * size - 0.5F, (1.0F - uv.y()) * size - 0.5F;
    }
    Eigen::Matrix2f edges;
    edges << corners.col(1) - corners.col(0), corners.col(2) - corners.col(0);
    const float area = edges.determinant();
    if (!(std::abs(area) > 1e-12F)) {
      continue;
    }
    const Eigen::Matrix2f to_weights = edges.inverse();
    const Eigen::Vector2f low = corners.rowwise().minCoeff();
    const Eigen::Vector2f high = corners.rowwise().maxCoeff();
    for (int y = bound(std::floor(low.y())); y <= bound(std::ceil(high.y())); ++y) {
      for (int x = bound(std::floor(low.x())); x <= bound(std::ceil(high.x())); ++x) {
        const Eigen::Vector2f weights =
            to_weights * (Eigen::Vector2f(static_cast<float>(x), static_cast<float>(y)) - corners.col(0));
        const float first = 1.0F - weights.sum();
        // A hair's breadth of tolerance, so that no pixel on a shared edge falls between its triangles.
        constexpr float kTolerance = 1e-4F;
        if (weights.x() < -kTolerance || weights.y() < -kTolerance || first < -kTolerance) {
          continue;
        }
        const std::size_t pixel =
            static_cast<std::size_t>(y) * static_cast<std::size_t>(size_px) + static_cast<std::size_t>(x);
        if (std::exchange(taken[pixel], std::uint8_t{1}) == 0) {
          texels.push_back({static_cast<std::int32_t>(pixel),
                            static_cast<std::int32_t>(t),
                            {first, weights.x(), weights.y()},
                            1,
                            -1});
        }
      }
    }
  }
  return texels;
}

/// Adds the pixels around the covered ones, each a copy of a neighbour, ring by ring.
void pad(std::vector<Texel>& texels, int size_px) {
  std::vector<std::uint8_t> taken(static_cast<std::size_t>(size_px) * static_cast<std::size_t>(size_px), 0);
  for (const Texel& texel : texels) {
    taken[static_cast<std::size_t>(texel.pixel)] = 1;
  }
  std::size_t ring_begin = 0;
  for (int ring = 0; ring < kPadding_px; ++ring) {
    const std::size_t ring_end = texels.size();
    for (std::size_t i = ring_begin; i < ring_end; ++i) {
      const int x = texels[i].pixel % size_px;
      const int y = texels[i].pixel / size_px;
      for (const auto& [dx, dy] :
           {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}, {-1, -1}, {1, -1}, {-1, 1}, {1, 1}}) {
        if (x + dx < 0 || x + dx >= size_px || y + dy < 0 || y + dy >= size_px) {
          continue;
        }
        const int pixel = (y + dy) * size_px + x + dx;
        if (std::exchange(taken[static_cast<std::size_t>(pixel)], std::uint8_t{1}) == 0) {
          Texel copy = texels[i];
          copy.pixel = pixel;
          texels.push_back(copy);
        }
      }
    }
    ring_begin = ring_end;
  }
}

/// Unit tangents of the smooth surface along u and v: the sums of the triangles' dP/du and dP/dv at each
/// vertex, made orthogonal to its normal [Len01].
struct Tangents {
  Eigen::Matrix3Xf along_u;
  Eigen::Matrix3Xf along_v;
};

Tangents tangents_of(const mesh::Vertices& vertices, const Eigen::Matrix3Xf& normals,
                     const mesh::Triangles& triangles, const mesh::TextureCoordinates& coordinates) {
  Tangents out{Eigen::Matrix3Xf::Zero(3, vertices.cols()), Eigen::Matrix3Xf::Zero(3, vertices.cols())};
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const Eigen::Vector3i corner = triangles.col(t);
    Eigen::Matrix<float, 3, 2> edges;
    edges << vertices.col(corner[1]) - vertices.col(corner[0]),
        vertices.col(corner[2]) - vertices.col(corner[0]);
    Eigen::Matrix2f uv;
    uv << coordinates.col(corner[1]) - coordinates.col(corner[0]),
        coordinates.col(corner[2]) - coordinates.col(corner[0]);
    if (!(std::abs(uv.determinant()) > 1e-14F)) {
      continue;
    }
    // Weighted with the triangle's area, as its normal is.
    const Eigen::Matrix<float, 3, 2> slopes = edges * uv.inverse();
    const float area = edges.col(0).cross(edges.col(1)).norm();
    for (const int vertex : corner) {
      out.along_u.col(vertex) += area * slopes.col(0).normalized();
      out.along_v.col(vertex) += area * slopes.col(1).normalized();
    }
  }
  for (Eigen::Index i = 0; i < vertices.cols(); ++i) {
    const Eigen::Vector3f normal = normals.col(i);
    Eigen::Vector3f u = out.along_u.col(i) - normal * normal.dot(out.along_u.col(i));
    u = u.norm() > 0 ? Eigen::Vector3f(u.normalized()) : normal.unitOrthogonal();
    const Eigen::Vector3f v = normal.cross(u);
    out.along_v.col(i) = v.dot(out.along_v.col(i)) < 0 ? Eigen::Vector3f(-v) : v;
    out.along_u.col(i) = u;
  }
  return out;
}

/// Unit x along u, y along v, z the normal at a point of a surface; columns.
Eigen::Matrix3f tangent_frame(const Eigen::Vector3f& u, const Eigen::Vector3f& v,
                              const Eigen::Vector3f& normal) {
  const Eigen::Vector3f x = (u - normal * normal.dot(u)).normalized();
  const Eigen::Vector3f across = normal.cross(x);
  Eigen::Matrix3f out;
  out << x, (across.dot(v) < 0 ? Eigen::Vector3f(-across) : across), normal;
  return out;
}

}  // namespace

struct MapBaker::Impl {
  MapPicture picture;
  std::shared_ptr<const MapLayout> layout;
  std::vector<Eigen::Matrix3f> frames;  ///< of the layout at its texels: columns along u, v, the normal
  std::shared_ptr<const mesh::Hierarchy> hierarchy;  ///< that the texels are of
  std::vector<Texel> texels;
  mesh::Vertices vertices_mm;
  Eigen::Matrix3Xf normals;
  mesh::Vertices smooth_mm;
  Eigen::Matrix3Xf smooth_normals;

  /// value(texel, out) gives a pixel's channels.
  template <typename Value>
  void fill(int channels, const Value& value) {
    const auto pixels = static_cast<std::size_t>(picture.size_px) * static_cast<std::size_t>(picture.size_px);
    picture.channels = channels;
    picture.values.assign(pixels * static_cast<std::size_t>(channels), 0.0F);
    for (const Texel& texel : texels) {
      value(texel,
            &picture.values[static_cast<std::size_t>(texel.pixel) * static_cast<std::size_t>(channels)]);
    }
  }
  /// A vertex field at a texel: field [any][vertex_count].
  template <typename Field>
  auto at(const Texel& texel, const Field& field) const {
    const Eigen::Vector3i corner = hierarchy->finest().triangles.col(texel.triangle);
    return (texel.weights[0] * field.col(corner[0]) + texel.weights[1] * field.col(corner[1]) +
            texel.weights[2] * field.col(corner[2]))
        .eval();
  }
  void find_texels();
  void bake_tangent_normals(const mesh::MeshFrame& frame);
};

void MapBaker::Impl::find_texels() {
  frames.clear();
  if (layout == nullptr) {
    texels = covered_texels(hierarchy->finest().triangles, hierarchy->texture_coordinates, picture.size_px);
    pad(texels, picture.size_px);
    return;
  }
  texels = covered_texels(layout->triangles, layout->texture_coordinates, picture.size_px);
  const Tangents tangents =
      tangents_of(layout->vertices_mm, layout->normals, layout->triangles, layout->texture_coordinates);
  for (Texel& texel : texels) {
    const Eigen::Vector3i corner = layout->triangles.col(texel.triangle);
    const auto blend = [&](const Eigen::Matrix3Xf& field) -> Eigen::Vector3f {
      return texel.weights[0] * field.col(corner[0]) + texel.weights[1] * field.col(corner[1]) +
             texel.weights[2] * field.col(corner[2]);
    };
    const MapLayout::Place place = layout->place(texel.triangle, texel.weights);
    texel.triangle = place.triangle;
    texel.weights = place.weights;
    texel.strength = place.strength;
    if (place.triangle >= 0) {
      texel.frame = static_cast<std::int32_t>(frames.size());
      frames.push_back(tangent_frame(blend(tangents.along_u), blend(tangents.along_v),
                                     blend(layout->normals).normalized()));
    }
  }
  pad(texels, picture.size_px);
  std::erase_if(texels, [](const Texel& texel) { return texel.triangle < 0; });
}

void MapBaker::Impl::bake_tangent_normals(const mesh::MeshFrame& frame) {
  const mesh::Level& level = hierarchy->finest();
  mesh::rebuild_finest(*hierarchy, frame.control_vertices_mm, {}, smooth_mm, smooth_normals);
  const Tangents tangents =
      tangents_of(smooth_mm, smooth_normals, level.triangles, hierarchy->texture_coordinates);
  fill(3, [&](const Texel& texel, float* out) {
    const Eigen::Vector3f normal = at(texel, normals).normalized();
    const Eigen::Vector3f z = at(texel, smooth_normals).normalized();
    Eigen::Map<Eigen::Vector3f> pixel(out, 3);
    if (texel.frame < 0) {
      pixel = tangent_frame(at(texel, tangents.along_u), at(texel, tangents.along_v), z).transpose() * normal;
      return;
    }
    // The shortest turn that lays the take's surface on the layout's takes its relief along.
    const Eigen::Matrix3f& own = frames[static_cast<std::size_t>(texel.frame)];
    const Eigen::Vector3f turned = Eigen::Quaternionf::FromTwoVectors(z, own.col(2)) * normal;
    const Eigen::Vector3f flat = own.col(2);
    pixel = own.transpose() * (flat + texel.strength * (turned - flat)).normalized();
  });
  if (layout != nullptr) {  // where nothing is transferred the surface is its own
    for (std::size_t pixel = 0; pixel < picture.values.size(); pixel += 3) {
      if (picture.values[pixel] == 0 && picture.values[pixel + 1] == 0 && picture.values[pixel + 2] == 0) {
        picture.values[pixel + 2] = 1;
      }
    }
  }
}

MapBaker::MapBaker(int size_px, std::shared_ptr<const MapLayout> layout) : impl_(std::make_unique<Impl>()) {
  if (size_px < 16 || size_px > 16384) {
    throw Error(ErrorKind::Usage, "a map is 16 to 16384 pixels wide");
  }
  impl_->picture.size_px = size_px;
  impl_->layout = std::move(layout);
}

MapBaker::~MapBaker() = default;

const MapPicture& MapBaker::bake(const mesh::MeshFrame& frame, MapKind kind) {
  Impl& impl = *impl_;
  if (!mesh::has_mesh(frame)) {
    throw Error(ErrorKind::Internal, "export: the frame has no mesh");
  }
  if (impl.layout != nullptr && kind == MapKind::ObjectNormal) {
    throw Error(ErrorKind::Internal, "export: another mesh's normals are its own");
  }
  if (impl.hierarchy != frame.subject->hierarchy) {
    impl.hierarchy = frame.subject->hierarchy;
    impl.find_texels();
  }
  const Eigen::Index count = impl.hierarchy->finest().vertex_count;
  switch (kind) {
    case MapKind::Displacement: {
      Eigen::RowVectorXf displacements = Eigen::RowVectorXf::Zero(count);
      if (!frame.displacements_mm.empty()) {
        displacements = Eigen::Map<const Eigen::RowVectorXf>(frame.displacements_mm.data(), count);
      }
      impl.fill(1, [&](const Texel& texel, float* out) {
        *out = texel.strength * impl.at(texel, displacements)(0);
      });
      break;
    }
    case MapKind::Albedo: {
      if (frame.albedo == nullptr) {
        throw Error(ErrorKind::Internal, "export: the frame has no albedo");
      }
      const Eigen::Map<const mesh::Vertices> albedo(frame.albedo->linear_rgb.data(), 3, count);
      impl.fill(3, [&](const Texel& texel, float* out) {
        Eigen::Map<Eigen::Vector3f>(out, 3) = impl.at(texel, albedo);
      });
      break;
    }
    case MapKind::ObjectNormal:
    case MapKind::TangentNormal:
      mesh::rebuild_finest(*impl.hierarchy, frame.control_vertices_mm, frame.displacements_mm,
                           impl.vertices_mm, impl.normals);
      if (kind == MapKind::TangentNormal) {
        impl.bake_tangent_normals(frame);
        break;
      }
      impl.fill(3, [&](const Texel& texel, float* out) {
        Eigen::Map<Eigen::Vector3f>(out, 3) = impl.at(texel, impl.normals).normalized();
      });
      break;
  }
  return impl.picture;
}

}  // namespace facet::exports
