#include "stream/image_codec.hpp"

#include <algorithm>
#include <array>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "stream/pixel_packing.hpp"
#include "stream/protocol.hpp"

namespace facet::stream {
namespace {

using flatbuffers::FlatBufferBuilder;
using flatbuffers::Offset;

constexpr std::size_t kRgbaBytes = 4;

std::size_t pixel_count(const Frame& frame) {
  return static_cast<std::size_t>(frame.width_px) * static_cast<std::size_t>(frame.height_px);
}

/// So many pixels each way become one, that the longest side is no longer than wanted.
int scale_of(const Frame& frame, const WantedPixels& wanted) {
  const int longest = std::max(frame.width_px, frame.height_px);
  const int shortest = std::min(frame.width_px, frame.height_px);
  if (!wanted.any || wanted.longest_px <= 0 || longest <= wanted.longest_px) {
    return 1;
  }
  return std::clamp((longest + wanted.longest_px - 1) / wanted.longest_px, 1, std::min(shortest, 255));
}

Offset<wire::Image> write_image(FlatBufferBuilder& builder, const Frame& frame, std::size_t camera,
                                const WantedPixels& wanted) {
  Offset<flatbuffers::Vector<std::uint8_t>> pixels;
  const int scale = scale_of(frame, wanted);
  const std::size_t channels = wanted.any && scale == 1 ? channel_count(frame) : 3;
  const int width_px = frame.width_px / scale;
  const int height_px = frame.height_px / scale;
  if (wanted.any) {
    std::uint8_t* out = nullptr;
    pixels = builder.CreateUninitializedVector(
        static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px) * channels, &out);
    scale == 1 ? pack_pixels(frame, channels, out) : pack_smaller(frame, scale, out);
  }
  return wire::CreateImage(builder, static_cast<std::uint8_t>(camera), frame.sequence, frame.timestamp_ns,
                           frame.corrupt, static_cast<std::uint16_t>(width_px),
                           static_cast<std::uint16_t>(height_px), static_cast<std::uint8_t>(channels), pixels,
                           static_cast<std::uint8_t>(scale));
}

void require(bool holds, const char* what) {
  if (!holds) {
    throw Error(ErrorKind::UnreadableInput, std::string("damaged or foreign message: frame set: ") + what);
  }
}

Frame read_image(const wire::Image& image) {
  require(image.width_px() > 0 && image.width_px() <= kMaxImagePx && image.height_px() > 0 &&
              image.height_px() <= kMaxImagePx,
          "size of an image");
  require(image.channels() == 1 || image.channels() == 3, "channels of an image");
  Frame frame;
  frame.sequence = image.sequence();
  frame.timestamp_ns = image.timestamp_ns();
  frame.corrupt = image.corrupt();
  frame.width_px = image.width_px();
  frame.height_px = image.height_px();
  frame.stride_bytes = static_cast<std::size_t>(image.width_px()) * kRgbaBytes;
  if (image.pixels() == nullptr) {
    return frame;
  }
  const std::size_t count = pixel_count(frame);
  require(image.pixels()->size() == count * image.channels(), "number of an image's pixels");
  frame.pixels = unpack_pixels(image.pixels()->data(), image.channels(), count);
  return frame;
}

}  // namespace

std::size_t pixel_bytes(const FrameSet& set, const WantedPixels& wanted) {
  std::size_t bytes = 0;
  for (const Frame& frame : set.frames) {
    if (wanted.any && !frame.empty()) {
      const auto scale = static_cast<std::size_t>(scale_of(frame, wanted));
      bytes += pixel_count(frame) / (scale * scale) * 3;
    }
  }
  return bytes;
}

Offset<wire::FrameSet> write_frame_set(FlatBufferBuilder& builder, const FrameSet& set,
                                       const WantedPixels& wanted) {
  const std::size_t cameras = std::min(set.frames.size(), kMaxCameras);
  std::array<Offset<flatbuffers::String>, kMaxCameras> names;
  std::array<Offset<wire::Image>, kMaxCameras> images;
  std::size_t image_count = 0;
  for (std::size_t camera = 0; camera < cameras; ++camera) {
    const std::string_view name = set.camera_names != nullptr && camera < set.camera_names->size()
                                      ? std::string_view((*set.camera_names)[camera])
                                      : std::string_view();
    const std::string_view part = name.substr(0, kMaxNameBytes);
    names.at(camera) = builder.CreateString(part.data(), part.size());
    const Frame& frame = set.frames[camera];
    if (!frame.empty() && frame.width_px <= static_cast<int>(kMaxImagePx) &&
        frame.height_px <= static_cast<int>(kMaxImagePx)) {
      images.at(image_count++) = write_image(builder, frame, camera, wanted);
    }
  }
  const auto name_vector = builder.CreateVector(names.data(), cameras);
  const auto image_vector = builder.CreateVector(images.data(), image_count);
  Offset<flatbuffers::String> light;
  if (!set.light.empty() && set.light.size() <= kMaxLightBytes) {
    light = builder.CreateString(set.light);
  }
  return wire::CreateFrameSet(builder, set.slot, set.trigger_ns, set.skew_ns, name_vector, image_vector,
                              light);
}

std::shared_ptr<const FrameSet> read_frame_set(const wire::FrameSet& set, std::int64_t media_time_ns) {
  require(set.cameras() != nullptr && set.cameras()->size() > 0 && set.cameras()->size() <= kMaxCameras,
          "number of cameras");
  auto out = std::make_shared<FrameSet>();
  out->slot = set.slot();
  out->trigger_ns = set.trigger_ns();
  out->media_time_ns = media_time_ns;
  out->skew_ns = set.skew_ns();
  std::vector<std::string> names;
  for (const flatbuffers::String* name : *set.cameras()) {
    require(name->size() <= kMaxNameBytes, "name of a camera");
    names.push_back(name->str());
  }
  if (set.light() != nullptr) {
    require(set.light()->size() <= kMaxLightBytes, "light of a slot");
    out->light = set.light()->str();
  }
  out->frames.resize(names.size());
  out->missing = ~std::uint64_t{0} >> (kMaxCameras - names.size());
  if (set.images() != nullptr) {
    for (const wire::Image* image : *set.images()) {
      const std::size_t camera = image->camera();
      require(camera < names.size() && (out->missing >> camera & 1) != 0, "camera of an image");
      out->frames[camera] = read_image(*image);
      out->missing &= ~(std::uint64_t{1} << camera);
    }
  }
  out->camera_names = std::make_shared<const std::vector<std::string>>(std::move(names));
  return out;
}

}  // namespace facet::stream
