#include "camera/video_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <new>
#include <string>
#include <thread>
#include <vector>

#include "camera/pixel_buffers.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "facet/system_error.hpp"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/display.h>
#include <libavutil/pixdesc.h>
#include <libswscale/swscale.h>
}

namespace facet::camera {
namespace {

constexpr int kMaxSide_px = 16384;
constexpr std::int64_t kSecond_ns = 1'000'000'000;
/// A recorded file can't tell its rate: what browsers and players assume.
constexpr double kDefaultRate_hz = 25.0;
/// A paced source that is later than this many frames skips to the newest one.
constexpr int kPacedSlack_frames = 1;
/// It skips for so long; where the file cannot be decoded as fast as it should run, frames come late.
constexpr std::int64_t kLongestSkip_ns = kSecond_ns / 10;
/// A decoder that reports this many errors in a row, with no frame between, is not asked again.
constexpr int kMostDecoderErrors = 100;
/// A step in the file's times longer than this is a damaged time stamp, not a pause.
constexpr std::int64_t kLongestStep_ns = 10 * kSecond_ns;

struct FormatDeleter {
  void operator()(AVFormatContext* context) const { avformat_close_input(&context); }
};
struct CodecDeleter {
  void operator()(AVCodecContext* context) const { avcodec_free_context(&context); }
};
struct FrameDeleter {
  void operator()(AVFrame* frame) const { av_frame_free(&frame); }
};
struct PacketDeleter {
  void operator()(AVPacket* packet) const { av_packet_free(&packet); }
};
struct ScalerDeleter {
  void operator()(SwsContext* context) const { sws_freeContext(context); }
};

std::string describe(int av_error) {
  char text[AV_ERROR_MAX_STRING_SIZE] = {};
  av_strerror(av_error, text, sizeof text);
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
  const std::uint8_t* matrix = av_stream_get_side_data(&stream, AV_PKT_DATA_DISPLAYMATRIX, nullptr);
  if (matrix == nullptr) {
    return 0;
  }
  std::int32_t values[9];
  std::memcpy(values, matrix, sizeof values);
  const double counter_clockwise_deg = av_display_rotation_get(values);
  if (std::isnan(counter_clockwise_deg)) {
    return 0;
  }
  const long turns = std::lround(-counter_clockwise_deg / 90.0);
  return static_cast<int>((turns % 4 + 4) % 4);
}

class VideoFile final : public Camera {
 public:
  explicit VideoFile(const CameraConfig& config);

  CameraInfo info() const override { return info_; }
  CameraStatus status() const override;
  void start() override;
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override;
  void stop() override;
  std::string last_error() const override;

 private:
  CaptureOutcome next_frame(Frame& out, std::chrono::milliseconds timeout);
  void set_state(CameraState state, std::string reason = {});
  CaptureOutcome end_of_stream();
  enum class Decoded { Frame, End, Failed };
  Decoded decode();
  bool rewind();
  bool deliver(Frame& out);
  void set_error(std::string text);
  void set_error(const char* what, int av_error);

  CameraConfig config_;
  CameraInfo info_;
  std::unique_ptr<AVFormatContext, FormatDeleter> format_;
  std::unique_ptr<AVCodecContext, CodecDeleter> codec_;
  std::unique_ptr<AVFrame, FrameDeleter> frame_{av_frame_alloc()};
  std::unique_ptr<AVPacket, PacketDeleter> packet_{av_packet_alloc()};
  std::unique_ptr<SwsContext, ScalerDeleter> scaler_;
  std::shared_ptr<PixelBuffers> pool_ = std::make_shared<PixelBuffers>();
  std::vector<std::uint8_t> unrotated_;  // only where the file asks for a rotation

  int stream_index_ = -1;
  int last_av_error_ = 0;
  int turns_ = 0;
  int scaled_width_px_ = 0;  // before rotation
  int scaled_height_px_ = 0;

