#include "service/osc_message.hpp"

#include <algorithm>
#include <bit>

namespace facet::service {
namespace {

constexpr int kMostDepth = 4;
constexpr std::size_t kMostMessages = 64;
constexpr std::size_t kMostArguments = 32;
constexpr std::size_t kWord = 4;

/// Takes parts off the front of a packet; every part is a multiple of four bytes.
class Parts {
 public:
  explicit Parts(std::span<const std::byte> bytes) : rest_(bytes) {}

  bool empty() const { return rest_.empty(); }
  bool skip(std::size_t bytes) {
    if (bytes > rest_.size()) {
      return false;
    }
    rest_ = rest_.subspan(bytes);
    return true;
  }
  std::optional<std::uint32_t> word() {
    if (rest_.size() < kWord) {
      return std::nullopt;
    }
    std::uint32_t value = 0;
    for (std::size_t i = 0; i < kWord; ++i) {
      value = value << 8U | std::to_integer<std::uint32_t>(rest_[i]);
    }
    rest_ = rest_.subspan(kWord);
    return value;
  }
  std::optional<std::string> text() {
    const auto end = std::find(rest_.begin(), rest_.end(), std::byte{0});
    const auto length = static_cast<std::size_t>(end - rest_.begin());
    const std::size_t padded = (length / kWord + 1) * kWord;
    if (end == rest_.end() || padded > rest_.size()) {
      return std::nullopt;
    }
    std::string text(reinterpret_cast<const char*>(rest_.data()), length);
    rest_ = rest_.subspan(padded);
    return text;
  }
  std::optional<Parts> part(std::size_t bytes) {
    if (bytes > rest_.size()) {
      return std::nullopt;
    }
    const Parts part(rest_.first(bytes));
    rest_ = rest_.subspan(bytes);
    return part;
  }

 private:
  std::span<const std::byte> rest_;
};

/// False where it is not whole, or its type unknown.
bool read_argument(char type, Parts& parts, std::vector<OscValue>& out) {
  switch (type) {
    case 'i':
    case 'f': {
      const auto word = parts.word();
      if (word && type == 'i') {
        out.emplace_back(static_cast<std::int32_t>(*word));
      } else if (word) {
        out.emplace_back(std::bit_cast<float>(*word));
      }
      return word.has_value();
    }
    case 's': {
      auto text = parts.text();
      if (text) {
        out.emplace_back(std::move(*text));
      }
      return text.has_value();
    }
    case 'T':
    case 'F':
      out.emplace_back(type == 'T');
      return true;
    case 'N':
    case 'I':
      out.emplace_back();
      return true;
    case 'b': {
      const auto bytes = parts.word();
      out.emplace_back();
      return bytes && parts.skip((std::size_t{*bytes} + kWord - 1) / kWord * kWord);
    }
    case 'h':
    case 't':
    case 'd':
      out.emplace_back();
      return parts.skip(2 * kWord);
    default:
      return false;
  }
}

bool read_message(std::string address, Parts& parts, std::vector<OscMessage>& out) {
  OscMessage message{std::move(address), {}};
  // Senders of before OSC 1.0 leave the types out where there are no arguments.
  const auto types = parts.empty() ? std::optional<std::string>(",") : parts.text();
  if (!message.address.starts_with('/') || !types || !types->starts_with(',') ||
      types->size() > kMostArguments + 1 || out.size() == kMostMessages) {
    return false;
  }
  const bool whole = std::all_of(types->begin() + 1, types->end(),
                                 [&](char type) { return read_argument(type, parts, message.arguments); });
  out.push_back(std::move(message));
  return whole && parts.empty();
}

bool read_packet(Parts parts, int depth, std::vector<OscMessage>& out) {
  auto address = parts.text();
  if (!address) {
    return false;
  }
  if (*address != "#bundle") {
    return read_message(std::move(*address), parts, out);
  }
  if (depth == kMostDepth || !parts.skip(2 * kWord)) {
    return false;
  }
  while (!parts.empty()) {
    const auto bytes = parts.word();
    const auto part = bytes && *bytes % kWord == 0 ? parts.part(*bytes) : std::nullopt;
    if (!part || !read_packet(*part, depth + 1, out)) {
      return false;
    }
  }
  return true;
}

void append_word(std::vector<std::byte>& out, std::uint32_t value) {
  for (int shift = 24; shift >= 0; shift -= 8) {
    out.push_back(static_cast<std::byte>(value >> static_cast<unsigned>(shift)));
  }
}

void append_text(std::vector<std::byte>& out, std::string_view text) {
  const auto bytes = std::as_bytes(std::span(text));
  out.insert(out.end(), bytes.begin(), bytes.end());
  out.resize((out.size() / kWord + 1) * kWord);
}

}  // namespace

std::optional<std::vector<OscMessage>> parse_osc(std::span<const std::byte> packet) {
  std::vector<OscMessage> messages;
  if (packet.size() > kMostOscBytes || packet.size() % kWord != 0 ||
      !read_packet(Parts(packet), 0, messages)) {
    return std::nullopt;
  }
  return messages;
}

std::vector<std::byte> osc_packet(const OscMessage& message) {
  std::vector<std::byte> out;
  append_text(out, message.address);
  std::string types = ",";
  for (const OscValue& value : message.arguments) {
    const auto* yes = std::get_if<bool>(&value);
    types += yes == nullptr ? "Nifs"[value.index()] : *yes ? 'T' : 'F';
  }
  append_text(out, types);
  for (const OscValue& value : message.arguments) {
    if (const auto* whole = std::get_if<std::int32_t>(&value)) {
      append_word(out, static_cast<std::uint32_t>(*whole));
    } else if (const auto* number = std::get_if<float>(&value)) {
      append_word(out, std::bit_cast<std::uint32_t>(*number));
    } else if (const auto* text = std::get_if<std::string>(&value)) {
      append_text(out, *text);
    }
  }
  return out;
}

}  // namespace facet::service
