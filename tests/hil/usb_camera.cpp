// A USB camera in software: the kernel's USB/IP host controller (module vhci_hcd) gets a USB Video Class
// device over a socket pair, so that its real driver uvcvideo is what programs see. Its pictures carry a
// painted number.
//
//   usb_camera [--port N] [--lines FOLDER --pattern-lines N [--trigger LINE --exposure-ms T]]
//     --port N            of the host controller, 0 to 7: one for each camera
//     --lines FOLDER      of a simulated GPIO chip, such as /sys/devices/platform/gpio-sim.0/gpiochip0: what
//     lines 0 to
//                         N - 1 show at the start of a picture is its pattern
//     --trigger LINE      a picture begins as this line of it rises; without it the camera runs free
//     --exposure-ms T     how long the trigger's program holds the pattern: a camera that looks at the line
//     later than
//                         that misses the picture rather than show what came after
//
// Standard input steers it, a word a line:
//   plug, unplug          at first it is unplugged
//   freeze, resume        no picture is sent in between, as by a camera whose firmware hangs
//   error                 the next picture is marked as bad
//   short                 the next picture ends half way
//   stall                 the endpoint answers once with an error
//   garbage               the next picture's bytes are noise
//   skip N                the next N pictures are taken, and not sent
//   status                prints {"event":"status", ...}
// It prints {"event":...,"time_ns":...} for plugged, unplugged and streaming (the driver began),
// CLOCK_MONOTONIC.
//
// Protocols: Universal Serial Bus Video Class 1.0 with a bulk endpoint (USB/IP has no exact times for
// isochronous ones), USB 2.0 chapter 9, and the kernel's Documentation/usb/usbip_protocol.rst.

#include <arpa/inet.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <deque>
#include <map>
#include <optional>
#include <random>
#include <span>
#include <stdexcept>
#include <string>
#include <system_error>
#include <thread>
#include <vector>

#include "painted_number.hpp"
#include "usb_descriptors.hpp"

// After <cstdio>, which it needs and does not name.
#include <jpeglib.h>

namespace facet::hil {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr const char* kController = "/sys/devices/platform/vhci_hcd.0";

std::int64_t now_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kSecond_ns + now.tv_nsec;
}

[[noreturn]] void fail(const std::string& what) {
  throw std::system_error(errno, std::generic_category(), what);
}

void say(const std::string& event) {
  fmt::print("{{\"event\":\"{}\",\"time_ns\":{}}}\n", event, now_ns());
  std::fflush(stdout);
}

/// A closed-over file descriptor.
class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int fd) : fd_(fd) {}
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~Descriptor() { reset(); }
  void reset() {
    if (fd_ >= 0) {
      ::close(std::exchange(fd_, -1));
    }
  }
  int get() const { return fd_; }
  explicit operator bool() const { return fd_ >= 0; }

 private:
  int fd_ = -1;
};

// The wire to the host controller.

enum class UsbipCommand : std::uint32_t { Submit = 1, Unlink = 2, ReturnSubmit = 3, ReturnUnlink = 4 };

/// Every message begins with this, each word in network order; the setup packet is as on USB.
struct UsbipHeader {
  std::uint32_t command = 0;
  std::uint32_t sequence = 0;
  std::uint32_t device = 0;
  std::uint32_t direction = 0;  ///< 1: to the host
  std::uint32_t endpoint = 0;
  std::uint32_t flags_or_status = 0;  ///< Unlink: the sequence of what is given up
  std::uint32_t length = 0;           ///< of the data
  std::array<std::uint32_t, 3> isochronous{};
  std::array<std::uint8_t, 8> setup{};
};
static_assert(sizeof(UsbipHeader) == 48);

void swap_order(UsbipHeader& header) {
  for (std::uint32_t* word : {&header.command, &header.sequence, &header.device, &header.direction,
                              &header.endpoint, &header.flags_or_status, &header.length}) {
    *word = ntohl(*word);
  }
}

/// The GPIO lines of a simulated chip, read where the simulator shows them.
class WatchedLines {
 public:
  WatchedLines(const std::string& folder, int pattern_lines, int trigger_line, double exposure_ms)
      : exposure_ns_(static_cast<std::int64_t>(exposure_ms * 1e6)) {
    for (int line = 0; line < pattern_lines; ++line) {
      pattern_.push_back(open(folder, line));
    }
    if (trigger_line >= 0) {
      trigger_ = open(folder, trigger_line);
    }
  }