  bool started_ = false;
  bool stopped_ = false;
  bool at_end_ = false;
  bool draining_ = false;
  bool pending_ = false;  // frame_ holds a decoded frame that is not delivered yet
  std::uint64_t decoded_count_ = 0;
  std::uint64_t decoded_in_pass_ = 0;
  std::uint64_t damaged_packets_ = 0;
  std::int64_t first_pts_ = AV_NOPTS_VALUE;
  std::int64_t pass_offset_ns_ = 0;  // media time at which this pass over a looped file began
  std::int64_t media_time_ns_ = 0;
  std::int64_t period_ns_ = 0;
  std::int64_t longest_step_ns_ = 0;  // from one frame to the next
  std::int64_t duration_ns_ = 0;      // that the file names; 0 where it does not
  std::int64_t clock_start_ns_ = 0;

  mutable Mutex shown_mutex_;
  std::string error_ FACET_GUARDED_BY(shown_mutex_);
  CameraStatus status_ FACET_GUARDED_BY(shown_mutex_);
};

VideoFile::VideoFile(const CameraConfig& config) : config_(config) {
  av_log_set_level(AV_LOG_QUIET);  // what goes wrong is said in our own words, with the file's name
  const std::string path = config.path.string();
  std::error_code file_error;
  if (!std::filesystem::exists(config.path, file_error)) {
    throw Error(
        kind_of_errno(file_error.value()),
        fmt::format("{}: {}", path, file_error ? describe_errno(file_error.value()) : "no such file"));
  }
  if (std::filesystem::is_directory(config.path, file_error)) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: is a folder, not a video", path));
  }
  if (std::filesystem::is_regular_file(config.path, file_error) &&
      std::filesystem::file_size(config.path, file_error) == 0) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: the file is empty", path));
  }

  if (!frame_ || !packet_) {
    throw std::bad_alloc();
  }
  AVFormatContext* opened = nullptr;
  // "file:" keeps a name with a colon from being read as a protocol.
  int result = avformat_open_input(&opened, ("file:" + path).c_str(), nullptr, nullptr);
  if (result < 0) {
    throw refusal(result, path, "not a video that can be read ({}); is the file complete?");
  }
  format_.reset(opened);
  result = avformat_find_stream_info(format_.get(), nullptr);
  const AVCodec* decoder = nullptr;
  if (result >= 0) {
    result = av_find_best_stream(format_.get(), AVMEDIA_TYPE_VIDEO, -1, -1, &decoder, 0);
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
  codec_.reset(avcodec_alloc_context3(decoder));
  if (!codec_ || !frame_ || !packet_) {
    throw std::bad_alloc();
  }
  result = avcodec_parameters_to_context(codec_.get(), stream.codecpar);
  if (result < 0) {
    throw refusal(result, path, "the stream's parameters are damaged ({})");
  }
  codec_->thread_count = static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1U, 4U));
  result = avcodec_open2(codec_.get(), decoder, nullptr);
  if (result < 0) {
    throw refusal(result, path, "its decoder does not start ({})");
  }

  const int width = stream.codecpar->width;
  const int height = stream.codecpar->height;
  if (width < 1 || height < 1 || width > kMaxSide_px || height > kMaxSide_px) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: a picture of {}x{} px can't be used (1 to {} px a side)", path, width,
                            height, kMaxSide_px));
  }
  // Square pixels: the wider way is kept, so that no line is lost.
  scaled_width_px_ = width;
  scaled_height_px_ = height;
  const AVRational aspect =
      av_guess_sample_aspect_ratio(format_.get(), format_->streams[stream_index_], nullptr);
  if (aspect.num > 0 && aspect.den > 0 && aspect.num != aspect.den) {
    const double ratio = av_q2d(aspect);
    const double stretched = ratio > 1 ? width * ratio : height / ratio;
    if (stretched <= kMaxSide_px) {
      (ratio > 1 ? scaled_width_px_ : scaled_height_px_) = static_cast<int>(std::lround(stretched));
    }
  }
  turns_ = quarter_turns(stream);

  const AVRational rate = av_guess_frame_rate(format_.get(), format_->streams[stream_index_], nullptr);
  info_.rate_hz = rate.num > 0 && rate.den > 0 ? av_q2d(rate) : 0;
  period_ns_ = static_cast<std::int64_t>(static_cast<double>(kSecond_ns) /
                                         (info_.rate_hz > 0 ? info_.rate_hz : kDefaultRate_hz));
  info_.name = path;
  info_.width_px = turns_ % 2 == 0 ? scaled_width_px_ : scaled_height_px_;
  info_.height_px = turns_ % 2 == 0 ? scaled_height_px_ : scaled_width_px_;
  info_.live = config.paced;
  if (!config.loop) {
    if (stream.nb_frames > 0) {
      info_.frame_count = static_cast<std::uint64_t>(stream.nb_frames);
    } else if (format_->duration > 0 && info_.rate_hz > 0) {
      const double seconds = static_cast<double>(format_->duration) / AV_TIME_BASE;
      info_.frame_count = static_cast<std::uint64_t>(std::lround(seconds * info_.rate_hz));
    }
  }
  if (stream.duration > 0) {
    duration_ns_ =
        av_rescale_q(stream.duration, stream.time_base, AVRational{1, static_cast<int>(kSecond_ns)});
  } else if (format_->duration > 0) {
    duration_ns_ = av_rescale(format_->duration, kSecond_ns, AV_TIME_BASE);
  }
}

