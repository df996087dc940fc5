// `facet import`: a take of a booth's pictures out of the pictures or videos of others.

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

#include "camera/factory.hpp"
#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "files/image_file.hpp"
#include "maths/srgb.hpp"
#include "mesh/mesh_frame.hpp"
#include "natural_order.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "slot_program.hpp"
#include "stop_signals.hpp"
#include "take/recorder.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

/// Periods of the program whose pictures tell where it begins.
constexpr std::size_t kPeriodsLookedAt = 12;
constexpr std::int64_t kMostSlots = 10'000'000;

struct ImportOptions {
  std::vector<std::string> inputs;
  std::string take;
  std::string rig;
  std::string grey = "srgb";
  std::string program = "stripes,stripes,blank";
  std::vector<std::string> shifts;
  double rate_hz = 60;
  int start = -1;
};

/// Values of 16 bits to sRGB of 8.
using Coding = std::vector<std::uint8_t>;

Coding coding_of(const std::string& grey) {
  Coding coding(std::size_t{1} << 16);
  for (std::size_t v = 0; v < coding.size(); ++v) {
    const float share = static_cast<float>(v) / 65535.0F;
    const float coded = grey == "linear" ? maths::encode_srgb(share) : share;
    coding[v] = static_cast<std::uint8_t>(std::lround(255 * std::clamp(coded, 0.0F, 1.0F)));
  }
  return coding;
}

/// The pictures of one camera, by number, each asked for once and in order.
class PictureRow {
 public:
  virtual ~PictureRow() = default;
  virtual std::uint64_t first() const = 0;
  /// One behind the last; a video's is an estimate.
  virtual std::uint64_t end() const = 0;
  /// Empty where there is none of the number. Throws Error(UnreadableInput).
  virtual Frame at(std::uint64_t number) = 0;
};

bool is_png_or_jpeg(const std::filesystem::path& file) {
  const std::string extension = file.extension().string();
  constexpr std::array kKnown = {".png", ".PNG", ".jpg", ".JPG", ".jpeg", ".JPEG"};
  return std::any_of(kKnown.begin(), kKnown.end(), [&](const char* known) { return extension == known; });
}

Frame frame_of(const files::RgbImage<std::uint16_t>& image, const Coding& coding) {
  Frame frame;
  frame.width_px = image.width_px;
  frame.height_px = image.height_px;
  frame.stride_bytes = std::size_t{4} * static_cast<std::size_t>(image.width_px);
  const std::size_t pixels =
      static_cast<std::size_t>(image.width_px) * static_cast<std::size_t>(image.height_px);
  const std::shared_ptr<std::uint8_t[]> rgba(new std::uint8_t[4 * pixels]);
  std::uint8_t* const bytes = rgba.get();
  for (std::size_t i = 0; i < pixels; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      bytes[4 * i + c] = coding[image.values[3 * i + c]];
    }
    bytes[4 * i + 3] = 255;
  }
  frame.pixels = rgba;
  return frame;
}

/// The same of a picture that was decoded already.
void recode(Frame& frame, const Coding& coding) {
  const std::shared_ptr<std::uint8_t[]> rgba(
      new std::uint8_t[frame.stride_bytes * static_cast<std::size_t>(frame.height_px)]);
  for (int y = 0; y < frame.height_px; ++y) {
    const std::uint8_t* from = frame.row(y);
    std::uint8_t* to = rgba.get() + static_cast<std::size_t>(y) * frame.stride_bytes;
    for (int x = 0; x < 4 * frame.width_px; ++x) {
      to[x] = x % 4 == 3 ? 255 : coding[static_cast<std::size_t>(from[x]) * 257];
    }
  }
  frame.pixels = rgba;
}

/// A picture that FFmpeg reads, or the next one of a video; nothing at its end. Throws
/// Error(UnreadableInput), also for one that is cut short.
std::optional<Frame> next_of(Camera& camera, const std::filesystem::path& file) {
  Frame frame;
  switch (camera.next(frame, std::chrono::seconds(60))) {
    case CaptureOutcome::Delivered:
      return frame;
    case CaptureOutcome::EndOfStream:
      if (camera.last_error().empty()) {
        return std::nullopt;
      }
      break;
    case CaptureOutcome::Timeout:
    case CaptureOutcome::Failed:
      break;
  }
  throw Error(ErrorKind::UnreadableInput, fmt::format("'{}': {}", file.string(), camera.last_error()));
}

