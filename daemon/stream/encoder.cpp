#include "stream/encoder.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <vector>

#include "facet/assert.hpp"
#include "facet_generated.h"
#include "stream/image_codec.hpp"

namespace facet::stream {
namespace {

using flatbuffers::FlatBufferBuilder;
using flatbuffers::Offset;

constexpr std::size_t kInitialBufferBytes = 1U << 20;
constexpr float kInt16Max = 32767.0F;
/// What a message has for pictures beside the largest mesh that it may hold.
constexpr std::size_t kMaxPixelBytes = kMaxMessageBytes - (16U << 20);

std::span<const std::uint8_t> finish(FlatBufferBuilder& builder, wire::Body type, Offset<void> body) {
  wire::FinishMessageBuffer(builder, wire::CreateMessage(builder, type, body));
  return {builder.GetBufferPointer(), builder.GetSize()};
}

Offset<flatbuffers::String> bounded_string(FlatBufferBuilder& builder, std::string_view text,
                                           std::size_t limit) {
  const std::string_view part = text.substr(0, limit);
  return builder.CreateString(part.data(), part.size());
}

float finite_or_zero(float value) {
  // Comparisons with NaN are false.
  return std::abs(value) <= std::numeric_limits<float>::max() ? value : 0.0F;
}

float largest_magnitude(std::span<const float> values) {
  // Several at a time: the maximum of many is the same in any order, which compilers don't take for granted.
  constexpr std::size_t kLanes = 16;
  std::array<float, kLanes> largest{};
  const auto take = [](float& so_far, float value) {
    const float magnitude = std::abs(value);
    // Comparisons with NaN are false; infinity must not become the scale.
    const float sound = magnitude <= 3.0e38F ? magnitude : 0.0F;
    so_far = sound > so_far ? sound : so_far;
  };
  std::size_t k = 0;
  for (; k + kLanes <= values.size(); k += kLanes) {
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      take(largest[lane], values[k + lane]);
    }
  }
  for (; k < values.size(); ++k) {
    take(largest[0], values[k]);
  }
  return *std::max_element(largest.begin(), largest.end());
}

/// To the nearest, as std::lrint does, but in a way that compilers turn into vector instructions.
std::int16_t to_int16(float scaled) {
  const float nearest = std::rint(std::min(std::max(finite_or_zero(scaled), -kInt16Max), kInt16Max));
  return static_cast<std::int16_t>(static_cast<std::int32_t>(nearest));
}

std::uint8_t to_uint8(float value) {
  const float nearest = std::rint(std::min(std::max(finite_or_zero(value), 0.0F), 1.0F) * 255.0F);
  return static_cast<std::uint8_t>(static_cast<std::int32_t>(nearest));
}

template <typename Derived>
std::span<const float> flat(const Eigen::PlainObjectBase<Derived>& matrix) {
  return {matrix.data(), static_cast<std::size_t>(matrix.size())};
}

/// Indices are non-negative by contract; on the wire they are unsigned.
Offset<flatbuffers::Vector<std::uint32_t>> indices(FlatBufferBuilder& builder,
                                                   std::span<const std::int32_t> values) {
  std::uint32_t* out = nullptr;
  const auto vector = builder.CreateUninitializedVector(values.size(), &out);
  std::transform(values.begin(), values.end(), out,
                 [](std::int32_t value) { return static_cast<std::uint32_t>(value); });
  return vector;
}

Offset<wire::Level> level_message(FlatBufferBuilder& builder, const mesh::Level& level, bool with_stencils) {
  Offset<wire::Stencils> stencils;
  if (with_stencils) {
    const mesh::SparseRows& rows = level.from_coarser;
    const auto offsets = indices(builder, rows.row_offsets);
    const auto columns = indices(builder, rows.columns);
    const auto weights = builder.CreateVector(rows.weights);
    stencils = wire::CreateStencils(builder, offsets, columns, weights);
  }
  const auto triangles =
      indices(builder, {level.triangles.data(), static_cast<std::size_t>(level.triangles.size())});
  return wire::CreateLevel(builder, static_cast<std::uint32_t>(level.vertex_count), triangles, stencils);
}

Offset<wire::Hierarchy> hierarchy_message(FlatBufferBuilder& builder, const mesh::Hierarchy& hierarchy,
                                          Profile profile) {
  const bool whole = profile == Profile::Displacements;
  std::vector<Offset<wire::Level>> levels;
  std::vector<Offset<wire::Level>> coarser;
  for (const mesh::Level& level : hierarchy.levels) {
    std::vector<Offset<wire::Level>>& list = whole || &level == &hierarchy.finest() ? levels : coarser;
    list.push_back(level_message(builder, level, whole));
  }
  const auto level_vector = builder.CreateVector(levels);
  const auto coarser_vector =
      whole ? Offset<flatbuffers::Vector<Offset<wire::Level>>>() : builder.CreateVector(coarser);
  const auto coordinates = builder.CreateVector(
      hierarchy.texture_coordinates.data(), static_cast<std::size_t>(hierarchy.texture_coordinates.size()));
  const auto control_vertex_count =
      whole ? static_cast<std::uint32_t>(hierarchy.control_vertex_count) : std::uint32_t{0};
  return wire::CreateHierarchy(builder, hierarchy.id, control_vertex_count, level_vector, coordinates,
                               coarser_vector);
}

bool all_finite(std::span<const float> values) {
  return std::all_of(values.begin(), values.end(), [](float value) { return std::isfinite(value); });
}

/// Topology, stencils and texture coordinates of a Subject message.
std::size_t topology_bytes(const mesh::Hierarchy& hierarchy) {
  auto words = static_cast<std::size_t>(hierarchy.texture_coordinates.size());
  for (const mesh::Level& level : hierarchy.levels) {
    const mesh::SparseRows& rows = level.from_coarser;
    words += static_cast<std::size_t>(level.triangles.size()) + rows.row_offsets.size() +
             rows.columns.size() + rows.weights.size();
  }
  return sizeof(std::uint32_t) * words;
}

/// Empty where the frame's mesh may be sent; else what is wrong with it.
std::string_view mesh_fault(const mesh::MeshFrame& frame) {
  const mesh::Subject& subject = *frame.subject;
  if (const std::string_view fault = subject_fault(subject); !fault.empty()) {
    return fault;
  }
  const auto finest = static_cast<std::size_t>(subject.hierarchy->finest().vertex_count);
  if (frame.expression.size() != subject.expression_names.size()) {
    return "mesh left out: number of expression weights differs from the subject's";
  }
  if (!frame.model_weights.empty() && frame.model_weights.size() != frame.expression.size()) {
    return "mesh left out: number of the model's weights differs from the subject's";
  }
  if (!frame.expression_confidence.empty() && frame.expression_confidence.size() != frame.expression.size()) {
    return "mesh left out: number of the expression's confidences differs from the subject's";
  }
  if (!frame.avatar_values.empty() && frame.avatar_values.size() != frame.expression.size()) {
    return "mesh left out: number of avatar values differs from the subject's";
  }
  if (!frame.displacements_mm.empty() && frame.displacements_mm.size() != finest) {
    return "mesh left out: number of displacements differs from the finest level's vertices";
  }
  if (!frame.confidence.empty() && frame.confidence.size() != finest) {
    return "mesh left out: number of confidences differs from the finest level's vertices";
  }
  if (!frame.camera_from_head.matrix().allFinite() || !all_finite(frame.expression) ||
      !all_finite(frame.model_weights) || !all_finite(frame.expression_confidence) ||
      !all_finite(frame.avatar_values) || !all_finite(frame.lighting)) {
    return "mesh left out: pose, expression or lighting is not finite";
  }
  return "";
}

bool carries_mesh(const mesh::MeshFrame& frame) {
  return frame.subject != nullptr && frame.subject->hierarchy != nullptr &&
         !frame.subject->hierarchy->levels.empty() && frame.control_vertices_mm.cols() > 0 &&
         frame.control_vertices_mm.cols() == frame.subject->hierarchy->control_vertex_count;
}

wire::Pose pose_struct(const Eigen::Isometry3f& pose) {
  std::array<float, 12> rows{};
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 4; ++column) {
      rows[static_cast<std::size_t>(row * 4 + column)] = pose.matrix()(row, column);
    }
  }
  return wire::Pose(rows);
}

}  // namespace

