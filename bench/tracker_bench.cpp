// Measures the tracker on video clips: how many face frames get a mesh, how well it lies on the landmarks,
// what a frame costs on one core, how quiet it is; and writes contact sheets of the coarse wire over the
// frames.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <memory>
#include <numeric>
#include <optional>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "maths/statistics.hpp"
#include "render/renderer.hpp"
#include "track/tracker.hpp"

namespace {

using facet::Frame;
using facet::track::Tracker;
using facet::track::TrackResult;

struct Options {
  std::filesystem::path model = facet::default_model_file();
  std::filesystem::path assets = facet::default_landmark_nets();
  std::vector<std::filesystem::path> clips;
  std::filesystem::path sheet_folder;
  int sheet_tiles = 12;
  bool single_pass = false;
  bool absences = false;
};

/// Processor time of the calling thread, ms: all of the tracker's work runs there, and other programs don't
/// count.
double thread_ms() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

double quantile(std::vector<double> values, double q) {
  if (values.empty()) {
    return 0;
  }
  const double place = q * static_cast<double>(values.size() - 1);
  return facet::maths::nth_of(values, static_cast<std::size_t>(place));
}

double mean(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) {
    sum += value;
  }
  return values.empty() ? 0 : sum / static_cast<double>(values.size());
}

/// Control mesh edges over the frame, cut to the face: near edges light, landmarks as dots.
facet::render::Picture draw(const Frame& frame, const TrackResult& result,
                            const facet::face::FaceModel& model) {
  facet::render::Picture picture = facet::render::to_picture(frame);
  const auto project = [&](const Eigen::Vector3f& head_mm) {
    const Eigen::Vector3f p = result.camera_from_head * head_mm;
    return Eigen::Vector2f(result.camera.fx * p.x() / p.z() + result.camera.cx,
                           result.camera.fy * p.y() / p.z() + result.camera.cy);
  };
  Eigen::Vector2f middle(0.5F * static_cast<float>(frame.width_px),
                         0.5F * static_cast<float>(frame.height_px));
  float half = 0.5F * static_cast<float>(std::min(frame.width_px, frame.height_px));
  if (result.has_mesh) {
    const auto& quads = model.control.quads;
    for (Eigen::Index q = 0; q < quads.cols(); ++q) {
      const std::uint8_t region = model.regions[static_cast<std::size_t>(quads(0, q))];
      if (!facet::face::has_region(region, facet::face::Region::Refinable) &&
          !facet::face::has_region(region, facet::face::Region::Lips)) {
        continue;
      }
      Eigen::Vector3f corners[4];
      for (int c = 0; c < 4; ++c) {
        corners[c] = result.vertices_mm.col(quads(c, q));
      }
      const Eigen::Vector3f normal = (corners[2] - corners[0]).cross(corners[3] - corners[1]);
      const Eigen::Vector3f seen = result.camera_from_head * corners[0];
      if ((result.camera_from_head.linear() * normal).dot(seen) >= 0) {
        continue;
      }
      for (int c = 0; c < 4; ++c) {
        facet::render::draw_line(picture, project(corners[c]), project(corners[(c + 1) % 4]), {60, 255, 140},
                                 0.22F);
      }
    }
    const Eigen::Vector3f centre = result.camera_from_head.translation();
    middle = project(Eigen::Vector3f::Zero());
    half = 150.0F * result.camera.fx / centre.z();
  }
  const float dot_radius = half / 250.0F;
  for (const Eigen::Vector2f& point : result.landmarks_px) {
    facet::render::draw_dot(picture, point, dot_radius, {255, 60, 40});
  }
  const int side = static_cast<int>(2 * half);
  return facet::render::crop(picture, static_cast<int>(middle.x() - half),
                             static_cast<int>(middle.y() - half), side, side);
}

/// Nearest-neighbour copy into a square of `side_px`.
facet::render::Picture fit_square(const facet::render::Picture& from, int side_px) {
  facet::render::Picture to = facet::render::plain_picture(side_px, side_px, {0, 0, 0});
  for (int y = 0; y < side_px; ++y) {
    for (int x = 0; x < side_px; ++x) {
      const auto source = static_cast<std::size_t>((y * from.height_px / side_px) * from.width_px +
                                                   x * from.width_px / side_px) *
                          3;
      const auto target = static_cast<std::size_t>(y * side_px + x) * 3;
      std::copy_n(from.rgb.begin() + static_cast<std::ptrdiff_t>(source), 3,
                  to.rgb.begin() + static_cast<std::ptrdiff_t>(target));
    }
  }
  return to;
}

