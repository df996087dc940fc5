#pragma once

#include <fmt/format.h>
#include <linux/usb/ch9.h>
#include <linux/usb/video.h>

#include <array>
#include <cstdint>
#include <initializer_list>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace facet::hil {

/// Little-endian bytes of descriptors.
class Bytes {
 public:
  Bytes& u8(std::initializer_list<int> values) {
    for (const int value : values) {
      data_.push_back(static_cast<std::uint8_t>(value));
    }
    return *this;
  }
  Bytes& u16(unsigned value) { return little_endian(value, 2); }
  Bytes& u32(std::uint32_t value) { return little_endian(value, 4); }
  Bytes& text(const std::string& letters) {
    data_.insert(data_.end(), letters.begin(), letters.end());
    return *this;
  }
  Bytes& add(const Bytes& other) {
    data_.insert(data_.end(), other.data_.begin(), other.data_.end());
    return *this;
  }
  std::size_t size() const { return data_.size(); }
  const std::vector<std::uint8_t>& data() const { return data_; }

 private:
  Bytes& little_endian(std::uint32_t value, int bytes) {
    for (int i = 0; i < bytes; ++i) {
      data_.push_back(static_cast<std::uint8_t>(value >> 8 * i));
    }
    return *this;
  }
  std::vector<std::uint8_t> data_;
};

inline std::uint32_t read_little_endian(std::span<const std::uint8_t> data, std::size_t at, int bytes) {
  std::uint32_t value = 0;
  for (int i = 0; i < bytes; ++i) {
    value |= std::uint32_t{data[at + static_cast<std::size_t>(i)]} << 8 * i;
  }
  return value;
}

// What the device is.

struct Size {
  int width_px;
  int height_px;
};
inline constexpr std::array kSizes = {Size{640, 480}, Size{320, 240}, Size{1280, 720}};
inline constexpr std::array kRates_hz = {60, 30, 15};
/// Pixel formats, by their numbers in the descriptors.
inline constexpr int kYuyv = 1;
inline constexpr int kMjpeg = 2;
inline constexpr std::uint32_t kIntervalUnit_hz = 10'000'000;
inline constexpr int kControlInterface = 0;
inline constexpr int kStreamingInterface = 1;
inline constexpr int kEndpoint = 1;
inline constexpr int kPacketBytes = 512;
/// One USB request of uvcvideo at most: 32 packets.
inline constexpr std::size_t kPayloadBytes = std::size_t{32} * kPacketBytes;
inline constexpr std::size_t kPayloadHeaderBytes = 2;
inline constexpr int kCameraTerminal = 1;
inline constexpr int kProcessingUnit = 2;
inline constexpr int kOutputTerminal = 3;
inline constexpr const char* kVendor = "Facet";
inline constexpr const char* kProduct = "Simulated Camera";

inline Bytes device_descriptor(int serial) {
  // Class "miscellaneous, interface association"; vendor 1d6b:0102 of the Linux Foundation is its webcam
  // gadget's.
  return Bytes()
      .u8({USB_DT_DEVICE_SIZE, USB_DT_DEVICE})
      .u16(0x0200)
      .u8({USB_CLASS_MISC, 2, 1, 64})
      .u16(0x1d6b)
      .u16(0x0102)
      .u16(static_cast<unsigned>(serial))
      .u8({1, 2, 3, 1});
}

inline Bytes interface_descriptor(int number, int endpoints, int subclass) {
  return Bytes().u8(
      {USB_DT_INTERFACE_SIZE, USB_DT_INTERFACE, number, 0, endpoints, USB_CLASS_VIDEO, subclass, 0, 0});
}

/// A class-specific interface descriptor: its length and type come before its content.
inline Bytes class_specific(const Bytes& content) {
  return Bytes().u8({static_cast<int>(content.size()) + 2, USB_DT_CS_INTERFACE}).add(content);
}

inline Bytes control_descriptors() {
  // Camera: mode of exposure (bit 1) and its time (bit 3). Processing: brightness (0), white balance
  // temperature (6) and its automatic (12), gain (9).
  const Bytes units =
      Bytes()
          .add(class_specific(Bytes()
                                  .u8({UVC_VC_INPUT_TERMINAL, kCameraTerminal})
                                  .u16(UVC_ITT_CAMERA)
                                  .u8({0, 0})
                                  .u16(0)
                                  .u16(0)
                                  .u16(0)
                                  .u8({3, 1 << 1 | 1 << 3, 0, 0})))
          .add(class_specific(Bytes()
                                  .u8({UVC_VC_PROCESSING_UNIT, kProcessingUnit, kCameraTerminal})
                                  .u16(0)
                                  .u8({2, 1 << 0 | 1 << 6, 1 << 1 | 1 << 4, 0})))
          .add(class_specific(Bytes()
                                  .u8({UVC_VC_OUTPUT_TERMINAL, kOutputTerminal})
                                  .u16(UVC_TT_STREAMING)
                                  .u8({0, kProcessingUnit, 0})));
  constexpr unsigned kHeaderBytes = 13;
  const Bytes header = class_specific(Bytes()
                                          .u8({UVC_VC_HEADER})
                                          .u16(0x0100)
                                          .u16(kHeaderBytes + static_cast<unsigned>(units.size()))
                                          .u32(48'000'000)
                                          .u8({1, kStreamingInterface}));
  return Bytes().add(header).add(units);
}

