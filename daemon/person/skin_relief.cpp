#include "person/skin_relief.hpp"

#include <algorithm>
#include <array>
#include <map>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <tuple>
#include <utility>
#include <vector>

#include "maths/srgb.hpp"
#include "mesh/quads.hpp"
#include "person/burst_lamp.hpp"
#include "person/chart_view.hpp"
#include "person/relief_solve.hpp"
#include "person/skin_albedo.hpp"
#include "person/skin_registration.hpp"

namespace facet::person {
namespace {

constexpr int kTurns = 8;  ///< of lamps, exposures and albedo
/// Tukey's bound: wide at first, while light and albedo are wrong.
constexpr int kWideTurns = 2;
constexpr float kWideBound = 0.8F;
constexpr float kBound = 0.3F;
/// Every so many-th texel tells of lamps and exposures.
constexpr Eigen::Index kRowStep = 40;
constexpr int kAlbedoRounds = 3;
constexpr int kRegistrations = 2;
constexpr float kKnown = 0.5F;        ///< pictures' worth of weight, of an albedo to register with
constexpr float kWhole = 0.999F;      ///< of a texel, that triangles hold
constexpr float kShown = 0.05F;       ///< a picture's weight
constexpr float kLeastShade = 0.05F;  ///< of the usual brightness
/// A relief that half of the pictures tell and the others don't is noise.
constexpr double kLeastAgreement = 0.5;
/// Light and albedo that leave more of the brightness explain nothing.
constexpr double kMostResidual = 0.12;
constexpr double kLeastGain = 0.2;
constexpr double kMostGain = 5;
constexpr float kReliefBound = 0.2F;
constexpr float kMostAlbedoFactor = 2;
/// What a picture under a light of its own counts as: those of a turn have one light, whose faults are
/// theirs.
constexpr float kLitCounts = 4;
constexpr float kLampCounts = 12;  ///< the same under a lamp that was found
/// Of what a lamp gave, that may be left over.
constexpr float kMostUnexplained = 0.3F;
/// Cosine of 40 degrees, which two of the lamps are to stand apart at least.
constexpr float kApart = 0.766F;
/// What a lamp's light is off by far and wide is not the relief's: a bell of this standard deviation, mm.
constexpr double kEvenMm = 14;
/// Of the usual brightness that a lamp took from skin, and of how much skin: then the other light was one,
/// too.
constexpr float kLess = 0.05F;
constexpr float kMostLess = 0.05F;
constexpr float kLeastExpected = 1e-4F;  ///< of the squared bound: less is no light
constexpr float kMostUneven = 2;         ///< times as bright as expected, or as dark
constexpr float kReliefCounts = 0.02F;   ///< what the albedo found counts as, of one picture's worth
/// Pictures' worth of weight between which the relief fades in, and its way to the chart's rim.
constexpr float kFewestSeen = 1;
constexpr float kEnoughSeen = 3;
constexpr float kRimMm = 2;
constexpr float kMostMm = 3;  ///< no skin is deeper furrowed at rest

/// [3][texels] of every step-th texel.
template <typename Values>
Values every(const Values& values, Eigen::Index step) {
  return values(Eigen::all, Eigen::seq(0, values.cols() - 1, step));
}

/// Where the texels lie in a keyframe's picture.
struct Shot {
  cv::Mat x_px, y_px;  ///< [height][width]
  cv::Mat weight;      ///< [height][width]
  cv::Mat held;        ///< [height][width] 1: a triangle holds the texel
};

class SkinSolve {
 public:
  SkinSolve(const face::FaceModel& model, int chart_texels, const std::vector<Keyframe>& keyframes,
            const ShapeSolver& solver, const Eigen::Vector2d& centre_px, const std::function<void()>& between)
      : keyframes_(keyframes),
        between_(between),
        triangles_(mesh::split_quads(model.control.quads)),
        chart_(face_chart(model, chart_texels)),
        surface_mm_(solver.surface(solver.heads().front().expression).cast<float>()),
        normals_(normals_of(surface_mm_, triangles_)),
        texels_(chart_, triangles_, surface_mm_),
        visibility_(surface_mm_, normals_, triangles_),
        light_(texels_, visibility_, turns_of(solver), rooms_of(keyframes)) {
    const auto count = static_cast<Eigen::Index>(keyframes.size());
    all_.weight.resize(count, texels_.count());
    all_.model.resize(3, texels_.count());
    for (Eigen::Index i = 0; i < texels_.count(); ++i) {
      all_.model.col(i) = chart_.spread(model.mean_albedo, place(i));
    }
    all_.albedo = all_.model;
    for (std::size_t k = 0; k < keyframes.size(); ++k) {
      between_();
      ChartView view =
          chart_view(chart_, triangles_, keyframes[k].picture, solver, solver.heads()[k], centre_px);
      const HeadState& head = solver.heads()[k];
      Eigen::Isometry3f& pose = poses_.emplace_back(Eigen::Isometry3f::Identity());
      pose.linear() = head.rotation.cast<float>();
      pose.translation() = head.translation_mm.cast<float>();
      shots_.push_back({std::move(view.x_px), std::move(view.y_px), std::move(view.weight), held_texels()});
    }
    sample_pictures();
  }

