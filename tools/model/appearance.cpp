#include "model/appearance.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "face/face_model.hpp"
#include "mesh/quads.hpp"

namespace facet::model {
namespace {

using face::Region;

// Where things lie on the mean head, mm from the middle between the eyes; looked up on its render.
constexpr double kHairlineMm = 66;      // above it, hair on most heads
constexpr double kTempleDepthMm = -48;  // behind it, in front of the ears, hair or the ear itself
constexpr double kLipRingsMm = 16;      // the lips' height above and below their seam at the mid-line
constexpr int kLipRings = 7;            // of quads, from the seam to the vermilion border
constexpr int kRimRings = 2;            // of quads, from the seam of lids and lips over their rims
constexpr float kHollow = 0.3F;         // less of the hemisphere is open in nostrils
constexpr double kIrisAngleRad = 0.42;  // 6 mm of iris on a 14 mm eyeball

struct Brow {
  double inner_mm = 12;  // from the mid-line
  double outer_mm = 54;
  double inner_height_mm = 16;
  double peak_height_mm = 21.5;
  double outer_height_mm = 14;
  double peak_at = 0.62;  // part of the way from inner to outer end
  double half_width_mm = 4.8;
};

/// Height of the brow's middle at a distance from the mid-line: a parabola on either side of the peak.
double brow_height_mm(const Brow& brow, double x_mm) {
  const double t = (x_mm - brow.inner_mm) / (brow.outer_mm - brow.inner_mm);
  const double end = t < brow.peak_at ? brow.inner_height_mm : brow.outer_height_mm;
  const double reach =
      t < brow.peak_at ? (brow.peak_at - t) / brow.peak_at : (t - brow.peak_at) / (1 - brow.peak_at);
  return brow.peak_height_mm - (brow.peak_height_mm - end) * reach * reach;
}

/// Bilinear sample of a picture in linear light; v runs upwards.
Eigen::Vector3f sample_linear(const render::Picture& picture, const Eigen::Vector2f& uv) {
  const float x = std::clamp(uv.x(), 0.0F, 1.0F) * static_cast<float>(picture.width_px - 1);
  const float y = (1 - std::clamp(uv.y(), 0.0F, 1.0F)) * static_cast<float>(picture.height_px - 1);
  const int x0 = std::min(static_cast<int>(x), picture.width_px - 2);
  const int y0 = std::min(static_cast<int>(y), picture.height_px - 2);
  const float a = x - static_cast<float>(x0);
  const float b = y - static_cast<float>(y0);
  const auto pixel = [&](int dx, int dy) {
    const std::size_t at =
        3 * (static_cast<std::size_t>(y0 + dy) * static_cast<std::size_t>(picture.width_px) +
             static_cast<std::size_t>(x0 + dx));
    return Eigen::Vector3f(render::srgb8_to_linear(picture.rgb[at]),
                           render::srgb8_to_linear(picture.rgb[at + 1]),
                           render::srgb8_to_linear(picture.rgb[at + 2]));
  };
  return (1 - b) * ((1 - a) * pixel(0, 0) + a * pixel(1, 0)) + b * ((1 - a) * pixel(0, 1) + a * pixel(1, 1));
}

}  // namespace

std::vector<std::uint8_t> find_regions(const HeadMesh& head, const Eigen::Matrix3Xd& mean_mm,
                                       const std::vector<std::uint8_t>& ear) {
  const std::vector<int> lip_ring = ring_distance(head.quads, head.vertex_count(), head.lip_seam, kLipRings);
  double lip_half_width_mm = 0;
  double lip_seam_y_mm = 0;
  for (const int v : head.lip_seam) {
    lip_half_width_mm = std::max(lip_half_width_mm, std::abs(mean_mm(0, v)));
    lip_seam_y_mm += mean_mm(1, v) / static_cast<double>(head.lip_seam.size());
  }
  // Shading says nothing of the lids' and lips' rims, with lashes, wet edges and the shadow between them, nor
  // of nostrils.
  std::vector<int> rims = head.lip_seam;
  rims.insert(rims.end(), head.left_lid_seam.begin(), head.left_lid_seam.end());
  rims.insert(rims.end(), head.right_lid_seam.begin(), head.right_lid_seam.end());
  const std::vector<int> rim_ring = ring_distance(head.quads, head.vertex_count(), rims, kRimRings);
  const Eigen::MatrixXf openness = render::openness(mean_mm.cast<float>(), mesh::split_quads(head.quads));
  const Brow brow;
  std::vector<std::uint8_t> regions(head.part.size(), 0);
  for (std::size_t v = 0; v < regions.size(); ++v) {
    const Eigen::Vector3d p = mean_mm.col(static_cast<Eigen::Index>(v));
    const bool skin = head.part[v] == Part::Skin;
    const bool interior = head.part[v] == Part::MouthInterior;
    const bool lips = skin && lip_ring[v] >= 0 && std::abs(p.x()) < lip_half_width_mm + 1 &&
                      std::abs(p.y() - lip_seam_y_mm) < kLipRingsMm;
    const double across = std::abs(p.x());
    const bool in_brow = skin && p.z() > kTempleDepthMm && across > brow.inner_mm && across < brow.outer_mm &&
                         std::abs(p.y() - brow_height_mm(brow, across)) < brow.half_width_mm;
    const bool scalp = skin && (ear[v] != 0 || p.y() > kHairlineMm || p.z() < kTempleDepthMm);
    const bool boundary = head.on_boundary[v] != 0;
    const bool refinable =
        skin && !scalp && !boundary && rim_ring[v] < 0 && openness(0, static_cast<Eigen::Index>(v)) > kHollow;
    const auto mark = [&](bool is, Region region) {
      regions[v] = static_cast<std::uint8_t>(regions[v] | (is ? static_cast<std::uint8_t>(region) : 0));
    };
    mark(refinable, Region::Refinable);
    mark(!skin && !interior, Region::Eye);
    mark(lips, Region::Lips);
    mark(interior, Region::MouthInterior);
    mark(boundary, Region::Boundary);
    mark(scalp, Region::Scalp);
    mark(in_brow, Region::Brow);
  }
  return regions;
}

mesh::Vertices mean_albedo(const HeadMesh& head, const Eigen::Matrix3Xd& mean_mm,
                           const std::vector<render::Picture>& skins) {
  mesh::Vertices albedo = mesh::Vertices::Zero(3, head.vertex_count());
  for (const render::Picture& skin : skins) {
    for (int v = 0; v < head.vertex_count(); ++v) {
      albedo.col(v) +=
          sample_linear(skin, head.skin_uv[static_cast<std::size_t>(v)]) / static_cast<float>(skins.size());
    }
  }
  paint_eyeballs(head, mean_mm, albedo);
  return albedo;
}

void paint_eyeballs(const HeadMesh& head, const Eigen::Matrix3Xd& mean_mm, mesh::Vertices& albedo) {
  const Eigen::Vector3f sclera(0.62F, 0.56F, 0.53F);
  const Eigen::Vector3f iris(0.055F, 0.035F, 0.025F);
  for (const Part part : {Part::LeftEyeball, Part::RightEyeball}) {
    const std::vector<int> eyeball = head.vertices_of(part);
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    for (const int v : eyeball) {
      centre += mean_mm.col(v) / static_cast<double>(eyeball.size());
    }
    for (const int v : eyeball) {
      const double from_front = std::acos(std::clamp((mean_mm.col(v) - centre).normalized().z(), -1.0, 1.0));
      albedo.col(v) = from_front < kIrisAngleRad ? iris : sclera;
    }
  }
}

}  // namespace facet::model
