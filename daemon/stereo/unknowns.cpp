#include "stereo/unknowns.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "facet/error.hpp"

namespace facet::stereo {
namespace {

using shaders::stereo::Band;
using shaders::stereo::kAlongYBits;
using shaders::stereo::kMost_px;
using shaders::stereo::kMostSlots;

std::size_t cells(int x, int y, int t) {
  return static_cast<std::size_t>(x) * static_cast<std::size_t>(y) * static_cast<std::size_t>(t);
}

}  // namespace

Unknowns::Unknowns(const VolumeSize& size, int radius_x, int radius_y, int radius_t, int band_rows)
    : size_(size), rx_(radius_x), ry_(radius_y), rt_(radius_t), band_rows_(band_rows) {
  const auto width = static_cast<std::uint32_t>(size.width_px);
  const auto slots = static_cast<std::uint32_t>(size.slots);
  if (width > kMost_px || static_cast<std::uint32_t>(size.height_px) > kMost_px || slots > kMostSlots ||
      width * slots >= 1U << kAlongYBits) {
    throw Error(ErrorKind::Usage, fmt::format("a stereo volume of {} x {} x {} voxels is too large",
                                              size.width_px, size.height_px, size.slots));
  }
  const auto band_count = static_cast<std::size_t>((size.height_px + band_rows - 1) / band_rows);
  boxes_.resize(band_count);
  bands_.resize(band_count);
  row_.resize(static_cast<std::size_t>(width) * slots);
  row_before_.resize(row_.size());
}

void Unknowns::find(std::span<const float> start_px, float break_px, std::size_t most_cells) {
  list_voxels(start_px, break_px);
  link();
  place_bands(most_cells);
}

/// The voxels with the neighbours before them, and the box of each band.
void Unknowns::list_voxels(std::span<const float> start_px, float break_px) {
  constexpr int kFar = std::numeric_limits<int>::max();
  list_.clear();
  voxels_.clear();
  near_.clear();
  std::fill(row_before_.begin(), row_before_.end(), -1);
  const auto width = static_cast<std::size_t>(size_.width_px);
  for (std::size_t b = 0; b < bands_.size(); ++b) {
    Box box{kFar, 0, kFar, 0, kFar, 0};
    bands_[b].places.x = static_cast<std::int32_t>(list_.size());
    const int first_row = static_cast<int>(b) * band_rows_;
    for (int y = first_row; y < std::min(first_row + band_rows_, size_.height_px); ++y) {
      for (int t = 0; t < size_.slots; ++t) {
        const std::size_t first = size_.voxel(0, y, t);
        const float* line = start_px.data() + first;
        std::int32_t* now = row_.data() + static_cast<std::size_t>(t) * width;
        const std::int32_t* above = row_before_.data() + static_cast<std::size_t>(t) * width;
        const auto in_row = list_.size();
        int first_x = 0;
        int last_x = 0;
        for (int x = 0; x < size_.width_px; ++x) {
          now[x] = -1;
          const float own = line[x];
          if (std::isnan(own)) {
            continue;
          }
          const auto at = static_cast<std::int32_t>(list_.size());
          const auto linked = [&](std::int32_t before) {
            return before >= 0 &&
                   std::abs(own - start_px[voxels_[static_cast<std::size_t>(before)]]) <= break_px;
          };
          Near near{-1, -1, -1, -1, x > 0 && now[x - 1] >= 0 && linked(now[x - 1])};
          if (linked(above[x])) {
            near.before_y = above[x];
            near_[static_cast<std::size_t>(above[x])].after_y = at;
          }
          const std::int32_t earlier = t > 0 ? now[x - size_.width_px] : -1;
          if (linked(earlier)) {
            near.before_t = earlier;
            near_[static_cast<std::size_t>(earlier)].after_t = at;
          }
          first_x = list_.size() == in_row ? x : first_x;
          last_x = x;
          now[x] = at;
          near_.push_back(near);
          voxels_.push_back(static_cast<std::uint32_t>(first) + static_cast<std::uint32_t>(x));
          const auto packed =
              static_cast<std::uint32_t>(x) +
              kMost_px * (static_cast<std::uint32_t>(y) + kMost_px * static_cast<std::uint32_t>(t));
          list_.push_back({static_cast<std::int32_t>(packed), 0, 0, 0});
        }
        if (list_.size() > in_row) {
          box = {std::min(box.x, first_x), std::max(box.past_x, last_x + 1), std::min(box.y, y), y + 1,
                 std::min(box.t, t),       std::max(box.past_t, t + 1)};
        }
      }
      std::swap(row_, row_before_);
    }
    bands_[b].places.y = static_cast<std::int32_t>(list_.size());
    boxes_[b] = box;
  }
}

/// The words of the links and the steps to the neighbours.
void Unknowns::link() {
  using namespace shaders::stereo;
  const auto bits = [](bool before, bool after, bool before_before, bool after_after) {
    return (before ? kLinkBefore : 0U) | (after ? kLinkAfter : 0U) | (before_before ? kBeforeHasBefore : 0U) |
           (after_after ? kAfterHasAfter : 0U);
  };
  const auto near = [&](std::int32_t at) -> const Near& { return near_[static_cast<std::size_t>(at)]; };
  const auto step = [](std::int32_t at, std::int32_t other) {
    return other >= 0 ? static_cast<std::uint32_t>(std::abs(at - other)) : 0U;
  };
  const auto has_next = [&](std::size_t at) { return at + 1 < near_.size() && near_[at + 1].before_x; };
  for (std::size_t i = 0; i < list_.size(); ++i) {
    const Near& own = near_[i];
    const auto at = static_cast<std::int32_t>(i);
    std::uint32_t word = bits(own.before_x, has_next(i), own.before_x && near_[i - 1].before_x,
                              has_next(i) && has_next(i + 1));
    word |= bits(own.before_y >= 0, own.after_y >= 0, own.before_y >= 0 && near(own.before_y).before_y >= 0,
                 own.after_y >= 0 && near(own.after_y).after_y >= 0)
            << 4U;
    word |= bits(own.before_t >= 0, own.after_t >= 0, own.before_t >= 0 && near(own.before_t).before_t >= 0,
                 own.after_t >= 0 && near(own.after_t).after_t >= 0)
            << 8U;
    list_[i].y = static_cast<std::int32_t>(word);
    list_[i].z = static_cast<std::int32_t>(step(at, own.before_y) | step(at, own.before_t) << kAlongYBits);
    list_[i].w = static_cast<std::int32_t>(step(at, own.after_y) | step(at, own.after_t) << kAlongYBits);
  }
}

/// Boxes one after the other, and a new part where they would have more cells than a part may.
void Unknowns::place_bands(std::size_t most_cells) {
  most_samples_ = 0;
  most_sums_x_ = 0;
  most_sums_xy_ = 0;
  std::size_t samples = 0;
  std::size_t sums_x = 0;
  std::size_t sums_xy = 0;
  int part = 0;
  for (std::size_t b = 0; b < bands_.size(); ++b) {
    Band& band = bands_[b];
    if (band.places.x == band.places.y) {
      band.origin = {0, 0, 0, part};
      band.extent = {0, 0, 0, 0};
      band.places.z = 0;
      band.places.w = 0;
      continue;
    }
    const Box& box = boxes_[b];
    const int first_slot = std::max(0, box.t - rt_);
    const int width = box.past_x - box.x;
    const int height = box.past_y - box.y;
    const int slots = std::min(size_.slots, box.past_t + rt_) - first_slot;
    const std::size_t own = cells(width, height, slots);
    if (sums_xy > 0 && sums_xy + own > most_cells) {
      ++part;
      samples = 0;
      sums_x = 0;
      sums_xy = 0;
    }
    band.origin = {box.x, box.y, first_slot, part};
    band.extent = {width, height, slots, static_cast<std::int32_t>(samples)};
    band.places.z = static_cast<std::int32_t>(sums_x);
    band.places.w = static_cast<std::int32_t>(sums_xy);
    samples += cells(width + 2 * rx_, height + 2 * ry_, slots);
    sums_x += cells(width, height + 2 * ry_, slots);
    sums_xy += own;
    most_samples_ = std::max(most_samples_, samples);
    most_sums_x_ = std::max(most_sums_x_, sums_x);
    most_sums_xy_ = std::max(most_sums_xy_, sums_xy);
  }
  part_count_ = part + 1;
}

}  // namespace facet::stereo
