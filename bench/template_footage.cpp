#include "template_footage.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>

#include "facet/error.hpp"
#include "render/renderer.hpp"

namespace facet::bench {
namespace {

std::vector<char> bytes_of(const float* values, std::size_t count) {
  std::vector<char> bytes(count * sizeof(float));
  std::memcpy(bytes.data(), values, bytes.size());
  return bytes;
}

}  // namespace

capture::DepthMap depth_of(const simulation::TruthMesh& truth, capture::Lens lens, double noise_mm,
                           std::mt19937_64& random) {
  lens.distortion = {};
  const Eigen::Isometry3f camera_from_rig = lens.camera_from_rig.cast<float>();
  const mesh::Vertices seen =
      (camera_from_rig.linear() * truth.vertices_mm).colwise() + camera_from_rig.translation();
  const render::Raycaster caster(seen, truth.triangles);
  const CameraIntrinsics camera{static_cast<float>(lens.fx_px),
                                static_cast<float>(lens.fy_px),
                                static_cast<float>(lens.cx_px),
                                static_cast<float>(lens.cy_px),
                                lens.width_px,
                                lens.height_px};
  capture::DepthMap map;
  map.width_px = lens.width_px;
  map.height_px = lens.height_px;
  map.lens = lens;
  map.depth_mm = caster.cast(camera).depth_mm;
  map.confidence.resize(map.depth_mm.size());
  map.sigma_mm.resize(map.depth_mm.size());
  std::normal_distribution<double> noise(0, std::max(noise_mm, 1e-9));
  for (std::size_t i = 0; i < map.depth_mm.size(); ++i) {
    if (map.depth_mm[i] > 0) {
      map.depth_mm[i] += static_cast<float>(noise_mm > 0 ? noise(random) : 0);
      map.confidence[i] = 1;
      map.sigma_mm[i] = static_cast<float>(noise_mm);
    }
  }
  return map;
}

void add_noise(Frame& frame, std::mt19937_64& random) {
  constexpr double kLevels = 1.5;
  std::normal_distribution<double> noise(0, kLevels);
  const std::size_t size = frame.stride_bytes * static_cast<std::size_t>(frame.height_px);
  auto pixels = std::make_shared<std::uint8_t[]>(size);
  for (std::size_t i = 0; i < size; ++i) {
    const auto at = static_cast<std::ptrdiff_t>(i);
    pixels[at] = static_cast<std::uint8_t>(
        std::lround(std::clamp(static_cast<double>(frame.pixels[at]) + noise(random), 0.0, 255.0)));
  }
  frame.pixels = std::move(pixels);
}

StereoDepth::StereoDepth(gpu::Context& context, const simulation::VirtualBooth& booth) : booth_(booth) {
  stereo::StereoOptions options;
  options.depths = {850, 1250};
  options.most_slots = kSlots;
  for (const capture::StereoPair& pair : booth.rig().pairs) {
    matchers_.push_back(std::make_unique<stereo::StereoMatcher>(context, booth.rig(), pair, options));
  }
}

std::vector<capture::DepthMap> StereoDepth::at(std::uint64_t blank) {
  std::vector<capture::DepthMap> result;
  std::vector<std::vector<stereo::StereoSlot>> slots(matchers_.size());
  for (int i = 0; i < kSlots; ++i) {
    const simulation::BoothSlot slot = booth_.slot(blank + static_cast<std::uint64_t>(i) - kSlots / 2);
    for (std::size_t p = 0; p < matchers_.size(); ++p) {
      const capture::StereoPair& pair = booth_.rig().pairs[p];
      slots[p].push_back({slot.frame(pair.left),
                          slot.frame(pair.right),
                          slot.shown().kind == capture::Shown::Kind::Stripes,
                          {}});
    }
  }
  for (std::size_t p = 0; p < matchers_.size(); ++p) {
    if (matchers_[p]->match(slots[p], maps_) != stereo::StereoOutcome::Done) {
      throw Error(ErrorKind::Internal, matchers_[p]->failure());
    }
    result.push_back(std::move(maps_[kSlots / 2]));
  }
  return result;
}

Footage::Footage(const simulation::VirtualBooth& booth, std::filesystem::path folder)
    : booth_(booth), folder_(std::move(folder)), triangles_(booth.slot(0).surface().triangles) {
  if (!folder_.empty()) {
    const simulation::VirtualBoothConfig& config = booth.config();
    folder_ /= fmt::format("{}-{}-{}{}", config.seed, config.samples, config.head_motion,
                           config.actor_seed ? fmt::format("-{}", *config.actor_seed) : "");
    std::filesystem::create_directories(folder_);
  }
}

simulation::TruthMesh Footage::truth(std::uint64_t slot) const {
  simulation::TruthMesh mesh;
  const auto bytes = kept(fmt::format("{}-truth", slot), [&] {
    const mesh::Vertices vertices_mm = booth_.slot(slot).surface().vertices_mm;
    return bytes_of(vertices_mm.data(), static_cast<std::size_t>(vertices_mm.size()));
  });
  mesh.vertices_mm.resize(3, static_cast<Eigen::Index>(bytes.size() / (3 * sizeof(float))));
  std::memcpy(mesh.vertices_mm.data(), bytes.data(), bytes.size());
  mesh.triangles = triangles_;
  mesh::vertex_normals(mesh.vertices_mm, mesh.triangles, mesh.normals);
  return mesh;
}

Frame Footage::picture(std::uint64_t slot, std::size_t camera) const {
  const capture::Lens& lens = booth_.rig().cameras[camera].lens;
  Frame frame;
  frame.width_px = lens.width_px;
  frame.height_px = lens.height_px;
  frame.stride_bytes = 4 * static_cast<std::size_t>(lens.width_px);
  const std::size_t size = frame.stride_bytes * static_cast<std::size_t>(lens.height_px);
  const auto bytes = kept(fmt::format("{}-camera{}", slot, camera), [&] {
    const Frame seen = booth_.slot(slot).frame(camera);
    std::vector<char> pixels(size);
    for (int y = 0; y < seen.height_px; ++y) {
      std::memcpy(pixels.data() + static_cast<std::size_t>(y) * frame.stride_bytes, seen.row(y),
                  frame.stride_bytes);
    }
    return pixels;
  });
  auto pixels = std::make_shared<std::uint8_t[]>(size);
  std::memcpy(pixels.get(), bytes.data(), size);
  frame.pixels = std::move(pixels);
  return frame;
}

std::vector<capture::DepthMap> Footage::stereo(std::uint64_t slot, StereoDepth& matchers) const {
  std::vector<capture::DepthMap> maps;
  for (std::size_t p = 0; p < booth_.rig().pairs.size(); ++p) {
    const auto bytes = kept(fmt::format("{}-stereo{}", slot, p), [&] {
      if (maps_slot_ != slot || maps_.empty()) {
        maps_ = matchers.at(slot);
        maps_slot_ = slot;
      }
      const capture::DepthMap& map = maps_[p];
      std::vector<float> values(map.depth_mm);
      values.insert(values.end(), map.sigma_mm.begin(), map.sigma_mm.end());
      values.insert(values.end(), map.confidence.begin(), map.confidence.end());
      for (const double value : {static_cast<double>(map.width_px), static_cast<double>(map.height_px),
                                 map.lens.fx_px, map.lens.fy_px, map.lens.cx_px, map.lens.cy_px}) {
        values.push_back(static_cast<float>(value));
      }
      for (Eigen::Index i = 0; i < 16; ++i) {
        values.push_back(static_cast<float>(map.lens.camera_from_rig.matrix()(i % 4, i / 4)));
      }
      return bytes_of(values.data(), values.size());
    });
    constexpr std::size_t kLensValues = 6 + 16;
    std::vector<float> values(bytes.size() / sizeof(float));
    std::memcpy(values.data(), bytes.data(), bytes.size());
    const std::size_t pixels = (values.size() - kLensValues) / 3;
    const float* lens = values.data() + 3 * pixels;
    capture::DepthMap& map = maps.emplace_back();
    map.width_px = map.lens.width_px = static_cast<int>(lens[0]);
    map.height_px = map.lens.height_px = static_cast<int>(lens[1]);
    map.lens.fx_px = static_cast<double>(lens[2]);
    map.lens.fy_px = static_cast<double>(lens[3]);
    map.lens.cx_px = static_cast<double>(lens[4]);
    map.lens.cy_px = static_cast<double>(lens[5]);
    for (Eigen::Index i = 0; i < 16; ++i) {
      map.lens.camera_from_rig.matrix()(i % 4, i / 4) = static_cast<double>(lens[6 + i]);
    }
    map.depth_mm.assign(values.data(), values.data() + pixels);
    map.sigma_mm.assign(values.data() + pixels, values.data() + 2 * pixels);
    map.confidence.assign(values.data() + 2 * pixels, values.data() + 3 * pixels);
  }
  return maps;
}

std::vector<char> Footage::kept(const std::string& name,
                                const std::function<std::vector<char>()>& make) const {
  if (folder_.empty()) {
    return make();
  }
  const std::filesystem::path file = folder_ / name;
  if (std::ifstream in(file, std::ios::binary | std::ios::ate); in) {
    std::vector<char> bytes(static_cast<std::size_t>(in.tellg()));
    in.seekg(0);
    in.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    return bytes;
  }
  std::vector<char> bytes = make();
  std::ofstream(file, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  return bytes;
}

}  // namespace facet::bench
