#include "report/take_evaluation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <exception>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <utility>

#include "face/person_model.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "maths/statistics.hpp"
#include "report/heat_map.hpp"
#include "report/take_pictures.hpp"
#include "report/truth_folder.hpp"

namespace facet::report {
namespace {

using face::FacePart;

constexpr std::size_t kHeatMapRows = 4;
constexpr std::size_t kJointFrames = 5;  // that the sequence's alignment is found from

/// Indices in the take of frames that have a mesh and a truth; counts those with a truth but without a mesh.
std::vector<std::int64_t> frames_to_measure(take::TakeReader& take, const TruthFolder& truth,
                                            const std::vector<std::int64_t>& wanted, int& without_mesh) {
  std::vector<std::int64_t> all(static_cast<std::size_t>(take.frame_count()));
  std::iota(all.begin(), all.end(), std::int64_t{0});
  std::vector<std::int64_t> frames;
  std::size_t met = 0;
  for (const std::int64_t index : wanted.empty() ? all : wanted) {
    const take::FrameEntry entry = take.entry(index);
    if (!truth.has(entry.sequence)) {
      continue;
    }
    ++met;
    if (entry.has_mesh) {
      frames.push_back(index);
    } else {
      ++without_mesh;
    }
  }
  const std::vector<std::uint64_t> numbers = truth.frames();
  const auto refuse = [&](const std::string& why) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{} and {}: {}", take.info().file.string(), truth.folder().string(), why));
  };
  if (frames.empty()) {
    refuse(
        fmt::format("no frame has both a mesh and a truth; the truth has frames {} to {}, {} of them in "
                    "the take, without a mesh",
                    numbers.front(), numbers.back(), met));
  }
  if (wanted.empty() && met < numbers.size()) {
    refuse(
        fmt::format("the truth has {} frames, {} to {}, of which the take has {}, {} to {}: of another "
                    "video? --frames {}:{} measures what both have",
                    numbers.size(), numbers.front(), numbers.back(), met, take.entry(0).sequence,
                    take.entry(take.frame_count() - 1).sequence, take.entry(frames.front()).sequence,
                    take.entry(frames.back()).sequence + 1));
  }
  return frames;
}

/// A frame's meshes and its truth.
struct PosedFrame {
  std::shared_ptr<const mesh::MeshFrame> frame;
  std::unique_ptr<const Truth> truth;
  Reconstruction coarse;
  Reconstruction refined;
};

/// Any thread.
std::shared_ptr<const PosedFrame> pose_frame(std::shared_ptr<const mesh::MeshFrame> frame,
                                             const TruthFolder& truths) {
  auto posed = std::make_shared<PosedFrame>();
  posed->truth = std::make_unique<Truth>(truths.mesh(frame->sequence), truths.focal_px().value_or(0));
  FrameGeometry geometry = geometry_of(*frame);
  auto measured = measured_vertices(*frame->subject, geometry.coarse_mm, geometry.coarse_normals);
  posed->coarse = {std::move(geometry.coarse_mm), std::move(geometry.coarse_normals), measured,
                   frame->camera.fx};
  posed->refined = {std::move(geometry.refined_mm), std::move(geometry.refined_normals), std::move(measured),
                    frame->camera.fx};
  posed->frame = std::move(frame);
  return posed;
}

/// What is measured of a frame by itself.
struct Measurement {
  std::int64_t index = 0;  ///< in the take
  std::shared_ptr<const mesh::MeshFrame> frame;
  std::optional<Frame> image;
  std::shared_ptr<const PosedFrame> posed;
  Comparison coarse;
  Comparison refined;
  Comparison coarse_by_sequence;
  Comparison refined_by_sequence;
  double coarse_rms = 0;
  double refined_rms = 0;
  BandFields bands;
  std::exception_ptr failure;
};

double rms_of(const mesh::MeshFrame& frame, const Reconstruction& mesh, const std::optional<Frame>& image) {
  if (!image || !frame.albedo ||
      frame.albedo->linear_rgb.size() != static_cast<std::size_t>(mesh.vertices_mm.size())) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  return photometric_rms(vertex_errors(mesh.vertices_mm, mesh.normals, frame.albedo->linear_rgb,
                                       frame.lighting, frame.camera, *image),
                         mesh.measured);
}

/// Fills what index, frame and image, and perhaps posed, say. Any thread; throws nothing.
void measure_frame(Measurement& out, const TruthFolder& truths, Alignment alignment,
                   const maths::Similarity& sequence) {
  try {
    if (!out.posed) {
      out.posed = pose_frame(out.frame, truths);
    }
    const PosedFrame& posed = *out.posed;
    const Truth& truth = *posed.truth;
    out.coarse = compare(posed.coarse, truth, alignment);
    // Refined vertices are near the coarse ones, and so are their alignment and what they are nearest to.
    out.refined = measure(
        posed.refined, truth,
        align_from({&posed.refined, &truth}, alignment, out.coarse.truth_from_reconstruction), &out.coarse);
    out.coarse_by_sequence = measure_again(posed.coarse, truth, sequence, out.coarse);
    out.refined_by_sequence = measure_again(posed.refined, truth, sequence, out.refined);
    out.coarse_rms = rms_of(*out.frame, posed.coarse, out.image);
    out.refined_rms = rms_of(*out.frame, posed.refined, out.image);
    if (!out.frame->displacements_mm.empty()) {
      out.bands =
          split_bands(out.frame->subject->hierarchy->finest().one_rings, posed.coarse,
                      true_displacements_mm(posed.coarse, out.coarse.truth_from_reconstruction, truth),
                      out.frame->displacements_mm);
    }
  } catch (...) {
    out.failure = std::current_exception();
  }
}

/// The points of one part of the face.
std::pair<std::vector<std::int32_t>, Comparison> part_of(const std::vector<std::int32_t>& vertices,
                                                         const Comparison& comparison,
                                                         const std::vector<FacePart>& parts, FacePart part) {
  std::pair<std::vector<std::int32_t>, Comparison> out;
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    if (parts[static_cast<std::size_t>(vertices[k])] == part) {
      out.first.push_back(vertices[k]);
      out.second.signed_distance_mm.push_back(comparison.signed_distance_mm[k]);
      out.second.normal_error_deg.push_back(comparison.normal_error_deg[k]);
    }
  }
  return out;
}

