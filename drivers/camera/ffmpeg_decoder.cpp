#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <new>
#include <string>
#include <thread>
#include <vector>

#include "camera/ffmpeg_api.hpp"
#include "camera/video_decoder.hpp"
#include "camera/video_file.hpp"
#include "facet/error.hpp"
#include "facet/system_error.hpp"

namespace facet::camera {
namespace {

constexpr AVRational kNanosecond{1, 1'000'000'000};

struct FormatDeleter {
  void operator()(AVFormatContext* context) const { ffmpeg().avformat_close_input(&context); }
};
struct CodecDeleter {
  void operator()(AVCodecContext* context) const { ffmpeg().avcodec_free_context(&context); }
};
struct FrameDeleter {
  void operator()(AVFrame* frame) const { ffmpeg().av_frame_free(&frame); }
};
struct PacketDeleter {
  void operator()(AVPacket* packet) const { ffmpeg().av_packet_free(&packet); }
};
struct ScalerDeleter {
  void operator()(SwsContext* context) const { ffmpeg().sws_freeContext(context); }
};

std::string describe(int av_error) {
  char text[AV_ERROR_MAX_STRING_SIZE] = {};
  ffmpeg().av_strerror(av_error, text, sizeof text);
  return text;
}

/// Why a file can't be a source. FFmpeg hands on what the system said as AVERROR(errno), minus the errno; its
/// own numbers are no errno.
///
/// what   with {} for the reason
Error refusal(int av_error, const std::string& path, const char* what) {
  const std::string why = may_pass(-av_error) ? "can't be read: " + describe_errno(-av_error)
                                              : fmt::format(fmt::runtime(what), describe(av_error));
  return {kind_of_errno(-av_error), fmt::format("{}: {}", path, why)};
}

/// Clockwise quarter turns that put the picture upright, from the stream's display matrix.
int quarter_turns(const AVStream& stream) {
  const std::uint8_t* matrix = ffmpeg().av_stream_get_side_data(&stream, AV_PKT_DATA_DISPLAYMATRIX, nullptr);
  if (matrix == nullptr) {
    return 0;
  }
  std::int32_t values[9];
  std::memcpy(values, matrix, sizeof values);
  const double counter_clockwise_deg = ffmpeg().av_display_rotation_get(values);
  if (std::isnan(counter_clockwise_deg)) {
    return 0;
  }
  const long turns = std::lround(-counter_clockwise_deg / 90.0);
  return static_cast<int>((turns % 4 + 4) % 4);
}

class FfmpegDecoder final : public VideoDecoder {
 public:
  explicit FfmpegDecoder(const std::filesystem::path& file);

  bool advance() override;
  std::optional<std::int64_t> time_ns() const override;
  bool damaged() const override {
    return (frame_->flags & AV_FRAME_FLAG_CORRUPT) != 0 || frame_->decode_error_flags != 0;
  }
  std::shared_ptr<std::uint8_t[]> take_picture() override;
  bool rewind() override;

 private:
  const AVStream& open_stream(const std::string& path);
  void set_sizes(const std::string& path, const AVStream& stream);
  void set_times(const AVStream& stream);
  std::int64_t duration_ns(const AVStream& stream) const;
  bool convert(std::uint8_t* rgba, int stride);
  void turn(std::uint8_t* rgba, int stride) const;
  void describe_trouble(const char* what, int av_error);

  const FfmpegApi& api_ = ffmpeg();
  std::unique_ptr<AVFormatContext, FormatDeleter> format_;
  std::unique_ptr<AVCodecContext, CodecDeleter> codec_;
  std::unique_ptr<AVFrame, FrameDeleter> frame_{api_.av_frame_alloc()};
  std::unique_ptr<AVPacket, PacketDeleter> packet_{api_.av_packet_alloc()};
  std::unique_ptr<SwsContext, ScalerDeleter> scaler_;
  std::vector<std::uint8_t> unrotated_;  // only where the file asks for a rotation

  int stream_index_ = -1;
  int turns_ = 0;
  int scaled_width_px_ = 0;  // before rotation
  int scaled_height_px_ = 0;
  bool draining_ = false;
  std::uint64_t decoded_count_ = 0;
  std::int64_t first_pts_ = AV_NOPTS_VALUE;  // of this pass over the file
};

FfmpegDecoder::FfmpegDecoder(const std::filesystem::path& file) {
  const std::string path = file.string();
  if (!frame_ || !packet_) {
    throw std::bad_alloc();
  }
  const AVStream& stream = open_stream(path);
  set_sizes(path, stream);
  set_times(stream);
}

const AVStream& FfmpegDecoder::open_stream(const std::string& path) {
  AVFormatContext* opened = nullptr;
  // "file:" keeps a name with a colon from being read as a protocol.
  int result = api_.avformat_open_input(&opened, ("file:" + path).c_str(), nullptr, nullptr);
  if (result < 0) {
    throw refusal(result, path, "not a video that can be read ({}); is the file complete?");
  }
  format_.reset(opened);
  result = api_.avformat_find_stream_info(format_.get(), nullptr);
  const AVCodec* decoder = nullptr;
  if (result >= 0) {
    result = api_.av_find_best_stream(format_.get(), AVMEDIA_TYPE_VIDEO, -1, -1, &decoder, 0);
  }
  if (result < 0 || decoder == nullptr) {
    throw refusal(result < 0 ? result : AVERROR_DECODER_NOT_FOUND, path,
                  "holds no video stream that can be decoded ({})");
  }
  stream_index_ = result;
  for (unsigned i = 0; i < format_->nb_streams; ++i) {
    format_->streams[i]->discard = static_cast<int>(i) == stream_index_ ? AVDISCARD_DEFAULT : AVDISCARD_ALL;
  }
  const AVStream& stream = *format_->streams[stream_index_];
  codec_.reset(api_.avcodec_alloc_context3(decoder));
  if (!codec_) {
    throw std::bad_alloc();
  }
  result = api_.avcodec_parameters_to_context(codec_.get(), stream.codecpar);
  if (result < 0) {
    throw refusal(result, path, "the stream's parameters are damaged ({})");
  }
  codec_->thread_count = static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1U, 4U));
  result = api_.avcodec_open2(codec_.get(), decoder, nullptr);
  if (result < 0) {
    throw refusal(result, path, "its decoder does not start ({})");
  }
  return stream;
}

void FfmpegDecoder::set_sizes(const std::string& path, const AVStream& stream) {
  const int width = stream.codecpar->width;
  const int height = stream.codecpar->height;
  if (width < 1 || height < 1 || width > kMostVideoSide_px || height > kMostVideoSide_px) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: a picture of {}x{} px can't be used (1 to {} px a side)", path, width,
                            height, kMostVideoSide_px));
  }
  // Square pixels: the wider way is kept, so that no line is lost.
  scaled_width_px_ = width;
  scaled_height_px_ = height;
  const AVRational aspect =
      api_.av_guess_sample_aspect_ratio(format_.get(), format_->streams[stream_index_], nullptr);
  if (aspect.num > 0 && aspect.den > 0 && aspect.num != aspect.den) {
    const double ratio = av_q2d(aspect);
    const double stretched = ratio > 1 ? width * ratio : height / ratio;
    if (stretched <= kMostVideoSide_px) {
      (ratio > 1 ? scaled_width_px_ : scaled_height_px_) = static_cast<int>(std::lround(stretched));
    }
  }
  turns_ = quarter_turns(stream);
  facts_.width_px = turns_ % 2 == 0 ? scaled_width_px_ : scaled_height_px_;
  facts_.height_px = turns_ % 2 == 0 ? scaled_height_px_ : scaled_width_px_;
}

