#include "report/take_pictures.hpp"

#include <algorithm>
#include <cmath>
#include <system_error>
#include <utility>

#include "camera/factory.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"

namespace facet::report {
namespace {

using Eigen::Vector3f;
using render::Picture;

}  // namespace

FrameGeometry geometry_of(const mesh::MeshFrame& frame) {
  FrameGeometry geometry;
  const mesh::Hierarchy& hierarchy = *frame.subject->hierarchy;
  mesh::rebuild_finest(hierarchy, frame.control_vertices_mm, {}, geometry.coarse_mm, geometry.coarse_normals);
  mesh::rebuild_finest(hierarchy, frame.control_vertices_mm, frame.displacements_mm, geometry.refined_mm,
                       geometry.refined_normals);
  const Eigen::Matrix3f rotation = frame.camera_from_head.linear();
  geometry.coarse_mm = frame.camera_from_head * geometry.coarse_mm;
  geometry.refined_mm = frame.camera_from_head * geometry.refined_mm;
  geometry.coarse_normals = rotation * geometry.coarse_normals;
  geometry.refined_normals = rotation * geometry.refined_normals;
  return geometry;
}

SourceImages::SourceImages(std::filesystem::path file) : file_(std::move(file)) {
  if (file_.extension() == ".take") {
    take_ = std::make_unique<take::TakeReader>(file_);
  } else {
    open();
  }
}

void SourceImages::open() {
  camera_ = camera::open_camera({.kind = "file", .path = file_});
  camera_->start();
  has_last_ = false;
}

/// Frames of a take are numbered upwards.
std::optional<Frame> SourceImages::at_in_take(std::uint64_t sequence) {
  std::int64_t low = 0;
  std::int64_t high = take_->frame_count();
  while (low < high) {
    const std::int64_t middle = low + (high - low) / 2;
    take_->entry(middle).sequence < sequence ? low = middle + 1 : high = middle;
  }
  if (low == take_->frame_count() || take_->entry(low).sequence != sequence) {
    return std::nullopt;
  }
  const std::shared_ptr<const FrameSet> set = take_->frame(low)->images;
  return set != nullptr && set->frames.size() == 1 && !set->frames.front().empty()
             ? std::optional(set->frames.front())
             : std::nullopt;
}

std::optional<Frame> SourceImages::at(std::uint64_t sequence) {
  if (take_ != nullptr) {
    return at_in_take(sequence);
  }
  // Not looked for where the source can't have it (that of a loop counts on): the container's number is an
  // estimate.
  constexpr std::uint64_t kEstimate = 100;
  const std::optional<std::uint64_t> count = camera_->info().frame_count;
  if (count && sequence > *count + *count / 10 + kEstimate) {
    return std::nullopt;
  }
  if (has_last_ && last_.sequence > sequence) {
    open();
  }
  while (!has_last_ || last_.sequence < sequence) {
    constexpr std::chrono::seconds kPatience{10};
    if (camera_->next(last_, kPatience) != CaptureOutcome::Delivered) {
      return std::nullopt;
    }
    has_last_ = true;
  }
  return last_.sequence == sequence && !last_.empty() ? std::optional(last_) : std::nullopt;
}

std::unique_ptr<SourceImages> open_source_images(const take::TakeInfo& info, const std::string& given) {
  if (!given.empty()) {
    return std::make_unique<SourceImages>(given);
  }
  if (info.picture_bytes > 0) {
    return std::make_unique<SourceImages>(info.file);
  }
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(info.source, ignored)) {
    return nullptr;
  }
  try {
    return std::make_unique<SourceImages>(info.source);
  } catch (const Error&) {
    return nullptr;
  }
}

