#include "service/thumbnails.hpp"

#include <pthread.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <deque>
#include <new>
#include <set>
#include <thread>
#include <utility>

#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "files/output_file.hpp"
#include "mesh/hierarchy.hpp"
#include "render/renderer.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::service {
namespace {

constexpr int kNice = 15;
constexpr std::array<std::uint8_t, 3> kGround{26, 32, 41};

/// A face from the front, by its albedo where there is one, under one soft lamp.
render::Picture draw(const mesh::MeshFrame& frame) {
  const mesh::Hierarchy& hierarchy = *frame.subject->hierarchy;
  mesh::Vertices vertices;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(hierarchy, frame.control_vertices_mm, frame.displacements_mm, vertices, normals);
  // Head frame to that of a camera a metre before it: y and z change signs.
  constexpr float kAway_mm = 1000;
  const Eigen::Vector3f low = vertices.rowwise().minCoeff();
  const Eigen::Vector3f high = vertices.rowwise().maxCoeff();
  const Eigen::Vector3f middle = 0.5F * (low + high);
  const Eigen::Vector3f turn(1, -1, -1);
  vertices = turn.asDiagonal() * (vertices.colwise() - middle);
  vertices.row(2).array() += kAway_mm;
  const mesh::Triangles& triangles = hierarchy.finest().triangles;
  constexpr auto kWidth = static_cast<float>(Thumbnails::kWidth_px);
  constexpr auto kHeight = static_cast<float>(Thumbnails::kHeight_px);
  constexpr float kMargin = 1.12F;
  const float focal_px = kAway_mm * std::min(kWidth / std::max(1.0F, kMargin * (high.x() - low.x())),
                                             kHeight / std::max(1.0F, kMargin * (high.y() - low.y())));
  const CameraIntrinsics camera{focal_px,
                                focal_px,
                                0.5F * (kWidth - 1),
                                0.5F * (kHeight - 1),
                                Thumbnails::kWidth_px,
                                Thumbnails::kHeight_px};
  const bool has_albedo = frame.albedo != nullptr &&
                          frame.albedo->linear_rgb.size() == 3 * static_cast<std::size_t>(vertices.cols());
  const Eigen::Vector3f lamp = Eigen::Vector3f(-0.45F, 0.55F, 0.7F).normalized();
  mesh::Vertices colours(3, vertices.cols());
  for (Eigen::Index v = 0; v < colours.cols(); ++v) {
    const float light = 0.25F + 1.1F * std::max(0.0F, (normals.col(v).dot(lamp) + 0.2F) / 1.2F);
    const Eigen::Vector3f skin =
        has_albedo
            ? Eigen::Vector3f(Eigen::Map<const Eigen::Vector3f>(frame.albedo->linear_rgb.data() + 3 * v))
            : Eigen::Vector3f(0.5F, 0.325F, 0.255F);
    colours.col(v) = light * skin;
  }
  const render::Raycaster caster(vertices, triangles, render::Raycaster::Build::Quick);
  const auto colour = [&](std::int32_t triangle, const Eigen::Vector2f& barycentric) -> Eigen::Vector3f {
    return render::interpolate(triangles, triangle, barycentric, colours);
  };
  return render::render_surface(caster, camera, colour,
                                render::plain_picture(camera.width_px, camera.height_px, kGround));
}

/// The take's mesh nearest to its middle.
std::shared_ptr<const mesh::MeshFrame> middle_mesh(const std::filesystem::path& take) {
  take::TakeReader reader(take);
  const std::int64_t count = reader.frame_count();
  for (std::int64_t step = 0; step <= count; ++step) {
    const std::int64_t index = count / 2 + (step % 2 == 0 ? step / 2 : -(step + 1) / 2);
    if (index >= 0 && index < count && reader.entry(index).has_mesh) {
      return reader.frame(index, take::Pictures::Described);
    }
  }
  return nullptr;
}

}  // namespace

struct Thumbnails::Impl {
  std::filesystem::path folder;
  mutable Mutex mutex;  ///< not held while something is drawn
  Condition woken;
  bool stopping FACET_GUARDED_BY(mutex) = false;
  std::deque<std::string> wanted FACET_GUARDED_BY(mutex);
  /// Takes as they were.
  std::set<std::pair<std::string, std::filesystem::file_time_type>> failed FACET_GUARDED_BY(mutex);
  std::atomic<bool> ended{true};
  std::jthread thread;