  bool triggers() const { return static_cast<bool>(trigger_); }

  enum class Look { Rest, Fired, TooLate };
  /// Whether the trigger has risen since the last look; reads the pattern where it has. Too late: that look
  /// lies so far back that the pattern may be another exposure's.
  Look look() {
    const bool active = level(trigger_);
    const bool rose = active && !triggered_;
    triggered_ = active;
    if (rose) {
      read_pattern();
      const bool certain = level(trigger_) && now_ns() - rested_ns_ < exposure_ns_;
      return certain ? Look::Fired : Look::TooLate;
    }
    if (!active) {
      rested_ns_ = now_ns();
    }
    return Look::Rest;
  }

  void read_pattern() {
    bits_ = 0;
    for (std::size_t i = 0; i < pattern_.size(); ++i) {
      bits_ |= level(pattern_[i]) ? 1U << i : 0;
    }
  }
  std::uint32_t pattern() const { return bits_; }

 private:
  static Descriptor open(const std::string& folder, int line) {
    const std::string path = fmt::format("{}/sim_gpio{}/value", folder, line);
    Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
    if (!file) {
      fail(path);
    }
    return file;
  }
  static bool level(const Descriptor& file) {
    char letter = '0';
    return ::pread(file.get(), &letter, 1, 0) == 1 && letter == '1';
  }

  std::int64_t exposure_ns_;
  std::vector<Descriptor> pattern_;
  Descriptor trigger_;
  bool triggered_ = false;
  std::int64_t rested_ns_ = 0;  ///< when the trigger was last seen at rest
  std::uint32_t bits_ = 0;
};

class UsbCamera {
 public:
  UsbCamera(int port, WatchedLines& lines) : lines_(lines), port_(port) {
    select(kYuyv, 0, kRates_hz.front());
  }

  /// Until the end of standard input.
  void run() {
    while (!ended_) {
      begin_picture();
      send_picture();
      wait();
    }
  }

 private:
  struct Request {
    std::uint32_t sequence;
    std::size_t length;
  };

  // Cable.

  void plug() {
    std::array<int, 2> ends{};
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0) {
      fail("socketpair");
    }
    Descriptor own(ends[0]);
    const Descriptor controllers(ends[1]);
    const int buffer_bytes = 4 << 20;
    ::setsockopt(own.get(), SOL_SOCKET, SO_SNDBUFFORCE, &buffer_bytes, sizeof buffer_bytes);
    const std::string attach = fmt::format("{}/attach", kController);
    // Port, socket, device number, speed: 3 is high speed (480 Mbit/s).
    const std::string words = fmt::format("{} {} {} 3", port_, controllers.get(), port_ + 1);
    constexpr int kTries = 300;
    for (int i = 0; i < kTries; ++i) {
      const Descriptor file(::open(attach.c_str(), O_WRONLY | O_CLOEXEC));
      if (!file) {
        fail(attach + " (is the module vhci_hcd loaded?)");
      }
      if (::write(file.get(), words.data(), words.size()) == static_cast<ssize_t>(words.size())) {
        host_ = std::move(own);
        say("plugged");
        return;
      }
      // The port is still busy with the device before.
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    fail(attach);
  }

  void unplug() {
    host_.reset();
    stop_streaming();
    say("unplugged");
  }

  // Pictures.

  void select(int format, std::size_t size, int rate_hz) {
    format_ = format;
    size_ = size;
    rate_hz_ = rate_hz;
    const auto& [width, height] = kSizes.at(size);
    // A grey ramp.
    picture_.resize(static_cast<std::size_t>(width * height) * 2);
    for (std::size_t i = 0; i < picture_.size(); i += 2) {
      picture_[i] = static_cast<std::uint8_t>(64 + i / 2 % static_cast<std::size_t>(width) * 128 /
                                                       static_cast<std::size_t>(width));
      picture_[i + 1] = 128;
    }
  }

  void stop_streaming() {
    streaming_ = false;
    sent_.reset();
    requests_.clear();
  }

  std::int64_t period_ns() const { return kSecond_ns / rate_hz_; }