/// The files of a folder, by the number that their names end in.
class PictureFolder final : public PictureRow {
 public:
  PictureFolder(const std::filesystem::path& folder, const Coding& coding) : coding_(coding) {
    std::vector<std::filesystem::path> files;
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      if (entry.is_regular_file() && entry.path().filename().string().front() != '.') {
        files.push_back(entry.path());
      }
    }
    std::sort(files.begin(), files.end(), [](const auto& a, const auto& b) {
      return natural_before(a.filename().string(), b.filename().string());
    });
    for (const std::filesystem::path& file : files) {
      const auto [known, is_new] = files_.emplace(number_of(file), file);
      if (!is_new) {
        throw Error(ErrorKind::Usage,
                    fmt::format("'{}' and '{}' have the same number: pictures are told apart by "
                                "the last number of their names",
                                known->second.string(), file.string()));
      }
    }
    if (files_.empty()) {
      throw Error(ErrorKind::UnreadableInput, fmt::format("'{}' has no pictures in it", folder.string()));
    }
  }
  std::uint64_t first() const override { return files_.begin()->first; }
  std::uint64_t end() const override { return files_.rbegin()->first + 1; }
  Frame at(std::uint64_t number) override {
    const auto found = files_.find(number);
    if (found == files_.end()) {
      return {};
    }
    if (is_png_or_jpeg(found->second)) {
      return frame_of(files::read_image<std::uint16_t>(found->second), coding_);
    }
    const auto camera = camera::open_camera({.kind = "file", .path = found->second});
    camera->start();
    auto frame = next_of(*camera, found->second);
    if (!frame) {
      throw Error(ErrorKind::UnreadableInput, fmt::format("'{}' holds no picture", found->second.string()));
    }
    recode(*frame, coding_);
    return *frame;
  }

 private:
  static std::uint64_t number_of(const std::filesystem::path& file) {
    const std::string name = file.stem().string();
    const auto end = name.find_last_of("0123456789");
    if (end == std::string::npos) {
      throw Error(ErrorKind::Usage,
                  fmt::format("'{}' has no number in its name, which would tell its slot", file.string()));
    }
    const auto before = name.find_last_not_of("0123456789", end);
    const std::size_t begin = before == std::string::npos ? 0 : before + 1;
    std::uint64_t number = 0;
    const auto [stop, fault] = std::from_chars(name.data() + begin, name.data() + end + 1, number);
    if (fault != std::errc() || number > (std::uint64_t{1} << 48)) {
      throw Error(ErrorKind::Usage, fmt::format("the number of '{}' is too large", file.string()));
    }
    return number;
  }

  const Coding& coding_;
  std::map<std::uint64_t, std::filesystem::path> files_;
};

/// A video: its frames are numbered from 0.
class PictureVideo final : public PictureRow {
 public:
  PictureVideo(const std::filesystem::path& file, const Coding& coding)
      : file_(file), coding_(coding), camera_(camera::open_camera({.kind = "file", .path = file})) {
    camera_->start();
    ahead_ = next_of(*camera_, file_);
  }
  std::uint64_t first() const override { return 0; }
  std::uint64_t end() const override {
    return ahead_ ? std::max<std::uint64_t>(camera_->info().frame_count.value_or(0), next_ + 1) : next_;
  }
  Frame at(std::uint64_t number) override {
    while (ahead_ && next_ < number) {  // of before the first slot that is imported
      ahead_ = next_of(*camera_, file_);
      ++next_;
    }
    if (number != next_ || !ahead_) {
      return {};
    }
    Frame frame = *std::exchange(ahead_, next_of(*camera_, file_));
    ++next_;
    recode(frame, coding_);
    return frame;
  }

 private:
  std::filesystem::path file_;
  const Coding& coding_;
  std::unique_ptr<Camera> camera_;
  std::optional<Frame> ahead_;
  std::uint64_t next_ = 0;  ///< number of what is ahead
};

/// Mean step from a pixel to the second next one in its row, of the green: stripes have many, skin few.
double unevenness(const Frame& frame) {
  if (frame.empty()) {
    return 0;
  }
  double sum = 0;
  for (int y = 0; y < frame.height_px; y += 2) {
    const std::uint8_t* row = frame.row(y) + 1;
    for (int x = 2; x < frame.width_px; ++x) {
      sum += std::abs(row[std::ptrdiff_t{4} * x] - row[std::ptrdiff_t{4} * (x - 2)]);
    }
  }
  return 1e-6 + sum / (static_cast<double>(frame.width_px) * frame.height_px);
}

