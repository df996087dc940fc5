#include "simulation/lossless_video.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <new>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include "facet/error.hpp"
#include "files/output_file.hpp"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/error.h>
#include <libavutil/frame.h>
}

namespace facet::simulation {
namespace {

constexpr int kBufferBytes = 1 << 18;  // as FFmpeg's own for files

std::string reason_of(int code) {
  std::array<char, AV_ERROR_MAX_STRING_SIZE> text{};
  av_strerror(code, text.data(), text.size());
  return text.data();
}

struct CloseCodec {
  void operator()(AVCodecContext* codec) const { avcodec_free_context(&codec); }
};
struct CloseContainer {
  void operator()(AVFormatContext* container) const {
    if (container->pb != nullptr) {
      av_freep(&container->pb->buffer);
      avio_context_free(&container->pb);
    }
    avformat_free_context(container);
  }
};
struct FreeFrame {
  void operator()(AVFrame* frame) const { av_frame_free(&frame); }
};
struct FreePacket {
  void operator()(AVPacket* packet) const { av_packet_free(&packet); }
};

/// The container's bytes on their way into a file that comes into being whole.
struct Output {
  explicit Output(const std::filesystem::path& path) : file(path) {}

  files::OutputFile file;
  std::int64_t position = 0;
  std::int64_t size = 0;
  std::string fault;
};

/// Byte: const from libavformat 61 on.
template <typename Byte>
int write_packet(void* opaque, Byte* bytes, int count) {
  Output& output = *static_cast<Output*>(opaque);
  try {
    output.file.write_at(static_cast<std::uint64_t>(output.position),
                         std::as_bytes(std::span(bytes, static_cast<std::size_t>(count))));
  } catch (const Error& error) {
    output.fault = error.what();
    return AVERROR(EIO);
  }
  output.position += count;
  output.size = std::max(output.size, output.position);
  return count;
}

std::int64_t seek(void* opaque, std::int64_t offset, int whence) {
  Output& output = *static_cast<Output*>(opaque);
  if (whence == AVSEEK_SIZE) {
    return output.size;
  }
  return whence == SEEK_SET ? output.position = offset : AVERROR(EINVAL);
}

}  // namespace

struct LosslessVideo::Impl {
  std::string file;
  std::optional<Output> output;
  std::unique_ptr<AVFormatContext, CloseContainer> container;
  std::unique_ptr<AVCodecContext, CloseCodec> codec;
  std::unique_ptr<AVFrame, FreeFrame> frame;
  std::unique_ptr<AVPacket, FreePacket> packet;
  AVStream* stream = nullptr;  // owned by the container
  std::int64_t frame_count = 0;
  bool finished = false;

  void check(int code, const char* what) const {
    if (code < 0 && output && !output->fault.empty()) {
      throw Error(ErrorKind::Storage, output->fault);
    }
    if (code < 0) {
      throw Error(ErrorKind::Storage,
                  fmt::format("{}: cannot {} the video ({}); check the folder and the free space", file, what,
                              reason_of(code)));
    }
  }

