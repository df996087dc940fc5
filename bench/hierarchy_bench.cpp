// What the hierarchy is for [MD19 fig. 6] and how the solver converges [MD19 fig. 8], on
// sequences with known geometry: numbers, and a picture of each.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "face/face_parts.hpp"
#include "facet/error.hpp"
#include "mesh/mesh.hpp"
#include "render/renderer.hpp"
#include "truth_sequence.hpp"

namespace {

using facet::Error;
using facet::ErrorKind;
using facet::bench::Sequence;
using facet::refine::RefinerConfig;
using facet::render::Picture;

constexpr int kCellWidth_px = 480;
constexpr int kCellHeight_px = 560;
constexpr std::array<std::uint8_t, 3> kPaper{20, 22, 27};
constexpr std::array<std::uint8_t, 3> kInk{225, 228, 232};
constexpr float kLargestError_deg = 30;
constexpr int kSteps = 10;

/// A refinement of one frame to be drawn.
struct Result {
  std::string name;
  std::vector<float> displacements_mm;
};

/// A camera that shows the face's measured part in one cell.
facet::CameraIntrinsics cell_camera(const facet::bench::TrackedFrame& frame,
                                    const Eigen::Matrix3Xf& vertices_mm,
                                    const std::vector<std::int32_t>& measured) {
  Eigen::Vector2f low(1e9F, 1e9F);
  Eigen::Vector2f high = -low;
  for (const std::int32_t v : measured) {
    const Eigen::Vector3f p = vertices_mm.col(v);
    const Eigen::Vector2f px(frame.camera.fx * p.x() / p.z() + frame.camera.cx,
                             frame.camera.fy * p.y() / p.z() + frame.camera.cy);
    low = low.cwiseMin(px);
    high = high.cwiseMax(px);
  }
  const float scale = std::min(kCellWidth_px / (high - low).x(), kCellHeight_px / (high - low).y()) * 0.96F;
  const Eigen::Vector2f middle = 0.5F * (low + high);
  facet::CameraIntrinsics camera = frame.camera;
  camera.fx *= scale;
  camera.fy *= scale;
  camera.cx = scale * (camera.cx - middle.x()) + 0.5F * (kCellWidth_px - 1);
  camera.cy = scale * (camera.cy - middle.y()) + 0.5F * (kCellHeight_px - 1);
  camera.width_px = kCellWidth_px;
  camera.height_px = kCellHeight_px;
  return camera;
}

/// Colours of vertices over a dark ground.
Picture draw(const facet::render::Raycaster& surface, const facet::mesh::Triangles& triangles,
             const facet::CameraIntrinsics& camera, const Eigen::Matrix3Xf& colours) {
  return facet::render::render_surface(
      surface, camera,
      [&](std::int32_t triangle, const Eigen::Vector2f& barycentric) {
        return facet::render::interpolate(triangles, triangle, barycentric, colours);
      },
      facet::render::plain_picture(kCellWidth_px, kCellHeight_px, kPaper));
}

/// One column per result: shaded, and the error of its normals.
Picture draw_results(const Sequence& sequence, std::size_t index, const std::vector<Result>& results) {
  constexpr int kGap_px = 6;
  constexpr int kTop_px = 26;
  const facet::bench::TrackedFrame& frame = sequence.frames[index];
  const facet::bench::MeasuredFrame& measured = sequence.measured.at(index);
  const facet::mesh::Triangles& triangles = sequence.subject->hierarchy->finest().triangles;
  const auto columns = static_cast<int>(results.size());
  Picture sheet = facet::render::plain_picture(columns * (kCellWidth_px + kGap_px) + kGap_px,
                                               kTop_px + 2 * (kCellHeight_px + kGap_px), kPaper);
  const auto camera =
      cell_camera(frame, facet::bench::reconstruct(sequence, frame, {}).vertices_mm, measured.vertices);
  for (int column = 0; column < columns; ++column) {
    const Result& result = results[static_cast<std::size_t>(column)];
    const auto mesh = facet::bench::reconstruct(sequence, frame, result.displacements_mm);
    const auto comparison = facet::bench::compare_aligned(mesh, measured);
    const facet::render::Raycaster surface(mesh.vertices_mm, triangles);
    // Light from above left, along the surface, so that relief shows.
    const Eigen::Vector3f to_light = Eigen::Vector3f(-0.55F, -0.6F, -0.58F).normalized();
    Eigen::Matrix3Xf grey(3, mesh.normals.cols());
    Eigen::Matrix3Xf heat = Eigen::Matrix3Xf::Constant(3, mesh.normals.cols(), 0.03F);
    for (Eigen::Index v = 0; v < grey.cols(); ++v) {
      grey.col(v).setConstant(0.08F + 0.75F * std::max(0.0F, mesh.normals.col(v).dot(to_light)));
    }
    for (std::size_t k = 0; k < measured.vertices.size(); ++k) {
      const float error = comparison.normal_error_deg[k];
      const auto rgb = facet::render::heat_colour(std::isnan(error) ? 0 : error / kLargestError_deg);
      for (int channel = 0; channel < 3; ++channel) {
        heat(channel, measured.vertices[k]) =
            facet::render::srgb8_to_linear(rgb[static_cast<std::size_t>(channel)]);
      }
    }
    const int x = kGap_px + column * (kCellWidth_px + kGap_px);
    facet::render::draw_text(sheet, x + 4, 8, result.name, kInk);
    facet::render::paste(sheet, draw(surface, triangles, camera, grey), x, kTop_px);
    facet::render::paste(sheet, draw(surface, triangles, camera, heat), x,
                         kTop_px + kCellHeight_px + kGap_px);
  }
  return sheet;
}

/// Hierarchical against the finest level alone, with the paper's budget on either.
void compare_with_direct(facet::gpu::Context& context, const facet::face::FaceModel& model,
                         const Sequence& sequence, const std::string& picture) {
  const std::size_t shown = sequence.measured.rbegin()->first;
  std::vector<Result> results{{"coarse", {}}};
  fmt::print("{}: coarse {:.3f} mm, {:.2f} deg\n", sequence.name, sequence.coarse.mean_mm,
             sequence.coarse.normal_error_deg);
  for (const bool hierarchical : {false, true}) {
    RefinerConfig config;
    config.budget = facet::refine::Budget::Paper;
    config.hierarchical = hierarchical;
    std::vector<float> displacements_mm;
    const auto score = facet::bench::refine_sequence(
        context, model, sequence, config, [&](std::size_t index, const facet::refine::RefineOutput& output) {
          if (index == shown) {
            displacements_mm = output.displacements_mm;
          }
        });
    const std::string name = hierarchical ? "hierarchical" : "finest level alone";
    fmt::print("{:<20} {:.3f} mm ({:+.1f} %), {:.2f} deg ({:+.1f} %), {:.0f} ms per frame\n", name,
               score.mean_mm, 100 * (score.mean_mm / sequence.coarse.mean_mm - 1), score.normal_deg,
               100 * (score.normal_deg / sequence.coarse.normal_error_deg - 1), score.device_ms);
    results.push_back({fmt::format("{}: {:.2f} deg", name, score.normal_deg), std::move(displacements_mm)});
  }
  results.front().name = fmt::format("coarse: {:.2f} deg", sequence.coarse.normal_error_deg);
  facet::render::write_png(draw_results(sequence, shown, results), picture);
}

struct Curve {
  int pcg_iterations = 0;
  std::vector<std::vector<double>> energies;  ///< [level][step]
};

/// Curves of one level over the Gauss-Newton steps, relative to the least energy that any of them reaches.
void draw_level(Picture& plot, int x0, int width, int height, const std::vector<Curve>& curves,
                std::size_t level) {
  constexpr int kMargin_px = 60;
  constexpr std::array<std::array<std::uint8_t, 3>, 3> kColours{
      {{255, 170, 60}, {120, 200, 255}, {140, 230, 130}}};
  double least = 1e300;
  double most = 0;
  for (const Curve& curve : curves) {
    least = std::min(least, *std::min_element(curve.energies[level].begin(), curve.energies[level].end()));
    most = std::max(most, curve.energies[level].front());
  }
  const auto at = [&](std::size_t step, double energy) {
    const double part = (energy - least) / std::max(most - least, 1e-300);
    return Eigen::Vector2f(static_cast<float>(x0 + kMargin_px) +
                               static_cast<float>(step) / kSteps * static_cast<float>(width - 2 * kMargin_px),
                           static_cast<float>(height - kMargin_px) -
                               static_cast<float>(part) * static_cast<float>(height - 2 * kMargin_px));
  };
  for (std::size_t step = 0; step <= kSteps; ++step) {
    facet::render::draw_line(plot, at(step, least), at(step, least) + Eigen::Vector2f(0, 5), kInk);
    facet::render::draw_text(plot, static_cast<int>(at(step, least).x()) - 4, height - kMargin_px + 10,
                             std::to_string(step), kInk);
  }
  facet::render::draw_line(plot, at(0, least), at(kSteps, least), kInk);
  facet::render::draw_line(plot, at(0, least), at(0, most), kInk);
  facet::render::draw_text(plot, x0 + 4, kMargin_px - 6, fmt::format("{:.0f}", most), kInk);
  facet::render::draw_text(plot, x0 + 4, height - kMargin_px - 6, fmt::format("{:.0f}", least), kInk);
  facet::render::draw_text(plot, x0 + kMargin_px, 12,
                           fmt::format("level {}: energy over Gauss-Newton steps", level), kInk);
  for (std::size_t c = 0; c < curves.size(); ++c) {
    const auto& energies = curves[c].energies[level];
    for (std::size_t step = 1; step < energies.size(); ++step) {
      facet::render::draw_line(plot, at(step - 1, energies[step - 1]), at(step, energies[step]),
                               kColours[c % kColours.size()]);
    }
    facet::render::draw_text(plot, x0 + width / 2, 40 + 18 * static_cast<int>(c),
                             fmt::format("{} PCG iterations", curves[c].pcg_iterations),
                             kColours[c % kColours.size()]);
  }
}

/// Energies of the last measured frame from a cold start, its albedo learned before.
void plot_convergence(facet::gpu::Context& context, const facet::face::FaceModel& model,
                      const Sequence& sequence, const std::string& picture) {
  std::shared_ptr<const facet::mesh::Albedo> albedo;
  facet::bench::refine_sequence(
      context, model, sequence, RefinerConfig(),
      [&](std::size_t, const facet::refine::RefineOutput& output) { albedo = output.albedo; });
  const auto& frame = sequence.frames[sequence.measured.rbegin()->first];
  std::vector<Curve> curves;
  for (const int iterations : {5, 7, 10}) {
    RefinerConfig config;
    config.budget = facet::refine::Budget::Fixed;
    config.gauss_newton_steps = kSteps;
    config.pcg_iterations = iterations;
    config.record_energies = true;
    facet::refine::Refiner refiner(context, config);
    refiner.set_subject({sequence.subject->hierarchy, model.mean_albedo, model.control.refinable, albedo,
                         facet::face::shading_trust(model), model.identity_count() == 0});
    refiner.submit({frame.image, frame.camera, frame.camera_from_head, &frame.control_vertices_mm});
    facet::refine::RefineOutput output;
    if (refiner.collect(output) != facet::refine::RefineOutcome::Refined) {
      throw Error(ErrorKind::Internal, output.failure);
    }
    curves.push_back({iterations, output.energies});
  }
  const std::size_t finest = curves.front().energies.size() - 1;
  for (const std::size_t level : {std::size_t{0}, finest}) {
    fmt::print("level {}, energy before each step and after the last:\n", level);
    for (const Curve& curve : curves) {
      fmt::print("  {:>2} PCG iterations:", curve.pcg_iterations);
      for (const double energy : curve.energies[level]) {
        fmt::print(" {:.1f}", energy);
      }
      fmt::print("\n");
    }
  }
  constexpr int kWidth_px = 640;
  constexpr int kHeight_px = 420;
  Picture plot = facet::render::plain_picture(2 * kWidth_px, kHeight_px, kPaper);
  draw_level(plot, 0, kWidth_px, kHeight_px, curves, 0);
  draw_level(plot, kWidth_px, kWidth_px, kHeight_px, curves, finest);
  facet::render::write_png(plot, picture);
}

}  // namespace

