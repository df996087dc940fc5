#include "refine/refiner.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "refine/albedo.hpp"
#include "refine/device_order.hpp"
#include "refine/displacement_kernels.hpp"
#include "refine/lighting.hpp"
#include "refine/observation.hpp"
#include "refine/recorded_frames.hpp"
#include "refine/refiner_options.hpp"
#include "refine/room_light.hpp"
#include "refine/subject_setup.hpp"
#include "refine_shaders.hpp"
#include "shaders/refine/layout.h"

namespace facet::refine {
namespace {

using shaders::vec4;
using shaders::refine::FrameParameters;
using shaders::refine::Light;

constexpr std::size_t kMostTimedKernels = 4096;
// After the first frames the albedo looks for vertices not yet seen in one frame of this many.
constexpr std::uint64_t kAlbedoRefreshFrames = 8;
// A new albedo is handed out when more than this share of M0's vertices has learned from the frame.
constexpr float kAlbedoNewsShare = 0.005F;

struct Level {
  /// coarser  order of the next coarser level's vertices; nullptr at the coarsest
  Level(gpu::Context& context, const mesh::Hierarchy& hierarchy, std::size_t index,
        const std::vector<std::uint8_t>& free, const std::vector<float>& trust, const DeviceOrder* coarser)
      : order(device_order(hierarchy.levels[index].one_rings, hierarchy.texture_coordinates)),
        topology(context, reordered(hierarchy.levels[index].one_rings, order), reordered(free, order),
                 order.curve, reordered(trust, order)),
        stencils(context, reordered(hierarchy.levels[index].from_coarser, order, coarser)),
        state(context, topology.vertex_count) {}

  DeviceOrder order;
  LevelTopology topology;
  LevelStencils stencils;
  LevelState state;
  std::optional<DeviceArray> in_finer;  ///< fine_albedo: [vertex_count] device index in the next finer level
};

std::vector<std::uint32_t> vertex_counts(const mesh::Hierarchy& hierarchy) {
  std::vector<std::uint32_t> out;
  for (const mesh::Level& level : hierarchy.levels) {
    out.push_back(static_cast<std::uint32_t>(level.vertex_count));
  }
  return out;
}

std::uint32_t most_places(const std::vector<std::unique_ptr<Level>>& levels) {
  std::uint32_t most = 0;
  for (const std::unique_ptr<Level>& level : levels) {
    most = std::max(most, level->topology.patches.place_count);
  }
  return most;
}

}  // namespace

/// Everything on the device that belongs to one subject.
struct SubjectBuffers {
  SubjectBuffers(gpu::Context& context, const RefinerConfig& config, const SubjectSetup& subject);

  std::uint32_t control_vertex_count;
  Weights weights;
  std::vector<std::unique_ptr<Level>> levels;
  mesh::Triangles triangles;  ///< of the coarsest level, in device order
  DeviceArray handed_out_as;  ///< [finest vertex_count] DeviceOrder::host_index
  DeviceArray control;        ///< [control_vertex_count] shading frame, mm; the host writes it every frame
  std::vector<vec4> control_written;  ///< what was last copied to `control`
  gpu::Buffer frame;                  ///< FrameParameters
  SolverScratch scratch;
  OcclusionMap depth;
  LightingState lighting;
  AlbedoState albedo;
  gpu::Buffer results;  ///< [finest vertex_count] vec2: displacement, confidence, in the hierarchy's order
  gpu::Buffer results_out;
  gpu::Buffer errors_out;  ///< [workgroup] vec4
  gpu::Buffer light_out;
  gpu::Buffer albedo_out;
  std::optional<RoomLight> room;
  std::optional<DeviceArray> room_irradiance;  ///< [M0's vertex count] RoomLight::irradiance
  std::optional<ImagePyramid> pyramid;
  std::vector<std::unique_ptr<FurtherCameraState>> further_views;
  std::optional<DeviceArray> view_colours;  ///< [finest vertex_count] of one further view at a time
  RecordedFrames frames;
};

/// All kernels of the method.
struct Kernels {
  explicit Kernels(gpu::Context& context)
      : observation(context),
        lighting(context),
        albedo(context),
        displacement(context),
        finish(context, shaders::refine::kernels(), "refine/finish") {}