std::string_view subject_fault(const mesh::Subject& subject) {
  // What a subject's message holds beside the topology: names, identity, regions.
  constexpr std::size_t kRemainderBytes = 1U << 20;
  if (subject.identity.size() > kMaxCoefficients || subject.expression_names.size() > kMaxCoefficients) {
    return "mesh left out: the face model has more than 1024 identity or expression modes, the most that a "
           "message may hold: use a smaller model";
  }
  if (subject.hierarchy == nullptr || subject.hierarchy->levels.empty()) {
    return "";
  }
  const mesh::Hierarchy& hierarchy = *subject.hierarchy;
  if (hierarchy.levels.size() > kMaxLevels || hierarchy.finest().vertex_count > std::int64_t{kMaxVertices} ||
      topology_bytes(hierarchy) + static_cast<std::size_t>(subject.neutral_mm.size()) * sizeof(float) >
          kMaxMessageBytes - kRemainderBytes) {
    return "mesh left out: the mesh has more levels, vertices or bytes than a message may hold (12, 500000, "
           "64 MiB): lower hierarchy.max_vertices or hierarchy.max_levels";
  }
  return "";
}

struct Encoder::Impl {
  FlatBufferBuilder builder{kInitialBufferBytes};
  mesh::Vertices vertices_mm;  ///< [3][finest vertex_count], profile Vertices
  Eigen::Matrix3Xf normals;    ///< [3][finest vertex_count]
  std::uint64_t subject_number = 0;

