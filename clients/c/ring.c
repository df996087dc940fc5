#include "ring.h"

#include <string.h>

static uint64_t load_word(const uint8_t* memory) {
  return __atomic_load_n((const uint64_t*)(const void*)memory, __ATOMIC_RELAXED);
}

uint64_t ring_published(const struct ring* ring) {
  return load_word(ring->memory + offsetof(struct facet_ring_page, published));
}

const uint8_t* ring_slot(const struct ring* ring, uint64_t publication) {
  return ring->memory + FACET_RING_PAGE_BYTES + (publication - 1) % ring->slot_count * ring->slot_bytes;
}

int ring_intact(const struct ring* ring) {
  __atomic_thread_fence(__ATOMIC_ACQUIRE);
  return load_word(ring_slot(ring, ring->publication)) == 2 * ring->publication;
}

int ring_copy_head(const struct ring* ring, uint64_t publication, struct facet_ring_slot* slot,
                   struct buffer* head) {
  const uint8_t* from = ring_slot(ring, publication);
  uint64_t words[sizeof(*slot) / 8];
  words[0] = load_word(from);
  __atomic_thread_fence(__ATOMIC_ACQUIRE);
  if (words[0] != 2 * publication) {
    return 0;
  }
  for (size_t k = 1; k < sizeof(*slot) / 8; ++k) {
    words[k] = load_word(from + 8 * k);
  }
  memcpy(slot, words, sizeof(*slot));
  /* Not known to be whole yet: no more is believed of it than that it stays inside the slot. */
  const size_t most = ring->slot_bytes - sizeof(*slot);
  const size_t bytes = slot->head_bytes < most ? slot->head_bytes : most;
  head->size = 0;
  while (head->room < bytes + 8) {
    head->size = head->room;
    if (!buffer_grow(head, bytes + 8)) {
      return -1;
    }
  }
  for (size_t k = 0; k < bytes; k += 8) {
    const uint64_t word = load_word(from + sizeof(*slot) + k);
    memcpy(head->bytes + k, &word, 8);
  }
  head->size = bytes;
  __atomic_thread_fence(__ATOMIC_ACQUIRE);
  return load_word(from) == 2 * publication;
}
