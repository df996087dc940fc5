#include "stream/decoder.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include "facet/error.hpp"
#include "facet_generated.h"
#include "stream/image_codec.hpp"

namespace facet::stream {
namespace {

template <typename T>
using WireVector = flatbuffers::Vector<T>;

// Depth and number of tables of a genuine message: Message > Body > Hierarchy > Level > Stencils.
constexpr flatbuffers::uoffset_t kMaxDepth = 8;
constexpr flatbuffers::uoffset_t kMaxTables = kMaxCameras + 16;

[[noreturn]] void reject(const char* what) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("damaged or foreign message: {}", what));
}

void require(bool holds, const char* what) {
  if (!holds) {
    reject(what);
  }
}

const wire::Message& verified(std::span<const std::uint8_t> message) {
  require(message.size() <= kMaxMessageBytes, "longer than the protocol allows");
  require(message.size() >= 2 * sizeof(flatbuffers::uoffset_t) + flatbuffers::kFileIdentifierLength,
          "too short");
  require(wire::MessageBufferHasIdentifier(message.data()), "identifier is not FCT1");
  flatbuffers::Verifier verifier(message.data(), message.size(), kMaxDepth, kMaxTables);
  require(wire::VerifyMessageBuffer(verifier), "structure is broken");
  return *wire::GetMessage(message.data());
}

template <typename Table>
const Table& body_of(std::span<const std::uint8_t> message, const char* expected) {
  const Table* body = verified(message).body_as<Table>();
  require(body != nullptr, expected);
  return *body;
}

std::string text(const flatbuffers::String* string, std::size_t limit, const char* what) {
  if (string == nullptr) {
    return {};
  }
  require(string->size() <= limit, what);
  return string->str();
}

template <typename T>
std::size_t size_of(const WireVector<T>* vector) {
  return vector == nullptr ? 0 : vector->size();
}

bool all_finite(const WireVector<float>* values) {
  return values == nullptr ||
         std::all_of(values->begin(), values->end(), [](float value) { return std::isfinite(value); });
}

std::vector<float> floats(const WireVector<float>* values) {
  return values == nullptr ? std::vector<float>{} : std::vector<float>(values->begin(), values->end());
}

/// Values below `end`, as signed indices.
void copy_indices(const WireVector<std::uint32_t>& values, std::uint32_t end, std::int32_t* out,
                  const char* what) {
  for (const std::uint32_t value : values) {
    require(value < end, what);
    *out++ = static_cast<std::int32_t>(value);
  }
}

mesh::SparseRows decode_stencils(const wire::Stencils* stencils, std::uint32_t rows, std::uint32_t columns) {
  require(stencils != nullptr && stencils->row_offsets() != nullptr && stencils->columns() != nullptr &&
              stencils->weights() != nullptr,
          "a level has no stencils");
  const auto& offsets = *stencils->row_offsets();
  const auto& weights = *stencils->weights();
  const std::size_t entries = stencils->columns()->size();
  require(offsets.size() == rows + 1U, "stencils: number of rows differs from the level's vertices");
  require(entries <= std::size_t{kMaxStencilEntriesPerRow} * rows, "stencils: too many entries");
  require(weights.size() == entries, "stencils: numbers of columns and weights differ");
  require(
      offsets.Get(0) == 0 && offsets.Get(rows) == entries && std::is_sorted(offsets.begin(), offsets.end()),
      "stencils: row offsets do not grow from 0 to the number of entries");

  mesh::SparseRows out;
  out.row_offsets.resize(offsets.size());
  out.columns.resize(entries);
  copy_indices(offsets, static_cast<std::uint32_t>(entries) + 1U, out.row_offsets.data(), "stencils: offset");
  copy_indices(*stencils->columns(), columns, out.columns.data(), "stencils: column out of range");
  out.weights.assign(weights.begin(), weights.end());
  constexpr float kRowSumTolerance = 1e-3F;  // 4-8 masks are multiples of 1/64; float sums of a few entries
  for (std::uint32_t row = 0; row < rows; ++row) {
    float sum = 0;
    for (std::uint32_t entry = offsets.Get(row); entry < offsets.Get(row + 1); ++entry) {
      sum += out.weights[entry];
    }
    // Written so that NaN fails.
    require(std::abs(sum - 1.0F) <= kRowSumTolerance, "stencils: weights of a row do not sum to 1");
  }
  return out;
}