  /// Records a whole frame for images of the pyramid's size. learn: with the albedo.
  void record(gpu::Batch& batch, const RefinerConfig& config, const SubjectBuffers& subject, bool learn,
              const StepPlan& plan) const;

  ObservationKernels observation;
  LightingKernels lighting;
  AlbedoKernels albedo;
  DisplacementKernels displacement;
  gpu::Kernel finish;

 private:
  void record_observe(gpu::Batch& batch, const SubjectBuffers& subject, const Level& level) const;
  void record_albedo(gpu::Batch& batch, const RefinerConfig& config, const SubjectBuffers& subject) const;
  void record_displacements(gpu::Batch& batch, const RefinerConfig& config, const SubjectBuffers& subject,
                            const StepPlan& plan) const;
  void record_readback(gpu::Batch& batch, const RefinerConfig& config, const SubjectBuffers& subject,
                       bool learn) const;
};

struct Refiner::Impl {
  Impl(gpu::Context& used, const RefinerConfig& chosen) : context(used), config(chosen), kernels(used) {
    context.keep_kernels();
  }

  gpu::Context& context;
  RefinerConfig config;
  Kernels kernels;
  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  std::optional<SubjectBuffers> subject;
  const RecordedFrame* in_flight = nullptr;
  Clock::time_point submitted;
  bool lost = false;
  bool warm = false;              ///< the previous frame's displacements and light can be used
  std::uint64_t frame_count = 0;  ///< of this subject
  std::uint64_t albedo_version = 0;
  bool albedo_known = false;   ///< the subject came with one: it is held
  mesh::Vertices skin_albedo;  ///< SubjectSetup::skin_albedo
  std::shared_ptr<const mesh::Albedo> albedo;