/// The largest expression weights as bars with their names, in the lower left corner.
void draw_weights(facet::render::Picture& picture, const TrackResult& result,
                  const facet::face::FaceModel& model) {
  constexpr std::size_t kShown = 12;
  constexpr int kRowPx = 15;
  constexpr int kBarPx = 90;
  constexpr float kLeastShown = 0.03F;
  std::vector<std::size_t> order(result.expression.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(),
            [&](std::size_t a, std::size_t b) { return result.expression[a] > result.expression[b]; });
  int y = picture.height_px - static_cast<int>(kShown) * kRowPx;
  for (std::size_t i = 0; i < std::min(kShown, order.size()); ++i, y += kRowPx) {
    const float weight = result.expression[order[i]];
    if (weight < kLeastShown) {
      break;
    }
    const auto length = static_cast<float>(kBarPx) * weight;
    for (int row = 3; row < kRowPx - 3; ++row) {
      const auto at = static_cast<float>(y + row);
      facet::render::draw_line(picture, {2.0F, at}, {2.0F + length, at}, {90, 170, 255}, 0.9F);
    }
    facet::render::draw_text(picture, kBarPx + 6, y, model.expression_names[order[i]], {255, 255, 255});
  }
}

struct ClipFigures {
  int frames = 0;
  int face_frames = 0;
  int mesh_frames = 0;
  int tracking_frames = 0;
  int broken_frames = 0;  ///< a vertex that is not finite or further than 2 m from the head's origin
  std::uint32_t subjects = 0;
  double focal_px = 0;
  int width_px = 0;
  int height_px = 0;
  std::vector<double> reprojection;                     ///< fraction of the interocular distance
  std::vector<double> detect_ms, landmarks_ms, fit_ms;  ///< wall clock
  std::vector<double> processor_ms;                     ///< of the whole tracker
  std::vector<double> flicker_mm;  ///< mean |second difference| of the vertices in the head frame
};

class ClipRun {
 public:
  ClipRun(const facet::face::FaceModel& model, const Options& options, const std::filesystem::path& clip)
      : model_(model), options_(options), clip_(clip) {}

  /// The subject of the clip from a first pass; nothing when none was acquired.
  std::optional<facet::track::Person> first_pass() {
    Tracker tracker(model_, {.landmark_nets = options_.assets, .intrinsics = {}});
    auto camera = facet::camera::open_camera({.kind = "file", .path = clip_});
    camera->start();
    Frame frame;
    while (camera->next(frame, std::chrono::seconds(10)) == facet::CaptureOutcome::Delivered) {
      ++acquisition_frames_;
      if (tracker.process(frame).state == facet::mesh::TrackingState::Tracking) {
        width_px_ = frame.width_px;
        height_px_ = frame.height_px;
        return tracker.person();
      }
    }
    return std::nullopt;
  }

  ClipFigures measure(const std::optional<facet::track::Person>& subject) {
    Tracker tracker(model_, {.landmark_nets = options_.assets, .intrinsics = {}});
    if (subject) {
      tracker.adopt(*subject, width_px_, height_px_);
    }
    auto camera = facet::camera::open_camera({.kind = "file", .path = clip_});
    camera->start();
    const auto expected = static_cast<int>(camera->info().frame_count.value_or(1));
    const int every = std::max(1, expected / options_.sheet_tiles);
    Frame frame;
    while (camera->next(frame, std::chrono::seconds(10)) == facet::CaptureOutcome::Delivered) {
      const double before_ms = thread_ms();
      const TrackResult& result = tracker.process(frame);
      figures_.processor_ms.push_back(thread_ms() - before_ms);
      add(result);
      if (!options_.sheet_folder.empty() && figures_.frames % every == 1 % every) {
        tiles_.push_back(fit_square(draw(frame, result, model_), kTilePx));
        if (result.has_mesh) {
          draw_weights(tiles_.back(), result, model_);
        }
      }
      figures_.width_px = frame.width_px;
      figures_.height_px = frame.height_px;
    }
    write_sheet();
    return figures_;
  }

