#include "sound/sound_file.hpp"

#include <fmt/format.h>
#include <pthread.h>
#include <sys/statvfs.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <deque>
#include <optional>
#include <thread>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "files/disk.hpp"
#include "files/output_file.hpp"
#include "sound/flac_file.hpp"

namespace facet::sound {
namespace {

constexpr auto kSyncPeriod = std::chrono::seconds(1);
constexpr std::int64_t kMostWaiting_s = 20;
constexpr std::int64_t kSilentPiece = 4096;

/// A piece of the queue: samples, or so many of silence.
struct Piece {
  std::vector<std::int32_t> samples;
  std::int64_t silent = 0;
};

}  // namespace

struct SoundFile::Impl {
  SoundFileConfig config;
  files::DiskFile file;
  int write_error = 0;  ///< of the disk; facet-flac only, once started
  std::optional<FlacEncoder> encoder;
  Clock::time_point sync_due;

  mutable Mutex mutex;
  Condition woken;
  std::deque<Piece> waiting FACET_GUARDED_BY(mutex);
  std::int64_t waiting_samples FACET_GUARDED_BY(mutex) = 0;
  bool stopping FACET_GUARDED_BY(mutex) = false;
  SoundFileStatus shown FACET_GUARDED_BY(mutex);
  std::atomic<bool> ended{true};
  std::jthread thread;

  std::size_t channels() const { return static_cast<std::size_t>(config.format.channels); }
  std::int64_t length(const Piece& piece) const {
    return piece.silent + static_cast<std::int64_t>(piece.samples.size() / channels());
  }
  void push(Piece piece);
  std::optional<Piece> next();
  bool encode(const Piece& piece);
  std::string disk_fault() const;
  bool sync();
  void fail(std::string reason);
  void run();
};

void SoundFile::Impl::push(Piece piece) {
  const Lock lock(mutex);
  if (stopping) {
    return;
  }
  const std::int64_t samples = length(piece);
  shown.samples += samples;
  if (waiting_samples + samples > kMostWaiting_s * config.format.rate_hz && !piece.samples.empty()) {
    shown.lost += samples;
    piece = {{}, samples};
  }
  // Silence that waits takes no room.
  waiting_samples += piece.silent > 0 ? 0 : samples;
  if (piece.silent > 0 && !waiting.empty() && waiting.back().silent > 0) {
    waiting.back().silent += piece.silent;
  } else {
    waiting.push_back(std::move(piece));
  }
  woken.notify_one();
}

/// Nothing at the end.
std::optional<Piece> SoundFile::Impl::next() {
  const Lock lock(mutex);
  woken.wait(mutex, [this]() FACET_REQUIRES(mutex) { return stopping || !waiting.empty(); });
  if (waiting.empty()) {
    return std::nullopt;
  }
  Piece piece = std::move(waiting.front());
  waiting.pop_front();
  waiting_samples -= piece.silent > 0 ? 0 : length(piece);
  return piece;
}

bool SoundFile::Impl::encode(const Piece& piece) {
  std::vector<std::int32_t> silence;
  for (std::int64_t left = piece.silent; left > 0; left -= kSilentPiece) {
    silence.assign(static_cast<std::size_t>(std::min(left, kSilentPiece)) * channels(), 0);
    if (!encoder->add(silence)) {
      return false;
    }
  }
  return piece.samples.empty() || encoder->add(piece.samples);
}

std::string SoundFile::Impl::disk_fault() const {
  return fmt::format("'{}' can't be written: {}", config.file.string(), std::strerror(write_error));
}

/// False where it failed, or the disk's reserve is touched.
bool SoundFile::Impl::sync() {
  if (files::disk().sync_data(file.get()) != 0) {
    write_error = errno;
    fail(disk_fault());
    return false;
  }
  struct statvfs disk {};
  const bool known = ::statvfs(config.file.c_str(), &disk) == 0;
  const std::uint64_t free_bytes = static_cast<std::uint64_t>(disk.f_bavail) * disk.f_frsize;
  if (known && free_bytes < config.disk_reserve_bytes) {
    fail(fmt::format("disk nearly full: {} MiB are free, {} MiB are kept in reserve", free_bytes >> 20,
                     config.disk_reserve_bytes >> 20));
    return false;
  }
  sync_due = Clock::now() + kSyncPeriod;
  return true;
}

void SoundFile::Impl::fail(std::string reason) {
  const Lock lock(mutex);
  if (shown.reason.empty()) {
    shown.reason = std::move(reason);
  }
  stopping = true;
  for (const Piece& piece : waiting) {
    shown.samples -= length(piece);
  }
  waiting.clear();
}

void SoundFile::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-flac");
  try {
    files::sync_folder(config.file.parent_path());
    sync_due = Clock::now() + kSyncPeriod;
    while (const auto piece = next()) {
      if (!encode(*piece)) {
        fail(disk_fault());
        break;
      }
      if (Clock::now() >= sync_due && !sync()) {
        break;
      }
    }
  } catch (const std::exception& error) {
    fail(error.what());
  }
  encoder->finish();
  if (write_error == 0 && files::disk().sync_data(file.get()) != 0) {
    write_error = errno;
  }
  if (write_error != 0) {
    fail(disk_fault());
  }
  ended = true;
}

SoundFile::SoundFile(const SoundFileConfig& config) : impl_(std::make_unique<Impl>()) {
  Impl& impl = *impl_;
  impl.config = config;
  impl.file = files::DiskFile::create(config.file, 0644);
  if (!impl.file) {
    throw Error(ErrorKind::Storage,
                fmt::format("cannot create '{}': {}", config.file.string(), std::strerror(errno)));
  }
  impl.encoder.emplace(config.format, [&impl](std::span<const std::byte> bytes, std::uint64_t position) {
    const bool written = impl.file.write(bytes, position);
    impl.write_error = written ? impl.write_error : errno;
    return written;
  });
}

SoundFile::~SoundFile() {
  stop();
}

void SoundFile::start() {
  impl_->ended = false;
  try {
    impl_->thread = std::jthread([this] { impl_->run(); });
  } catch (...) {
    impl_->ended = true;
    throw;
  }
}

bool SoundFile::ended() const {
  return impl_->ended;
}

void SoundFile::add(std::vector<std::int32_t> samples) {
  if (!samples.empty()) {
    impl_->push({std::move(samples), 0});
  }
}

void SoundFile::add_silence(std::int64_t samples) {
  if (samples > 0) {
    impl_->push({{}, samples});
  }
}

void SoundFile::request_stop(std::string reason) {
  const Lock lock(impl_->mutex);
  if (!std::exchange(impl_->stopping, true)) {
    impl_->shown.reason = std::move(reason);
  }
  impl_->woken.notify_all();
}

SoundFileStatus SoundFile::stop() {
  request_stop();
  if (impl_->thread.joinable()) {
    impl_->thread.join();
  }
  return status();
}

SoundFileStatus SoundFile::status() const {
  const Lock lock(impl_->mutex);
  return impl_->shown;
}

}  // namespace facet::sound