void VideoFile::start() {
  if (started_) {
    return;
  }
  // The first frame is decoded now, so that a file without one is an error at start and not an empty run.
  const Decoded outcome = decode();
  if (outcome != Decoded::Frame) {
    const std::string reason = last_error();
    throw Error(kind_of_errno(-last_av_error_),
                fmt::format("{}: holds no frame that can be decoded{}", config_.path.string(),
                            reason.empty() ? "" : " (" + reason + ")"));
  }
  started_ = true;
  clock_start_ns_ = Clock::now_ns();
  set_state(CameraState::Opening);
}

void VideoFile::stop() {
  stopped_ = true;
  set_state(CameraState::Idle);
}

CameraStatus VideoFile::status() const {
  const Lock lock(shown_mutex_);
  return status_;
}

void VideoFile::set_state(CameraState state, std::string reason) {
  const Lock lock(shown_mutex_);
  status_.state = state;
  status_.reason = std::move(reason);
}

std::string VideoFile::last_error() const {
  const Lock lock(shown_mutex_);
  return error_;
}

void VideoFile::set_error(std::string text) {
  const Lock lock(shown_mutex_);
  error_ = std::move(text);
}

/// what   with {} for the frame and for the reason
void VideoFile::set_error(const char* what, int av_error) {
  last_av_error_ = av_error;
  set_error(config_.path.string() + ": " +
            fmt::format(fmt::runtime(what), decoded_count_, describe(av_error)));
}

/// Puts the next decoded picture into frame_ and its position into media_time_ns_.
VideoFile::Decoded VideoFile::decode() {
  int errors = 0;
  for (;;) {
    const int received = avcodec_receive_frame(codec_.get(), frame_.get());
    if (received == 0) {
      break;
    }
    if (received == AVERROR_EOF) {
      if (config_.loop && decoded_in_pass_ > 0 && rewind()) {
        continue;
      }
      return Decoded::End;
    }
    if (received != AVERROR(EAGAIN)) {
      ++damaged_packets_;
      set_error("a damaged part near frame {} was skipped ({})", received);
      if (++errors >= kMostDecoderErrors) {
        return Decoded::End;
      }
      continue;
    }
    const int read = av_read_frame(format_.get(), packet_.get());
    if (read < 0) {
      if (read != AVERROR_EOF) {
        set_error("reading ended early at frame {} ({})", read);
      }
      if (draining_) {
        return Decoded::End;
      }
      draining_ = true;
      avcodec_send_packet(codec_.get(), nullptr);
      continue;
    }
    if (packet_->stream_index == stream_index_) {
      const int sent = avcodec_send_packet(codec_.get(), packet_.get());
      if (sent < 0 && sent != AVERROR(EAGAIN)) {
        ++damaged_packets_;
        set_error("a damaged part near frame {} was skipped ({})", sent);
      }
    }
    av_packet_unref(packet_.get());
  }

  const AVStream& stream = *format_->streams[stream_index_];
  const std::int64_t pts = frame_->best_effort_timestamp;
  std::int64_t time_ns = decoded_in_pass_ == 0 ? pass_offset_ns_ : media_time_ns_ + period_ns_;
  if (pts != AV_NOPTS_VALUE) {
    if (first_pts_ == AV_NOPTS_VALUE) {
      first_pts_ = pts;
    }
    const std::int64_t from_file =
        av_sat_add64(pass_offset_ns_, av_rescale_q(av_sat_sub64(pts, first_pts_), stream.time_base,
                                                   AVRational{1, static_cast<int>(kSecond_ns)}));
    // Broken files step back, stand still or jump: time goes on regardless.
    if (decoded_in_pass_ == 0 ||
        (from_file > media_time_ns_ && from_file - media_time_ns_ <= kLongestStep_ns)) {
      time_ns = from_file;
    }
  }
  longest_step_ns_ = std::max(longest_step_ns_, time_ns - media_time_ns_);
  media_time_ns_ = time_ns;
  ++decoded_count_;
  ++decoded_in_pass_;
  pending_ = true;
  return Decoded::Frame;
}

