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
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
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
#include "person/surface_anchor.hpp"
#include "person/texture_chart.hpp"
#include "pipeline/observe_head.hpp"
#include "pipeline/refined_relief.hpp"
#include "report/evaluation.hpp"
#include "simulation/truth_mesh.hpp"

namespace {

using namespace facet;

struct Options {
  std::vector<std::filesystem::path> folders;
  std::filesystem::path model = default_model_file();
  std::filesystem::path nets = default_landmark_nets();
  std::filesystem::path save, pictures;
  person::EnrolmentOptions enrolment;
  std::vector<double> curvatures{person::AnchorStrength().curvature};
  bool solve_expressions = false;
  std::optional<pipeline::FrameRange> burst;
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

/// A head's chart beside the truth: what the surface that was found has at each texel and what is true there.
struct SkinTruth {
  person::TextureChart chart;
  mesh::Vertices placed_mm;  ///< [3][vertex_count] in the truth's frame
  float scale = 1;           ///< of the truth's frame against the head's
  Eigen::Matrix3Xf normals;  ///< [3][texel] of the surface
  Eigen::Matrix3Xf true_normals, true_albedo;
  /// [texel] of the truth over the surface through the vertices as it bends between them (half of Phong's
  /// tessellation), mm; and over the triangles.
  Eigen::ArrayXf height_mm, over_triangles_mm;
  std::vector<char> known;           ///< [texel]
  std::vector<char> plain;           ///< [texel] skin, and neither lids, nose nor mouth
  std::vector<face::FacePart> part;  ///< [texel] of its first corner
};

float brightness(const Eigen::Vector3f& rgb) {
  return rgb.dot(Eigen::Vector3f(0.2126F, 0.7152F, 0.0722F));
}

SkinTruth skin_truth(const face::FaceModel& model, const person::LearnedShape& learned, int texels,
                     const report::Truth& truth) {
  const mesh::Triangles triangles = mesh::split_quads(model.control.quads);
  report::Reconstruction mesh;
  mesh::apply(person::surface_rows(model), learned.neutral_mm.cast<float>().eval(), mesh.vertices_mm);
  mesh::vertex_normals(mesh.vertices_mm, triangles, mesh.normals);
  for (std::int32_t v = 0; v < model.vertex_count(); ++v) {
    if (model.control.refinable[static_cast<std::size_t>(v)] != 0) {
      mesh.measured.push_back(v);
    }
  }
  const maths::Similarity onto = report::align_from({&mesh, &truth}, report::Alignment::Similarity, {});
  SkinTruth out{person::face_chart(model, texels),
                onto.apply(mesh.vertices_mm),
                onto.scale,
                {},
                {},
                {},
                {},
                {},
                {},
                {},
                {}};
  const auto count = static_cast<Eigen::Index>(out.chart.triangle().size());
  out.normals = out.true_normals = out.true_albedo = Eigen::Matrix3Xf::Zero(3, count);
  out.height_mm = out.over_triangles_mm = Eigen::ArrayXf::Zero(count);
  out.known.assign(static_cast<std::size_t>(count), 0);
  out.plain = out.known;
  out.part.resize(static_cast<std::size_t>(count));
  const std::vector<face::FacePart> parts = face::control_parts(model);
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(out.placed_mm, triangles, normals);
  Eigen::Matrix3Xf true_normals;
  mesh::vertex_normals(truth.mesh().vertices_mm, truth.mesh().triangles, true_normals);
  for (Eigen::Index i = 0; i < count; ++i) {
    const auto texel = static_cast<std::size_t>(i);
    if (out.chart.triangle()[texel] < 0) {
      continue;
    }
    const Eigen::Vector3f at = out.chart.spread(out.placed_mm, texel);
    out.normals.col(i) = out.chart.spread(normals, texel).stableNormalized();
    const auto closest = truth.caster().closest_point(at, 20);
    const auto of_texel = triangles.col(out.chart.triangle()[texel]);
    out.part[texel] = parts[static_cast<std::size_t>(of_texel[0])];
    out.plain[texel] = std::all_of(of_texel.begin(), of_texel.end(), [&](std::int32_t v) {
      const face::FacePart part = parts[static_cast<std::size_t>(v)];
      return model.control.refinable[static_cast<std::size_t>(v)] != 0 && part != face::FacePart::Lids &&
             part != face::FacePart::Nose && part != face::FacePart::Mouth;
    });
    if (closest.triangle < 0) {
      continue;
    }
    out.known[texel] = 1;
    const auto corners = truth.mesh().triangles.col(closest.triangle);
    const Eigen::Vector3f shares(1 - closest.barycentric.sum(), closest.barycentric[0],
                                 closest.barycentric[1]);
    const auto mix = [&](const Eigen::Matrix3Xf& values) -> Eigen::Vector3f {
      return values(Eigen::all, corners) * shares;
    };
    out.true_albedo.col(i) = mix(truth.mesh().albedo);
    out.true_normals.col(i) = mix(true_normals).stableNormalized();
    out.over_triangles_mm[i] = (mix(truth.mesh().vertices_mm) - at).dot(out.normals.col(i));
    float bends = 0;
    for (int c = 0; c < 3; ++c) {
      bends += 0.5F * out.chart.barycentric()[texel][c] *
               (out.placed_mm.col(of_texel[c]) - at).dot(normals.col(of_texel[c]));
    }
    out.height_mm[i] = out.over_triangles_mm[i] - bends;
  }
  return out;
}

/// [height][width] by a bell of this standard deviation, texels.
Eigen::ArrayXf blurred(const Eigen::ArrayXf& image, int width, float sigma) {
  const int reach = static_cast<int>(std::ceil(4 * sigma));
  Eigen::ArrayXf bell(2 * reach + 1);
  for (int i = -reach; i <= reach; ++i) {
    bell[i + reach] = std::exp(-0.5F * static_cast<float>(i * i) / (sigma * sigma));
  }
  bell /= bell.sum();
  const auto height = static_cast<int>(image.size()) / width;
  const auto along = [&](const Eigen::ArrayXf& from, int step, int length) {
    Eigen::ArrayXf out = Eigen::ArrayXf::Zero(from.size());
    for (Eigen::Index p = 0; p < from.size(); ++p) {
      const int at = static_cast<int>(p) / step % length;
      for (int i = std::max(-reach, -at); i <= std::min(reach, length - 1 - at); ++i) {
        out[p] += bell[i + reach] * from[p + static_cast<Eigen::Index>(i) * step];
      }
    }
    return out;
  };
  return along(along(image, 1, width), width, height);
}

/// What of an image lies between two widths, texels, where weight is 1.
Eigen::ArrayXf band(const Eigen::ArrayXf& image, const Eigen::ArrayXf& weight, int width, float low,
                    float high) {
  const auto mean = [&](float wide) -> Eigen::ArrayXf {
    return blurred(image * weight, width, wide / 4) / (blurred(weight, width, wide / 4) + 1e-4F);
  };
  const Eigen::ArrayXf fine = low > 0 ? mean(low) : image;
  return fine - mean(high);
}

struct Agreement {
  double n = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0;
  void add(float found, float truth) {
    const auto x = static_cast<double>(found);
    const auto y = static_cast<double>(truth);
    n += 1, a += x, b += y, aa += x * x, bb += y * y, ab += x * y;
  }
  double correlation() const {
    return (ab / n - a * b / n / n) /
           std::sqrt(std::max((aa / n - a * a / n / n) * (bb / n - b * b / n / n), 1e-30));
  }
  double depth() const { return ab / std::max(bb, 1e-30); }
};

/// Two pictures [3][texel] beside each other, what was found to the left.
void write_pictures(const Options& options, const std::string& name, int width,
                    const std::array<Eigen::Matrix3Xf, 2>& pictures) {
  std::filesystem::create_directories(options.pictures);
  std::ofstream out(options.pictures / (name + ".ppm"), std::ios::binary);
  const auto height = static_cast<int>(pictures[0].cols()) / width;
  out << "P6\n" << 2 * width << " " << height << "\n255\n";
  // The chart's rows begin at the chin.
  for (int row = height - 1; row >= 0; --row) {
    for (const Eigen::Matrix3Xf& picture : pictures) {
      for (int column = 0; column < width; ++column) {
        for (int c = 0; c < 3; ++c) {
          const float value = std::clamp(picture(c, row * width + column), 0.0F, 1.0F);
          out.put(static_cast<char>(static_cast<unsigned char>(255 * std::pow(value, 1 / 2.2F))));
        }
      }
    }
  }
}

void print_albedo(const Options& options, const face::FaceModel& model, const person::Skin& skin,
                  const SkinTruth& truth, const std::string& name) {
  Agreement before;
  Agreement after;
  const Eigen::Map<const Eigen::Matrix3Xf> found(skin.chart.albedo.data(), 3, truth.height_mm.size());
  const auto logarithm = [](const Eigen::Vector3f& rgb) {
    return std::log(std::max(brightness(rgb), 1e-4F));
  };
  for (Eigen::Index i = 0; i < truth.height_mm.size(); ++i) {
    const auto texel = static_cast<std::size_t>(i);
    if (truth.known[texel] != 0 && skin.seen[texel] > 1 && std::abs(truth.over_triangles_mm[i]) < 3 &&
        truth.true_albedo(0, i) > 0) {
      const float there = logarithm(truth.true_albedo.col(i));
      before.add(logarithm(truth.chart.spread(model.mean_albedo, texel)), there);
      after.add(logarithm(found.col(i)), there);
    }
  }
  fmt::print("    albedo: correlation {:.3f} -> {:.3f}; residual {:.3f}, gains", before.correlation(),
             after.correlation(), skin.residual);
  for (const float gain : skin.gains) {
    fmt::print(" {:.2f}", gain);
  }
  fmt::print("\n");
  if (!options.pictures.empty()) {
    write_pictures(options, name + "-albedo", skin.chart.width, {found, truth.true_albedo});
  }
}

/// What the relief makes of the surface's normals, [3][texel]; zero where a texel lacks a neighbour.
Eigen::Matrix3Xf with_relief(const person::Skin& skin, const SkinTruth& truth, double& texel_mm) {
  Eigen::Matrix3Xf out = Eigen::Matrix3Xf::Zero(3, truth.height_mm.size());
  std::vector<float> lengths;
  const auto held = [&](int texel) { return truth.chart.triangle()[static_cast<std::size_t>(texel)] >= 0; };
  for (int row = 0; row + 1 < skin.chart.height; ++row) {
    for (int column = 0; column + 1 < skin.chart.width; ++column) {
      const int i = row * skin.chart.width + column;
      const int below = i + skin.chart.width;
      if (!held(i) || !held(i + 1) || !held(below)) {
        continue;
      }
      const auto at = [&](int texel) -> Eigen::Vector3f {
        return truth.chart.spread(truth.placed_mm, static_cast<std::size_t>(texel)) / truth.scale;
      };
      const Eigen::Vector3f u = at(i + 1) - at(i);
      const Eigen::Vector3f v = at(below) - at(i);
      lengths.push_back(u.norm());
      const float uu = u.squaredNorm();
      const float uv = u.dot(v);
      const float vv = v.squaredNorm();
      const float area = std::max(uu * vv - uv * uv, 1e-6F);
      const auto relief = [&](int texel) { return skin.chart.relief_mm[static_cast<std::size_t>(texel)]; };
      const Eigen::Vector3f rises = (vv * u - uv * v) / area * (relief(i + 1) - relief(i)) +
                                    (uu * v - uv * u) / area * (relief(below) - relief(i));
      out.col(i) = (truth.normals.col(i) - rises).stableNormalized();
    }
  }
  texel_mm = lengths.empty() ? 1 : static_cast<double>(maths::median_of(lengths));
  return out;
}

void print_relief(const Options& options, const person::Skin& skin, const SkinTruth& truth,
                  const std::string& name) {
  double texel_mm = 1;
  const Eigen::Matrix3Xf normals = with_relief(skin, truth, texel_mm);
  const Eigen::Index count = truth.height_mm.size();
  const auto per_mm = static_cast<float>(1 / texel_mm);
  Eigen::ArrayXf weight = Eigen::ArrayXf::Zero(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const auto texel = static_cast<std::size_t>(i);
    weight[i] = truth.known[texel] != 0 && truth.plain[texel] != 0 && skin.seen[texel] > 1 &&
                        std::abs(truth.height_mm[i]) < 3 && normals.col(i).squaredNorm() > 0
                    ? 1.0F
                    : 0.0F;
  }
  const Eigen::ArrayXf whole = blurred(weight, skin.chart.width, 2 * per_mm);
  const Eigen::Map<const Eigen::ArrayXf> relief(skin.chart.relief_mm.data(), count);
  std::array<Eigen::Matrix3Xf, 2> pictures{Eigen::Matrix3Xf::Zero(3, count),
                                           Eigen::Matrix3Xf::Zero(3, count)};
  fmt::print("    relief:");
  for (const auto& [low, high] : {std::pair(0.0F, 4.0F), std::pair(4.0F, 15.0F)}) {
    const Eigen::ArrayXf found = band(relief, weight, skin.chart.width, low * per_mm, high * per_mm);
    const Eigen::ArrayXf there = band(truth.height_mm, weight, skin.chart.width, low * per_mm, high * per_mm);
    Agreement agreement;
    std::map<face::FacePart, Agreement> of_part;
    for (Eigen::Index i = 0; i < count; ++i) {
      if (whole[i] > 0.97F) {
        agreement.add(found[i], there[i]);
        of_part[truth.part[static_cast<std::size_t>(i)]].add(found[i], there[i]);
      }
      if (weight[i] > 0) {
        pictures[0].col(i).array() += 0.25F + 2 * found[i];
        pictures[1].col(i).array() += 0.25F + 2 * there[i];
      }
    }
    fmt::print(" {:.0f} to {:.0f} mm correlation {:.3f}, depth {:.3f} (", low, high, agreement.correlation(),
               agreement.depth());
    const char* between = "";
    for (const auto& [part, one] : of_part) {
      fmt::print("{}{} {:.2f}, {:.2f}", std::exchange(between, "; "),
                 face::kFacePartNames.at(static_cast<std::size_t>(part)), one.correlation(), one.depth());
    }
    fmt::print(");");
  }
  double before = 0;
  double after = 0;
  int facing = 0;
  const auto degrees = [](float cosine) {
    return std::acos(std::clamp(static_cast<double>(cosine), -1.0, 1.0)) * 180 / std::numbers::pi;
  };
  for (Eigen::Index i = 0; i < count; ++i) {
    const float cosine = normals.col(i).dot(truth.true_normals.col(i));
    if (whole[i] > 0.97F && cosine > 0.2F) {
      before += degrees(truth.normals.col(i).dot(truth.true_normals.col(i)));
      after += degrees(cosine);
      ++facing;
    }
  }
  fmt::print(" normals {:.2f} -> {:.2f}\n", before / std::max(facing, 1), after / std::max(facing, 1));
  if (!options.pictures.empty()) {
    write_pictures(options, name + "-relief", skin.chart.width, pictures);
  }
}

/// Refines the relief as the product does.
void refine(const Options& options, const person::Observed& observed, double focal_px,
            face::FaceModel& person) {
  track::TrackerConfig tracker;
  tracker.landmark_nets = options.nets;
  tracker.intrinsics = observed.camera;
  tracker.intrinsics->fx = tracker.intrinsics->fy = static_cast<float>(focal_px);
  const double begun = processor_s();
  const std::string missed = pipeline::refine_relief(
      person, observed, tracker, {{}, refine::refiner_opener({}, {})}, [] { return true; });
  fmt::print("    {} ({:.1f} s)\n", missed.empty() ? "refined" : missed, processor_s() - begun);
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
  if (learned.skin.chart.width > 0) {
    const SkinTruth skin = skin_truth(model, learned, enrolment.skin_texels, truth);
    print_albedo(options, model, learned.skin, skin, folder.filename().string());
    print_relief(options, learned.skin, skin, folder.filename().string());
  }
  const std::string name = folder.filename().string();
  face::FaceModel person = face::person_model(model, learned.identity, learned.neutral_mm, name);
  if (learned.skin.believed) {
    person.skin = learned.skin.chart;
    refine(options, observed, learned.focal_px, person);
    person::Skin refined = learned.skin;
    refined.chart = person.skin;
    print_relief(options, refined, skin_truth(model, learned, enrolment.skin_texels, truth),
                 name + ", refined");
  }
  if (!options.save.empty()) {
    std::filesystem::create_directories(options.save);
    person.save(options.save / (name + ".facemodel"));
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
      pipeline::observe_head(parts, config.frames, options.burst, [](std::uint64_t) { return true; });
  const person::KeyframeCollector& collector = head.keyframes;
  const double tracked = processor_s();
  person::EnrolmentOptions enrolment = options.enrolment;
  enrolment.expression =
      options.solve_expressions ? person::KeyframeExpression::Solved : person::KeyframeExpression::Rest;
  enrolment.skin = enrolment.skin_texels > 0;
  const auto observed = collector.observed(enrolment.keyframes, enrolment.lit);
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
  app.add_option("--pictures", options.pictures,
                 "folder for the albedo and the relief that were found, each beside the truth");
  app.add_option("--keyframes", options.enrolment.keyframes);
  app.add_option_function<std::string>(
      "--burst", [&](const std::string& text) { options.burst = pipeline::parse_frame_range(text); },
      "frames A:B in which lamps fire in turn");
  app.add_option("--lit", options.enrolment.lit, "pictures of the burst");
  app.add_option("--rounds", options.enrolment.rounds);
  app.add_option("--chart", options.enrolment.chart_texels);
  app.add_option("--skin", options.enrolment.skin_texels, "of the skin's chart; 0: no skin");
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
