#include "wire.h"

#include <math.h>
#include <string.h>

#if !defined(__BYTE_ORDER__) || __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "numbers are read as they lie in memory: little-endian machines only"
#endif

/* FlatBuffers, as far as these messages need them */

/* What is read from. Once `wrong` is set, every reading gives nothing. */
struct reader {
  const uint8_t* bytes;
  size_t size;
  const char* wrong;
};

struct table {
  size_t at;
  size_t vtable;
  size_t vtable_bytes;
};

struct vector {
  const uint8_t* data; /* NULL: not there */
  size_t count;
};

static void fail(struct reader* in, const char* what) {
  if (in->wrong == NULL) {
    in->wrong = what;
  }
}

static void require(struct reader* in, int holds, const char* what) {
  if (!holds) {
    fail(in, what);
  }
}

/* Whether [at, at + bytes) is inside and nothing is wrong yet. */
static int inside(struct reader* in, size_t at, size_t bytes) {
  if (in->wrong == NULL && (at > in->size || bytes > in->size - at)) {
    fail(in, "structure is broken");
  }
  return in->wrong == NULL;
}

static uint16_t get_u16(struct reader* in, size_t at) {
  uint16_t value = 0;
  if (inside(in, at, sizeof(value))) {
    memcpy(&value, in->bytes + at, sizeof(value));
  }
  return value;
}

static uint32_t get_u32(struct reader* in, size_t at) {
  uint32_t value = 0;
  if (inside(in, at, sizeof(value))) {
    memcpy(&value, in->bytes + at, sizeof(value));
  }
  return value;
}

static struct table get_table(struct reader* in, size_t at) {
  struct table out = {at, 0, 0};
  const int64_t vtable = (int64_t)at - (int32_t)get_u32(in, at);
  if (vtable < 0 || (size_t)vtable > in->size) {
    fail(in, "structure is broken");
    return out;
  }
  out.vtable = (size_t)vtable;
  out.vtable_bytes = get_u16(in, out.vtable);
  inside(in, out.vtable, out.vtable_bytes);
  return out;
}

/* Where field `id` of a table lies; 0: it is not there. */
static size_t get_field(struct reader* in, const struct table* table, unsigned id, size_t bytes) {
  const size_t entry = 4 + 2 * (size_t)id;
  if (in->wrong != NULL || entry + 2 > table->vtable_bytes) {
    return 0;
  }
  const size_t offset = get_u16(in, table->vtable + entry);
  return offset != 0 && inside(in, table->at + offset, bytes) ? table->at + offset : 0;
}

/* Copies a field where it is there. */
static int get_scalar(struct reader* in, const struct table* table, unsigned id, void* out, size_t bytes) {
  const size_t at = get_field(in, table, id, bytes);
  if (at != 0) {
    memcpy(out, in->bytes + at, bytes);
  }
  return at != 0;
}

/* Where the offset at `at` leads; 0: nowhere. In a vector it may be 0 (FlatBuffers' own verifier lets that
 * pass). */
static size_t follow_element(struct reader* in, size_t at) {
  const size_t offset = get_u32(in, at);
  return in->wrong == NULL && inside(in, at + offset, 4) ? at + offset : 0;
}

/* The same for a field. */
static size_t follow(struct reader* in, size_t at) {
  require(in, get_u32(in, at) != 0, "structure is broken");
  return follow_element(in, at);
}

/* 1 where the table is there. */
static int get_subtable(struct reader* in, const struct table* table, unsigned id, struct table* out) {
  const size_t field = get_field(in, table, id, 4);
  const size_t at = field != 0 ? follow(in, field) : 0;
  if (at != 0) {
    *out = get_table(in, at);
  }
  return at != 0 && in->wrong == NULL;
}

