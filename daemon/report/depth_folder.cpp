#include "report/depth_folder.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <system_error>
#include <utility>

#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/pfm.hpp"
#include "files/text_file.hpp"

namespace facet::report {
namespace {

constexpr std::size_t kMostDescriptionBytes = 1U << 16;

std::filesystem::path sigma_file(const std::filesystem::path& folder, const std::string& left_camera,
                                 std::uint64_t slot) {
  return folder / left_camera / fmt::format("slot_{:06}-sigma.pfm", slot);
}

/// Number of slot_NUMBER-sigma.pfm, which is written last.
std::optional<std::uint64_t> slot_of(const std::string& name) {
  constexpr std::string_view kBefore = "slot_";
  constexpr std::string_view kAfter = "-sigma.pfm";
  if (!name.starts_with(kBefore) || !name.ends_with(kAfter)) {
    return std::nullopt;
  }
  const std::string digits = name.substr(kBefore.size(), name.size() - kBefore.size() - kAfter.size());
  const bool number = !digits.empty() && digits.size() <= 18 &&
                      std::all_of(digits.begin(), digits.end(), [](char c) { return c >= '0' && c <= '9'; });
  return number ? std::optional(std::stoull(digits)) : std::nullopt;
}

}  // namespace

std::filesystem::path depth_file(const std::filesystem::path& folder, const std::string& left_camera,
                                 std::uint64_t slot) {
  return folder / left_camera / fmt::format("slot_{:06}.pfm", slot);
}

DepthFolder::DepthFolder(std::filesystem::path folder, const capture::Rig& rig, const std::string& made_of)
    : folder_(std::move(folder)) {
  for (const capture::StereoPair& pair : rig.pairs) {
    const std::string& name = rig.cameras[pair.left].name;
    if (std::find(names_.begin(), names_.end(), name) != names_.end()) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("two pairs of the rig have the left camera '{}', and depth maps are named by it: "
                      "process without --depth",
                      name));
    }
    names_.push_back(name);
    files::make_folder(folder_ / names_.back());
  }
  const std::filesystem::path description = folder_ / "depth.json";
  std::error_code ignored;
  if (!std::filesystem::exists(description, ignored)) {
    files::OutputFile file(description);
    file.write(made_of);
    file.commit();
    return;
  }
  if (files::read_text(description, kMostDescriptionBytes, "description of depth maps") != made_of) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("'{}' holds depth maps of another take, rig or range of slots (see depth.json in it): "
                    "remove it, or give another folder",
                    folder_.string()));
  }
  if (!std::filesystem::exists(folder_ / "rig.toml", ignored)) {
    return;
  }
  lenses_ = capture::read_rig(folder_ / "rig.toml");
  if (lenses_->cameras.size() != names_.size()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: {} lenses for {} pairs: remove the folder", (folder_ / "rig.toml").string(),
                            lenses_->cameras.size(), names_.size()));
  }
  for (const auto& entry : std::filesystem::directory_iterator(folder_ / names_.back())) {
    const auto slot = slot_of(entry.path().filename().string());
    const bool whole = slot && std::all_of(names_.begin(), names_.end(), [&](const std::string& name) {
                         return std::filesystem::exists(depth_file(folder_, name, *slot), ignored) &&
                                std::filesystem::exists(sigma_file(folder_, name, *slot), ignored);
                       });
    if (whole) {
      kept_.insert(*slot);
    }
  }
}

std::vector<capture::DepthMap> DepthFolder::read(std::uint64_t slot) const {
  std::vector<capture::DepthMap> maps;
  for (std::size_t pair = 0; pair < names_.size(); ++pair) {
    const std::filesystem::path file = depth_file(folder_, names_[pair], slot);
    files::FloatImage depth = files::read_pfm(file);
    files::FloatImage sigma = files::read_pfm(sigma_file(folder_, names_[pair], slot));
    capture::DepthMap& map = maps.emplace_back();
    map.lens = lenses_->cameras[pair].lens;
    map.width_px = depth.width_px;
    map.height_px = depth.height_px;
    if (map.width_px != map.lens.width_px || map.height_px != map.lens.height_px ||
        sigma.values.size() != depth.values.size()) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("{}: not of its lens's size: remove the folder", file.string()));
    }
    map.depth_mm = std::move(depth.values);
    map.sigma_mm = std::move(sigma.values);
    map.confidence.resize(map.depth_mm.size());
    std::transform(map.depth_mm.begin(), map.depth_mm.end(), map.sigma_mm.begin(), map.confidence.begin(),
                   [](float z, float s) { return z > 0 ? capture::depth_confidence(s) : 0.0F; });
  }
  return maps;
}

void DepthFolder::write(std::uint64_t slot, std::span<const capture::DepthMap> maps) {
  const bool whole =
      std::none_of(maps.begin(), maps.end(), [](const auto& map) { return map.depth_mm.empty(); });
  if (!whole || kept_.contains(slot)) {
    return;
  }
  if (!lenses_) {
    lenses_.emplace();
    for (std::size_t pair = 0; pair < maps.size(); ++pair) {
      lenses_->cameras.push_back({names_.at(pair), maps[pair].lens, false});
    }
    capture::write_rig(*lenses_, folder_ / "rig.toml");
  }
  for (std::size_t pair = 0; pair < maps.size(); ++pair) {
    const capture::DepthMap& map = maps[pair];
    files::write_pfm({map.width_px, map.height_px, map.depth_mm}, depth_file(folder_, names_[pair], slot));
    files::write_pfm({map.width_px, map.height_px, map.sigma_mm}, sigma_file(folder_, names_[pair], slot));
  }
}

}  // namespace facet::report