  Skin run(double scale) {
    SkinAlbedo albedo = albedo_of_model();
    find_albedo(albedo);
    for (int round = 0; round < kRegistrations; ++round) {
      bring_together(albedo);
      sample_pictures();
      settle(albedo);
    }
    Skin out;
    out.residual = albedo.residual(all_);
    out.gains.assign(albedo.gains().begin(), albedo.gains().end());
    out.chart.width = chart_.width();
    out.chart.height = chart_.height();
    out.chart.least = chart_.least();
    out.chart.texels_per_unit = chart_.texels_per_unit();
    const cv::Mat seen = texels_.image(all_.seen);
    out.seen.assign(seen.ptr<float>(), seen.ptr<float>() + seen.total());
    const cv::Mat fading = fade(seen);
    Eigen::ArrayXf albedo_factor;
    const Eigen::VectorXd relief =
        find_relief(albedo, of_texels(fading), out.agreement, albedo_factor, out.lamps);
    out.believed = out.agreement >= kLeastAgreement && out.residual <= kMostResidual;
    out.chart.relief_mm.assign(seen.total(), 0);
    out.chart.albedo.assign(3 * seen.total(), 0);
    for (Eigen::Index i = 0; i < texels_.count(); ++i) {
      if (out.believed) {
        out.chart.relief_mm[place(i)] = std::clamp(static_cast<float>(scale * relief[i]), -kMostMm, kMostMm);
      }
      if (!(all_.seen[i] > kFewestSeen)) {
        continue;  // the model's, which everybody has
      }
      const Eigen::Array3f rgb = albedo_factor[i] * all_.albedo.col(i).array();
      for (std::size_t c = 0; c < 3; ++c) {
        out.chart.albedo[3 * place(i) + c] = std::clamp(rgb[static_cast<Eigen::Index>(c)], 0.0F, 1.0F);
      }
    }
    return out;
  }

 private:
  static Eigen::Matrix3Xf normals_of(const mesh::Vertices& surface_mm, const mesh::Triangles& triangles) {
    Eigen::Matrix3Xf normals;
    mesh::vertex_normals(surface_mm, triangles, normals);
    return normals;
  }

  static std::vector<Eigen::MatrixXd> turns_of(const ShapeSolver& solver) {
    std::vector<Eigen::MatrixXd> out;
    for (const HeadState& head : solver.heads()) {
      out.push_back(light::turned_lamps(head.rotation.transpose().cast<float>()));
    }
    return out;
  }