static struct vector vector_at(struct reader* in, size_t at, size_t element_bytes, size_t alignment) {
  struct vector out = {NULL, 0};
  const size_t count = get_u32(in, at);
  if (in->wrong == NULL && inside(in, at + 4, count * element_bytes)) {
    require(in, (at + 4) % alignment == 0, "structure is not aligned");
  }
  if (in->wrong == NULL) {
    out.data = in->bytes + at + 4;
    out.count = count;
  }
  return out;
}

static struct vector get_vector(struct reader* in, const struct table* table, unsigned id,
                                size_t element_bytes, size_t alignment) {
  struct vector none = {NULL, 0};
  const size_t field = get_field(in, table, id, 4);
  const size_t at = field != 0 ? follow(in, field) : 0;
  return at != 0 ? vector_at(in, at, element_bytes, alignment) : none;
}

/* A terminated string; "" where it is not there. */
static const char* string_at(struct reader* in, size_t at, size_t limit, const char* what) {
  const struct vector text = vector_at(in, at, 1, 1);
  if (text.data == NULL || !inside(in, at + 4 + text.count, 1)) {
    return "";
  }
  require(in, text.data[text.count] == 0, "structure is broken");
  require(in, text.count <= limit, what);
  return in->wrong == NULL ? (const char*)text.data : "";
}

static const char* get_string(struct reader* in, const struct table* table, unsigned id, size_t limit,
                              const char* what) {
  const size_t field = get_field(in, table, id, 4);
  const size_t at = field != 0 ? follow(in, field) : 0;
  return at != 0 ? string_at(in, at, limit, what) : "";
}

/* The vectors below were checked for alignment to their numbers when they were found. */
static const float* floats(struct vector in) {
  return (const float*)(const void*)in.data;
}
static const uint32_t* indices(struct vector in) {
  return (const uint32_t*)(const void*)in.data;
}

static int all_finite(const float* values, size_t count) {
  for (size_t k = 0; k < count; ++k) {
    if (!isfinite(values[k])) {
      return 0;
    }
  }
  return 1;
}

/* The body of a message of kind `kind`. */
static struct table open_body(struct reader* in, const uint8_t* message, size_t size, int kind) {
  struct table body = {0, 0, 0};
  struct table root;
  uint8_t type = 0;
  in->bytes = message;
  in->size = size;
  in->wrong = NULL;
  require(in, size <= WIRE_MAX_MESSAGE_BYTES, "longer than the protocol allows");
  require(in, size >= 12, "too short");
  require(in, in->wrong == NULL && memcmp(message + 4, "FCT1", 4) == 0, "identifier is not FCT1");
  const size_t at = in->wrong == NULL ? follow(in, 0) : 0;
  if (at != 0) {
    root = get_table(in, at);
    get_scalar(in, &root, 0, &type, sizeof(type));
    if (kind < 0) {
      body.at = type;
      return body;
    }
    require(in, type == kind && get_subtable(in, &root, 1, &body), "another kind of message");
  }
  return body;
}

int wire_kind(const uint8_t* message, size_t size) {
  struct reader in;
  const struct table type = open_body(&in, message, size, -1);
  return in.wrong == NULL ? (int)type.at : WIRE_BROKEN;
}

/* small messages */

enum { MAX_TEXT_BYTES = 1024, MAX_STENCIL_ENTRIES_PER_ROW = 64, MAX_LANDMARKS = 4096 };

const char* wire_hello(const uint8_t* message, size_t size, uint32_t* protocol_version) {
  struct reader in;
  const struct table body = open_body(&in, message, size, WIRE_HELLO);
  *protocol_version = 0;
  get_scalar(&in, &body, 0, protocol_version, sizeof(*protocol_version));
  return in.wrong;
}

const char* wire_dropped(const uint8_t* message, size_t size, uint64_t* total) {
  struct reader in;
  const struct table body = open_body(&in, message, size, WIRE_DROPPED);
  *total = 0;
  get_scalar(&in, &body, 1, total, sizeof(*total));
  return in.wrong;
}

