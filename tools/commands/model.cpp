// `facet model`: makes, completes, shows and explains face models.

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>

#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "model/build_model.hpp"
#include "model/contact_sheet.hpp"
#include "model/ict_model.hpp"
#include "model/landmark_map.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct BuildArguments {
  std::string assets = assets_folder().string();
  std::string output;
  model::BuildOptions options;
};

struct ImportArguments {
  model::IctOptions options;
  std::string output;
  std::string landmark_nets = default_landmark_nets().string();
  std::string albedo_from = default_model_file().string();
};

struct FileArguments {
  std::string model = default_model_file().string();
  std::string output;
  std::string landmark_nets = default_landmark_nets().string();
  std::string sheet;
  model::SheetOptions sheet_options;
};

constexpr const char* kGroupNames[landmark::kLandmarkGroupCount] = {"skin", "contour", "brow",
                                                                    "eye",  "lips",    "nose"};

/// A progress bar for callbacks that name what they do.
class NamedProgress {
 public:
  explicit NamedProgress(std::string what, std::string unit)
      : what_(std::move(what)), unit_(std::move(unit)) {}
  void operator()(std::uint64_t done, std::uint64_t total, const std::string& note) {
    if (!bar_) {
      bar_ = std::make_unique<Progress>(what_, total, unit_);
    }
    bar_->set(done, note);
    if (done == total) {
      bar_->finish();
    }
  }

 private:
  std::string what_;
  std::string unit_;
  std::unique_ptr<Progress> bar_;
};

void find_and_check_landmarks(face::FaceModel& model, const std::filesystem::path& landmark_nets) {
  landmark::Landmarker landmarker(landmark_nets);
  NamedProgress finding("Finding the landmarks", "pictures");
  model.landmarks = model::find_landmarks(model, landmarker, [&](int done, int total) {
    finding(static_cast<std::uint64_t>(done), static_cast<std::uint64_t>(total), "");
  });
  NamedProgress checking("Checking the landmarks", "pictures");
  const auto agreements = model::check_landmarks(model, landmarker, [&](int done, int total) {
    checking(static_cast<std::uint64_t>(done), static_cast<std::uint64_t>(total), "");
  });
  tell("Landmarks: what the net finds on renders against the model's own, mean in mm\n  {:<24}", "");
  for (const char* group : kGroupNames) {
    tell("{:>9}", group);
  }
  tell("\n");
  for (const model::LandmarkAgreement& agreement : agreements) {
    tell("  {:<24}", agreement.pose);
    for (const float mean_mm : agreement.mean_mm) {
      tell("{:>9}", agreement.found ? fmt::format("{:.1f}", mean_mm) : "no face");
    }
    tell("\n");
  }
}

void run_build(BuildArguments arguments) {
  const std::filesystem::path assets = arguments.assets;
  arguments.options.makehuman = assets / "makehuman";
  const std::filesystem::path output =
      arguments.output.empty() ? assets / "default.facemodel" : std::filesystem::path(arguments.output);
  NamedProgress progress("Building the face model", "steps");
  model::BuildReport report;
  face::FaceModel model = model::build_model(
      arguments.options,
      [&](std::uint64_t done, std::uint64_t total, const std::string& what) { progress(done, total, what); },
      report);
  tell(
      "{} identity modes hold {:.1f} % of the variance; faces spread {:.1f} mm (rms) about their mean\n"
      "unseen faces: {:.2f} mm (rms) lost on the neutral face, {:.2f} mm on an expression\n"
      "eyes {:.1f} mm apart, {} vertices, {} quads, {} expressions\n",
      model.identity_count(), 100 * report.explained_variance, report.identity_rms_mm,
      report.neutral_error_mm, report.expression_error_mm, report.eye_distance_mm, model.vertex_count(),
      model.control.quads.cols(), model.expression_count());
  find_and_check_landmarks(model, assets / "mediapipe" / "face_mesh_solution_packed_assets.data");
  model.save(output);
  tell("{}: {:.1f} MB\n", output.string(), static_cast<double>(std::filesystem::file_size(output)) / 1e6);
}