  /// Those of the turn are of one room, each of the others of its own.
  static std::vector<Eigen::Index> rooms_of(const std::vector<Keyframe>& keyframes) {
    const bool turned = std::any_of(keyframes.begin(), keyframes.end(),
                                    [](const Keyframe& keyframe) { return keyframe.light == 0; });
    std::vector<Eigen::Index> out;
    out.reserve(keyframes.size());
    Eigen::Index next = turned ? 1 : 0;
    for (const Keyframe& keyframe : keyframes) {
      out.push_back(keyframe.light == 0 ? 0 : next++);
    }
    return out;
  }

  std::size_t place(Eigen::Index texel) const {
    return static_cast<std::size_t>(texels_.grid.place[static_cast<std::size_t>(texel)]);
  }

  cv::Mat held_texels() const { return texels_.image(Eigen::ArrayXf::Ones(texels_.count())); }

  void sample_pictures() {
    const std::array<float, 256>& decoded = maths::decoded_srgb8();
    const cv::Mat table(1, 256, CV_32F, const_cast<float*>(decoded.data()));
    for (Eigen::MatrixXf& plane : all_.rgb) {
      plane.resize(all_.weight.rows(), all_.weight.cols());
    }
    for (std::size_t k = 0; k < shots_.size(); ++k) {
      cv::Mat linear;
      cv::LUT(rgb_of(keyframes_[k].picture), table, linear);
      const Shot& shot = shots_[k];
      const cv::Mat sampled = sample(linear, shot.x_px, shot.y_px);
      for (Eigen::Index i = 0; i < texels_.count(); ++i) {
        // Beside what no triangle holds a place between two texels is none.
        const bool whole = shot.held.ptr<float>()[place(i)] > kWhole;
        all_.weight(static_cast<Eigen::Index>(k), i) = whole ? shot.weight.ptr<float>()[place(i)] : 0;
        const auto& pixel = sampled.ptr<cv::Vec3f>()[place(i)];
        for (std::size_t c = 0; c < 3; ++c) {
          all_.rgb[c](static_cast<Eigen::Index>(k), i) = pixel[static_cast<int>(c)];
        }
      }
    }
  }

  SkinAlbedo albedo_of_model() const {
    const Eigen::Index count = all_.weight.rows();
    Eigen::ArrayXd sums = Eigen::ArrayXd::Constant(count, 1e-12);
    Eigen::ArrayXd weights = Eigen::ArrayXd::Constant(count, 1e-12);
    double model = 1e-12;
    for (Eigen::Index i = 0; i < texels_.count(); ++i) {
      model += static_cast<double>(brightness(all_.model.col(i)));
      for (Eigen::Index k = 0; k < count; ++k) {
        sums[k] += static_cast<double>(all_.weight(k, i) * all_.brightness(k, i));
        weights[k] += static_cast<double>(all_.weight(k, i));
      }
    }
    const double usual = sums.sum() / weights.sum();
    // How bright each picture is, whichever side it shows: nearer to its exposure than none.
    const Eigen::VectorXf gains =
        (sums / weights / std::max(usual, 1e-6)).max(kLeastGain).min(kMostGain).cast<float>();
    return {light_, gains, static_cast<float>(std::max(usual, 1e-6)),
            static_cast<float>(model / static_cast<double>(std::max<Eigen::Index>(texels_.count(), 1)))};
  }

  /// What tells of the lamps.
  SkinSamples few() const {
    SkinSamples out;
    for (std::size_t c = 0; c < 3; ++c) {
      out.rgb[c] = every(all_.rgb[c], kRowStep);
    }
    out.weight = every(all_.weight, kRowStep);
    out.model = every(all_.model, kRowStep);
    out.albedo = every(all_.albedo, kRowStep);
    if (all_.shading.size() > 0) {
      out.shading = every(all_.shading, kRowStep);
    }
    return out;
  }

  Eigen::MatrixXf few_rows() const {
    std::vector<std::int32_t> texels;
    for (Eigen::Index i = 0; i < texels_.count(); i += kRowStep) {
      texels.push_back(static_cast<std::int32_t>(i));
    }
    return light_.rows(texels);
  }