  /// Takes a picture when it is time for one.
  void begin_picture() {
    if (lines_.triggers()) {
      const WatchedLines::Look look = lines_.look();
      if (look == WatchedLines::Look::Rest || !streaming_) {
        return;
      }
      if (look == WatchedLines::Look::TooLate || frozen_ || sent_) {
        ++missed_;
        return;
      }
    } else {
      const std::int64_t now = now_ns();
      if (!streaming_ || frozen_ || sent_ || now < due_ns_) {
        return;
      }
      // Late by more than a period: those between are missed.
      const std::int64_t late = (now - due_ns_) / period_ns();
      missed_ += late;
      taken_ += static_cast<std::uint32_t>(late);
      due_ns_ += (late + 1) * period_ns();
      lines_.read_pattern();
    }
    paint(picture_, kSizes[size_].width_px, kSizes[size_].height_px,
          {taken_++ & kPictureMask, lines_.pattern()});
    if (skip_ > 0) {
      --skip_;
      return;
    }
    if (format_ == kMjpeg) {
      compress();
    } else {
      bytes_ = picture_;
    }
    if (std::exchange(garbage_, false)) {
      std::generate(bytes_.begin(), bytes_.end(), [noise = std::minstd_rand()]() mutable {
        return static_cast<std::uint8_t>(noise() >> 8);
      });
    }
    marked_ = std::exchange(error_, false);
    if (std::exchange(short_, false)) {
      bytes_.resize(bytes_.size() / 2);
    }
    sent_ = 0;
  }

  /// The picture as JPEG, of which the painted cells are whole blocks.
  void compress() {
    const auto& [width, height] = kSizes[size_];
    jpeg_compress_struct jpeg{};
    jpeg_error_mgr errors{};
    jpeg.err = jpeg_std_error(&errors);
    jpeg_create_compress(&jpeg);
    unsigned char* data = nullptr;
    unsigned long size = 0;
    jpeg_mem_dest(&jpeg, &data, &size);
    jpeg.image_width = static_cast<JDIMENSION>(width);
    jpeg.image_height = static_cast<JDIMENSION>(height);
    jpeg.input_components = 1;  // all pictures are grey
    jpeg.in_color_space = JCS_GRAYSCALE;
    jpeg_set_defaults(&jpeg);
    jpeg.dct_method = JDCT_FASTEST;
    jpeg_start_compress(&jpeg, TRUE);
    std::vector<std::uint8_t> row(static_cast<std::size_t>(width));
    while (jpeg.next_scanline < jpeg.image_height) {
      const std::size_t begin = std::size_t{jpeg.next_scanline} * row.size() * 2;
      for (std::size_t x = 0; x < row.size(); ++x) {
        row[x] = picture_[begin + 2 * x];
      }
      JSAMPROW rows = row.data();
      jpeg_write_scanlines(&jpeg, &rows, 1);
    }
    jpeg_finish_compress(&jpeg);
    bytes_.assign(data, data + size);
    std::free(data);
    jpeg_destroy_compress(&jpeg);
  }

  /// Answers the driver's requests with what is left of the picture.
  void send_picture() {
    while (sent_ && !requests_.empty()) {
      const Request request = requests_.front();
      requests_.pop_front();
      if (stall_) {
        stall_ = false;
        answer(request.sequence, -EPIPE, {}, 0, true);
        continue;
      }
      const std::size_t count =
          std::min(bytes_.size() - *sent_, std::min(request.length, kPayloadBytes) - kPayloadHeaderBytes);
      const bool last = *sent_ + count == bytes_.size();
      const std::array<std::uint8_t, kPayloadHeaderBytes> header = {
          kPayloadHeaderBytes,
          static_cast<std::uint8_t>(UVC_STREAM_EOH | (odd_ ? UVC_STREAM_FID : 0) |
                                    (last ? UVC_STREAM_EOF : 0) | (marked_ ? UVC_STREAM_ERR : 0))};
      answer(request.sequence, 0, header, 0, true, std::span(bytes_).subspan(*sent_, count));
      if (!sent_) {
        return;  // unplugged
      }
      *sent_ += count;
      if (last) {
        sent_.reset();
        odd_ = !odd_;
        ++pictures_sent_;
      }
    }
  }

  // USB/IP.

  void answer(std::uint32_t sequence, int status, std::span<const std::uint8_t> data, std::size_t taken_bytes,
              bool to_host, std::span<const std::uint8_t> more = {}) {
    const std::size_t length = to_host ? data.size() + more.size() : taken_bytes;
    UsbipHeader header;
    header.command = static_cast<std::uint32_t>(UsbipCommand::ReturnSubmit);
    header.sequence = sequence;
    header.flags_or_status = static_cast<std::uint32_t>(status);
    header.length = static_cast<std::uint32_t>(length);
    swap_order(header);
    std::array<iovec, 3> parts = {iovec{&header, sizeof header},
                                  iovec{const_cast<std::uint8_t*>(data.data()), to_host ? data.size() : 0},
                                  iovec{const_cast<std::uint8_t*>(more.data()), more.size()}};
    send(parts);
  }