mesh::Level decode_level(const wire::Level& level, bool with_stencils, std::uint32_t coarser_vertex_count) {
  require(level.vertex_count() > 0 && level.vertex_count() <= kMaxVertices, "level: vertex count");
  require(level.triangles() != nullptr && level.triangles()->size() % 3 == 0 &&
              level.triangles()->size() / 3 <= kMaxTriangles,
          "level: triangle count");
  mesh::Level out;
  out.vertex_count = static_cast<std::int32_t>(level.vertex_count());
  out.triangles.resize(3, static_cast<Eigen::Index>(level.triangles()->size() / 3));
  copy_indices(*level.triangles(), level.vertex_count(), out.triangles.data(),
               "level: triangle names a vertex that is not there");
  if (with_stencils) {
    out.from_coarser = decode_stencils(level.from_coarser(), level.vertex_count(), coarser_vertex_count);
  }
  out.one_rings = mesh::build_one_rings(out.triangles, out.vertex_count);
  return out;
}

std::shared_ptr<const mesh::Hierarchy> decode_hierarchy(const wire::Hierarchy& hierarchy) {
  require(hierarchy.id() != 0, "hierarchy: id is 0");
  require(hierarchy.control_vertex_count() <= kMaxVertices, "hierarchy: control vertex count");
  require(size_of(hierarchy.levels()) >= 1 && hierarchy.levels()->size() <= kMaxLevels,
          "hierarchy: number of levels");
  const bool with_stencils = hierarchy.control_vertex_count() > 0;
  require(with_stencils || hierarchy.levels()->size() == 1,
          "hierarchy: several levels without control vertices");

  auto out = std::make_shared<mesh::Hierarchy>();
  out->id = hierarchy.id();
  out->control_vertex_count = static_cast<std::int32_t>(hierarchy.control_vertex_count());
  std::uint32_t coarser = hierarchy.control_vertex_count();
  for (const wire::Level* level : *hierarchy.levels()) {
    require(out->levels.empty() || level->vertex_count() >= coarser, "hierarchy: a finer level is smaller");
    out->levels.push_back(decode_level(*level, with_stencils, coarser));
    coarser = level->vertex_count();
  }
  const WireVector<float>* coordinates = hierarchy.texture_coordinates();
  require(size_of(coordinates) == std::size_t{2} * coarser && all_finite(coordinates),
          "hierarchy: texture coordinates");
  out->texture_coordinates =
      Eigen::Map<const mesh::TextureCoordinates>(coordinates->data(), 2, static_cast<Eigen::Index>(coarser));
  return out;
}

bool good_step(float step_mm) {
  // One part in a thousand above the limit, for the writer's rounding.
  return step_mm > 0.0F && step_mm <= kMaxStepMm * 1.001F;
}

/// Numbers of a message, or of a ring's slot.
template <typename T>
struct Numbers {
  const WireVector<T>* in_message = nullptr;
  RingArray in_ring;

  bool absent() const { return in_message == nullptr && in_ring.data == nullptr; }
  std::size_t size() const { return size_of(in_message) + in_ring.count; }
  /// out must have size() places.
  void scaled_by(float step, float* out) const {
    if (in_message != nullptr) {
      std::transform(in_message->begin(), in_message->end(), out,
                     [step](T value) { return static_cast<float>(value) * step; });
    }
    for_each_number<T>(in_ring, [=](std::size_t k, T value) { out[k] = static_cast<float>(value) * step; });
  }
};

/// The long arrays of a frame, wherever they lie.
struct Arrays {
  Arrays(const wire::Frame& frame, const RingReader* ring) {
    if (ring != nullptr) {
      control_vertices.in_ring = ring->array(FACET_RING_CONTROL_VERTICES);
      displacements.in_ring = ring->array(FACET_RING_DISPLACEMENTS);
      vertices.in_ring = ring->array(FACET_RING_VERTICES);
      normals.in_ring = ring->array(FACET_RING_NORMALS);
      confidence.in_ring = ring->array(FACET_RING_CONFIDENCE);
      return;
    }
    const auto values = [](const wire::FixedPoint* in) { return in == nullptr ? nullptr : in->values(); };
    control_vertices.in_message = values(frame.control_vertices());
    displacements.in_message = values(frame.displacements());
    vertices.in_message = values(frame.vertices());
    normals.in_message = frame.normals();
    confidence.in_message = frame.confidence();
  }

