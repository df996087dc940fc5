#include "camera/v4l2_device.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <set>

#include "camera/v4l2_controls.hpp"

namespace facet::camera {
namespace {

/// A driver's lists are read no further than this.
constexpr std::uint32_t kLongestList = 256;
/// 29.97 Hz is 30 Hz for who asks for it.
constexpr double kRateTolerance = 0.01;
/// With fewer the driver has no buffer to fill while a frame is converted.
constexpr unsigned kLeastBuffers = 2;

struct KnownFormat {
  std::uint32_t fourcc;
  const char* name;                   ///< one of kV4l2Formats
  std::optional<PixelLayout> layout;  ///< none: JPEG
  std::uint32_t planes = 1;           ///< blocks of memory
};
constexpr std::array kKnownFormats = {
    KnownFormat{V4L2_PIX_FMT_YUYV, "YUYV", PixelLayout::Yuyv},
    KnownFormat{V4L2_PIX_FMT_NV12M, "NV12", PixelLayout::Nv12, 2},
    KnownFormat{V4L2_PIX_FMT_NV12, "NV12", PixelLayout::Nv12},
    KnownFormat{V4L2_PIX_FMT_MJPEG, "MJPEG", std::nullopt},
    KnownFormat{V4L2_PIX_FMT_JPEG, "MJPEG", std::nullopt},
    KnownFormat{V4L2_PIX_FMT_GREY, "GREY", PixelLayout::Grey},
    KnownFormat{V4L2_PIX_FMT_Y16, "Y16", PixelLayout::Y16},
    KnownFormat{V4L2_PIX_FMT_Y10, "Y10", PixelLayout::Y10},
};

const KnownFormat* find_format(std::uint32_t fourcc) {
  const auto* found = std::find_if(kKnownFormats.begin(), kKnownFormats.end(),
                                   [&](const KnownFormat& format) { return format.fourcc == fourcc; });
  return found == kKnownFormats.end() ? nullptr : found;
}

std::string format_name(std::uint32_t fourcc) {
  if (const KnownFormat* known = find_format(fourcc)) {
    return known->name;
  }
  constexpr std::uint32_t kBigEndian = 1U << 31;
  std::string name;
  for (int i = 0; i < 4; ++i) {
    const char letter = static_cast<char>(fourcc >> 8 * i & 0x7F);
    name += letter > ' ' ? std::string(1, letter) : "";
  }
  return (fourcc & kBigEndian) != 0 ? name + "-BE" : name;
}

std::string describe_error(int error) {
  switch (error) {
    case ENOENT:
    case ENODEV:
    case ENXIO:
      return "no such device";
    case EBUSY:
      return "is in use by another program";
    case EACCES:
      return "may not be opened: the user must be in its group (video)";
    default:
      return std::strerror(error);
  }
}

/// Frames per second of the time between two; 0 where it says nothing.
double rate_of(const v4l2_fract& interval) {
  return interval.numerator == 0 ? 0.0 : static_cast<double>(interval.denominator) / interval.numerator;
}

bool has_size(const V4l2Mode& mode, int width_px, int height_px) {
  return width_px >= mode.min_width_px && width_px <= mode.max_width_px && height_px >= mode.min_height_px &&
         height_px <= mode.max_height_px;
}

bool has_rate(const V4l2Mode& mode, double rate_hz) {
  return mode.rates_hz.empty() ||
         std::any_of(mode.rates_hz.begin(), mode.rates_hz.end(), [&](const auto& range) {
           return rate_hz >= range.first * (1 - kRateTolerance) &&
                  rate_hz <= range.second * (1 + kRateTolerance);
         });
}

std::string describe_size(const V4l2Mode& mode) {
  if (mode.max_width_px == 0) {
    return "any size";
  }
  std::string text = fmt::format("{}x{}", mode.min_width_px, mode.min_height_px);
  if (mode.max_width_px != mode.min_width_px || mode.max_height_px != mode.min_height_px) {
    text += fmt::format(" to {}x{}", mode.max_width_px, mode.max_height_px);
  }
  return text;
}

std::string describe_rates(const V4l2Mode& mode) {
  std::vector<std::string> rates;
  for (const auto& [least, most] : mode.rates_hz) {
    rates.push_back(least == most ? fmt::format("{:.4g}", least)
                                  : fmt::format("{:.4g} to {:.4g}", least, most));
  }
  return rates.empty() ? "" : fmt::format(" at {} Hz", fmt::join(rates, ", "));
}

/// The sizes and rates of one format; sizes with the same rates stand together.
std::string describe_format(const std::vector<V4l2Mode>& modes, std::uint32_t fourcc) {
  std::string text;
  std::string rates;
  for (const V4l2Mode& mode : modes) {
    if (mode.fourcc != fourcc) {
      continue;
    }
    const std::string its_rates = describe_rates(mode);
    if (!text.empty()) {
      text += its_rates == rates ? ", " : rates + "; ";
    }
    text += describe_size(mode);
    rates = its_rates;
  }
  return text + rates;
}

/// Kr and Kb of the matrix that the driver names, or that its colour space implies
/// (V4L2_MAP_YCBCR_ENC_DEFAULT).
ColourCoding colour_coding(const v4l2_pix_format& pixels, bool grey) {
  ColourCoding coding;
  std::uint32_t encoding = pixels.ycbcr_enc;
  if (encoding == V4L2_YCBCR_ENC_DEFAULT) {
    encoding = V4L2_MAP_YCBCR_ENC_DEFAULT(pixels.colorspace);
  }
  if (encoding == V4L2_YCBCR_ENC_709 || encoding == V4L2_YCBCR_ENC_XV709) {
    coding.red_share = 0.2126;
    coding.blue_share = 0.0722;
  } else if (encoding == V4L2_YCBCR_ENC_BT2020) {
    coding.red_share = 0.2627;
    coding.blue_share = 0.0593;
  }
  if (pixels.quantization == V4L2_QUANTIZATION_DEFAULT) {
    // Grey sensors use all values, as the kernel's own pattern generator does.
    coding.full_range = grey || pixels.colorspace == V4L2_COLORSPACE_JPEG;
  } else {
    coding.full_range = pixels.quantization == V4L2_QUANTIZATION_FULL_RANGE;
  }
  return coding;
}

}  // namespace

V4l2Device::V4l2Device(V4l2Kernel& kernel, const std::string& path) : kernel_(kernel), path_(path) {
  fd_ = kernel_.open(path);
  if (fd_ < 0) {
    fail(-fd_, "");
  }
  try {
    v4l2_capability capability{};
    if (!ask(VIDIOC_QUERYCAP, &capability, "VIDIOC_QUERYCAP")) {
      refuse("is no video device");
    }
    card_ = std::string(reinterpret_cast<const char*>(capability.card),
                        ::strnlen(reinterpret_cast<const char*>(capability.card), sizeof capability.card));
    const std::uint32_t can = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? capability.device_caps
                                                                                    : capability.capabilities;
    constexpr std::uint32_t kWays = V4L2_CAP_STREAMING | V4L2_CAP_READWRITE | V4L2_CAP_EXT_PIX_FORMAT;
    if ((can & ~kWays) == 0 || (can & ~kWays) == V4L2_CAP_VIDEO_OUTPUT) {
      // v4l2loopback with exclusive_caps=1: nothing has written into it, or its writer is gone.
      throw DeviceFault(DeviceFault::Kind::Failing, "gives no pictures: nothing writes into it");
    }
    if ((can & (V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_VIDEO_CAPTURE_MPLANE)) == 0 ||
        (can & V4L2_CAP_STREAMING) == 0) {
      refuse("does not stream pictures into memory (a camera has further devices for other things)");
    }
    if ((can & V4L2_CAP_VIDEO_CAPTURE) == 0) {
      type_ = V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE;
    }
    read_modes();
  } catch (...) {
    close();
    throw;
  }
}

V4l2Device::~V4l2Device() {
  close();
}

void V4l2Device::close() {
  if (fd_ < 0) {
    return;
  }
  if (streaming_) {
    kernel_.ioctl(fd_, VIDIOC_STREAMOFF, &type_);
  }
  for (const Planes& planes : buffers_) {
    for (const Mapping& mapping : planes) {
      if (mapping.start != nullptr) {
        kernel_.unmap(mapping.start, mapping.length);
      }
    }
  }
  kernel_.close(std::exchange(fd_, -1));
}

void V4l2Device::fail(int error, const std::string& what) const {
  const bool absent = error == ENODEV || error == ENXIO || error == ENOENT;
  throw DeviceFault(absent ? DeviceFault::Kind::Absent : DeviceFault::Kind::Failing,
                    fmt::format("{}{}", describe_error(error), what.empty() ? "" : " (" + what + ")"));
}

void V4l2Device::refuse(const std::string& what) const {
  throw DeviceFault(DeviceFault::Kind::Unsuitable, what);
}

bool V4l2Device::ask(unsigned long request, void* argument, const char* what) const {
  const int result = kernel_.ioctl(fd_, request, argument);
  if (result >= 0) {
    return true;
  }
  constexpr std::array kRefusals = {EINVAL, ENOTTY, ENODATA, ERANGE, EACCES};
  if (std::find(kRefusals.begin(), kRefusals.end(), -result) == kRefusals.end()) {
    fail(-result, what);
  }
  return false;
}

void V4l2Device::demand(unsigned long request, void* argument, const char* what) const {
  const int result = kernel_.ioctl(fd_, request, argument);
  if (result < 0) {
    fail(-result, what);
  }
}

void V4l2Device::read_modes() {
  v4l2_fmtdesc format{};
  format.type = type_;
  while (format.index < kLongestList && ask(VIDIOC_ENUM_FMT, &format, "VIDIOC_ENUM_FMT")) {
    if (find_format(format.pixelformat) != nullptr) {
      read_sizes(format.pixelformat);
    } else {
      unread_formats_.push_back(format_name(format.pixelformat));
    }
    ++format.index;
  }
}

void V4l2Device::read_sizes(std::uint32_t fourcc) {
  const std::size_t before = modes_.size();
  v4l2_frmsizeenum size{};
  size.pixel_format = fourcc;
  while (size.index < kLongestList && ask(VIDIOC_ENUM_FRAMESIZES, &size, "VIDIOC_ENUM_FRAMESIZES")) {
    V4l2Mode& mode = modes_.emplace_back();
    mode.fourcc = fourcc;
    const bool discrete = size.type == V4L2_FRMSIZE_TYPE_DISCRETE;
    mode.min_width_px = static_cast<int>(discrete ? size.discrete.width : size.stepwise.min_width);
    mode.min_height_px = static_cast<int>(discrete ? size.discrete.height : size.stepwise.min_height);
    mode.max_width_px = static_cast<int>(discrete ? size.discrete.width : size.stepwise.max_width);
    mode.max_height_px = static_cast<int>(discrete ? size.discrete.height : size.stepwise.max_height);
    read_rates(mode);
    if (!discrete) {
      return;  // one range is all there is
    }
    ++size.index;
  }
  if (modes_.size() == before) {
    modes_.emplace_back().fourcc = fourcc;  // the driver tells no sizes
  }
}

void V4l2Device::read_rates(V4l2Mode& mode) const {
  v4l2_frmivalenum interval{};
  interval.pixel_format = mode.fourcc;
  interval.width = static_cast<std::uint32_t>(mode.max_width_px);
  interval.height = static_cast<std::uint32_t>(mode.max_height_px);
  while (interval.index < kLongestList &&
         ask(VIDIOC_ENUM_FRAMEINTERVALS, &interval, "VIDIOC_ENUM_FRAMEINTERVALS")) {
    if (interval.type != V4L2_FRMIVAL_TYPE_DISCRETE) {
      // The shortest time between frames is the highest rate.
      mode.rates_hz.emplace_back(rate_of(interval.stepwise.max), rate_of(interval.stepwise.min));
      return;
    }
    mode.rates_hz.emplace_back(rate_of(interval.discrete), rate_of(interval.discrete));
    ++interval.index;
  }
}

std::string V4l2Device::offer() const {
  constexpr std::size_t kNamed = 6;
  // Formats with the same sizes and rates stand together, in the order of the device.
  std::vector<std::pair<std::string, std::string>> formats;  // what is offered, names
  std::set<std::uint32_t> seen;
  std::set<std::string> told;  // NV12 may be there in one block of memory and in two
  for (const V4l2Mode& mode : modes_) {
    const std::string name = format_name(mode.fourcc);
    if (!seen.insert(mode.fourcc).second) {
      continue;
    }
    const std::string text = describe_format(modes_, mode.fourcc);
    if (!told.insert(name + " " + text).second) {
      continue;
    }
    const auto same =
        std::find_if(formats.begin(), formats.end(), [&](const auto& other) { return other.first == text; });
    if (same == formats.end()) {
      formats.emplace_back(text, name);
    } else {
      same->second += ", " + name;
    }
  }
  std::vector<std::string> parts;
  parts.reserve(formats.size() + 1);
  for (const auto& [text, names] : formats) {
    parts.push_back(names + " " + text);
  }
  if (!unread_formats_.empty()) {
    const auto end =
        unread_formats_.begin() + static_cast<std::ptrdiff_t>(std::min(kNamed, unread_formats_.size()));
    const std::size_t more = unread_formats_.size() - std::min(kNamed, unread_formats_.size());
    parts.push_back(fmt::format("{}{}, which Facet does not read",
                                fmt::join(unread_formats_.begin(), end, ", "),
                                more > 0 ? fmt::format(" and {} more", more) : ""));
  }
  return parts.empty() ? "no pixel format yet" : fmt::format("{}", fmt::join(parts, "; "));
}

std::string V4l2Device::controls() const {
  return describe_named_controls(
      [this](unsigned long request, void* argument) { return ask(request, argument, "controls"); });
}

std::uint32_t V4l2Device::choose(const LiveConfig& config) const {
  if (modes_.empty() && unread_formats_.empty()) {
    // As v4l2loopback does until something writes into it.
    throw DeviceFault(DeviceFault::Kind::Failing, "offers " + offer());
  }
  for (const KnownFormat& format : kKnownFormats) {
    if (config.format != "auto" && config.format != format.name) {
      continue;
    }
    for (const V4l2Mode& mode : modes_) {
      const bool sizes_unknown = mode.max_width_px == 0;
      if (mode.fourcc == format.fourcc &&
          (sizes_unknown ||
           (has_size(mode, config.width_px, config.height_px) && has_rate(mode, config.rate_hz)))) {
        return format.fourcc;
      }
    }
  }
  refuse(fmt::format("source.format \"{}\" at {}x{} px and {:.4g} Hz is not among what the device has: {}",
                     config.format, config.width_px, config.height_px, config.rate_hz, offer()));
}

void V4l2Device::check(const LiveConfig& config) const {
  choose(config);
  const std::string wrong = check_controls(
      config, [this](unsigned long request, void* argument) { return ask(request, argument, "controls"); });
  if (!wrong.empty()) {
    refuse(wrong);
  }
}

void V4l2Device::start(const LiveConfig& config) {
  check(config);
  set_format(config);
  set_rate(config);
  const std::string refused = set_controls(
      config, [this](unsigned long request, void* argument) { return ask(request, argument, "controls"); });
  if (!refused.empty()) {
    throw DeviceFault(DeviceFault::Kind::Failing, refused);
  }
  map_buffers(config.buffers);
  started_ns_ = kernel_.monotonic_ns();
  demand(VIDIOC_STREAMON, &type_, "VIDIOC_STREAMON");
  streaming_ = true;
}

/// Sets a format; what the device made of it, as the single-planar interface tells it.
v4l2_pix_format V4l2Device::demand_format(const v4l2_pix_format& wanted) {
  v4l2_format format{};
  format.type = type_;
  plane_count_ = 1;
  if (!multi_planar()) {
    format.fmt.pix = wanted;
    demand(VIDIOC_S_FMT, &format, "VIDIOC_S_FMT");
    return format.fmt.pix;
  }
  v4l2_pix_format_mplane& planes = format.fmt.pix_mp;
  planes.width = wanted.width;
  planes.height = wanted.height;
  planes.pixelformat = wanted.pixelformat;
  planes.field = wanted.field;
  planes.num_planes = static_cast<std::uint8_t>(find_format(wanted.pixelformat)->planes);
  demand(VIDIOC_S_FMT, &format, "VIDIOC_S_FMT");
  if (planes.pixelformat == wanted.pixelformat &&
      (planes.num_planes != find_format(wanted.pixelformat)->planes ||
       (planes.num_planes == 2 && planes.plane_fmt[1].bytesperline != planes.plane_fmt[0].bytesperline))) {
    refuse(
        fmt::format("gives {} in {} blocks of memory, or with other rows in each, which Facet does not read",
                    format_name(planes.pixelformat), planes.num_planes));
  }
  plane_count_ = planes.num_planes;
  v4l2_pix_format given{};
  given.width = planes.width;
  given.height = planes.height;
  given.pixelformat = planes.pixelformat;
  given.field = planes.field;
  given.bytesperline = planes.plane_fmt[0].bytesperline;
  given.colorspace = planes.colorspace;
  given.ycbcr_enc = planes.ycbcr_enc;
  given.quantization = planes.quantization;
  return given;
}

void V4l2Device::set_format(const LiveConfig& config) {
  const std::uint32_t fourcc = choose(config);
  v4l2_pix_format pixels{};
  pixels.width = static_cast<std::uint32_t>(config.width_px);
  pixels.height = static_cast<std::uint32_t>(config.height_px);
  pixels.pixelformat = fourcc;
  pixels.field = V4L2_FIELD_NONE;
  pixels.priv = V4L2_PIX_FMT_PRIV_MAGIC;  // so that the kernel fills in encoding and quantization
  pixels = demand_format(pixels);
  if (pixels.pixelformat != fourcc || static_cast<int>(pixels.width) != config.width_px ||
      static_cast<int>(pixels.height) != config.height_px) {
    refuse(fmt::format("gives {} {}x{} px instead of {} {}x{} px; it has: {}",
                       format_name(pixels.pixelformat), pixels.width, pixels.height, format_name(fourcc),
                       config.width_px, config.height_px, offer()));
  }
  if (pixels.field != V4L2_FIELD_NONE && pixels.field != V4L2_FIELD_ANY) {
    refuse("gives half pictures (interlaced), which can't be used");
  }
  format_ = {};
  format_.layout = find_format(fourcc)->layout;
  if (!format_.layout) {
    format_.least_bytes = 1;
    return;
  }
  const PixelLayout layout = *format_.layout;
  format_.coding = colour_coding(pixels, layout != PixelLayout::Yuyv && layout != PixelLayout::Nv12);
  format_.stride_bytes =
      std::max<std::size_t>(pixels.bytesperline, packed_stride_bytes(layout, config.width_px));
  format_.least_bytes = picture_bytes(layout, config.width_px, config.height_px, format_.stride_bytes);
  if (plane_count_ == 2) {
    const std::size_t both = format_.least_bytes;
    format_.least_bytes =
        picture_bytes(PixelLayout::Grey, config.width_px, config.height_px, format_.stride_bytes);
    format_.least_chroma_bytes = both - static_cast<std::size_t>(config.height_px) * format_.stride_bytes;
  }
}

void V4l2Device::set_rate(const LiveConfig& config) const {
  v4l2_streamparm parameters{};
  parameters.type = type_;
  // Thousandths: enough for 29.97.
  parameters.parm.capture.timeperframe = {1000,
                                          static_cast<std::uint32_t>(std::lround(config.rate_hz * 1000))};
  if (!ask(VIDIOC_S_PARM, &parameters, "VIDIOC_S_PARM")) {
    return;  // what delivers pictures of another machine has that one's rate
  }
  const double given_hz = rate_of(parameters.parm.capture.timeperframe);
  if (given_hz > 0 && std::abs(given_hz - config.rate_hz) > kRateTolerance * config.rate_hz) {
    refuse(fmt::format("gives {:.4g} Hz instead of source.rate_hz = {:.4g}; it has: {}", given_hz,
                       config.rate_hz, offer()));
  }
}

void V4l2Device::map_buffers(unsigned count) {
  v4l2_requestbuffers request{};
  request.count = count;
  request.type = type_;
  request.memory = V4L2_MEMORY_MMAP;
  demand(VIDIOC_REQBUFS, &request, "VIDIOC_REQBUFS");
  if (request.count < kLeastBuffers) {
    fail(ENOMEM, fmt::format("the driver has {} of {} buffers", request.count, count));
  }
  for (std::uint32_t index = 0; index < request.count; ++index) {
    std::array<v4l2_plane, kMostPlanes> planes{};
    v4l2_buffer buffer = new_buffer(index, planes);
    demand(VIDIOC_QUERYBUF, &buffer, "VIDIOC_QUERYBUF");
    buffers_.emplace_back();
    for (std::uint32_t plane = 0; plane < plane_count_; ++plane) {
      Mapping& mapping = buffers_.back()[plane];
      mapping.length = multi_planar() ? planes[plane].length : buffer.length;
      mapping.start =
          kernel_.map(fd_, mapping.length, multi_planar() ? planes[plane].m.mem_offset : buffer.m.offset);
      if (mapping.start == nullptr) {
        fail(ENOMEM, "mmap");
      }
    }
    queue(index);
  }
}

v4l2_buffer V4l2Device::new_buffer(std::uint32_t index, std::array<v4l2_plane, kMostPlanes>& planes) const {
  v4l2_buffer buffer{};
  buffer.type = type_;
  buffer.memory = V4L2_MEMORY_MMAP;
  buffer.index = index;
  if (multi_planar()) {
    buffer.m.planes = planes.data();
    buffer.length = plane_count_;
  }
  return buffer;
}

void V4l2Device::wait(std::int64_t until_ns) {
  const int events = kernel_.wait(fd_, until_ns);
  if (events < 0) {
    fail(-events, "poll");
  }
  if ((events & (POLLERR | POLLHUP | POLLNVAL)) != 0 && (events & POLLIN) == 0) {
    // VIDIOC_DQBUF says which error; where it does not, this is one by itself.
    dequeue();
    fail((events & POLLHUP) != 0 ? ENODEV : EIO, "poll");
  }
}

std::optional<v4l2_buffer> V4l2Device::dequeue() {
  std::array<v4l2_plane, kMostPlanes> planes{};
  v4l2_buffer buffer = new_buffer(0, planes);
  const int result = kernel_.ioctl(fd_, VIDIOC_DQBUF, &buffer);
  if (result == -EAGAIN) {
    return std::nullopt;
  }
  if (result < 0) {
    fail(-result, "VIDIOC_DQBUF");
  }
  if (buffer.index >= buffers_.size()) {
    fail(EIO, fmt::format("the driver filled a buffer {} that it does not have", buffer.index));
  }
  for (std::uint32_t plane = 0; plane < plane_count_; ++plane) {
    Mapping& mapping = buffers_[buffer.index][plane];
    // Of several planes, what is before the picture counts as used too.
    const std::size_t begin = multi_planar() ? planes[plane].data_offset : 0;
    const std::size_t end = multi_planar() ? planes[plane].bytesused : buffer.bytesused;
    mapping.filled = {};
    if (begin <= end && end <= mapping.length) {
      mapping.filled = {static_cast<const std::uint8_t*>(mapping.start) + begin, end - begin};
    }
  }
  buffer.m.planes = nullptr;  // they end with this call
  return buffer;
}

void V4l2Device::queue(std::uint32_t index) {
  std::array<v4l2_plane, kMostPlanes> planes{};
  v4l2_buffer buffer = new_buffer(index, planes);
  demand(VIDIOC_QBUF, &buffer, "VIDIOC_QBUF");
}

}  // namespace facet::camera