  void send(std::span<iovec> parts) {
    while (!parts.empty()) {
      msghdr message{};
      message.msg_iov = parts.data();
      message.msg_iovlen = parts.size();
      ssize_t sent = ::sendmsg(host_.get(), &message, MSG_NOSIGNAL);
      if (sent < 0) {
        if (errno == EINTR) {
          continue;
        }
        unplug();  // the controller let it go
        return;
      }
      while (!parts.empty() && static_cast<std::size_t>(sent) >= parts.front().iov_len) {
        sent -= static_cast<ssize_t>(parts.front().iov_len);
        parts = parts.subspan(1);
      }
      if (!parts.empty()) {
        parts.front().iov_base = static_cast<std::uint8_t*>(parts.front().iov_base) + sent;
        parts.front().iov_len -= static_cast<std::size_t>(sent);
      }
    }
  }

  bool receive(void* data, std::size_t size) {
    return ::recv(host_.get(), data, size, MSG_WAITALL) == static_cast<ssize_t>(size);
  }

  void serve() {
    UsbipHeader header;
    if (!receive(&header, sizeof header)) {
      unplug();
      return;
    }
    swap_order(header);
    if (static_cast<UsbipCommand>(header.command) == UsbipCommand::Unlink) {
      give_up(header.sequence, header.flags_or_status);
    } else if (header.endpoint == kEndpoint) {
      if (!streaming_) {
        streaming_ = true;
        due_ns_ = now_ns();
        say("streaming");
      }
      requests_.push_back({header.sequence, header.length});
    } else {
      std::vector<std::uint8_t> data(header.direction == 0 ? header.length : 0);
      if (!data.empty() && !receive(data.data(), data.size())) {
        unplug();
        return;
      }
      control(header, data);
    }
  }

  void give_up(std::uint32_t sequence, std::uint32_t what) {
    const auto found = std::find_if(requests_.begin(), requests_.end(),
                                    [&](const Request& r) { return r.sequence == what; });
    UsbipHeader header;
    header.command = static_cast<std::uint32_t>(UsbipCommand::ReturnUnlink);
    header.sequence = sequence;
    if (found != requests_.end()) {
      requests_.erase(found);
      header.flags_or_status = static_cast<std::uint32_t>(-ECONNRESET);
    }
    swap_order(header);
    std::array<iovec, 1> parts = {iovec{&header, sizeof header}};
    send(parts);
    if (requests_.empty()) {
      stop_streaming();
    }
  }

  /// A request of the default endpoint: answered, or refused as USB does, by a stall.
  void control(const UsbipHeader& header, std::span<const std::uint8_t> data) {
    usb_ctrlrequest setup{};
    std::memcpy(&setup, header.setup.data(), sizeof setup);
    const bool to_host = header.direction != 0;
    std::optional<Bytes> reply;
    if ((setup.bRequestType & USB_TYPE_MASK) == USB_TYPE_STANDARD) {
      reply = standard(setup);
    } else if (to_host) {
      reply = read_control(setup);
    } else if (write_control(setup, data)) {
      reply.emplace();
    }
    if (!reply) {
      answer(header.sequence, -EPIPE, {}, 0, to_host);
      return;
    }
    const std::size_t count = std::min<std::size_t>(reply->size(), setup.wLength);
    answer(header.sequence, 0, std::span(reply->data()).first(count), data.size(), to_host);
  }

  std::optional<Bytes> standard(const usb_ctrlrequest& setup) {
    const int index = setup.wValue & 0xFF;
    switch (setup.bRequest) {
      case USB_REQ_GET_DESCRIPTOR:
        switch (setup.wValue >> 8) {
          case USB_DT_DEVICE:
            return device_descriptor(port_);
          case USB_DT_CONFIG:
            return configuration_descriptor();
          case USB_DT_STRING:
            return index <= 3 ? std::optional(string_descriptor(index, fmt::format("{}", port_)))
                              : std::nullopt;
          default:
            return std::nullopt;
        }
      case USB_REQ_GET_STATUS:
        return Bytes().u16(0);
      case USB_REQ_CLEAR_FEATURE:  // the endpoint's halt, with which uvcvideo ends a bulk stream
      case USB_REQ_SET_INTERFACE:
        stop_streaming();
        return Bytes();
      default:
        return Bytes();
    }
  }

