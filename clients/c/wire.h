#ifndef FACET_CLIENT_WIRE_H
#define FACET_CLIENT_WIRE_H

#include "facet-client.h"
#include "stream/ring_layout.h"

/* The messages of the stream protocol (daemon/stream/facet.fbs), read where they lie: every offset and length
 * is checked before it is followed, every index and number before it is given out. Bytes from outside; any
 * thread. */

/* Limits of docs/stream-protocol.md. */
enum {
  WIRE_VERSION = 1,
  WIRE_HEADER_BYTES = 8,
  WIRE_MAX_LEVELS = 12,
  WIRE_MAX_COEFFICIENTS = 1024,
  WIRE_MAX_NAME_BYTES = 64,
  WIRE_MAX_SUBSCRIBE_BYTES = 256
};
#define WIRE_MAGIC 0x4D544346u /* "FCTM" in memory */
#define WIRE_MAX_MESSAGE_BYTES (64u << 20)
#define WIRE_MAX_VERTICES 500000u

/* Kinds of messages, as the union Body numbers them. */
enum {
  WIRE_BROKEN = 0,
  WIRE_HELLO = 1,
  WIRE_DROPPED = 3,
  WIRE_GOODBYE = 4,
  WIRE_SUBJECT = 5,
  WIRE_ALBEDO = 6,
  WIRE_FRAME = 7,
  WIRE_RING = 8
};

struct wire_level {
  uint32_t vertex_count;
  const uint32_t* row_offsets; /* [vertex_count + 1] */
  const uint32_t* columns;
  const float* weights;
};

struct wire_subject {
  facet_subject shown;
  facet_level shown_levels[WIRE_MAX_LEVELS];
  uint32_t level_count; /* with stencils; 0 with FACET_VERTICES and FACET_SIGNALS */
  struct wire_level levels[WIRE_MAX_LEVELS];
  const char* names[WIRE_MAX_COEFFICIENTS];
};

/* An array of a ring's slot, inside the slot. */
struct wire_array {
  const void* data; /* NULL: not there */
  size_t count;
};

/* message: [size], aligned to 8 bytes. Each returns NULL, or what is wrong. The
 * pointers that come out point into the message. */
int wire_kind(const uint8_t* message, size_t size); /* WIRE_BROKEN where it is no message */
const char* wire_hello(const uint8_t* message, size_t size, uint32_t* protocol_version);
const char* wire_dropped(const uint8_t* message, size_t size, uint64_t* total);
const char* wire_goodbye(const uint8_t* message, size_t size, const char** reason);
const char* wire_ring(const uint8_t* message, size_t size, uint32_t* version);
const char* wire_subject(const uint8_t* message, size_t size, struct wire_subject* out);
const char* wire_albedo(const uint8_t* message, size_t size, facet_albedo* out);
/* Of a frame, before the subject that it needs is known: 0 where it has none or is broken. */
uint64_t wire_frame_subject(const uint8_t* message, size_t size);
/* subject  that the frame names; NULL only where it names none
 * arrays   [FACET_RING_ARRAY_COUNT] of the slot of which `message` is the head; NULL: they are in the message
 */
const char* wire_frame(const uint8_t* message, size_t size, const struct wire_subject* subject,
                       const struct wire_array* arrays, facet_frame* out);

/* A Subscribe message without the socket's header. name: at most WIRE_MAX_NAME_BYTES; returns its length. */
size_t wire_subscribe(uint8_t out[WIRE_MAX_SUBSCRIBE_BYTES], int profile, int want_albedo, const char* name,
                      uint32_t ring_version);

#endif
