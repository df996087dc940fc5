#include "allocation_counter.hpp"

#include <atomic>

namespace {

std::atomic<std::size_t> count{0};

}  // namespace

#ifndef FACET_SANITIZED

// glibc's own names for its allocator: a program may define malloc and pass on to them.
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t items, std::size_t size);
void* __libc_realloc(void* memory, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);

void* malloc(std::size_t size) {
  count.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}

void* calloc(std::size_t items, std::size_t size) {
  count.fetch_add(1, std::memory_order_relaxed);
  return __libc_calloc(items, size);
}

void* realloc(void* memory, std::size_t size) {
  count.fetch_add(1, std::memory_order_relaxed);
  return __libc_realloc(memory, size);
}

void* aligned_alloc(std::size_t alignment, std::size_t size) {
  count.fetch_add(1, std::memory_order_relaxed);
  return __libc_memalign(alignment, size);
}
}

#endif

namespace facet::test {

std::size_t allocation_count() {
  return count.load(std::memory_order_relaxed);
}

bool allocations_are_counted() {
#ifdef FACET_SANITIZED
  return false;
#else
  return true;
#endif
}

}  // namespace facet::test