  /// What VS_PROBE_CONTROL and VS_COMMIT_CONTROL say: format, frame, interval, sizes (UVC 1.0, 26 bytes).
  Bytes probe() const {
    return Bytes()
        .u16(1)
        .u8({format_, static_cast<int>(size_) + 1})
        .u32(kIntervalUnit_hz / static_cast<std::uint32_t>(rate_hz_))
        .u16(0)
        .u16(0)
        .u16(0)
        .u16(0)
        .u16(0)
        .u32(static_cast<std::uint32_t>(picture_.size()))
        .u32(kPayloadBytes);
  }

  std::optional<Bytes> read_control(const usb_ctrlrequest& setup) const {
    constexpr int kReadAndWrite = UVC_CONTROL_CAP_GET | UVC_CONTROL_CAP_SET;
    const int selector = setup.wValue >> 8;
    if ((setup.wIndex & 0xFF) == kStreamingInterface) {
      if (selector != UVC_VS_PROBE_CONTROL && selector != UVC_VS_COMMIT_CONTROL) {
        return std::nullopt;
      }
      switch (setup.bRequest) {
        case UVC_GET_INFO:
          return Bytes().u8({kReadAndWrite});
        case UVC_GET_LEN:
          return Bytes().u16(static_cast<unsigned>(probe().size()));
        default:
          return probe();
      }
    }
    const auto found = controls_.find({setup.wIndex >> 8, selector});
    if (found == controls_.end()) {
      return std::nullopt;
    }
    const Control& control = found->second;
    std::uint32_t value = control.value;
    switch (setup.bRequest) {
      case UVC_GET_INFO:
        return Bytes().u8({kReadAndWrite});
      case UVC_GET_LEN:
        return Bytes().u16(static_cast<unsigned>(control.bytes));
      case UVC_GET_MIN:
        value = control.minimum;
        break;
      case UVC_GET_MAX:
        value = control.maximum;
        break;
      case UVC_GET_RES:
        value = control.resolution;
        break;
      case UVC_GET_DEF:
        value = controls().at(found->first).value;
        break;
      default:
        break;
    }
    Bytes reply;
    for (int i = 0; i < control.bytes; ++i) {
      reply.u8({static_cast<int>(value >> 8 * i & 0xFF)});
    }
    return reply;
  }

  bool write_control(const usb_ctrlrequest& setup, std::span<const std::uint8_t> data) {
    constexpr std::size_t kFormatAt = 2;
    constexpr std::size_t kFrameAt = 3;
    constexpr std::size_t kIntervalAt = 4;
    const int selector = setup.wValue >> 8;
    if ((setup.wIndex & 0xFF) == kStreamingInterface) {
      if ((selector != UVC_VS_PROBE_CONTROL && selector != UVC_VS_COMMIT_CONTROL) ||
          data.size() < kIntervalAt + 4) {
        return false;
      }
      const std::size_t frame = std::clamp<std::size_t>(data[kFrameAt], 1, kSizes.size());
      const std::uint32_t interval = std::max(1U, read_little_endian(data, kIntervalAt, 4));
      int rate = kRates_hz.front();
      for (const int offered : kRates_hz) {
        rate = kIntervalUnit_hz / static_cast<std::uint32_t>(offered) <= interval ? offered : rate;
      }
      select(data[kFormatAt] == kMjpeg ? kMjpeg : kYuyv, frame - 1, rate);
      return true;
    }
    const auto found = controls_.find({setup.wIndex >> 8, selector});
    if (found == controls_.end() || data.size() < static_cast<std::size_t>(found->second.bytes)) {
      return false;
    }
    found->second.value = read_little_endian(data, 0, found->second.bytes);
    return true;
  }

  // What happens next.

  void wait() {
    constexpr std::int64_t kLookAtTrigger_ns = 1'000'000;
    std::optional<timespec> timeout;
    if (streaming_ && !sent_ && !frozen_) {
      const std::int64_t left =
          lines_.triggers() ? kLookAtTrigger_ns : std::max<std::int64_t>(0, due_ns_ - now_ns());
      timeout = timespec{left / kSecond_ns, left % kSecond_ns};
    }
    std::array<pollfd, 2> watched = {pollfd{STDIN_FILENO, POLLIN, 0}, pollfd{host_.get(), POLLIN, 0}};
    ::ppoll(watched.data(), watched.size(), timeout ? &*timeout : nullptr, nullptr);
    if (host_ && watched[1].revents != 0) {
      serve();
    }
    if (watched[0].revents != 0) {
      read_commands();
    }
  }