  /// Lamps, exposures and the albedo of a few texels in turns, then the albedo of all.
  void find_albedo(SkinAlbedo& albedo) {
    SkinSamples samples = few();
    const Eigen::MatrixXf rows = few_rows();
    for (int turn = 0; turn < kTurns; ++turn) {
      between_();
      albedo.set_bound(turn < kWideTurns ? kWideBound : kBound);
      albedo.solve_lamps(samples, rows);
      albedo.solve_gains(samples);
      albedo.solve_albedo(samples, turn == 0);
    }
    all_.shading = light_.shading(albedo.lamps());
    for (int round = 0; round < kAlbedoRounds; ++round) {
      albedo.solve_albedo(all_, round == 0);
    }
  }

  /// Everything once more, for pictures that lie better on each other.
  void settle(SkinAlbedo& albedo) {
    albedo.solve_albedo(all_, false);
    SkinSamples samples = few();
    albedo.solve_lamps(samples, few_rows());
    albedo.solve_gains(samples);
    all_.shading = light_.shading(albedo.lamps());
    albedo.solve_albedo(all_, false);
  }

  void bring_together(const SkinAlbedo& albedo) {
    const Eigen::ArrayXf known = (all_.seen > kKnown).cast<float>();
    Eigen::ArrayXf values(texels_.count());
    for (Eigen::Index i = 0; i < texels_.count(); ++i) {
      values[i] = all_.albedo_brightness(i);
    }
    const SkinRegistration registration(texels_, values, known);
    for (std::size_t k = 0; k < shots_.size(); ++k) {
      between_();
      const auto row = static_cast<Eigen::Index>(k);
      const float least = kLeastShade * albedo.usual_brightness();
      for (Eigen::Index i = 0; i < texels_.count(); ++i) {
        values[i] = all_.brightness(row, i) / std::max(albedo.gains()[row] * all_.shading(row, i), least);
      }
      const Eigen::ArrayXf weight = (all_.weight.row(row).transpose().array() > kShown).cast<float>();
      const std::array<cv::Mat, 2> flow = registration.flow(values, weight);
      Shot& shot = shots_[k];
      shot = {moved(shot.x_px, flow), moved(shot.y_px, flow), moved(shot.weight, flow),
              moved(shot.held, flow)};
    }
  }

  /// [keyframe] of which half it is: every second one of the turn, by yaw; of a burst every second light.
  std::vector<char> halves() const {
    std::vector<std::size_t> by_yaw(keyframes_.size());
    std::iota(by_yaw.begin(), by_yaw.end(), std::size_t{0});
    std::sort(by_yaw.begin(), by_yaw.end(),
              [&](std::size_t a, std::size_t b) { return keyframes_[a].yaw_deg < keyframes_[b].yaw_deg; });
    std::vector<char> out(keyframes_.size());
    int turned = 0;
    for (const std::size_t k : by_yaw) {
      const int light = keyframes_[k].light;
      out[k] = static_cast<char>((light == 0 ? turned++ : light) % 2);
    }
    return out;
  }

  /// [texel_count] of an image [height][width].
  Eigen::ArrayXf of_texels(const cv::Mat& image) const {
    Eigen::ArrayXf out(texels_.count());
    for (Eigen::Index i = 0; i < out.size(); ++i) {
      out[i] = image.ptr<float>()[place(i)];
    }
    return out;
  }