  Numbers<std::int16_t> control_vertices;
  Numbers<std::int16_t> displacements;
  Numbers<std::int16_t> vertices;
  Numbers<std::int16_t> normals;
  Numbers<std::uint8_t> confidence;
};

/// out has `count` places.
void decode_fixed_point(const wire::FixedPoint* table, const Numbers<std::int16_t>& values, std::size_t count,
                        float* out, const char* what) {
  require(table != nullptr && values.size() == count && good_step(table->step_mm()), what);
  values.scaled_by(table->step_mm(), out);
}

Eigen::Isometry3f decode_pose(const wire::Pose* pose) {
  require(pose != nullptr, "frame: mesh without pose");
  Eigen::Isometry3f out = Eigen::Isometry3f::Identity();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 4; ++column) {
      out.matrix()(row, column) = pose->row_major()->Get(static_cast<std::uint16_t>(row * 4 + column));
    }
  }
  constexpr float kRotationTolerance = 1e-2F;  // float products over a long chain of poses
  const Eigen::Matrix3f gram = out.linear().transpose() * out.linear();
  require(out.matrix().allFinite() &&
              (gram - Eigen::Matrix3f::Identity()).cwiseAbs().maxCoeff() < kRotationTolerance &&
              out.linear().determinant() > 0,
          "frame: pose is not a rotation and a translation");
  return out;
}

mesh::StageTimes decode_stage_times(const wire::StageTimes* times) {
  mesh::StageTimes out;
  if (times == nullptr) {
    return out;
  }
  const std::pair<float*, float> fields[] = {
      {&out.capture_ms, times->capture_ms()},     {&out.detect_ms, times->detect_ms()},
      {&out.landmarks_ms, times->landmarks_ms()}, {&out.fit_ms, times->fit_ms()},
      {&out.upload_ms, times->upload_ms()},       {&out.lighting_ms, times->lighting_ms()},
      {&out.albedo_ms, times->albedo_ms()},       {&out.displacement_ms, times->displacement_ms()},
      {&out.readback_ms, times->readback_ms()},   {&out.latency_ms, times->latency_ms()},
      {&out.depth_ms, times->depth_ms()}};
  for (const auto& [field, value] : fields) {
    require(std::isfinite(value), "frame: stage times");
    *field = value;
  }
  return out;
}

CameraIntrinsics decode_camera(const wire::Camera* camera) {
  CameraIntrinsics out;
  if (camera == nullptr) {
    return out;
  }
  constexpr std::int32_t kMaxSidePx = 65536;
  require(std::isfinite(camera->fx()) && std::isfinite(camera->fy()) && std::isfinite(camera->cx()) &&
              std::isfinite(camera->cy()) && camera->width_px() >= 0 && camera->width_px() <= kMaxSidePx &&
              camera->height_px() >= 0 && camera->height_px() <= kMaxSidePx,
          "frame: camera");
  return {camera->fx(), camera->fy(), camera->cx(), camera->cy(), camera->width_px(), camera->height_px()};
}