void run_import_ict(const ImportArguments& arguments) {
  NamedProgress reading("Reading the shapes", "files");
  model::IctReport report;
  face::FaceModel model = model::import_ict(
      arguments.options,
      [&](int done, int total) {
        reading(static_cast<std::uint64_t>(done), static_cast<std::uint64_t>(total), "");
      },
      report);
  tell("{} vertices, {} quads, {} identity modes, {} expressions\n", model.vertex_count(),
       model.control.quads.cols(), model.identity_count(), model.expression_count());
  if (!report.missing.empty()) {
    tell("no shape for  {}\n", fmt::format("{}", fmt::join(report.missing, ", ")));
  }
  find_and_check_landmarks(model, arguments.landmark_nets);
  if (!arguments.albedo_from.empty()) {
    model::borrow_albedo(face::FaceModel::load(arguments.albedo_from), model);
  }
  model.save(arguments.output);
  tell("{}: {:.1f} MB\n", arguments.output,
       static_cast<double>(std::filesystem::file_size(arguments.output)) / 1e6);
}

void run_landmarks(const FileArguments& arguments) {
  face::FaceModel model = face::FaceModel::load(arguments.model);
  find_and_check_landmarks(model, arguments.landmark_nets);
  if (!arguments.sheet.empty()) {
    constexpr int kSheetTilePx = 500;
    landmark::Landmarker landmarker(arguments.landmark_nets);
    render::write_png(model::landmark_sheet(model, landmarker, kSheetTilePx), arguments.sheet);
    tell("{}\n", arguments.sheet);
  }
  const std::string& output = arguments.output.empty() ? arguments.model : arguments.output;
  model.save(output);
  tell("{}\n", output);
}

void run_show(const FileArguments& arguments) {
  const face::FaceModel model = face::FaceModel::load(arguments.model);
  NamedProgress progress("Rendering the contact sheet", "tiles");
  const render::Picture sheet =
      model::contact_sheet(model, arguments.sheet_options, [&](int done, int total) {
        progress(static_cast<std::uint64_t>(done), static_cast<std::uint64_t>(total), "");
      });
  render::write_png(sheet, arguments.output);
  tell("{}: {}x{} px\n", arguments.output, sheet.width_px, sheet.height_px);
}

void run_info(const FileArguments& arguments) {
  const face::FaceModel model = face::FaceModel::load(arguments.model);
  const auto count = [&](face::Region region) {
    return std::count_if(model.regions.begin(), model.regions.end(),
                         [&](std::uint8_t bits) { return face::has_region(bits, region); });
  };
  const auto mean_mm = model.core_row(0, 0);
  const Eigen::Vector3f size_mm = mean_mm.rowwise().maxCoeff() - mean_mm.rowwise().minCoeff();
  tell(
      "{}\n  name         {}\n  file         {:.1f} MB; in memory {:.0f} MB\n  mesh         {} vertices, {} "
      "quads, "
      "{:.0f} x {:.0f} x {:.0f} mm\n  identity     {} modes\n  expressions  {}\n  landmarks    {}\n  regions "
      "     "
      "refinable {}, eye {}, lips {}, mouth interior {}, boundary {}, scalp {}, brow {}\n",
      arguments.model, model.name, static_cast<double>(std::filesystem::file_size(arguments.model)) / 1e6,
      static_cast<double>(model.core_mm.size() * sizeof(float)) / 1e6, model.vertex_count(),
      model.control.quads.cols(), size_mm.x(), size_mm.y(), size_mm.z(), model.identity_count(),
      model.expression_count(),
      model.landmarks.empty() ? "none: run `facet model landmarks`"
                              : fmt::format("{}", model.landmarks.size()),
      count(face::Region::Refinable), count(face::Region::Eye), count(face::Region::Lips),
      count(face::Region::MouthInterior), count(face::Region::Boundary), count(face::Region::Scalp),
      count(face::Region::Brow));
  tell("\n  {:<22}{:>14}{:>20}{:>22}\n", "expression", "typical weight", "largest move, mm",
       "varies by person, mm");
  for (int e = 0; e < model.expression_count(); ++e) {
    const float largest_mm = model.core_row(0, e + 1).colwise().norm().maxCoeff();
    Eigen::VectorXf variance = Eigen::VectorXf::Zero(model.vertex_count());
    for (int i = 1; i < model.identity_modes; ++i) {
      variance += model.core_row(i, e + 1).colwise().squaredNorm().transpose();
    }
    tell("  {:<22}{:>14.2f}{:>20.1f}{:>22.2f}\n", model.expression_names[static_cast<std::size_t>(e)],
         model.expression_sigma[static_cast<std::size_t>(e)], largest_mm, std::sqrt(variance.maxCoeff()));
  }
}