void FfmpegDecoder::set_times(const AVStream& stream) {
  const AVRational rate = api_.av_guess_frame_rate(format_.get(), format_->streams[stream_index_], nullptr);
  facts_.rate_hz = rate.num > 0 && rate.den > 0 ? av_q2d(rate) : 0;
  facts_.duration_ns = duration_ns(stream);
  if (stream.nb_frames > 0) {
    facts_.frame_count = static_cast<std::uint64_t>(stream.nb_frames);
  } else if (facts_.duration_ns > 0 && facts_.rate_hz > 0) {
    const double seconds = static_cast<double>(facts_.duration_ns) / kNanosecond.den;
    facts_.frame_count = static_cast<std::uint64_t>(std::lround(seconds * facts_.rate_hz));
  }
}

/// The stream's own; of a Matroska file, which has it as a tag alone, that. Only where nobody says it the
/// file's, which is its longest stream's: sound may outlast the picture.
std::int64_t FfmpegDecoder::duration_ns(const AVStream& stream) const {
  if (stream.duration > 0) {
    return api_.av_rescale_q(stream.duration, stream.time_base, kNanosecond);
  }
  std::int64_t duration_us = format_->duration;
  const AVDictionaryEntry* tag =
      api_.av_dict_get(stream.metadata, "DURATION", nullptr, AV_DICT_IGNORE_SUFFIX);
  if (std::int64_t told_us = 0;
      tag != nullptr && api_.av_parse_time(&told_us, tag->value, 1) == 0 && told_us > 0) {
    duration_us = told_us;
  }
  return duration_us > 0 ? api_.av_rescale(duration_us, kNanosecond.den, AV_TIME_BASE) : 0;
}

