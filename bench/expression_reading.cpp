// Learns how a face's values are read off its landmarks (track::ExpressionReading) from strangers whose
// values are known, and says how well: every actor judged by what was learned from the others. Ridge of x,
// the landmarks' movements and the fit's weights, on the true values w gives D and, from what is left, S;
// recorded people's values give C, how values go together.

#include <fmt/format.h>
#include <fmt/ostream.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "face/face_model.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "landmark/landmark_layout.hpp"
#include "maths/statistics.hpp"
#include "report/tracking_figures.hpp"
#include "report/truth_folder.hpp"
#include "simulation/recorded_curves.hpp"
#include "track/expression_reader.hpp"
#include "track/landmark_model.hpp"
#include "track/tracker.hpp"

namespace facet::bench {
namespace {

using Rows = Eigen::MatrixXd;

/// What was chosen, on the recorded clips of the tuning set (docs/decisions/expressions.md).
struct Choice {
  double alone = 0.3;           ///< part of S that is each number's own
  double measured_mm2 = 0.02;   ///< variance of any number, mm^2
  double ridge = 0.5;           ///< of D, frames
  double independent = 1e-3;    ///< of C, square of a value
  double sideways = 1e-2;       ///< least of C for mouths and jaws to a side, square of a value
  double seconds_of_life = 20;  ///< of each recording, from its start on; the check set has later ones
  double at_rest = 0.2;         ///< quantile that a recorded value rests at
  float rare = 2;               ///< track::ExpressionReading::rare
};

struct Actor {
  std::string name;
  std::vector<std::map<std::string, float>> truth;  ///< [frame]
  Rows movements_mm;                                ///< [frame][2 landmark model count]
  Rows weights;                                     ///< [frame][names] fitted
  Rows values;                                      ///< [frame][names] true
};

class Trainer {
 public:
  explicit Trainer(const std::filesystem::path& model_file)
      : model_(face::FaceModel::load(model_file)), landmarks_(model_), names_(model_.expression_names) {
    choose_landmarks();
    find_mirrors();
  }

  Actor watch(const std::filesystem::path& folder) const {
    const auto camera = camera::open_camera({.kind = "file", .path = folder / "video.mkv"});
    camera->start();
    std::vector<Frame> frames;
    for (Frame frame; camera->next(frame, std::chrono::seconds(10)) == CaptureOutcome::Delivered;) {
      frames.push_back(frame);
    }
    track::TrackerConfig config;
    config.landmark_nets = default_landmark_nets();
    track::Tracker first(model_, config);
    for (std::size_t f = 0; f < frames.size() && !first.person(); ++f) {
      first.process(frames[f]);
    }
    first.settle_subject();
    if (!first.person()) {
      throw Error(ErrorKind::NoFace, fmt::format("{}: no face", folder.string()));
    }
    track::Tracker tracker(model_, config);
    tracker.adopt(*first.person(), frames.front().width_px, frames.front().height_px);
    const report::TruthFolder truth(folder, 1);
    Actor actor{folder.filename().string(), {}, {}, {}, {}};
    std::vector<std::vector<float>> fitted;
    std::vector<Eigen::RowVectorXd> movements;
    for (const Frame& frame : frames) {
      const track::TrackResult& result = tracker.process(frame);
      const report::TruthNotes* notes = truth.notes(frame.sequence);
      if (!result.has_mesh || notes == nullptr || notes->expression.empty()) {
        continue;
      }
      actor.truth.push_back(notes->expression);
      fitted.push_back(result.expression);
      movements.emplace_back(
          Eigen::Map<const Eigen::RowVectorXf>(result.movements.mm.data(), result.movements.mm.size())
              .cast<double>());
    }
    const auto count = static_cast<Eigen::Index>(movements.size());
    actor.movements_mm.resize(count, Eigen::Index{2} * landmarks_.count());
    actor.values.resize(count, static_cast<Eigen::Index>(names_.size()));
    actor.weights.resize(count, static_cast<Eigen::Index>(names_.size()));
    for (Eigen::Index f = 0; f < count; ++f) {
      actor.movements_mm.row(f) = movements[static_cast<std::size_t>(f)];
      for (std::size_t n = 0; n < names_.size(); ++n) {
        const auto& values = actor.truth[static_cast<std::size_t>(f)];
        const auto found = values.find(names_[n]);
        actor.values(f, static_cast<Eigen::Index>(n)) = found != values.end() ? found->second : 0;
        actor.weights(f, static_cast<Eigen::Index>(n)) = fitted[static_cast<std::size_t>(f)][n];
      }
    }
    return actor;
  }