void add_build(Command parent) {
  auto arguments = std::make_shared<BuildArguments>();
  const Command command = parent.subcommand("build", "Make the default model from MakeHuman's data (CC0)");
  command.option("--assets", arguments->assets, "Folder that packaging/fetch-assets filled").shows_default();
  command.option("-o,--output", arguments->output,
                 "Model file to write (default: default.facemodel in --assets)");
  command.option("--seed", arguments->options.seed, "Of the sampled identities").shows_default();
  command.option("--identities", arguments->options.identities, "Sampled; each counts with its mirror image")
      .shows_default()
      .range(2, 1000);
  command.option("--modes", arguments->options.core.max_modes, "Largest number of identity modes")
      .shows_default()
      .range(1, 500);
  command.callback([arguments] { run_build(*arguments); });
}

void add_import_ict(Command parent) {
  auto arguments = std::make_shared<ImportArguments>();
  const Command command = parent.subcommand(
      "import-ict", "Make a model of ICT-FaceKit's scans (MIT; download them from its authors)");
  command.option("folder", arguments->options.folder, "Its FaceXModel folder, with the OBJ files")
      .required()
      .existing_folder();
  command.option("-o,--output", arguments->output, "Model file to write").required();
  command
      .option("--modes", arguments->options.identity_modes,
              "Identity modes at most; each takes about 8 MB of memory")
      .shows_default()
      .range(0, 500);
  command.option("--landmark-nets,--landmark-assets", arguments->landmark_nets, "File of the landmark nets")
      .shows_default();
  command
      .option("--albedo-from", arguments->albedo_from,
              "Model whose mean albedo the skin gets; empty: plain skin")
      .shows_default();
  command.callback([arguments] { run_import_ict(*arguments); });
}

}  // namespace

void add_model_command(Command app) {
  const Command command = app.subcommand("model", "Make, show and examine face models");
  command.requires_subcommand();
  add_build(command);
  add_import_ict(command);

  auto landmarks = std::make_shared<FileArguments>();
  const Command find = command.subcommand(
      "landmarks", "Find where the landmark net's points lie on a model, by rendering it; any model file");
  find.option("model", landmarks->model, "Model file").shows_default();
  find.option("-o,--output", landmarks->output, "Model file to write (default: the same file)");
  find.option("--landmark-nets,--landmark-assets", landmarks->landmark_nets, "MediaPipe's packed assets")
      .shows_default();
  find.option("--sheet", landmarks->sheet, "Also draw what was found, as a PNG");
  find.callback([landmarks] { run_landmarks(*landmarks); });

  auto show = std::make_shared<FileArguments>();
  show->output = "sheet.png";
  const Command sheet =
      command.subcommand("show", "Render a contact sheet of identity modes and expressions");
  sheet.option("model", show->model, "Model file").shows_default();
  sheet.option("-o,--output", show->output, "PNG to write").shows_default();
  sheet.option("--tile", show->sheet_options.tile_px, "Width of one picture, px")
      .shows_default()
      .range(40, 1000);
  sheet.option("--columns", show->sheet_options.columns, "Pictures per row").shows_default().range(2, 40);
  sheet.callback([show] { run_show(*show); });

  auto info = std::make_shared<FileArguments>();
  const Command explain = command.subcommand("info", "Print a model's sizes, regions and expressions");
  explain.option("model", info->model, "Model file").shows_default();
  explain.callback([info] { run_info(*info); });
}

}  // namespace facet::tools
