#include "camera/libcamera_camera.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <libcamera/camera.h>
#include <libcamera/camera_manager.h>
#include <libcamera/control_ids.h>
#include <libcamera/formats.h>
#include <libcamera/framebuffer_allocator.h>
#include <libcamera/property_ids.h>
#include <libcamera/request.h>
#include <linux/dma-buf.h>
#include <sys/ioctl.h>
#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include "camera/device_fault.hpp"
#include "camera/driver_count.hpp"
#include "camera/jpeg_decoder.hpp"
#include "camera/libcamera_controls.hpp"
#include "camera/pixel_buffers.hpp"
#include "camera/pixel_conversion.hpp"
#include "facet/clock.hpp"
#include "facet/mutex.hpp"

namespace facet::camera {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;

[[noreturn]] void fail(DeviceFault::Kind kind, const std::string& what) {
  throw DeviceFault(kind, what);
}

/// Calls of libcamera return minus an errno.
void demand(int result, const char* what) {
  if (result == -EBUSY) {
    fail(DeviceFault::Kind::Failing, "is in use by another program");
  }
  if (result == -ENODEV) {
    fail(DeviceFault::Kind::Absent, fmt::format("no such device ({})", what));
  }
  if (result < 0) {
    fail(DeviceFault::Kind::Failing, fmt::format("{}: {}", what, std::strerror(-result)));
  }
}

/// Formats in the order in which "auto" takes them. libcamera names colours by their place in a little-endian
/// word, so RGB888 has blue first in memory.
struct KnownFormat {
  libcamera::PixelFormat format;
  const char* name;                   ///< one of kLibcameraFormats
  std::optional<PixelLayout> layout;  ///< none: JPEG
};
constexpr std::array kKnownFormats = {
    KnownFormat{libcamera::formats::YUYV, "YUYV", PixelLayout::Yuyv},
    KnownFormat{libcamera::formats::NV12, "NV12", PixelLayout::Nv12},
    KnownFormat{libcamera::formats::BGR888, "RGB", PixelLayout::Rgb},
    KnownFormat{libcamera::formats::RGB888, "RGB", PixelLayout::Bgr},
    KnownFormat{libcamera::formats::XBGR8888, "RGB", PixelLayout::Rgbx},
    KnownFormat{libcamera::formats::XRGB8888, "RGB", PixelLayout::Bgrx},
    KnownFormat{libcamera::formats::ABGR8888, "RGB", PixelLayout::Rgbx},
    KnownFormat{libcamera::formats::ARGB8888, "RGB", PixelLayout::Bgrx},
    KnownFormat{libcamera::formats::MJPEG, "MJPEG", std::nullopt},
    KnownFormat{libcamera::formats::R8, "GREY", PixelLayout::Grey},
    KnownFormat{libcamera::formats::R10, "Y10", PixelLayout::Y10},
};

const KnownFormat* find_format(const libcamera::PixelFormat& format) {
  const auto* found = std::find_if(kKnownFormats.begin(), kKnownFormats.end(),
                                   [&](const KnownFormat& known) { return known.format == format; });
  return found == kKnownFormats.end() ? nullptr : found;
}

ColourCoding colour_coding(const libcamera::StreamConfiguration& stream, bool grey) {
  ColourCoding coding;
  coding.full_range = grey;
  if (stream.colorSpace) {
    using Encoding = libcamera::ColorSpace::YcbcrEncoding;
    if (stream.colorSpace->ycbcrEncoding == Encoding::Rec709) {
      coding.red_share = 0.2126;
      coding.blue_share = 0.0722;
    } else if (stream.colorSpace->ycbcrEncoding == Encoding::Rec2020) {
      coding.red_share = 0.2627;
      coding.blue_share = 0.0593;
    }
    coding.full_range = grey || stream.colorSpace->range == libcamera::ColorSpace::Range::Full;
  }
  return coding;
}

std::string describe_formats(const libcamera::StreamFormats& formats) {
  std::vector<std::string> parts;
  std::vector<std::string> unread;
  for (const libcamera::PixelFormat& format : formats.pixelformats()) {
    const KnownFormat* known = find_format(format);
    if (known == nullptr) {
      unread.push_back(format.toString());
      continue;
    }
    std::vector<std::string> sizes;
    for (const libcamera::Size& size : formats.sizes(format)) {
      sizes.push_back(size.toString());
    }
    if (sizes.empty()) {
      const libcamera::SizeRange range = formats.range(format);
      sizes.push_back(fmt::format("{} to {}", range.min.toString(), range.max.toString()));
    }
    parts.push_back(fmt::format("{} {}", known->name, fmt::join(sizes, ", ")));
  }
  if (!unread.empty()) {
    parts.push_back(fmt::format("{}, which Facet does not read", fmt::join(unread, ", ")));
  }
  return parts.empty() ? "no format" : fmt::format("{}", fmt::join(parts, "; "));
}

std::unique_ptr<libcamera::CameraManager> start_manager() {
  auto manager = std::make_unique<libcamera::CameraManager>();
  demand(manager->start(), "libcamera does not start");
  return manager;
}

std::unique_ptr<libcamera::CameraConfiguration> generate(libcamera::Camera& camera) {
  auto generated = camera.generateConfiguration({libcamera::StreamRole::VideoRecording});
  if (generated == nullptr || generated->empty()) {
    fail(DeviceFault::Kind::Failing, "has no stream for video");
  }
  return generated;
}

std::string name_of(const libcamera::Camera& camera) {
  const auto model = camera.properties().get(libcamera::properties::Model);
  return model ? fmt::format("{} ({})", camera.id(), *model) : camera.id();
}

/// What a buffer of a camera holds, readable while this lives.
class MappedBuffer {
 public:
  explicit MappedBuffer(const libcamera::FrameBuffer& buffer) {
    // Planes often lie in one file.
    std::map<int, std::size_t> lengths;
    for (const libcamera::FrameBuffer::Plane& plane : buffer.planes()) {
      std::size_t& length = lengths[plane.fd.get()];
      length = std::max<std::size_t>(length, std::size_t{plane.offset} + plane.length);
    }
    for (const auto& [fd, length] : lengths) {
      void* start = ::mmap(nullptr, length, PROT_READ, MAP_SHARED, fd, 0);
      if (start == MAP_FAILED) {
        fail(DeviceFault::Kind::Failing, fmt::format("mmap: {}", std::strerror(errno)));
      }
      mappings_.push_back({fd, static_cast<std::uint8_t*>(start), length});
    }
    for (const libcamera::FrameBuffer::Plane& plane : buffer.planes()) {
      const auto at = std::find_if(mappings_.begin(), mappings_.end(),
                                   [&](const Mapping& mapping) { return mapping.fd == plane.fd.get(); });
      planes_.emplace_back(at->start + plane.offset, plane.length);
    }
  }
  ~MappedBuffer() {
    for (const Mapping& mapping : mappings_) {
      ::munmap(mapping.start, mapping.length);
    }
  }
  MappedBuffer(const MappedBuffer&) = delete;
  MappedBuffer& operator=(const MappedBuffer&) = delete;

