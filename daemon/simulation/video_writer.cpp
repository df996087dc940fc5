#include "simulation/video_writer.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <new>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "simulation/ffmpeg_writer_api.hpp"

namespace facet::simulation {
namespace {

constexpr int kBufferBytes = 1 << 18;  // as FFmpeg's own for files

std::string reason_of(int code) {
  std::array<char, AV_ERROR_MAX_STRING_SIZE> text{};
  ffmpeg().av_strerror(code, text.data(), text.size());
  return text.data();
}

struct CloseCodec {
  void operator()(AVCodecContext* codec) const { ffmpeg().avcodec_free_context(&codec); }
};
struct CloseContainer {
  void operator()(AVFormatContext* container) const {
    if (container->pb != nullptr) {
      ffmpeg().av_freep(&container->pb->buffer);
      ffmpeg().avio_context_free(&container->pb);
    }
    ffmpeg().avformat_free_context(container);
  }
};
struct FreeFrame {
  void operator()(AVFrame* frame) const { ffmpeg().av_frame_free(&frame); }
};
struct FreePacket {
  void operator()(AVPacket* packet) const { ffmpeg().av_packet_free(&packet); }
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

/// Luma weights of red and blue, and the whole numbers that 0 to 1 becomes.
struct Coding {
  float red;
  float blue;
  float luma_low;
  float luma_span;
  float chroma_span;
};
constexpr Coding kBt601Full{0.299F, 0.114F, 0, 255, 255};        // JFIF
constexpr Coding kBt709Limited{0.2126F, 0.0722F, 16, 219, 224};  // ITU-R BT.709

std::uint8_t to_byte(float value) {
  return static_cast<std::uint8_t>(std::lround(std::clamp(value, 0.0F, 255.0F)));
}

/// The picture as planes of luma and, averaged over 2x2 pixels, chroma. frame: of even size
void fill_yuv420(const render::Picture& picture, const Coding& coding, AVFrame& frame) {
  const float green = 1 - coding.red - coding.blue;
  const auto width = static_cast<std::size_t>(frame.width);
  for (int y = 0; y < frame.height; y += 2) {
    for (int x = 0; x < frame.width; x += 2) {
      float blue_sum = 0;
      float red_sum = 0;
      for (const auto& [column, row] : {std::pair{x, y}, {x + 1, y}, {x, y + 1}, {x + 1, y + 1}}) {
        const std::uint8_t* rgb =
            &picture.rgb[3 * (static_cast<std::size_t>(row) * width + static_cast<std::size_t>(column))];
        const auto r = static_cast<float>(rgb[0]) / 255;
        const auto g = static_cast<float>(rgb[1]) / 255;
        const auto b = static_cast<float>(rgb[2]) / 255;
        const float luma = coding.red * r + green * g + coding.blue * b;
        blue_sum += (b - luma) / (2 - 2 * coding.blue);
        red_sum += (r - luma) / (2 - 2 * coding.red);
        frame.data[0][row * frame.linesize[0] + column] = to_byte(coding.luma_low + coding.luma_span * luma);
      }
      frame.data[1][y / 2 * frame.linesize[1] + x / 2] = to_byte(128 + coding.chroma_span * blue_sum / 4);
      frame.data[2][y / 2 * frame.linesize[2] + x / 2] = to_byte(128 + coding.chroma_span * red_sum / 4);
    }
  }
}

void fill_bgr0(const render::Picture& picture, AVFrame& frame) {
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
}

/// Throws Error(Unavailable) where FFmpeg was built without it.
const AVCodec* encoder_of(VideoCodec codec) {
  const AVCodec* found = nullptr;
  switch (codec) {
    case VideoCodec::Lossless:
      found = ffmpeg().avcodec_find_encoder(AV_CODEC_ID_FFV1);
      break;
    case VideoCodec::MotionJpeg:
      found = ffmpeg().avcodec_find_encoder(AV_CODEC_ID_MJPEG);
      break;
    case VideoCodec::H264:
      // By name: encoders of graphics cards give other bytes on every machine.
      found = ffmpeg().avcodec_find_encoder_by_name("libx264");
      if (found == nullptr) {
        found = ffmpeg().avcodec_find_encoder_by_name("libopenh264");
      }
      if (found == nullptr) {
        throw Error(ErrorKind::Unavailable,
                    "the installed libavcodec has no H.264 encoder (libx264 or libopenh264): install a build "
                    "of FFmpeg with one of them, or choose Motion JPEG (mjpeg)");
      }
      break;
  }
  if (found == nullptr) {
    throw Error(ErrorKind::Internal, "the installed libavcodec has no FFV1 or no Motion JPEG encoder");
  }
  return found;
}

void configure_lossless(AVCodecContext& codec) {
  codec.pix_fmt = AV_PIX_FMT_BGR0;
  codec.level = 3;  // FFV1 version 3: slices with checksums
  codec.slices = 4;
  codec.thread_count = 2;
  codec.color_range = AVCOL_RANGE_JPEG;
}

/// libx264 gives the same bytes with one thread only, and on every processor only where it is told so. The
/// options of its own that libopenh264 lacks are left out there.
void configure_h264(AVCodecContext& codec, int rate_hz) {
  codec.pix_fmt = AV_PIX_FMT_YUV420P;
  codec.color_range = AVCOL_RANGE_MPEG;
  codec.colorspace = AVCOL_SPC_BT709;
  codec.color_primaries = AVCOL_PRI_BT709;
  codec.color_trc = AVCOL_TRC_IEC61966_2_1;
  codec.chroma_sample_location = AVCHROMA_LOC_CENTER;
  codec.thread_count = 1;
  codec.gop_size = 2 * rate_hz;
  codec.max_b_frames = 0;
  codec.bit_rate = webcam_bits_per_second(codec.width, codec.height, rate_hz);
  codec.rc_max_rate = codec.bit_rate * 3 / 2;
  codec.rc_buffer_size = static_cast<int>(codec.bit_rate);
  ffmpeg().av_opt_set(codec.priv_data, "profile", "main", 0);
  if (std::string(codec.codec->name) == "libx264") {
    ffmpeg().av_opt_set(codec.priv_data, "preset", "superfast", 0);
    ffmpeg().av_opt_set(codec.priv_data, "tune", "zerolatency", 0);
    ffmpeg().av_opt_set(codec.priv_data, "x264-params", "cpu-independent=1", 0);
  }
}

void configure_motion_jpeg(AVCodecContext& codec) {
  constexpr int kQuantiser = 5;  // of 2 (best) to 31
  codec.pix_fmt = AV_PIX_FMT_YUV420P;
  codec.color_range = AVCOL_RANGE_JPEG;
  codec.colorspace = AVCOL_SPC_BT470BG;
  codec.chroma_sample_location = AVCHROMA_LOC_CENTER;
  codec.thread_count = 1;
  codec.flags |= AV_CODEC_FLAG_QSCALE;
  codec.global_quality = FF_QP2LAMBDA * kQuantiser;
  ffmpeg().av_opt_set(codec.priv_data, "huffman", "default", 0);  // the standard's tables, as in cameras
}

}  // namespace

std::int64_t webcam_bits_per_second(int width_px, int height_px, int rate_hz) {
  const double size = static_cast<double>(width_px) * height_px / (1280.0 * 720.0);
  return std::llround(3e6 * std::pow(size, 0.75) * rate_hz / 30);
}

struct VideoWriter::Impl {
  std::string file;
  std::optional<Output> output;
  std::unique_ptr<AVFormatContext, CloseContainer> container;
  std::unique_ptr<AVCodecContext, CloseCodec> codec;
  std::unique_ptr<AVFrame, FreeFrame> frame;
  std::unique_ptr<AVPacket, FreePacket> packet;
  AVStream* stream = nullptr;  // owned by the container
  VideoCodec kind = VideoCodec::Lossless;
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
    check(ffmpeg().avcodec_send_frame(codec.get(), next), "encode");
    for (;;) {
      const int got = ffmpeg().avcodec_receive_packet(codec.get(), packet.get());
      if (got == AVERROR(EAGAIN) || got == AVERROR_EOF) {
        return;
      }
      check(got, "encode");
      ffmpeg().av_packet_rescale_ts(packet.get(), codec->time_base, stream->time_base);
      packet->stream_index = stream->index;
      check(ffmpeg().av_interleaved_write_frame(container.get(), packet.get()), "write");
    }
  }
};

VideoWriter::VideoWriter(const std::filesystem::path& file, int width_px, int height_px, int rate_hz,
                         VideoCodec codec_kind)
    : impl_(std::make_unique<Impl>()) {
  impl_->file = file.string();
  impl_->kind = codec_kind;
  if (width_px < 1 || height_px < 1 || rate_hz < 1) {
    throw Error(ErrorKind::Usage, fmt::format("{}: a video of {}x{} px at {} Hz cannot be written",
                                              impl_->file, width_px, height_px, rate_hz));
  }
  if (codec_kind != VideoCodec::Lossless && (width_px % 2 != 0 || height_px % 2 != 0)) {
    throw Error(ErrorKind::Usage,
                fmt::format("{}: H.264 and Motion JPEG halve the chroma, so {}x{} px cannot "
                            "be written; choose even sides",
                            impl_->file, width_px, height_px));
  }
  AVFormatContext* container = nullptr;
  impl_->check(ffmpeg().avformat_alloc_output_context2(&container, nullptr, "matroska", impl_->file.c_str()),
               "set up");
  impl_->container.reset(container);
  container->flags |= AVFMT_FLAG_BITEXACT;  // no random identifiers
  const AVCodec* encoder = encoder_of(codec_kind);
  impl_->stream = ffmpeg().avformat_new_stream(container, nullptr);
  impl_->codec.reset(ffmpeg().avcodec_alloc_context3(encoder));
  impl_->frame.reset(ffmpeg().av_frame_alloc());
  impl_->packet.reset(ffmpeg().av_packet_alloc());
  if (impl_->stream == nullptr || !impl_->codec || !impl_->frame || !impl_->packet) {
    throw std::bad_alloc();
  }
  AVCodecContext& codec = *impl_->codec;
  codec.width = width_px;
  codec.height = height_px;
  codec.log_level_offset = AV_LOG_VERBOSE - AV_LOG_INFO;  // libx264 would tell how it fared
  codec.time_base = {1, rate_hz};
  codec.framerate = {rate_hz, 1};
  switch (codec_kind) {
    case VideoCodec::Lossless:
      configure_lossless(codec);
      break;
    case VideoCodec::H264:
      configure_h264(codec, rate_hz);
      break;
    case VideoCodec::MotionJpeg:
      configure_motion_jpeg(codec);
      break;
  }
  if ((container->oformat->flags & AVFMT_GLOBALHEADER) != 0) {
    codec.flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  }
  impl_->check(ffmpeg().avcodec_open2(&codec, encoder, nullptr), "encode");
  impl_->stream->time_base = codec.time_base;
  impl_->stream->avg_frame_rate = codec.framerate;
  impl_->check(ffmpeg().avcodec_parameters_from_context(impl_->stream->codecpar, &codec), "set up");
  impl_->output.emplace(file);
  auto* const buffer = static_cast<unsigned char*>(ffmpeg().av_malloc(kBufferBytes));
  container->pb =
      ffmpeg().avio_alloc_context(buffer, kBufferBytes, 1, &*impl_->output, nullptr, write_packet, seek);
  if (container->pb == nullptr) {
    ffmpeg().av_free(buffer);
    throw std::bad_alloc();
  }
  impl_->check(ffmpeg().avformat_write_header(container, nullptr), "write");

  impl_->frame->format = codec.pix_fmt;
  impl_->frame->width = width_px;
  impl_->frame->height = height_px;
  impl_->check(ffmpeg().av_frame_get_buffer(impl_->frame.get(), 0), "set up");
}

VideoWriter::~VideoWriter() {
  try {
    finish();
  } catch (const Error&) {
    // Documented: who wants to know calls finish().
  }
}

void VideoWriter::append(const render::Picture& picture) {
  AVFrame& frame = *impl_->frame;
  if (impl_->finished || picture.width_px != frame.width || picture.height_px != frame.height) {
    throw Error(ErrorKind::Internal,
                fmt::format("{}: a picture of {}x{} px does not fit the video of {}x{} px", impl_->file,
                            picture.width_px, picture.height_px, frame.width, frame.height));
  }
  impl_->check(ffmpeg().av_frame_make_writable(&frame), "encode");
  switch (impl_->kind) {
    case VideoCodec::Lossless:
      fill_bgr0(picture, frame);
      break;
    case VideoCodec::H264:
      fill_yuv420(picture, kBt709Limited, frame);
      break;
    case VideoCodec::MotionJpeg:
      fill_yuv420(picture, kBt601Full, frame);
      frame.quality = impl_->codec->global_quality;
      break;
  }
  frame.pts = impl_->frame_count++;
  impl_->encode(&frame);
}

void VideoWriter::finish() {
  if (std::exchange(impl_->finished, true)) {
    return;
  }
  impl_->encode(nullptr);
  impl_->check(ffmpeg().av_write_trailer(impl_->container.get()), "finish");
  impl_->output->file.commit();
}

}  // namespace facet::simulation
