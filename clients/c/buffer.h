#ifndef FACET_CLIENT_BUFFER_H
#define FACET_CLIENT_BUFFER_H

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

/* A message whose memory is used again. */
struct buffer {
  uint8_t* bytes; /* of malloc: aligned for every number */
  size_t size;
  size_t room;
};

/* Memory grows with what has come, not with what was announced. */
static inline int buffer_grow(struct buffer* buffer, size_t announced) {
  if (buffer->size < buffer->room || buffer->room >= announced) {
    return 1;
  }
  size_t room = buffer->room < 65536 ? 65536 : 2 * buffer->room;
  room = room < announced ? room : announced;
  uint8_t* bytes = realloc(buffer->bytes, room);
  if (bytes == NULL) {
    return 0;
  }
  buffer->bytes = bytes;
  buffer->room = room;
  return 1;
}

#endif
