#include "camera/host_protocol.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <string_view>
#include <type_traits>

#include "camera/pixel_buffers.hpp"
#include "facet/printable.hpp"

namespace facet::camera {
namespace {

constexpr std::uint32_t kMagic = 0x31484346;  // "FCH1": the last digit is the version

/// What stands before name and text.
struct Record {
  std::uint32_t magic;
  std::uint32_t kind;
  std::uint64_t sequence;
  std::int64_t timestamp_ns;
  std::uint64_t counters[kCameraCounts.size()];
  std::uint32_t corrupt;
  std::uint32_t fault;
  std::uint32_t name_bytes;
  std::uint32_t text_bytes;
};
static_assert(std::is_trivially_copyable_v<Record> && sizeof(Record) == 40 + 8 * kCameraCounts.size());

constexpr std::size_t kMaxName_bytes = 256;
constexpr std::size_t kMaxText_bytes = kMaxHostMessage_bytes - sizeof(Record) - kMaxName_bytes;

}  // namespace

const char* to_string(HostMessage::Kind kind) {
  switch (kind) {
    case HostMessage::Kind::Listed:
      return "a camera of a list";
    case HostMessage::Kind::Opened:
      return "that its camera is open";
    case HostMessage::Kind::Frame:
      return "a frame";
    case HostMessage::Kind::Alive:
      return "that it is alive";
    case HostMessage::Kind::Fault:
      return "a fault";
  }
  return "nothing";
}

std::size_t write_host_message(const HostMessage& message, std::span<std::uint8_t> buffer) {
  Record record{};
  record.magic = kMagic;
  record.kind = static_cast<std::uint32_t>(message.kind);
  record.sequence = message.sequence;
  record.timestamp_ns = message.timestamp_ns;
  for (std::size_t i = 0; i < kCameraCounts.size(); ++i) {
    record.counters[i] = message.counters.*kCameraCounts[i].value;
  }
  record.corrupt = message.corrupt ? 1 : 0;
  record.fault = static_cast<std::uint32_t>(message.fault);
  const std::size_t name_bytes = std::min(message.name.size(), kMaxName_bytes);
  const std::size_t text_bytes = std::min(message.text.size(), kMaxText_bytes);
  record.name_bytes = static_cast<std::uint32_t>(name_bytes);
  record.text_bytes = static_cast<std::uint32_t>(text_bytes);
  std::memcpy(buffer.data(), &record, sizeof record);
  std::memcpy(buffer.data() + sizeof record, message.name.data(), name_bytes);
  std::memcpy(buffer.data() + sizeof record + name_bytes, message.text.data(), text_bytes);
  return sizeof record + name_bytes + text_bytes;
}

std::optional<HostMessage> read_host_message(std::span<const std::uint8_t> bytes, std::string& wrong) {
  Record record{};
  if (bytes.size() < sizeof record) {
    wrong = fmt::format("a message of {} bytes", bytes.size());
    return std::nullopt;
  }
  std::memcpy(&record, bytes.data(), sizeof record);
  if (record.magic != kMagic) {
    wrong = "a message that is none, or of another version";
    return std::nullopt;
  }
  if (record.kind < static_cast<std::uint32_t>(HostMessage::Kind::Listed) ||
      record.kind > static_cast<std::uint32_t>(HostMessage::Kind::Fault)) {
    wrong = fmt::format("a message of kind {}", record.kind);
    return std::nullopt;
  }
  if (record.corrupt > 1 || record.fault > static_cast<std::uint32_t>(DeviceFault::Kind::Unsuitable)) {
    wrong = "a message with values that there are not";
    return std::nullopt;
  }
  // The sizes are compared one by one: their sum could wrap.
  const std::size_t rest = bytes.size() - sizeof record;
  if (record.name_bytes > std::min(rest, kMaxName_bytes) || record.text_bytes != rest - record.name_bytes) {
    wrong = fmt::format("a message of {} bytes that says it is another size", bytes.size());
    return std::nullopt;
  }
  HostMessage message;
  message.kind = static_cast<HostMessage::Kind>(record.kind);
  message.sequence = record.sequence;
  message.timestamp_ns = record.timestamp_ns;
  message.corrupt = record.corrupt == 1;
  for (std::size_t i = 0; i < kCameraCounts.size(); ++i) {
    message.counters.*kCameraCounts[i].value = record.counters[i];
  }
  message.fault = static_cast<DeviceFault::Kind>(record.fault);
  const std::string_view texts(reinterpret_cast<const char*>(bytes.data() + sizeof record), rest);
  message.name = printable(texts.substr(0, record.name_bytes), kMaxName_bytes);
  message.text = printable(texts.substr(record.name_bytes), kMaxText_bytes);
  return message;
}

PictureLayout picture_layout(int width_px, int height_px) {
  PictureLayout layout;
  layout.stride_bytes = static_cast<std::size_t>(rgba_stride_bytes(width_px));
  layout.pixels_at = kRowAlignment_bytes;
  layout.end_mark_at = layout.pixels_at + layout.stride_bytes * static_cast<std::size_t>(height_px);
  layout.total_bytes = layout.end_mark_at + kRowAlignment_bytes;
  return layout;
}

}  // namespace facet::camera
