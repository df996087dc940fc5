// `facet report`: one page about a take, for people.

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <limits>
#include <map>
#include <memory>
#include <numbers>
#include <numeric>
#include <optional>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "maths/statistics.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "render/renderer.hpp"
#include "report/html_plot.hpp"
#include "report/sheet.hpp"
#include "report/take_evaluation.hpp"
#include "report/take_pictures.hpp"
#include "stream/base64.hpp"
#include "take/reader.hpp"
#include "take_stages.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
constexpr std::size_t kSheetRows = 4;
constexpr std::size_t kMostCurves = 12;  ///< expressions with a curve of their own
constexpr std::size_t kCurvesInAPlot = 6;
constexpr std::size_t kMostReasons = 12;
constexpr float kLeastRange = 0.02F;  ///< of a curve worth drawing

struct ReportOptions {
  std::string take;
  std::string output;
  std::string truth;
  std::string video;
};

/// What is drawn against time. NaN where a frame does not say.
struct Series {
  std::vector<double> at_s;  ///< [frames] since the first
  std::vector<mesh::TrackingState> states;
  std::vector<std::uint8_t> degraded;
  std::vector<float> reprojection_px;
  std::vector<float> photometric_rms;
  std::array<std::vector<float>, 3> head_deg;  ///< yaw, pitch, roll
  std::vector<float> head_away_mm;             ///< from the camera
  std::array<std::vector<float>, kStages.size()> stage_ms;
  std::vector<std::string> expression_names;
  std::vector<std::vector<float>> expressions;  ///< [expressions][frames]
  std::map<std::string, int> reasons;           ///< why frames were degraded, and how many
  std::size_t vertices = 0;
};

/// Yaw to the subject's left, pitch down and roll to the subject's left are positive, degrees; all 0 where
/// the head looks into the camera.
std::array<float, 3> head_angles_deg(const Eigen::Isometry3f& camera_from_head) {
  const Eigen::Matrix3f turned =
      Eigen::Vector3f(1, -1, -1).asDiagonal() * Eigen::Matrix3f(camera_from_head.linear());
  constexpr float kDegrees = 180 / std::numbers::pi_v<float>;
  return {kDegrees * std::atan2(turned(0, 2), turned(2, 2)),
          kDegrees * std::asin(std::clamp(-turned(1, 2), -1.0F, 1.0F)),
          kDegrees * std::atan2(-turned(1, 0), turned(1, 1))};
}

void add_frame(const mesh::MeshFrame& frame, double at_s, Series& series) {
  series.at_s.push_back(at_s);
  series.states.push_back(frame.state);
  series.degraded.push_back(frame.degraded ? 1 : 0);
  if (frame.degraded) {
    ++series.reasons[frame.degraded_reason];
  }
  const bool has_mesh = frame.state == mesh::TrackingState::Tracking && frame.subject != nullptr;
  const bool refined = has_mesh && !frame.displacements_mm.empty();
  series.reprojection_px.push_back(has_mesh && frame.reprojection_px > 0 ? frame.reprojection_px : kNone);
  series.photometric_rms.push_back(refined && frame.photometric_rms > 0 ? frame.photometric_rms : kNone);
  const std::array<float, 3> angles = head_angles_deg(frame.camera_from_head);
  for (std::size_t i = 0; i < angles.size(); ++i) {
    series.head_deg[i].push_back(has_mesh ? angles[i] : kNone);
  }
  series.head_away_mm.push_back(has_mesh ? frame.camera_from_head.translation().norm() : kNone);
  for (std::size_t s = 0; s < kStages.size(); ++s) {
    series.stage_ms[s].push_back(frame.stage_ms.*(kStages[s].time_ms));
  }
  if (has_mesh && series.expression_names.empty()) {
    series.expression_names = frame.subject->expression_names;
    series.expressions.assign(series.expression_names.size(),
                              std::vector<float>(series.at_s.size() - 1, kNone));
  }
  for (std::size_t e = 0; e < series.expressions.size(); ++e) {
    series.expressions[e].push_back(has_mesh && e < frame.expression.size() ? frame.expression[e] : kNone);
  }
  if (refined) {
    series.vertices = frame.displacements_mm.size();
  }
}

