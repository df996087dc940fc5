#include "camera/video_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <string>
#include <thread>
#include <utility>

#include "camera/video_decoder.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "facet/system_error.hpp"

namespace facet::camera {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
/// A recorded file can't tell its rate: what browsers and players assume.
constexpr double kDefaultRate_hz = 25.0;
/// A paced source that is later than this many frames skips to the newest one.
constexpr int kPacedSlack_frames = 1;
/// It skips for so long; where the file cannot be decoded as fast as it should run, frames come late.
constexpr std::int64_t kLongestSkip_ns = kSecond_ns / 10;
/// A step in the file's times longer than this is a damaged time stamp, not a pause.
constexpr std::int64_t kLongestStep_ns = 10 * kSecond_ns;

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
  bool decode();
  bool deliver(Frame& out);
  void set_error(std::string text);
  void keep_trouble();

  CameraConfig config_;
  std::unique_ptr<VideoDecoder> decoder_;
  CameraInfo info_;
  bool started_ = false;
  bool stopped_ = false;
  bool at_end_ = false;
  bool pending_ = false;  // the decoder holds a picture that is not delivered yet
  std::uint64_t decoded_count_ = 0;
  std::uint64_t decoded_in_pass_ = 0;
  std::uint64_t kept_troubles_ = 0;
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

/// Throws Error that names the file.
std::unique_ptr<VideoDecoder> open_decoder(const std::filesystem::path& file) {
  const std::string path = file.string();
  std::error_code file_error;
  if (!std::filesystem::exists(file, file_error)) {
    throw Error(
        kind_of_errno(file_error.value()),
        fmt::format("{}: {}", path, file_error ? describe_errno(file_error.value()) : "no such file"));
  }
  if (std::filesystem::is_directory(file, file_error)) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: is a folder, not a video", path));
  }
  if (std::filesystem::is_regular_file(file, file_error) &&
      std::filesystem::file_size(file, file_error) == 0) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: the file is empty", path));
  }
  std::unique_ptr<VideoDecoder> decoder = open_avi_decoder(file);
  return decoder != nullptr ? std::move(decoder) : open_ffmpeg_decoder(file);
}

VideoFile::VideoFile(const CameraConfig& config) : config_(config), decoder_(open_decoder(config.path)) {
  const VideoFacts& facts = decoder_->facts();
  info_.name = config.path.string();
  info_.width_px = facts.width_px;
  info_.height_px = facts.height_px;
  info_.rate_hz = facts.rate_hz;
  info_.live = config.paced;
  if (!config.loop) {
    info_.frame_count = facts.frame_count;
  }
  period_ns_ = static_cast<std::int64_t>(static_cast<double>(kSecond_ns) /
                                         (info_.rate_hz > 0 ? info_.rate_hz : kDefaultRate_hz));
  duration_ns_ = facts.duration_ns;
}

void VideoFile::start() {
  if (started_) {
    return;
  }
  // The first frame is decoded now, so that a file without one is an error at start and not an empty run.
  if (!decode()) {
    const std::string reason = last_error();
    throw Error(kind_of_errno(decoder_->trouble_errno()),
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

void VideoFile::keep_trouble() {
  if (std::exchange(kept_troubles_, decoder_->trouble_count()) != decoder_->trouble_count()) {
    set_error(config_.path.string() + ": " + decoder_->trouble());
  }
}

std::int64_t saturated_sum(std::int64_t a, std::int64_t b) {
  std::int64_t sum = 0;
  return !__builtin_add_overflow(a, b, &sum) ? sum
         : a < 0                             ? std::numeric_limits<std::int64_t>::min()
                                             : std::numeric_limits<std::int64_t>::max();
}

/// Has the decoder make the next picture and puts its position into media_time_ns_.
bool VideoFile::decode() {
  bool decoded = decoder_->advance();
  if (!decoded && config_.loop && decoded_in_pass_ > 0 && decoder_->rewind()) {
    decoded_in_pass_ = 0;
    pass_offset_ns_ = media_time_ns_ + period_ns_;
    decoded = decoder_->advance();
  }
  keep_trouble();
  if (!decoded) {
    return false;
  }
  std::int64_t time_ns = decoded_in_pass_ == 0 ? pass_offset_ns_ : media_time_ns_ + period_ns_;
  if (const auto in_pass_ns = decoder_->time_ns()) {
    const std::int64_t from_file = saturated_sum(pass_offset_ns_, *in_pass_ns);
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
  return true;
}

bool VideoFile::deliver(Frame& out) {
  pending_ = false;
  out.corrupt = decoder_->damaged();
  out.pixels = decoder_->take_picture();
  if (out.pixels == nullptr) {
    keep_trouble();
    return false;
  }
  out.sequence = decoded_count_ - 1;
  out.media_time_ns = media_time_ns_;
  out.timestamp_ns = config_.paced ? clock_start_ns_ + media_time_ns_ : Clock::now_ns();
  out.width_px = info_.width_px;
  out.height_px = info_.height_px;
  out.stride_bytes = static_cast<std::size_t>(rgba_stride_bytes(info_.width_px));
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
  if (!pending_ && !decode()) {
    return end_of_stream();
  }
  if (config_.paced) {
    // Late by more than the slack: the frames in between are gone, as they would be with a live camera.
    const std::int64_t skip_until_ns = Clock::now_ns() + kLongestSkip_ns;
    while (Clock::now_ns() > clock_start_ns_ + media_time_ns_ + (kPacedSlack_frames + 1) * period_ns_) {
      if (Clock::now_ns() > skip_until_ns) {
        break;
      }
      if (!decode()) {
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