void decode_geometry(const wire::Frame& in, const Arrays& arrays, DecodedFrame& out) {
  const mesh::Subject& subject = *out.frame.subject;
  if (subject.hierarchy == nullptr) {
    require(in.control_vertices() == nullptr && in.vertices() == nullptr && in.displacements() == nullptr &&
                arrays.confidence.absent(),
            "frame: geometry for a subject without topology");
    return;
  }
  const auto finest = static_cast<std::size_t>(subject.hierarchy->finest().vertex_count);
  const auto control = static_cast<std::size_t>(subject.hierarchy->control_vertex_count);
  if (control > 0) {
    out.frame.control_vertices_mm.resize(3, static_cast<Eigen::Index>(control));
    decode_fixed_point(in.control_vertices(), arrays.control_vertices, 3 * control,
                       out.frame.control_vertices_mm.data(), "frame: control vertices");
    if (in.displacements() != nullptr) {
      out.frame.displacements_mm.resize(finest);
      decode_fixed_point(in.displacements(), arrays.displacements, finest, out.frame.displacements_mm.data(),
                         "frame: displacements");
    }
  } else {
    out.vertices_mm.resize(3, static_cast<Eigen::Index>(finest));
    decode_fixed_point(in.vertices(), arrays.vertices, 3 * finest, out.vertices_mm.data(), "frame: vertices");
    require(arrays.normals.size() == 3 * finest, "frame: normals");
    out.normals.resize(3, static_cast<Eigen::Index>(finest));
    arrays.normals.scaled_by(1.0F / 32767.0F, out.normals.data());
  }
  if (!arrays.confidence.absent()) {
    require(arrays.confidence.size() == finest, "frame: confidence");
    out.frame.confidence.resize(finest);
    arrays.confidence.scaled_by(1.0F / 255.0F, out.frame.confidence.data());
  }
}

void decode_mesh_part(const wire::Frame& in, const Arrays& arrays, DecodedFrame& out) {
  mesh::MeshFrame& frame = out.frame;
  frame.camera_from_head = decode_pose(in.camera_from_head());
  require(size_of(in.expression()) == frame.subject->expression_names.size() && all_finite(in.expression()),
          "frame: expression");
  frame.expression = floats(in.expression());
  if (const auto* confidence = in.expression_confidence()) {
    require(confidence->size() == frame.expression.size(), "frame: confidence of the expression");
    frame.expression_confidence.resize(confidence->size());
    std::transform(confidence->begin(), confidence->end(), frame.expression_confidence.begin(),
                   [](std::uint8_t byte) { return static_cast<float>(byte) / 255; });
  }
  if (in.model_weights() != nullptr) {
    require(size_of(in.model_weights()) == frame.expression.size() && all_finite(in.model_weights()),
            "frame: weights of the model");
    frame.model_weights = floats(in.model_weights());
  }
  if (in.avatar_values() != nullptr) {
    require(size_of(in.avatar_values()) == frame.expression.size() && all_finite(in.avatar_values()),
            "frame: avatar values");
    frame.avatar_values = floats(in.avatar_values());
  }
  require(in.lighting() != nullptr, "frame: mesh without lighting");
  for (std::uint16_t i = 0; i < 9; ++i) {
    frame.lighting[i] = in.lighting()->sh()->Get(i);
    require(std::isfinite(frame.lighting[i]), "frame: lighting");
  }
  require(std::isfinite(in.photometric_rms()), "frame: photometric rms");
  frame.photometric_rms = in.photometric_rms();
  decode_geometry(in, arrays, out);
}

void decode_whole_frame(const wire::Frame& body, const RingReader* ring,
                        std::shared_ptr<const mesh::Subject> subject,
                        std::shared_ptr<const mesh::Albedo> albedo, DecodedFrame& out) {
  require(static_cast<std::uint8_t>(body.state()) <= static_cast<std::uint8_t>(mesh::TrackingState::Lost),
          "frame: unknown tracking state");
  require(static_cast<std::uint8_t>(body.origin()) <= static_cast<std::uint8_t>(mesh::Origin::Pose),
          "frame: unknown origin");
  require(size_of(body.landmarks_px()) <= kMaxLandmarks, "frame: number of landmarks");
  require(std::isfinite(body.reprojection_px()), "frame: reprojection");

  DecodedFrame decoded;
  mesh::MeshFrame& frame = decoded.frame;
  frame.sequence = body.sequence();
  frame.timestamp_ns = body.timestamp_ns();
  frame.media_time_ns = body.media_time_ns();
  frame.state = static_cast<mesh::TrackingState>(body.state());
  frame.degraded = body.degraded();
  frame.degraded_reason = text(body.degraded_reason(), kMaxTextBytes, "frame: degraded reason");
  frame.origin = static_cast<mesh::Origin>(body.origin());
  frame.camera = decode_camera(body.camera());
  frame.stage_ms = decode_stage_times(body.stage_ms());
  frame.reprojection_px = body.reprojection_px();
  if (body.landmarks_px() != nullptr) {
    frame.landmarks_px.reserve(body.landmarks_px()->size());
    for (const wire::Point* point : *body.landmarks_px()) {
      require(std::isfinite(point->x_px()) && std::isfinite(point->y_px()), "frame: landmark");
      frame.landmarks_px.emplace_back(point->x_px(), point->y_px());
    }
  }
  if (body.subject_id() != 0) {
    require(subject != nullptr && subject->id == body.subject_id(), "frame: its subject was not sent");
    frame.subject = std::move(subject);
    if (albedo != nullptr && body.albedo_version() != 0 && frame.subject->hierarchy != nullptr) {
      require(albedo->version == body.albedo_version(), "frame: albedo of another version");
      require(albedo->linear_rgb.size() ==
                  std::size_t{3} * static_cast<std::size_t>(frame.subject->hierarchy->finest().vertex_count),
              "albedo: number of values differs from the finest level's vertices");
      frame.albedo = std::move(albedo);
    }
    decode_mesh_part(body, Arrays(body, ring), decoded);
  }
  if (body.frame_set() != nullptr) {
    frame.images = read_frame_set(*body.frame_set(), frame.media_time_ns);
  }
  out = std::move(decoded);
}

}  // namespace

