#include "report/booth_sheet.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>

#include "capture/rig_file.hpp"
#include "capture/undistortion.hpp"
#include "facet/error.hpp"
#include "files/pfm.hpp"
#include "report/bands.hpp"
#include "report/depth_folder.hpp"
#include "report/depth_pictures.hpp"
#include "report/evaluation.hpp"
#include "report/take_pictures.hpp"
#include "simulation/truth_mesh.hpp"

namespace facet::report {
namespace {

using Eigen::Vector3f;
using render::Picture;

constexpr int kCellWidth_px = 400;
constexpr int kCellHeight_px = 480;
constexpr int kGap_px = 6;
constexpr int kHeader_px = 46;
constexpr float kLargestError_mm = 1;
constexpr float kUnknown = 0.05F;  ///< grey of what is not measured
constexpr float kWireOpacity = 0.22F;
constexpr std::array<std::uint8_t, 3> kDark{30, 32, 37};
constexpr float kLargestRelief_mm = 0.3F;
// Columns.
constexpr std::size_t kPattern = 0;
constexpr std::size_t kDepth = 1;
constexpr std::size_t kOver = 2;
constexpr std::size_t kShaded = 3;
constexpr std::size_t kTexture = 4;
constexpr std::size_t kRelief = 5;
constexpr std::size_t kConfidence = 6;
constexpr std::size_t kDistance = 7;
constexpr std::array<const char*, 8> kColumns{"pattern",
                                              "depth",
                                              "mesh over the picture",
                                              "mesh, shaded",
                                              "texture",
                                              "relief, -0.3 to 0.3 mm",
                                              "confidence, 0 to 1",
                                              "distance to the truth, mm"};
using Cells = std::array<Picture, kColumns.size()>;

/// Scaled to fit a cell and centred in it.
Picture fitted(const Picture& picture) {
  const double scale = std::min(static_cast<double>(kCellWidth_px) / picture.width_px,
                                static_cast<double>(kCellHeight_px) / picture.height_px);
  const Picture small = render::resize(picture, std::max(1, static_cast<int>(scale * picture.width_px)),
                                       std::max(1, static_cast<int>(scale * picture.height_px)));
  Picture cell = render::plain_picture(kCellWidth_px, kCellHeight_px, kDark);
  render::paste(cell, small, (kCellWidth_px - small.width_px) / 2, (kCellHeight_px - small.height_px) / 2);
  return cell;
}

/// The part of a picture that is not dark, with a margin, in a cell's proportions.
Picture trimmed(const Picture& picture, const std::function<bool(std::size_t)>& counts) {
  int left = picture.width_px;
  int right = 0;
  int top = picture.height_px;
  int bottom = 0;
  for (int y = 0; y < picture.height_px; ++y) {
    for (int x = 0; x < picture.width_px; ++x) {
      if (counts(static_cast<std::size_t>(y) * static_cast<std::size_t>(picture.width_px) +
                 static_cast<std::size_t>(x))) {
        left = std::min(left, x);
        right = std::max(right, x + 1);
        top = std::min(top, y);
        bottom = std::max(bottom, y + 1);
      }
    }
  }
  if (left >= right) {
    return picture;
  }
  const double height =
      1.1 * std::max<double>(bottom - top, (right - left) * double{kCellHeight_px} / kCellWidth_px);
  const auto width = static_cast<int>(height * kCellWidth_px / kCellHeight_px);
  return render::crop(picture, (left + right - width) / 2, (top + bottom - static_cast<int>(height)) / 2,
                      width, static_cast<int>(height), kDark);
}

bool same_pixels(const Frame& a, const Frame& b) {
  if (a.empty() || b.empty() || a.width_px != b.width_px || a.height_px != b.height_px) {
    return false;
  }
  for (int y = 0; y < a.height_px; ++y) {
    if (std::memcmp(a.row(y), b.row(y), 4 * static_cast<std::size_t>(a.width_px)) != 0) {
      return false;
    }
  }
  return true;
}

/// The slot of the truth whose picture of a camera this is; none where it is no picture of it.
std::optional<std::uint64_t> slot_of_truth(take::TakeReader& footage, const std::string& camera,
                                           const Frame& picture) {
  for (std::int64_t i = 0; i < footage.frame_count(); ++i) {
    const auto frame = footage.frame(i);
    if (frame->images == nullptr) {
      continue;
    }
    const auto& names = *frame->images->camera_names;
    const auto at = std::find(names.begin(), names.end(), camera);
    if (at != names.end() &&
        same_pixels(frame->images->frames[static_cast<std::size_t>(at - names.begin())], picture)) {
      return frame->sequence;
    }
  }
  return std::nullopt;
}

class Drawer {
 public:
  explicit Drawer(const BoothSheetSources& sources) : sources_(sources) {
    const auto colour = std::find_if(sources.rig.cameras.begin(), sources.rig.cameras.end(),
                                     [](const capture::RigCamera& camera) { return camera.colour; });
    if (colour == sources.rig.cameras.end() || sources.rig.pairs.empty()) {
      throw Error(ErrorKind::Usage,
                  "the rig has no colour camera or no pair: it is not the one of this take");
    }
    colour_ = &*colour;
    left_ = &sources.rig.cameras[sources.rig.pairs.front().left];
    if (!sources.depth_folder.empty()) {
      const capture::Rig lenses = capture::read_rig(sources.depth_folder / "rig.toml");
      depth_lens_ = lenses.cameras.at(0).lens;
    }
    if (!sources.truth_folder.empty()) {
      footage_.emplace(sources.truth_folder / "capture.take");
    }
  }