bool VideoFile::rewind() {
  if (av_seek_frame(format_.get(), stream_index_, 0, AVSEEK_FLAG_BACKWARD) < 0 &&
      avformat_seek_file(format_.get(), stream_index_, INT64_MIN, 0, INT64_MAX, 0) < 0) {
    set_error(fmt::format("{}: can't start over, the file can't be rewound", config_.path.string()));
    return false;
  }
  avcodec_flush_buffers(codec_.get());
  draining_ = false;
  decoded_in_pass_ = 0;
  first_pts_ = AV_NOPTS_VALUE;
  pass_offset_ns_ = media_time_ns_ + period_ns_;
  return true;
}

/// Converts frame_ to RGBA, upright, into `out`.
bool VideoFile::deliver(Frame& out) {
  pending_ = false;
  const auto source_format = static_cast<AVPixelFormat>(frame_->format);
  scaler_.reset(sws_getCachedContext(
      scaler_.release(), frame_->width, frame_->height, source_format, scaled_width_px_, scaled_height_px_,
      AV_PIX_FMT_RGBA, SWS_BILINEAR | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INT, nullptr, nullptr, nullptr));
  if (!scaler_) {
    set_error(fmt::format("{}: frame {} has a pixel format that can't be converted", config_.path.string(),
                          decoded_count_ - 1));
    return false;
  }
  int matrix = frame_->colorspace;
  if (matrix == AVCOL_SPC_UNSPECIFIED || matrix == AVCOL_SPC_RGB) {
    matrix = frame_->height >= 720 ? SWS_CS_ITU709 : SWS_CS_ITU601;  // what players assume
  }
  const bool full_range = frame_->color_range == AVCOL_RANGE_JPEG || frame_->format == AV_PIX_FMT_YUVJ420P ||
                          frame_->format == AV_PIX_FMT_YUVJ422P || frame_->format == AV_PIX_FMT_YUVJ444P;
  sws_setColorspaceDetails(scaler_.get(), sws_getCoefficients(matrix), full_range ? 1 : 0,
                           sws_getCoefficients(SWS_CS_DEFAULT), 1, 0, 1 << 16, 1 << 16);

  const int stride = rgba_stride_bytes(info_.width_px);
  const int scaled_stride = rgba_stride_bytes(scaled_width_px_);
  auto buffer = pool_->take(static_cast<std::size_t>(stride) * static_cast<std::size_t>(info_.height_px));
  std::uint8_t* scaled = buffer.get();
  if (turns_ != 0) {
    unrotated_.resize(static_cast<std::size_t>(scaled_stride) * static_cast<std::size_t>(scaled_height_px_));
    scaled = unrotated_.data();
  }
  std::uint8_t* planes[4] = {scaled, nullptr, nullptr, nullptr};
  const int strides[4] = {turns_ != 0 ? scaled_stride : stride, 0, 0, 0};
  sws_scale(scaler_.get(), frame_->data, frame_->linesize, 0, frame_->height, planes, strides);

  if (turns_ != 0) {
    for (int y = 0; y < info_.height_px; ++y) {
      std::uint8_t* row = buffer.get() + static_cast<std::size_t>(y) * static_cast<std::size_t>(stride);
      for (int x = 0; x < info_.width_px; ++x) {
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
                    scaled + static_cast<std::ptrdiff_t>(from_y) * scaled_stride +
                        4 * static_cast<std::ptrdiff_t>(from_x),
                    4);
      }
    }
  }
  const AVPixFmtDescriptor* description = av_pix_fmt_desc_get(source_format);
  if (description != nullptr && (description->flags & AV_PIX_FMT_FLAG_ALPHA) != 0) {
    for (std::size_t i = 3; i < static_cast<std::size_t>(stride) * static_cast<std::size_t>(info_.height_px);
         i += 4) {
      buffer[static_cast<std::ptrdiff_t>(i)] = 255;
    }
  }

  out.sequence = decoded_count_ - 1;
  out.media_time_ns = media_time_ns_;
  out.timestamp_ns = config_.paced ? clock_start_ns_ + media_time_ns_ : Clock::now_ns();
  out.width_px = info_.width_px;
  out.height_px = info_.height_px;
  out.stride_bytes = static_cast<std::size_t>(stride);
  out.corrupt = (frame_->flags & AV_FRAME_FLAG_CORRUPT) != 0 || frame_->decode_error_flags != 0;
  out.pixels = std::move(buffer);
  return true;
}