Cell cell_around(const mesh::Vertices& vertices_mm, const CameraIntrinsics& camera, int width_px,
                 int height_px) {
  Eigen::Array2f low(1e9F, 1e9F);
  Eigen::Array2f high(-1e9F, -1e9F);
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    const Vector3f at = vertices_mm.col(v);
    if (at.z() > 1) {
      const Eigen::Array2f px(camera.fx * at.x() / at.z() + camera.cx,
                              camera.fy * at.y() / at.z() + camera.cy);
      low = low.min(px);
      high = high.max(px);
    }
  }
  if (low.x() > high.x()) {
    low = {0, 0};
    high = {static_cast<float>(camera.width_px), static_cast<float>(camera.height_px)};
  }
  constexpr float kMargin = 1.2F;
  constexpr float kSmallest_px = 8;
  const auto width = static_cast<float>(width_px);
  const auto height = static_cast<float>(height_px);
  const float scale = std::min(width / std::max(kSmallest_px, kMargin * (high.x() - low.x())),
                               height / std::max(kSmallest_px, kMargin * (high.y() - low.y())));
  Cell cell;
  cell.width_px = width / scale;
  cell.height_px = height / scale;
  cell.x_px = 0.5F * (low.x() + high.x() - cell.width_px);
  cell.y_px = 0.5F * (low.y() + high.y() - cell.height_px);
  // A pixel centre u of the picture lies at (u + 0.5 - x) * scale - 0.5 of the cell.
  cell.camera = {camera.fx * scale,
                 camera.fy * scale,
                 (camera.cx + 0.5F - cell.x_px) * scale - 0.5F,
                 (camera.cy + 0.5F - cell.y_px) * scale - 0.5F,
                 width_px,
                 height_px};
  return cell;
}

Picture cell_picture(const Frame& image, const Cell& cell) {
  // The cut-out's edges fall between pixels: it is taken larger by whole pixels, scaled, and cut to the cell.
  const int x0 = static_cast<int>(std::floor(cell.x_px)) - 1;
  const int y0 = static_cast<int>(std::floor(cell.y_px)) - 1;
  const int x1 = static_cast<int>(std::ceil(cell.x_px + cell.width_px)) + 1;
  const int y1 = static_cast<int>(std::ceil(cell.y_px + cell.height_px)) + 1;
  const Picture part = render::crop(render::to_picture(image), x0, y0, x1 - x0, y1 - y0, kPaper);
  const float scale = static_cast<float>(cell.camera.width_px) / cell.width_px;
  const Picture scaled =
      render::resize(part, static_cast<int>(std::lround(scale * static_cast<float>(x1 - x0))),
                     static_cast<int>(std::lround(scale * static_cast<float>(y1 - y0))));
  return render::crop(scaled, static_cast<int>(std::lround((cell.x_px - static_cast<float>(x0)) * scale)),
                      static_cast<int>(std::lround((cell.y_px - static_cast<float>(y0)) * scale)),
                      cell.camera.width_px, cell.camera.height_px, kPaper);
}

Picture render_colours(const render::Raycaster& caster, const mesh::Triangles& triangles,
                       const mesh::Vertices& colours, const CameraIntrinsics& camera,
                       const Picture& background) {
  constexpr int kRaysPerPixel = 6;
  const auto colour = [&](std::int32_t triangle, const Eigen::Vector2f& barycentric) -> Vector3f {
    return render::interpolate(triangles, triangle, barycentric, colours);
  };
  return render::render_surface(caster, camera, colour, background, kRaysPerPixel);
}

mesh::Vertices grey_shading(const Eigen::Matrix3Xf& normals) {
  const Vector3f key = Vector3f(-0.55F, -0.5F, -0.67F).normalized();
  const Vector3f fill = Vector3f(0.8F, 0.1F, -0.6F).normalized();
  mesh::Vertices shaded(3, normals.cols());
  for (Eigen::Index v = 0; v < normals.cols(); ++v) {
    const Vector3f normal = normals.col(v);
    const float light = 0.03F + 0.04F * (1 - normal.y()) + 0.62F * std::max(0.0F, normal.dot(key)) +
                        0.1F * std::max(0.0F, normal.dot(fill));
    shaded.col(v).setConstant(light);
  }
  return shaded;
}

mesh::Vertices normal_colours(const Eigen::Matrix3Xf& normals) {
  mesh::Vertices colours(3, normals.cols());
  for (Eigen::Index v = 0; v < normals.cols(); ++v) {
    const auto rgb = render::normal_colour(normals.col(v));
    for (std::size_t channel = 0; channel < 3; ++channel) {
      colours(static_cast<Eigen::Index>(channel), v) = render::srgb8_to_linear(rgb[channel]);
    }
  }
  return colours;
}