  Cells row(const mesh::MeshFrame& frame, std::optional<BoothError>& error) {
    Cells cells;
    cells.fill(cell_note("not available"));
    if (const auto pattern = picture_of(*left_, frame.sequence, -1)) {
      cells[kPattern] = fitted(render::to_picture(*pattern));
    }
    cells[kDepth] = depth(frame.sequence);
    const std::optional<Frame> seen = picture_of(*colour_, frame.sequence, 0);
    if (!mesh::has_mesh(frame)) {
      const Picture missing = cell_note(fmt::format("no mesh: {}", mesh::to_string(frame.state)));
      std::fill(cells.begin() + kOver, cells.end(), missing);
      cells[kOver] = seen ? fitted(render::to_picture(*seen)) : missing;
      return cells;
    }
    const FrameGeometry geometry = geometry_of(frame);
    const mesh::Triangles& triangles = frame.subject->hierarchy->finest().triangles;
    const Cell cell = cell_around(face_vertices(frame), frame.camera, kCellWidth_px, kCellHeight_px);
    const Picture dark = render::plain_picture(kCellWidth_px, kCellHeight_px, kDark);
    const render::Raycaster caster(geometry.refined_mm, triangles);
    cells[kOver] = draw_coarse_mesh(
        frame, cell, seen ? cell_picture(capture::Undistortion(colour_->lens).apply(*seen), cell) : dark,
        kWireOpacity);
    cells[kShaded] =
        render_colours(caster, triangles, grey_shading(geometry.refined_normals), cell.camera, dark);
    const auto vertex_count = static_cast<std::size_t>(geometry.refined_mm.cols());
    if (frame.albedo && frame.albedo->linear_rgb.size() == 3 * vertex_count) {
      const mesh::Vertices texture = Eigen::Map<const mesh::Vertices>(
          frame.albedo->linear_rgb.data(), 3, static_cast<Eigen::Index>(vertex_count));
      cells[kTexture] = render_colours(caster, triangles, texture, cell.camera, dark);
    }
    const Reconstruction refined = measured_mesh(frame, geometry);
    const Reconstruction base = without_wrinkles(*frame.subject, refined);
    mesh::Vertices colours = mesh::Vertices::Constant(3, geometry.refined_mm.cols(), kUnknown);
    const Eigen::VectorXf relief_mm = heights_of(*frame.subject, refined, base);
    for (std::size_t k = 0; k < refined.measured.size(); ++k) {
      const float share = relief_mm[static_cast<Eigen::Index>(k)] / kLargestRelief_mm;
      colours.col(refined.measured[k]).setConstant(0.25F + 0.25F * std::clamp(share, -1.0F, 1.0F));
    }
    cells[kRelief] = render_colours(caster, triangles, colours, cell.camera, dark);
    if (frame.confidence.size() == vertex_count) {
      colours.setConstant(kUnknown);
      for (const std::int32_t v : refined.measured) {
        const auto rgb = render::heat_colour(frame.confidence[static_cast<std::size_t>(v)]);
        for (std::size_t channel = 0; channel < 3; ++channel) {
          colours(static_cast<Eigen::Index>(channel), v) = render::srgb8_to_linear(rgb[channel]);
        }
      }
      cells[kConfidence] = render_colours(caster, triangles, colours, cell.camera, dark);
    }
    if (footage_ && seen) {
      if (const auto slot = slot_of_truth(*footage_, colour_->name, *seen)) {
        cells[kDistance] = compare_with(*slot, frame, refined, base, caster, cell, error);
      }
    }
    return cells;
  }