  /// Takes the samples' pictures: they are needed no more.
  ///
  /// fade           [texel_count] what of the relief is kept
  /// albedo_factor  [texel_count] what the relief makes of the albedo
  /// lamps          how many a burst has that stand at a place
  Eigen::VectorXd find_relief(const SkinAlbedo& albedo, const Eigen::ArrayXf& fade, double& agreement,
                              Eigen::ArrayXf& albedo_factor, int& lamps) {
    shots_.clear();
    AlbedoPrior prior;
    prior.brightness.resize(texels_.count());
    ShadedPictures pictures;
    pictures.brightness.resize(all_.weight.rows(), all_.weight.cols());
    double sum = 0;
    for (Eigen::Index i = 0; i < texels_.count(); ++i) {
      prior.brightness[i] = all_.albedo_brightness(i);
      sum += static_cast<double>(brightness(albedo.hue() * all_.model.col(i).array()));
      for (Eigen::Index k = 0; k < all_.weight.rows(); ++k) {
        pictures.brightness(k, i) = all_.brightness(k, i);
      }
    }
    const auto model =
        static_cast<float>(sum / static_cast<double>(std::max<Eigen::Index>(texels_.count(), 1)));
    const float usual_shading = albedo.usual_brightness() / std::max(model, 1e-6F);
    prior.counts = kReliefCounts * usual_shading * usual_shading;
    prior.usual_brightness = albedo.usual_brightness();
    for (Eigen::MatrixXf& plane : all_.rgb) {
      plane.resize(0, 0);
    }
    pictures.weight = std::move(all_.weight);
    pictures.shading = albedo.gains().asDiagonal() * all_.shading;
    all_.shading.resize(0, 0);
    light_.slopes(albedo.lamps(), pictures.slope_u, pictures.slope_v);
    pictures.slope_u = albedo.gains().asDiagonal() * pictures.slope_u;
    pictures.slope_v = albedo.gains().asDiagonal() * pictures.slope_v;
    ReliefPrior relief_prior;
    relief_prior.texel_mm = texels_.texel_mm;
    between_();
    std::vector<float> counts;
    counts.reserve(keyframes_.size());
    for (const Keyframe& keyframe : keyframes_) {
      counts.push_back(keyframe.light == 0 ? 1 : kLitCounts);
    }
    lamps = put_lamps(prior, pictures, counts);
    agreement = agreement_of_halves(texels_.grid, pictures, prior, relief_prior, halves(), kReliefBound);
    between_();
    const Eigen::VectorXd flat = Eigen::VectorXd::Zero(texels_.count());
    const SlopeSystem system = slope_system(texels_.grid, pictures, prior, flat, kReliefBound, counts);
    Eigen::VectorXd relief =
        relief_step(texels_.grid, system, relief_prior, flat).cwiseProduct(fade.matrix().cast<double>());
    const auto of = [&](const Eigen::VectorXd& relief_mm) {
      return albedo_with_relief(texels_.grid, pictures, prior, relief_mm, kReliefBound);
    };
    albedo_factor = (of(relief) / of(flat).max(1e-6F)).max(1 / kMostAlbedoFactor).min(kMostAlbedoFactor);
    return relief;
  }

  /// Rows of what is taken, [texel_count]: weighted mean, and the sum of weights.
  static std::pair<Eigen::ArrayXf, Eigen::ArrayXf> mean_of(const ShadedPictures& pictures,
                                                           const std::vector<Eigen::Index>& rows) {
    Eigen::ArrayXf sum = Eigen::ArrayXf::Zero(pictures.weight.cols());
    Eigen::ArrayXf weight = sum;
    for (const Eigen::Index k : rows) {
      sum += (pictures.weight.row(k).array() * pictures.brightness.row(k).array()).transpose();
      weight += pictures.weight.row(k).array().transpose();
    }
    return {sum / weight.max(kShown), weight};
  }

  /// [texel_count] by what a lamp's light is brighter than expected, far and wide: what the mesh is off by
  /// and the light that skin throws on skin make of it.
  Eigen::ArrayXf unevenness(const Eigen::ArrayXf& found, const Eigen::ArrayXf& expected,
                            const Eigen::ArrayXf& weight, float bound) const {
    const Eigen::ArrayXf counts = weight * ((found - expected).abs() < bound).cast<float>();
    const double sigma = kEvenMm / texels_.texel_mm;
    const Eigen::ArrayXf above = of_texels(blurred(texels_.image(counts * found * expected), sigma));
    const Eigen::ArrayXf below = of_texels(blurred(texels_.image(counts * expected.square()), sigma));
    const float least = kLeastExpected * bound * bound;
    return (below > least).select((above / below.max(least)).max(1 / kMostUneven).min(kMostUneven), 1.0F);
  }

