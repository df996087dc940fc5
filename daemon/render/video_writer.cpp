#include "render/video_writer.hpp"

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
#include <vector>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "render/ffmpeg_writer_api.hpp"

namespace facet::render {
namespace {

constexpr int kBufferBytes = 1 << 18;  // as FFmpeg's own for files
constexpr int kFilmTicks_hz = 90000;
constexpr int kMostAacChannels = 8;
constexpr std::int64_t kAacBits_per_s = 96'000;  // of one channel
constexpr float kFullScale = 8'388'608;          // 24 bits

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
void fill_yuv420(const Picture& picture, const Coding& coding, AVFrame& frame) {
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

void fill_bgr0(const Picture& picture, AVFrame& frame) {
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
    case VideoCodec::Film:
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

/// libx264 gives the same bytes with one thread only, and on every processor only where it is told so.
void configure_any_h264(AVCodecContext& codec) {
  codec.pix_fmt = AV_PIX_FMT_YUV420P;
  codec.color_range = AVCOL_RANGE_MPEG;
  codec.colorspace = AVCOL_SPC_BT709;
  codec.color_primaries = AVCOL_PRI_BT709;
  codec.color_trc = AVCOL_TRC_IEC61966_2_1;
  codec.chroma_sample_location = AVCHROMA_LOC_CENTER;
  codec.thread_count = 1;
}

/// The options of its own that libopenh264 lacks are left out there.
void configure_h264(AVCodecContext& codec, int rate_hz) {
  configure_any_h264(codec);
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

/// libopenh264 has no constant quality: it gets what webcams send, four times.
void configure_film(AVCodecContext& codec, int rate_hz) {
  configure_any_h264(codec);
  codec.gop_size = std::max(1, rate_hz / 2);
  if (std::string(codec.codec->name) == "libx264") {
    ffmpeg().av_opt_set(codec.priv_data, "profile", "high", 0);
    ffmpeg().av_opt_set(codec.priv_data, "preset", "fast", 0);
    ffmpeg().av_opt_set(codec.priv_data, "crf", "17", 0);
    ffmpeg().av_opt_set(codec.priv_data, "x264-params", "cpu-independent=1", 0);
  } else {
    codec.max_b_frames = 0;
    codec.bit_rate = 4 * webcam_bits_per_second(codec.width, codec.height, rate_hz);
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

std::string fault_of(const FilmSound& sound) {
  const AVCodec* encoder = ffmpeg().avcodec_find_encoder(AV_CODEC_ID_AAC);
  if (encoder == nullptr) {
    return "the installed libavcodec has no AAC encoder";
  }
  bool known = false;
  for (const int* rate = encoder->supported_samplerates; rate != nullptr && *rate != 0; ++rate) {
    known = known || *rate == sound.rate_hz;
  }
  return known && sound.channels >= 1 && sound.channels <= kMostAacChannels
             ? std::string()
             : fmt::format("AAC has no {} channels at {} Hz", sound.channels, sound.rate_hz);
}

bool takes_timecode(double rate_hz) {
  constexpr std::array kKnown = {24, 25, 30, 48, 50, 60, 100, 120, 150};
  return std::find(kKnown.begin(), kKnown.end(), std::lround(rate_hz)) != kKnown.end();
}

struct VideoWriter::Impl {
  /// One of the file's streams on its way from samples to packets.
  struct Track {
    std::unique_ptr<AVCodecContext, CloseCodec> codec;
    std::unique_ptr<AVFrame, FreeFrame> frame;
    AVStream* stream = nullptr;  // owned by the container
  };

  std::string file;
  VideoFormat format;
  std::optional<Output> output;
  std::unique_ptr<AVFormatContext, CloseContainer> container;
  std::unique_ptr<AVPacket, FreePacket> packet;
  Track pictures;
  Track sound;
  std::int64_t picture_count = 0;
  std::int64_t sample_count = 0;  ///< of each channel, encoded
  std::vector<float> samples;     ///< [any][channels], not encoded yet
  bool finished = false;

  bool is_film() const { return format.codec == VideoCodec::Film; }

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

  void require_what_can_be() const;
  void add_track(Track& track, const AVCodec* encoder) const;
  void open_codec(const Track& track, const AVCodec* encoder) const;
  void begin_pictures();
  void begin_sound();
  void encode(const Track& track, const AVFrame* next) const;
  void encode_samples(int count);
};

void VideoWriter::Impl::require_what_can_be() const {
  const bool whole = format.rate_hz == std::floor(format.rate_hz) && format.rate_hz <= 1e6;
  if (format.width_px < 1 || format.height_px < 1 || !(format.rate_hz > 0) || (!whole && !is_film())) {
    throw Error(ErrorKind::Usage, fmt::format("{}: a video of {}x{} px at {} Hz cannot be written", file,
                                              format.width_px, format.height_px, format.rate_hz));
  }
  if (format.codec != VideoCodec::Lossless && (format.width_px % 2 != 0 || format.height_px % 2 != 0)) {
    throw Error(ErrorKind::Usage,
                fmt::format("{}: H.264 and Motion JPEG halve the chroma, so {}x{} px cannot "
                            "be written; choose even sides",
                            file, format.width_px, format.height_px));
  }
}

void VideoWriter::Impl::add_track(Track& track, const AVCodec* encoder) const {
  track.stream = ffmpeg().avformat_new_stream(container.get(), nullptr);
  track.codec.reset(ffmpeg().avcodec_alloc_context3(encoder));
  track.frame.reset(ffmpeg().av_frame_alloc());
  if (track.stream == nullptr || !track.codec || !track.frame) {
    throw std::bad_alloc();
  }
  track.codec->log_level_offset = AV_LOG_VERBOSE - AV_LOG_INFO;  // libx264 would tell how it fared
  if ((container->oformat->flags & AVFMT_GLOBALHEADER) != 0) {
    track.codec->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  }
}

void VideoWriter::Impl::open_codec(const Track& track, const AVCodec* encoder) const {
  if (const int code = ffmpeg().avcodec_open2(track.codec.get(), encoder, nullptr); code < 0) {
    throw Error(ErrorKind::Usage,
                fmt::format("{}: {} can't make a video of {}x{} px ({}): choose a smaller one", file,
                            encoder->name, format.width_px, format.height_px, reason_of(code)));
  }
  track.stream->time_base = track.codec->time_base;
  check(ffmpeg().avcodec_parameters_from_context(track.stream->codecpar, track.codec.get()), "set up");
}

void VideoWriter::Impl::begin_pictures() {
  const AVCodec* encoder = encoder_of(format.codec);
  add_track(pictures, encoder);
  AVCodecContext& codec = *pictures.codec;
  codec.width = format.width_px;
  codec.height = format.height_px;
  const auto rate_hz = static_cast<int>(std::max(1L, std::lround(format.rate_hz)));
  codec.time_base = {1, rate_hz};
  codec.framerate = {rate_hz, 1};
  switch (format.codec) {
    case VideoCodec::Lossless:
      configure_lossless(codec);
      break;
    case VideoCodec::H264:
      configure_h264(codec, rate_hz);
      break;
    case VideoCodec::MotionJpeg:
      configure_motion_jpeg(codec);
      break;
    case VideoCodec::Film:
      codec.time_base = {1, kFilmTicks_hz};
      // Rates such as 29.97 as broadcasters write them.
      codec.framerate = std::abs(format.rate_hz - rate_hz) > 1e-3 ? AVRational{rate_hz * 1000, 1001}
                                                                  : AVRational{rate_hz, 1};
      configure_film(codec, rate_hz);
      break;
  }
  open_codec(pictures, encoder);
  pictures.stream->avg_frame_rate = codec.framerate;
  pictures.frame->format = codec.pix_fmt;
  pictures.frame->width = codec.width;
  pictures.frame->height = codec.height;
  check(ffmpeg().av_frame_get_buffer(pictures.frame.get(), 0), "set up");
}

void VideoWriter::Impl::begin_sound() {
  if (const std::string fault = fault_of(*format.sound); !fault.empty()) {
    throw Error(ErrorKind::Usage, fmt::format("{}: {}", file, fault));
  }
  const AVCodec* encoder = ffmpeg().avcodec_find_encoder(AV_CODEC_ID_AAC);
  add_track(sound, encoder);
  AVCodecContext& codec = *sound.codec;
  codec.sample_fmt = AV_SAMPLE_FMT_FLTP;
  codec.sample_rate = format.sound->rate_hz;
  codec.time_base = {1, format.sound->rate_hz};
  codec.bit_rate = kAacBits_per_s * format.sound->channels;
  codec.flags |= AV_CODEC_FLAG_BITEXACT;
  ffmpeg().av_channel_layout_default(&codec.ch_layout, format.sound->channels);
  open_codec(sound, encoder);
  sound.frame->format = codec.sample_fmt;
  sound.frame->sample_rate = codec.sample_rate;
  sound.frame->nb_samples = codec.frame_size;
  ffmpeg().av_channel_layout_default(&sound.frame->ch_layout, format.sound->channels);
  check(ffmpeg().av_frame_get_buffer(sound.frame.get(), 0), "set up");
}

/// Sends a frame (null: the end) to the encoder and writes the packets that it gives.
void VideoWriter::Impl::encode(const Track& track, const AVFrame* next) const {
  check(ffmpeg().avcodec_send_frame(track.codec.get(), next), "encode");
  for (;;) {
    const int got = ffmpeg().avcodec_receive_packet(track.codec.get(), packet.get());
    if (got == AVERROR(EAGAIN) || got == AVERROR_EOF) {
      return;
    }
    check(got, "encode");
    ffmpeg().av_packet_rescale_ts(packet.get(), track.codec->time_base, track.stream->time_base);
    packet->stream_index = track.stream->index;
    check(ffmpeg().av_interleaved_write_frame(container.get(), packet.get()), "write");
  }
}

/// The first `count` of the samples that wait.
void VideoWriter::Impl::encode_samples(int count) {
  AVFrame& frame = *sound.frame;
  check(ffmpeg().av_frame_make_writable(&frame), "encode");
  const auto channels = static_cast<std::size_t>(format.sound->channels);
  for (std::size_t channel = 0; channel < channels; ++channel) {
    auto* const plane = reinterpret_cast<float*>(frame.extended_data[channel]);
    for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k) {
      plane[k] = samples[k * channels + channel];
    }
  }
  frame.nb_samples = count;
  frame.pts = sample_count;
  sample_count += count;
  samples.erase(samples.begin(),
                samples.begin() + static_cast<std::ptrdiff_t>(channels) * static_cast<std::ptrdiff_t>(count));
  encode(sound, &frame);
}

VideoWriter::VideoWriter(const std::filesystem::path& file, const VideoFormat& format)
    : impl_(std::make_unique<Impl>()) {
  impl_->file = file.string();
  impl_->format = format;
  impl_->require_what_can_be();
  AVFormatContext* container = nullptr;
  impl_->check(ffmpeg().avformat_alloc_output_context2(
                   &container, nullptr, impl_->is_film() ? "mp4" : "matroska", impl_->file.c_str()),
               "set up");
  impl_->container.reset(container);
  container->flags |= AVFMT_FLAG_BITEXACT;  // no random identifiers
  impl_->packet.reset(ffmpeg().av_packet_alloc());
  if (!impl_->packet) {
    throw std::bad_alloc();
  }
  impl_->begin_pictures();
  if (impl_->is_film() && format.sound) {
    impl_->begin_sound();
  }
  if (impl_->is_film() && !format.timecode.empty() && takes_timecode(format.rate_hz)) {
    ffmpeg().av_dict_set(&container->metadata, "timecode", format.timecode.c_str(), 0);
  }
  impl_->output.emplace(file);
  auto* const buffer = static_cast<unsigned char*>(ffmpeg().av_malloc(kBufferBytes));
  container->pb =
      ffmpeg().avio_alloc_context(buffer, kBufferBytes, 1, &*impl_->output, nullptr, write_packet, seek);
  if (container->pb == nullptr) {
    ffmpeg().av_free(buffer);
    throw std::bad_alloc();
  }
  impl_->check(ffmpeg().avformat_write_header(container, nullptr), "write");
}

VideoWriter::~VideoWriter() = default;

void VideoWriter::append(const Picture& picture, std::optional<double> time_s) {
  AVFrame& frame = *impl_->pictures.frame;
  if (impl_->finished || picture.width_px != frame.width || picture.height_px != frame.height) {
    throw Error(ErrorKind::Internal,
                fmt::format("{}: a picture of {}x{} px does not fit the video of {}x{} px", impl_->file,
                            picture.width_px, picture.height_px, frame.width, frame.height));
  }
  impl_->check(ffmpeg().av_frame_make_writable(&frame), "encode");
  std::int64_t at = impl_->picture_count;
  switch (impl_->format.codec) {
    case VideoCodec::Lossless:
      fill_bgr0(picture, frame);
      break;
    case VideoCodec::MotionJpeg:
      fill_yuv420(picture, kBt601Full, frame);
      frame.quality = impl_->pictures.codec->global_quality;
      break;
    case VideoCodec::H264:
      fill_yuv420(picture, kBt709Limited, frame);
      break;
    case VideoCodec::Film:
      fill_yuv420(picture, kBt709Limited, frame);
      at = std::llround(time_s.value_or(static_cast<double>(at) / impl_->format.rate_hz) * kFilmTicks_hz);
      break;
  }
  if (impl_->picture_count > 0 && at <= frame.pts) {
    throw Error(ErrorKind::Internal, fmt::format("{}: a picture at {} s is not after the one before",
                                                 impl_->file, time_s.value_or(0)));
  }
  ++impl_->picture_count;
  frame.pts = at;
  impl_->encode(impl_->pictures, &frame);
}

void VideoWriter::append_sound(std::span<const std::int32_t> samples) {
  if (impl_->finished || impl_->sound.codec == nullptr) {
    throw Error(ErrorKind::Internal, fmt::format("{}: a video without sound is given some", impl_->file));
  }
  for (const std::int32_t sample : samples) {
    impl_->samples.push_back(static_cast<float>(sample) / kFullScale);
  }
  const int piece = impl_->sound.codec->frame_size;
  while (impl_->samples.size() >=
         static_cast<std::size_t>(piece) * static_cast<std::size_t>(impl_->format.sound->channels)) {
    impl_->encode_samples(piece);
  }
}

void VideoWriter::finish() {
  if (std::exchange(impl_->finished, true)) {
    return;
  }
  impl_->encode(impl_->pictures, nullptr);
  if (impl_->sound.codec != nullptr) {
    if (!impl_->samples.empty()) {
      impl_->encode_samples(static_cast<int>(impl_->samples.size()) / impl_->format.sound->channels);
    }
    impl_->encode(impl_->sound, nullptr);
  }
  impl_->check(ffmpeg().av_write_trailer(impl_->container.get()), "finish");
  impl_->output->file.commit();
}

}  // namespace facet::render