 private:
  static Picture cell_note(const std::string& text) { return note(text, kCellWidth_px, kCellHeight_px); }

  /// What a camera saw in the slot `offset` from one; none where it is not at hand.
  std::optional<Frame> picture_of(const capture::RigCamera& camera, std::uint64_t slot, int offset) {
    if (sources_.pictures == nullptr) {
      return std::nullopt;
    }
    const std::uint64_t wanted = slot + static_cast<std::uint64_t>(offset);
    for (std::int64_t i = 0; i < sources_.pictures->frame_count(); ++i) {
      if (sources_.pictures->entry(i).sequence != wanted) {
        continue;
      }
      const auto frame = sources_.pictures->frame(i);
      if (frame->images == nullptr) {
        return std::nullopt;
      }
      const auto& names = *frame->images->camera_names;
      const auto at = std::find(names.begin(), names.end(), camera.name);
      if (at != names.end()) {
        const Frame& picture = frame->images->frames[static_cast<std::size_t>(at - names.begin())];
        return picture.empty() ? std::nullopt : std::optional(picture);
      }
    }
    return std::nullopt;
  }

  /// Of the finest vertices; empty where they are not known.
  const std::vector<face::FacePart>& parts_of(const mesh::Subject& subject) {
    if (parts_of_ != subject.hierarchy) {
      parts_of_ = subject.hierarchy;
      finest_parts_.clear();
      if (static_cast<std::int32_t>(sources_.parts.size()) == subject.hierarchy->control_vertex_count) {
        finest_parts_ = face::finest_parts(*subject.hierarchy, sources_.parts);
      }
    }
    return finest_parts_;
  }

  Picture depth(std::uint64_t slot) {
    if (!depth_lens_) {
      return cell_note("not available");
    }
    const std::filesystem::path file = depth_file(sources_.depth_folder, left_->name, slot);
    std::error_code ignored;
    if (!std::filesystem::exists(file, ignored)) {
      return cell_note("no depth map");
    }
    const files::FloatImage map = files::read_pfm(file);
    if (map.width_px != depth_lens_->width_px || map.height_px != depth_lens_->height_px) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("{}: {} x {} px, rig.toml beside it says {} x {}", file.string(), map.width_px,
                              map.height_px, depth_lens_->width_px, depth_lens_->height_px));
    }
    capture::DepthMap relief;
    relief.width_px = map.width_px;
    relief.height_px = map.height_px;
    relief.lens = *depth_lens_;
    relief.depth_mm = map.values;
    return fitted(trimmed(relief_of(relief), [&](std::size_t pixel) { return map.values[pixel] > 0; }));
  }

  static Reconstruction measured_mesh(const mesh::MeshFrame& frame, const FrameGeometry& geometry) {
    Reconstruction refined;
    refined.vertices_mm = geometry.refined_mm;
    refined.normals = geometry.refined_normals;
    refined.measured = measured_vertices(*frame.subject, geometry.coarse_mm, geometry.coarse_normals);
    return refined;
  }

  /// Two fields over the measured vertices, smoothed over 5 mm.
  static void smooth(const mesh::Subject& subject, const Reconstruction& mesh, Eigen::Matrix2Xf& fields) {
    constexpr float kSmooth_mm = 5;
    const mesh::Level& level = subject.hierarchy->finest();
    double edges = 0;
    std::size_t edge_count = 0;
    for (const std::int32_t v : mesh.measured) {
      for (auto e = level.one_rings.offsets[static_cast<std::size_t>(v)];
           e < level.one_rings.offsets[static_cast<std::size_t>(v) + 1]; ++e) {
        const auto beside = level.one_rings.neighbours[static_cast<std::size_t>(e)];
        edges += static_cast<double>((mesh.vertices_mm.col(beside) - mesh.vertices_mm.col(v)).squaredNorm());
        ++edge_count;
      }
    }
    // A half-ring average adds a quarter of the mean squared edge to the variance along either axis.
    const double a_round = edges / (4 * static_cast<double>(std::max<std::size_t>(edge_count, 1)));
    const int rounds = static_cast<int>(kSmooth_mm * kSmooth_mm / std::max(a_round, 1e-3));
    RingSmoother(level.one_rings, mesh.measured).smooth(fields, rounds);
  }