  /// Where the numbers of the long vectors go: into the message, or beside it for a ring.
  bool beside = false;
  std::array<std::vector<std::int16_t>, FACET_RING_CONFIDENCE> beside_numbers;
  std::vector<std::uint8_t> beside_confidence;

  /// What a frame refers to, made before its table begins.
  struct Parts {
    Offset<flatbuffers::String> degraded_reason;
    Offset<wire::StageTimes> stage_ms;
    Offset<flatbuffers::Vector<const wire::Point*>> landmarks_px;
    Offset<flatbuffers::Vector<float>> expression;
    Offset<flatbuffers::Vector<std::uint8_t>> expression_confidence;
    Offset<flatbuffers::Vector<float>> model_weights;
    Offset<flatbuffers::Vector<float>> avatar_values;
    Offset<wire::FixedPoint> control_vertices;
    Offset<wire::FixedPoint> displacements;
    Offset<wire::FixedPoint> vertices;
    Offset<flatbuffers::Vector<std::int16_t>> normals;
    Offset<flatbuffers::Vector<std::uint8_t>> confidence;
    Offset<wire::FrameSet> frame_set;
  };

  std::uint64_t wire_id(const mesh::Subject& subject) const {
    return subject_number != 0 ? subject_number : subject.id;
  }
  template <typename T>
  Offset<flatbuffers::Vector<T>> place(std::vector<T>& beside_vector, std::size_t count, T** out);
  Offset<flatbuffers::Vector<std::int16_t>> scaled(std::size_t which, std::span<const float> values,
                                                   float scale);
  Offset<wire::FixedPoint> fixed_point(std::size_t which, std::span<const float> values,
                                       float finest_step_mm);
  void geometry_parts(const mesh::MeshFrame& frame, Profile profile, Parts& parts);
  std::span<const std::uint8_t> frame_message(const mesh::MeshFrame& frame, Profile profile,
                                              WantedPixels wanted);
  Offset<wire::StageTimes> stage_times(const mesh::StageTimes& times);
  Offset<flatbuffers::Vector<const wire::Point*>> landmarks(const std::vector<Eigen::Vector2f>& points);
};

Encoder::Encoder() : impl_(std::make_unique<Impl>()) {}
Encoder::~Encoder() = default;

std::span<const std::uint8_t> Encoder::hello(const Hello& hello) {
  FlatBufferBuilder& builder = impl_->builder;
  builder.Clear();
  const auto server = bounded_string(builder, hello.server, kMaxTextBytes);
  std::vector<wire::Profile> profiles;
  profiles.reserve(hello.profiles.size());
  for (const Profile profile : hello.profiles) {
    profiles.push_back(static_cast<wire::Profile>(profile));
  }
  const auto list = builder.CreateVector(profiles);
  const auto body = wire::CreateHello(builder, hello.protocol_version, server, list, hello.max_message_bytes);
  return finish(builder, wire::Body::Hello, body.Union());
}

