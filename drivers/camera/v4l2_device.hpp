#pragma once

#include <linux/videodev2.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "camera/device_fault.hpp"
#include "camera/factory.hpp"
#include "camera/pixel_conversion.hpp"
#include "camera/v4l2_kernel.hpp"

namespace facet::camera {

/// What a device says that it offers in one pixel format at one size or range of sizes (0: it tells no
/// sizes).
struct V4l2Mode {
  std::uint32_t fourcc = 0;
  int min_width_px = 0;
  int min_height_px = 0;
  int max_width_px = 0;  ///< the same as the least where there is no range
  int max_height_px = 0;
  std::vector<std::pair<double, double>> rates_hz;  ///< least and most, equal where there is no range; empty:
                                                    ///< the driver does not tell
};

/// One open V4L2 capture device, of the single-planar or the multi-planar interface; of the latter, formats
/// whose picture is in one block of memory, and NV12 in two. One thread. Everything throws DeviceFault where
/// the device does not do it.
class V4l2Device {
 public:
  /// Opens the device and reads what it offers.
  V4l2Device(V4l2Kernel& kernel, const std::string& path);
  /// Ends the stream and closes.
  ~V4l2Device();
  V4l2Device(const V4l2Device&) = delete;
  V4l2Device& operator=(const V4l2Device&) = delete;

  const std::string& card() const { return card_; }
  /// What it offers, for people, such as "YUYV, NV12 640x480, 320x240 at 30, 15 Hz; H264, which Facet does
  /// not read".
  std::string offer() const;
  /// The controls that can be set by their names, for people.
  std::string controls() const;

  /// Throws Unsuitable where the device can't do it; changes nothing in the device.
  void check(const LiveConfig& config) const;

  /// Sets format, rate and controls, hands the driver its buffers and begins the stream.
  void start(const LiveConfig& config);

  struct Format {
    std::optional<PixelLayout> layout;  ///< none: JPEG
    ColourCoding coding;
    std::size_t stride_bytes = 0;
    std::size_t least_bytes = 0;         ///< that a whole picture has; JPEG: 1
    std::size_t least_chroma_bytes = 0;  ///< of these in a block of their own, beside least_bytes
  };
  const Format& format() const { return format_; }         ///< once started
  std::int64_t started_ns() const { return started_ns_; }  ///< CLOCK_MONOTONIC just before the stream began
  unsigned buffer_count() const { return static_cast<unsigned>(buffers_.size()); }

  /// Waits for a filled buffer, until `until_ns` at most.
  void wait(std::int64_t until_ns);
  /// The oldest filled buffer; nothing where there is none.
  std::optional<v4l2_buffer> dequeue();
  /// What a dequeued buffer holds; empty where its size is impossible. Valid until it is queued again.
  std::span<const std::uint8_t> payload(const v4l2_buffer& buffer) const {
    return buffers_[buffer.index][0].filled;
  }
  /// The same of its chroma where that has a block of its own.
  std::span<const std::uint8_t> chroma(const v4l2_buffer& buffer) const {
    return buffers_[buffer.index][1].filled;
  }
  void queue(std::uint32_t index);

 private:
  struct Mapping {
    void* start = nullptr;
    std::size_t length = 0;
    std::span<const std::uint8_t> filled;
  };
  static constexpr std::size_t kMostPlanes = 2;
  using Planes = std::array<Mapping, kMostPlanes>;
  /// A buffer as a request takes it; it points at `planes`, one of which is used where the device is
  /// multi-planar.
  v4l2_buffer new_buffer(std::uint32_t index, std::array<v4l2_plane, kMostPlanes>& planes) const;
  bool multi_planar() const { return type_ == V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE; }
  v4l2_pix_format demand_format(const v4l2_pix_format& wanted);

  void close();
  /// Carries out a request; false where the driver does not know it, does not take a value, or says that the
  /// list is at its end.
  bool ask(unsigned long request, void* argument, const char* what) const;
  /// The same for requests that every device must carry out.
  void demand(unsigned long request, void* argument, const char* what) const;
  [[noreturn]] void fail(int error, const std::string& what) const;
  [[noreturn]] void refuse(const std::string& what) const;

  void read_modes();
  void read_sizes(std::uint32_t fourcc);
  void read_rates(V4l2Mode& mode) const;
  std::uint32_t choose(const LiveConfig& config) const;
  void set_format(const LiveConfig& config);
  void set_rate(const LiveConfig& config) const;
  void map_buffers(unsigned count);

  V4l2Kernel& kernel_;
  std::string path_;
  std::string card_;
  int fd_ = -1;
  std::uint32_t type_ = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  bool streaming_ = false;
  std::int64_t started_ns_ = 0;
  std::vector<V4l2Mode> modes_;              ///< of the formats that can be read
  std::vector<std::string> unread_formats_;  ///< names of the others
  Format format_;
  std::uint32_t plane_count_ = 1;  ///< of the format that is set
  std::vector<Planes> buffers_;
};

}  // namespace facet::camera