  int acquisition_frames() const { return acquisition_frames_; }

 private:
  static constexpr int kTilePx = 480;

  void add(const TrackResult& result) {
    ++figures_.frames;
    figures_.face_frames += result.landmarks_px.empty() ? 0 : 1;
    figures_.tracking_frames += result.state == facet::mesh::TrackingState::Tracking ? 1 : 0;
    figures_.detect_ms.push_back(static_cast<double>(result.detect_ms));
    figures_.landmarks_ms.push_back(static_cast<double>(result.landmarks_ms));
    figures_.fit_ms.push_back(static_cast<double>(result.fit_ms));
    if (!result.has_mesh) {
      history_ = 0;
      return;
    }
    ++figures_.mesh_frames;
    figures_.subjects = result.subject;
    figures_.focal_px = static_cast<double>(result.camera.fx);
    figures_.reprojection.push_back(static_cast<double>(result.reprojection_px / result.interocular_px));
    const auto& vertices = result.vertices_mm;
    if (!vertices.allFinite() || vertices.cwiseAbs().maxCoeff() > 2000.0F ||
        !result.camera_from_head.matrix().allFinite()) {
      ++figures_.broken_frames;
    }
    if (history_ >= 2) {
      figures_.flicker_mm.push_back(
          static_cast<double>((vertices - 2 * last_ + before_last_).colwise().norm().mean()));
    }
    before_last_ = last_;
    last_ = vertices;
    ++history_;
  }

  void write_sheet() const {
    if (tiles_.empty()) {
      return;
    }
    constexpr int kColumns = 4;
    const int rows = (static_cast<int>(tiles_.size()) + kColumns - 1) / kColumns;
    auto sheet = facet::render::plain_picture(kColumns * kTilePx, rows * kTilePx, {0, 0, 0});
    for (std::size_t i = 0; i < tiles_.size(); ++i) {
      const int at = static_cast<int>(i);
      facet::render::paste(sheet, tiles_[i], (at % kColumns) * kTilePx, (at / kColumns) * kTilePx);
    }
    facet::render::write_png(sheet, options_.sheet_folder / (clip_.stem().string() + ".png"));
  }

  const facet::face::FaceModel& model_;
  const Options& options_;
  std::filesystem::path clip_;
  ClipFigures figures_;
  std::vector<facet::render::Picture> tiles_;
  facet::mesh::Vertices last_, before_last_;
  int history_ = 0;
  int acquisition_frames_ = 0;
  int width_px_ = 0;
  int height_px_ = 0;
};

/// From the picture in which a face is there (again) to the first mesh of it, ms of the clip's time; the
/// picture's own interval counts, since it is exposed before it is seen.
struct Absences {
  std::vector<double> appeared_ms;  ///< to a tracker that knows nobody
  std::vector<double> returned_ms;  ///< to the tracker that followed it before
  int never = 0;                    ///< no mesh before the next absence
};

/// The clip with stretches of even grey in it, shorter and longer than the second for which a lost face is
/// waited for.
Absences measure_absences(const facet::face::FaceModel& model, const Options& options,
                          const std::filesystem::path& clip, bool known) {
  constexpr int kPeriod = 100;
  constexpr std::array<int, 2> kAway{12, 45};
  constexpr std::uint8_t kGrey = 96;
  Absences out;
  std::optional<Tracker> tracker;
  const auto renew = [&] {
    tracker.emplace(model, facet::track::TrackerConfig{.landmark_nets = options.assets, .intrinsics = {}});
  };
  renew();
  auto camera = facet::camera::open_camera({.kind = "file", .path = clip});
  camera->start();
  const double rate_hz = camera->info().rate_hz;
  const double interval_ms = 1e3 / (rate_hz > 0 ? rate_hz : 30);
  Frame frame;
  int waited = -1;  // pictures with the face since it is there; -1: it has its mesh
  for (int f = 0; camera->next(frame, std::chrono::seconds(10)) == facet::CaptureOutcome::Delivered; ++f) {
    // With a first stretch of the face, in which it becomes known.
    const int period = f / kPeriod;
    const int away = kAway[static_cast<std::size_t>(period) % kAway.size()];
    if (f % kPeriod < away && (period > 0 || !known)) {
      if (f % kPeriod == 0) {
        out.never += waited >= 0 ? 1 : 0;
        if (!known) {
          renew();
        }
      }
      auto grey =
          std::make_shared<std::uint8_t[]>(frame.stride_bytes * static_cast<std::size_t>(frame.height_px));
      std::fill_n(grey.get(), frame.stride_bytes * static_cast<std::size_t>(frame.height_px), kGrey);
      frame.pixels = grey;
      tracker->process(frame);
      waited = 0;
      continue;
    }
    const bool has_mesh = tracker->process(frame).has_mesh;
    if (waited >= 0) {
      ++waited;
      if (has_mesh) {
        (known ? out.returned_ms : out.appeared_ms).push_back(interval_ms * waited);
        waited = -1;
      }
    }
  }
  return out;
}