/// what   with {} for the frame and for the reason
void FfmpegDecoder::describe_trouble(const char* what, int av_error) {
  set_trouble(fmt::format(fmt::runtime(what), decoded_count_, describe(av_error)),
              may_pass(-av_error) ? -av_error : 0);
}

bool FfmpegDecoder::advance() {
  constexpr const char* kDamagedPart = "a damaged part near frame {} was skipped ({})";
  int errors = 0;
  for (;;) {
    const int received = api_.avcodec_receive_frame(codec_.get(), frame_.get());
    if (received == 0) {
      break;
    }
    if (received == AVERROR_EOF) {
      return false;
    }
    if (received != AVERROR(EAGAIN)) {
      describe_trouble(kDamagedPart, received);
      if (++errors >= kMostVideoErrors) {
        return false;
      }
      continue;
    }
    const int read = api_.av_read_frame(format_.get(), packet_.get());
    if (read < 0) {
      if (read != AVERROR_EOF) {
        describe_trouble("reading ended early at frame {} ({})", read);
      }
      if (draining_) {
        return false;
      }
      draining_ = true;
      api_.avcodec_send_packet(codec_.get(), nullptr);
      continue;
    }
    if (packet_->stream_index == stream_index_) {
      const int sent = api_.avcodec_send_packet(codec_.get(), packet_.get());
      if (sent < 0 && sent != AVERROR(EAGAIN)) {
        describe_trouble(kDamagedPart, sent);
      }
    }
    api_.av_packet_unref(packet_.get());
  }
  ++decoded_count_;
  if (first_pts_ == AV_NOPTS_VALUE) {
    first_pts_ = frame_->best_effort_timestamp;
  }
  return true;
}

std::optional<std::int64_t> FfmpegDecoder::time_ns() const {
  const std::int64_t pts = frame_->best_effort_timestamp;
  if (pts == AV_NOPTS_VALUE) {
    return std::nullopt;
  }
  return api_.av_rescale_q(av_sat_sub64(pts, first_pts_), format_->streams[stream_index_]->time_base,
                           kNanosecond);
}

bool FfmpegDecoder::rewind() {
  if (api_.av_seek_frame(format_.get(), stream_index_, 0, AVSEEK_FLAG_BACKWARD) < 0 &&
      api_.avformat_seek_file(format_.get(), stream_index_, INT64_MIN, 0, INT64_MAX, 0) < 0) {
    set_trouble("can't start over, the file can't be rewound");
    return false;
  }
  api_.avcodec_flush_buffers(codec_.get());
  draining_ = false;
  first_pts_ = AV_NOPTS_VALUE;
  return true;
}

