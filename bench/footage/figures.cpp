#include "footage/figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>
#include <utility>

#include "face/person_model.hpp"
#include "facet/error.hpp"
#include "footage/face_views.hpp"
#include "maths/alignment.hpp"
#include "report/bands.hpp"
#include "report/evaluation.hpp"

namespace facet::footage {
namespace {

using report::FrameGeometry;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// Vertices of the face's skin that a frame shows, ascending.
std::vector<std::int32_t> shown(const mesh::MeshFrame& frame, const FrameGeometry& geometry) {
  return report::measured_vertices(*frame.subject, geometry.coarse_mm, geometry.coarse_normals);
}

std::vector<std::int32_t> common(const std::vector<std::int32_t>& a, const std::vector<std::int32_t>& b) {
  std::vector<std::int32_t> both;
  std::set_intersection(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(both));
  return both;
}

std::vector<Moment> moments_of(take::TakeReader& take) {
  std::vector<Moment> moments;
  for (std::int64_t index = 0; index < take.frame_count(); ++index) {
    if (!take.entry(index).has_mesh) {
      continue;
    }
    const auto frame = take.frame(index, take::Pictures::Described);
    if (mesh::has_mesh(*frame) && !frame->displacements_mm.empty()) {
      moments.push_back(
          {index, static_cast<double>(frame->media_time_ns) * 1e-9, frame->subject->id, frame->expression});
    }
  }
  return moments;
}

/// Adds both frames of a pair to the sum, each as the truth of the other; returns how many points both show.
std::size_t add_pair(const mesh::MeshFrame& first, const mesh::MeshFrame& second, report::WrinkleSum& sum) {
  const FrameGeometry first_geometry = report::geometry_of(first);
  const FrameGeometry second_geometry = report::geometry_of(second);
  const auto both = common(shown(first, first_geometry), shown(second, second_geometry));
  const mesh::OneRings& rings = first.subject->hierarchy->finest().one_rings;
  const auto add = [&](const mesh::MeshFrame& truth, const FrameGeometry& geometry,
                       const mesh::MeshFrame& recovered) {
    std::vector<float> true_mm(truth.displacements_mm.size(), std::numeric_limits<float>::quiet_NaN());
    for (const std::int32_t v : both) {
      true_mm[static_cast<std::size_t>(v)] = truth.displacements_mm[static_cast<std::size_t>(v)];
    }
    sum.add(rings, {geometry.coarse_mm, geometry.coarse_normals, both}, true_mm, recovered.displacements_mm);
  };
  add(first, first_geometry, second);
  add(second, second_geometry, first);
  return both.size();
}

/// The control mesh of a frame without the part that the model's expressions have in it.
mesh::Vertices neutral_of(const face::FaceModel& model, const mesh::MeshFrame& frame) {
  if (frame.control_vertices_mm.cols() != model.vertex_count()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("frame {}: its mesh has {} control vertices, the face model {}: give the model "
                            "that the take was made with (--model)",
                            frame.sequence, frame.control_vertices_mm.cols(), model.vertex_count()));
  }
  const face::ExpressionBasis basis = face::expressions_of(model, *frame.subject);
  mesh::Vertices posed;
  basis.evaluate(mesh::shape_weights(frame), posed);
  return frame.control_vertices_mm - (posed - basis.neutral_mm);
}

mesh::Vertices albedo_of(const mesh::MeshFrame& frame, Eigen::Index vertex_count) {
  if (!frame.albedo || static_cast<Eigen::Index>(frame.albedo->linear_rgb.size()) < 3 * vertex_count) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("frame {}: no albedo was learned up to it", frame.sequence));
  }
  return Eigen::Map<const mesh::Vertices>(frame.albedo->linear_rgb.data(), 3, vertex_count);
}

mesh::Vertices columns(const mesh::Vertices& field, const std::vector<std::int32_t>& chosen) {
  return field(Eigen::all, chosen);
}