/// Gathers MeshFigures.
class MeshSum {
 public:
  /// parts: of every finest vertex; empty: parts are not told apart
  FrameMeans add(const mesh::MeshFrame& frame, const Reconstruction& mesh, const Comparison& comparison,
                 double rms, const std::vector<FacePart>& parts) {
    constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
    const auto index = static_cast<std::int64_t>(frame.sequence);
    for (std::size_t p = 0; p < (parts.empty() ? 0 : kFaceParts); ++p) {
      const auto [vertices, part] = part_of(mesh.measured, comparison, parts, static_cast<FacePart>(p));
      parts_[p].add(index, vertices, part, kNone);
    }
    return whole_.add(index, mesh.measured, comparison, rms);
  }

  void follow(const mesh::MeshFrame& frame, const Reconstruction& mesh, const Comparison& comparison,
              const Truth& truth, const std::vector<FacePart>& parts) {
    constexpr double kSeconds = 1e-9;
    skin_.add(frame.subject->id, kSeconds * static_cast<double>(frame.media_time_ns), mesh, comparison,
              truth.mesh(), [&](std::int32_t vertex, double mm) {
                if (!parts.empty()) {
                  const auto p = static_cast<std::size_t>(parts[static_cast<std::size_t>(vertex)]);
                  part_skin_mm_[p] += mm;
                  ++part_skin_points_[p];
                }
              });
  }

  const SkinPointSum& skin() const { return skin_; }
  std::uint64_t point_count() const { return whole_.point_count(); }

  MeshFigures figures() const {
    MeshFigures figures;
    figures.whole = whole_.figures();
    figures.skin = skin_.figures();
    for (std::size_t p = 0; p < kFaceParts; ++p) {
      figures.parts[p] = parts_[p].figures();
      figures.part_skin_mm[p] = part_skin_points_[p] > 0
                                    ? part_skin_mm_[p] / static_cast<double>(part_skin_points_[p])
                                    : std::numeric_limits<double>::quiet_NaN();
    }
    return figures;
  }

 private:
  FigureSum whole_;
  std::array<FigureSum, kFaceParts> parts_;
  SkinPointSum skin_;
  std::array<double, kFaceParts> part_skin_mm_{};
  std::array<std::uint64_t, kFaceParts> part_skin_points_{};
};