const char* wire_goodbye(const uint8_t* message, size_t size, const char** reason) {
  struct reader in;
  const struct table body = open_body(&in, message, size, WIRE_GOODBYE);
  *reason = get_string(&in, &body, 0, MAX_TEXT_BYTES, "goodbye: reason");
  return in.wrong;
}

const char* wire_ring(const uint8_t* message, size_t size, uint32_t* version) {
  struct reader in;
  const struct table body = open_body(&in, message, size, WIRE_RING);
  *version = 0;
  get_scalar(&in, &body, 0, version, sizeof(*version));
  return in.wrong;
}

/* subject and albedo */

static void read_stencils(struct reader* in, const struct table* table, uint32_t coarser,
                          struct wire_level* out) {
  const struct vector offsets = get_vector(in, table, 0, 4, 4);
  const struct vector columns = get_vector(in, table, 1, 4, 4);
  const struct vector weights = get_vector(in, table, 2, 4, 4);
  require(in, offsets.data != NULL && columns.data != NULL && weights.data != NULL,
          "a level has no stencils");
  require(in, offsets.count == (size_t)out->vertex_count + 1, "stencils: number of rows");
  require(in, columns.count <= (size_t)MAX_STENCIL_ENTRIES_PER_ROW * out->vertex_count,
          "stencils: too many entries");
  require(in, weights.count == columns.count, "stencils: numbers of columns and weights differ");
  if (in->wrong != NULL) {
    return;
  }
  out->row_offsets = indices(offsets);
  out->columns = indices(columns);
  out->weights = floats(weights);
  require(in, out->row_offsets[0] == 0 && out->row_offsets[out->vertex_count] == columns.count,
          "stencils: row offsets");
  for (uint32_t row = 0; row < out->vertex_count && in->wrong == NULL; ++row) {
    const uint32_t first = out->row_offsets[row];
    const uint32_t end = out->row_offsets[row + 1];
    float sum = 0;
    require(in, first <= end && end <= columns.count, "stencils: row offsets");
    for (uint32_t k = first; k < end && in->wrong == NULL; ++k) {
      require(in, out->columns[k] < coarser, "stencils: column out of range");
      sum += out->weights[k];
    }
    require(in, fabsf(sum - 1.0F) <= 1e-3F, "stencils: weights of a row do not sum to 1");
  }
}

/* Triangles of a level: every one is checked. */
static void read_level(struct reader* in, const struct table* table, uint32_t coarser, int with_stencils,
                       struct wire_level* level, facet_level* out) {
  struct table stencils;
  level->vertex_count = 0;
  get_scalar(in, table, 0, &level->vertex_count, sizeof(level->vertex_count));
  require(in, level->vertex_count > 0 && level->vertex_count <= WIRE_MAX_VERTICES, "level: vertex count");
  const struct vector triangles = get_vector(in, table, 1, 4, 4);
  require(
      in,
      triangles.data != NULL && triangles.count % 3 == 0 && triangles.count / 3 <= 2 * WIRE_MAX_VERTICES + 2,
      "level: triangle count");
  for (size_t k = 0; k < triangles.count && in->wrong == NULL; ++k) {
    require(in, indices(triangles)[k] < level->vertex_count,
            "level: triangle names a vertex that is not there");
  }
  if (with_stencils) {
    require(in, get_subtable(in, table, 2, &stencils), "a level has no stencils");
    if (in->wrong == NULL) {
      read_stencils(in, &stencils, coarser, level);
    }
  }
  out->vertex_count = level->vertex_count;
  out->triangles = indices(triangles);
  out->triangle_count = (uint32_t)(triangles.count / 3);
}