Series read_series(take::TakeReader& take) {
  Series series;
  const std::int64_t count = take.frame_count();
  Progress progress("Reading", static_cast<std::uint64_t>(count));
  // The source's own time: a recording may have been worked on faster or slower than it was made.
  const std::int64_t first_ns = count > 0 ? take.entry(0).media_time_ns : 0;
  for (std::int64_t i = 0; i < count; ++i) {
    const auto frame = take.frame(i, take::Pictures::Described);
    // A damaged take may say any time; the axis does not go back.
    const double at_s = 1e-9 * (static_cast<double>(frame->media_time_ns) - static_cast<double>(first_ns));
    add_frame(*frame, std::max(at_s, series.at_s.empty() ? 0 : series.at_s.back()), series);
    progress.advance();
  }
  return series;
}

float quantile(std::vector<float> values, double share) {
  std::erase_if(values, [](float value) { return !std::isfinite(value); });
  if (values.empty()) {
    return kNone;
  }
  return maths::quantile_of(values, share);
}

std::string picture_html(const render::Picture& picture, const std::string& caption) {
  return fmt::format(
      "<figure><img alt=\"{0}\" src=\"data:image/png;base64,{1}\"><figcaption>{0}</figcaption></figure>\n",
      report::html_text(caption), stream::base64(render::encode_png(picture)));
}

/// A bar of states over time, one rectangle for each run of frames of one state.
std::string states_html(const Series& series) {
  constexpr std::array kColours = {"var(--rule)", "var(--c5)", "var(--c2)", "var(--c1)"};
  const std::size_t count = series.states.size();
  std::string svg = fmt::format(
      "<figure><figcaption><h3>State</h3></figcaption>\n<svg class=\"plot\" viewBox=\"0 0 960 22\" "
      "role=\"img\" aria-label=\"State of every frame\">\n");
  const double span_s = count > 0 ? std::max(series.at_s.back(), 1e-9) : 1;
  const auto x_of = [&](std::size_t frame) {
    return 56 + (960 - 56 - 12) * (frame < count ? series.at_s[frame] / span_s : 1);
  };
  std::array<std::size_t, 4> frames{};
  for (std::size_t begin = 0; begin < count;) {
    std::size_t end = begin;
    while (end < count && series.states[end] == series.states[begin] &&
           series.degraded[end] == series.degraded[begin]) {
      ++end;
    }
    const auto state = static_cast<std::size_t>(series.states[begin]);
    frames.at(state) += end - begin;
    svg += fmt::format("<rect x=\"{:.1f}\" y=\"{}\" width=\"{:.2f}\" height=\"{}\" style=\"fill:{}\"/>\n",
                       x_of(begin), 2, std::max(x_of(end) - x_of(begin), 1.0), 14, kColours.at(state));
    if (series.degraded[begin] != 0) {
      svg += fmt::format(
          "<rect x=\"{:.1f}\" y=\"16\" width=\"{:.2f}\" height=\"5\" style=\"fill:var(--c3)\"/>\n",
          x_of(begin), std::max(x_of(end) - x_of(begin), 1.0));
    }
    begin = end;
  }
  svg += "</svg>\n<ul class=\"key\">\n";
  for (std::size_t state = 0; state < frames.size(); ++state) {
    svg += fmt::format("<li><i style=\"background:{}\"></i><b>{}</b> {} frames</li>\n", kColours.at(state),
                       mesh::to_string(static_cast<mesh::TrackingState>(state)), frames.at(state));
  }
  svg += fmt::format(
      "<li><i style=\"background:var(--c3)\"></i><b>degraded</b> {} frames</li>\n</ul></figure>\n",
      std::count(series.degraded.begin(), series.degraded.end(), std::uint8_t{1}));
  std::vector<std::pair<int, std::string>> reasons;
  for (const auto& [reason, times] : series.reasons) {
    reasons.emplace_back(times, reason);
  }
  std::sort(reasons.rbegin(), reasons.rend());
  for (std::size_t i = 0; i < std::min(reasons.size(), kMostReasons); ++i) {
    svg += fmt::format("<p class=\"reason\">degraded, {} frames: {}</p>\n", reasons[i].first,
                       report::html_text(reasons[i].second));
  }
  if (reasons.size() > kMostReasons) {
    svg += fmt::format("<p class=\"reason\">and {} other reasons</p>\n", reasons.size() - kMostReasons);
  }
  return svg;
}

