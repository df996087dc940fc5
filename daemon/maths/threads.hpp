#pragma once

#include <cstddef>
#include <functional>

namespace facet::maths {

/// Does `count` pieces of work, each once, on this thread and up to thread_count - 1 more that live as long
/// as the call. Where one can't be made, those that are there do the work. work   called with its thread's
/// number, 0 (this one) to thread_count - 1, and the piece's, 0 to count - 1, from
///        several threads at once
/// Throws what a piece threw first, once all threads have ended; pieces that nobody had begun by then are
/// left out.
void for_each_piece(std::size_t count, std::size_t thread_count,
                    const std::function<void(std::size_t thread, std::size_t piece)>& work);

}  // namespace facet::maths