/* Levels below the finest of a subject without stencils. Returns their number. */
static size_t read_coarser_levels(struct reader* in, const struct table* table, struct wire_subject* out) {
  const struct vector levels = get_vector(in, table, 4, 4, 4);
  uint32_t coarser = 1;
  require(in, levels.count < WIRE_MAX_LEVELS, "hierarchy: number of coarser levels");
  for (size_t k = 0; k < levels.count && in->wrong == NULL; ++k) {
    const size_t at = follow_element(in, (size_t)(levels.data - in->bytes) + 4 * k);
    const struct table level = get_table(in, at);
    struct wire_level unused;
    read_level(in, &level, 0, 0, &unused, &out->shown_levels[k]);
    require(in, out->shown_levels[k].vertex_count >= coarser, "hierarchy: a finer level is smaller");
    coarser = out->shown_levels[k].vertex_count;
  }
  return in->wrong == NULL ? levels.count : 0;
}

static void read_hierarchy(struct reader* in, const struct table* table, struct wire_subject* out) {
  uint64_t id = 0;
  get_scalar(in, table, 0, &id, sizeof(id));
  get_scalar(in, table, 1, &out->shown.control_vertex_count, sizeof(out->shown.control_vertex_count));
  require(in, id != 0, "hierarchy: id is 0");
  require(in, out->shown.control_vertex_count <= WIRE_MAX_VERTICES, "hierarchy: control vertex count");
  const struct vector levels = get_vector(in, table, 2, 4, 4);
  const int with_stencils = out->shown.control_vertex_count > 0;
  require(in, levels.count >= 1 && levels.count <= WIRE_MAX_LEVELS, "hierarchy: number of levels");
  require(in, with_stencils || levels.count == 1, "hierarchy: several levels without control vertices");
  const size_t below = with_stencils ? 0 : read_coarser_levels(in, table, out);
  uint32_t coarser = with_stencils ? out->shown.control_vertex_count
                     : below > 0   ? out->shown_levels[below - 1].vertex_count
                                   : 0;
  for (size_t k = 0; k < levels.count && in->wrong == NULL; ++k) {
    const size_t at = follow_element(in, (size_t)(levels.data - in->bytes) + 4 * k);
    const struct table level = get_table(in, at);
    read_level(in, &level, coarser, with_stencils, &out->levels[k], &out->shown_levels[below + k]);
    require(in, (with_stencils && k == 0) || out->levels[k].vertex_count >= coarser,
            "hierarchy: a finer level is smaller");
    coarser = out->levels[k].vertex_count;
  }
  if (in->wrong != NULL) {
    return;
  }
  out->shown.level_count = (uint32_t)(below + levels.count);
  out->shown.levels = out->shown_levels;
  const facet_level* finest = &out->shown_levels[out->shown.level_count - 1];
  out->shown.vertex_count = finest->vertex_count;
  out->shown.triangles = finest->triangles;
  out->shown.triangle_count = finest->triangle_count;
  const struct vector coordinates = get_vector(in, table, 3, 4, 4);
  require(in, coordinates.count == 2 * (size_t)coarser && all_finite(floats(coordinates), coordinates.count),
          "hierarchy: texture coordinates");
  out->shown.texture_coordinates = floats(coordinates);
  out->level_count = with_stencils ? (uint32_t)levels.count : 0;
}

