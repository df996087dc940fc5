#include "rebuild.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Room for what a subject's levels need. 0: there is none. */
static int make_room(struct mesh_memory* memory, size_t vertex_count) {
  if (memory->vertex_count >= vertex_count) {
    return 1;
  }
  rebuild_free(memory);
  for (int k = 0; k < 2; ++k) {
    memory->positions[k] = malloc(vertex_count * 3 * sizeof(float));
  }
  memory->normals = malloc(vertex_count * 3 * sizeof(float));
  if (memory->positions[0] == NULL || memory->positions[1] == NULL || memory->normals == NULL) {
    rebuild_free(memory);
    return 0;
  }
  memory->vertex_count = vertex_count;
  return 1;
}

void rebuild_free(struct mesh_memory* memory) {
  free(memory->positions[0]);
  free(memory->positions[1]);
  free(memory->normals);
  memset(memory, 0, sizeof(*memory));
}

/* A ring's numbers are read by aligned words of 64 bits, which another process may be writing. */
static void scaled(const int16_t* values, size_t count, float step, int in_ring, float* out) {
  size_t k = 0;
  for (; in_ring && k < count; k += 4) {
    const uint64_t word = __atomic_load_n((const uint64_t*)(const void*)(values + k), __ATOMIC_RELAXED);
    int16_t numbers[4];
    memcpy(numbers, &word, sizeof(word));
    for (size_t i = 0; i < 4 && k + i < count; ++i) {
      out[k + i] = (float)numbers[i] * step;
    }
  }
  for (; k < count; ++k) {
    out[k] = (float)values[k] * step;
  }
}

/* out[row] = sum of weights * in[column] over the row. */
static void apply(const struct wire_level* level, const float* in, float* out) {
  uint32_t entry = 0;
  for (uint32_t row = 0; row < level->vertex_count; ++row) {
    const uint32_t end = level->row_offsets[row + 1];
    float x = 0;
    float y = 0;
    float z = 0;
    for (; entry < end; ++entry) {
      const float* from = in + 3 * (size_t)level->columns[entry];
      const float weight = level->weights[entry];
      x = fmaf(weight, from[0], x);
      y = fmaf(weight, from[1], y);
      z = fmaf(weight, from[2], z);
    }
    *out++ = x;
    *out++ = y;
    *out++ = z;
  }
}

/* Area-weighted unit normals ([MD19 eq. 5] at d = 0); 0 where a vertex has no area. Operation by
 * operation as mesh::vertex_normals: the same bits. */
static void vertex_normals(const float* vertices, const facet_subject* subject, float* normals) {
  memset(normals, 0, (size_t)subject->vertex_count * 3 * sizeof(float));
  for (size_t t = 0; t < subject->triangle_count; ++t) {
    const uint32_t* corners = subject->triangles + 3 * t;
    const float* origin = vertices + 3 * (size_t)corners[0];
    const float* second = vertices + 3 * (size_t)corners[1];
    const float* third = vertices + 3 * (size_t)corners[2];
    float a[3];
    float b[3];
    for (int i = 0; i < 3; ++i) {
      a[i] = second[i] - origin[i];
      b[i] = third[i] - origin[i];
    }
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3;
      const int k = (i + 2) % 3;
      const float doubled_area = fmaf(-a[k], b[j], a[j] * b[k]);
      for (int corner = 0; corner < 3; ++corner) {
        normals[3 * (size_t)corners[corner] + (size_t)i] += doubled_area;
      }
    }
  }
  for (size_t v = 0; v < subject->vertex_count; ++v) {
    float* normal = normals + 3 * v;
    const float length = sqrtf(fmaf(normal[0], normal[0], fmaf(normal[2], normal[2], normal[1] * normal[1])));
    if (length > 0) {
      normal[0] /= length;
      normal[1] /= length;
      normal[2] /= length;
    }
  }
}

static void displace(const float* displacements_mm, const float* normals, size_t vertex_count,
                     float* vertices) {
  for (size_t v = 0; v < vertex_count; ++v) {
    for (size_t i = 0; i < 3; ++i) {
      vertices[3 * v + i] = fmaf(normals[3 * v + i], displacements_mm[v], vertices[3 * v + i]);
    }
  }
}

/* Level by level, then along the normals of the finest one [MD19 sec. 4.3]. */
static int rebuild(const facet_frame* frame, const struct wire_subject* subject, struct mesh_memory* memory,
                   facet_mesh* out) {
  size_t room = subject->shown.vertex_count;
  if (room < subject->shown.control_vertex_count) {
    room = subject->shown.control_vertex_count;
  }
  if (!make_room(memory, room)) {
    return FACET_OUT_OF_MEMORY;
  }
  float* coarser = memory->positions[0];
  float* finer = memory->positions[1];
  scaled(frame->control_vertices.values, frame->control_vertices.count, frame->control_vertices.step_mm,
         frame->in_ring, coarser);
  for (uint32_t l = 0; l < subject->level_count; ++l) {
    apply(&subject->levels[l], coarser, finer);
    float* next = coarser;
    coarser = finer;
    finer = next;
  }
  vertex_normals(coarser, &subject->shown, memory->normals);
  if (frame->displacements.values != NULL) {
    scaled(frame->displacements.values, frame->displacements.count, frame->displacements.step_mm,
           frame->in_ring, finer);
    displace(finer, memory->normals, subject->shown.vertex_count, coarser);
    vertex_normals(coarser, &subject->shown, memory->normals);
  }
  out->vertices_mm = coarser;
  return FACET_OK;
}

int rebuild_mesh(const facet_frame* frame, const struct wire_subject* subject, struct mesh_memory* memory,
                 facet_mesh* out) {
  int outcome = FACET_OK;
  if (frame->control_vertices.values != NULL) {
    outcome = rebuild(frame, subject, memory, out);
  } else if (frame->vertices.values != NULL) {
    if (!make_room(memory, subject->shown.vertex_count)) {
      return FACET_OUT_OF_MEMORY;
    }
    scaled(frame->vertices.values, frame->vertices.count, frame->vertices.step_mm, frame->in_ring,
           memory->positions[0]);
    scaled(frame->normals, frame->vertices.count, 1.0F / 32767.0F, frame->in_ring, memory->normals);
    out->vertices_mm = memory->positions[0];
  } else {
    return FACET_NO_MESH;
  }
  out->vertex_count = subject->shown.vertex_count;
  out->normals = memory->normals;
  return outcome;
}
