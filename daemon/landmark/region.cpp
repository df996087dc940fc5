#include "landmark/region.hpp"

#include <algorithm>
#include <cstring>

namespace facet::landmark {
namespace {

constexpr int max_rows_per_box = 8;  ///< rows read of one box: more cost memory bandwidth and gain nothing

using Float4 = float __attribute__((vector_size(16)));
using Int4 = std::int32_t __attribute__((vector_size(16)));
using Short4 = std::uint16_t __attribute__((vector_size(8)));
using Byte16 = std::uint8_t __attribute__((vector_size(16)));

Float4 load(const std::uint8_t* pixel) {
  std::int32_t packed = 0;
  std::memcpy(&packed, pixel, sizeof packed);
  // Bytes to 32-bit lanes in one shuffle; compilers make a dozen instructions of __builtin_convertvector
  // here.
  const auto bytes = reinterpret_cast<Byte16>(Int4{packed, 0, 0, 0});
  const Byte16 spread =
      __builtin_shufflevector(bytes, Byte16{}, 0, 16, 16, 16, 1, 16, 16, 16, 2, 16, 16, 16, 3, 16, 16, 16);
  return __builtin_convertvector(reinterpret_cast<Int4>(spread), Float4);
}

/// Values from 0 to less than 256, cut to integers.
void store(Float4 values, std::uint8_t* pixel) {
  const auto bytes = reinterpret_cast<Byte16>(__builtin_convertvector(values, Int4));
  const auto packed = reinterpret_cast<Int4>(
      __builtin_shufflevector(bytes, bytes, 0, 4, 8, 12, 0, 4, 8, 12, 0, 4, 8, 12, 0, 4, 8, 12));
  const std::int32_t first = packed[0];
  std::memcpy(pixel, &first, sizeof first);
}

Float4 blend(const std::uint8_t* above_left, const std::uint8_t* above_right, const std::uint8_t* below_left,
             const std::uint8_t* below_right, float right, float below) {
  const Float4 above = load(above_left) + right * (load(above_right) - load(above_left));
  const Float4 under = load(below_left) + right * (load(below_right) - load(below_left));
  return above + below * (under - above);
}

}  // namespace

void Region::image_from_net(const Eigen::Ref<const Eigen::Matrix3Xf>& net_px, int input_side,
                            Eigen::Matrix3Xf& image_px) const {
  const float pixel = size_px / static_cast<float>(input_side);
  Eigen::Matrix3f turn = Eigen::Matrix3f::Zero();
  turn.col(0).head<2>() = pixel * right();
  turn.col(1).head<2>() = pixel * down();
  turn(2, 2) = pixel;
  Eigen::Vector3f origin = Eigen::Vector3f::Zero();
  origin.head<2>() = image_from_window(Eigen::Vector2f::Zero());
  image_px.resize(3, net_px.cols());
  image_px.noalias() = turn * net_px;
  image_px.colwise() += origin;
}

RegionSampler::RegionSampler(int side) : side_(side) {}

RegionSampler::Source RegionSampler::average_boxes(const Frame& frame, const Region& region, int box) {
  // The boxes that the window touches, in a grid fixed to the image, so that a moving window sees the same
  // averages.
  const float half = 0.5F * region.size_px * (region.right().cwiseAbs().sum()) + static_cast<float>(box);
  const auto first_box = [&](float centre, int extent) {
    const float low = std::clamp(centre - half, 0.0F, static_cast<float>(extent - 1));
    return static_cast<int>(low) / box;
  };
  const auto last_box = [&](float centre, int extent) {
    const float high = std::clamp(centre + half, 0.0F, static_cast<float>(extent - 1));
    return static_cast<int>(high) / box;
  };
  const int box_x = first_box(region.centre_px.x(), frame.width_px);
  const int box_y = first_box(region.centre_px.y(), frame.height_px);
  Source source;
  source.box = static_cast<float>(box);
  source.first_x = box_x * box;
  source.first_y = box_y * box;
  source.width = last_box(region.centre_px.x(), frame.width_px) - box_x + 1;
  source.height = last_box(region.centre_px.y(), frame.height_px) - box_y + 1;
  source.stride_bytes = 4 * static_cast<std::size_t>(source.width);
  averaged_.resize(source.stride_bytes * static_cast<std::size_t>(source.height));
  source.pixels = averaged_.data();

  const int columns = std::min(source.width * box, frame.width_px - source.first_x);
  const auto values = 4 * static_cast<std::size_t>(columns);
  column_sums_.resize(values);
  const int row_step = (box + max_rows_per_box - 1) / max_rows_per_box;
  for (int y = 0; y < source.height; ++y) {
    const int begin = source.first_y + y * box;
    const int end = std::min(begin + box, frame.height_px);
    int rows = 0;
    std::fill(column_sums_.begin(), column_sums_.end(), std::uint16_t{0});
    for (int row = begin; row < end; row += row_step, ++rows) {
      const std::uint8_t* pixels = frame.row(row) + 4 * static_cast<std::size_t>(source.first_x);
      std::uint16_t* sums = column_sums_.data();
      for (std::size_t i = 0; i < values; ++i) {
        sums[i] = static_cast<std::uint16_t>(sums[i] + pixels[i]);
      }
    }
    std::uint8_t* out = averaged_.data() + static_cast<std::size_t>(y) * source.stride_bytes;
    for (int x = 0; x < source.width; ++x, out += 4) {
      const int from = x * box;
      const int to = std::min(from + box, columns);
      Int4 sum{};
      for (int column = from; column < to; ++column) {
        Short4 column_sum;
        std::memcpy(&column_sum, &column_sums_[4 * static_cast<std::size_t>(column)], sizeof column_sum);
        sum += __builtin_convertvector(column_sum, Int4);
      }
      const float weight = 1.0F / static_cast<float>(rows * (to - from));
      store(__builtin_convertvector(sum, Float4) * weight + 0.5F, out);
    }
  }
  return source;
}

void RegionSampler::sample(const Frame& frame, const Region& region, Border border, float scale, float offset,
                           std::span<float> planar) {
  const float pixels_per_output = region.size_px / static_cast<float>(side_);
  const int box = std::clamp(static_cast<int>(std::lround(std::min(pixels_per_output, 1e4F))), 1,
                             std::max(frame.width_px, frame.height_px));
  const Source source = box == 1
                            ? Source{frame.pixels.get(), frame.stride_bytes, frame.width_px, frame.height_px}
                            : average_boxes(frame, region, box);

  // From here on in the source's pixels, their centres at integers.
  const auto source_from_image = [&](const Eigen::Vector2f& image) {
    const Eigen::Vector2f first(static_cast<float>(source.first_x), static_cast<float>(source.first_y));
    return Eigen::Vector2f(((image - first).array() + 0.5F) / source.box - 0.5F);
  };
  const Eigen::Vector2f right = region.right() * (pixels_per_output / source.box);
  const Eigen::Vector2f down = region.down() * (pixels_per_output / source.box);
  const Eigen::Vector2f first =
      source_from_image(region.image_from_window(Eigen::Vector2f::Zero())) + 0.5F * (right + down);
  const Eigen::Vector2f image_begin = source_from_image(Eigen::Vector2f::Constant(-0.5F));
  const Eigen::Vector2f image_end = source_from_image(
      {static_cast<float>(frame.width_px) - 0.5F, static_cast<float>(frame.height_px) - 0.5F});
  const auto last_x = static_cast<float>(source.width - 1);
  const auto last_y = static_cast<float>(source.height - 1);

  const auto side = static_cast<std::size_t>(side_);
  float* red = planar.data();
  float* green = red + side * side;
  float* blue = green + side * side;
  for (std::size_t row = 0; row < side; ++row) {
    const Eigen::Vector2f start = first + static_cast<float>(row) * down;
    for (std::size_t column = 0; column < side; ++column) {
      const float x = start.x() + static_cast<float>(column) * right.x();
      const float y = start.y() + static_cast<float>(column) * right.y();
      Float4 colour{};
      const bool beyond =
          x < image_begin.x() || y < image_begin.y() || x > image_end.x() || y > image_end.y();
      if (border == Border::Replicate || !beyond) {
        const float inside_x = std::clamp(x, 0.0F, last_x);
        const float inside_y = std::clamp(y, 0.0F, last_y);
        const int x0 = static_cast<int>(inside_x);
        const int y0 = static_cast<int>(inside_y);
        const std::size_t next_x = x0 + 1 < source.width ? 4 : 0;
        const std::size_t next_y = y0 + 1 < source.height ? source.stride_bytes : 0;
        const std::uint8_t* pixel = source.pixels + static_cast<std::size_t>(y0) * source.stride_bytes +
                                    4 * static_cast<std::size_t>(x0);
        colour = blend(pixel, pixel + next_x, pixel + next_y, pixel + next_x + next_y,
                       inside_x - static_cast<float>(x0), inside_y - static_cast<float>(y0));
      }
      const Float4 value = scale * colour + offset;
      const std::size_t out = row * side + column;
      red[out] = value[0];
      green[out] = value[1];
      blue[out] = value[2];
    }
  }
}

}  // namespace facet::landmark