  /// The mesh smoothed over 5 mm.
  static Reconstruction without_wrinkles(const mesh::Subject& subject, const Reconstruction& mesh) {
    Reconstruction base = mesh;
    for (const Eigen::Index row : {Eigen::Index{0}, Eigen::Index{1}}) {
      Eigen::Matrix2Xf fields(2, std::ssize(mesh.measured));
      for (std::size_t k = 0; k < mesh.measured.size(); ++k) {
        fields.col(static_cast<Eigen::Index>(k)) = mesh.vertices_mm.col(mesh.measured[k]).segment<2>(row);
      }
      smooth(subject, mesh, fields);
      for (std::size_t k = 0; k < mesh.measured.size(); ++k) {
        base.vertices_mm.col(mesh.measured[k]).segment<2>(row) = fields.col(static_cast<Eigen::Index>(k));
      }
    }
    mesh::vertex_normals(base.vertices_mm, subject.hierarchy->finest().triangles, base.normals);
    return base;
  }

  /// [measured] what stands out of the mesh smoothed, mm, without what curved skin does everywhere.
  static Eigen::VectorXf heights_of(const mesh::Subject& subject, const Reconstruction& mesh,
                                    const Reconstruction& base) {
    Eigen::Matrix2Xf heights = Eigen::Matrix2Xf::Zero(2, std::ssize(mesh.measured));
    for (std::size_t k = 0; k < mesh.measured.size(); ++k) {
      const std::int32_t v = mesh.measured[k];
      heights(0, static_cast<Eigen::Index>(k)) =
          base.normals.col(v).dot(mesh.vertices_mm.col(v) - base.vertices_mm.col(v));
    }
    Eigen::Matrix2Xf wide = heights;
    smooth(subject, mesh, wide);
    return (heights - wide).row(0).transpose();
  }

  /// Mesh and truth stand alike over what the mesh is without its wrinkles.
  static WrinkleSum wrinkles_of(const mesh::Subject& subject, const Reconstruction& mesh,
                                const Reconstruction& base, const Truth& truth) {
    const mesh::Level& level = subject.hierarchy->finest();
    simulation::TruthMesh found;
    found.vertices_mm = mesh.vertices_mm;
    found.normals = mesh.normals;
    found.triangles = level.triangles;
    std::vector<float> true_mm = true_displacements_mm(base, {}, truth);
    std::vector<float> found_mm = true_displacements_mm(base, {}, Truth(std::move(found)));
    for (std::size_t v = 0; v < true_mm.size(); ++v) {
      if (std::isnan(found_mm[v])) {
        true_mm[v] = std::numeric_limits<float>::quiet_NaN();
        found_mm[v] = 0;
      }
    }
    WrinkleSum sum;
    sum.add(level.one_rings, base, true_mm, found_mm);
    return sum;
  }

