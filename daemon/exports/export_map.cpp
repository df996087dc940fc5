#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfOutputFile.h>
#include <ImfStandardAttributes.h>
#include <ImfStdIO.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "exports/export.hpp"
#include "facet/error.hpp"
#include "files/image_file.hpp"
#include "files/output_file.hpp"
#include "maths/srgb.hpp"

namespace facet::exports {
namespace {

/// What a PNG's 16 bits stand for, 0 to 1.
float coded(float value, MapKind kind) {
  switch (kind) {
    case MapKind::Displacement:
      return 0.5F + value / (2.0F * kDisplacementRange_mm);
    case MapKind::ObjectNormal:
    case MapKind::TangentNormal:
      return 0.5F + 0.5F * value;
    case MapKind::Albedo:
      return maths::encode_srgb(std::min(value, 1.0F));
  }
  return 0;
}

/// Value: std::uint8_t or std::uint16_t.
template <typename Value>
std::vector<std::uint8_t> encode(const MapPicture& picture, MapKind kind) {
  constexpr auto kMost = static_cast<float>(std::numeric_limits<Value>::max());
  std::vector<Value> values(picture.values.size());
  std::transform(picture.values.begin(), picture.values.end(), values.begin(), [kind](float value) {
    return static_cast<Value>(std::lrint(std::clamp(coded(value, kind), 0.0F, 1.0F) * kMost));
  });
  return files::encode_png(picture.size_px, picture.size_px, values);
}

void write_png(const MapPicture& picture, MapKind kind, const std::filesystem::path& file) {
  const std::vector<std::uint8_t> bytes = encode<std::uint16_t>(picture, kind);
  files::OutputFile output(file);
  output.write(std::as_bytes(std::span(bytes)));
  output.commit();
}

void write_exr(const MapPicture& picture, MapKind kind, const std::filesystem::path& file) {
  static constexpr std::array kNames = {"R", "G", "B"};
  Imf::Header header(picture.size_px, picture.size_px);
  header.compression() = Imf::ZIP_COMPRESSION;
  Imf::addComments(header,
                   kind == MapKind::Displacement ? "Facet: displacement, mm along the smooth surface's normal"
                   : kind == MapKind::ObjectNormal  ? "Facet: unit normal, head frame"
                   : kind == MapKind::TangentNormal ? "Facet: unit normal, x along u, y along v, z outwards"
                                                    : "Facet: albedo, linear RGB");
  Imf::FrameBuffer pixels;
  const std::size_t step = sizeof(float) * static_cast<std::size_t>(picture.channels);
  for (int channel = 0; channel < picture.channels; ++channel) {
    const char* name = picture.channels == 1 ? "Y" : kNames.at(static_cast<std::size_t>(channel));
    header.channels().insert(name, Imf::Channel(Imf::FLOAT));
    // The library reads alone through this pointer.
    auto* base = reinterpret_cast<char*>(const_cast<float*>(picture.values.data() + channel));
    pixels.insert(name, Imf::Slice(Imf::FLOAT, base, step, step * static_cast<std::size_t>(picture.size_px)));
  }
  Imf::StdOSStream stream;
  {
    Imf::OutputFile encoder(stream, header);
    encoder.setFrameBuffer(pixels);
    encoder.writePixels(picture.size_px);
  }
  files::OutputFile output(file);
  output.write(stream.str());
  output.commit();
}

}  // namespace

std::vector<std::uint8_t> encode_skin(const MapPicture& albedo) {
  return encode<std::uint8_t>(albedo, MapKind::Albedo);
}

void write_map(const MapPicture& picture, MapKind kind, PictureFormat format,
               const std::filesystem::path& file) {
  format == PictureFormat::Png ? write_png(picture, kind, file) : write_exr(picture, kind, file);
}

}  // namespace facet::exports
