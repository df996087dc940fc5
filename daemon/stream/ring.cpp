#include "stream/ring.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>
#include <utility>

#include "facet/assert.hpp"
#include "facet/error.hpp"

namespace facet::stream {
namespace {

// The layout's numbers lie as this machine has them in memory.
static_assert(std::endian::native == std::endian::little);

constexpr std::size_t kWordBytes = sizeof(std::uint64_t);
constexpr std::size_t kSlotWords = sizeof(facet_ring_slot) / kWordBytes;
constexpr std::array<std::size_t, FACET_RING_ARRAY_COUNT> kNumberBytes = {2, 2, 2, 2, 1};
/// A writer that laps a reader so often in a row is left alone until its next wake-up.
constexpr int kAttempts = 64;

std::size_t aligned(std::size_t bytes) {
  return (bytes + FACET_RING_ALIGNMENT - 1) / FACET_RING_ALIGNMENT * FACET_RING_ALIGNMENT;
}

[[noreturn]] void fail(const char* what) {
  throw Error(ErrorKind::Internal, fmt::format("ring: {}: {}", what, std::strerror(errno)));
}

void require(bool holds, const char* what) {
  if (!holds) {
    throw Error(ErrorKind::UnreadableInput, std::string("damaged or foreign ring: ") + what);
  }
}

std::atomic_ref<std::uint64_t> word_at(std::uint8_t* memory) {
  return std::atomic_ref<std::uint64_t>(*reinterpret_cast<std::uint64_t*>(memory));
}

/// Relaxed stores of whole words; the last one is filled up with zeros.
void store_words(std::uint8_t* out, std::span<const std::uint8_t> bytes) {
  const std::size_t whole = bytes.size() / kWordBytes * kWordBytes;
  std::uint64_t word = 0;
  for (std::size_t k = 0; k < whole; k += kWordBytes) {
    std::memcpy(&word, bytes.data() + k, kWordBytes);
    word_at(out + k).store(word, std::memory_order_relaxed);
  }
  if (whole < bytes.size()) {
    word = 0;
    std::memcpy(&word, bytes.data() + whole, bytes.size() - whole);
    word_at(out + whole).store(word, std::memory_order_relaxed);
  }
}

/// What another process may be writing; ordered by the fences that follow.
std::uint64_t load_acquire(const std::uint8_t* memory) {
  const std::uint64_t value = load_word(memory);
  std::atomic_thread_fence(std::memory_order_acquire);
  return value;
}

}  // namespace

std::size_t ring_slot_bytes(const RingFrame& frame) {
  std::size_t bytes = aligned(sizeof(facet_ring_slot) + frame.head.size());
  for (const auto& array : frame.arrays) {
    bytes += aligned(array.size());
  }
  return bytes;
}

Mapping::Mapping(int fd, std::size_t bytes, bool writable) {
  // A writer makes its pages at once; a reader's are there already.
  void* memory = ::mmap(nullptr, bytes, writable ? PROT_READ | PROT_WRITE : PROT_READ,
                        writable ? MAP_SHARED | MAP_POPULATE : MAP_SHARED, fd, 0);
  if (memory == MAP_FAILED) {
    fail("mmap");
  }
  bytes_ = {static_cast<std::uint8_t*>(memory), bytes};
}

Mapping::~Mapping() {
  if (!bytes_.empty()) {
    ::munmap(bytes_.data(), bytes_.size());
  }
}

RingWriter::RingWriter(Profile profile, std::uint32_t slot_count, std::size_t slot_bytes)
    : memory_(::memfd_create("facet-ring", MFD_CLOEXEC | MFD_ALLOW_SEALING)),
      slot_count_(slot_count),
      slot_bytes_(aligned(slot_bytes)) {
  FACET_ASSERT(slot_count_ >= 2 && slot_count_ <= FACET_RING_MAX_SLOTS, slot_count_);
  if (!memory_) {
    fail("memfd_create");
  }
  const std::size_t bytes = FACET_RING_PAGE_BYTES + slot_count_ * slot_bytes_;
  // Pages that are not there when memory runs out would be a SIGBUS in the middle of a frame.
  if (const int error = ::posix_fallocate(memory_.get(), 0, static_cast<off_t>(bytes)); error != 0) {
    errno = error;
    fail("no memory for it");
  }
  mapping_ = Mapping(memory_.get(), bytes, true);
  facet_ring_page page{};
  page.magic = FACET_RING_MAGIC;
  page.version = FACET_RING_VERSION;
  page.slot_count = slot_count;
  page.profile = static_cast<std::uint32_t>(profile);
  page.slot_bytes = slot_bytes_;
  std::memcpy(mapping_.bytes().data(), &page, sizeof(page));
  // From here on the memory can be written through the mapping above alone.
  if (::fcntl(memory_.get(), F_ADD_SEALS, F_SEAL_FUTURE_WRITE | F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) !=
      0) {
    fail("seals");
  }
}

// [Boe12]: a store of the odd sequence,
// a release fence, relaxed stores of the data, a release store of the even sequence.
void RingWriter::write(std::uint64_t number, const RingFrame& frame) {
  FACET_ASSERT(ring_slot_bytes(frame) <= slot_bytes_, ring_slot_bytes(frame), slot_bytes_);
  FACET_ASSERT(FACET_RING_PAGE_BYTES + slot_count_ * slot_bytes_ <= mapping_.bytes().size(), slot_count_,
               slot_bytes_, mapping_.bytes().size());
  const std::uint64_t publication = published_ + 1;
  std::uint8_t* slot =
      mapping_.bytes().data() + FACET_RING_PAGE_BYTES + (publication - 1) % slot_count_ * slot_bytes_;
  word_at(slot).store(2 * publication - 1, std::memory_order_relaxed);
  std::atomic_thread_fence(std::memory_order_release);

  facet_ring_slot header{};
  header.number = number;
  header.head_bytes = static_cast<std::uint32_t>(frame.head.size());
  std::size_t offset = aligned(sizeof(header) + frame.head.size());
  for (std::size_t which = 0; which < frame.arrays.size(); ++which) {
    const auto& array = frame.arrays.at(which);
    if (!array.empty()) {
      header.arrays[which] = {static_cast<std::uint32_t>(offset),
                              static_cast<std::uint32_t>(array.size() / kNumberBytes.at(which))};
      store_words(slot + offset, array);
      offset += aligned(array.size());
    }
  }
  FACET_ASSERT(offset <= slot_bytes_, offset, slot_bytes_);
  store_words(slot + sizeof(header), frame.head);
  const auto words = std::bit_cast<std::array<std::uint8_t, sizeof(header)>>(header);
  store_words(slot + kWordBytes, std::span(words).subspan(kWordBytes));

  word_at(slot).store(2 * publication, std::memory_order_release);
  published_ = publication;
  word_at(mapping_.bytes().data() + offsetof(facet_ring_page, published))
      .store(publication, std::memory_order_release);
}

RingReader::RingReader(const FileDescriptor& fd) {
  struct stat status {};
  const int seals = ::fcntl(fd.get(), F_GET_SEALS);
  // Memory that its owner may shorten kills its readers (SIGBUS).
  require(seals >= 0 && (seals & F_SEAL_SHRINK) != 0 && ::fstat(fd.get(), &status) == 0,
          "its memory is not sealed");
  // The page first: no more is mapped than it says, and it may not say more than the limits.
  facet_ring_page page{};
  constexpr std::size_t kFixed = offsetof(facet_ring_page, published);
  require(::pread(fd.get(), &page, kFixed, 0) == static_cast<ssize_t>(kFixed), "it is too small");
  const std::size_t bytes = check(page);
  require(std::cmp_greater_equal(status.st_size, bytes), "it is too small");
  // What is not there yet would become this process's memory when it is read.
  constexpr std::uint64_t kBlockBytes = 512;
  require(static_cast<std::uint64_t>(status.st_blocks) * kBlockBytes >= bytes, "its memory is not all there");
  mapping_ = Mapping(fd.get(), bytes, false);
  memory_ = mapping_.bytes();
}

RingReader::RingReader(std::span<const std::uint8_t> memory) {
  require(memory.size() >= FACET_RING_PAGE_BYTES, "it is too small");
  facet_ring_page page{};
  std::memcpy(&page, memory.data(), offsetof(facet_ring_page, published));
  require(memory.size() >= check(page), "it is too small");
  memory_ = memory;
}

std::size_t RingReader::check(const facet_ring_page& page) {
  require(page.magic == FACET_RING_MAGIC, "no ring");
  require(page.version == FACET_RING_VERSION, "another version");
  require(page.slot_count >= 2 && page.slot_count <= FACET_RING_MAX_SLOTS, "number of slots");
  require(page.slot_bytes >= sizeof(facet_ring_slot) && page.slot_bytes % FACET_RING_ALIGNMENT == 0 &&
              page.slot_bytes <= kMaxMessageBytes,
          "size of a slot");
  require(page.profile < kProfileCount, "profile");
  profile_ = static_cast<Profile>(page.profile);
  slot_count_ = page.slot_count;
  slot_bytes_ = page.slot_bytes;
  return FACET_RING_PAGE_BYTES + slot_count_ * slot_bytes_;
}

const std::uint8_t* RingReader::slot_of(std::uint64_t publication) const {
  FACET_ASSERT(publication > 0 && slot_count_ > 0, publication, slot_count_);
  return memory_.data() + FACET_RING_PAGE_BYTES + (publication - 1) % slot_count_ * slot_bytes_;
}

RingReader::Outcome RingReader::newest() {
  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    const std::uint64_t publication = load_acquire(memory_.data() + offsetof(facet_ring_page, published));
    if (publication == publication_ || publication == 0) {
      return Outcome::NothingNew;
    }
    const std::uint8_t* slot = slot_of(publication);
    std::array<std::uint64_t, kSlotWords> words{};
    words[0] = load_acquire(slot);
    if (words[0] != 2 * publication) {
      continue;
    }
    for (std::size_t k = 1; k < kSlotWords; ++k) {
      words.at(k) = load_word(slot + k * kWordBytes);
    }
    const auto header = std::bit_cast<facet_ring_slot>(words);
    // Not known to be whole yet: no more is believed of it than that it stays inside the slot.
    const std::size_t head_bytes = std::min<std::size_t>(header.head_bytes, slot_bytes_ - sizeof(header));
    coming_head_.resize((head_bytes + kWordBytes - 1) / kWordBytes);
    for (std::size_t k = 0; k < coming_head_.size(); ++k) {
      coming_head_[k] = load_word(slot + sizeof(header) + k * kWordBytes);
    }
    std::atomic_thread_fence(std::memory_order_acquire);
    if (load_word(slot) != 2 * publication) {
      continue;
    }
    require(head_bytes == header.head_bytes, "a frame is longer than its slot");
    for (std::size_t which = 0; which < FACET_RING_ARRAY_COUNT; ++which) {
      const facet_ring_array& array = header.arrays[which];
      require(array.offset % FACET_RING_ALIGNMENT == 0 && (array.offset == 0) == (array.count == 0) &&
                  array.offset + array.count * kNumberBytes.at(which) <= slot_bytes_,
              "an array lies outside of its slot");
    }
    publication_ = publication;
    slot_ = header;
    head_.swap(coming_head_);
    return Outcome::Frame;
  }
  return Outcome::NothingNew;
}

std::span<const std::uint8_t> RingReader::head() const {
  return {reinterpret_cast<const std::uint8_t*>(head_.data()), slot_.head_bytes};
}

RingArray RingReader::array(std::size_t which) const {
  const facet_ring_array& array = slot_.arrays[which];
  return array.offset == 0 ? RingArray{} : RingArray{slot_of(publication_) + array.offset, array.count};
}

bool RingReader::intact() const {
  std::atomic_thread_fence(std::memory_order_acquire);
  return load_word(slot_of(publication_)) == 2 * publication_;
}

}  // namespace facet::stream