/// The model that a take was made with, as far as it is known.
class TakesModel {
 public:
  /// frame   of the take, with a mesh; left_out is told what can't be measured
  TakesModel(const mesh::MeshFrame& frame, const std::filesystem::path& given,
             std::map<std::string, std::string>& left_out) {
    const std::filesystem::path file = given.empty() ? default_model_file() : given;
    std::string why;
    if (given.empty() && !std::filesystem::exists(file)) {
      why = fmt::format("there is no {}: give the take's face model with --model", file.string());
    } else {
      model_ = face::FaceModel::load(file);
      if (model_->vertex_count() != frame.subject->hierarchy->control_vertex_count ||
          model_->regions != frame.subject->regions) {
        why =
            fmt::format("the take was not made with the model {}: give the one with --model", file.string());
      } else if (model_->landmarks.empty()) {
        why = fmt::format("the model {} has no landmarks", file.string());
      }
    }
    if (!why.empty()) {
      if (!given.empty()) {
        throw Error(ErrorKind::Usage, why);
      }
      model_.reset();
      left_out["regions"] = why;
      left_out["neutral"] = why;
      return;
    }
    control_parts_ = face::control_parts(*model_);
  }

  /// Of the finest vertices; empty where they are not known.
  const std::vector<FacePart>& parts_of(const mesh::Subject& subject) {
    if (model_ && subject_ != subject.id && subject.regions == model_->regions) {
      subject_ = subject.id;
      parts_ = face::finest_parts(*subject.hierarchy, control_parts_);
    }
    return parts_;
  }

  /// The face at rest of the frame's person, head frame. None where the frame's mesh is not what the model
  /// makes of its expression, with the reason.
  std::optional<Reconstruction> face_at_rest(const mesh::MeshFrame& frame, std::string& why) const {
    const mesh::Subject& subject = *frame.subject;
    if (!model_) {
      return std::nullopt;
    }
    mesh::Vertices rebuilt_mm;
    const face::ExpressionBasis basis = face::expressions_of(*model_, subject);
    basis.evaluate(mesh::shape_weights(frame), rebuilt_mm);
    // The take's vertices are rounded to a hundredth of a millimetre. Where the shape is the person's own its
    // skin may have been followed (docs/person.md): what lies on the face has slid by some millimetres then;
    // eyes, inner mouth and scalp are where the model has them.
    constexpr float kMostDifference_mm = 0.1F;
    constexpr float kMostSlide_mm = 4.1F;
    const bool own = subject.neutral_mm.cols() > 0;
    const Eigen::VectorXf apart = (rebuilt_mm - frame.control_vertices_mm).colwise().norm().transpose();
    const float nearest_quarter = maths::quantile_of(std::vector<float>(apart.begin(), apart.end()), 0.25);
    if (model_->expression_names != subject.expression_names || !(nearest_quarter <= kMostDifference_mm) ||
        !(apart.maxCoeff() <= (own ? kMostSlide_mm : kMostDifference_mm))) {
      why = "the take's meshes are not what its face model makes of its weights: of a booth's template?";
      return std::nullopt;
    }
    Reconstruction face;
    mesh::rebuild_finest(*subject.hierarchy, basis.neutral_mm, {}, face.vertices_mm, face.normals);
    face.measured = face_skin(subject);
    return face;
  }

 private:
  std::optional<face::FaceModel> model_;
  std::vector<FacePart> control_parts_;
  std::uint64_t subject_ = 0;
  std::vector<FacePart> parts_;
};

/// The similarity that brings pinned vertices to their points on the truth at rest.
maths::Similarity start_by_pins(const Reconstruction& face, const std::vector<SkinPointSum::Pin>& pins,
                                const simulation::TruthMesh& truth, Alignment alignment) {
  std::vector<Eigen::Index> pinned;
  for (const std::int32_t vertex : face.measured) {
    if (pins[static_cast<std::size_t>(vertex)].triangle >= 0) {
      pinned.push_back(vertex);
    }
  }
  mesh::Vertices to_mm(3, static_cast<Eigen::Index>(pinned.size()));
  for (std::size_t k = 0; k < pinned.size(); ++k) {
    const SkinPointSum::Pin& pin = pins[static_cast<std::size_t>(pinned[k])];
    to_mm.col(static_cast<Eigen::Index>(k)) =
        render::interpolate(truth.triangles, pin.triangle, pin.barycentric, truth.vertices_mm);
  }
  return maths::best_similarity(face.vertices_mm(Eigen::all, pinned), to_mm,
                                alignment == Alignment::Similarity);
}

