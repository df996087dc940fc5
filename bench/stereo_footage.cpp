#include "stereo_footage.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "facet/error.hpp"
#include "maths/srgb.hpp"
#include "render/renderer.hpp"
#include "simulation/virtual_booth.hpp"
#include "support/stereo_scene.hpp"

namespace facet::bench {
namespace {

using facet::test::StereoScene;

StereoScene::Surface surface_of(const std::string& name) {
  if (name == "plane") {
    return StereoScene::Surface::Plane;
  }
  if (name == "sphere") {
    return StereoScene::Surface::Sphere;
  }
  if (name == "wave") {
    return StereoScene::Surface::Wave;
  }
  if (name == "step") {
    return StereoScene::Surface::Step;
  }
  throw Error(ErrorKind::Usage, fmt::format("no scene {}: plane, sphere, wave, step", name));
}

/// Surface that lies in the right picture and is not hidden there.
std::vector<bool> seen_by_both(const stereo::Rectification& rectification,
                               const std::vector<float>& truth_mm) {
  const int width = rectification.left().width_px;
  const int height = rectification.left().height_px;
  std::vector<bool> seen(truth_mm.size(), false);
  std::vector<double> nearest(static_cast<std::size_t>(width));
  for (int y = 0; y < height; ++y) {
    const std::size_t first = static_cast<std::size_t>(y) * static_cast<std::size_t>(width);
    std::fill(nearest.begin(), nearest.end(), -1e9);
    for (const bool marking : {true, false}) {
      for (int x = 0; x < width; ++x) {
        const std::size_t at = first + static_cast<std::size_t>(x);
        if (!(truth_mm[at] > 0)) {
          continue;
        }
        const double d = rectification.disparity_px(static_cast<double>(truth_mm[at]));
        const auto there = static_cast<int>(std::lround(x - d));
        if (there < 3 || there >= width - 3) {
          continue;
        }
        double& most = nearest[static_cast<std::size_t>(there)];
        if (marking) {
          most = std::max(most, d);
        } else {
          seen[at] = d >= most - 1.5;
        }
      }
    }
  }
  return seen;
}

/// Judges the period in the middle.
void judge_middle(StereoFootage& footage) {
  footage.first_judged = (footage.slots.size() - 1) / 2 / 3 * 3;
  footage.past_judged = std::min(footage.slots.size(), footage.first_judged + 3);
}

}  // namespace

StereoFootage scene_footage(const std::string& name, const SceneOptions& options) {
  StereoScene scene(options.width_px, options.height_px);
  scene.surface = surface_of(name);
  scene.seed = options.seed;
  scene.speed_mm_per_slot = options.speed_mm_per_slot;
  scene.stripe_mm = options.stripe_mm;
  scene.noise = options.noise;
  const int slots = options.slots;
  StereoFootage out;
  out.name = name;
  out.rig = scene.rig;
  out.pair = scene.rig.pairs.front();
  out.depths = {660, 840};
  out.width_px = options.width_px;
  out.height_px = options.height_px;
  out.slots.resize(static_cast<std::size_t>(slots));
  out.truth_mm.resize(out.slots.size());
  out.seen.resize(out.slots.size());
  out.nothing.resize(out.slots.size());
  const stereo::Rectification rectification = out.rectification();
  out.lens = rectification.left();
  render::for_each_row(slots, [&](int slot) {
    const auto at = static_cast<std::size_t>(slot);
    out.slots[at].left = scene.picture(out.pair.left, slot);
    out.slots[at].right = scene.picture(out.pair.right, slot);
    out.slots[at].has_pattern = StereoScene::has_pattern(slot);
    const std::vector<double> depth = scene.depth_mm(rectification.left(), slot);
    out.truth_mm[at].assign(depth.begin(), depth.end());
    out.seen[at] = seen_by_both(rectification, out.truth_mm[at]);
    for (const float truth : out.truth_mm[at]) {
      out.nothing[at].push_back(!(truth > 0));
    }
  });
  judge_middle(out);
  return out;
}

namespace {

/// Adds a slot's truth as footage.lens sees it. camera: whose picture the lens is, with its distortion;
/// other: what must see a point too for it to be judged.
void add_truth(const simulation::VirtualBooth& booth, const simulation::BoothSlot& shot, std::size_t camera,
               const capture::Lens& other, StereoFootage& footage) {
  const capture::Lens& lens = footage.lens;
  const CameraIntrinsics intrinsics{static_cast<float>(lens.fx_px),
                                    static_cast<float>(lens.fy_px),
                                    static_cast<float>(lens.cx_px),
                                    static_cast<float>(lens.cy_px),
                                    lens.width_px,
                                    lens.height_px};
  const Eigen::Vector3f other_centre = (lens.camera_from_rig * other.centre_mm()).cast<float>();
  const Eigen::Isometry3d rig_from_lens = lens.camera_from_rig.inverse();
  const simulation::TruthMesh surface = shot.surface();
  const mesh::Vertices vertices =
      (lens.camera_from_rig.cast<float>() * surface.vertices_mm.colwise().homogeneous()).eval();
  const render::Raycaster raycaster(vertices, surface.triangles);
  const render::HitImage hits = raycaster.cast(intrinsics);
  const Eigen::MatrixXf skin = render::interpolate(hits, surface.triangles, booth.skin().transpose());
  const std::size_t count = hits.depth_mm.size();
  std::vector<std::uint8_t> seen(count, 0);
  const auto point_at = [&](int x, int y, double depth) {
    return Eigen::Vector3d(depth *
                           Eigen::Vector3d((x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px, 1));
  };
  render::for_each_row(lens.height_px, [&](int y) {
    for (int x = 0; x < lens.width_px; ++x) {
      const std::size_t at =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(lens.width_px) + static_cast<std::size_t>(x);
      const double depth = static_cast<double>(hits.depth_mm[at]);
      if (depth > 0 && skin(0, static_cast<Eigen::Index>(at)) > 0.5F) {
        const Eigen::Vector3d point = point_at(x, y, depth);
        const auto there = other.project(rig_from_lens * point);
        seen[at] = there && there->x() >= 3 && there->x() < other.width_px - 4 &&
                           !raycaster.occluded(point.cast<float>(), other_centre, 1.0F)
                       ? 1
                       : 0;
      }
    }
  });
  // Hair, neck and eyes are in the pictures and not in the surface.
  const simulation::DepthTruth whole = shot.depth(camera);
  const capture::Lens& picture = booth.rig().cameras[camera].lens;
  std::vector<bool> nothing(count, false);
  for (std::size_t at = 0; at < count; ++at) {
    const auto width = static_cast<std::size_t>(lens.width_px);
    const auto pixel = picture.project(
        rig_from_lens * point_at(static_cast<int>(at % width), static_cast<int>(at / width), 1));
    bool empty = !(hits.depth_mm[at] > 0);
    for (int k = 0; pixel && empty && k < 9; ++k) {
      const int x = static_cast<int>(std::lround(pixel->x())) + k % 3 - 1;
      const int y = static_cast<int>(std::lround(pixel->y())) + k / 3 - 1;
      empty = x < 0 || y < 0 || x >= whole.width_px || y >= whole.height_px ||
              !(whole.depth_mm[static_cast<std::size_t>(y) * static_cast<std::size_t>(whole.width_px) +
                               static_cast<std::size_t>(x)] > 0);
    }
    nothing[at] = empty;
  }
  footage.nothing.push_back(std::move(nothing));
  footage.truth_mm.push_back(hits.depth_mm);
  footage.seen.emplace_back(seen.begin(), seen.end());
}

StereoFootage empty_footage(const simulation::VirtualBooth& booth, const std::string& name,
                            std::size_t pair) {
  StereoFootage out;
  out.name = name;
  out.rig = booth.rig();
  out.pair = out.rig.pairs.at(pair);
  out.depths = {880, 1130};
  out.width_px = 640;
  out.height_px = 480;
  out.lens = out.rectification().left();
  return out;
}

}  // namespace

simulation::VirtualBoothConfig booth_config(const std::string& name, const SceneOptions& options) {
  simulation::VirtualBoothConfig config;
  config.seed = options.seed;
  if (name == "actor") {
    config.scene = simulation::BoothScene::Actor;
  } else if (name == "still") {
    config.scene = simulation::BoothScene::Actor;
    config.pose_s = options.first_slot / config.slots_per_second;
  } else if (name == "booth-plane") {
    config.scene = simulation::BoothScene::Plane;
  } else if (name == "booth-sphere") {
    config.scene = simulation::BoothScene::Sphere;
  } else {
    throw Error(ErrorKind::Usage, fmt::format("no scene {}: actor, still, booth-plane, booth-sphere", name));
  }
  return config;
}

StereoFootage booth_footage(const simulation::VirtualBooth& booth, const std::string& name, std::size_t pair,
                            const SceneOptions& options) {
  StereoFootage out = empty_footage(booth, name, pair);
  const stereo::Rectification rectification = out.rectification();
  for (int slot = 0; slot < options.slots; ++slot) {
    const auto number = static_cast<std::uint64_t>(options.first_slot + slot);
    const simulation::BoothSlot shot = booth.slot(number, options.program);
    const capture::SlotLight& light = capture::light_of_slot(options.program, number);
    stereo::StereoSlot& pictures = out.slots.emplace_back();
    pictures.left = shot.frame(out.pair.left);
    pictures.right = shot.frame(out.pair.right);
    pictures.has_pattern = light.has_pattern();
    const bool blank = light.kind == capture::SlotLight::Kind::Blank;
    if (blank || light.kind == capture::SlotLight::Kind::Fringes) {
      pictures.fringes = {light.quarters / 4.0, blank};
    }
    add_truth(booth, shot, out.pair.left, rectification.right(), out);
  }
  judge_middle(out);
  return out;
}

namespace {

/// What each of 4 + order slots counts for: that of a set of four shifts, binomially averaged with the sets
/// that begin one slot later and so on (arXiv:2404.06693).
std::vector<double> compensating_weights(int order) {
  std::vector<double> weights(4, 1);
  for (int k = 0; k < order; ++k) {
    weights.push_back(0);
    for (std::size_t i = weights.size() - 1; i > 0; --i) {
      weights[i] = (weights[i] + weights[i - 1]) / 2;
    }
    weights[0] /= 2;
  }
  return weights;
}

}  // namespace

CodedFootage coded_footage(const simulation::VirtualBooth& booth, const std::string& name, std::size_t pair,
                           const SceneOptions& options, const scan::DecodeOptions& decode) {
  CodedFootage out;
  out.pair = empty_footage(booth, name, pair);
  out.projector = out.pair;
  out.left_camera = out.pair.pair.left;
  out.projector_index = pair;  // the one on the pair's side
  const capture::Rig& rig = booth.rig();
  const capture::Lens& light = rig.projectors.at(out.projector_index).lens;
  capture::PatternConfig config = booth.config().patterns;
  config.width_px = light.width_px;
  config.height_px = light.height_px;
  const auto decoder_of = [&](std::size_t camera) {
    return scan::PhaseDecoder(options.sequence, rig.cameras[camera].lens.width_px,
                              rig.cameras[camera].lens.height_px, decode);
  };
  if (options.compensation >= 0 &&
      (options.compensation % 2 == 0 || options.compensation > 9 || options.first_slot < 8 ||
       std::any_of(options.sequence.columns.fringes.begin(), options.sequence.columns.fringes.end(),
                   [](const capture::FringeSet& set) { return set.shifts != 4; }))) {
    throw Error(ErrorKind::Usage,
                "self-compensation is of order 1, 3 to 9, of sets of 4 shifts (phase:4x64), from slot 8 on");
  }
  scan::PhaseDecoder left = decoder_of(out.pair.pair.left);
  scan::PhaseDecoder right = decoder_of(out.pair.pair.right);
  const auto grey_of = [](const Frame& frame) {
    std::vector<float> grey;
    for (int y = 0; y < frame.height_px; ++y) {
      for (int x = 0; x < frame.width_px; ++x) {
        grey.push_back(static_cast<float>(frame.row(y)[4 * x]) / 255);
      }
    }
    return grey;
  };
  const auto shot_of = [&](std::size_t picture, int slot) {
    std::vector<capture::GreyImage> shown(rig.projectors.size());
    shown[out.projector_index] = capture::draw_coded(config, options.sequence, picture);
    return booth.slot(static_cast<std::uint64_t>(slot), std::move(shown));
  };
  using Shots = std::array<std::vector<float>, 2>;
  const std::array<std::size_t, 2> cameras = {out.pair.pair.left, out.pair.pair.right};
  for (std::size_t picture = 0; picture < options.sequence.pictures.size(); ++picture) {
    const capture::CodedPicture& coded = options.sequence.pictures[picture];
    const bool is_compensated = options.compensation >= 0 && coded.kind == capture::CodedPicture::Kind::Phase;
    Shots shots;
    if (is_compensated) {
      const std::vector<double> weights = compensating_weights(options.compensation);
      const int before = static_cast<int>(weights.size() - 1) / 2;
      for (std::size_t k = static_cast<std::size_t>(coded.index); k < weights.size(); k += 4) {
        const simulation::BoothSlot shot =
            shot_of(picture, options.first_slot - before + static_cast<int>(k));
        for (std::size_t c = 0; c < 2; ++c) {
          const std::vector<float> grey = grey_of(shot.frame(cameras[c]));
          shots[c].resize(grey.size());
          for (std::size_t i = 0; i < grey.size(); ++i) {
            shots[c][i] += static_cast<float>(weights[k]) * maths::decode_srgb(grey[i]);
          }
        }
      }
      for (std::vector<float>& shot : shots) {
        std::transform(shot.begin(), shot.end(), shot.begin(), maths::encode_srgb);
      }
    } else {
      // Of a moving actor the Gray code is that of the middle: the best that it could be.
      const simulation::BoothSlot shot =
          shot_of(picture, options.compensation >= 0 ? options.first_slot
                                                     : options.first_slot + static_cast<int>(picture));
      shots = {grey_of(shot.frame(cameras[0])), grey_of(shot.frame(cameras[1]))};
    }
    left.add(picture, shots[0]);
    right.add(picture, shots[1]);
  }
  out.left = left.decode();
  out.right = right.decode();
  const simulation::BoothSlot shot = booth.slot(static_cast<std::uint64_t>(options.first_slot));
  add_truth(booth, shot, out.left_camera, out.pair.rectification().right(), out.pair);
  out.projector.lens = rig.cameras[out.left_camera].lens;
  out.projector.lens.distortion = {};
  add_truth(booth, shot, out.left_camera, light, out.projector);
  for (StereoFootage* footage : {&out.pair, &out.projector}) {
    footage->slots.resize(1);
    footage->past_judged = 1;
  }
  return out;
}

}  // namespace facet::bench