  const std::vector<std::span<const std::uint8_t>>& planes() const { return planes_; }

  /// Before and after reading: the memory may not be coherent with the processor's caches.
  void begin_reading() const { synchronise(DMA_BUF_SYNC_START); }
  void end_reading() const { synchronise(DMA_BUF_SYNC_END); }

 private:
  struct Mapping {
    int fd;
    std::uint8_t* start;
    std::size_t length;
  };

  void synchronise(std::uint64_t phase) const {
    for (const Mapping& mapping : mappings_) {
      dma_buf_sync sync{phase | DMA_BUF_SYNC_READ};
      ::ioctl(mapping.fd, DMA_BUF_IOCTL_SYNC, &sync);  // refused by what is no DMA buffer, and needs none
    }
  }

  std::vector<Mapping> mappings_;
  std::vector<std::span<const std::uint8_t>> planes_;
};

class LibcameraCamera final : public Camera {
 public:
  explicit LibcameraCamera(const CameraConfig& config);
  ~LibcameraCamera() override;

  CameraInfo info() const override { return info_; }
  CameraStatus status() const override;
  void start() override;
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override;
  void stop() override;
  std::string last_error() const override;

 private:
  /// A completed request and what was found of it.
  struct Arrived {
    libcamera::Request* request = nullptr;
    std::uint64_t sequence = 0;
    std::int64_t timestamp_ns = 0;
    bool damaged = false;
    bool dated = false;
  };