std::string stages_html(const Series& series) {
  std::string table =
      "<table><thead><tr><th>stage</th><th>mean ms</th><th>median</th><th>95 %</th><th>greatest</th>"
      "<th>frames</th></tr></thead><tbody>\n";
  report::Plot plot;
  plot.title = "Time of each stage";
  plot.unit = "ms";
  plot.at = series.at_s;
  plot.stacked = true;
  report::Plot latency;
  latency.title = "Latency, frame to mesh";
  latency.unit = "ms";
  latency.at = series.at_s;
  for (std::size_t s = 0; s < kStages.size(); ++s) {
    std::vector<float> ran = series.stage_ms[s];
    std::erase_if(ran, [](float ms) { return !(ms > 0); });
    if (ran.empty()) {
      continue;
    }
    const double mean = std::accumulate(ran.begin(), ran.end(), 0.0) / static_cast<double>(ran.size());
    table += fmt::format(
        "<tr><td>{}</td><td>{:.2f}</td><td>{:.2f}</td><td>{:.2f}</td><td>{:.2f}</td><td>{}</td></tr>\n",
        kStages[s].name, mean, quantile(ran, 0.5), quantile(ran, 0.95), quantile(ran, 1), ran.size());
    const bool whole = kStages[s].time_ms == &mesh::StageTimes::latency_ms;
    (whole ? latency : plot).lines.push_back({kStages[s].name, series.stage_ms[s]});
  }
  table += "</tbody></table>\n";
  return (plot.lines.empty() ? std::string() : report::plot_svg(plot)) +
         (latency.lines.empty() ? std::string() : report::plot_svg(latency)) + table;
}

/// All expressions as rows of a picture: dark 0, bright 1.
render::Picture expression_map(const Series& series) {
  constexpr int kWidth = 900;
  constexpr int kNames = 170;
  constexpr int kRow = 14;
  const int rows = static_cast<int>(series.expressions.size());
  render::Picture picture = render::plain_picture(kNames + kWidth, kRow * rows, report::kPaper);
  for (int e = 0; e < rows; ++e) {
    const std::vector<float>& values = series.expressions[static_cast<std::size_t>(e)];
    render::draw_text(picture, 4, kRow * e + 1, series.expression_names[static_cast<std::size_t>(e)],
                      report::kInk, 1);
    for (int x = 0; x < kWidth; ++x) {
      // The greatest of the frames that share a column, so that blinks are seen.
      const std::size_t begin = values.size() * static_cast<std::size_t>(x) / kWidth;
      const std::size_t end = std::max(begin + 1, values.size() * static_cast<std::size_t>(x + 1) / kWidth);
      float value = kNone;
      for (std::size_t i = begin; i < std::min(end, values.size()); ++i) {
        value = std::isfinite(value) ? std::max(value, values[i]) : values[i];
      }
      if (std::isfinite(value)) {
        const auto colour = render::heat_colour(value);
        for (int y = 1; y < kRow - 1; ++y) {
          std::copy(colour.begin(), colour.end(),
                    picture.rgb.begin() + 3 * ((kRow * e + y) * picture.width_px + kNames + x));
        }
      }
    }
  }
  return picture;
}

std::string expressions_html(const Series& series) {
  std::vector<std::pair<float, std::size_t>> ranges;
  for (std::size_t e = 0; e < series.expressions.size(); ++e) {
    const float range = quantile(series.expressions[e], 0.99) - quantile(series.expressions[e], 0.01);
    if (range > kLeastRange) {
      ranges.emplace_back(range, e);
    }
  }
  std::sort(ranges.rbegin(), ranges.rend());
  ranges.resize(std::min(ranges.size(), kMostCurves));
  std::string html;
  for (std::size_t first = 0; first < ranges.size(); first += kCurvesInAPlot) {
    report::Plot plot;
    plot.title = first == 0 ? "Expressions that move most" : "... and the next";
    plot.at = series.at_s;
    plot.most = 1;
    for (std::size_t i = first; i < std::min(first + kCurvesInAPlot, ranges.size()); ++i) {
      const std::size_t e = ranges[i].second;
      plot.lines.push_back({series.expression_names[e], series.expressions[e]});
    }
    html += report::plot_svg(plot);
  }
  if (!series.expressions.empty() && series.expression_names.size() == series.expressions.size()) {
    html += picture_html(expression_map(series), "All expressions over time: dark is 0, bright is 1");
  }
  return html;
}

