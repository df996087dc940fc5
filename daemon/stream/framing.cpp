#include "stream/framing.hpp"

#include <algorithm>

namespace facet::stream {
namespace {

void put_uint32(std::uint8_t* out, std::uint32_t value) {
  for (int byte = 0; byte < 4; ++byte) {
    out[byte] = static_cast<std::uint8_t>(value >> (8 * byte));
  }
}

std::uint32_t get_uint32(const std::uint8_t* in) {
  std::uint32_t value = 0;
  for (int byte = 0; byte < 4; ++byte) {
    value |= static_cast<std::uint32_t>(in[byte]) << (8 * byte);
  }
  return value;
}

}  // namespace

std::array<std::uint8_t, kHeaderBytes> make_header(std::size_t length) {
  std::array<std::uint8_t, kHeaderBytes> header{};
  put_uint32(header.data(), kMessageMagic);
  put_uint32(header.data() + 4, static_cast<std::uint32_t>(length));
  return header;
}

MessageAssembler::Outcome MessageAssembler::feed(std::span<const std::uint8_t>& bytes) {
  if (header_filled_ < kHeaderBytes) {
    const std::size_t taken = std::min(bytes.size(), kHeaderBytes - header_filled_);
    std::copy_n(bytes.begin(), taken, header_.begin() + static_cast<std::ptrdiff_t>(header_filled_));
    header_filled_ += taken;
    bytes = bytes.subspan(taken);
    if (header_filled_ < kHeaderBytes) {
      return Outcome::Incomplete;
    }
    if (get_uint32(header_.data()) != kMessageMagic) {
      return Outcome::WrongMagic;
    }
    length_ = get_uint32(header_.data() + 4);
    if (length_ > limit_bytes_) {
      return Outcome::TooLong;
    }
  }
  const std::size_t taken = std::min(bytes.size(), length_ - message_.size());
  message_.insert(message_.end(), bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(taken));
  bytes = bytes.subspan(taken);
  return message_.size() == length_ ? Outcome::Complete : Outcome::Incomplete;
}

void MessageAssembler::next() {
  header_filled_ = 0;
  length_ = 0;
  message_.clear();
}

}  // namespace facet::stream