  /// C: how far recorded people's values go from where they rest, and together, either side alike.
  void hear(const std::vector<std::filesystem::path>& recordings, const std::string& but) {
    const auto count = static_cast<Eigen::Index>(names_.size());
    prior_ = choice_.independent * Rows::Identity(count, count);
    std::vector<Rows> heard;
    for (const std::filesystem::path& file : recordings) {
      if (but.empty() || file.filename().string().find(but) == std::string::npos) {
        heard.push_back(moments(simulation::RecordedCurves::read(file)));
      }
    }
    if (heard.empty() || (!but.empty() && heard.size() == recordings.size())) {
      throw Error(ErrorKind::Usage, fmt::format("of the recordings '{}' leaves out none, or all", but));
    }
    for (const Rows& moment : heard) {
      for (Eigen::Index a = 0; a < count; ++a) {
        for (Eigen::Index b = 0; b < count; ++b) {
          prior_(a, b) += (moment(a, b) + moment(name_twin_[as_size(a)], name_twin_[as_size(b)])) /
                          (2.0 * as_double(heard));
        }
      }
    }
    // People do it when asked to; the recordings, made of talk, have hardly any of it.
    for (const char* name : {"mouthLeft", "mouthRight", "jawLeft", "jawRight"}) {
      const auto found = std::find(names_.begin(), names_.end(), name);
      if (found != names_.end()) {
        double& variance = prior_(found - names_.begin(), found - names_.begin());
        variance = std::max(variance, choice_.sideways);
      }
    }
  }

  track::ExpressionReading learn(const std::vector<const Actor*>& actors) const {
    const auto names = static_cast<Eigen::Index>(names_.size());
    const auto columns = static_cast<Eigen::Index>(2 * chosen_.size()) + names;
    std::vector<std::pair<Rows, Rows>> sets;  // x and values, both without the set's mean
    Rows matrix = choice_.ridge * Rows::Identity(names, names);
    Rows right = Rows::Zero(names, columns);
    double frames = 0;
    for (const Actor* actor : actors) {
      for (const bool mirrored : {false, true}) {
        Rows seen = seen_of(*actor, mirrored);
        Rows values = actor->values;
        if (mirrored) {
          values = actor->values(Eigen::all, name_twin_);
        }
        seen.rowwise() -= seen.colwise().mean().eval();
        values.rowwise() -= values.colwise().mean().eval();
        matrix += values.transpose() * values;
        right += values.transpose() * seen;
        frames += static_cast<double>(values.rows());
        sets.emplace_back(std::move(seen), std::move(values));
      }
    }
    const Rows response = matrix.llt().solve(right);
    Rows noise = Rows::Zero(columns, columns);
    for (const auto& [seen, values] : sets) {
      const Rows left = seen - values * response;
      noise += left.transpose() * left / frames;
    }
    const Eigen::VectorXd own = noise.diagonal();
    noise *= 1 - choice_.alone;
    noise.diagonal() += choice_.alone * own;
    noise.diagonal().array() += choice_.measured_mm2;
    const Rows evidence = noise.llt().solve(response.transpose()).transpose();
    const Rows certainty = prior_.inverse() + evidence * response.transpose();
    track::ExpressionReading reading{names_,       {}, evidence.cast<float>(), certainty.cast<float>(),
                                     choice_.rare, {}};
    for (const int l : chosen_) {
      reading.landmarks.push_back(landmarks_.landmarks()[static_cast<std::size_t>(l)]);
    }
    return reading;
  }