const char* wire_subject(const uint8_t* message, size_t size, struct wire_subject* out) {
  struct reader in;
  struct table hierarchy;
  const struct table body = open_body(&in, message, size, WIRE_SUBJECT);
  memset(out, 0, sizeof(*out));
  get_scalar(&in, &body, 0, &out->shown.id, sizeof(out->shown.id));
  require(&in, out->shown.id != 0, "subject: id is 0");
  const struct vector names = get_vector(&in, &body, 1, 4, 4);
  const struct vector identity = get_vector(&in, &body, 2, 4, 4);
  require(&in, names.count <= WIRE_MAX_COEFFICIENTS, "subject: number of expressions");
  require(&in, identity.count <= WIRE_MAX_COEFFICIENTS && all_finite(floats(identity), identity.count),
          "subject: identity");
  for (size_t k = 0; k < names.count && in.wrong == NULL; ++k) {
    const size_t at = follow_element(&in, (size_t)(names.data - in.bytes) + 4 * k);
    out->names[k] = at != 0 ? string_at(&in, at, WIRE_MAX_NAME_BYTES, "subject: expression name") : "";
  }
  out->shown.expression_names = out->names;
  out->shown.expression_count = names.count;
  out->shown.identity = floats(identity);
  out->shown.identity_count = identity.count;
  if (get_subtable(&in, &body, 4, &hierarchy)) {
    read_hierarchy(&in, &hierarchy, out);
    const struct vector neutral = get_vector(&in, &body, 6, 4, 4);
    require(&in,
            neutral.count == 0 || (neutral.count == 3 * (size_t)out->shown.control_vertex_count &&
                                   all_finite(floats(neutral), neutral.count)),
            "subject: neutral");
    out->shown.neutral_mm = neutral.count != 0 ? floats(neutral) : NULL;
  }
  const char* person = get_string(&in, &body, 5, WIRE_MAX_NAME_BYTES, "subject: person");
  out->shown.person = *person != 0 ? person : NULL;
  return in.wrong;
}

const char* wire_albedo(const uint8_t* message, size_t size, facet_albedo* out) {
  struct reader in;
  const struct table body = open_body(&in, message, size, WIRE_ALBEDO);
  memset(out, 0, sizeof(*out));
  get_scalar(&in, &body, 0, &out->subject_id, sizeof(out->subject_id));
  get_scalar(&in, &body, 1, &out->version, sizeof(out->version));
  get_scalar(&in, &body, 2, &out->scale, sizeof(out->scale));
  const struct vector values = get_vector(&in, &body, 3, 2, 2);
  require(&in, out->subject_id != 0 && out->version != 0, "albedo: id or version is 0");
  require(&in, isfinite(out->scale) && out->scale > 0, "albedo: scale");
  require(&in, values.count % 3 == 0 && values.count <= 3 * (size_t)WIRE_MAX_VERTICES,
          "albedo: number of values");
  out->linear_rgb = (const uint16_t*)(const void*)values.data;
  out->vertex_count = values.count / 3;
  return in.wrong;
}

/* frames */

/* p_camera = R p_head + t: R must be a rotation. */
static int is_pose(float pose[3][4]) {
  for (int row = 0; row < 3; ++row) {
    if (!all_finite(pose[row], 4)) {
      return 0;
    }
  }
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const float dot = pose[0][i] * pose[0][j] + pose[1][i] * pose[1][j] + pose[2][i] * pose[2][j];
      if (!(fabsf(dot - (i == j ? 1.0F : 0.0F)) < 1e-2F)) {
        return 0;
      }
    }
  }
  return pose[0][0] * (pose[1][1] * pose[2][2] - pose[1][2] * pose[2][1]) -
             pose[0][1] * (pose[1][0] * pose[2][2] - pose[1][2] * pose[2][0]) +
             pose[0][2] * (pose[1][0] * pose[2][1] - pose[1][1] * pose[2][0]) >
         0;
}

/* Numbers with their step, out of the message or of the slot. 1 where the field is there. */
static int read_fixed_point(struct reader* in, const struct table* frame, unsigned id,
                            const struct wire_array* array, size_t count, facet_fixed_point* out,
                            const char* what) {
  struct table table;
  if (!get_subtable(in, frame, id, &table)) {
    return 0;
  }
  const struct vector values = get_vector(in, &table, 1, 2, 2);
  get_scalar(in, &table, 0, &out->step_mm, sizeof(out->step_mm));
  out->values = array != NULL ? (const int16_t*)array->data : (const int16_t*)(const void*)values.data;
  out->count = array != NULL ? array->count : values.count;
  require(in, out->count == count && out->step_mm > 0.0F && out->step_mm <= 0.02F * 1.001F, what);
  return 1;
}