  void find_camera();
  void choose_format();
  void queue_requests();
  void on_completed(libcamera::Request* request);
  void on_disconnected();
  std::vector<libcamera::Request*> wait_completed(std::chrono::milliseconds timeout);
  std::optional<Arrived> examine(libcamera::Request& request);
  bool convert(const Arrived& arrived, Frame& out);
  bool convert_pixels(const MappedBuffer& buffer, std::span<const libcamera::FrameMetadata::Plane> planes,
                      std::uint8_t* rgba, std::size_t stride_bytes, bool& damaged);
  void requeue(libcamera::Request& request);
  void count(std::uint64_t CameraCounters::*which, std::uint64_t how_many = 1);
  void set_state(CameraState state, const std::string& reason);

  CameraConfig config_;
  CameraInfo info_;
  DriverCount count_;
  std::unique_ptr<libcamera::CameraManager> manager_;
  std::shared_ptr<libcamera::Camera> camera_;
  std::unique_ptr<libcamera::CameraConfiguration> stream_config_;
  const KnownFormat* format_ = nullptr;
  std::unique_ptr<libcamera::FrameBufferAllocator> allocator_;
  std::map<const libcamera::FrameBuffer*, std::unique_ptr<MappedBuffer>> mapped_;
  std::vector<std::unique_ptr<libcamera::Request>> requests_;
  JpegDecoder jpeg_;
  std::shared_ptr<PixelBuffers> pool_ = std::make_shared<PixelBuffers>();
  std::int64_t started_ns_ = 0;
  std::int64_t timestamp_ns_ = 0;  ///< of the newest delivered frame
  std::int64_t first_timestamp_ns_ = 0;
  bool running_ = false;