class Evaluator {
 public:
  Evaluator(take::TakeReader& take, const std::filesystem::path& folder, const EvaluationOptions& options)
      : take_(take), truths_(folder, options.mm_per_unit), options_(options) {
    frames_ = frames_to_measure(take, truths_, options.frames, out_.without_mesh);
    if (std::filesystem::exists(folder / "video.mkv")) {
      images_ = std::make_unique<SourceImages>(folder / "video.mkv");
    }
    model_ = std::make_unique<TakesModel>(*take.frame(frames_.front()), options.model, out_.left_out);
  }

  TakeEvaluation run(const std::function<void(std::uint64_t done, std::uint64_t total)>& progress) {
    progress(0, frames_.size());
    const auto pictured = spread_evenly(frames_, kHeatMapRows);
    align_sequence();
    for (std::size_t done = 0; done < frames_.size();) {
      std::vector<Measurement> batch(std::min<std::size_t>(2, frames_.size() - done));
      for (std::size_t k = 0; k < batch.size(); ++k) {
        begin(batch[k], frames_[done + k]);
      }
      render::for_each_row(static_cast<int>(batch.size()), [&](int k) {
        measure_frame(batch[static_cast<std::size_t>(k)], truths_, options_.alignment, sequence_);
      });
      for (const Measurement& one : batch) {
        if (one.failure) {
          std::rethrow_exception(one.failure);
        }
        const bool is_pictured = std::find(pictured.begin(), pictured.end(), one.index) != pictured.end();
        add(one, is_pictured);
        progress(++done, frames_.size());
      }
    }
    finish();
    return std::move(out_);
  }

 private:
  /// One similarity for all frames, from a few of them; these are kept for when it is their turn.
  void align_sequence() {
    std::vector<PosedPair> pairs;
    for (const std::int64_t index : spread_evenly(frames_, kJointFrames)) {
      const auto posed = pose_frame(take_.frame(index), truths_);
      pairs.push_back({&posed->refined, posed->truth.get()});
      kept_[index] = posed;
    }
    sequence_ = align_together(pairs, options_.alignment);
  }

  void begin(Measurement& out, std::int64_t index) {
    out.index = index;
    const auto kept = kept_.extract(index);
    if (!kept.empty()) {
      out.posed = kept.mapped();
    }
    out.frame = out.posed ? out.posed->frame : take_.frame(index);
    out.image = images_ ? images_->at(out.frame->sequence) : std::nullopt;
  }

  void add(const Measurement& one, bool is_pictured) {
    const mesh::MeshFrame& frame = *one.frame;
    const PosedFrame& posed = *one.posed;
    const std::vector<FacePart>& parts = model_->parts_of(*frame.subject);
    const FrameMeans coarse = coarse_.add(frame, posed.coarse, one.coarse, one.coarse_rms, parts);
    const FrameMeans refined = refined_.add(frame, posed.refined, one.refined, one.refined_rms, parts);
    constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
    coarse_by_sequence_.add(frame, posed.coarse, one.coarse_by_sequence, kNone, parts);
    refined_by_sequence_.add(frame, posed.refined, one.refined_by_sequence, kNone, parts);
    coarse_.follow(frame, posed.coarse, one.coarse, *posed.truth, parts);
    refined_.follow(frame, posed.refined, one.refined, *posed.truth, parts);
    coarse_by_sequence_.follow(frame, posed.coarse, one.coarse_by_sequence, *posed.truth, parts);
    refined_by_sequence_.follow(frame, posed.refined, one.refined_by_sequence, *posed.truth, parts);
    add_bands(one.bands, parts);
    scale_sum_ += static_cast<double>(one.refined.truth_from_reconstruction.scale);
    if (const TruthNotes* notes = truths_.notes(frame.sequence)) {
      expressions_.add(frame.subject->expression_names, frame.expression, notes->expression);
      if (notes->camera_from_head) {
        pose_.add_pose(frame.camera_from_head, *notes->camera_from_head);
      }
    }
    if (truths_.focal_px()) {
      pose_.add_focal_length(frame.camera.fx, *truths_.focal_px());
    }
    if (is_pictured) {
      heat_map_.add_row(frame, one.image, posed.coarse, one.coarse, posed.refined, one.refined);
    }
    out_.frames.push_back({one.index, coarse, refined});
  }

