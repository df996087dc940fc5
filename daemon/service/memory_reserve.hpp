#pragma once

namespace facet::service {

/// Memory that is given back when `new` finds none, so that what is under way can end: an exception of want
/// of memory must not meet a destructor that allocates, as those of nlohmann's JSON do. Behind the reserve
/// `new` throws std::bad_alloc as ever. One in a process, from before its threads to their end.
class MemoryReserve {
 public:
  MemoryReserve();
  ~MemoryReserve();
  MemoryReserve(const MemoryReserve&) = delete;
  MemoryReserve& operator=(const MemoryReserve&) = delete;

  /// Takes again what was given back. Returns how often memory ran out since the last call. One thread at a
  /// time.
  static int refill();
};

}  // namespace facet::service