const char* to_string(MessageType type) {
  switch (type) {
    case MessageType::Hello:
      return "hello";
    case MessageType::Subscribe:
      return "subscribe";
    case MessageType::Dropped:
      return "dropped";
    case MessageType::Goodbye:
      return "goodbye";
    case MessageType::Subject:
      return "subject";
    case MessageType::Albedo:
      return "albedo";
    case MessageType::Frame:
      return "frame";
    case MessageType::Ring:
      return "ring";
    case MessageType::Unknown:
      break;
  }
  return "unknown";
}

MessageType message_type(std::span<const std::uint8_t> message) {
  switch (verified(message).body_type()) {
    case wire::Body::Hello:
      return MessageType::Hello;
    case wire::Body::Subscribe:
      return MessageType::Subscribe;
    case wire::Body::Dropped:
      return MessageType::Dropped;
    case wire::Body::Goodbye:
      return MessageType::Goodbye;
    case wire::Body::Subject:
      return MessageType::Subject;
    case wire::Body::Albedo:
      return MessageType::Albedo;
    case wire::Body::Frame:
      return MessageType::Frame;
    case wire::Body::Ring:
      return MessageType::Ring;
    case wire::Body::NONE:
      reject("no body");
  }
  return MessageType::Unknown;
}

Hello decode_hello(std::span<const std::uint8_t> message) {
  const auto& body = body_of<wire::Hello>(message, "not a hello");
  Hello out;
  out.protocol_version = body.protocol_version();
  out.server = text(body.server(), kMaxTextBytes, "hello: server");
  out.max_message_bytes = body.max_message_bytes();
  out.profiles.clear();
  require(size_of(body.profiles()) <= 32, "hello: profiles");
  for (std::size_t i = 0; i < size_of(body.profiles()); ++i) {
    // A newer server may offer profiles that are unknown here.
    const auto profile =
        static_cast<std::uint8_t>(body.profiles()->Get(static_cast<flatbuffers::uoffset_t>(i)));
    if (profile < kProfileCount) {
      out.profiles.push_back(static_cast<Profile>(profile));
    }
  }
  return out;
}

Subscription decode_subscription(std::span<const std::uint8_t> message) {
  const auto& body = body_of<wire::Subscribe>(message, "not a subscription");
  require(static_cast<std::uint8_t>(body.profile()) < kProfileCount, "subscription: unknown profile");
  Subscription out;
  out.protocol_version = body.protocol_version();
  out.profile = static_cast<Profile>(body.profile());
  out.want_albedo = body.want_albedo();
  out.client = text(body.client(), kMaxNameBytes, "subscription: client");
  out.want_images = body.want_images();
  out.ring_version = body.ring_version();
  out.longest_image_px = body.longest_image_px();
  return out;
}

Dropped decode_dropped(std::span<const std::uint8_t> message) {
  const auto& body = body_of<wire::Dropped>(message, "not a drop notice");
  return {body.since_last(), body.total()};
}