struct NamedInput {
  std::string camera;
  std::filesystem::path place;
  std::int64_t shift = 0;  ///< slots by which its pictures come late
};

std::pair<std::string, std::string> parted(const std::string& text, const char* what) {
  const std::size_t equals = text.find('=');
  if (equals == std::string::npos || equals == 0 || equals + 1 == text.size()) {
    throw Error(ErrorKind::Usage, fmt::format("'{}' is none: {}", text, what));
  }
  return {text.substr(0, equals), text.substr(equals + 1)};
}

std::vector<NamedInput> named_inputs(const ImportOptions& options) {
  std::vector<NamedInput> inputs;
  for (const std::string& given : options.inputs) {
    const auto [camera, place] = parted(given, "name the camera and its folder or video, CAMERA=FOLDER");
    if (std::any_of(inputs.begin(), inputs.end(),
                    [&name = camera](const NamedInput& one) { return one.camera == name; })) {
      throw Error(ErrorKind::Usage, fmt::format("camera '{}' is given twice", camera));
    }
    inputs.push_back({camera, place, 0});
  }
  for (const std::string& given : options.shifts) {
    const auto [camera, number] = parted(given, "--shift takes CAMERA=SLOTS");
    const auto found = std::find_if(inputs.begin(), inputs.end(),
                                    [&name = camera](const NamedInput& one) { return one.camera == name; });
    std::int64_t shift = 0;
    const auto [stop, fault] = std::from_chars(number.data(), number.data() + number.size(), shift);
    if (found == inputs.end() || fault != std::errc() || stop != number.data() + number.size() ||
        std::abs(shift) > 1'000'000) {
      throw Error(ErrorKind::Usage,
                  fmt::format("--shift {}: CAMERA=SLOTS of a camera that is imported", given));
    }
    found->shift = shift;
  }
  if (inputs.size() > kMaxCameras) {
    throw Error(ErrorKind::Usage,
                fmt::format("{} cameras are given, the most are {}", inputs.size(), kMaxCameras));
  }
  return inputs;
}

class Import {
 public:
  explicit Import(const ImportOptions& options)
      : options_(options),
        program_(capture::parse_slot_program(options.program)),
        coding_(coding_of(options.grey)),
        inputs_(named_inputs(options)) {
    if (!options.rig.empty()) {
      rig_ = capture::read_rig(options.rig);
    }
    names_ = std::make_shared<std::vector<std::string>>();
    for (const NamedInput& input : inputs_) {
      if (rig_) {
        capture::camera_named(*rig_, options.rig, input.camera,
                              "name the pictures' camera as the rig file does");
      }
      names_->push_back(input.camera);
    }
    sizes_.resize(inputs_.size());
  }

  void run() {
    const std::size_t start = options_.start >= 0 ? static_cast<std::size_t>(options_.start) : find_start();
    if (start >= program_.size()) {
      throw Error(ErrorKind::Usage,
                  fmt::format("--start {}: the program has slots 0 to {}", start, program_.size() - 1));
    }
    open();
    const StopSignals signals;  // before the recorder's threads
    take::TakeRecorderConfig config;
    config.file = options_.take;
    config.source = fmt::format("imported from {}", options_.inputs.front());
    config.software = "facet " FACET_VERSION;
    config.when_full = take::WhenFull::Wait;
    config.queue_frames = 4;
    config.with_images = true;
    take::TakeRecorder recorder(config);
    recorder.start();
    try {
      write(recorder, start, signals);
    } catch (...) {
      recorder.stop();
      remove_take();
      throw;
    }
    const take::RecorderStatus status = recorder.stop();
    if (const int signal = signals.pending(); signal != 0) {
      remove_take();
      signals.die_of(signal);
    }
    if (status.state != take::RecorderState::Finished || status.frames != written_ || written_ == 0) {
      throw Error(ErrorKind::Storage,
                  fmt::format("{}: {} of {} slots were written: {}", options_.take, status.frames, written_,
                              status.reason.empty() ? "there are none" : status.reason));
    }
    tell("{}: {} slots of {} cameras, {} pictures missing; the first slot is number {} of the program ({})\n",
         options_.take, written_, inputs_.size(), missing_, start, options_.program);
  }