  Picture compare_with(std::uint64_t slot, const mesh::MeshFrame& frame, const Reconstruction& reconstruction,
                       const Reconstruction& base, const render::Raycaster& caster, const Cell& cell,
                       std::optional<BoothError>& error) {
    const std::filesystem::path file = sources_.truth_folder / "truth" / fmt::format("slot_{:06}.ply", slot);
    std::error_code ignored;
    if (!std::filesystem::exists(file, ignored)) {
      return cell_note(fmt::format("no true surface of slot {}", slot));
    }
    simulation::TruthMesh truth = simulation::read_truth_ply(file);
    const Eigen::Isometry3f camera_from_rig = colour_->lens.camera_from_rig.cast<float>();
    truth.vertices_mm =
        (camera_from_rig.linear() * truth.vertices_mm).colwise() + camera_from_rig.translation();
    truth.normals = camera_from_rig.linear() * truth.normals;
    const Truth true_surface(std::move(truth));
    const Comparison comparison = compare(reconstruction, true_surface, Alignment::None);
    std::vector<float> distances;
    double normal_sum = 0;
    BoothError found;
    found.slot = frame.sequence;
    const std::vector<face::FacePart>& parts = parts_of(*frame.subject);
    mesh::Vertices colours = mesh::Vertices::Constant(3, reconstruction.vertices_mm.cols(), kUnknown);
    for (std::size_t k = 0; k < reconstruction.measured.size(); ++k) {
      const float distance = std::abs(comparison.signed_distance_mm[k]);
      if (std::isnan(distance)) {
        continue;
      }
      distances.push_back(distance);
      normal_sum += static_cast<double>(comparison.normal_error_deg[k]);
      if (!parts.empty()) {
        PointErrors& part = found.parts.at(
            static_cast<std::size_t>(parts[static_cast<std::size_t>(reconstruction.measured[k])]));
        part.distance_mm.push_back(distance);
        part.normal_deg.push_back(comparison.normal_error_deg[k]);
      }
      const auto rgb = render::heat_colour(distance / kLargestError_mm);
      for (std::size_t channel = 0; channel < 3; ++channel) {
        colours(static_cast<Eigen::Index>(channel), reconstruction.measured[k]) =
            render::srgb8_to_linear(rgb[channel]);
      }
    }
    if (!distances.empty()) {
      std::sort(distances.begin(), distances.end());
      const auto count = static_cast<double>(distances.size());
      found.mean_mm = std::accumulate(distances.begin(), distances.end(), 0.0) / count;
      found.p95_mm = static_cast<double>(distances[static_cast<std::size_t>(0.95 * (count - 1))]);
      found.normal_deg = normal_sum / count;
      const WrinkleSum wrinkles = wrinkles_of(*frame.subject, reconstruction, base, true_surface);
      found.wrinkle_correlation = wrinkles.correlation();
      found.wrinkle_depth = wrinkles.depth();
      error = std::move(found);
    }
    return render_colours(caster, frame.subject->hierarchy->finest().triangles, colours, cell.camera,
                          render::plain_picture(kCellWidth_px, kCellHeight_px, kDark));
  }

  const BoothSheetSources& sources_;
  const capture::RigCamera* colour_ = nullptr;  ///< the first one, whose frame the meshes are in
  const capture::RigCamera* left_ = nullptr;    ///< of the first pair
  std::optional<capture::Lens> depth_lens_;
  std::optional<take::TakeReader> footage_;
  std::shared_ptr<const mesh::Hierarchy> parts_of_;
  std::vector<face::FacePart> finest_parts_;
};

}  // namespace

Picture make_booth_sheet(const BoothSheetSources& sources, const std::vector<std::int64_t>& frames,
                         const std::function<void(int)>& done, std::vector<BoothError>& errors) {
  Drawer drawer(sources);
  const int columns = static_cast<int>(kColumns.size());
  const int rows = static_cast<int>(frames.size());
  Picture sheet = render::plain_picture(columns * kCellWidth_px + (columns + 1) * kGap_px,
                                        kHeader_px + rows * (kCellHeight_px + kGap_px), kPaper);
  for (int column = 0; column < columns; ++column) {
    render::draw_text(sheet, kGap_px + column * (kCellWidth_px + kGap_px) + 4, 16,
                      kColumns[static_cast<std::size_t>(column)], kInk);
  }
  constexpr int kScale_px = 110;
  draw_scale(sheet, sheet.width_px - kScale_px - kGap_px - 4, 10, kScale_px, "0",
             fmt::format("{}", kLargestError_mm));
  errors.clear();
  for (int row = 0; row < rows; ++row) {
    const auto frame = sources.meshes->frame(frames[static_cast<std::size_t>(row)]);
    std::optional<BoothError> error;
    const Cells cells = drawer.row(*frame, error);
    const int y = kHeader_px + row * (kCellHeight_px + kGap_px);
    for (int column = 0; column < columns; ++column) {
      render::paste(sheet, cells[static_cast<std::size_t>(column)],
                    kGap_px + column * (kCellWidth_px + kGap_px), y);
    }
    label_cell(
        sheet, kGap_px, y + kCellHeight_px,
        fmt::format("slot {}  {:.2f} s", frame->sequence, static_cast<double>(frame->media_time_ns) * 1e-9));
    if (error) {
      label_cell(sheet, kGap_px + (columns - 1) * (kCellWidth_px + kGap_px), y + kCellHeight_px,
                 fmt::format("mean {:.2f}, 95 % {:.2f} mm", error->mean_mm, error->p95_mm));
      errors.push_back(*std::move(error));
    }
    done(row + 1);
  }
  return sheet;
}

}  // namespace facet::report