  void fit_views(std::span<const FurtherCamera> views);
  void write_views(std::span<const FurtherCamera> views, std::span<const vec4> control) const;
  void write_room(const RefineInput& input, std::span<const vec4> control);
  void read(RefineOutput& output);
  void read_albedo();
  bool learns(std::uint64_t frame) const;
  std::unique_ptr<gpu::Batch> record(const StepPlan& plan, bool learn) const;
  std::vector<std::vector<double>> read_energies(const StepPlan& plan) const;
  void clear_output(RefineOutput& output) const;
};

SubjectBuffers::SubjectBuffers(gpu::Context& context, const RefinerConfig& config,
                               const SubjectSetup& subject)
    : control_vertex_count(static_cast<std::uint32_t>(subject.hierarchy->control_vertex_count)),
      weights(weights_for(subject, config.weights)),
      levels([&] {
        const auto free = free_vertices(*subject.hierarchy, subject.refinable);
        const auto trust = trust_of_levels(*subject.hierarchy, subject.trust);
        std::vector<std::unique_ptr<Level>> made;
        for (std::size_t l = 0; l < free.size(); ++l) {
          made.push_back(std::make_unique<Level>(context, *subject.hierarchy, l, free[l], trust[l],
                                                 l > 0 ? &made.back()->order : nullptr));
        }
        return made;
      }()),
      triangles(subject.hierarchy->levels.front().triangles.unaryExpr([&](std::int32_t vertex) {
        return levels.front()->order.device_index[static_cast<std::size_t>(vertex)];
      })),
      handed_out_as(context, levels.back()->topology.vertex_count, gpu::TexelFormat::R32i, "handed out as"),
      control(context, control_vertex_count, gpu::TexelFormat::Rgba32f, "control vertices",
              gpu::Memory::Upload),
      frame(context, sizeof(FrameParameters), gpu::Memory::Upload, "frame parameters"),
      scratch(context, levels.back()->topology.vertex_count, levels.back()->topology.group_count,
              most_places(levels),
              static_cast<std::uint32_t>(levels.size()) * static_cast<std::uint32_t>(most_steps(config) + 1)),
      depth(context, triangles),
      lighting(context),
      albedo(context, (config.fine_albedo ? levels.back() : levels.front())->topology.vertex_count,
             albedo_options(config, weights).pcg_iterations),
      results(context, sizeof(shaders::vec2) * levels.back()->topology.vertex_count, gpu::Memory::Device,
              "results"),
      results_out(context, sizeof(shaders::vec2) * levels.back()->topology.vertex_count,
                  gpu::Memory::Readback, "results read back"),
      errors_out(context, sizeof(vec4) * context.info().workgroup_count, gpu::Memory::Readback, "error sums"),
      light_out(context, sizeof(Light), gpu::Memory::Readback, "light read back"),
      albedo_out(context, sizeof(vec4) * levels.back()->topology.vertex_count, gpu::Memory::Readback,
                 "albedo read back"),
      frames(vertex_counts(*subject.hierarchy),
             plans_frames(config) ? std::nullopt
                                  : std::optional(constant_plan(config, subject.hierarchy->levels.size())),
             config.record_energies) {
  gpu::upload(context, handed_out_as.buffer, std::as_bytes(std::span(levels.back()->order.host_index)));
  const bool known = subject.albedo != nullptr;
  const std::vector<mesh::Vertices> start = albedo_of_levels(subject);
  if (config.room_lamps == RoomLamps::Always ||
      (config.room_lamps == RoomLamps::KnownShapes && subject.known_shape)) {
    room.emplace(subject.hierarchy, counts_for_light(subject), start.front());
    room_irradiance.emplace(context, levels.front()->topology.vertex_count, gpu::TexelFormat::Rgba32f,
                            "room's irradiance", gpu::Memory::Upload);
  }
  const auto reliefs = relief_of_levels(subject);
  for (std::size_t l = 0; l < levels.size(); ++l) {
    const std::vector<vec4> packed = reordered(with_fourth(start[l], known ? 1 : 0), levels[l]->order);
    gpu::upload(context, levels[l]->state.albedo.buffer, std::as_bytes(std::span(packed)));
    if (!reliefs.empty()) {
      const auto relief = reordered(with_fourth(reliefs[l], 0), levels[l]->order);
      gpu::upload(context, levels[l]->state.reliefs.buffer, std::as_bytes(std::span(relief)));
    }
    if (l == (config.fine_albedo ? levels.size() - 1 : 0)) {
      gpu::upload(context, albedo.mean.buffer, std::as_bytes(std::span(packed)));
    }
    if (config.fine_albedo && l + 1 < levels.size()) {
      std::vector<std::int32_t> in_finer = levels[l]->order.host_index;
      for (std::int32_t& vertex : in_finer) {
        vertex = levels[l + 1]->order.device_index[static_cast<std::size_t>(vertex)];
      }
      levels[l]->in_finer.emplace(context, in_finer.size(), gpu::TexelFormat::R32i, "in the finer level");
      gpu::upload(context, levels[l]->in_finer->buffer, std::as_bytes(std::span(in_finer)));
    }
  }
}

void Kernels::record(gpu::Batch& batch, const RefinerConfig& config, const SubjectBuffers& subject,
                     bool learn, const StepPlan& plan) const {
  const Level& coarsest = *subject.levels.front();
  const bool refine_coarsest = plan.steps.front() > 0;

  if (config.time_kernels) {
    batch.time_dispatches();
  }
  batch.stage("upload");
  observation.record_image(batch, *subject.pyramid, subject.frame);
  observation.record_prolong(
      batch, coarsest.topology, coarsest.stencils, subject.control.view, coarsest.state, subject.frame,
      {refine_coarsest, config.given_prior ? Prior::Given : Prior::None, config.displacement_bound_mm});
  for (const std::unique_ptr<FurtherCameraState>& view : subject.further_views) {
    observation.record_image(batch, view->pyramid, view->frame);
  }
  // Only now, behind one barrier: what they need was made side by side.
  observation.record_depth(batch, coarsest.state, subject.depth, subject.frame);
  observation.record_mips(batch, *subject.pyramid, subject.frame);
  for (const std::unique_ptr<FurtherCameraState>& view : subject.further_views) {
    observation.record_depth(batch, coarsest.state, view->depth, view->frame);
    observation.record_mips(batch, view->pyramid, view->frame);
  }
  record_observe(batch, subject, coarsest);

  batch.stage("lighting");
  if (subject.room_irradiance) {
    batch.copy(subject.room_irradiance->buffer, coarsest.state.irradiance.buffer);
  }
  lighting.record(batch, coarsest.topology, coarsest.state, subject.lighting, subject.frame,
                  {config.weights.lighting_temporal, config.robust_scale, config.metric_floor});

  if (learn && !config.fine_albedo) {
    batch.stage("albedo");
    record_albedo(batch, config, subject);
  }

  batch.stage("displacement");
  record_displacements(batch, config, subject, plan);
  if (learn && config.fine_albedo) {
    batch.stage("albedo");
    record_albedo(batch, config, subject);
  }
  batch.stage("readback");
  record_readback(batch, config, subject, learn);
  batch.finish();
}

/// What all cameras see of a level.
void Kernels::record_observe(gpu::Batch& batch, const SubjectBuffers& subject, const Level& level) const {
  observation.record_observe(batch, level.topology, level.state, *subject.pyramid, subject.depth,
                             subject.frame);
  for (const std::unique_ptr<FurtherCameraState>& view : subject.further_views) {
    observation.record_view(batch, level.topology, level.state, *view, *subject.view_colours,
                            &level == subject.levels.front().get(), view == subject.further_views.back());
  }
}

void Kernels::record_albedo(gpu::Batch& batch, const RefinerConfig& config,
                            const SubjectBuffers& subject) const {
  const Level& learned = config.fine_albedo ? *subject.levels.back() : *subject.levels.front();
  albedo.record(batch, learned.topology, learned.state, subject.albedo, subject.frame, subject.lighting.light,
                albedo_options(config, subject.weights));
  for (std::size_t l = 1; l < subject.levels.size(); ++l) {
    if (config.fine_albedo) {
      const Level& finer = *subject.levels[subject.levels.size() - l];
      const Level& level = *subject.levels[subject.levels.size() - l - 1];
      albedo.record_restrict(batch, finer.topology, finer.state, level.topology, level.state,
                             level.in_finer->view);
    } else {
      const Level& level = *subject.levels[l];
      observation.record_prolong_values(batch, level.topology, level.stencils,
                                        subject.levels[l - 1]->state.albedo, level.state.albedo);
    }
  }
}

void Kernels::record_displacements(gpu::Batch& batch, const RefinerConfig& config,
                                   const SubjectBuffers& subject, const StepPlan& plan) const {
  for (std::size_t l = 0; l < subject.levels.size(); ++l) {
    const Level& level = *subject.levels[l];
    if (config.time_kernels) {
      batch.stage(fmt::format("displacement/{}", l));
    }
    const bool refined = plan.steps[l] > 0;
    const bool prolonged = config.hierarchical && l > 0;
    if (l > 0) {
      observation.record_prolong(
          batch, level.topology, level.stencils, subject.levels[l - 1]->state.positions.view, level.state,
          subject.frame, {refined, prolonged ? Prior::Prolonged : Prior::None, config.displacement_bound_mm});
      if (subject.room_irradiance) {
        observation.record_prolong_values(batch, level.topology, level.stencils,
                                          subject.levels[l - 1]->state.irradiance, level.state.irradiance);
      }
    }
    // The finest level is looked at in any case: its vertices' confidence is handed out.
    if (l > 0 && (refined || l + 1 == subject.levels.size())) {
      record_observe(batch, subject, level);
    }
    if (!refined) {
      continue;
    }
    const bool has_prior = prolonged || (l == 0 && config.given_prior);
    const DisplacementOptions options =
        displacement_options(config, subject.weights, has_prior, plan.steps[l], plan.pcg_iterations);
    const std::uint32_t slot = first_energy_slot(config, l);
    displacement.record(batch, level.topology, level.state, subject.scratch, subject.lighting.light, options,
                        slot);
    if (plan.last_energy) {
      displacement.record_energy(batch, level.topology, level.state, subject.scratch, subject.lighting.light,
                                 options, slot + static_cast<std::uint32_t>(plan.steps[l]));
    }
  }
}

void Kernels::record_readback(gpu::Batch& batch, const RefinerConfig& config, const SubjectBuffers& subject,
                              bool learn) const {
  const Level& finest = *subject.levels.back();
  shaders::refine::SolvePush push{};
  push.vertex_count = finest.topology.vertex_count;
  push.robust_scale = config.robust_scale;
  push.bound_mm = config.displacement_bound_mm;
  batch.dispatch(finish,
                 {{"vertex_rings", finest.topology.vertex_rings.view},
                  {"ring_indices", finest.topology.ring_indices.view},
                  {"positions", finest.state.positions.view},
                  {"normals", finest.state.normals.view},
                  {"colours", finest.state.colours.view},
                  {"albedo", finest.state.albedo.view},
                  {"irradiance", finest.state.irradiance.view},
                  {"light", subject.lighting.light},
                  {"handed_out_as", subject.handed_out_as.view},
                  {"results", subject.results},
                  {"error_sums", subject.errors_out}},
                 {finest.topology.workgroup_count}, push);
  // In one go: a GPU writes scattered numbers to the host's memory ten times as slowly as to its own.
  batch.copy(subject.results, subject.results_out);
  batch.copy(subject.lighting.light, subject.light_out);
  if (learn) {
    batch.copy(finest.state.albedo.buffer, subject.albedo_out);
  }
}

Refiner::Refiner(gpu::Context& context, const RefinerConfig& config) {
  check(config);
  impl_ = std::make_unique<Impl>(context, config);
}

Refiner::~Refiner() {
  if (impl_->in_flight != nullptr) {
    impl_->in_flight->batch->wait();
  }
}

void Refiner::set_subject(const SubjectSetup& subject) {
  check(impl_->config, subject);
  impl_->subject.reset();
  impl_->subject.emplace(impl_->context, impl_->config, subject);
  impl_->hierarchy = subject.hierarchy;
  impl_->warm = false;
  impl_->frame_count = 0;
  impl_->albedo = subject.albedo;
  impl_->albedo_known = subject.albedo != nullptr;
  impl_->skin_albedo = subject.skin_albedo;
}

void Refiner::restart() {
  impl_->warm = false;
}

void Refiner::submit(const RefineInput& input) {
  Impl& impl = *impl_;
  if (!impl.subject) {
    throw Error(ErrorKind::Usage, "refinement has no subject: call set_subject first");
  }
  SubjectBuffers& subject = *impl.subject;
  const bool seen = !input.image.empty();
  const int width_px = seen ? input.image.width_px : input.camera.width_px;
  const int height_px = seen ? input.image.height_px : input.camera.height_px;
  if ((!seen && input.further_views.empty()) || width_px < 1 || height_px < 1) {
    throw Error(ErrorKind::Usage, "refinement was given an empty image");
  }
  if (input.control_vertices_mm == nullptr ||
      input.control_vertices_mm->cols() != static_cast<Eigen::Index>(subject.control_vertex_count)) {
    throw Error(ErrorKind::Usage,
                fmt::format("refinement was given {} control vertices; the subject has {}",
                            input.control_vertices_mm == nullptr ? 0 : input.control_vertices_mm->cols(),
                            subject.control_vertex_count));
  }
  const std::size_t given = input.prior_displacements_mm.size();
  if (given != (impl.config.given_prior ? subject.control_vertex_count : 0)) {
    throw Error(ErrorKind::Usage, fmt::format("refinement was given {} displacements for {} control vertices",
                                              given, subject.control_vertex_count));
  }
  for (const FurtherCamera& view : input.further_views) {
    if (!view.image.empty() &&
        (view.image.width_px != view.camera.width_px || view.image.height_px != view.camera.height_px)) {
      throw Error(ErrorKind::Usage,
                  fmt::format("refinement was given an image of {} x {} px of a camera with {} x {} px",
                              view.image.width_px, view.image.height_px, view.camera.width_px,
                              view.camera.height_px));
    }
  }
  impl.submitted = Clock::now();
  if (!subject.pyramid || subject.pyramid->width_px != width_px || subject.pyramid->height_px != height_px) {
    subject.frames.clear();
    subject.pyramid.reset();
    subject.pyramid.emplace(impl.context, width_px, height_px);
  }
  impl.fit_views(input.further_views);

  // Here first and then over in one go: reading back what was written for the device may be uncached.
  std::vector<vec4>& control = subject.control_written;
  control.resize(subject.control_vertex_count);
  to_shading_frame(*input.control_vertices_mm, input.prior_displacements_mm, input.camera_from_head, control);
  std::ranges::copy(control, subject.control.buffer.mapped_as<vec4>().begin());
  FrameParameters frame{};
  const FaceRegion region = set_frame_parameters(*subject.pyramid, input.camera, control, frame);
  upload_picture(*subject.pyramid, region, input.image, frame);
  if (!input.image_counts) {
    frame.source_px.z = 0;
  }
  impl.write_views(input.further_views, control);
  impl.write_room(input, control);
  frame.keep_displacements = frame.keep_lighting = impl.warm ? 1.0F : 0.0F;
  frame.learn_albedo = 1;
  subject.frame.mapped_as<FrameParameters>().front() = frame;
  const bool learn = impl.learns(impl.frame_count);
  ++impl.frame_count;
  const auto record = [&impl](const StepPlan& plan, bool learning) { return impl.record(plan, learning); };
  try {
    impl.in_flight = &subject.frames.next(impl.warm, learn, input.time_limit_ms, record);
    impl.lost = impl.in_flight->batch->submit() != gpu::Outcome::Done;
  } catch (const gpu::DeviceLostError&) {
    impl.lost = true;  // as if it had gone a moment later: collect says so
  }
  if (!impl.lost) {
    subject.frames.record_ahead(impl.learns(impl.frame_count), !impl.albedo_known, record);
  }
}

std::unique_ptr<gpu::Batch> Refiner::Impl::record(const StepPlan& plan, bool learn) const {
  auto batch = std::make_unique<gpu::Batch>(context, learn ? "frame, albedo learned" : "frame, albedo held",
                                            config.time_kernels ? kMostTimedKernels : gpu::Batch::max_stages);
  kernels.record(*batch, config, *subject, learn, plan);
  return batch;
}

/// Whether the albedo learns from the subject's n-th frame.
bool Refiner::Impl::learns(std::uint64_t frame) const {
  return !albedo_known && (frame < static_cast<std::uint64_t>(std::max(0, config.albedo_frames)) ||
                           frame % kAlbedoRefreshFrames == 0);
}

/// Makes room for the further views where their number or sizes changed.
void Refiner::Impl::fit_views(std::span<const FurtherCamera> views) {
  std::vector<std::unique_ptr<FurtherCameraState>>& there = subject->further_views;
  const bool fit = std::equal(views.begin(), views.end(), there.begin(), there.end(),
                              [](const FurtherCamera& view, const std::unique_ptr<FurtherCameraState>& room) {
                                return view.camera.width_px == room->pyramid.width_px &&
                                       view.camera.height_px == room->pyramid.height_px;
                              });
  if (fit) {
    return;
  }
  subject->frames.clear();
  there.clear();
  for (const FurtherCamera& view : views) {
    there.push_back(std::make_unique<FurtherCameraState>(context, view.camera.width_px, view.camera.height_px,
                                                         subject->triangles));
  }
  if (!subject->view_colours) {
    subject->view_colours.emplace(context, subject->levels.back()->topology.vertex_count,
                                  gpu::TexelFormat::Rgba32f, "view colours");
    clear(context, {&subject->view_colours->buffer});
  }
}

/// control: shading frame of the reference camera, mm.
void Refiner::Impl::write_views(std::span<const FurtherCamera> views, std::span<const vec4> control) const {
  for (std::size_t v = 0; v < views.size(); ++v) {
    FurtherCameraState& room = *subject->further_views[v];
    FrameParameters frame{};
    const FaceRegion region =
        set_frame_parameters(room.pyramid, views[v].camera, control, frame, views[v].view_from_reference);
    upload_picture(room.pyramid, region, views[v].image, frame);
    room.frame.mapped_as<FrameParameters>().front() = frame;
  }
}

/// What the room's lamps give every vertex of M0 in this frame.
void Refiner::Impl::write_room(const RefineInput& input, std::span<const vec4> control) {
  if (!subject->room) {
    return;
  }
  const Eigen::Matrix3f half_turn = Eigen::Vector3f(1, -1, -1).asDiagonal();
  subject->room->look(input.image_counts ? input.image : Frame{}, input.camera, control,
                      half_turn * input.camera_from_head.linear());
  const std::vector<std::int32_t>& host_index = subject->levels.front()->order.host_index;
  const std::span<vec4> out = subject->room_irradiance->buffer.mapped_as<vec4>();
  for (std::size_t i = 0; i < host_index.size(); ++i) {
    out[i] = subject->room->irradiance()[static_cast<std::size_t>(host_index[i])];
  }
}

void Refiner::Impl::clear_output(RefineOutput& output) const {
  const std::size_t count = subject ? subject->levels.back()->topology.vertex_count : 0;
  output.displacements_mm.assign(count, 0.0F);
  output.confidence.assign(count, 0.0F);
  output.lighting = {};
  output.photometric_rms = 0;
  output.energies.clear();
  output.steps.clear();
  output.given_up.clear();
}

void Refiner::Impl::read_albedo() {
  const bool first_frames = frame_count <= static_cast<std::uint64_t>(std::max(0, config.albedo_frames));
  const LevelTopology& learned =
      (config.fine_albedo ? subject->levels.back() : subject->levels.front())->topology;
  const float gained = subject->albedo.gained_in_frame(learned.workgroup_count);
  const bool news = gained > kAlbedoNewsShare * static_cast<float>(learned.vertex_count);
  if (albedo != nullptr && !first_frames && !news) {
    return;
  }
  auto next = std::make_shared<mesh::Albedo>();
  next->version = ++albedo_version;
  const std::span<const vec4> values = subject->albedo_out.mapped_as<vec4>();
  next->linear_rgb.resize(3 * values.size());
  const std::vector<std::int32_t>& host_index = subject->levels.back()->order.host_index;
  for (std::size_t i = 0; i < values.size(); ++i) {
    float* const rgb = next->linear_rgb.data() + 3 * static_cast<std::size_t>(host_index[i]);
    rgb[0] = values[i].x;
    rgb[1] = values[i].y;
    rgb[2] = values[i].z;
  }
  if (skin_albedo.cols() > 0) {
    std::vector<float> counts(values.size());
    for (std::size_t i = 0; i < values.size(); ++i) {
      counts[static_cast<std::size_t>(host_index[i])] = values[i].w;
    }
    take_hue(skin_albedo, counts, next->linear_rgb);
  }
  albedo = std::move(next);
}

/// [level][step] before each step, and after the last where the plan asked for it; empty where a level was
/// interpolated.
std::vector<std::vector<double>> Refiner::Impl::read_energies(const StepPlan& plan) const {
  std::vector<std::vector<double>> out(plan.steps.size());
  for (std::size_t l = 0; l < out.size(); ++l) {
    const int values = plan.steps[l] == 0 ? 0 : plan.steps[l] + (plan.last_energy ? 1 : 0);
    for (int step = 0; step < values; ++step) {
      out[l].push_back(
          subject->scratch.energy(first_energy_slot(config, l) + static_cast<std::uint32_t>(step),
                                  subject->levels[l]->topology.workgroup_count));
    }
  }
  return out;
}

void Refiner::Impl::read(RefineOutput& output) {
  const auto results = subject->results_out.mapped_as<shaders::vec2>();
  output.displacements_mm.resize(results.size());
  output.confidence.resize(results.size());
  for (std::size_t i = 0; i < results.size(); ++i) {
    output.displacements_mm[i] = results[i].x;
    output.confidence[i] = results[i].y;
  }
  const Light light = subject->light_out.mapped_as<Light>().front();
  output.lighting = unpack_light(light);
  if (subject->room) {
    const std::array<float, 9> lamps = subject->room->harmonics();
    for (std::size_t k = 0; k < lamps.size(); ++k) {
      output.lighting[k] += light.room.x * lamps[k];
    }
  }
  double squares = 0;
  double visible = 0;
  const std::uint32_t workgroups = subject->levels.back()->topology.workgroup_count;
  for (const vec4& sum : subject->errors_out.mapped_as<vec4>().first(workgroups)) {
    squares += static_cast<double>(sum.x);
    visible += static_cast<double>(sum.y);
  }
  constexpr double kChannels = 3;
  output.photometric_rms = visible > 0 ? static_cast<float>(std::sqrt(squares / (kChannels * visible))) : 0;
}

RefineOutcome Refiner::collect(RefineOutput& output) {
  Impl& impl = *impl_;
  output.failure.clear();
  if (impl.in_flight == nullptr && !impl.lost) {
    impl.clear_output(output);
    output.failure = "no frame is in flight";
    return RefineOutcome::NumericalFailure;
  }
  const RecordedFrame* const in_flight = std::exchange(impl.in_flight, nullptr);
  if (impl.lost || in_flight->batch->wait() != gpu::Outcome::Done) {
    impl.lost = true;
    output = {};
    output.failure =
        fmt::format("the GPU {} while it refined a frame", impl.context.hung() ? "hung" : "was lost");
    return RefineOutcome::DeviceLost;
  }
  const RecordedFrame& recorded = *in_flight;
  const gpu::Batch& batch = *recorded.batch;
  output.upload_ms = batch.stage_ms("upload");
  output.lighting_ms = batch.stage_ms("lighting");
  output.albedo_ms = batch.stage_ms("albedo");
  output.displacement_ms = batch.stage_ms("displacement");
  output.readback_ms = batch.stage_ms("readback");
  output.recording_ms = impl.subject->frames.recording_ms();

  double failed = 0;
  const std::uint32_t workgroups = impl.subject->levels.back()->topology.workgroup_count;
  for (const vec4& sum : impl.subject->errors_out.mapped_as<vec4>().first(workgroups)) {
    failed += static_cast<double>(sum.z);
  }
  const Light solved = impl.subject->light_out.mapped_as<Light>().front();
  const auto light = unpack_light(solved);
  const bool light_finite = std::isfinite(solved.room.x) &&
                            std::all_of(light.begin(), light.end(), [](float l) { return std::isfinite(l); });
  std::vector<std::vector<double>> energies = impl.read_energies(recorded.plan);
  // A step that did not begin from numbers leaves its level as it was.
  const bool energies_finite = std::all_of(energies.begin(), energies.end(), [](const auto& level) {
    return std::all_of(level.begin(), level.end(), [](double energy) { return std::isfinite(energy); });
  });
  if (failed > 0 || !light_finite || !energies_finite) {
    impl.clear_output(output);
    impl.warm = false;
    output.albedo = impl.albedo;
    output.failure = fmt::format("the solve left finite numbers at {:.0f} vertices{}{}", failed,
                                 light_finite ? "" : ", in the light",
                                 energies_finite ? "" : ", in the energy: the coarse mesh may be broken");
    return RefineOutcome::NumericalFailure;
  }
  impl.read(output);
  if (impl.config.time_kernels) {
    output.kernels.assign(batch.stage_times().begin(), batch.stage_times().end());
  }
  if (recorded.learn) {
    impl.read_albedo();
  }
  output.albedo = impl.albedo;
  output.steps = recorded.plan.steps;
  output.given_up.clear();
  if (plans_frames(impl.config)) {
    const std::chrono::duration<float, std::milli> frame_time = Clock::now() - impl.submitted;
    impl.subject->frames.planner().learn(energies, output.displacement_ms, frame_time.count());
    output.given_up = impl.subject->frames.planner().given_up();
  }
  output.energies.clear();
  if (impl.config.record_energies) {
    output.energies = std::move(energies);
  }
  impl.warm = true;
  return RefineOutcome::Refined;
}

}  // namespace facet::refine