 private:
  /// Every slot, or those until a signal comes.
  void write(take::TakeRecorder& recorder, std::size_t start, const StopSignals& signals) {
    Progress progress("Importing", static_cast<std::uint64_t>(end_ - first_), "slots");
    for (std::int64_t number = first_; number < end(); ++number) {
      if (signals.pending() != 0) {
        return;
      }
      FrameSet set = set_of(number, start);
      if (set.missing ==
          (inputs_.size() == kMaxCameras ? ~std::uint64_t{0} : (std::uint64_t{1} << inputs_.size()) - 1)) {
        continue;  // a gap of all cameras is a slot that nobody has
      }
      missing_ += static_cast<std::uint64_t>(std::popcount(set.missing));
      auto frame = std::make_shared<mesh::MeshFrame>();
      frame->sequence = set.slot;
      frame->timestamp_ns = set.trigger_ns;
      frame->media_time_ns = set.media_time_ns;
      frame->degraded = !set.complete();
      frame->degraded_reason = frame->degraded ? "a picture is missing" : "";
      frame->control_vertices_mm.resize(3, 0);
      frame->images = std::make_shared<const FrameSet>(std::move(set));
      if (!recorder.record(std::move(frame))) {
        break;  // stop() says why
      }
      ++written_;
      progress.set(static_cast<std::uint64_t>(number + 1 - first_));
    }
    progress.finish();
  }
  void remove_take() const {
    std::error_code ignored;
    std::filesystem::path frames = options_.take;
    std::filesystem::remove(frames, ignored);
    std::filesystem::remove_all(frames.replace_extension(".frames"), ignored);
  }

  /// From the beginning.
  void open() {
    rows_.clear();
    first_ = std::numeric_limits<std::int64_t>::max();
    for (const NamedInput& input : inputs_) {
      std::error_code ignored;
      if (std::filesystem::is_directory(input.place, ignored)) {
        rows_.push_back(std::make_unique<PictureFolder>(input.place, coding_));
      } else {
        rows_.push_back(std::make_unique<PictureVideo>(input.place, coding_));
      }
      first_ = std::min(first_, shifted(rows_.size() - 1, rows_.back()->first()));
    }
    end_ = end();
    if (end_ - first_ > kMostSlots) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("the pictures' numbers go from {} to {}: more slots than an import has; a file whose "
                      "name ends in another number, such as a time, belongs elsewhere",
                      first_, end_ - 1));
    }
  }
  std::int64_t shifted(std::size_t k, std::uint64_t number) const {
    return static_cast<std::int64_t>(number) - inputs_[k].shift;
  }
  std::int64_t end() const {
    std::int64_t end = first_;
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      end = std::max(end, shifted(k, rows_[k]->end()));
    }
    return end;
  }

  Frame picture(std::size_t k, std::int64_t number) {
    const std::int64_t own = number + inputs_[k].shift;
    Frame frame = own < 0 ? Frame{} : rows_[k]->at(static_cast<std::uint64_t>(own));
    if (frame.empty()) {
      return frame;
    }
    auto& [width, height] = sizes_[k];
    if (width == 0) {
      width = frame.width_px;
      height = frame.height_px;
      if (rig_) {
        const capture::RigCamera& camera =
            rig_->cameras[capture::find_camera(*rig_, inputs_[k].camera).value()];
        if (camera.lens.width_px != width || camera.lens.height_px != height) {
          throw Error(
              ErrorKind::UnreadableInput,
              fmt::format("pictures of camera '{}' are {} x {} px, but '{}' was calibrated at {} x {} px",
                          inputs_[k].camera, width, height, options_.rig, camera.lens.width_px,
                          camera.lens.height_px));
        }
      }
    } else if (frame.width_px != width || frame.height_px != height) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("picture {} of camera '{}' is {} x {} px, those before it {} x {} px", own,
                              inputs_[k].camera, frame.width_px, frame.height_px, width, height));
    }
    return frame;
  }

  /// With which slot of the program the pictures begin, asked of every camera by itself.
  std::size_t find_start() {
    open();
    const std::size_t count =
        std::min(static_cast<std::size_t>(end_ - first_), kPeriodsLookedAt * program_.size());
    std::vector<std::vector<double>> uneven(inputs_.size(), std::vector<double>(count, 0.0));
    for (std::size_t n = 0; n < count; ++n) {
      for (std::size_t k = 0; k < inputs_.size(); ++k) {
        uneven[k][n] = unevenness(picture(k, first_ + static_cast<std::int64_t>(n)));
      }
    }
    std::optional<std::size_t> agreed;
    std::string by;
    for (std::size_t k = 0; k < inputs_.size(); ++k) {
      const ProgramStart start = find_program_start(uneven[k], program_);
      if (!start.told) {
        continue;
      }
      if (agreed && *agreed != start.first) {
        const std::size_t late = (*agreed + start.repeats_after - start.first) % start.repeats_after;
        throw Error(
            ErrorKind::UnreadableInput,
            fmt::format("the blank pictures of camera '{}' come {} slots later than those of '{}': its "
                        "pictures are numbered otherwise; --shift {}={} mends it",
                        inputs_[k].camera, late, by, inputs_[k].camera, late));
      }
      if (!agreed) {
        agreed = start.first;
        by = inputs_[k].camera;
      }
    }
    if (!agreed) {
      throw Error(
          ErrorKind::UnreadableInput,
          fmt::format("no camera tells which slots of '{}' are blank, which are the even ones: say with "
                      "--start which slot of the program comes first, or mend --program",
                      options_.program));
    }
    return *agreed;
  }

  FrameSet set_of(std::int64_t number, std::size_t start) {
    FrameSet set;
    const auto since = static_cast<std::uint64_t>(number - first_);
    const auto time = [&](std::uint64_t slots) {
      return static_cast<std::int64_t>(std::llround(static_cast<double>(slots) * 1e9 / options_.rate_hz));
    };
    set.slot = since + start;
    set.light = capture::to_word(capture::light_of_slot(program_, set.slot));
    set.trigger_ns = time(set.slot);
    set.media_time_ns = time(since);
    set.camera_names = names_;
    for (std::size_t k = 0; k < inputs_.size(); ++k) {
      Frame frame = picture(k, number);
      frame.sequence = set.slot;
      frame.timestamp_ns = set.trigger_ns;
      frame.media_time_ns = set.media_time_ns;
      set.missing |= frame.empty() ? std::uint64_t{1} << k : 0;
      set.frames.push_back(std::move(frame));
    }
    return set;
  }

  ImportOptions options_;
  capture::SlotProgram program_;
  Coding coding_;
  std::vector<NamedInput> inputs_;
  std::optional<capture::Rig> rig_;
  std::shared_ptr<std::vector<std::string>> names_;
  std::vector<std::unique_ptr<PictureRow>> rows_;
  std::uint64_t missing_ = 0;
  std::uint64_t written_ = 0;
  std::vector<std::pair<int, int>> sizes_;  ///< [inputs] width and height, px
  std::int64_t first_ = 0;  ///< slots as the pictures are numbered, each camera's shift taken away
  std::int64_t end_ = 0;
};

}  // namespace