  /// Sends a frame (null: the end) to the encoder and writes the packets that it gives.
  void encode(const AVFrame* next) const {
    check(avcodec_send_frame(codec.get(), next), "encode");
    for (;;) {
      const int got = avcodec_receive_packet(codec.get(), packet.get());
      if (got == AVERROR(EAGAIN) || got == AVERROR_EOF) {
        return;
      }
      check(got, "encode");
      av_packet_rescale_ts(packet.get(), codec->time_base, stream->time_base);
      packet->stream_index = stream->index;
      check(av_interleaved_write_frame(container.get(), packet.get()), "write");
    }
  }
};

LosslessVideo::LosslessVideo(const std::filesystem::path& file, int width_px, int height_px, int rate_hz)
    : impl_(std::make_unique<Impl>()) {
  impl_->file = file.string();
  if (width_px < 1 || height_px < 1 || rate_hz < 1) {
    throw Error(ErrorKind::Usage, fmt::format("{}: a video of {}x{} px at {} Hz cannot be written",
                                              impl_->file, width_px, height_px, rate_hz));
  }
  AVFormatContext* container = nullptr;
  impl_->check(avformat_alloc_output_context2(&container, nullptr, "matroska", impl_->file.c_str()),
               "set up");
  impl_->container.reset(container);
  const AVCodec* encoder = avcodec_find_encoder(AV_CODEC_ID_FFV1);
  impl_->stream = encoder != nullptr ? avformat_new_stream(container, nullptr) : nullptr;
  impl_->codec.reset(encoder != nullptr ? avcodec_alloc_context3(encoder) : nullptr);
  impl_->frame.reset(av_frame_alloc());
  impl_->packet.reset(av_packet_alloc());
  if (impl_->stream == nullptr || !impl_->codec || !impl_->frame || !impl_->packet) {
    throw Error(ErrorKind::Internal, "the installed libavcodec has no FFV1 encoder");
  }
  AVCodecContext& codec = *impl_->codec;
  codec.width = width_px;
  codec.height = height_px;
  codec.pix_fmt = AV_PIX_FMT_BGR0;
  codec.time_base = {1, rate_hz};
  codec.framerate = {rate_hz, 1};
  codec.level = 3;  // FFV1 version 3: slices with checksums
  codec.slices = 4;
  codec.thread_count = 2;
  codec.color_range = AVCOL_RANGE_JPEG;
  if ((container->oformat->flags & AVFMT_GLOBALHEADER) != 0) {
    codec.flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  }
  impl_->check(avcodec_open2(&codec, encoder, nullptr), "encode");
  impl_->stream->time_base = codec.time_base;
  impl_->stream->avg_frame_rate = codec.framerate;
  impl_->check(avcodec_parameters_from_context(impl_->stream->codecpar, &codec), "set up");
  impl_->output.emplace(file);
  auto* const buffer = static_cast<unsigned char*>(av_malloc(kBufferBytes));
  container->pb = avio_alloc_context(buffer, kBufferBytes, 1, &*impl_->output, nullptr, write_packet, seek);
  if (container->pb == nullptr) {
    av_free(buffer);
    throw std::bad_alloc();
  }
  impl_->check(avformat_write_header(container, nullptr), "write");

  impl_->frame->format = codec.pix_fmt;
  impl_->frame->width = width_px;
  impl_->frame->height = height_px;
  impl_->check(av_frame_get_buffer(impl_->frame.get(), 0), "set up");
}

LosslessVideo::~LosslessVideo() {
  try {
    finish();
  } catch (const Error&) {
    // Documented: who wants to know calls finish().
  }
}

void LosslessVideo::append(const render::Picture& picture) {
  AVFrame& frame = *impl_->frame;
  if (impl_->finished || picture.width_px != frame.width || picture.height_px != frame.height) {
    throw Error(ErrorKind::Internal,
                fmt::format("{}: a picture of {}x{} px does not fit the video of {}x{} px", impl_->file,
                            picture.width_px, picture.height_px, frame.width, frame.height));
  }
  impl_->check(av_frame_make_writable(&frame), "encode");
  const std::uint8_t* from = picture.rgb.data();
  for (int y = 0; y < frame.height; ++y) {
    std::uint8_t* to = frame.data[0] + static_cast<std::ptrdiff_t>(y) * frame.linesize[0];
    for (int x = 0; x < frame.width; ++x, from += 3, to += 4) {
      to[0] = from[2];
      to[1] = from[1];
      to[2] = from[0];
      to[3] = 0;
    }
  }
  frame.pts = impl_->frame_count++;
  impl_->encode(&frame);
}

void LosslessVideo::finish() {
  if (std::exchange(impl_->finished, true)) {
    return;
  }
  impl_->encode(nullptr);
  impl_->check(av_write_trailer(impl_->container.get()), "finish");
  impl_->output->file.commit();
}

}  // namespace facet::simulation
