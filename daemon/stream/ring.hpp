#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "stream/protocol.hpp"
#include "stream/ring_layout.h"
#include "stream/unix_socket.hpp"

/// Frames handed to readers on the same machine through shared memory: a writer that never waits, readers
/// that can neither change nor delay anything. docs/stream-protocol.md says how a reader gets a ring,
/// ring_layout.h how it lies in memory.
namespace facet::stream {

/// A frame in two parts: the message without the vectors that are long, and these. Views.
struct RingFrame {
  std::span<const std::uint8_t> head;  ///< a Frame message
  /// By FACET_RING_CONTROL_VERTICES and so on; bytes, little-endian. Empty: not there.
  std::array<std::span<const std::uint8_t>, FACET_RING_ARRAY_COUNT> arrays;
};

/// Bytes that the slot of a frame must have.
std::size_t ring_slot_bytes(const RingFrame& frame);

/// Memory that is mapped into this process; empty or whole.
class Mapping {
 public:
  Mapping() = default;
  /// Maps the first bytes of `fd`; a writer's pages are made at once. Throws Error(Internal).
  Mapping(int fd, std::size_t bytes, bool writable);
  Mapping(Mapping&& other) noexcept : bytes_(std::exchange(other.bytes_, {})) {}
  Mapping& operator=(Mapping&& other) noexcept {
    std::swap(bytes_, other.bytes_);
    return *this;
  }
  Mapping(const Mapping&) = delete;
  Mapping& operator=(const Mapping&) = delete;
  ~Mapping();

  std::span<std::uint8_t> bytes() const { return bytes_; }

 private:
  std::span<std::uint8_t> bytes_;
};

/// The one writer of a ring. One thread; after construction it allocates nothing and makes no system call.
class RingWriter {
 public:
  /// Makes the memory (memfd), whole at once, and seals it: nobody can shorten, lengthen or write it but
  /// through the mapping that exists already. slot_count from 2, slot_bytes as ring_slot_bytes says. Throws
  /// Error(Internal) where memory or descriptors are used up.
  RingWriter(Profile profile, std::uint32_t slot_count, std::size_t slot_bytes);

  /// Of the memory, for readers; they can't write through it.
  int fd() const { return memory_.get(); }
  std::size_t bytes() const { return mapping_.bytes().size(); }
  std::size_t slot_bytes() const { return slot_bytes_; }
  std::span<const std::uint8_t> memory() const { return mapping_.bytes(); }

  /// Puts a frame over the oldest one. number: the server's count of frames. The frame must fit its slot.
  void write(std::uint64_t number, const RingFrame& frame);

 private:
  FileDescriptor memory_;
  Mapping mapping_;
  std::size_t slot_count_ = 0;
  std::size_t slot_bytes_ = 0;
  std::uint64_t published_ = 0;
};

/// An array in a ring's slot. The memory may change at any moment: read it by aligned words of 64 bits (as
/// for_each_number does), and believe what was read only after RingReader::intact.
struct RingArray {
  const std::uint8_t* data = nullptr;  ///< aligned to 64 bytes, readable to the next multiple of 8 bytes
  std::size_t count = 0;               ///< numbers
};

/// One reader. One thread. It takes the memory for hostile: all that it follows is copied and checked first.
class RingReader {
 public:
  /// Maps what the page of the memory behind `fd` says, at most 64 slots of 64 MiB. Throws
  /// Error(UnreadableInput) where the memory is not sealed against shortening, is no ring of this version, or
  /// is not all there.
  explicit RingReader(const FileDescriptor& fd);
  /// The same for memory that is mapped already and outlives this.
  explicit RingReader(std::span<const std::uint8_t> memory);

  enum class Outcome {
    Frame,      ///< number(), head() and array() are of the newest frame
    NothingNew  ///< the newest is the one that was read last, or there is none
  };
  /// Looks for the newest frame. Throws Error(UnreadableInput) where a whole frame's slot makes no sense.
  Outcome newest();

  std::uint64_t number() const { return slot_.number; }
  /// The frame's message without its arrays: a copy, whole. Valid until newest() gives another.
  std::span<const std::uint8_t> head() const;
  /// In place. which: FACET_RING_CONTROL_VERTICES and so on
  RingArray array(std::size_t which) const;
  /// Whether nothing that was read of the frame since newest() can have been overwritten.
  bool intact() const;

  Profile profile() const { return profile_; }

 private:
  /// Takes over what a page says; the bytes that the ring needs. `published` is not looked at.
  std::size_t check(const facet_ring_page& page);
  const std::uint8_t* slot_of(std::uint64_t publication) const;

  Mapping mapping_;
  std::span<const std::uint8_t> memory_;
  Profile profile_ = Profile::Signals;
  std::size_t slot_count_ = 0;
  std::size_t slot_bytes_ = 0;
  std::uint64_t publication_ = 0;  ///< that was read last; 0: none
  facet_ring_slot slot_{};         ///< its own, checked
  std::vector<std::uint64_t> head_;
  std::vector<std::uint64_t> coming_head_;  ///< not known to be whole
};

/// One word of memory that another process may be writing.
inline std::uint64_t load_word(const std::uint8_t* aligned) {
  // A lock-free load writes nothing, so that it may be of memory that can't be written.
  static_assert(std::atomic_ref<std::uint64_t>::is_always_lock_free);
  auto* word = const_cast<std::uint64_t*>(reinterpret_cast<const std::uint64_t*>(aligned));
  return std::atomic_ref<std::uint64_t>(*word).load(std::memory_order_relaxed);
}

/// Calls use(k, number k) for every number of a ring's array. T: std::int16_t or std::uint8_t, as
/// ring_layout.h says of that array.
template <typename T, typename Use>
void for_each_number(const RingArray& array, Use&& use) {
  constexpr std::size_t kPerWord = sizeof(std::uint64_t) / sizeof(T);
  const std::size_t whole = array.count / kPerWord * kPerWord;
  std::array<T, kPerWord> numbers;
  for (std::size_t k = 0; k < whole; k += kPerWord) {
    numbers = std::bit_cast<std::array<T, kPerWord>>(load_word(array.data + k * sizeof(T)));
    for (std::size_t i = 0; i < kPerWord; ++i) {
      use(k + i, numbers[i]);
    }
  }
  if (whole < array.count) {
    numbers = std::bit_cast<std::array<T, kPerWord>>(load_word(array.data + whole * sizeof(T)));
    for (std::size_t k = whole; k < array.count; ++k) {
      use(k, numbers[k - whole]);
    }
  }
}

}  // namespace facet::stream
