#include "service/memory_reserve.hpp"

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdlib>
#include <new>

namespace facet::service {
namespace {

// Each want of memory takes one piece. They are never written: that they are there costs address space alone.
constexpr std::size_t kPieceBytes = std::size_t{1} << 20;
std::array<std::atomic<void*>, 16> pieces;
std::atomic<int> given_back{0};

void give_back_one() {
  for (std::atomic<void*>& piece : pieces) {
    if (void* const memory = piece.exchange(nullptr)) {
      std::free(memory);
      ++given_back;
      return;  // new tries again
    }
  }
  throw std::bad_alloc();
}

}  // namespace

MemoryReserve::MemoryReserve() {
  refill();
  std::set_new_handler(give_back_one);
}

MemoryReserve::~MemoryReserve() {
  std::set_new_handler(nullptr);
  for (std::atomic<void*>& piece : pieces) {
    std::free(piece.exchange(nullptr));
  }
}

int MemoryReserve::refill() {
  for (std::atomic<void*>& piece : pieces) {
    if (piece == nullptr) {
      piece = std::malloc(kPieceBytes);
    }
  }
  return given_back.exchange(0);
}

}  // namespace facet::service