void print_absences(const facet::face::FaceModel& model, const Options& options) {
  fmt::print("\nFirst mesh of a face, ms: median, worst (times)\n{:28} {:>22} {:>22} {:>6}\n", "clip",
             "nobody known", "known, back", "never");
  for (const auto& clip : options.clips) {
    const Absences unknown = measure_absences(model, options, clip, false);
    const Absences known = measure_absences(model, options, clip, true);
    const auto shown = [](const std::vector<double>& ms) {
      return fmt::format("{:.0f}, {:.0f} ({})", quantile(ms, 0.5), quantile(ms, 1), ms.size());
    };
    fmt::print("{:28} {:>22} {:>22} {:6}\n", clip.stem().string(), shown(unknown.appeared_ms),
               shown(known.returned_ms), unknown.never + known.never);
  }
}

void print(const std::string& name, const ClipFigures& figures, int acquisition_frames) {
  const double longer = std::max(figures.width_px, figures.height_px);
  fmt::print(
      "{:28} {:6} {:6} {:7.2f} {:5} {:7.2f} {:7.2f} {:7} {:6.2f} {:7.3f} | {:6.2f} {:6.2f} {:6.2f} {:6.2f} "
      "{:6.2f}\n",
      name, figures.frames, figures.face_frames,
      100.0 * figures.mesh_frames / std::max(figures.face_frames, 1), figures.broken_frames,
      100.0 * quantile(figures.reprojection, 0.5), 100.0 * quantile(figures.reprojection, 0.95),
      acquisition_frames, figures.focal_px / longer, mean(figures.flicker_mm), mean(figures.detect_ms),
      mean(figures.landmarks_ms), mean(figures.fit_ms), mean(figures.processor_ms),
      quantile(figures.processor_ms, 0.95));
}

int run(const Options& options) {
  const auto model = facet::face::FaceModel::load(options.model);
  fmt::print("{:28} {:>6} {:>6} {:>7} {:>5} {:>7} {:>7} {:>7} {:>6} {:>7} | {:>6} {:>6} {:>6} {:>6} {:>6}\n",
             "clip", "frames", "faces", "mesh %", "bad", "rep %", "p95 %", "acquire", "f/side", "flicker",
             "detect", "landm", "fit", "cpu", "p95 ms");
  for (const auto& clip : options.clips) {
    ClipRun run(model, options, clip);
    std::optional<facet::track::Person> subject;
    if (!options.single_pass) {
      subject = run.first_pass();
    }
    print(clip.stem().string(), run.measure(subject), run.acquisition_frames());
  }
  if (options.absences) {
    print_absences(model, options);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("Measures the tracker on video clips");
  app.add_option("--model", options.model, "face model")->capture_default_str();
  app.add_option("--landmark-nets", options.assets, "MediaPipe's packed nets")->capture_default_str();
  app.add_option("--sheets", options.sheet_folder, "folder for contact sheets of the wire over the frames");
  app.add_flag("--single-pass", options.single_pass, "as live: acquire while measuring");
  app.add_flag("--absences", options.absences, "also: how soon a face that appears or returns has a mesh");
  app.add_option("clips", options.clips, "videos")->required();
  CLI11_PARSE(app, argc, argv);
  try {
    return run(options);
  } catch (const facet::Error& error) {
    fmt::print(stderr, "{}\n", error.what());
    return static_cast<int>(error.kind());
  }
}
