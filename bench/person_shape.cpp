// Learns a head's shape from a video in which it turns, and measures it against the truth: the face at rest
// before and after, the focal length, the gates, the uncertainty.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "face/face_parts.hpp"
#include "face/person_model.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "maths/statistics.hpp"
#include "mesh/quads.hpp"
#include "person/enrolment.hpp"
#include "person/improved_person.hpp"
#include "person/person_file.hpp"
#include "pipeline/observe_head.hpp"
#include "report/evaluation.hpp"
#include "simulation/truth_mesh.hpp"

namespace {

using namespace facet;

struct Options {
  std::vector<std::filesystem::path> folders;
  std::filesystem::path model = default_model_file();
  std::filesystem::path nets = default_landmark_nets();
  std::filesystem::path save;
  person::EnrolmentOptions enrolment;
  std::vector<double> curvatures{person::AnchorStrength().curvature};
  bool solve_expressions = false;
  std::filesystem::path person;
  std::vector<std::filesystem::path> against;
};

double processor_s() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

struct Measured {
  double mean_mm = 0, p95_mm = 0, normals_deg = 0, within_two_sigma = 0;
  /// Share whose nearest truth faces the other way: the inside of lids, nostrils or sockets. Its normal tells
  /// nothing, and counts in no mean.
  double other_layer = 0;
  struct Part {
    double distance_mm = 0, normals_deg = 0;
    int count = 0, facing = 0;
  };
  std::array<Part, face::kFacePartNames.size()> parts;  ///< sums
};

Measured measure(const face::FaceModel& model, const Eigen::Matrix3Xd& neutral_mm, const report::Truth& truth,
                 const Eigen::VectorXd* sigma) {
  const mesh::SparseRows rows = person::surface_rows(model);
  report::Reconstruction mesh;
  mesh::apply(rows, neutral_mm.cast<float>().eval(), mesh.vertices_mm);
  mesh::vertex_normals(mesh.vertices_mm, mesh::split_quads(model.control.quads), mesh.normals);
  // As facet eval does: nothing at the rims of lids, lips and nostrils.
  std::vector<std::uint8_t> whole = model.control.refinable;
  for (Eigen::Index q = 0; q < model.control.quads.cols(); ++q) {
    const auto quad = model.control.quads.col(q);
    if (std::any_of(quad.begin(), quad.end(), [&](std::int32_t v) {
          return model.control.refinable[static_cast<std::size_t>(v)] == 0;
        })) {
      for (const std::int32_t v : quad) {
        whole[static_cast<std::size_t>(v)] = 0;
      }
    }
  }
  for (std::int32_t v = 0; v < model.vertex_count(); ++v) {
    if (whole[static_cast<std::size_t>(v)] != 0) {
      mesh.measured.push_back(v);
    }
  }
  // Both are at rest in the head frame, whose origin each model has elsewhere by some millimetres.
  maths::Similarity start;
  float nearest = 1e9F;
  report::Comparison compared;
  for (const float up : {-12.0F, 0.0F, 12.0F}) {
    start.translation_mm = Eigen::Vector3f(0, up, 0);
    const maths::Similarity found = report::align_from({&mesh, &truth}, report::Alignment::Similarity, start);
    const report::Comparison now = report::measure(mesh, truth, found);
    float sum = 0;
    for (const float d : now.signed_distance_mm) {
      sum += std::isfinite(d) ? std::min(std::abs(d), 10.0F) : 10.0F;
    }
    if (sum < nearest) {
      nearest = sum;
      compared = now;
    }
  }
  const std::vector<face::FacePart> parts = face::control_parts(model);
  Measured out;
  std::vector<double> distances;
  int within = 0;
  int known = 0;
  int facing = 0;
  for (std::size_t i = 0; i < mesh.measured.size(); ++i) {
    const double d = std::abs(static_cast<double>(compared.signed_distance_mm[i]));
    if (!std::isfinite(d)) {
      continue;
    }
    distances.push_back(d);
    out.mean_mm += d;
    Measured::Part& part =
        out.parts[static_cast<std::size_t>(parts[static_cast<std::size_t>(mesh.measured[i])])];
    part.distance_mm += d;
    ++part.count;
    if (const double turned = static_cast<double>(compared.normal_error_deg[i]); turned < 90) {
      out.normals_deg += turned;
      part.normals_deg += turned;
      ++part.facing;
      ++facing;
    }
    if (sigma != nullptr && std::isfinite((*sigma)[mesh.measured[i]])) {
      ++known;
      within += d <= 2 * (*sigma)[mesh.measured[i]] ? 1 : 0;
    }
  }
  const auto count = static_cast<double>(distances.size());
  out.mean_mm /= count;
  out.normals_deg /= std::max(facing, 1);
  out.other_layer = 1 - facing / count;
  out.p95_mm = maths::quantile_of(distances, 0.95);
  out.within_two_sigma = known > 0 ? static_cast<double>(within) / known : 0;
  return out;
}

void learn(const Options& options, const face::FaceModel& model, const std::filesystem::path& folder,
           const person::Observed& observed, const person::EnrolmentOptions& enrolment,
           const person::OrientationSpan& span) {
  const double begun = processor_s();
  const person::LearnedShape learned = person::learn_shape(model, observed, enrolment, {});
  const double solved = processor_s();
  if (learned.neutral_mm.cols() == 0) {
    fmt::print("{}: {}\n", folder.filename().string(), learned.refused);
    return;
  }
  const report::Truth truth(simulation::read_truth_ply(folder / "truth/neutral.ply"));
  const Eigen::Matrix3Xd before = model.contract_identity(observed.identity).neutral_mm.cast<double>();
  const Measured generic = measure(model, before, truth, nullptr);
  const Measured own = measure(model, learned.neutral_mm, truth, &learned.sigma_mm);
  std::ifstream file(folder / "camera.json");
  const nlohmann::json camera = nlohmann::json::parse(file);
  const double true_focal = camera.at("fx").get<double>();
  fmt::print(
      "{}: {} keyframes, yaw {:.0f} to {:.0f}, pitch {:.0f} to {:.0f} | {:.2f} -> {:.2f} mm, p95 {:.2f} -> "
      "{:.2f}, normals {:.1f} -> {:.1f} (other layer {:.1f} -> {:.1f} %), "
      "focal {:+.1f} -> {:+.1f} %, 2 sigma {:.0f} % | {:.0f} s; curvature {}\n",
      folder.filename().string(), observed.keyframes.size(), span.least_yaw, span.largest_yaw,
      span.least_pitch, span.largest_pitch, generic.mean_mm, own.mean_mm, generic.p95_mm, own.p95_mm,
      generic.normals_deg, own.normals_deg, 100 * generic.other_layer, 100 * own.other_layer,
      100 * (static_cast<double>(observed.camera.fx) / true_focal - 1),
      100 * (learned.focal_px / true_focal - 1), 100 * own.within_two_sigma, solved - begun,
      enrolment.anchor.curvature);
  for (std::size_t p = 0; p < own.parts.size(); ++p) {
    const Measured::Part& was = generic.parts[p];
    const Measured::Part& now = own.parts[p];
    fmt::print("    {}: {:.2f} -> {:.2f} mm, {:.1f} -> {:.1f} degrees\n", face::kFacePartNames[p],
               was.distance_mm / std::max(was.count, 1), now.distance_mm / std::max(now.count, 1),
               was.normals_deg / std::max(was.facing, 1), now.normals_deg / std::max(now.facing, 1));
  }
  for (const person::Gate& gate : learned.gates) {
    fmt::print("    {} {:.3f} (limit {:.3f}){}\n", gate.name, gate.value, gate.limit,
               gate.passed ? "" : ": " + gate.sentence);
  }
  if (!options.save.empty()) {
    std::filesystem::create_directories(options.save);
    const std::string name = folder.filename().string();
    face::person_model(model, learned.identity, learned.neutral_mm, name)
        .save(options.save / (name + ".facemodel"));
    std::ofstream(options.save / (name + ".focal"))
        << learned.focal_px / std::max(observed.camera.width_px, observed.camera.height_px) << "\n";
  }
}

/// A person who was kept, against the truth of the only folder.
void measure_person(const Options& options, const face::FaceModel& model) {
  const person::PersonFile person = person::read_person(options.person);
  const report::Truth truth(simulation::read_truth_ply(options.folders.front() / "truth/neutral.ply"));
  const Eigen::VectorXd sigma = Eigen::Map<const Eigen::VectorXf>(
                                    person.sigma_mm.data(), static_cast<Eigen::Index>(person.sigma_mm.size()))
                                    .cast<double>();
  const Measured own = measure(model, person.neutral_mm.cast<double>(), truth, &sigma);
  fmt::print("{}: {:.3f} mm, p95 {:.2f}, normals {:.1f}, 2 sigma {:.0f} %\n",
             options.person.filename().string(), own.mean_mm, own.p95_mm, own.normals_deg,
             100 * own.within_two_sigma);
  for (const std::filesystem::path& file : options.against) {
    fmt::print("    from {}: {:.2f} standard deviations apart\n", file.filename().string(),
               person::improved(model, person, person::read_person(file)).disagreement);
  }
}

void run_one(const Options& options, const face::FaceModel& model, const std::filesystem::path& folder) {
  pipeline::ShadingConfig config;
  config.source.path = folder / "video.mkv";
  config.model_file = options.model;
  config.tracker.landmark_nets = options.nets;
  config.gpu_device = pipeline::kNoDevice;
  const double begun = processor_s();
  pipeline::ShadingParts parts = pipeline::open_shading(config);
  const pipeline::ObservedHead head =
      pipeline::observe_head(parts, config.frames, [](std::uint64_t) { return true; });
  const person::KeyframeCollector& collector = head.keyframes;
  const double tracked = processor_s();
  person::EnrolmentOptions enrolment = options.enrolment;
  enrolment.expression =
      options.solve_expressions ? person::KeyframeExpression::Solved : person::KeyframeExpression::Rest;
  const auto observed = collector.observed(enrolment.keyframes);
  if (!observed) {
    fmt::print("{}: no keyframe\n", folder.filename().string());
    return;
  }
  for (const double curvature : options.curvatures) {
    enrolment.anchor.curvature = curvature;
    learn(options, model, folder, *observed, enrolment, collector.span());
  }
  fmt::print("    tracked in {:.0f} s of a processor\n", tracked - begun);
}
}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("Learns the shape of turning heads and measures it against the truth");
  app.add_option("folders", options.folders, "sequences of facet synth")
      ->required()
      ->check(CLI::ExistingDirectory);
  app.add_option("--model", options.model)->check(CLI::ExistingFile);
  app.add_option("--person", options.person,
                 "nothing is learned: this person is measured against the folder's")
      ->check(CLI::ExistingFile);
  app.add_option("--against", options.against, "with --person: other persons, how far apart they are")
      ->check(CLI::ExistingFile);
  app.add_option("--save", options.save, "folder for the persons' face models");
  app.add_option("--keyframes", options.enrolment.keyframes);
  app.add_option("--rounds", options.enrolment.rounds);
  app.add_option("--chart", options.enrolment.chart_texels);
  app.add_option("--distance", options.enrolment.anchor.distance);
  app.add_option("--curvature", options.curvatures, "of the anchor; each is tried")->delimiter(',');
  app.add_flag("--solve-expressions", options.solve_expressions);
  CLI11_PARSE(app, argc, argv);
  try {
    const face::FaceModel model = face::FaceModel::load(options.model);
    if (!options.person.empty()) {
      measure_person(options, model);
      return 0;
    }
    for (const std::filesystem::path& folder : options.folders) {
      run_one(options, model, folder);
    }
  } catch (const std::exception& error) {
    fmt::print(stderr, "person_shape: {}\n", error.what());
    return 1;
  }
  return 0;
}