  /// The lights of a burst by their pictures' rows; first the darkest, which is the room's alone.
  std::vector<std::vector<Eigen::Index>> burst_lights(const ShadedPictures& pictures) const {
    std::map<int, std::vector<Eigen::Index>> rows;
    for (std::size_t k = 0; k < keyframes_.size(); ++k) {
      if (keyframes_[k].light > 0) {
        rows[keyframes_[k].light].push_back(static_cast<Eigen::Index>(k));
      }
    }
    std::vector<std::pair<float, std::vector<Eigen::Index>>> lights;
    for (auto& [light, of] : rows) {
      const auto [mean, weight] = mean_of(pictures, of);
      lights.emplace_back((mean * weight).sum() / std::max(weight.sum(), kShown), std::move(of));
    }
    std::sort(lights.begin(), lights.end());
    std::vector<std::vector<Eigen::Index>> out;
    out.reserve(lights.size());
    for (auto& [brightness, of] : lights) {
      out.push_back(std::move(of));
    }
    return out;
  }

  /// A light of a burst that is a lamp.
  struct FoundLamp {
    std::vector<Eigen::Index> rows;  ///< of its pictures
    std::vector<LitPicture> pictures;
    BurstLamp lamp;
  };

  struct FoundLamps {
    Eigen::ArrayXf dark;  ///< [texel_count] what the room's light alone shows
    std::vector<FoundLamp> lamps;
  };

  FoundLamps find_lamps(const LitSurface& surface, const AlbedoPrior& albedo,
                        const ShadedPictures& pictures) const {
    FoundLamps out;
    const std::vector<std::vector<Eigen::Index>> lights = burst_lights(pictures);
    if (lights.size() < 2) {
      return out;
    }
    Eigen::ArrayXf known;
    std::tie(out.dark, known) = mean_of(pictures, lights.front());
    known = (known > kShown).cast<float>();
    for (auto rows = lights.begin() + 1; rows != lights.end(); ++rows) {
      between_();
      std::vector<LitPicture> lit;
      lit.reserve(rows->size());
      for (const Eigen::Index k : *rows) {
        lit.push_back({poses_[static_cast<std::size_t>(k)], pictures.brightness.row(k),
                       known * pictures.weight.row(k).transpose().array()});
      }
      std::optional<BurstLamp> lamp =
          find_burst_lamp(surface, visibility_, lit, out.dark, albedo.brightness, albedo.usual_brightness);
      if (!lamp || lamp->unexplained > kMostUnexplained) {
        continue;
      }
      // Some of the skin got more light without: that was no dark picture.
      const auto [mean, weight] = mean_of(pictures, *rows);
      const float exposure = std::accumulate(lamp->exposure.begin(), lamp->exposure.end(), 0.0F) /
                             static_cast<float>(lamp->exposure.size());
      const float least = -kLess * albedo.usual_brightness;
      const Eigen::ArrayXf less = (mean - exposure * out.dark < least).cast<float>();
      if ((known * weight * less).sum() <= kMostLess * (known * weight).sum()) {
        out.lamps.push_back({*rows, std::move(lit), std::move(*lamp)});
      }
    }
    return out;
  }

  /// Whether lamps stand around a face far enough from each other that it tells their light from the room's.
  bool stand_apart(const std::vector<FoundLamp>& lamps) const {
    float least = 1;  // cosine
    for (const FoundLamp& a : lamps) {
      const Eigen::Vector3f middle_mm = a.pictures.front().camera_from_head * surface_mm_.rowwise().mean();
      for (const FoundLamp& b : lamps) {
        least = std::min(
            least,
            (a.lamp.place_mm - middle_mm).normalized().dot((b.lamp.place_mm - middle_mm).normalized()));
      }
    }
    return least <= kApart;
  }