  void run();
  void draw_until_stopped();
  std::optional<std::filesystem::file_time_type> try_to_make(const std::string& take) const;
  void make(const std::string& take) const;
};

void Thumbnails::Impl::make(const std::string& take) const {
  const std::filesystem::path of = take::named_take(folder, take);
  const auto mesh = middle_mesh(of);
  if (mesh == nullptr) {
    throw Error(ErrorKind::UnreadableInput, "no mesh");
  }
  const std::filesystem::path to = file(folder, take);
  files::make_folder(to.parent_path());
  render::write_png(draw(*mesh), to);
  // Where the take was deleted or renamed meanwhile no picture of the face stays.
  std::error_code ignored;
  if (!std::filesystem::exists(of, ignored)) {
    std::filesystem::remove(to, ignored);
  }
}

/// Nothing where the picture was made; else of when the take is of which there is none: the page shows none.
std::optional<std::filesystem::file_time_type> Thumbnails::Impl::try_to_make(const std::string& take) const {
  std::filesystem::file_time_type changed;
  try {
    std::error_code ignored;
    changed = std::filesystem::last_write_time(take::named_take(folder, take), ignored);
    make(take);
  } catch (const std::exception&) {
    return changed;
  }
  return std::nullopt;
}

void Thumbnails::Impl::draw_until_stopped() {
  const Lock lock(mutex);
  while (true) {
    woken.wait(mutex, [&]() FACET_REQUIRES(mutex) { return stopping || !wanted.empty(); });
    if (stopping) {
      return;
    }
    // It stays in front while it is drawn, so that it is not asked for again.
    const std::string& take = wanted.front();
    std::optional<std::filesystem::file_time_type> refused;
    {
      const Unlock unlock(mutex);
      refused = try_to_make(take);
    }
    try {
      if (refused) {
        failed.insert({take, *refused});
      }
    } catch (const std::bad_alloc&) {
      // It will be tried once more.
    }
    wanted.pop_front();
  }
}

void Thumbnails::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-pictures");
  ::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), kNice);
  draw_until_stopped();
  ended = true;
}

Thumbnails::Thumbnails(std::filesystem::path folder) : impl_(std::make_unique<Impl>()) {
  impl_->folder = std::move(folder);
}

Thumbnails::~Thumbnails() {
  stop();
}

void Thumbnails::start() {
  impl_->ended = false;
  try {
    impl_->thread = std::jthread([this] { impl_->run(); });
  } catch (...) {
    impl_->ended = true;
    throw;
  }
}

void Thumbnails::request_stop() {
  const Lock lock(impl_->mutex);
  impl_->stopping = true;
  impl_->woken.notify_one();
}

bool Thumbnails::finished() const {
  return impl_->ended;
}

void Thumbnails::stop() {
  request_stop();
  if (impl_->thread.joinable()) {
    impl_->thread.join();
  }
}

std::filesystem::path Thumbnails::file(const std::filesystem::path& folder, const std::string& take) {
  return folder / ".thumbnails" / (take::named_take(folder, take).stem().string() + ".png");
}

std::optional<std::int64_t> Thumbnails::ask(const std::string& take) {
  std::error_code no_take;
  std::error_code no_picture;
  const auto taken = std::filesystem::last_write_time(take::named_take(impl_->folder, take), no_take);
  const auto drawn = std::filesystem::last_write_time(file(impl_->folder, take), no_picture);
  if (no_take) {
    return std::nullopt;
  }
  if (!no_picture && drawn >= taken) {
    return std::chrono::duration_cast<std::chrono::milliseconds>(drawn.time_since_epoch()).count();
  }
  const Lock lock(impl_->mutex);
  if (impl_->failed.count({take, taken}) == 0 &&
      std::find(impl_->wanted.begin(), impl_->wanted.end(), take) == impl_->wanted.end()) {
    impl_->wanted.push_back(take);
    impl_->woken.notify_one();
  }
  return std::nullopt;
}

}  // namespace facet::service