  /// What the product makes of an actor's frames.
  Rows read(const track::ExpressionReading& reading, const Actor& actor) const {
    track::ExpressionReader reader(landmarks_, names_, reading);
    Rows out = actor.weights;
    std::vector<float> values(names_.size());
    std::vector<float> ignored;
    track::LandmarkMovements moved;
    moved.seen.setOnes(landmarks_.count());
    for (Eigen::Index f = 0; f < out.rows(); ++f) {
      const Eigen::RowVectorXf movements = actor.movements_mm.row(f).cast<float>();
      Eigen::Map<Eigen::RowVectorXf>(values.data(), out.cols()) = actor.weights.row(f).cast<float>();
      moved.mm = Eigen::Map<const Eigen::Matrix2Xf>(movements.data(), 2, landmarks_.count());
      reader.read(moved, values, ignored);
      out.row(f) = Eigen::Map<Eigen::RowVectorXf>(values.data(), out.cols()).cast<double>();
    }
    return out;
  }

  const std::vector<std::string>& names() const { return names_; }
  /// The name of the other side, or the same.
  std::size_t twin_of(std::size_t name) const { return static_cast<std::size_t>(name_twin_[name]); }

  void write(const track::ExpressionReading& reading, const std::filesystem::path& file) const {
    std::ofstream out(file);
    fmt::print(out,
               "// Written by bench/expression-reading for track::ExpressionReader: one file, because it is "
               "one table.\n");
    fmt::print(out, "// clang-format off\nconstexpr float kRare = {:#.6g}F;\n", reading.rare);
    fmt::print(out, "constexpr std::array<int, {}> kLandmarks = {{{}}};\n", reading.landmarks.size(),
               fmt::join(reading.landmarks, ","));
    write_table(out, "Evidence", reading.evidence);
    write_table(out, "Certainty", reading.certainty);
    fmt::print(out, "constexpr std::array<float, {}> kTold = {{{:.3f}F}};\n", names_.size(),
               fmt::join(reading.told, "F,"));
    fmt::print(out, "// clang-format on\n");
    if (!out.flush()) {
      throw Error(ErrorKind::Storage, fmt::format("cannot write {}", file.string()));
    }
  }

 private:
  void write_table(std::ostream& out, const char* what,
                   const track::ExpressionReading::Numbers& numbers) const {
    constexpr float kLargest = 9999;
    const Eigen::VectorXf steps = numbers.rowwise().lpNorm<Eigen::Infinity>() / kLargest;
    fmt::print(out, "constexpr std::array<Row, {}> k{}Rows = {{{{\n", names_.size(), what);
    for (std::size_t n = 0; n < names_.size(); ++n) {
      fmt::print(out, "{{\"{}\", {:#.6g}F}},\n", names_[n], steps[static_cast<Eigen::Index>(n)]);
    }
    fmt::print(out, "}}}};\nconstexpr std::array<std::int16_t, {}> k{} = {{", numbers.size(), what);
    for (Eigen::Index n = 0; n < numbers.rows(); ++n) {
      for (Eigen::Index c = 0; c < numbers.cols(); ++c) {
        fmt::print(out, "{}{},", c % 24 == 0 ? "\n" : "", std::lround(numbers(n, c) / steps[n]));
      }
    }
    fmt::print(out, "\n}};\n");
  }
  static std::size_t as_size(Eigen::Index i) { return static_cast<std::size_t>(i); }
  static double as_double(const std::vector<Rows>& list) { return static_cast<double>(list.size()); }