std::string truth_html(const report::TakeEvaluation& evaluation, const Series& series) {
  report::Plot distance;
  distance.title = "Distance to the truth, mean of each frame";
  distance.unit = "mm";
  report::Plot normals;
  normals.title = "Angle to the true normals, mean of each frame";
  normals.unit = "degrees";
  std::array<report::PlotLine, 2> distances = {report::PlotLine{"coarse", {}},
                                               report::PlotLine{"refined", {}}};
  std::array<report::PlotLine, 2> angles = distances;
  for (const report::FrameEvaluation& frame : evaluation.frames) {
    distance.at.push_back(series.at_s.at(static_cast<std::size_t>(frame.index)));
    distances[0].values.push_back(static_cast<float>(frame.coarse.mm));
    distances[1].values.push_back(static_cast<float>(frame.refined.mm));
    angles[0].values.push_back(static_cast<float>(frame.coarse.normal_deg));
    angles[1].values.push_back(static_cast<float>(frame.refined.normal_deg));
  }
  normals.at = distance.at;
  distance.lines.assign(distances.begin(), distances.end());
  normals.lines.assign(angles.begin(), angles.end());
  std::string html =
      "<h2>Against the truth</h2>\n<table><thead><tr><th></th><th>mean mm</th><th>standard deviation</th>"
      "<th>median</th><th>95 %</th><th>same skin point mm</th><th>drift mm</th><th>normals, degrees</th>"
      "<th>flicker mm</th></tr></thead><tbody>\n";
  const auto known = [](double mm) { return std::isfinite(mm) ? fmt::format("{:.3f}", mm) : "-"; };
  for (const auto& [name, mesh] :
       {std::pair<const char*, const report::MeshFigures&>("coarse", evaluation.by_frame.coarse),
        {"refined", evaluation.by_frame.refined}}) {
    const report::AccuracyFigures& figures = mesh.whole;
    html += fmt::format(
        "<tr><td>{}</td><td>{:.3f}</td><td>{:.3f}</td><td>{:.3f}</td><td>{:.3f}</td><td>{}</td><td>{}</td>"
        "<td>{:.2f}</td><td>{}</td></tr>\n",
        name, figures.mean_mm, figures.std_mm, figures.median_mm, figures.p95_mm, known(mesh.skin.mean_mm),
        known(mesh.skin.drift_mm()), figures.normal_error_deg, known(figures.flicker_mm));
  }
  html += fmt::format(
      "</tbody></table>\n<p>{} frames, {} with a truth but without a mesh; each mesh aligned by "
      "a similarity first (docs/evaluation.md).</p>\n",
      evaluation.frames.size(), evaluation.without_mesh);
  html += report::plot_svg(distance) + report::plot_svg(normals);
  return html + picture_html(evaluation.heat_map, "Distances and normal errors of four frames");
}

std::string row_html(const std::string& name, const std::string& value) {
  return fmt::format("<tr><th>{}</th><td>{}</td></tr>\n", report::html_text(name), report::html_text(value));
}

std::string head_html(const take::TakeReader& take, const Series& series) {
  const take::TakeInfo& info = take.info();
  const double seconds = series.at_s.empty() ? 0 : series.at_s.back();
  std::string html = "<table class=\"facts\"><tbody>\n";
  html += row_html("source", info.source);
  html += row_html("recorded", fmt::format("{} by {}{}", info.created_utc, info.software,
                                           info.closed ? "" : ", not closed"));
  html += row_html("frames",
                   fmt::format("{} in {:.2f} s, {} not recorded", take.frame_count(), seconds, info.dropped));
  if (series.vertices > 0) {
    html += row_html("finest mesh", fmt::format("{} vertices", series.vertices));
  }
  html +=
      row_html("size", fmt::format("{:.1f} MB, {:.1f} KB a frame", static_cast<double>(info.file_bytes) / 1e6,
                                   static_cast<double>(info.file_bytes) / 1e3 /
                                       static_cast<double>(std::max<std::int64_t>(1, take.frame_count()))));
  return html + "</tbody></table>\n";
}

report::Plot plot_of(const std::string& title, const std::string& unit, const Series& series, bool from_zero,
                     std::vector<report::PlotLine> lines) {
  report::Plot plot;
  plot.title = title;
  plot.unit = unit;
  plot.at = series.at_s;
  plot.from_zero = from_zero;
  plot.lines = std::move(lines);
  return plot;
}

bool any(const std::vector<float>& values) {
  return std::any_of(values.begin(), values.end(), [](float value) { return std::isfinite(value); });
}