  // Between libcamera's thread and the one that calls next.
  mutable Mutex mutex_;
  Condition changed_;
  std::vector<libcamera::Request*> completed_ FACET_GUARDED_BY(mutex_);
  CameraStatus status_ FACET_GUARDED_BY(mutex_);
};

LibcameraCamera::LibcameraCamera(const CameraConfig& config)
    : config_(config),
      count_(std::llround(static_cast<double>(kSecond_ns) / config.live.rate_hz)),
      manager_(start_manager()) {
  find_camera();
  demand(camera_->acquire(), "acquire");
  try {
    choose_format();
    make_controls(config_, camera_->controls());
  } catch (...) {
    camera_->release();
    throw;
  }
  info_.name = name_of(*camera_);
  info_.width_px = config.live.width_px;
  info_.height_px = config.live.height_px;
  info_.rate_hz = config.live.rate_hz;
  info_.live = true;
  camera_->requestCompleted.connect(this, &LibcameraCamera::on_completed);
  camera_->disconnected.connect(this, &LibcameraCamera::on_disconnected);
}

LibcameraCamera::~LibcameraCamera() {
  stop();
  camera_->requestCompleted.disconnect(this);
  camera_->disconnected.disconnect(this);
  camera_->release();
  stream_config_.reset();
  camera_.reset();
  manager_->stop();
}

void LibcameraCamera::find_camera() {
  const auto cameras = manager_->cameras();
  const std::string& wanted = config_.libcamera.id;
  std::vector<std::string> ids;
  for (const auto& camera : cameras) {
    ids.push_back(camera->id());
    if (camera->id() == wanted || (wanted.empty() && cameras.size() == 1)) {
      camera_ = camera;
    }
  }
  if (camera_ == nullptr) {
    const std::string there =
        ids.empty() ? "libcamera finds none" : fmt::format("libcamera finds: {}", fmt::join(ids, ", "));
    if (wanted.empty() && !ids.empty()) {
      fail(DeviceFault::Kind::Unsuitable, "source.id must say which camera; " + there);
    }
    fail(DeviceFault::Kind::Absent, "no such camera; " + there);
  }
}

void LibcameraCamera::choose_format() {
  const LiveConfig& wanted = config_.live;
  const libcamera::Size size(static_cast<unsigned>(wanted.width_px), static_cast<unsigned>(wanted.height_px));
  const libcamera::StreamFormats offered = generate(*camera_)->at(0).formats();
  const std::vector<libcamera::PixelFormat> formats = offered.pixelformats();
  for (const KnownFormat& known : kKnownFormats) {
    if ((wanted.format != "auto" && wanted.format != known.name) ||
        std::find(formats.begin(), formats.end(), known.format) == formats.end()) {
      continue;
    }
    auto config = generate(*camera_);
    libcamera::StreamConfiguration& stream = config->at(0);
    stream.pixelFormat = known.format;
    stream.size = size;
    stream.bufferCount = wanted.buffers;
    // Whether it fits is for the pipeline handler to say; what does not it replaces.
    if (config->validate() != libcamera::CameraConfiguration::Invalid && stream.pixelFormat == known.format &&
        stream.size == size) {
      stream_config_ = std::move(config);
      format_ = &known;
      return;
    }
  }
  fail(DeviceFault::Kind::Unsuitable,
       fmt::format("source.format \"{}\" at {}x{} px is not among what the camera has: {}", wanted.format,
                   wanted.width_px, wanted.height_px, describe_formats(offered)));
}

void LibcameraCamera::start() {
  demand(camera_->configure(stream_config_.get()), "configure");
  libcamera::Stream* stream = stream_config_->at(0).stream();
  allocator_ = std::make_unique<libcamera::FrameBufferAllocator>(camera_);
  demand(allocator_->allocate(stream), "allocate");
  for (const auto& buffer : allocator_->buffers(stream)) {
    mapped_.emplace(buffer.get(), std::make_unique<MappedBuffer>(*buffer));
    auto request = camera_->createRequest();
    if (request == nullptr) {
      fail(DeviceFault::Kind::Failing, "createRequest");
    }
    demand(request->addBuffer(stream, buffer.get()), "addBuffer");
    requests_.push_back(std::move(request));
  }
  started_ns_ = Clock::now_ns();
  demand(camera_->start(), "start");
  running_ = true;
  set_state(CameraState::Opening, "");
  queue_requests();
}

void LibcameraCamera::queue_requests() {
  const LibcameraControls controls = make_controls(config_, camera_->controls());
  for (std::size_t i = 0; i < requests_.size(); ++i) {
    if (i < 2) {
      requests_[i]->controls().merge(i == 0 ? controls.switches : controls.values);
    }
    demand(camera_->queueRequest(requests_[i].get()), "queueRequest");
  }
}

void LibcameraCamera::stop() {
  if (!std::exchange(running_, false)) {
    return;
  }
  camera_->stop();
  requests_.clear();
  mapped_.clear();
  allocator_.reset();
  set_state(CameraState::Idle, "");
}

CameraStatus LibcameraCamera::status() const {
  const Lock lock(mutex_);
  return status_;
}

std::string LibcameraCamera::last_error() const {
  return status().reason;
}

void LibcameraCamera::set_state(CameraState state, const std::string& reason) {
  const Lock lock(mutex_);
  status_.state = state;
  status_.reason = reason;
}

void LibcameraCamera::count(std::uint64_t CameraCounters::*which, std::uint64_t how_many) {
  const Lock lock(mutex_);
  status_.counters.*which += how_many;
}

/// In libcamera's thread.
void LibcameraCamera::on_completed(libcamera::Request* request) {
  const Lock lock(mutex_);
  if (request->status() == libcamera::Request::RequestComplete) {
    completed_.push_back(request);
  } else if (status_.state == CameraState::Opening || status_.state == CameraState::Streaming) {
    // Not at the end, when all of them are cancelled: then nobody looks any more.
    status_.state = CameraState::Failing;
    status_.reason = "cancelled a frame: it was unplugged, or refuses a setting";
  }
  changed_.notify_one();
}

/// In libcamera's thread.
void LibcameraCamera::on_disconnected() {
  const Lock lock(mutex_);
  status_.state = CameraState::Absent;
  status_.reason = "was unplugged";
  changed_.notify_one();
}

std::vector<libcamera::Request*> LibcameraCamera::wait_completed(std::chrono::milliseconds timeout) {
  const Lock lock(mutex_);
  changed_.wait_for(mutex_, timeout, [this]() FACET_REQUIRES(mutex_) {
    return !completed_.empty() || status_.state == CameraState::Absent ||
           status_.state == CameraState::Failing;
  });
  if (status_.state == CameraState::Absent || status_.state == CameraState::Failing) {
    return {};
  }
  return std::exchange(completed_, {});
}

CaptureOutcome LibcameraCamera::next(Frame& out, std::chrono::milliseconds timeout) {
  if (!running_) {
    return CaptureOutcome::EndOfStream;
  }
  try {
    std::optional<Arrived> newest;
    for (libcamera::Request* request : wait_completed(timeout)) {
      const std::optional<Arrived> arrived = examine(*request);
      if (!arrived) {
        requeue(*request);
        continue;
      }
      if (newest) {
        count(&CameraCounters::skipped);
        requeue(*newest->request);
      }
      newest = arrived;
    }
    if (!newest) {
      return CaptureOutcome::Timeout;
    }
    Frame frame;
    const bool converted = convert(*newest, frame);
    requeue(*newest->request);
    if (!converted) {
      return CaptureOutcome::Timeout;
    }
    const Lock lock(mutex_);
    CameraCounters& counters = status_.counters;
    ++counters.delivered;
    counters.damaged += frame.corrupt ? 1 : 0;
    counters.undated += newest->dated ? 0 : 1;
    if (status_.state == CameraState::Opening) {
      status_.state = CameraState::Streaming;
    }
    out = std::move(frame);
    return CaptureOutcome::Delivered;
  } catch (const DeviceFault& fault) {
    set_state(fault.kind == DeviceFault::Kind::Absent ? CameraState::Absent : CameraState::Failing,
              fault.what());
  } catch (const std::exception& fault) {
    set_state(CameraState::Failing, fault.what());
  }
  return CaptureOutcome::Timeout;
}

std::optional<LibcameraCamera::Arrived> LibcameraCamera::examine(libcamera::Request& request) {
  const libcamera::FrameMetadata& metadata = request.buffers().begin()->second->metadata();
  if (metadata.status == libcamera::FrameMetadata::FrameCancelled) {
    return std::nullopt;
  }
  const std::int64_t now = Clock::now_ns();
  const auto stamp = request.metadata().get(libcamera::controls::SensorTimestamp);
  const std::optional<std::int64_t> driver_ns = monotonic_stamp_ns(
      stamp.value_or(static_cast<std::int64_t>(metadata.timestamp)), started_ns_, now, Clock::boot_ns());
  const DriverCount::Step step = count_.next(metadata.sequence, driver_ns);
  count(&CameraCounters::lost, step.lost);
  count(&CameraCounters::omitted, step.omitted);
  Arrived arrived;
  arrived.request = &request;
  arrived.sequence = step.sequence;
  arrived.timestamp_ns = driver_ns.value_or(now);
  arrived.damaged = metadata.status == libcamera::FrameMetadata::FrameError;
  arrived.dated = driver_ns.has_value();
  return arrived;
}

bool LibcameraCamera::convert(const Arrived& arrived, Frame& out) {
  const libcamera::FrameBuffer* buffer = arrived.request->buffers().begin()->second;
  const MappedBuffer& mapped = *mapped_.at(buffer);
  const auto metadata = buffer->metadata().planes();
  const auto stride = static_cast<std::size_t>(rgba_stride_bytes(info_.width_px));
  auto pixels = pool_->take(stride * static_cast<std::size_t>(info_.height_px));
  out.corrupt = arrived.damaged;
  mapped.begin_reading();
  const bool converted =
      convert_pixels(mapped, {metadata.data(), metadata.size()}, pixels.get(), stride, out.corrupt);
  mapped.end_reading();
  if (!converted) {
    return false;
  }
  out.sequence = arrived.sequence;
  out.timestamp_ns = arrived.timestamp_ns;
  if (timestamp_ns_ != 0) {
    out.timestamp_ns = std::max(out.timestamp_ns, timestamp_ns_ + 1);
  } else {
    first_timestamp_ns_ = out.timestamp_ns;
  }
  timestamp_ns_ = out.timestamp_ns;
  out.media_time_ns = out.timestamp_ns - first_timestamp_ns_;
  out.width_px = info_.width_px;
  out.height_px = info_.height_px;
  out.stride_bytes = stride;
  out.pixels = std::move(pixels);
  return true;
}

bool LibcameraCamera::convert_pixels(const MappedBuffer& buffer,
                                     std::span<const libcamera::FrameMetadata::Plane> planes,
                                     std::uint8_t* rgba, std::size_t stride_bytes, bool& damaged) {
  const auto& mapped = buffer.planes();
  std::size_t filled_bytes = 0;
  for (std::size_t i = 0; i < std::min(planes.size(), mapped.size()); ++i) {
    filled_bytes += std::min<std::size_t>(planes[i].bytesused, mapped[i].size());
  }
  if (!format_->layout) {
    const JpegOutcome outcome =
        jpeg_.decode(mapped.front().first(std::min(filled_bytes, mapped.front().size())), info_.width_px,
                     info_.height_px, rgba, stride_bytes);
    if (outcome == JpegOutcome::Unreadable) {
      count(&CameraCounters::undecodable);
      return false;
    }
    damaged = damaged || outcome == JpegOutcome::Damaged;
    return true;
  }
  const PixelLayout layout = *format_->layout;
  const libcamera::StreamConfiguration& stream = stream_config_->at(0);
  const std::size_t source_stride =
      std::max<std::size_t>(stream.stride, packed_stride_bytes(layout, info_.width_px));
  if (filled_bytes < picture_bytes(layout, info_.width_px, info_.height_px, source_stride)) {
    count(&CameraCounters::truncated);
    return false;
  }
  const bool grey = layout == PixelLayout::Grey || layout == PixelLayout::Y10;
  convert_to_rgba({.layout = layout,
                   .coding = colour_coding(stream, grey),
                   .bytes = mapped.front().data(),
                   .stride_bytes = source_stride,
                   .width_px = info_.width_px,
                   .height_px = info_.height_px,
                   .chroma = mapped.size() > 1 ? mapped[1].data() : nullptr},
                  rgba, stride_bytes);
  return true;
}

void LibcameraCamera::requeue(libcamera::Request& request) {
  request.reuse(libcamera::Request::ReuseBuffers);
  demand(camera_->queueRequest(&request), "queueRequest");
}

}  // namespace

std::unique_ptr<Camera> open_libcamera_camera(const CameraConfig& config) {
  return std::make_unique<LibcameraCamera>(config);
}

std::vector<CameraListing> list_libcamera_cameras() {
  const auto manager = start_manager();
  std::vector<CameraListing> found;
  for (const auto& camera : manager->cameras()) {
    std::string description;
    try {
      const auto model = camera->properties().get(libcamera::properties::Model);
      description = fmt::format("{}: {}; sets {}", model.value_or("camera"),
                                describe_formats(generate(*camera)->at(0).formats()),
                                describe_controls(camera->controls()));
    } catch (const DeviceFault& fault) {
      description = fault.what();
    }
    found.push_back({camera->id(), description});
  }
  manager->stop();
  return found;
}

}  // namespace facet::camera