  /// Lips, lids, brows, nose, irises, and every fourth point of the skin: as good as all of them. The outline
  /// slides on the skin.
  void choose_landmarks() {
    const auto& groups = landmark::landmark_groups();
    int skin = 0;
    for (int l = 0; l < landmarks_.count(); ++l) {
      const int landmark = landmarks_.landmarks()[static_cast<std::size_t>(l)];
      const auto group = landmark < landmark::landmark_count ? groups[static_cast<std::size_t>(landmark)]
                                                             : landmark::LandmarkGroup::Eye;
      if (group == landmark::LandmarkGroup::Contour ||
          (group == landmark::LandmarkGroup::Skin && skin++ % 4 != 0)) {
        continue;
      }
      chosen_.push_back(l);
    }
  }

  void find_mirrors() {
    track::LandmarkBasis basis;
    landmarks_.contract_identity(Eigen::VectorXd::Zero(landmarks_.identity_count()), basis);
    const Eigen::Map<const Eigen::Matrix3Xd> places(basis.neutral_mm.data(), 3, landmarks_.count());
    for (Eigen::Index l = 0; l < places.cols(); ++l) {
      const Eigen::Vector3d other(-places(0, l), places(1, l), places(2, l));
      Eigen::Index nearest = 0;
      (places.colwise() - other).colwise().squaredNorm().minCoeff(&nearest);
      landmark_twin_.push_back(nearest);
    }
    for (const std::string& name : names_) {
      std::string other = name;
      for (const auto& [from, to] : {std::pair{"Left", "Right"}, {"Right", "Left"}}) {
        if (name.ends_with(from)) {
          other = name.substr(0, name.size() - std::string(from).size()) + to;
        }
      }
      name_twin_.push_back(std::find(names_.begin(), names_.end(), other) - names_.begin());
    }
  }

  Rows moments(const simulation::RecordedCurves& curves) const {
    constexpr double kRate_hz = 30;
    const auto frames = static_cast<Eigen::Index>(choice_.seconds_of_life * kRate_hz);
    Rows values(frames, static_cast<Eigen::Index>(names_.size()));
    for (Eigen::Index f = 0; f < frames; ++f) {
      const mesh::ArkitValues all = curves.values(static_cast<double>(f) / kRate_hz);
      for (std::size_t n = 0; n < names_.size(); ++n) {
        const int index = mesh::arkit_index(names_[n]);
        values(f, static_cast<Eigen::Index>(n)) = index >= 0 ? all.at(static_cast<std::size_t>(index)) : 0;
      }
    }
    for (auto column : values.colwise()) {
      const double rest =
          maths::quantile_of(std::vector<double>(column.begin(), column.end()), choice_.at_rest);
      column = (column.array() - rest).max(0).matrix();
    }
    return values.transpose() * values / static_cast<double>(frames);
  }

  /// x of every frame; mirrored: of the landmarks and weights at the other side, left for right.
  Rows seen_of(const Actor& actor, bool mirrored) const {
    const Rows& movements_mm = actor.movements_mm;
    Rows out(movements_mm.rows(), static_cast<Eigen::Index>(2 * chosen_.size()) + actor.weights.cols());
    for (std::size_t k = 0; k < chosen_.size(); ++k) {
      const Eigen::Index from = mirrored ? landmark_twin_[static_cast<std::size_t>(chosen_[k])] : chosen_[k];
      out.col(static_cast<Eigen::Index>(2 * k)) = (mirrored ? -1 : 1) * movements_mm.col(2 * from);
      out.col(static_cast<Eigen::Index>(2 * k) + 1) = movements_mm.col(2 * from + 1);
    }
    if (mirrored) {
      out.rightCols(actor.weights.cols()) = track::kFittedMm * actor.weights(Eigen::all, name_twin_);
    } else {
      out.rightCols(actor.weights.cols()) = track::kFittedMm * actor.weights;
    }
    return out;
  }

