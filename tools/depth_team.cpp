#include "depth_team.hpp"

#include <array>
#include <cstdlib>
#include <cstring>
#include <span>
#include <stdexcept>
#include <utility>

#include "facet/error.hpp"

namespace facet::tools {
namespace {

/// Plain data of a map, as it travels.
struct MapHeader {
  std::int32_t width_px = 0;
  std::int32_t height_px = 0;
  double fx_px = 0;
  double fy_px = 0;
  double cx_px = 0;
  double cy_px = 0;
  std::array<double, 16> camera_from_rig{};
};

template <typename T>
void put(std::vector<char>& bytes, const T* values, std::size_t count) {
  if (count > 0) {
    const std::size_t at = bytes.size();
    bytes.resize(at + count * sizeof(T));
    std::memcpy(bytes.data() + at, values, count * sizeof(T));
  }
}

/// Reads what put wrote, from a member of the same program.
class Taker {
 public:
  explicit Taker(std::span<const char> bytes) : bytes_(bytes) {}
  template <typename T>
  void take(T* values, std::size_t count) {
    if (count > bytes_.size() / sizeof(T)) {
      throw Error(ErrorKind::Internal,
                  "a message of another process of the team is cut off: do all run one version?");
    }
    std::memcpy(values, bytes_.data(), count * sizeof(T));
    bytes_ = bytes_.subspan(count * sizeof(T));
  }
  template <typename T>
  T take() {
    T value{};
    take(&value, 1);
    return value;
  }

 private:
  std::span<const char> bytes_;
};

void put_map(std::vector<char>& bytes, const capture::DepthMap& map) {
  MapHeader header{
      map.width_px, map.height_px, map.lens.fx_px, map.lens.fy_px, map.lens.cx_px, map.lens.cy_px, {}};
  Eigen::Map<Eigen::Matrix4d>(header.camera_from_rig.data()) = map.lens.camera_from_rig.matrix();
  put(bytes, &header, 1);
  put(bytes, map.depth_mm.data(), map.depth_mm.size());
  put(bytes, map.sigma_mm.data(), map.sigma_mm.size());
  put(bytes, map.confidence.data(), map.confidence.size());
}

capture::DepthMap take_map(Taker& taker) {
  constexpr std::int32_t kMostSide_px = 1 << 15;
  const auto header = taker.take<MapHeader>();
  if (header.width_px < 0 || header.width_px > kMostSide_px || header.height_px < 0 ||
      header.height_px > kMostSide_px) {
    throw Error(ErrorKind::Internal, "a message of another process of the team makes no sense");
  }
  capture::DepthMap map;
  map.width_px = map.lens.width_px = header.width_px;
  map.height_px = map.lens.height_px = header.height_px;
  map.lens.fx_px = header.fx_px;
  map.lens.fy_px = header.fy_px;
  map.lens.cx_px = header.cx_px;
  map.lens.cy_px = header.cy_px;
  map.lens.camera_from_rig.matrix() = Eigen::Map<const Eigen::Matrix4d>(header.camera_from_rig.data());
  const auto count = static_cast<std::size_t>(map.width_px) * static_cast<std::size_t>(map.height_px);
  for (std::vector<float>* values : {&map.depth_mm, &map.sigma_mm, &map.confidence}) {
    values->resize(count);
    taker.take(values->data(), count);
  }
  return map;
}

}  // namespace

void Team::abort(int status) const {
  std::_Exit(status);
}

void Team::share(std::vector<std::uint64_t>&) const {}

// NOLINTNEXTLINE(performance-unnecessary-value-param): those that send keep the bytes
void Team::send(std::vector<char>, const stereo::Alive&) {
  throw std::logic_error("a process that is alone has no leader");
}

void Team::finish_sending(const stereo::Alive&) {}

std::vector<char> Team::receive(int, const stereo::Alive&) {
  throw std::logic_error("a process that is alone has no other members");
}

std::unique_ptr<Team> join_nobody() {
  // What Open MPI's mpirun tells the processes that it starts.
  const char* size = std::getenv("OMPI_COMM_WORLD_SIZE");
  if (size != nullptr && std::string(size) != "1") {
    throw Error(ErrorKind::Usage,
                "several processes share a take's work as `facet-team process`, not as `facet process`");
  }
  return std::make_unique<Team>();
}

SharedDepth::SharedDepth(std::unique_ptr<booth::DepthSource> own, Team& team,
                         std::shared_ptr<report::DepthFolder> folder)
    : own_(std::move(own)), team_(team), folder_(std::move(folder)) {
  std::vector<std::uint64_t> kept;
  if (folder_ != nullptr) {
    kept.assign(folder_->kept().begin(), folder_->kept().end());
  }
  team_.share(kept);
  kept_.insert(kept.begin(), kept.end());
}

SharedDepth::~SharedDepth() {
  team_.finish_sending([] {});
}

std::string SharedDepth::device() const {
  return team_.size() == 1 ? own_->device()
                           : own_->device() + " and those of " + std::to_string(team_.size() - 1) + " others";
}

std::string SharedDepth::find(std::uint64_t first_slot, std::span<const booth::DepthSlot> slots,
                              std::vector<std::vector<capture::DepthMap>>& maps, const stereo::Alive& alive) {
  maps.clear();
  bool kept = true;
  for (std::size_t i = 0; i < slots.size(); ++i) {
    if (slots[i].wanted) {
      kept = kept && kept_.contains(first_slot + i);
      maps.emplace_back();
    }
  }
  if (kept) {
    std::size_t at = 0;
    for (std::size_t i = 0; i < slots.size() && team_.leads(); ++i) {
      if (slots[i].wanted) {
        maps[at++] = folder_->read(first_slot + i);
      }
    }
    return {};
  }
  const int member = run_++ % team_.size();
  if (member == team_.rank()) {
    std::string wrong = own_->find(first_slot, slots, maps, alive);
    if (!team_.leads()) {
      send(maps, wrong, alive);
    }
    return wrong;
  }
  return team_.leads() ? receive(member, maps, alive) : std::string();
}

void SharedDepth::send(const std::vector<std::vector<capture::DepthMap>>& maps, const std::string& wrong,
                       const stereo::Alive& alive) {
  std::vector<char> bytes;
  const auto length = static_cast<std::uint32_t>(wrong.size());
  put(bytes, &length, 1);
  put(bytes, wrong.data(), wrong.size());
  for (const auto& pairs : maps) {
    const auto count = static_cast<std::uint32_t>(pairs.size());
    put(bytes, &count, 1);
    for (const capture::DepthMap& map : pairs) {
      put_map(bytes, map);
    }
  }
  team_.send(std::move(bytes), alive);
}

std::string SharedDepth::receive(int member, std::vector<std::vector<capture::DepthMap>>& maps,
                                 const stereo::Alive& alive) {
  const std::vector<char> bytes = team_.receive(member, alive);
  Taker taker(bytes);
  std::string wrong(taker.take<std::uint32_t>(), ' ');
  taker.take(wrong.data(), wrong.size());
  for (auto& pairs : maps) {
    const auto count = taker.take<std::uint32_t>();
    for (std::uint32_t pair = 0; pair < count; ++pair) {
      pairs.push_back(take_map(taker));
    }
  }
  return wrong;
}

}  // namespace facet::tools