void add_import_command(Command app) {
  auto options = std::make_shared<ImportOptions>();
  const Command command = app.subcommand(
      "import", "Make a take of a booth's pictures out of pictures or videos that others recorded");
  command
      .option("inputs", options->inputs,
              "CAMERA=FOLDER or CAMERA=VIDEO, for each camera. Pictures of a folder (PNG, JPEG, what FFmpeg "
              "reads; 8 "
              "or 16 bits) are told apart by the last number of their names, equal numbers are one slot; "
              "some may be "
              "missing")
      .required();
  command.option("-o,--output", options->take, "The take to write, NAME.take; must not exist yet")
      .required()
      .ends_in({".take"});
  command.option("--rate", options->rate_hz, "Slots a second").shows_default().range(0.1, 10'000.0);
  command
      .option(
          "--grey", options->grey,
          "How the pictures are coded: srgb, as cameras for looking at give them, or linear, as many machine "
          "cameras do")
      .shows_default()
      .one_of({"srgb", "linear"});
  command
      .option("--program", options->program,
              "What the slots show, again and again: stripes or fringes for these programs, or a word for "
              "each slot: "
              "\"blank\" is even light, fringes:0 to fringes:3 are fringes, every other word is a pattern "
              "that never repeats")
      .shows_default();
  command
      .option("--start", options->start,
              "Which slot of the program, from 0, the first pictures show; default: told by the pictures")
      .range(0, 1000);
  command
      .option("--shift", options->shifts,
              "CAMERA=SLOTS: this camera's pictures are numbered so many slots late (negative: early)")
      .delimiter(',')
      .one_at_a_time();
  command.option("--rig", options->rig,
                 "Rig file that the cameras' names and pictures' sizes are held against");
  command.footer("Then: facet process NAME.take --rig RIG --program PROGRAM -o MESHES.take (docs/booth.md)");
  command.callback([options] { Import(*options).run(); });
}

}  // namespace facet::tools
