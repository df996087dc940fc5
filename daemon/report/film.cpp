#include "report/film.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include "facet/error.hpp"

namespace facet::report {
namespace {

using render::Picture;

constexpr std::array kPanels = {FilmPanel::Picture, FilmPanel::Mesh, FilmPanel::Grey, FilmPanel::Skin,
                                FilmPanel::Normals};
constexpr int kTextLine_px = 28;
constexpr int kRaysPerPixel = 4;
constexpr float kWireOpacity = 0.55F;
constexpr std::array<std::uint8_t, 3> kBackground{30, 32, 37};

int even(int length_px) {
  return std::max(2, length_px + length_px % 2);
}

bool is_rendered(FilmPanel panel) {
  return panel == FilmPanel::Grey || panel == FilmPanel::Skin || panel == FilmPanel::Normals;
}

/// Linear RGB of the skin in the light that was found; where none was (a booth's meshes), under the studio's.
mesh::Vertices lit_skin(const Eigen::Matrix3Xf& normals, const std::vector<float>& albedo,
                        const std::array<float, 9>& lighting) {
  mesh::Vertices colours = grey_shading(normals);
  const bool is_known = lighting[0] > 0;
  for (Eigen::Index v = 0; v < normals.cols(); ++v) {
    const float light =
        is_known ? std::max(0.0F, render::irradiance(lighting, normals.col(v))) : 1.6F * colours(0, v);
    for (Eigen::Index channel = 0; channel < 3; ++channel) {
      colours(channel, v) = light * albedo[static_cast<std::size_t>(3 * v + channel)];
    }
  }
  return colours;
}

/// Several colourings of one mesh, for the price of one: fields [3 * picture_count][vertex_count] linear RGB.
std::vector<Picture> render_fields(const render::Raycaster& surface, const mesh::Triangles& triangles,
                                   const Eigen::MatrixXf& fields, const CameraIntrinsics& camera) {
  const auto pixels = static_cast<Eigen::Index>(camera.width_px) * camera.height_px;
  Eigen::MatrixXf sums = Eigen::MatrixXf::Zero(fields.rows(), pixels);
  Eigen::VectorXf hit_count = Eigen::VectorXf::Zero(pixels);
  for (const Eigen::Vector2f& offset : render::sample_offsets_px(kRaysPerPixel)) {
    const render::HitImage hits = surface.cast(camera, offset);
    sums += render::interpolate(hits, triangles, fields);
    for (Eigen::Index pixel = 0; pixel < pixels; ++pixel) {
      hit_count[pixel] += hits.triangle[static_cast<std::size_t>(pixel)] >= 0 ? 1.0F : 0.0F;
    }
  }
  std::array<float, 3> behind{};
  for (std::size_t channel = 0; channel < 3; ++channel) {
    behind[channel] = render::srgb8_to_linear(kBackground[channel]);
  }
  std::vector<Picture> pictures;
  for (Eigen::Index row = 0; row < fields.rows(); row += 3) {
    Picture& picture =
        pictures.emplace_back(render::plain_picture(camera.width_px, camera.height_px, kBackground));
    render::for_each_row(camera.height_px, [&](int y) {
      for (Eigen::Index pixel = static_cast<Eigen::Index>(y) * camera.width_px;
           pixel < static_cast<Eigen::Index>(y + 1) * camera.width_px; ++pixel) {
        if (hit_count[pixel] == 0) {
          continue;
        }
        for (std::size_t channel = 0; channel < 3; ++channel) {
          const float sum = sums(row + static_cast<Eigen::Index>(channel), pixel) +
                            (kRaysPerPixel - hit_count[pixel]) * behind[channel];
          picture.rgb[3 * static_cast<std::size_t>(pixel) + channel] =
              render::linear_to_srgb8(sum / kRaysPerPixel);
        }
      }
    });
  }
  return pictures;
}

}  // namespace

const char* to_string(FilmPanel panel) {
  switch (panel) {
    case FilmPanel::Picture:
      return "picture";
    case FilmPanel::Mesh:
      return "mesh";
    case FilmPanel::Grey:
      return "grey";
    case FilmPanel::Skin:
      return "skin";
    case FilmPanel::Normals:
      return "normals";
  }
  return "";
}

std::vector<FilmPanel> parse_film_panels(const std::string& text) {
  std::vector<FilmPanel> panels;
  for (std::size_t begin = 0; begin <= text.size();) {
    const std::size_t end = std::min(text.find(',', begin), text.size());
    const std::string name = text.substr(begin, end - begin);
    const auto* const found = std::find_if(kPanels.begin(), kPanels.end(),
                                           [&](FilmPanel panel) { return name == to_string(panel); });
    if (found == kPanels.end()) {
      std::vector<std::string> names;
      std::transform(kPanels.begin(), kPanels.end(), std::back_inserter(names), to_string);
      throw Error(ErrorKind::Usage,
                  fmt::format("a film has no panel '{}'; it can have, with commas between: {}", name,
                              fmt::join(names, ", ")));
    }
    panels.push_back(*found);
    begin = end + 1;
  }
  return panels;
}

Cell film_cell(const std::vector<FilmLook>& looks, int width_px, int height_px) {
  Eigen::Index count = 0;
  for (const FilmLook& look : looks) {
    count += look.vertices_mm.cols();
  }
  const CameraIntrinsics& last = looks.back().camera;
  mesh::Vertices all(3, count);
  Eigen::Index at = 0;
  for (const FilmLook& look : looks) {
    // Where the last camera sees in the same pixels what this one sees.
    auto part = all.middleCols(at, look.vertices_mm.cols());
    const CameraIntrinsics& own = look.camera;
    part = look.vertices_mm;
    part.row(0) = (own.fx * part.row(0) + (own.cx - last.cx) * part.row(2)) / last.fx;
    part.row(1) = (own.fy * part.row(1) + (own.cy - last.cy) * part.row(2)) / last.fy;
    at += look.vertices_mm.cols();
  }
  return cell_around(all, last, width_px, height_px);
}

FilmPainter::FilmPainter(take::TakeReader& take, const std::vector<std::int64_t>& frames,
                         SourceImages* images, std::vector<FilmPanel> panels, int height_px)
    : images_(images), panels_(std::move(panels)) {
  constexpr std::size_t kMostLooks = 120;
  std::vector<std::int64_t> meshes;
  std::copy_if(frames.begin(), frames.end(), std::back_inserter(meshes),
               [&](std::int64_t index) { return take.entry(index).has_mesh; });
  if (meshes.empty()) {
    throw Error(ErrorKind::NoFace, "none of the selected frames has a mesh: nothing was written");
  }
  std::vector<FilmLook> looks;
  for (const std::int64_t index : spread_evenly(meshes, kMostLooks)) {
    const auto frame = take.frame(index, take::Pictures::Described);
    looks.push_back({face_vertices(*frame), frame->camera});
    if (index == meshes.back() && frame->albedo != nullptr) {
      subject_ = frame->subject->id;
      albedo_ = frame->albedo->linear_rgb;
    }
  }
  width_px_ = looks.back().camera.width_px;
  height_px_ = looks.back().camera.height_px;
  cell_ = film_cell(looks, even(height_px * 4 / 5), even(height_px));
}

int FilmPainter::width_px() const {
  return cell_.camera.width_px * static_cast<int>(panels_.size());
}

int FilmPainter::height_px() const {
  return cell_.camera.height_px + kTextLine_px;
}

/// As it was learned by the film's end; of another person than that, the frame's own.
std::vector<float> FilmPainter::albedo_of(const mesh::MeshFrame& frame) const {
  const auto count = 3 * static_cast<std::size_t>(frame.subject->hierarchy->finest().vertex_count);
  if (frame.subject->id == subject_ && albedo_.size() == count) {
    return albedo_;
  }
  return frame.albedo != nullptr && frame.albedo->linear_rgb.size() == count ? frame.albedo->linear_rgb
                                                                             : std::vector<float>{};
}

/// The film's cut-out as this frame's camera sees it: the focal length becomes better known on the way.
Cell FilmPainter::cell_of(const mesh::MeshFrame& frame) const {
  if (!mesh::has_mesh(frame)) {
    return cell_;
  }
  Cell cell = cell_;
  const float scale = static_cast<float>(cell.camera.width_px) / cell.width_px;
  cell.camera.fx = frame.camera.fx * scale;
  cell.camera.fy = frame.camera.fy * scale;
  cell.camera.cx = (frame.camera.cx + 0.5F - cell.x_px) * scale - 0.5F;
  cell.camera.cy = (frame.camera.cy + 0.5F - cell.y_px) * scale - 0.5F;
  return cell;
}

/// Null where none is to be shown, or there is none.
std::optional<Frame> FilmPainter::image_of(const mesh::MeshFrame& frame) const {
  if (images_ == nullptr || std::all_of(panels_.begin(), panels_.end(), is_rendered)) {
    return std::nullopt;
  }
  std::optional<Frame> image = images_->at(frame.sequence);
  if (image && (image->width_px != width_px_ || image->height_px != height_px_)) {
    throw Error(ErrorKind::Usage,
                fmt::format("the pictures are of {}x{} px, the take was made from such of {}x{}: give with "
                            "--video what it was made from, or choose --panels grey,skin",
                            image->width_px, image->height_px, width_px_, height_px_));
  }
  return image;
}

Picture FilmPainter::paint(const mesh::MeshFrame& frame, const std::string& text) {
  const int width_px = cell_.camera.width_px;
  const int height_px = cell_.camera.height_px;
  const bool has_mesh = mesh::has_mesh(frame);
  const Cell cell = cell_of(frame);
  const std::optional<Frame> image = image_of(frame);
  const Picture nothing =
      has_mesh ? note("not learned yet", width_px, height_px)
               : note(fmt::format("no mesh: {}", mesh::to_string(frame.state)), width_px, height_px);
  const Picture input = image ? cell_picture(*image, cell) : note("image not available", width_px, height_px);
  std::vector<Picture> cells(panels_.size(), nothing);
  FrameGeometry geometry;
  Eigen::MatrixXf fields;
  std::vector<std::size_t> rendered;
  if (has_mesh) {
    geometry = geometry_of(frame);
  }
  for (std::size_t k = 0; k < panels_.size(); ++k) {
    mesh::Vertices colours;
    if (panels_[k] == FilmPanel::Picture) {
      cells[k] = input;
    } else if (panels_[k] == FilmPanel::Mesh && has_mesh) {
      cells[k] = draw_coarse_mesh(frame, cell, input, kWireOpacity);
    } else if (panels_[k] == FilmPanel::Grey && has_mesh) {
      colours = grey_shading(geometry.refined_normals);
    } else if (panels_[k] == FilmPanel::Normals && has_mesh) {
      colours = normal_colours(geometry.refined_normals);
    } else if (panels_[k] == FilmPanel::Skin && has_mesh) {
      if (const std::vector<float> albedo = albedo_of(frame); !albedo.empty()) {
        colours = lit_skin(geometry.refined_normals, albedo, frame.lighting);
      }
    }
    if (colours.cols() > 0) {
      fields.conservativeResize(fields.rows() + 3, colours.cols());
      fields.bottomRows(3) = colours;
      rendered.push_back(k);
    }
  }
  if (!rendered.empty()) {
    const mesh::Triangles& triangles = frame.subject->hierarchy->finest().triangles;
    const render::Raycaster surface(geometry.refined_mm, triangles, render::Raycaster::Build::Quick);
    std::vector<Picture> pictures = render_fields(surface, triangles, fields, cell.camera);
    for (std::size_t k = 0; k < rendered.size(); ++k) {
      cells[rendered[k]] = std::move(pictures[k]);
    }
  }
  Picture film = render::plain_picture(this->width_px(), this->height_px(), kPaper);
  for (std::size_t k = 0; k < cells.size(); ++k) {
    render::paste(film, cells[k], static_cast<int>(k) * width_px, 0);
  }
  render::draw_text(film, 8, height_px + 8, text, kInk);
  return film;
}

}  // namespace facet::report
