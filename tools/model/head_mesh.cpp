#include "model/head_mesh.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <set>
#include <string_view>
#include <utility>

#include "facet/error.hpp"

namespace facet::model {
namespace {

[[noreturn]] void fail(const std::string& what) {
  throw Error(
      ErrorKind::UnreadableInput,
      fmt::format("MakeHuman's base mesh is not the expected one: {}. Run packaging/fetch-assets again.",
                  what));
}

/// Union-find over texture coordinates: quads that share one lie on the same island.
class Islands {
 public:
  explicit Islands(int count) : parent_(static_cast<std::size_t>(count)) {
    std::iota(parent_.begin(), parent_.end(), 0);
  }
  int find(int at) {
    while (parent_[static_cast<std::size_t>(at)] != at) {
      at = parent_[static_cast<std::size_t>(at)] =
          parent_[static_cast<std::size_t>(parent_[static_cast<std::size_t>(at)])];
    }
    return at;
  }
  void join(int a, int b) { parent_[static_cast<std::size_t>(find(a))] = find(b); }

 private:
  std::vector<int> parent_;
};

int group_index(const MakeHumanMesh& base, std::string_view name) {
  const auto found = std::find(base.group_names.begin(), base.group_names.end(), name);
  if (found == base.group_names.end()) {
    fail(fmt::format("the group '{}' is missing", name));
  }
  return static_cast<int>(found - base.group_names.begin());
}

/// Quads of the head by part: the body's texture islands are told apart by what they hold.
std::map<Part, std::vector<int>> head_quads(const MakeHumanMesh& base) {
  const int body = group_index(base, "body");
  const int left_eye = group_index(base, "helper-l-eye");
  const int right_eye = group_index(base, "helper-r-eye");
  Islands islands(static_cast<int>(base.texture_coordinates.cols()));
  for (Eigen::Index q = 0; q < base.quads.cols(); ++q) {
    for (int corner = 1; corner < 4; ++corner) {
      islands.join(base.corner_uv(0, q), base.corner_uv(corner, q));
    }
  }
  std::map<int, std::vector<int>> by_island;
  std::map<Part, std::vector<int>> quads;
  for (int q = 0; q < base.quads.cols(); ++q) {
    const int group = base.group[static_cast<std::size_t>(q)];
    if (group == body) {
      by_island[islands.find(base.corner_uv(0, q))].push_back(q);
    } else if (group == left_eye) {
      quads[Part::LeftEyeball].push_back(q);
    } else if (group == right_eye) {
      quads[Part::RightEyeball].push_back(q);
    }
  }
  constexpr std::size_t kSkinQuads = 3116;
  constexpr std::size_t kMouthQuads = 398;
  constexpr std::size_t kSocketQuads = 293;
  for (const auto& [island, members] : by_island) {
    if (members.size() == kSkinQuads || members.size() == kMouthQuads || members.size() == kSocketQuads) {
      auto& into = quads[members.size() == kSkinQuads    ? Part::Skin
                         : members.size() == kMouthQuads ? Part::MouthInterior
                                                         : Part::Socket];
      into.insert(into.end(), members.begin(), members.end());
    }
  }
  if (quads[Part::Skin].size() != kSkinQuads || quads[Part::MouthInterior].size() != kMouthQuads ||
      quads[Part::Socket].size() != 2 * kSocketQuads ||
      quads[Part::LeftEyeball].size() != quads[Part::RightEyeball].size()) {
    fail("its texture islands differ");
  }
  return quads;
}

using Edge = std::pair<int, int>;

/// The strips of quads that run round the nape below the skull: they start at the lowest edges of the
/// mid-line at the back and cross every quad to its opposite edge until the border.
std::set<int> nape_strips(const MakeHumanMesh& base, const std::vector<int>& skin) {
  constexpr std::size_t kStrips = 3;
  constexpr double kOnMidlineDm = 1e-3;
  std::map<Edge, int> quad_of_edge;  // directed
  std::map<double, Edge> midline;    // by height
  for (const int q : skin) {
    for (int corner = 0; corner < 4; ++corner) {
      const Edge edge(base.quads(corner, q), base.quads((corner + 1) % 4, q));
      quad_of_edge[edge] = q;
      const Eigen::Vector3d a = base.vertices_dm.col(edge.first);
      const Eigen::Vector3d b = base.vertices_dm.col(edge.second);
      if (std::abs(a.x()) < kOnMidlineDm && std::abs(b.x()) < kOnMidlineDm && a.z() < 0 && a.y() < b.y()) {
        midline[a.y()] = edge;
      }
    }
  }
  std::set<int> strips;
  std::size_t taken = 0;
  for (auto it = midline.begin(); it != midline.end() && taken < kStrips; ++it, ++taken) {
    for (Edge edge : {it->second, Edge(it->second.second, it->second.first)}) {
      for (auto at = quad_of_edge.find(edge); at != quad_of_edge.end() && strips.insert(at->second).second;
           at = quad_of_edge.find(edge)) {
        for (int corner = 0; corner < 4; ++corner) {
          if (base.quads(corner, at->second) == edge.first) {
            edge = {base.quads((corner + 3) % 4, at->second), base.quads((corner + 2) % 4, at->second)};
            break;
          }
        }
      }
    }
  }
  return strips;
}

std::vector<Edge> quad_edges(const mesh::Quads& quads, Eigen::Index q) {
  return {{quads(0, q), quads(1, q)},
          {quads(1, q), quads(2, q)},
          {quads(2, q), quads(3, q)},
          {quads(3, q), quads(0, q)}};
}

std::vector<std::uint8_t> find_boundary(const mesh::Quads& quads, int vertex_count) {
  std::set<Edge> edges;
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    for (const Edge& edge : quad_edges(quads, q)) {
      edges.insert(edge);
    }
  }
  std::vector<std::uint8_t> boundary(static_cast<std::size_t>(vertex_count), 0);
  for (const auto& [a, b] : edges) {
    if (edges.find({b, a}) == edges.end()) {
      boundary[static_cast<std::size_t>(a)] = boundary[static_cast<std::size_t>(b)] = 1;
    }
  }
  return boundary;
}

/// The vertex that lies where each vertex would in a mirror. A vertex at the slit mirrors to its twin.
std::vector<int> find_mirror(const HeadMesh& head, const Eigen::Matrix3Xd& positions_dm) {
  constexpr double kSamePlaceDm = 2e-3;
  const auto key = [&](const Eigen::Vector3d& p) {
    return std::tuple(std::lround(p.y() / kSamePlaceDm), std::lround(p.z() / kSamePlaceDm));
  };
  std::multimap<std::tuple<long, long>, int> places;
  for (int v = 0; v < head.vertex_count(); ++v) {
    places.emplace(key(positions_dm.col(v)), v);
  }
  std::vector<int> mirror(static_cast<std::size_t>(head.vertex_count()), -1);
  for (int v = 0; v < head.vertex_count(); ++v) {
    const Eigen::Vector3d wanted = positions_dm.col(v).cwiseProduct(Eigen::Vector3d(-1, 1, 1));
    double best = kSamePlaceDm;
    for (long dy = -1; dy <= 1; ++dy) {
      for (long dz = -1; dz <= 1; ++dz) {
        auto at = key(wanted);
        std::get<0>(at) += dy;
        std::get<1>(at) += dz;
        for (auto [it, end] = places.equal_range(at); it != end; ++it) {
          const double distance = (positions_dm.col(it->second) - wanted).norm();
          const Part other = head.part[static_cast<std::size_t>(it->second)];
          const Part own = head.part[static_cast<std::size_t>(v)];
          const bool eyeballs = own == Part::LeftEyeball || own == Part::RightEyeball;
          const bool other_eyeball = other == Part::LeftEyeball || other == Part::RightEyeball;
          // A twin at the slit is preferred to the vertex itself.
          const double penalty = it->second == v ? 1e-6 : 0.0;
          if (distance + penalty < best && eyeballs == other_eyeball && (eyeballs || own == other)) {
            best = distance + penalty;
            mirror[static_cast<std::size_t>(v)] = it->second;
          }
        }
      }
    }
    if (mirror[static_cast<std::size_t>(v)] < 0) {
      fail(fmt::format("vertex {} has no mirror image", head.base_vertex[static_cast<std::size_t>(v)]));
    }
  }
  return mirror;
}

/// Texture coordinates of the inner mouth and the sockets: the solution of uniform Laplace equations inside
/// the holes that lips and lids leave in the skin's chart [Tut63], so that one chart covers them all.
void fill_holes(HeadMesh& head) {
  const auto inside = [&](int v) {
    const Part part = head.part[static_cast<std::size_t>(v)];
    return part == Part::MouthInterior || part == Part::Socket;
  };
  std::vector<int> unknown(static_cast<std::size_t>(head.vertex_count()), -1);
  int count = 0;
  for (int v = 0; v < head.vertex_count(); ++v) {
    if (inside(v)) {
      unknown[static_cast<std::size_t>(v)] = count++;
    }
  }
  std::set<Edge> edges;
  for (Eigen::Index q = 0; q < head.quads.cols(); ++q) {
    for (const auto& [a, b] : quad_edges(head.quads, q)) {
      edges.insert({a, b});
      edges.insert({b, a});
    }
  }
  std::vector<Eigen::Triplet<double>> entries;
  Eigen::MatrixX2d right = Eigen::MatrixX2d::Zero(count, 2);
  for (const auto& [a, b] : edges) {
    const int row = unknown[static_cast<std::size_t>(a)];
    if (row < 0) {
      continue;
    }
    entries.emplace_back(row, row, 1.0);
    if (const int column = unknown[static_cast<std::size_t>(b)]; column >= 0) {
      entries.emplace_back(row, column, -1.0);
    } else {
      right.row(row) += head.texture_coordinates.col(b).transpose().cast<double>();
    }
  }
  Eigen::SparseMatrix<double> laplacian(count, count);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(laplacian);
  const Eigen::MatrixX2d solved = solver.solve(right);
  for (int v = 0; v < head.vertex_count(); ++v) {
    if (unknown[static_cast<std::size_t>(v)] >= 0) {
      head.texture_coordinates.col(v) =
          solved.row(unknown[static_cast<std::size_t>(v)]).transpose().cast<float>();
    }
  }
}

/// One upright chart: the skin's island turned by a quarter and scaled to the left of the unit square, holes
/// filled, the eyeballs (seen along z, the back outermost) beside it.
void lay_out_texture(HeadMesh& head, const Eigen::Matrix3Xd& positions_dm) {
  constexpr float kMargin = 0.01F;
  constexpr float kEyeballRadius = 0.06F;
  head.texture_coordinates.setZero(2, head.vertex_count());
  Eigen::Vector2f low(INFINITY, INFINITY);
  Eigen::Vector2f high = -low;
  for (int v = 0; v < head.vertex_count(); ++v) {
    if (head.part[static_cast<std::size_t>(v)] == Part::Skin) {
      const Eigen::Vector2f uv = head.skin_uv[static_cast<std::size_t>(v)];
      head.texture_coordinates.col(v) << uv.y(), -uv.x();
      low = low.cwiseMin(head.texture_coordinates.col(v));
      high = high.cwiseMax(head.texture_coordinates.col(v));
    }
  }
  const float scale = (1 - 2 * kMargin) / (high - low).maxCoeff();
  for (int v = 0; v < head.vertex_count(); ++v) {
    if (head.part[static_cast<std::size_t>(v)] == Part::Skin) {
      head.texture_coordinates.col(v) = (scale * (head.texture_coordinates.col(v) - low)).array() + kMargin;
    }
  }
  fill_holes(head);
  for (const Part part : {Part::LeftEyeball, Part::RightEyeball}) {
    const std::vector<int> vertices = head.vertices_of(part);
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    for (const int v : vertices) {
      centre += positions_dm.col(v) / static_cast<double>(vertices.size());
    }
    const Eigen::Vector2f middle(part == Part::LeftEyeball ? 0.9F : 0.1F, 0.9F);
    for (const int v : vertices) {
      const Eigen::Vector3d direction = (positions_dm.col(v) - centre).normalized();
      const double from_front = std::acos(std::clamp(direction.z(), -1.0, 1.0)) / std::numbers::pi;
      const Eigen::Vector2d around = direction.head<2>().norm() > 0
                                         ? Eigen::Vector2d(direction.head<2>().normalized())
                                         : Eigen::Vector2d::Zero();
      head.texture_coordinates.col(v) = middle + kEyeballRadius * (from_front * around).cast<float>();
    }
  }
}

}  // namespace