/// The pixels of a cell at which a face's skin is seen that both frames show.
std::vector<std::size_t> skin_pixels(const render::HitImage& hits, const mesh::Triangles& triangles,
                                     const std::vector<std::int32_t>& skin, std::size_t vertex_count) {
  std::vector<bool> is_skin(vertex_count, false);
  for (const std::int32_t v : skin) {
    is_skin[static_cast<std::size_t>(v)] = true;
  }
  std::vector<std::size_t> pixels;
  for (std::size_t pixel = 0; pixel < hits.triangle.size(); ++pixel) {
    const std::int32_t t = hits.triangle[pixel];
    if (t >= 0 && is_skin[static_cast<std::size_t>(triangles(0, t))] &&
        is_skin[static_cast<std::size_t>(triangles(1, t))] &&
        is_skin[static_cast<std::size_t>(triangles(2, t))]) {
      pixels.push_back(pixel);
    }
  }
  return pixels;
}

double rms(const render::Picture& a, const render::Picture& b, const std::vector<std::size_t>& pixels) {
  double sum = 0;
  for (const std::size_t pixel : pixels) {
    for (std::size_t channel = 0; channel < 3; ++channel) {
      const auto difference = static_cast<double>(render::srgb8_to_linear(a.rgb[3 * pixel + channel]) -
                                                  render::srgb8_to_linear(b.rgb[3 * pixel + channel]));
      sum += difference * difference;
    }
  }
  return std::sqrt(sum / (3 * static_cast<double>(pixels.size())));
}

}  // namespace

std::vector<FramePair> choose_pairs(std::span<const Moment> moments, Expressions which, double min_gap_s,
                                    std::size_t count) {
  std::vector<FramePair> all;
  for (std::size_t a = 0; a < moments.size(); ++a) {
    for (std::size_t b = a + 1; b < moments.size(); ++b) {
      const Moment& first = moments[a];
      const Moment& second = moments[b];
      if (first.subject_id != second.subject_id || std::abs(second.time_s - first.time_s) < min_gap_s) {
        continue;
      }
      double squares = 0;
      for (std::size_t e = 0; e < std::min(first.expression.size(), second.expression.size()); ++e) {
        const auto step = static_cast<double>(second.expression[e] - first.expression[e]);
        squares += step * step;
      }
      all.push_back({first.index, second.index, std::sqrt(squares)});
    }
  }
  std::stable_sort(all.begin(), all.end(), [which](const FramePair& a, const FramePair& b) {
    return which == Expressions::Alike ? a.distance < b.distance : a.distance > b.distance;
  });
  std::vector<FramePair> chosen;
  std::set<std::int64_t> taken;
  for (const FramePair& pair : all) {
    if (chosen.size() == count) {
      break;
    }
    if (!taken.contains(pair.first) && !taken.contains(pair.second)) {
      taken.insert({pair.first, pair.second});
      chosen.push_back(pair);
    }
  }
  return chosen;
}

Repeatability repeatability(std::span<take::TakeReader* const> takes, Expressions which, double min_gap_s,
                            std::size_t count, const std::function<void()>& progress) {
  report::WrinkleSum sum;
  Repeatability found;
  std::size_t points = 0;
  for (take::TakeReader* take : takes) {
    for (const FramePair& pair : choose_pairs(moments_of(*take), which, min_gap_s, count)) {
      const auto first = take->frame(pair.first, take::Pictures::Described);
      const auto second = take->frame(pair.second, take::Pictures::Described);
      points += 2 * add_pair(*first, *second, sum);
      found.distance += pair.distance;
      ++found.pairs;
      progress();
    }
  }
  found.distance = found.pairs > 0 ? found.distance / found.pairs : kNaN;
  found.correlation = sum.point_count() > 0 ? sum.correlation() : kNaN;
  found.share = points > 0 ? static_cast<double>(sum.point_count()) / static_cast<double>(points) : kNaN;
  return found;
}

