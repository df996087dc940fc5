#include "maths/threads.hpp"

#include <algorithm>
#include <atomic>
#include <exception>
#include <thread>
#include <vector>

namespace facet::maths {

void for_each_piece(std::size_t count, std::size_t thread_count,
                    const std::function<void(std::size_t thread, std::size_t piece)>& work) {
  std::atomic<std::size_t> next = 0;
  std::atomic_flag failed;
  std::exception_ptr fault;  // of whoever set the flag; read once the others have ended
  const auto take_part = [&](std::size_t thread) {
    try {
      for (std::size_t piece = next++; piece < count; piece = next++) {
        work(thread, piece);
      }
    } catch (...) {
      next = count;
      if (!failed.test_and_set()) {
        fault = std::current_exception();
      }
    }
  };
  {
    std::vector<std::jthread> others;  // joined at the end of this block
    try {
      for (std::size_t thread = 1; thread < std::min(thread_count, count); ++thread) {
        others.emplace_back([&take_part, thread] { take_part(thread); });
      }
    } catch (const std::exception&) {
      // No thread, or no memory for one, is to be had: it takes longer.
    }
    take_part(0);
  }
  if (fault != nullptr) {
    std::rethrow_exception(fault);
  }
}

}  // namespace facet::maths