  /// Of a burst: lamps that are found in its pictures stand for what was found of the light in each, and what
  /// the room gave is taken off. Returns how many.
  int put_lamps(const AlbedoPrior& albedo, ShadedPictures& pictures, std::vector<float>& counts) const {
    const LitSurface surface{texels_, surface_mm_, normals_, triangles_};
    const FoundLamps found = find_lamps(surface, albedo, pictures);
    if (!stand_apart(found.lamps)) {
      return 0;
    }
    for (const auto& [rows, shown, lamp] : found.lamps) {
      for (std::size_t j = 0; j < rows.size(); ++j) {
        const Eigen::Index k = rows[j];
        const LampShading light = lamp_shading(surface, lamp, shown[j].camera_from_head);
        const Eigen::ArrayXf given = shown[j].brightness - lamp.exposure[j] * found.dark;
        const Eigen::ArrayXf trusted = shown[j].weight * light.trust;
        const Eigen::ArrayXf expected = lamp.strength[j] * albedo.brightness * light.shading;
        const Eigen::ArrayXf strength =
            lamp.strength[j] * unevenness(given, expected, trusted, kReliefBound * albedo.usual_brightness);
        pictures.brightness.row(k) = given;
        pictures.weight.row(k) = trusted;
        pictures.shading.row(k) = strength * light.shading;
        pictures.slope_u.row(k) = strength * light.slope_u;
        pictures.slope_v.row(k) = strength * light.slope_v;
        counts[static_cast<std::size_t>(k)] = kLampCounts;
      }
    }
    return static_cast<int>(found.lamps.size());
  }

  /// [height][width] 1 where enough is seen, 0 at the rim and beyond.
  cv::Mat fade(const cv::Mat& seen) const {
    cv::Mat held = cv::Mat::zeros(seen.size(), CV_8U);
    for (Eigen::Index i = 0; i < texels_.count(); ++i) {
      held.ptr<std::uint8_t>()[place(i)] = 1;
    }
    cv::Mat out;
    cv::distanceTransform(held, out, cv::DIST_L2, cv::DIST_MASK_PRECISE);
    const auto texel_mm = static_cast<float>(texels_.texel_mm);
    for (int row = 0; row < out.rows; ++row) {
      for (int column = 0; column < out.cols; ++column) {
        out.at<float>(row, column) = smoothstep(texel_mm * out.at<float>(row, column), 0, kRimMm) *
                                     smoothstep(seen.at<float>(row, column), kFewestSeen, kEnoughSeen);
      }
    }
    return out;
  }

  const std::vector<Keyframe>& keyframes_;
  const std::function<void()>& between_;
  mesh::Triangles triangles_;
  TextureChart chart_;
  mesh::Vertices surface_mm_;  ///< head frame
  Eigen::Matrix3Xf normals_;   ///< of its vertices
  SkinTexels texels_;
  light::HeadVisibility visibility_;
  SkinLight light_;
  std::vector<Shot> shots_;
  std::vector<Eigen::Isometry3f> poses_;  ///< [keyframe] camera from head
  SkinSamples all_;
};

/// Of the head as enrolment gives it over the head as the solver has it.
double scale_of(const ShapeSolver& solver) {
  const auto size = [](Eigen::Matrix3Xd vertices) {
    vertices.colwise() -= vertices.rowwise().mean().eval();
    return vertices.norm();
  };
  return size(solver.control_in_gauge()) / std::max(size(solver.control()), 1e-9);
}

}  // namespace

Skin find_skin(const face::FaceModel& model, int chart_texels, const std::vector<Keyframe>& keyframes,
               const ShapeSolver& solver, const Eigen::Vector2d& centre_px,
               const std::function<void()>& between) {
  return SkinSolve(model, chart_texels, keyframes, solver, centre_px, between).run(scale_of(solver));
}

int skin_pieces(int keyframes, int lights) {
  return (1 + kRegistrations) * keyframes + kTurns + 2 + std::max(lights - 1, 0);
}

}  // namespace facet::person