CaptureOutcome VideoFile::next(Frame& out, std::chrono::milliseconds timeout) {
  if (!started_ || stopped_) {
    return CaptureOutcome::EndOfStream;
  }
  const CaptureOutcome outcome = next_frame(out, timeout);
  if (outcome == CaptureOutcome::EndOfStream) {
    set_state(CameraState::Ended);
  } else if (outcome == CaptureOutcome::Failed) {
    set_state(CameraState::Failing, last_error());
  } else if (outcome == CaptureOutcome::Delivered) {
    const Lock lock(shown_mutex_);
    status_.state = CameraState::Streaming;
    ++status_.counters.delivered;
    status_.counters.damaged += out.corrupt ? 1 : 0;
    status_.counters.skipped = decoded_count_ - status_.counters.delivered;
  }
  return outcome;
}

CaptureOutcome VideoFile::next_frame(Frame& out, std::chrono::milliseconds timeout) {
  if (at_end_) {
    return CaptureOutcome::EndOfStream;
  }
  const std::int64_t deadline_ns =
      Clock::now_ns() + std::chrono::duration_cast<std::chrono::nanoseconds>(timeout).count();
  if (!pending_ && decode() != Decoded::Frame) {
    return end_of_stream();
  }
  if (config_.paced) {
    // Late by more than the slack: the frames in between are gone, as they would be with a live camera.
    const std::int64_t skip_until_ns = Clock::now_ns() + kLongestSkip_ns;
    while (Clock::now_ns() > clock_start_ns_ + media_time_ns_ + (kPacedSlack_frames + 1) * period_ns_) {
      if (Clock::now_ns() > skip_until_ns) {
        break;
      }
      if (decode() != Decoded::Frame) {
        return end_of_stream();
      }
    }
    const std::int64_t due_ns = clock_start_ns_ + media_time_ns_;
    if (due_ns > deadline_ns) {
      std::this_thread::sleep_for(timeout);
      return CaptureOutcome::Timeout;
    }
    std::this_thread::sleep_for(
        std::chrono::nanoseconds(std::max<std::int64_t>(0, due_ns - Clock::now_ns())));
  }
  return deliver(out) ? CaptureOutcome::Delivered : CaptureOutcome::Failed;
}

CaptureOutcome VideoFile::end_of_stream() {
  at_end_ = true;
  // Either alone is no truncation: an edit list leaves frames out, and a varying rate has fewer than the
  // nominal one.
  const bool fewer = info_.frame_count && decoded_count_ + 1 < *info_.frame_count;
  const bool earlier = duration_ns_ == 0 ||
                       media_time_ns_ + std::max(longest_step_ns_, period_ns_) + period_ns_ < duration_ns_;
  if (fewer && earlier && last_error().empty()) {
    set_error(fmt::format("{}: ended at frame {} of about {}; the file seems truncated",
                          config_.path.string(), decoded_count_, *info_.frame_count));
  }
  return CaptureOutcome::EndOfStream;
}

}  // namespace

std::unique_ptr<Camera> open_video_file(const CameraConfig& config) {
  return std::make_unique<VideoFile>(config);
}

namespace {

constexpr CameraSetting kSettings[] = {
    {"path", &at<&CameraConfig::path>},
    {"paced", &at<&CameraConfig::paced>},
    {"loop", &at<&CameraConfig::loop>},
};

}  // namespace

constexpr CameraKind kVideoFile = {
    .name = "file",
    .settings = kSettings,
    .needs = "path",
    .advice = "name the video file that faces come from",
    .open = open_video_file,
};

}  // namespace facet::camera