static const void* numbers_of(struct reader* in, const struct table* frame, unsigned id, size_t bytes,
                              const struct wire_array* array, size_t count, const char* what) {
  const struct vector values = get_vector(in, frame, id, bytes, bytes);
  const void* data = array != NULL ? array->data : values.data;
  const size_t there = array != NULL ? array->count : values.count;
  require(in, data == NULL || there == count, what);
  return data;
}

static void read_geometry(struct reader* in, const struct table* frame, const facet_subject* subject,
                          const struct wire_array* arrays, facet_frame* out) {
  const struct wire_array* of[FACET_RING_ARRAY_COUNT] = {NULL};
  for (int k = 0; arrays != NULL && k < FACET_RING_ARRAY_COUNT; ++k) {
    of[k] = &arrays[k];
  }
  const size_t finest = subject->vertex_count;
  if (finest == 0) {
    require(in,
            get_field(in, frame, 16, 4) == 0 && get_field(in, frame, 17, 4) == 0 &&
                get_field(in, frame, 18, 4) == 0 && get_field(in, frame, 20, 4) == 0,
            "frame: geometry for a subject without topology");
    return;
  }
  if (subject->control_vertex_count > 0) {
    require(in,
            read_fixed_point(in, frame, 16, of[FACET_RING_CONTROL_VERTICES],
                             3 * (size_t)subject->control_vertex_count, &out->control_vertices,
                             "frame: control vertices"),
            "frame: control vertices");
    read_fixed_point(in, frame, 17, of[FACET_RING_DISPLACEMENTS], finest, &out->displacements,
                     "frame: displacements");
  } else {
    require(in,
            read_fixed_point(in, frame, 18, of[FACET_RING_VERTICES], 3 * finest, &out->vertices,
                             "frame: vertices"),
            "frame: vertices");
    out->normals = numbers_of(in, frame, 19, 2, of[FACET_RING_NORMALS], 3 * finest, "frame: normals");
    require(in, out->normals != NULL, "frame: normals");
  }
  out->confidence = numbers_of(in, frame, 20, 1, of[FACET_RING_CONFIDENCE], finest, "frame: confidence");
}

/* Of camera_from_head: the camera's y and z turned round, and a quaternion of unit length. */
static void set_upright(facet_frame* out) {
  const float signs[3] = {1, -1, -1};
  float r[3][3];
  for (int row = 0; row < 3; ++row) {
    out->upright_position_m[row] = 0.001F * signs[row] * out->camera_from_head[row][3];
    for (int column = 0; column < 3; ++column) {
      r[row][column] = signs[row] * out->camera_from_head[row][column];
    }
  }
  /* Four times the square of each part; the largest is what the others are divided by. */
  const float squares[4] = {1 + r[0][0] - r[1][1] - r[2][2], 1 - r[0][0] + r[1][1] - r[2][2],
                            1 - r[0][0] - r[1][1] + r[2][2], 1 + r[0][0] + r[1][1] + r[2][2]};
  int most = 0;
  for (int k = 1; k < 4; ++k) {
    most = squares[k] > squares[most] ? k : most;
  }
  float* q = out->upright_rotation;
  q[most] = squares[most];
  if (most == 3) {
    q[0] = r[2][1] - r[1][2];
    q[1] = r[0][2] - r[2][0];
    q[2] = r[1][0] - r[0][1];
  } else {
    const int next = (most + 1) % 3;
    const int last = (most + 2) % 3;
    q[next] = r[most][next] + r[next][most];
    q[last] = r[most][last] + r[last][most];
    q[3] = r[last][next] - r[next][last];
  }
  const float length = sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (int k = 0; k < 4; ++k) {
    q[k] /= length;
  }
}