std::vector<int> HeadMesh::vertices_of(Part wanted) const {
  std::vector<int> found;
  for (int v = 0; v < vertex_count(); ++v) {
    if (part[static_cast<std::size_t>(v)] == wanted) {
      found.push_back(v);
    }
  }
  return found;
}

HeadMesh cut_head(const MakeHumanMesh& base) {
  auto quads = head_quads(base);
  const std::set<int> nape = nape_strips(base, quads[Part::Skin]);
  std::erase_if(quads[Part::Skin], [&](int q) { return nape.count(q) != 0; });
  HeadMesh head;
  // A skin vertex is told apart by its texture coordinate too, which opens the slit along the seam; all else
  // by the base vertex, which joins inner mouth and sockets to the skin.
  std::map<Edge, int> skin_vertices;
  std::map<int, int> vertices;
  std::vector<std::array<int, 4>> found;
  const auto add_vertex = [&](int base_vertex, int uv, Part part) {
    head.base_vertex.push_back(base_vertex);
    head.part.push_back(part);
    head.skin_uv.emplace_back(base.texture_coordinates.col(uv));
    return head.vertex_count() - 1;
  };
  std::set<int> lip_seam;
  std::set<int> lid_seam;
  for (const Part part :
       {Part::Skin, Part::MouthInterior, Part::Socket, Part::LeftEyeball, Part::RightEyeball}) {
    for (const int q : quads[part]) {
      std::array<int, 4> corners{};
      for (int corner = 0; corner < 4; ++corner) {
        const int base_vertex = base.quads(corner, q);
        const int uv = base.corner_uv(corner, q);
        int& at = corners[static_cast<std::size_t>(corner)];
        if (part == Part::Skin) {
          auto [it, is_new] = skin_vertices.try_emplace({base_vertex, uv}, 0);
          if (is_new) {
            it->second = add_vertex(base_vertex, uv, part);
            vertices.try_emplace(base_vertex, it->second);
          }
          at = it->second;
        } else {
          auto [it, is_new] = vertices.try_emplace(base_vertex, 0);
          if (is_new) {
            it->second = add_vertex(base_vertex, uv, part);
          } else if (head.part[static_cast<std::size_t>(it->second)] == Part::Skin) {
            (part == Part::MouthInterior ? lip_seam : lid_seam).insert(it->second);
          }
          at = it->second;
        }
      }
      found.push_back(corners);
    }
  }
  head.quads.resize(4, static_cast<Eigen::Index>(found.size()));
  for (std::size_t q = 0; q < found.size(); ++q) {
    head.quads.col(static_cast<Eigen::Index>(q)) = Eigen::Map<const Eigen::Vector4i>(found[q].data());
  }
  Eigen::Matrix3Xd positions_dm(3, head.vertex_count());
  for (int v = 0; v < head.vertex_count(); ++v) {
    positions_dm.col(v) = base.vertices_dm.col(head.base_vertex[static_cast<std::size_t>(v)]);
  }
  head.lip_seam.assign(lip_seam.begin(), lip_seam.end());
  for (const int v : lid_seam) {
    (positions_dm(0, v) > 0 ? head.left_lid_seam : head.right_lid_seam).push_back(v);
  }
  head.on_boundary = find_boundary(head.quads, head.vertex_count());
  head.mirror = find_mirror(head, positions_dm);
  lay_out_texture(head, positions_dm);
  return head;
}

