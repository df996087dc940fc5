#ifndef FACET_CLIENT_RING_H
#define FACET_CLIENT_RING_H

#include <stddef.h>
#include <stdint.h>

#include "buffer.h"
#include "stream/ring_layout.h"

/* A ring of frames in shared memory that its owner writes while it is read (docs/stream-protocol.md). */

struct ring {
  uint8_t* memory; /* NULL: none */
  size_t bytes;
  size_t slot_count;
  size_t slot_bytes;
  int wake;             /* readable with each frame */
  uint64_t publication; /* that was read last; 0: none */
  uint64_t number;      /* the server's, of that frame; 0: none */
  struct facet_ring_slot slot;
};

uint64_t ring_published(const struct ring* ring); /* the newest publication; 0: none yet */
const uint8_t* ring_slot(const struct ring* ring, uint64_t publication);
/* 1: the publication that was read last has not been overwritten so far. */
int ring_intact(const struct ring* ring);
/* Copies slot and head of a publication. 1: whole; 0: it was being written; -1: no memory. */
int ring_copy_head(const struct ring* ring, uint64_t publication, struct facet_ring_slot* slot,
                   struct buffer* head);

#endif