static void read_mesh_part(struct reader* in, const struct table* frame, const struct wire_subject* subject,
                           const struct wire_array* arrays, facet_frame* out) {
  require(in, subject != NULL && subject->shown.id == out->subject_id, "frame: its subject was not sent");
  require(in, get_scalar(in, frame, 10, out->camera_from_head, sizeof(out->camera_from_head)),
          "frame: mesh without pose");
  require(in, in->wrong != NULL || is_pose(out->camera_from_head),
          "frame: pose is not a rotation and a translation");
  require(in, get_scalar(in, frame, 14, out->lighting, sizeof(out->lighting)) && all_finite(out->lighting, 9),
          "frame: lighting");
  const struct vector expression = get_vector(in, frame, 11, 4, 4);
  get_scalar(in, frame, 13, &out->photometric_rms, sizeof(out->photometric_rms));
  get_scalar(in, frame, 15, &out->albedo_version, sizeof(out->albedo_version));
  require(in, isfinite(out->photometric_rms), "frame: photometric rms");
  require(in, all_finite(floats(expression), expression.count), "frame: expression");
  if (in->wrong != NULL) {
    return;
  }
  require(in, expression.count == subject->shown.expression_count, "frame: expression");
  out->expression = floats(expression);
  out->expression_count = expression.count;
  const struct vector confidence = get_vector(in, frame, 23, 1, 1);
  require(in, confidence.data == NULL || confidence.count == expression.count,
          "frame: confidence of the expression");
  out->expression_confidence = confidence.data;
  const struct vector values = get_vector(in, frame, 25, 4, 4);
  require(
      in,
      values.data == NULL || (values.count == expression.count && all_finite(floats(values), values.count)),
      "frame: avatar values");
  out->avatar_values = values.data != NULL ? floats(values) : out->expression;
  set_upright(out);
  read_geometry(in, frame, &subject->shown, arrays, out);
}

uint64_t wire_frame_subject(const uint8_t* message, size_t size) {
  struct reader in;
  uint64_t id = 0;
  const struct table body = open_body(&in, message, size, WIRE_FRAME);
  get_scalar(&in, &body, 9, &id, sizeof(id));
  return in.wrong == NULL ? id : 0;
}

const char* wire_frame(const uint8_t* message, size_t size, const struct wire_subject* subject,
                       const struct wire_array* arrays, facet_frame* out) {
  struct reader in;
  struct table stages;
  struct {
    float fx, fy, cx, cy;
    int32_t width_px, height_px;
  } camera = {0, 0, 0, 0, 0, 0};
  uint8_t state = 0;
  uint8_t degraded = 0;
  uint8_t origin = 0;
  const struct table body = open_body(&in, message, size, WIRE_FRAME);
  memset(out, 0, sizeof(*out));
  get_scalar(&in, &body, 0, &out->sequence, sizeof(out->sequence));
  get_scalar(&in, &body, 1, &out->timestamp_ns, sizeof(out->timestamp_ns));
  get_scalar(&in, &body, 2, &out->media_time_ns, sizeof(out->media_time_ns));
  get_scalar(&in, &body, 3, &state, sizeof(state));
  get_scalar(&in, &body, 4, &degraded, sizeof(degraded));
  out->degraded_reason = get_string(&in, &body, 5, MAX_TEXT_BYTES, "frame: degraded reason");
  get_scalar(&in, &body, 6, &camera, sizeof(camera));
  get_scalar(&in, &body, 24, &origin, sizeof(origin));
  require(&in, state <= FACET_LOST, "frame: unknown tracking state");
  require(&in, origin <= FACET_POSE, "frame: unknown origin");
  require(&in,
          isfinite(camera.fx) && isfinite(camera.fy) && isfinite(camera.cx) && isfinite(camera.cy) &&
              camera.width_px >= 0 && camera.width_px <= 65536 && camera.height_px >= 0 &&
              camera.height_px <= 65536,
          "frame: camera");
  if (get_subtable(&in, &body, 7, &stages)) {
    get_scalar(&in, &stages, 9, &out->latency_ms, sizeof(out->latency_ms));
    require(&in, isfinite(out->latency_ms), "frame: stage times");
  }
  const struct vector landmarks = get_vector(&in, &body, 8, 8, 4);
  require(&in, landmarks.count <= MAX_LANDMARKS && all_finite(floats(landmarks), 2 * landmarks.count),
          "frame: landmarks");
  get_scalar(&in, &body, 9, &out->subject_id, sizeof(out->subject_id));
  get_scalar(&in, &body, 12, &out->reprojection_px, sizeof(out->reprojection_px));
  require(&in, isfinite(out->reprojection_px), "frame: reprojection");
  out->state = state;
  out->origin = origin;
  out->degraded = degraded != 0;
  out->fx = camera.fx;
  out->fy = camera.fy;
  out->cx = camera.cx;
  out->cy = camera.cy;
  out->width_px = camera.width_px;
  out->height_px = camera.height_px;
  out->landmarks_px = floats(landmarks);
  out->landmark_count = landmarks.count;
  out->in_ring = arrays != NULL;
  if (in.wrong == NULL && out->subject_id != 0) {
    read_mesh_part(&in, &body, subject, arrays, out);
  }
  return in.wrong;
}

