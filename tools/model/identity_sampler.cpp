#include "model/identity_sampler.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "files/text_file.hpp"

namespace facet::model {
namespace {

using nlohmann::json;

// Typical slider values by group, chosen so that distances between landmarks spread as measured on real
// adults (the table in docs/face-model.md). A group that is not named is left alone. The head's sliders are
// halved: at full size the skull varies too much.
const std::map<std::string, double> kGroupSigma = {{"head", 0.15}, {"forehead", 0.3}, {"eyebrows", 0.3},
                                                   {"eyes", 0.3},  {"nose", 0.24},    {"mouth", 0.25},
                                                   {"ears", 0.3},  {"chin", 0.2},     {"cheek", 0.3}};
constexpr double kAsymmetrySigma = 0.18;
constexpr double kNeckSigma = 0.25;

// MakeHuman's men have faces 20 mm longer than its women; real ones differ by 8 mm. The mixture is kept
// around the value whose mean face has the proportions of a measured adult mean.
constexpr double kMaleMean = 0.32;
constexpr double kMaleSigma = 0.17;

// Concentration of the Dirichlet draw of ethnicities: below 1 most people lie near one corner.
constexpr double kEthnicityConcentration = 0.8;

struct SliderName {
  std::vector<std::string> low;  // targets that the negative side adds, left and right
  std::vector<std::string> high;
  double sigma = 0;
};

std::vector<SliderName> slider_names(const std::filesystem::path& file) {
  constexpr files::JsonLimits kLimits{1U << 20, 100'000};
  const json document = files::parse_json(files::read_text(file, kLimits.most_bytes, "list of sliders"),
                                          kLimits, file.string());
  std::vector<SliderName> names;
  try {
    for (const json& group : document) {
      const auto group_name = group.at("group").get<std::string>();
      const auto sigma = kGroupSigma.find(group_name);
      if (sigma == kGroupSigma.end()) {
        continue;
      }
      for (const json& modifier : group.at("modifiers")) {
        const auto target = modifier.at("target").get<std::string>();
        // The package's eye sizes differ from the CC0 release; a right side is tied to its left one.
        if (target.find("eye-size") != std::string::npos || target.starts_with("r-")) {
          continue;
        }
        const auto sides = [&](const std::string& end) {
          const std::string name = group_name + "/" + target + (end.empty() ? "" : "-" + end);
          std::vector<std::string> both = {name};
          if (target.starts_with("l-")) {
            both.push_back(group_name + "/r-" + target.substr(2) + "-" + end);
          }
          return both;
        };
        SliderName name;
        name.sigma = sigma->second;
        if (modifier.contains("max")) {
          name.low = sides(modifier.at("min").get<std::string>());
          name.high = sides(modifier.at("max").get<std::string>());
        } else {
          name.high = sides("");
        }
        names.push_back(std::move(name));
      }
    }
  } catch (const json::exception& error) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: unexpected contents: {}. Run packaging/fetch-assets again.", file.string(),
                            error.what()));
  }
  if (names.empty()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: no sliders. Run packaging/fetch-assets again.", file.string()));
  }
  return names;
}

}  // namespace

IdentitySampler::IdentitySampler(const std::filesystem::path& folder, const MakeHumanTargets& targets,
                                 const MakeHumanMesh& base, const HeadMesh& head, const HeadFrame& frame)
    : base_mm_(base_positions_mm(base, head, frame)) {
  const auto displacement = [&](const std::string& name) {
    return Eigen::Matrix3Xd(HeadFrame::kMmPerDm * targets.displacements_dm(name, head.base_vertex));
  };
  for (std::size_t e = 0; e < kEthnicities.size(); ++e) {
    macro_mm_[e][0] = displacement(fmt::format("macrodetails/{}-female-young", kEthnicities[e]));
    macro_mm_[e][1] = displacement(fmt::format("macrodetails/{}-male-young", kEthnicities[e]));
  }
  const auto sum = [&](const std::vector<std::string>& names) {
    Eigen::Matrix3Xf total = Eigen::Matrix3Xf::Zero(3, head.vertex_count());
    for (const std::string& name : names) {
      total += displacement(name).cast<float>();
    }
    return total;
  };
  for (const SliderName& name : slider_names(folder / "src/json/modifiers/modeling_modifiers.json")) {
    sliders_.push_back({sum(name.low), sum(name.high), name.sigma, name.low.empty()});
  }
  sliders_.push_back({sum({"neck/neck-double-less"}), sum({"neck/neck-double-more"}), kNeckSigma, false});
  // "asym-brown-1-l" pushes one way, "asym-brown-1-r" the other: the two sides of one slider.
  for (const std::string& left : targets.names("asym/asym-")) {
    if (left.ends_with("-l")) {
      sliders_.push_back({sum({left}), sum({left.substr(0, left.size() - 1) + "r"}), kAsymmetrySigma, false});
    }
  }
}

Identity IdentitySampler::compose(const std::array<double, 3>& ethnicity, double male) const {
  Identity identity{base_mm_, ethnicity};
  for (std::size_t e = 0; e < ethnicity.size(); ++e) {
    identity.neutral_mm += ethnicity[e] * ((1 - male) * macro_mm_[e][0] + male * macro_mm_[e][1]);
  }
  return identity;
}

Identity IdentitySampler::average() const {
  constexpr double kThird = 1.0 / 3.0;
  return compose({kThird, kThird, kThird}, kMaleMean);
}

Identity IdentitySampler::draw(std::mt19937_64& random) const {
  std::normal_distribution<double> normal;
  std::gamma_distribution<double> gamma(kEthnicityConcentration);
  std::array<double, 3> ethnicity{};
  double total = 0;
  for (double& weight : ethnicity) {
    weight = gamma(random);
    total += weight;
  }
  for (double& weight : ethnicity) {
    weight /= total;
  }
  Identity identity = compose(ethnicity, std::clamp(kMaleMean + kMaleSigma * normal(random), 0.0, 1.0));
  for (const Slider& slider : sliders_) {
    double value = std::clamp(slider.sigma * normal(random), -1.0, 1.0);
    if (slider.one_sided) {
      value = std::abs(value);
    }
    identity.neutral_mm += std::abs(value) * (value < 0 ? slider.low_mm : slider.high_mm).cast<double>();
  }
  return identity;
}

}  // namespace facet::model