  Choice choice_;
  face::FaceModel model_;
  track::LandmarkModel landmarks_;
  std::vector<std::string> names_;
  std::vector<int> chosen_;                  ///< in landmarks_
  std::vector<Eigen::Index> landmark_twin_;  ///< [landmarks_.count()]
  std::vector<Eigen::Index> name_twin_;      ///< [names]
  Rows prior_;
};

std::map<std::string, report::WeightFigures> figures_of(const Trainer& trainer, const Actor& actor,
                                                        const Rows& values) {
  report::ExpressionSum sum;
  for (Eigen::Index f = 0; f < values.rows(); ++f) {
    const Eigen::VectorXf row = values.row(f).transpose().cast<float>();
    sum.add(trainer.names(), {row.begin(), row.end()}, actor.truth[static_cast<std::size_t>(f)]);
  }
  std::map<std::string, report::WeightFigures> out;
  for (const report::WeightFigures& one : sum.figures()) {
    out.emplace(one.name, one);
  }
  return out;
}

/// Whether the truth moves a value by more than 0.1.
bool moves(const Trainer& trainer, const Actor& actor, const std::string& name) {
  constexpr double kMoves = 0.1;
  const auto& names = trainer.names();
  const auto course = actor.values.col(std::find(names.begin(), names.end(), name) - names.begin());
  return course.maxCoeff() - course.minCoeff() > kMoves;
}

/// How values follow the truth, of names that move.
void print(const std::string& what, const Trainer& trainer, const Actor& actor, const Rows& values) {
  int moving = 0;
  int best = 0;
  int good = 0;
  int fair = 0;
  int dead = 0;
  double error = 0;
  std::vector<double> slopes;
  const auto figures = figures_of(trainer, actor, values);
  for (const auto& [name, one] : figures) {
    error += one.mean_error / static_cast<double>(figures.size());
    if (!moves(trainer, actor, name)) {
      continue;
    }
    ++moving;
    best += one.correlation >= 0.9 ? 1 : 0;
    good += one.correlation >= 0.8 ? 1 : 0;
    fair += one.correlation >= 0.65 ? 1 : 0;
    dead += one.is_dead ? 1 : 0;
    if (!std::isnan(one.slope)) {
      slopes.push_back(one.slope);
    }
  }
  fmt::print("{},{},{},{},{},{},{},{:.2f},{:.4f}\n", actor.name, what, moving, best, good, fair, dead,
             slopes.empty() ? 0.0 : maths::median_of(slopes), error);
  std::cout.flush();
}

struct Options {
  std::vector<std::filesystem::path> folders;
  std::vector<std::filesystem::path> curves;
  std::vector<std::string> judged;  ///< FOLDER or FOLDER=NAME: without the recording of that name in C
  std::filesystem::path model = default_model_file();
  std::filesystem::path output;
};

/// Of each name the judged sequences in which the truth moves it by more than kMoves.
class ByName {
 public:
  void add(const Trainer& trainer, const Actor& actor, const Rows& read) {
    const auto fit = figures_of(trainer, actor, actor.weights);
    const auto now = figures_of(trainer, actor, read);
    for (const std::string& name : trainer.names()) {
      if (moves(trainer, actor, name)) {
        pairs_[name].emplace_back(fit.at(name), now.at(name));
      }
    }
  }
  /// Square of the mean correlation of what is read, either side alike; 0 of what never moved.
  Eigen::VectorXf told(const Trainer& trainer) const {
    const auto& names = trainer.names();
    Eigen::VectorXf out(static_cast<Eigen::Index>(names.size()));
    for (std::size_t n = 0; n < names.size(); ++n) {
      double sum = 0;
      double count = 0;
      for (const std::size_t name : {n, trainer.twin_of(n)}) {
        const auto found = pairs_.find(names[name]);
        if (found == pairs_.end()) {
          continue;
        }
        for (const auto& pair : found->second) {
          const double correlation = pair.second.correlation;
          sum += std::isnan(correlation) ? 0 : correlation;
          ++count;
        }
      }
      const double mean = count > 0 ? std::max(0.0, sum / count) : 0;
      out[static_cast<Eigen::Index>(n)] = static_cast<float>(mean * mean);
    }
    return out;
  }
  void print() const {
    fmt::print("\nname,sequences,fit_correlation,fit_slope,correlation,slope,error\n");
    for (const auto& entry : pairs_) {
      const auto& pairs = entry.second;
      const auto mean = [&pairs](auto&& of) {
        double sum = 0;
        for (const auto& pair : pairs) {
          const double value = of(pair);
          sum += std::isnan(value) ? 0 : value / static_cast<double>(pairs.size());
        }
        return sum;
      };
      fmt::print("{},{},{:.2f},{:.2f},{:.2f},{:.2f},{:.3f}\n", entry.first, pairs.size(),
                 mean([](const auto& pair) { return pair.first.correlation; }),
                 mean([](const auto& pair) { return pair.first.slope; }),
                 mean([](const auto& pair) { return pair.second.correlation; }),
                 mean([](const auto& pair) { return pair.second.slope; }),
                 mean([](const auto& pair) { return pair.second.mean_error; }));
    }
  }