std::span<const std::uint8_t> Encoder::subscription(const Subscription& subscription) {
  FlatBufferBuilder& builder = impl_->builder;
  builder.Clear();
  const auto client = bounded_string(builder, subscription.client, kMaxNameBytes);
  const auto body = wire::CreateSubscribe(builder, subscription.protocol_version,
                                          static_cast<wire::Profile>(subscription.profile),
                                          subscription.want_albedo, client, subscription.want_images,
                                          subscription.ring_version, subscription.longest_image_px);
  return finish(builder, wire::Body::Subscribe, body.Union());
}

std::span<const std::uint8_t> Encoder::dropped(const Dropped& dropped) {
  FlatBufferBuilder& builder = impl_->builder;
  builder.Clear();
  return finish(builder, wire::Body::Dropped,
                wire::CreateDropped(builder, dropped.since_last, dropped.total).Union());
}

std::span<const std::uint8_t> Encoder::goodbye(std::string_view reason) {
  FlatBufferBuilder& builder = impl_->builder;
  builder.Clear();
  const auto text = bounded_string(builder, reason, kMaxTextBytes);
  return finish(builder, wire::Body::Goodbye, wire::CreateGoodbye(builder, text).Union());
}

std::span<const std::uint8_t> Encoder::ring(const RingOffer& offer) {
  FlatBufferBuilder& builder = impl_->builder;
  builder.Clear();
  return finish(builder, wire::Body::Ring, wire::CreateRing(builder, offer.version, offer.bytes).Union());
}

void Encoder::number_subject(std::uint64_t number) {
  impl_->subject_number = number;
}

std::span<const std::uint8_t> Encoder::subject(const mesh::Subject& subject, Profile profile) {
  FlatBufferBuilder& builder = impl_->builder;
  builder.Clear();
  std::vector<Offset<flatbuffers::String>> names;
  names.reserve(subject.expression_names.size());
  for (const std::string& name : subject.expression_names) {
    names.push_back(bounded_string(builder, name, kMaxNameBytes));
  }
  const auto name_vector = builder.CreateVector(names);
  const auto identity = builder.CreateVector(subject.identity);
  Offset<flatbuffers::Vector<std::uint8_t>> regions;
  if (profile == Profile::Displacements) {
    regions = builder.CreateVector(subject.regions);
  }
  Offset<wire::Hierarchy> hierarchy;
  if (profile != Profile::Signals && subject.hierarchy != nullptr) {
    hierarchy = hierarchy_message(builder, *subject.hierarchy, profile);
  }
  Offset<flatbuffers::String> person;
  if (!subject.person.empty()) {
    person = bounded_string(builder, subject.person, kMaxNameBytes);
  }
  Offset<flatbuffers::Vector<float>> neutral;
  if (profile == Profile::Displacements && subject.neutral_mm.size() > 0) {
    neutral =
        builder.CreateVector(subject.neutral_mm.data(), static_cast<std::size_t>(subject.neutral_mm.size()));
  }
  const auto body = wire::CreateSubject(builder, impl_->wire_id(subject), name_vector, identity, regions,
                                        hierarchy, person, neutral);
  return finish(builder, wire::Body::Subject, body.Union());
}

std::span<const std::uint8_t> Encoder::albedo(std::uint64_t subject_id, const mesh::Albedo& albedo) {
  FlatBufferBuilder& builder = impl_->builder;
  builder.Clear();
  constexpr float kUint16Max = 65535.0F;
  const float scale = std::max(1.0F, largest_magnitude(albedo.linear_rgb));
  std::uint16_t* out = nullptr;
  const auto values = builder.CreateUninitializedVector(albedo.linear_rgb.size(), &out);
  std::transform(albedo.linear_rgb.begin(), albedo.linear_rgb.end(), out, [&](float value) {
    return static_cast<std::uint16_t>(
        std::lrint(std::clamp(finite_or_zero(value) / scale, 0.0F, 1.0F) * kUint16Max));
  });
  const auto body = wire::CreateAlbedo(builder, subject_id, albedo.version, scale, values);
  return finish(builder, wire::Body::Albedo, body.Union());
}

Offset<wire::StageTimes> Encoder::Impl::stage_times(const mesh::StageTimes& times) {
  return wire::CreateStageTimes(builder, finite_or_zero(times.capture_ms), finite_or_zero(times.detect_ms),
                                finite_or_zero(times.landmarks_ms), finite_or_zero(times.fit_ms),
                                finite_or_zero(times.upload_ms), finite_or_zero(times.lighting_ms),
                                finite_or_zero(times.albedo_ms), finite_or_zero(times.displacement_ms),
                                finite_or_zero(times.readback_ms), finite_or_zero(times.latency_ms),
                                finite_or_zero(times.depth_ms));
}