void draw_scale(Picture& picture, int x_px, int y_px, int width_px, const std::string& low,
                const std::string& high) {
  constexpr int kHeight_px = 10;
  for (int x = 0; x < width_px; ++x) {
    const auto colour =
        render::heat_colour(static_cast<float>(x) / static_cast<float>(std::max(1, width_px - 1)));
    const auto at = static_cast<float>(x_px + x);
    render::draw_line(picture, {at, static_cast<float>(y_px)}, {at, static_cast<float>(y_px + kHeight_px)},
                      colour);
  }
  render::draw_text(picture, x_px, y_px + kHeight_px + 5, low, kFaintInk);
  render::draw_text(picture, x_px + width_px - render::text_size_px(high).x(), y_px + kHeight_px + 5, high,
                    kFaintInk);
}

std::vector<std::int64_t> spread_evenly(const std::vector<std::int64_t>& indices, std::size_t count) {
  if (indices.size() <= count) {
    return indices;
  }
  std::vector<std::int64_t> spread;
  for (std::size_t k = 0; k < count; ++k) {
    spread.push_back(indices[count == 1 ? indices.size() / 2 : k * (indices.size() - 1) / (count - 1)]);
  }
  return spread;
}

render::Picture note(const std::string& text, int width_px, int height_px) {
  render::Picture picture = render::plain_picture(width_px, height_px, {30, 32, 37});
  const auto size = render::text_size_px(text);
  render::draw_text(picture, (width_px - size.x()) / 2, (height_px - size.y()) / 2, text, kFaintInk);
  return picture;
}

void label_cell(render::Picture& sheet, int x_px, int bottom_px, const std::string& text) {
  const auto size = render::text_size_px(text);
  render::paste(sheet, render::plain_picture(size.x() + 12, size.y() + 10, kPaper), x_px,
                bottom_px - size.y() - 10);
  render::draw_text(sheet, x_px + 6, bottom_px - size.y() - 5, text, kInk);
}

render::Picture draw_coarse_mesh(const mesh::MeshFrame& frame, const Cell& cell, render::Picture picture,
                                 float opacity) {
  const mesh::Hierarchy& hierarchy = *frame.subject->hierarchy;
  std::vector<mesh::Vertices> levels;
  mesh::push_positions(hierarchy, frame.control_vertices_mm, levels);
  const mesh::Vertices vertices_mm = frame.camera_from_head * levels.front();
  const mesh::Triangles& triangles = hierarchy.levels.front().triangles;
  const render::Raycaster caster(vertices_mm, triangles);
  constexpr float kMargin_mm = 2;
  std::vector<std::uint8_t> seen(static_cast<std::size_t>(vertices_mm.cols()));
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    seen[static_cast<std::size_t>(v)] =
        caster.occluded(Eigen::Vector3f::Zero(), vertices_mm.col(v), kMargin_mm) ? 0 : 1;
  }
  const auto pixel = [&](std::int32_t v) -> Eigen::Vector2f {
    const Eigen::Vector3f at = vertices_mm.col(v);
    return {cell.camera.fx * at.x() / at.z() + cell.camera.cx,
            cell.camera.fy * at.y() / at.z() + cell.camera.cy};
  };
  constexpr std::array<std::uint8_t, 3> kWire{90, 235, 170};
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const Eigen::Vector3f a = vertices_mm.col(triangles(0, t));
    const Eigen::Vector3f b = vertices_mm.col(triangles(1, t));
    const Eigen::Vector3f c = vertices_mm.col(triangles(2, t));
    if ((b - a).cross(c - a).dot(a) >= 0) {
      continue;
    }
    for (Eigen::Index corner = 0; corner < 3; ++corner) {
      const std::int32_t from = triangles(corner, t);
      const std::int32_t to = triangles((corner + 1) % 3, t);
      // Each inner edge is drawn from the triangle in which it runs upwards.
      if (from < to && seen[static_cast<std::size_t>(from)] != 0 && seen[static_cast<std::size_t>(to)] != 0) {
        render::draw_line(picture, pixel(from), pixel(to), kWire, opacity);
      }
    }
  }
  return picture;
}

mesh::Vertices face_vertices(const mesh::MeshFrame& frame) {
  std::vector<Eigen::Index> chosen;
  for (std::size_t v = 0; v < frame.subject->regions.size(); ++v) {
    if (face::has_region(frame.subject->regions[v], face::Region::Refinable)) {
      chosen.push_back(static_cast<Eigen::Index>(v));
    }
  }
  return frame.camera_from_head * mesh::Vertices(frame.control_vertices_mm(Eigen::all, chosen));
}

}  // namespace facet::report
