#ifndef FACET_STREAM_RING_LAYOUT_H
#define FACET_STREAM_RING_LAYOUT_H

#include <stdint.h>

/* The shared-memory ring as it lies in memory (docs/stream-protocol.md, "The ring"); for C11 and C++20,
 * little-endian:
 *
 *   0                                      struct facet_ring_page
 *   FACET_RING_PAGE_BYTES + k * slot_bytes slot k: struct facet_ring_slot, the head message, the arrays
 *
 * Publication n (from 1) lies in slot (n - 1) % slot_count. One process writes; every access to what changes
 * is an atomic one of 64 aligned bits. To read publication n:
 *
 *   load sequence, acquire; it must be 2 n
 *   copy slot and head message word by word, relaxed
 *   fence, acquire; load sequence, relaxed: the copy counts only where it is still 2 n
 *   read the arrays in place, relaxed; what was made of them counts only after the same check again
 */

#define FACET_RING_MAGIC 0x52544346u /* "FCTR" in memory */
#define FACET_RING_VERSION 1u
#define FACET_RING_PAGE_BYTES 4096u
#define FACET_RING_ALIGNMENT 64u /* of slots, and of arrays within their slot */
#define FACET_RING_MAX_SLOTS 64u

/* The arrays beside a head message: what the message of the same profile on the socket holds in its vectors.
 */
enum {
  /* int16 [control_vertex_count][3], times control_vertices.step_mm of the head */
  FACET_RING_CONTROL_VERTICES = 0,
  FACET_RING_DISPLACEMENTS = 1, /* int16 [finest vertex_count], times displacements.step_mm */
  FACET_RING_VERTICES = 2,      /* int16 [finest vertex_count][3], times vertices.step_mm */
  FACET_RING_NORMALS = 3,       /* int16 [finest vertex_count][3], 32767 is 1 */
  FACET_RING_CONFIDENCE = 4,    /* uint8 [finest vertex_count], 255 is 1 */
  FACET_RING_ARRAY_COUNT = 5
};

/* Written once, before the first reader sees it, but for `published`. */
struct facet_ring_page {
  uint32_t magic;
  uint32_t version;
  uint32_t slot_count; /* 2 to FACET_RING_MAX_SLOTS */
  uint32_t profile;    /* of the stream protocol */
  uint64_t slot_bytes; /* from slot to slot; a multiple of FACET_RING_ALIGNMENT */
  uint64_t reserved[5];
  uint64_t published; /* the newest publication that is whole; 0: none */
};

struct facet_ring_array {
  uint32_t offset; /* bytes from the slot's start; a multiple of FACET_RING_ALIGNMENT; 0: not there */
  uint32_t count;  /* numbers */
};

struct facet_ring_slot {
  uint64_t sequence;   /* 2 n - 1: publication n is being written; 2 n: it is whole; 0: never used */
  uint64_t number;     /* the server's count of frames, also of those that nobody got: gaps are drops */
  uint32_t head_bytes; /* of the head message, which follows this struct */
  uint32_t reserved;
  struct facet_ring_array arrays[FACET_RING_ARRAY_COUNT];
};

#ifdef __cplusplus
static_assert(sizeof(facet_ring_page) == 72 && sizeof(facet_ring_slot) == 64);
#else
_Static_assert(sizeof(struct facet_ring_page) == 72 && sizeof(struct facet_ring_slot) == 64, "layout");
#endif

#endif