Offset<flatbuffers::Vector<const wire::Point*>> Encoder::Impl::landmarks(
    const std::vector<Eigen::Vector2f>& points) {
  if (points.empty()) {
    return {};
  }
  wire::Point* out = nullptr;
  const auto vector =
      builder.CreateUninitializedVectorOfStructs(std::min<std::size_t>(points.size(), kMaxLandmarks), &out);
  for (std::size_t i = 0; i < std::min<std::size_t>(points.size(), kMaxLandmarks); ++i) {
    out[i] = wire::Point(finite_or_zero(points[i].x()), finite_or_zero(points[i].y()));
  }
  return vector;
}

/// Room for `count` numbers; the vector is null where they lie beside the message.
template <typename T>
Offset<flatbuffers::Vector<T>> Encoder::Impl::place(std::vector<T>& beside_vector, std::size_t count,
                                                    T** out) {
  if (beside) {
    beside_vector.resize(count);
    *out = beside_vector.data();
    return {};
  }
  return builder.CreateUninitializedVector(count, out);
}

Offset<flatbuffers::Vector<std::int16_t>> Encoder::Impl::scaled(std::size_t which,
                                                                std::span<const float> values, float scale) {
  std::int16_t* out = nullptr;
  const auto vector = place(beside_numbers.at(which), values.size(), &out);
  std::transform(values.begin(), values.end(), out, [scale](float value) { return to_int16(value * scale); });
  return vector;
}

Offset<wire::FixedPoint> Encoder::Impl::fixed_point(std::size_t which, std::span<const float> values,
                                                    float finest_step_mm) {
  const float step_mm = std::clamp(largest_magnitude(values) / kInt16Max, finest_step_mm, kMaxStepMm);
  const auto vector = scaled(which, values, 1.0F / step_mm);
  return wire::CreateFixedPoint(builder, step_mm, vector);
}

void Encoder::Impl::geometry_parts(const mesh::MeshFrame& frame, Profile profile, Parts& parts) {
  parts.expression = builder.CreateVector(frame.expression);
  if (!frame.expression_confidence.empty()) {
    std::uint8_t* bytes = nullptr;
    parts.expression_confidence =
        builder.CreateUninitializedVector(frame.expression_confidence.size(), &bytes);
    std::transform(frame.expression_confidence.begin(), frame.expression_confidence.end(), bytes, to_uint8);
  }
  if (!frame.avatar_values.empty()) {
    parts.avatar_values = builder.CreateVector(frame.avatar_values);
  }
  if (profile == Profile::Displacements && !frame.model_weights.empty()) {
    parts.model_weights = builder.CreateVector(frame.model_weights);
  }
  if (profile == Profile::Signals) {
    return;
  }
  if (!frame.confidence.empty()) {
    std::uint8_t* out = nullptr;
    parts.confidence = place(beside_confidence, frame.confidence.size(), &out);
    std::transform(frame.confidence.begin(), frame.confidence.end(), out, to_uint8);
  }
  if (profile == Profile::Displacements) {
    parts.control_vertices =
        fixed_point(FACET_RING_CONTROL_VERTICES, flat(frame.control_vertices_mm), kPositionStepMm);
    FACET_ASSERT(frame.control_vertices_mm.cols() == frame.subject->hierarchy->control_vertex_count,
                 frame.control_vertices_mm.cols());
    if (!frame.displacements_mm.empty()) {
      parts.displacements =
          fixed_point(FACET_RING_DISPLACEMENTS, frame.displacements_mm, kDisplacementStepMm);
    }
    return;
  }
  mesh::rebuild_finest(*frame.subject->hierarchy, frame.control_vertices_mm, frame.displacements_mm,
                       vertices_mm, normals);
  FACET_ASSERT(vertices_mm.cols() == normals.cols() &&
                   vertices_mm.cols() == frame.subject->hierarchy->finest().vertex_count,
               vertices_mm.cols(), normals.cols());
  parts.vertices = fixed_point(FACET_RING_VERTICES, flat(vertices_mm), kPositionStepMm);
  parts.normals = scaled(FACET_RING_NORMALS, flat(normals), kInt16Max);
}