inline Bytes frame_descriptor(int type, int index, const Size& size) {
  const auto bytes = static_cast<std::uint32_t>(size.width_px * size.height_px * 2);
  Bytes frame = Bytes()
                    .u8({type, index, 0})
                    .u16(static_cast<unsigned>(size.width_px))
                    .u16(static_cast<unsigned>(size.height_px))
                    .u32(bytes * 8 * kRates_hz.back())
                    .u32(bytes * 8 * kRates_hz.front())
                    .u32(bytes)
                    .u32(kIntervalUnit_hz / kRates_hz.front())
                    .u8({static_cast<int>(kRates_hz.size())});
  for (const int rate : kRates_hz) {
    frame.u32(kIntervalUnit_hz / static_cast<std::uint32_t>(rate));
  }
  return class_specific(frame);
}

inline Bytes streaming_descriptors() {
  constexpr int kSizeCount = static_cast<int>(kSizes.size());
  Bytes formats;
  // YUYV by its GUID; 16 bits a pixel.
  formats.add(
      class_specific(Bytes()
                         .u8({UVC_VS_FORMAT_UNCOMPRESSED, kYuyv, kSizeCount})
                         .text("YUY2")
                         .u8({0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71, 16, 1, 0, 0, 0, 0})));
  for (int i = 0; i < kSizeCount; ++i) {
    formats.add(frame_descriptor(UVC_VS_FRAME_UNCOMPRESSED, i + 1, kSizes.at(static_cast<std::size_t>(i))));
  }
  formats.add(class_specific(Bytes().u8({UVC_VS_COLORFORMAT, 1, 1, 4})));
  formats.add(class_specific(Bytes().u8({UVC_VS_FORMAT_MJPEG, kMjpeg, kSizeCount, 0, 1, 0, 0, 0, 0})));
  for (int i = 0; i < kSizeCount; ++i) {
    formats.add(frame_descriptor(UVC_VS_FRAME_MJPEG, i + 1, kSizes.at(static_cast<std::size_t>(i))));
  }
  formats.add(class_specific(Bytes().u8({UVC_VS_COLORFORMAT, 1, 1, 4})));
  constexpr unsigned kHeaderBytes = 15;
  const Bytes header =
      class_specific(Bytes()
                         .u8({UVC_VS_INPUT_HEADER, 2})
                         .u16(kHeaderBytes + static_cast<unsigned>(formats.size()))
                         .u8({USB_DIR_IN | kEndpoint, 0, kOutputTerminal, 0, 0, 0, 1, 0, 0}));
  return Bytes().add(header).add(formats);
}

inline Bytes configuration_descriptor() {
  const Bytes rest =
      Bytes()
          .u8({8, USB_DT_INTERFACE_ASSOCIATION, 0, 2, USB_CLASS_VIDEO, UVC_SC_VIDEO_INTERFACE_COLLECTION, 0,
               0})
          .add(interface_descriptor(kControlInterface, 0, UVC_SC_VIDEOCONTROL))
          .add(control_descriptors())
          .add(interface_descriptor(kStreamingInterface, 1, UVC_SC_VIDEOSTREAMING))
          .add(streaming_descriptors())
          .u8({USB_DT_ENDPOINT_SIZE, USB_DT_ENDPOINT, USB_DIR_IN | kEndpoint, USB_ENDPOINT_XFER_BULK})
          .u16(kPacketBytes)
          .u8({0});
  return Bytes()
      .u8({USB_DT_CONFIG_SIZE, USB_DT_CONFIG})
      .u16(USB_DT_CONFIG_SIZE + static_cast<unsigned>(rest.size()))
      .u8({2, 1, 0, USB_CONFIG_ATT_ONE, 250})
      .add(rest);
}

inline Bytes string_descriptor(int index, const std::string& serial) {
  if (index == 0) {
    return Bytes().u8({4, USB_DT_STRING}).u16(0x0409);  // English
  }
  const std::array<std::string, 3> texts = {kVendor, kProduct, serial};
  const std::string& text = texts.at(static_cast<std::size_t>(index) - 1);
  Bytes bytes = Bytes().u8({static_cast<int>(2 + 2 * text.size()), USB_DT_STRING});
  for (const char letter : text) {
    bytes.u16(static_cast<unsigned char>(letter));
  }
  return bytes;
}

/// A value that the driver may read and set.
struct Control {
  int bytes;
  std::uint32_t minimum;
  std::uint32_t maximum;
  std::uint32_t resolution;
  std::uint32_t value;
};

/// By unit and selector. The mode of exposure has one bit a mode: manual (1) and aperture priority (8).
inline std::map<std::pair<int, int>, Control> controls() {
  return {{{kCameraTerminal, UVC_CT_AE_MODE_CONTROL}, {1, 1, 8, 1 | 8, 8}},
          {{kCameraTerminal, UVC_CT_EXPOSURE_TIME_ABSOLUTE_CONTROL}, {4, 1, 5000, 1, 156}},
          {{kProcessingUnit, UVC_PU_BRIGHTNESS_CONTROL}, {2, 0, 255, 1, 128}},
          {{kProcessingUnit, UVC_PU_GAIN_CONTROL}, {2, 0, 100, 1, 10}},
          {{kProcessingUnit, UVC_PU_WHITE_BALANCE_TEMPERATURE_CONTROL}, {2, 2800, 6500, 10, 4600}},
          {{kProcessingUnit, UVC_PU_WHITE_BALANCE_TEMPERATURE_AUTO_CONTROL}, {1, 0, 1, 1, 1}}};
}

}  // namespace facet::hil