/// The frame as RGBA, before it is turned.
bool FfmpegDecoder::convert(std::uint8_t* rgba, int stride) {
  const auto source_format = static_cast<AVPixelFormat>(frame_->format);
  scaler_.reset(api_.sws_getCachedContext(
      scaler_.release(), frame_->width, frame_->height, source_format, scaled_width_px_, scaled_height_px_,
      AV_PIX_FMT_RGBA, SWS_BILINEAR | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INT, nullptr, nullptr, nullptr));
  if (!scaler_) {
    set_trouble(fmt::format("frame {} has a pixel format that can't be converted", decoded_count_ - 1));
    return false;
  }
  int matrix = frame_->colorspace;
  if (matrix == AVCOL_SPC_UNSPECIFIED || matrix == AVCOL_SPC_RGB) {
    matrix = frame_->height >= 720 ? SWS_CS_ITU709 : SWS_CS_ITU601;  // what players assume
  }
  const bool full_range = frame_->color_range == AVCOL_RANGE_JPEG || frame_->format == AV_PIX_FMT_YUVJ420P ||
                          frame_->format == AV_PIX_FMT_YUVJ422P || frame_->format == AV_PIX_FMT_YUVJ444P;
  api_.sws_setColorspaceDetails(scaler_.get(), api_.sws_getCoefficients(matrix), full_range ? 1 : 0,
                                api_.sws_getCoefficients(SWS_CS_DEFAULT), 1, 0, 1 << 16, 1 << 16);
  std::uint8_t* planes[4] = {rgba, nullptr, nullptr, nullptr};
  const int strides[4] = {stride, 0, 0, 0};
  api_.sws_scale(scaler_.get(), frame_->data, frame_->linesize, 0, frame_->height, planes, strides);
  return true;
}

/// From unrotated_.
void FfmpegDecoder::turn(std::uint8_t* rgba, int stride) const {
  const int scaled_stride = rgba_stride_bytes(scaled_width_px_);
  for (int y = 0; y < facts_.height_px; ++y) {
    std::uint8_t* row = rgba + static_cast<std::size_t>(y) * static_cast<std::size_t>(stride);
    for (int x = 0; x < facts_.width_px; ++x) {
      int from_x = scaled_width_px_ - 1 - x;
      int from_y = scaled_height_px_ - 1 - y;
      if (turns_ == 1) {
        from_x = y;
        from_y = scaled_height_px_ - 1 - x;
      } else if (turns_ == 3) {
        from_x = scaled_width_px_ - 1 - y;
        from_y = x;
      }
      std::memcpy(row + 4 * static_cast<std::ptrdiff_t>(x),
                  unrotated_.data() + static_cast<std::ptrdiff_t>(from_y) * scaled_stride +
                      4 * static_cast<std::ptrdiff_t>(from_x),
                  4);
    }
  }
}

std::shared_ptr<std::uint8_t[]> FfmpegDecoder::take_picture() {
  const int stride = rgba_stride_bytes(facts_.width_px);
  const std::size_t size = static_cast<std::size_t>(stride) * static_cast<std::size_t>(facts_.height_px);
  auto buffer = pool_->take(size);
  if (turns_ == 0) {
    if (!convert(buffer.get(), stride)) {
      return nullptr;
    }
  } else {
    const int scaled_stride = rgba_stride_bytes(scaled_width_px_);
    unrotated_.resize(static_cast<std::size_t>(scaled_stride) * static_cast<std::size_t>(scaled_height_px_));
    if (!convert(unrotated_.data(), scaled_stride)) {
      return nullptr;
    }
    turn(buffer.get(), stride);
  }
  const AVPixFmtDescriptor* description =
      api_.av_pix_fmt_desc_get(static_cast<AVPixelFormat>(frame_->format));
  if (description != nullptr && (description->flags & AV_PIX_FMT_FLAG_ALPHA) != 0) {
    for (std::size_t i = 3; i < size; i += 4) {
      buffer[static_cast<std::ptrdiff_t>(i)] = 255;
    }
  }
  return buffer;
}

}  // namespace

void require_ffmpeg() {
  ffmpeg();
}

std::unique_ptr<VideoDecoder> open_ffmpeg_decoder(const std::filesystem::path& file) {
  try {
    require_ffmpeg();
  } catch (const Error& error) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: only plain Motion JPEG in AVI is read without FFmpeg, and {}", file.string(),
                            error.what()));
  }
  return std::make_unique<FfmpegDecoder>(file);
}

}  // namespace facet::camera