int main(int argc, char** argv) {
  std::filesystem::path folder;
  facet::bench::SequenceOptions options;
  options.measure_every = 10;
  std::string device = "auto";
  std::string comparison = "hierarchy.png";
  std::string convergence = "convergence.png";
  CLI::App app(
      "Hierarchical against direct refinement, and the solver's convergence, on a sequence of facet synth");
  app.add_option("folder", folder, "Folder that facet synth wrote")->required();
  app.add_option("--measure-every", options.measure_every, "Frames from one measured frame to the next")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--min-edge-px", options.min_edge_px, "Of the hierarchy")->capture_default_str();
  app.add_option("--comparison", comparison, "Picture of coarse, direct and hierarchical meshes")
      ->capture_default_str();
  app.add_option("--convergence", convergence, "Plot of energies")->capture_default_str();
  app.add_option("--model", options.model, "Face model file")->capture_default_str();
  app.add_option("--device", device, "GPU, by part of its name")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    const auto model = facet::face::FaceModel::load(options.model);
    facet::gpu::ContextOptions context_options;
    context_options.device = device;
    facet::gpu::Context context(context_options);
    const Sequence sequence = facet::bench::load_sequence(model, options, folder);
    plot_convergence(context, model, sequence, convergence);
    compare_with_direct(context, model, sequence, comparison);
  } catch (const Error& error) {
    fmt::print(stderr, "hierarchy_bench: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
  return 0;
}
