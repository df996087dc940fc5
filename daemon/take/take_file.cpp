#include "take/take_file.hpp"

#include <fmt/format.h>
#include <zstd.h>

#include "facet/error.hpp"

namespace facet::take {

std::string cut_text(std::string_view text, std::size_t bytes) {
  const auto within_character = [&] { return (static_cast<unsigned char>(text[bytes]) & 0xC0U) == 0x80U; };
  while (bytes > 0 && bytes < text.size() && within_character()) {
    --bytes;
  }
  return std::string(text.substr(0, bytes));
}

struct BlobCompressor::Impl {
  struct Free {
    void operator()(ZSTD_CCtx* owned) const { ZSTD_freeCCtx(owned); }
  };
  std::unique_ptr<ZSTD_CCtx, Free> context{made(ZSTD_createCCtx())};
  std::vector<std::uint8_t> out;
};

BlobCompressor::BlobCompressor(int level) : impl_(std::make_unique<Impl>()) {
  ZSTD_CCtx_setParameter(impl_->context.get(), ZSTD_c_compressionLevel, level);
  ZSTD_CCtx_setParameter(impl_->context.get(), ZSTD_c_checksumFlag, 1);
}

BlobCompressor::~BlobCompressor() = default;

std::span<const std::uint8_t> BlobCompressor::compress(std::span<const std::uint8_t> message) {
  const std::size_t bound = ZSTD_compressBound(message.size());
  if (impl_->out.size() < bound) {
    impl_->out.resize(bound);
  }
  const std::size_t size = ZSTD_compress2(impl_->context.get(), impl_->out.data(), impl_->out.size(),
                                          message.data(), message.size());
  if (ZSTD_isError(size) != 0U) {
    throw Error(ErrorKind::Internal, fmt::format("take: cannot compress: {}", ZSTD_getErrorName(size)));
  }
  return {impl_->out.data(), size};
}

void decompress_blob(std::span<const std::uint8_t> blob, std::vector<std::uint8_t>& out) {
  const unsigned long long size = ZSTD_getFrameContentSize(blob.data(), blob.size());
  if (size == ZSTD_CONTENTSIZE_ERROR || size == ZSTD_CONTENTSIZE_UNKNOWN || size > kMaxBlobBytes) {
    throw Error(ErrorKind::UnreadableInput, "not a compressed blob of a take, or too long");
  }
  out.resize(size);
  const std::size_t written = ZSTD_decompress(out.data(), out.size(), blob.data(), blob.size());
  if (ZSTD_isError(written) != 0U || written != size) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("damaged blob: {}",
                            ZSTD_isError(written) != 0U ? ZSTD_getErrorName(written) : "too short"));
  }
}

}  // namespace facet::take