Halves compare_halves(const face::FaceModel& model, const mesh::MeshFrame& first,
                      const mesh::MeshFrame& second) {
  Halves halves;
  std::vector<std::int32_t> skin;
  for (std::size_t v = 0; v < model.regions.size(); ++v) {
    if (face::has_region(model.regions[v], face::Region::Refinable)) {
      skin.push_back(static_cast<std::int32_t>(v));
    }
  }
  const mesh::Vertices from = columns(neutral_of(model, first), skin);
  const mesh::Vertices to = columns(neutral_of(model, second), skin);
  const maths::Similarity second_from_first = maths::best_similarity(from, to, true);
  halves.shape_mm = static_cast<double>((second_from_first.apply(from) - to).colwise().norm().mean());

  const std::int32_t level_0 = first.subject->hierarchy->levels.front().vertex_count;
  if (second.subject->hierarchy->levels.front().vertex_count != level_0) {
    throw Error(ErrorKind::UnreadableInput, "the two takes' meshes have different coarse levels");
  }
  auto both = common(shown(first, report::geometry_of(first)), shown(second, report::geometry_of(second)));
  both.erase(std::lower_bound(both.begin(), both.end(), level_0), both.end());
  halves.albedo_points = static_cast<int>(both.size());
  if (both.empty()) {
    halves.albedo_rms = halves.albedo_spread = kNaN;
    return halves;
  }
  const mesh::Vertices a = columns(albedo_of(first, level_0), both);
  const mesh::Vertices b = columns(albedo_of(second, level_0), both);
  const float gain = (a.array() * b.array()).sum() / a.squaredNorm();
  const auto values = static_cast<float>(b.size());
  halves.albedo_rms = static_cast<double>(std::sqrt((gain * a - b).squaredNorm() / values));
  const Eigen::Vector3f mean = b.rowwise().mean();
  halves.albedo_spread = static_cast<double>(std::sqrt((b.colwise() - mean).squaredNorm() / values));
  return halves;
}

std::optional<PredictionErrors> prediction_errors(const mesh::MeshFrame& frame,
                                                  const mesh::MeshFrame& earlier, const Frame& image,
                                                  const Frame& earlier_image) {
  constexpr int kSide_px = 256;
  constexpr std::size_t kFewest_px = 1000;
  mesh::MeshFrame posed = frame;
  posed.displacements_mm = earlier.displacements_mm;
  posed.albedo = earlier.albedo;
  posed.lighting = earlier.lighting;
  const FrameGeometry own = report::geometry_of(frame);
  const FrameGeometry others = report::geometry_of(posed);
  const mesh::Triangles& triangles = frame.subject->hierarchy->finest().triangles;
  const Eigen::Index vertex_count = own.coarse_mm.cols();
  const mesh::Vertices own_albedo = albedo_of(frame, vertex_count);
  const mesh::Vertices albedo = albedo_of(earlier, vertex_count);

  const report::Cell cell =
      report::cell_around(report::face_vertices(frame), frame.camera, kSide_px, kSide_px);
  const render::Picture picture = report::cell_picture(image, cell);
  const render::Raycaster coarse(own.coarse_mm, triangles);
  const auto skin = common(shown(frame, own), shown(earlier, report::geometry_of(earlier)));
  const auto pixels =
      skin_pixels(coarse.cast(cell.camera), triangles, skin, static_cast<std::size_t>(vertex_count));
  if (pixels.size() < kFewest_px) {
    return std::nullopt;
  }
  const auto error = [&](const render::Raycaster& surface, const mesh::Vertices& colours) {
    return rms(report::render_colours(surface, triangles, colours, cell.camera, picture), picture, pixels);
  };
  PredictionErrors errors;
  errors.fitted = error(render::Raycaster(own.refined_mm, triangles),
                        lit_colours(own_albedo, own.refined_normals, frame.lighting));
  errors.predicted = error(render::Raycaster(others.refined_mm, triangles),
                           lit_colours(albedo, others.refined_normals, earlier.lighting));
  errors.coarse = error(coarse, lit_colours(albedo, own.coarse_normals, earlier.lighting));
  errors.before = rms(report::cell_picture(earlier_image, cell), picture, pixels);
  return errors;
}

}  // namespace facet::footage