std::string decode_goodbye(std::span<const std::uint8_t> message) {
  return text(body_of<wire::Goodbye>(message, "not a goodbye").reason(), kMaxTextBytes, "goodbye: reason");
}

RingOffer decode_ring(std::span<const std::uint8_t> message) {
  const auto& body = body_of<wire::Ring>(message, "not a ring");
  return {body.version(), body.bytes()};
}

std::shared_ptr<const mesh::Subject> decode_subject(std::span<const std::uint8_t> message) {
  const auto& body = body_of<wire::Subject>(message, "not a subject");
  require(body.id() != 0, "subject: id is 0");
  require(size_of(body.expression_names()) <= kMaxCoefficients, "subject: number of expressions");
  require(size_of(body.identity()) <= kMaxCoefficients && all_finite(body.identity()), "subject: identity");
  auto out = std::make_shared<mesh::Subject>();
  out->id = body.id();
  if (body.expression_names() != nullptr) {
    for (const flatbuffers::String* name : *body.expression_names()) {
      out->expression_names.push_back(text(name, kMaxNameBytes, "subject: expression name"));
    }
  }
  out->identity = floats(body.identity());
  out->person = text(body.person(), kMaxNameBytes, "subject: person");
  if (body.hierarchy() != nullptr) {
    out->hierarchy = decode_hierarchy(*body.hierarchy());
    const auto control = static_cast<std::size_t>(out->hierarchy->control_vertex_count);
    require(size_of(body.regions()) == control || size_of(body.regions()) == 0, "subject: regions");
    if (body.regions() != nullptr) {
      out->regions.assign(body.regions()->begin(), body.regions()->end());
    }
    require((size_of(body.neutral_mm()) == 3 * control || size_of(body.neutral_mm()) == 0) &&
                all_finite(body.neutral_mm()),
            "subject: neutral");
    if (size_of(body.neutral_mm()) > 0) {
      out->neutral_mm =
          Eigen::Map<const mesh::Vertices>(body.neutral_mm()->data(), 3, static_cast<Eigen::Index>(control));
    }
  }
  return out;
}

DecodedAlbedo decode_albedo(std::span<const std::uint8_t> message) {
  const auto& body = body_of<wire::Albedo>(message, "not an albedo");
  require(body.subject_id() != 0 && body.version() != 0, "albedo: id or version is 0");
  require(std::isfinite(body.scale()) && body.scale() > 0, "albedo: scale");
  require(size_of(body.linear_rgb()) % 3 == 0 && size_of(body.linear_rgb()) <= std::size_t{3} * kMaxVertices,
          "albedo: number of values");
  auto albedo = std::make_shared<mesh::Albedo>();
  albedo->version = body.version();
  albedo->linear_rgb.resize(size_of(body.linear_rgb()));
  if (body.linear_rgb() != nullptr) {
    const float unit = body.scale() / 65535.0F;
    std::transform(body.linear_rgb()->begin(), body.linear_rgb()->end(), albedo->linear_rgb.begin(),
                   [&](std::uint16_t value) { return static_cast<float>(value) * unit; });
  }
  return {body.subject_id(), std::move(albedo)};
}

FrameReferences frame_references(std::span<const std::uint8_t> message) {
  const auto& body = body_of<wire::Frame>(message, "not a frame");
  return {body.subject_id(), body.subject_id() == 0 ? 0 : body.albedo_version()};
}

void decode_frame(std::span<const std::uint8_t> message, std::shared_ptr<const mesh::Subject> subject,
                  std::shared_ptr<const mesh::Albedo> albedo, DecodedFrame& out) {
  decode_whole_frame(body_of<wire::Frame>(message, "not a frame"), nullptr, std::move(subject),
                     std::move(albedo), out);
}

void decode_frame(const RingReader& ring, std::shared_ptr<const mesh::Subject> subject,
                  std::shared_ptr<const mesh::Albedo> albedo, DecodedFrame& out) {
  decode_whole_frame(body_of<wire::Frame>(ring.head(), "not a frame"), &ring, std::move(subject),
                     std::move(albedo), out);
}

}  // namespace facet::stream
