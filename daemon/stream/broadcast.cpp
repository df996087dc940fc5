#include "stream/broadcast.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <span>
#include <utility>

#include "facet/assert.hpp"
#include "facet/error.hpp"
#include "stream/framing.hpp"

namespace facet::stream {

Broadcast::Broadcast(const std::string& server, StreamStatistics& statistics, Calls calls)
    : statistics_(statistics), calls_(std::move(calls)) {
  Hello hello;
  hello.server = server;
  hello_ = packet(encoder_.hello(hello));
}

std::shared_ptr<const Packet> Broadcast::goodbye(const std::string& why) {
  return packet(encoder_.goodbye(why));
}

std::shared_ptr<const Packet> Broadcast::packet(std::span<const std::uint8_t> message) {
  auto free = std::find_if(pool_.begin(), pool_.end(),
                           [](const std::shared_ptr<Packet>& entry) { return entry.use_count() == 1; });
  if (free == pool_.end()) {
    free = pool_.insert(pool_.end(), std::make_shared<Packet>());
  }
  const auto header = make_header(message.size());
  std::vector<std::uint8_t>& bytes = (*free)->bytes;
  bytes.resize(kHeaderBytes + message.size());
  std::copy(header.begin(), header.end(), bytes.begin());
  std::copy(message.begin(), message.end(), bytes.begin() + kHeaderBytes);
  return *free;
}

void Broadcast::take(std::shared_ptr<const mesh::MeshFrame> frame, std::uint64_t number) {
  FACET_ASSERT(number > current_number_, number, current_number_);
  statistics_.skipped += number - current_number_ - 1;
  statistics_.published = number;
  current_number_ = number;
  current_ = std::move(frame);
  frame_packets_.clear();
  if (current_->subject == nullptr || !subject_fault(*current_->subject).empty()) {
    return;
  }
  // Takes come from elsewhere too: one may show another mesh under an id that is known.
  if (subject_ != current_->subject) {
    subject_ = current_->subject;
    encoder_.number_subject(++subject_number_);
    subject_packets_.fill(nullptr);
    albedo_ = nullptr;
    albedo_packet_ = nullptr;
  }
  if (current_->albedo != nullptr && (albedo_ == nullptr || albedo_->version != current_->albedo->version)) {
    albedo_ = current_->albedo;
    albedo_packet_ = nullptr;
  }
}

std::shared_ptr<const Packet> Broadcast::frame_packet(const Subscription& subscription) {
  FACET_ASSERT(current_ != nullptr, current_number_);
  WantedPixels pixels;
  if (subscription.want_images && current_->images != nullptr) {
    pixels = {true, subscription.longest_image_px};
  }
  const auto made = std::find_if(frame_packets_.begin(), frame_packets_.end(), [&](const FramePacket& one) {
    return one.profile == subscription.profile && one.pixels.any == pixels.any &&
           one.pixels.longest_px == pixels.longest_px;
  });
  if (made != frame_packets_.end()) {
    return made->packet;
  }
  auto message = packet(encoder_.frame(*current_, subscription.profile, pixels));
  statistics_.encoded_bytes += message->bytes.size();
  frame_packets_.push_back({subscription.profile, pixels, message});
  return message;
}

bool Broadcast::fill_ring(Profile profile) {
  Ring& ring = rings_.at(static_cast<std::size_t>(profile));
  if (ring.number == current_number_) {
    return true;
  }
  FACET_ASSERT(current_ != nullptr && ring.number < current_number_, ring.number, current_number_);
  const RingFrame frame = encoder_.ring_frame(*current_, profile);
  const std::size_t bytes = ring_slot_bytes(frame);
  if (!ring.writer || ring.writer->slot_bytes() < bytes) {
    try {
      // Readers keep the ring that they have: only ever larger by a quarter, rings can't pile up.
      ring.writer = RingWriter(profile, kRingSlots, bytes + bytes / 4);
      ring.generation = ++ring_generations_;
    } catch (const Error& error) {
      statistics_.last_refusal = fmt::format("frames go over the socket: {}", error.what());
      return false;
    }
  }
  FACET_ASSERT(bytes <= ring.writer->slot_bytes(), bytes, ring.writer->slot_bytes());
  ring.writer->write(current_number_, frame);
  ring.number = current_number_;
  statistics_.encoded_bytes += bytes;
  return true;
}

void Broadcast::announce(Reader& reader) {
  if (reader.last_number >= current_number_) {
    return;
  }
  FACET_ASSERT(reader.wake && reader.wake_far_end, reader.statistics.id, reader.ring_generation);
  const std::uint64_t missed = current_number_ - reader.last_number - 1;
  reader.last_number = current_number_;
  int unseen = 0;
  if (::ioctl(reader.wake_far_end.get(), FIONREAD, &unseen) == 0 && unseen > 0) {
    reader.statistics.frames_dropped += missed + 1;
  } else {
    const char wake_up = 1;
    [[maybe_unused]] const ssize_t ignored = ::write(reader.wake.get(), &wake_up, 1);
    reader.statistics.frames_dropped += missed;
    ++reader.statistics.frames_sent;
    calls_.used(reader);
  }
  // Readers of a ring see what they lost by the frames' numbers.
  reader.dropped_told = reader.statistics.frames_dropped;
}

void Broadcast::announce(const std::vector<std::unique_ptr<Reader>>& readers) {
  for (const std::unique_ptr<Reader>& reader : readers) {
    if (reader->by_ring() && reader->ring_generation != 0 && fill_ring(reader->subscription.profile) &&
        reader->ring_generation ==
            rings_.at(static_cast<std::size_t>(reader->subscription.profile)).generation) {
      announce(*reader);
    }
  }
}

std::shared_ptr<const Packet> Broadcast::ring_packet(Reader& reader) {
  const Ring& ring = rings_.at(static_cast<std::size_t>(reader.subscription.profile));
  FACET_ASSERT(ring.writer && ring.number == current_number_, ring.number, current_number_);
  if (reader.ring_generation == ring.generation) {
    announce(reader);
    return nullptr;
  }
  std::array<int, 2> ends{-1, -1};
  FileDescriptor memory(::fcntl(ring.writer->fd(), F_DUPFD_CLOEXEC, 0));
  if (!memory || ::pipe2(ends.data(), O_CLOEXEC | O_NONBLOCK) != 0) {
    calls_.refuse(reader, fmt::format("no file descriptor left for a ring: {}", std::strerror(errno)));
    return nullptr;
  }
  reader.wake_far_end.reset(ends[0]);
  reader.wake.reset(ends[1]);
  reader.passed.clear();
  reader.passed.push_back(std::move(memory));
  reader.passed.emplace_back(::fcntl(reader.wake_far_end.get(), F_DUPFD_CLOEXEC, 0));
  if (!reader.passed.back() || ++reader.ring_offers > kMaxRingOffers) {
    reader.passed.clear();
    calls_.refuse(reader,
                  fmt::format("no ring: descriptors used up, or more than {} asked for", kMaxRingOffers));
    return nullptr;
  }
  reader.ring_generation = ring.generation;
  announce(reader);
  return packet(encoder_.ring({FACET_RING_VERSION, ring.writer->bytes()}));
}

std::shared_ptr<const Packet> Broadcast::next_packet(Reader& reader) {
  reader.outgoing_is_frame = false;
  if (!reader.hello_sent) {
    reader.hello_sent = true;
    return hello_;
  }
  if (!reader.statistics.subscribed) {
    return nullptr;
  }
  const Profile profile = reader.subscription.profile;
  if (subject_ != nullptr && reader.subject_number != subject_number_) {
    reader.subject_number = subject_number_;
    reader.albedo_version = 0;
    auto& cached = subject_packets_[static_cast<std::size_t>(profile)];
    if (cached == nullptr) {
      FACET_ASSERT(subject_fault(*subject_).empty(), subject_number_);
      cached = packet(encoder_.subject(*subject_, profile));
    }
    return cached;
  }
  if (albedo_ != nullptr && profile != Profile::Signals && reader.subscription.want_albedo &&
      reader.albedo_version != albedo_->version) {
    reader.albedo_version = albedo_->version;
    if (albedo_packet_ == nullptr) {
      albedo_packet_ = packet(encoder_.albedo(subject_number_, *albedo_));
    }
    return albedo_packet_;
  }
  if (reader.by_ring() && current_number_ > 0) {
    if (fill_ring(profile)) {
      return ring_packet(reader);
    }
    reader.subscription.ring_version = 0;
    reader.statistics.ring = false;
  }
  if (reader.last_number >= current_number_) {
    return nullptr;
  }
  FACET_ASSERT(current_ != nullptr && reader.last_number < current_number_, reader.last_number,
               current_number_);
  const std::uint64_t missed = current_number_ - reader.last_number - 1;
  reader.last_number = current_number_ - 1;
  reader.dropped_since_frame += missed;
  reader.statistics.frames_dropped += missed;
  if (reader.statistics.frames_dropped != reader.dropped_told) {
    reader.dropped_told = reader.statistics.frames_dropped;
    return packet(encoder_.dropped({reader.dropped_since_frame, reader.statistics.frames_dropped}));
  }
  reader.last_number = current_number_;
  reader.dropped_since_frame = 0;
  reader.outgoing_is_frame = true;
  return frame_packet(reader.subscription);
}

}  // namespace facet::stream