  void read_commands() {
    std::array<char, 256> text{};
    const ssize_t count = ::read(STDIN_FILENO, text.data(), text.size());
    if (count <= 0) {
      ended_ = true;
      return;
    }
    typed_.append(text.data(), static_cast<std::size_t>(count));
    for (std::size_t end = typed_.find('\n'); end != std::string::npos; end = typed_.find('\n')) {
      obey(typed_.substr(0, end));
      typed_.erase(0, end + 1);
    }
  }

  void obey(const std::string& command) {
    if (command == "plug") {
      plug();
    } else if (command == "unplug") {
      unplug();
    } else if (command == "freeze") {
      frozen_ = true;
    } else if (command == "resume") {
      frozen_ = false;
      due_ns_ = now_ns();
    } else if (command == "error") {
      error_ = true;
    } else if (command == "short") {
      short_ = true;
    } else if (command == "garbage") {
      garbage_ = true;
    } else if (command == "stall") {
      stall_ = true;
    } else if (command.starts_with("skip ")) {
      skip_ = std::stoi(command.substr(5));
    } else if (command == "status") {
      fmt::print(
          "{{\"event\":\"status\",\"time_ns\":{},\"streaming\":{},\"taken\":{},\"sent\":{},\"missed\":{}",
          now_ns(), streaming_, taken_, pictures_sent_, missed_);
      for (const auto& [name, unit, selector] :
           {std::tuple{"exposure_mode", kCameraTerminal, UVC_CT_AE_MODE_CONTROL},
            {"exposure_100us", kCameraTerminal, UVC_CT_EXPOSURE_TIME_ABSOLUTE_CONTROL},
            {"gain", kProcessingUnit, UVC_PU_GAIN_CONTROL},
            {"white_balance_k", kProcessingUnit, UVC_PU_WHITE_BALANCE_TEMPERATURE_CONTROL},
            {"white_balance_auto", kProcessingUnit, UVC_PU_WHITE_BALANCE_TEMPERATURE_AUTO_CONTROL}}) {
        fmt::print(",\"{}\":{}", name, controls_.at({unit, selector}).value);
      }
      fmt::print("}}\n");
      std::fflush(stdout);
    } else {
      throw std::runtime_error("unknown command: " + command);
    }
  }

  WatchedLines& lines_;
  std::map<std::pair<int, int>, Control> controls_ = controls();
  std::deque<Request> requests_;  ///< of the driver, for pictures
  std::string typed_;
  std::vector<std::uint8_t> picture_;  ///< YUYV
  std::vector<std::uint8_t> bytes_;    ///< what is sent of it
  std::optional<std::size_t> sent_;    ///< of bytes_, while a picture is under way
  std::int64_t due_ns_ = 0;            ///< the next picture, when free-running
  std::int64_t pictures_sent_ = 0;
  std::int64_t missed_ = 0;  ///< there was no time for it
  std::size_t size_ = 0;
  int port_;
  Descriptor host_;
  int rate_hz_ = 0;
  int format_ = kYuyv;
  std::uint32_t taken_ = 0;
  int skip_ = 0;
  bool ended_ = false;
  bool streaming_ = false;
  bool odd_ = false;  ///< of UVC's frame identifier, which changes with every picture
  bool frozen_ = false;
  bool marked_ = false;  ///< the picture under way
  bool error_ = false;   ///< the next picture
  bool short_ = false;
  bool garbage_ = false;
  bool stall_ = false;
};

int run(int argc, char** argv) {
  int port = 0;
  std::string lines;
  int pattern_lines = 0;
  int trigger = -1;
  double exposure_ms = 8;
  CLI::App app("A USB camera in software");
  app.add_option("--port", port)->check(CLI::Range(0, 7));
  app.add_option("--lines", lines);
  app.add_option("--pattern-lines", pattern_lines)->check(CLI::Range(0, 8));
  app.add_option("--trigger", trigger);
  app.add_option("--exposure-ms", exposure_ms);
  CLI11_PARSE(app, argc, argv);
  try {
    WatchedLines watched(lines, pattern_lines, trigger, exposure_ms);
    UsbCamera(port, watched).run();
  } catch (const std::exception& error) {
    fmt::print(stderr, "usb_camera: {}\n", error.what());
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace facet::hil

int main(int argc, char** argv) {
  return facet::hil::run(argc, argv);
}