/* what the client says */

size_t wire_subscribe(uint8_t out[WIRE_MAX_SUBSCRIBE_BYTES], int profile, int want_albedo, const char* name,
                      uint32_t ring_version) {
  /* Offsets by hand: root, identifier, Message {type, body} with its vtable, Subscribe with its own, the
   * name. */
  enum { MESSAGE_VTABLE = 8, MESSAGE = 16, SUBSCRIBE_VTABLE = 28, SUBSCRIBE = 44, NAME = 64 };
  const char* end = memchr(name, 0, WIRE_MAX_NAME_BYTES);
  const size_t name_bytes = end != NULL ? (size_t)(end - name) : WIRE_MAX_NAME_BYTES;
  const uint16_t message_vtable[4] = {8, 12, 8, 4};
  const uint16_t subscribe_vtable[8] = {16, 20, 4, 16, 17, 12, 0, 8};
  const uint32_t root = MESSAGE;
  const int32_t to_message_vtable = MESSAGE - MESSAGE_VTABLE;
  const uint32_t body = SUBSCRIBE - (MESSAGE + 4);
  const int32_t to_subscribe_vtable = SUBSCRIBE - SUBSCRIBE_VTABLE;
  const uint32_t version = WIRE_VERSION;
  const uint32_t to_name = NAME - (SUBSCRIBE + 12);
  const uint32_t length = (uint32_t)name_bytes;
  memset(out, 0, WIRE_MAX_SUBSCRIBE_BYTES);
  memcpy(out, &root, 4);
  memcpy(out + 4, "FCT1", 4);
  memcpy(out + MESSAGE_VTABLE, message_vtable, sizeof(message_vtable));
  memcpy(out + MESSAGE, &to_message_vtable, 4);
  memcpy(out + MESSAGE + 4, &body, 4);
  out[MESSAGE + 8] = 2; /* Subscribe */
  memcpy(out + SUBSCRIBE_VTABLE, subscribe_vtable, sizeof(subscribe_vtable));
  memcpy(out + SUBSCRIBE, &to_subscribe_vtable, 4);
  memcpy(out + SUBSCRIBE + 4, &version, 4);
  memcpy(out + SUBSCRIBE + 8, &ring_version, 4);
  memcpy(out + SUBSCRIBE + 12, &to_name, 4);
  out[SUBSCRIBE + 16] = (uint8_t)profile;
  out[SUBSCRIBE + 17] = want_albedo != 0;
  memcpy(out + NAME, &length, 4);
  memcpy(out + NAME + 4, name, name_bytes);
  return (NAME + 4 + name_bytes + 1 + 7) / 8 * 8;
}
