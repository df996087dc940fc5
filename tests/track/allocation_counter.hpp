#pragma once

#include <cstddef>

namespace facet::test {

/// Number of calls of malloc, calloc, realloc and aligned_alloc in this process so far. The counting versions
/// are in allocation_counter.cpp; they are left out under the sanitizers, which bring their own.
std::size_t allocation_count();

/// False where allocation_count() always says 0.
bool allocations_are_counted();

}  // namespace facet::test