std::span<const std::uint8_t> Encoder::frame(const mesh::MeshFrame& frame, Profile profile,
                                             const WantedPixels& wanted) {
  impl_->beside = false;
  return impl_->frame_message(frame, profile, wanted);
}

RingFrame Encoder::ring_frame(const mesh::MeshFrame& frame, Profile profile) {
  for (auto& numbers : impl_->beside_numbers) {
    numbers.clear();
  }
  impl_->beside_confidence.clear();
  impl_->beside = true;
  RingFrame out;
  out.head = impl_->frame_message(frame, profile, {});
  for (std::size_t which = 0; which < impl_->beside_numbers.size(); ++which) {
    const std::vector<std::int16_t>& numbers = impl_->beside_numbers.at(which);
    out.arrays.at(which) = {reinterpret_cast<const std::uint8_t*>(numbers.data()),
                            numbers.size() * sizeof(std::int16_t)};
  }
  out.arrays[FACET_RING_CONFIDENCE] = impl_->beside_confidence;
  return out;
}

std::span<const std::uint8_t> Encoder::Impl::frame_message(const mesh::MeshFrame& frame, Profile profile,
                                                           WantedPixels wanted) {
  builder.Clear();
  bool with_mesh = carries_mesh(frame);
  bool degraded = frame.degraded;
  std::string_view degraded_reason = frame.degraded_reason;
  if (with_mesh) {
    if (const std::string_view fault = mesh_fault(frame); !fault.empty()) {
      with_mesh = false;
      degraded = true;
      degraded_reason = fault;
    }
  }
  if (frame.images != nullptr && pixel_bytes(*frame.images, wanted) > kMaxPixelBytes) {
    wanted.any = false;
    degraded = true;
    degraded_reason =
        "pictures left out: together they are larger than a message may be (64 MiB): use smaller pictures";
  }

  Parts parts;
  parts.degraded_reason = bounded_string(builder, degraded_reason, kMaxTextBytes);
  parts.stage_ms = stage_times(frame.stage_ms);
  parts.landmarks_px = landmarks(frame.landmarks_px);
  if (with_mesh) {
    geometry_parts(frame, profile, parts);
  }
  if (frame.images != nullptr && !frame.images->frames.empty()) {
    parts.frame_set = write_frame_set(builder, *frame.images, wanted);
  }

  const CameraIntrinsics& intrinsics = frame.camera;
  const wire::Camera camera(finite_or_zero(intrinsics.fx), finite_or_zero(intrinsics.fy),
                            finite_or_zero(intrinsics.cx), finite_or_zero(intrinsics.cy), intrinsics.width_px,
                            intrinsics.height_px);
  const wire::Pose pose = pose_struct(frame.camera_from_head);
  const wire::Lighting lighting{std::span<const float, 9>(frame.lighting)};
  wire::FrameBuilder table(builder);
  table.add_sequence(frame.sequence);
  table.add_timestamp_ns(frame.timestamp_ns);
  table.add_media_time_ns(frame.media_time_ns);
  table.add_state(static_cast<wire::TrackingState>(frame.state));
  table.add_degraded(degraded);
  table.add_degraded_reason(parts.degraded_reason);
  table.add_camera(&camera);
  table.add_stage_ms(parts.stage_ms);
  table.add_landmarks_px(parts.landmarks_px);
  table.add_reprojection_px(finite_or_zero(frame.reprojection_px));
  if (with_mesh) {
    table.add_subject_id(wire_id(*frame.subject));
    table.add_camera_from_head(&pose);
    table.add_expression(parts.expression);
    table.add_model_weights(parts.model_weights);
    table.add_expression_confidence(parts.expression_confidence);
    table.add_avatar_values(parts.avatar_values);
    table.add_photometric_rms(finite_or_zero(frame.photometric_rms));
    table.add_lighting(&lighting);
    table.add_albedo_version(frame.albedo != nullptr ? frame.albedo->version : 0);
    table.add_control_vertices(parts.control_vertices);
    table.add_displacements(parts.displacements);
    table.add_vertices(parts.vertices);
    table.add_normals(parts.normals);
    table.add_confidence(parts.confidence);
  }
  table.add_frame_set(parts.frame_set);
  table.add_origin(static_cast<wire::Origin>(frame.origin));
  return finish(builder, wire::Body::Frame, table.Finish().Union());
}

}  // namespace facet::stream