 private:
  std::map<std::string, std::vector<std::pair<report::WeightFigures, report::WeightFigures>>> pairs_;
};

void run(const Options& options) {
  if (!options.output.empty() && options.judged.empty()) {
    throw Error(ErrorKind::Usage,
                "--output needs sequences to judge by: they say how far each value is told");
  }
  Trainer trainer(options.model);
  std::vector<Actor> actors;
  for (const auto& folder : options.folders) {
    actors.push_back(trainer.watch(folder));
    fmt::print(stderr, "{}: {} frames\n", actors.back().name, actors.back().values.rows());
  }
  trainer.hear(options.curves, "");
  fmt::print("actor,values,moving,correlate_0.9,correlate_0.8,correlate_0.65,dead,median_slope,mean_error\n");
  std::vector<const Actor*> all;
  for (const Actor& actor : actors) {
    std::vector<const Actor*> others;
    for (const Actor& other : actors) {
      if (&other != &actor) {
        others.push_back(&other);
      }
    }
    all.push_back(&actor);
    print("fit", trainer, actor, actor.weights);
    print("read", trainer, actor, trainer.read(trainer.learn(others), actor));
  }
  ByName by_name;
  for (const std::string& judged : options.judged) {
    const std::size_t equals = judged.rfind('=');
    const Actor actor = trainer.watch(judged.substr(0, equals));
    trainer.hear(options.curves, equals == std::string::npos ? "" : judged.substr(equals + 1));
    const Rows read = trainer.read(trainer.learn(all), actor);
    print("fit", trainer, actor, actor.weights);
    print("read", trainer, actor, read);
    by_name.add(trainer, actor, read);
  }
  if (!options.judged.empty()) {
    by_name.print();
  }
  if (!options.output.empty()) {
    trainer.hear(options.curves, "");
    track::ExpressionReading reading = trainer.learn(all);
    reading.told = by_name.told(trainer);
    trainer.write(reading, options.output);
    fmt::print(stderr, "{} written\n", options.output.string());
  }
}

}  // namespace
}  // namespace facet::bench

int main(int argc, char** argv) {
  facet::bench::Options options;
  CLI::App app("Learn how expressions are read off landmarks, and say how well");
  app.add_option("folders", options.folders,
                 "Sequences of facet synth to learn from (bench/expression-reading makes them)")
      ->required();
  app.add_option("--curves", options.curves, "Recorded curves (CSV) that say how values go together")
      ->required();
  app.add_option("--judge", options.judged,
                 "FOLDER or FOLDER=RECORDING: judge another sequence; without that recording in what says "
                 "how values go together");
  app.add_option("--model", options.model, "Face model file of the tracker")->capture_default_str();
  app.add_option("-o,--output", options.output, "What the product reads with");
  CLI11_PARSE(app, argc, argv);
  try {
    facet::bench::run(options);
  } catch (const std::exception& error) {
    fmt::print(stderr, "expression_reading: {}\n", error.what());
    return 1;
  }
  return 0;
}