HeadFrame head_frame(const MakeHumanMesh& base, const HeadMesh& head) {
  const auto mean = [&](Part part) {
    const std::vector<int> vertices = head.vertices_of(part);
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const int v : vertices) {
      sum += base.vertices_dm.col(head.base_vertex[static_cast<std::size_t>(v)]);
    }
    return Eigen::Vector3d(sum / static_cast<double>(vertices.size()));
  };
  return {0.5 * (mean(Part::LeftEyeball) + mean(Part::RightEyeball))};
}

Eigen::Matrix3Xd base_positions_mm(const MakeHumanMesh& base, const HeadMesh& head, const HeadFrame& frame) {
  Eigen::Matrix3Xd positions_dm(3, head.vertex_count());
  for (int v = 0; v < head.vertex_count(); ++v) {
    positions_dm.col(v) = base.vertices_dm.col(head.base_vertex[static_cast<std::size_t>(v)]);
  }
  return frame.points_mm(positions_dm);
}

std::vector<int> ring_distance(const mesh::Quads& quads, int vertex_count, const std::vector<int>& from,
                               int max_rings) {
  std::vector<int> distance(static_cast<std::size_t>(vertex_count), -1);
  for (const int v : from) {
    distance[static_cast<std::size_t>(v)] = 0;
  }
  for (int ring = 1; ring <= max_rings; ++ring) {
    for (Eigen::Index q = 0; q < quads.cols(); ++q) {
      const auto at = [&](int corner) -> int& {
        return distance[static_cast<std::size_t>(quads(corner, q))];
      };
      const bool touches = at(0) == ring - 1 || at(1) == ring - 1 || at(2) == ring - 1 || at(3) == ring - 1;
      for (int corner = 0; touches && corner < 4; ++corner) {
        if (at(corner) < 0) {
          at(corner) = ring;
        }
      }
    }
  }
  return distance;
}

Eigen::VectorXd vertex_areas(const mesh::Quads& quads, const Eigen::Matrix3Xd& positions) {
  Eigen::VectorXd areas = Eigen::VectorXd::Zero(positions.cols());
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    const Eigen::Vector3d diagonal_a = positions.col(quads(2, q)) - positions.col(quads(0, q));
    const Eigen::Vector3d diagonal_b = positions.col(quads(3, q)) - positions.col(quads(1, q));
    const double area = 0.5 * diagonal_a.cross(diagonal_b).norm();
    for (int corner = 0; corner < 4; ++corner) {
      areas[quads(corner, q)] += 0.25 * area;
    }
  }
  return areas;
}

}  // namespace facet::model
