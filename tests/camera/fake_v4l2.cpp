#include "fake_v4l2.hpp"

#include <gtest/gtest.h>
#include <poll.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <span>
#include <utility>

namespace facet::test {
namespace {

constexpr std::int64_t kMapStep = 0x10000;

std::uint32_t bits_of(std::uint32_t fourcc) {
  switch (fourcc) {
    case V4L2_PIX_FMT_GREY:
      return 8;
    case V4L2_PIX_FMT_NV12:
      return 12;
    default:
      return 16;
  }
}

/// Bytes between rows of the first plane without padding.
std::uint32_t row_bytes(std::uint32_t fourcc, std::uint32_t width_px) {
  const bool planar = fourcc == V4L2_PIX_FMT_NV12 || fourcc == V4L2_PIX_FMT_NV12M;
  return planar ? width_px : width_px * bits_of(fourcc) / 8;
}

std::uint32_t type_of(const FakeV4l2::Control& control) {
  if (control.menu.empty()) {
    return control.type;
  }
  return control.numbers.empty() ? V4L2_CTRL_TYPE_MENU : V4L2_CTRL_TYPE_INTEGER_MENU;
}

}  // namespace

FakeV4l2::FakeV4l2() : modes{{V4L2_PIX_FMT_GREY, 4, 2, {10, 30}}} {}

void FakeV4l2::unplug() {
  present = false;
  gone_ = open_;
}

void FakeV4l2::break_stream() {
  broken_ = true;
}

void FakeV4l2::run_until(std::int64_t time_ns) {
  while (now_ns < time_ns) {
    step(time_ns);
  }
}

/// Goes on to what happens next, or to the time given.
void FakeV4l2::step(std::int64_t until_ns) {
  std::int64_t next_ns = until_ns;
  const bool filling = streaming() && !silent && !broken_ && gone_.count(streaming_fd_) == 0;
  if (filling) {
    next_ns = std::min(next_ns, std::max(now_ns, next_frame_ns_));
  }
  if (!actions_.empty()) {
    next_ns = std::min(next_ns, std::max(now_ns, actions_.begin()->first));
  }
  now_ns = next_ns;
  while (silent && next_frame_ns_ <= now_ns) {
    next_frame_ns_ += period_ns;  // left out, not put off
  }
  if (!actions_.empty() && actions_.begin()->first <= now_ns) {
    const auto action = std::move(actions_.begin()->second);
    actions_.erase(actions_.begin());
    action();
  } else if (filling && next_frame_ns_ <= now_ns) {
    fill();
    next_frame_ns_ += period_ns;
  }
}

void FakeV4l2::fill() {
  const bool at_start = (buffer_flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
  const std::size_t all_bytes = plane_count() == 2 ? format_.sizeimage * 3 / 2 : format_.sizeimage;
  Filled filled{std::vector<std::uint8_t>(all_bytes), buffer_flags, sequence_++,
                now_ns + stamp_offset_ns - (at_start ? period_ns : 0)};
  if (on_fill) {
    on_fill(filled);
  }
  ++pictures;
  if (filled.dropped || queued_.empty()) {
    return;
  }
  const std::uint32_t index = queued_.front();
  queued_.pop_front();
  Buffer& buffer = buffers_[index];
  buffer.filled = {};
  buffer.filled.index = filled.wrong_index ? 1000 : index;
  buffer.filled.type = type();
  std::span<const std::uint8_t> rest = filled.bytes;
  for (std::size_t plane = 0; plane < plane_count(); ++plane) {
    std::vector<std::uint8_t>& memory = buffer.memory[plane];
    const std::size_t room = memory.size() - data_offset;
    const std::size_t size = plane + 1 < plane_count() ? std::min(rest.size(), room) : rest.size();
    std::copy_n(rest.begin(), std::min(size, room), memory.begin() + data_offset);
    rest = rest.subspan(size);
    buffer.planes[plane].data_offset = data_offset;
    buffer.planes[plane].bytesused = static_cast<std::uint32_t>(size + data_offset);
  }
  buffer.filled.bytesused = multi_planar() ? 0 : buffer.planes[0].bytesused;
  buffer.filled.flags = filled.flags;
  buffer.filled.sequence = filled.sequence;
  buffer.filled.timestamp.tv_sec = filled.stamp_ns / kSecond_ns;
  buffer.filled.timestamp.tv_usec = filled.stamp_ns % kSecond_ns / 1000;
  buffer.queued = false;
  done_.push_back(index);
}

int FakeV4l2::open(const std::string& wanted) {
  ++opens;
  if (!present || wanted != path) {
    return -ENOENT;
  }
  if (open_error != 0) {
    return -open_error;
  }
  open_.insert(next_fd_);
  return next_fd_++;
}

void FakeV4l2::close(int fd) {
  EXPECT_EQ(open_.erase(fd), 1U) << "closed twice";
  EXPECT_TRUE(fd != streaming_fd_ || gone_.count(fd) != 0) << "closed with its stream on";
  gone_.erase(fd);
  if (fd == owner_fd_) {
    EXPECT_EQ(mapped, 0) << "closed with its buffers mapped";
    owner_fd_ = -1;
    buffers_.clear();
  }
  if (fd == streaming_fd_) {
    stream(fd, false);
  }
}

void* FakeV4l2::map(int fd, std::size_t length, std::int64_t offset) {
  const auto index = static_cast<std::size_t>(offset / kMapStep);
  const std::size_t plane = offset % kMapStep == 0 ? 0 : 1;
  EXPECT_EQ(fd, owner_fd_);
  EXPECT_EQ(buffers_.at(index).memory.at(plane).size(), length);
  if (map_failures > 0) {
    --map_failures;
    return nullptr;
  }
  ++mapped;
  return buffers_[index].memory.at(plane).data();
}

void FakeV4l2::unmap(void* start, std::size_t length) {
  const bool known = std::any_of(buffers_.begin(), buffers_.end(), [&](const Buffer& buffer) {
    return std::any_of(buffer.memory.begin(), buffer.memory.end(),
                       [&](const auto& memory) { return memory.data() == start && memory.size() == length; });
  });
  EXPECT_TRUE(known);
  --mapped;
}

int FakeV4l2::wait(int fd, std::int64_t until_ns) {
  for (;;) {
    if (fd >= 0) {
      if (gone_.count(fd) != 0) {
        return POLLERR | POLLHUP;
      }
      if (fd != streaming_fd_ || broken_) {
        return POLLERR;
      }
      if (!done_.empty()) {
        return POLLIN;
      }
    }
    if (now_ns >= until_ns) {
      return 0;
    }
    step(until_ns);
  }
}

int FakeV4l2::ioctl(int fd, unsigned long request, void* argument) {
  if (open_.count(fd) == 0) {
    ADD_FAILURE() << "an ioctl on a descriptor that is not open";
    return -EBADF;
  }
  if (gone_.count(fd) != 0) {
    return -ENODEV;
  }
  std::deque<int>& planned = errors[request];
  if (!planned.empty()) {
    const int error = planned.front();
    planned.pop_front();
    if (error != 0) {
      return -error;
    }
  }
  return answer(fd, request, argument);
}

int FakeV4l2::answer(int fd, unsigned long request, void* argument) {
  switch (request) {
    case VIDIOC_QUERYCAP: {
      auto& capability = *static_cast<v4l2_capability*>(argument);
      std::strcpy(reinterpret_cast<char*>(capability.card), "Fake Camera");
      capability.capabilities =
          V4L2_CAP_DEVICE_CAPS | V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_STREAMING;
      capability.device_caps = capabilities;
      return 0;
    }
    case VIDIOC_ENUM_FMT:
      return enumerate_format(*static_cast<v4l2_fmtdesc*>(argument));
    case VIDIOC_ENUM_FRAMESIZES:
      return enumerate_size(*static_cast<v4l2_frmsizeenum*>(argument));
    case VIDIOC_ENUM_FRAMEINTERVALS:
      return enumerate_interval(*static_cast<v4l2_frmivalenum*>(argument));
    case VIDIOC_S_FMT:
      return owner_fd_ >= 0 ? -EBUSY : set_format(*static_cast<v4l2_format*>(argument));
    case VIDIOC_S_PARM:
      return set_rate(*static_cast<v4l2_streamparm*>(argument));
    case VIDIOC_QUERYCTRL:
      return query_control(*static_cast<v4l2_queryctrl*>(argument));
    case VIDIOC_QUERYMENU:
      return query_menu(*static_cast<v4l2_querymenu*>(argument));
    case VIDIOC_QUERY_EXT_CTRL:
      return query_control(*static_cast<v4l2_query_ext_ctrl*>(argument));
    case VIDIOC_S_CTRL: {
      const auto& wanted = *static_cast<v4l2_control*>(argument);
      return set_control(wanted.id, wanted.value);
    }
    case VIDIOC_S_EXT_CTRLS:
      return set_controls(*static_cast<v4l2_ext_controls*>(argument));
    case VIDIOC_REQBUFS:
      return request_buffers(fd, *static_cast<v4l2_requestbuffers*>(argument));
    case VIDIOC_QUERYBUF:
      return fd != owner_fd_ ? -EINVAL : query_buffer(*static_cast<v4l2_buffer*>(argument));
    case VIDIOC_QBUF: {
      const auto& buffer = *static_cast<v4l2_buffer*>(argument);
      const std::uint32_t index = buffer.index;
      if (fd != owner_fd_ || !fits(buffer) || index >= buffers_.size() || buffers_[index].queued) {
        return -EINVAL;
      }
      buffers_[index].queued = true;
      queued_.push_back(index);
      return 0;
    }
    case VIDIOC_DQBUF:
      return fd != streaming_fd_ ? -EINVAL : dequeue(*static_cast<v4l2_buffer*>(argument));
    case VIDIOC_STREAMON:
      return fd != owner_fd_ || queued_.empty() || *static_cast<std::uint32_t*>(argument) != type()
                 ? -EINVAL
                 : stream(fd, true);
    case VIDIOC_STREAMOFF:
      return *static_cast<std::uint32_t*>(argument) != type() ? -EINVAL : stream(fd, false);
    default:
      return -ENOTTY;
  }
}

int FakeV4l2::enumerate_format(v4l2_fmtdesc& format) const {
  std::vector<std::uint32_t> formats;
  for (const Mode& mode : modes) {
    if (std::find(formats.begin(), formats.end(), mode.fourcc) == formats.end()) {
      formats.push_back(mode.fourcc);
    }
  }
  if (format.type != type() || format.index >= formats.size()) {
    return -EINVAL;
  }
  format.pixelformat = formats[format.index];
  return 0;
}

int FakeV4l2::enumerate_size(v4l2_frmsizeenum& size) const {
  std::vector<Mode> found;
  std::copy_if(modes.begin(), modes.end(), std::back_inserter(found),
               [&](const Mode& mode) { return mode.fourcc == size.pixel_format; });
  if (!tells_sizes) {
    return -ENOTTY;
  }
  if (size.index >= (sizes_in_a_range ? 1U : found.size())) {
    return -EINVAL;
  }
  if (sizes_in_a_range) {
    size.type = V4L2_FRMSIZE_TYPE_STEPWISE;
    size.stepwise = {static_cast<std::uint32_t>(found.front().width_px),
                     static_cast<std::uint32_t>(found.back().width_px),
                     2,
                     static_cast<std::uint32_t>(found.front().height_px),
                     static_cast<std::uint32_t>(found.back().height_px),
                     2};
    return 0;
  }
  size.type = V4L2_FRMSIZE_TYPE_DISCRETE;
  size.discrete = {static_cast<std::uint32_t>(found[size.index].width_px),
                   static_cast<std::uint32_t>(found[size.index].height_px)};
  return 0;
}

int FakeV4l2::enumerate_interval(v4l2_frmivalenum& interval) const {
  for (const Mode& mode : modes) {
    if (mode.fourcc == interval.pixel_format && mode.width_px == static_cast<int>(interval.width) &&
        mode.height_px == static_cast<int>(interval.height)) {
      if (sizes_in_a_range && interval.index == 0) {
        interval.type = V4L2_FRMIVAL_TYPE_CONTINUOUS;
        interval.stepwise.min = {1, static_cast<std::uint32_t>(mode.rates_hz.back())};
        interval.stepwise.max = {1, static_cast<std::uint32_t>(mode.rates_hz.front())};
        return 0;
      }
      if (!sizes_in_a_range && interval.index < mode.rates_hz.size()) {
        interval.type = V4L2_FRMIVAL_TYPE_DISCRETE;
        interval.discrete = {1, static_cast<std::uint32_t>(mode.rates_hz[interval.index])};
        return 0;
      }
    }
  }
  return -EINVAL;
}

int FakeV4l2::set_format(v4l2_format& format) {
  if (format.type != type()) {
    return -EINVAL;
  }
  if (!multi_planar()) {
    return set_format(format.fmt.pix);
  }
  v4l2_pix_format_mplane& planes = format.fmt.pix_mp;
  v4l2_pix_format pixels{};
  pixels.width = planes.width;
  pixels.height = planes.height;
  pixels.pixelformat = planes.pixelformat;
  set_format(pixels);
  planes.width = pixels.width;
  planes.height = pixels.height;
  planes.pixelformat = pixels.pixelformat;
  planes.field = pixels.field;
  planes.colorspace = pixels.colorspace;
  planes.ycbcr_enc = static_cast<std::uint8_t>(pixels.ycbcr_enc);
  planes.quantization = static_cast<std::uint8_t>(pixels.quantization);
  planes.num_planes = static_cast<std::uint8_t>(planes_given != 0 ? planes_given : plane_count());
  planes.plane_fmt[0].bytesperline = pixels.bytesperline;
  planes.plane_fmt[0].sizeimage = pixels.sizeimage;
  planes.plane_fmt[1].bytesperline = pixels.bytesperline + chroma_row_padding_bytes;
  planes.plane_fmt[1].sizeimage = pixels.sizeimage / 2;
  return 0;
}

int FakeV4l2::set_format(v4l2_pix_format& pixels) {
  const bool exact = std::any_of(modes.begin(), modes.end(), [&](const Mode& mode) {
    return mode.fourcc == pixels.pixelformat &&
           (sizes_in_a_range || (mode.width_px == static_cast<int>(pixels.width) &&
                                 mode.height_px == static_cast<int>(pixels.height)));
  });
  if (!exact) {
    pixels.pixelformat = modes.front().fourcc;
    pixels.width = static_cast<std::uint32_t>(modes.front().width_px);
    pixels.height = static_cast<std::uint32_t>(modes.front().height_px);
  }
  pixels.field = field;
  pixels.colorspace = colorspace;
  pixels.ycbcr_enc = ycbcr_enc;
  pixels.quantization = quantization;
  pixels.bytesperline = row_bytes(pixels.pixelformat, pixels.width) + row_padding_bytes;
  pixels.sizeimage = pixels.bytesperline * pixels.height;
  if (pixels.pixelformat == V4L2_PIX_FMT_NV12) {
    pixels.sizeimage += pixels.bytesperline * ((pixels.height + 1) / 2);
  } else if (pixels.pixelformat == V4L2_PIX_FMT_MJPEG) {
    pixels.bytesperline = 0;
    pixels.sizeimage = 4096;
  }
  format_ = pixels;
  return 0;
}

int FakeV4l2::set_rate(v4l2_streamparm& parameters) {
  if (parameters.type != type()) {
    return -EINVAL;
  }
  v4l2_fract& interval = parameters.parm.capture.timeperframe;
  const double wanted_hz = static_cast<double>(interval.denominator) / interval.numerator;
  std::vector<int> rates;
  for (const Mode& mode : modes) {
    rates.insert(rates.end(), mode.rates_hz.begin(), mode.rates_hz.end());
  }
  if (rates.empty()) {
    return -ENOTTY;
  }
  const int nearest = *std::min_element(rates.begin(), rates.end(), [&](int a, int b) {
    return std::abs(a - wanted_hz) < std::abs(b - wanted_hz);
  });
  interval = {1, static_cast<std::uint32_t>(nearest)};
  period_ns = kSecond_ns / nearest;
  return 0;
}

int FakeV4l2::query_control(v4l2_queryctrl& query) const {
  const auto found = controls.find(query.id);
  if (found == controls.end()) {
    return -EINVAL;
  }
  query.type = type_of(found->second);
  query.minimum = static_cast<std::int32_t>(found->second.minimum);
  query.maximum = static_cast<std::int32_t>(found->second.maximum);
  query.step = found->second.step;
  return 0;
}

int FakeV4l2::query_control(v4l2_query_ext_ctrl& query) const {
  const bool next = (query.id & V4L2_CTRL_FLAG_NEXT_CTRL) != 0;
  const std::uint32_t id = query.id & V4L2_CTRL_ID_MASK;
  const auto found = next ? controls.upper_bound(id) : controls.find(id);
  if (found == controls.end()) {
    return -EINVAL;
  }
  const Control& control = found->second;
  query.id = found->first;
  query.type = type_of(control);
  control.name.copy(query.name, sizeof query.name);
  query.minimum = control.minimum;
  query.maximum = control.maximum;
  query.step = static_cast<std::uint64_t>(control.step);
  query.flags = control.flags;
  return 0;
}

int FakeV4l2::query_menu(v4l2_querymenu& entry) const {
  const auto found = controls.find(entry.id);
  if (found == controls.end() || found->second.menu.count(entry.index) == 0) {
    return -EINVAL;
  }
  if (const auto text = found->second.texts.find(entry.index); text != found->second.texts.end()) {
    text->second.copy(reinterpret_cast<char*>(entry.name), sizeof entry.name);
  }
  if (const auto number = found->second.numbers.find(entry.index); number != found->second.numbers.end()) {
    entry.value = number->second;
  }
  return 0;
}

int FakeV4l2::set_control(std::uint32_t id, std::int64_t value) {
  const auto found = controls.find(id);
  if (found == controls.end() || (!found->second.menu.empty() && found->second.menu.count(value) == 0)) {
    return -EINVAL;
  }
  if ((found->second.flags & V4L2_CTRL_FLAG_INACTIVE) != 0) {
    return -EACCES;
  }
  if (found->second.type != V4L2_CTRL_TYPE_BITMASK &&
      (value < found->second.minimum || value > found->second.maximum)) {
    return -ERANGE;
  }
  found->second.value = value;
  if (on_control) {
    on_control(id);
  }
  return 0;
}

int FakeV4l2::set_controls(v4l2_ext_controls& wanted) {
  if (wanted.which != V4L2_CTRL_WHICH_CUR_VAL || wanted.count != 1) {
    return -EINVAL;
  }
  v4l2_ext_control& one = *wanted.controls;
  const auto found = controls.find(one.id);
  const bool wide = found != controls.end() && found->second.type == V4L2_CTRL_TYPE_INTEGER64;
  const int result = set_control(one.id, wide ? one.value64 : one.value);
  if (result == 0 && wide) {
    one.value64 = found->second.value;
  } else if (result == 0) {
    one.value = static_cast<std::int32_t>(found->second.value);
  }
  return result;
}

/// Whether a buffer of a request is of this device's kind, with its planes.
bool FakeV4l2::fits(const v4l2_buffer& buffer) const {
  return buffer.type == type() && buffer.memory == V4L2_MEMORY_MMAP &&
         (!multi_planar() || (buffer.m.planes != nullptr && buffer.length >= plane_count()));
}

int FakeV4l2::query_buffer(v4l2_buffer& buffer) {
  if (!fits(buffer) || buffer.index >= buffers_.size()) {
    return -EINVAL;
  }
  for (std::size_t plane = 0; multi_planar() && plane < plane_count(); ++plane) {
    buffer.m.planes[plane].length = static_cast<std::uint32_t>(buffers_[buffer.index].memory[plane].size());
    buffer.m.planes[plane].m.mem_offset =
        static_cast<std::uint32_t>(buffer.index * kMapStep + (plane == 0 ? 0 : kMapStep / 2));
  }
  if (!multi_planar()) {
    buffer.length = static_cast<std::uint32_t>(buffers_[buffer.index].memory[0].size());
    buffer.m.offset = static_cast<std::uint32_t>(buffer.index * kMapStep);
  }
  return 0;
}

int FakeV4l2::request_buffers(int fd, v4l2_requestbuffers& request) {
  if (owner_fd_ >= 0) {
    return -EBUSY;
  }
  if (request.type != type()) {
    return -EINVAL;
  }
  request.count = std::min(request.count, most_buffers);
  owner_fd_ = fd;
  buffers_.assign(request.count, {});
  for (Buffer& buffer : buffers_) {
    buffer.memory[0].resize(format_.sizeimage + data_offset);
    buffer.memory[1].resize(plane_count() == 2 ? format_.sizeimage / 2 + data_offset : 0);
  }
  queued_.clear();
  return 0;
}

int FakeV4l2::dequeue(v4l2_buffer& buffer) {
  if (broken_) {
    return -EIO;
  }
  if (done_.empty()) {
    return -EAGAIN;
  }
  if (!fits(buffer)) {
    return -EINVAL;
  }
  const Buffer& done = buffers_[done_.front()];
  v4l2_plane* planes = multi_planar() ? buffer.m.planes : nullptr;
  buffer = done.filled;
  if (planes != nullptr) {
    std::copy_n(done.planes.begin(), plane_count(), planes);
    buffer.m.planes = planes;
    buffer.length = static_cast<std::uint32_t>(plane_count());
  }
  done_.pop_front();
  return 0;
}

int FakeV4l2::stream(int fd, bool on) {
  streaming_fd_ = on ? fd : -1;
  broken_ = false;
  sequence_ = first_sequence;
  next_frame_ns_ = now_ns + period_ns;
  done_.clear();
  if (!on) {
    queued_.clear();
  }
  return 0;
}

}  // namespace facet::test
