#pragma once

#include <linux/videodev2.h>

#include <array>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "camera/v4l2_kernel.hpp"

namespace facet::test {

inline constexpr std::int64_t kMillisecond_ns = 1'000'000;
inline constexpr std::int64_t kSecond_ns = 1'000'000'000;

/// One V4L2 device as the kernel shows it, and its clock, which goes on only while somebody waits. Breaks
/// where it is told to.
class FakeV4l2 final : public camera::V4l2Kernel {
 public:
  struct Mode {
    std::uint32_t fourcc;
    int width_px;
    int height_px;
    std::vector<int> rates_hz;
  };
  struct Control {
    std::int64_t minimum;
    std::int64_t maximum;
    int step;
    std::int64_t value;
    std::set<std::int64_t> menu;  ///< empty: no menu
    std::string name = "";
    std::uint32_t type = V4L2_CTRL_TYPE_INTEGER;        ///< of one that has no menu
    std::map<std::int64_t, std::string> texts = {};     ///< of a menu's entries
    std::map<std::int64_t, std::int64_t> numbers = {};  ///< of a menu of numbers
    std::uint32_t flags = 0;                            ///< grabbed: it can't be set now
  };
  /// What the device is about to put into a buffer.
  struct Filled {
    std::vector<std::uint8_t> bytes;
    std::uint32_t flags;
    std::uint32_t sequence;
    std::int64_t stamp_ns;
    bool dropped = false;      ///< counted, but not put into a buffer
    bool wrong_index = false;  ///< the driver names a buffer that it does not have
  };

  FakeV4l2();

  // What the device is.
  std::string path = "/dev/video0";
  bool present = true;
  std::uint32_t capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
  std::vector<Mode> modes;
  bool sizes_in_a_range = false;  ///< ENUM_FRAMESIZES: from the first mode's size to the last one's
  bool tells_sizes = true;
  std::map<std::uint32_t, Control> controls;
  std::function<void(std::uint32_t id)> on_control;  ///< called when one was set
  std::uint32_t colorspace = V4L2_COLORSPACE_SRGB;
  std::uint32_t ycbcr_enc = V4L2_YCBCR_ENC_DEFAULT;
  std::uint32_t quantization = V4L2_QUANTIZATION_DEFAULT;
  std::uint32_t field = V4L2_FIELD_NONE;
  std::uint32_t row_padding_bytes = 0;
  // With V4L2_CAP_VIDEO_CAPTURE_MPLANE among the capabilities instead of V4L2_CAP_VIDEO_CAPTURE:
  std::uint32_t data_offset = 0;               ///< of the picture in each plane
  std::uint32_t chroma_row_padding_bytes = 0;  ///< of NV12M's second plane, beyond the first one's
  std::uint32_t planes_given = 0;              ///< instead of what the format has; 0: no
  std::uint32_t most_buffers = 32;
  std::int64_t period_ns = 100 * kMillisecond_ns;  ///< set by S_PARM
  std::uint32_t first_sequence = 0;
  std::uint32_t buffer_flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
  std::int64_t stamp_offset_ns = 0;  ///< of the driver's clock to CLOCK_MONOTONIC
  std::int64_t wall_offset_ns = 1'700'000'000 * kSecond_ns;
  bool silent = false;  ///< no frames come
  std::function<void(Filled&)>
      on_fill;       ///< changes what a buffer gets; the first frame of a stream is all zero
  int pictures = 0;  ///< filled since the beginning

  // What happens to it.
  std::int64_t now_ns = 100 * kSecond_ns;
  /// errno of the next calls of an ioctl, 0: that one works.
  std::map<unsigned long, std::deque<int>> errors;
  int open_error = 0;
  int map_failures = 0;
  void at(std::int64_t time_ns, std::function<void()> action) {
    actions_.emplace(time_ns, std::move(action));
  }
  void unplug();
  /// The driver gives the stream up, as vb2_queue_error does.
  void break_stream();
  /// Time goes by while nobody waits.
  void run_until(std::int64_t time_ns);

  // What is seen of its users.
  std::size_t open_count() const { return open_.size(); }
  int mapped = 0;
  int opens = 0;
  bool streaming() const { return streaming_fd_ >= 0; }
  std::size_t buffer_count() const { return buffers_.size(); }

  int open(const std::string& wanted) override;
  void close(int fd) override;
  int ioctl(int fd, unsigned long request, void* argument) override;
  void* map(int fd, std::size_t length, std::int64_t offset) override;
  void unmap(void* start, std::size_t length) override;
  int wait(int fd, std::int64_t until_ns) override;
  std::int64_t monotonic_ns() override { return now_ns; }
  std::int64_t realtime_ns() override { return now_ns + wall_offset_ns; }

 private:
  struct Buffer {
    std::array<std::vector<std::uint8_t>, 2> memory;  ///< of each plane
    bool queued = false;
    v4l2_buffer filled{};
    std::array<v4l2_plane, 2> planes{};
  };
  bool multi_planar() const { return (capabilities & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0; }
  std::uint32_t type() const {
    return multi_planar() ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
  }
  std::size_t plane_count() const { return format_.pixelformat == V4L2_PIX_FMT_NV12M ? 2 : 1; }
  bool fits(const v4l2_buffer& buffer) const;
  int query_buffer(v4l2_buffer& buffer);

  int answer(int fd, unsigned long request, void* argument);
  int enumerate_format(v4l2_fmtdesc& format) const;
  int enumerate_size(v4l2_frmsizeenum& size) const;
  int enumerate_interval(v4l2_frmivalenum& interval) const;
  int set_format(v4l2_pix_format& pixels);
  int set_format(v4l2_format& format);
  int set_rate(v4l2_streamparm& parameters);
  int query_control(v4l2_queryctrl& query) const;
  int query_menu(v4l2_querymenu& entry) const;
  int query_control(v4l2_query_ext_ctrl& query) const;
  int set_control(std::uint32_t id, std::int64_t value);
  int set_controls(v4l2_ext_controls& wanted);
  int request_buffers(int fd, v4l2_requestbuffers& request);
  int dequeue(v4l2_buffer& buffer);
  int stream(int fd, bool on);
  void fill();
  void step(std::int64_t until_ns);

  std::multimap<std::int64_t, std::function<void()>> actions_;
  std::set<int> open_;
  std::set<int> gone_;  ///< descriptors of a device that was unplugged
  int next_fd_ = 3;
  int owner_fd_ = -1;  ///< has buffers
  int streaming_fd_ = -1;
  bool broken_ = false;
  v4l2_pix_format format_{};
  std::vector<Buffer> buffers_;
  std::deque<std::uint32_t> queued_;
  std::deque<std::uint32_t> done_;
  std::uint32_t sequence_ = 0;
  std::int64_t next_frame_ns_ = 0;
};

}  // namespace facet::test