constexpr const char* kPageStyle = R"(
:root{--paper:#fbfbf9;--ink:#1d2026;--faint:#5d6470;--rule:#dcdcd6}
@media(prefers-color-scheme:dark){:root{--paper:#14161a;--ink:#e2e4e8;--faint:#969aa2;--rule:#333842}}
body{font:15px/1.5 system-ui,sans-serif;background:var(--paper);color:var(--ink);margin:2em auto;max-width:1040px;padding:0 1em}
h1{font-size:1.5em;margin:0 0 .4em;overflow-wrap:anywhere}h2{font-size:1.2em;margin:1.8em 0 .4em;border-bottom:1px solid var(--rule)}
h3{font-size:1em;margin:.9em 0 0}figure{margin:0 0 .8em}img{max-width:100%;height:auto;border-radius:4px}
figcaption{color:var(--faint);font-size:.9em}figcaption h3{color:var(--ink)}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:.6em 0}
td,th{padding:.15em .9em .15em 0;text-align:right;border-bottom:1px solid var(--rule)}
td:first-child,th:first-child,.facts td{text-align:left;overflow-wrap:anywhere}
thead th{color:var(--faint);font-weight:500}.reason{color:var(--faint);margin:.2em 0}
)";

void run_report(const ReportOptions& options) {
  take::TakeReader take(options.take);
  // A page that can't be written is known now, not after the work.
  files::OutputFile page(options.output);
  const Series series = read_series(take);
  const std::string name = std::filesystem::path(options.take).filename().string();
  page.write(fmt::format(
      "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" "
      "content=\"width=device-width\"><title>{0}</title>\n<style>{1}{2}</style></head><body>\n<h1>{0}</h1>\n",
      report::html_text(name), kPageStyle, report::kPlotStyle));
  page.write(head_html(take, series));

  if (!options.truth.empty()) {
    std::optional<Progress> progress;
    const report::TakeEvaluation evaluation =
        report::evaluate_take(take, options.truth, {}, [&](std::uint64_t done, std::uint64_t total) {
          if (!progress) {
            progress.emplace("Measuring", total);
          }
          progress->set(done);
        });
    progress.reset();
    page.write(truth_html(evaluation, series));
  }

  page.write("<h2>Tracking</h2>\n");
  page.write(states_html(series));
  if (any(series.reprojection_px)) {
    page.write(report::plot_svg(plot_of("Landmarks, median distance of the model's to the measured ones",
                                        "px", series, true, {{"reprojection", series.reprojection_px}})));
  }
  if (any(series.photometric_rms)) {
    page.write(
        report::plot_svg(plot_of("Photometric error, rms of picture minus rendering", "of linear white",
                                 series, true, {{"photometric", series.photometric_rms}})));
  }
  if (any(series.head_away_mm)) {
    page.write(report::plot_svg(
        plot_of("Head, turned to the subject's left, down, tilted to the left", "degrees", series, true,
                {{"yaw", series.head_deg[0]}, {"pitch", series.head_deg[1]}, {"roll", series.head_deg[2]}})));
    page.write(report::plot_svg(
        plot_of("Head, distance from the camera", "mm", series, false, {{"distance", series.head_away_mm}})));
  }
  page.write("<h2>Expressions</h2>\n");
  page.write(expressions_html(series));
  page.write("<h2>Time</h2>\n");
  page.write(stages_html(series));

  std::vector<std::int64_t> with_mesh;
  for (std::int64_t i = 0; i < take.frame_count(); ++i) {
    if (take.entry(i).has_mesh) {
      with_mesh.push_back(i);
    }
  }
  if (!with_mesh.empty()) {
    const auto images = report::open_source_images(take.info(), options.video);
    const auto frames = report::spread_evenly(with_mesh, kSheetRows);
    Progress progress("Drawing", frames.size(), "rows");
    const render::Picture sheet = report::make_sheet(
        take, frames, images.get(), [&](int rows) { progress.set(static_cast<std::uint64_t>(rows)); });
    progress.finish();
    page.write("<h2>Pictures</h2>\n");
    page.write(picture_html(sheet, "Picture, coarse mesh, normals, shaded mesh, albedo, photometric error"));
  }
  page.write("</body></html>\n");
  page.commit();
  tell("{}: {} frames of {}\n", options.output, take.frame_count(), options.take);
}

}  // namespace

void add_report_command(Command app) {
  auto options = std::make_shared<ReportOptions>();
  const Command command = app.subcommand(
      "report",
      "One page about a take: states, errors, expressions, times and pictures (HTML, nothing outside it)");
  command.option("take", options->take, "The take").required();
  command.option("-o,--output", options->output, "HTML to write").required();
  command.option("--truth", options->truth,
                 "Folder that `facet synth` wrote: errors against the truth over time, and a heat map");
  command.option("--video", options->video, "The video that the take was made from, where it has moved");
  command.callback([options] { run_report(*options); });
}

}  // namespace facet::tools
