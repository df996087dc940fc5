#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <string>
#include <thread>

#include "facet/error.hpp"
#include "stream/decoder.hpp"
#include "stream/encoder.hpp"
#include "stream/ring.hpp"
#include "support/mesh_frames.hpp"
#include "support/source_folder.hpp"

namespace facet::stream {
namespace {

using testing::HasSubstr;

std::string rejection(const std::function<void()>& act) {
  try {
    act();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  return "";
}

/// A frame whose every number tells which one it is.
struct Numbered {
  explicit Numbered(std::size_t vertices) : head(40), vertices_mm(3 * vertices), confidence(vertices) {}

  const RingFrame& at(std::uint64_t number) {
    std::fill(head.begin(), head.end(), static_cast<std::uint8_t>(number * 7));
    std::fill(vertices_mm.begin(), vertices_mm.end(), static_cast<std::int16_t>(number));
    std::fill(confidence.begin(), confidence.end(), static_cast<std::uint8_t>(number >> 2));
    frame.head = head;
    frame.arrays[FACET_RING_VERTICES] = {reinterpret_cast<const std::uint8_t*>(vertices_mm.data()),
                                         vertices_mm.size() * sizeof(std::int16_t)};
    frame.arrays[FACET_RING_CONFIDENCE] = confidence;
    return frame;
  }

  std::vector<std::uint8_t> head;
  std::vector<std::int16_t> vertices_mm;
  std::vector<std::uint8_t> confidence;
  RingFrame frame;
};

/// Whether all that is read is of one frame.
bool is_whole(const RingReader& ring) {
  const std::uint64_t number = ring.number();
  bool same = true;
  for (const std::uint8_t byte : ring.head()) {
    same = same && byte == static_cast<std::uint8_t>(number * 7);
  }
  for_each_number<std::int16_t>(ring.array(FACET_RING_VERTICES), [&](std::size_t, std::int16_t value) {
    same = same && value == static_cast<std::int16_t>(number);
  });
  for_each_number<std::uint8_t>(ring.array(FACET_RING_CONFIDENCE), [&](std::size_t, std::uint8_t value) {
    same = same && value == static_cast<std::uint8_t>(number >> 2);
  });
  return same;
}

TEST(Ring, NewestFrameIsReadInPlace) {
  Numbered frames(1001);  // no whole number of words
  RingWriter writer(Profile::Vertices, 4, ring_slot_bytes(frames.at(0)));
  const FileDescriptor fd(::dup(writer.fd()));
  RingReader reader(fd);
  EXPECT_EQ(reader.profile(), Profile::Vertices);
  EXPECT_EQ(reader.newest(), RingReader::Outcome::NothingNew);
  for (std::uint64_t number = 10; number < 30; number += 2) {
    writer.write(number, frames.at(number));
    writer.write(number + 1, frames.at(number + 1));
    ASSERT_EQ(reader.newest(), RingReader::Outcome::Frame);
    EXPECT_EQ(reader.number(), number + 1);
    EXPECT_EQ(reader.head().size(), frames.head.size());
    EXPECT_EQ(reader.array(FACET_RING_VERTICES).count, 3003U);
    EXPECT_EQ(reader.array(FACET_RING_CONFIDENCE).count, 1001U);
    EXPECT_EQ(reader.array(FACET_RING_NORMALS).count, 0U);
    EXPECT_TRUE(is_whole(reader));
    EXPECT_TRUE(reader.intact());
    EXPECT_EQ(reader.newest(), RingReader::Outcome::NothingNew);
  }
}

TEST(Ring, AFrameStaysForOneRoundAndIsKnownToBeGoneThen) {
  Numbered frames(10);
  constexpr std::uint32_t kSlots = 5;
  RingWriter writer(Profile::Vertices, kSlots, ring_slot_bytes(frames.at(0)));
  RingReader reader(writer.memory());
  writer.write(1, frames.at(1));
  ASSERT_EQ(reader.newest(), RingReader::Outcome::Frame);
  for (std::uint64_t number = 2; number <= kSlots; ++number) {
    writer.write(number, frames.at(number));
    EXPECT_TRUE(reader.intact());
    EXPECT_TRUE(is_whole(reader));
  }
  writer.write(kSlots + 1, frames.at(kSlots + 1));
  EXPECT_FALSE(reader.intact());
  EXPECT_FALSE(is_whole(reader));
  EXPECT_EQ(reader.newest(), RingReader::Outcome::Frame);
  EXPECT_EQ(reader.number(), kSlots + 1);
}

// The writer goes round without a pause while readers read in place: what they take for whole is whole. In
// the same memory, so that the thread sanitizer sees both sides.
TEST(Ring, NothingTornIsAcceptedWhateverTheWritersSpeed) {
#ifdef FACET_SANITIZED
  constexpr std::uint64_t kReads = 1'000;
#else
  constexpr std::uint64_t kReads = 5'000;
#endif
  Numbered frames(200);
  // Three slots: a reader is lapped by the third frame after its own.
  RingWriter writer(Profile::Vertices, 3, ring_slot_bytes(frames.at(0)));
  writer.write(1, frames.at(1));
  std::atomic<bool> done{false};
  std::thread writing([&] {
    for (std::uint64_t number = 2; !done.load(); ++number) {
      writer.write(number, frames.at(number));
    }
  });
  struct Counts {
    std::uint64_t whole = 0;
    std::uint64_t refused = 0;
    std::uint64_t torn_accepted = 0;
    std::uint64_t torn_refused = 0;
  };
  std::array<Counts, 3> counts;
  std::atomic<bool> torn_seen{false};
  const auto patience = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  std::vector<std::thread> reading;
  for (Counts& mine : counts) {
    reading.emplace_back([&] {
      RingReader reader(writer.memory());
      // On and on until one was torn, which depends on who runs when.
      while (mine.whole + mine.refused < kReads || mine.whole == 0 ||
             (!torn_seen.load() && std::chrono::steady_clock::now() < patience)) {
        if (reader.newest() == RingReader::Outcome::NothingNew) {
          std::this_thread::yield();
          continue;
        }
        const bool whole = is_whole(reader);
        if (reader.intact()) {
          ++mine.whole;
          mine.torn_accepted += whole ? 0 : 1;
        } else {
          ++mine.refused;
          mine.torn_refused += whole ? 0 : 1;
          torn_seen.store(torn_seen.load() || !whole);
        }
      }
    });
  }
  for (std::thread& thread : reading) {
    thread.join();
  }
  done.store(true);
  writing.join();
  std::uint64_t torn_refused = 0;
  for (const Counts& mine : counts) {
    EXPECT_EQ(mine.torn_accepted, 0U);
    torn_refused += mine.torn_refused;
  }
  EXPECT_GT(torn_refused, 0U) << "no read was torn: the test has not tried what it is for";
}

TEST(Ring, ReadersCanNotWriteIt) {
  Numbered frames(10);
  RingWriter writer(Profile::Vertices, 2, ring_slot_bytes(frames.at(0)));
  const std::size_t bytes = writer.bytes();
  const FileDescriptor passed(::dup(writer.fd()));
  const FileDescriptor opened_anew(
      ::open(("/proc/self/fd/" + std::to_string(passed.get())).c_str(), O_RDWR | O_CLOEXEC));
  ASSERT_TRUE(opened_anew);
  for (const FileDescriptor* fd : {&passed, &opened_anew}) {
    EXPECT_EQ(::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd->get(), 0), MAP_FAILED);
    EXPECT_EQ(errno, EPERM);
    EXPECT_EQ(::pwrite(fd->get(), "x", 1, 0), -1);
    EXPECT_EQ(::ftruncate(fd->get(), 0), -1);
    EXPECT_EQ(::ftruncate(fd->get(), static_cast<off_t>(2 * bytes)), -1);
    EXPECT_EQ(::fallocate(fd->get(), FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, 0, 4096), -1);
    EXPECT_EQ(::fcntl(fd->get(), F_ADD_SEALS, F_SEAL_WRITE), -1);
    void* mapped = ::mmap(nullptr, bytes, PROT_READ, MAP_SHARED, fd->get(), 0);
    ASSERT_NE(mapped, MAP_FAILED);
    EXPECT_EQ(::mprotect(mapped, bytes, PROT_READ | PROT_WRITE), -1);
    ::munmap(mapped, bytes);
  }
  writer.write(1, frames.at(1));
  RingReader reader(passed);
  EXPECT_EQ(reader.newest(), RingReader::Outcome::Frame) << "the writer still can";
}

TEST(Ring, ForeignMemoryIsRefused) {
  const FileDescriptor unsealed(::memfd_create("unsealed", MFD_CLOEXEC));
  ASSERT_EQ(::ftruncate(unsealed.get(), 65536), 0);
  EXPECT_THAT(rejection([&] { RingReader reader(unsealed); }), HasSubstr("sealed"));
  int ends[2];
  ASSERT_EQ(::pipe(ends), 0);
  const FileDescriptor pipe(ends[0]);
  const FileDescriptor other_end(ends[1]);
  EXPECT_THAT(rejection([&] { RingReader reader(pipe); }), HasSubstr("sealed"));

  Numbered frames(10);
  RingWriter writer(Profile::Vertices, 2, ring_slot_bytes(frames.at(0)));
  std::vector<std::uint64_t> words(writer.bytes() / 8);
  std::memcpy(words.data(), writer.memory().data(), writer.bytes());
  const auto with = [&](std::size_t offset, auto value) {
    std::vector<std::uint64_t> changed = words;
    std::memcpy(reinterpret_cast<std::uint8_t*>(changed.data()) + offset, &value, sizeof(value));
    return rejection([&] {
      RingReader reader({reinterpret_cast<const std::uint8_t*>(changed.data()), writer.bytes()});
    });
  };
  EXPECT_EQ(with(offsetof(facet_ring_page, magic), std::uint32_t{FACET_RING_MAGIC}), "");
  EXPECT_THAT(with(offsetof(facet_ring_page, magic), std::uint32_t{1}), HasSubstr("no ring"));
  EXPECT_THAT(with(offsetof(facet_ring_page, version), std::uint32_t{2}), HasSubstr("version"));
  EXPECT_THAT(with(offsetof(facet_ring_page, slot_count), std::uint32_t{1}), HasSubstr("slots"));
  EXPECT_THAT(with(offsetof(facet_ring_page, slot_count), std::uint32_t{3}), HasSubstr("too small"));
  EXPECT_THAT(with(offsetof(facet_ring_page, slot_count), std::uint32_t{65}), HasSubstr("slots"));
  EXPECT_THAT(with(offsetof(facet_ring_page, profile), std::uint32_t{3}), HasSubstr("profile"));
  EXPECT_THAT(with(offsetof(facet_ring_page, slot_bytes), std::uint64_t{0}), HasSubstr("slot"));
  EXPECT_THAT(with(offsetof(facet_ring_page, slot_bytes), ~std::uint64_t{63}), HasSubstr("slot"));
}

TEST(Ring, MemoryIsMappedOnceItsSizeIsKnownToBeRight) {
  const auto refusal = [](std::uint32_t slot_count, std::uint64_t slot_bytes, off_t bytes) {
    const FileDescriptor memory(::memfd_create("ring", MFD_CLOEXEC | MFD_ALLOW_SEALING));
    facet_ring_page page{};
    page.magic = FACET_RING_MAGIC;
    page.version = FACET_RING_VERSION;
    page.slot_count = slot_count;
    page.slot_bytes = slot_bytes;
    EXPECT_EQ(::pwrite(memory.get(), &page, sizeof(page), 0), static_cast<ssize_t>(sizeof(page)));
    EXPECT_EQ(::ftruncate(memory.get(), bytes), 0);
    EXPECT_EQ(::fcntl(memory.get(), F_ADD_SEALS, F_SEAL_SHRINK), 0);
    const std::string why = rejection([&] { RingReader reader(memory); });
    struct stat status {};
    EXPECT_EQ(::fstat(memory.get(), &status), 0);
    EXPECT_LT(status.st_blocks * 512, 1 << 20) << "pages came to be by reading them";
    return why;
  };
  constexpr off_t kSparse = off_t{1} << 33;
  EXPECT_THAT(refusal(64, kMaxMessageBytes, kSparse), HasSubstr("not all there"));
  EXPECT_THAT(refusal(64, kMaxMessageBytes, 100'000), HasSubstr("too small"));
  EXPECT_THAT(refusal(65, kMaxMessageBytes, kSparse), HasSubstr("number of slots"));
  EXPECT_THAT(refusal(2, kMaxMessageBytes + 64, kSparse), HasSubstr("size of a slot"));
  EXPECT_THAT(refusal(0, 0, kSparse), HasSubstr("number of slots"));
}

TEST(Ring, AServerThatLiesAboutASlotIsRefused) {
  Numbered frames(10);
  RingWriter writer(Profile::Vertices, 2, ring_slot_bytes(frames.at(0)));
  writer.write(1, frames.at(1));
  std::vector<std::uint64_t> words(writer.bytes() / 8);
  std::memcpy(words.data(), writer.memory().data(), writer.bytes());
  auto* bytes = reinterpret_cast<std::uint8_t*>(words.data());
  const std::span<const std::uint8_t> memory(bytes, writer.bytes());
  {
    RingReader reader(memory);
    EXPECT_EQ(reader.newest(), RingReader::Outcome::Frame);
  }
  facet_ring_slot good{};
  std::memcpy(&good, bytes + FACET_RING_PAGE_BYTES, sizeof(good));
  const auto with = [&](const std::function<void(facet_ring_slot&)>& change) {
    facet_ring_slot changed = good;
    change(changed);
    std::memcpy(bytes + FACET_RING_PAGE_BYTES, &changed, sizeof(changed));
    return rejection([&] {
      RingReader reader(memory);
      reader.newest();
    });
  };
  EXPECT_THAT(with([](auto& slot) { slot.head_bytes = 0xFFFFFFFFU; }), HasSubstr("longer"));
  EXPECT_THAT(with([](auto& slot) { slot.arrays[FACET_RING_VERTICES].offset += 8; }), HasSubstr("array"));
  EXPECT_THAT(with([](auto& slot) { slot.arrays[FACET_RING_VERTICES].count = 0xFFFFFFFFU; }),
              HasSubstr("array"));
  EXPECT_THAT(with([](auto& slot) { slot.arrays[FACET_RING_NORMALS].count = 1; }), HasSubstr("array"));
  EXPECT_THAT(with([](auto& slot) { slot.arrays[FACET_RING_CONFIDENCE].offset = 0xFFFFFFC0U; }),
              HasSubstr("array"));
  // A sequence that never fits is no frame, not an endless loop.
  EXPECT_EQ(with([](auto& slot) { slot.sequence = 77; }), "");
}

// The same frame as a message and through a ring, every profile: the same numbers.
TEST(Ring, HoldsWhatTheMessageHolds) {
  const auto subject = test::patch_subject();
  const auto albedo = test::patch_albedo(*subject);
  for (const Profile profile : {Profile::Signals, Profile::Displacements, Profile::Vertices}) {
    Encoder encoder;
    const auto known = decode_subject(encoder.subject(*subject, profile));
    for (std::uint64_t sequence = 1; sequence <= 3; ++sequence) {
      const mesh::MeshFrame sent =
          sequence == 3 ? test::searching_frame(3) : test::patch_frame(sequence, subject, albedo);
      const RingFrame parts = encoder.ring_frame(sent, profile);
      RingWriter writer(profile, 2, ring_slot_bytes(parts));
      writer.write(sequence, parts);
      RingReader reader(writer.memory());
      ASSERT_EQ(reader.newest(), RingReader::Outcome::Frame);
      EXPECT_LT(reader.head().size(), 8192U) << "the long vectors lie beside it";
      DecodedFrame by_ring;
      decode_frame(reader, sequence == 3 ? nullptr : known, nullptr, by_ring);
      DecodedFrame by_message;
      decode_frame(encoder.frame(sent, profile), sequence == 3 ? nullptr : known, nullptr, by_message);
      EXPECT_EQ(by_ring.frame.sequence, sequence);
      EXPECT_EQ(by_ring.frame.control_vertices_mm, by_message.frame.control_vertices_mm);
      EXPECT_EQ(by_ring.frame.displacements_mm, by_message.frame.displacements_mm);
      EXPECT_EQ(by_ring.frame.confidence, by_message.frame.confidence);
      EXPECT_EQ(by_ring.vertices_mm, by_message.vertices_mm);
      EXPECT_EQ(by_ring.normals, by_message.normals);
      EXPECT_EQ(by_ring.frame.expression, by_message.frame.expression);
      EXPECT_EQ(by_ring.frame.landmarks_px, by_message.frame.landmarks_px);
      EXPECT_EQ(by_ring.frame.displacements_mm.empty(), profile != Profile::Displacements || sequence == 3);
      EXPECT_EQ(by_ring.vertices_mm.cols() == 0, profile != Profile::Vertices || sequence == 3);
    }
  }
}

// The seed of fuzz_stream_ring: a ring of two small slots with one frame. FACET_WRITE_GOLDEN=1 writes it
// anew.
TEST(Ring, SeedOfTheFuzzerIsARing) {
  const std::filesystem::path seed =
      std::filesystem::path(FACET_SOURCE_DIR) / "tests/fuzz/corpus/stream_ring/displacements";
  const auto subject = test::patch_subject(5, 3, 1);
  if (std::getenv("FACET_WRITE_GOLDEN") != nullptr) {
    Encoder encoder;
    const RingFrame parts =
        encoder.ring_frame(test::patch_frame(1, subject, nullptr), Profile::Displacements);
    RingWriter writer(Profile::Displacements, 2, ring_slot_bytes(parts));
    writer.write(1, parts);
    const auto* memory = reinterpret_cast<const char*>(writer.memory().data());
    std::filesystem::create_directories(seed.parent_path());
    std::ofstream(seed, std::ios::binary)
        .write(memory, sizeof(facet_ring_page))
        .write(memory + FACET_RING_PAGE_BYTES,
               static_cast<std::streamsize>(writer.bytes() - FACET_RING_PAGE_BYTES));
  }
  std::ifstream file(seed, std::ios::binary);
  const std::vector<char> bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  ASSERT_GT(bytes.size(), sizeof(facet_ring_page));
  std::vector<std::uint64_t> words((FACET_RING_PAGE_BYTES + bytes.size()) / 8 + 1);
  auto* memory = reinterpret_cast<std::uint8_t*>(words.data());
  std::memcpy(memory, bytes.data(), sizeof(facet_ring_page));
  std::memcpy(memory + FACET_RING_PAGE_BYTES, bytes.data() + sizeof(facet_ring_page),
              bytes.size() - sizeof(facet_ring_page));
  RingReader reader({memory, FACET_RING_PAGE_BYTES + bytes.size() - sizeof(facet_ring_page)});
  ASSERT_EQ(reader.newest(), RingReader::Outcome::Frame);
  DecodedFrame out;
  decode_frame(reader, subject, nullptr, out);
  EXPECT_EQ(out.frame.sequence, 1U);
}

}  // namespace
}  // namespace facet::stream