  void add_bands(const BandFields& bands, const std::vector<FacePart>& parts) {
    const std::array<const BandField*, 3> fields{&bands.whole, &bands.middle, &bands.wrinkles};
    for (std::size_t b = 0; b < fields.size(); ++b) {
      out_.bands[b].add(fields[b]->true_mm, fields[b]->recovered_mm);
      for (std::size_t k = 0; k < (parts.empty() ? 0 : fields[b]->vertices.size()); ++k) {
        const FacePart part = parts[static_cast<std::size_t>(fields[b]->vertices[k])];
        out_.part_bands[static_cast<std::size_t>(part)][b].add(
            static_cast<double>(fields[b]->true_mm[k]), static_cast<double>(fields[b]->recovered_mm[k]));
      }
    }
  }

  void measure_neutral() {
    const std::optional<simulation::TruthMesh> at_rest = truths_.neutral();
    const auto last = take_.frame(frames_.back());
    std::string why;
    if (!at_rest) {
      why = "the truth has no truth/neutral.ply";
    } else if (!refined_.skin().has_topology_of(*at_rest)) {
      why = "the triangles of truth/neutral.ply are not those of the frames";
    } else if (const auto face = model_->face_at_rest(*last, why)) {
      const Truth truth(*at_rest);
      const bool aligned = options_.alignment != Alignment::None;
      const maths::Similarity start =
          aligned ? start_by_pins(*face, refined_.skin().pins(), truth.mesh(), options_.alignment)
                  : maths::Similarity();
      const maths::Similarity transform = align_from({&*face, &truth}, options_.alignment, start);
      MeshSum sum;
      sum.add(*last, *face, measure(*face, truth, transform), std::numeric_limits<double>::quiet_NaN(),
              model_->parts_of(*last->subject));
      out_.neutral = {static_cast<double>(transform.scale), sum.figures()};
    }
    if (!why.empty()) {
      out_.left_out["neutral"] = why;
    }
  }

  void finish() {
    out_.points = refined_.point_count();
    out_.by_frame = {scale_sum_ / static_cast<double>(frames_.size()), coarse_.figures(), refined_.figures()};
    out_.by_sequence = {static_cast<double>(sequence_.scale), coarse_by_sequence_.figures(),
                        refined_by_sequence_.figures()};
    out_.has_parts = !out_.left_out.contains("regions");
    out_.weights = expressions_.figures();
    out_.pose = pose_.figures();
    out_.heat_map = heat_map_.picture();
    if (const std::string why = refined_.skin().missing(); !why.empty()) {
      out_.left_out["skin_point"] = why;
    }
    if (out_.weights.empty()) {
      out_.left_out["expressions"] = "no frame of camera.json has a weight by a name that the take has";
    }
    if (out_.pose.frames == 0) {
      out_.left_out["pose"] = "no frame of camera.json has camera_from_head";
    }
    measure_neutral();
  }

  take::TakeReader& take_;
  TruthFolder truths_;
  const EvaluationOptions& options_;
  std::unique_ptr<SourceImages> images_;
  std::unique_ptr<TakesModel> model_;
  TakeEvaluation out_;
  std::vector<std::int64_t> frames_;
  std::map<std::int64_t, std::shared_ptr<const PosedFrame>> kept_;
  maths::Similarity sequence_;
  MeshSum coarse_;
  MeshSum refined_;
  MeshSum coarse_by_sequence_;
  MeshSum refined_by_sequence_;
  ExpressionSum expressions_;
  PoseSum pose_;
  double scale_sum_ = 0;
  HeatMap heat_map_;
};

}  // namespace

TakeEvaluation evaluate_take(take::TakeReader& take, const std::filesystem::path& folder,
                             const EvaluationOptions& options,
                             const std::function<void(std::uint64_t done, std::uint64_t total)>& progress) {
  return Evaluator(take, folder, options).run(progress);
}

}  // namespace facet::report
